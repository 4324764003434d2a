"""`gaitcal compare`."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table
from rich.text import Text

from gaitcal.commands.console import Talk
from gaitcal.compare import compare
from gaitcal.model.model_file import load_model


def run(result: Path, osim: Path, *, quiet: bool, verbose: bool) -> None:
    """Print an OpenSim model's joint axes, masses and lengths beside ours."""
    talk = Talk(quiet=quiet, verbose=verbose)
    table = Table(show_edge=False, pad_edge=False)
    table.add_column("quantity")
    table.add_column("unit")
    for name in ("ours", "theirs", "difference"):
        table.add_column(name, justify="right")
    for row in compare(load_model(result / "model.toml"), osim):
        numbers = (f"{v:.2f}" for v in (row.ours, row.theirs, row.difference))
        table.add_row(Text(row.quantity), Text(row.unit), *numbers)
    talk.out.print(table)
