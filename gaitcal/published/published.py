"""The printed figures of Reinbolt et al. 2007 (`published_results.json`), parameters by the names of this project."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

PROBLEMS: tuple[str, ...] = ("hip", "knee", "ankle", "full leg")
"""Columns of Table I: three isolated trials and gait."""
SIDE = "l"
"""The paper's leg is the left one: only then do the signs of Table II fit frames with z to the right."""


@dataclass(frozen=True, kw_only=True)
class JointParameterRow:
    """A row of Table II: difference from the true (synthetic) and from the nominal (experimental) value, mm or deg."""

    name: str
    """Of the joint parameter, left leg."""
    title: str
    """As the paper has it."""
    unit: str
    single_joint: tuple[float, float]
    """Synthetic and experimental."""
    full_leg: tuple[float, float]
    """Synthetic and experimental."""


@dataclass(frozen=True, kw_only=True)
class InertialParameterRow:
    """A row of Table IV: difference from the true (synthetic) or nominal (experimental) value, kg, mm, kg mm^2."""

    name: str
    """Of the symmetric inertial parameter: `thigh.com.sup`."""
    title: str
    """As the paper has it."""
    unit: str
    correct_seed: float
    random_seeds: tuple[float, float]
    """Mean and standard deviation."""
    experimental: float
    note: str = ""


@cache
def _content() -> dict[str, Any]:
    path = files("gaitcal.published") / "published_results.json"
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def table_one(row: str, quantity: str) -> dict[str, float | None]:
    """Problem -> figure, for a row of Table I (`synthetic_with_noise`, ...) and `marker_distance_mm`, `position_mm`,
    `orientation_deg`.
    """
    return dict(zip(PROBLEMS, _content()["table_I"][row][quantity], strict=True))


def table_two() -> tuple[JointParameterRow, ...]:
    """Table II, 27 rows."""
    return tuple(JointParameterRow(**row) for row in _content()["table_II"])


def table_three(row: str) -> list[Any]:
    """Force N, torque N·m, then inertia kg mm^2, mass kg, mass centre mm; each [mean, sd] for the random seeds."""
    figures: list[Any] = _content()["table_III"][row]
    return figures


def table_four() -> tuple[InertialParameterRow, ...]:
    """Table IV, 37 rows; `foot.com.sup` was held and is no variable."""
    return tuple(InertialParameterRow(**row) for row in _content()["table_IV"])


def cpu_seconds(problem: str) -> tuple[float, float]:
    """Shortest and longest published time, s: `isolated`, `gait` or `inertial` (3.4 GHz Pentium 4)."""
    shortest, longest = _content()["cpu_s"][problem]
    return float(shortest), float(longest)


def text(name: str) -> Any:
    """A figure from the prose: see `published_results.json`."""
    return _content()[name]
