"""Noise draws: the same for the same seed, whatever the number of processes or of draws."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.published.inertial_recovery import SeedResult, generators, noisy_draws
from gaitcal.published.joint_recovery import synthetic_problem
from gaitcal.published.protocol import PROBLEMS
from gaitcal.published.reproduce import draw_frame
from tests.published.conftest import FEW_SEEDS


@pytest.mark.slow
def test_processes_do_not_matter(draws: list[SeedResult]) -> None:
    again = noisy_draws(0, 2, jobs=2, random_seeds=FEW_SEEDS)
    assert draw_frame(again).equals(draw_frame(draws))
    for one, other in zip(again, draws, strict=True):
        assert np.array_equal(one.joints["full leg"].nodes, other.joints["full leg"].nodes)
        assert [r.each for r in one.random] == [r.each for r in other.random]


def test_draws_and_seeds_differ(draws: list[SeedResult]) -> None:
    assert not np.allclose(draws[0].joints["hip"].errors, draws[1].joints["hip"].errors)
    markers = [
        synthetic_problem("full leg", rng).data.measured
        for seed, draw in ((0, 0), (0, 1), (1, 0))
        for rng in generators(seed, draw)[0]
    ]
    assert len({m.tobytes() for m in markers}) == 3 * len(PROBLEMS)
    masses = [[r.each["thigh.mass"] for r in d.random] for d in draws]
    assert len({*masses[0], *masses[1]}) == 2 * FEW_SEEDS
