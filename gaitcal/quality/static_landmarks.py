"""Check the landmarks of a static trial: swapped, displaced, or of another body height.

Each possible fault changes the landmarks p to p' and is judged by J of `body_plan.py`:

    swapped     two landmarks, or two groups of them, have swapped labels:  J(p')
    displaced   one landmark is d off:  min over d of  J(p with p_k - d) + |d|^2 / D^2
                (Gauss-Newton)

The fault with the least cost is reported if it saves enough. The corrected landmarks are searched
again, as faults may be combined. Faults that cost hardly more than the best are reported with it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, Finding, Severity, join_names
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
"""Least gain of J for a reported swap: on clean recordings the best one costs 15 more than none."""
DISPLACED_SAVES = 18.0
"""Least gain of J for a reported displacement. On the thirteen recordings one saves at most 11.5;
with landmark errors of 3 mm along each axis, which give the J of these recordings, none of 50 is
reported, with 4 mm 1 or 2."""
DISPLACED_M = 0.022  # Smallest reported displacement
SPREAD_M = 0.060  # D: landmarks are rarely displaced by more
RIVAL = 6.0  # Faults within this much of the best J (odds of 20 to 1) are reported with it
BUILD_SAVES = 12.0
"""Gain of J by build and stance, relative to one displaced landmark, from which none is reported:
people whose joint axes are rotated at random by up to 10 deg in every segment save 17 to 160; one
landmark displaced by 30 to 60 mm, never more than 8."""
SUSPICIOUS_Z = 2.2  # Largest |z| up to which no fault is searched
MOST_FAULTS = 3
TALLER = np.exp(np.linspace(-0.5, 0.5, 101))  # Tried factors of body height
HEIGHT_OFF, HEIGHT_SAVES = 0.075, 12.0
"""Departure from 1 of the factor that fits best, and gain of J, from which body height is doubted:
0.961 to 1.041, and 6 at most, on clean recordings of grown people and children."""
STEPS = 6  # Gauss-Newton steps
STEP_M = 1e-4  # Step of the finite differences

LEG = ("knee_lat", "knee_med", "ankle_lat", "ankle_med", "heel", "toe")
LEGS_REPORTED, LEGS_DOUBTED = 1.96, 3.29
"""Standard deviations of leg length given body height, exceeded by 1 person in 20 and 1 in 1000."""
IMPOSSIBLE_Z = 5.5  # Standard deviations from which no body has such a length
GROSS_M = 0.060
"""A landmark this far off displaces a joint centre by more than the 20 mm that its prior allows: an
error."""
EVIDENCE = 3  # Number of measures in a finding
_DIRECTIONS = (("back", "forward"), ("down", "up"), ("left", "right"))


@dataclass(frozen=True, kw_only=True)
class SwappedLandmarks:
    """Landmarks with swapped labels."""

    pairs: tuple[tuple[str, str], ...]
    before: tuple[LandmarkMeasure, ...]  # Unusual measures without the swap, the worst first


@dataclass(frozen=True, kw_only=True)
class DisplacedLandmark:
    """One landmark that is displaced from its bone."""

    landmark: str
    away: Array  # (3,) m, displacement in body axes: forward, up, right
    rivals: tuple[tuple[str, float], ...]  # Other landmarks that explain as much, and their m
    before: tuple[LandmarkMeasure, ...]  # Unusual measures, the worst first

    @property
    def size(self) -> float:
        """Size of the displacement, m."""
        return float(np.linalg.norm(self.away))


def estimate_height_factor(p: Landmarks, height: float, *, even: bool = True) -> float:
    """Estimate the factor of body height that all lengths together require.

    `p`: landmarks, (3,) m each, y up. `height`: given body height, m. `even`: whether the person
    stands on both straight legs. Returns: 1 if the lengths agree with the given height.
    """
    lengths = [
        (m.value, m.mean, m.sd) for m in measure_landmarks(p, height, even=even) if m.absolute
    ]
    value, mean, sd = np.reshape(lengths, (-1, 3)).T
    # sum of squares for each tried height; 1 is in the middle
    costs = ((value / TALLER[:, None] - mean) ** 2 / sd**2).sum(axis=1)
    best = int(np.argmin(costs))
    gain = float(costs[len(costs) // 2] - costs[best])
    factor = float(TALLER[best])
    return factor if abs(factor - 1.0) > HEIGHT_OFF and gain > HEIGHT_SAVES else 1.0


def find_faults(
    p: Landmarks, height: float, *, even: bool = True
) -> Iterator[SwappedLandmarks | DisplacedLandmark]:
    """Find faults of landmarks, one after another.

    `p`: landmarks, (3,) m each, y up. `height`: body height, m. `even`: whether the person stands
    on both straight legs: then posture is the same on both sides. Yields: at most `MOST_FAULTS`; a
    displacement is the last one.
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
    """Swap the positions of pairs of landmarks.

    `p`: landmarks, (3,) m each. `pairs`: names of landmarks.
    """
    out = dict(p)
    for a, b in pairs:
        out[a], out[b] = p[b], p[a]
    return out


def _find_worst_fault(
    p: Landmarks, height: float, even: bool
) -> SwappedLandmarks | DisplacedLandmark | None:
    """Find the fault with the least cost; None if none saves enough."""
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
    # a swap is preferred to a displacement that explains about as much
    if j - best > EXCHANGE_SAVES and best < moved[0][1] + RIVAL:
        return SwappedLandmarks(pairs=pairs, before=suspicious)
    name, least, away = moved[0]
    if j - least < DISPLACED_SAVES or np.linalg.norm(away) < DISPLACED_M:
        return None
    if compute_build_cost(p, height, even=even) < least - BUILD_SAVES:
        # unusual build or stance explains the measures better than a single landmark
        return None
    rivals = tuple((n, float(np.linalg.norm(a))) for n, c, a in moved[1:] if c - least < RIVAL)
    return DisplacedLandmark(landmark=name, away=away, rivals=rivals, before=suspicious)


def _list_swaps(p: Landmarks) -> Iterator[tuple[tuple[str, str], ...]]:
    """List common swaps: sides of a landmark, joint or leg; lateral and medial; two joints."""

    def select_present(*pairs: tuple[str, str]) -> tuple[tuple[str, str], ...]:
        return tuple(pair for pair in pairs if pair[0] in p and pair[1] in p)

    def pair_sides(*names: str) -> tuple[tuple[str, str], ...]:
        return select_present(*((f"{name}_r", f"{name}_l") for name in names))

    groups: list[tuple[str, ...]] = [
        *((name,) for name in ("asis", *LEG)),
        LEG[:2],
        LEG[2:4],
        LEG[4:],
        LEG[2:],
    ]
    groups += [("knee_med", "ankle_med"), LEG, ("asis", *LEG), LEG[:4]]
    found = [pair_sides(*group) for group in groups]
    for joint in ("knee", "ankle"):
        across = [
            select_present((f"{joint}_lat_{side}", f"{joint}_med_{side}")) for side in linkage.SIDES
        ]
        found += [*across, across[0] + across[1]]
    for side, end in product(linkage.SIDES, ("lat", "med")):
        found.append(select_present((f"knee_{end}_{side}", f"ankle_{end}_{side}")))
    found += [select_present((f"heel_{side}", f"toe_{side}")) for side in linkage.SIDES]
    found.append(select_present(*((f"heel_{side}", f"toe_{side}") for side in linkage.SIDES)))
    yield from dict.fromkeys(pairs for pairs in found if pairs)
    yield ()


def _fit_displacement(
    p: Landmarks, height: float, name: str, even: bool
) -> tuple[str, float, Array]:
    """Fit the displacement of one landmark: its name, least cost, and (3,) m in body axes."""

    def compute_residuals(d: Array) -> Array:
        corrected = {**p, name: p[name] - d}
        return np.array(
            [*(m.z for m in measure_landmarks(corrected, height, even=even)), *(d / SPREAD_M)]
        )

    d = np.zeros(3)
    r = compute_residuals(d)
    damping = 1e-3
    for _ in range(STEPS):
        # Jacobian by forward differences; Levenberg-Marquardt step
        J = np.stack([(compute_residuals(d + STEP_M * e) - r) / STEP_M for e in np.eye(3)], axis=1)
        H = J.T @ J
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), -J.T @ r)
        new = compute_residuals(d + step)
        if new @ new < r @ r:
            d, r, damping = d + step, new, 0.1 * damping
            if np.linalg.norm(step) < 1e-4:
                break
        else:
            damping = max(10 * damping, 0.1)
    axes = compute_body_axes(p)
    return name, float(r @ r), d if axes is None else d @ axes


def check_proportions(trial: TrialEvidence) -> Iterator[Finding]:
    """Report landmarks of a static trial that are swapped or displaced, and a wrong body height.

    Parameters
    ----------
    trial
        The trial; moving trials are not checked.

    Yields
    ------
    Finding
        Errors, warnings and notes.
    """
    p = collect_landmarks(trial)
    if not p:
        return
    given, below = trial.subject.height, measure_hip_height(trial)
    if below is not None and below < 0:
        yield trial.error(
            "landmarks",
            f"the ASIS are {-below:.2f} m below the ankles",
            "export the file with its vertical axis upwards",
            cause="the vertical axis of the static trial points down",
            weight=10.0,
            code=Code.NOT_UPRIGHT,
        )
        return
    if any(name not in p for name in marker_set.REQUIRED):
        # reported already, as the nominal model cannot be built; other measures would be misleading
        return
    found = _find_faults_in_posture(p, given)
    swapped: list[tuple[str, str]] = []
    for fault in found:
        swapped += fault.pairs if isinstance(fault, SwappedLandmarks) else ()
    sound = swap_landmarks(p, tuple(swapped))
    posture = measure_standing_legs(sound, given)
    straight = posture is None or not (posture.bent or posture.sitting)
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


def _find_faults_in_posture(
    p: Landmarks, height: float
) -> list[SwappedLandmarks | DisplacedLandmark]:
    """Find faults; if the legs are bent or lifted, by measures independent of posture."""
    found = list(find_faults(p, height))
    # a bent or lifted leg looks like displaced landmarks
    if any(isinstance(fault, DisplacedLandmark) for fault in found):
        posture = measure_standing_legs(p, height)
        if posture is not None and (posture.uneven or posture.bent or posture.sitting):
            return list(find_faults(p, height, even=False))
    return found


def measure_hip_height(trial: TrialEvidence) -> float | None:
    """Measure the median height of the ASIS above the lateral malleoli.

    Returns: m; None if a landmark is missing.
    """
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
    """Collect the landmarks of pelvis and legs in the still window of a static trial.

    Parameters
    ----------
    trial
        Any trial.

    Returns
    -------
    dict of str to ndarray
        Landmark -> (3,) m; empty for a moving trial.
    """
    used = {"sacrum", *(f"{name}_{side}" for name in ("asis", *LEG) for side in linkage.SIDES)}
    return {name: point for name, point in (trial.posture or {}).items() if name in used}


def _report_swap(trial: TrialEvidence, fault: SwappedLandmarks) -> Finding:
    """Build the error on swapped landmarks."""
    pairs = _list_label_pairs(trial, fault.pairs)
    names = join_names([f"'{a}' and '{b}'" for a, b in pairs], 4)
    cause = f"the labels of {names} are swapped in the static trial"
    if {"asis_r", "heel_r", "knee_lat_r"} <= {name for pair in fault.pairs for name in pair}:
        names = f"right and left ({names})"
        cause = f"the labels of {names} are swapped in the static trial, or an axis is mirrored"
    swaps = ", ".join(f'"{a}" = "{b}", "{b}" = "{a}"' for a, b in pairs)
    return trial.error(
        "landmarks",
        _format_measures(fault.before),
        "swap the labels in this file or, if they are swapped in every trial, set rename = "
        f"{{ {swaps} }} under [markers]",
        cause=cause,
        leg=_get_leg(*(name for pair in fault.pairs for name in pair)),
        weight=10.0,
        code=Code.LANDMARKS_EXCHANGED,
    )


def _report_displacement(trial: TrialEvidence, fault: DisplacedLandmark) -> Finding:
    """Build the error or warning on a displaced landmark."""
    axis = int(np.argmax(np.abs(fault.away)))
    direction = _DIRECTIONS[axis][int(fault.away[axis] > 0)]
    name = describe_labels(trial, fault.landmark)
    rivals = [
        f"{describe_labels(trial, other)} by {1e3 * m:.0f} mm" for other, m in fault.rivals[:3]
    ]
    return trial.make_finding(
        Severity.ERROR if fault.size > GROSS_M else Severity.WARNING,
        "landmarks",
        _format_measures(fault.before)
        + (f"; equally good explanations: {' or '.join(rivals)}" if rivals else ""),
        "check the marker (person, photograph, video), and record or label the static trial again",
        cause=f"{name} is about {1e3 * fault.size:.0f} mm off its bone in the static trial, mostly "
        f"{direction}",
        leg=_get_leg(fault.landmark),
        weight=fault.size / 0.02,
        code=Code.LANDMARK_DISPLACED,
    )


def _report_height(
    trial: TrialEvidence, p: Landmarks, severity: Severity, factor: float, legs: float | None
) -> Finding:
    """Build the warning or note on a body height that the lengths contradict."""
    given = trial.subject.height
    lengths = [m for m in measure_landmarks(p, given) if m.absolute and abs(m.z) > 1.0]
    found = ""
    if legs is not None:
        share, sd = HIP_HEIGHT
        found = (
            f"the ASIS are {legs:.3f} m above the ankles; usual for {given:.2f} m: "
            f"{share * given:.2f} m, SD {sd * given:.2f} m; "
        )
    likely = (
        f"all lengths together suggest {factor * given:.2f} m"
        if factor != 1.0
        else "other lengths are inconclusive"
    )
    return trial.make_finding(
        severity,
        "height",
        f"{found}{likely}{'; ' + _format_measures(lengths) if factor != 1.0 and lengths else ''}",
        "correct subject.height_m, or the unit or scale of the markers",
        cause=f"a body height of {given:.2f} m contradicts the markers",
        weight=3.0,
        code=Code.BODY_HEIGHT,
    )


def _check_impossible_lengths(
    trial: TrialEvidence, found: Sequence[LandmarkMeasure]
) -> Iterator[Finding]:
    """Report lengths that no body has, if no single fault explains them."""
    worst = [m for m in found if m.absolute and abs(m.z) > IMPOSSIBLE_Z]
    if worst:
        names = dict.fromkeys(name for m in worst for name in m.landmarks)
        labels = ", ".join(describe_labels(trial, name) for name in names)
        cure = f"check labels, positions and unit of {labels}"
        cause = "lengths in the static trial are impossible for a body"
        yield trial.error(
            "landmarks",
            _format_measures(worst),
            cure,
            cause=cause,
            weight=10.0,
            code=Code.IMPOSSIBLE_LENGTHS,
        )


def _format_measures(found: Sequence[LandmarkMeasure]) -> str:
    """Format the most unusual measures."""
    worst = sorted(found, key=lambda m: -abs(m.z))
    return ", ".join(m.description for m in worst[:EVIDENCE])


def describe_labels(trial: TrialEvidence, landmark: str) -> str:
    """Name the markers of a landmark.

    Parameters
    ----------
    trial
        The static trial.
    landmark
        Name of a landmark, such as `knee_lat_r`.

    Returns
    -------
    str
    """
    labels = trial.marker_set.landmarks.get(landmark, (landmark,))
    return " and ".join(f"'{label}'" for label in labels)


def _list_label_pairs(
    trial: TrialEvidence, pairs: tuple[tuple[str, str], ...]
) -> list[tuple[str, str]]:
    """List the labels of swapped landmarks.

    `pairs`: names of landmarks. Returns: pairs of labels.
    """
    markers = trial.marker_set.landmarks
    out: list[tuple[str, str]] = []
    for a, b in pairs:
        out += zip(markers.get(a, (a,)), markers.get(b, (b,)), strict=False)
    return out


def _get_leg(*names: str) -> str:
    """Return the leg of all these landmarks; empty for both."""
    sides = {name[-1] for name in names if name != "sacrum"}
    return sides.pop() if len(sides) == 1 else ""
