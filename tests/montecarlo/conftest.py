"""The nominal subject, made ready for draws once."""

from __future__ import annotations

import pytest

from gaitcal.montecarlo.case import MonteCarloCase, nominal_case
from gaitcal.montecarlo.context import MonteCarloContext
from gaitcal.montecarlo.settings import MonteCarloSettings


@pytest.fixture(scope="session")
def case() -> MonteCarloCase:
    return nominal_case()


@pytest.fixture(scope="session")
def context(case: MonteCarloCase) -> MonteCarloContext:
    return MonteCarloContext(case, MonteCarloSettings())
