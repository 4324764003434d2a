"""Runs that several tests look at."""

from __future__ import annotations

import pytest

from gaitcal.reproduction.noise_seed import SeedResult, noiseless, noisy_draws

FEW_SEEDS = 2


@pytest.fixture(scope="session")
def clean() -> SeedResult:
    """Everything without noise, two random inertial seeds."""
    return noiseless(0, FEW_SEEDS)


@pytest.fixture(scope="session")
def draws() -> list[SeedResult]:
    """Two draws of the noise, two random inertial seeds each."""
    return noisy_draws(0, 2, jobs=1, random_seeds=FEW_SEEDS)
