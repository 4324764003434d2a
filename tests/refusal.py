"""How an input is refused: in one line."""

from collections.abc import Callable
from typing import Any

import pytest

from gaitcal.errors import InputError


def refusal(function: Callable[..., object], *words: Any, **options: Any) -> str:
    """The one line with which the function refuses what it is given."""
    with pytest.raises(InputError) as caught:
        function(*words, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)
