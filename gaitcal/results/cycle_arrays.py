"""The table of strides as an xarray Dataset, with named dimensions; xarray itself is installed by who wants it."""

from __future__ import annotations

from typing import Any

import pandas as pd

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.gait.ensemble import require_once
from gaitcal.gait.stride_table import conventions_of, typed

DIMENSIONS = ("person", "session", "trial", "side", "stride", "percent")
COLUMNS = {"": "value", "_se": "se", "_valid": "valid"}
"""Ending of a data variable -> column of the table."""


def cycles_to_xarray(strides: pd.DataFrame) -> Any:
    """A `xarray.Dataset` of strides as `gaitcal.cycles` and `gaitcal.read_cycles` give them.

    Dimensions `trial`, `side`, `stride`, `percent`; `person` and `session`, too, where there are several. Data
    variables `hip_flexion`, `hip_flexion_se` (standard error), `hip_flexion_valid` (1: may be used), with `units` as
    attribute, and with `positive` (what a positive value means) where the table says it, as exports do; NaN where a
    trial has no such stride. Without any stride it is empty.

    Raises
    ------
    InputError
        xarray is not installed, a stride is there twice, or a variable in two conventions.
    """
    try:
        import xarray
    except ImportError:
        raise InputError("xarray is not installed; pip install xarray", code=Code.INSTALLATION) from None
    if strides.empty:
        return xarray.Dataset()
    strides = typed(strides)
    require_once(strides)
    told = conventions_of(strides)
    several = [name for name in DIMENSIONS if name not in ("person", "session") or strides[name].nunique() > 1]
    wide = strides.set_index([*several, "variable"])[list(COLUMNS.values())].unstack("variable")
    columns: dict[str, pd.Series] = {}
    for variable in dict.fromkeys(strides["variable"]):
        columns |= {f"{variable}{ending}": wide[column, variable] for ending, column in COLUMNS.items()}
    dataset = xarray.Dataset.from_dataframe(pd.DataFrame(columns))
    for name in dataset.data_vars:
        variable = str(name).removesuffix("_se").removesuffix("_valid")
        unit, positive = told[variable]
        dataset[name].attrs["units"] = "1" if str(name).endswith("_valid") else unit
        if positive and str(name) == variable:
            dataset[name].attrs["positive"] = positive
    dataset["percent"].attrs["units"] = "%"
    for name in ("person", "session"):
        if name not in several:
            dataset.attrs[name] = strides[name].iloc[0]
    return dataset
