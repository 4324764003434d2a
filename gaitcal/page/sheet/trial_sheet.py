"""One trial of the page beside its body in motion: curves, events, strides, verdict.

The curves of one trial: angles, moments, powers, ground forces, pelvis residuals and marker errors at each frame.

Everything is as in the files of a result: angles in degrees, internal moments in N·m with OpenSim's signs, powers in W,
forces in N. The page brings them into the convention that its reader chooses.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_reactions import unseen_frames
from gaitcal.dynamics.joint_kinetics import power_of
from gaitcal.faults.verdict import TrialVerdict
from gaitcal.gait.cycles import GaitCycle, normalise, source_words, usable
from gaitcal.gait.moments import moment_names, moment_of, own_error_of, role_words
from gaitcal.gait.spatiotemporal import Stride
from gaitcal.gait.strides import along_line, pelvis_angles, strides_of, turns
from gaitcal.model.coordinates import split_side
from gaitcal.model.linkage import PELVIS_ANGLES, SIDES, is_translation
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import MarkerErrors, Motion
from gaitcal.page.packing import base64_of, floats, lengths
from gaitcal.page.scene import MOST_FRAMES
from gaitcal.page.sections.sections import trial_sections
from gaitcal.page.sheet.rows import joint_of
from gaitcal.session.result import LoadedTrial, TrialResult, angle_counts
from gaitcal.session.tables import pelvis_in_stride, taken_off, told_powers
from gaitcal.session.truth_errors import CurveTruth, TrialTruth

GROUND: Final = {"ground_reaction_vertical": 1, "ground_reaction_forward": 0, "ground_reaction_sideways": 2}
"""Force of the ground on a foot -> its laboratory axis: y up, x forward, z to the right."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One variable of one trial."""

    base: str
    """Coordinate without its side, joint of a power, or what a force is called."""
    side: str
    """`r`, `l`; empty of what belongs to no leg."""
    kind: str
    """`angle`, `moment`, `power`, `force`, `residual_force`, `residual_moment`, `marker_error`."""
    unit: str
    """`deg`, `N m`, `W`, `N`, `mm`."""
    value: Array
    """(nf,)."""
    valid: BoolArray
    """(nf,) frames in which it counts."""
    error: Array | None = None
    """(nf,) standard error."""
    own: Array | None = None
    """(nf,) the part of it that differs from stride to stride."""
    nominal: Array | None = None
    """(nf,) with the nominal model."""
    truth: Array | None = None
    """(nf,) where it is known."""


def curves_of(
    model: SubjectModel, trial: TrialResult, relative_to: Mapping[str, float] | None, truth: TrialTruth | None
) -> tuple[Curve, ...]:
    """All curves of a trial.

    Parameters
    ----------
    relative_to : coordinate -> rad in the static posture, from which joint angles are counted; None: from zero.
    truth : None where it is not known.
    """
    curves = [*_angles(model, trial, relative_to, truth), _marker_error(trial)]
    if trial.loads is not None:
        curves += [*_moments(model, trial.loads, truth), *_powers(model, trial.loads), *_forces(trial.loads)]
        curves += _residuals(trial.loads)
    return tuple(curves)


def packed_curves(curves: tuple[Curve, ...], every: int) -> dict[str, Any]:
    """`curves` for the page, of every so many frames; `masks` are shared: a curve's `valid` is the number of one."""
    kept = slice(None, None, every)
    masks = masks_of(curves)
    numbers = {mask.tobytes(): number for number, mask in enumerate(masks)}

    def packed(values: Array | None) -> dict[str, Any] | None:
        return None if values is None or not np.isfinite(values).any() else lengths(values[kept])

    told = [
        {
            "base": c.base,
            "side": c.side,
            "joint": joint_of(c.base),
            "kind": c.kind,
            "unit": c.unit,
            "valid": numbers[c.valid.tobytes()],
            "value": lengths(c.value[kept]),
            "se": packed(c.error),
            "own": packed(c.own),
            "nominal": packed(c.nominal),
            "truth": packed(c.truth),
        }
        for c in curves
    ]
    return {"curves": told, "masks": [base64_of(mask[kept].astype("<u1")) for mask in masks]}


def masks_of(curves: tuple[Curve, ...]) -> list[BoolArray]:
    """The different `valid` of the curves, in the order of `masks` of `packed_curves`."""
    return list({c.valid.tobytes(): c.valid for c in curves}.values())


def _angles(
    model: SubjectModel, trial: TrialResult, relative_to: Mapping[str, float] | None, truth: TrialTruth | None
) -> Iterator[Curve]:
    """Joint angles; those of the pelvis against the trial's line of progression."""
    body, frozen, unseen, static = trial.body, set(model.frozen), unseen_frames(trial.body), taken_off(relative_to)
    known: Mapping[str, CurveTruth] = {} if truth is None else truth.coordinates
    whole = _whole(trial)
    rooms = pelvis_parts(trial, truth)
    along = {part: _along(angles, line_of(trial)) for part, angles in rooms.items()}
    for k, name in enumerate(body.coordinates):
        if name in frozen or is_translation(name):
            continue
        off = np.degrees(static.get(name, 0.0))
        errors = (trial.coordinate_errors, trial.own_coordinate_errors)
        error, own = (None if e is None else np.degrees(e[:, k]) for e in errors)
        base, side = split_side(name)
        values = {
            "value": np.degrees(body.q[:, k]) - off,
            "nominal": None if whole is None else np.degrees(whole.q[:, k]) - off,
            "truth": known[name].truth - off if name in known else None,
        }
        if name in PELVIS_ANGLES:
            values = {part: along[part][:, PELVIS_ANGLES.index(name)] if part in along else None for part in values}
        yield Curve(
            base=base,
            side=side,
            kind="angle",
            unit="deg",
            valid=angle_counts(trial, name, unseen),
            error=error,
            own=own,
            **values,
        )


def line_of(trial: TrialResult) -> float:
    """Rad to the left of the room's x axis: where the walk goes on the mean; 0 where its strides do not tell."""
    lines = [stride.line for stride in trial.strides if stride.line is not None]
    return float(np.angle(np.mean(np.exp(1j * np.array(lines))))) if lines else 0.0


def pelvis_parts(trial: TrialResult, truth: TrialTruth | None) -> dict[str, Array]:
    """`value`, and `nominal` and `truth` where they are known -> (nf, 3) rad, `PELVIS_ANGLES` against the room."""
    whole, known = _whole(trial), {} if truth is None else truth.coordinates
    out = {"value": pelvis_angles(trial.body)}
    if whole is not None:
        out["nominal"] = pelvis_angles(whole)
    if all(name in known for name in PELVIS_ANGLES):
        out["truth"] = np.radians(np.stack([known[name].truth for name in PELVIS_ANGLES], axis=1))
    return out


def _whole(trial: TrialResult) -> Motion | None:
    return trial.nominal if trial.nominal.coordinates == trial.body.coordinates else None


def _along(angles: Array, line: float) -> Array:
    """(nf, 3) deg."""
    return np.asarray(np.degrees(along_line(angles, line, np.ones(len(angles), dtype=bool))))


def _moments(model: SubjectModel, loads: LoadedTrial, truth: TrialTruth | None) -> Iterator[Curve]:
    known: Mapping[str, CurveTruth] = {} if truth is None else truth.forces
    for name in moment_names(model):
        base, side = split_side(name)
        yield Curve(
            base=base,
            side=side,
            kind="moment",
            unit="N m",
            value=moment_of(loads.final, name),
            valid=loads.reactions.valid_for(name),
            error=None if loads.errors is None else moment_of(loads.errors, name),
            own=None if loads.errors is None else own_error_of(loads.errors, name),
            nominal=moment_of(loads.nominal, name),
            truth=known[name].truth if name in known else None,
        )


def _powers(model: SubjectModel, loads: LoadedTrial) -> Iterator[Curve]:
    if loads.kinetics is None:
        return
    errors = None if loads.errors is None else loads.errors.kinetics
    for name in told_powers(model.frozen):
        base, side = split_side(name)
        if joint_of(base) in ("", "arm"):
            continue
        yield Curve(
            base=base,
            side=side,
            kind="power",
            unit="W",
            value=power_of(loads.kinetics, name),
            valid=loads.reactions.valid_for(name),
            error=None if errors is None else power_of(errors, name),
            own=None if errors is None or errors.own is None else power_of(errors.own, name),
        )


def _forces(loads: LoadedTrial) -> Iterator[Curve]:
    for leg, side in enumerate(SIDES):
        valid = np.asarray(loads.reactions.valid_legs[:, leg])
        for base, axis in GROUND.items():
            value = loads.reactions.wrench[:, leg, axis]
            yield Curve(base=base, side=side, kind="force", unit="N", value=value, valid=valid)


def _residuals(loads: LoadedTrial) -> Iterator[Curve]:
    """What the pelvis would have to be held with, of the last model and of the first."""
    if not (stages := loads.residuals):
        return
    first, last = stages[0], stages[-1]
    for kind, unit, value, nominal in (
        ("residual_force", "N", last.force, first.force),
        ("residual_moment", "N m", last.moment, first.moment),
    ):
        yield Curve(base=kind, side="", kind=kind, unit=unit, value=value, nominal=nominal, valid=loads.reactions.valid)


def _marker_error(trial: TrialResult) -> Curve:
    """RMS distance (mm) of measured and model markers with weight, in each frame."""
    value = _rms(trial.body.errors if trial.joint is None else trial.calibrated.errors)
    return Curve(
        base="marker_error",
        side="",
        kind="marker_error",
        unit="mm",
        value=value,
        nominal=_rms(trial.nominal.errors),
        valid=np.isfinite(value),
    )


def _rms(errors: MarkerErrors) -> Array:
    """(nf,) mm; NaN where no marker is seen."""
    squares = errors.distance[:, errors.weight > 0] ** 2
    seen = np.isfinite(squares)
    sums, counts = np.where(seen, squares, 0.0).sum(axis=1), seen.sum(axis=1)
    return np.asarray(1e3 * np.sqrt(np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0)))


def trial_sheet(
    model: SubjectModel,
    trial: TrialResult,
    *,
    verdict: TrialVerdict | None,
    relative_to: Mapping[str, float] | None = None,
    truth: TrialTruth | None = None,
) -> dict[str, Any]:
    """What the page tells of a trial; numbers packed as in `page/packing.py`.

    Parameters
    ----------
    verdict : None of a trial that is not judged by itself.
    relative_to, truth : as of `curves_of`.
    """
    time = trial.body.time
    every = max(1, -(-len(time) // MOST_FRAMES))
    curves = curves_of(model, trial, relative_to, truth)
    return {
        "name": trial.name,
        "role": role_words(trial.role, trial.joint),
        "joint": trial.joint,
        "refused": list(trial.refused_legs),
        "verdict": None if verdict is None else _verdict(verdict),
        "start": float(time[0]),
        "duration": float(time[-1] - time[0]),
        "frames": len(time),
        "every": every,
        "time": floats((time - time[0])[::every]),
        **packed_curves(curves, every),
        "events": [
            {
                "side": e.side,
                "kind": e.moment.value,
                "time": e.time - float(time[0]),
                "source": source_words([e.source]),
            }
            for e in trial.events.events
        ],
        "strides": _strides(trial, pelvis_parts(trial, truth), masks_of(curves)),
        "measures": [_measured(stride) for stride in trial.strides],
        "line": line_of(trial),
        "relative": relative_to is not None,
        "sections": trial_sections(model, trial),
    }


def _verdict(verdict: TrialVerdict) -> dict[str, str]:
    return {"judgement": verdict.judgement.value, **{side: of.value for side, of in verdict.legs.items()}}


def _strides(trial: TrialResult, rooms: Mapping[str, Array], masks: Sequence[BoolArray]) -> list[dict[str, Any]]:
    """Complete strides of both feet: s from the begin of the trial; `number`, pelvis and, of each mask of the curves,
    valid percents as in `cycles.csv`.
    """
    if trial.joint is not None:
        return []
    start = float(trial.body.time[0])
    measured = {(s.side, s.number): s for s in trial.strides}
    return [
        {
            "side": side,
            "number": number,
            "start": cycle.start - start,
            "stop": cycle.stop - start,
            "off": None if cycle.toe_off is None else cycle.toe_off - start,
            "turns": (own := measured.get((side, number))) is not None and turns(own.turn),
            "pelvis": _pelvis(trial, cycle, own, rooms),
            "valid": [base64_of(usable(trial.body.time, mask, cycle).astype("<u1")) for mask in masks],
        }
        for side in SIDES
        for number, cycle in enumerate(strides_of(trial.events)[side], start=1)
    ]


def _pelvis(
    trial: TrialResult, cycle: GaitCycle, stride: Stride | None, rooms: Mapping[str, Array]
) -> dict[str, dict[str, Any]]:
    """Pelvis angle -> each part of `pelvis_parts` over 0 to 100 %, against the line of this stride."""
    laid = {
        part: normalise(trial.body.time, pelvis_in_stride(trial, angles, cycle, stride), cycle)
        for part, angles in rooms.items()
    }
    return {name: {part: lengths(of[:, k]) for part, of in laid.items()} for k, name in enumerate(PELVIS_ANGLES)}


def _measured(stride: Stride) -> dict[str, Any]:
    """One row of `spatiotemporal.csv`, also of a stride of which the recording shows a part."""
    return {
        "side": stride.side,
        "number": stride.number,
        "turns": turns(stride.turn),
        "values": {name: float(value) for name, value in stride.measures.items()},
    }
