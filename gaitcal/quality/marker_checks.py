"""Check markers of the set in a trial: missing, unknown, duplicated, invisible, misplaced.

In the static trial each segment is a line between landmarks: ASIS to knee, knee to ankle, heel to
toe, sacrum to the middle of the ASIS. A marker is at most 0.088 body heights from the line of its
segment on thirteen people.

The pose of a leg segment with a single marker is not determined by its markers, but the adjacent
joints may determine it. This is tested on the trial: pelvis and legs are tracked with the nominal
model, and s_f is the uncertainty of the angles of frame f (`tracking/coordinate_prior.py`).

Without the second marker of both thighs, both shanks, or all four (9 Plug-in Gait walks of 5
people) hip, knee and ankle were within 5 deg RMS of those with all markers, s being 6 to 12 deg.
Without the toes, s was 29 to 55 deg and angles were wrong by up to 31 deg. With one marker on each
of the three segments of a leg, s is no guide, as the leg has two possible postures.
"""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.foot_contact import compute_distance_to_line
from gaitcal.errors import Code, Finding, GaitcalError, Severity, find_similar_names, join_names
from gaitcal.io.labels import is_unlabelled
from gaitcal.io.recording import (
    MarkerGaps,
    find_runs,
    find_visible,
    format_spans,
    measure_duration,
    measure_gaps,
)
from gaitcal.model import linkage
from gaitcal.model.landmarks import describe_guessed_sacrum, find_single_psis
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess.clean_trial import BRIDGED_S
from gaitcal.preprocess.trial_evidence import NEGLIGIBLE_WEIGHT, TrialEvidence
from gaitcal.tracking.coordinate_prior import MARKER_M, compute_uncertainty
from gaitcal.tracking.motion import track_motion
from gaitcal.tracking.rigid import FEWEST_MARKERS
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import (
    MIN_ROOT_VISIBLE_SHARE,
    build_trial_problem,
    compute_visible_share,
)

SAME_M = 1e-4  # Two markers always nearer than this are one trajectory under two names
HALF = 0.5
"""Share of the frames: below it a marker is rarely visible, or a segment has a single marker."""
LANDMARK_M = 0.008
"""Uncertainty from which a reconstructed landmark is doubtful: repeated palpation scatters by 6 to
21 mm (Della Croce et al., Med Biol Eng Comput 37:155-161, 1999)."""
LIMBS = ("thigh", "shank")
SEGMENT_ENDS = (
    ("thigh", "asis", "knee_lat"),
    ("shank", "knee_lat", "ankle_lat"),
    ("foot", "heel", "toe"),
)
"""Segment of a leg, and the landmarks at its ends."""
# Largest distance from the segment in body heights; a marker on a wand adds some 0.05
FARTHEST_SHARE = 0.14
OFF_SEGMENT = 0.06  # Share of body height from which a marker of a thigh or shank may be misplaced
NEARER_SHARE = 0.4
"""It is misplaced if another of these segments is nearer by this factor: on thirteen people the
nearest such neighbour is 0.9 times as far as the marker's segment."""
ONE_MARKER = "one marker"
TWO = 2  # Fewest markers of a segment whose adjacent joints determine the rest
# Uncertainty from which an angle is not determined, in the worst tenth of the frames
UNDETERMINED_RAD = np.deg2rad(12.0)
WORST_SHARE = 0.9  # Quantile over frames
# Largest standard deviation of the distance to a marker of the same segment
FIXED_DISTANCE_M = 0.010
BESIDE_JOINT_M = 0.015  # The same to a marker near the proximal joint
# Least standard deviation of the distance to others: if nothing moves, every distance is constant
MOVES_M = 0.030
COMMON_FRAMES = 20  # Fewest frames in which both markers are visible


def check_outliers(trial: TrialEvidence) -> Iterator[Finding]:
    """Report markers metres away from the body; they are left out there.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        One warning, or a note if they have little weight.
    """
    if not trial.outliers:
        return
    names = join_names([f"'{outlier.label}'" for outlier in trial.outliers])
    weighed = any(trial.weight(outlier.label) > NEGLIGIBLE_WEIGHT for outlier in trial.outliers)
    yield trial.make_finding(
        Severity.WARNING if weighed else Severity.INFO,
        "stray markers",
        join_names([outlier.description for outlier in trial.outliers]),
        "these samples are left out; relabel the trial if they are needed",
        cause=f"{names} {'is' if len(trial.outliers) == 1 else 'are'} metres away from the body",
        code=Code.STRAY_MARKER,
    )


def check_missing(trial: TrialEvidence) -> Iterator[Finding]:
    """Report markers of the set that the file lacks, with similar labels of the file.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        A warning on markers that torques need, a note on others.
    """
    absent = [label for label in trial.expected if label not in trial.column]
    needed = [] if trial.is_isolated else [label for label in absent if _is_needed(trial, label)]
    strangers = _list_unknown_labels(trial)
    cure = (
        'correct the labels in the file, or set rename = { "label in file" = "label in set" } '
        "under [markers]"
    )
    others = [label for label in absent if label not in needed]
    for labels, severity in ((needed, Severity.WARNING), (others, Severity.INFO)):
        if labels:
            close = {label: find_similar_names(label, strangers) for label in labels}
            names = [
                f"'{m}' (is it '{like[0]}'?)" if like else f"'{m}'" for m, like in close.items()
            ]
            found = f"{len(labels)} markers of the set are not in the file: {join_names(names, 8)}"
            yield trial.make_finding(severity, "labels", found, cure, code=Code.MISSING_MARKERS)


def _is_needed(trial: TrialEvidence, label: str) -> bool:
    """Return whether torques need a marker.

    They need markers with weight of pelvis and legs, and those of a trunk with too few others. They
    do not need arms, nor medial markers of moving trials that the static trial shows.
    """
    segment = trial.marker_set.segment_of.get(label, "pelvis")
    if trial.weight(label) <= NEGLIGIBLE_WEIGHT:
        return False
    if segment not in linkage.LOWER_BODY:
        return (
            segment == "head_trunk" and len(trial.list_weighted_markers(segment)) < FEWEST_MARKERS
        )
    shown = () if trial.is_static or trial.stance is None else trial.stance.landmarks
    medial = (
        m
        for name in shown
        if "_med_" in name
        for option in trial.marker_set.options(name)
        for m in option
    )
    return label not in medial


def check_base_segment(trial: TrialEvidence) -> Iterator[Finding]:
    """Report a base segment with fewer than three markers.

    The base segment is the pelvis or, if it is hidden, the segment proximal to a functional trial's
    joint.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        An error; a note if another segment replaces the pelvis.
    """
    if trial.is_static or trial.model is None:
        return
    joint, of_pelvis = trial.trial.joint, trial.list_weighted_markers("pelvis")
    base = linkage.find_base_segment(joint) or "pelvis"
    shown = trial.list_weighted_markers(base)
    if len(shown) < FEWEST_MARKERS:
        name = "the pelvis" if base == "pelvis" else f"{base}, the base segment of {joint},"
        yield trial.error(
            "labels",
            f"found {len(shown)} markers of {name} with weight ({', '.join(shown) or 'none'}); "
            f"allowed: at least {FEWEST_MARKERS}",
            "label them in this trial, or add others of that segment to the marker set",
            code=Code.FEW_MARKERS,
        )
    elif base != "pelvis":
        columns = [trial.column[m] for m in of_pelvis]
        if (
            compute_visible_share(trial.visible[:, columns].T.astype(float))
            < MIN_ROOT_VISIBLE_SHARE
        ):
            found = (
                f"three pelvis markers are visible in less than half of the frames: {base} is the "
                "base segment, and the joints between it and the pelvis are held at zero"
            )
            yield trial.info("labels", found, code=Code.PELVIS_CARRIED)


def check_empty_labels(trial: TrialEvidence) -> Iterator[Finding]:
    """Report markers whose label is in the file without a single position.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        An error if pelvis or a leg (in a functional trial a segment of its joint) lose all markers;
        otherwise a warning or a note.
    """
    empty = [m for m in trial.present if not trial.is_ever_visible(m)]
    if not empty:
        return
    segment_of = trial.marker_set.segment_of
    # visible markers with weight that remain on these segments
    left = {segment_of[m]: 0 for m in empty}
    for label in trial.present:
        if trial.is_ever_visible(label) and trial.weight(label) > 0 and segment_of[label] in left:
            left[segment_of[label]] += 1
    joint = trial.trial.joint
    needed = linkage.list_joint_segments(joint) if joint else ("pelvis", *linkage.LEG_SEGMENTS)
    lost = [s for s in left if s in needed and not left[s]]
    light = all(
        trial.weight(m) <= NEGLIGIBLE_WEIGHT or left[segment_of[m]] >= FEWEST_MARKERS for m in empty
    )
    harmless = trial.is_isolated or light
    found = (
        f"{join_names([repr(m) for m in empty])} without a position in any of the "
        f"{len(trial.visible)} frames"
    )
    if lost:
        found += f"; {join_names(lost)} {'has' if len(lost) == 1 else 'have'} no other marker"
    yield trial.make_finding(
        Severity.ERROR if lost else Severity.INFO if harmless else Severity.WARNING,
        "labels",
        found,
        f"label {'it' if len(empty) == 1 else 'them'}, if worn in this trial",
        code=Code.NEVER_SEEN,
    )


def check_single_psis(trial: TrialEvidence) -> Iterator[Finding]:
    """Report a static trial with one posterior spine marker of two.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        One warning for each such marker.
    """
    if not trial.is_static or trial.model is None:
        return
    for label in find_single_psis(
        trial.marker_set, [m for m in trial.present if trial.is_ever_visible(m)]
    ):
        found = (
            f"{describe_guessed_sacrum(label)}; if it is 10 mm higher or lower than the other, the "
            "pelvis is rotated by 2 deg"
        )
        cure = "record the static trial again with both, or with one marker midway between the two"
        cause = "the sacrum is located by a single posterior spine"
        yield trial.warning("landmarks", found, cure, cause=cause, code=Code.ONE_POSTERIOR_SPINE)


def check_unknown_labels(trial: TrialEvidence) -> Iterator[Finding]:
    """Report labels that are not in the marker set; they are not used.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        One note, or nothing.
    """
    strangers = _list_unknown_labels(trial)
    if strangers:
        found = f"{len(strangers)} labels unknown to the set: {join_names(strangers)}"
        yield trial.info(
            "labels", found, "no action if they are not needed", code=Code.UNKNOWN_LABELS
        )


def _list_unknown_labels(trial: TrialEvidence) -> list[str]:
    """List labels of the file that are neither in the marker set nor those of devices."""
    known = {*trial.marker_set.labels, *trial.marker_set.devices}
    return [label for label in trial.recording.labels if label not in known]


def check_duplicates(trial: TrialEvidence) -> Iterator[Finding]:
    """Report labels that occur twice, and trajectories with two labels.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        A warning on labels, an error on trajectories.
    """
    names = [label.rpartition("#")[0] for label in trial.recording.labels if "#" in label]
    twice = [name for name in names if name in trial.column]
    if twice:
        found = f"labels that occur twice: {join_names(twice)}; the first one is used"
        yield trial.warning(
            "labels", found, "give every marker a unique label", code=Code.LABEL_TWICE
        )
    labels = [
        label
        for label in trial.marker_set.labels
        if label in trial.column and trial.weight(label) > 0
    ]
    some = slice(None, None, max(1, len(trial.visible) // 20))  # some twenty frames are enough
    paths = trial.recording.markers[some][:, [trial.column[label] for label in labels]]
    same = []
    for i, label in enumerate(labels):
        distance = np.abs(paths[:, i, None] - paths[:, :i])
        both = find_visible(distance)
        # only frames in which both are visible are compared
        farthest = np.where(both[:, :, None], distance, 0.0).max(axis=(0, 2), initial=0.0)
        on_it = np.flatnonzero((both.sum(axis=0) >= 3) & (farthest < SAME_M))
        same += [f"'{labels[k]}' and '{label}'" for k in on_it]
    if same:
        cure = "relabel the trial, or set the weight of the wrong label to 0"
        yield trial.error(
            "labels",
            f"one trajectory under two labels: {join_names(same)}",
            cure,
            code=Code.ONE_TRAJECTORY,
        )


def check_bare_segments(trial: TrialEvidence) -> Iterator[Finding]:
    """Report segments of the legs, and other tracked ones, without a visible marker with weight.

    Parameters
    ----------
    trial
        A whole-body trial; others are not checked.

    Yields
    ------
    Finding
        One warning, or nothing.
    """
    if not trial.is_whole_body or trial.model is None:
        return
    visible = {m for m in trial.column if trial.is_ever_visible(m) and trial.weight(m) > 0}
    markers = trial.model.markers
    wanted: dict[str, list[str]] = {segment: [] for segment in linkage.LEG_SEGMENTS}
    for label, segment, weight in zip(
        markers.labels, markers.segments, markers.weight, strict=True
    ):
        if weight > 0:
            wanted.setdefault(segment, []).append(label)
    bare = [segment for segment, labels in wanted.items() if visible.isdisjoint(labels)]
    if bare:
        sides = {segment[-1] for segment in bare if segment in linkage.LEG_SEGMENTS}
        torques = (
            f"; no torque{' of this leg' if len(sides) == 1 else ''} is valid" if sides else ""
        )
        yield trial.warning(
            "labels",
            f"no marker with weight of {join_names(bare)}: its motion is not determined{torques}",
            "label them in this trial, or check rename and weights under [markers]",
            leg=next(iter(sides))
            if len(sides) == 1 and set(bare) <= set(linkage.LEG_SEGMENTS)
            else "",
            code=Code.BARE_SEGMENT,
        )


def check_gaps(trial: TrialEvidence) -> Iterator[Finding]:
    """Report long gaps, markers that are missing most of the time, and gaps of the pelvis.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        A warning if a segment keeps too few other markers; otherwise notes.
    """
    used = {m for m in trial.as_fitted.present if trial.is_ever_visible(m)}
    markers = [gap for gap in measure_gaps(trial.recording) if gap.label in used]
    yield from _check_rare_markers(trial, used, markers)
    long = sorted(
        (g for g in markers if g.visible_share >= HALF and g.longest_gap > BRIDGED_S),
        key=lambda g: -g.longest_gap,
    )
    if long:
        longest = join_names([f"{g.label} {g.longest_gap:.2f} s" for g in long])
        cure = "no action: gaps have no weight and are not filled; the segment's others are used"
        yield trial.info(
            "gaps", f"gaps longer than {BRIDGED_S:g} s: {longest}", cure, code=Code.GAPS
        )
    yield from _check_pelvis_gaps(trial.as_fitted)


def _check_rare_markers(
    trial: TrialEvidence, used: set[str], markers: Sequence[MarkerGaps]
) -> Iterator[Finding]:
    """Report markers visible in less than half of the frames; a warning if few others remain."""
    rare = {g.label: g for g in markers if g.visible_share < HALF}
    common = used - set(rare)
    kept = Counter(
        segment
        for segment in trial.templates
        for m in trial.list_weighted_markers(segment)
        if m in common
    )
    harmful = [m for m in rare if trial.weight(m) > NEGLIGIBLE_WEIGHT]
    harmful = [m for m in harmful if kept[trial.marker_set.segment_of[m]] < FEWEST_MARKERS]
    for labels, severity in (
        (harmful, Severity.WARNING),
        (set(rare) - set(harmful), Severity.INFO),
    ):
        if labels:
            shares = [f"{m} {100 * g.visible_share:.0f} %" for m, g in rare.items() if m in labels]
            found = f"visible in less than half of the frames: {join_names(shares)}"
            cure = "label more of the trial, or check the camera setup"
            if severity is Severity.INFO:
                cure = (
                    f"no action: {FEWEST_MARKERS} others determine the pose of their segments, or "
                    "they have little weight"
                )
            yield trial.make_finding(severity, "gaps", found, cure, code=Code.GAPS)


def _check_pelvis_gaps(trial: TrialEvidence) -> Iterator[Finding]:
    """Report frames without a pelvis pose: short ones are bridged, long ones shorten the trial."""
    cure = "label or fill the markers of the pelvis there"
    if trial.trial.cut:
        yield trial.info("gaps", trial.trial.cut, cure, code=Code.PELVIS_LOST)
    if trial.pelvis is None or trial.pelvis.determined.all():
        return
    lost = ~trial.pelvis.determined
    share = float(np.mean(lost))
    message = f"fewer than three pelvis markers in {100 * share:.0f} % of the frames"
    if share > HALF:
        message += f" ({format_spans(trial.recording.time, find_runs(lost))})"
        yield trial.warning("gaps", message, cure, code=Code.PELVIS_LOST)
    else:
        message += f", never for longer than {BRIDGED_S:g} s: these are bridged"
        yield trial.info("gaps", message, code=Code.PELVIS_LOST)


def check_reconstructed(trial: TrialEvidence) -> Iterator[Finding]:
    """Report markers of the model that were reconstructed from other trials.

    Parameters
    ----------
    trial
        The static trial that makes the model; others are not checked.

    Yields
    ------
    Finding
        A warning for each uncertain landmark, one note on the others.
    """
    if trial.rebuilding is None or trial.model is None:
        return
    markers = trial.rebuilding.markers
    doubted = [
        m for m in markers if m.landmarks and (m.uncertainty > LANDMARK_M or m.unknown_marker)
    ]
    for marker in doubted:
        cure = (
            "check the angles of that segment, or use a static trial in which the marker is visible"
        )
        if marker.unknown_marker:
            cure = (
                f'set rename = {{ "{marker.unknown_marker}" = "{marker.label}" }} under [markers], '
                "if it is the same marker"
            )
        yield trial.warning(
            "lost markers",
            marker.description,
            cure,
            cause=f"'{marker.label}', needed for {join_names(list(marker.landmarks))}, is missing "
            "in the static trial",
            weight=marker.uncertainty / LANDMARK_M,
            code=Code.REBUILT_MARKER,
        )
    certain = [marker.description for marker in markers if marker not in doubted]
    if certain:
        yield trial.info("lost markers", join_names(certain), code=Code.REBUILT_MARKER)


def check_not_reconstructed(trial: TrialEvidence) -> Iterator[Finding]:
    """Report markers that only moving trials show and that could not be reconstructed.

    Parameters
    ----------
    trial
        The static trial that makes the model; others are not checked.

    Yields
    ------
    Finding
        One warning, or nothing.
    """
    if trial.rebuilding is None or trial.model is None or not trial.rebuilding.not_reconstructed:
        return
    reasons = [f"'{label}': {why}" for label, why in trial.rebuilding.not_reconstructed.items()]
    found = (
        f"not visible in this trial but in others, and left out of the model: {'; '.join(reasons)}"
    )
    cure = "use a static trial in which they are visible, or set their weights to 0"
    yield trial.warning("lost markers", found, cure, code=Code.MARKER_LEFT_OUT)


def check_marker_positions(trial: TrialEvidence) -> Iterator[Finding]:
    """Report markers of a static trial that are not at their segment.

    Parameters
    ----------
    trial
        The trial; moving trials are not checked.

    Yields
    ------
    Finding
        One error, or nothing.
    """
    lines, height = _locate_segment_lines(trial), trial.subject.height
    wrong = []
    for label, position in trial.still_positions.items() if lines else ():
        segment = trial.marker_set.segment_of.get(label)
        if segment not in lines:
            continue
        away = {
            other: float(compute_distance_to_line(position, *ends)) for other, ends in lines.items()
        }
        nearest = min(away, key=lambda other: away[other])
        limbs = segment.startswith(LIMBS) and nearest.startswith(LIMBS)
        other = (
            limbs
            and away[segment] / height > OFF_SEGMENT
            and away[nearest] < NEARER_SHARE * away[segment]
        )
        if away[segment] / height > FARTHEST_SHARE or other:
            wrong.append(
                f"'{label}' {1e3 * away[segment]:.0f} mm from {segment} (nearest: {nearest})"
            )
    if wrong:
        found = (
            f"{join_names(wrong)}; usual: up to {1e3 * OFF_SEGMENT * height:.0f} mm, and nearer "
            "than to any other segment"
        )
        cure = "relabel the static trial, or set the weight of the marker to 0"
        cause = "markers are not at their segments"
        yield trial.error(
            "marker positions", found, cure, cause=cause, weight=5.0, code=Code.MARKER_ELSEWHERE
        )


def _locate_segment_lines(trial: TrialEvidence) -> dict[str, tuple[Array, Array]]:
    """Locate segments: name -> its two ends, (3,) m."""
    p = trial.posture or {}
    out: dict[str, tuple[Array, Array]] = {}
    for side in linkage.SIDES:
        for segment, proximal, distal in SEGMENT_ENDS:
            a, b = f"{proximal}_{side}", f"{distal}_{side}"
            if a in p and b in p:
                out[f"{segment}_{side}"] = (p[a], p[b])
    if all(name in p for name in ("asis_r", "asis_l", "sacrum")):
        out["pelvis"] = (p["sacrum"], 0.5 * (p["asis_r"] + p["asis_l"]))
    return out


def check_single_markers(trial: TrialEvidence) -> Iterator[Finding]:
    """Report segments of the legs with fewer than two markers: in most frames, or for a while.

    Parameters
    ----------
    trial
        A moving trial; static ones are not checked.

    Yields
    ------
    Finding
        A note for a while; in most frames a warning, or an error if angles are undetermined.
    """
    if trial.is_static or trial.model is None:
        return
    counts = {segment: count for segment, count in _count_markers(trial).items() if count.any()}
    single = [s for s, count in counts.items() if np.mean(count >= TWO) < HALF]
    for segment, count in counts.items():
        lasting = [
            run
            for run in find_runs(count < TWO)
            if measure_duration(trial.recording.time, run) > BRIDGED_S
        ]
        if segment not in single and lasting:
            found = (
                f"{segment} has fewer than two visible markers with weight in "
                f"{format_spans(trial.recording.time, lasting)}"
            )
            yield trial.info(ONE_MARKER, found, code=Code.ONE_MARKER_SEGMENT)
    uncertain = _estimate_uncertainty(trial, trial.model) if trial.is_whole_body and single else {}
    for segment in single:
        # with one marker on each of its segments, the leg has two possible postures
        whole_leg = sum(s[-1] == segment[-1] for s in single) == len(linkage.LEG_SEGMENTS) // 2
        share = float(np.mean(counts[segment] >= TWO))
        yield _report_single_marker(trial, segment, share, None if whole_leg else uncertain)


def _report_single_marker(
    trial: TrialEvidence, segment: str, share: float, uncertain: dict[str, float] | None
) -> Finding:
    """Build the finding on a segment that has two markers in this share of the frames only.

    `uncertain`: angle of a leg -> rad; None if it is not known.
    """
    side, labels = segment[-1], join_names([f"'{m}'" for m in trial.list_weighted_markers(segment)])
    found = (
        f"{segment} has two visible markers with weight in {100 * share:.0f} % of the frames "
        f"({labels})"
    )
    cure = (
        "label its other markers, here and in the static trial, or add them to this segment in "
        "the marker set"
    )
    along = join_names([f"'{label}'" for label in _find_markers_moving_along(trial, segment)])
    if along:
        cure = (
            f"{along} of the file moves with it: add it to this segment in the marker set, or "
            "rename it"
        )
    angles = {name: s for name, s in (uncertain or {}).items() if name.endswith(f"_{side}")}
    large = [f"{n} ({np.rad2deg(s):.0f} deg)" for n, s in angles.items() if s > UNDETERMINED_RAD]
    severity, worst = Severity.ERROR, max(angles.values(), default=0.0)
    if uncertain is None:
        found += "; the adjacent joints do not determine its pose"
    elif worst > UNDETERMINED_RAD:
        found += (
            f"; with marker errors of {1e3 * MARKER_M:.0f} mm undetermined: {join_names(large)}"
        )
    else:
        severity = Severity.WARNING
        found += "; the adjacent joints determine its rotation"
        if worst:
            found += (
                f", to {np.rad2deg(worst):.0f} deg with marker errors of {1e3 * MARKER_M:.0f} mm"
            )
    return trial.make_finding(
        severity,
        ONE_MARKER,
        found,
        cure,
        cause=f"{segment} has a single marker",
        leg=side,
        weight=3.0 if severity is Severity.WARNING else 1.0,
        code=Code.ONE_MARKER_SEGMENT,
    )


def _count_markers(trial: TrialEvidence) -> dict[str, Array]:
    """Count visible markers with weight, segment -> (nf,), of segments that the trial must show.

    These are the legs, or in a functional trial the moving segments of its joint; the base segment
    of the joint needs three markers.
    """
    joint = trial.trial.joint
    checked = (
        linkage.LEG_SEGMENTS
        if joint is None
        else tuple(s for s in linkage.list_joint_segments(joint)[1:] if s in linkage.LEG_SEGMENTS)
    )
    out: dict[str, Array] = {}
    for segment in checked:
        columns = [trial.column[m] for m in trial.list_weighted_markers(segment)]
        out[segment] = trial.visible[:, columns].sum(axis=1)
    return out


def _estimate_uncertainty(trial: TrialEvidence, model: SubjectModel) -> dict[str, float] | None:
    """Estimate the uncertainty (rad) of leg angles in the worst tenth of the frames.

    Returns None if tracking fails.
    """
    nominal = model.nominal
    try:
        problem = build_trial_problem(
            trial.name,
            model,
            trial.recording,
            ControlPointRule(),
            root="pelvis",
            segments=linkage.LOWER_BODY,
        )
        motion = track_motion(problem, nominal)
    except (GaitcalError, np.linalg.LinAlgError):
        return None
    if not motion.converged:
        return None
    uncertain = compute_uncertainty(
        problem.compute_frame_hessians(motion.q, problem.build_body(nominal))
    )
    frames = slice(None) if trial.pelvis is None else trial.pelvis.determined
    # a single bad frame does not decide
    worst = np.quantile(uncertain[frames], WORST_SHARE, axis=0)
    names, beyond = (
        zip(problem.chain.coordinates, worst, strict=True),
        linkage.list_joint_coordinates(linkage.FOLLOWED_SEGMENT),
    )
    return {name: float(s) for name, s in names if name[-2:] in ("_r", "_l") and name not in beyond}


def _find_markers_moving_along(trial: TrialEvidence, segment: str) -> list[str]:
    """Find unknown labels whose distances to the markers of a leg segment are constant.

    A shank or foot marker must also keep its distance from the lateral marker of the joint above:
    near that joint's axis a marker keeps its distance from both segments.

    `segment`: a leg segment, such as `shank_r`. Returns: labels of the file.
    """
    part, _, side = segment.partition("_")
    below = {"thigh": f"shank_{side}", "shank": f"foot_{side}"}.get(part)
    return [
        label
        for label in _list_unknown_labels(trial)
        if not is_unlabelled(label)
        and _has_fixed_distances(trial, label, segment)
        and not (
            below
            and trial.list_weighted_markers(below)
            and _has_fixed_distances(trial, label, below)
        )
    ]


def _has_fixed_distances(trial: TrialEvidence, label: str, segment: str) -> bool:
    """Return whether a label keeps its distances to a segment while it moves against others."""
    part, _, side = segment.partition("_")
    above = {"shank": f"knee_lat_{side}", "foot": f"ankle_lat_{side}"}.get(part, "")
    # near the axis of the proximal joint the distance varies a little more
    near_joint = {
        m: BESIDE_JOINT_M for m in trial.marker_set.landmarks.get(above, ()) if m in trial.column
    }
    near_joint |= dict.fromkeys(trial.list_weighted_markers(segment), FIXED_DISTANCE_M)
    spread = [(_measure_scatter(trial, label, other), most) for other, most in near_joint.items()]
    others = [
        _measure_scatter(trial, label, m)
        for s in linkage.SIDES
        for m in trial.list_weighted_markers(f"foot_{s}")
        + trial.list_weighted_markers(f"thigh_{s}")
    ]
    # in a trial without motion every distance is constant
    moved = max((s for s in others if s is not None), default=0.0)
    return (
        bool(spread) and all(s is not None and s < most for s, most in spread) and moved > MOVES_M
    )


def _measure_scatter(trial: TrialEvidence, one: str, other: str) -> float | None:
    """Measure the standard deviation (m) of two markers' distance; None in too few frames."""
    away = np.linalg.norm(trial.path(one) - trial.path(other), axis=1)
    away = away[np.isfinite(away)]
    return float(np.std(away)) if len(away) >= COMMON_FRAMES else None
