"""Where things stand: switches in a row, curves above the fold, the verdict of a phone, the order of Trust, paper."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gaitcal.page.view import Shown, page_html
from tests.page.browser import Page
from tests.page.made_page import long_walks, stridden

pytestmark = [pytest.mark.browser, pytest.mark.slow]
Visit = Callable[..., Page]
STRIDES = {0: {"r": [0.103, 0.551, 0.987], "l": [0.252, 0.741]}}
ROW = 40
"""px: one row of switches."""
VISIBLE = "(e => { const r = e.getBoundingClientRect(); return r.top < innerHeight && r.bottom > 0; })"


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("walked") / "result.html"
    scene = long_walks()
    sheet: Any = stridden(scene, STRIDES)[0]
    path.write_text(page_html(Shown(scene, sheet)), encoding="utf-8")
    return path


def words(page: Page, selector: str) -> list[str]:
    return list(page.run(f"[...document.querySelectorAll({selector!r})].map(e => e.textContent.trim())"))


def test_switches_are_a_row_and_say_what_is_set_behind_the_button(visit: Visit, walked: Path) -> None:
    page = visit(walked, 1280, 800)
    assert page.run("document.getElementById('switches').offsetHeight") <= ROW
    assert page.run("document.getElementById('switches-others').hidden")
    assert words(page, "#switches-more") == ["More"]
    page.run("gaitcal.state.set({ acting: 'external', nominal: true, off: new Set(['0/r/1']) })")
    assert words(page, "#switches-more") == ["More: external, before calibration"]
    assert words(page, "#switches .told") == ["external, clinical signs"]
    page.run("document.getElementById('switches-more').click()")
    assert not page.run("document.getElementById('switches-others').hidden")
    assert page.run("document.getElementById('switches-more').getAttribute('aria-expanded')") == "true"


def test_a_joint_of_the_address_is_in_view(visit: Visit, walked: Path) -> None:
    page = visit(f"{walked.as_uri()}?joint#joint=ankle_r", 1280, 400)
    page.run("new Promise(done => setTimeout(() => done(true), 300))")
    large = "document.querySelector('.curve-group.large')"
    assert page.run(f"{large}.dataset.joint") == "ankle" and page.run("scrollY") > 0
    assert 0 <= page.run(f"{large}.getBoundingClientRect().top") < page.run("innerHeight / 2")


def test_a_phone_shows_the_first_line_until_more_is_asked_for(visit: Visit, everything: Path) -> None:
    page = visit(everything, 390, 844, phone=True)
    seen = "[...document.querySelectorAll('#verdict .lines li')].filter(li => li.offsetHeight > 0).length"
    assert page.run(seen) == 1
    page.run("document.querySelector('#verdict .more').click()")
    assert page.run(seen) == 3 and words(page, "#verdict .more") == ["Less"]


def test_trust_tells_of_the_trial_between_verdict_and_calibration(visit: Visit, everything: Path) -> None:
    page = visit(everything, 1280, 800)
    page.run("gaitcal.state.set({ preset: 'trust', playing: false })")
    parts = page.run("[...document.querySelectorAll('#sections > :is(.reasons, .of-trial, h2)')].map(e => e.className)")
    assert parts == ["", "reasons refused", "of-trial", "of-all"]
    assert page.run("document.querySelector('.of-all').nextElementSibling.tagName") == "H3"


def test_a_key_names_bounds_only_where_one_is_seen(visit: Visit, everything: Path) -> None:
    page = visit(everything, 1280, 800)
    row = {"label": "axis", "nominal": 0.0, "fitted": 1.0, "se": None, "truth": None}
    rows = [{**row, "bounds": bounds} for bounds in ([-50.0, 50.0], [None, 1.0])]
    made = "Gaitcal.BLOCKS.intervals({unit: 'mm', rows: [%s]}, new Gaitcal.Blocks({})).querySelector('.key')"
    told_of = [page.run(f"({made % json.dumps(row)})?.textContent ?? ''") for row in rows]
    assert ["bound" in text for text in told_of] == [False, True]
