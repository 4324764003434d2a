"""What markers are whose labels say nothing: which landmark each may be, else which segment it
moves with; to be asked.

One recording stands, the others move. Height, heading and posture of the arms are tried in turn
(`place_markers`); the likeliest is kept, unless the opposite heading is nearly as likely.
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
"""How far both feet must say the same of the way forward to be believed without asking where feet
and pelvis point.
"""
# Log of the odds, 100 to 1, from which left and right, or a segment, are told without a doubt
BEYOND_DOUBT = 4.6
ONE_IN_20, ONE_IN_100 = 7.81, 11.34
"""Chi-squared of three, which one landmark in so many exceeds: of one in a hundred a person is
asked.
"""
FLOOR_M = 0.02  # Of the lowest marker over the floor
TALL, STEP, STEPS = 1.03, 1.06, 12
"""Heights that are tried: the highest marker's, as if it were over the head, and so on to where it
is on the pelvis.
"""
NEAREST = 5
LIKELIEST = 3  # Of these heights, where one is told
# Standard deviation of a height that is told, as a share, against that by which markers fit best
HEIGHT_TOLD = 0.03
FEWEST_MARKERS = 10
WALKS_M, RESTS_M = 0.1, 0.01
"""RMS distance from their mean place of markers on feet that walk, on a treadmill, too, and of
those in the room.
"""
# Share of the markers that another one is on a segment with: all but some wrist, elbow or shoulder
WITH_ANOTHER = 0.75
ALONE = 0.09
"""Half as far from the middle as a posterior superior iliac spine, as a share of the distance of
the anterior ones.
"""
GLIDING, CLUSTER = ("knee_", "toe_"), 3
"""Landmarks over which skin glides, or that bend, and of how many other markers a segment needs to
do without them.
"""
KNEE, KNEE_SPREAD = 0.27, 0.08
"""Height of the knee, and how far a device's markers may be above or below, as shares of the
body's.
"""
DEVICE = ("knee_axis", "knee_device_2", "knee_device_3")


@dataclass(frozen=True, kw_only=True)
class LabelProposal:
    """What each label may mean."""

    rename: Mapping[str, str]  # Label -> landmark, as the marker set "landmarks" names it
    tracking: Mapping[
        str, tuple[str, ...]
    ]  # Segment -> labels of the other markers that move with it
    weights: Mapping[str, float]  # Label, of a landmark its name -> 0: shown only
    evidence: Mapping[str, str]  # Label -> by what it was told, in words
    unused: Mapping[str, str]  # Label -> why it is nowhere
    asked: frozenset[str] = frozenset()
    """Labels of `rename` that lie where few markers of that landmark do, or that no trial shows
    moving and that may be of another segment: not named so unless a person says it.
    """
    basis: str  # By what height and heading were told, in words


def propose_labels(recordings: Sequence[Recording], height: float | None = None) -> LabelProposal:
    """What the labels of recordings mean that all name the same markers; `height` in m, where
    somebody tells it.

    InputError where nobody stands still, or where it cannot be told which way the person faces.
    """
    standing = min(recordings, key=_measure_sway)
    moving = [r for r in recordings if r is not standing]
    every, scatter, points, seen, why = _collect_markers(standing, moving)
    rows = np.isfinite(scatter).any(axis=1)
    if (
        rows.any()
        and (
            share := float(
                (unnamed_markers.compute_segment_log_odds(scatter)[rows] > 0).any(axis=1).mean()
            )
        )
        < WITH_ANOTHER
    ):
        raise InputError(
            f"{100 * share:.0f} % of the labels keep their distance from another one in all "
            "recordings, as markers of "
            f"one segment do; {100 * WITH_ANOTHER:.0f} % or more are needed: a label has to name "
            "the same marker "
            "in all files",
            code=Code.LANDMARKS,
        )
    forward = unnamed_markers.estimate_forward_direction(
        moving, points[seen], [every[i] for i in seen]
    )
    placed, view, told = _fit_likeliest_body(
        *_select_evidence(seen, points, scatter), forward, height
    )
    still_only = [every[i] for i in seen if not np.isfinite(scatter[i]).any()]
    devices = _find_knee_devices(
        standing, still_only, view.origin[1] + KNEE * placed.height, KNEE_SPREAD * placed.height
    )
    on_device = {label for parts in devices for label in parts}
    if on_device:
        seen = [i for i in seen if every[i] not in on_device]
        placed, view, told = _fit_likeliest_body(
            *_select_evidence(seen, points, scatter), forward, height
        )
    placed = _drop_lone_forearms(placed, view, *_select_evidence(seen, points, scatter))
    labels = [every[i] for i in seen]
    found = _read_labels(labels, placed, scatter[np.ix_(seen, seen)])
    odd = dict(
        zip(
            labels,
            unnamed_markers.compute_misplacement(view.transform_to_body(points[seen]), placed),
            strict=True,
        )
    )
    unsure = {
        m
        for m, ahead in zip(labels, placed.ahead, strict=True)
        if m in still_only and ahead < BEYOND_DOUBT
    }
    segment = {m: placed.body.segments[p] for m, p in zip(labels, placed.places, strict=True)}
    found = _identify_sacrum(found, {label: points[i] for i, label in enumerate(every)})
    out = {
        label: float(view.transform_to_body(points[[every.index(label)]])[0, 2])
        for label in on_device
    }
    rods: dict[str, str] = {}
    for parts in devices:
        outwards = sorted(parts, key=lambda label: -abs(out[label]))
        side = SIDES[0] if out[outwards[0]] > 0 else SIDES[1]
        rods |= {label: f"{part}_{side}" for label, part in zip(outwards, DEVICE, strict=True)}
    words = dict.fromkeys(
        rods, "at the knee, as far from two others as the markers of a knee alignment device are"
    )
    known = {every[i] for i in seen} | on_device
    return LabelProposal(
        rename={**found.rename, **rods},
        tracking=found.tracking,
        weights=found.weights,
        evidence={**found.evidence, **words},
        unused={
            **found.unused,
            **why,
            **{m: "never seen with the others" for m in every if m not in known},
        },
        asked=frozenset(
            m
            for m in found.rename
            if m in unsure or (odd[m] > ONE_IN_100 and segment[m] in LOWER_BODY)
        ),
        basis=f"{told}; {PureWindowsPath(standing.source).name} stands",
    )


def place_unknown_markers(
    standing: Recording,
    moving: Sequence[Recording],
    segment_of: Mapping[str, str],
    lacking: Sequence[str] = (),
    height: float | None = None,
) -> LabelProposal:
    """Which segments the labels move with that a set does not know; `segment_of`: label that it
    knows -> segment.

    Of each landmark in `lacking`, which nothing gives, the label is told that lies there: only a
    person names it so. InputError as of `propose_labels`.
    """
    every, scatter, points, seen, why = _collect_markers(standing, moving, segment_of)
    at = {
        m: place
        for m, place in zip(every, points, strict=True)
        if m not in segment_of and np.isfinite(place).all()
    }
    why |= {
        m: "in no trial that moves"
        for m, row in zip(every, scatter, strict=True)
        if not np.isfinite(row).any()
    }
    seen = [i for i in seen if every[i] in segment_of or every[i] not in why]
    labels, body = [every[i] for i in seen], unnamed_markers.load_standing_bodies()[0]
    points, beside = _select_evidence(seen, points, scatter)
    segments, scatter = np.array(body.segments), scatter[np.ix_(seen, seen)]
    own = [segment_of.get(label) for label in labels]
    allowed = np.array(
        [~body.landmark if segment is None else segments == segment for segment in own]
    )
    known = [k for k, segment in enumerate(own) if segment is not None]
    forward = unnamed_markers.estimate_forward_direction(
        moving, points[known], [labels[k] for k in known]
    )
    placed, view, told = _fit_likeliest_body(
        points, replace(beside, allowed=allowed), forward, height
    )
    found = _read_labels(labels, placed, scatter)
    lies = _describe_nearby_landmarks(
        lacking, at, view, points[known], replace(placed, places=placed.places[known])
    )
    near_two = {m for m, ahead in zip(labels, placed.ahead, strict=True) if ahead < BEYOND_DOUBT}
    why |= dict.fromkeys(sorted(near_two), "moves with two segments about as well") | dict(
        found.unused
    )
    why |= {m: "never seen with the others" for m in every if m not in labels and m not in why}
    place = segments[placed.places]
    same = beside.known & (place[:, None] == place)
    loose = {
        m
        for m, t, mates in zip(labels, beside.log_odds, same, strict=True)
        if mates.any() and t[mates].mean() < 0
    }
    why |= dict.fromkeys(
        sorted(loose - near_two), "does not keep its distance from the segment on which it stands"
    )
    alone = {m for s, group in found.tracking.items() if s not in own for m in group}
    why |= dict.fromkeys(
        sorted(alone - near_two - loose), "on a segment of which the set knows no marker"
    )
    out = {*segment_of, *near_two, *loose, *alone}
    apart = {s: tuple(m for m in group if m not in out) for s, group in found.tracking.items()}
    tracking = {segment: group for segment, group in apart.items() if group}
    kept = [label for group in tracking.values() for label in group]
    return LabelProposal(
        rename={},
        tracking=tracking,
        weights={label: weight for label, weight in found.weights.items() if label in kept},
        evidence={label: found.evidence[label] + lies.get(label, "") for label in kept},
        unused={
            label: words + lies.get(label, "")
            for label, words in why.items()
            if label not in segment_of
        },
        basis=told,
    )


def _describe_nearby_landmarks(
    lacking: Sequence[str],
    at: Mapping[str, Array],
    view: "_View",
    points: Array,
    placed: unnamed_markers.PlacedMarkers,
) -> dict[str, str]:
    """Label -> at which landmark it lies, in words: of each that lacks the nearest one, (3,) m in
    `at`, if 19 in 20 are as near to where the markers that stand at `points` put it.
    """
    out = {}
    for name in (name for name in lacking if name in placed.body.labels):
        places = np.append(placed.places, placed.body.labels.index(name))
        with_one = replace(placed, places=places)
        away = {
            m: unnamed_markers.compute_misplacement(
                view.transform_to_body(np.vstack([points, p])), with_one
            )[-1]
            for m, p in at.items()
        }
        nearest = min(away, key=away.__getitem__, default="")
        if nearest and away[nearest] < ONE_IN_20:
            out[nearest] = f"; lies where {name} does: rename it, if it is"
    return out


def _collect_markers(
    standing: Recording, moving: Sequence[Recording], named: Collection[str] = ()
) -> tuple[list[str], Array, Array, list[int], dict[str, str]]:
    """All labels of markers, (n, n) m scatter of their distances, (n, 3) m where they stand, the
    numbers of those seen, and label -> why it is no marker on a person, of which nothing else is
    said; those `named` are.
    """
    why = _find_resting_points(standing, moving)
    every = list(dict.fromkeys(m for r in (standing, *moving) for m in r.labels if m not in why))
    why |= {
        m: "another path under the name of a marker" for m in every if m.rpartition("#")[0] in named
    }
    every = [m for m in every if m not in why]
    scatter = unnamed_markers.compute_distance_scatter(moving, every)
    words = "keeps its distance from another one better than markers do: computed"
    markers = np.array([not named or m in named for m in every])
    standing_at = unnamed_markers.measure_standing_points(standing, every)
    why |= {
        every[i]: words
        for i in _find_computed_points(scatter, markers, standing_at)
        if every[i] not in named
    }
    standing_at = standing_at[[m not in why for m in every]]
    every = [m for m in every if m not in why]
    scatter = unnamed_markers.compute_distance_scatter(moving, every, standing_at)
    points = unnamed_markers.place_missing_markers(standing_at, every, moving, scatter)
    seen = [i for i in range(len(every)) if np.isfinite(points[i]).all()]
    if len(seen) < FEWEST_MARKERS:
        message = (
            f"{len(seen)} markers are seen while somebody stands; {FEWEST_MARKERS} or more are "
            "needed"
        )
        raise InputError(message, code=Code.LANDMARKS)
    return every, scatter, points, seen, why


def _find_computed_points(scatter: Array, markers: BoolArray, points: Array) -> list[int]:
    """Numbers of the points that keep their distance from another one as no two markers do, of a
    pair of them that stand at `points` (n, 3) m those that `computed_of_pair` says; none where most
    of the points do that are held for `markers` (n,), as those of a made-up person.
    """
    apart = np.where(np.isfinite(scatter), scatter, np.inf)
    np.fill_diagonal(apart, np.inf)
    together = apart < MEASURED_M
    rigid: BoolArray = np.asarray(together.any(axis=1))
    moving = markers & np.isfinite(apart).any(axis=1)
    if 2 * (rigid & moving).sum() > moving.sum():
        return []
    middle = np.nanmean(points, axis=0)
    for i, k in zip(*np.nonzero(np.triu(together)), strict=True):
        if together[i].sum() == together[k].sum() == 1 and np.isfinite(points[[i, k]]).all():
            rigid[[i, k]] = identify_computed_points(points[i], points[k], middle)
    return np.flatnonzero(rigid).tolist()


def _measure_sway(recording: Recording) -> float:
    """m, RMS distance from its mean place of the marker that moves more than nine in ten."""
    away = list(_measure_sways(recording).values())
    return float(np.quantile(away, 0.9)) if len(away) >= FEWEST_MARKERS else np.inf


def _find_resting_points(standing: Recording, moving: Sequence[Recording]) -> dict[str, str]:
    """Label of what is not on the person -> why: it stays where the lowest quarter of the markers
    walks, and is at the same place in all recordings, as no foot is that is seen while it stands.
    """
    found: set[str] = set()
    places: dict[str, list[Array]] = {}
    for recording in (standing, *moving):
        away, markers = (
            _measure_sways(recording),
            dict(zip(recording.labels, recording.markers.swapaxes(0, 1), strict=True)),
        )
        for label in away:
            places.setdefault(label, []).append(np.nanmean(markers[label], axis=0))
        low = sorted((places[m][-1][1], m) for m in away)
        if (
            away
            and recording is not standing
            and np.median([away[m] for _, m in low[: -(-len(low) // 4)]]) > WALKS_M
        ):
            found |= {label for label in away if away[label] < RESTS_M}
    # In the order of the files: that of a set differs from run to run.
    rests = (
        m
        for m, at in places.items()
        if m in found and len(at) > 1 and np.ptp(at, axis=0).max() < RESTS_M
    )
    return dict.fromkeys(rests, "stays where it is while the person walks")


def _measure_sways(recording: Recording) -> dict[str, float]:
    """Label -> m, RMS distance from its mean place, where it is seen."""
    seen = find_visible(recording.markers)
    paths = {
        m: recording.markers[seen[:, i], i]
        for i, m in enumerate(recording.labels)
        if seen[:, i].any()
    }
    return {
        m: float(np.sqrt(np.square(path - path.mean(axis=0)).sum(axis=1).mean()))
        for m, path in paths.items()
    }


def _find_knee_devices(
    standing: Recording, labels: Sequence[str], knee: float, spread: float
) -> list[tuple[str, str, str]]:
    """Threes of markers, of the standing trial only, as far from each other as those of a device,
    and at a knee (m).
    """
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
    for three in combinations(paths, 3):
        if not any(set(three) & set(other) for other in out) and is_device(
            *(paths[label] for label in three)
        ):
            out.append(three)
    return out


def _select_evidence(
    rows: Sequence[int], points: Array, scatter: Array
) -> tuple[Array, unnamed_markers.MotionEvidence]:
    """Where some of the markers stand, and what is known of them besides."""
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
    """How a standing person is seen: `heading` (x, z) and `origin`, (3,) m, on the floor in the
    body's middle.
    """

    heading: Array
    origin: Array

    def transform_to_body(self, points: Array) -> Array:
        """(n, 3) m: forward, up, to the right."""
        away = points - self.origin
        ahead, right = self.heading, np.array([-self.heading[1], self.heading[0]])
        return np.column_stack([away[:, [0, 2]] @ ahead, away[:, 1], away[:, [0, 2]] @ right])


def _fit_likeliest_body(
    points: Array, evidence: unnamed_markers.MotionEvidence, forward: Array, height: float | None
) -> tuple[unnamed_markers.PlacedMarkers, _View, str]:
    """The markers on the likeliest body, how it is seen, and how that was told."""
    floor = points[:, 1].min() - FLOOR_M
    above = points[:, 1] - floor
    low = points[above < 0.6 * above.max()][:, [0, 2]]
    middle = 0.5 * (low.max(axis=0) + low.min(axis=0))
    said = float(np.linalg.norm(forward))
    axes = np.linalg.eigh(np.cov(low.T))[1].T
    walks = said > BOTH_FEET
    if walks:
        axes = np.array([forward, [-forward[1], forward[0]]]) / said
    headings = [sign * axis for axis in axes for sign in (1.0, -1.0)]  # that of the feet first
    usual, spread = (
        (height, HEIGHT_TOLD * height)
        if height
        else (unnamed_markers.HEIGHT_M, unnamed_markers.HEIGHT_SD_M)
    )

    def seen_from(heading: Array) -> _View:
        ahead = float(np.median((points[:, [0, 2]] - middle)[above < 0.5 * above.max()] @ heading))
        return _View(heading, np.insert(middle + ahead * heading, 1, floor))

    def cost(placed: unnamed_markers.PlacedMarkers) -> float:
        return placed.cost + 0.5 * ((placed.height - usual) / spread) ** 2

    heights = above.max() / TALL * STEP ** np.arange(STEPS)
    heights = heights[np.argsort(np.abs(heights - usual))][: None if height is None else NEAREST]
    hanging, *_ = bodies = unnamed_markers.load_standing_bodies()
    views = [seen_from(heading) for heading in headings]
    seen, tried = [view.transform_to_body(points) for view in views], []
    for k, tall in product(range(len(views)), heights):
        tried.append(
            (
                cost(unnamed_markers.place_markers(seen[k], hanging, tall, evidence, rounds=4)),
                float(tall),
                k,
            )
        )
    best = {k: sorted(t for t in tried if t[2] == k)[:LIKELIEST] for k in range(len(headings))}
    whole = {
        k: min(
            (
                unnamed_markers.place_markers(seen[k], body, tall, evidence)
                for _, tall, _ in best[k]
                for body in bodies
            ),
            key=cost,
        )
        for k in {*sorted(best, key=lambda k: best[k][0])[:2], *([0] if walks else [])}
    }
    for k, found in whole.items():
        for side in SIDES:  # both arms alike so far
            armed = (found.body.replace_arm(side, body) for body in bodies)
            tried_too = [
                unnamed_markers.place_markers(seen[k], body, found.height, evidence)
                for body in armed
            ]
            found = min((found, *tried_too), key=cost)
        whole[k] = found
    chosen = min(whole, key=lambda k: cost(whole[k]))
    if walks and cost(whole[0]) - cost(whole[chosen]) > BEYOND_DOUBT:
        raise InputError(
            "it cannot be told which way the person faces: feet swing otherwise than feet and "
            "pelvis point, as of who "
            "walks backward or sideways; a walk forward among the recordings tells it",
            code=Code.LANDMARKS,
        )
    chosen = 0 if walks else chosen
    odds = min((cost(whole[k]) - cost(whole[chosen]) for k in whole if k != chosen), default=np.inf)
    if not walks and odds < BEYOND_DOUBT:
        raise InputError(
            "it cannot be told which way the person faces: nobody walks, and feet and pelvis fit "
            "forward and backward; "
            "a walk among the recordings tells it",
            code=Code.LANDMARKS,
        )
    how = (
        f"both feet swing forward (agreement {said:.2f})"
        if walks
        else "feet and pelvis point forward"
    )
    return whole[chosen], views[chosen], f"{how}; fits a person of {whole[chosen].height:.2f} m"


def _drop_lone_forearms(
    placed: unnamed_markers.PlacedMarkers,
    view: _View,
    points: Array,
    beside: unnamed_markers.MotionEvidence,
) -> unnamed_markers.PlacedMarkers:
    """Markers placed again without a forearm if neither its upper arm nor the trunk has a marker: a
    cluster of the thigh lies where hands hang.
    """
    segments = np.array(placed.body.segments)
    on = set(segments[placed.places[placed.places >= 0]].tolist())
    lone = [
        f"forearm_hand_{s}"
        for s in SIDES
        if f"forearm_hand_{s}" in on and not on & {f"upper_arm_{s}", "head_trunk"}
    ]
    if not lone:
        return placed
    without = replace(beside, allowed=beside.allowed & ~np.isin(segments, lone))
    return unnamed_markers.place_markers(
        view.transform_to_body(points), placed.body, placed.height, without
    )


def _identify_sacrum(found: LabelProposal, at: Mapping[str, Array]) -> LabelProposal:
    """The proposal with a single marker behind the pelvis as that on the sacrum, where it lies in
    the middle.
    """
    back = {
        name: label
        for label, name in found.rename.items()
        if name.startswith(("asis", "psis", "sacrum"))
    }
    if len(back) != 3 or not {"asis_r", "asis_l"} <= set(back) or "sacrum" in back:
        return found
    (label,) = (label for name, label in back.items() if name.startswith("psis"))
    across = at[back["asis_r"]] - at[back["asis_l"]]
    aside = float(
        (at[label] - 0.5 * (at[back["asis_r"]] + at[back["asis_l"]])) @ across / (across @ across)
    )
    if abs(aside) > ALONE:
        return found
    words = (
        f"alone behind the pelvis, {1e3 * abs(aside) * np.linalg.norm(across):.0f} mm from its "
        "middle"
    )
    return replace(
        found, rename={**found.rename, label: "sacrum"}, evidence={**found.evidence, label: words}
    )


def _read_labels(
    labels: Sequence[str], placed: unnamed_markers.PlacedMarkers, scatter: Array
) -> LabelProposal:
    """What the places of markers say of their labels."""
    body, on = placed.body, placed.places
    rename, tracking, weights, evidence, unused = {}, dict[str, list[str]](), {}, {}, {}
    segments = np.array([body.segments[p] if p >= 0 else "" for p in on])
    for i, label in enumerate(labels):
        if on[i] < 0:
            unused[label] = "on no segment of a standing person, or moves with none"
            continue
        segment, joint = body.segments[on[i]], body.joints[on[i]]
        mates = scatter[i, (segments == segment) & (np.arange(len(labels)) != i)]
        words = ["likely" if placed.ahead[i] < BEYOND_DOUBT else "sure of the segment"]
        if body.labels[on[i]]:
            words.append(
                f"{1e3 * placed.away[i] * placed.height:.0f} mm from where the others put this "
                "landmark"
            )
        if np.isfinite(mates).any():
            words.append(
                f"keeps its distance from markers of {segment} to {1e3 * np.nanmedian(mates):.0f} "
                "mm"
            )
        evidence[label] = ", ".join(words)
        if body.labels[on[i]]:
            rename[label] = body.labels[on[i]]
        elif np.isfinite(scatter).any() and not np.isfinite(scatter[i]).any():
            unused[label] = f"on {segment}, but in no trial that moves"
        else:
            tracking.setdefault(segment, []).append(label)
            if joint == "head":
                weights[label] = 0.0
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
