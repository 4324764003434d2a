"""The page of two sessions: what it says, no script and no request, names as data, the band and
what lies beyond it.
"""

import base64
import os
import re
from dataclasses import replace
from pathlib import Path

import pytest

from gaitcal.cli.export_commands import render_account_page
from gaitcal.export.opensim.transfer_account import AccountTable
from gaitcal.gait.conventions import Convention, MomentUnit, Signs
from gaitcal.report.figures.chart import SIDE_COLOURS
from gaitcal.report.figures.comparison_sheets import render_comparison_page
from gaitcal.results.session_comparison import compare_sessions
from gaitcal.results.shown_labels import list_person_facts
from tests.report.page.browser import browser, chromium
from tests.report.page.test_accessible import FAULTS
from tests.results.made_sessions import made_session

CONVENTION = Convention(signs=Signs.CLINICAL, unit=MomentUnit.NM_PER_KG)
SHEETS = {"Kinematics": ("knee_angle", "ankle_angle"), "Kinetics": ("knee_angle_moment",)}
HOSTILE = "<img src=x onerror=1>"
SWING = -8.0


@pytest.fixture(scope="module")
def page() -> str:
    a, b = made_session("before"), made_session(HOSTILE, seed=0, swing=SWING)
    found = compare_sessions(a, b)
    scores = [("Gait Profile Score, right", "9.1 ± 0.4", "6.2 ± 0.5", "-2.9")]
    people = [list_person_facts(s) for s in found.subjects]
    return render_comparison_page(
        found, CONVENTION, SHEETS, people, scores, ("free speed", "slow speed")
    )


def svgs(page: str) -> list[str]:
    return [
        base64.b64decode(part).decode() for part in re.findall(r"svg\+xml;base64,([^\"]+)", page)
    ]


def test_it_says_who_what_differs_and_by_how_much(page: str) -> None:
    assert HOSTILE not in page and "&lt;img src=x" in page and "<script" not in page
    assert (
        page.index("Body mass")
        < page.index("What differs")
        < page.index("Kinematics")
        < page.index("Kinetics")
    )
    assert (
        page.index("Kinetics") < page.index("Gait Profile Score") < page.index("Steps and phases")
    )
    assert (
        '<th scope="col">before, against free speed</th>' in page
        and ", against slow speed</th>" in page
    )
    row = re.search(
        r'<tr class="beyond"><th scope="row">right knee flexion, highest in swing</th>(.*?)</tr>',
        page,
    )
    assert row is not None and "<td>-8.0</td>" in row[1]


def test_a_stretch_beyond_the_band_is_marked_and_only_that(page: str) -> None:
    """Right and left knee angle and moment are drawn, the ankle that nobody has is not."""
    kinematics, kinetics = svgs(page)
    assert "Knee flexion, right" in kinematics and "ankle" not in kinematics.lower()
    assert "Knee extension moment, left" in kinetics and "N·m/kg" in kinetics
    assert (count_marks(kinematics), count_marks(kinetics)) == (1, 0)


def count_marks(svg: str) -> int:
    """Bars below curves: opaque areas in the colours of the sides."""
    filled = re.findall(r'style="fill: (#[0-9a-f]{6})"', svg)
    return sum(colour.upper() in SIDE_COLOURS.values() for colour in filled)


def test_moments_are_by_the_mass_of_each_session() -> None:
    """A child that grew by half: the same moments in N·m are less by mass, and the curve
    says so.
    """
    a, b = made_session("before"), made_session("after", seed=0)
    heavy = replace(b.model, subject=replace(b.model.subject, mass=1.5 * b.model.subject.mass))
    pages = [
        render_comparison_page(
            compare_sessions(a, replace(b, model=m)), CONVENTION, SHEETS, ((), ())
        )
        for m in (b.model, heavy)
    ]
    same, grown = (svgs(page)[1] for page in pages)
    assert same != grown and svgs(pages[0])[0] == svgs(pages[1])[0]


def of_an_export() -> str:
    """The other page of this kind, wide tables on it."""
    heads = {
        "title": "Every joint",
        "description": "Moved.",
        "text_columns": ("joint", "body"),
        "number_columns": ("mm", "+-", "deg", "far"),
    }
    table = AccountTable(
        **heads, rows=(("hip_r", HOSTILE, "1.2", "0.3", "", "31, 42, 55, 67, 78, 89"),) * 30
    )
    return render_account_page(
        "mine.osim", (("person", HOSTILE), ("now", "mine.osim")), ["look"], [HOSTILE], [table]
    )


@pytest.mark.browser
@pytest.mark.skipif(chromium() is None, reason="no browser")
def test_they_open_without_a_request_and_a_word_on_the_console(page: str, tmp_path: Path) -> None:
    path, axe = tmp_path / "page.html", os.environ.get("GAITCAL_AXE", "")
    with browser(tmp_path, chromium() or "") as tab:
        for text, images in ((page, 2), (of_an_export(), 0)):
            path.write_text(text, encoding="utf-8")
            tab.open(path.as_uri(), 390, 844)
            assert tab.run("document.documentElement.scrollWidth") <= 390
            assert [
                r for r in tab.requests if not r.startswith(("file:", "data:"))
            ] == [] and tab.console == []
            assert tab.run(f"document.images.length === {images}")
            assert tab.run("[...document.images].every(i => i.naturalWidth > 300)")
            if axe:
                tab.run(f"{Path(axe).read_text(encoding='utf-8')}; true")
                assert tab.run(FAULTS) == []
