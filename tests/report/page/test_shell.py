"""Clock, timeline, presets, joints and keys of the page, in a browser."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.report.page.browser import DRAWN, Page, Visit
from tests.report.page.test_browser import paused, stage

pytestmark = [pytest.mark.browser, pytest.mark.slow]

FRAME = 0.005
"""s of the walking scene."""
PIXEL = 0.01
"""s: the timeline is some hundred pixels wide, and the walk a second long."""
TABS = "[...document.querySelectorAll('[role=tab]')]"


def state(page: Page, field: str) -> Any:
    return page.run(f"(v => v instanceof Set ? [...v].sort() : v)(gaitcal.state.{field})")


# ------------------------------------------------------------------------------------------ presets


def test_a_preset_has_its_layers_and_is_a_tab(visit: Visit, shown: Path) -> None:
    page = paused(visit(shown))
    assert state(page, "preset") == "clinician" and state(page, "layers") == [
        "body",
        "bones",
        "forces",
    ]
    page.run(f"{TABS}[0].focus()")
    page.press("ArrowRight")
    assert state(page, "preset") == "fit" and state(page, "layers") == [
        "body",
        "errors",
        "measured",
        "model",
    ]
    assert page.run("document.activeElement.id") == "preset-fit"
    assert page.run(f"{TABS}.map(tab => tab.ariaSelected)") == [
        "false",
        "true",
        "false",
        "false",
        "false",
    ]
    assert (
        page.run("document.getElementById('panel').getAttribute('aria-labelledby')") == "preset-fit"
    )
    assert page.run(
        "document.getElementById('show-errors').checked && "
        "!document.getElementById('show-forces').checked"
    )
    assert "5 times" in page.run("document.getElementById('toggles').textContent")
    page.press("ArrowLeft")
    page.press("ArrowLeft")
    assert state(page, "preset") == "provenance"
    assert page.console == []


def test_errors_are_drawn_five_times_as_long_in_fit(visit: Visit, shown: Path) -> None:
    page = paused(visit(shown))
    length = (
        "gaitcal.stage.figure.markers.bars.instanceMatrix.array.slice(4, 7).reduce((s, x) => s + x "
        "* x, 0) ** 0.5"
    )
    page.run("gaitcal.state.set({ preset: 'joints' })")
    once = page.run(length)
    page.run("gaitcal.state.set({ preset: 'fit' })")
    assert page.run(length) == pytest.approx(5 * once, rel=1e-5)


def test_a_bare_scene_is_the_body_alone(visit: Visit, html: Path) -> None:
    page = paused(visit(html))
    for part in ("verdict", "presets", "panel"):
        assert page.run(f"document.getElementById('{part}').hidden"), part
    assert page.run("document.getElementById('layers').offsetWidth") > 200
    pane = page.box("document.getElementById('pane')")
    assert pane[1] == pytest.approx(page.run("document.getElementById('top').offsetHeight"), abs=1)
    assert state(page, "layers") == sorted(page.run("Gaitcal.LAYERS"))
    assert page.console == []


# ------------------------------------------------------------------------------- clock and timeline


def test_the_timeline_says_what_each_leg_does(visit: Visit, shown: Path) -> None:
    page = paused(visit(shown))
    label = "document.getElementById('track-{}').getAttribute('aria-label')"
    said = "right leg: foot strikes at 0.05 s, 1.00 s; foot off at 0.65 s; torques valid"
    assert page.run(label.format("r")).startswith(said)
    assert page.run("Gaitcal.stances(gaitcal.sheet, 'r', gaitcal.trial.duration)") == [
        [0.05, 0.65],
        [1.0, pytest.approx(1.035, abs=1e-3)],
    ]
    assert page.run("Gaitcal.stances(gaitcal.sheet, 'l', gaitcal.trial.duration)")[0] == [0, 0.1]
    assert page.run("gaitcal.trial.valid.r") == [[0, pytest.approx(0.745, abs=1e-3)]]
    page.run("gaitcal.clock.seek(0.5)")
    assert page.run("document.getElementById('time').getAttribute('aria-valuetext')") == "0.50 s"
    page.run("gaitcal.state.set({ trial: 1 })")
    assert page.run("document.getElementById('track-r').parentElement.hidden")


def test_a_drag_over_the_timeline_loops_a_window(visit: Visit, shown: Path) -> None:
    page = paused(visit(shown))
    left, top, width, height = page.box("document.getElementById('track-r')")
    page.drag(*((left + share * width, top + height / 2) for share in (0.2, 0.6)))
    duration = page.run("gaitcal.trial.duration")
    assert state(page, "window") == pytest.approx([0.2 * duration, 0.6 * duration], abs=PIXEL)
    page.run(
        "gaitcal.state.set({ seconds: gaitcal.state.window[1] - 0.01, speed: 2, playing: true })"
    )
    page.until("gaitcal.state.seconds < gaitcal.state.window[1] - 0.05")
    page.run("gaitcal.clock.play(false)")
    assert 0.2 * duration - PIXEL <= page.run("gaitcal.state.seconds") <= 0.6 * duration + PIXEL
    page.drag((left + 0.9 * width, top + height / 2))
    assert page.run("gaitcal.state.seconds") == pytest.approx(0.9 * duration, abs=PIXEL)
    page.run("document.getElementById('window-clear').click()")
    assert state(page, "window") is None and page.run(
        "document.getElementById('window-clear').disabled"
    )
    page.run("gaitcal.clock.seek(0.3); document.getElementById('window-begin').click()")
    page.run("gaitcal.clock.seek(0.4); document.getElementById('window-end').click()")
    assert state(page, "window") == [0.3, 0.4]


def test_time_stays_in_the_trial_and_another_trial_begins_anew(visit: Visit, shown: Path) -> None:
    page = paused(visit(shown))
    page.run("gaitcal.clock.seek(99)")
    assert page.run("gaitcal.state.seconds === gaitcal.trial.duration")
    page.run("gaitcal.clock.seek(-1)")
    assert page.run("gaitcal.state.seconds") == 0
    page.run(
        "gaitcal.state.set({ seconds: 0.5, window: [0.2, 0.6] }); gaitcal.state.set({ trial: 1 })"
    )
    assert page.run("gaitcal.state.seconds") == 0 and state(page, "window") is None
    assert page.run("document.title").endswith("no plates")


def test_every_key_does_what_the_dialog_says(visit: Visit, shown: Path) -> None:
    page = paused(visit(shown), 0.2)
    page.press("ArrowRight")
    assert page.run("gaitcal.state.seconds") == pytest.approx(0.2 + FRAME, abs=1e-4)
    page.send(
        "Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft", code="ArrowLeft", modifiers=8
    )
    assert page.run("gaitcal.state.seconds") == pytest.approx(0.2 - 9 * FRAME, abs=1e-4)
    page.press("[")
    page.press("End")
    assert page.run("gaitcal.state.seconds === gaitcal.trial.duration")
    page.run("gaitcal.clock.seek(0.6)")
    page.press("]")
    assert state(page, "window") == pytest.approx([0.155, 0.6], abs=1e-4)
    page.press("Home")
    assert page.run("gaitcal.state.seconds") == pytest.approx(0.155, abs=1e-4)
    page.press("\\")
    assert state(page, "window") is None
    for key, field, value in (
        ("p", "axis", "time"), ("n", "nominal", True), ("b", "norm", False), ("e", "errors", False),
        ("t", "truth", False), ("3", "preset", "joints"), ("j", "joint", "hip_r"),
        ("Escape", "joint", None),
        ("+", "speed", 2), ("-", "speed", 1), (" ", "playing", True), (" ", "playing", False),
    ):  # fmt: skip
        page.press(key)
        assert state(page, field) == value, key
    page.press("?")
    assert page.run("document.getElementById('keys').open")
    page.press("j")
    assert state(page, "joint") is None, "behind the dialog nothing moves"
    page.run(
        "document.getElementById('keys-on').click(); document.getElementById('keys-close').click()"
    )
    page.press("j")
    assert state(page, "joint") is None, "keys of one letter can be turned off"
    page.run("document.getElementById('keys-on').click()")
    page.run(
        "gaitcal.state.set({ preset: 'clinician' }); document.getElementById('switch-axis').focus()"
    )
    page.press("n")
    assert state(page, "nominal"), "a list of choices keeps its keys"
    assert page.console == []


# ------------------------------------------------------------------------------------------- joints


def test_a_click_on_a_joint_flies_there_and_dims_the_rest(visit: Visit, shown: Path) -> None:
    page = paused(visit(shown))
    x, y = page.run(
        """(() => { const p = gaitcal.stage.figure.joints.pose("knee_r").place.project(gaitcal.stage.viewer.camera);
        const r = document.getElementById("pane").getBoundingClientRect();
        return [r.left + (p.x + 1) / 2 * r.width, r.top + (1 - p.y) / 2 * r.height]; })()"""
    )
    page.drag((x, y))
    assert state(page, "joint") == "knee_r"
    page.run(DRAWN)
    assert page.run("gaitcal.stage.viewer.camera.fov") == 10
    assert {"fitted", "nominal"} < set(state(page, "layers")), "its axes are seen"
    opacity = """Object.fromEntries(gaitcal.stage.figure.body.meshes.filter(m => m.skin && m.mesh.visible)
        .map(({ mesh, segment }) => [gaitcal.stage.figure.body.segments[segment], mesh.material.opacity]))"""
    near = page.run(opacity)
    assert near["thigh_r"] == near["shank_r"] > 2 * near["pelvis"] and "thigh_l" not in near
    page.press("Escape")
    page.run(DRAWN)
    assert state(page, "joint") is None and page.run("gaitcal.stage.viewer.camera.fov") == 32
    assert len(set(page.run(opacity).values())) == 1
    assert state(page, "layers") == ["body", "bones", "forces"]
    assert page.console == []


def test_who_wants_no_motion_gets_none(
    visit: Visit, shown: Path, media: Callable[..., None]
) -> None:
    media(prefers_reduced_motion="reduce")
    page = visit(f"{shown.as_uri()}?still")
    assert not page.run("gaitcal.state.playing")
    assert page.run("gaitcal.state.set({ joint: 'knee_l' }), gaitcal.stage.viewer.camera.fov") == 10
    media()
    page = visit(f"{shown.as_uri()}?moving")
    assert page.run("gaitcal.state.playing")


def test_dark_is_dark(visit: Visit, shown: Path, media: Callable[..., None]) -> None:
    page = paused(visit(shown))
    light = stage(page)
    media(prefers_color_scheme="dark")
    page.run(DRAWN)
    assert np.median(light[:80, -80:]) > 200 and np.median(stage(page)[:80, -80:]) < 60


def chosen(page: Page, control: str, value: str) -> None:
    change = f"(s => {{ s.value = '{value}'; s.dispatchEvent(new Event('change')); }})"
    page.run(f"{change}(document.getElementById('{control}'))")


# ------------------------------------------------------------------------------------------ address


def test_what_is_chosen_is_in_the_address_and_comes_back(visit: Visit, shown: Path) -> None:
    page = paused(visit(f"{shown.as_uri()}?a"), 0.0)
    page.run("gaitcal.state.set({ seconds: 0 })")
    page.until("location.hash === ''")
    values = """{ preset: "joints", axis: "time", unit: "Nm", signs: "clinical", acting: "external", nominal: true,
        norm: false, errors: false, spread: "mean", seconds: 0.25, window: [0.1, 0.5], speed: 0.5, joint: "ankle_l",
        off: new Set(["0/r/1"]) }"""
    page.run(f"gaitcal.state.set({values}); document.getElementById('show-bones').click()")
    page.until("location.hash.includes('ankle_l')")
    said = page.run("location.hash")
    assert "truth" not in said, "what is as usual is not said"
    page = visit(f"{shown.as_uri()}?b{said}")
    assert not page.run("gaitcal.state.playing")
    for field, value in (
        ("preset", "joints"), ("axis", "time"), ("unit", "Nm"), ("signs", "clinical"),
        ("acting", "external"),
        ("nominal", True), ("norm", False), ("errors", False), ("truth", True), ("spread", "mean"),
        ("seconds", 0.25),
        ("window", [0.1, 0.5]), ("speed", 0.5), ("joint", "ankle_l"), ("off", ["0/r/1"]),
        ("layers", ["body", "fitted", "nominal", "uncertainty"]),
    ):  # fmt: skip
        assert state(page, field) == value, field
    page = visit(f"{shown.as_uri()}?c#trial=no+plates&t=0.5")
    assert (
        page.run("gaitcal.trial.name") == "no plates" and page.run("gaitcal.state.seconds") == 0.5
    )
    assert page.console == []


@pytest.mark.parametrize(
    "said",
    [
        "%", "=&=&", "preset=__proto__&axis=constructor&trial=-1&t=NaN",
        "t=1e999&window=5,9&joint=%00",
        "off=0/0/0,../..&layers=x&speed=1e9", "trial=1.5&window=a,b&t=-3",
        "&".join(["preset=fit"] * 5000),
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
    page.until("gaitcal.state.joint === 'knee_l'")


# ----------------------------------------------------------------------------------------- switches


def test_switches_choose_and_those_without_a_meaning_are_not_there(
    visit: Visit, shown: Path
) -> None:
    page = paused(visit(shown))
    there = page.run(
        "[...document.querySelectorAll('#switches [id^=switch-]')].map(({ id }) => "
        "id.slice(7)).sort()"
    )
    assert there == ["acting", "axis", "errors", "nominal", "signs", "spread", "unit"], (
        "no norm, truth"
    )
    for field, value in (
        ("axis", "time"), ("unit", "%BWH"), ("signs", "clinical"), ("acting", "external"),
        ("spread", "mean"),
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


# ------------------------------------------------------------------------ names, phones, long walks


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
    page.run(
        f"document.getElementById('pane').scrollIntoView({{ block: 'center' }}); {DRAWN}"
    )  # below the curves
    picture = stage(page)
    assert ((picture[..., 0] > picture[..., 2] + 12) & (picture[..., 0] > 90)).mean() > 0.02, (
        "skin is seen"
    )
    if width < 760:
        assert page.run("document.getElementById('pane').clientHeight") == pytest.approx(
            0.45 * height, abs=2
        )
        assert (
            page.run("document.getElementById('controls').getBoundingClientRect().bottom")
            <= height + 0.5
        )
        limit = 140 if width >= 390 else 0.3 * height
        assert page.run("document.getElementById('controls').offsetHeight") <= limit
        assert page.run(
            "(p => p.scrollWidth <= p.clientWidth)(document.getElementById('presets'))"
        ), "all tabs are seen"
    assert page.console == []
