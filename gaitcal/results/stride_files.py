"""The files of strides in a result folder: `cycles.csv`, its mean curves `ensemble.csv`, and `spatiotemporal.csv`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pandas as pd

from gaitcal.files.snapshot import sha256_of
from gaitcal.gait.ensemble import ensemble
from gaitcal.gait.progression import TURNING
from gaitcal.gait.stride_table import CYCLE_COLUMNS, typed
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.person.result import TrialResult
from gaitcal.results.cycles import CYCLES, DIGITS, write_cycles
from gaitcal.results.spatiotemporal import (
    SPATIOTEMPORAL,
    SPATIOTEMPORAL_COLUMNS,
    SPATIOTEMPORAL_HEADER,
    spatiotemporal_table,
)
from gaitcal.results.table_file import VERDICT, read_csv, refused_lines, write_csv

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

    cycles: pd.DataFrame
    cycle_lines: tuple[str, ...]
    """Comment lines about these trials."""
    spatiotemporal: pd.DataFrame
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
    none = EarlierStrides(pd.DataFrame(), (), pd.DataFrame(), ())
    before = earlier or none
    cycles = write_cycles(folder / CYCLES, model, trials, relative_to, before.cycles, before.cycle_lines)
    numbers = typed(cycles)
    write_csv(ensemble(numbers).round(DIGITS), folder / ENSEMBLE, (*_turning_lines(numbers), *ENSEMBLE_HEADER))
    table = spatiotemporal_table(model.subject, trials)
    if len(before.spatiotemporal):
        table = pd.concat([before.spatiotemporal, table.astype(object)], ignore_index=True)
    refused = (f"{t.name}: {line}" for t in trials if t.joint is None for line in refused_lines(t))
    write_csv(table, folder / SPATIOTEMPORAL, (*before.spatiotemporal_lines, *refused, *SPATIOTEMPORAL_HEADER))


def _turning_lines(strides: pd.DataFrame) -> tuple[str, ...]:
    """A comment line that names the strides that turn; none where all go straight."""
    if "turn" not in strides:
        return ()
    turning = strides[strides["turn"].abs() > TURNING]
    named = dict.fromkeys(turning[["trial", "side", "stride"]].itertuples(index=False, name=None))
    if not named:
        return ()
    words = ", ".join(f"{trial} {side} {stride}" for trial, side, stride in named)
    return (f"left out, strides that turn by more than {TURNING:g} deg (trial, side, stride): {words}",)


def earlier_strides(folder: Path, hashes: Mapping[str, str], kept: Iterable[str], subject: Subject) -> EarlierStrides:
    """Rows of the trials `kept`, with the comment lines about them; none of a file that is not as it was written.

    `hashes`: file -> SHA-256 as it was written. Rows of a version that named no person are those of `subject`.
    """
    names = tuple(kept)
    out = []
    for file, columns in STRIDE_FILES.items():
        table, lines = pd.DataFrame(), tuple[str, ...]()
        if file in hashes and sha256_of(folder / file) == hashes[file]:
            table, comments = read_csv(folder / file)
            # with the word that follows: a trial may be called `se`, of which the head speaks as well
            lines = tuple(line for line in comments if line.startswith(tuple(f"{name}: {VERDICT}" for name in names)))
            table = table[table["trial"].isin(names)]
            if "person" not in table:
                table = table.assign(person=subject.name, session=subject.session)
            table = table.reindex(columns=list(columns))  # an earlier version had fewer, in another order
        out.append((table, lines))
    (cycles, cycle_lines), (spatiotemporal, spatiotemporal_lines) = out
    return EarlierStrides(cycles, cycle_lines, spatiotemporal, spatiotemporal_lines)
