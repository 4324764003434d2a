"""A result against the truth that its study names: in numbers, files, summary, page and words; or
in none of them.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.result import Calibration
from gaitcal.analysis.truth_comparison import (
    compare_with_truth,
    describe_settings,
    find_two_marker_segments,
    summarise_errors,
)
from gaitcal.analysis.truth_errors import TruthErrors
from gaitcal.dynamics.ground_reactions import get_leg
from gaitcal.errors import Code
from gaitcal.io.csv_recordings import write_markers_csv
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import IP_NAMES, JP_NAMES
from gaitcal.report.page.page_data import build_calibration_page_data
from gaitcal.results.summary import summarise_calibration, write_truth
from gaitcal.results.table_files import format_json
from gaitcal.study.declared_truth import TrueCurves
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role
from gaitcal.synthetic.synthetic_motion import WALK_NODES
from tests.kept import copied_person, kept_person
from tests.messages import check_text, refuses
from tests.report.page.walked_blocks import page_words

pytestmark = pytest.mark.slow

SAME_ANGLE, SAME_PLACE = 0.05, 0.4
"""deg, mm: a C3D's 32-bit millimetres, and priors that pull, as noise is never taken for zero; the
documented 0.05 deg of leg angles are RMS."""
SAME_ANKLE = 0.06
"""deg, of a walk alone: what an ankle does and what skin over the shank does with it are nearly
one.
"""
SAME_TORQUE = 1.0
"""N·m: nominal masses are off by up to 10 %."""
DIGITS = {"rtol": 1e-9, "atol": 1e-12}


def of_walk_alone(kept: Path, **options: Any) -> Calibration:
    """Noiseless; the walk alone, which is quick."""
    study = Study.load(kept_person(kept, **options))
    return calibrate(
        replace(study, trials=tuple(t for t in study.trials if t.role is not Role.JOINT))
    )


@pytest.fixture(scope="module")
def known(kept: Path) -> Calibration:
    """Its nominal model is the truth, but for the digits in which the published subject
    is printed.
    """
    return of_walk_alone(kept)


def errors(calibration: Calibration) -> TruthErrors:
    return calibration.truth


def test_a_noiseless_walk_has_the_true_angles_and_moments(known: Calibration) -> None:
    walk = errors(known).get_curves("gait")
    legs = {name: curve for name, curve in walk.coordinates.items() if get_leg(name)}
    assert set(legs) == {name for name in COORDINATES if get_leg(name)}
    for name, curve in legs.items():
        assert curve.rms < (SAME_ANKLE if name.startswith("ankle") else SAME_ANGLE), name
        assert np.ptp(curve.truth) > 1.0, name
    for name, curve in walk.forces.items():
        if get_leg(name):
            assert curve.rms < SAME_TORQUE, name
            assert curve.compared.sum() == known.trial("gait").loads.reactions.valid_for(name).sum()


def test_noiseless_trials_of_all_joints_find_a_wrong_persons_truth(kept: Path) -> None:
    """Joints 10 mm and 10 deg off, and segments whose true axes are others than those of the static
    trial.
    """
    study = Study.load(kept_person(kept, seed=3, perturb=True, whole=True))
    exact = study.settings.model_copy(update={"nodes": WALK_NODES})  # the spline space of the truth
    truth = errors(calibrate(replace(study, settings=exact)))
    assert len(truth.features) == 12
    for feature in truth.features:
        assert feature.fitted < SAME_PLACE < 1.0 < feature.nominal, (feature.joint, feature.part)
        assert all(feature.within)
    for name, curve in truth.get_curves("gait").coordinates.items():
        if get_leg(name):
            assert curve.rms < 0.06 < 0.2 < curve.nominal_rms, (
                name
            )  # as the reference says of synthesize
    for name, curve in truth.get_curves("gait").forces.items():
        if get_leg(name):
            assert curve.rms < SAME_TORQUE, name
            assert curve.share_within > 0.95, name


def test_files_hold_the_truth_at_the_frames_of_the_result(
    known: Calibration, tmp_path: Path
) -> None:
    truth = errors(known)
    write_truth(truth, tmp_path)
    assert {p.name for p in (tmp_path / "truth").iterdir()} == {
        "parameters.csv",
        "gait_motion.csv",
        "gait_moments.csv",
    }
    motion = pd.read_csv(tmp_path / "truth/gait_motion.csv", comment="#")
    body, study = known.trial("gait").body, known.study
    np.testing.assert_allclose(motion["time"], body.time)
    true = np.rad2deg(study.truth.motions["gait"].values["hip_flexion_r"])
    np.testing.assert_allclose(motion["hip_flexion_r"], true, **DIGITS)
    found = np.rad2deg(body.q[:, body.coordinates.index("hip_flexion_r")])
    np.testing.assert_allclose(motion["hip_flexion_r_error"], found - true, rtol=1e-6, atol=1e-9)
    moments = pd.read_csv(tmp_path / "truth/gait_moments.csv", comment="#")
    loads = known.trial("gait").loads
    valid = loads.reactions.valid_for("knee_adduction_l")
    assert 0 < valid.sum() < len(valid)
    np.testing.assert_array_equal(moments["knee_adduction_l_error"].notna(), valid)
    assert moments["knee_adduction_l"].notna().all()
    table = pd.read_csv(tmp_path / "truth/parameters.csv", comment="#").set_index("name")
    assert len(table) == len(JP_NAMES) + len(IP_NAMES)
    np.testing.assert_allclose(table["error"], table["fitted"] - table["truth"])
    with_bars = table[table["standard_error"] > 0]
    np.testing.assert_allclose(with_bars["z"], with_bars["error"] / with_bars["standard_error"])


def test_summary_has_every_curve_and_fitted_parameter(known: Calibration) -> None:
    told = json.loads(format_json(summarise_calibration(known)))["truth"]
    truth = errors(known)
    assert set(told["parameters"]) == {p.name for p in truth.parameters if p.status == "fitted"}
    hip = truth.get_curves("gait").coordinates["hip_flexion_r"]
    assert told["trials"]["gait"]["coordinates"]["hip_flexion_r"] == {
        "rms_error": pytest.approx(hip.rms, abs=1e-6),
        "nominal_rms_error": pytest.approx(hip.nominal_rms, abs=1e-6),
        "share_within": pytest.approx(hip.share_within, abs=1e-6),
    }


def test_the_page_draws_and_tells_it(known: Calibration) -> None:
    page = page_words(known)
    assert "How near the truth" in page
    for total in summarise_errors(known, errors(known)):
        assert total.label in page
    gait = next(
        trial for trial in build_calibration_page_data(known)["trials"] if trial["name"] == "gait"
    )
    drawn = {
        (curve["base"], curve["side"], curve["kind"])
        for curve in gait["curves"]
        if curve["truth"] is not None
    }
    assert {("knee_angle", "r", "angle"), ("knee_adduction", "l", "moment")} <= drawn


def test_without_truth_nothing_of_it_is_there(known: Calibration, tmp_path: Path) -> None:
    unknown = replace(known, truth=None)
    page = page_words(unknown)
    assert "truth" not in page.lower().replace("truth.csv", "").replace("truth/", "")
    assert "truth" not in summarise_calibration(unknown)
    write_truth(unknown.truth, tmp_path)
    assert not list(tmp_path.iterdir())


def test_other_frames_are_not_compared(known: Calibration) -> None:
    """Settings that were changed after the study was read."""
    settings = known.study.settings.model_copy(update={"hip_centre": "bell"})
    changed = compare_with_truth(
        replace(known, study=replace(known.study, settings=settings), truth=None)
    )
    assert changed.truth is None
    check_text(changed.notes[-1], "truth.hip_centre", "harrington", "bell")


def test_another_static_trial_is_not_compared(
    known: Calibration, kept: Path, tmp_path: Path
) -> None:
    """Refused where the study is read, noted where it was changed afterwards; the same in another
    format is not.
    """
    study = known.study
    file = copied_person(kept, tmp_path / "study")
    write_markers_csv(file.parent / "static.csv", study.static.recording)
    as_csv = file.read_text(encoding="utf-8").replace("static.c3d", "static.csv")
    file.write_text(as_csv, encoding="utf-8")
    assert Study.load(file).truth is not None
    markers = study.static.recording.markers.copy()
    markers[:, study.static.recording.labels.index("R.Heel")] += [0.0, 0.0, 0.005]
    other = replace(study.static.recording, markers=markers)
    write_markers_csv(file.parent / "static.csv", other)
    with refuses(Code.TRUTH, 5.0, field="truth.landmarks", source="study.toml"):
        Study.load(file)
    trials = tuple(replace(t, recording=other) if t is study.static else t for t in study.trials)
    changed = compare_with_truth(replace(known, study=replace(study, trials=trials), truth=None))
    assert changed.truth is None
    check_text(changed.notes[-1], "truth.landmarks")


def test_true_curves_of_other_times(known: Calibration) -> None:
    """None of the frames: no curve, and the page says why. Some of them: the page says how many."""
    truth = known.study.truth

    def compared(**changes: TrueCurves) -> Calibration:
        motions = {"gait": changes.get("motion", truth.motions["gait"])}
        moments = {"gait": changes.get("moments", truth.moments["gait"])}
        own = replace(truth, motions=motions, moments=moments)
        return compare_with_truth(replace(known, study=replace(known.study, truth=own), truth=None))

    def later(curves: TrueCurves, seconds: float) -> TrueCurves:
        return replace(curves, time=curves.time + seconds)

    shifted = compared(
        motion=later(truth.motions["gait"], 10.0), moments=later(truth.moments["gait"], 10.0)
    )
    assert not errors(shifted).trials
    check_text(shifted.notes[-1])
    assert "Not compared: gait: its true curves (motion, 10.00 to" in page_words(shifted)
    half = compared(
        motion=later(truth.motions["gait"], 0.5), moments=later(truth.moments["gait"], 10.0)
    )
    assert not errors(half).get_curves("gait").forces
    page = page_words(half)
    assert re.search(r"RMS error over 3\d\d of 415 frames, those of the true curves", page)
    assert "RMS error over all 415 frames" in page_words(known)
    unknown = replace(truth, motions={}, moments=truth.moments | {"run": truth.moments["gait"]})
    del unknown.moments["gait"]
    none = compare_with_truth(replace(known, study=replace(known.study, truth=unknown), truth=None))
    assert list(errors(none).not_compared) == ["gait"]
    check_text(errors(none).not_compared["gait"])


def test_sums_tell_legs_from_arms_and_count_what_is_undetermined(known: Calibration) -> None:
    truth = errors(known)
    joints = {s.label: s for s in summarise_errors(known, truth) if s.label.startswith("joint")}
    assert len(joints) == 6
    sought = [p for p in truth.parameters if p.kind.startswith("joint") and p.status != "fixed"]
    assert sum(s.count for s in joints.values()) == len(sought)
    unknown = [p for p in sought if p.status == "unidentifiable"]
    assert unknown and sum(s.undetermined for s in joints.values()) == len(unknown)
    legs = [
        p
        for p in sought
        if p.kind == "joint position" and re.match("hip|knee|talocrural|subtalar", p.name)
    ]
    assert joints["joint positions, legs"].count == len(legs)
    assert joints["joint positions, legs"].fitted == pytest.approx(
        np.sqrt(np.mean([p.error**2 for p in legs]))
    )
    assert find_two_marker_segments(known) == (
        "upper_arm_r",
        "forearm_hand_r",
        "upper_arm_l",
        "forearm_hand_l",
    )
    page = page_words(known)
    assert "Two markers track upper arm r" in page
    settings = describe_settings(known)
    check_text(settings, "force_filter_hz: none")
    assert settings in page and "nodes" not in settings
