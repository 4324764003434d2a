import io
import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.page.scene import Scene
from gaitcal.page.scene_file import load_scene, save_scene
from tests.page.people import walking_scene


def same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))  # type: ignore[arg-type]
    return a == b


def test_a_scene_comes_back_as_it_was(scene: Scene, tmp_path: Path) -> None:
    save_scene(scene, tmp_path / "scene.npz")
    assert same(load_scene(tmp_path / "scene.npz"), scene)
    assert [p.name for p in tmp_path.iterdir()] == ["scene.npz"]


def test_a_landmark_that_is_missing_is_damage(scene: Scene, tmp_path: Path) -> None:
    points = {name: point for name, point in scene.landmarks.points.items() if name != "thigh_r/hip"}
    for spoilt in (points, {**points, "thigh_r/hip": np.full(3, np.nan)}):
        save_scene(replace(scene, landmarks=replace(scene.landmarks, points=spoilt)), tmp_path / "scene.npz")
        with pytest.raises(InputError, match="damaged"):
            load_scene(tmp_path / "scene.npz")


def test_any_name_comes_back(tmp_path: Path) -> None:
    count = len(walking_scene().labels)
    labels = tuple(f"../{k}\u202e</script>\ud800" for k in range(count))
    odd = walking_scene(labels, "\x00 ä 漢 🦵")
    save_scene(odd, tmp_path / "scene.npz")
    back = load_scene(tmp_path / "scene.npz")
    assert back.labels == labels and back.subject == odd.subject


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_scene(tmp_path / "scene.npz")


PICKLE = io.BytesIO()
np.savez(PICKLE, scene=np.array([{"version": 1}], dtype=object))


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04 nonsense", b"{}", b"\x93NUMPY", pytest.param(PICKLE.getvalue(), id="pickle"), None]
)
def test_other_files_and_folders_are_refused(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path if content is None else tmp_path / "scene.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="no scene of gaitcal"):
        load_scene(path)


def test_damage_anywhere_is_an_error_or_harmless(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    save_scene(scene, path)
    good = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(60):
        content = bytearray(good)
        content[int(rng.integers(len(good)))] ^= int(rng.integers(1, 256))
        path.write_bytes(content if rng.random() < 0.8 else content[: int(rng.integers(len(good)))])
        try:
            load_scene(path)
        except InputError:
            refused += 1
    assert refused > 45


@pytest.mark.parametrize(
    "change",
    [
        {"version": 99},
        {"labels": ["one"]},
        {"garments": [["unknown", "pelvis"]]},
        {"trials": [["walk", "gait", "many", 1]]},
        {"segments": ["pelvis"]},
    ],
)
def test_contents_that_do_not_fit_together_are_refused(change: dict, scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    save_scene(replace(scene, trials=scene.trials[:1]), path)
    with np.load(path) as arrays:
        content = dict(arrays)
    text = json.loads(content["scene"].tobytes().decode()) | change
    content["scene"] = np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)
    np.savez(path, **content)
    with pytest.raises(InputError, match="no scene of gaitcal"):
        load_scene(path)
