"""`gaitcal convert`, `export` and `compare`: files from other programs, for them, and beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.text import Text

from gaitcal.commands.console import Talk, frameless_table
from gaitcal.compare import compare
from gaitcal.errors import UsageError, nearest
from gaitcal.export import write_mjcf, write_osim, write_urdf
from gaitcal.files.amend import amended
from gaitcal.files.snapshot import Snapshot
from gaitcal.findings import Finding, note_of
from gaitcal.recording import convert
from gaitcal.results.saved import load_result_model

WRITERS = {"osim": (write_osim, "model.osim"), "urdf": (write_urdf, "model.urdf"), "mjcf": (write_mjcf, "model.xml")}


def convert_recording(source: Path, target: Path, talk: Talk) -> None:
    """Convert one recording and say which files were written."""
    for path in convert(source, target):
        talk.line(f"wrote {path}")


def export_model(result: Path, formats: str, out: Path | None, talk: Talk) -> None:
    """Write the fitted model of a result folder in other programs' formats."""
    chosen = [name.strip() for name in formats.split(",") if name.strip()]
    if not chosen:
        raise UsageError(f"found nothing; at least one of {', '.join(WRITERS)} is needed", field="--format")
    for name in chosen:
        if name not in WRITERS:
            raise UsageError(f"found '{name}'; allowed: {', '.join(WRITERS)}{nearest(name, WRITERS)}", field="--format")
    model, read, doubts = load_result_model(result)
    folder = out or result / "export"
    with amended(folder) as stage:
        for name in chosen:
            write, file = WRITERS[name]
            write(model, stage / file)
        read.require_unchanged()
    _tell(talk, read, doubts)
    for name in chosen:
        talk.line(f"wrote {folder / WRITERS[name][1]}")


def compare_models(result: Path, osim: Path, talk: Talk) -> None:
    """Print an OpenSim model's joint axes, masses and lengths beside ours."""
    table = frameless_table(("quantity", "unit"), ("ours", "theirs", "difference"))
    model, read, doubts = load_result_model(result)
    _tell(talk, read, doubts)
    for row in compare(model, osim):
        numbers = (f"{v:.2f}" for v in (row.ours, row.theirs, row.difference))
        table.add_row(Text(row.quantity), Text(row.unit), *numbers)
    talk.out.print(table)


def _tell(talk: Talk, read: Snapshot, doubts: Sequence[Finding]) -> None:
    """What a user of the model should know: files that were edited, a calibration that is doubtful or refused."""
    for text in (*read.remarks, *map(note_of, doubts)):
        talk.line(f"warning: {text}")
