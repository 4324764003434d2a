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

from gaitcal.page import body_meshes as meshes_module
from gaitcal.page.body_meshes import BALLS, MESHES, Mesh, body_meshes, read_stl, round_body
from gaitcal.page.plain_data import GAP
from gaitcal.page.scene import Scene, person_scene
from gaitcal.page.scene_file import scene_json
from gaitcal.page.view import SCRIPTS
from gaitcal.synthetic.motion import gait_motion
from tests.page.people import long_motion, subject_model, walking_trial

LIMIT = 25_000_000
"""bytes that a page may have."""
PACKED = 1e-4
"""m: 16 bits on the few metres that markers are from the pelvis."""


def scripts(html: str) -> list[tuple[str, str]]:
    """Attributes and contents of the script elements, found as a browser does."""
    return re.findall(r"<script([^>]*)>(.*?)</script", html, flags=re.DOTALL | re.IGNORECASE)


def content(html: str) -> dict[str, Any]:
    result = json.loads(next(text for attributes, text in scripts(html) if 'id="result"' in attributes))
    scene: dict[str, Any] = result["scene"]
    return scene


def lengths(packed: dict[str, Any]) -> np.ndarray:
    raw = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2")
    return np.where(raw == GAP, np.nan, packed["low"] + packed["step"] * (raw.astype(float) + 32767))


def test_the_page_holds_what_the_scene_holds(scene: Scene, html: Path) -> None:
    text = html.read_text(encoding="utf-8")
    found = content(text)
    trial, packed = scene.trials[0], found["trials"][0]
    pelvis = np.frombuffer(base64.b64decode(packed["pelvis"]), dtype="<f4").reshape(-1, 1, 3)
    assert lengths(packed["measured"]).reshape(trial.measured.shape) + pelvis == pytest.approx(
        trial.measured, abs=PACKED, nan_ok=True
    )
    assert lengths(packed["origins"]).reshape(trial.origins.shape) + pelvis == pytest.approx(trial.origins, abs=PACKED)
    assert found["markers"]["labels"] == list(scene.labels)
    assert [t["name"] for t in found["trials"]] == ["walk", "no plates"]
    assert len(text) < 3_000_000


def test_exactly_two_scripts_may_run_and_nothing_is_fetched(html: Path) -> None:
    text = html.read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    running = [body for attributes, body in scripts(text) if "type=" not in attributes]
    hashes = {base64.b64encode(hashlib.sha256(body.encode()).digest()).decode() for body in running}
    assert len(running) == 3
    assert set(re.findall(r"'sha256-([^']*)'", policy.group(1))) == hashes
    assert policy.group(1).startswith("default-src 'none'; ")
    assert "unsafe-eval" not in policy.group(1) and "script-src 'unsafe" not in policy.group(1)
    outside = re.sub(r"<script.*?</script", "", text, flags=re.DOTALL)
    assert not re.search(r"(src|href)\s*=|url\(|@import|https?:", outside)


def test_no_two_scripts_define_the_same_name() -> None:
    folder = files("gaitcal.page") / "scripts"
    names = [
        n for s in SCRIPTS for n in re.findall(r"^Gaitcal\.(\w+) =", (folder / s).read_text(encoding="utf-8"), re.M)
    ]
    assert sorted({n for n in names if names.count(n) > 1}) == []


def test_nothing_of_this_machine_is_in_the_page(html: Path) -> None:
    text = html.read_text(encoding="utf-8")
    assert str(Path(meshes_module.__file__).parent) not in text
    assert "site-packages" not in text


def test_a_long_walk_does_not_coarsen_the_markers() -> None:
    model = subject_model()
    far = walking_trial(model, long_motion(10_000), "long", None)
    assert np.ptp(far.origins[:, 0, 0]) > 50.0
    packed = json.loads(scene_json(person_scene(model, (far,), {}), body_meshes()))["trials"][0]
    assert packed["measured"]["step"] < PACKED


def test_an_absurd_marker_is_left_out_and_spares_the_others() -> None:
    model = subject_model()
    trial = walking_trial(model, gait_motion(), "walk", None)
    measured = trial.measured.copy()
    measured[5, 2] = [1e30, 0.0, 0.0]
    measured[6, 2] = np.inf
    odd = replace(trial, measured=measured)
    packed = json.loads(scene_json(person_scene(model, (odd,), {}), body_meshes()))["trials"][0]
    back = lengths(packed["measured"]).reshape(measured.shape)
    assert np.isnan(back[5:7, 2]).all() and np.isfinite(back[7]).all()
    assert packed["measured"]["step"] < PACKED


# ------------------------------------------------------------------------------------------------------- body meshes


def test_the_package_has_every_mesh() -> None:
    assert body_meshes().replaced == ()


def test_capsules_where_the_package_is_missing(monkeypatch: pytest.MonkeyPatch, scene: Scene) -> None:
    monkeypatch.setattr(meshes_module, "PACKAGE", "no-such-package")
    body = body_meshes()
    assert set(body.replaced) == set(MESHES) - set(BALLS)
    assert json.loads(scene_json(scene, body))["capsules"]


def test_a_mesh_in_another_unit_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    low, high = MESHES["foot"]
    monkeypatch.setitem(MESHES, "foot", (low * 0.01, high * 0.01))
    assert body_meshes().replaced == ("foot",)


@pytest.mark.parametrize("body", [b"", b"solid ascii", b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 100])
def test_what_is_no_stl_is_refused(body: bytes) -> None:
    with pytest.raises(ValueError, match="STL"):
        read_stl(body)


@pytest.mark.parametrize("name", sorted(MESHES))
def test_meshes_are_closed_and_turned_outwards(name: str) -> None:
    mesh = body_meshes().meshes[name]
    assert volume(mesh) > 0
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 2).mean() > 0.94  # cut surfaces of the package have a few seams, a coarser grid some folds


def test_a_ball_has_the_volume_of_a_ball() -> None:
    ball = round_body(-np.ones(3), np.ones(3))
    assert volume(ball) == pytest.approx(4 / 3 * np.pi, rel=0.05)
    assert volume(round_body(-np.ones(3), np.ones(3), blunt=2.0)) > volume(ball)


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
