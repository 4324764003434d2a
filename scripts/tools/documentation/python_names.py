"""The public names of the package by what they are for, and the modules whose types they take and return."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
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

MODULES: Final = (  # whose types a user's own program meets; the rest is inside
    "gaitcal.findings",
    "gaitcal.faults.verdict",
    "gaitcal.io.snapshot",
    "gaitcal.study.study",
    "gaitcal.study.study_trial",
    "gaitcal.study.truth",
    "gaitcal.session.result",
    "gaitcal.session.truth_errors",
    "gaitcal.session.joint_parameters",
    "gaitcal.study.settings",
    "gaitcal.study.joint_prior",
    "gaitcal.io.labels",
    "gaitcal.model.marker_set",
    "gaitcal.model.linkage",
    "gaitcal.model.parameters",
    "gaitcal.model.parameters",
    "gaitcal.model.segment_frames",
    "gaitcal.motion.spline",
    "gaitcal.motion.trial_problem",
    "gaitcal.calibration.joint_phases",
    "gaitcal.calibration.inertial_calibration",
    "gaitcal.dynamics.expected_residual",
    "gaitcal.published.case",
    "gaitcal.published.protocol",
    "gaitcal.published.statistics",
    "gaitcal.published.workers",
    "gaitcal.export",
    "gaitcal.compare",
    "gaitcal.page",
    "gaitcal.arrays",
)
TYPES: Final = (
    "gaitcal.dynamics.joint_kinetics.KineticErrors",
    "gaitcal.dynamics.axis_errors.TorqueErrors",
    "gaitcal.compare.sessions.SessionComparison",
    "gaitcal.study.study_file.StudyFile",
    "gaitcal.study.study_file.TrialTable",
    "gaitcal.study.study_file.TruthTable",
    "gaitcal.io.recording.ForcePlate",
    "gaitcal.session.bandwidth.Bandwidth",
    "gaitcal.motion.spline.NodeRule",
    "gaitcal.motion.motion.MarkerErrors",
    "gaitcal.motion.descent.DescentSettings",
    "gaitcal.published.study.MonteCarloStudy",
    "gaitcal.published.study.DrawProgress",
    "gaitcal.model.subject_model.MarkerPlacement",
    "gaitcal.model.segment_frames.HipCentre",
    "gaitcal.model.ankle_zero.AnkleZero",
    "gaitcal.gait.conventions.NormalBand",
    "gaitcal.gait.conventions.Bands",
    "gaitcal.results.table_file.Json",
    "gaitcal.runtime.Progress",
    "gaitcal.codes.Code",
)
"""Types of signatures whose modules hold much else."""


def ungrouped() -> set[str]:
    """Public names in no group, or in a group and not public."""
    return set(gaitcal.__all__) ^ {name for names in GROUPS.values() for name in names}


def undocumented() -> list[str]:
    """Public functions and classes, and their public members and fields, that nothing is said about.

    Needs griffe, which the extra `docs` brings; empty without it.
    """
    if find_spec("griffe") is None:
        return []
    griffe = import_module("griffe")
    package = griffe.load("gaitcal", search_paths=[Path(gaitcal.__file__).parents[1]], resolve_aliases=True)
    out = []
    for name in gaitcal.__all__:
        found = package[name].final_target
        members = found.members.values() if found.is_class else ()
        said = [(name, found), *((f"{name}.{m.name}", m) for m in members if not m.name.startswith("_"))]
        out += [full for full, object_ in said if object_.docstring is None and not object_.is_alias]
    return out


def markdown(group: str) -> str:
    """Directives for the public names of a group, or for the modules (`inside`)."""
    names = (*MODULES, *TYPES) if group == "inside" else tuple(f"gaitcal.{name}" for name in GROUPS[group])
    return "\n\n".join(f"::: {name}" for name in names)
