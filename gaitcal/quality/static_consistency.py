"""Check that all trials show one body: unit, scale, moving and static trials, walks.

The effect of a cause on a result is measured by its effect on the pose of a segment: translation of
a joint centre, rotation of the segment. Soft tissue and marker placement differ by 4 to 6 mm and 2
to 4 deg at the joints of clean recordings; from twice that, the result is wrong by more than its
error bar. Soft tissue and gaps change the size of one cluster by some per cent; the median of seven
is more reliable than any of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.errors import STUDY, Code, Finding, Severity, join_names
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import SIDE_WORDS
from gaitcal.preprocess.marker_clusters import FEWEST, align_points
from gaitcal.preprocess.static_disagreement import OFFSET_M, Contradiction, Fault
from gaitcal.preprocess.trial_evidence import BODY_SIZE, TrialEvidence, get_side
from gaitcal.quality import knee_axes, label_checks

POSE_TRANSLATION_M, POSE_ROTATION_RAD = 0.012, np.deg2rad(7.0)
"""Error of a segment's pose at its joints beyond which a result exceeds its error bar."""
REFUSED_TIMES_LIMIT = 1.15
"""Times a limit: below, large soft tissue artefacts have the same effect, and the result is
doubtful but not refused."""
BEYOND_SKIN_M = 0.025  # Displacement that soft tissue never has for a whole trial
REFUSED_EXCESS = 2.0  # Times a limit, for a contradiction without a known cause
BETWEEN_WALKS = 0.6
"""Factor of the limits of offsets between walks of one session: clean ones differ by 1.5 mm, the
pelvis by 2.6.
"""
DIRECTIONS = (("forward", "backward"), ("up", "down"), ("to the right", "to the left"))
PART_OF_OFFSET = 0.4  # A direction is named where it has so much of an offset
FEWEST_WALKS = 3  # Fewest walks of which one can differ from the others
CODES = {
    Fault.MARKER: Code.MARKER_OFF_STATIC,
    Fault.LABELS: Code.EXCHANGED_LABELS,
    Fault.MIRRORED: Code.CLUSTER_MIRRORED,
    Fault.CLUSTER: Code.CLUSTER_SLID,
    Fault.UNKNOWN: Code.SEGMENTS_APART,
}
SCALE = (0.983, 1.011)
"""Allowed median size of the clusters of a trial, relative to the static trial: all clean trials of
20 people are between 0.985 and 1.002."""
FEWEST_CLUSTERS = 6
MOST_MARGIN = 0.006
"""Largest widening of these limits by the scatter of the clusters' sizes, two standard errors of
their median. Halves of a clean walk with Plug-in Gait markers, two to four a segment, have a median
of 0.980."""
# Beyond the limits by so much it is another body, or another calibration of the cameras
CERTAIN = 0.012
LENGTHS_SCALE = (0.8, 1.25)
"""Lengths within segments relative to the static trial: outside this range, the unit or the camera
calibration must be wrong."""
SCALE_DOUBTED = 0.04  # Departure of this ratio from 1 that soft tissue does not explain
SHORTEST_M = 0.03  # Shorter distances between markers do not determine a scale
UNITS = {"millimetres": 1e3, "centimetres": 1e2, "inches": 39.4}


def check_static_consistency(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Report contradictions between moving trials and the static trial, or between walks.

    Parameters
    ----------
    trials
        Trials with labels of sides and axes in order; the static trial and moving ones.

    Yields
    ------
    Finding
        One a cause: size of the body, whole trials, single markers and clusters, knee axes, walks.
    """
    yield from _check_body_scale(trials)
    sized = [_rescale_trial(t) for t in trials if not t.is_static]
    found: dict[tuple[Fault, str, tuple[str, ...]], list[tuple[TrialEvidence, Contradiction]]] = {}
    spoilt: set[str] = set()
    for trial in sized:
        causes = trial.contradictions
        whole = _explain_whole_trial(trial, causes) if causes else None
        if whole is not None:
            yield whole
            spoilt.add(trial.name)
            continue
        for cause in causes:
            # a marker displaced for a while is reported with its time elsewhere
            if not (cause.fault is Fault.MARKER and cause.labels[0] in trial.displaced):
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
    """Build the finding on one cause from the trials that show it, of `moving` moving trials."""
    trial, worst = max(group, key=lambda pair: pair[1].excess)
    names = list(dict.fromkeys(t.name for t, _ in group))
    several = len(names) > 1
    other = "use another static trial"
    if several and len(names) == moving:
        other += " (all moving trials contradict this one)"
    cause, found, cure = DESCRIPTIONS[worst.fault](worst, other)
    return Finding(
        severity=_judge_severity(worst),
        topic="one body",
        where=STUDY if several else trial.name,
        source="" if several else trial.source,
        cause=cause,
        found=f"{found} "
        f"({f'throughout {join_names(names)}' if several else _format_whole_time(trial)})",
        cure=cure,
        leg=get_side(worst.segment),
        weight=worst.excess,
        code=CODES[worst.fault],
    )


def _judge_severity(cause: Contradiction) -> Severity:
    """Judge whether a contradiction is an error or a warning."""
    if cause.fault in (Fault.LABELS, Fault.MIRRORED):
        refused = True
    elif cause.fault is Fault.UNKNOWN:
        refused = cause.excess > REFUSED_EXCESS
    else:
        # an offset within all joint limits is inferred rather than measured
        far = cause.fault is Fault.MARKER and cause.offset > BEYOND_SKIN_M and cause.excess > 1.0
        sure = cause.excess > REFUSED_TIMES_LIMIT or far
        refused = sure and (cause.shift > POSE_TRANSLATION_M or cause.rotation > POSE_ROTATION_RAD)
    return Severity.ERROR if refused else Severity.WARNING


def _describe_marker(cause: Contradiction, other: str) -> tuple[str, str, str]:
    """Describe a displaced marker: cause, evidence, remedy; `other`: use another static trial."""
    segment, label, deg = _name_segment(cause.segment), cause.labels[0], np.rad2deg(cause.rotation)
    markers = " or ".join(map(repr, (label, *cause.rivals)))
    pose = f"{deg:.0f} deg"
    if cause.shift:
        pose = f"{1e3 * cause.shift:.0f} mm at its joints and {pose}"
    cure = f'set weights = {{ "{label}" = 0 }} under [markers], or {other}'
    if cause.rivals:
        cure = f"{other}; neither can be left out, as one marker alone does not determine the pose"
    return (
        f"the position of marker {markers} on the {segment} differs from the static trial",
        f"{1e3 * cause.offset:.0f} mm off{_describe_direction(cause)}; the pose of the segment "
        f"changes by {pose}",
        cure,
    )


def _describe_labels(cause: Contradiction, other: str) -> tuple[str, str, str]:
    """Describe swapped labels: cause, evidence, remedy."""
    one, two = map(repr, cause.labels[:2])
    return (
        f"the labels {one} and {two} on the {_name_segment(cause.segment)} are swapped, here or in "
        "the static trial",
        f"swapping them explains offsets of up to {1e3 * cause.offset:.0f} mm",
        "swap the two labels in the file that is wrong",
    )


def _describe_mirrored(cause: Contradiction, other: str) -> tuple[str, str, str]:
    """Describe a mirrored cluster: cause, evidence, remedy."""
    labels = join_names([repr(label) for label in cause.labels])
    return (
        f"the markers of the {_name_segment(cause.segment)} are mirrored relative to the static "
        "trial",
        f"their handedness differs; offsets of up to {1e3 * cause.offset:.0f} mm of {labels}",
        f"relabel this cluster in the trial or in the static trial, or {other}",
    )


def _describe_cluster(cause: Contradiction, other: str) -> tuple[str, str, str]:
    """Describe a displaced cluster: cause, evidence, remedy."""
    joints = join_names([_name_segment(joint) for joint in cause.exceeded_at])
    found = (
        f"{1e3 * cause.offset:.0f} mm{_describe_direction(cause)} and "
        f"{np.rad2deg(cause.rotation):.0f} deg, observed at {joints}"
    )
    # with three markers or fewer, a single one displaced out of their plane has the same effect
    if len(cause.labels) <= FEWEST:
        labels = join_names([repr(label) for label in cause.labels])
        found += f"; one of {labels} displaced out of their plane has the same effect"
    return (
        f"the markers of the {_name_segment(cause.segment)} moved together on the segment since "
        "the static trial",
        found,
        f"{other}, recorded with the markers as in this trial, or relabel the segment",
    )


def _describe_unknown(cause: Contradiction, other: str) -> tuple[str, str, str]:
    """Describe segments that contradict each other without a known cause."""
    return (
        f"the segments at the {_name_segment(cause.segment)} do not meet as in the static trial",
        f"joint centres {1e3 * cause.offset:.0f} mm apart, rotated by "
        f"{np.rad2deg(cause.rotation):.0f} deg",
        f"check the labels of both segments and the static trial, or {other}",
    )


DESCRIPTIONS = {
    Fault.MARKER: _describe_marker,
    Fault.LABELS: _describe_labels,
    Fault.MIRRORED: _describe_mirrored,
    Fault.CLUSTER: _describe_cluster,
    Fault.UNKNOWN: _describe_unknown,
}


def _describe_direction(cause: Contradiction) -> str:
    """Describe the directions of an offset: ` (12 mm forward, 8 mm up)`."""
    directions = [
        f"{1e3 * abs(value):.0f} mm {names[0] if value > 0 else names[1]}"
        for value, names in zip(cause.direction, DIRECTIONS, strict=True)
        if abs(value) > PART_OF_OFFSET * cause.offset
    ]
    return f" ({', '.join(directions)})" if directions else ""


def _name_segment(name: str) -> str:
    """Name a segment: `right thigh` for `thigh_r`."""
    return f"{SIDE_WORDS[name[-1]]} {name[:-2]}" if get_side(name) else name


def _format_whole_time(trial: TrialEvidence) -> str:
    """Format the time of a trial: `the whole trial, 0.00-1.20 s`."""
    time = trial.recording.time
    return f"the whole trial, {time[0]:.2f}-{time[-1]:.2f} s"


def _explain_whole_trial(trial: TrialEvidence, causes: Sequence[Contradiction]) -> Finding | None:
    """Report swapped right and left labels, or a mirrored axis, if that explains everything."""
    if len(causes) < 2 and causes[0].fault is not Fault.UNKNOWN:
        return None
    found = []
    for change, cause in (
        (label_checks.swap_sides, "right and left labels are swapped"),
        (_mirror_axis, "one axis of the laboratory is mirrored"),
    ):
        # a correction that removes all contradictions explains them
        changed = trial.with_recording(change(trial.recording))
        if changed.clusters and not changed.contradictions:
            found.append(cause)
    if not found:
        return None
    most = max(1e3 * c.offset for c in causes)
    explained = (
        f"explains contradictions at {join_names([_name_segment(c.segment) for c in causes])} "
        f"of up to {most:.0f} mm"
    )
    return trial.error(
        "one body",
        f"correcting it {explained} ({_format_whole_time(trial)})",
        "swap right and left in the labels of the file, or export it again with right-handed axes",
        cause=f"{', or '.join(found)}, in this trial or in the static one",
        weight=max(c.excess for c in causes),
        code=Code.SIDES_EXCHANGED,
    )


def _mirror_axis(recording: Recording) -> Recording:
    """Mirror a recording along z."""
    return replace(recording, markers=recording.markers * [1.0, 1.0, -1.0])


def _check_between_walks(walks: Sequence[TrialEvidence], reported: set[str]) -> Iterator[Finding]:
    """Report a walk in which a cluster differs from the other walks; not segments `reported`."""
    for trial in walks:
        for segment, cluster in trial.clusters.items():
            clusters = [t.clusters[segment] for t in walks if segment in t.clusters]
            same = [c for c in clusters if c.labels == cluster.labels]
            if len(same) < FEWEST_WALKS or segment in reported:
                continue
            # compare the shape of the cluster with the median of all walks, after alignment
            baseline = np.median([c.shape for c in same], axis=0)
            turn, shift = align_points(cluster.shape, baseline)
            away = np.linalg.norm(cluster.shape @ turn.T + shift - baseline, axis=1)
            limit = BETWEEN_WALKS * np.hypot(cluster.size * OFFSET_M[cluster.part], cluster.scatter)
            worst = float((away / limit).max())
            if worst <= 1.0:
                continue
            names = [f"'{cluster.labels[k]}' {1e3 * away[k]:.0f} mm" for k in np.argsort(-away)]
            yield trial.warning(
                "one body",
                f"{join_names(names, 3)} ({_format_whole_time(trial)})",
                f'set weights = {{ "{cluster.labels[int(away.argmax())]}" = 0 }} under [markers], '
                "or leave the trial out",
                cause=f"the markers of the {_name_segment(segment)} are placed differently than in "
                f"the other {len(walks) - 1} walks",
                leg=get_side(segment),
                weight=worst,
                code=Code.ODD_WALK,
            )


def _measure_scale(trial: TrialEvidence) -> float | None:
    """Measure the scale of a trial relative to the static trial.

    Returns: median size of its clusters; None with too few.
    """
    ratios = [cluster.size_ratio for cluster in trial.clusters.values()]
    return float(np.median(ratios)) if len(ratios) >= FEWEST_CLUSTERS else None


def _detect_odd_scale(trial: TrialEvidence) -> float | None:
    """Return the scale of a trial if it differs from that of the static trial, else None.

    Parameters
    ----------
    trial
        A moving trial.

    Returns
    -------
    float or None

    Notes
    -----
    The allowed range is widened by 2 (1.25 (1.48 median |r - median r|) / sqrt(n)), twice the
    standard error of a median of n sizes r, and by soft tissue if no posture is like that of the
    static trial, which acts on all segments alike. Scatter alone enlarges a cluster a little.
    """
    scale = _measure_scale(trial)
    if scale is None:
        return None
    ratios = np.array([cluster.size_ratio for cluster in trial.clusters.values()])
    # median absolute deviation as a standard deviation
    scatter = 1.48 * float(np.median(np.abs(ratios - np.median(ratios))))
    margin = min(MOST_MARGIN, 2.5 * scatter / float(np.sqrt(len(ratios))))
    margin += 2.0 * float(
        np.mean([c.compute_tissue_spread() / c.static_size for c in trial.clusters.values()])
    )
    swollen = float(np.median([c.swelling for c in trial.clusters.values()]))
    return scale if not SCALE[0] - margin <= scale <= SCALE[1] + margin + swollen else None


def _rescale_trial(trial: TrialEvidence) -> TrialEvidence:
    """Scale a trial to the size of the static one if it differs, so that other faults can be found.

    Parameters
    ----------
    trial
        A moving trial.

    Returns
    -------
    TrialEvidence
    """
    scale = _detect_odd_scale(trial)
    return trial if scale is None else trial.with_markers(trial.recording.markers / scale)


def _check_body_scale(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Report trials that show a body of another size than the static trial.

    Yields an error or warning for each such trial, or one for the static trial if all moving
    differ.
    """
    measured = [(t, _measure_scale(t)) for t in trials if not t.is_static]
    scales = {t.name: (t, scale) for t, scale in measured if scale is not None}
    odd = [(t, scale) for t, scale in scales.values() if _detect_odd_scale(t) is not None]
    if not odd:
        return
    away = {t.name: max(SCALE[0] - scale, scale - SCALE[1]) for t, scale in odd}
    found = (
        "the clusters of all segments are "
        f"{', '.join(f'{t.name} {scale:.3f}' for t, scale in odd)} times as large as in the static "
        f"trial (median); allowed: {SCALE[0]:g} to {SCALE[1]:g}"
    )
    at_fault = [(t, away[t.name]) for t, _ in odd]
    cause = "the trial shows a body of another size than the others"
    cure = "use the trial of this person, exported with the same camera calibration as the others"
    # if all moving trials differ, the static trial is at fault
    if len(odd) == len(scales):
        at_fault = [(next((t for t in trials if t.is_static), odd[0][0]), max(away.values()))]
        cause = "the static trial shows a body of another size than "
        cause += "the moving trial" if len(odd) == 1 else "all moving trials"
        cure = (
            "use the static trial of this person and session, with the same camera calibration as "
            "the other trials"
        )
    weight = 1.0 + max(away.values()) / (1.0 - SCALE[0])
    for t, by in at_fault:
        severity = Severity.ERROR if by > CERTAIN else Severity.WARNING
        yield t.make_finding(
            severity, "body size", found, cure, cause=cause, weight=weight, code=Code.BODY_SIZE
        )


def check_size(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the cloud of markers has the size of a body.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        One error on the unit of length, or nothing.
    """
    height, found = trial.subject.height, trial.extent
    if trial.has_body_size or found is None:
        return
    likely = next(
        (name for name, unit in UNITS.items() if 0.15 * height < found / unit < 2.5 * height), None
    )
    cure = "check the unit of length that the file declares"
    if likely == "millimetres":
        cure = f"it is {found / 1e3:.3g} m if the numbers are mm: declare mm, or divide by 1000"
    elif likely:
        cure = (
            f"it is {found / UNITS[likely]:.3g} m if the numbers are {likely}: declare their unit"
        )
    allowed = f"{BODY_SIZE[0] * height:.2g} to {BODY_SIZE[1] * height:.2g} m"
    yield trial.error(
        "units",
        f"the markers span {found:.4g} m; allowed: {allowed}",
        cure,
        code=Code.UNIT_OF_LENGTH,
    )


def check_scale(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that lengths within segments are those of the static trial.

    Parameters
    ----------
    trial
        A moving trial; static ones are not checked.

    Yields
    ------
    Finding
        One error or warning, or nothing.
    """
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
            cure = "the numbers are mm, those of the static trial m: declare mm, or divide by 1000"
        yield trial.error("units", message, cure, code=Code.UNIT_OF_LENGTH)
    elif abs(ratio - 1) > SCALE_DOUBTED and len(ratios) >= 6:
        cure = "check that cameras were not recalibrated and markers not moved between the two"
        yield trial.warning("units", message, cure, code=Code.OTHER_SCALE)


def _compute_length_ratios(trial: TrialEvidence) -> Iterator[float]:
    """Yield the median distance of each marker pair of a segment relative to the static posture."""
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
