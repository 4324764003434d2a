"""Names, notes and files of a study are data on its page, whatever they are: in the text, and in a browser."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from gaitcal.page.page_data import calibration_page_data
from gaitcal.page.scene import Scene
from gaitcal.page.view import Shown, page_html
from tests.fake_result import HOSTILE, Names, fake_calibration
from tests.page.browser import Visit
from tests.page.people import walking_scene

WORST = f"</script><!--<script>@@PAGE@@ \\g<0> \u2066\u05d0\u2069 \u2028 \ud800 {HOSTILE}"
TAG = re.compile(r"<(/?script|!--|img|svg)", re.IGNORECASE)


def shown(word: str) -> Shown:
    """A result in which everything that may be named has this name."""
    whole = fake_calibration(Names(word, word, word, word, word, word))
    scene = walking_scene(subject=word)
    trials = tuple(replace(scene.trials[0], name=trial.name) for trial in whole.trials)
    return Shown(replace(scene, trials=trials), calibration_page_data(whole))


@pytest.fixture(scope="module")
def hostile() -> str:
    return page_html(shown(WORST))


def test_a_hostile_study_adds_no_markup(hostile: str) -> None:
    clean = page_html(shown("name"))
    assert TAG.findall(hostile) == TAG.findall(clean)
    found = re.search(r'<script type="application/json" id="result">(.*?)</script>', hostile, re.DOTALL)
    one = json.loads(found.group(1))
    assert one["scene"]["subject"] == one["sheet"]["person"]["name"] == WORST
    assert one["scene"]["trials"][0]["name"] == one["sheet"]["trials"][0]["name"] == WORST
    hostile.encode("utf-8")


@pytest.mark.slow
@pytest.mark.browser
def test_a_browser_makes_nothing_of_them(hostile: str, visit: Visit, tmp_path: Path) -> None:
    (tmp_path / "result.html").write_text(hostile, encoding="utf-8")
    page = visit(tmp_path / "result.html")
    page.run("gaitcal.state.set({ trial: 1, spread: 'mean' })")
    assert page.run("document.querySelectorAll('img, iframe, object, embed, link').length") == 0
    assert page.run("typeof window.hacked") == "undefined"
    assert page.run("document.scripts.length") == 7
    assert page.run("document.getElementById('subject').textContent") == WORST
    page.until("document.documentElement.scrollWidth <= innerWidth")  # its curves have its width
    assert len(page.requests) == 1


def test_a_page_of_a_scene_alone_has_no_sheet(scene: Scene) -> None:
    assert '"sheet":null' in page_html(Shown(scene))
