"""`gaitcal export`."""

from __future__ import annotations

from pathlib import Path

from gaitcal.commands.console import Talk
from gaitcal.errors import InputError, UsageError, nearest
from gaitcal.export import write_mjcf, write_osim, write_urdf
from gaitcal.model.model_file import load_model

WRITERS = {"osim": (write_osim, "model.osim"), "urdf": (write_urdf, "model.urdf"), "mjcf": (write_mjcf, "model.xml")}


def run(result: Path, formats: str, out: Path | None, *, quiet: bool, verbose: bool) -> None:
    """Write the fitted model of a result folder in other programs' formats."""
    talk = Talk(quiet=quiet, verbose=verbose)
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
