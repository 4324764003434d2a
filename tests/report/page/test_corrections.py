"""What a reader changes: strides in and out of means, events, comments; and what is first seen."""

import json
from pathlib import Path
from typing import Any

import pytest
import tomllib

from gaitcal.io.csv_recordings import EVENT_FILE, apply_corrected_events, write_markers_csv
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.report.gait_report import read_comments
from tests.io.recordings import body
from tests.report.page.browser import STEADY, Page, Visit
from tests.report.page.made_page import HOSTILE, long_walks, stridden, written_page

pytestmark = [pytest.mark.browser, pytest.mark.slow]
STRIDES = {0: {"r": [0.103, 0.551, 0.987, 1.1], "l": [0.252, 0.741]}, 1: {"r": [0.05, 0.5]}}
START = 2.0
"""s: the first walk's begin on the clock of its recording."""
KEEP = "Gaitcal.download = (...said) => { window.said = said; }; 0"


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = long_walks(2)
    sheet: Any = stridden(scene, STRIDES)[0]
    reasons = {"plate": "2", "reason": ""}, {"plate": "", "reason": "foot beside the plate"}
    for trial, (name, start) in zip(
        sheet["trials"], (("walk.csv", START), ("other.csv", 0.0)), strict=True
    ):
        trial |= {"file": name, "start": start}
        for k, stride in enumerate(trial["strides"]):
            stride |= reasons[k % 2]
    return written_page(tmp_path_factory.mktemp("corrected"), scene, sheet)


def opened(visit: Visit, path: Path) -> Page:
    page = visit(path, 1440, 900)
    page.run(f"gaitcal.clock.play(false); {KEEP}; {STEADY}")
    return page


@pytest.fixture
def page(visit: Visit, walked: Path) -> Page:
    return opened(visit, walked)


def pressed(page: Page, host: str, words: str) -> None:
    buttons = f"[...document.querySelectorAll('#{host} button')]"
    page.run(f"{buttons}.find(button => button.textContent === {json.dumps(words)}).click()")


def test_what_is_first_seen_is_both_sheets_steps_and_strides(page: Page) -> None:
    """At 1440 x 900 without scrolling; on the phone the first curve ends within 420 px."""
    legs = (
        "['hip', 'knee', 'ankle'].includes(p.closest('.curve-group').dataset.joint) && "
        "p.offsetHeight"
    )
    panels = f"[...document.querySelectorAll('.curve-panel')].filter(p => {legs})"
    foot = page.run("document.getElementById('controls').getBoundingClientRect().top")
    assert page.run(f"Math.max(...{panels}.map(p => p.getBoundingClientRect().bottom))") <= foot + 1
    assert page.run("document.getElementById('counting').getBoundingClientRect().top") < foot
    page.size(390, 844, True)
    page.run(f"scrollTo(0, 0); {STEADY}")
    first = "document.querySelector('.curve-panel .curve-plot').getBoundingClientRect().bottom"
    assert 0 < page.run(first) <= 420
    page.size(1440, 900)


def test_a_tick_takes_a_stride_out_of_means(page: Page) -> None:
    words = "row => row.innerText.replace(/\\s+/g, ' ').trim()"
    assert page.run(f"[...document.querySelectorAll('#counting tbody tr')].map({words})")[:4] == [
        "walk0",
        "right 1 2 ✓whole",
        "right 2 – turns: in no mean; foot beside the plate",
        "right 3 2 ✓whole",
    ]
    told = "document.querySelector('#counting p').textContent"
    assert page.run(told) == "In means: 3 of 3 right, 1 of 1 left straight strides."
    subject = "{base: 'hip_flexion', kind: 'angle'}"
    traces = f"new Gaitcal.Traces({subject}, gaitcal.curves.strides, gaitcal.curves.convention)"
    count = f"Math.max(...{traces}.main('r').counts)"
    assert page.run(count) == 3
    assert page.run("document.getElementById('part-0-r-2').disabled"), "it turns"
    page.run("document.getElementById('part-0-r-1').click()")
    assert (
        page.run(told) == "In means: 2 of 3 right, 1 of 1 left straight strides."
        and page.run(count) == 2
    )
    page.run("document.getElementById('part-1').click()")
    assert page.run(told) == "In means: 1 of 3 right, 1 of 1 left straight strides."
    page.run("gaitcal.state.set({off: new Set()})")
    assert page.console == []


def test_corrected_events_are_those_that_are_read(page: Page, tmp_path: Path) -> None:
    """One is dragged, one moved by a key, one added, one deleted: the table that is saved reads
    back as they stand.
    """
    page.run("document.getElementById('correct').click()")
    left, top, width, height = page.box("document.querySelector('#track-r .movable')")
    x, y, wide = (
        left + width / 2,
        top + height / 2,
        page.box("document.getElementById('track-r')")[2],
    )
    duration = page.run("gaitcal.trial.duration")
    page.drag(*((x + shift * wide, y) for shift in (0.0, 0.05, 0.1)))
    moved = page.run("gaitcal.sheet.events.find(e => e.source === Gaitcal.BY_HAND)")
    assert (
        moved["time"] == pytest.approx(0.103 + 0.1 * duration, abs=0.012) and moved["side"] == "r"
    )
    assert page.run("gaitcal.state.window") is None, "no stretch is looped"
    page.press("ArrowRight")
    assert page.run("document.activeElement.getAttribute('aria-label')").startswith(
        "right foot strike at "
    )
    frame = page.run("gaitcal.trial.time[1]")
    later = page.run("gaitcal.sheet.events.find(e => e.source === Gaitcal.BY_HAND).time")
    assert later == pytest.approx(moved["time"] + frame, abs=1e-4)
    page.run("document.querySelector('#track-l .movable').focus()")
    page.press("Delete")
    page.run("gaitcal.state.set({seconds: 0.9})")
    pressed(page, "events", "left foot off")
    pressed(page, "events", "Save events")
    name, table, _ = page.run("said")
    assert name == EVENT_FILE and "gaitcal calibrate FOLDER" in page.run(
        "document.querySelector('#events output').textContent"
    )
    (tmp_path / EVENT_FILE).write_text(table, encoding="utf-8")
    recording = body(frames=500)
    write_markers_csv(tmp_path / "walk.csv", recording)
    read = apply_corrected_events(recording, tmp_path / "walk.csv")
    shown = page.run("gaitcal.sheet.events.map(e => [e.kind, e.side, e.time])")
    assert list(read.events) == [
        FootEvent(FootMoment(k), s, pytest.approx(START + t, abs=1e-6)) for k, s, t in shown
    ]
    assert "other.csv" not in table, "what nobody corrected stays with its file"
    pressed(page, "events", "Undo")
    assert not page.run("gaitcal.sheet.events.some(e => e.source === Gaitcal.BY_HAND)")
    page.run("document.getElementById('correct').click()")
    assert page.console == []


def test_comments_are_kept_in_the_saved_page_and_read_by_the_report(
    visit: Visit, page: Page, tmp_path: Path
) -> None:
    said = {"summary": f"{HOSTILE} </script>", "kinetics": 'Weak "push-off"\nleft'}
    for section, text in said.items():
        page.run(f"document.getElementById('comment-{section}').value = {json.dumps(text)}")
    pressed(page, "comments", "Save comments.toml")
    name, text, _ = page.run("said")
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert read_comments(tmp_path / name) == said == tomllib.loads(text)
    pressed(page, "comments", "Save page with comments")
    name, saved, _ = page.run("said")
    assert name == "result.html"
    (tmp_path / name).write_text(saved, encoding="utf-8")
    again = opened(visit, tmp_path / name)
    for section, text in said.items():
        assert again.run(f"document.getElementById('comment-{section}').value") == text
    again.run("gaitcal.print.build()")
    assert again.texts("#print .comment") == [f"Comment: {text}" for text in said.values()]
    again.run("gaitcal.print.clear()")
    pressed(again, "comments", "Save page with comments")
    assert again.run("said[1]") == saved, "saved again it is the same"
    assert again.console == []
