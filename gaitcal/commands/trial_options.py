"""The options of a further trial, written on the command line as in a study file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, cast, get_args

from gaitcal.errors import UsageError
from gaitcal.study.study_file import Side


def plates_of(text: str | None) -> dict[str, Side]:
    """`1=r,2=l` -> plate and foot.

    Raises
    ------
    UsageError
        Names the option, what was found and what is allowed; as the other functions here.
    """
    out: dict[str, Side] = {}
    for part in [] if text is None else text.split(","):
        name, equals, side = (word.strip() for word in part.rpartition("="))
        if not name or not equals or side not in get_args(Side) or name in out:
            allowed = "plate=foot, each plate once, the foot r, l or none, such as 1=r,2=l"
            raise UsageError(f"found '{part.strip()}'; allowed: {allowed}", field="--plates")
        out[name] = cast(Side, side)
    return out


def time_of(text: str | None) -> tuple[float, float] | None:
    """`0.4,1.6` -> start and end in s."""
    if text is None:
        return None
    numbers = [_number(part) for part in text.split(",")]
    if len(numbers) == 2 and numbers[0] is not None and numbers[1] is not None and numbers[0] < numbers[1]:
        return numbers[0], numbers[1]
    raise UsageError(f"found '{text}'; allowed: two increasing numbers, start,end in seconds", field="--time")


def filter_of(text: str | None) -> float | Literal["none"] | None:
    """`6` or `none` -> cut-off in Hz; None: as in the calibration."""
    if text is None or text == "none":
        return cast(Literal["none"] | None, text)
    number = _number(text)
    if number is None or number <= 0:
        raise UsageError(f"found '{text}'; allowed: a number above 0, or none", field="--filter-hz")
    return number


def only_for_one(options: Mapping[str, object], trials: int) -> None:
    """Refuse options that say something of one recording where there are several."""
    for name, value in options.items():
        if value is not None and trials != 1:
            raise UsageError(f"found {trials} trials; allowed: one, of which it speaks", field=name)


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < 1e9 else None  # neither infinite nor NaN
