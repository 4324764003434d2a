"""Long recordings: one normal matrix at a time, in place, with the same result."""

from __future__ import annotations

import weakref

import numpy as np
import pytest

from gaitcal.motion import track
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem
from scripts.tools.benchmark import memory
from tests.derivatives import perturbed_parameters, random_trial

SLOPE_GIB = 0.3
"""Growth from 5 000 to 20 000 frames; 0.18 GiB are needed. Ten times that is what 1.5 GiB leave for 100 000 frames."""


@pytest.mark.parametrize("first_damping", [0.0, 1e-3])
def test_large_matrices_are_factored_in_place(monkeypatch: pytest.MonkeyPatch, first_damping: float) -> None:
    rng = np.random.default_rng(6)
    parameters = perturbed_parameters(rng)
    problem, true = random_trial(rng, parameters)
    constants = problem.constants(parameters)
    settings = DescentSettings(first_damping=first_damping)
    start = true + rng.normal(0, 0.3, true.shape)  # far enough off that some steps are refused
    plain = track_nodes(problem, constants, start, settings)
    monkeypatch.setattr(track, "LARGE_BYTES", 0)
    lean = track_nodes(problem, constants, start, settings)
    assert (lean.steps, lean.converged) == (plain.steps, plain.converged)
    np.testing.assert_allclose(lean.nodes, plain.nodes, rtol=0, atol=1e-9)
    assert lean.cost == pytest.approx(plain.cost, rel=1e-6, abs=1e-18)


def test_no_factor_is_held_while_the_next_matrix_is_formed(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    parameters = perturbed_parameters(rng)
    problem, true = random_trial(rng, parameters)
    constants, alive = problem.constants(parameters), weakref.WeakSet[BandFactor]()
    made, formed = BandFactor.__init__, TrialProblem.equations
    held: list[int] = []
    monkeypatch.setattr(BandFactor, "__init__", lambda self, *a, **k: (alive.add(self), made(self, *a, **k))[1])
    monkeypatch.setattr(TrialProblem, "equations", lambda *a, **k: (held.append(len(alive)), formed(*a, **k))[1])
    monkeypatch.setattr(track, "LARGE_BYTES", 0)
    track_nodes(problem, constants, true + rng.normal(0, 0.3, true.shape), DescentSettings(keep_within=0.0))
    assert len(held) > 2
    assert not any(held)


@pytest.mark.slow
def test_memory_of_a_long_recording() -> None:
    short, long = (memory.usage(frames, 100.0) for frames in (5_000, 20_000))
    assert long.rms_mm < 2.5
    assert long.peak_gib - short.peak_gib < SLOPE_GIB
    assert long.peak_gib < 0.8
