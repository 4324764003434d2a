"""Scenes: poses, joints and errors are those of the model; and their files, whole or refused."""

import io
import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.errors import Code, InputError
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATES, JOINTS, SEGMENTS, Source
from gaitcal.model.parameters import read_published_parameters
from gaitcal.report.page.body_meshes import MESHES, fit_body_meshes
from gaitcal.report.page.scene import MOST_FRAMES, Scene, build_joint_marks
from gaitcal.report.page.scene_file import load_scene, save_scene
from gaitcal.synthetic.synthetic_motion import (
    compute_residual_free_wrench,
    compute_synthetic_markers,
    simulate_gait,
)
from tests.messages import refuses
from tests.report.page.people import (
    long_motion,
    model_markers,
    subject_model,
    walking_scene,
    walking_trial,
)

SINGLE = 2e-6
"""m: single precision on a few metres, quaternions included."""
EXACT = 1e-12
"""m: double precision all the way."""
DRAWN = 0.015
"""m: meshes are cut for joints where the reference body has them, not where this mesh is thickest.
"""


def test_the_poses_put_model_markers_where_the_model_has_them(scene: Scene) -> None:
    model, trial = subject_model(), scene.trials[0]
    expected = compute_synthetic_markers(model.parameters, model.markers, simulate_gait().q)
    assert model_markers(scene, trial) == pytest.approx(expected, abs=SINGLE)
    assert (np.sum(trial.turns[1:] * trial.turns[:-1], axis=2) > 0.99).all(), (
        "quaternions do not jump"
    )
    assert np.isnan(trial.measured[40:80, 3]).all() and np.isfinite(trial.measured[:40]).all(), (
        "gaps stay gaps"
    )


def test_arrows_stand_where_the_moment_is_vertical(scene: Scene) -> None:
    wrench = compute_residual_free_wrench(subject_model().parameters, simulate_gait())
    trial = scene.trials[0]
    shown = np.isfinite(trial.forces).all(axis=2)
    assert shown.any() and not shown.all()
    assert (shown == (wrench[:, :, 1] > 20.0)).all()
    force, centre = trial.forces[shown].astype(float), trial.pressure_centres[shown].astype(float)
    assert force == pytest.approx(wrench[shown][:, :3], rel=1e-6, abs=1e-4)
    rest = wrench[shown][:, 3:] - np.cross(centre, force)
    assert np.abs(rest[:, [0, 2]]).max() < 1e-3  # N·m; single precision of 700 N at a metre
    assert np.abs(centre[:, 1]).max() == 0.0


def test_a_trial_without_plates_has_no_arrows(scene: Scene) -> None:
    assert (
        scene.trials[0].has_forces
        and scene.trials[0].valid.any()
        and not scene.trials[0].valid.all()
    )
    assert not scene.trials[1].has_forces and not scene.trials[1].valid.any()
    assert scene.trials[1].plates.shape == (0, 4, 3)


def test_segments_without_markers_are_not_tracked() -> None:
    model = subject_model()
    bare = ("foot_l", "upper_arm_r")
    kept = [k for k, s in enumerate(model.markers.segments) if not s.startswith(bare)]
    parts = {
        name: tuple(getattr(model.markers, name)[k] for k in kept)
        for name in ("labels", "segments")
    }
    markers = replace(
        model.markers, **parts, local=model.markers.local[kept], weight=model.markers.weight[kept]
    )
    trial = walking_trial(replace(model, markers=markers), simulate_gait(), "walk", None)
    hidden = {s for s, tracked in zip(SEGMENTS, trial.tracked, strict=True) if not tracked}
    assert hidden == {*bare, "talus_l"}


def test_a_long_trial_is_thinned_when_the_scene_is_made() -> None:
    trial = walking_trial(subject_model(), long_motion(10_000), "long", None)
    assert (trial.recorded, trial.stride, len(trial.time)) == (10_000, 3, 3334)
    assert len(trial.time) <= MOST_FRAMES
    assert trial.time[1] - trial.time[0] == pytest.approx(3 / 200)
    assert (
        len(trial.origins)
        == len(trial.turns)
        == len(trial.measured)
        == len(trial.valid)
        == len(trial.time)
    )


def test_both_segments_see_a_fitted_joint_in_one_place() -> None:
    """Whatever the coordinates, centre and axis of a joint are the same point and line from parent
    and child.
    """
    model = subject_model()
    q = np.random.default_rng(3).uniform(-0.8, 0.8, (4, len(COORDINATES)))
    chain = Chain("pelvis", SEGMENTS)
    body = chain.body(model.parameters)
    placed = Kinematics(body, q, columns=False)
    axes, origins = placed.axes, placed.origins
    seen: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for mark in build_joint_marks(model.nominal, model.parameters, {}):
        s = chain.segments.index(mark.segment)
        centre = origins[s] + np.einsum("j,jif->if", mark.fitted_centre, axes[s])
        seen.setdefault(mark.joint, []).append(
            (centre, np.einsum("j,jif->if", mark.fitted_axis, axes[s]))
        )
    pairs = {name: both for name, both in seen.items() if len(both) == 2}
    assert set(pairs) >= {"hip_r", "knee_l", "subtalar_r", "back", "shoulder_l", "elbow_r"}
    for name, ((centre_1, axis_1), (centre_2, axis_2)) in pairs.items():
        assert centre_1 == pytest.approx(centre_2, abs=EXACT)
        if not name.startswith(
            "shoulder"
        ):  # two axes: one is fixed in the trunk, the other in the arm
            assert axis_1 == pytest.approx(axis_2, abs=EXACT, nan_ok=True)


@pytest.mark.parametrize(
    "joint", ["knee_r", "knee_l", "subtalar_r", "subtalar_l", "shoulder_r", "elbow_l"]
)
def test_axes_point_the_way_their_coordinates_turn(joint: str) -> None:
    """The first coordinate of a joint turns the child about the axis in the parent, the last about
    that in itself.
    """
    model = subject_model()
    chain = Chain("pelvis", SEGMENTS)
    body = chain.body(model.parameters)
    marks = {
        m.segment: m.fitted_axis
        for m in build_joint_marks(model.nominal, model.parameters, {})
        if m.joint == joint
    }
    (linked,) = [j for j in JOINTS if j.name == joint]
    names = [e.name for e in linked.elements if e.source is Source.COORDINATE]
    parent, child = (chain.segments.index(s) for s in (linked.parent, linked.child))
    for segment, name in ((linked.parent, names[0]), (linked.child, names[-1])):
        q = np.zeros((2, len(COORDINATES)))
        q[1, COORDINATES.index(name)] = 0.3
        placed = Kinematics(body, q, columns=False)
        axes, _ = placed.axes, placed.origins  # rows: axes of a segment, laboratory
        before, after = (axes[parent, :, :, k] @ axes[child, :, :, k].T for k in (0, 1))
        turn = after @ before.T if segment == linked.parent else before.T @ after
        assert Rotation.from_matrix(turn).as_rotvec() == pytest.approx(
            0.3 * marks[segment], abs=1e-9
        ), segment


def test_standard_errors_become_clouds_and_cones_and_one_that_is_no_number_draws_nothing() -> None:
    model = subject_model()
    errors = {
        "hip_r.pelvis.ant": 0.003, "hip_r.pelvis.sup": 0.004, "knee_r.thigh.front": 0.02,
        "knee_r.thigh.trans": 0.03,
    }  # fmt: skip
    marks = {
        (m.joint, m.segment): m for m in build_joint_marks(model.nominal, model.nominal, errors)
    }
    hip = marks["hip_r", "pelvis"]
    assert hip.fitted and not marks["hip_r", "thigh_r"].fitted
    assert hip.centre_spread @ hip.centre_spread.T == pytest.approx(
        np.diag([9e-6, 16e-6, 0.0]), abs=1e-12
    )
    knee = marks["knee_r", "thigh_r"]
    # the axis lies along -z: turning about x tips it in y, about y in x
    assert knee.axis_spread @ knee.axis_spread.T == pytest.approx(
        np.diag([9e-4, 4e-4, 0.0]), abs=1e-9
    )
    assert np.isnan(marks["hip_l", "pelvis"].centre_spread).all()
    assert np.isnan(hip.nominal_axis).all()
    odd = {"hip_r.pelvis.ant": float("nan"), "hip_r.pelvis.sup": np.inf}
    assert not any(mark.fitted for mark in build_joint_marks(model.nominal, model.nominal, odd))


def test_limb_meshes_end_at_the_joint_centres() -> None:
    model = subject_model()
    worn = {(g.mesh, g.segment): g.place for g in fit_body_meshes(model)}
    knee = build_joint_marks(model.nominal, model.parameters, {})
    centre = next(m.fitted_centre for m in knee if m.joint == "knee_r" and m.segment == "thigh_r")
    place = worn["upperleg", "thigh_r"]
    assert place[:, :3] @ [0.0, -60.8, 0.0] + place[:, 3] == pytest.approx(centre, abs=EXACT)
    # the sole is under the ankle, the toes in front
    foot = worn["foot", "foot_r"]
    low, high = (foot[:, :3] @ MESHES["foot"][k] + foot[:, 3] for k in (0, 1))
    assert low[1] < high[1] and high[0] - low[0] == pytest.approx(0.152 * 1.70, abs=DRAWN)


@pytest.mark.parametrize("height", [1.2, 1.70, 2.05])
def test_the_standing_body_is_as_tall_as_the_person(height: float) -> None:
    base = subject_model()
    scale = height / 1.70
    joint = read_published_parameters().joint * np.array(
        [scale if abs(x) > 0 else 1.0 for x in base.nominal.joint]
    )
    parameters = replace(base.nominal, joint=joint)
    markers = replace(base.markers, local=scale * base.markers.local)
    subject = replace(base.subject, height=height)
    model = replace(
        base, subject=subject, parameters=parameters, nominal=parameters, markers=markers
    )
    head = next(g.place for g in fit_body_meshes(model) if g.mesh == "head")
    marks = {
        (m.joint, m.segment): m.fitted_centre[1]
        for m in build_joint_marks(parameters, parameters, {})
    }
    legs = marks["hip_r", "thigh_r"] - marks["knee_r", "thigh_r"] - marks["talocrural_r", "shank_r"]
    lumbar = (
        legs
        + marks["knee_r", "shank_r"]
        + marks["back", "pelvis"]
        - marks["hip_r", "pelvis"]
        + 0.039 * height
    )
    top = (head[:, :3] @ [0.0, 46.2, 0.0] + head[:, 3])[1] - marks["back", "head_trunk"]
    assert lumbar + top == pytest.approx(height, abs=0.01)


def test_the_head_is_where_its_markers_are() -> None:
    """Of a person whose stature is given 30 cm too large: not a head above them."""
    base = subject_model()
    tall = replace(base, subject=replace(base.subject, height=2.0))
    head = next(g.place for g in fit_body_meshes(tall) if g.mesh == "head")
    top = (head[:, :3] @ [0.0, 46.2, 0.0] + head[:, 3])[1]
    assert 0.0 < top - base.markers.local[base.markers.labels.index("Top.Head"), 1] < 0.07


def same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray):
        return (
            isinstance(b, np.ndarray)
            and a.dtype == b.dtype
            and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        )
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return (
            isinstance(b, dict) and a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
        )
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return a == b


def test_a_scene_comes_back_as_it_was_with_any_name(scene: Scene, tmp_path: Path) -> None:
    labels = tuple(f"../{k}\u202e</script>\ud800" for k in range(len(scene.labels)))
    for one in (scene, walking_scene(labels, "\x00 ä 漢 🦵")):
        save_scene(one, tmp_path / "scene.npz")
        assert same(load_scene(tmp_path / "scene.npz"), one)
        assert [p.name for p in tmp_path.iterdir()] == ["scene.npz"]


def test_a_landmark_that_is_missing_is_damage_and_a_file_is_no_such_file(
    scene: Scene, tmp_path: Path
) -> None:
    with refuses(Code.NO_RESULT, "scene.npz"):
        load_scene(tmp_path / "scene.npz")
    points = {
        name: point for name, point in scene.landmarks.points.items() if name != "thigh_r/hip"
    }
    for spoilt in (points, {**points, "thigh_r/hip": np.full(3, np.nan)}):
        save_scene(
            replace(scene, landmarks=replace(scene.landmarks, points=spoilt)),
            tmp_path / "scene.npz",
        )
        with pytest.raises(InputError, match="damaged"):
            load_scene(tmp_path / "scene.npz")


PICKLE = io.BytesIO()
np.savez(PICKLE, scene=np.array([{"version": 1}], dtype=object))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"PK\x03\x04 nonsense",
        b"{}",
        b"\x93NUMPY",
        pytest.param(PICKLE.getvalue(), id="pickle"),
        None,
    ],
)
def test_other_files_and_folders_are_refused(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    with refuses(InputError, path.name):
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
def test_contents_that_do_not_fit_together_are_refused(
    change: dict, scene: Scene, tmp_path: Path
) -> None:
    path = tmp_path / "scene.npz"
    save_scene(replace(scene, trials=scene.trials[:1]), path)
    with np.load(path) as arrays:
        content = dict(arrays)
    text = json.loads(content["scene"].tobytes().decode()) | change
    content["scene"] = np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)
    np.savez(path, **content)
    with refuses(InputError, path.name):
        load_scene(path)
