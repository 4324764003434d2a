"""One difference between two sessions, with its error bar, and the tables of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pandas as pd

from gaitcal.compare.difference_error import MDC
from gaitcal.model.linkage import LEG_JOINTS


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A figure in both sessions; in `unit`, as all that follows it."""

    kind: str
    """angle, moment, power, force, spatiotemporal, joint position, joint orientation."""
    side: str
    """`r`, `l`; empty for what belongs to neither leg."""
    name: str
    """Variable of `cycles.csv` or `spatiotemporal.csv`, or joint parameter."""
    measure: str
    """Which figure of a curve: `largest in swing`, `range`; `mean` of a measure of strides; empty for a parameter."""
    unit: str
    a: float
    b: float
    se_strides: float
    """Standard error by how strides differ; NaN where nothing tells it, 0 where it has no part."""
    se_shared: float
    """By errors that all strides of a session share, as far as they do not cancel."""
    strides_a: int
    strides_b: int

    @property
    def difference(self) -> float:
        """From A to B."""
        return self.b - self.a

    @property
    def se(self) -> float:
        """Of the difference; without the strides' part where that is not known."""
        known = self.se_strides if self.spread_known else 0.0
        return float((known**2 + self.se_shared**2) ** 0.5)

    @property
    def mdc95(self) -> float:
        """The minimal detectable change: what these recordings could miss."""
        return MDC * self.se

    @property
    def spread_known(self) -> bool:
        """Whether anything tells how strides vary."""
        return self.se_strides == self.se_strides

    @property
    def times(self) -> float:
        """How many times the minimal detectable change it is; 0 where there is no difference."""
        if self.difference == 0.0:
            return 0.0
        return abs(self.difference) / self.mdc95 if self.mdc95 > 0.0 else float("inf")

    @property
    def beyond_legs(self) -> bool:
        """Whether it is a joint parameter of trunk or arms, whose error bars know nothing of a spine that bends."""
        return self.kind.startswith("joint") and not self.name.startswith(LEG_JOINTS)

    @property
    def exceeds(self) -> bool:
        """Whether it is more than the recordings could miss; never where nobody knows how strides vary."""
        return self.spread_known and self.times > 1.0


COLUMNS = (
    *("kind", "side", "name", "measure", "unit", "a", "b", "difference", "se", "mdc95", "times", "exceeds"),
    *("se_strides", "se_shared", "strides_a", "strides_b"),
)
DIFFERENCES_HEADER = (
    "differences between two sessions of one person, b - a; the largest against what could be missed come first",
    "se: standard error of the difference, by how strides vary (se_strides; Student's t for few strides; empty where",
    "each session has one stride: such a difference never counts as exceeding) and by errors that all strides of a",
    "session share, as far as they are not the same in both sessions (se_shared)",
    "mdc95: minimal detectable change, 1.96 se; times: |difference| / mdc95; exceeds: 1 where that is above 1",
    "joint parameters: each session's in its own segment frames, which new markers place anew",
)
"""Comment lines of `differences.csv`."""
DIGITS = 6


def ranked(differences: Iterable[Difference]) -> tuple[Difference, ...]:
    """Those that exceed first, of the legs and of curves before trunk and arms; what nobody can judge last."""
    return tuple(
        sorted(differences, key=lambda d: (not d.exceeds or d.beyond_legs, not d.exceeds, not d.spread_known, -d.times))
    )


def difference_table(differences: Iterable[Difference]) -> pd.DataFrame:
    """`differences.csv`: one row each, with `COLUMNS`."""
    rows = [{name: getattr(d, name) for name in COLUMNS} for d in differences]
    table = pd.DataFrame(rows, columns=list(COLUMNS)).astype({"exceeds": int})
    numbers = ["a", "b", "difference", "se", "mdc95", "times", "se_strides", "se_shared"]
    return table.astype(dict.fromkeys(numbers, float)).round(dict.fromkeys(numbers, DIGITS))
