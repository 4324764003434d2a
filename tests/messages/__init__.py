"""The wording of messages stands in the TOML files of this folder, which a person reviews.

Tests assert codes, fields, names and numbers by `check_finding`, `check_text` and `refuses`, which
record what a user reads. What a test recorded must be what the files have of it;
`pytest --update-messages` rewrites that of the tests that run. Figures and folders are left out:
`#` stands for every number.
"""

import difflib
import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import tomllib

from gaitcal.errors import Code, Finding, GaitcalError, Severity

FOLDER = Path(__file__).parent
FILES = {"GC-0": "recordings", "GC-1": "results", "GC-2": "refusals", "": "notes"}
"""File of each series of codes; the last has what has no code."""
HINT = "If the new wording is meant: pytest --update-messages, and review the change."
_NUMBER = re.compile(
    r"(?:(?<![\w.])[-+])?(?<![A-Za-z_.\d])\d+(?:\.\d+)*(?:e[-+]?\d+)?(?![A-Za-z_])"
)
_FOLDERS = re.compile(r"(?:(?<=file://)|(?<![\w.:/]))/(?:[^\s/'\",;:)]+/)+")
_TEST_FOLDER = re.compile(r"\btest_\w{1,25}?\d+\b")
"""Name of `tmp_path`: its number depends on the tests that ran before."""
_REPEATED = re.compile(r"(\w)\1{19,}")

Entry = tuple[str, str, str, str]
"""Heading (code and name, or `note`), cause, text, cure."""
_recorded: list[Entry] = []
_book: dict[str, list[Entry]] = {}
"""What each test recorded, as the files have it, or, where they are rewritten, as it was now."""


def numbers(text: str) -> list[float]:
    """The numbers in a text, in order; a dash between two is no sign."""
    return [float(number) for number in _NUMBER.findall(text) if number.count(".") < 2]


def without_figures(text: str) -> str:
    """Replace each number by `#`, leave out folders of files, and shorten long repetitions."""
    named = _TEST_FOLDER.sub("tmp_path", _FOLDERS.sub("", " ".join(text.split())))
    return _NUMBER.sub("#", _REPEATED.sub(r"\1...", named))


def _record(message: Finding | Exception | str) -> None:
    """Compare this message, once the test has passed, with the reviewed one."""
    code = getattr(message, "code", None)
    heading = f"{code.value} {code.name}" if code else "note"
    parts = ("", str(message), "")
    if isinstance(message, Finding):
        parts = (message.cause, message.found, message.cure)
    cause, text, cure = map(without_figures, parts)
    _recorded.append((heading, cause, text, cure))


def require_parts(text: str, parts: Iterable[object]) -> None:
    """Each part stands in the text: a name, or a number."""
    assert _list_missing(text, parts) == [], text


def _list_missing(text: str, parts: Iterable[object]) -> list[object]:
    found = numbers(text)
    return [p for p in parts if (p not in text if isinstance(p, str) else p not in found)]


def check_text(text: str | Iterable[str], *parts: str | float) -> None:
    """A text, or some notes, in which these names and numbers stand."""
    texts = [text] if isinstance(text, str) else list(text)
    require_parts(" ".join(texts), parts)
    for one in texts:
        _record(one)


def check_note(notes: Iterable[str], *parts: str | float) -> None:
    """One of some notes, in which these names and numbers stand."""
    texts = list(notes)
    found = [text for text in texts if not _list_missing(text, parts)]
    assert found, texts
    _record(found[0])


def check_finding(finding: Finding, code: Code, *parts: object, **fields: object) -> None:
    """A finding of this code (and `Severity`, where it is among the parts), of these fields, that
    names these parts.
    """
    severities = [part for part in parts if isinstance(part, Severity)]
    assert finding.code is code, (finding.code, finding.line)
    assert severities in ([], [finding.severity]), (finding.severity, finding.line)
    assert {name: getattr(finding, name) for name in fields} == fields, finding.line
    require_parts(finding.line, (part for part in parts if not isinstance(part, Severity)))
    _record(finding)


@contextmanager
def refuses(
    what: Code | type[Exception], *parts: str | float, field: str = "", source: object = ""
) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """What stands below is refused with this code, of this field and file, in one line that names
    these parts (names and numbers).
    """
    with pytest.raises(GaitcalError if isinstance(what, Code) else what) as caught:
        yield caught
    text = str(caught.value)
    if isinstance(caught.value, GaitcalError) and isinstance(what, Code):
        assert caught.value.code is what, text
        assert "\n" not in text
    assert all(f"{part}: " in text for part in (source, field) if part), text
    require_parts(text, parts)
    _record(caught.value)


def read_book() -> dict[str, list[Entry]]:
    """What each test recorded, by its name."""
    book = defaultdict(list)
    for path in sorted(FOLDER.glob("*.toml")):
        for heading, rows in tomllib.loads(path.read_text(encoding="utf-8")).items():
            for row in rows:
                entry = (heading, row.get("cause", ""), row["text"], row.get("cure", ""))
                for test in row["tests"]:
                    book[test].append(entry)
    return {test: sorted(entries) for test, entries in book.items()}


def write_book(book: dict[str, list[Entry]]) -> None:
    """The files, each message once, by code; tests that are no more are left out."""
    tests: dict[Entry, list[str]] = defaultdict(list)
    for test in sorted(book):
        file, _, name = test.partition("::")
        path = FOLDER.parent / file
        if path.is_file() and f"def {name.split('[')[0]}(" in path.read_text(encoding="utf-8"):
            for entry in book[test]:
                tests[entry].append(test)
    blocks = defaultdict(list)
    for entry in sorted(tests):
        heading, *parts = entry
        lines = [f"[[{json.dumps(heading)}]]"]
        for key, part in zip(("cause", "text", "cure"), parts, strict=True):
            lines += [f"{key} = {json.dumps(part, ensure_ascii=False)}"] * bool(part)
        names = [f"    {json.dumps(test)}," for test in tests[entry]]
        series = next(s for s in FILES if heading.startswith(s))
        blocks[series].append("\n".join([*lines, "tests = [", *names, "]", ""]))
    for series, name in FILES.items():
        (FOLDER / f"{name}.toml").write_text("\n".join(blocks[series]), encoding="utf-8")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-messages", action="store_true", help="rewrite tests/messages/ of the tests run"
    )


def pytest_configure(config: pytest.Config) -> None:
    if not config.getoption("--update-messages"):
        _book.update(read_book())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Compare what the test recorded, or keep it; slow tests are about other things."""
    _recorded.clear()
    yield
    if item.get_closest_marker("slow"):
        return
    test, found = item.nodeid.removeprefix("tests/"), sorted(set(_recorded))
    if item.config.getoption("--update-messages"):
        _book[test] = found
    elif found != _book.get(test, []):
        before, after = (
            [" | ".join(e) for e in entries] for entries in (_book.get(test, []), found)
        )
        lines = difflib.ndiff(before, after)
        pytest.fail("\n".join(["messages are not as reviewed:", *lines, HINT]), pytrace=False)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take what another process of `-n` recorded."""
    for test, entries in getattr(node, "workeroutput", {}).get("messages", {}).items():
        _book[test] = [tuple(entry) for entry in entries]


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the files, or hand on what is to be written."""
    if session.config.getoption("--update-messages"):
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput["messages"] = _book
        else:
            write_book(read_book() | _book)
