"""Tables, pictures, verdict and steps of the page, and what it is on paper."""

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest

from gaitcal.explanations import PARTS
from gaitcal.gait.spatiotemporal import Average, average_measures, select_straight_strides
from gaitcal.results.shown_labels import SHOWN_MEASURES
from tests.report.page.browser import Page, Visit
from tests.report.page.made_page import (
    HOSTILE,
    REFUSED,
    STRAIGHT,
    everything_page,
    long_walks,
    measured_strides,
    stridden,
    written_page,
)

pytestmark = [pytest.mark.browser, pytest.mark.slow]

A4_HEIGHT = (297.0 - 13.0 - 15.0) / 25.4 * 96.0
"""px between the margins of `print.css`."""
ROUNDING = 1e-9
"""Sums of a dozen numbers, in another order."""
PIXELS = 2.0
"""Lines are drawn at fractions of a pixel."""


def opened(
    visit: Visit, everything: Path, preset: str, width: int = 1280, height: int = 800
) -> Page:
    page = visit(everything, width, height, phone=width < 760)
    page.run(f"gaitcal.state.set({{preset: '{preset}', playing: false, seconds: 0.3}})")
    return page


def test_every_block_becomes_what_it_is_and_names_are_text(visit: Visit, everything: Path) -> None:
    of = "#sections > :not(.of-trial, .reasons)"
    for preset in ("fit", "provenance"):
        page = opened(visit, everything, preset)
        assert page.console == []
        assert page.texts("#sections > h3") == [f"Tables {HOSTILE}", "Joint parameters", "Pair"]
        assert page.run(f"document.querySelectorAll('{of} table').length") == 7, (
            "five tables, those of two pictures"
        )
        assert len(page.texts(".of-trial figure.traced")) == 3, "curves are of a trial"
        assert page.run("document.querySelectorAll('#sections > figure.traced').length") == 0
        assert page.run("document.querySelectorAll('#sections img').length") == 0
        assert HOSTILE in "".join(page.texts("#sections th"))
        assert not page.run("document.title").startswith("1")


def test_tables_have_heads_totals_and_tones_that_are_not_colour_alone(
    visit: Visit, everything: Path
) -> None:
    page = opened(visit, everything, "fit")
    first = "#sections > .scroll"
    assert (
        page.run(f"document.querySelector('{first} table').getAttribute('aria-label')")
        == f"Tables {HOSTILE}"
    )
    assert page.run(
        f"[...document.querySelectorAll('{first}:first-of-type thead th')].every(th => th.scope "
        "=== 'col')"
    )
    rows = page.run(
        f"[...document.querySelector('{first}').querySelectorAll('tbody tr')].map(r => "
        "r.textContent)"
    )
    assert rows == [
        "pelvis8.1✓1.25 (good)followed by its own markers",
        "thigh 2 markers!12.4 (look at this)–✕above",
        "all9.910.2not judged",
    ]
    assert page.run(
        f"[...document.querySelector('{first}').querySelectorAll('tbody tr')].map(r => r.className)"
    ) == ["", "", "total"]
    assert (
        page.run(f"getComputedStyle(document.querySelector('{first} tbody td')).textAlign")
        == "right"
    )
    assert (
        page.run(
            f"getComputedStyle(document.querySelector('{first} tbody td:last-child')).textAlign"
        )
        == "left"
    )


@pytest.mark.parametrize("width", [1280, 390])
def test_a_wide_table_scrolls_by_itself_and_by_keyboard(
    visit: Visit, everything: Path, width: int
) -> None:
    page = opened(visit, everything, "fit", width)
    page.run("new Promise(done => requestAnimationFrame(() => setTimeout(done, 50)))")
    wide = page.run(
        "[...document.querySelectorAll('#sections .scroll.wide')].map(s => [s.tabIndex, "
        "s.ariaLabel.split(':')[0]])"
    )
    assert [0, "Every marker"] in wide
    assert page.run("document.documentElement.scrollWidth <= innerWidth"), (
        "the page itself does not"
    )
    assert page.run(
        "[...document.querySelectorAll('#sections .scroll:not(.wide)')].every(s => s.tabIndex === "
        "-1)"
    )


def test_intervals_show_the_change_and_tell_the_values(visit: Visit, everything: Path) -> None:
    page = opened(visit, everything, "joints")
    table = "document.querySelector('#sections > figure.picture .unseen table')"
    rows = page.run(f"[...{table}.rows].map(r => [...r.cells].map(c => c.textContent))")
    assert rows[0] == ["Parameter", "Nominal", "Fitted", "Standard error", "Truth"]
    assert rows[1] == ["right hip centre, forward mm", "70.0", "66.2", "1.1", "65.0"]
    assert rows[3] == ["right knee axis, up mm", "400.0", "404.0", "–", "–"]
    lanes = page.run(
        """(p => { const x = (e, a) => parseFloat(e.getAttribute(a)); const lane = p.querySelector('svg.lane');
        const [dot, ring, line] = ['circle.dot', 'circle.truth', 'line.whisker'].map(kind => lane.querySelector(kind));
        return [x(dot, 'cx'), x(ring, 'cx'), x(line, 'x1'), x(line, 'x2'), x(lane.querySelector('line.zero'), 'x1')]; })
        (document.querySelector('#sections > figure.picture'))"""
    )
    dot, ring, low, high, zero = lanes
    percent = (dot - zero) / -3.8
    assert ring - zero == pytest.approx(-5.0 * percent, abs=0.01)
    assert [low - zero, high - zero] == pytest.approx([-4.9 * percent, -2.7 * percent], abs=0.01)


def test_curves_of_a_trial_follow_the_clock_and_move_it(visit: Visit, everything: Path) -> None:
    page = opened(visit, everything, "trust")
    words = page.texts(".of-trial .traced figcaption")
    assert "Peak 39.4 N in the valid frames." in words[0], "60 N do not count"
    duration = page.run("gaitcal.trial.duration")
    page.run("document.querySelector('.traced').scrollIntoView()")  # it is drawn when it is seen
    page.until("document.querySelector('.traced .cursor') !== null")
    page.run("gaitcal.clock.seek(gaitcal.trial.duration / 2)")
    assert "translateX(50" in page.run("document.querySelector('.traced .cursor').style.transform")
    page.run(
        """(p => { p.scrollIntoView(); const b = p.getBoundingClientRect();
        const at = {clientX: b.left + 0.25 * b.width, clientY: b.top + 5, bubbles: true};
        p.dispatchEvent(new MouseEvent('click', at)); })
        (document.querySelector('.traced .u-over'))"""
    )
    width = page.run("document.querySelector('.traced .u-over').clientWidth")
    assert page.run("gaitcal.state.seconds") == pytest.approx(0.25 * duration, abs=duration / width)


def test_what_is_unfolded_stays_so_in_another_trial(visit: Visit, everything: Path) -> None:
    page = opened(visit, everything, "fit")
    page.run(
        "document.querySelector('#sections > details').open = true; gaitcal.state.set({trial: 1})"
    )
    assert page.run("document.querySelector('#sections > details').open")
    assert page.texts(".of-trial > h2") == ["Trial walk 2, walking"]


def test_verdict_in_shape_and_word_leads_to_its_reasons(visit: Visit, everything: Path) -> None:
    page = opened(visit, everything, "clinician")
    assert page.texts("#verdict .lines li") == [
        "✕poor: A line of tone poor.",
        "!look at this: A line of tone look.",
        "·A line of tone plain.",
    ]
    assert page.texts("#verdict .facts") == ["Diagnosis: <b>none</b>"]
    assert page.texts("#verdict strong") == ["Refused"]
    page.run("document.querySelector('#verdict button').click()")
    assert page.run("gaitcal.state.preset") == "trust"
    assert page.texts(".reasons li > strong") == ["Plates and feet do not agree", "Few markers"]
    assert (
        HOSTILE in page.texts(".reasons li")[0]
        and "walk 2, left leg" in page.texts(".reasons li")[0]
    )
    assert page.texts(".explanation summary") == ["What this means, and what to do: GC-073"]
    assert not page.run("document.querySelector('.explanation').open")
    assert page.texts(".explanation h3") == list(PARTS)
    assert (
        page.texts(".explanation > p")[-1] == "The same on the command line: gaitcal explain GC-073"
    )
    assert page.texts(".reasons tbody tr")[1] == "walk 2✕refused✓trustworthy✕refused"


def test_without_lines_the_sentence_stands_on_top(visit: Visit, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text(everything_page(lines=[]), encoding="utf-8")
    assert opened(visit, path, "clinician").texts("#verdict .lines li") == [
        "·Do not use the left leg."
    ]


def means(of: Average | None) -> list[float | None]:
    return [] if of is None else [of.n, of.mean, of.sd]


def numbers(leg: dict[str, Any] | None) -> list[float | None]:
    return [] if leg is None else [leg["n"], leg["mean"], leg["sd"]]


def close(values: list[float | None]) -> list[Any]:
    return [None if value is None else pytest.approx(value, rel=ROUNDING) for value in values]


@pytest.mark.parametrize("off", [(), (2,), (0, 2)])
def test_steps_are_those_of_python(visit: Visit, everything: Path, off: tuple[int, ...]) -> None:
    page = opened(visit, everything, "clinician")
    page.run(f"gaitcal.state.set({{off: new Set({[f'{k}' for k in off]})}})")
    strides = {
        n: select_straight_strides(s, REFUSED[n])
        for k, (n, s) in enumerate(measured_strides().items())
        if k not in off
    }
    wanted = {m.name: m for m in average_measures(strides) if m.name in SHOWN_MEASURES}
    found = page.run(
        "Gaitcal.stepsOf(gaitcal)"
        ".map(({name, right, left, symmetry, error}) => [name, right, left, symmetry, error ?? "
        "null])"
    )
    assert [row[0] for row in found] == [name for name in SHOWN_MEASURES if name in wanted]
    for name, right, left, symmetry, error in found:
        assert numbers(right) == close(means(wanted[name].right))
        assert numbers(left) == close(means(wanted[name].left))
        assert [symmetry, error] == close([wanted[name].symmetry, wanted[name].symmetry_error])
    assert len(page.texts("#steps tbody tr")) == len(found)


def test_steps_leave_out_a_stride_that_is_off(visit: Visit, everything: Path) -> None:
    page = opened(visit, everything, "clinician")
    count = "Gaitcal.stepsOf(gaitcal).find(row => row.name === 'stride_time').right.n"
    before = page.run(count)
    straight = next(
        s.number
        for s in measured_strides()["walk 1"]
        if s.side == "r" and s.turn == STRAIGHT and s.number
    )
    page.run(f"gaitcal.state.set({{off: new Set(['0/r/{straight}'])}})")
    assert page.run(count) == before - 1


def test_three_pages_first_then_the_shown_preset_of_all_trials(
    visit: Visit, everything: Path
) -> None:
    page = opened(visit, everything, "joints")
    page.send("Emulation.setEmulatedMedia", media="print")
    try:
        page.send(
            "Emulation.setDeviceMetricsOverride",
            width=695,
            height=1017,
            deviceScaleFactor=1,
            mobile=False,
        )
        page.run("gaitcal.print.build()")
        heights = page.run(
            "[...document.querySelectorAll('#print .leaf')].map(leaf => leaf.scrollHeight)"
        )
        assert len(heights) == 3 and all(height <= A4_HEIGHT + PIXELS for height in heights)
        assert page.run("document.documentElement.scrollWidth") <= 695 + PIXELS
        assert page.run(
            "[...document.body.children].filter(e => e.offsetParent || e.offsetHeight).map(e => "
            "e.id)"
        ) == ["print"]
        assert page.texts("#print .leaf:first-child .leaf-steps > h2") == ["Steps and phases"]
        assert page.texts("#print .leaf:first-child .leaf-strides > h2") == ["Which strides count"]
        assert len(page.texts("#print .leaf:nth-child(2) .curve-panel")) == 4
        assert len(page.texts("#print .leaf:nth-child(3) .curve-panel")) == 4
        assert len(page.texts("#print .appendix .of-trial")) == len(REFUSED)
        assert (
            page.run("document.querySelectorAll('#print details:not([open], .explanation)').length")
            == 0
        )
        page.run("gaitcal.print.clear()")
    finally:
        page.send("Emulation.setEmulatedMedia", media="")
    assert page.run("document.getElementById('print').childNodes.length") == 0
    assert page.console == []


def test_printing_writes_pages_and_leaves_the_screen_as_it_was(
    visit: Visit, everything: Path
) -> None:
    page = opened(visit, everything, "clinician")
    panels = page.run("document.querySelectorAll('#curves .curve-panel').length")
    pdf = base64.b64decode(
        page.send("Page.printToPDF", preferCSSPageSize=True, printBackground=True)["data"]
    )
    assert len(re.findall(rb"/Type /Page\b", pdf)) > 4
    assert page.run("document.querySelectorAll('#curves .curve-panel').length") == panels
    assert not page.run("document.documentElement.classList.contains('on-paper')")
    assert page.console == []


NO_WEBGL = """(({ prototype }) => { const real = prototype.getContext; prototype.getContext = function (kind, ...more) {
    return kind.startsWith('webgl') ? null : real.call(this, kind, ...more); } })(HTMLCanvasElement)"""


def test_without_webgl_everything_but_the_body_is_there(visit: Visit, everything: Path) -> None:
    """Verdict, curves, tables, every preset, the clock and print."""
    blank = visit("about:blank")
    script = blank.send("Page.addScriptToEvaluateOnNewDocument", source=NO_WEBGL)["identifier"]
    try:
        page = visit(everything, 1280, 900, fresh=True)
        assert "no WebGL" in page.texts("#failure")[0]
        assert (
            "Refused" in page.texts("#verdict .judged")[0]
            and len(page.texts("#verdict-lines li")) == 3
        )
        page.until("gaitcal.curves.panels.some((panel) => panel.plot && panel.span)")
        page.run("gaitcal.clock.play(false); gaitcal.clock.seek(0.3); gaitcal.curves.readings()")
        assert any(page.texts(".curve-reading"))
        for preset in ("fit", "joints", "trust", "provenance", "clinician"):
            page.run(f"gaitcal.state.set({{ preset: '{preset}', joint: null }})")
            assert preset == "clinician" or page.texts("#sections table")
        page.press("j")
        page.run("gaitcal.print.build(); gaitcal.print.clear(); true")
        assert page.console == []
    finally:
        blank.send("Page.removeScriptToEvaluateOnNewDocument", identifier=script)
        visit("about:blank", fresh=True)


STRIDES = {0: {"r": [0.103, 0.551, 0.987], "l": [0.252, 0.741]}}
ROW = 40
"""px: one row of switches."""


def test_switches_are_a_row_and_say_what_is_set_behind_the_button(
    visit: Visit, walked: Path
) -> None:
    page = visit(walked, 1280, 800)
    assert page.run("document.getElementById('switches').offsetHeight") <= ROW
    assert page.run("document.getElementById('switches-others').hidden")
    assert page.texts("#switches-more") == ["More"]
    page.run("gaitcal.state.set({ acting: 'external', nominal: true, off: new Set(['0/r/1']) })")
    assert page.texts("#switches-more") == ["More: external, before calibration"]
    assert page.texts("#switches .told") == ["external, clinical signs"]
    page.run("document.getElementById('switches-more').click()")
    assert not page.run("document.getElementById('switches-others').hidden")
    assert (
        page.run("document.getElementById('switches-more').getAttribute('aria-expanded')") == "true"
    )


def test_a_joint_of_the_address_is_in_view(visit: Visit, walked: Path) -> None:
    page = visit(f"{walked.as_uri()}?joint#joint=ankle_r", 1280, 400)
    page.run("new Promise(done => setTimeout(() => done(true), 300))")
    large = "document.querySelector('.curve-group.large')"
    assert page.run(f"{large}.dataset.joint") == "ankle" and page.run("scrollY") > 0
    assert 0 <= page.run(f"{large}.getBoundingClientRect().top") < page.run("innerHeight / 2")


def test_a_phone_shows_the_first_line_until_more_is_asked_for(
    visit: Visit, everything: Path
) -> None:
    page = visit(everything, 390, 844, phone=True)
    seen = (
        "[...document.querySelectorAll('#verdict .lines li')].filter(li => li.offsetHeight > "
        "0).length"
    )
    assert page.run(seen) == 1
    page.run("document.querySelector('#verdict .more').click()")
    assert page.run(seen) == 3 and page.texts("#verdict .more") == ["Less"]


def test_trust_tells_of_the_trial_between_verdict_and_calibration(
    visit: Visit, everything: Path
) -> None:
    page = visit(everything, 1280, 800)
    page.run("gaitcal.state.set({ preset: 'trust', playing: false })")
    parts = page.run(
        "[...document.querySelectorAll('#sections > :is(.reasons, .of-trial, h2)')].map(e => "
        "e.className)"
    )
    assert parts == ["", "reasons refused", "of-trial", "of-all"]
    assert page.run("document.querySelector('.of-all').nextElementSibling.tagName") == "H3"


def test_a_key_names_bounds_only_where_one_is_seen(visit: Visit, everything: Path) -> None:
    page = visit(everything, 1280, 800)
    row = {"label": "axis", "nominal": 0.0, "fitted": 1.0, "se": None, "truth": None}
    rows = [{**row, "bounds": bounds} for bounds in ([-50.0, 50.0], [None, 1.0])]
    made = (
        "Gaitcal.BLOCKS.intervals({unit: 'mm', rows: [%s]}, new "
        "Gaitcal.Blocks({})).querySelector('.key')"
    )
    told_of = [page.run(f"({made % json.dumps(row)})?.textContent ?? ''") for row in rows]
    assert ["bound" in text for text in told_of] == [False, True]


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = long_walks()
    return written_page(tmp_path_factory.mktemp("walked"), scene, stridden(scene, STRIDES)[0])
