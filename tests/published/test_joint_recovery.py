"""Phase 1 from absolute zero: exact without noise, below the true parameters' cost with noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import JP_INDEX, leg_parameters
from gaitcal.published import joint_recovery
from gaitcal.published.inertial_recovery import SeedResult
from gaitcal.published.joint_recovery import LEG, free_parameters, synthetic_problem, true_model, true_motion
from gaitcal.published.protocol import PROBLEMS

MARKER_MM = 1e-9
"""What is asked for; the paper reached 1e-8 to 2e-6."""
PARAMETER = 1e-6
"""deg, mm."""
NODES = 1e-9
"""m, rad."""


@pytest.mark.parametrize("problem", PROBLEMS)
def test_exact_without_noise(clean: SeedResult, problem: str) -> None:
    found = clean.joints[problem]
    assert found.converged
    assert found.marker_mm < MARKER_MM
    assert np.abs(found.errors).max() < PARAMETER
    assert found.nodes == pytest.approx(true_motion(problem).nodes, abs=NODES)


def test_problems_are_the_published_ones(clean: SeedResult) -> None:
    assert [len(free_parameters(p)) for p in PROBLEMS] == [6, 9, 12, 17]
    assert [len(clean.joints[p].names) for p in PROBLEMS] == [6, 9, 12, len(leg_parameters("l"))]
    for problem in PROBLEMS:
        markers = synthetic_problem(problem, None)
        assert markers.data.measured.shape == (41, 3, 208 if problem == "full leg" else 1200)
        assert (markers.basis.nodes, len(markers.chain.coordinates)) == (20, len(COORDINATES))
        assert set(np.unique(markers.data.weight)) == {1.0}


def test_everything_starts_at_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    plain = joint_recovery.step_together

    def spy(problems: Any, parameters: Any, free: Any, starts: Any, p: Any, **options: Any) -> Any:
        seen.append((starts, p))
        return plain(problems, parameters, free, starts, p, **options)

    monkeypatch.setattr(joint_recovery, "step_together", spy)
    joint_recovery.solve("full leg", synthetic_problem("full leg", None), true_model().parameters)
    (starts, p) = seen[0]
    assert p.shape == (17,) and not p.any()
    assert starts[0].shape == (20, len(COORDINATES)) and not starts[0].any()


def test_noise_moves_the_minimum_below_the_truth(draws: list[SeedResult]) -> None:
    for draw in draws:
        for problem in PROBLEMS[:3]:
            found = draw.joints[problem]
            assert found.converged
            assert found.cost < found.cost_at_truth
            assert 4.0 < found.marker_mm < 9.0
            assert found.marker_mm < found.largest_mm
            assert found.marker_mm == pytest.approx(1e3 * np.sqrt(found.cost / (41 * 1200)))


def test_gait_keeps_what_isolated_trials_found(draws: list[SeedResult]) -> None:
    joints = draws[0].joints
    leg = dict(zip(LEG, joints["full leg"].errors, strict=True))
    for problem in PROBLEMS[:3]:
        for name, error in zip(joints[problem].names, joints[problem].errors, strict=True):
            assert (leg[name] == pytest.approx(error, abs=1e-9)) == (name not in free_parameters("full leg"))


def test_the_right_leg_stays_true(draws: list[SeedResult]) -> None:
    found, truth = draws[0].joints["full leg"].parameters.joint, true_model().parameters.joint
    others = [i for name, i in JP_INDEX.items() if name not in LEG]
    assert np.array_equal(found[others], truth[others])
