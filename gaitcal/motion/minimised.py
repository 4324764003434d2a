"""What `descend` minimises: a sum of squares that tells its cost and gradient at a point, and, for more, its matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

from gaitcal.arrays import Array


@dataclass(frozen=True)
class Evaluation:
    """The cost at a point."""

    cost: float
    gradient: Array
    """Half of it, in the shape of x."""


class Factor(Protocol):
    """A factorised matrix M."""

    def solve(self, gradient: Array) -> Array:
        """M^-1 gradient, in the shape of x."""


Point = TypeVar("Point", bound=Evaluation)
AnyFactor = TypeVar("AnyFactor", bound=Factor)
PointOf = TypeVar("PointOf", bound=Evaluation, covariant=True)
FactorOf = TypeVar("FactorOf", bound=Factor, covariant=True)


class Linearisation(Protocol[PointOf, FactorOf]):
    """Cost, gradient and matrix at a point. `spent`: the factor took the place of the matrix in memory."""

    @property
    def evaluation(self) -> PointOf: ...  # noqa: D102
    @property
    def spent(self) -> bool: ...  # noqa: D102

    def factor(self, damping: float) -> FactorOf:
        """The factor of M + damping diag(M); LinAlgError where that is not positive definite."""


class Problem(Protocol[PointOf, FactorOf]):
    """What is minimised. Below `nothing_left` nothing is left to fit; `has_curvature`: it can give Newton's matrix."""

    @property
    def nothing_left(self) -> float: ...  # noqa: D102
    @property
    def has_curvature(self) -> bool: ...  # noqa: D102

    def evaluate(self, x: Array) -> PointOf:
        """Cost and gradient at x."""

    def linearise(self, x: Array, *, curved: bool) -> Linearisation[PointOf, FactorOf]:
        """The same with the matrix: Gauss-Newton's or, if `curved`, Newton's."""
