"""One body in all trials: each moving trial against the static one, and walks against each other.

What a cause does to a result is judged by what it does to the pose of its segment: a joint centre carried away, a
segment turned. Skin and honest placement differ by 4 to 6 mm and 2 to 4 deg at the joints of clean recordings; from
twice that on the result is wrong by more than its own error bar.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.codes import Code
from gaitcal.faults.body_size import body_scale, rescaled
from gaitcal.faults.cluster import FEWEST, alignment
from gaitcal.faults.contradiction import Contradiction, Fault, contradictions
from gaitcal.faults.direction import mirrored
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.exchanged import undone
from gaitcal.faults.marker_slip import stretches
from gaitcal.faults.trial_body import OFFSET_M
from gaitcal.findings import STUDY, Finding, Severity, listed
from gaitcal.io.recording import Recording
from gaitcal.runtime import remembered

SHIFT_M, TURN_RAD = 0.012, np.deg2rad(7.0)
"""Of a segment's pose at its joints, from which a result is wrong by more than its error bar."""
KNEE_AXIS_RAD = np.deg2rad(30.0)
"""Clean recordings reach 26 deg where the knee bends far, as the skin of the thigh turns, and 14 deg in walking."""
SURE = 1.15
"""Times a limit: below, heavy skin can do as much, and the result is doubtful but not refused."""
FAR_M = 0.025
"""Way of a single marker that no skin goes for a whole trial."""
LARGE = 2.0
"""Times a limit, for a contradiction without a known cause."""
BETWEEN_WALKS = 0.6
"""Factor of the limits of offsets between walks of one session: clean ones differ by 1.5 mm, the pelvis by 2.6."""
SIDES_WORDS = "right and left labels are exchanged"
MIRROR_WORDS = "one axis of the laboratory is mirrored"
SIDE_WORDS = {"r": "right ", "l": "left "}
WAYS = (("forward", "backward"), ("up", "down"), ("to the right", "to the left"))
PART_OF_OFFSET = 0.4
"""A direction is named where it has so much of an offset."""
FEWEST_WALKS = 3
"""Of which one can be the odd one."""


def static_consistency(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Everything in which moving trials contradict the static one or each other, one finding a cause."""
    yield from body_scale(trials)
    sized = [rescaled(t) for t in trials if not t.is_static]
    found: dict[tuple[Fault, str, tuple[str, ...]], list[tuple[TrialEvidence, Contradiction]]] = {}
    told: set[str] = set()
    for trial in sized:
        causes = contradictions_in(trial)
        if causes and (mended := undone(trial)) is not trial:  # exchanges are told by a check of their own
            trial = mended
            causes = contradictions_in(trial)
        if not causes:
            continue
        if (whole := _whole_trial(trial, causes)) is not None:
            yield whole
            told.add(trial.name)
            continue
        for cause in causes:
            if cause.fault is Fault.MARKER and cause.labels[0] in stretches(trial):
                continue  # told with the time at which it left its place
            found.setdefault((cause.fault, cause.segment, cause.labels), []).append((trial, cause))
    for group in found.values():
        yield _of_cause(group, [t for t in sized if t.name not in told])
    concerned = {_side(segment) for _, segment, _ in found}
    yield from _knee_axes([t for t in sized if t.name not in told], concerned)
    yield from _between_walks(
        [t for t in sized if t.is_gait and t.name not in told], {segment for _, segment, _ in found}
    )


@remembered
def contradictions_in(trial: TrialEvidence) -> tuple[Contradiction, ...]:
    """Everything in which a moving trial contradicts the static one."""
    return contradictions(trial.clusters, trial.links)


def _of_cause(group: list[tuple[TrialEvidence, Contradiction]], moving: Sequence[TrialEvidence]) -> Finding:
    """One cause, and the trials that show it."""
    trial, worst = max(group, key=lambda pair: pair[1].excess)
    names = list(dict.fromkeys(t.name for t, _ in group))
    everywhere = len(names) > 1
    when = f"throughout {listed(names)}" if everywhere else _seconds(trial)
    return Finding(
        severity=_severity(worst),
        topic="one body",
        where=STUDY if everywhere else trial.name,
        source="" if everywhere else trial.source,
        cause=_cause(worst, "the static trial"),
        found=f"{_evidence(worst)} ({when})",
        cure=_cure(worst, everywhere and len(names) == len(moving)),
        leg=_side(worst.segment),
        weight=worst.excess,
        code=_CODES[worst.fault],
    )


_CODES = {
    Fault.MARKER: Code.MARKER_OFF_STATIC,
    Fault.LABELS: Code.EXCHANGED_LABELS,
    Fault.MIRRORED: Code.CLUSTER_MIRRORED,
    Fault.CLUSTER: Code.CLUSTER_SLID,
    Fault.UNKNOWN: Code.SEGMENTS_APART,
}


def _severity(cause: Contradiction) -> Severity:
    if cause.fault in (Fault.LABELS, Fault.MIRRORED):
        return Severity.ERROR
    if cause.fault is Fault.UNKNOWN:
        return Severity.ERROR if cause.excess > LARGE else Severity.WARNING
    sure = cause.excess > SURE or (cause.fault is Fault.MARKER and cause.offset > FAR_M)
    return Severity.ERROR if sure and (cause.shift > SHIFT_M or cause.turn > TURN_RAD) else Severity.WARNING


def _cause(cause: Contradiction, against: str) -> str:
    place = _part(cause.segment)
    if cause.fault is Fault.MARKER:
        which = " or ".join(repr(label) for label in (cause.labels[0], *cause.rivals))
        return f"marker {which} is not where {against} has it on the {place}"
    if cause.fault is Fault.LABELS:
        return (
            f"'{cause.labels[0]}' and '{cause.labels[1]}' on the {place} carry each other's label, or did in {against}"
        )
    if cause.fault is Fault.MIRRORED:
        return f"the markers of the {place} are mirrored against {against}"
    if cause.fault is Fault.CLUSTER:
        return f"the markers of the {place} slid or turned together on the segment since {against}"
    return f"the segments at the {place} do not meet as in {against}"


def _evidence(cause: Contradiction) -> str:
    mm, deg = 1e3 * cause.offset, np.rad2deg(cause.turn)
    pose = "the pose of the segment is off by "
    pose += f"{1e3 * cause.shift:.0f} mm at its joints and by {deg:.0f} deg" if cause.shift else f"{deg:.0f} deg"
    if cause.fault is Fault.MARKER:
        return f"{mm:.0f} mm off{_ways(cause)}; {pose}"
    if cause.fault is Fault.CLUSTER:
        seen = f"{mm:.0f} mm{_ways(cause)} and {deg:.0f} deg, seen at {listed([_part(j) for j in cause.seen_at])}"
        names = listed([repr(label) for label in cause.labels])
        return f"{seen}; one of {names} out of their plane would look alike" if len(cause.labels) <= FEWEST else seen
    if cause.fault is Fault.UNKNOWN:
        return f"joint centres {mm:.0f} mm apart, turned by {deg:.0f} deg"
    if cause.fault is Fault.MIRRORED:
        return f"their handedness differs; offsets of up to {mm:.0f} mm of {listed([repr(m) for m in cause.labels])}"
    return f"exchanging them explains offsets of up to {mm:.0f} mm"


def _cure(cause: Contradiction, static_doubted: bool) -> str:
    other = (
        "another static trial (all moving trials agree against this one)" if static_doubted else "another static trial"
    )
    if cause.fault is Fault.MARKER and cause.rivals:
        return f"{other}; neither can be left out, as one alone does not tell how the segment lies"
    if cause.fault is Fault.MARKER:
        return f'weights = {{ "{cause.labels[0]}" = 0 }} under [markers] leaves it out; or {other}'
    if cause.fault is Fault.LABELS:
        return "exchange the two labels in the file that is wrong"
    if cause.fault is Fault.MIRRORED:
        return f"label this cluster again in the trial or in the static one; or {other}"
    if cause.fault is Fault.CLUSTER:
        return f"{other}, recorded with the markers as they sit in the trial; or label the segment again"
    return f"look at the labels of both segments and at the static trial; or {other}"


def _ways(cause: Contradiction) -> str:
    """The directions of an offset in words."""
    size = float(np.linalg.norm(cause.direction))
    words = [
        f"{1e3 * abs(value):.0f} mm {ways[0] if value > 0 else ways[1]}"
        for value, ways in zip(cause.direction, WAYS, strict=True)
        if abs(value) > PART_OF_OFFSET * size
    ]
    return f" ({', '.join(words)})" if words else ""


def _side(segment: str) -> str:
    return segment[-1] if segment.endswith(("_r", "_l")) else ""


def _part(name: str) -> str:
    """`thigh_r` as `right thigh`."""
    return f"{SIDE_WORDS[name[-1]]}{name[:-2]}" if _side(name) else name


def _seconds(trial: TrialEvidence) -> str:
    time = trial.recording.time
    return f"the whole trial, {time[0]:.2f}-{time[-1]:.2f} s"


def _whole_trial(trial: TrialEvidence, causes: Sequence[Contradiction]) -> Finding | None:
    """The exchange of all right and left labels, or a mirrored axis, where it explains everything."""
    if len(causes) < 2 and causes[0].fault is not Fault.UNKNOWN:
        return None
    most = max(1e3 * c.offset for c in causes)
    seen = f"explains contradictions at {listed([_part(c.segment) for c in causes])} of up to {most:.0f} mm"
    found = []
    for change, words in ((sides_exchanged, SIDES_WORDS), (axis_mirrored, MIRROR_WORDS)):
        changed = replace(trial, trial=replace(trial.trial, recording=change(trial.recording)))
        if changed.clusters and not contradictions_in(changed):
            found.append(words)
    if not found:
        return None
    return trial.error(
        "one body",
        f"undoing it {seen} ({_seconds(trial)})",
        "exchange right and left in the labels of the file, or export it again with right-handed axes",
        cause=f"{', or '.join(found)}, in this trial or in the static one",
        weight=max(c.excess for c in causes),
        code=Code.SIDES_EXCHANGED,
    )


def sides_exchanged(recording: Recording) -> Recording:
    """The recording with every label that names a side given to its namesake."""
    labels = list(recording.labels)
    other = {a: b for a in labels for b in labels if mirrored(a, b) or mirrored(b, a)}
    return replace(recording, labels=tuple(other.get(label, label) for label in labels))


def axis_mirrored(recording: Recording) -> Recording:
    """The recording in a mirror."""
    return replace(recording, markers=recording.markers * [1.0, 1.0, -1.0])


def _knee_axes(trials: Sequence[TrialEvidence], told: set[str]) -> Iterator[Finding]:
    """Knees that bend about another line than through their epicondyles, on legs of which nothing else was said."""
    for side in {"r", "l"} - told:
        turns = {t.name: t.links[knee].axis_turn for t in trials if (knee := f"knee_{side}") in t.links}
        odd = {name: np.rad2deg(turn) for name, turn in turns.items() if turn is not None and abs(turn) > KNEE_AXIS_RAD}
        if odd:
            worst = max(abs(v) for v in odd.values())
            yield Finding(
                severity=Severity.WARNING,
                topic="one body",
                where=next(iter(odd)) if len(odd) == 1 else STUDY,
                cause=f"the {SIDE_WORDS[side]}knee bends about another line than through its epicondyles",
                found=", ".join(f"{v:+.0f} deg, seen from above, in {name}" for name, v in odd.items())
                + f"; allowed: {np.rad2deg(KNEE_AXIS_RAD):.0f}",
                cure="look at the medial and lateral knee markers of the static trial; or another static trial",
                leg=side,
                weight=worst / float(np.rad2deg(KNEE_AXIS_RAD)),
                code=Code.KNEE_BENDS_ELSEWHERE,
            )


def _between_walks(walks: Sequence[TrialEvidence], told: set[str]) -> Iterator[Finding]:
    """The walk of a session in which a cluster has another shape than in the rest; not of segments `told`."""
    if len(walks) < FEWEST_WALKS:
        return
    for trial in walks:
        for segment, cluster in trial.clusters.items():
            same = [c for t in walks if (c := t.clusters.get(segment)) is not None and c.labels == cluster.labels]
            if len(same) < FEWEST_WALKS or segment in told:
                continue
            usual = np.median([c.shape for c in same], axis=0)
            turn, shift = alignment(cluster.shape, usual)
            away = np.linalg.norm(cluster.shape @ turn.T + shift - usual, axis=1)
            limit = BETWEEN_WALKS * np.hypot(cluster.size * OFFSET_M[cluster.part], cluster.scatter)
            if (worst := float((away / limit).max())) <= 1.0:
                continue
            names = [f"'{cluster.labels[k]}' {1e3 * away[k]:.0f} mm" for k in np.argsort(-away)]
            yield trial.warning(
                "one body",
                f"{listed(names, 3)} ({_seconds(trial)})",
                f'weights = {{ "{cluster.labels[int(away.argmax())]}" = 0 }} under [markers], or leave the trial out',
                cause=f"the markers of the {_part(segment)} sit otherwise than in the other {len(walks) - 1} walks",
                leg=_side(segment),
                weight=worst,
                code=Code.ODD_WALK,
            )
