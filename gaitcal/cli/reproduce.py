"""`gaitcal reproduce`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from rich.text import Text

from gaitcal.cli.console import Console, frameless_table
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.atomic import atomic_directory, require_room
from gaitcal.io.lock import ResultKind
from gaitcal.published.claims import Claim, Kind, Verdict
from gaitcal.published.reproduce import Reproduction, ReproductionSettings, SensitivityDraws, reproduce, write_tables
from gaitcal.published.tables import RUN, TableRow

DATA = "GAITCAL_DATA"
KEPT = ".draws"
"""Ending of the folder, beside the output, that keeps Monte Carlo draws: an interrupted study goes on there."""
_CLAIMS = {Kind.PAPER: "claims of the paper", Kind.SENSITIVITY: "sensitivities, ours"}
_DECIDED = (Verdict.HOLDS, Verdict.FAILS, Verdict.UNDECIDED)
_SHOWN = ("I", "III", "discussion")


def run(out: Path, console: Console, *, draws: int, noise_seeds: int, seed: int, sensitivities: bool) -> None:
    """Run the published study, write its tables and print them."""
    settings = ReproductionSettings(
        noise_seeds=noise_seeds,
        seed=seed,
        draws=draws,
        sensitivities=SensitivityDraws() if sensitivities else None,
        data=_data(),
    )
    kept = out.with_name(out.name + KEPT) if draws else None
    require_room(out, ResultKind.REPRODUCTION)
    with console.working() as step, atomic_directory(out, ResultKind.REPRODUCTION) as folder:
        reproduction = reproduce(settings, kept, step)
        step("writing the tables")
        write_tables(reproduction, folder)
    print_reproduction(console, reproduction)
    console.line(f"tables: {out}")
    if kept is not None:
        console.line(f"draws:  {kept} (a further run with the same seed goes on from them)")


def _data() -> Path | None:
    named = os.environ.get(DATA)
    if not named:
        return None
    if not Path(named).is_dir():
        raise InputError("is no folder", source=named, field=DATA, code=Code.NO_FILE)
    return Path(named)


def print_reproduction(console: Console, reproduction: Reproduction) -> None:
    """Tables I and III, the discussion, the claims and the times; everything else is in the files."""
    for name in _SHOWN:
        rows = [row for row in reproduction.tables if row.table == name]
        console.line()
        console.line("Discussion" if name == "discussion" else f"Table {name}")
        _print_rows(console, rows)
    console.line()
    console.line(
        f"Medians of {len(reproduction.noisy)} noise draws where there is noise; ranges are in tables.csv. Times:"
    )
    _print_rows(console, [row for row in reproduction.times if row.row != RUN])
    laps = (f"{row.column} {row.ours:.0f} s" for row in reproduction.times if row.row == RUN)
    console.line(f"{RUN}: {', '.join(laps)}")
    console.line()
    _print_claims(console, reproduction.claims)


def _print_rows(console: Console, rows: Sequence[TableRow]) -> None:
    columns = list(dict.fromkeys(row.column for row in rows))
    table = frameless_table(("ours | published",), columns)
    for title in dict.fromkeys(row.row for row in rows):
        cells = {row.column: _cell(row) for row in rows if row.row == title}
        table.add_row(Text(title), *(cells.get(column, "") for column in columns))
    console.out.print(table)


def _cell(row: TableRow) -> str:
    ours, published = ("-" if value is None else f"{value:.3g}" for value in (row.ours, row.published))
    return f"{ours} | {published} {row.unit}"


def _print_claims(console: Console, claims: Sequence[Claim]) -> None:
    """Those of the paper and ours apart: whether ours hold says nothing of the paper."""
    for kind, title in _CLAIMS.items():
        of_kind = [claim for claim in claims if claim.kind is kind]
        table = frameless_table((title, "published", "ours", "verdict"))
        for claim in of_kind:
            if claim.verdict in _DECIDED or console.verbose:
                table.add_row(*(Text(t) for t in (claim.claim, claim.published, claim.ours, claim.verdict.value)))
        if table.row_count:
            console.out.print(table)
        counts = {v: sum(claim.verdict is v for claim in of_kind) for v in Verdict}
        console.line(f"{title}: " + ", ".join(f"{count} {v.value}" for v, count in counts.items() if count))
