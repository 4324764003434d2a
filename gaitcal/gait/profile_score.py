"""Gait Profile Score and Movement Analysis Profile: distance of a gait's angles from healthy means.

Baker, McGinley, Schwartz, Beynon, Rozumalski, Graham and Tirosh, Gait Posture 30:265-269, 2009. For
stride s and angle i, with x at 51 points of the stride (0, 2, ... 100 %) and m the healthy mean,

    GVS_i,s = sqrt(mean_t (x_i,s(t) - m_i(t))^2)        deg
    GVS_i   = mean of GVS_i,s over straight strides

Nine angles of a side make the Movement Analysis Profile. The score of the side is their RMS. That
of both sides contains the pelvis once, of left strides, and the other six angles of each side: 15
angles. Healthy people do not score 0 but about the RMS of their standard deviation over the stride.

Standard errors: strides differ (SD / sqrt(n)), and each angle has errors that all strides share, of
joint centres and axes. These are nearly an offset: x is displaced by z e(t), z standard normal, e
the shared standard error. The SD of GVS over z is computed by Gauss-Hermite quadrature, because a
score near 0 is not linear in z. Scores are combined as if the errors of different angles were
independent. On average an error makes a score larger, as any noise does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gaitcal.arrays import Array
from gaitcal.gait import cycles, normal_bands
from gaitcal.gait.strides import TURNING
from gaitcal.model import coordinates, linkage
from gaitcal.model.subject_model import Subject

ANGLES: Final = (
    *linkage.PELVIS_ANGLES,
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_angle",
    "ankle_angle",
    coordinates.FOOT_PROGRESSION,
)
EVERY: Final = 2
"""%, distance of the points."""
GPS, BOTH = "gps", "both"
_Z, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
"""Nodes and weights of Gauss-Hermite quadrature over a standard normal variable."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """Gait Variable Score of one angle, or a Gait Profile Score; deg."""

    side: str  # `r`, `l`, or `both`
    variable: str  # of `ANGLES`, or `gps`
    score: float
    error: float  # standard error; NaN where the errors of the angles are not known
    norm: float  # RMS of the standard deviation of healthy people
    strides: int  # of a profile score: the smallest number among its angles


def compute_profile_scores(
    strides: Mapping[str, Sequence[Any] | NDArray[Any]], bands: normal_bands.Bands, subject: Subject
) -> tuple[Score, ...]:
    """Compute the scores of nine angles, of each side and of both.

    Parameters
    ----------
    strides : mapping
        Columns of `cycles.csv`, a row for each percent.
    bands : Bands
        Normal bands; without one of the nine angles there are no scores.
    subject : Subject
        Person to whom the bands are scaled.

    Returns
    -------
    tuple of Score
        None of a side that lacks a complete straight stride of any angle.
    """
    if not set(ANGLES) <= set(bands):
        return ()
    column = {name: np.asarray(strides[name]) for name in ("side", "variable")}
    walking = np.asarray(strides["activity"]) == cycles.WALKING
    wanted = np.isin(column["variable"], ANGLES) & walking
    column = {n: v[wanted] for n, v in column.items()}
    numbers = {
        n: np.asarray(strides[n])[wanted].astype(float)
        for n in ("value", "se", "se_stride", "valid", "turn")
    }
    counts = (numbers["valid"] == 1) & ~(np.abs(numbers["turn"]) > TURNING)
    value = np.where(counts, numbers["value"], np.nan)
    shared = np.sqrt(np.maximum(numbers["se"] ** 2 - numbers["se_stride"] ** 2, 0.0))
    out: list[Score] = []
    for side in linkage.SIDES:
        scores = []
        for name in ANGLES:
            # (n, 51) each: strides of this angle at every second percent
            rows = (column["side"] == side) & (column["variable"] == name)
            x, e = (v[rows].reshape(-1, cycles.POINTS)[:, ::EVERY] for v in (value, shared))
            whole = np.isfinite(x).all(axis=1)
            if not whole.any():
                break
            mean, sd = (part[::EVERY] for part in bands[name].scale_to_person(subject, side))
            norm = float(_compute_rms(sd))
            scores.append(_score_angle(side, name, x[whole] - mean, e[whole].mean(axis=0), norm))
        if len(scores) == len(ANGLES):
            out += [*scores, _combine_scores(side, scores)]
    if len({s.side for s in out}) < len(linkage.SIDES):
        return tuple(out)
    # The score of both sides contains the pelvis once, of left strides.
    both = []
    for s in out:
        if s.variable in ANGLES and (s.side == "l" or s.variable not in linkage.PELVIS_ANGLES):
            both.append(s)
    return (*out, _combine_scores(BOTH, both))


def make_score_title(score: Score) -> str:
    """Make the title of a score: `Hip rotation`, `Gait Profile Score`."""
    if score.variable == GPS:
        return "Gait Profile Score"
    return coordinates.describe_coordinate(score.variable).title


def _score_angle(side: str, name: str, away: Array, shared: Array, norm: float) -> Score:
    """Score one angle from deviations `away` (n, 51) deg and shared standard errors (51,) deg."""
    scores = _compute_rms(away)
    # Variance by shared errors: the mean score at each node of the quadrature over z.
    displaced = np.stack([_compute_rms(away + z * shared).mean() for z in _Z])
    weights = _WEIGHTS / _WEIGHTS.sum()
    by_axes = weights @ displaced**2 - (weights @ displaced) ** 2
    by_strides = scores.var(ddof=1) / len(scores) if len(scores) > 1 else 0.0
    error = float(np.sqrt(max(by_axes, 0.0) + by_strides)) if np.isfinite(by_axes) else np.nan
    return Score(
        side=side,
        variable=name,
        score=float(scores.mean()),
        error=error,
        norm=norm,
        strides=len(scores),
    )


def _combine_scores(side: str, parts: Sequence[Score]) -> Score:
    """Combine the scores of angles to their RMS."""
    score, error, norm = (
        np.array([getattr(p, name) for p in parts]) for name in ("score", "error", "norm")
    )
    whole = float(_compute_rms(score))
    share = score / whole if whole > 0.0 else np.ones(len(parts))
    return Score(
        side=side,
        variable=GPS,
        score=whole,
        error=float(np.linalg.norm(share * error) / len(parts)),
        norm=float(_compute_rms(norm)),
        strides=min(p.strides for p in parts),
    )


def _compute_rms(values: Array) -> Array:
    """Compute the root mean square over the last axis."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=-1)))
