"""The nominal subject, made ready for draws once."""

from __future__ import annotations

import pytest

from gaitcal.study.monte_carlo.case import MonteCarloCase, nominal_case
from gaitcal.study.monte_carlo.context import MonteCarloContext
from gaitcal.study.monte_carlo.settings import MonteCarloSettings


@pytest.fixture(scope="session")
def case() -> MonteCarloCase:
    return nominal_case()


@pytest.fixture(scope="session")
def context(case: MonteCarloCase) -> MonteCarloContext:
    return MonteCarloContext(case, MonteCarloSettings())
