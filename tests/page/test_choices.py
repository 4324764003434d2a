"""Address, switches, hostile names, phones and long walks of the page, in a browser."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gaitcal.page.bone_files import bones_of_folder
from gaitcal.page.scene import Scene
from tests.page.browser import Page
from tests.page.made_bones import folder_of_bones
from tests.page.made_page import plain_page
from tests.page.test_browser import DRAWN, paused, stage, until
from tests.page.test_shell import state

pytestmark = [pytest.mark.browser, pytest.mark.slow]

Visit = Callable[..., Page]


@pytest.fixture(scope="module")
def shown(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shell")
    bones = bones_of_folder(folder_of_bones(folder / "Geometry"))
    (folder / "result.html").write_text(plain_page(scene, bones=bones), encoding="utf-8")
    return folder / "result.html"


def chosen(page: Page, control: str, value: str) -> None:
    change = f"(s => {{ s.value = '{value}'; s.dispatchEvent(new Event('change')); }})"
    page.run(f"{change}(document.getElementById('{control}'))")


# ------------------------------------------------------------------------------------------------------------ address


def test_what_is_chosen_is_in_the_address_and_comes_back(visit: Visit, shown: Path) -> None:
    page = paused(visit(f"{shown.as_uri()}?a"), 0.0)
    page.run("gaitcal.state.set({ seconds: 0 })")
    page.run(until("location.hash === ''"))
    values = """{ preset: "joints", axis: "time", unit: "Nm", signs: "clinical", acting: "external", nominal: true,
        norm: false, errors: false, spread: "mean", seconds: 0.25, window: [0.1, 0.5], speed: 0.5, joint: "ankle_l",
        off: new Set(["0/r/1"]) }"""
    page.run(f"gaitcal.state.set({values}); document.getElementById('show-bones').click()")
    page.run(until("location.hash.includes('ankle_l')"))
    said = page.run("location.hash")
    assert "truth" not in said, "what is as usual is not said"
    page = visit(f"{shown.as_uri()}?b{said}")
    assert not page.run("gaitcal.state.playing")
    for field, value in (
        ("preset", "joints"), ("axis", "time"), ("unit", "Nm"), ("signs", "clinical"), ("acting", "external"),
        ("nominal", True), ("norm", False), ("errors", False), ("truth", True), ("spread", "mean"), ("seconds", 0.25),
        ("window", [0.1, 0.5]), ("speed", 0.5), ("joint", "ankle_l"), ("off", ["0/r/1"]),
        ("layers", ["body", "fitted", "nominal", "uncertainty"]),
    ):  # fmt: skip
        assert state(page, field) == value, field
    page = visit(f"{shown.as_uri()}?c#trial=no+plates&t=0.5")
    assert page.run("gaitcal.trial.name") == "no plates" and page.run("gaitcal.state.seconds") == 0.5
    assert page.console == []


@pytest.mark.parametrize(
    "said",
    [
        "%", "=&=&", "preset=__proto__&axis=constructor&trial=-1&t=NaN", "t=1e999&window=5,9&joint=%00",
        "off=0/0/0,../..&layers=x&speed=1e9", "trial=1.5&window=a,b&t=-3", "&".join(["preset=fit"] * 5000),
    ],
)  # fmt: skip
def test_an_address_of_any_text_opens_the_page(visit: Visit, shown: Path, said: str) -> None:
    page = paused(visit(f"{shown.as_uri()}?{len(said)}#{said}"))
    assert page.console == []
    assert page.run("document.getElementById('failure').hidden")
    assert page.run("gaitcal.trial.name") == "walk" and state(page, "window") is None


def test_a_change_of_the_address_is_followed(visit: Visit, shown: Path) -> None:
    page = paused(visit(f"{shown.as_uri()}?h"))
    page.run("location.hash = '#knee_l'")
    page.run(until("gaitcal.state.joint === 'knee_l'"))


# ------------------------------------------------------------------------------------------- ---------------- switches


def test_switches_choose_and_those_without_a_meaning_are_not_there(visit: Visit, shown: Path) -> None:
    page = paused(visit(shown))
    there = page.run("[...document.querySelectorAll('#switches [id^=switch-]')].map(({ id }) => id.slice(7)).sort()")
    assert there == ["acting", "axis", "errors", "nominal", "signs", "spread", "unit"], "no norm, truth"
    for field, value in (
        ("axis", "time"), ("unit", "%BWH"), ("signs", "clinical"), ("acting", "external"), ("spread", "mean"),
    ):  # fmt: skip
        chosen(page, f"switch-{field}", value)
        assert state(page, field) == value
    page.run("document.getElementById('switch-nominal').click()")
    assert state(page, "nominal")
    page.run("gaitcal.state.set({ errors: false })")
    assert not page.run("document.getElementById('switch-errors').checked")
    page.run("document.getElementById('part-0-r-1').click()")
    assert state(page, "off") == ["0/r/1"]
    told = "document.querySelector('#counting p').textContent"
    assert page.run(told) == "In means: 0 of 1 right, 0 of 0 left straight strides."
    controls = "[...document.querySelectorAll('#switches input, #switches select')]"
    assert page.run(f"{controls}.every(c => c.labels.length === 1)")


# ------------------------------------------------------------------------------------------- names, phones, long walks


@pytest.mark.parametrize("width, height", [(390, 844), (320, 568), (844, 390)])
def test_a_phone_shows_person_and_controls_and_cuts_nothing_off(
    visit: Visit, shown: Path, width: int, height: int
) -> None:
    page = paused(visit(shown, width, height, phone=True))
    assert page.run("document.documentElement.scrollWidth") <= width
    cut = page.run(
        """[...document.querySelectorAll("#top button, #top select, #controls button, #controls select, #time, #clock,"
        + "#switches select, #switches input")].filter(e => e.offsetParent !== null).filter(e => {
        const r = e.getBoundingClientRect(); return r.left < 0 || r.right > innerWidth + 0.5 || r.width < 12; })
        .map(e => e.id || e.textContent)"""
    )
    assert cut == []
    page.run(f"gaitcal.state.set({{ layers: new Set(['body']) }}); {DRAWN}")
    page.run(f"document.getElementById('pane').scrollIntoView({{ block: 'center' }}); {DRAWN}")  # below the curves
    picture = stage(page)
    assert ((picture[..., 0] > picture[..., 2] + 12) & (picture[..., 0] > 90)).mean() > 0.02, "skin is seen"
    if width < 760:
        assert page.run("document.getElementById('pane').clientHeight") == pytest.approx(0.45 * height, abs=2)
        assert page.run("document.getElementById('controls').getBoundingClientRect().bottom") <= height + 0.5
        limit = 140 if width >= 390 else 0.3 * height
        assert page.run("document.getElementById('controls').offsetHeight") <= limit
        assert page.run("(p => p.scrollWidth <= p.clientWidth)(document.getElementById('presets'))"), (
            "all tabs are seen"
        )
    assert page.console == []
