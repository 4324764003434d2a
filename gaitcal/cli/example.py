"""`gaitcal example`: which public recordings there are, and one of them fetched into a folder."""

from __future__ import annotations

import shlex
from pathlib import Path
from urllib.parse import urlsplit

from rich.text import Text

from gaitcal.cli.console import Console, frameless_table
from gaitcal.cli.folder import PLAIN_WIDTH
from gaitcal.errors import UsageError
from gaitcal.io.examples import (
    SOURCE,
    Connection,
    Example,
    Step,
    example_named,
    examples,
    fetch_example,
    is_complete,
    right_files,
)
from gaitcal.io.result_folder import ResultKind, require_room


def fetch_or_list(name: str | None, out: Path | None, mirror: str | None, console: Console) -> None:
    """List the examples, or fetch one: what is asked of whom is told before."""
    if name is None:
        if out is not None or mirror is not None:
            raise UsageError("says where to put an example, and none is named", field="--out" if out else "--mirror")
        _list(console)
        return
    example = example_named(name)
    folder = Path(name) if out is None else out
    connection = Connection(mirror=mirror)
    if is_complete(example, folder):
        console.line(f"all {len(example.files)} files are there and right; nothing is fetched")
    else:
        require_room(folder, ResultKind.EXAMPLE)
        _announce(example, folder, connection, console)
        with console.working() as step:
            fetch_example(example, folder, connection, lambda at: step(_progress(at)))
        console.line(f"{len(example.files)} files, SHA-256 as registered: {folder} ({SOURCE} says whose they are)")
    console.line(f"note:  {example.remark}")
    console.line(f"next:  gaitcal {example.command.format(dir=shlex.quote(str(folder)))}")


def _list(console: Console) -> None:
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
    if not console.out.is_terminal:
        console.out.width = PLAIN_WIDTH
    console.out.print(table)
    console.line("fetch one:  gaitcal example NAME --out FOLDER")


def _announce(example: Example, folder: Path, connection: Connection, console: Console) -> None:
    there = right_files(example, folder)
    rest = [file for file in example.files if file not in there]
    host = connection.mirror or f"https://{', '.join(example.hosts)}"
    kept = f" ({len(there)} are there already)" if there else ""
    console.line(f"{example.name}: {example.title}")
    console.line(f"fetching {len(rest)} files, {sum(file.bytes for file in rest) / 1e6:.1f} MB, from {host}{kept}")
    console.line(f"published by {example.of}: {example.repository}, licence {example.licence}")


def _progress(at: Step) -> str:
    return f"{at.done / 1e6:.1f} of {at.total / 1e6:.1f} MB: {at.name}"
