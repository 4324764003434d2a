"""Commands `explain` (print the page of a code) and `example` (fetch public recordings)."""

import re
import shlex
import textwrap
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

from rich.text import Text

from gaitcal.cli import options
from gaitcal.cli.console import Console, make_frameless_table
from gaitcal.cli.study_folder import PLAIN_WIDTH
from gaitcal.errors import Code, UsageError, suggest_name
from gaitcal.explanations import (
    Bullets,
    Explanation,
    Paragraph,
    load_all_explanations,
    load_explanation,
    split_parts,
)
from gaitcal.io import examples as offered
from gaitcal.io.result_folder import ResultKind, check_output_folder

MIN_WIDTH, MAX_WIDTH = 30, 100
"""Width (columns) of a printed page; longer lines are hard to read."""
SERIES = {"0": "Findings in recordings", "1": "Findings in results", "2": "Errors of commands"}
"""First digit of a code -> heading of its series."""


def explain_code(console: Console, code: options.CodeName = None) -> None:
    """Print the page of a code, or the list of all codes.

    Raises
    ------
    UsageError
        There is no such code.
    """
    width = max(MIN_WIDTH, min(MAX_WIDTH, console.out.width))
    if code is None:
        lines = _format_code_list()
    else:
        lines = _format_page(load_explanation(_parse_code(code)), width)
    for line in lines:
        console.print_line(line)


def _parse_code(name: str) -> Code:
    """Parse a code written as `GC-012`, `gc-12` or `12`.

    Raises UsageError: there is no such code; the message has the nearest one.
    """
    match = re.fullmatch(r"\[?(?:gc)?[-_ ]?(\d{1,3})\]?", name.strip(), re.IGNORECASE)
    known = [code.value for code in Code]
    wanted = f"GC-{int(match.group(1)):03d}" if match else name.strip()[:40]
    if wanted not in known:
        hint = suggest_name(wanted.upper(), known)
        message = (
            f"found '{wanted}'; allowed: a code as {known[0]} ('gaitcal explain' lists all){hint}"
        )
        raise UsageError(message, field="explain")
    return Code(wanted)


def _format_code_list() -> Iterator[str]:
    """Yield lines with all codes and their titles, under a heading for each series."""
    series = ""
    for explanation in load_all_explanations():
        if (digit := explanation.code.value[3]) != series:
            yield from ([] if not series else [""])
            yield f"{SERIES[digit]}:"
            series = digit
        yield f"  {explanation.code.value}  {explanation.title}"
    yield ""
    yield "The page of a code: gaitcal explain GC-020"


def _format_page(explanation: Explanation, width: int) -> Iterator[str]:
    """Format the page of a code for a terminal.

    `width`: width of the lines, columns. Yields one line.
    """
    yield from textwrap.wrap(f"{explanation.code.value}: {explanation.title}", width)
    yield f"({explanation.severity.lower()})"
    for heading, pieces in split_parts(explanation.text):
        yield ""
        yield heading
        for piece in pieces:
            if isinstance(piece, Paragraph):
                yield from _wrap_text(piece.text, width)
            elif isinstance(piece, Bullets):
                for item in piece.items:
                    yield from _wrap_text(item, width, "- ")
            else:
                yield from _wrap_text(" ".join(piece.lines), width)


def _wrap_text(text: str, width: int, mark: str = "") -> list[str]:
    """Wrap text below a heading, without Markdown; `mark` is the bullet of the first line."""
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
    """List the examples, or fetch one after printing its source and licence.

    Raises
    ------
    UsageError
        An option needs the name of an example, or there is no such example.
    InputError
        A file cannot be fetched, or is not the registered one.
    """
    if name is None:
        if out is not None or mirror is not None:
            raise UsageError(
                "found without the name of an example; allowed: with a name",
                field="--out" if out else "--mirror",
            )
        _list_examples(console)
        return
    example = offered.find_example(name)
    folder = Path(name) if out is None else out
    connection = offered.Connection(mirror=mirror)
    if offered.is_complete(example, folder):
        console.print_line(
            f"all {len(example.files)} files are complete and verified; nothing is fetched"
        )
    else:
        check_output_folder(folder, ResultKind.EXAMPLE)
        _print_announcement(example, folder, connection, console)
        with console.show_progress() as step:
            offered.fetch_example(
                example, folder, connection, lambda at: step(_format_progress(at))
            )
        console.print_line(
            f"{len(example.files)} files, SHA-256 as registered: {folder} (source and licence: "
            f"{offered.SOURCE})"
        )
    console.print_line(f"note:  {example.remark}")
    console.print_line(f"next:  gaitcal {example.command.format(dir=shlex.quote(str(folder)))}")


def _list_examples(console: Console) -> None:
    """Print a table of the examples."""
    table = make_frameless_table(("name", "recordings", "published as", "licence"), ("files", "MB"))
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
    console.print_line("fetch one:  gaitcal example NAME --out FOLDER")


def _print_announcement(
    example: offered.Example, folder: Path, connection: offered.Connection, console: Console
) -> None:
    """Print the source, size and licence of the files that will be fetched."""
    present = offered.find_verified_files(example, folder)
    missing = [file for file in example.files if file not in present]
    host = connection.mirror or f"https://{', '.join(example.hosts)}"
    kept = f" ({len(present)} exist already)" if present else ""
    console.print_line(f"{example.name}: {example.title}")
    console.print_line(
        f"fetching {len(missing)} files, {sum(file.bytes for file in missing) / 1e6:.1f} MB, from "
        f"{host}{kept}"
    )
    console.print_line(
        f"published by {example.publisher}: {example.repository}, licence {example.licence}"
    )


def _format_progress(at: offered.DownloadProgress) -> str:
    """Format the progress of a download."""
    return f"{at.done / 1e6:.1f} of {at.total / 1e6:.1f} MB: {at.name}"
