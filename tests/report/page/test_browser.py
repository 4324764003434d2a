"""The figure in space, in a browser: layers, clock, joints from near by, markup that cannot run,
long walks.
"""

import io
import re
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaitcal.cli import view_command as view_command
from gaitcal.cli.console import Console
from gaitcal.cli.view_command import ViewServer
from gaitcal.report.page import bone_files
from gaitcal.report.page.page_folder import write_page
from gaitcal.report.page.page_html import PageContent, render_page
from gaitcal.report.page.scene import Scene
from tests.report.page.browser import DRAWN, Page, Visit
from tests.report.page.made_page import plain_data, written_page
from tests.report.page.people import long_scene, model_markers
from tests.report.page.test_page import LIMIT

pytestmark = pytest.mark.browser

LAYERS = (
    "body",
    "bones",
    "measured",
    "model",
    "errors",
    "forces",
    "nominal",
    "fitted",
    "uncertainty",
)
SHOWN = 0.2
"""mm: one decimal is shown, of positions packed to some 0.05 mm."""
POSING = """(() => { let best = Infinity;
    for (let turn = 0; turn < 10; turn++) {
        const start = performance.now();
        for (let k = 0; k < 100; k++) gaitcal.clock.seek(gaitcal.trial.duration * k / 100);
        best = Math.min(best, performance.now() - start);
    } return best; })()"""
"""ms that 100 poses take at best: only to be compared within one browser."""


def stage(page: Page) -> np.ndarray:
    """(h, w, 3) what the stage shows."""
    scale = page.run("devicePixelRatio")
    left, top, width, height = (
        round(scale * x) for x in page.box("document.getElementById('pane')")
    )
    picture = np.asarray(Image.open(io.BytesIO(page.picture())).convert("RGB"), dtype=int)
    return picture[top : top + height, left : left + width]


def paused(page: Page, seconds: float = 0.6) -> Page:
    page.run(f"gaitcal.clock.play(false); gaitcal.clock.seek({seconds}); {DRAWN}")
    return page


def changed(a: np.ndarray, b: np.ndarray) -> int:
    """Pixels that differ plainly."""
    return int((np.abs(a - b).max(axis=2) > 24).sum())


@pytest.mark.slow
def test_it_opens_offline_without_a_word_and_without_a_request(visit: Visit, html: Path) -> None:
    page = paused(visit(html, fresh=True))
    assert page.console == []
    assert [url for url in page.requests if not url.startswith(("data:", "blob:"))] == [
        html.as_uri()
    ]
    assert page.run("document.getElementById('failure').hidden")
    assert page.run("document.title") == "Built-in subject · walk"


def test_the_person_is_in_the_picture(visit: Visit, html: Path) -> None:
    page = paused(visit(html))
    page.run(
        f"document.getElementById('show-bones').click(); {DRAWN}"
    )  # with bones, the skin is only a veil
    picture = stage(page)
    skin = (picture[..., 0] > picture[..., 2] + 12) & (picture[..., 0] > 90)
    rows, columns = np.nonzero(skin)
    height, width = skin.shape
    assert skin.mean() > 0.03
    assert np.ptp(rows) > 0.55 * height
    assert abs(np.median(columns) / width - 0.5) < 0.1
    assert rows.min() > 0 and rows.max() < height - 1


@pytest.mark.slow
def test_playing_moves_the_picture_and_the_slider(visit: Visit, html: Path) -> None:
    page = visit(html, fresh=True)
    assert page.run("gaitcal.state.playing")
    page.run("gaitcal.clock.seek(0)")
    page.until("Number(document.getElementById('time').value) > 0.05")
    page.run("document.getElementById('play').click()")
    assert not page.run("gaitcal.state.playing")
    first = stage(paused(page, 0.2))
    assert changed(first, stage(paused(page, 0.2))) == 0
    assert changed(first, stage(paused(page, 0.7))) > 2000


def test_slider_and_speed(visit: Visit, html: Path) -> None:
    page = paused(visit(html), 0.0)
    page.run(
        "(s => { s.value = 0.5; s.dispatchEvent(new Event('input')); "
        "})(document.getElementById('time'))"
    )
    assert page.run("gaitcal.state.seconds") == pytest.approx(0.5, abs=1e-3)
    assert page.run("document.getElementById('clock').textContent") == "0.50 s"
    page.run(
        "(s => { s.value = '0.1'; s.dispatchEvent(new Event('change')); "
        "})(document.getElementById('speed'))"
    )
    assert page.run("gaitcal.state.speed") == 0.1


@pytest.mark.slow
def test_every_layer_can_be_hidden_and_shown(visit: Visit, html: Path) -> None:
    page = paused(visit(html), 0.3)
    full = stage(page)
    for layer in LAYERS:
        click = f"document.getElementById('show-{layer}').click(); {DRAWN}"
        page.run(click)
        without = stage(page)
        page.run(click)
        assert changed(full, without) > 20, layer
    assert changed(full, stage(page)) == 0


def test_another_trial_says_what_it_lacks(visit: Visit, html: Path) -> None:
    page = paused(visit(html))
    page.run(
        "(s => { s.value = '1'; s.dispatchEvent(new Event('change')); "
        "})(document.getElementById('trial'))"
    )
    assert page.run("gaitcal.trial.name") == "no plates"
    assert page.run("document.getElementById('show-forces').disabled")
    assert "no force plates" in page.run("document.getElementById('toggles').textContent")
    assert page.console == []


SIDES_SHOWN = """[...new Set([...gaitcal.stage.figure.bones.meshes, ...gaitcal.stage.figure.body.meshes,
    ...gaitcal.stage.figure.joints.parts.fitted]
    .filter(({ mesh }) => mesh.visible)
    .map(({ segment }) => /_([rl])$/.exec(gaitcal.result.scene.segments[segment])?.[1] ?? ""))].sort().join(" ")"""


@pytest.mark.slow
def test_a_knee_from_near_by_says_where_its_axis_passes(visit: Visit, html: Path) -> None:
    page = paused(visit(html))
    press = (
        "[...document.querySelectorAll('#near button')].find(b => b.textContent === '{}').click()"
    )
    whole = stage(page)
    page.run(press.format("right knee") + f"; {DRAWN}")
    words = page.run("document.getElementById('about').textContent")
    assert words.startswith("Right knee\nFitted (solid): ") and "Nominal (dashed): " in words
    assert page.run(SIDES_SHOWN) == " r", "nothing of the other leg stands before it"
    near = stage(page)
    assert changed(whole, near) > 5000
    page.run(f"document.getElementById('show-bones').click(); {DRAWN}")
    assert changed(near, stage(page)) > 5000
    page.run(
        f"document.getElementById('show-bones').click(); {press.format('whole body')}; {DRAWN}"
    )
    assert page.run(SIDES_SHOWN) == " l r"
    assert "frames" in page.run("document.getElementById('about').textContent")
    assert page.console == []


@pytest.mark.slow
def test_an_address_that_names_a_knee_opens_there(visit: Visit, html: Path) -> None:
    page = visit(f"{html.as_uri()}?b#knee_l")  # another query, or it would be the same page
    assert page.run("gaitcal.stage.near") == "knee_l" and not page.run("gaitcal.state.playing")
    page = visit(f"{html.as_uri()}?a#constructor")
    assert page.run("gaitcal.stage.near") is None and page.console == []


@pytest.mark.slow
def test_bones_veil_an_axis_and_do_not_hide_it(visit: Visit, html: Path) -> None:
    """The fitted rod changes the picture before the bone and, fainter, inside it."""
    page = paused(visit(html))
    page.run(f"gaitcal.state.set({{ joint: 'knee_r' }}); {DRAWN}")
    for layer in ("measured", "model", "errors", "uncertainty", "nominal", "body"):
        page.run(f"document.getElementById('show-{layer}').click()")
    page.run(DRAWN)
    veiled = stage(page)
    page.run(f"document.getElementById('show-bones').click(); {DRAWN}")
    plain = stage(page)
    page.run(f"document.getElementById('show-fitted').click(); {DRAWN}")
    nothing = stage(page)
    rod = np.abs(plain - nothing).max(axis=2) > 60
    page.run(f"document.getElementById('show-bones').click(); {DRAWN}")
    bone = stage(page)
    alone, shown = (np.abs(a - b).max(axis=2)[rod] for a, b in ((plain, nothing), (veiled, bone)))
    before_bone = np.abs(bone - nothing).max(axis=2)[rod] > 24
    assert before_bone.sum() > 50 and (~before_bone).sum() > 50
    assert (shown[before_bone] < 0.6 * alone[before_bone]).sum() > 20, "inside the bone it is faint"
    assert (shown > 12).mean() > 0.95, "but nowhere gone"


@pytest.mark.slow
def test_without_bones_the_page_says_how_to_get_them(
    visit: Visit, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bone_files, "find_installed_bones", lambda: None)
    page = paused(visit(written_page(tmp_path, scene)))
    assert page.run("document.getElementById('show-bones').disabled")
    assert "pip install 'gaitcal[bones]'" in page.run(
        "document.getElementById('toggles').textContent"
    )
    assert page.console == []


def test_pointing_at_a_marker_tells_its_name_and_error(
    visit: Visit, html: Path, scene: Scene
) -> None:
    trial = scene.trials[0]
    page = paused(visit(html), float(trial.time[120] - trial.time[0]))
    x, y = page.run(
        """(() => { const p = gaitcal.stage.figure.markers.atMeasured[0].clone().project(gaitcal.stage.viewer.camera);
        const r = document.getElementById('pane').getBoundingClientRect();
        return [r.left + (p.x + 1) / 2 * r.width, r.top + (1 - p.y) / 2 * r.height]; })()"""
    )
    page.move(x, y)
    page.run(DRAWN)
    text = page.run("document.getElementById('tip').textContent")
    assert not page.run("document.getElementById('tip').hidden")
    found = re.fullmatch(r"R\.ASIS\n([\d.]+) mm from the model's marker", text)
    error = np.linalg.norm(trial.measured[120, 0] - model_markers(scene, trial)[120, 0])
    assert found is not None and float(found.group(1)) == pytest.approx(1000 * error, abs=SHOWN)


@pytest.mark.slow
def test_even_markup_that_got_in_cannot_run(visit: Visit, html: Path) -> None:
    page = paused(visit(html, fresh=True))
    page.run(
        "document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=\"window.hacked=1\">')"
    )
    page.run(
        "document.body.append(Object.assign(document.createElement('script'), {textContent: "
        "'window.hacked=1'}))"
    )
    page.run("fetch('data:,x').catch(() => 0)")
    assert page.run("typeof window.hacked") == "undefined"
    assert page.console and all("Content Security Policy" in line for line in page.console)


@pytest.mark.slow
def test_ten_thousand_frames_stay_responsive(
    visit: Visit, html: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From the command to the picture: what is left out is said, and posing a frame takes no longer
    for it.
    """
    page_file = tmp_path / "view.html"
    scene = long_scene()
    write_page(tmp_path, scene, plain_data(scene))
    view_command.view_result(Console(quiet=False, verbose=False), tmp_path, html=page_file)
    assert "long: the page shows 3334 of 10000 frames, one in 3; poses" in capsys.readouterr().out
    assert page_file.stat().st_size < LIMIT
    of_a_short_walk = visit(html).run(POSING)
    page = visit(page_file)
    page.run(DRAWN)
    assert changed(stage(paused(page, 1.0)), stage(paused(page, 1.2))) > 2000
    assert "every third frame" in page.run("document.getElementById('about').textContent")
    assert page.run(POSING) < 4 * of_a_short_walk
    page.run("gaitcal.clock.seek(gaitcal.trial.duration)")
    assert page.run("gaitcal.stage.figure.place.x") > 50.0
    assert page.console == []


def test_between_two_frames_the_pose_is_between(visit: Visit, html: Path, scene: Scene) -> None:
    page = paused(visit(html))
    time, origins = scene.trials[0].time, scene.trials[0].origins
    page.run(f"gaitcal.clock.seek({(time[50] + time[51]) / 2 - time[0]})")
    where = page.run(
        f"gaitcal.stage.figure.body.groups[{scene.segments.index('foot_r')}].position.toArray()"
    )
    assert where == pytest.approx((origins[50, 4] + origins[51, 4]) / 2, abs=1e-3)


@pytest.mark.slow
def test_the_served_page_works_too(visit: Visit, scene: Scene) -> None:
    with ViewServer(render_page(PageContent(scene))) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            page = paused(visit(server.url))
            assert page.console == []
            assert {url for url in page.requests if not url.startswith(("data:", "blob:"))} <= {
                server.url,
                f"http://127.0.0.1:{server.server_port}/favicon.ico",
            }
            assert page.run("gaitcal.trial.name") == "walk"
        finally:
            server.shutdown()
            thread.join()
