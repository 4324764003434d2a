"""Ankle angles stay counted from the static posture whatever a fit does to the ankle's axes;
relative angles.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.trial_result import (
    compute_static_angles,
    shift_coefficients,
    zero_ankle_angles,
)
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.results.trial_tables import format_relative_header
from gaitcal.study.settings import CalibrationSettings
from tests.fake_result import fake_calibration
from tests.messages import check_text
from tests.model.people import published_static
from tests.quality.spoilt import moved, sound_study, with_trial

ROUNDING = 1e-9
"""rad, m: of positions of a metre."""
TRACKED = 1e-6
"""rad: where tracking stops."""
STRAY_DEG = 1.0
"""What a marker less, or one rebuilt from the walk, makes of an ankle."""
ANKLES = ("ankle_angle_r", "subtalar_angle_r", "ankle_angle_l", "subtalar_angle_l")
TURNED = {
    "talocrural_r.shank.front": 15.0,
    "talocrural_l.shank.trans": -12.0,
    "subtalar_r.foot.trans": 8.0,
    "subtalar_l.foot.sag": -14.0,
}
"""deg."""


def turned(parameters: Parameters) -> Parameters:
    names = tuple(TURNED)
    values = parameters.joint[[JP_INDEX[n] for n in names]] + np.deg2rad(list(TURNED.values()))
    return parameters.with_joint(names, values)


def places(parameters: Parameters, q: np.ndarray) -> np.ndarray:
    """Axes and origins of all segments at coordinates (nf, 27)."""
    chain = Chain()
    body = chain.body(parameters)
    placed = Kinematics(body, q, columns=False)
    axes, origins = placed.axes, placed.origins
    return np.concatenate([axes.ravel(), origins.ravel()])


def test_ankles_keep_their_angle_in_the_static_posture() -> None:
    model, static = published_model(static_only=True), published_static()
    fitted = turned(model.parameters)
    wrong = compute_static_angles(model, fitted, static)
    assert max(abs(np.rad2deg(wrong[name])) for name in ANKLES) > 3.0
    counted = zero_ankle_angles(model, fitted, static)
    settled = counted.parameters
    now, nominal = (
        compute_static_angles(model, settled, static),
        compute_static_angles(model, model.nominal, static),
    )
    assert [now[name] for name in ANKLES] == pytest.approx(
        [nominal[name] for name in ANKLES], abs=TRACKED
    )
    assert counted.static_angles == pytest.approx(now, abs=TRACKED)
    np.testing.assert_array_equal(settled.joint, fitted.joint)


def test_nothing_moves_when_the_zero_does() -> None:
    """Any motion, its coordinates shifted as the function says, puts every segment where it was."""
    model = published_model(static_only=True)
    fitted = turned(model.parameters)
    counted = zero_ankle_angles(model, fitted, published_static())
    settled, moved = counted.parameters, counted.offsets
    q = np.random.default_rng(1).uniform(-0.7, 0.7, (5, len(COORDINATES)))
    after = shift_coefficients(q, COORDINATES, moved)
    assert np.abs(after - q).max() > np.deg2rad(3.0)
    np.testing.assert_allclose(places(settled, after), places(fitted, q), atol=ROUNDING)


@pytest.mark.slow
def test_a_marker_metres_away_in_the_static_trial_turns_no_ankle() -> None:
    """The zero of the ankles is counted from the same static trial as the model, without its stray
    marker.
    """
    sound = sound_study()
    walk = tuple(t for t in sound.trials if t.name in ("static", "walk"))
    sound = replace(sound, trials=walk, settings=CalibrationSettings(ip="none"))
    away = with_trial(sound, "static", moved("L.Heel", lambda x: x + [3.0, 0.0, 1.0]))
    clean, spoilt = (calibrate(study, checked=()) for study in (sound, away))
    for name in ANKLES:
        assert (
            np.rad2deg(abs(spoilt.static_angles[name] - clean.static_angles[name])) < STRAY_DEG
        ), name
        means = [
            t.body.q[:, t.body.coordinates.index(name)].mean()
            for t in (clean.trials[0], spoilt.trials[0])
        ]
        assert np.rad2deg(abs(means[1] - means[0])) < STRAY_DEG, name


@pytest.mark.slow
def test_the_published_protocol_keeps_the_zero_of_its_nominal_model() -> None:
    """Unless the study says what the ankle's zero is."""
    sound = sound_study()
    walk = tuple(t for t in sound.trials if t.name in ("static", "walk"))
    moves = {}
    for name, settings in {
        "published": CalibrationSettings(protocol="published", ip="none"),
        "said": CalibrationSettings(protocol="published", ip="none", ankle_zero="markers"),
    }.items():
        found = calibrate(replace(sound, trials=walk, settings=settings), checked=())
        moves[name] = np.abs(
            found.model.parameters.zero_angles - found.nominal.parameters.zero_angles
        ).max()
    assert moves["published"] == 0.0 < moves["said"]


def test_relative_angles_are_those_of_the_static_trial_taken_off() -> None:
    trial = fake_calibration().trials[0]
    static = {name: 0.01 * (k + 1) for k, name in enumerate(COORDINATES)}
    plain, relative = trial.body.columns(), trial.body.columns(relative_to=static)
    names = ("hip_flexion_r", "ankle_angle_l", "lumbar_bending")
    off = np.column_stack([plain[name] - relative[name] for name in names])
    wanted = [np.rad2deg(static[name]) for name in names]
    np.testing.assert_allclose(off, np.broadcast_to(wanted, off.shape), atol=ROUNDING)
    same = [
        c for c in plain if c.startswith("pelvis") or c.endswith(("_velocity", "_acceleration"))
    ]
    assert all(np.array_equal(plain[name], relative[name]) for name in same)
    _, listed = format_relative_header(static)
    assert "pelvis" not in listed
    check_text(listed, "hip_flexion_r", f"{wanted[0]:.2f}")
