"""Whether the lines through the epicondyles of a person's knees lie where knees have them, seen
from above.

With k the angle of the line from the medial to the lateral epicondyle, a that of the malleoli and h
that of the line through both ASIS, each from the body's medial-lateral axis, positive where the
lateral end lies forward, three pieces of side evidence tell how far the line is off:

    bending    k - (axis about which the knee bends in a walk)     0 deg
    pelvis     k - h, the rotation of the hip                      0 deg
    torsion    (k - a) - TORSION_DEG, outward torsion of the shank

x_i with standard deviations s_i give e = sum(x_i / s_i^2) / sum(1 / s_i^2), whose own is s = sum(1
/ s_i^2)^(-1/2). All share k, so that people's own build scatters e less than that and no error of a
marker does. One trial whose knee bends about a line far off is told by itself.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.model import body_plan, linkage, rotations, segment_frames
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.static_landmarks import label_words, landmarks

TORSION_DEG = 10.0
"""Mean outward torsion between the lines of epicondyles and malleoli as they are palpated: 3 to 20
deg on the legs of five recordings of people. By computed tomography it is 35 (Strecker et al.
1997), from the back of the tibia."""
BOTH_DEG = {"bending": 6.0, "pelvis": 10.0, "torsion": 8.0}
"""sd of the mean of both legs. Measured on clean recordings: bending -5 to 7.5 deg on eight people,
pelvis -4 to 2.5, torsion 5 to 16. Pelvis and torsion are wider: by tomography version of the femur
scatters by 8.7 and torsion of the tibia by 8.0 deg (Strecker et al. 1997, 505 femora and 504
tibiae: 17.4 and 15.9 for two standard deviations)."""
ONE_DEG = {"bending": 7.0, "pelvis": 12.0, "torsion": 9.0}
"""sd of one leg: bending -14 to 8, pelvis -11 to 11, torsion 3 to 20 deg."""
ODD, ODD_BOTH = 3.0, 2.5
"""Standard deviations of e from which one knee is doubted, and both where a walk shows how they
bend: 11 deg. Of clean recordings the mean of both is off by 4.0 deg at most (3.2 RMS), that of one
leg by 10."""
LEAST_BENDING = 1.5
"""Standard deviations of the bending alone, where a walk shows it: people whose thighs and shanks
are twisted, each the other way, bend about their epicondyles all the same."""
LEAST_OTHERS = 0.5  # Standard deviations by which all other side evidence must say the same
IN_TRIAL_DEG = 30.0
"""Clean recordings reach 26 deg where the knee bends far, as the skin of the thigh turns, and 14
deg in walking.
"""
AXIS_FLEXION, AXIS_RANGE = np.deg2rad(75.0), np.deg2rad(35.0)
AXIS_PERCENTILES = (5.0, 95.0)
AXIS_FRAMES = 20
"""The axis of a knee is read below the flexion where its skin slides much, from a movement as large
as that.
"""
AGAINST = {
    "bending": "against the axis about which the knees bend in walks",
    "pelvis": "against the line through the ASIS",
    "torsion": "against the malleoli, less the usual torsion of a shank",
}
KNEES = {"r": "right knee", "l": "left knee"}


@dataclass(frozen=True, kw_only=True)
class OddLine:
    """Epicondyles whose line is not the knee's."""

    sides: tuple[str, ...]
    # Degrees, e; positive where the lateral ends lie too far forward or the medial ones too far
    # back
    turn: float
    baseline: float  # deg, largest e of people
    side_evidence: Mapping[str, float]  # deg, x of each


def knee_lines(trials: Sequence[TrialEvidence], said: Sequence[Finding]) -> Iterator[Finding]:
    """Knees whose epicondyles lie off their line, where nothing that was `said` already doubts
    these landmarks.
    """
    static = next((trial for trial in trials if trial.is_static), None)
    if static is None or any(_doubts_landmarks(found, static.name) for found in said):
        return
    for found in odd_lines(landmarks(static), bending(trials)):
        both = len(found.sides) == 2
        names = [
            label_words(static, f"knee_{end}_{side}")
            for side in found.sides
            for end in ("lat", "med")
        ]
        evidence = ", ".join(
            f"{x:+.0f} deg {AGAINST[name]}" for name, x in found.side_evidence.items()
        )
        yield static.warning(
            "landmarks",
            f"seen from above: {evidence}; together {found.turn:+.0f} deg, usual within "
            f"{found.baseline:.0f}",
            f"look at {', '.join(names)} in the static trial (person, photograph), and record it "
            "again; hip rotation "
            "and knee adduction are wrong by as much",
            cause="the lateral and medial markers of "
            f"{'both knees' if both else f'the {KNEES[found.sides[0]]}'} lie "
            f"about {abs(found.turn):.0f} deg off the axis on which a knee bends, the lateral end "
            "too far "
            f"{'forward' if found.turn > 0 else 'back'}",
            leg="" if both else found.sides[0],
            weight=abs(found.turn) / found.baseline,
            code=Code.KNEE_MARKERS,
        )


def _doubts_landmarks(found: Finding, static: str) -> bool:
    if found.severity is Severity.INFO:
        return False
    spoilt = found.severity is Severity.ERROR or found.topic in ("landmarks", "posture")
    return (found.where == static and spoilt) or "epicondyles" in found.cause


def odd_lines(p: Mapping[str, Array], bending: Mapping[str, float]) -> Iterator[OddLine]:
    """Knees whose epicondyles lie off their line: both, or one.

    p: landmarks of the static trial, (3,) m each, y up. bending: side -> deg of the walks, positive
    as k; may be empty.
    """
    legs = {side: _side_evidence(p, side, bending.get(side)) for side in linkage.SIDES}
    mean = {name: 0.5 * (x + legs["l"][name]) for name, x in legs["r"].items() if name in legs["l"]}
    both = _odd(linkage.SIDES, mean, BOTH_DEG)
    alike = [_estimate(legs[side], ONE_DEG)[0] for side in linkage.SIDES]
    if (
        both is not None
        and min(alike) * max(alike) > 0
        and min(map(abs, alike)) > 0.5 * abs(both.turn)
    ):
        yield both
        return
    ones = [_odd((side,), legs[side], ONE_DEG) for side in linkage.SIDES]
    yield from (one for one in ones if one is not None)


def _side_evidence(p: Mapping[str, Array], side: str, bending: float | None) -> dict[str, float]:
    """Degrees by name, those that can be told; empty without a line through the knee."""
    axes = body_plan.compute_body_axes(p)

    def line(medial: str, lateral: str) -> float | None:
        """Degrees from the body's medial-lateral axis, positive where the lateral end lies forward."""
        if axes is None or medial not in p or lateral not in p:
            return None
        forward, _, right = (p[lateral] - p[medial]) @ axes
        return float(np.rad2deg(np.arctan2(forward, segment_frames.sign(side) * right)))

    knee = line(f"knee_med_{side}", f"knee_lat_{side}")
    if knee is None:
        return {}
    found = {} if bending is None else {"bending": bending}
    pelvis = line(*(("asis_l", "asis_r") if side == "r" else ("asis_r", "asis_l")))
    if pelvis is not None:
        found["pelvis"] = knee - pelvis
    ankle = line(f"ankle_med_{side}", f"ankle_lat_{side}")
    if ankle is not None:
        found["torsion"] = knee - ankle - TORSION_DEG
    return found


def _estimate(found: Mapping[str, float], sd: Mapping[str, float]) -> tuple[float, float]:
    """The estimate e and its s, deg."""
    weight = {name: sd[name] ** -2 for name in found}
    total = sum(weight.values())
    if not total:
        return 0.0, float("inf")
    return sum(weight[name] * x for name, x in found.items()) / total, total**-0.5


def _odd(
    sides: tuple[str, ...], found: Mapping[str, float], sd: Mapping[str, float]
) -> OddLine | None:
    turn, spread = _estimate(found, sd)
    baseline = spread * (ODD_BOTH if len(sides) == 2 and "bending" in found else ODD)
    if len(found) < 2 or abs(turn) < baseline:
        return None
    least = {name: LEAST_BENDING if name == "bending" else LEAST_OTHERS for name in found}
    agree = all(np.sign(turn) * x / sd[name] > least[name] for name, x in found.items())
    return (
        OddLine(sides=sides, turn=turn, baseline=baseline, side_evidence=found) if agree else None
    )


def bending(trials: Sequence[TrialEvidence]) -> dict[str, float]:
    """Side -> deg from the axis of the knee to its epicondyles, median of the walks; where they
    tell one.
    """
    out: dict[str, float] = {}
    for side in linkage.SIDES:
        found = [axis_turn(trial, f"knee_{side}") for trial in trials if trial.is_gait]
        turns = [turn for turn in found if turn is not None]
        if turns:
            out[side] = segment_frames.sign(side) * float(np.rad2deg(np.median(turns)))
    return out


def axis_turn(trial: TrialEvidence, knee: str) -> float | None:
    """Rad, transverse angle from the axis that a knee's turns vary about to its epicondyles; None
    where it cannot be told.
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
    vector = 0.5 * np.stack(
        [about[:, i, j] - about[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1
    )
    axis = np.linalg.svd(vector - vector.mean(axis=0), full_matrices=False)[2][0]
    (ax, az), (ex, ez) = (v[[0, 2]] * np.sign(v[2]) for v in (axis, epicondyles))
    return float(np.arctan2(ex, ez) - np.arctan2(ax, az))


def knee_axes(trials: Sequence[TrialEvidence], said: Collection[str]) -> Iterator[Finding]:
    """Knees that bend about another line than through their epicondyles, on legs of which nothing
    else was `said`.
    """
    for side in {"r", "l"} - set(said):
        turns = {
            t.name: np.rad2deg(turn)
            for t in trials
            if (turn := axis_turn(t, f"knee_{side}")) is not None
        }
        odd = {name: turn for name, turn in turns.items() if abs(turn) > IN_TRIAL_DEG}
        if odd:
            yield Finding(
                severity=Severity.WARNING,
                topic="one body",
                where=next(iter(odd)) if len(odd) == 1 else STUDY,
                cause=f"the {KNEES[side]} bends about another line than through its epicondyles",
                found=", ".join(
                    f"{v:+.0f} deg, seen from above, in {name}" for name, v in odd.items()
                )
                + f"; allowed: {IN_TRIAL_DEG:.0f}",
                cure="look at the medial and lateral knee markers of the static trial; or another "
                "static trial",
                leg=side,
                weight=max(abs(v) for v in odd.values()) / IN_TRIAL_DEG,
                code=Code.KNEE_BENDS_ELSEWHERE,
            )
