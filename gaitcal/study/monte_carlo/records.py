"""The records of draws as tables: one row per draw, the same whatever order they came in."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
import pyarrow as pa

from gaitcal.study.monte_carlo.chunk import ChunkResult
from gaitcal.study.monte_carlo.draw import COLUMNS
from gaitcal.study.monte_carlo.settings import Plan, Varied

KEYS = ("set", "level", "draw")
FIELDS = (*KEYS, "evaluations", "failure", *COLUMNS)


def table_of(result: ChunkResult) -> pa.Table:
    """The records of a chunk, columns `FIELDS`."""
    chunk = result.chunk
    columns: dict[str, pa.Array] = {
        "set": pa.array([chunk.varied.value] * chunk.draws),
        "level": pa.array(np.full(chunk.draws, chunk.level, dtype=np.int64)),
        "draw": pa.array(np.arange(chunk.first, chunk.stop, dtype=np.int64)),
        "evaluations": pa.array(result.evaluations),
        "failure": pa.array(result.failures, pa.string()),
    }
    return pa.table(columns | {name: pa.array(result.values[:, k]) for k, name in enumerate(COLUMNS)})


def together(tables: Iterable[pa.Table], plan: Plan | None = None) -> pd.DataFrame:
    """All draws among `tables`, or those of a plan, ordered by set, level and number, each once."""
    kept = list(tables)
    if not kept:
        return pd.DataFrame(columns=list(FIELDS))
    draws = pa.concat_tables(kept).to_pandas()
    order = {varied.value: varied.key for varied in Varied}
    if plan is not None:
        sets, levels = [varied.value for varied in plan.sets], list(plan.levels)
        draws = draws[(draws["draw"] < plan.draws) & draws["set"].isin(sets) & draws["level"].isin(levels)]
    draws = draws.drop_duplicates(list(KEYS))
    return draws.sort_values(list(KEYS), key=lambda c: c.map(order) if c.name == "set" else c, ignore_index=True)
