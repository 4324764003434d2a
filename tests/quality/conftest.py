"""The sound study that the checks are tried on."""

import pytest

from gaitcal.study.study import Study
from tests.quality.spoilt import sound_study


@pytest.fixture(scope="session")
def sound() -> Study:
    """Standing, walking over two plates, a moving knee: nothing to find."""
    return sound_study()
