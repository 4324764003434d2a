"""The printed figures of Reinbolt et al. 2007 (`published_results.json`), by the names that this project uses."""

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

_JOINT = {"hip": "hip", "knee": "knee", "ankle talocrural": "talocrural", "ankle subtalar": "subtalar"}
_DIRECTION = {
    "anterior position": "ant",
    "superior position": "sup",
    "lateral position": "lat",
    "frontal plane orientation": "front",
    "transverse plane orientation": "trans",
    "sagittal plane orientation": "sag",
}
_BODY = {"head and trunk": "head_trunk", "upper arm": "upper_arm", "lower arm and hand": "forearm_hand"}
_AXIS = {"anterior": "ant", "superior": "sup", "lateral": "lat"}
_QUANTITY = {"mass": "mass", "com": "com", "moment of inertia": "moi"}


@dataclass(frozen=True, kw_only=True)
class JointParameterRow:
    """A row of Table II: difference from the true (synthetic) or nominal (experimental) value, mm or deg."""

    name: str
    """Of the joint parameter, left leg."""
    title: str
    unit: str
    single_joint: float
    full_leg: float
    single_joint_experimental: float
    full_leg_experimental: float


@dataclass(frozen=True, kw_only=True)
class InertialParameterRow:
    """A row of Table IV: difference from the true (synthetic) or nominal (experimental) value, kg, mm, kg mm^2."""

    name: str
    """Of the symmetric inertial parameter: `thigh.com.sup`."""
    title: str
    unit: str
    correct_seed: float
    random_mean: float
    random_sd: float
    experimental: float
    note: str


@cache
def _content() -> dict[str, Any]:
    path = files("gaitcal.reproduction") / "published_results.json"
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def table_one(row: str, quantity: str) -> dict[str, float | None]:
    """Problem -> figure, for a row of Table I (`synthetic_with_noise`, ...) and `marker_distance_mm`, `position_mm`,
    `orientation_deg`.
    """
    return dict(zip(PROBLEMS, _content()["table_I"][row][quantity], strict=True))


def table_two() -> tuple[JointParameterRow, ...]:
    """Table II, 27 rows."""
    return tuple(
        JointParameterRow(
            name=f"{_JOINT[entry['joint']]}_{SIDE}.{entry['segment']}.{_DIRECTION[entry['parameter']]}",
            title=f"{entry['joint']}, {entry['segment']}, {entry['parameter']}",
            unit=entry["unit"],
            single_joint=entry["single_joint"][0],
            full_leg=entry["full_leg"][0],
            single_joint_experimental=entry["single_joint"][1],
            full_leg_experimental=entry["full_leg"][1],
        )
        for entry in _content()["table_II"]
    )


def table_three(row: str) -> list[Any]:
    """Force N, torque N·m, then inertia kg mm^2, mass kg, mass centre mm; each [mean, sd] for the random seeds."""
    figures: list[Any] = _content()["table_III"][row]
    return figures


def table_four() -> tuple[InertialParameterRow, ...]:
    """Table IV, 37 rows; `foot.com.sup` was held and is no variable."""
    rows = []
    for entry in _content()["table_IV"]:
        segment, quantity, direction = entry["segment"], entry["category"], entry["direction"]
        names = (_BODY.get(segment, segment), _QUANTITY[quantity], *([_AXIS[direction]] if direction else []))
        words = (quantity.replace("com", "mass centre"), segment, *([direction] if direction else []))
        mean, sd = entry["random_seeds"]
        rows.append(
            InertialParameterRow(
                name=".".join(names),
                title=", ".join(words),
                unit=entry["unit"],
                correct_seed=entry["correct_seed"],
                random_mean=mean,
                random_sd=sd,
                experimental=entry["experimental"],
                note=entry.get("note", ""),
            )
        )
    return tuple(rows)


def cpu_seconds(problem: str) -> tuple[float, float]:
    """Shortest and longest published time, s: `isolated`, `gait` or `inertial` (3.4 GHz Pentium 4)."""
    shortest, longest = _content()["cpu_s"][problem]
    return float(shortest), float(longest)


def text(name: str) -> Any:
    """A figure from the prose: see `published_results.json`."""
    return _content()[name]
