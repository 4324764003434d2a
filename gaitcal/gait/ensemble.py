"""Mean curves of a table of strides: every variable of each side, at every percent, over strides and trials.

The statistics are those of `gait/spread.py`. Samples that are not valid are left out one by one, so that n may change
along the stride. Strides that turn (`gait/progression.py`) are left out whole: legs and trunk, too, move otherwise in a
turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gaitcal.arrays import Array, IntArray
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.gait.progression import TURNING
from gaitcal.gait.spread import spread
from gaitcal.gait.stride_table import CYCLE_COLUMNS, TOLD, conventions_of, typed
from gaitcal.runtime import with_one_blas_thread

if TYPE_CHECKING:
    import pandas as pd  # loaded by who asks for a data frame: it takes a third of a second

GROUP: Final = ("person", "session", "side", "variable")
"""Columns of `cycles.csv` whose strides belong together."""
WHERE: Final = [*GROUP, "trial", "stride", "percent"]
"""Columns that tell one sample from all others."""
STATISTICS: Final = ("n", "trials", "mean", "sd", "sd_within", "sd_between", "sd_error", "se")
ENSEMBLE_COLUMNS: Final = (*GROUP, "percent", *STATISTICS)


def require_once(strides: pd.DataFrame) -> None:
    """InputError where a table of strides has one twice, as those of two sessions without a name have."""
    if (twice := strides.duplicated(WHERE)).any():
        row = strides.loc[twice].iloc[0]
        raise InputError(
            f"found stride {row['stride']} of {row['trial']}, side {row['side']}, twice; allowed: once for each "
            "person and session; name the sessions",
            field="strides",
            code=Code.STRIDE_TABLE,
        )


@with_one_blas_thread
def ensemble(strides: pd.DataFrame) -> pd.DataFrame:
    """Mean and spread over strides and trials of every variable of each side, at every percent.

    Parameters
    ----------
    strides : as `gaitcal.cycles` or `gaitcal.read_cycles` give it, or pandas reads it; samples with `valid` 0 and
        strides that turn are left out.

    Raises
    ------
    InputError
        A column is missing, a stride is there twice, or a variable in two conventions.

    Returns
    -------
    One row a percent, with `ENSEMBLE_COLUMNS`, in the units of `strides`: `n` strides of `trials` trials; `mean`; `sd`
    over strides; `sd_within`, `sd_between` trials; `sd_error`, the part that is measurement error; `se` of the mean;
    `unit` and `positive` where `strides` have them.
    """
    import pandas as pd

    if strides.empty:
        return pd.DataFrame(columns=list(ENSEMBLE_COLUMNS))
    strides = typed(strides)
    require_once(strides)
    found = mean_curves({name: strides[name].to_numpy() for name in CYCLE_COLUMNS})
    told = conventions_of(strides) if any(name in strides for name in TOLD) else {}
    words = [told.get(str(variable), ("", "")) for variable in found["variable"]] if told else []
    return pd.DataFrame({**found, **{name: [of[k] for of in words] for k, name in enumerate(TOLD) if words}})


def mean_curves(strides: Mapping[str, NDArray[Any] | list[Any]]) -> dict[str, NDArray[Any]]:
    """`ENSEMBLE_COLUMNS` of the columns of strides, each of which is there once (`CYCLE_COLUMNS`, numbers as numbers).

    Groups are in the order in which they come first.
    """
    codes = {name: _codes(strides[name]) for name in WHERE}
    sizes = [len(known) for known, _ in codes.values()]
    percent, _ = codes["percent"]
    key = np.ravel_multi_index([codes[name][1] for name in WHERE[:-1]], sizes[:-1])
    stride_keys, first, row = np.unique(key, return_index=True, return_inverse=True)

    def wide(name: str) -> Array:
        out = np.full((len(stride_keys), len(percent)), np.nan)
        out[row, codes["percent"][1]] = strides[name]
        return out

    valid, turn = wide("valid"), wide("turn")
    counts = (valid == 1) & ~(np.abs(turn) > TURNING)
    usable = np.where(counts, wide("value"), np.nan)
    own, total = wide("se_stride"), wide("se")
    trials = codes["trial"][1][first]
    group = key // (sizes[-3] * sizes[-2])
    _, begun = np.unique(group, return_index=True)
    begun = np.sort(begun)
    columns: dict[str, list[Array]] = {name: [] for name in STATISTICS}
    for at in begun:
        rows = np.flatnonzero(group[first] == group[at])
        found = spread(usable[rows], trials[rows], own[rows], total[rows])
        for name, values in columns.items():
            values.append(getattr(found, name))
    named = {name: np.repeat([strides[name][at] for at in begun], len(percent)) for name in GROUP}
    joined = {name: np.concatenate(values) for name, values in columns.items()}
    return {**named, "percent": np.tile(percent, len(begun)), **joined}


def _codes(values: NDArray[Any] | list[Any]) -> tuple[NDArray[Any], IntArray]:
    """What a column holds, in its order, and the place there of each of its values."""
    if isinstance(values, np.ndarray) and values.dtype.kind in "iuf":
        known, codes = np.unique(values, return_inverse=True)
        return known, codes
    texts = list(values)  # hashed: to sort all of them takes ten times as long
    names = sorted(set(texts), key=str)
    places = {name: k for k, name in enumerate(names)}
    return np.array(names, dtype=object), np.array([places[text] for text in texts])
