"""Every finding and every error has a code, every code a page, and no code ever changes its
meaning.
"""

import ast
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gaitcal.cli.application import COMMANDS, HELP, app, load_command
from gaitcal.errors import Code, Finding, InputError, Severity, UsageError
from gaitcal.explanations import (
    PARTS,
    Paragraph,
    load_all_explanations,
    load_explanation,
    split_parts,
)
from gaitcal.quality.verdict import judge
from gaitcal.report.page.page_data import build_verdict_page_data, explain_code

PACKAGE = Path(__file__).parents[1] / "gaitcal"
PAGES = PACKAGE / "explanations" / "pages"
LIST = Path(__file__).parent / "codes.txt"
NEED_A_CODE = ("Finding", "InputError", "PersonError")
"""Calls that must name a code; `UsageError` and `ConvergenceError` have one each of their own."""
LONGEST_LINES = 30


def test_no_code_changes_its_meaning() -> None:
    """A line for each code; a new one is added at the end of its series, none is taken away or
    given again.
    """
    known = dict(line.split() for line in LIST.read_text(encoding="utf-8").splitlines())
    now = {code.value: code.name for code in Code}
    assert now == known
    assert list(now) == sorted(now)


def test_every_finding_and_every_error_of_input_names_its_code() -> None:
    without = []
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            named = isinstance(call.func, ast.Name) and call.func.id in NEED_A_CODE
            if named and not any(keyword.arg in ("code", None) for keyword in call.keywords):
                without.append(f"{path.relative_to(PACKAGE)}:{call.lineno}")
    assert without == []


@pytest.mark.slow
def test_every_code_is_used() -> None:
    source = "".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    unused = [code.name for code in Code if not re.search(rf"\bCode\.{code.name}\b", source)]
    assert unused == []


def test_every_code_has_a_page_and_every_page_a_code() -> None:
    assert {path.stem for path in PAGES.iterdir() if path.suffix == ".md"} == {
        code.value for code in Code
    }
    assert [told.code for told in load_all_explanations()] == list(Code)


@pytest.mark.parametrize("code", Code, ids=lambda code: code.value)
def test_every_page_has_its_parts(code: Code) -> None:
    told = load_explanation(code)
    parts = split_parts(told.text)
    assert tuple(name for name, _ in parts) in (PARTS, (PARTS[0], PARTS[-1]))
    assert all(pieces for _, pieces in parts)
    assert told.markdown == (PAGES / f"{code.value}.md").read_text(encoding="utf-8")
    words = {word.lower() for word in re.split(r", | or ", told.severity)}
    assert words and words <= {"error", "warning", "note"}
    assert 10 <= len(told.markdown.splitlines()) <= LONGEST_LINES
    assert max(map(len, told.markdown.splitlines())) <= 120
    for other in re.findall(r"GC-\d{3}", told.text):
        assert other in {known.value for known in Code}


def test_explain_lists_all_codes() -> None:
    text = CliRunner().invoke(app, ["explain"]).output
    for told in load_all_explanations():
        assert f"  {told.code.value}  {told.title}\n" in text


@pytest.mark.parametrize("word", ["GC-020", "gc-20", "20", "[GC-020]", "GC020"])
def test_explain_prints_a_page_wrapped(word: str) -> None:
    done = CliRunner().invoke(app, ["explain", word])
    assert done.exit_code == 0
    assert done.output.startswith("GC-020: The labels of two markers are swapped\n")
    assert all(part in done.output.splitlines() for part in PARTS)
    assert max(map(len, done.output.splitlines())) <= 100


def test_an_unknown_code_is_one_clear_line() -> None:
    done = CliRunner().invoke(app, ["explain", "GC-999"])
    assert isinstance(done.exception, UsageError)
    assert str(done.exception).startswith("explain: found 'GC-999'; allowed: a code as GC-001")


def test_a_fault_that_is_told_as_a_finding_keeps_its_code() -> None:
    fault = InputError("no such file", source="walk.c3d", code=Code.NO_FILE)
    assert Finding.from_error(fault, "walk", "walk.c3d", "reading").code is Code.NO_FILE


def test_the_page_of_a_result_holds_the_page_of_each_reason() -> None:
    finding = Finding(
        code=Code.SPIKES,
        severity=Severity.WARNING,
        topic="jumps",
        where="walk",
        found="64 mm",
        cure="label again",
    )
    (reason,) = build_verdict_page_data(judge([finding], ["walk"]))["reasons"]
    assert reason["code"] == "GC-018"
    told = explain_code(Code.SPIKES)["page"]
    assert reason["page"] == told
    assert [block["text"] for block in told if block["kind"] == "heading"] == list(PARTS)
    first = split_parts(load_explanation(Code.SPIKES).text)[0][1][0]
    assert isinstance(first, Paragraph) and told[1]["text"] == first.text


def test_every_command_has_an_example_that_parses() -> None:
    assert list(COMMANDS) == list(HELP)
    for name, (_, line) in COMMANDS.items():
        program, told, *arguments = shlex.split(line)
        assert (program, told) == ("gaitcal", name)
        load_command(name).make_context(
            name, arguments
        )  # raises where an argument or option cannot be
        assert f"Example: {line}" in " ".join(
            CliRunner().invoke(app, [name, "--help"]).output.split()
        )
