"""`python -m scripts.validation truth`: its geometry and counting on exact data, small runs, error
bars that hold.
"""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from gaitcal import Study, calibrate, parameter_table
from gaitcal.export.opensim.peer_model import Axis, find_displacement_axis
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import COORDINATES, NEEDED_JOINTS
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JP_INDEX, JP_NAMES, JP_TO_SI, list_leg_parameters
from gaitcal.model.segment_frames import HipCentre
from gaitcal.study.study_trial import Role
from gaitcal.synthetic.subject import make_synthetic_model, make_true_gait
from gaitcal.synthetic.synthetic_truth import (
    _compute_joint_lines,
    compute_segment_frames,
    compute_static_frames,
)
from scripts.validation import harness
from scripts.validation.harness import results
from scripts.validation.truth import check, made_up, people, report, skin
from scripts.validation.truth.people import EXACT_PLATES
from tests.kept import copied_person, kept_folder, kept_person

ROUNDING = 1e-10
"""m, or of a unit vector: coordinates of metres, in doubles, through a singular value
decomposition.
"""


def test_a_displacement_turns_about_the_line_that_it_was_turned_about() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        point, turn = rng.normal(size=3), pin.exp3(rng.uniform(0.05, 2.5) * n)
        before = pin.SE3(Rotation.random(random_state=1).as_matrix(), rng.normal(size=3))
        slid = pin.SE3(turn, point - turn @ point + rng.normal() * n)
        found = find_displacement_axis(before, slid * before)
        np.testing.assert_allclose(found.direction, n, atol=ROUNDING)
        assert found.measure_distance(point) < ROUNDING


def _moving(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return Rotation.random(count, random_state=seed).as_matrix(), rng.normal(size=(count, 3))


def test_score_finds_a_ball_joint() -> None:
    (above, at), below = _moving(30, 5), Rotation.random(30, random_state=6).as_matrix()
    c, d = np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.4, -0.1])
    origin = above @ c + at - below @ d
    for found, true in zip(check.score((above, at), (below, origin)), (c, d), strict=True):
        np.testing.assert_allclose(found, true, atol=ROUNDING)


def test_sara_finds_a_hinge() -> None:
    above, at = _moving(30, 7)
    n, c, d = np.array([0.6, 0.0, 0.8]), np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.4, -0.1])
    rest = Rotation.random(random_state=8).as_matrix()
    turns = Rotation.from_rotvec(np.linspace(-1, 1, 30)[:, None] * n).as_matrix()
    below = above @ turns @ rest
    proximal, distal = check.sara((above, at), (below, above @ c + at - below @ d))
    assert (
        check.angle(proximal.direction, n) < 1e-6
        and check.angle(distal.direction, rest.T @ n) < 1e-6
    )  # deg
    assert proximal.measure_distance(c) < ROUNDING and distal.measure_distance(d) < ROUNDING


def test_true_parameters_of_a_known_linkage() -> None:
    parameters = make_synthetic_model(np.random.default_rng(9), perturb=True).parameters
    pose = np.zeros(len(COORDINATES))
    pose[6:] = np.random.default_rng(10).normal(size=len(pose) - 6) * 0.1
    frames = compute_segment_frames(parameters, pose)
    known = _compute_joint_lines(parameters, pose)
    for side in "rl":
        coordinates = {"knee": "knee_angle", "ankle": "ankle_angle", "subtalar": "subtalar_angle"}
        axes = {
            f"{joint}_{side}": Axis(known[f"{c}_{side}"][1], known[f"{c}_{side}"][0])
            for joint, c in coordinates.items()
        }
        centres = {f"hip_{side}": known[f"hip_flexion_{side}"][1]}
        person = SimpleNamespace(centres=centres, proximal=axes, distal=axes)
        found = people.leg_parameters(person, frames, side)
        assert set(found) == {
            name for name in list_leg_parameters(side) if name.startswith(NEEDED_JOINTS)
        }
        for name, value in found.items():
            assert value == pytest.approx(parameters.joint[JP_INDEX[name]], abs=ROUNDING), name


def test_static_frames_are_where_the_model_put_its_markers() -> None:
    model = published_model()
    turn, shift = Rotation.random(random_state=11).as_matrix(), np.array([1.0, 2.0, 3.0])
    still = model.markers.local @ turn.T + shift
    recording = Recording(
        source="s", time=np.zeros(1), labels=model.markers.labels, markers=still[None]
    )
    for name, frame in people.static_frames(model, recording).items():
        if model.markers.segments.count(name) >= 3:
            np.testing.assert_allclose(
                frame.rotation, turn, atol=1e-6
            )  # markers may stand nearly on one line
            np.testing.assert_allclose(frame.local(shift), 0.0, atol=1e-6)


TRACKING = {
    "pelvis": ("P1", "P2", "P3"),
    **{
        f"{part}_{s}": tuple(f"{part}{s}{k}" for k in range(3))
        for part in ("thigh", "shank", "foot")
        for s in "rl"
    },
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
    back = Rotation.from_euler(
        "z", -angles[:, None], degrees=True
    ).as_matrix()  # into the frame of the bone
    own = np.einsum("fij,fmj->fmi", back, linear[:, thigh])
    np.testing.assert_allclose(own[2], 2 * own[1], atol=ROUNDING)
    np.testing.assert_allclose(quadratic[2], linear[2], atol=ROUNDING)
    sizes = np.linalg.norm(own[2], axis=1)
    assert (
        0.005 < sizes.mean() < 0.04
    )  # 15 mm of the cluster, and each marker's own and the turn on top
    left = [labels.index(label) for label in TRACKING["thigh_l"]]
    np.testing.assert_allclose(linear[:, left], 0.0, atol=ROUNDING)


def test_table_of_a_few_fits() -> None:
    held = harness.Bars(20, (14, 19), 20.0)
    fits = [
        report.Outcome(
            part="isolated",
            case="linear",
            person="p",
            seed=seed,
            seconds=1.0,
            converged=True,
            figures={
                "hip in pelvis, mm": report.Figure(error=error, before=30.0, peer=12.0, bars=held)
            },
        )
        for seed, error in enumerate((3.0, 4.0, 8.0))
    ]
    rows = list(report.lines(fits))
    assert "isolated, linear: fits 3, people 1, median 1.00 s each" in rows
    (row,) = [row for row in rows if row.startswith("hip in pelvis")]
    assert row.split()[4:] == [
        "30.0",
        "4.00",
        "3.00",
        "to",
        "8.00",
        "5.45",
        "12.0",
        "1.00",
        "70.0",
        "95.0",
        "60",
    ]
    lost = [replace(fits[0], converged=False)]
    assert any("1 NOT CONVERGED" in r for r in report.lines(lost))


@pytest.mark.slow
def test_gait_of_a_simulated_person(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = tmp_path / "figures.json"
    arguments = ["--parts", "gait", "--only", "p01", "--kinds", "none", "--json", str(found)]
    (fit,) = results("truth", *arguments, "--set", "gait_parameters=leg")
    hip = fit.figures["hip in laboratory, mm"]
    assert hip.before is not None and hip.error < 0.5 * hip.before
    assert (
        abs(hip.error - fit.figures["hip in pelvis, mm"].error) < 1.0
    )  # the same, told in two ways
    torque = fit.figures["torque knee_angle, N·m"]
    assert torque.error < 10.0 and torque.bars.count > 100  # signs and columns are right
    assert json.loads(found.read_text(encoding="utf-8"))[0]["figures"].keys() == fit.figures.keys()
    said = capsys.readouterr().out
    assert "settings: gait_parameters=leg" in said and "torque subtalar_angle, N·m" in said


SLOW_CAMERA = 25.0
"""Frames/s: OpenSim takes 15 ms a frame."""


def simulated_trials(kept: Path, data: Path) -> Path:
    """A cache with the trials of p01, that nobody changes."""
    pytest.importorskip("opensim", reason="extra `peers`")
    source = data.resolve() / "opensim_truth" / "p01"
    files = source / "subject01.osim", source / "coordinates.sto"
    trials = partial(people.make_trials, *files, rate=SLOW_CAMERA)
    return kept_folder(kept / "simulated" / "p01", trials).parent


@pytest.mark.slow
@pytest.mark.peers
def test_isolated_trials_of_a_simulated_person(data_dir: Path, kept: Path) -> None:
    common = [
        "--parts",
        "isolated",
        "--only",
        "p01",
        "--seeds",
        "1",
        "--cache",
        str(simulated_trials(kept, data_dir)),
    ]
    exact, noisy = results("truth", *common, "--kinds", "none,linear", "--set", "prior=none")
    for name in ("hip in pelvis, mm", "hip in thigh, mm"):
        assert (
            exact.figures[name].error
            < 0.1
            < noisy.figures[name].error
            < 30.0
            < exact.figures[name].before
        )
        assert exact.figures[name].peer < 1e-3
    for name in ("talocrural axis, deg", "subtalar axis, deg"):
        assert exact.figures[name].error < 0.5


@pytest.mark.slow
def test_synthetic_people_and_the_part_of_that_name(
    kept: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("scripts.validation.truth.made_up.synthesize", partial(copied_person, kept))
    (fit,) = results("truth", "--parts", "synthetic", "--synthetic-people", "1", "--seed", "3")
    torques = fit.figures["torques of all, N·m"]
    assert 0.5 < torques.error < 6.0 and torques.bars.count > 1000
    for name, error in fit.figures.items():
        if name.startswith(("knee", "hip position")):
            assert error.error < error.before, name
    assert 55.0 < torques.bars.shares[0] < 92.0 and torques.bars.shares[1] > 86.0
    assert "synthetic, waves: fits 1, people 1" in capsys.readouterr().out


SEEDS = (3, 4, 5)
"""Three people: errors of one person go together, so that their coverage scatters by some 10 %."""
EXACT = {"segment_axes": "exact", "plate_error": EXACT_PLATES}


@pytest.mark.slow
def test_intervals_of_whole_calibrations_cover_the_truth(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Told that plates and palpated axes are exact: bars for what may be wrong with them are for
    others than these.

    Isolated trials beside the walk:
    `test_truth.py::test_synthetic_people_and_the_part_of_that_name`.
    """
    monkeypatch.setattr("scripts.validation.truth.made_up.synthesize", partial(copied_person, kept))
    people = [made_up.synthetic_person(seed, made_up.Settings.GAIT_ONLY, EXACT) for seed in SEEDS]
    parameters = pd.concat([p.parameters for p in people])
    joint = parameters[parameters["kind"].str.startswith("joint")]["z"].dropna()
    torques = np.concatenate([p.torques.ravel() for p in people])
    powers, vectors = (
        np.concatenate([(gaps / errors).ravel() for gaps, errors in pairs])
        for pairs in ([p.powers for p in people], [p.vectors for p in people])
    )
    for z in (joint, torques, powers, vectors):
        # wide for these people, who vary less (within 10 mm, 10 deg, 10 %) than people of whom
        # priors are
        assert 55.0 < 100.0 * np.mean(np.abs(z) < 1.0) < 92.0
        assert 100.0 * np.mean(np.abs(z) < 1.96) > 86.0
    report = list(made_up.lines(people))
    assert any(line.startswith("knee       position") and "in 95 %" in line for line in report)
    assert any(line.startswith("subtalar_angle_l") for line in report)


@pytest.mark.slow
def test_the_truth_is_told_in_the_frames_of_the_calibration(kept: Path) -> None:
    """A thigh begins at the hip of the rule that a calibration uses, here another than
    the default.
    """
    rule = HipCentre.BELL
    study = Study.load(kept_person(kept, seed=3, perturb=True))
    study = replace(
        study,
        settings=study.settings.model_validate({"hip_centre": rule.value, "jp": False}),
        trials=tuple(trial for trial in study.trials if trial.role is not Role.JOINT),
    )
    nominal = parameter_table(calibrate(study)).set_index("name")["nominal"]
    person = replace(published_model(static_only=True), parameters=make_true_gait(3)[0])
    truth = dict(
        zip(JP_NAMES, compute_static_frames(person, rule).parameters.joint / JP_TO_SI, strict=True)
    )
    # one hip joins two frames: its true place in the thigh, which begins at the nominal hip, is
    # where it misses that
    for side in "rl":
        names = [f"hip_{side}.{{}}.{direction}" for direction in ("ant", "sup", "lat")]
        in_pelvis = [truth[n.format("pelvis")] - nominal[n.format("pelvis")] for n in names]
        in_thigh = [truth[n.format("thigh")] - nominal[n.format("thigh")] for n in names]
        np.testing.assert_allclose(np.linalg.norm(in_thigh), np.linalg.norm(in_pelvis), rtol=1e-3)


def test_bars_count_what_holds() -> None:
    held = harness.bars(np.array([0.5, -1.5, 3.0, 0.1]), np.array([1.0, 1.0, 1.0, np.nan]))
    assert (held.count, held.within) == (4, (1, 2))
    assert held.rms == pytest.approx(np.sqrt(3 / 4))
    both = held + held
    assert (both.count, both.within, both.shares) == (8, (2, 4), (25.0, 50.0))
