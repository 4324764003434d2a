"""The files of strides in a result folder: `cycles.csv`, its mean curves `ensemble.csv`, and `spatiotemporal.csv`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gaitcal.gait.ensemble import ENSEMBLE_COLUMNS, mean_curves, require_once
from gaitcal.gait.progression import TURNING
from gaitcal.gait.stride_table import CYCLE_COLUMNS, typed
from gaitcal.io.snapshot import sha256_of
from gaitcal.model.subject_model import SubjectModel
from gaitcal.results.cycles import CYCLES, DIGITS, write_cycles
from gaitcal.results.spatiotemporal import (
    SPATIOTEMPORAL,
    SPATIOTEMPORAL_COLUMNS,
    SPATIOTEMPORAL_HEADER,
    spatiotemporal_columns,
)
from gaitcal.results.table_file import VERDICT, Column, Table, read_csv, refused_lines, write_csv
from gaitcal.session.result import TrialResult

if TYPE_CHECKING:
    import pandas as pd  # loaded where a folder holds earlier rows: it takes a third of a second

ENSEMBLE: Final = "ensemble.csv"
STRIDE_FILES: Final = {CYCLES: CYCLE_COLUMNS, SPATIOTEMPORAL: SPATIOTEMPORAL_COLUMNS}
"""With their columns, those that are read back when further trials join them."""
ENSEMBLE_HEADER: Final = (
    "mean curves of cycles.csv over all straight strides of its trials, valid samples alone; units as there",
    "n strides of so many trials at that percent; sd over strides; sd_within strides of a trial, sd_between trials",
    "(empty where no trial has two strides); sd_error: what of sd and sd_within is measurement error, at most",
    "se: standard error of the mean, with the errors that all strides share",
)
"""Comment lines above the header."""


@dataclass(frozen=True)
class EarlierStrides:
    """Rows of trials that a folder holds already, as text."""

    cycles: pd.DataFrame | None
    """None where there are none, as of `spatiotemporal`."""
    cycle_lines: tuple[str, ...]
    """Comment lines about these trials."""
    spatiotemporal: pd.DataFrame | None
    spatiotemporal_lines: tuple[str, ...]


def write_stride_files(
    folder: Path,
    model: SubjectModel,
    trials: Sequence[TrialResult],
    relative_to: Mapping[str, float] | None = None,
    earlier: EarlierStrides | None = None,
) -> None:
    """Write all files of strides of gait trials, those of earlier ones before them.

    `relative_to`: coordinate -> rad in the static posture, from which joint angles are counted.
    """
    before = earlier or EarlierStrides(None, (), None, ())
    cycles = write_cycles(folder / CYCLES, model, trials, relative_to, before.cycles, before.cycle_lines)
    strides = cycles if isinstance(cycles, Mapping) else _numbers(cycles)
    write_csv(_mean_curves(strides), folder / ENSEMBLE, (*_turning_lines(strides), *ENSEMBLE_HEADER))
    table: Table = spatiotemporal_columns(model.subject, trials)
    if before.spatiotemporal is not None and len(before.spatiotemporal):
        import pandas as pd

        table = pd.concat([before.spatiotemporal, pd.DataFrame(table, dtype=object)], ignore_index=True)
    refused = (f"{t.name}: {line}" for t in trials if t.joint is None for line in refused_lines(t))
    write_csv(table, folder / SPATIOTEMPORAL, (*before.spatiotemporal_lines, *refused, *SPATIOTEMPORAL_HEADER))


def _numbers(strides: pd.DataFrame) -> dict[str, Column]:
    """The columns of a table of strides that may hold text, each stride once."""
    table = typed(strides)
    require_once(table)
    return {name: table[name].to_numpy() for name in CYCLE_COLUMNS}


def _mean_curves(strides: Mapping[str, Column]) -> dict[str, NDArray[Any]]:
    if not len(strides["value"]):
        return {name: np.empty(0) for name in ENSEMBLE_COLUMNS}
    curves = mean_curves(strides)
    return {name: np.round(v, DIGITS) if v.dtype.kind == "f" else v for name, v in curves.items()}


def _turning_lines(strides: Mapping[str, Column]) -> tuple[str, ...]:
    """A comment line that names the strides that turn; none where all go straight."""
    turning = np.flatnonzero(np.abs(np.asarray(strides["turn"], dtype=np.float64)) > TURNING)
    named = dict.fromkeys((strides["trial"][k], strides["side"][k], strides["stride"][k]) for k in turning)
    if not named:
        return ()
    words = ", ".join(f"{trial} {side} {stride}" for trial, side, stride in named)
    return (f"left out, strides that turn by more than {TURNING:g} deg (trial, side, stride): {words}",)


def earlier_strides(folder: Path, hashes: Mapping[str, str], kept: Iterable[str]) -> EarlierStrides:
    """Rows of the trials `kept`, with the comment lines about them; none of a file that is not as it was written.

    `hashes`: file -> SHA-256 as it was written.
    """
    names = tuple(kept)
    out = []
    for file in STRIDE_FILES:
        table, lines = None, tuple[str, ...]()
        if file in hashes and sha256_of(folder / file) == hashes[file]:
            table, comments = read_csv(folder / file)
            # with the word that follows: a trial may be called `se`, of which the head speaks as well
            lines = tuple(line for line in comments if line.startswith(tuple(f"{name}: {VERDICT}" for name in names)))
            table = table[table["trial"].isin(names)]
        out.append((table, lines))
    (cycles, cycle_lines), (spatiotemporal, spatiotemporal_lines) = out
    return EarlierStrides(cycles, cycle_lines, spatiotemporal, spatiotemporal_lines)
