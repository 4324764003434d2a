"""Propose landmarks for markers with unknown labels, else the segments that they move with.

One recording stands, the others move. Heights, headings and postures of the arms are tried
(`place_markers`), and the likeliest is kept, unless the opposite heading is nearly as likely. The
user confirms the proposal.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import PureWindowsPath

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Code, InputError
from gaitcal.intake import unnamed_markers
from gaitcal.io.recording import Recording, find_visible
from gaitcal.model.landmarks import is_device
from gaitcal.model.linkage import LOWER_BODY, SIDES
from gaitcal.quality.named_joint_centres import MEASURED_M, identify_computed_points

LANDMARK_SET = "landmarks"
BOTH_FEET = 0.5
"""Agreement of both feet from which the direction of walking is taken as the heading."""
BEYOND_DOUBT = 4.6
"""Log odds (100 to 1) from which heading or segment are certain."""
ONE_IN_20 = 7.81
"""Chi-squared with three degrees of freedom that one landmark in 20 exceeds."""
ONE_IN_100 = 11.34
"""The same of one landmark in 100, which the user must confirm."""
FLOOR_M = 0.02
"""m, height of the lowest marker above the floor."""
TALL = 1.03
"""Height of the highest marker over the smallest body height that is tried."""
STEP = 1.06
"""Ratio of the heights that are tried."""
STEPS = 12
"""Number of heights: up to a body whose pelvis has the highest marker."""
NEAREST = 5
"""Number of heights if the body height is given: those nearest to it."""
LIKELIEST = 3
"""Heights of each heading that are tried with all postures of the arms."""
HEIGHT_SPREAD = 0.03
"""Standard deviation of a given height, as a share of it."""
FEWEST_MARKERS = 10
WALKS_M = 0.1
"""m, smallest RMS distance from their mean positions of foot markers in walking, on a treadmill,
too.
"""
RESTS_M = 0.01
"""m, the same of points that are fixed in the room."""
WITH_ANOTHER = 0.75
"""Smallest share of the markers that are on a segment with another one: all but some at wrists,
elbows or shoulders.
"""
ALONE = 0.09
"""Half the distance of a posterior iliac spine from the midline, over the distance of the anterior
ones.
"""
GLIDING = ("knee_", "toe_")
"""Landmarks over which skin glides, or that bend."""
CLUSTER = 3
"""Other markers with which a segment is tracked without them."""
KNEE = 0.27
"""Height of the knee as a share of the body height."""
KNEE_SPREAD = 0.08
"""Largest distance in height of a knee device's markers from it, as a share of the body height."""
DEVICE = ("knee_axis", "knee_device_2", "knee_device_3")


@dataclass(frozen=True, kw_only=True)
class LabelProposal:
    """Proposed meaning of labels."""

    rename: Mapping[str, str]
    """Label -> landmark of the marker set "landmarks"."""
    tracking: Mapping[str, tuple[str, ...]]
    """Segment -> labels of further markers that move with it."""
    weights: Mapping[str, float]
    """Label, or landmark -> 0: shown, not fitted."""
    evidence: Mapping[str, str]
    """Label -> reason of its proposal."""
    unused: Mapping[str, str]
    """Label -> why it is not used."""
    asked: frozenset[str] = frozenset()
    """Labels of `rename` that the user must confirm: at an unusual position, or without movement
    and perhaps on another segment.
    """
    basis: str
    """Evidence of heading and height."""


def propose_labels(recordings: Sequence[Recording], height: float | None = None) -> LabelProposal:
    """Propose the meaning of labels in recordings that use the same ones for the same markers.

    Parameters
    ----------
    recordings
        One stands, the others move.
    height
        m, of the person, if it is given.

    Returns
    -------
    LabelProposal

    Raises
    ------
    InputError
        There is no still window, the labels differ between files, or the heading is not certain.
    """
    standing = min(recordings, key=_measure_sway)
    moving = [r for r in recordings if r is not standing]
    every, scatter, points, visible, why = _collect_markers(standing, moving)
    _require_consistent_labels(scatter)
    names = [every[i] for i in visible]
    forward = unnamed_markers.estimate_forward_direction(moving, points[visible], names)
    evidence = _select_evidence(visible, points, scatter)
    placed, view, basis = _fit_likeliest_body(*evidence, forward, height)
    # markers of knee devices would be taken for landmarks: without them again
    still_only = [every[i] for i in visible if not np.isfinite(scatter[i]).any()]
    devices = _find_knee_devices(
        standing, still_only, view.origin[1] + KNEE * placed.height, KNEE_SPREAD * placed.height
    )
    on_device = {label for parts in devices for label in parts}
    if on_device:
        visible = [i for i in visible if every[i] not in on_device]
        evidence = _select_evidence(visible, points, scatter)
        placed, view, basis = _fit_likeliest_body(*evidence, forward, height)
    placed = _drop_lone_forearms(placed, view, *evidence)
    labels = [every[i] for i in visible]
    found = _read_labels(labels, placed, scatter[np.ix_(visible, visible)])
    asked = _list_labels_to_confirm(
        labels, found.rename, placed, view.transform_to_body(points[visible]), still_only
    )
    found = _identify_sacrum(found, {label: points[i] for i, label in enumerate(every)})
    lateral = view.transform_to_body(points)[:, 2]
    rods = _name_device_markers(devices, dict(zip(every, lateral.tolist(), strict=True)))
    distances = "at the knee, with the distances of a knee alignment device from two others"
    known = {*labels, *on_device}
    never = {m: "never visible with the others" for m in every if m not in known}
    return LabelProposal(
        rename={**found.rename, **rods},
        tracking=found.tracking,
        weights=found.weights,
        evidence={**found.evidence, **dict.fromkeys(rods, distances)},
        unused={**found.unused, **why, **never},
        asked=frozenset(m for m in found.rename if m in asked),
        basis=f"{basis}; standing in {PureWindowsPath(standing.source).name}",
    )


def _require_consistent_labels(scatter: Array) -> None:
    """Raise an error if few markers keep their distance from another one over all recordings."""
    rows = np.isfinite(scatter).any(axis=1)
    if not rows.any():
        return
    together = unnamed_markers.compute_segment_log_odds(scatter)[rows] > 0
    share = float(together.any(axis=1).mean())
    if share < WITH_ANOTHER:
        raise InputError(
            f"only {100 * share:.0f} % of the labels keep their distance from another one in all "
            "recordings, as markers of "
            f"one segment do; {100 * WITH_ANOTHER:.0f} % or more are needed: a label must name "
            "the same marker in all files",
            code=Code.LANDMARKS,
        )


def _list_labels_to_confirm(
    labels: Sequence[str],
    rename: Mapping[str, str],
    placed: unnamed_markers.MarkerLocations,
    points: Array,
    still_only: Sequence[str],
) -> set[str]:
    """List renamed labels at unusual positions, or without movement and uncertain segment."""
    chi_squared = unnamed_markers.compute_misplacement(points, placed)
    out = set()
    for i, label in enumerate(labels):
        if label not in rename:
            continue
        is_unsure = label in still_only and placed.ahead[i] < BEYOND_DOUBT
        segment = placed.body.segments[placed.assignment[i]]
        if is_unsure or (chi_squared[i] > ONE_IN_100 and segment in LOWER_BODY):
            out.add(label)
    return out


def _name_device_markers(
    devices: Sequence[tuple[str, str, str]], lateral: Mapping[str, float]
) -> dict[str, str]:
    """Name the markers of knee devices, lateral ones first; `lateral`: label -> m to the right."""
    out: dict[str, str] = {}
    for parts in devices:
        outwards = sorted(parts, key=lambda label: -abs(lateral[label]))
        side = SIDES[0] if lateral[outwards[0]] > 0 else SIDES[1]
        out |= {label: f"{part}_{side}" for label, part in zip(outwards, DEVICE, strict=True)}
    return out


def place_unknown_markers(
    standing: Recording,
    moving: Sequence[Recording],
    segment_of: Mapping[str, str],
    lacking: Sequence[str] = (),
    height: float | None = None,
) -> LabelProposal:
    """Assign labels that a set does not contain to the segments that they move with.

    Parameters
    ----------
    standing
        Static trial.
    moving
        Recordings of movements.
    segment_of
        Label of the set -> segment.
    lacking
        Landmarks that no marker gives. The label at one of these positions is mentioned; only the
        user names it so.
    height
        m, of the person, if it is given.

    Returns
    -------
    LabelProposal
        Without `rename`.

    Raises
    ------
    InputError
        As of `propose_labels`.
    """
    every, scatter, points, visible, why = _collect_markers(standing, moving, segment_of)
    unknown_at = {
        label: position
        for label, position in zip(every, points, strict=True)
        if label not in segment_of and np.isfinite(position).all()
    }
    for label, row in zip(every, scatter, strict=True):
        if not np.isfinite(row).any():
            why[label] = "not in any trial with movement"
    visible = [i for i in visible if every[i] in segment_of or every[i] not in why]
    labels, body = [every[i] for i in visible], unnamed_markers.load_standing_bodies()[0]
    points, evidence = _select_evidence(visible, points, scatter)
    segments, scatter = np.array(body.segments), scatter[np.ix_(visible, visible)]
    # known markers stay on their segments, unknown ones may be on any surface
    given = [segment_of.get(label) for label in labels]
    allowed = np.array(
        [~body.landmark if segment is None else segments == segment for segment in given]
    )
    known = [k for k, segment in enumerate(given) if segment is not None]
    names = [labels[k] for k in known]
    forward = unnamed_markers.estimate_forward_direction(moving, points[known], names)
    limited = replace(evidence, allowed=allowed)
    placed, view, basis = _fit_likeliest_body(points, limited, forward, height)
    found = _read_labels(labels, placed, scatter)
    near = _describe_nearby_landmarks(
        lacking,
        unknown_at,
        view,
        points[known],
        replace(placed, assignment=placed.assignment[known]),
    )
    # labels that are not assigned, with their reason
    near_two = {m for m, ahead in zip(labels, placed.ahead, strict=True) if ahead < BEYOND_DOUBT}
    why |= dict.fromkeys(sorted(near_two), "moves about equally well with two segments")
    why |= dict(found.unused)
    for label in every:
        if label not in labels:
            why.setdefault(label, "never visible with the others")
    loose = _find_loose_markers(labels, segments[placed.assignment], evidence)
    why |= dict.fromkeys(
        sorted(loose - near_two), "does not keep its distance from the segment at its position"
    )
    alone = {m for s, group in found.tracking.items() if s not in given for m in group}
    why |= dict.fromkeys(
        sorted(alone - near_two - loose), "on a segment of which the set contains no marker"
    )
    out = {*segment_of, *near_two, *loose, *alone}
    tracking = {}
    for segment, group in found.tracking.items():
        assigned = tuple(label for label in group if label not in out)
        if assigned:
            tracking[segment] = assigned
    kept = [label for group in tracking.values() for label in group]
    return LabelProposal(
        rename={},
        tracking=tracking,
        weights={label: weight for label, weight in found.weights.items() if label in kept},
        evidence={label: found.evidence[label] + near.get(label, "") for label in kept},
        unused={
            label: reason + near.get(label, "")
            for label, reason in why.items()
            if label not in segment_of
        },
        basis=basis,
    )


def _find_loose_markers(
    labels: Sequence[str], segments: Array, evidence: unnamed_markers.MotionEvidence
) -> set[str]:
    """Find markers that do not keep their distance from those on the same segment (n,)."""
    same = evidence.known & (segments[:, None] == segments)
    out = set()
    for label, log_odds, mates in zip(labels, evidence.log_odds, same, strict=True):
        if mates.any() and log_odds[mates].mean() < 0:
            out.add(label)
    return out


def _describe_nearby_landmarks(
    lacking: Sequence[str],
    at: Mapping[str, Array],
    view: "_View",
    points: Array,
    placed: unnamed_markers.MarkerLocations,
) -> dict[str, str]:
    """Describe which unknown label is at the position of a landmark that lacks a marker.

    `at`: label -> position (3,) m. The nearest label of each landmark counts, if 19 in 20 markers
    are as near to the position by the known markers at `points` (n, 3) m.
    """
    out = {}
    for name in (name for name in lacking if name in placed.body.labels):
        assignment = np.append(placed.assignment, placed.body.labels.index(name))
        with_one = replace(placed, assignment=assignment)
        away = {}
        for label, position in at.items():
            in_body = view.transform_to_body(np.vstack([points, position]))
            away[label] = unnamed_markers.compute_misplacement(in_body, with_one)[-1]
        nearest = min(away, key=away.__getitem__, default="")
        if nearest and away[nearest] < ONE_IN_20:
            out[nearest] = f"; at the position of {name}: rename it if it is this landmark"
    return out


def _collect_markers(
    standing: Recording, moving: Sequence[Recording], named: Collection[str] = ()
) -> tuple[list[str], Array, Array, list[int], dict[str, str]]:
    """Collect labels, scatter (n, n) m, positions (n, 3) m and indices of visible markers.

    The last value is label -> why it is not a marker on the person. Markers that are `named` are
    known.
    """
    why = _find_resting_points(standing, moving)
    every = list(dict.fromkeys(m for r in (standing, *moving) for m in r.labels if m not in why))
    why |= {m: "a second path of a marker" for m in every if m.rpartition("#")[0] in named}
    every = [m for m in every if m not in why]
    # points that another program computed from markers
    scatter = unnamed_markers.compute_distance_scatter(moving, every)
    markers = np.array([not named or m in named for m in every])
    standing_at = unnamed_markers.measure_standing_points(standing, every)
    for i in _find_computed_points(scatter, markers, standing_at):
        if every[i] not in named:
            why[every[i]] = "computed: keeps its distance from another one better than markers do"
    standing_at = standing_at[[m not in why for m in every]]
    every = [m for m in every if m not in why]
    scatter = unnamed_markers.compute_distance_scatter(moving, every, standing_at)
    points = unnamed_markers.place_missing_markers(standing_at, every, moving, scatter)
    visible = [i for i in range(len(every)) if np.isfinite(points[i]).all()]
    if len(visible) < FEWEST_MARKERS:
        message = (
            f"only {len(visible)} markers are visible in the static trial; {FEWEST_MARKERS} or "
            "more are needed"
        )
        raise InputError(message, code=Code.LANDMARKS)
    return every, scatter, points, visible, why


def _find_computed_points(scatter: Array, markers: BoolArray, points: Array) -> list[int]:
    """Find the indices of points that keep their distance from another one as no two markers do.

    Of a pair at `points` (n, 3) m those that `computed_of_pair` decides. None if most of the
    `markers` (n,) do so, as those of a synthetic subject.
    """
    scatters = np.where(np.isfinite(scatter), scatter, np.inf)
    np.fill_diagonal(scatters, np.inf)
    together = scatters < MEASURED_M
    rigid: BoolArray = np.asarray(together.any(axis=1))
    moving = markers & np.isfinite(scatters).any(axis=1)
    if 2 * (rigid & moving).sum() > moving.sum():
        return []
    middle = np.nanmean(points, axis=0)
    for i, k in zip(*np.nonzero(np.triu(together)), strict=True):
        if together[i].sum() == together[k].sum() == 1 and np.isfinite(points[[i, k]]).all():
            rigid[[i, k]] = identify_computed_points(points[i], points[k], middle)
    return np.flatnonzero(rigid).tolist()


def _measure_sway(recording: Recording) -> float:
    """Measure the RMS distance (m) from the mean position, 90th percentile over the markers."""
    away = list(_measure_sways(recording).values())
    return float(np.quantile(away, 0.9)) if len(away) >= FEWEST_MARKERS else np.inf


def _find_resting_points(standing: Recording, moving: Sequence[Recording]) -> dict[str, str]:
    """Find label -> why it is not on the person: it is at rest while the lowest markers walk.

    It is at the same position in all recordings, unlike a foot at rest.
    """
    found: set[str] = set()
    positions: dict[str, list[Array]] = {}
    for recording in (standing, *moving):
        away = _measure_sways(recording)
        paths = dict(zip(recording.labels, recording.markers.swapaxes(0, 1), strict=True))
        for label in away:
            positions.setdefault(label, []).append(np.nanmean(paths[label], axis=0))
        if not away or recording is standing:
            continue
        # the lowest quarter of the markers
        by_height = sorted((positions[label][-1][1], label) for label in away)
        lowest = by_height[: -(-len(by_height) // 4)]
        if np.median([away[label] for _, label in lowest]) > WALKS_M:
            found |= {label for label in away if away[label] < RESTS_M}
    # in the order of the files: that of a set differs from run to run
    resting = []
    for label, means in positions.items():
        if label in found and len(means) > 1 and np.ptp(means, axis=0).max() < RESTS_M:
            resting.append(label)
    return dict.fromkeys(resting, "at rest while the person walks")


def _measure_sways(recording: Recording) -> dict[str, float]:
    """Measure label -> RMS distance (m) from its mean position, where it is visible."""
    visible = find_visible(recording.markers)
    paths = {
        m: recording.markers[visible[:, i], i]
        for i, m in enumerate(recording.labels)
        if visible[:, i].any()
    }
    return {
        m: float(np.sqrt(np.square(path - path.mean(axis=0)).sum(axis=1).mean()))
        for m, path in paths.items()
    }


def _find_knee_devices(
    standing: Recording, labels: Sequence[str], knee: float, spread: float
) -> list[tuple[str, str, str]]:
    """Find triples of static markers at a knee (height, m) with the distances of a device."""
    out: list[tuple[str, str, str]] = []
    paths = {
        label: standing.markers[:, standing.labels.index(label)]
        for label in labels
        if label in standing.labels
    }
    paths = {
        label: path
        for label, path in paths.items()
        if abs(np.nanmedian(path[:, 1]) - knee) < spread
    }
    used: set[str] = set()
    for three in combinations(paths, 3):
        if used.isdisjoint(three) and is_device(*(paths[label] for label in three)):
            out.append(three)
            used |= set(three)
    return out


def _select_evidence(
    rows: Sequence[int], points: Array, scatter: Array
) -> tuple[Array, unnamed_markers.MotionEvidence]:
    """Select positions (n, 3) m and evidence of some of the markers."""
    scatter = scatter[np.ix_(rows, rows)]
    known = np.isfinite(scatter)
    np.fill_diagonal(known, False)
    allowed = np.ones(
        (len(scatter), len(unnamed_markers.load_standing_bodies()[0].labels)), dtype=bool
    )
    return points[rows], unnamed_markers.MotionEvidence(
        log_odds=unnamed_markers.compute_segment_log_odds(scatter), known=known, allowed=allowed
    )


@dataclass(frozen=True)
class _View:
    """Axes of a standing person: `heading` (x, z), `origin` (3,) m on the floor below it."""

    heading: Array
    origin: Array

    def transform_to_body(self, points: Array) -> Array:
        """Transform points (n, 3) m to forward, up, right."""
        away = points - self.origin
        ahead, right = self.heading, np.array([-self.heading[1], self.heading[0]])
        return np.column_stack([away[:, [0, 2]] @ ahead, away[:, 1], away[:, [0, 2]] @ right])


def _fit_likeliest_body(
    points: Array, evidence: unnamed_markers.MotionEvidence, forward: Array, height: float | None
) -> tuple[unnamed_markers.MarkerLocations, _View, str]:
    """Fit markers to the likeliest body: assignment, axes of the person, and their evidence."""
    floor = points[:, 1].min() - FLOOR_M
    above = points[:, 1] - floor
    low = points[above < 0.6 * above.max()][:, [0, 2]]
    middle = 0.5 * (low.max(axis=0) + low.min(axis=0))
    agreement = float(np.linalg.norm(forward))
    axes = np.linalg.eigh(np.cov(low.T))[1].T
    walks = agreement > BOTH_FEET
    if walks:
        axes = np.array([forward, [-forward[1], forward[0]]]) / agreement
    # the heading of the feet comes first
    headings = [sign * axis for axis in axes for sign in (1.0, -1.0)]
    usual, spread = unnamed_markers.HEIGHT_M, unnamed_markers.HEIGHT_SD_M
    if height:
        usual, spread = height, HEIGHT_SPREAD * height

    def build_view(heading: Array) -> _View:
        ahead = float(np.median((points[:, [0, 2]] - middle)[above < 0.5 * above.max()] @ heading))
        return _View(heading, np.insert(middle + ahead * heading, 1, floor))

    def compute_cost(placed: unnamed_markers.MarkerLocations) -> float:
        return placed.cost + 0.5 * ((placed.height - usual) / spread) ** 2

    heights = above.max() / TALL * STEP ** np.arange(STEPS)
    heights = heights[np.argsort(np.abs(heights - usual))][: None if height is None else NEAREST]
    bodies = unnamed_markers.load_standing_bodies()
    views = [build_view(heading) for heading in headings]
    in_view = [view.transform_to_body(points) for view in views]
    # roughly: all headings and heights with hanging arms
    tried: dict[int, list[tuple[float, float]]] = {k: [] for k in range(len(views))}
    for k, tall in product(range(len(views)), heights):
        rough = unnamed_markers.place_markers(in_view[k], bodies[0], tall, evidence, rounds=4)
        tried[k].append((compute_cost(rough), float(tall)))
    likeliest = {k: sorted(costs)[:LIKELIEST] for k, costs in tried.items()}
    # the two best headings, and that of the feet, with all postures of the arms
    candidates = {
        *sorted(likeliest, key=lambda k: (likeliest[k][0], k))[:2],
        *([0] if walks else []),
    }
    whole = {}
    for k in candidates:
        pairs = product((tall for _, tall in likeliest[k]), bodies)
        placed = [
            unnamed_markers.place_markers(in_view[k], body, tall, evidence) for tall, body in pairs
        ]
        found = min(placed, key=compute_cost)
        # each arm in another posture
        for side in SIDES:
            armed = (found.body.replace_arm(side, body) for body in bodies)
            others = [
                unnamed_markers.place_markers(in_view[k], body, found.height, evidence)
                for body in armed
            ]
            found = min((found, *others), key=compute_cost)
        whole[k] = found
    cost_of = {k: compute_cost(placed) for k, placed in whole.items()}
    chosen = _choose_heading(cost_of, walks=walks)
    evidence_of_heading = "direction of feet and pelvis"
    if walks:
        evidence_of_heading = f"both feet swing forward (agreement {agreement:.2f})"
    basis = f"{evidence_of_heading}; fits a height of {whole[chosen].height:.2f} m"
    return whole[chosen], views[chosen], basis


def _choose_heading(cost_of: Mapping[int, float], *, walks: bool) -> int:
    """Choose the heading, in walking that of the feet (0); InputError if it is not certain."""
    chosen = min(cost_of, key=cost_of.__getitem__)
    if walks and cost_of[0] - cost_of[chosen] > BEYOND_DOUBT:
        raise InputError(
            "the direction of the person is not certain: the swing of the feet contradicts the "
            "direction of feet and pelvis, as in walking backward or sideways; add a recording of "
            "forward walking",
            code=Code.LANDMARKS,
        )
    chosen = 0 if walks else chosen
    odds = min((cost_of[k] - cost_of[chosen] for k in cost_of if k != chosen), default=np.inf)
    if not walks and odds < BEYOND_DOUBT:
        raise InputError(
            "the direction of the person is not certain: no recording shows walking, and feet and "
            "pelvis fit forward and backward; add a recording of walking",
            code=Code.LANDMARKS,
        )
    return chosen


def _drop_lone_forearms(
    placed: unnamed_markers.MarkerLocations,
    view: _View,
    points: Array,
    evidence: unnamed_markers.MotionEvidence,
) -> unnamed_markers.MarkerLocations:
    """Place markers again without a forearm if neither its upper arm nor the trunk has a marker.

    A marker cluster on the thigh is where hands hang.
    """
    segments = np.array(placed.body.segments)
    used = set(segments[placed.assignment[placed.assignment >= 0]].tolist())
    lone = []
    for s in SIDES:
        if f"forearm_hand_{s}" in used and not used & {f"upper_arm_{s}", "head_trunk"}:
            lone.append(f"forearm_hand_{s}")
    if not lone:
        return placed
    without = replace(evidence, allowed=evidence.allowed & ~np.isin(segments, lone))
    return unnamed_markers.place_markers(
        view.transform_to_body(points), placed.body, placed.height, without
    )


def _identify_sacrum(found: LabelProposal, at: Mapping[str, Array]) -> LabelProposal:
    """Name a single marker behind the pelvis as that on the sacrum if it is near the midline."""
    back = {
        name: label
        for label, name in found.rename.items()
        if name.startswith(("asis", "psis", "sacrum"))
    }
    if len(back) != 3 or not {"asis_r", "asis_l"} <= set(back) or "sacrum" in back:
        return found
    (label,) = (label for name, label in back.items() if name.startswith("psis"))
    # distance from the midline as a share of that of the anterior spines
    across = at[back["asis_r"]] - at[back["asis_l"]]
    aside = float(
        (at[label] - 0.5 * (at[back["asis_r"]] + at[back["asis_l"]])) @ across / (across @ across)
    )
    if abs(aside) > ALONE:
        return found
    distance = 1e3 * abs(aside) * np.linalg.norm(across)
    reason = f"the only marker behind the pelvis, {distance:.0f} mm from its midline"
    return replace(
        found, rename={**found.rename, label: "sacrum"}, evidence={**found.evidence, label: reason}
    )


def _read_labels(
    labels: Sequence[str], placed: unnamed_markers.MarkerLocations, scatter: Array
) -> LabelProposal:
    """Read the meaning of labels from the positions of their markers."""
    body, on = placed.body, placed.assignment
    rename, tracking, weights, evidence, unused = {}, dict[str, list[str]](), {}, {}, {}
    segments = np.array([body.segments[p] if p >= 0 else "" for p in on])
    for i, label in enumerate(labels):
        if on[i] < 0:
            unused[label] = "at or moving with no segment of the standing person"
            continue
        # evidence: distance from the landmark, and constant distances on its segment
        segment, joint = body.segments[on[i]], body.joints[on[i]]
        mates = scatter[i, (segments == segment) & (np.arange(len(labels)) != i)]
        reasons = ["likely" if placed.ahead[i] < BEYOND_DOUBT else "sure of the segment"]
        if body.labels[on[i]]:
            distance = 1e3 * placed.away[i] * placed.height
            reasons.append(f"{distance:.0f} mm from this landmark according to the other markers")
        if np.isfinite(mates).any():
            reasons.append(
                f"constant distance from markers of {segment} within "
                f"{1e3 * np.nanmedian(mates):.0f} mm"
            )
        evidence[label] = ", ".join(reasons)
        # a landmark, a marker that never moves, or one that follows its segment
        if body.labels[on[i]]:
            rename[label] = body.labels[on[i]]
        elif np.isfinite(scatter).any() and not np.isfinite(scatter[i]).any():
            unused[label] = f"on {segment}, but not in any trial with movement"
        else:
            tracking.setdefault(segment, []).append(label)
            if joint == "head":
                weights[label] = 0.0
    # landmarks under gliding skin are not fitted if other markers track the segment
    for name in rename.values():
        segment = body.segments[body.labels.index(name)]
        if name.startswith(GLIDING) and len(tracking.get(segment, ())) >= CLUSTER:
            weights[name] = 0.0
    return LabelProposal(
        rename=rename,
        tracking={segment: tuple(group) for segment, group in sorted(tracking.items())},
        weights=weights,
        evidence=evidence,
        unused=unused,
        basis="",
    )
