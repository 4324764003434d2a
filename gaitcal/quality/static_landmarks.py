"""The landmarks of a static trial against the body of a person: exchanged, displaced, or of another
height.

Which fault would explain that their measures are not those of a body? Every candidate changes the
landmarks p to p' and is judged by J of `body_plan.py`:

    exchange    two landmarks, or two groups of them, carry each other's labels:  J(p')
    displaced   one landmark lies d elsewhere:  min over d of  J(p with p_k - d) + |d|^2 / D^2      (Gauss-Newton)

The candidate with the least cost is told if it saves enough; what it leaves is searched again, as
faults come together. Candidates that cost hardly more than the best are told beside it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, Finding, Severity, listed
from gaitcal.model import linkage, marker_set
from gaitcal.model.body_plan import (
    HIP_HEIGHT,
    LandmarkMeasure,
    Landmarks,
    compute_body_axes,
    compute_build_cost,
    measure_landmarks,
    sum_squared_deviations,
)
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.trial_role import measure_standing_legs

EXCHANGE_SAVES = 12.0
"""Least gain of J that an exchange is told for: on clean recordings the best one costs 15 more than
none.
"""
DISPLACED_SAVES = 18.0
"""Least gain of J that a displaced landmark is told for. On the thirteen recordings one saves at
most 11.5; where all landmarks are put on with 3 mm of error along each axis, which makes J what it
is there, none of 50 is told, with 4 mm 1 or 2."""
DISPLACED_M = 0.022  # Smallest displacement told
SPREAD_M = 0.060  # D: landmarks that are wrong are rarely wrong by more
RIVAL = 6.0  # Candidates within this much of the best J (odds of 20 to 1) are told beside it
BUILD_SAVES = 12.0
"""By how much build and stance must explain the measures better than one landmark does for none to
be blamed: people whose joint axes are turned at random by up to 10 deg in every segment save 17 to
160; one landmark displaced by 30 to 60 mm, never more than 8."""
SUSPICIOUS_Z = 2.2  # Largest |z| up to which nothing is searched
MOST_FAULTS = 3
TALLER = np.exp(np.linspace(-0.5, 0.5, 101))  # Factors of body height that are tried
HEIGHT_OFF, HEIGHT_SAVES = 0.075, 12.0
"""Departure from 1 of the factor that fits best, and gain of J, from which body height is doubted:
0.961 to 1.041, and 6 at most, on clean recordings of grown people and children."""
STEPS = 6
STEP_M = 1e-4

LEG = ("knee_lat", "knee_med", "ankle_lat", "ankle_med", "heel", "toe")
LEGS_REPORTED, LEGS_DOUBTED = 1.96, 3.29
"""Standard deviations of people's legs beside a body height: beyond lie 1 person in 20 and 1 in
1000.
"""
IMPOSSIBLE_Z = 5.5  # Standard deviations from which no body has such a length
GROSS_M = 0.060
"""A landmark this far off moves a joint centre by more than the 20 mm that its prior allows: the
trial is refused.
"""
EVIDENCE = 3  # Measures that are told as evidence
_DIRECTIONS = (("back", "forward"), ("down", "up"), ("left", "right"))


@dataclass(frozen=True, kw_only=True)
class SwappedLandmarks:
    """Landmarks that carry each other's labels."""

    pairs: tuple[tuple[str, str], ...]
    before: tuple[LandmarkMeasure, ...]  # The measures that spoke against it, the worst first


@dataclass(frozen=True, kw_only=True)
class DisplacedLandmark:
    """One landmark that lies elsewhere than on its bone."""

    landmark: str
    away: Array  # (3,) m, by how much it lies off, in body axes: forward, up, right
    rivals: tuple[
        tuple[str, float], ...
    ]  # Other landmarks of which the same could be said, and their m
    before: tuple[LandmarkMeasure, ...]

    @property
    def size(self) -> float:
        """Its distance from there, m."""
        return float(np.linalg.norm(self.away))


def estimate_height_factor(p: Landmarks, height: float, *, even: bool = True) -> float:
    """Factor of the given body height (m) that all lengths together ask for; 1 where they agree
    with it.
    """
    lengths = [
        (m.value, m.mean, m.sd) for m in measure_landmarks(p, height, even=even) if m.absolute
    ]  # others know no height
    value, mean, sd = np.reshape(lengths, (-1, 3)).T
    costs = ((value / TALLER[:, None] - mean) ** 2 / sd**2).sum(axis=1)
    best = int(np.argmin(costs))
    gain = float(costs[len(costs) // 2] - costs[best])
    factor = float(TALLER[best])
    return factor if abs(factor - 1.0) > HEIGHT_OFF and gain > HEIGHT_SAVES else 1.0


def find_faults(
    p: Landmarks, height: float, *, even: bool = True
) -> Iterator[SwappedLandmarks | DisplacedLandmark]:
    """What is wrong with the landmarks p ((3,) m each, y up) of a person of this height (m), one
    after another.

    `even`: the person stands on both straight legs, so that right and left are alike in posture,
    too.
    """
    p = dict(p)
    for _ in range(MOST_FAULTS):
        found = _find_worst_fault(p, height, even)
        if found is None:
            return
        yield found
        if isinstance(found, DisplacedLandmark):
            return
        p = swap_landmarks(p, found.pairs)


def swap_landmarks(p: Landmarks, pairs: tuple[tuple[str, str], ...]) -> dict[str, Array]:
    """The landmarks with these pairs carrying each other's positions."""
    out = dict(p)
    for a, b in pairs:
        out[a], out[b] = p[b], p[a]
    return out


def _find_worst_fault(
    p: Landmarks, height: float, even: bool
) -> SwappedLandmarks | DisplacedLandmark | None:
    present = measure_landmarks(p, height, even=even)
    worst = sorted(present, key=lambda m: -abs(m.z))
    if not worst or abs(worst[0].z) < SUSPICIOUS_Z:
        return None
    j = sum_squared_deviations(present)
    best, pairs = min(
        (
            (sum_squared_deviations(measure_landmarks(swap_landmarks(p, c), height, even=even)), c)
            for c in _list_swaps(p)
        ),
        key=lambda found: found[0],
    )
    moved = sorted(
        (_fit_displacement(p, height, name, even) for name in p if name != "sacrum"),
        key=lambda found: found[1],
    )
    suspicious = tuple(m for m in worst if abs(m.z) >= SUSPICIOUS_Z)
    if j - best > EXCHANGE_SAVES and best < moved[0][1] + RIVAL:
        return SwappedLandmarks(pairs=pairs, before=suspicious)
    name, least, away = moved[0]
    if j - least < DISPLACED_SAVES or np.linalg.norm(away) < DISPLACED_M:
        return None
    if compute_build_cost(p, height, even=even) < least - BUILD_SAVES:
        # somebody who is built so, or stands so: many landmarks lie otherwise, and no one is to
        # blame
        return None
    rivals = tuple((n, float(np.linalg.norm(a))) for n, c, a in moved[1:] if c - least < RIVAL)
    return DisplacedLandmark(landmark=name, away=away, rivals=rivals, before=suspicious)


def _list_swaps(p: Landmarks) -> Iterator[tuple[tuple[str, str], ...]]:
    """Exchanges that people make: sides of a landmark, joint, segment or leg; the two sides of a
    joint; two joints.
    """

    def there(*pairs: tuple[str, str]) -> tuple[tuple[str, str], ...]:
        return tuple(pair for pair in pairs if pair[0] in p and pair[1] in p)

    def sides(*names: str) -> tuple[tuple[str, str], ...]:
        return there(*((f"{name}_r", f"{name}_l") for name in names))

    groups: list[tuple[str, ...]] = [
        *((name,) for name in ("asis", *LEG)),
        LEG[:2],
        LEG[2:4],
        LEG[4:],
        LEG[2:],
    ]
    groups += [("knee_med", "ankle_med"), LEG, ("asis", *LEG), LEG[:4]]
    found = [sides(*group) for group in groups]
    for joint in ("knee", "ankle"):
        across = [there((f"{joint}_lat_{side}", f"{joint}_med_{side}")) for side in linkage.SIDES]
        found += [*across, across[0] + across[1]]
    for side, end in product(linkage.SIDES, ("lat", "med")):
        found.append(there((f"knee_{end}_{side}", f"ankle_{end}_{side}")))
    found += [there((f"heel_{side}", f"toe_{side}")) for side in linkage.SIDES]
    found.append(there(*((f"heel_{side}", f"toe_{side}") for side in linkage.SIDES)))
    yield from dict.fromkeys(pairs for pairs in found if pairs)
    yield ()


def _fit_displacement(
    p: Landmarks, height: float, name: str, even: bool
) -> tuple[str, float, Array]:
    """The landmark, the least cost with it put elsewhere, and by how much it lies off (3,) m, in
    body axes.
    """

    def residuals(d: Array) -> Array:
        there = {**p, name: p[name] - d}
        return np.array(
            [*(m.z for m in measure_landmarks(there, height, even=even)), *(d / SPREAD_M)]
        )

    d = np.zeros(3)
    r = residuals(d)
    damping = 1e-3
    for _ in range(STEPS):
        J = np.stack([(residuals(d + STEP_M * e) - r) / STEP_M for e in np.eye(3)], axis=1)
        H = J.T @ J
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), -J.T @ r)
        new = residuals(d + step)
        if new @ new < r @ r:
            d, r, damping = d + step, new, 0.1 * damping
            if np.linalg.norm(step) < 1e-4:
                break
        else:
            damping = max(10 * damping, 0.1)
    axes = compute_body_axes(p)
    return name, float(r @ r), d if axes is None else d @ axes


def check_proportions(trial: TrialEvidence) -> Iterator[Finding]:
    """Landmarks that carry each other's labels, or lie off their bones, in a static trial; a height
    that is wrong.
    """
    p = collect_landmarks(trial)
    if not p:
        return
    given, below = trial.subject.height, measure_hip_height(trial)
    if below is not None and below < 0:
        yield trial.error(
            "landmarks",
            f"the ASIS lie {-below:.2f} m below the ankles",
            "write the file with its vertical axis upwards",
            cause="the vertical axis of the static trial points down",
            weight=10.0,
            code=Code.NOT_UPRIGHT,
        )
        return
    if any(name not in p for name in marker_set.REQUIRED):
        # told already as what keeps the nominal model from being made: the rest would be read askew
        # without it
        return
    found = list(find_faults(p, given))
    if any(isinstance(fault, DisplacedLandmark) for fault in found):
        # A leg that is bent or lifted looks like landmarks off their bones: then only what posture
        # leaves alone counts.
        stands = measure_standing_legs(p, given)
        even = stands is None or not (stands.uneven or stands.bent or stands.sitting)
        found = found if even else list(find_faults(p, given, even=False))
    swapped = [
        pairs for fault in found if isinstance(fault, SwappedLandmarks) for pairs in fault.pairs
    ]
    sound = swap_landmarks(p, tuple(swapped))
    stands = measure_standing_legs(sound, given)
    straight = stands is None or not (stands.bent or stands.sitting)
    factor = estimate_height_factor(sound, given, even=straight)
    legs = measure_hip_height(trial) if straight else None
    beyond = 0.0 if legs is None or found else abs(legs / given - HIP_HEIGHT[0]) / HIP_HEIGHT[1]
    if factor != 1.0 or beyond > LEGS_REPORTED:
        severity = Severity.INFO if factor == 1.0 and beyond < LEGS_DOUBTED else Severity.WARNING
        yield _report_height(trial, sound, severity, factor, legs)
        found = list(find_faults(p, factor * given))
    for fault in found:
        yield (
            _report_swap(trial, fault)
            if isinstance(fault, SwappedLandmarks)
            else _report_displacement(trial, fault)
        )
    if not found:
        yield from _check_impossible_lengths(trial, measure_landmarks(sound, factor * given))


def measure_hip_height(trial: TrialEvidence) -> float | None:
    """m, median height of the ASIS above the lateral malleoli."""
    paths = [
        trial.landmark(f"{name}_{side}") for name in ("asis", "ankle_lat") for side in linkage.SIDES
    ]
    if any(path is None for path in paths):
        return None
    up = np.array([path[:, 1] for path in paths if path is not None])
    difference = 0.5 * (up[0] + up[1] - up[2] - up[3])
    difference = difference[np.isfinite(difference)]
    return float(np.median(difference)) if len(difference) else None


def collect_landmarks(trial: TrialEvidence) -> dict[str, Array]:
    """Landmark -> (3,) m, of pelvis and legs, mean of the still window of a static trial; empty
    where there is none.
    """
    used = {"sacrum", *(f"{name}_{side}" for name in ("asis", *LEG) for side in linkage.SIDES)}
    return {name: point for name, point in (trial.posture or {}).items() if name in used}


def _report_swap(trial: TrialEvidence, fault: SwappedLandmarks) -> Finding:
    pairs = list_label_pairs(trial, fault.pairs)
    exchanged_labels = listed([f"'{a}' and '{b}'" for a, b in pairs], 4)
    if {"asis_r", "heel_r", "knee_lat_r"} <= {name for pair in fault.pairs for name in pair}:
        exchanged_labels = f"right and left ({exchanged_labels}), or an axis is mirrored: they"
    swaps = ", ".join(f'"{a}" = "{b}", "{b}" = "{a}"' for a, b in pairs)
    return trial.error(
        "landmarks",
        _format_measures(fault.before),
        "exchange the labels in this file or, where every trial that has them has them so, with "
        "[markers] rename = "
        f"{{ {swaps} }}",
        cause=f"{exchanged_labels} carry each other's labels in the static trial",
        leg=_get_leg(*(name for pair in fault.pairs for name in pair)),
        weight=10.0,
        code=Code.LANDMARKS_EXCHANGED,
    )


def _report_displacement(trial: TrialEvidence, fault: DisplacedLandmark) -> Finding:
    way = int(np.argmax(np.abs(fault.away)))
    where = _DIRECTIONS[way][int(fault.away[way] > 0)]
    name = describe_labels(trial, fault.landmark)
    rivals = [
        f"{describe_labels(trial, other)} by {1e3 * m:.0f} mm" for other, m in fault.rivals[:3]
    ]
    return trial.make_finding(
        Severity.ERROR if fault.size > GROSS_M else Severity.WARNING,
        "landmarks",
        _format_measures(fault.before)
        + (f"; as well it could be {' or '.join(rivals)}" if rivals else ""),
        "look where the marker sat (person, photograph, video), and record or label the static "
        "trial again",
        cause=f"{name} lies about {1e3 * fault.size:.0f} mm off its bone in the static trial, "
        f"mostly {where}",
        leg=_get_leg(fault.landmark),
        weight=fault.size / 0.02,
        code=Code.LANDMARK_DISPLACED,
    )


def _report_height(
    trial: TrialEvidence, p: Landmarks, severity: Severity, factor: float, legs: float | None
) -> Finding:
    given = trial.subject.height
    lengths = [m for m in measure_landmarks(p, given) if m.absolute and abs(m.z) > 1.0]
    found = ""
    if legs is not None:
        share, sd = HIP_HEIGHT
        found = (
            f"the ASIS stand {legs:.3f} m above the ankles; people of {given:.2f} m have "
            f"{share * given:.2f} m, "
        )
        found += f"SD {sd * given:.2f}; "
    likely = (
        f"all lengths together fit {factor * given:.2f} m"
        if factor != 1.0
        else "other lengths do not decide"
    )
    return trial.make_finding(
        severity,
        "height",
        f"{found}{likely}{'; ' + _format_measures(lengths) if factor != 1.0 and lengths else ''}",
        "correct subject.height_m, or the unit or scale of the markers",
        cause=f"a body height of {given:.2f} m does not go with the markers",
        weight=3.0,
        code=Code.BODY_HEIGHT,
    )


def _check_impossible_lengths(
    trial: TrialEvidence, found: Sequence[LandmarkMeasure]
) -> Iterator[Finding]:
    """Lengths that no body has, where no single fault explains them."""
    worst = [m for m in found if m.absolute and abs(m.z) > IMPOSSIBLE_Z]
    if worst:
        names = dict.fromkeys(name for m in worst for name in m.landmarks)
        cure = f"look at {', '.join(describe_labels(trial, name) for name in names)}: labels, place, unit"
        cause = "the static trial shows lengths that nobody has"
        yield trial.error(
            "landmarks",
            _format_measures(worst),
            cure,
            cause=cause,
            weight=10.0,
            code=Code.IMPOSSIBLE_LENGTHS,
        )


def _format_measures(found: Sequence[LandmarkMeasure]) -> str:
    worst = sorted(found, key=lambda m: -abs(m.z))
    return ", ".join(m.description for m in worst[:EVIDENCE])


def describe_labels(trial: TrialEvidence, landmark: str) -> str:
    """The markers of a landmark, in words."""
    labels = trial.marker_set.landmarks.get(landmark, (landmark,))
    return " and ".join(f"'{label}'" for label in labels)


def list_label_pairs(
    trial: TrialEvidence, pairs: tuple[tuple[str, str], ...]
) -> list[tuple[str, str]]:
    """The markers of exchanged landmarks, pair by pair."""
    of = trial.marker_set.landmarks
    return [
        labels for a, b in pairs for labels in zip(of.get(a, (a,)), of.get(b, (b,)), strict=False)
    ]


def _get_leg(*names: str) -> str:
    """The leg that all these landmarks belong to; empty for both."""
    sides = {name[-1] for name in names if name != "sacrum"}
    return sides.pop() if len(sides) == 1 else ""
