"""Why an iteration of SciPy's `least_squares` ended, in words that name no variable of its code."""

from __future__ import annotations

from scipy.optimize import OptimizeResult

STATUS = {
    0: "stopped at the largest number of evaluations",
    1: "the cost is stationary",
    2: "the cost falls no further",
    3: "the parameters move no further",
    4: "neither cost nor parameters change any more",
}
"""SciPy's status numbers."""


def ending(result: OptimizeResult) -> str:
    """The status in words; SciPy's own message where the number is new."""
    return STATUS.get(int(result.status), str(result.message))
