"""`gaitcal example`: which public recordings there are, and one of them fetched into a folder."""

from __future__ import annotations

import shlex
from pathlib import Path
from urllib.parse import urlsplit

from rich.text import Text

from gaitcal.cli.console import Talk, frameless_table
from gaitcal.cli.init import PLAIN_WIDTH
from gaitcal.errors import UsageError
from gaitcal.io.atomic import require_room
from gaitcal.io.example_download import Connection
from gaitcal.io.example_folder import SOURCE, Step, fetch_example, is_complete, right_files
from gaitcal.io.example_registry import Example, example_named, examples
from gaitcal.io.ownership import ResultKind


def run(name: str | None, out: Path | None, mirror: str | None, talk: Talk) -> None:
    """List the examples, or fetch one: what is asked of whom is told before."""
    if name is None:
        if out is not None or mirror is not None:
            raise UsageError("says where to put an example, and none is named", field="--out" if out else "--mirror")
        _list(talk)
        return
    example = example_named(name)
    folder = Path(name) if out is None else out
    connection = Connection(mirror=mirror)
    if is_complete(example, folder):
        talk.line(f"all {len(example.files)} files are there and right; nothing is fetched")
    else:
        require_room(folder, ResultKind.EXAMPLE)
        _announce(example, folder, connection, talk)
        with talk.working() as step:
            fetch_example(example, folder, connection, lambda at: step(_progress(at)))
        talk.line(f"{len(example.files)} files, SHA-256 as registered: {folder} ({SOURCE} says whose they are)")
    talk.line(f"note:  {example.remark}")
    talk.line(f"next:  gaitcal {example.command.format(dir=shlex.quote(str(folder)))}")


def _list(talk: Talk) -> None:
    table = frameless_table(("name", "recordings", "published as", "licence"), ("files", "MB"))
    for one in examples():
        cells = (
            one.name,
            one.title,
            urlsplit(one.repository).path.strip("/"),
            one.licence,
            str(len(one.files)),
            f"{one.size / 1e6:.1f}",
        )
        table.add_row(*(Text(cell) for cell in cells))
    if not talk.out.is_terminal:
        talk.out.width = PLAIN_WIDTH
    talk.out.print(table)
    talk.line("fetch one:  gaitcal example NAME --out FOLDER")


def _announce(example: Example, folder: Path, connection: Connection, talk: Talk) -> None:
    there = right_files(example, folder)
    rest = [file for file in example.files if file not in there]
    host = connection.mirror or f"https://{', '.join(example.hosts)}"
    kept = f" ({len(there)} are there already)" if there else ""
    talk.line(f"{example.name}: {example.title}")
    talk.line(f"fetching {len(rest)} files, {sum(file.bytes for file in rest) / 1e6:.1f} MB, from {host}{kept}")
    talk.line(f"published by {example.of}: {example.repository}, licence {example.licence}")


def _progress(at: Step) -> str:
    return f"{at.done / 1e6:.1f} of {at.total / 1e6:.1f} MB: {at.name}"
