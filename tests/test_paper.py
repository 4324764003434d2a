"""The paper cites what its references hold, and its figure is drawn from its table."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

PAPER = Path(__file__).parents[1] / "docs" / "paper"
SECTIONS = ("Summary", "Statement of need", "State of the field", "Software design", "Quality control", "References")


@pytest.fixture(scope="module")
def figures() -> ModuleType:
    spec = importlib.util.spec_from_file_location("paper_figures", PAPER / "figures.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_every_reference_is_cited_and_has_a_doi() -> None:
    text = (PAPER / "paper.md").read_text(encoding="utf-8")
    entries = re.split(r"^@\w+\{", (PAPER / "paper.bib").read_text(encoding="utf-8"), flags=re.M)[1:]
    keys = {entry.split(",")[0]: re.findall(r"doi\s*= \{(10\.\d{4,}/\S+)\}", entry) for entry in entries}
    assert set(re.findall(r"(?<![\w.])@(\w+)", text)) == set(keys)
    assert all(len(dois) == 1 for dois in keys.values())


def test_the_paper_has_its_parts_and_figures() -> None:
    text = (PAPER / "paper.md").read_text(encoding="utf-8")
    assert re.findall(r"^# (.+)$", text, re.M)[:4] == list(SECTIONS[:4])
    assert set(SECTIONS) <= set(re.findall(r"^# (.+)$", text, re.M))
    assert all((PAPER / name).is_file() for name in re.findall(r"!\[.*\]\((.+?)\)", text, re.S))
    assert len(text.split()) < 1750, "JOSS takes 750 to 1750 words"


def test_the_figure_is_drawn_from_its_table(figures: ModuleType, tmp_path: Path) -> None:
    rows = figures.read(PAPER / "truth.csv")
    assert {row.part for row in rows} == set(figures.PARTS)
    figures.write(rows, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (PAPER / "truth.csv").read_bytes()
    figures.draw(rows, tmp_path / "truth.png")
    assert (tmp_path / "truth.png").stat().st_size > 10_000
