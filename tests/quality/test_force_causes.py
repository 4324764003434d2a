"""Each cause corrects its fault, made by independent code; whitening against a dense covariance."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gaitcal.dynamics.expected_residual import BASELINE_RESIDUAL, CORRELATION_S
from gaitcal.quality.force_causes import ForceFault, list_causes
from gaitcal.quality.force_choice import choose, fit_causes, get_reported_size, select_named
from gaitcal.quality.force_evidence import SEPARATE_S, ForceEvidence, ForceResidual
from gaitcal.quality.plate_forces import build_rotation
from tests.quality.walks import exact_walk

LEFT = 0.05
"""Of the disagreement may be left: a filter and a fault do not quite commute, and splines end."""
SIZE = 0.1
SAME = 1e-9


def faults() -> Any:
    from scripts.validation.force_faults import faults as module

    return module


def fault(name: str) -> Any:
    """A fault of all plates that is large enough to find, by the function of that name or kind."""
    module = faults()
    for make in module.FAULTS:
        for seed in range(200):
            made = make(np.random.default_rng(seed), None)
            if made.row != name:
                break
            if large_enough(made):
                return made
    raise AssertionError(name)


def large_enough(made: Any) -> bool:
    if not made.size:
        return True
    size = float(np.linalg.norm(made.size))
    bounds = {
        "clock": (0.04, 0.1),
        "place": (0.08, 0.2),
        "yaw": (0.5, 1.5),
        "tilt": (0.08, 0.2),
        "offset": (60, 90),
    }
    low, high = {**bounds, "markers tilted": (0.08, 0.15)}.get(made.row, (1.5, 2.5))
    return low < size < high or (made.row == "free moment" and size > 5)


ROWS = [
    "clock",
    "place",
    "yaw",
    "tilt",
    "markers tilted",
    "gain",
    "vertical gain",
    "horizontal gain",
    "free moment",
    "offset",
    "sign of the fore-aft force",
    "sign of the sideways force",
    "sign of the vertical force",
    "axes exchanged",
    "unit of force",
    "unit of moment",
    "unit of the centre of pressure",
    "plates exchanged",
]


@pytest.mark.parametrize("row", ROWS)
def test_cause_corrects_its_fault(row: str) -> None:
    made = fault(row)
    evidence = exact_walk().evidence(made.change)
    _, found = fit_causes(ForceResidual([evidence]))
    own = next(fit for fit in found if fit.cause.kind is made.kind and fit.cause.unit == made.unit)
    assert own.explained > 1.0 - LEFT
    if made.kind is ForceFault.FREE_MOMENT:
        assert 1.0 + own.x[0] == pytest.approx(1.0 / made.size[0], abs=0.2)
    elif made.size:
        np.testing.assert_allclose(
            get_reported_size(own), made.size, atol=SIZE * np.linalg.norm(made.size)
        )
    assert made.kind in [fit.cause.kind for fit in select_named(found)]


def test_no_cause_without_a_fault() -> None:
    assert choose([exact_walk().evidence()])[:2] == ([], [])


def test_coefficients_of_zero_change_nothing_and_linear_causes_are_linear() -> None:
    evidence = exact_walk().evidence()
    clean = evidence.compute_residual(evidence.wrenches)
    for cause in list_causes([evidence]):
        if not cause.parameters:
            continue

        def residual(x: np.ndarray, undo: Any = cause.undo) -> np.ndarray:
            undone = undo(evidence, x)
            return np.asarray(evidence.compute_residual(undone.wrenches, undone.required_wrench))

        assert np.abs(residual(np.zeros(cause.parameters)) - clean).max() < 1e-6, cause.key
        if not cause.starts:
            x = np.linspace(0.3, 0.7, cause.parameters)
            parts = sum(
                a * (residual(e) - clean) for a, e in zip(x, np.eye(cause.parameters), strict=True)
            )
            np.testing.assert_allclose(
                residual(x) - clean, parts, atol=1e-6, err_msg=str(cause.key)
            )


def test_marker_tilt_rotates_gravity_about_the_mass_centre() -> None:
    """In tilted marker axes, a body at rest on tilted plates under tilted gravity has no
    residual.
    """
    evidence = exact_walk().evidence()
    cause = next(c for c in list_causes([evidence]) if c.kind is ForceFault.MARKERS_TILTED)
    x = np.array([0.07, -0.04])
    turn = build_rotation(np.array([x[0], 0.0, x[1]]))
    required = cause.undo(evidence, x).required_wrench
    assert required is not None
    weight = np.array([0.0, evidence.weight_of_model, 0.0])
    lean = turn @ weight - weight
    force, moment = np.split(required - evidence.required_wrench, 2, axis=1)
    np.testing.assert_allclose(force, np.tile(lean, (len(required), 1)), atol=SAME)
    np.testing.assert_allclose(np.sum(moment * lean, axis=1), 0.0, atol=1e-6)
    np.testing.assert_allclose(moment, np.cross(evidence.mass_centre, lean), atol=SAME)


RELATIVE = 1e-8
"""Relative: one factor of 200 rows each."""


def some_frames(count: int) -> ForceEvidence:
    whole = exact_walk().evidence()
    chosen = np.r_[0:count, count + 5 : count + 9]  # with a gap
    return replace(whole, time=whole.time[chosen], spread=whole.spread[chosen])


def dense(trials: list[ForceEvidence]) -> np.ndarray:
    """Covariance of the residuals of all trials, row by row."""
    blocks = []
    for trial in trials:
        apart = np.abs(trial.time[:, None] - trial.time[None, :])
        piece = np.concatenate([[0], np.cumsum(np.diff(trial.time) >= SEPARATE_S)])
        memory = np.where(piece[:, None] == piece[None, :], np.exp(-apart / CORRELATION_S), 0.0)
        scale = np.diag((BASELINE_RESIDUAL * np.repeat([trial.weight, trial.bwh], 3)) ** 2)
        blocks.append(np.kron(memory, scale))
    spread = np.concatenate([t.spread.reshape(-1, t.spread.shape[2]) for t in trials])
    out = spread @ spread.T
    at = 0
    for block in blocks:
        out[at : at + len(block), at : at + len(block)] += block
        at += len(block)
    return out


def test_whitened_squares_are_those_of_the_dense_covariance() -> None:
    rng = np.random.default_rng(0)
    trials = [some_frames(8), some_frames(12)]
    residuals = [rng.normal(size=(len(t.time), 6)) * [20, 30, 10, 5, 2, 8] for t in trials]
    y = ForceResidual(trials).whiten(residuals)
    stacked = np.concatenate([r.ravel() for r in residuals])
    expected = stacked @ np.linalg.solve(dense(trials), stacked)
    np.testing.assert_allclose(y @ y, expected, rtol=RELATIVE)
    residual = ForceResidual(trials)
    np.testing.assert_allclose(residual.sum_squares(y).sum(), y @ y, rtol=RELATIVE)


def test_residual_of_inertial_errors_has_little_weight() -> None:
    trial = some_frames(12)
    usual = trial.spread[:, :, 3]
    other = np.random.default_rng(1).permutation(usual.ravel()).reshape(usual.shape)
    residual = ForceResidual([trial])
    as_inertia, as_anything = (float((y := residual.whiten([r])) @ y) for r in (usual, other))
    assert as_inertia <= 1.0 + RELATIVE  # one standard deviation of one unknown
    assert as_anything > 3.0 * as_inertia
