"""One body in all trials: unit and scale, each moving trial against the static one, walks against
each other.

What a cause does to a result is judged by what it does to the pose of its segment: a joint centre
carried away, a segment turned. Skin and honest placement differ by 4 to 6 mm and 2 to 4 deg at the
joints of clean recordings; from twice that on the result is wrong by more than its own error bar.
Skin and gaps change the size of one cluster by some per cent; the median of seven says more than
any of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.errors import STUDY, Code, Finding, Severity, listed
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import SIDE_WORDS
from gaitcal.preprocess.marker_clusters import FEWEST, align_points
from gaitcal.preprocess.static_disagreement import OFFSET_M, Contradiction, Fault
from gaitcal.preprocess.trial_evidence import BODY_SIZE, TrialEvidence, get_side
from gaitcal.quality import knee_axes, label_checks

POSE_TRANSLATION_M, POSE_ROTATION_RAD = 0.012, np.deg2rad(7.0)
"""Of a segment's pose at its joints, from which a result is wrong by more than its error bar."""
REFUSED_TIMES_LIMIT = 1.15
"""Times a limit: below, heavy skin can do as much, and the result is doubtful but not refused."""
BEYOND_SKIN_M = 0.025  # Way of a single marker that no skin goes for a whole trial
REFUSED_EXCESS = 2.0  # Times a limit, for a contradiction without a known cause
BETWEEN_WALKS = 0.6
"""Factor of the limits of offsets between walks of one session: clean ones differ by 1.5 mm, the
pelvis by 2.6.
"""
DIRECTIONS = (("forward", "backward"), ("up", "down"), ("to the right", "to the left"))
PART_OF_OFFSET = 0.4  # A direction is named where it has so much of an offset
FEWEST_WALKS = 3  # Of which one can be the odd one
CODES = {
    Fault.MARKER: Code.MARKER_OFF_STATIC,
    Fault.LABELS: Code.EXCHANGED_LABELS,
    Fault.MIRRORED: Code.CLUSTER_MIRRORED,
    Fault.CLUSTER: Code.CLUSTER_SLID,
    Fault.UNKNOWN: Code.SEGMENTS_APART,
}
SCALE = (0.983, 1.011)
"""Median size of the clusters of a trial against the static trial: those of 20 people, all their
clean trials together, lie between 0.985 and 1.002."""
FEWEST_CLUSTERS = 6
MOST_MARGIN = 0.006
"""By which the scatter of the clusters' sizes about their median widens the limits, at most: two
standard errors of it. Halves of a clean walk with Plug-in Gait markers, two to four a segment, have
a median of 0.980."""
CERTAIN = (
    0.012  # Beyond these limits by so much it is another body or another calibration of the cameras
)
LENGTHS_SCALE = (0.8, 1.25)
"""Lengths within segments against those of the static trial: outside, unit or camera calibration
must be wrong.
"""
SCALE_DOUBTED = 0.04  # Departure of the same ratio from one that skin movement does not explain
SHORTEST_M = 0.03  # Markers nearer to each other do not tell a scale
UNITS = {"millimetres": 1e3, "centimetres": 1e2, "inches": 39.4}


def check_static_consistency(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Everything in which moving trials contradict the static one or each other, one finding a
    cause.
    """
    yield from check_body_scale(trials)
    sized = [rescale_trial(t) for t in trials if not t.is_static]
    found: dict[tuple[Fault, str, tuple[str, ...]], list[tuple[TrialEvidence, Contradiction]]] = {}
    spoilt: set[str] = set()
    for trial in sized:
        causes = trial.contradictions
        if causes and (whole := _explain_whole_trial(trial, causes)) is not None:
            yield whole
            spoilt.add(trial.name)
            continue
        for cause in causes:
            if not (
                cause.fault is Fault.MARKER and cause.labels[0] in trial.displaced
            ):  # told with its time
                found.setdefault((cause.fault, cause.segment, cause.labels), []).append(
                    (trial, cause)
                )
    sound = [t for t in sized if t.name not in spoilt]
    for group in found.values():
        yield _report_contradiction(group, len(sound))
    yield from knee_axes.check_knee_axes(sound, {get_side(segment) for _, segment, _ in found})
    yield from _check_between_walks(
        [t for t in sound if t.is_gait], {segment for _, segment, _ in found}
    )


def _report_contradiction(group: list[tuple[TrialEvidence, Contradiction]], moving: int) -> Finding:
    """One cause, and the trials that show it, of so many moving ones."""
    trial, worst = max(group, key=lambda pair: pair[1].excess)
    names = list(dict.fromkeys(t.name for t, _ in group))
    several = len(names) > 1
    other = "another static trial"
    if several and len(names) == moving:
        other += " (all moving trials agree against this one)"
    cause, found, cure = _describe(worst, other)
    return Finding(
        severity=_judge_severity(worst),
        topic="one body",
        where=STUDY if several else trial.name,
        source="" if several else trial.source,
        cause=cause,
        found=f"{found} ({f'throughout {listed(names)}' if several else _format_whole_time(trial)})",
        cure=cure,
        leg=get_side(worst.segment),
        weight=worst.excess,
        code=CODES[worst.fault],
    )


def _judge_severity(cause: Contradiction) -> Severity:
    if cause.fault in (Fault.LABELS, Fault.MIRRORED):
        refused = True
    elif cause.fault is Fault.UNKNOWN:
        refused = cause.excess > REFUSED_EXCESS
    else:
        # a way that only the joints tell, none of which is beyond its limit, is no measured one
        far = cause.fault is Fault.MARKER and cause.offset > BEYOND_SKIN_M and cause.excess > 1.0
        sure = cause.excess > REFUSED_TIMES_LIMIT or far
        refused = sure and (cause.shift > POSE_TRANSLATION_M or cause.rotation > POSE_ROTATION_RAD)
    return Severity.ERROR if refused else Severity.WARNING


def _describe(cause: Contradiction, other: str) -> tuple[str, str, str]:
    """What is wrong, the evidence, and what to do; `other`: another static trial."""
    place, labels = _name_segment(cause.segment), [repr(label) for label in cause.labels]
    mm, deg = 1e3 * cause.offset, np.rad2deg(cause.rotation)
    if cause.fault is Fault.MARKER:
        which = " or ".join([labels[0], *map(repr, cause.rivals)])
        pose = (
            f"{1e3 * cause.shift:.0f} mm at its joints and by {deg:.0f} deg"
            if cause.shift
            else f"{deg:.0f} deg"
        )
        cure = f'weights = {{ "{cause.labels[0]}" = 0 }} under [markers] leaves it out; or {other}'
        if cause.rivals:
            cure = (
                f"{other}; neither can be left out, as one alone does not tell how the segment lies"
            )
        return (
            f"marker {which} is not where the static trial has it on the {place}",
            f"{mm:.0f} mm off{_describe_direction(cause)}; the pose of the segment is off by {pose}",
            cure,
        )
    if cause.fault is Fault.LABELS:
        return (
            f"{labels[0]} and {labels[1]} on the {place} carry each other's label, or did in the "
            "static trial",
            f"exchanging them explains offsets of up to {mm:.0f} mm",
            "exchange the two labels in the file that is wrong",
        )
    if cause.fault is Fault.MIRRORED:
        return (
            f"the markers of the {place} are mirrored against the static trial",
            f"their handedness differs; offsets of up to {mm:.0f} mm of {listed(labels)}",
            f"label this cluster again in the trial or in the static one; or {other}",
        )
    if cause.fault is Fault.CLUSTER:
        offset = (
            f"{mm:.0f} mm{_describe_direction(cause)} and {deg:.0f} deg, seen at "
            f"{listed([_name_segment(j) for j in cause.exceeded_at])}"
        )
        plane = (
            f"; one of {listed(labels)} out of their plane would look alike"
            if len(labels) <= FEWEST
            else ""
        )
        return (
            f"the markers of the {place} slid or turned together on the segment since the static "
            "trial",
            offset + plane,
            f"{other}, recorded with the markers as they sit in the trial; or label the segment "
            "again",
        )
    return (
        f"the segments at the {place} do not meet as in the static trial",
        f"joint centres {mm:.0f} mm apart, turned by {deg:.0f} deg",
        f"look at the labels of both segments and at the static trial; or {other}",
    )


def _describe_direction(cause: Contradiction) -> str:
    """The directions of an offset in words."""
    directions = [
        f"{1e3 * abs(value):.0f} mm {ways[0] if value > 0 else ways[1]}"
        for value, ways in zip(cause.direction, DIRECTIONS, strict=True)
        if abs(value) > PART_OF_OFFSET * cause.offset
    ]
    return f" ({', '.join(directions)})" if directions else ""


def _name_segment(name: str) -> str:
    """`thigh_r` as `right thigh`."""
    return f"{SIDE_WORDS[name[-1]]} {name[:-2]}" if get_side(name) else name


def _format_whole_time(trial: TrialEvidence) -> str:
    time = trial.recording.time
    return f"the whole trial, {time[0]:.2f}-{time[-1]:.2f} s"


def _explain_whole_trial(trial: TrialEvidence, causes: Sequence[Contradiction]) -> Finding | None:
    """The exchange of all right and left labels, or a mirrored axis, where it explains everything."""
    if len(causes) < 2 and causes[0].fault is not Fault.UNKNOWN:
        return None
    found = []
    for change, words in (
        (label_checks.swap_sides, "right and left labels are exchanged"),
        (mirror_axis, "one axis of the laboratory is mirrored"),
    ):
        changed = trial.with_recording(change(trial.recording))
        if changed.clusters and not changed.contradictions:
            found.append(words)
    if not found:
        return None
    most = max(1e3 * c.offset for c in causes)
    explained = (
        f"explains contradictions at {listed([_name_segment(c.segment) for c in causes])} of up to "
        f"{most:.0f} mm"
    )
    return trial.error(
        "one body",
        f"undoing it {explained} ({_format_whole_time(trial)})",
        "exchange right and left in the labels of the file, or export it again with right-handed "
        "axes",
        cause=f"{', or '.join(found)}, in this trial or in the static one",
        weight=max(c.excess for c in causes),
        code=Code.SIDES_EXCHANGED,
    )


def mirror_axis(recording: Recording) -> Recording:
    """The recording in a mirror."""
    return replace(recording, markers=recording.markers * [1.0, 1.0, -1.0])


def _check_between_walks(walks: Sequence[TrialEvidence], told: set[str]) -> Iterator[Finding]:
    """The walk of a session in which a cluster has another shape than in the rest; not of segments
    `told`.
    """
    for trial in walks:
        for segment, cluster in trial.clusters.items():
            same = [
                c
                for t in walks
                if (c := t.clusters.get(segment)) is not None and c.labels == cluster.labels
            ]
            if len(same) < FEWEST_WALKS or segment in told:
                continue
            baseline = np.median([c.shape for c in same], axis=0)
            turn, shift = align_points(cluster.shape, baseline)
            away = np.linalg.norm(cluster.shape @ turn.T + shift - baseline, axis=1)
            limit = BETWEEN_WALKS * np.hypot(cluster.size * OFFSET_M[cluster.part], cluster.scatter)
            if (worst := float((away / limit).max())) <= 1.0:
                continue
            names = [f"'{cluster.labels[k]}' {1e3 * away[k]:.0f} mm" for k in np.argsort(-away)]
            yield trial.warning(
                "one body",
                f"{listed(names, 3)} ({_format_whole_time(trial)})",
                f'weights = {{ "{cluster.labels[int(away.argmax())]}" = 0 }} under [markers], or '
                "leave the trial out",
                cause=f"the markers of the {_name_segment(segment)} sit otherwise than in the other "
                f"{len(walks) - 1} walks",
                leg=get_side(segment),
                weight=worst,
                code=Code.ODD_WALK,
            )


def measure_scale(trial: TrialEvidence) -> float | None:
    """Median size of the trial's clusters; None with too few."""
    ratios = [cluster.size_ratio for cluster in trial.clusters.values()]
    return float(np.median(ratios)) if len(ratios) >= FEWEST_CLUSTERS else None


def detect_odd_scale(trial: TrialEvidence) -> float | None:
    """The scale of a trial where it is not that of the static trial.

    It is uncertain by 2 (1.25 (1.48 median |r - median r|) / sqrt(n)), twice the standard error of
    a median of n sizes r, and by what soft tissue does where no posture is like that of the static
    trial, in all segments alike; and scatter alone enlarges a cluster a little.
    """
    scale = measure_scale(trial)
    if scale is None:
        return None
    ratios = np.array([cluster.size_ratio for cluster in trial.clusters.values()])
    scatter = 1.48 * float(np.median(np.abs(ratios - np.median(ratios))))
    margin = min(MOST_MARGIN, 2.5 * scatter / float(np.sqrt(len(ratios))))
    margin += 2.0 * float(
        np.mean([c.compute_tissue_spread() / c.static_size for c in trial.clusters.values()])
    )
    swollen = float(np.median([c.swelling for c in trial.clusters.values()]))
    return scale if not SCALE[0] - margin <= scale <= SCALE[1] + margin + swollen else None


def rescale_trial(trial: TrialEvidence) -> TrialEvidence:
    """The trial in the size of the static one, where it has another: what else is wrong can be seen
    then.
    """
    scale = detect_odd_scale(trial)
    return trial if scale is None else trial.with_markers(trial.recording.markers / scale)


def check_body_scale(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Whether all trials show a body of one size."""
    scales = {
        t.name: (t, scale)
        for t in trials
        if not t.is_static and (scale := measure_scale(t)) is not None
    }
    odd = [(t, scale) for t, scale in scales.values() if detect_odd_scale(t) is not None]
    if not odd:
        return
    away = {t.name: max(SCALE[0] - scale, scale - SCALE[1]) for t, scale in odd}
    found = (
        "the clusters of all segments are "
        f"{', '.join(f'{t.name} {scale:.3f}' for t, scale in odd)} times as large "
    )
    found += f"as in the static trial (median); allowed: {SCALE[0]:g} to {SCALE[1]:g}"
    blamed = [(t, away[t.name]) for t, _ in odd]
    cause = "the trial shows a body of another size than the others"
    cure = (
        "use the trial of this person, exported with the calibration of the cameras of the others"
    )
    if len(odd) == len(scales):
        blamed = [(next((t for t in trials if t.is_static), odd[0][0]), max(away.values()))]
        cause = "the static trial shows a body of another size than "
        cause += "the moving trial" if len(odd) == 1 else "all moving trials"
        cure = (
            "use the static trial of this person and session, with the calibration of the cameras "
            "of the other "
        )
        cure += "trials"
    weight = 1.0 + max(away.values()) / (1.0 - SCALE[0])
    for t, by in blamed:
        severity = Severity.ERROR if by > CERTAIN else Severity.WARNING
        yield t.make_finding(
            severity, "body size", found, cure, cause=cause, weight=weight, code=Code.BODY_SIZE
        )


def check_size(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the cloud of markers has the size of a body."""
    height, found = trial.subject.height, trial.extent
    if trial.has_body_size or found is None:
        return
    likely = next(
        (name for name, unit in UNITS.items() if 0.15 * height < found / unit < 2.5 * height), None
    )
    cure = "check the unit of length that the file declares"
    if likely == "millimetres":
        cure = (
            f"it would be {found / 1e3:.3g} m if the numbers were mm: declare mm, or divide by 1000"
        )
    elif likely:
        cure = (
            f"it would be {found / UNITS[likely]:.3g} m if the numbers were {likely}: declare "
            "their unit"
        )
    allowed = f"{BODY_SIZE[0] * height:.2g} to {BODY_SIZE[1] * height:.2g} m"
    yield trial.error(
        "units",
        f"the markers span {found:.4g} m; allowed: {allowed}",
        cure,
        code=Code.UNIT_OF_LENGTH,
    )


def check_scale(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether lengths within segments are those of the static trial."""
    ratios = [] if trial.is_static else list(_compute_length_ratios(trial))
    if not ratios:
        return
    ratio = float(np.median(ratios))
    message = (
        f"lengths between markers of one segment are {ratio:.3g} times those of the static trial"
    )
    if not LENGTHS_SCALE[0] <= ratio <= LENGTHS_SCALE[1]:
        cure = "check the unit of length of both files, and that both show the same person"
        if 500 < ratio < 2000:
            cure = "the numbers are mm where the static trial has m: declare mm, or divide by 1000"
        yield trial.error("units", message, cure, code=Code.UNIT_OF_LENGTH)
    elif abs(ratio - 1) > SCALE_DOUBTED and len(ratios) >= 6:
        cure = "were the cameras calibrated anew, or markers put on again, between the two?"
        yield trial.warning("units", message, cure, code=Code.OTHER_SCALE)


def _compute_length_ratios(trial: TrialEvidence) -> Iterator[float]:
    """Median distance of every pair of markers with weight in a segment, over that in the static
    posture.
    """
    for labels, local in trial.templates.values():
        for i, a in enumerate(labels):
            for j in range(i):
                length = float(np.linalg.norm(local[i] - local[j]))
                if length < SHORTEST_M or not trial.weight(a) or not trial.weight(labels[j]):
                    continue
                distance = np.linalg.norm(trial.path(a) - trial.path(labels[j]), axis=1)
                distance = distance[np.isfinite(distance)]
                if len(distance):
                    yield float(np.median(distance)) / length
