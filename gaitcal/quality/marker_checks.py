"""Markers of the set in a trial: metres away, missing, unknown, named twice, seldom seen, lost,
beside their segment.

In the static trial each segment is a line between landmarks: ASIS to knee, knee to ankle, heel to
toe, sacrum to the middle of the ASIS. A marker lies at most 0.088 body heights from the line of its
segment on thirteen people.

A segment of a leg that one marker follows is no rigid body, but the joints beside it may tell how
it turns. Whether they do is asked of the trial: pelvis and legs are tracked with the nominal model,
and s_f is how uncertain markers leave the angles of frame f (`tracking/coordinate_prior.py`).

Without the second marker of both thighs, both shanks, or all four (9 Plug-in Gait walks of 5
people) hip, knee and ankle came out within 5 deg RMS of those with all markers, s being 6 to 12
deg; without the toes, s was 29 to 55 deg and angles were wrong by up to 31. With one marker on each
of the three, s is no guide: a leg has two postures then.
"""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.foot_contact import compute_distance_to_line
from gaitcal.errors import Code, Finding, GaitcalError, Severity, alike, listed
from gaitcal.io.labels import is_unlabelled
from gaitcal.io.recording import (
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
from gaitcal.tracking.spline import NodeRule
from gaitcal.tracking.trial_problem import (
    MIN_ROOT_VISIBLE_SHARE,
    build_trial_problem,
    compute_visible_share,
)

SAME_M = 1e-4  # Two markers always nearer than this are one trajectory under two names
HALF = 0.5
"""Share of the frames: in which a marker must be seen to say much, and a segment show two to be
called followed.
"""
LANDMARK_M = 0.008
"""Uncertainty from which a rebuilt landmark is doubted: palpated again they scatter by 6 to 21 mm
(Della Croce et al., Med Biol Eng Comput 37:155-161, 1999)."""
LIMBS = ("thigh", "shank")
FARTHEST_SHARE = (
    0.14  # Share of body height; a marker on a stick is farther off than skin, by some 0.05
)
OFF_SEGMENT, NEARER_SHARE = 0.06, 0.4
"""From the first share of body height on, a marker of a thigh or shank that another of these is
nearer to by the second belongs to that one: on thirteen people the nearest such neighbour is 0.9
times as far as the marker's own segment."""
ONE_MARKER = "one marker"
TWO = 2  # Markers that follow a segment, at least, where the joints beside it say the rest
UNDETERMINED_RAD = np.deg2rad(
    12.0
)  # Uncertainty from which an angle is not determined, in a tenth of the frames
WORST_SHARE = 0.9
FIXED_DISTANCE_M, BESIDE_JOINT_M, MOVES_M = 0.010, 0.015, 0.030
"""Standard deviation of the distance from a marker of the same segment, at most, and from one near
its upper joint; and from others, at least: in a trial in which nothing moves every distance is
kept."""
COMMON_FRAMES = 20  # Frames in which two markers must be seen together for that


def check_outliers(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers metres away from the body, which take no part there."""
    if not trial.outliers:
        return
    names = listed([f"'{outlier.label}'" for outlier in trial.outliers])
    weighed = any(trial.weight(outlier.label) > NEGLIGIBLE_WEIGHT for outlier in trial.outliers)
    yield trial.make_finding(
        Severity.WARNING if weighed else Severity.INFO,
        "strays",
        listed([outlier.description for outlier in trial.outliers]),
        "they take no part there; label the trial again if they are needed",
        cause=f"{names} {'is' if len(trial.outliers) == 1 else 'are'} metres away from the body",
        code=Code.STRAY_MARKER,
    )


def check_missing(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers of the set that the trial lacks, with the label that may be meant."""
    absent = [label for label in trial.expected if label not in trial.column]
    needed = [] if trial.is_isolated else [label for label in absent if _is_needed(trial, label)]
    strangers = list_unknown_labels(trial)
    cure = (
        'name them in the file, or with rename = { "label in file" = "label in set" } under '
        "[markers]"
    )
    rest = [label for label in absent if label not in needed]
    for labels, severity in ((needed, Severity.WARNING), (rest, Severity.INFO)):
        if labels:
            close = {label: alike(label, strangers) for label in labels}
            names = [
                f"'{m}' (is it '{like[0]}'?)" if like else f"'{m}'" for m, like in close.items()
            ]
            found = f"{len(labels)} markers of the set are not in the file: {listed(names, 8)}"
            yield trial.make_finding(severity, "labels", found, cure, code=Code.MISSING_MARKERS)


def _is_needed(trial: TrialEvidence, label: str) -> bool:
    """Whether torques lack a marker: one with weight of pelvis or legs, unless it marks the medial
    side of a joint, which the static trial shows and which is not worn to move; or one of a trunk
    that too few others show. No torque needs arms.
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
    """Whether the first segment of the part that is fitted has three markers: the pelvis, or what
    carries it.
    """
    if trial.is_static or trial.model is None:
        return
    joint, of_pelvis = trial.trial.joint, trial.list_weighted_markers("pelvis")
    carrier = linkage.find_base_segment(joint) or "pelvis"
    shown = trial.list_weighted_markers(carrier)
    if len(shown) < FEWEST_MARKERS:
        of = "the pelvis" if carrier == "pelvis" else f"{carrier}, which carries {joint},"
        yield trial.error(
            "labels",
            f"found {len(shown)} markers of {of} with weight ({', '.join(shown) or 'none'}); "
            "allowed: at least "
            f"{FEWEST_MARKERS}",
            "label them in this trial, or name others of that segment in the marker set",
            code=Code.FEW_MARKERS,
        )
    elif carrier != "pelvis":
        columns = [trial.column[m] for m in of_pelvis]
        if (
            compute_visible_share(trial.visible[:, columns].T.astype(float))
            < MIN_ROOT_VISIBLE_SHARE
        ):
            found = (
                f"the pelvis does not show three markers in half of the frames: {carrier} carries "
                "the body, the "
            )
            found += "joints between them are held straight"
            yield trial.info("labels", found, code=Code.PELVIS_CARRIED)


def check_empty_labels(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers whose label is in the file without a single position: as if it had no such label.

    An error where pelvis or leg lose all that they have, in an isolated trial the segments of its
    joint: then somebody meant these columns.
    """
    empty = [m for m in trial.present if not trial.is_ever_visible(m)]
    if not empty:
        return
    segment_of = trial.marker_set.segment_of
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
        f"{listed([repr(m) for m in empty])} named in the file, but never seen: found 0 of "
        f"{len(trial.visible)} frames"
    )
    if lost:
        found += f"; {listed(lost)} {'has' if len(lost) == 1 else 'have'} no other marker"
    yield trial.make_finding(
        Severity.ERROR if lost else Severity.INFO if harmless else Severity.WARNING,
        "labels",
        found,
        f"label {'it' if len(empty) == 1 else 'them'}, where worn in this trial",
        code=Code.NEVER_SEEN,
    )


def check_single_psis(trial: TrialEvidence) -> Iterator[Finding]:
    """A static trial in which one posterior spine of two is marked: the model's pelvis stands on
    its mirror image.
    """
    if not trial.is_static or trial.model is None:
        return
    for label in find_single_psis(
        trial.marker_set, [m for m in trial.present if trial.is_ever_visible(m)]
    ):
        found = (
            f"{describe_guessed_sacrum(label)}; 10 mm that it sits higher or lower than the other turn the "
            "pelvis by 2 deg"
        )
        cure = "record the static trial again with both, or give one marker midway between the two"
        cause = "one posterior spine alone tells where the sacrum is"
        yield trial.warning("landmarks", found, cure, cause=cause, code=Code.ONE_POSTERIOR_SPINE)


def check_unknown_labels(trial: TrialEvidence) -> Iterator[Finding]:
    """Labels that the marker set does not know: they are not used."""
    strangers = list_unknown_labels(trial)
    if strangers:
        found = f"{len(strangers)} labels unknown to the set: {listed(strangers)}"
        yield trial.info(
            "labels", found, "nothing, if they are meant to be left out", code=Code.UNKNOWN_LABELS
        )


def list_unknown_labels(trial: TrialEvidence) -> list[str]:
    """Labels of the file that the marker set does not know."""
    known = {*trial.marker_set.labels, *trial.marker_set.devices}
    return [label for label in trial.recording.labels if label not in known]


def check_duplicates(trial: TrialEvidence) -> Iterator[Finding]:
    """Labels that occur twice, and trajectories that have two names: markers that always lie on
    each other.
    """
    names = [label.rpartition("#")[0] for label in trial.recording.labels if "#" in label]
    if twice := [name for name in names if name in trial.column]:
        found = f"labels that occur twice: {listed(twice)}; the first was taken"
        yield trial.warning(
            "labels", found, "give every marker a label of its own", code=Code.LABEL_TWICE
        )
    labels = [
        label
        for label in trial.marker_set.labels
        if label in trial.column and trial.weight(label) > 0
    ]
    some = slice(None, None, max(1, len(trial.visible) // 20))  # some twenty frames tell
    paths = trial.recording.markers[some][:, [trial.column[label] for label in labels]]
    same = []
    for i, label in enumerate(labels):
        apart = np.abs(paths[:, i, None] - paths[:, :i])
        both = find_visible(apart)
        farthest = np.where(both[:, :, None], apart, 0.0).max(axis=(0, 2), initial=0.0)
        on_it = np.flatnonzero((both.sum(axis=0) >= 3) & (farthest < SAME_M))
        same += [f"'{labels[k]}' and '{label}'" for k in on_it]
    if same:
        cure = "one of the two is wrong: label the trial again, or give it no weight"
        yield trial.error(
            "labels",
            f"one trajectory under two labels: {listed(same)}",
            cure,
            code=Code.ONE_TRAJECTORY,
        )


def check_bare_segments(trial: TrialEvidence) -> Iterator[Finding]:
    """Segments of the legs, and others that the model tracks, that show no marker with weight in a
    trial.
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
            f"no marker with weight of {listed(bare)}: nothing tells how it moves{torques}",
            "label them in this trial, or see [markers] rename and weights of the study",
            leg=next(iter(sides))
            if len(sides) == 1 and set(bare) <= set(linkage.LEG_SEGMENTS)
            else "",
            code=Code.BARE_SEGMENT,
        )


def check_gaps(trial: TrialEvidence) -> Iterator[Finding]:
    """Long gaps, and markers that are missing most of the time."""
    used = {m for m in trial.as_fitted.present if trial.is_ever_visible(m)}
    markers = [gap for gap in measure_gaps(trial.recording) if gap.label in used]
    rare = {
        g.label: f"{g.label} {100 * g.visible_share:.0f} %"
        for g in markers
        if g.visible_share < HALF
    }
    kept = Counter(
        segment
        for segment in trial.templates
        for m in trial.list_weighted_markers(segment)
        if m in used - set(rare)
    )
    harmful = [m for m in rare if trial.weight(m) > NEGLIGIBLE_WEIGHT]
    harmful = [m for m in harmful if kept[trial.marker_set.segment_of[m]] < FEWEST_MARKERS]
    for labels, severity in (
        (harmful, Severity.WARNING),
        (set(rare) - set(harmful), Severity.INFO),
    ):
        if labels:
            found = (
                "seen in less than half of the frames: "
                f"{listed([told for m, told in rare.items() if m in labels])}"
            )
            cure = "they say little of this trial; label it further, or look at the camera setup"
            if severity is Severity.INFO:
                cure = (
                    f"{FEWEST_MARKERS} others tell how their segments lie, or they have hardly any "
                    "weight"
                )
            yield trial.make_finding(severity, "gaps", found, cure, code=Code.GAPS)
    long = sorted(
        (g for g in markers if g.visible_share >= HALF and g.longest_gap > BRIDGED_S),
        key=lambda g: -g.longest_gap,
    )
    if long:
        longest = listed([f"{g.label} {g.longest_gap:.2f} s" for g in long])
        cure = "gaps get no weight and are not filled; the rest of the segment carries it"
        yield trial.info(
            "gaps", f"gaps longer than {BRIDGED_S:g} s: {longest}", cure, code=Code.GAPS
        )
    yield from _check_pelvis_gaps(trial.as_fitted)


def _check_pelvis_gaps(trial: TrialEvidence) -> Iterator[Finding]:
    """Where the pelvis has no pose: the splines carry it over moments, and no trial is longer than
    what shows it.
    """
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
    """Markers that stand in the model where other trials say that they were."""
    if trial.rebuilding is None or trial.model is None:
        return
    markers = trial.rebuilding.markers
    doubted = [
        m for m in markers if m.landmarks and (m.uncertainty > LANDMARK_M or m.unknown_marker)
    ]
    for marker in doubted:
        cure = (
            "look whether the angles of that segment are plausible; a static trial that shows it "
            "is better"
        )
        if marker.unknown_marker:
            cure = (
                f'rename = {{ "{marker.unknown_marker}" = "{marker.label}" }} under [markers], if it is '
                "the same"
            )
        yield trial.warning(
            "lost markers",
            marker.description,
            cure,
            cause=f"the static trial lost '{marker.label}', which makes "
            f"{listed(list(marker.landmarks))}",
            weight=marker.uncertainty / LANDMARK_M,
            code=Code.REBUILT_MARKER,
        )
    if rest := [marker.description for marker in markers if marker not in doubted]:
        yield trial.info("lost markers", listed(rest), code=Code.REBUILT_MARKER)


def check_not_reconstructed(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers that moving trials show and the static one does not, and that nothing places."""
    if trial.rebuilding is None or trial.model is None or not trial.rebuilding.left:
        return
    reasons = [f"'{label}': {why}" for label, why in trial.rebuilding.left.items()]
    found = (
        f"not seen in this trial, seen in others, and left out of the model: {'; '.join(reasons)}"
    )
    cure = "name a static trial that shows them, or give them no weight"
    yield trial.warning("lost markers", found, cure, code=Code.MARKER_LEFT_OUT)


def check_marker_positions(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers of a static trial that lie elsewhere than at their segment."""
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
            f"{listed(wrong)}; usual: up to {1e3 * OFF_SEGMENT * height:.0f} mm, and nearer than any "
            "other"
        )
        cure = (
            "label the static trial again, or give the marker no weight and leave it out of the "
            "file"
        )
        cause = "markers do not lie at the segments that they are to follow"
        yield trial.error(
            "marker places", found, cure, cause=cause, weight=5.0, code=Code.MARKER_ELSEWHERE
        )


def _locate_segment_lines(trial: TrialEvidence) -> dict[str, tuple[Array, Array]]:
    """Segment -> its two ends, (3,) m."""
    p, parts = (
        trial.posture or {},
        (("thigh", "asis", "knee_lat"), ("shank", "knee_lat", "ankle_lat")),
    )
    ends = {
        f"{segment}_{side}": (f"{a}_{side}", f"{b}_{side}")
        for side in linkage.SIDES
        for segment, a, b in (*parts, ("foot", "heel", "toe"))
    }
    out = {segment: (p[a], p[b]) for segment, (a, b) in ends.items() if a in p and b in p}
    if all(name in p for name in ("asis_r", "asis_l", "sacrum")):
        out["pelvis"] = (p["sacrum"], 0.5 * (p["asis_r"] + p["asis_l"]))
    return out


def check_single_markers(trial: TrialEvidence) -> Iterator[Finding]:
    """Segments of the legs that show fewer than two markers: in most frames, or for a while."""
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
                f"{segment} shows fewer than two markers with weight in "
                f"{format_spans(trial.recording.time, lasting)}"
            )
            yield trial.info(ONE_MARKER, found, code=Code.ONE_MARKER_SEGMENT)
    unsure = _estimate_uncertainty(trial, trial.model) if trial.is_whole_body and single else {}
    for segment in single:
        side, labels = segment[-1], listed([f"'{m}'" for m in trial.list_weighted_markers(segment)])
        share = 100 * np.mean(counts[segment] >= TWO)
        found = f"{segment} shows two markers with weight in {share:.0f} % of the frames ({labels})"
        cure = (
            "label its other markers, here and in the static trial, or add them to this segment in "
            "the marker set"
        )
        if along := listed([f"'{label}'" for label in find_markers_moving_along(trial, segment)]):
            cure = (
                f"{along} of the file moves with it: add it to this segment in the marker set, or "
                "rename it"
            )
        angles = {name: s for name, s in (unsure or {}).items() if name.endswith(f"_{side}")}
        severity, worst = Severity.ERROR, max(angles.values(), default=0.0)
        if unsure is None or sum(s[-1] == side for s in single) == len(linkage.LEG_SEGMENTS) // 2:
            found += "; what the joints beside it leave open has no one answer"
        elif worst > UNDETERMINED_RAD:
            named = listed(
                [
                    f"{name} ({np.rad2deg(s):.0f} deg)"
                    for name, s in angles.items()
                    if s > UNDETERMINED_RAD
                ]
            )
            found += f"; markers {1e3 * MARKER_M:.0f} mm off leave {named} undetermined"
        else:
            severity, found = Severity.WARNING, f"{found}; the joints beside it tell how it turns"
            found += (
                f", to {np.rad2deg(worst):.0f} deg where markers are {1e3 * MARKER_M:.0f} mm off"
                if worst
                else ""
            )
        weight = 3.0 if severity is Severity.WARNING else 1.0
        cause = f"one marker alone follows {segment}"
        code = Code.ONE_MARKER_SEGMENT
        yield trial.make_finding(
            severity, ONE_MARKER, found, cure, cause=cause, leg=side, weight=weight, code=code
        )


def _count_markers(trial: TrialEvidence) -> dict[str, Array]:
    """Segment -> (nf,) markers with weight that are seen, of the segments of the legs whose turns
    the trial is to show; what carries an isolated joint needs three markers.
    """
    joint = trial.trial.joint
    judged = (
        linkage.LEG_SEGMENTS
        if joint is None
        else tuple(s for s in linkage.list_joint_segments(joint)[1:] if s in linkage.LEG_SEGMENTS)
    )
    return {
        s: trial.visible[:, [trial.column[m] for m in trial.list_weighted_markers(s)]].sum(axis=1)
        for s in judged
    }


def _estimate_uncertainty(trial: TrialEvidence, model: SubjectModel) -> dict[str, float] | None:
    """Angle of a leg -> rad, how uncertain it is in the worst tenth of the frames; None where
    tracking fails.
    """
    nominal = model.nominal
    try:
        problem = build_trial_problem(
            trial.name,
            model,
            trial.recording,
            NodeRule(),
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
    worst = np.quantile(uncertain[frames], WORST_SHARE, axis=0)
    names, beyond = (
        zip(problem.chain.coordinates, worst, strict=True),
        linkage.list_joint_coordinates(linkage.FOLLOWED_SEGMENT),
    )
    return {name: float(s) for name, s in names if name[-2:] in ("_r", "_l") and name not in beyond}


def find_markers_moving_along(trial: TrialEvidence, segment: str) -> list[str]:
    """Labels unknown to the set whose distance from the markers of a leg's segment stays the same.

    A shank or a foot must keep its distance from the lateral marker of the joint above, too: near
    that joint's axis a marker keeps its distance from both segments.
    """
    part, _, side = segment.partition("_")
    below = {"thigh": f"shank_{side}", "shank": f"foot_{side}"}.get(part)
    return [
        label
        for label in list_unknown_labels(trial)
        if not is_unlabelled(label)
        and _has_fixed_distances(trial, label, segment)
        and not (
            below
            and trial.list_weighted_markers(below)
            and _has_fixed_distances(trial, label, below)
        )
    ]


def _has_fixed_distances(trial: TrialEvidence, label: str, segment: str) -> bool:
    part, _, side = segment.partition("_")
    above = {"shank": f"knee_lat_{side}", "foot": f"ankle_lat_{side}"}.get(part, "")
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
    moved = max((s for s in others if s is not None), default=0.0)
    return (
        bool(spread) and all(s is not None and s < most for s, most in spread) and moved > MOVES_M
    )


def _measure_scatter(trial: TrialEvidence, one: str, other: str) -> float | None:
    """m, standard deviation of the distance of two markers; None where they are hardly seen
    together.
    """
    away = np.linalg.norm(trial.path(one) - trial.path(other), axis=1)
    away = away[np.isfinite(away)]
    return float(np.std(away)) if len(away) >= COMMON_FRAMES else None
