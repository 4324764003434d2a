"""Build all curves of one trial: angles, moments, powers and forces with errors and valid frames.

As in the files of a result: angles in degrees, internal moments in N·m with OpenSim's signs, powers
in W, forces in N. `cycles.csv` and the page normalise them over strides.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from gaitcal.analysis.result import Loads, TrialResult, find_valid_angles
from gaitcal.analysis.truth_errors import CurveTruth, CurveTruths
from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_reactions import find_unobserved_frames
from gaitcal.dynamics.joint_kinetics import power_of
from gaitcal.gait import cycles, moments, strides
from gaitcal.model.coordinates import (
    COORDINATE_TABLE,
    FOOT_PROGRESSION,
    GROUPS,
    SEGMENT_ANGLES,
    split_side,
)
from gaitcal.model.linkage import PELVIS_ANGLES, SIDES, is_translation
from gaitcal.model.subject_model import SubjectModel
from gaitcal.results.trial_tables import select_free_powers
from gaitcal.tracking.motion import Motion, select_static_offsets

GROUND: Final = {
    "ground_reaction_vertical": 1,
    "ground_reaction_forward": 0,
    "ground_reaction_sideways": 2,
}
"""Force of the ground on a foot -> its laboratory axis: y up, x forward, z to the right."""
_ENDINGS: Final = {kind.label: kind.ending for kind in cycles.CurveKind}


@dataclass(frozen=True)
class Curve:
    """One variable of one trial."""

    base: str  # Coordinate without its side, joint of a power, or name of a force
    side: str  # `r`, `l`; empty if it belongs to no leg
    # `angle`, `moment`, `power`, `force`, `residual_force`, `residual_moment`, `marker_error`
    kind: str
    unit: str  # `deg`, `N m`, `W`, `N`, `mm`
    value: Array  # (nf,)
    valid: BoolArray  # (nf,) frames in which it counts
    error: Array | None = None  # (nf,) standard error
    stride_error: Array | None = None  # (nf,) its part that differs between strides
    nominal: Array | None = None  # (nf,) with the nominal model
    truth: Array | None = None  # (nf,) where it is known

    @property
    def variable(self) -> str:
        """Name in `cycles.csv`, without the side of the leg: `hip_flexion_moment`."""
        return (
            self.base
            if self.kind == "force"
            else f"{self.base}{_ENDINGS.get(self.kind, self.kind)}"
        )


def build_curves(
    model: SubjectModel,
    trial: TrialResult,
    relative_to: Mapping[str, float] | None,
    truth: CurveTruths | None,
) -> tuple[Curve, ...]:
    """Build all curves of a trial.

    Parameters
    ----------
    model
        The calibrated subject.
    trial
        One trial.
    relative_to
        Coordinate -> rad in the static posture, subtracted from the joint angles; None: anatomical.
    truth
        Declared true curves; None if unknown.

    Returns
    -------
    tuple of Curve
        Without moments, powers and forces if there are no force plates.
    """
    curves = [
        *_build_angles(model, trial, relative_to, truth),
        *_build_feet(trial),
        _build_marker_error(trial),
    ]
    if trial.loads is not None:
        curves += [
            *_build_moments(model, trial.loads, truth),
            *_build_powers(model, trial.loads),
            *_build_forces(trial.loads),
        ]
        curves += _build_residuals(trial.loads)
    return tuple(curves)


def find_joint(base: str) -> str:
    """Find the joint of the page for a coordinate or for a joint power.

    Parameters
    ----------
    base
        Coordinate without its side, or joint of a power.

    Returns
    -------
    str
        Empty if there is none.
    """
    if row := COORDINATE_TABLE.get(base) or SEGMENT_ANGLES.get(base):
        return row.group
    return next((key for key, group in GROUPS.items() if group.power == base), "")


def _build_angles(
    model: SubjectModel,
    trial: TrialResult,
    relative_to: Mapping[str, float] | None,
    truth: CurveTruths | None,
) -> Iterator[Curve]:
    """Build joint angles; those of the pelvis are relative to the trial's line of progression."""
    body, hidden, static, nominal = (
        trial.body,
        find_unobserved_frames(trial.body),
        select_static_offsets(relative_to),
        _get_nominal_motion(trial),
    )
    known: Mapping[str, CurveTruth] = {} if truth is None else truth.coordinates
    everywhere, line = np.ones(len(body.time), dtype=bool), compute_line(trial)
    pelvis = {
        part: np.degrees(strides.express_along_line(angles, line, everywhere))
        for part, angles in collect_pelvis_parts(trial, truth).items()
    }
    for k, name in enumerate(body.coordinates):
        if name in model.frozen or is_translation(name):
            continue
        offset = np.degrees(static.get(name, 0.0))
        errors = (trial.coordinate_errors, trial.trial_coordinate_errors)
        # The whole standard error, and its part that differs from stride to stride.
        error, stride_error = (None if e is None else np.degrees(e[:, k]) for e in errors)
        values = {
            "value": np.degrees(body.q[:, k]) - offset,
            "nominal": None if nominal is None else np.degrees(nominal.q[:, k]) - offset,
            "truth": known[name].truth - offset if name in known else None,
        }
        # Pelvis angles in the room depend on the walking direction.
        if name in PELVIS_ANGLES:
            values = {
                part: pelvis[part][:, PELVIS_ANGLES.index(name)] if part in pelvis else None
                for part in values
            }
        yield Curve(
            *split_side(name),
            "angle",
            "deg",
            valid=find_valid_angles(trial, name, hidden),
            error=error,
            stride_error=stride_error,
            **values,
        )


def _build_feet(trial: TrialResult) -> Iterator[Curve]:
    """Build foot progression relative to the trial's line; strides have other lines."""
    feet, line, hidden = trial.foot_axes, compute_line(trial), find_unobserved_frames(trial.body)
    if feet is None:
        return
    for k, side in enumerate(SIDES):
        error, stride_error = (
            None if e is None else np.degrees(e[:, k]) for e in (feet.error, feet.marker_error)
        )
        # The direction of the foot is valid where the foot is visible, as its last joint angle.
        valid = find_valid_angles(trial, f"subtalar_angle_{side}", hidden)
        value = np.degrees(feet.compute_progression(side, line))
        yield Curve(
            FOOT_PROGRESSION,
            side,
            "angle",
            "deg",
            value,
            valid,
            error=error,
            stride_error=stride_error,
        )


def compute_line(trial: TrialResult) -> float:
    """Compute the mean line of progression of a trial.

    Parameters
    ----------
    trial
        One trial.

    Returns
    -------
    float
        Rad to the left of the laboratory's x axis; 0 if no stride has a line.
    """
    lines = [stride.line for stride in trial.strides if stride.line is not None]
    return float(np.angle(np.mean(np.exp(1j * np.array(lines))))) if lines else 0.0


def collect_pelvis_parts(trial: TrialResult, truth: CurveTruths | None) -> dict[str, Array]:
    """Collect pelvis angles relative to the laboratory.

    Parameters
    ----------
    trial
        One trial.
    truth
        Declared true curves; None if unknown.

    Returns
    -------
    dict
        `value`, and `nominal` and `truth` if known -> (nf, 3) rad, `PELVIS_ANGLES`.
    """
    nominal, known = _get_nominal_motion(trial), {} if truth is None else truth.coordinates
    out = {"value": strides.get_pelvis_angles(trial.body)}
    if nominal is not None:
        out["nominal"] = strides.get_pelvis_angles(nominal)
    if all(name in known for name in PELVIS_ANGLES):
        out["truth"] = np.radians(np.stack([known[name].truth for name in PELVIS_ANGLES], axis=1))
    return out


def _get_nominal_motion(trial: TrialResult) -> Motion | None:
    return trial.nominal if trial.nominal.coordinates == trial.body.coordinates else None


def _build_moments(model: SubjectModel, loads: Loads, truth: CurveTruths | None) -> Iterator[Curve]:
    known: Mapping[str, CurveTruth] = {} if truth is None else truth.forces
    for name in moments.list_moments(model):
        yield Curve(
            *split_side(name),
            "moment",
            "N m",
            value=moments.get_moment(loads.final, name),
            valid=loads.reactions.valid_for(name),
            error=None if loads.errors is None else moments.get_moment(loads.errors, name),
            stride_error=None
            if loads.errors is None
            else moments.get_trial_marker_se(loads.errors, name),
            nominal=moments.get_moment(loads.nominal, name),
            truth=known[name].truth if name in known else None,
        )


def _build_powers(model: SubjectModel, loads: Loads) -> Iterator[Curve]:
    if loads.kinetics is None:
        return
    errors = None if loads.errors is None else loads.errors.kinetics
    for name in select_free_powers(model.frozen):
        # Powers of the pelvis and of the arms have no clinical use.
        if find_joint(split_side(name)[0]) in ("", "arm"):
            continue
        yield Curve(
            *split_side(name),
            "power",
            "W",
            value=power_of(loads.kinetics, name),
            valid=loads.reactions.valid_for(name),
            error=None if errors is None else power_of(errors, name),
            stride_error=None
            if errors is None or errors.from_markers is None
            else power_of(errors.from_markers, name),
        )


def _build_forces(loads: Loads) -> Iterator[Curve]:
    for leg, side in enumerate(SIDES):
        valid = np.asarray(loads.reactions.valid_legs[:, leg])
        for base, axis in GROUND.items():
            value = loads.reactions.wrench[:, leg, axis]
            yield Curve(base, side, "force", "N", value, valid)


def _build_residuals(loads: Loads) -> Iterator[Curve]:
    """Build the pelvis residuals of the last and the first model."""
    # Residuals with nominal and fitted inertial parameters.
    if not (stages := loads.residuals):
        return
    first, last = stages[0], stages[-1]
    for kind, unit, value, nominal in (
        ("residual_force", "N", last.force, first.force),
        ("residual_moment", "N m", last.moment, first.moment),
    ):
        yield Curve(kind, "", kind, unit, value, loads.reactions.valid, nominal=nominal)


def _build_marker_error(trial: TrialResult) -> Curve:
    """Build the RMS distance (mm) of measured and model markers with weight, frame by frame."""
    errors = trial.body.errors if trial.joint is None else trial.calibrated.errors
    kind, value = "marker_error", 1e3 * errors.compute_rms_by_frame()
    nominal = 1e3 * trial.nominal.errors.compute_rms_by_frame()
    return Curve(kind, "", kind, "mm", value, np.isfinite(value), nominal=nominal)
