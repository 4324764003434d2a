"""Checks of the epicondyle lines in the transverse plane.

k is the angle of the line from the medial to the lateral epicondyle, a that of the malleoli and h
that of the line through both ASIS, each from the body's medial-lateral axis, positive if the
lateral end is forward. Three pieces of side evidence give the error of the line:

    bending    k - (flexion axis of the knee in a walk)            0 deg
    pelvis     k - h, the rotation of the hip                      0 deg
    torsion    (k - a) - TORSION_DEG, outward torsion of the shank

x_i with standard deviations s_i give e = sum(x_i / s_i^2) / sum(1 / s_i^2), with standard deviation
s = sum(1 / s_i^2)^(-1/2). All share k, so that anatomy scatters e less than a marker error does.
A single trial whose knee bends about a distant line is reported by itself.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.model import body_plan, linkage, rotations, segment_frames
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.static_landmarks import collect_landmarks, describe_labels

TORSION_DEG = 10.0
"""Mean outward torsion between the palpated lines of epicondyles and malleoli: 3 to 20 deg on the
legs of five recordings of people. By computed tomography it is 35 (Strecker et al. 1997), from the
back of the tibia."""
BOTH_DEG = {"bending": 6.0, "pelvis": 10.0, "torsion": 8.0}
"""sd of the mean of both legs. Measured on clean recordings: bending -5 to 7.5 deg on eight people,
pelvis -4 to 2.5, torsion 5 to 16. Pelvis and torsion are wider: by tomography version of the femur
scatters by 8.7 and torsion of the tibia by 8.0 deg (Strecker et al. 1997, 505 femora and 504
tibiae: 17.4 and 15.9 for two standard deviations)."""
ONE_DEG = {"bending": 7.0, "pelvis": 12.0, "torsion": 9.0}
"""sd of one leg: bending -14 to 8, pelvis -11 to 11, torsion 3 to 20 deg."""
ODD, ODD_BOTH = 3.0, 2.5
"""Standard deviations of e from which one knee is reported, and both where a walk gives the flexion
axes: 11 deg. On clean recordings the mean of both is off by 4.0 deg at most (3.2 RMS), that of one
leg by 10."""
LEAST_BENDING = 1.5
"""Standard deviations of the bending alone, where a walk gives it: people whose thighs and shanks
are twisted in opposite directions still bend about their epicondyles."""
LEAST_OTHERS = 0.5  # Standard deviations by which all other side evidence must agree
IN_TRIAL_DEG = 30.0
"""Clean recordings reach 26 deg at large knee flexion, as the soft tissue of the thigh rotates, and
14 deg in walking."""
AXIS_FLEXION = np.deg2rad(75.0)
AXIS_RANGE = np.deg2rad(35.0)
AXIS_PERCENTILES = (5.0, 95.0)
AXIS_FRAMES = 20
"""The knee axis is estimated below `AXIS_FLEXION` (rad), beyond which soft tissue slides much, from
a range of at least `AXIS_RANGE` (rad) between these percentiles, in more than `AXIS_FRAMES`."""
AGAINST = {
    "bending": "relative to the flexion axis of the knees in walks",
    "pelvis": "relative to the line through the ASIS",
    "torsion": "relative to the malleoli, less the usual torsion of a shank",
}
KNEES = {"r": "right knee", "l": "left knee"}


@dataclass(frozen=True, kw_only=True)
class OddLine:
    """Epicondyles whose line departs from the knee axis."""

    sides: tuple[str, ...]
    # e, deg; positive if lateral ends are too far forward or medial ones too far back
    angle: float
    baseline: float  # deg, largest usual e
    side_evidence: Mapping[str, float]  # deg, x of each


def check_knee_lines(
    trials: Sequence[TrialEvidence], findings: Sequence[Finding]
) -> Iterator[Finding]:
    """Report knees whose epicondyle line departs from the knee axis.

    Parameters
    ----------
    trials
        All trials of the study.
    findings
        Findings of the other checks; nothing is reported if they already doubt these landmarks.

    Yields
    ------
    Finding
        Warnings of the static trial: one on both knees, or one a knee.
    """
    static = next((trial for trial in trials if trial.is_static), None)
    if static is None or any(_is_landmark_doubt(found, static.name) for found in findings):
        return
    for found in find_odd_lines(collect_landmarks(static), measure_bending(trials)):
        both = len(found.sides) == 2
        names = [
            describe_labels(static, f"knee_{end}_{side}")
            for side in found.sides
            for end in ("lat", "med")
        ]
        evidence = ", ".join(
            f"{x:+.0f} deg {AGAINST[name]}" for name, x in found.side_evidence.items()
        )
        yield static.warning(
            "landmarks",
            f"viewed from above: {evidence}; combined {found.angle:+.0f} deg, usual: within "
            f"{found.baseline:.0f} deg",
            f"check {', '.join(names)} in the static trial (person, photograph), and record it "
            "again; hip rotation and knee adduction are wrong by as much",
            cause="the line through the lateral and medial markers of "
            f"{'both knees' if both else f'the {KNEES[found.sides[0]]}'} is about "
            f"{abs(found.angle):.0f} deg off the flexion axis of a knee, the lateral end too far "
            f"{'forward' if found.angle > 0 else 'back'}",
            leg="" if both else found.sides[0],
            weight=abs(found.angle) / found.baseline,
            code=Code.KNEE_MARKERS,
        )


def _is_landmark_doubt(found: Finding, static: str) -> bool:
    """Return whether a finding already doubts the landmarks of the static trial."""
    if found.severity is Severity.INFO:
        return False
    spoilt = found.severity is Severity.ERROR or found.topic in ("landmarks", "posture")
    return (found.where == static and spoilt) or "epicondyles" in found.cause


def find_odd_lines(p: Mapping[str, Array], bending: Mapping[str, float]) -> Iterator[OddLine]:
    """Find epicondyle lines that depart from the knee axis: of both knees, or of one.

    `p`: landmarks of the static trial, (3,) m each, y up. `bending`: side -> angle (deg) of the
    epicondyle line from the flexion axis in walks, positive as k; may be empty. Yields one for both
    knees, or one a knee.
    """
    legs = {side: _compute_side_evidence(p, side, bending.get(side)) for side in linkage.SIDES}
    mean = {name: 0.5 * (x + legs["l"][name]) for name, x in legs["r"].items() if name in legs["l"]}
    both = _judge_line(linkage.SIDES, mean, BOTH_DEG)
    alike = [_estimate(legs[side], ONE_DEG)[0] for side in linkage.SIDES]
    # an error of placement common to both knees is one finding
    if (
        both is not None
        and min(alike) * max(alike) > 0
        and min(map(abs, alike)) > 0.5 * abs(both.angle)
    ):
        yield both
        return
    ones = [_judge_line((side,), legs[side], ONE_DEG) for side in linkage.SIDES]
    yield from (one for one in ones if one is not None)


def _compute_side_evidence(
    p: Mapping[str, Array], side: str, bending: float | None
) -> dict[str, float]:
    """Compute the available side evidence, deg; empty without an epicondyle line."""
    axes = body_plan.compute_body_axes(p)

    def measure_angle(medial: str, lateral: str) -> float | None:
        """Measure a line from the medial-lateral axis, deg; positive if laterally forward."""
        if axes is None or medial not in p or lateral not in p:
            return None
        forward, _, right = (p[lateral] - p[medial]) @ axes
        return float(np.rad2deg(np.arctan2(forward, segment_frames.sign(side) * right)))

    knee = measure_angle(f"knee_med_{side}", f"knee_lat_{side}")
    if knee is None:
        return {}
    found = {} if bending is None else {"bending": bending}
    pelvis = measure_angle(*(("asis_l", "asis_r") if side == "r" else ("asis_r", "asis_l")))
    if pelvis is not None:
        found["pelvis"] = knee - pelvis
    ankle = measure_angle(f"ankle_med_{side}", f"ankle_lat_{side}")
    if ankle is not None:
        found["torsion"] = knee - ankle - TORSION_DEG
    return found


def _estimate(found: Mapping[str, float], sd: Mapping[str, float]) -> tuple[float, float]:
    """Compute the estimate e and its standard deviation s, deg."""
    weight = {name: sd[name] ** -2 for name in found}
    total = sum(weight.values())
    if not total:
        return 0.0, float("inf")
    return sum(weight[name] * x for name, x in found.items()) / total, total**-0.5


def _judge_line(
    sides: tuple[str, ...], found: Mapping[str, float], sd: Mapping[str, float]
) -> OddLine | None:
    """Return the line of one or both knees if its side evidence agrees on a large error."""
    angle, spread = _estimate(found, sd)
    baseline = spread * (ODD_BOTH if len(sides) == 2 and "bending" in found else ODD)
    if len(found) < 2 or abs(angle) < baseline:
        return None
    # all side evidence must agree in direction
    least = {name: LEAST_BENDING if name == "bending" else LEAST_OTHERS for name in found}
    agree = all(np.sign(angle) * x / sd[name] > least[name] for name, x in found.items())
    return (
        OddLine(sides=sides, angle=angle, baseline=baseline, side_evidence=found) if agree else None
    )


def measure_bending(trials: Sequence[TrialEvidence]) -> dict[str, float]:
    """Measure the angle between epicondyle line and flexion axis in walks.

    `trials`: all trials; only gait trials are used. Returns: side -> median over walks, deg,
    positive as k; sides without an estimate are missing.
    """
    out: dict[str, float] = {}
    for side in linkage.SIDES:
        found = [_measure_axis_angle(trial, f"knee_{side}") for trial in trials if trial.is_gait]
        angles = [angle for angle in found if angle is not None]
        if angles:
            out[side] = segment_frames.sign(side) * float(np.rad2deg(np.median(angles)))
    return out


def _measure_axis_angle(trial: TrialEvidence, knee: str) -> float | None:
    """Measure the transverse angle from a knee's mean flexion axis to its epicondyle line.

    `knee`: `knee_r` or `knee_l`. Returns: rad; None if the knee moves too little or its markers are
    missing.
    """
    epicondyles = None if trial.stance is None else trial.stance.knee_axes.get(knee)
    if knee not in trial.links or epicondyles is None:
        return None
    turn = trial.links[knee].rotations
    flexion = rotations.compute_root_angles(turn)[:, 0]
    used = flexion > -AXIS_FLEXION  # a knee bends to negative f
    if (
        used.sum() <= AXIS_FRAMES
        or np.ptp(np.percentile(flexion[used], AXIS_PERCENTILES)) <= AXIS_RANGE
    ):
        return None
    about = turn[used] @ segment_frames.find_nearest_rotation(turn[used].mean(axis=0)).T
    # principal direction of the small rotations about the mean posture
    vector = 0.5 * np.stack(
        [about[:, i, j] - about[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1
    )
    axis = np.linalg.svd(vector - vector.mean(axis=0), full_matrices=False)[2][0]
    # both lines in the transverse plane, pointing to the right
    (ax, az), (ex, ez) = (v[[0, 2]] * np.sign(v[2]) for v in (axis, epicondyles))
    return float(np.arctan2(ex, ez) - np.arctan2(ax, az))


def check_knee_axes(
    trials: Sequence[TrialEvidence], reported: Collection[str]
) -> Iterator[Finding]:
    """Report knees that bend about another line than that through their epicondyles.

    Parameters
    ----------
    trials
        Moving trials.
    reported
        Sides of legs that have findings already; they are left out.

    Yields
    ------
    Finding
        At most one warning a knee.
    """
    for side in {"r", "l"} - set(reported):
        angles = [(trial.name, _measure_axis_angle(trial, f"knee_{side}")) for trial in trials]
        degrees = {name: np.rad2deg(angle) for name, angle in angles if angle is not None}
        odd = {name: angle for name, angle in degrees.items() if abs(angle) > IN_TRIAL_DEG}
        if odd:
            yield Finding(
                severity=Severity.WARNING,
                topic="one body",
                where=next(iter(odd)) if len(odd) == 1 else STUDY,
                cause=f"the {KNEES[side]} bends about another line than that through its "
                "epicondyles",
                found=", ".join(
                    f"{v:+.0f} deg (viewed from above) in {name}" for name, v in odd.items()
                )
                + f"; allowed: {IN_TRIAL_DEG:.0f} deg",
                cure="check the medial and lateral knee markers of the static trial, or use "
                "another "
                "static trial",
                leg=side,
                weight=max(abs(v) for v in odd.values()) / IN_TRIAL_DEG,
                code=Code.KNEE_BENDS_ELSEWHERE,
            )
