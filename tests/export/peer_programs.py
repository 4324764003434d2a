"""The other programs that results are compared with (extra `peers`). Without them tests skip; in CI
they fail.
"""

import importlib
import os
import sys
from typing import Any

import pytest

NO_WHEEL = {"opensim": (3, 11)}
"""Program -> first Python for which pyproject.toml asks for it; before, there is no wheel, and CI
cannot have it.
"""


def peer(name: str) -> Any:
    """The module of that name."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        reason = f"no {name} here ({error}); it comes with the extra `peers`"
        if os.environ.get("CI") and sys.version_info >= NO_WHEEL.get(name, (3, 10)):
            pytest.fail(f"{reason}; with CI set it must be there", pytrace=False)
        pytest.skip(reason)
