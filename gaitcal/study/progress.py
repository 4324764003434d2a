"""How long work tells what it is doing: any callable that takes a line of text."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

Progress: TypeAlias = Callable[[str], None]


def silent(text: str) -> None:
    """Say nothing."""
