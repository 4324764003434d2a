"""Do calibrated joints lie where the bones have them?

    bones [--folder DIR] [--only NAME,...] [--left-in]
    bones --learn FILE [--folder DIR]
    bones --floor [--folder DIR] [--only NAME,...]

Each recording of skin markers beside tracked bones (`bones/recordings.py`) is calibrated as what it
shows, a walk, an isolated trial or an activity (`bones/fits.py`). Reported are

knee    how far the axis of flexion is from that of the bones where it crosses the middle of the
        thigh's lateral axis (mm), and the angle between both (deg), with standard errors; where the
        bones define their axis to 5 mm (`recordings.hinge_errors`), whose error counts beside ours
flexion RMS of the knee's angle less that of the bones, its mean taken out (deg), and the mean
hip     how far the centre is from the true one in the pelvis (mm)

for the nominal model, for a hinge or centre fitted to the clusters of skin markers (SARA, SCoRE),
for the estimator with markers that stay in their places, and for the estimator as it is. Intervals
of 68 and 95 % are counted over all coordinates of joints in both segments.

The prior of soft tissue is learnt from the bones of GAITCAL_DATA (`bones/learn.py`) with the
person of each recording left out; `--left-in` takes gaitcal's own, which knows them all. `--learn`
writes that prior to a file, and prints what it rests on. `--floor` reports what oracles reach
(`bones/floor.py`).

The axis of the bones is the one that both bones carry most alike: its direction the mean common
one, its point SCoRE's. Left legs are mirrored. The folder is `bones` of `GAITCAL_DATA` unless
given.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.soft_tissue_table import SkinTable
from gaitcal.model.parameters import JP_INDEX
from scripts.validation.bones.fits import (
    DEFINED_M,
    BoneFit,
    NominalJoint,
    fit_recording,
    joint_of,
    nominal_joint,
    parameters_of_axis,
    problem_of,
    tracked_flexion,
)
from scripts.validation.bones.floor import Floor, compute_floors, floor_lines
from scripts.validation.bones.learn import learn_lines, learn_table, person_of, write_table
from scripts.validation.bones.recordings import (
    BoneRecording,
    find_true_hip,
    fit_centre,
    fit_clusters,
    fit_hinge,
    hinge_errors,
    read_recordings,
)
from scripts.validation.harness import coverage, matching, option, rms, say, side_by_side
from scripts.validation.recordings import data
from scripts.validation.truth.people import z_axis

METHODS = ("nominal", "skin alone", "without soft tissue", "calibrated")
SHARED = ("--jobs", "--only", "--list", "--json")
OWN = {
    "--folder": option(Path, "of recordings (default: `bones` of GAITCAL_DATA)"),
    "--left-in": option(
        False, "with gaitcal's own prior of soft tissue, whoever it was learnt from"
    ),
    "--floor": option(
        False, "report what oracles reach: the true soft tissue given, or none (`bones/floor.py`)"
    ),
    "--learn": option(
        Path, "derive the prior of soft tissue from all recordings, and write it to this file"
    ),
}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What was found in one recording."""

    name: str
    person: str
    joint: str
    bent_deg: float
    """Range of the joint's flexion; of a hip, 0."""
    distance_mm: Mapping[str, float] = field(default_factory=dict)
    """Method -> distance from the true axis or centre."""
    angle_deg: Mapping[str, float] = field(default_factory=dict)
    """Method -> angle between the axes."""
    flexion_deg: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Method -> RMS less the mean, and the mean."""
    offset_mm: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Method -> the same by axis: forward, up (and right, of hips) in the segment above."""
    error_mm: float = np.nan
    """Standard error of the distance."""
    error_deg: float = np.nan
    """Standard error of the angle."""
    scores: Mapping[str, float] = field(default_factory=dict)
    """Joint parameter -> error in standard errors, of the calibrated joint."""
    softness: float = np.nan
    """Scale of the soft tissue that the deformation of the markers shows."""
    converged: bool = True


def assess_recording(recording: BoneRecording, table: SkinTable | None) -> Outcome:
    """Calibrate one recording by every method, and compare joints and angles with those of the
    bones.

    `table`: the skin of people; gaitcal's own unless given.
    """
    nominal = nominal_joint(recording)
    problem = problem_of(recording, nominal)
    fits = {
        "without soft tissue": fit_recording(recording, nominal, problem, tissue=False),
        "calibrated": fit_recording(recording, nominal, problem, tissue=True, table=table),
    }
    return (
        _hip_outcome(recording, nominal, fits)
        if nominal.joint == "hip_r"
        else _knee_outcome(recording, nominal, fits)
    )


def _values(nominal: NominalJoint, fits: Mapping[str, BoneFit]) -> dict[str, Array]:
    """Method -> all joint parameters."""
    return {"nominal": nominal.model.nominal.joint} | {
        method: fit.phase.estimate.parameters.joint for method, fit in fits.items()
    }


def _errors(fit: BoneFit) -> dict[str, float]:
    """Joint parameter -> standard error, m or rad."""
    return fit.phase.errors.standard_errors


def _knee_outcome(
    recording: BoneRecording, nominal: NominalJoint, fits: Mapping[str, BoneFit]
) -> Outcome:
    thigh, shank = recording.segments["thigh"], recording.segments["shank"]
    flexion = recording.knee_flexion
    bent = float(np.rad2deg(np.ptp(flexion)))
    angles = {method: tracked_flexion(fit.motion) for method, fit in fits.items()}
    flexion_deg = {}
    for method, values in angles.items():
        gap = np.rad2deg(values - flexion)
        flexion_deg[method] = float(gap.std()), float(gap.mean())
    skin = fit_clusters(recording, "thigh", "shank")
    turn = skin[0].rotation.swapaxes(1, 2) @ skin[1].rotation
    gap = np.rad2deg(-np.arctan2(turn[:, 1, 0], turn[:, 0, 0]) - flexion)
    flexion_deg["skin alone"] = float(gap.std()), float(gap.mean())
    common = partial(
        Outcome,
        name=recording.name,
        person=recording.person,
        joint="knee",
        bent_deg=bent,
        flexion_deg=flexion_deg,
        converged=fits["calibrated"].phase.estimate.converged,
        softness=fits["calibrated"].softness,
    )
    of_truth = hinge_errors(thigh, shank)
    if of_truth[0] > DEFINED_M:
        return common()
    truth = parameters_of_axis(nominal, fit_hinge(thigh, shank))
    found = {
        method: np.array([joint[JP_INDEX[name]] for name in truth])
        for method, joint in _values(nominal, fits).items()
    }
    peer = parameters_of_axis(nominal, fit_hinge(*skin))
    found["skin alone"] = np.array([peer[name] for name in truth])
    names, true = list(truth), np.array(list(truth.values()))
    place = [names.index(f"knee_r.thigh.{d}") for d in ("ant", "sup")]
    turns = [names.index(f"knee_r.thigh.{d}") for d in ("front", "trans")]
    errors = _errors(fits["calibrated"])
    size = np.array([errors.get(name, np.nan) for name in names])
    gaps = {method: (found[method] - true) for method in METHODS}
    known = np.array(
        [of_truth[0] if name.endswith(("ant", "sup")) else of_truth[1] for name in names]
    )
    scores = gaps["calibrated"] / np.hypot(size, known)
    return common(
        distance_mm={m: 1e3 * float(np.linalg.norm(gap[place])) for m, gap in gaps.items()},
        offset_mm={m: tuple((1e3 * gap[place]).tolist()) for m, gap in gaps.items()},
        angle_deg={m: _angle(z_axis(*found[m][turns]), z_axis(*true[turns])) for m in METHODS},
        error_mm=1e3 * float(np.linalg.norm(size[place])),
        error_deg=float(np.rad2deg(np.linalg.norm(size[turns]))),
        scores=dict(zip(names, scores.tolist(), strict=True)),
    )


def _angle(one: Array, other: Array) -> float:
    """Angle between two directions, deg."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def _hip_outcome(
    recording: BoneRecording, nominal: NominalJoint, fits: Mapping[str, BoneFit]
) -> Outcome:
    centres = find_true_hip(recording)
    peers = fit_centre(*fit_clusters(recording, "pelvis", "thigh"))
    errors, values = _errors(fits["calibrated"]), _values(nominal, fits)
    gaps: dict[str, Array] = {}
    scores: dict[str, float] = {}
    size = np.zeros(3)
    for segment, truth, peer in zip(("pelvis", "thigh"), centres, peers, strict=True):
        if truth is None:
            continue
        names = [f"hip_r.{segment}.{d}" for d in ("ant", "sup", "lat")]
        true = nominal.frames[segment].local(truth)
        found = {
            method: np.array([joint[JP_INDEX[name]] for name in names])
            for method, joint in values.items()
        }
        found["skin alone"] = nominal.frames[segment].local(peer)
        of_segment = np.array([errors.get(name, np.nan) for name in names])
        scores |= dict(
            zip(names, ((found["calibrated"] - true) / of_segment).tolist(), strict=True)
        )
        if segment == "pelvis":
            size = of_segment
            gaps = {method: 1e3 * (found[method] - true) for method in METHODS}
    return Outcome(
        name=recording.name,
        person=recording.person,
        joint="hip",
        bent_deg=0.0,
        distance_mm={method: float(np.linalg.norm(gap)) for method, gap in gaps.items()},
        offset_mm={method: tuple(gap.tolist()) for method, gap in gaps.items()},
        error_mm=1e3 * float(np.linalg.norm(size)),
        scores=scores,
        converged=fits["calibrated"].phase.estimate.converged,
        softness=fits["calibrated"].softness,
    )


def outcome_lines(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Tables of all recordings, then RMS and coverage."""
    heads = "".join(f"{m:>22}" for m in METHODS)
    for joint in ("knee", "hip"):
        of_joint = [o for o in outcomes if o.joint == joint and o.distance_mm]
        if not of_joint:
            continue
        what = "axis: mm, deg" if joint == "knee" else "centre: mm"
        yield f"{joint + ' ' + what:26}{heads}{'SE':>14}   calibrated less true"
        for o in of_joint:
            cells = "".join(f"{_cell(o, m):>22}" for m in METHODS)
            se = f"{o.error_mm:.1f}" + (f", {o.error_deg:.1f}" if joint == "knee" else "")
            offset = " ".join(f"{x:6.1f}" for x in o.offset_mm["calibrated"])
            more = f"   s {o.softness:.2f}" + ("" if o.converged else "   NOT CONVERGED")
            yield f"{o.name:26}{cells}{se:>14}   {offset}{more}"
        mean = "".join(f"{_summary(of_joint, m):>22}" for m in METHODS)
        yield f"{'RMS':26}{mean}"
        scores = np.array([z for o in of_joint for z in o.scores.values()])
        yield f"  {coverage(scores)}"
    bent = [o for o in outcomes if o.flexion_deg]
    if bent:
        yield f"{'flexion: RMS (mean), deg':26}{heads}{'bent':>8}"
        for o in bent:
            cells = "".join(f"{_flexion(o, m):>22}" for m in METHODS)
            yield f"{o.name:26}{cells}{o.bent_deg:8.0f}"
    scores = np.array([z for o in outcomes for z in o.scores.values()])
    if len(scores):
        yield f"all joints: {coverage(scores)}"
        worst = max(
            ((abs(z), f"{o.name} {n}") for o in outcomes for n, z in o.scores.items()),
            default=(0.0, ""),
        )
        yield f"largest: {worst[0]:.2f} standard errors, {worst[1]}"


def _cell(outcome: Outcome, method: str) -> str:
    turn = f", {outcome.angle_deg[method]:.1f}" if method in outcome.angle_deg else ""
    return f"{outcome.distance_mm[method]:.1f}{turn}"


def _summary(outcomes: Sequence[Outcome], method: str) -> str:
    turns = [o.angle_deg[method] for o in outcomes if method in o.angle_deg]
    return f"{rms([o.distance_mm[method] for o in outcomes]):.1f}" + (
        f", {rms(turns):.1f}" if turns else ""
    )


def _flexion(outcome: Outcome, method: str) -> str:
    if method not in outcome.flexion_deg:
        return ""
    spread, mean = outcome.flexion_deg[method]
    return f"{spread:.1f} ({mean:+.1f})"


def run(chosen: argparse.Namespace) -> dict[str, Sequence[Outcome | Floor | None]]:
    """Calibrate every recording and print the tables."""
    folder = chosen.folder or data() / "bones"
    recordings = {recording.name: recording for recording in read_recordings(folder)}
    names = matching(chosen.only, recordings)
    if chosen.list:
        say(*(f"{name:26}{joint_of(recordings[name])}" for name in names))
        return {}
    if chosen.learn:
        every = list(recordings.values())
        say(*learn_lines(every))
        write_table(learn_table(every), every, chosen.learn)
        return {}
    if chosen.floor:
        people = list(read_recordings(data() / "bones"))
        floors = compute_floors([recordings[name] for name in names], people, chosen.jobs)
        say(*floor_lines(floors))
        return {"floors": floors}
    known = [] if chosen.left_in else list(read_recordings(data() / "bones"))
    tables: dict[str, SkinTable | None] = {}
    for name in names:
        person = person_of(recordings[name])
        tables[person] = tables.get(person) or (
            learn_table(known, without=person) if known else None
        )
    tasks = [
        partial(assess_recording, recordings[name], tables[person_of(recordings[name])])
        for name in names
    ]
    outcomes = list(side_by_side(tasks, chosen.jobs))
    say(*outcome_lines(outcomes))
    return {"recordings": outcomes}
