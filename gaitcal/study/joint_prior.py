"""What is known of a person's joint parameters before any recording is looked at, where that is not the default."""

from __future__ import annotations

from gaitcal.arrays import Array
from gaitcal.records import dataclass


@dataclass(frozen=True, kw_only=True)
class JointPrior:
    """What is known of n joint parameters before any trial, in place of the default prior."""

    names: tuple[str, ...]
    mean: Array
    """(n,) m, rad: expected deviations from the nominal values."""
    covariance: Array
    """(n, n)."""
    file: str
    people: int
    left_out: int
    """People whose fold is left out because this person is among them; 0 where this person is not."""
    notes: tuple[str, ...]
    """Where it is from, in words."""
    sha256: str = ""
    """Of the file, hexadecimal."""
