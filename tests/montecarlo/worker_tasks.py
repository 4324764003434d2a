"""What worker processes are given in tests: functions that a fresh process can import."""

import os
import signal
from pathlib import Path


def square(number: int) -> int:
    return number * number


def process(number: int) -> int:
    return os.getpid()


def killed_once(place: Path) -> str:
    """Dies as by the system's hand the first time, and works the second."""
    if not place.exists():
        place.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return place.name


def killed_always(number: int) -> int:
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number
