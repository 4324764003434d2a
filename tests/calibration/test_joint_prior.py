"""What is known before a fit: of joint parameters by anatomy, of a trial's noise by what no joint can follow."""

import numpy as np
import pytest

from gaitcal.arrays import Array
from gaitcal.calibration import joint_prior
from gaitcal.calibration.joint_prior import (
    COVARIANCE,
    MEAN,
    TABLE,
    ForbiddenNoise,
    forbidden_noise,
    frames_per_sample,
    least_noise,
    prior_deviations,
    prior_of,
    trial_noises,
)
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import JOINT_OF_CHILD, Source
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, JP_TO_SI, Kind, Parameters, published_subject
from gaitcal.motion.motion import track_nodes
from gaitcal.motion.spline import spline_basis
from gaitcal.study.joint_prior import other_side
from tests.derivatives import seeded_trial

TWICE = [row for row in TABLE if len(row.parameters) == 2]


def test_it_is_a_covariance_alike_on_both_sides() -> None:
    assert np.linalg.eigvalsh(COVARIANCE / np.sqrt(np.outer(np.diag(COVARIANCE), np.diag(COVARIANCE))))[0] > 1e-3
    other = [JP_INDEX[other_side(name)] for name in JP_NAMES]
    np.testing.assert_array_equal(COVARIANCE[np.ix_(other, other)], COVARIANCE)
    mirrored = np.array([-1.0 if p.mirrored else 1.0 for p in JOINT_PARAMETERS])
    np.testing.assert_array_equal(mirrored * MEAN[other], MEAN)
    right, left = ([k for k, name in enumerate(JP_NAMES) if f"_{side}." in name] for side in "rl")
    assert not COVARIANCE[np.ix_(right, left)].any()


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.parameters[0])
def test_the_table_is_in_mm_and_degrees(row: joint_prior._Row) -> None:
    names = [name.replace(".", "_l.", 1) for name in row.parameters]
    mean, covariance = prior_of(names, None)
    unit = JP_TO_SI[JP_INDEX[names[0]]]
    mirrored = -1.0 if JOINT_PARAMETERS[JP_INDEX[names[0]]].mirrored else 1.0
    np.testing.assert_allclose(mean, mirrored * unit * row.mean)
    np.testing.assert_allclose(prior_deviations(names)[0], unit * row.deviation)
    apart = np.array([1.0, -1.0][: len(names)])
    if len(names) == 2:
        assert np.sqrt(apart @ covariance @ apart) == pytest.approx(unit * row.apart)


@pytest.mark.parametrize("row", TWICE, ids=lambda row: row.parameters[0])
def test_a_joint_seen_from_two_segments_moves_in_both_and_nothing_else_does(row: joint_prior._Row) -> None:
    """What the prior lets go together leaves the child where it was, but for a turn about its own joint."""
    names = tuple(name.replace(".", "_r.", 1) for name in row.parameters)
    body, child = published_subject(), names[1].split(".")[1] + "_r"
    step = 1e-4 if JOINT_PARAMETERS[JP_INDEX[names[0]]].kind is Kind.POSITION else 1e-3
    chain = Chain("pelvis")

    own = [e.name for e in JOINT_OF_CHILD[child].elements if e.source is Source.COORDINATE]

    def placed(parameters: Parameters, turned: str = "") -> Array:
        q = np.array([[step * (name == turned) for name in chain.coordinates]])
        return Kinematics(chain.body(parameters), q).segments[chain.segments.index(child)].ravel()

    def moved(*by: float) -> float:
        other = body.with_joint(names, body.joint[[JP_INDEX[n] for n in names]] + step * np.array(by))
        change = placed(other) - placed(body)
        turns = np.column_stack([placed(body, name) - placed(body) for name in own])
        return float(np.abs(change - turns @ np.linalg.lstsq(turns, change, rcond=None)[0]).max()) / step

    # the subtalar axis is steep: a turn of it about the talus is 1.3 times that about the foot, and dips it besides
    steep = row.parameters[0].startswith("subtalar.talus")
    assert moved(1.0, 1.0) < (row.apart / row.deviation if steep else 0.15) * moved(1.0, 0.0)
    ratio, near = (1.3, 0.05) if steep else (1.0, 0.01)
    assert moved(1.0, 0.0) == pytest.approx(ratio * moved(0.0, 1.0), rel=near)


WHITE = 0.002
"""m."""


@pytest.mark.parametrize(("kept", "expected"), [(0.0, 1.0), (0.5, 3.0), (0.9, 19.0)])
def test_frames_for_one_that_is_independent(kept: float, expected: float) -> None:
    """Errors of variance 1 that keep `kept` of the frame before: (1 + kept) / (1 - kept) frames a sample."""
    errors = np.random.default_rng(1).normal(size=(4000, 12))
    for f in range(1, len(errors)):
        errors[f] = kept * errors[f - 1] + np.sqrt(1 - kept**2) * errors[f]
    # the sum ends where the correlation falls below 0.05: at most that tail, and its sampling, are lost
    assert frames_per_sample(errors) == pytest.approx(expected, rel=0.12)
    assert frames_per_sample(0.0 * errors) == 1.0, "no error counts every frame"


def test_white_noise_is_found_as_it_is_and_clusters_that_move_together_count_more() -> None:
    segments = ("pelvis", "thigh_r")
    rng, parameters, problem, true = seeded_trial(2, segments=segments, frames=2000, nodes=60, per_segment=4)
    shape, body = problem.data.measured.shape, problem.body(parameters)

    def found(noise: Array) -> float:
        noisy = problem.with_measured(problem.data.measured + noise)
        return float(np.sqrt(forbidden_noise(noisy, parameters, track_nodes(noisy, body, true).x).variance))

    assert found(rng.normal(0, WHITE, shape)) == pytest.approx(WHITE, rel=0.15)
    # each cluster as a whole: the mean of four markers alike has four times the variance that independent ones give it
    together = np.repeat(rng.normal(0, WHITE, (2, 3, shape[2])), 4, axis=0)
    assert found(together) == pytest.approx(2.0 * WHITE, rel=0.25)


def test_parameters_use_samples_up_and_cameras_never_err_by_nothing() -> None:
    seen = [ForbiddenNoise(1e-6, 30.0), ForbiddenNoise(4e-6, 10.0)]
    np.testing.assert_allclose(trial_noises(seen, [0.0, 0.0], -2.0), [1e-3, 2e-3])
    np.testing.assert_allclose(trial_noises(seen, [0.0, 0.0], 18.0), np.sqrt(2.0) * np.array([1e-3, 2e-3]))
    assert trial_noises([ForbiddenNoise(0.0, 10.0)], [3e-4], 1.0) == [3e-4]
    time = np.arange(100) / 100.0
    assert least_noise(spline_basis(time, 8)) < least_noise(spline_basis(time / 4.0, 8))
