"""All curves of one trial: angles, moments, powers, forces, with their errors and the frames in
which they count.

As in the files of a result: angles in degrees, internal moments in N·m with OpenSim's signs, powers
in W, forces in N. `cycles.csv` and the page lay them over strides.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from gaitcal.analysis.result import Loads, TrialResult, angle_counts
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
from gaitcal.results.trial_tables import told_powers
from gaitcal.tracking.motion import MarkerErrors, Motion, select_static_offsets

GROUND: Final = {
    "ground_reaction_vertical": 1,
    "ground_reaction_forward": 0,
    "ground_reaction_sideways": 2,
}
"""Force of the ground on a foot -> its laboratory axis: y up, x forward, z to the right."""
_ENDINGS: Final = {kind.words: kind.ending for kind in cycles.CurveKind}


@dataclass(frozen=True)
class Curve:
    """One variable of one trial."""

    base: str  # Coordinate without its side, joint of a power, or what a force is called
    side: str  # `r`, `l`; empty of what belongs to no leg
    # `angle`, `moment`, `power`, `force`, `residual_force`, `residual_moment`, `marker_error`
    kind: str
    unit: str  # `deg`, `N m`, `W`, `N`, `mm`
    value: Array  # (nf,)
    valid: BoolArray  # (nf,) frames in which it counts
    error: Array | None = None  # (nf,) standard error
    own: Array | None = None  # (nf,) the part of it that differs from stride to stride
    nominal: Array | None = None  # (nf,) with the nominal model
    truth: Array | None = None  # (nf,) where it is known

    @property
    def variable(self) -> str:
        """Without the side of its leg, as `cycles.csv` calls it: `hip_flexion_moment`."""
        return (
            self.base
            if self.kind == "force"
            else f"{self.base}{_ENDINGS.get(self.kind, self.kind)}"
        )


def curves_of(
    model: SubjectModel,
    trial: TrialResult,
    relative_to: Mapping[str, float] | None,
    truth: CurveTruths | None,
) -> tuple[Curve, ...]:
    """All curves of a trial.

    `relative_to`: coordinate -> rad in the static posture, from which joint angles are counted;
    None: from zero. `truth`: None where it is not known.
    """
    curves = [*_angles(model, trial, relative_to, truth), *_feet(trial), _marker_error(trial)]
    if trial.loads is not None:
        curves += [
            *_moments(model, trial.loads, truth),
            *_powers(model, trial.loads),
            *_forces(trial.loads),
        ]
        curves += _residuals(trial.loads)
    return tuple(curves)


def joint_of(base: str) -> str:
    """The joint of the page that a coordinate, or a power of a joint, belongs to; empty where none."""
    if row := COORDINATE_TABLE.get(base) or SEGMENT_ANGLES.get(base):
        return row.group
    return next((key for key, group in GROUPS.items() if group.power == base), "")


def _angles(
    model: SubjectModel,
    trial: TrialResult,
    relative_to: Mapping[str, float] | None,
    truth: CurveTruths | None,
) -> Iterator[Curve]:
    """Joint angles; those of the pelvis against the trial's line of progression."""
    body, unseen, static, whole = (
        trial.body,
        find_unobserved_frames(trial.body),
        select_static_offsets(relative_to),
        _whole(trial),
    )
    known: Mapping[str, CurveTruth] = {} if truth is None else truth.coordinates
    everywhere, line = np.ones(len(body.time), dtype=bool), line_of(trial)
    pelvis = {
        part: np.degrees(strides.along_line(angles, line, everywhere))
        for part, angles in pelvis_parts(trial, truth).items()
    }
    for k, name in enumerate(body.coordinates):
        if name in model.frozen or is_translation(name):
            continue
        off = np.degrees(static.get(name, 0.0))
        errors = (trial.coordinate_errors, trial.own_coordinate_errors)
        error, own = (None if e is None else np.degrees(e[:, k]) for e in errors)
        values = {
            "value": np.degrees(body.q[:, k]) - off,
            "nominal": None if whole is None else np.degrees(whole.q[:, k]) - off,
            "truth": known[name].truth - off if name in known else None,
        }
        if name in PELVIS_ANGLES:
            values = {
                part: pelvis[part][:, PELVIS_ANGLES.index(name)] if part in pelvis else None
                for part in values
            }
        yield Curve(
            *split_side(name),
            "angle",
            "deg",
            valid=angle_counts(trial, name, unseen),
            error=error,
            own=own,
            **values,
        )


def _feet(trial: TrialResult) -> Iterator[Curve]:
    """Foot progression against the trial's line; each stride has its own (`_strides`)."""
    feet, line, unseen = trial.foot_axes, line_of(trial), find_unobserved_frames(trial.body)
    if feet is None:
        return
    for k, side in enumerate(SIDES):
        error, own = (None if e is None else np.degrees(e[:, k]) for e in (feet.error, feet.own))
        valid = angle_counts(trial, f"subtalar_angle_{side}", unseen)
        value = np.degrees(feet.progression(side, line))
        yield Curve(FOOT_PROGRESSION, side, "angle", "deg", value, valid, error=error, own=own)


def line_of(trial: TrialResult) -> float:
    """Rad to the left of the room's x axis: where the walk goes on the mean; 0 where its strides do
    not tell.
    """
    lines = [stride.line for stride in trial.strides if stride.line is not None]
    return float(np.angle(np.mean(np.exp(1j * np.array(lines))))) if lines else 0.0


def pelvis_parts(trial: TrialResult, truth: CurveTruths | None) -> dict[str, Array]:
    """`value`, and `nominal` and `truth` where they are known -> (nf, 3) rad, `PELVIS_ANGLES`
    against the room.
    """
    whole, known = _whole(trial), {} if truth is None else truth.coordinates
    out = {"value": strides.pelvis_angles(trial.body)}
    if whole is not None:
        out["nominal"] = strides.pelvis_angles(whole)
    if all(name in known for name in PELVIS_ANGLES):
        out["truth"] = np.radians(np.stack([known[name].truth for name in PELVIS_ANGLES], axis=1))
    return out


def _whole(trial: TrialResult) -> Motion | None:
    return trial.nominal if trial.nominal.coordinates == trial.body.coordinates else None


def _moments(model: SubjectModel, loads: Loads, truth: CurveTruths | None) -> Iterator[Curve]:
    known: Mapping[str, CurveTruth] = {} if truth is None else truth.forces
    for name in moments.moment_names(model):
        yield Curve(
            *split_side(name),
            "moment",
            "N m",
            value=moments.moment_of(loads.final, name),
            valid=loads.reactions.valid_for(name),
            error=None if loads.errors is None else moments.moment_of(loads.errors, name),
            own=None if loads.errors is None else moments.own_error_of(loads.errors, name),
            nominal=moments.moment_of(loads.nominal, name),
            truth=known[name].truth if name in known else None,
        )


def _powers(model: SubjectModel, loads: Loads) -> Iterator[Curve]:
    if loads.kinetics is None:
        return
    errors = None if loads.errors is None else loads.errors.kinetics
    for name in told_powers(model.frozen):
        if joint_of(split_side(name)[0]) in ("", "arm"):
            continue
        yield Curve(
            *split_side(name),
            "power",
            "W",
            value=power_of(loads.kinetics, name),
            valid=loads.reactions.valid_for(name),
            error=None if errors is None else power_of(errors, name),
            own=None
            if errors is None or errors.from_markers is None
            else power_of(errors.from_markers, name),
        )


def _forces(loads: Loads) -> Iterator[Curve]:
    for leg, side in enumerate(SIDES):
        valid = np.asarray(loads.reactions.valid_legs[:, leg])
        for base, axis in GROUND.items():
            value = loads.reactions.wrench[:, leg, axis]
            yield Curve(base, side, "force", "N", value, valid)


def _residuals(loads: Loads) -> Iterator[Curve]:
    """What the pelvis would have to be held with, of the last model and of the first."""
    if not (stages := loads.residuals):
        return
    first, last = stages[0], stages[-1]
    for kind, unit, value, nominal in (
        ("residual_force", "N", last.force, first.force),
        ("residual_moment", "N m", last.moment, first.moment),
    ):
        yield Curve(kind, "", kind, unit, value, loads.reactions.valid, nominal=nominal)


def _marker_error(trial: TrialResult) -> Curve:
    """RMS distance (mm) of measured and model markers with weight, in each frame."""
    value = _rms(trial.body.errors if trial.joint is None else trial.calibrated.errors)
    kind, nominal = "marker_error", _rms(trial.nominal.errors)
    return Curve(kind, "", kind, "mm", value, np.isfinite(value), nominal=nominal)


def _rms(errors: MarkerErrors) -> Array:
    """(nf,) mm; NaN where no marker is seen."""
    squares = errors.distance[:, errors.weight > 0] ** 2
    seen = np.isfinite(squares)
    sums, counts = np.where(seen, squares, 0.0).sum(axis=1), seen.sum(axis=1)
    return np.asarray(
        1e3 * np.sqrt(np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0))
    )
