"""The public names of the package by what they are for, and the modules whose types they take and return."""

from __future__ import annotations

from typing import Final

import gaitcal

GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "study": ("Study", "calibrate", "Calibration", "write_results", "parameter_table"),
    "recordings": ("Recording", "read_recording"),
    "model": (
        *("SubjectModel", "Subject", "nominal_model", "published_model", "build_model", "Parameters", "COORDINATES"),
        *("load_model", "save_model", "MarkerSet", "load_marker_set"),
    ),
    "motion": ("track", "Motion", "ground_reactions", "GroundReactions", "inverse_dynamics", "Moments"),
    "kinetics": ("joint_kinetics", "JointKinetics", "power_of", "component_of", "MomentFrame"),
    "strides": (
        *("cycles", "read_cycles", "ensemble", "spatiotemporal", "cycles_to_xarray", "read_normal_bands"),
        *("Convention", "Signs", "Acting", "MomentUnit"),
    ),
    "studies": ("compare_results", "monte_carlo", "synthesize"),
    "errors": ("GaitcalError", "InputError", "ConvergenceError"),
}

MODULES: Final = (
    "gaitcal.findings",
    "gaitcal.verdict.verdict",
    "gaitcal.files.snapshot",
    "gaitcal.study.study",
    "gaitcal.study.study_trial",
    "gaitcal.study.truth",
    "gaitcal.person.result",
    "gaitcal.person.truth_errors",
    "gaitcal.person.hold_out",
    "gaitcal.study.settings",
    "gaitcal.recording.metadata",
    "gaitcal.model.marker_coverage",
    "gaitcal.model.linkage",
    "gaitcal.model.joint_parameters",
    "gaitcal.model.inertial_parameters",
    "gaitcal.model.segment_frames",
    "gaitcal.motion.spline",
    "gaitcal.motion.trial_problem",
    "gaitcal.calibration.joint_phases",
    "gaitcal.calibration.inertial_calibration",
    "gaitcal.dynamics.residual_limits",
    "gaitcal.montecarlo.case",
    "gaitcal.montecarlo.settings",
    "gaitcal.montecarlo.statistics",
    "gaitcal.montecarlo.workers",
    "gaitcal.export",
    "gaitcal.compare",
    "gaitcal.page",
)
"""Whose types a user's own program meets; the rest is inside."""


def ungrouped() -> set[str]:
    """Public names in no group, or in a group and not public."""
    return set(gaitcal.__all__) ^ {name for names in GROUPS.values() for name in names}


def markdown(group: str) -> str:
    """Directives for the public names of a group, or for the modules (`inside`)."""
    names = MODULES if group == "inside" else tuple(f"gaitcal.{name}" for name in GROUPS[group])
    return "\n\n".join(f"::: {name}" for name in names)
