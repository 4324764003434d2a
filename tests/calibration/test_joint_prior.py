"""What anatomy expects of joint parameters: a covariance, mirrored sides, one bone end seen from two segments."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.calibration import joint_prior
from gaitcal.calibration.joint_prior import COVARIANCE, MEAN, TABLE, prior_deviations, prior_of
from gaitcal.model.chain import Chain
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, JP_TO_SI, Kind
from gaitcal.model.kinematics import forward, segment_transforms
from gaitcal.model.parameters import published_subject
from gaitcal.study.people_design import other_side

TWICE = [row.parameters for row in TABLE if len(row.parameters) == 2]


def test_it_is_a_covariance_alike_on_both_sides() -> None:
    assert np.linalg.eigvalsh(COVARIANCE / np.sqrt(np.outer(np.diag(COVARIANCE), np.diag(COVARIANCE))))[0] > 1e-3
    other = [JP_INDEX[other_side(name)] for name in JP_NAMES]
    np.testing.assert_array_equal(COVARIANCE[np.ix_(other, other)], COVARIANCE)
    np.testing.assert_array_equal(MEAN[other], MEAN)
    right, left = ([k for k, name in enumerate(JP_NAMES) if f"_{side}." in name] for side in "rl")
    assert not COVARIANCE[np.ix_(right, left)].any()
    assert not any(JOINT_PARAMETERS[JP_INDEX[name]].mirrored and MEAN[JP_INDEX[name]] for name in JP_NAMES)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.parameters[0])
def test_the_table_is_in_mm_and_degrees(row: joint_prior._Row) -> None:
    names = [name.replace(".", "_l.", 1) for name in row.parameters]
    mean, covariance = prior_of(names, None)
    unit = JP_TO_SI[JP_INDEX[names[0]]]
    np.testing.assert_allclose(mean, unit * row.mean)
    np.testing.assert_allclose(prior_deviations(names)[0], unit * row.deviation)
    apart = np.array([1.0, -1.0][: len(names)])
    if len(names) == 2:
        assert np.sqrt(apart @ covariance @ apart) == pytest.approx(unit * row.apart)


@pytest.mark.parametrize("pair", TWICE, ids=lambda pair: pair[0])
def test_a_joint_seen_from_two_segments_moves_in_both_and_nothing_else_does(pair: tuple[str, str]) -> None:
    """What the prior lets go together, the same number in parent and child, leaves the child where it was."""
    names = tuple(name.replace(".", "_r.", 1) for name in pair)
    body, child = published_subject(), names[1].split(".")[1] + "_r"
    step = 1e-4 if JOINT_PARAMETERS[JP_INDEX[names[0]]].kind is Kind.POSITION else 1e-3
    chain = Chain("pelvis")

    def moved(*by: float) -> float:
        other = body.with_joint(names, body.joint[[JP_INDEX[n] for n in names]] + step * np.array(by))
        places = []
        for parameters in (body, other):
            constants = chain.constants(parameters.joint, parameters.zero_angles)
            poses = forward(chain, constants, np.zeros((1, len(chain.coordinates))))
            places.append(segment_transforms(chain, constants, poses)[chain.segments.index(child)])
        return float(np.abs(places[1] - places[0]).max()) / step

    assert moved(1.0, 1.0) < 0.15 * moved(1.0, 0.0)
    assert moved(1.0, 0.0) == pytest.approx(moved(0.0, 1.0), rel=0.01)
