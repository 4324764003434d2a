"""Runs that several tests look at."""

from pathlib import Path

import pytest

from gaitcal.reproduction.recovery import SeedResult, recover_noiseless, recover_noisy_draws
from tests.kept import kept_object

FEW_SEEDS = 2


@pytest.fixture(scope="session")
def clean(kept: Path) -> SeedResult:
    """Everything without noise, two random inertial seeds."""
    return kept_object(kept / "reproduction" / "clean", lambda: recover_noiseless(0, FEW_SEEDS))


@pytest.fixture(scope="session")
def draws(kept: Path) -> list[SeedResult]:
    """Two draws of the noise, each from a process of its own, two random inertial seeds each."""
    return kept_object(
        kept / "reproduction" / "draws",
        lambda: recover_noisy_draws(0, 2, jobs=2, random_seeds=FEW_SEEDS),
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whoever asks for these runs takes long, if nobody did so before."""
    for item in items:
        if Path(__file__).parent in item.path.parents and {"clean", "draws"} & {
            *getattr(item, "fixturenames", ())
        }:
            item.add_marker(pytest.mark.slow)
