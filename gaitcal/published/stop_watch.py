"""How long the parts of a run take, by the clock."""

from __future__ import annotations

import time


class StopWatch:
    """Runs from the moment it is made."""

    def __init__(self) -> None:
        self._began = time.perf_counter()
        self.laps: dict[str, float] = {}
        """Part -> seconds, in order."""

    def lap(self, part: str) -> None:
        """A part is done, and the next one begins."""
        now = time.perf_counter()
        self.laps[part] = now - self._began
        self._began = now
