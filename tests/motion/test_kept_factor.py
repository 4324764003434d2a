"""A factor kept from the last steps saves work and changes nothing that matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem
from tests.derivatives import Array, perturbed_parameters, random_trial

SAME = 1e-5
"""m, rad: how near to the minimum tracking ends at its own tolerance."""
FEW = 14
"""Steps; it takes 11, and 17 with factors that are never given up."""


def noisy_trial() -> tuple[TrialProblem, object, Array]:
    rng = np.random.default_rng(30)
    parameters = perturbed_parameters(rng)
    problem, _ = random_trial(rng, parameters, frames=80, nodes=10)
    measured = problem.data.measured + rng.normal(0, 0.005, problem.data.measured.shape)
    problem = replace(problem, data=replace(problem.data, measured=measured))
    constants = problem.constants(parameters)
    return problem, constants, starting_nodes(problem.chain, constants, problem.data, problem.basis)


def test_the_last_steps_form_no_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, constants, start = noisy_trial()
    calls: list[str] = []
    for name in ("equations", "gradient"):
        plain = getattr(TrialProblem, name)
        monkeypatch.setattr(
            TrialProblem, name, lambda *a, plain=plain, name=name, **k: (calls.append(name), plain(*a, **k))[1]
        )
    kept = track_nodes(problem, constants, start)  # type: ignore[arg-type]
    with_keeping = list(calls)
    calls.clear()
    fresh = track_nodes(problem, constants, start, DescentSettings(keep_within=0.0))  # type: ignore[arg-type]
    assert with_keeping[-1] == "gradient"
    assert "gradient" not in calls
    assert with_keeping.count("equations") < calls.count("equations")
    exact = track_nodes(problem, constants, fresh.nodes, DescentSettings(gain=1e-15))  # type: ignore[arg-type]
    for found in (kept, fresh):
        assert found.converged
        np.testing.assert_allclose(found.nodes, exact.nodes, rtol=0, atol=SAME)


def test_a_kept_factor_that_no_longer_serves_is_formed_anew() -> None:
    """Kept from however far away, the end is the same: too slow a step asks for a new matrix."""
    problem, constants, start = noisy_trial()
    far = start + np.random.default_rng(31).normal(0, 0.3, start.shape)
    exact = track_nodes(problem, constants, start, DescentSettings(gain=1e-15))  # type: ignore[arg-type]
    found = track_nodes(problem, constants, far, DescentSettings(gain=1e-10, keep_within=np.inf))  # type: ignore[arg-type]
    assert found.converged
    assert found.steps < FEW
    np.testing.assert_allclose(found.nodes, exact.nodes, rtol=0, atol=SAME)
