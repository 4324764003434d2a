"""Inertial parameters from the pelvis residual: possible bodies, derivatives, and what a fit says
of its errors.
"""

import numpy as np
import pytest

from gaitcal.calibration.inertial_calibration import (
    ConsistentSettings,
    LogChart,
    RootEquations,
    compress_root_equations,
    fit_consistent,
)
from gaitcal.calibration.torque_errors import factor_inertial_covariance
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    IP_NAMES,
    InertialSet,
    compute_dynamic_jacobian,
    compute_dynamic_parameters,
    is_physical,
    make_full_set,
    make_symmetric_set,
    view_as_table,
)
from gaitcal.synthetic.synthetic_motion import simulate_gait
from tests.derivatives import Array, assert_derivative
from tests.messages import refuses

MODEL, MOTION = published_model(), simulate_gait()
WEIGHT, LENGTH = MODEL.subject.weight, MODEL.subject.height
SETS = pytest.mark.parametrize("which", [make_symmetric_set(), make_full_set()], ids=["36", "84"])


def loads(noise: float, seed: int) -> tuple[Array, Array]:
    """Root regressor (nf, 6, 12, 10) of a walk, and what the ground reactions must say (nf, 6),
    plus white noise of `noise` times weight in force and times weight and height in moment.
    """
    q, v, a = (MOTION.basis.evaluate(MOTION.coefficients, k) for k in range(3))
    regressor = Dynamics(MODEL.parameters).compute_root_regressor(q, v, a)
    exact = np.einsum(
        "fisk,sk->fi", regressor, compute_dynamic_parameters(MODEL.parameters.inertial)
    )
    white = np.random.default_rng(seed).normal(0.0, noise * WEIGHT, exact.shape)
    white[:, 3:] *= LENGTH
    return regressor, white - exact


def system(noise: float, seed: int) -> RootEquations:
    return compress_root_equations(*loads(noise, seed), WEIGHT, LENGTH)


@SETS
def test_consistent_inertias_are_possible_and_keep_the_mass(which: InertialSet) -> None:
    s, exact = make_symmetric_set().selection, system(0.0, 0)
    mean = s.T @ MODEL.parameters.inertial / (s * s).sum(axis=0)
    rng = np.random.default_rng(1)
    drawn = (
        MODEL.parameters.inertial + s @ (mean * rng.uniform(-0.05, 0.05, s.shape[1]))
        for _ in range(100)
    )
    start = next(inertial for inertial in drawn if is_physical(inertial).all())
    found = fit_consistent(exact, start, which)
    assert found.rms_force < exact.compute_rms(start)[0]
    assert is_physical(found.inertial).all()
    assert view_as_table(found.inertial)[:, 0].sum() == pytest.approx(
        view_as_table(start)[:, 0].sum(), abs=1e-10
    )


def test_log_chart_derivative() -> None:
    chart = LogChart(MODEL.parameters.inertial, make_symmetric_set())
    x = np.random.default_rng(2).normal(0, 0.1, chart.size)
    assert_derivative(chart.compute_jacobian(x), chart.compute_inertial, x)
    assert is_physical(chart.compute_inertial(10 * x)).all()


def test_an_impossible_seed_is_refused() -> None:
    bad = MODEL.parameters.inertial.copy()
    bad[4] = -1.0
    with refuses(ValueError):
        LogChart(bad, make_symmetric_set())


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_residuals_are_weighed_against_the_noise_that_the_fit_leaves(noise: float) -> None:
    """Its standard deviation in each of the six components of a frame, of which one in
    `independent` counts.
    """
    settings = ConsistentSettings()
    found = fit_consistent(
        system(noise, 61), MODEL.parameters.inertial, make_symmetric_set(), settings
    )
    scale = np.repeat([1.0 / WEIGHT, 1.0 / (WEIGHT * LENGTH)], 3)
    by_inertial = np.einsum(
        "i,fisd,sdk->fisk", scale, loads(noise, 61)[0], compute_dynamic_jacobian(found.inertial)
    )
    plain = by_inertial.reshape(-1, len(IP_NAMES)) @ found.jacobian
    weight = np.linalg.norm(found.residual_jacobian[: -len(found.names)]) / np.linalg.norm(plain)
    deviation = 1.0 / (weight * np.sqrt(settings.independent))
    # 1248 samples know it to 2 %; the parameters fitted take up less than that
    assert deviation == pytest.approx(noise, rel=0.05)


@SETS
def test_the_spread_of_the_inertial_parameters_is_the_inverse_of_what_the_fit_knows(
    which: InertialSet,
) -> None:
    """R R^T = (d IP / d x) (A^T A)^-1 (d IP / d x)^T, A the Jacobian of residuals and penalties."""
    found = fit_consistent(system(0.02, 62), MODEL.parameters.inertial, which)
    a = found.residual_jacobian
    covariance = found.jacobian @ np.linalg.solve(a.T @ a, found.jacobian.T)
    root = factor_inertial_covariance(found)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    np.testing.assert_allclose(
        (root @ root.T) / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-9
    )
