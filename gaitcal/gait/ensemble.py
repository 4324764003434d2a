"""Mean and spread of strides at each percent: between strides, between trials, measurement error.

The value of stride j of trial i, at one percent of the stride of one foot, is modelled as

    y_ij = mu + a_i + b_ij + e_ij + c,

with a_i the deviation of the trial (variance V_b), b_ij the deviation of the stride within its
trial (V_w), e_ij the measurement error of the single stride (variance s_ij^2), and c the error
that all strides of one calibrated person share: joint centres and axes, masses, axes of the
segments, bandwidth, force plates. c moves the mean and every stride alike, so it is no part of any
spread. From n strides in k trials, n_i in each (Searle, Casella & McCulloch, Variance Components,
1992, chapter 3):

    mean  = sum y_ij / n                     each stride has the same weight
    sd^2  = sum (y_ij - mean)^2 / (n - 1)    the standard deviation of gait reports
    V_w   = sum (y_ij - mean_i)^2 / (n - k)
    V_b   = max(0, (sum n_i (mean_i - mean)^2 / (k - 1) - V_w) / n_0)
    n_0   = (n - sum n_i^2 / n) / (k - 1)
    sd_error^2 = mean of s_ij^2              a part of sd^2 and of V_w

V_w needs a trial with two strides, V_b a second trial as well. Where every trial has one stride the
two cannot be separated, and only sd is known. s_ij is the standard error by the markers of the
trial itself (`se_stride` of `cycles.csv`). It includes soft tissue motion that repeats in every
stride, so sd_error is an upper limit: where it is larger than sd, the error bars are too wide. The
standard error of the mean contains both kinds of error; more strides do not reduce c:

    se^2 = sd^2 / n + mean(sqrt(se_ij^2 - s_ij^2))^2         n >= 2;   one stride: its se

Samples that are not valid are left out one by one, so n may change along the stride. Strides in
which the person turns (`gait/strides.py`) are left out as a whole.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gaitcal.arrays import Array, IntArray
from gaitcal.errors import Code, InputError
from gaitcal.gait.cycles import (
    CONVENTION_COLUMNS,
    CYCLE_COLUMNS,
    read_conventions,
    validate_stride_table,
)
from gaitcal.gait.strides import TURNING
from gaitcal.runtime import with_one_blas_thread

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True)
class StrideStatistics:
    """Statistics of strides at m points (percents); NaN where not known."""

    n: Array  # (m,) strides with a valid value
    trials: Array  # (m,) trials that they are of
    mean: Array  # (m,) in the unit of the values, as all that follow
    sd: Array  # (m,) over all strides
    sd_within: Array  # (m,) between strides of one trial, sqrt(V_w)
    sd_between: Array  # (m,) between trials, beyond the scatter of strides within them, sqrt(V_b)
    sd_error: Array  # (m,) the part of `sd`, and of `sd_within`, that is measurement error
    se: Array  # (m,) standard error of the mean, shared errors included


def compute_statistics(
    values: Array, trials: NDArray[Any], individual: Array | None = None, total: Array | None = None
) -> StrideStatistics:
    """Compute mean, standard deviations and standard error over strides.

    Parameters
    ----------
    values : (n, m) Array
        Values of n strides at m points; NaN where a value is not valid.
    trials : (n,) NDArray
        Label of the trial of each stride.
    individual : (n, m) Array, optional
        Standard errors s_ij of the single strides.
    total : (n, m) Array, optional
        Standard errors se_ij, errors that strides share included.

    Returns
    -------
    StrideStatistics
        `sd_error` needs `individual`, `se` needs both kinds of errors.
    """
    values = np.asarray(values, dtype=np.float64)
    valid = np.isfinite(values)
    n = valid.sum(axis=0)
    zeroed = np.where(valid, values, 0.0)
    groups = [trials == label for label in dict.fromkeys(np.asarray(trials).tolist())]
    # n_i and the sum of values of each trial at each point, (k, m)
    counts = np.array([valid[rows].sum(axis=0) for rows in groups], dtype=np.float64)
    counts = counts.reshape(len(groups), -1)
    sums = np.array([zeroed[rows].sum(axis=0) for rows in groups]).reshape(len(groups), -1)
    k, squares = (counts > 0).sum(axis=0), (counts**2).sum(axis=0)
    error, se = np.full(len(n), np.nan), np.full(len(n), np.nan)
    # Points with too few strides or trials divide by zero; they become NaN below.
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = zeroed.sum(axis=0) / n
        trial_means = sums / counts
        variance = np.where(valid, (values - mean) ** 2, 0.0).sum(axis=0) / (n - 1)
        # Sums of squares between trials and within them; V_w and V_b of the module.
        squares_between = np.nansum(counts * (trial_means - mean) ** 2, axis=0)
        squares_within = np.maximum((n - 1) * variance - squares_between, 0.0)
        within = np.where(n > k, squares_within / (n - k), np.nan)
        size = (n - squares / n) / (k - 1)
        excess = (squares_between / (k - 1) - within) / size
        between = np.where((n > k) & (k > 1), np.maximum(excess, 0.0), np.nan)
        if individual is not None:
            error = _average_over(np.square(individual), valid)
        if individual is not None and total is not None:
            shared = np.sqrt(np.maximum(np.square(total) - np.square(individual), 0.0))
            single = _average_over(np.asarray(total, dtype=np.float64), valid)
            joint = np.sqrt(variance / n + _average_over(shared, valid) ** 2)
            se = np.where(n > 1, joint, single)
    variance = np.where(n > 1, variance, np.nan)
    return StrideStatistics(
        n=n,
        trials=k,
        mean=np.where(n > 0, mean, np.nan),
        sd=np.sqrt(variance),
        sd_within=np.sqrt(within),
        sd_between=np.sqrt(between),
        sd_error=np.sqrt(error),
        se=np.where(n > 0, se, np.nan),
    )


def _average_over(values: Array, valid: Array) -> Array:
    """Average over the strides whose value is valid; NaN where one of them has no error."""
    return np.where(valid, values, 0.0).sum(axis=0) / valid.sum(axis=0)


GROUP: Final = ("person", "session", "activity", "side", "variable")
"""Columns of `cycles.csv` whose values are equal for strides that are averaged."""
SAMPLE_COLUMNS: Final = [*GROUP, "trial", "stride", "percent"]
"""Columns that identify one sample."""
STATISTICS: Final = ("n", "trials", "mean", "sd", "sd_within", "sd_between", "sd_error", "se")
ENSEMBLE_COLUMNS: Final = (*GROUP, "percent", *STATISTICS)


def require_unique_strides(strides: "pd.DataFrame") -> None:
    """Require that a table of strides contains each stride once.

    Parameters
    ----------
    strides : pandas.DataFrame
        Table with the columns `SAMPLE_COLUMNS`.

    Raises
    ------
    InputError
        A stride appears twice, as where two sessions without a name are joined.
    """
    twice = strides.duplicated(SAMPLE_COLUMNS)
    if twice.any():
        row = strides.loc[twice].iloc[0]
        message = (
            f"found stride {row['stride']} of {row['trial']}, side {row['side']}, twice; allowed: "
            "once for each person and session; name the sessions"
        )
        raise InputError(message, field="strides", code=Code.STRIDE_TABLE)


@with_one_blas_thread
def ensemble(strides: "pd.DataFrame") -> "pd.DataFrame":
    """Compute mean and spread over strides and trials of each variable and side, at each percent.

    Parameters
    ----------
    strides : pandas.DataFrame
        Table as `gaitcal.cycles` or `gaitcal.read_cycles` return it, or as pandas reads it. Samples
        with `valid` 0 and strides in which the person turns are left out.

    Returns
    -------
    pandas.DataFrame
        A row for each percent, with `ENSEMBLE_COLUMNS` in the units of `strides`: `n` strides of
        `trials` trials; `mean`; `sd` over strides; `sd_within` and `sd_between` trials; `sd_error`,
        the part that is measurement error; `se` of the mean; `unit` and `positive` where `strides`
        have them.

    Raises
    ------
    InputError
        A column is missing, a stride appears twice, or a variable appears in two conventions.
    """
    import pandas as pd

    if strides.empty:
        return pd.DataFrame(columns=list(ENSEMBLE_COLUMNS))
    strides = validate_stride_table(strides)
    require_unique_strides(strides)
    found = compute_mean_curves({name: strides[name].to_numpy() for name in CYCLE_COLUMNS})
    table = pd.DataFrame(found)
    if any(name in strides for name in CONVENTION_COLUMNS):
        conventions = read_conventions(strides)
        rows = [conventions.get(str(variable), ("", "")) for variable in found["variable"]]
        for k, name in enumerate(CONVENTION_COLUMNS):
            table[name] = [row[k] for row in rows]
    return table


def compute_mean_curves(strides: Mapping[str, NDArray[Any] | list[Any]]) -> dict[str, NDArray[Any]]:
    """Compute `ENSEMBLE_COLUMNS` from columns of strides.

    Parameters
    ----------
    strides : mapping
        `CYCLE_COLUMNS` -> column; numbers as numbers, each stride once.

    Returns
    -------
    dict
        Column -> values. Groups are in the order of their first row.
    """
    codes = {name: _encode_column(strides[name]) for name in SAMPLE_COLUMNS}
    sizes = [len(known) for known, _ in codes.values()]
    percent, _ = codes["percent"]
    # One number for each stride of each variable; `row` gives the stride of each sample.
    key = np.ravel_multi_index([codes[name][1] for name in SAMPLE_COLUMNS[:-1]], sizes[:-1])
    stride_keys, first, row = np.unique(key, return_index=True, return_inverse=True)

    def wide(name: str) -> Array:
        """Arrange a column as (strides, percents)."""
        out = np.full((len(stride_keys), len(percent)), np.nan)
        out[row, codes["percent"][1]] = strides[name]
        return out

    valid, turn = wide("valid"), wide("turn")
    counts = (valid == 1) & ~(np.abs(turn) > TURNING)
    usable = np.where(counts, wide("value"), np.nan)
    individual, total = wide("se_stride"), wide("se")
    trials = codes["trial"][1][first]
    # The last two columns of the key are trial and stride: without them it is that of the group.
    group = key // (sizes[-3] * sizes[-2])
    _, starts = np.unique(group, return_index=True)
    starts = np.sort(starts)
    columns: dict[str, list[Array]] = {name: [] for name in STATISTICS}
    for start in starts:
        rows = np.flatnonzero(group[first] == group[start])
        found = compute_statistics(usable[rows], trials[rows], individual[rows], total[rows])
        for name, values in columns.items():
            values.append(getattr(found, name))
    table: dict[str, NDArray[Any]] = {}
    for name in GROUP:
        table[name] = np.repeat([strides[name][start] for start in starts], len(percent))
    table["percent"] = np.tile(percent, len(starts))
    return table | {name: np.concatenate(values) for name, values in columns.items()}


def _encode_column(values: NDArray[Any] | list[Any]) -> tuple[NDArray[Any], IntArray]:
    """List the values of a column in order, and give each row the index of its value there."""
    if isinstance(values, np.ndarray) and values.dtype.kind in "iuf":
        known, codes = np.unique(values, return_inverse=True)
        return known, codes
    # A set and a dictionary of the few different texts: sorting all rows takes ten times as long.
    texts = list(values)
    names = sorted(set(texts), key=str)
    indices = {name: k for k, name in enumerate(names)}
    return np.array(names, dtype=object), np.array([indices[text] for text in texts])
