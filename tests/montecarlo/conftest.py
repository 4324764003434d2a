"""Runs that several tests look at."""

import pytest

from gaitcal.montecarlo.case import MonteCarloCase, make_nominal_case
from gaitcal.montecarlo.draw import MonteCarloContext
from gaitcal.montecarlo.protocol import MonteCarloSettings


@pytest.fixture(scope="session")
def case() -> MonteCarloCase:
    return make_nominal_case()


@pytest.fixture(scope="session")
def context(case: MonteCarloCase) -> MonteCarloContext:
    return MonteCarloContext(case, MonteCarloSettings())
