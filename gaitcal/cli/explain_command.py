"""`gaitcal explain`, the page of a code, and `gaitcal example`, public recordings that are fetched
into a folder.
"""

import re
import shlex
import textwrap
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

from rich.text import Text

from gaitcal.cli import options
from gaitcal.cli.console import Console, frameless_table
from gaitcal.cli.study_folder import PLAIN_WIDTH
from gaitcal.errors import Code, UsageError, nearest
from gaitcal.explanations import (
    Bullets,
    Explanation,
    Paragraph,
    all_explanations,
    explanation_of,
    parts_of,
)
from gaitcal.io import examples as offered
from gaitcal.io.result_folder import ResultKind, check_output_folder

WIDEST = 100  # Columns: longer lines are hard to read
NARROWEST = 30
SERIES = {"0": "Found in recordings", "1": "Told of a result", "2": "What stops a command"}
"""First digit of a code -> what its codes are of."""


def explain_code(console: Console, code: options.CodeName = None) -> None:
    """Print what a code means; without a name, a list of all codes."""
    width = max(NARROWEST, min(WIDEST, console.out.width))
    lines = listing() if code is None else page(explanation_of(code_named(code)), width)
    for line in lines:
        console.line(line)


def code_named(name: str) -> Code:
    """The code that somebody means: `GC-012`, `gc-12`, `12`; UsageError with the nearest for one
    that is not there.
    """
    said = re.fullmatch(r"\[?(?:gc)?[-_ ]?(\d{1,3})\]?", name.strip(), re.IGNORECASE)
    known = [code.value for code in Code]
    wanted = f"GC-{int(said.group(1)):03d}" if said else name.strip()[:40]
    if wanted not in known:
        hint = nearest(wanted.upper(), known)
        message = (
            f"found '{wanted}'; allowed: a code as {known[0]} ('gaitcal explain' lists all){hint}"
        )
        raise UsageError(message, field="explain")
    return Code(wanted)


def listing() -> Iterator[str]:
    """All codes with their titles, under a heading for each series."""
    series = ""
    for explanation in all_explanations():
        if (digit := explanation.code.value[3]) != series:
            yield from ([] if not series else [""])
            yield f"{SERIES[digit]}:"
            series = digit
        yield f"  {explanation.code.value}  {explanation.title}"
    yield ""
    yield "The page of one: gaitcal explain GC-020"


def page(explanation: Explanation, width: int) -> Iterator[str]:
    """The page of a code as lines of a terminal."""
    yield from textwrap.wrap(f"{explanation.code.value}: {explanation.title}", width)
    yield f"({explanation.severity.lower()})"
    for heading, pieces in parts_of(explanation.text):
        yield ""
        yield heading
        for piece in pieces:
            if isinstance(piece, Paragraph):
                yield from _wrapped(piece.text, width)
            elif isinstance(piece, Bullets):
                for item in piece.items:
                    yield from _wrapped(item, width, "- ")
            else:
                yield from _wrapped(" ".join(piece.lines), width)


def _wrapped(text: str, width: int, mark: str = "") -> list[str]:
    """Lines indented below their heading, without the marks of Markdown."""
    plain = re.sub(r"[`*]", "", text) if "`" in text or "**" in text else text
    indent = "  " + " " * len(mark)
    return textwrap.wrap(
        plain, width, initial_indent=f"  {mark}", subsequent_indent=indent, break_long_words=False
    )


def fetch_or_list(
    console: Console,
    name: options.ExampleName = None,
    out: options.ExampleOut = None,
    mirror: options.Mirror = None,
) -> None:
    """List the examples, or fetch one: what is asked of whom is told before."""
    if name is None:
        if out is not None or mirror is not None:
            raise UsageError(
                "says where to put an example, and none is named",
                field="--out" if out else "--mirror",
            )
        _list(console)
        return
    example = offered.find_example(name)
    folder = Path(name) if out is None else out
    connection = offered.Connection(mirror=mirror)
    if offered.is_complete(example, folder):
        console.line(f"all {len(example.files)} files are there and right; nothing is fetched")
    else:
        check_output_folder(folder, ResultKind.EXAMPLE)
        _announce(example, folder, connection, console)
        with console.working() as step:
            offered.fetch_example(example, folder, connection, lambda at: step(_progress(at)))
        console.line(
            f"{len(example.files)} files, SHA-256 as registered: {folder} ({offered.SOURCE} says "
            "whose they are)"
        )
    console.line(f"note:  {example.remark}")
    console.line(f"next:  gaitcal {example.command.format(dir=shlex.quote(str(folder)))}")


def _list(console: Console) -> None:
    table = frameless_table(("name", "recordings", "published as", "licence"), ("files", "MB"))
    for one in offered.load_examples():
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


def _announce(
    example: offered.Example, folder: Path, connection: offered.Connection, console: Console
) -> None:
    there = offered.find_verified_files(example, folder)
    rest = [file for file in example.files if file not in there]
    host = connection.mirror or f"https://{', '.join(example.hosts)}"
    kept = f" ({len(there)} are there already)" if there else ""
    console.line(f"{example.name}: {example.title}")
    console.line(
        f"fetching {len(rest)} files, {sum(file.bytes for file in rest) / 1e6:.1f} MB, from "
        f"{host}{kept}"
    )
    console.line(
        f"published by {example.publisher}: {example.repository}, licence {example.licence}"
    )


def _progress(at: offered.DownloadProgress) -> str:
    return f"{at.done / 1e6:.1f} of {at.total / 1e6:.1f} MB: {at.name}"
