"""Fixtures for every test."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# A busy machine may take ten times as long for one example: time is judged by the benchmarks, not here.
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")


@pytest.fixture(autouse=True)
def _nobody_is_quiet() -> None:
    """A command that was asked to be quiet in this process, in an earlier test or a fixture, quiets no test."""
    logging.getLogger("gaitcal").setLevel(logging.NOTSET)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real recordings that GAITCAL_DATA names. Without it tests skip; in CI they fail."""
    named = os.environ.get("GAITCAL_DATA")
    if named and Path(named).is_dir():
        return Path(named)
    reason = f"GAITCAL_DATA is {named!r}, no folder" if named else "GAITCAL_DATA is not set"
    if os.environ.get("CI"):
        pytest.fail(f"{reason}; with CI set the real recordings must be there", pytrace=False)
    pytest.skip(f"{reason}: no real recordings to test with")
