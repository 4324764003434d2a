"""Joint parameters before a fit: their prior by anatomy."""

import numpy as np
import pytest

from gaitcal.arrays import Array
from gaitcal.calibration import joint_prior
from gaitcal.calibration.joint_prior import (
    COVARIANCE,
    MEAN,
    TABLE,
    get_prior_deviations,
    select_prior,
)
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import JOINT_OF_CHILD, Source
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    JP_INDEX,
    JP_NAMES,
    JP_TO_SI,
    ParameterKind,
    Parameters,
    read_published_parameters,
)
from gaitcal.study.cohort_prior import name_other_side

TWICE = [row for row in TABLE if len(row.parameters) == 2]


def test_it_is_a_covariance_alike_on_both_sides() -> None:
    assert (
        np.linalg.eigvalsh(
            COVARIANCE / np.sqrt(np.outer(np.diag(COVARIANCE), np.diag(COVARIANCE)))
        )[0]
        > 1e-3
    )
    other = [JP_INDEX[name_other_side(name)] for name in JP_NAMES]
    np.testing.assert_array_equal(COVARIANCE[np.ix_(other, other)], COVARIANCE)
    mirrored = np.array([-1.0 if p.mirrored else 1.0 for p in JOINT_PARAMETERS])
    np.testing.assert_array_equal(mirrored * MEAN[other], MEAN)
    right, left = ([k for k, name in enumerate(JP_NAMES) if f"_{side}." in name] for side in "rl")
    assert not COVARIANCE[np.ix_(right, left)].any()


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.parameters[0])
def test_the_table_is_in_mm_and_degrees(row: joint_prior._Row) -> None:
    names = [name.replace(".", "_l.", 1) for name in row.parameters]
    mean, covariance = select_prior(names, None)
    unit = JP_TO_SI[JP_INDEX[names[0]]]
    mirrored = -1.0 if JOINT_PARAMETERS[JP_INDEX[names[0]]].mirrored else 1.0
    np.testing.assert_allclose(mean, mirrored * unit * row.mean)
    np.testing.assert_allclose(get_prior_deviations(names)[0], unit * row.deviation)
    apart = np.array([1.0, -1.0][: len(names)])
    if len(names) == 2:
        assert np.sqrt(apart @ covariance @ apart) == pytest.approx(unit * row.segment_difference)


@pytest.mark.parametrize("row", TWICE, ids=lambda row: row.parameters[0])
def test_a_joint_seen_from_two_segments_moves_in_both_and_nothing_else_does(
    row: joint_prior._Row,
) -> None:
    """What the prior lets go together leaves the child where it was, but for a turn about its own
    joint.
    """
    names = tuple(name.replace(".", "_r.", 1) for name in row.parameters)
    body, child = read_published_parameters(), names[1].split(".")[1] + "_r"
    step = 1e-4 if JOINT_PARAMETERS[JP_INDEX[names[0]]].kind is ParameterKind.POSITION else 1e-3
    chain = Chain("pelvis")

    own = [e.name for e in JOINT_OF_CHILD[child].elements if e.source is Source.COORDINATE]

    def placed(parameters: Parameters, turned: str = "") -> Array:
        q = np.array([[step * (name == turned) for name in chain.coordinates]])
        return Kinematics(chain.body(parameters), q).segments[chain.segments.index(child)].ravel()

    def moved(*by: float) -> float:
        other = body.with_joint(
            names, body.joint[[JP_INDEX[n] for n in names]] + step * np.array(by)
        )
        change = placed(other) - placed(body)
        turns = np.column_stack([placed(body, name) - placed(body) for name in own])
        return (
            float(np.abs(change - turns @ np.linalg.lstsq(turns, change, rcond=None)[0]).max())
            / step
        )

    # the subtalar axis is steep: a turn of it about the talus is 1.3 times that about the foot, and
    # dips it besides
    steep = row.parameters[0].startswith("subtalar.talus")
    assert moved(1.0, 1.0) < (row.segment_difference / row.deviation if steep else 0.15) * moved(
        1.0, 0.0
    )
    ratio, near = (1.3, 0.05) if steep else (1.0, 0.01)
    assert moved(1.0, 0.0) == pytest.approx(ratio * moved(0.0, 1.0), rel=near)
