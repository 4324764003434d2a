"""The main job on real recordings: what each of them must show."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gaitcal.analysis.result import Calibration, Stage
from gaitcal.io.opensim_files import read_table
from gaitcal.model.linkage import COORDINATE_INDEX, LOWER_BODY
from gaitcal.model.parameters import JP_INDEX, is_physical, view_as_table
from tests.kept import kept_real
from tests.messages import check_text

MM = 1e3
REFERENCE_SIGN = {"hip_flexion": 1, "knee_angle": -1, "ankle_angle": 1}
"""The reference's knee angle is negative in flexion."""


calibrated = cache(kept_real)


def test_subject01_fits_its_walk(data_dir: Path, kept: Path) -> None:
    walk = calibrated(kept, "subject01", data_dir).trial("walk")
    nominal, fitted, floor = (
        MM * (e.rms(*LOWER_BODY) or 0)
        for e in (walk.nominal.errors, walk.calibrated.errors, walk.floor)
    )
    assert (
        int(walk.calibrated.errors.select_observed(*LOWER_BODY).sum()) == 25
    )  # of 27 the toe tips have no weight
    assert floor == pytest.approx(2.3, abs=0.1)
    assert floor < (walk.compute_joint_floor_mm(*LOWER_BODY) or 0) < fitted < 5.6 < nominal < 12.0


def test_subject01_contacts_are_found_on_its_treadmill(data_dir: Path, kept: Path) -> None:
    """A foot rests, against the belt, while its plate is loaded, but for a few frames at either end
    (60 Hz).
    """
    walk = calibrated(kept, "subject01", data_dir).trial("walk")
    reactions = walk.loads.reactions
    valid = reactions.valid[:, None]
    assert not (valid & reactions.resting & ~reactions.loaded).any()
    assert (valid & reactions.loaded & ~reactions.resting).sum() <= 12  # as measured: 11
    assert (valid & reactions.resting).sum() > 150


def test_subject01_loads_are_explained_better_than_by_the_peer(data_dir: Path, kept: Path) -> None:
    """OpenSim's own residuals on 0.4 to 1.6 s: 30.6 N and 13.1 N·m."""
    calibration = calibrated(kept, "subject01", data_dir)
    walk = calibration.trial("walk")
    window = walk.loads.reactions.valid & (walk.body.time >= 0.4) & (walk.body.time <= 1.6)
    assert window.sum() >= 72
    before, after = (
        walk.loads.moments[stage].residual_rms(window) for stage in (Stage.JP, Stage.JP_IP)
    )
    assert after[0] < before[0] and after[1] < before[1]
    assert after[0] < 30.6 and after[1] < 13.1
    inertial = calibration.model.parameters.inertial
    assert is_physical(inertial).all()
    assert view_as_table(inertial)[:, 0].sum() == pytest.approx(72.6, abs=1e-9)


ANGLES = [(f"{name}_{side}", sign) for side in "rl" for name, sign in REFERENCE_SIGN.items()]


@pytest.mark.parametrize(("name", "sign"), ANGLES)
def test_subject01_moves_and_is_driven_as_the_peer_says(
    name: str, sign: int, data_dir: Path, kept: Path
) -> None:
    """Though its toe tips pull, which ours do not: the toes bend against the foot. Of moments 0.9
    is wanted; the hips' is what was measured (0.84, 0.78), the peer's hip centres lie 42 to 46 mm
    further back.
    """
    # the peer's ankles have another axis: nominal ones follow it to 0.93, fitted ones to 0.94
    angle, moment = correlation(name, sign, calibrated(kept, "subject01", data_dir), data_dir)
    assert angle > (0.93 if name.startswith("ankle") else 0.97)
    assert moment > (0.75 if name.startswith("hip") else 0.90)


def correlation(name: str, sign: int, calibration: Calibration, data: Path) -> tuple[float, float]:
    """Of angle and moment with OpenSim's, 0.4 to 1.6 s."""
    walk = calibration.trial("walk")
    column, out = COORDINATE_INDEX[name], []
    for file, ours, suffix in (
        ("subject01_walk1_ik.mot", walk.body.q[:, column], ""),
        ("inverse_dynamics.sto", walk.loads.final.tau[:, column], "_moment"),
    ):
        reference = read_table(data / "subject01/reference" / file)
        at = (reference.time >= 0.4) & (reference.time <= 1.6)
        mine = sign * np.interp(reference.time[at], walk.body.time, ours)
        out.append(float(np.corrcoef(mine, reference.get_column(f"{name}{suffix}")[at])[0, 1]))
    return out[0], out[1]


@pytest.mark.slow
def test_uf3_isolated_trials_come_near_their_floor(data_dir: Path, kept: Path) -> None:
    calibration = calibrated(kept, "uf3", data_dir)
    for trial in calibration.trials:
        nominal, fitted, floor = (
            e.rms() or 0.0 for e in (trial.nominal.errors, trial.calibrated.errors, trial.floor)
        )
        assert fitted < nominal
        if trial.joint:
            # 1.51 at most as measured: joints are where skin that moves is counted, hips are
            # tracked as if it did not
            joint_floor = 1e-3 * (trial.compute_joint_floor_mm() or 0.0)
            assert floor < joint_floor < fitted < 1.6 * joint_floor, trial.name
    knee = calibration.trial("knee_r").floor.rms() or 0.0
    assert MM * knee == pytest.approx(1.4, abs=0.1)
    gait = calibration.trial(
        "gait"
    )  # legs and pelvis over what each joint by itself reaches: 1.83 as measured
    assert (
        MM * gait.calibrated.errors.rms(*LOWER_BODY) / gait.compute_joint_floor_mm(*LOWER_BODY)
        < 1.9
    )


@pytest.mark.slow
def test_uf3_hips_lie_near_the_regression(data_dir: Path, kept: Path) -> None:
    calibration = calibrated(kept, "uf3", data_dir)
    at = [JP_INDEX[f"hip_{side}.pelvis.{way}"] for side in "rl" for way in ("ant", "sup", "lat")]
    moved = (calibration.model.parameters.joint - calibration.nominal.parameters.joint)[at].reshape(
        2, 3
    )
    assert (MM * np.linalg.norm(moved, axis=1) < 25.0).all()


@pytest.mark.slow
def test_functional_trials_run_from_c3d(data_dir: Path, kept: Path) -> None:
    for trial in calibrated(kept, "functional_c3d", data_dir).trials:
        nominal, fitted, floor = (
            e.rms() or 0.0 for e in (trial.nominal.errors, trial.calibrated.errors, trial.floor)
        )
        assert floor < fitted < nominal


@pytest.mark.slow
def test_plug_in_gait_runs_from_c3d_to_torques(data_dir: Path, kept: Path) -> None:
    """The right foot is on plate 1; the left one's toes rest beside plate 2, which reads 0.57 body
    weights.
    """
    calibration = calibrated(kept, "pig_c3d", data_dir)
    loads = calibration.trial("gait").loads
    valid, time = loads.reactions.valid, calibration.trial("gait").body.time
    assert valid[(time > 4.22) & (time < 4.72)].all()
    assert not valid[(time > 4.80) & (time < 5.35)].any()
    check_text(calibration.notes, 2)
    vertical = loads.final.residual_force[valid, 1] / calibration.model.subject.weight
    assert np.sqrt(np.mean(vertical**2)) < 0.135  # as measured: 0.130; 0.114 with forces "matched"
