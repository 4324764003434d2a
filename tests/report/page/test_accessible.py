"""Nothing keeps anybody from using the page: axe finds no serious fault in any preset, width or
scheme of colours.

axe-core is no part of this repository: `GAITCAL_AXE` is the path of its `axe.min.js` (`sh
scripts/tools/fetch_axe.sh` fetches it and prints that path). Without it, what needs it is skipped.
"""

import itertools
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.report.page.browser import SETTLED, Page, Visit
from tests.report.page.made_page import PRESETS

pytestmark = [pytest.mark.browser, pytest.mark.slow]

SIZES = {1280: 800, 390: 844}
"""px wide -> high: a screen and a phone."""
TARGET = 24.0
"""px, WCAG 2.2, 2.5.8: what is pressed is at least as wide and high, or has a label as large to
press.
"""
FAULTS = """axe.run(document, {resultTypes: ['violations']}).then(({violations}) => violations
    .filter(({impact}) => impact === 'serious' || impact === 'critical')
    .flatMap(({id, nodes}) => nodes.map(({target}) => `${id}: ${target.join(' ')}`)))"""
SMALL = """[...document.querySelectorAll('button, select, summary, input, a[href]')]
    .filter(e => e.checkVisibility({visibilityProperty: true})).filter(e => {
        const boxes = [e, e.closest('label')].filter(Boolean).map(part => part.getBoundingClientRect());
        return !boxes.some(box => box.width >= %f && box.height >= %f);
    }).map(e => `${e.tagName} ${e.id} ${e.className} ${e.textContent.trim().slice(0, 20)}`)"""
UNNAMED = """[...document.querySelectorAll('button, select, input, [tabindex="0"], [role=tab], canvas[role], dialog')]
    .filter(e => e.checkVisibility({visibilityProperty: true}))
    .filter(e => !(e.labels?.length || e.ariaLabel || e.getAttribute('aria-labelledby') || e.textContent.trim()))
    .map(e => e.outerHTML.slice(0, 80))"""


@pytest.fixture(scope="module")
def axe() -> str:
    path = os.environ.get("GAITCAL_AXE")
    if not path or not Path(path).is_file():
        pytest.skip(
            "no axe-core: GAITCAL_AXE is to be the path of its axe.min.js (sh "
            "scripts/tools/fetch_axe.sh)"
        )
    return Path(path).read_text(encoding="utf-8")


def opened(page: Page, preset: str) -> Page:
    """The preset with everything unfolded."""
    page.run(f"gaitcal.state.set({{preset: '{preset}', playing: false, seconds: 0.3}})")
    page.run("for (const fold of document.querySelectorAll('details')) fold.open = true")
    page.run(
        "document.querySelectorAll('.more[aria-expanded=false]').forEach(more => more.click())"
    )
    page.run(SETTLED)
    return page


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 390)])
def test_axe_finds_nothing_serious(
    visit: Visit, media: Callable[..., None], everything: Path, axe: str, scheme: str, width: int
) -> None:
    media(prefers_color_scheme=scheme, prefers_reduced_motion="reduce")
    page = visit(everything, width, SIZES[width], phone=width < 760, fresh=True)
    page.run(f"{axe}; true")
    faults = {preset: opened(page, preset).run(FAULTS) for preset in PRESETS}
    assert {preset: found for preset, found in faults.items() if found} == {}


@pytest.mark.parametrize("width", SIZES)
def test_controls_have_names_and_room_and_the_page_is_not_cut_off(
    visit: Visit, everything: Path, width: int
) -> None:
    page = visit(everything, width, SIZES[width], phone=width < 760)
    for preset in PRESETS:
        opened(page, preset)
        assert page.run(SMALL % (TARGET, TARGET)) == [], preset
        assert page.run(UNNAMED) == [], preset
        assert page.run("document.documentElement.scrollWidth <= innerWidth"), preset


def test_headings_and_landmarks_are_in_order(visit: Visit, everything: Path) -> None:
    page = visit(everything, 1280, 800)
    for preset in PRESETS:
        opened(page, preset)
        levels = page.run(
            """[...document.querySelectorAll('h1, h2, h3, h4, h5, h6')].filter(h => h.checkVisibility())
            .map(h => Number(h.tagName[1]))"""
        )
        assert levels[0] == 1 and levels.count(1) == 1, preset
        assert all(later <= level + 1 for level, later in itertools.pairwise(levels)), (
            preset,
            levels,
        )
    marks = (
        "['header', 'main', 'footer'].map(mark => document.querySelectorAll(`body > "
        "${mark}`).length)"
    )
    assert page.run(marks) == [1, 1, 1]
    assert (
        page.run(
            'document.querySelectorAll(\'[tabindex]:not([tabindex="0"], [tabindex="-1"])\').length'
        )
        == 0
    )
