"""`python -m scripts.validation truth`: its geometry and its counting on exact data, and small runs of each part."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.io.recording import Recording
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JP_INDEX, leg_parameters
from gaitcal.synthetic.subject import synthetic_model
from gaitcal.synthetic.truth import _joint_lines, segment_frames
from scripts.validation import error_bars
from scripts.validation.harness import changed_settings, results, write_json
from scripts.validation.truth import opensim_trials, people, report, rigid, skin

ROUNDING = 1e-10
"""m, or of a unit vector: coordinates of metres, in doubles, through a singular value decomposition."""


def test_screw_axis_is_the_line_that_was_turned_about() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        point, angle, slide = rng.normal(size=3), rng.uniform(0.05, 2.5), rng.normal()
        turn = Rotation.from_rotvec(angle * n).as_matrix()
        before = (Rotation.random(random_state=1).as_matrix(), rng.normal(size=3))
        after = (turn @ before[0], turn @ (before[1] - point) + point + slide * n)
        found = rigid.screw_axis(before, after)
        np.testing.assert_allclose(found.direction, n, atol=ROUNDING)
        assert found.distance(point) < ROUNDING


def test_line_measures_distances_and_angles() -> None:
    line = rigid.Line(np.array([1.0, 0.0, 5.0]), np.array([0.0, 0.0, 1.0]))
    assert line.distance(np.array([1.0, 2.0, -3.0])) == pytest.approx(2.0)
    slanted = np.array([0.0, np.sin(0.1), -np.cos(0.1)])
    assert line.angle(slanted) == pytest.approx(np.rad2deg(0.1))


def _moving(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return Rotation.random(count, random_state=seed).as_matrix(), rng.normal(size=(count, 3))


def test_score_finds_a_ball_joint() -> None:
    (above, at), below = _moving(30, 5), Rotation.random(30, random_state=6).as_matrix()
    c, d = np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.4, -0.1])
    origin = above @ c + at - below @ d
    for found, true in zip(rigid.score((above, at), (below, origin)), (c, d), strict=True):
        np.testing.assert_allclose(found, true, atol=ROUNDING)


def test_sara_finds_a_hinge() -> None:
    above, at = _moving(30, 7)
    n, c, d = np.array([0.6, 0.0, 0.8]), np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.4, -0.1])
    rest = Rotation.random(random_state=8).as_matrix()
    turns = Rotation.from_rotvec(np.linspace(-1, 1, 30)[:, None] * n).as_matrix()
    below = above @ turns @ rest
    proximal, distal = rigid.sara((above, at), (below, above @ c + at - below @ d))
    assert proximal.angle(n) < 1e-6 and distal.angle(rest.T @ n) < 1e-6  # deg
    assert proximal.distance(c) < ROUNDING and distal.distance(d) < ROUNDING


def test_true_parameters_of_a_known_linkage() -> None:
    parameters = synthetic_model(np.random.default_rng(9), perturb=True).parameters
    pose = np.zeros(len(COORDINATES))
    pose[6:] = np.random.default_rng(10).normal(size=21) * 0.1
    frames = segment_frames(parameters, pose)
    known = _joint_lines(parameters, pose)
    for side in "rl":
        coordinates = {"knee": "knee_angle", "ankle": "ankle_angle", "subtalar": "subtalar_angle"}
        axes = {
            f"{joint}_{side}": rigid.Line(known[f"{c}_{side}"][1], known[f"{c}_{side}"][0])
            for joint, c in coordinates.items()
        }
        centres = {f"hip_{side}": known[f"hip_flexion_{side}"][1]}
        person = SimpleNamespace(centres=centres, proximal=axes, distal=axes)
        found = people.leg_parameters(person, frames, side)
        assert set(found) == set(leg_parameters(side))
        for name, value in found.items():
            assert value == pytest.approx(parameters.joint[JP_INDEX[name]], abs=ROUNDING), name


def test_axes_of_parameters_are_told_back() -> None:
    back = people.z_parameters("a", people.z_axis(0.3, -0.2))
    assert back == pytest.approx({"a.front": 0.3, "a.trans": -0.2})
    back = people.x_parameters("a", people.x_axis(0.3, -0.2))
    assert back == pytest.approx({"a.trans": 0.3, "a.sag": -0.2})


def test_static_frames_are_where_the_model_put_its_markers() -> None:
    model = published_model()
    turn, shift = Rotation.random(random_state=11).as_matrix(), np.array([1.0, 2.0, 3.0])
    still = model.markers.local @ turn.T + shift
    recording = Recording(source="s", time=np.zeros(1), labels=model.markers.labels, markers=still[None])
    for name, frame in people.static_frames(model, recording).items():
        if model.markers.segments.count(name) >= 3:
            np.testing.assert_allclose(frame.rotation, turn, atol=1e-6)  # markers may stand nearly on one line
            np.testing.assert_allclose(frame.local(shift), 0.0, atol=1e-6)


def test_bars_count_what_holds() -> None:
    held = error_bars.bars(np.array([0.5, -1.5, 3.0, 0.1]), np.array([1.0, 1.0, 1.0, np.nan]))
    assert (held.count, held.within) == (4, (1, 2))
    assert held.rms == pytest.approx(np.sqrt(3 / 4))
    both = held + held
    assert (both.count, both.within, both.shares) == (8, (2, 4), (25.0, 50.0))


def test_bars_of_normal_errors_cover_as_they_say() -> None:
    errors = np.random.default_rng(12).normal(size=200_000) * 3.0
    first, second = error_bars.bars(errors, np.full(errors.shape, 3.0)).shares
    assert first == pytest.approx(68.27, abs=0.5)
    assert second == pytest.approx(95.0, abs=0.3)


def test_settings_of_the_command_line() -> None:
    found = changed_settings(["mode=simultaneous", "nodes=20", "jp = true", 'prior="none"'])
    assert found == {"mode": "simultaneous", "nodes": 20, "jp": True, "prior": "none"}
    with pytest.raises(Exception, match="allowed: key=value"):
        changed_settings(["mode"])


TRACKING = {
    "pelvis": ("P1", "P2", "P3"),
    **{f"{part}_{s}": tuple(f"{part}{s}{k}" for k in range(3)) for part in ("thigh", "shank", "foot") for s in "rl"},
}


def _bending(degrees: np.ndarray) -> tuple[Recording, dict[str, np.ndarray]]:
    """The right hip flexes by these angles, one frame each; all else stands."""
    rng = np.random.default_rng(13)
    rest = {label: rng.normal(size=3) * 0.2 for labels in TRACKING.values() for label in labels}
    hip = np.array([0.0, 0.1, 0.1])
    markers = np.array([list(rest.values())] * len(degrees))
    turns = Rotation.from_euler("z", degrees[:, None], degrees=True).as_matrix()
    for k, label in enumerate(rest):
        if label[:-1] in ("thighr", "shankr", "footr"):
            markers[:, k] = (turns @ (rest[label] - hip)) + hip
    time = np.arange(len(degrees)) * 0.005
    return Recording(source="s", time=time, labels=tuple(rest), markers=markers), rest


def _moved(kind: skin.Kind, degrees: np.ndarray, seed: tuple[int, int] = (1, 1)) -> np.ndarray:
    recording, rest = _bending(degrees)
    return skin.displacement(recording, rest, TRACKING, kind, 15.0, seed)


def test_skin_follows_the_joints_by_its_law() -> None:
    angles = np.array([0.0, 30.0, 60.0])
    linear, quadratic = (_moved(kind, angles) for kind in (skin.Kind.LINEAR, skin.Kind.QUADRATIC))
    np.testing.assert_allclose(linear[0], 0.0, atol=ROUNDING)
    labels = [label for group in TRACKING.values() for label in group]
    thigh = [labels.index(label) for label in TRACKING["thigh_r"]]
    back = Rotation.from_euler("z", -angles[:, None], degrees=True).as_matrix()  # into the frame of the bone
    own = np.einsum("fij,fmj->fmi", back, linear[:, thigh])
    np.testing.assert_allclose(own[2], 2 * own[1], atol=ROUNDING)
    np.testing.assert_allclose(quadratic[2], linear[2], atol=ROUNDING)
    sizes = np.linalg.norm(own[2], axis=1)
    assert 0.005 < sizes.mean() < 0.04  # 15 mm of the cluster, and each marker's own and the turn on top
    left = [labels.index(label) for label in TRACKING["thigh_l"]]
    np.testing.assert_allclose(linear[:, left], 0.0, atol=ROUNDING)


def test_laws_last_and_random_movement_does_not() -> None:
    angles = 30.0 * np.sin(np.arange(400) * 0.05)
    for kind, same in ((skin.Kind.LINEAR, True), (skin.Kind.RANDOM, False), (skin.Kind.BURSTS, False)):
        first, again, other = (_moved(kind, angles, (1, trial)) for trial in (1, 1, 2))
        assert np.array_equal(first, again)
        assert np.allclose(first, other) is same
    assert not np.allclose(_moved(skin.Kind.LINEAR, angles), _moved(skin.Kind.LINEAR, angles, (2, 1)))


def test_mixture_is_half_of_each() -> None:
    angles = 30.0 * np.sin(np.arange(50) * 0.05)
    parts = sum(_moved(kind, angles) for kind in skin.FIVE)
    np.testing.assert_allclose(_moved(skin.Kind.MIXTURE, angles), 0.5 * parts, atol=ROUNDING)


def test_smooth_noise_has_its_variance_and_frequency() -> None:
    time = np.arange(0, 10, 0.01)
    noise = skin.smooth_noise(time, 50, np.random.default_rng(14))
    assert noise.std() == pytest.approx(1.0, abs=0.1)
    rate = np.gradient(noise, time, axis=0)
    assert rate.std() / (2 * np.pi) == pytest.approx(skin.RANDOM_HZ, rel=0.1)


def test_table_and_limits_of_a_few_fits(tmp_path: Path) -> None:
    held = error_bars.Bars(20, (14, 19), 20.0)
    fits = [
        report.Outcome(
            part="isolated",
            case="linear",
            person="p",
            seed=seed,
            seconds=1.0,
            converged=True,
            figures={
                "hip in pelvis, mm": report.Figure(error=error, before=30.0, peer=12.0, bars=held),
                "hip in pelvis, ant, mm": report.Figure(error=error),
            },
        )
        for seed, error in enumerate((3.0, 4.0, 8.0))
    ]
    rows = list(report.lines(fits))
    assert "isolated, linear: fits 3, people 1, median 1.00 s each" in rows
    (row,) = [row for row in rows if row.startswith("hip in pelvis")]
    assert row.split()[4:] == ["30.0", "4.00", "3.00", "to", "8.00", "5.45", "12.0", "1.00", "70.0", "95.0", "60"]
    assert sum(row.startswith("hip in pelvis") for row in report.lines(fits, details=True)) == 2
    write_json(fits[:1], tmp_path / "earlier.json")
    (row,) = [r for r in report.lines(fits, report.read(tmp_path / "earlier.json")) if r.startswith("hip in pelvis")]
    assert row.split()[-2:] == ["60", "3.00"]
    lost = [replace(fits[0], converged=False)]
    assert any("1 NOT CONVERGED" in r for r in report.lines(lost))
    found = {c.words: (c.met, round(c.found, 2)) for c in report.checks(fits)}
    assert found == {
        "isolated, linear: hip in pelvis, mm, RMS": (True, 5.45),
        "isolated, linear: hip in pelvis, mm, in 95 %": (True, 95.0),
    }
    assert "wanted: 2 of 2 met" in "\n".join(report.wanted_lines(fits))


@pytest.mark.slow
def test_gait_of_a_simulated_person(data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = tmp_path / "figures.json"
    arguments = ["--parts", "gait", "--only", "p01", "--kinds", "none", "--json", str(found)]
    (fit,) = results("truth", *arguments, "--set", "gait_parameters=leg")
    hip = fit.figures["hip in laboratory, mm"]
    assert hip.before is not None and hip.error < 0.5 * hip.before
    assert abs(hip.error - fit.figures["hip in pelvis, mm"].error) < 1.0  # the same, told in two ways
    torque = fit.figures["torque knee_angle, N·m"]
    assert torque.error < 10.0 and torque.bars.count > 100  # signs and columns are right
    assert json.loads(found.read_text(encoding="utf-8"))[0]["figures"].keys() == fit.figures.keys()
    said = capsys.readouterr().out
    assert "settings: gait_parameters=leg" in said and "torque subtalar_angle, N·m" in said


def test_without_data_it_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GAITCAL_DATA", raising=False)
    with pytest.raises(SystemExit, match="GAITCAL_DATA"):
        results("truth", "--parts", "gait")


def test_without_opensim_it_says_what_is_missing(
    data_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "opensim", None)
    with pytest.raises(SystemExit, match="peers"):
        results("truth", "--parts", "isolated", "--only", "p01", "--cache", str(tmp_path))


@pytest.mark.slow
@pytest.mark.peers
def test_isolated_trials_of_a_simulated_person(data_dir: Path, tmp_path: Path) -> None:
    pytest.importorskip("opensim", reason="extra `peers`")
    source = data_dir.resolve() / "opensim_truth" / "p01"
    opensim_trials.make_trials(
        source / "subject01.osim", source / "coordinates.sto", tmp_path / "p01", rate=SLOW_CAMERA
    )
    common = ["--parts", "isolated", "--only", "p01", "--seeds", "1", "--cache", str(tmp_path)]
    exact, noisy = results("truth", *common, "--kinds", "none,linear", "--set", "prior=none")
    for name in ("hip in pelvis, mm", "hip in thigh, mm"):
        assert exact.figures[name].error < 0.1 < noisy.figures[name].error < 30.0 < exact.figures[name].before
        assert exact.figures[name].peer < 1e-3
    for name in ("talocrural axis, deg", "subtalar axis, deg"):
        assert exact.figures[name].error < 0.5


SLOW_CAMERA = 25.0
"""Frames/s: OpenSim takes 15 ms a frame."""


@pytest.mark.slow
def test_synthetic_people_and_the_part_of_that_name(capsys: pytest.CaptureFixture[str]) -> None:
    (fit,) = results("truth", "--parts", "synthetic", "--synthetic-people", "1")
    torques = fit.figures["torques of all, N·m"]
    assert 0.5 < torques.error < 6.0 and torques.bars.count > 1000
    assert fit.figures["knee position, mm"].error < fit.figures["knee position, mm"].before
    assert "synthetic, waves: fits 1, people 1" in capsys.readouterr().out
