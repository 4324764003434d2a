"""`gaitcal.view`: what MeshCat shows is the model's pose, what was measured, and nobody else's
business.
"""

import re
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import gaitcal
from gaitcal import viewer as module
from gaitcal.arrays import Array
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.errors import Code, InputError
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import SEGMENTS
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.page.scene import build_trial_scene
from gaitcal.synthetic.synthetic_motion import compute_residual_free_wrench, simulate_gait
from gaitcal.tracking.motion import Motion
from gaitcal.viewer import MotionViewer
from tests.report.page.browser import SETTLED, Page, Visit
from tests.report.page.people import recorded_walk, subject_model

SINGLE = 2e-6
"""m: single precision on a few metres, as browsers have it."""
FRAME = 60
"""Marker 3 is not seen in it (40 to 79)."""
Walk = tuple[SubjectModel, Motion, Recording, GroundReactions]


@pytest.fixture(scope="module")
def walk() -> Walk:
    model, true = subject_model(), simulate_gait()
    motion, recording, ground = recorded_walk(
        model, true, "walk", compute_residual_free_wrench(model.parameters, true)
    )
    assert ground is not None
    return model, motion, recording, ground


@pytest.fixture(scope="module")
def viewer(walk: Walk) -> Iterator[MotionViewer]:
    with gaitcal.view(*walk) as shown:
        yield shown


def placed(page: Page, path: str) -> tuple[Array, Array]:
    """Place (3,) m and size (3,) of a node, as the browser has it, in laboratory axes."""
    find = f"viewer.scene_tree.find(['meshcat', 'gaitcal', ...{path.split('/')}]).object"
    return tuple(np.array(page.run(f"{find}.{what}.toArray()")) for what in ("position", "scale"))  # type: ignore[return-value]


def port_of(viewer: MotionViewer) -> int:
    return int(urlsplit(viewer.url).port or 0)


def test_body_meshes_have_the_poses_of_the_page(walk: Walk, viewer: MotionViewer) -> None:
    model, motion, recording, ground = walk
    trial = build_trial_scene(model, "walk", "gait", motion, recording, ground)
    names = [g.name for g in viewer.visual_model.geometryObjects]
    assert set(names) == {fitted.segment for fitted in module.fit_body_meshes(model)}
    for name in names:
        pose, segment = viewer._poses[f"gaitcal/visuals/{name}"], SEGMENTS.index(name)
        assert pose.places == pytest.approx(trial.origins[:, segment], abs=SINGLE)
        turns = Rotation.from_quat(trial.turns[:, segment]).as_matrix()
        assert pose.turns == pytest.approx(turns, abs=SINGLE)


def test_a_segment_without_markers_has_no_mesh(walk: Walk) -> None:
    model, motion, _, _ = walk
    lost = replace(motion.errors, distance=np.where(
        np.array([s == "foot_l" for s in motion.errors.segments]), np.nan, motion.errors.distance
    ))  # fmt: skip
    with gaitcal.view(model, replace(motion, errors=lost)) as shown:
        names = {g.name for g in shown.visual_model.geometryObjects}
    assert "foot_l" not in names and "foot_r" in names
    assert not any("markers" in path or "forces" in path for path in shown._poses)


def test_rods_and_arrows_are_turned_to_any_direction() -> None:
    """Joint axes along y and against it, too."""
    rng = np.random.default_rng(4)
    directions = np.vstack([np.eye(3), -np.eye(3), rng.standard_normal((20, 3))])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turns = module._from_y_to(directions)
    assert turns[:, :, 1] == pytest.approx(directions, abs=1e-12)
    assert np.linalg.det(turns) == pytest.approx(1.0)


def test_arrows_are_a_millimetre_a_newton(walk: Walk, viewer: MotionViewer) -> None:
    wrench = walk[3].wrench
    loaded = wrench[:, :, 1] > 20.0
    for foot, side in enumerate(("right", "left")):
        pose = viewer._poses[f"gaitcal/forces/{side}"]
        down = loaded[:, foot]
        force = wrench[down, foot, :3]
        assert pose.turns is not None
        arrows = pose.turns[down][:, :, 1] * pose.sizes[down, None]
        assert arrows == pytest.approx(1e-3 * force, abs=SINGLE)
        assert (pose.sizes[~down] == module.HIDDEN).all()


@pytest.mark.browser
def test_a_browser_shows_the_frame(walk: Walk, viewer: MotionViewer, visit: Visit) -> None:
    recording = walk[2]
    viewer.show(FRAME)
    page = visit(viewer.url, fresh=True)
    page.until("viewer.camera.fov === 32 && !viewer.needs_render")
    page.run(SETTLED)
    seen = recording.markers[FRAME]
    for i, label in enumerate(recording.labels):
        place, size = placed(page, f"markers/{i + 1} {label}")
        if np.isfinite(seen[i]).all():
            assert place == pytest.approx(seen[i], abs=SINGLE) and size == pytest.approx(
                np.ones(3), abs=SINGLE
            )
        else:
            assert i == 3 and size.max() < 1e-4
    # Everything of the body is in the picture, upright and in its middle.
    corners = page.run("""(() => {
        viewer.scene.updateMatrixWorld(); viewer.camera.updateMatrixWorld();
        const box = new MeshCat.THREE.Box3();
        box.setFromObject(viewer.scene_tree.find(['meshcat', 'gaitcal', 'visuals']).object);
        return [box.min, box.max].map(p => p.toArray());
    })()""")
    size = np.array(corners[1]) - corners[0]
    assert 1.5 < size[1] < 2.0 and size[1] > size[[0, 2]].max(), (
        "three.js has y up, and so has a person"
    )
    for x in (0, 1):
        for y in (0, 1):
            for z in (0, 1):
                corner = [corners[x][0], corners[y][1], corners[z][2]]
                at = page.run(
                    f"new MeshCat.THREE.Vector3(...{corner}).project(viewer.camera).toArray()"
                )
                assert np.abs(at[:2]).max() < 1.0 and -1.0 < at[2] < 1.0
    assert [
        url
        for url in page.requests
        if urlsplit(url).scheme == "http" and urlsplit(url).hostname != "127.0.0.1"
    ] == []
    assert [line for line in page.console if "404" not in line] == [], (
        "of 404, that of favicon.ico alone"
    )


@pytest.mark.browser
def test_a_saved_file_plays_offline(viewer: MotionViewer, visit: Visit, tmp_path: Path) -> None:
    viewer.play()
    viewer.save(tmp_path / "walk.html")
    page = visit(tmp_path / "walk.html")
    page.until("viewer.animator.duration > 0 && viewer.animator.playing")
    assert page.run("viewer.animator.duration") == pytest.approx(np.ptp(viewer.time), abs=1e-4)
    page.until("viewer.animator.time > 0.1")
    page.run("viewer.animator.pause()")
    seconds = page.run("viewer.animator.time")
    expected = viewer._poses["gaitcal/visuals/pelvis"].places
    at = [np.interp(seconds, viewer.time - viewer.time[0], expected[:, k]) for k in range(3)]
    assert placed(page, "visuals/pelvis")[0] == pytest.approx(at, abs=1e-4), (
        "between frames it is linear"
    )
    assert [url for url in page.requests if not url.startswith(("file:", "data:"))] == []
    assert page.console == []


def test_play_and_pause_and_frames(viewer: MotionViewer) -> None:
    viewer.show(3)
    assert viewer.frame == 3
    viewer.pause()
    assert viewer.frame == 3, "it stands still already"
    viewer.play(speed=1e-6)
    viewer.pause()
    assert viewer.frame == 0, "it began anew"
    for refused in (-1, len(viewer.time)):
        with pytest.raises(InputError) as caught:
            viewer.show(refused)
        assert str(caught.value).startswith("frame:") and caught.value.code is Code.ARGUMENT
    with pytest.raises(InputError) as caught:
        viewer.play(0.0)
    assert str(caught.value).startswith("speed:") and caught.value.code is Code.ARGUMENT


def test_a_notebook_shows_the_address(viewer: MotionViewer) -> None:
    assert f'src="{viewer.url}"' in viewer._repr_html_()


def test_only_this_computer_is_answered_and_nothing_is_left(walk: Walk) -> None:
    before = threading.active_count()
    with gaitcal.view(walk[0], walk[1]) as shown:
        port = port_of(shown)
        # A server that listened on all addresses would have this one, too.
        with socket.socket() as other:
            other.bind(("127.0.0.2", port))
        with socket.create_connection(("127.0.0.1", port), timeout=10):
            pass
    assert threading.active_count() == before
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), timeout=10)


def test_what_does_not_fit_together_is_refused(walk: Walk) -> None:
    model, motion, recording, ground = walk
    part = replace(motion, coordinates=motion.coordinates[:6])
    short = replace(recording, time=recording.time[:9], markers=recording.markers[:9])
    cases: list[tuple[str, tuple[Any, ...]]] = [
        ("motion", (model, part)),
        ("recording", (model, motion, short)),
        ("ground", (model, motion, recording, replace(ground, wrench=ground.wrench[:9]))),
    ]
    for field, arguments in cases:
        with pytest.raises(InputError) as caught:
            gaitcal.view(*arguments)
        assert str(caught.value).startswith(f"{field}:") and caught.value.code is Code.ARGUMENT


def test_colours_and_sizes_are_those_of_the_page() -> None:
    scripts = files("gaitcal.report.page") / "scripts"
    body, markers = (
        (scripts / name).read_text(encoding="utf-8") for name in ("body.js", "markers.js")
    )
    colours = {name: int(value, 16) for name, value in re.findall(r"(\w+): 0x(\w{6})", body)}
    assert [colours[name] for name in ("body", "measured", "force", "plate", "fitted")] == [
        module.BODY, module.MEASURED, module.FORCE, module.PLATE, module.JOINT,
    ]  # fmt: skip
    assert (
        float(re.findall(r"METRES_PER_NEWTON = ([\d.]+)", markers)[0]) == module.METRES_PER_NEWTON
    )
