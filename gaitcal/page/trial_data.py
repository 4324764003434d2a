"""One trial of the page beside its body in motion: curves, events, strides, verdict, sections.

Everything is as in the files of a result: angles in degrees, internal moments in N·m with OpenSim's signs, powers in W,
forces in N. The page brings them into the convention that its reader chooses.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PureWindowsPath
from typing import Any, Final

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_reactions import unseen_frames
from gaitcal.dynamics.joint_kinetics import power_of
from gaitcal.faults.verdict import WalkVerdict
from gaitcal.gait.cycles import WALKING, GaitCycle, Kind, normalise, source_words, usable
from gaitcal.gait.moments import moment_names, moment_of, own_error_of, role_words
from gaitcal.gait.peaks import phase_peaks, stride_peaks
from gaitcal.gait.spatiotemporal import counting
from gaitcal.gait.strides import along_line, pelvis_angles, strides_of
from gaitcal.model.coordinates import COORDINATE_TABLE, FOOT_PROGRESSION, GROUPS, SEGMENT_ANGLES, split_side
from gaitcal.model.linkage import PELVIS_ANGLES, SIDES, is_translation
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import MarkerErrors, Motion
from gaitcal.page.plain_data import Sections, base64_of, floats, lengths, rounded
from gaitcal.page.scene import MOST_FRAMES
from gaitcal.page.summary import gait_numbers, stride_uses, trial_clinician_blocks
from gaitcal.page.trust import trial_fit_blocks, trial_trust_blocks
from gaitcal.session.result import Loads, TrialResult, angle_counts
from gaitcal.session.tables import foot_in_stride, pelvis_in_stride, taken_off, told_powers
from gaitcal.session.truth_errors import CurveTruth, CurveTruths

GROUND: Final = {"ground_reaction_vertical": 1, "ground_reaction_forward": 0, "ground_reaction_sideways": 2}
"""Force of the ground on a foot -> its laboratory axis: y up, x forward, z to the right."""


@dataclass(frozen=True)
class Curve:
    """One variable of one trial."""

    base: str  # Coordinate without its side, joint of a power, or what a force is called
    side: str  # `r`, `l`; empty of what belongs to no leg
    kind: str  # `angle`, `moment`, `power`, `force`, `residual_force`, `residual_moment`, `marker_error`
    unit: str  # `deg`, `N m`, `W`, `N`, `mm`
    value: Array  # (nf,)
    valid: BoolArray  # (nf,) frames in which it counts
    error: Array | None = None  # (nf,) standard error
    own: Array | None = None  # (nf,) the part of it that differs from stride to stride
    nominal: Array | None = None  # (nf,) with the nominal model
    truth: Array | None = None  # (nf,) where it is known


def curves_of(
    model: SubjectModel, trial: TrialResult, relative_to: Mapping[str, float] | None, truth: CurveTruths | None
) -> tuple[Curve, ...]:
    """All curves of a trial.

    `relative_to`: coordinate -> rad in the static posture, from which joint angles are counted; None: from zero.
    `truth`: None where it is not known.
    """
    curves = [*_angles(model, trial, relative_to, truth), *_feet(trial), _marker_error(trial)]
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

    of_curves = [
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
    return {"curves": of_curves, "masks": [base64_of(mask[kept].astype("<u1")) for mask in masks]}


def joint_of(base: str) -> str:
    """The joint of the page that a coordinate, or a power of a joint, belongs to; empty where none."""
    if row := COORDINATE_TABLE.get(base) or SEGMENT_ANGLES.get(base):
        return row.group
    return next((key for key, group in GROUPS.items() if group.power == base), "")


def masks_of(curves: tuple[Curve, ...]) -> list[BoolArray]:
    """The different `valid` of the curves, in the order of `masks` of `packed_curves`."""
    return list({c.valid.tobytes(): c.valid for c in curves}.values())


def _angles(
    model: SubjectModel, trial: TrialResult, relative_to: Mapping[str, float] | None, truth: CurveTruths | None
) -> Iterator[Curve]:
    """Joint angles; those of the pelvis against the trial's line of progression."""
    body, unseen, static, whole = trial.body, unseen_frames(trial.body), taken_off(relative_to), _whole(trial)
    known: Mapping[str, CurveTruth] = {} if truth is None else truth.coordinates
    everywhere, line = np.ones(len(body.time), dtype=bool), line_of(trial)
    pelvis = {
        part: np.degrees(along_line(angles, line, everywhere)) for part, angles in pelvis_parts(trial, truth).items()
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
            values = {part: pelvis[part][:, PELVIS_ANGLES.index(name)] if part in pelvis else None for part in values}
        yield Curve(
            *split_side(name), "angle", "deg", valid=angle_counts(trial, name, unseen), error=error, own=own, **values
        )


def _feet(trial: TrialResult) -> Iterator[Curve]:
    """Foot progression against the trial's line; each stride has its own (`_strides`)."""
    feet, line, unseen = trial.foot_axes, line_of(trial), unseen_frames(trial.body)
    if feet is None:
        return
    for k, side in enumerate(SIDES):
        error, own = (None if e is None else np.degrees(e[:, k]) for e in (feet.error, feet.own))
        valid = angle_counts(trial, f"subtalar_angle_{side}", unseen)
        value = np.degrees(feet.progression(side, line))
        yield Curve(FOOT_PROGRESSION, side, "angle", "deg", value, valid, error=error, own=own)


def line_of(trial: TrialResult) -> float:
    """Rad to the left of the room's x axis: where the walk goes on the mean; 0 where its strides do not tell."""
    lines = [stride.line for stride in trial.strides if stride.line is not None]
    return float(np.angle(np.mean(np.exp(1j * np.array(lines))))) if lines else 0.0


def pelvis_parts(trial: TrialResult, truth: CurveTruths | None) -> dict[str, Array]:
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


def _moments(model: SubjectModel, loads: Loads, truth: CurveTruths | None) -> Iterator[Curve]:
    known: Mapping[str, CurveTruth] = {} if truth is None else truth.forces
    for name in moment_names(model):
        yield Curve(
            *split_side(name),
            "moment",
            "N m",
            value=moment_of(loads.final, name),
            valid=loads.reactions.valid_for(name),
            error=None if loads.errors is None else moment_of(loads.errors, name),
            own=None if loads.errors is None else own_error_of(loads.errors, name),
            nominal=moment_of(loads.nominal, name),
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
            own=None if errors is None or errors.own is None else power_of(errors.own, name),
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
    return np.asarray(1e3 * np.sqrt(np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0)))


def trial_page_data(
    model: SubjectModel,
    trial: TrialResult,
    *,
    verdict: WalkVerdict | None,
    relative_to: Mapping[str, float] | None = None,
    truth: CurveTruths | None = None,
) -> dict[str, Any]:
    """What the page tells of a trial; numbers packed as in `plain_data.py`.

    `verdict`: None of a trial that is not judged by itself.
    `relative_to`, `truth`: as of `curves_of`.
    """
    time, start = trial.body.time, float(trial.body.time[0])
    every = max(1, -(-len(time) // MOST_FRAMES))
    curves = curves_of(model, trial, relative_to, truth)
    return {
        "name": trial.name,
        "file": PureWindowsPath(trial.recording.source).name,
        "role": role_words(trial.role, trial.joint),
        "joint": trial.joint,
        "activity": trial.activity,
        "repeats": bool(trial.events.repeats),
        "verdict": None
        if verdict is None
        else {"judgement": verdict.judgement.value, **{side: of.value for side, of in verdict.legs.items()}},
        "start": start,
        "duration": float(time[-1] - time[0]),
        "frames": len(time),
        "every": every,
        "time": floats((time - time[0])[::every]),
        **packed_curves(curves, every),
        "events": [
            {"side": e.side, "kind": e.moment.value, "time": e.time - start, "source": source_words([e.source])}
            for e in trial.events.events
        ],
        "strides": _strides(trial, pelvis_parts(trial, truth), curves),
        "measures": [  # what counts, also of a stride of which the recording shows a part
            {"side": stride.side, "number": stride.number, "values": {n: float(v) for n, v in stride.measures.items()}}
            for stride in counting(trial.strides, trial.refused_legs)
        ],
        "line": line_of(trial),
        "relative": relative_to is not None,
        "sections": trial_sections(model, trial),
    }


def trial_sections(model: SubjectModel, trial: TrialResult) -> Sections:
    """Of one trial, calibrated or further; presets to which it has nothing to say are left out."""
    sections = {"fit": trial_fit_blocks(trial)}
    if (walk := gait_numbers(model, trial)) is not None:
        sections |= {"clinician": trial_clinician_blocks(walk), "trust": trial_trust_blocks(model, walk)}
    return {preset: blocks for preset, blocks in sections.items() if blocks}


def _strides(trial: TrialResult, pelvis: Mapping[str, Array], curves: tuple[Curve, ...]) -> list[dict[str, Any]]:
    """Complete strides of both feet: s from the begin of the trial; `number`, pelvis, of each mask of the curves valid
    percents as in `cycles.csv`, and peaks. `pelvis`: parts of `pelvis_parts`, over each stride against its own line.
    """
    if trial.joint is not None:
        return []
    time, start = trial.body.time, float(trial.body.time[0])
    measured = {(s.side, s.number): s for s in trial.strides}
    uses = {(use.side, use.number): use for use in stride_uses(trial)}
    out = []
    for side in SIDES:
        for number, cycle in enumerate(strides_of(trial.events)[side], start=1):
            stride, use = measured.get((side, number)), uses[side, number]
            foot = foot_in_stride(trial, side, cycle, stride)
            laid = {
                part: normalise(time, pelvis_in_stride(trial, angles, cycle, stride), cycle)
                for part, angles in pelvis.items()
            }
            out.append(
                {
                    "side": side,
                    "number": number,
                    "start": cycle.start - start,
                    "stop": cycle.stop - start,
                    "off": None if cycle.toe_off is None else cycle.toe_off - start,
                    "turns": use.turns,
                    "plate": use.plate,
                    "reason": use.reason,
                    "pelvis": {
                        name: {part: lengths(angles[:, k]) for part, angles in laid.items()}
                        for k, name in enumerate(PELVIS_ANGLES)
                    }
                    | ({} if foot is None else {FOOT_PROGRESSION: {"value": lengths(normalise(time, foot, cycle))}}),
                    "valid": [base64_of(usable(time, mask, cycle).astype("<u1")) for mask in masks_of(curves)],
                    "peaks": peaks_in(
                        time,
                        cycle,
                        [c for c in curves if c.side in (side, "")],
                        laid["value"],
                        walks=trial.activity == WALKING,
                    ),
                }
            )
    return out


def peaks_in(
    time: Array, cycle: GaitCycle, curves: Sequence[Curve], pelvis: Array, *, walks: bool = True
) -> dict[str, list[float | None]]:
    """Peak -> what `gait/peaks.py` says of it, None for NaN. `pelvis`: (101, 3) deg, `PELVIS_ANGLES`."""
    endings, unknown = {kind.words: kind.ending for kind in Kind}, np.full(len(time), np.nan)
    laid = {}
    for curve in curves:
        parts = [unknown if part is None else part for part in (curve.value, curve.error, curve.own)]
        value, error, own = normalise(time, np.stack(parts, axis=1), cycle).T
        value = pelvis[:, PELVIS_ANGLES.index(curve.base)] if curve.base in PELVIS_ANGLES else value
        name = curve.base if curve.kind == "force" else f"{curve.base}{endings.get(curve.kind, curve.kind)}"
        laid[name] = (np.where(usable(time, curve.valid, cycle), value, np.nan), error, own)
    found = stride_peaks(laid, cycle.stance) if walks else phase_peaks(laid, cycle.phases)
    return {name: [rounded(v) for v in values] for name, values in found.items()}
