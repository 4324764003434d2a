"""A page as a file: what it holds, what may run, its size whatever the trials, the meshes of the
body.
"""

import base64
import hashlib
import json
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitcal.analysis.result import Calibration
from gaitcal.report.page import body_meshes as meshes_module
from gaitcal.report.page.body_meshes import (
    BALLS,
    MESHES,
    Mesh,
    make_round_body,
    read_body_meshes,
    read_stl,
)
from gaitcal.report.page.page_data import (
    build_calibration_page_data,
    report_thinned_curves,
    thin_page_data,
)
from gaitcal.report.page.page_html import SCRIPTS, PageContent, list_omissions, render_page
from gaitcal.report.page.plain_data import (
    GAP,
    dump_script_json,
    encode_base64,
    pack_floats,
    pack_lengths,
)
from gaitcal.report.page.scene import MotionScene, Scene, build_person_scene
from gaitcal.report.page.scene_file import dump_scene_json
from gaitcal.synthetic.synthetic_motion import simulate_gait
from tests.fake_result import HOSTILE, Names, fake_calibration
from tests.report.page.browser import Visit
from tests.report.page.people import (
    long_motion,
    standard_errors,
    subject_model,
    walking_scene,
    walking_trial,
)
from tests.report.page.walked_blocks import held, scripts

LIMIT = 25_000_000
"""bytes that a page may have."""
PACKED = 1e-4
"""m: 16 bits on the few metres that markers are from the pelvis."""


def values_of(packed: dict[str, Any]) -> np.ndarray:
    raw = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2")
    return np.where(
        raw == GAP, np.nan, packed["low"] + packed["step"] * (raw.astype(float) + 32767)
    )


def test_the_page_holds_what_the_scene_holds(scene: Scene, html: Path) -> None:
    text = html.read_text(encoding="utf-8")
    found = held(text)["scene"]
    trial, packed = scene.trials[0], found["trials"][0]
    pelvis = np.frombuffer(base64.b64decode(packed["pelvis"]), dtype="<f4").reshape(-1, 1, 3)
    for name in ("measured", "origins"):
        wanted = getattr(trial, name)
        back = values_of(packed[name]).reshape(wanted.shape) + pelvis
        assert back == pytest.approx(wanted, abs=PACKED, nan_ok=True), name
    assert found["markers"]["labels"] == list(scene.labels)
    assert [t["name"] for t in found["trials"]] == ["walk", "no plates"]
    assert len(text) < 3_000_000


def test_only_its_own_scripts_may_run_nothing_is_fetched_and_nothing_of_this_machine_is_in_it(
    html: Path,
) -> None:
    text = html.read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text).group(1)
    running = [body for attributes, body in scripts(text) if "type=" not in attributes]
    hashes = {base64.b64encode(hashlib.sha256(body.encode()).digest()).decode() for body in running}
    assert len(running) == 3
    assert set(re.findall(r"'sha256-([^']*)'", policy)) == hashes
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe-eval" not in policy and "script-src 'unsafe" not in policy
    outside = re.sub(r"<script.*?</script", "", text, flags=re.DOTALL)
    assert not re.search(r"(src|href)\s*=|url\(|@import|https?:", outside)
    assert str(Path(meshes_module.__file__).parent) not in text and "site-packages" not in text


def test_no_two_scripts_define_the_same_name() -> None:
    folder = files("gaitcal.report.page") / "scripts"
    names = [
        n
        for s in SCRIPTS
        for n in re.findall(r"^Gaitcal\.(\w+) =", (folder / s).read_text(encoding="utf-8"), re.M)
    ]
    assert sorted({n for n in names if names.count(n) > 1}) == []


def packed_trial(trial: MotionScene) -> dict[str, Any]:
    """A trial as the page shows it."""
    packed: dict[str, Any] = json.loads(
        dump_scene_json(build_person_scene(subject_model(), (trial,), {}), read_body_meshes())
    )
    return packed["trials"][0]


def test_a_long_walk_does_not_coarsen_the_markers() -> None:
    far = walking_trial(subject_model(), long_motion(10_000), "long", None)
    assert np.ptp(far.origins[:, 0, 0]) > 50.0
    assert packed_trial(far)["measured"]["step"] < PACKED


def test_an_absurd_marker_is_left_out_and_spares_the_others() -> None:
    trial = walking_trial(subject_model(), simulate_gait(), "walk", None)
    measured = trial.measured.copy()
    measured[5:7, 2] = [1e30, 0.0, 0.0], [np.inf] * 3
    packed = packed_trial(replace(trial, measured=measured))["measured"]
    back = values_of(packed).reshape(measured.shape)
    assert np.isnan(back[5:7, 2]).all() and np.isfinite(back[7]).all()
    assert packed["step"] < PACKED


# -------------------------------------------------------------------------------------- body meshes


def test_meshes_that_are_missing_or_in_another_unit_are_replaced(
    monkeypatch: pytest.MonkeyPatch, scene: Scene
) -> None:
    assert read_body_meshes().replaced == (), "the package has every mesh"
    low, high = MESHES["foot"]
    with monkeypatch.context() as patch:
        patch.setitem(MESHES, "foot", (low * 0.01, high * 0.01))
        assert read_body_meshes().replaced == ("foot",)
    monkeypatch.setattr(meshes_module, "PACKAGE", "no-such-package")
    body = read_body_meshes()
    assert set(body.replaced) == set(MESHES) - set(BALLS)
    assert json.loads(dump_scene_json(scene, body))["capsules"]


@pytest.mark.parametrize(
    "body", [b"", b"solid ascii", b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 100]
)
def test_what_is_no_stl_is_refused(body: bytes) -> None:
    with pytest.raises(ValueError, match="STL"):
        read_stl(body)


@pytest.mark.parametrize("name", sorted(MESHES))
def test_meshes_are_closed_and_turned_outwards(name: str) -> None:
    mesh = read_body_meshes().meshes[name]
    assert volume(mesh) > 0
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (
        counts == 2
    ).mean() > 0.94  # cut surfaces of the package have a few seams, a coarser grid some folds


def test_a_ball_has_the_volume_of_a_ball() -> None:
    ball = make_round_body(-np.ones(3), np.ones(3))
    assert volume(ball) == pytest.approx(4 / 3 * np.pi, rel=0.05)
    assert volume(make_round_body(-np.ones(3), np.ones(3), blunt=2.0)) > volume(ball)


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


FRAMES = 3334
"""Of a trial of 10 000, one in three."""


def long_trial(name: str, curves: int = 100) -> dict[str, Any]:
    """As many curves with as many parts as a walk on plates has."""
    time = np.arange(FRAMES) * 0.03
    values = np.sin(time)
    values[5] = np.nan
    part = pack_lengths(values)
    curve = {
        "base": "hip_flexion",
        "valid": 0,
        **dict.fromkeys(("value", "se", "own", "nominal"), part),
        "truth": None,
    }
    return {
        "name": name,
        "frames": 10_000,
        "every": 3,
        "time": pack_floats(time),
        "masks": [encode_base64(np.arange(FRAMES, dtype="<u1"))],
        "curves": [curve] * curves,
        "strides": [],
    }


def test_a_sheet_of_common_size_stays_as_it_is(whole: Calibration) -> None:
    sheet = build_calibration_page_data(whole)
    assert thin_page_data(sheet) is sheet and report_thinned_curves(sheet) == ()


def test_what_stays_are_the_same_values_at_their_times() -> None:
    trial = long_trial("walk")
    (short,) = thin_page_data({"trials": [trial]}, most=1_000_000)["trials"]
    factor = short["every"] // 3
    assert factor > 1 and short["frames"] == 10_000
    for part in ("value", "se", "own", "nominal"):
        found, whole = (values_of(of["curves"][7][part]) for of in (short, trial))
        np.testing.assert_array_equal(found, whole[::factor])
    assert short["curves"][7]["truth"] is None
    time = np.frombuffer(base64.b64decode(short["time"]), dtype="<f4")
    np.testing.assert_allclose(time, np.arange(FRAMES)[::factor] * 0.03, rtol=1e-6)
    assert base64.b64decode(short["masks"][0]) == bytes(np.arange(FRAMES, dtype="<u1")[::factor])
    assert len(dump_script_json({"trials": [short]})) < 1_200_000


@pytest.mark.slow
def test_long_trials_stay_under_the_limit(whole: Calibration) -> None:
    model = subject_model()
    trial = walking_trial(model, long_motion(10_000), "long", None)
    data = build_calibration_page_data(whole) | {"trials": [long_trial("long")] * 12}
    shown = PageContent(build_person_scene(model, (trial,) * 12, standard_errors()), data)
    assert LIMIT / 2 < len(render_page(shown)) < LIMIT
    left_out = list_omissions(shown)
    assert len(left_out) == 2 * 12
    assert re.search(r"the page shows \d+ of 10000 frames, one in \d+;", left_out[0])
    assert "its curves show one frame in" in left_out[12]
    assert list_omissions(PageContent(walking_scene())) == ()


def test_the_sheet_may_stand_in_a_script_whatever_it_says() -> None:
    names = ["</script>", "<!--", "\u202e\u2028\ud800", '"\\', "@@PAGE@@"]
    text = dump_script_json({"names": names})
    assert "<" not in text and text.isascii() and json.loads(text)["names"] == names


WORST = f"</script><!--<script>@@PAGE@@ \\g<0> \u2066\u05d0\u2069 \u2028 \ud800 {HOSTILE}"
TAG = re.compile(r"<(/?script|!--|img|svg)", re.IGNORECASE)


def named(word: str) -> PageContent:
    """A result in which everything that may be named has this name."""
    whole = fake_calibration(Names(word, word, word, word, word, word))
    scene = walking_scene(subject=word)
    trials = tuple(replace(scene.trials[0], name=trial.name) for trial in whole.trials)
    return PageContent(replace(scene, trials=trials), build_calibration_page_data(whole))


@pytest.fixture(scope="module")
def hostile() -> str:
    return render_page(named(WORST))


def test_a_hostile_study_adds_no_markup(hostile: str) -> None:
    clean = render_page(named("name"))
    assert TAG.findall(hostile) == TAG.findall(clean)
    one = held(hostile)
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
    assert '"sheet":null' in render_page(PageContent(scene))
