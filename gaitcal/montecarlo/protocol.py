"""Settings and printed figures of the published study (Reinbolt et al. 2007).

Levels are per cent of the bounds: at 100 % joint positions move by up to 10 mm, orientations by up
to 10 degrees, inertial parameters by up to 10 % of their values, and marker noise has amplitudes of
up to 10 mm.

Printed figures are in `published_results.json`, with parameters named as in this project.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from functools import cache
from importlib.resources import files
from types import SimpleNamespace
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    JP_INDEX,
    JP_NAMES,
    ParameterKind,
    list_gait_parameters,
    list_leg_parameters,
)

PUBLISHED_LEVELS = (25, 50, 75, 100)
PUBLISHED_DRAWS = 5000
MOST_LEVEL = 1000
"""Per cent: ten times the published bounds is the largest perturbation of a model."""


class Varied(Enum):
    """One of the four sets of the study."""

    JP = "jp"
    IP = "ip"
    BOTH = "both"
    NOISE = "noise"

    @property
    def key(self) -> int:
        """Index of the set in the random stream; never to be changed."""
        return list(Varied).index(self)

    @property
    def title(self) -> str:
        """Title in figures and tables."""
        return {"jp": "JP", "ip": "IP", "both": "JP+IP", "noise": "NP"}[self.value]

    @property
    def joint(self) -> bool:
        """Whether joint parameters vary."""
        return self in (Varied.JP, Varied.BOTH)

    @property
    def inertial(self) -> bool:
        """Whether inertial parameters vary."""
        return self in (Varied.IP, Varied.BOTH)


class ReactionFrame(Enum):
    """Frame in which the ground reactions are constant when the model changes.

    The paper does not give it (method, section 8).
    """

    LAB = "lab"
    """The laboratory, as force plates measure them."""
    FOOT = "foot"
    """The foot: they move with it."""


class ParameterChoice(Enum):
    """Which joint parameters vary, those of both legs independently.

    The value is the number of them in the published linkage.
    """

    LEG = 27
    """All parameters of each leg."""
    GAIT = 17
    """Those of each leg that a gait trial determines."""
    ALL = 98
    """All parameters, with back and arms."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joint parameters, in the order of the random stream."""
        if self is ParameterChoice.ALL:
            return JP_NAMES
        list_names = list_leg_parameters if self is ParameterChoice.LEG else list_gait_parameters
        return tuple(name for side in SIDES for name in list_names(side))


@dataclass(frozen=True, kw_only=True)
class MonteCarloSettings:
    """Settings of a draw, besides the model, its set, its level and its number."""

    seed: int = 0
    parameters: ParameterChoice = ParameterChoice.LEG
    position_mm: float = 10.0
    orientation_deg: float = 10.0
    inertial_percent: float = 10.0
    noise_mm: float = 10.0
    refit_tolerance: float = 1e-6
    """Largest change of a control point (m, rad) in the last step; the remaining error is smaller
    by the rate of convergence.
    """
    refit_most_evaluations: int = 80
    """Evaluations of the gradient after which a draw has failed."""

    @property
    def joint_bounds(self) -> Array:
        """(np,) m, rad: bounds at 100 % of the joint parameters that vary."""
        by_kind = {
            ParameterKind.POSITION: self.position_mm,
            ParameterKind.ORIENTATION: self.orientation_deg,
        }
        kinds = [JOINT_PARAMETERS[JP_INDEX[name]].kind for name in self.parameters.names]
        return np.array([by_kind[kind] * kind.to_si for kind in kinds])

    def convert_to_json(self) -> Mapping[str, float]:
        """Convert to a flat dictionary of numbers, for the store of draws.

        Returns: setting -> number.
        """
        return asdict(self) | {"parameters": self.parameters.value}


@dataclass(frozen=True)
class Plan:
    """Number of draws: each set at each level, `draws` times."""

    sets: tuple[Varied, ...] = tuple(Varied)
    levels: tuple[int, ...] = PUBLISHED_LEVELS
    """Per cent of the bounds."""
    draws: int = PUBLISHED_DRAWS

    @property
    def cells(self) -> tuple[tuple[Varied, int], ...]:
        """Every set with every level, in the order of tables."""
        levels = sorted(set(self.levels))
        return tuple((v, level) for v in Varied if v in self.sets for level in levels)

    @property
    def total(self) -> int:
        """Number of draws of the whole study."""
        return self.draws * len(self.cells)


PROBLEMS: tuple[str, ...] = ("hip", "knee", "ankle", "full leg")
"""Columns of Table I: three functional trials and gait."""
SIDE = "l"
"""Side of the paper's leg: only of the left leg do the signs of Table II agree with frames with z
to the right.
"""


@cache
def _read_figures() -> dict[str, Any]:
    """Read the printed figures of the paper."""
    path = files("gaitcal.montecarlo") / "published_results.json"
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def get_table_one(row: str, quantity: str) -> dict[str, float | None]:
    """Get a row of Table I.

    Parameters
    ----------
    row : str
        `synthetic_with_noise`, ...
    quantity : str
        `marker_distance_mm`, `position_mm` or `orientation_deg`.

    Returns
    -------
    dict
        Problem (`PROBLEMS`) -> figure, mm or deg; None if not printed.
    """
    return dict(zip(PROBLEMS, _read_figures()["table_I"][row][quantity], strict=True))


def get_table_two() -> list[Any]:
    """Get the 27 rows of Table II.

    Returns
    -------
    list of SimpleNamespace
        `name` of the joint parameter (left leg), `title`, `unit` (mm, deg); `single_joint` and
        `full_leg`: pairs of the difference from the true (synthetic) and from the nominal
        (experimental) value.
    """
    return [SimpleNamespace(**row) for row in _read_figures()["table_II"]]


def get_table_three(row: str) -> list[Any]:
    """Get a row of Table III.

    Parameters
    ----------
    row : str
        `synthetic_without_noise`, ...

    Returns
    -------
    list
        Force N, torque N·m, then inertia kg mm^2, mass kg, mass centre mm; each [mean, SD] for the
        random seeds.
    """
    figures: list[Any] = _read_figures()["table_III"][row]
    return figures


def get_table_four() -> list[Any]:
    """Get the 37 rows of Table IV.

    Returns
    -------
    list of SimpleNamespace
        `name` of the symmetric parameter, `title`, `unit` (kg, mm, kg mm^2), `note`; difference
        from the true value (`correct_seed`, and `random_seeds`: mean and SD) or from the nominal
        one (`experimental`). `foot.com.sup` was held.
    """
    return [SimpleNamespace(**{"note": ""} | row) for row in _read_figures()["table_IV"]]


def get_cpu_seconds(problem: str) -> tuple[float, float]:
    """Get the shortest and longest published computing time (3.4 GHz Pentium 4).

    Parameters
    ----------
    problem : str
        `isolated`, `gait` or `inertial`.

    Returns
    -------
    tuple of float
        s.
    """
    shortest, longest = _read_figures()["cpu_s"][problem]
    return float(shortest), float(longest)


def get_figure(name: str) -> Any:
    """Get a figure from the text of the paper, by its name in `published_results.json`."""
    return _read_figures()[name]
