"""`gaitcal convert`, `export` and `compare`: files from other programs, for them, and beside ours."""

from __future__ import annotations

from pathlib import Path

from rich.text import Text

from gaitcal.commands.console import Talk, frameless_table
from gaitcal.compare import compare
from gaitcal.errors import InputError, UsageError, nearest
from gaitcal.export import write_mjcf, write_osim, write_urdf
from gaitcal.model.model_file import load_model
from gaitcal.recording import convert

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
    model = load_model(result / "model.toml")
    folder = out or result / "export"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", source=folder) from None
    for name in chosen:
        write, file = WRITERS[name]
        write(model, folder / file)
        talk.line(f"wrote {folder / file}")


def compare_models(result: Path, osim: Path, talk: Talk) -> None:
    """Print an OpenSim model's joint axes, masses and lengths beside ours."""
    table = frameless_table(("quantity", "unit"), ("ours", "theirs", "difference"))
    for row in compare(load_model(result / "model.toml"), osim):
        numbers = (f"{v:.2f}" for v in (row.ours, row.theirs, row.difference))
        table.add_row(Text(row.quantity), Text(row.unit), *numbers)
    talk.out.print(table)
