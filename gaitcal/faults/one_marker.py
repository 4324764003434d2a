"""Segments of the legs that one marker follows: no rigid body, but the joints beside it may tell how it turns.

Whether they do is asked of the trial: pelvis and legs are tracked with the nominal model, and with H_f the Gauss-Newton
matrix of frame f the angles that markers with errors of NOISE_M leave are uncertain by

    s_f^2 = diag( (H_f / NOISE_M^2 + 1 / WIDEST^2)^-1 ).

Without the second marker of both thighs, both shanks, or all four (9 Plug-in Gait walks of 5 people) hip, knee and
ankle came out within 5 deg RMS of those with all markers, s being 6 to 12 deg; without the toes, s was 29 to 55 deg
and angles were wrong by up to 31. With one marker on each of the three, s is no guide: a leg has two postures then.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import GaitcalError
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.markers import LONG_S, unknown_labels
from gaitcal.findings import Finding, listed
from gaitcal.io.intervals import duration, runs, spans
from gaitcal.io.labels import is_unlabelled
from gaitcal.model.linkage import LEG_SEGMENTS, LOWER_BODY, SIDES, joint_segments
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.spline import NodeRule
from gaitcal.motion.trial_problem import trial_problem

TOPIC = "one marker"
TWO = 2
"""Markers that follow a segment, at least, where the joints beside it say the rest."""
MOST = 0.5
"""Share of the frames in which a segment must show two to be called followed."""
NOISE_M = 0.005
"""Of a marker on skin, each component."""
WIDEST = 1.0
"""rad, m: how far a coordinate that nothing tells may be off."""
TOLD_RAD = np.deg2rad(12.0)
"""Uncertainty from which an angle is not determined, in a tenth of the frames."""
WORST_SHARE = 0.9
KEEPS_M, BESIDE_JOINT_M, MOVES_M = 0.010, 0.015, 0.030
"""Standard deviation of the distance from a marker of the same segment, at most, and from one near its upper joint; and
from others, at least: in a trial in which nothing moves every distance is kept."""
TOGETHER = 20
"""Frames in which two markers must be seen together for that."""


def followed(trial: TrialEvidence) -> Iterator[Finding]:
    """Segments of the legs that show fewer than two markers: in most frames, or for a while."""
    if trial.is_static or trial.model is None:
        return
    counts = _counts(trial)
    single = [s for s, count in counts.items() if count.any() and np.mean(count >= TWO) < MOST]
    for segment, count in counts.items():
        lasting = [run for run in runs(count < TWO) if duration(trial.recording.time, run) > LONG_S]
        if segment not in single and count.any() and lasting:
            when = spans(trial.recording.time, lasting)
            yield trial.info(
                TOPIC, f"{segment} shows fewer than two markers with weight in {when}", code=Code.ONE_MARKER_SEGMENT
            )
    if not single:
        return
    unsure = _undetermined(trial, trial.model) if trial.is_gait else {}
    for segment in single:
        yield _finding(trial, segment, counts, [s for s in single if s[-1] == segment[-1]], unsure)


def _finding(
    trial: TrialEvidence, segment: str, counts: dict[str, Array], together: list[str], unsure: dict[str, float] | None
) -> Finding:
    side = segment[-1]
    seen = listed([f"'{m}'" for m in trial.weighed(segment)])
    share = 100 * np.mean(counts[segment] >= TWO)
    found = f"{segment} shows two markers with weight in {share:.0f} % of the frames ({seen})"
    along = listed([f"'{label}'" for label in moving_along(trial, segment)])
    cure = (
        f"{along} of the file moves with it: add it to this segment in the marker set, or rename it"
        if along
        else "label its other markers, here and in the static trial, or add them to this segment in the marker set"
    )
    cause = f"one marker alone follows {segment}"
    if unsure is None or len(together) == len(LEG_SEGMENTS) // 2:
        found += "; what the joints beside it leave open has no one answer"
        return trial.error(TOPIC, found, cure, cause=cause, leg=side, code=Code.ONE_MARKER_SEGMENT)
    open_angles = {name: s for name, s in unsure.items() if name.endswith(f"_{side}") and s > TOLD_RAD}
    if open_angles:
        named = listed([f"{name} ({np.rad2deg(s):.0f} deg)" for name, s in open_angles.items()])
        found += f"; markers {1e3 * NOISE_M:.0f} mm off leave {named} undetermined"
        return trial.error(TOPIC, found, cure, cause=cause, leg=side, code=Code.ONE_MARKER_SEGMENT)
    worst = max((s for name, s in unsure.items() if name.endswith(f"_{side}")), default=0.0)
    found += "; the joints beside it tell how it turns"
    found += f", to {np.rad2deg(worst):.0f} deg where markers are {1e3 * NOISE_M:.0f} mm off" if worst else ""
    return trial.warning(TOPIC, found, cure, cause=cause, leg=side, weight=3.0, code=Code.ONE_MARKER_SEGMENT)


def _counts(trial: TrialEvidence) -> dict[str, Array]:
    """Segment -> (nf,) markers with weight that are seen, of the segments of the legs whose turns the trial is to show;
    what carries an isolated joint needs three markers.
    """
    joint = trial.trial.joint
    judged = LEG_SEGMENTS if joint is None else tuple(s for s in joint_segments(joint)[1:] if s in LEG_SEGMENTS)
    return {s: trial.seen[:, [trial.place[m] for m in trial.weighed(s)]].sum(axis=1) for s in judged}


def _undetermined(trial: TrialEvidence, model: SubjectModel) -> dict[str, float] | None:
    """Angle of a leg -> rad, how uncertain it is in the worst tenth of the frames; None where tracking fails."""
    nominal = model.nominal
    try:
        problem = trial_problem(trial.name, model, trial.recording, NodeRule(), root="pelvis", segments=LOWER_BODY)
        motion = tracked_motion(problem, nominal)
    except (GaitcalError, np.linalg.LinAlgError):
        return None
    if not motion.converged:
        return None
    hessian = problem.frame_hessians(motion.q, problem.constants(nominal))
    inverse = np.linalg.inv(hessian / NOISE_M**2 + np.eye(hessian.shape[1]) / WIDEST**2)
    deviation = np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))
    frames = slice(None) if trial.pelvis is None else trial.pelvis.determined
    worst = np.quantile(deviation[frames], WORST_SHARE, axis=0)
    names = zip(problem.chain.coordinates, worst, strict=True)
    return {name: float(s) for name, s in names if name[-2:] in ("_r", "_l")}


def moving_along(trial: TrialEvidence, segment: str) -> list[str]:
    """Labels unknown to the set whose distance from the markers of a leg's segment stays the same.

    A shank or a foot must keep its distance from the lateral marker of the joint above, too: near that joint's axis a
    marker keeps its distance from both segments.
    """
    part, _, side = segment.partition("_")
    below = {"thigh": f"shank_{side}", "shank": f"foot_{side}"}.get(part)
    return [
        label
        for label in unknown_labels(trial)
        if not is_unlabelled(label)
        and _keeps(trial, label, segment)
        and not (below and trial.weighed(below) and _keeps(trial, label, below))
    ]


def _keeps(trial: TrialEvidence, label: str, segment: str) -> bool:
    part, _, side = segment.partition("_")
    above = {"shank": f"knee_lat_{side}", "foot": f"ankle_lat_{side}"}.get(part, "")
    own = {m: BESIDE_JOINT_M for m in trial.marker_set.landmarks.get(above, ()) if m in trial.place}
    own |= dict.fromkeys(trial.weighed(segment), KEEPS_M)
    spread = [(_spread(trial, label, other), most) for other, most in own.items()]
    others = [_spread(trial, label, m) for s in SIDES for m in trial.weighed(f"foot_{s}") + trial.weighed(f"thigh_{s}")]
    moved = max((s for s in others if s is not None), default=0.0)
    return bool(spread) and all(s is not None and s < most for s, most in spread) and moved > MOVES_M


def _spread(trial: TrialEvidence, one: str, other: str) -> float | None:
    """m, standard deviation of the distance of two markers; None where they are hardly seen together."""
    away = np.linalg.norm(trial.path(one) - trial.path(other), axis=1)
    away = away[np.isfinite(away)]
    return float(np.std(away)) if len(away) >= TOGETHER else None
