"""The walk of the built-in person: carried by the ground, for any linkage, two whole strides."""

import numpy as np
import pytest

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import FOOT_BREADTH, HEEL_RADIUS_M, SOLE_SHAPE
from gaitcal.dynamics.inverse_dynamics import Dynamics, compute_pelvis_residual
from gaitcal.dynamics.plate_outline import compute_foot_tip
from gaitcal.io.recording import find_runs
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.synthetic.subject import make_synthetic_model
from gaitcal.synthetic.synthetic_motion import (
    TrueMotion,
    compute_ground_on_feet,
    simulate_gait,
    simulate_isolated_trial,
    simulate_two_strides,
)
from gaitcal.synthetic.walk import (
    DOUBLE_SUPPORT,
    GAIT_CYCLE,
    STANCE,
    _build_ground_rows,
    _Rows,
    compute_feet,
    compute_foot_phases,
    compute_gait_curves,
    compute_nominal_curves,
    make_walking_ground,
)
from gaitcal.tracking.spline import build_spline_basis

RESIDUAL = 1e-9
"""N, N·m: rounding of some hundred N at lever arms of a metre."""
SPRINGS_M, LOADED_N = 0.008, 50.0
"""m by which a centre of pressure may move between two frames, 5 ms, where a foot bears load: a
striking heel, or an ankle over toes that leave, moves by 5 mm."""
PERTURBED_SPRINGS_M = 0.02
"""The same in the first and last loaded frame of people whose axes are turned by up to 10 deg: up
to 19 mm in 16.
"""

WALKS: dict[str, tuple[Parameters, TrueMotion]] = {}


def walk(person: str) -> tuple[Parameters, TrueMotion]:
    """The published study's person, the nominal one, or a perturbed one by its seed."""
    if person not in WALKS:
        seed = int(person) if person.isdigit() else None
        model = make_synthetic_model(np.random.default_rng(seed), perturb=seed is not None)
        motion = simulate_gait() if person == "study" else simulate_two_strides(model.parameters)
        WALKS[person] = model.parameters, motion
    return WALKS[person]


def in_the_sole(parameters: Parameters, motion: TrueMotion, centre: Array) -> BoolArray:
    """(nf, 2) centres (nf, 2, 3) m that lie on the soles, told by the heel and toe markers and by
    nothing else.
    """
    points = compute_feet(parameters, motion.q).points
    height = published_model().subject.height
    out = np.zeros((len(centre), 2), dtype=bool)
    for foot in range(2):
        heel, toe = points[:, foot, 0], points[:, foot, 1]
        line = (compute_foot_tip(heel, toe, height) - heel)[:, [0, 2]]
        length = np.linalg.norm(line, axis=1)
        forward = line / length[:, None]
        away = (centre[:, foot] - heel)[:, [0, 2]]
        along = (np.einsum("fi,fi->f", away, forward) - HEEL_RADIUS_M) / (length - HEEL_RADIUS_M)
        across = np.abs(away[:, 0] * forward[:, 1] - away[:, 1] * forward[:, 0])
        width = FOOT_BREADTH * height * np.interp(along, *SOLE_SHAPE)
        out[:, foot] = (along >= 0) & (along <= 1) & (across <= width / 2)
    return out


PEOPLE = ("study", "nominal", "1", "2", "3")


@pytest.mark.parametrize("person", PEOPLE)
def test_the_ground_carries_the_walk(person: str) -> None:
    """No residual; every loaded foot has its centre of pressure in its sole, from strike to off,
    where it rolls and does not spring.
    """
    parameters, motion = walk(person)
    ground = compute_ground_on_feet(parameters, motion)
    q, v, a = (motion.basis.evaluate(motion.coefficients, k) for k in range(3))
    residual = compute_pelvis_residual(
        q, Dynamics(parameters).compute_forces(q, v, a, ground.wrench)
    )
    assert np.abs(residual).max() < RESIDUAL
    up = ground.wrench[:, :, 1]
    loaded = up > 0
    assert loaded.any(axis=0).all() and (up >= 0).all()
    assert in_the_sole(parameters, motion, ground.centre)[loaded].all()
    force, moment = ground.wrench[..., :3][loaded], ground.wrench[..., 3:][loaded]
    centre = np.stack([moment[:, 2] / force[:, 1], -moment[:, 0] / force[:, 1]], axis=1)
    heavy = force[:, 1] > 1.0  # of less, rounding makes the quotient
    np.testing.assert_allclose(centre[heavy], ground.centre[loaded][heavy][:, [0, 2]], atol=1e-9)
    assert motion.phase is not None
    own = compute_foot_phases(motion.phase)
    assert not up[(own <= 0) | (own >= STANCE)].any()
    assert loaded[(own > 0.01) & (own < STANCE - 0.01)].all()
    assert loaded[(own[:, 0] > 0.01) & (own[:, 0] < DOUBLE_SUPPORT - 0.01)].all()
    for foot in range(2):
        for stance in find_runs(up[:, foot] > LOADED_N):
            steps = np.linalg.norm(np.diff(ground.centre[stance, foot], axis=0), axis=1)
            assert steps[1:-1].max() < SPRINGS_M
            assert steps[[0, -1]].max() < (PERTURBED_SPRINGS_M if person.isdigit() else SPRINGS_M)
            assert ground.centre[stance.stop - 1, foot, 0] > ground.centre[stance.start, foot, 0]


def test_resting_feet_do_not_slide() -> None:
    parameters, motion = walk("nominal")
    assert motion.phase is not None
    own = compute_foot_phases(motion.phase)
    points = compute_feet(parameters, motion.q).points
    for foot in range(2):
        for begin, end, point in ((0.08, 0.28, 0), (0.18, 0.46, 2)):
            for still in find_runs((own[:, foot] > begin) & (own[:, foot] < end)):
                assert np.ptp(points[still, foot, point], axis=0).max() < 0.012


def test_two_strides_have_a_whole_stride_of_each_foot() -> None:
    _, motion = walk("nominal")
    assert motion.phase is not None
    for foot in range(2):
        own = motion.phase - 0.5 * foot
        assert sum(own[0] < k < own[-1] for k in range(-3, 4)) == 2


def test_accelerations_are_those_of_the_curves() -> None:
    step = 1e-4
    phase = np.linspace(0.0, 1.0, 7)
    before, now, after = (compute_gait_curves(phase + k * step / GAIT_CYCLE)[0] for k in (-1, 0, 1))
    np.testing.assert_allclose(
        compute_gait_curves(phase)[1], (before - 2 * now + after) / step**2, rtol=1e-6, atol=1e-4
    )


def test_no_ground_no_forces() -> None:
    with pytest.raises(ValueError, match="ground of this motion"):
        compute_ground_on_feet(published_model().parameters, simulate_isolated_trial("knee_r"))


def test_slopes_are_those_of_the_residuals() -> None:
    """Central differences along random directions; the feet's rows by velocity leave out how their
    slopes turn.
    """
    parameters = make_synthetic_model(np.random.default_rng(5), perturb=True).parameters
    time = np.arange(40) / 200.0
    basis, phase = build_spline_basis(time, 12), 0.4 + time / GAIT_CYCLE
    meant = compute_nominal_curves(phase)
    coefficients, rng, size = basis.fit(meant.q), np.random.default_rng(6), 1e-6
    direction = rng.normal(size=coefficients.shape)

    def rows(at: Array) -> list[_Rows]:
        return _build_ground_rows(parameters, basis, at, make_walking_ground(phase))

    for k, (low, here, high) in enumerate(
        zip(
            rows(coefficients - size * direction),
            rows(coefficients),
            rows(coefficients + size * direction),
            strict=True,
        )
    ):
        if k == 3:  # resting points
            continue
        told = np.zeros_like(here[0])
        for order, slope in here[1].items():
            told += np.einsum("fnc,fc->fn", slope, basis.evaluate(direction, order))
        scale = np.abs(told).max()
        assert len(COORDINATES) == coefficients.shape[1] and scale > 0
        np.testing.assert_allclose((high[0] - low[0]) / (2 * size), told, atol=2e-6 * scale)
