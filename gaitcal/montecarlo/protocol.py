"""The published study (Reinbolt et al. 2007) as settings: its printed figures, and what its Monte
Carlo study varies.

Levels are per cent of the bounds; at 100 % joint positions move by up to 10 mm, orientations by up
to 10 degrees, inertial parameters by up to 10 % of themselves, and marker noise has amplitudes of
up to 10 mm.

Printed figures are in `published_results.json`, parameters by the names of this project.
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
"""Per cent: ten times the published bounds are no perturbation of a model any more."""


class Varied(Enum):
    """One of the four sets of the study."""

    JP = "jp"
    IP = "ip"
    BOTH = "both"
    NOISE = "noise"

    @property
    def key(self) -> int:
        """Place of the set in the random stream; never to be changed."""
        return list(Varied).index(self)

    @property
    def title(self) -> str:
        """As figures and tables call it."""
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
    """Where the ground reactions stay when the model changes: the paper does not say (method,
    section 8).
    """

    LAB = "lab"
    """Fixed in the laboratory, as force plates measure them."""
    FOOT = "foot"
    """Carried along with the foot frame."""


class ParameterChoice(Enum):
    """Which joint parameters vary, the two legs independently; named by how many the published
    linkage has.
    """

    LEG = 27
    """All of each leg."""
    GAIT = 17
    """Those of each leg that a gait trial determines."""
    ALL = 98
    """All, back and arms too."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joint parameters, in the order of the random stream."""
        if self is ParameterChoice.ALL:
            return JP_NAMES
        of_leg = list_leg_parameters if self is ParameterChoice.LEG else list_gait_parameters
        return tuple(name for side in SIDES for name in of_leg(side))


@dataclass(frozen=True, kw_only=True)
class MonteCarloSettings:
    """Everything that a draw depends on besides the model, its set, its level and its number."""

    seed: int = 0
    parameters: ParameterChoice = ParameterChoice.LEG
    position_mm: float = 10.0
    orientation_deg: float = 10.0
    inertial_percent: float = 10.0
    noise_mm: float = 10.0
    refit_tolerance: float = 1e-6
    """Largest change of a node (m, rad) in the last step; the error left is smaller by the rate of
    convergence.
    """
    refit_most_evaluations: int = 80
    """Evaluations of the gradient after which a draw counts as failed."""

    @property
    def joint_bounds(self) -> Array:
        """(np,) m, rad: bounds at 100 % of the joint parameters that vary."""
        by_kind = {
            ParameterKind.POSITION: self.position_mm,
            ParameterKind.ORIENTATION: self.orientation_deg,
        }
        kinds = [JOINT_PARAMETERS[JP_INDEX[name]].kind for name in self.parameters.names]
        return np.array([by_kind[kind] * kind.to_si for kind in kinds])

    def as_json(self) -> Mapping[str, float]:
        """Flat and plain, for the store and for comparison with it."""
        return asdict(self) | {"parameters": self.parameters.value}


@dataclass(frozen=True)
class Plan:
    """How much to do: each set at each level, `draws` times."""

    sets: tuple[Varied, ...] = tuple(Varied)
    levels: tuple[int, ...] = PUBLISHED_LEVELS
    """Per cent of the bounds."""
    draws: int = PUBLISHED_DRAWS

    @property
    def cells(self) -> tuple[tuple[Varied, int], ...]:
        """Every set with every level, in the order of tables."""
        return tuple(
            (varied, level)
            for varied in Varied
            if varied in self.sets
            for level in sorted(set(self.levels))
        )

    @property
    def total(self) -> int:
        """Number of draws of the whole study."""
        return self.draws * len(self.cells)


PROBLEMS: tuple[str, ...] = ("hip", "knee", "ankle", "full leg")
"""Columns of Table I: three isolated trials and gait."""
SIDE = "l"
"""The paper's leg is the left one: only then do the signs of Table II fit frames with z to the
right.
"""


@cache
def _content() -> dict[str, Any]:
    path = files("gaitcal.montecarlo") / "published_results.json"
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def table_one(row: str, quantity: str) -> dict[str, float | None]:
    """Problem -> figure, for a row of Table I (`synthetic_with_noise`, ...) and
    `marker_distance_mm`, `position_mm`, `orientation_deg`.
    """
    return dict(zip(PROBLEMS, _content()["table_I"][row][quantity], strict=True))


def table_two() -> list[Any]:
    """Table II, 27 rows: name of the joint parameter (left leg), title, unit (mm, deg);
    single_joint, full_leg: pairs of the difference from the true (synthetic) and from the nominal
    (experimental) value.
    """
    return [SimpleNamespace(**row) for row in _content()["table_II"]]


def table_three(row: str) -> list[Any]:
    """Force N, torque N·m, then inertia kg mm^2, mass kg, mass centre mm; each [mean, sd] for the
    random seeds.
    """
    figures: list[Any] = _content()["table_III"][row]
    return figures


def table_four() -> list[Any]:
    """Table IV, 37 rows: name of the symmetric parameter, title, unit (kg, mm, kg mm^2), note;
    difference from the true (correct_seed, and random_seeds: mean and SD) or nominal value
    (experimental). `foot.com.sup` was held.
    """
    return [SimpleNamespace(**{"note": ""} | row) for row in _content()["table_IV"]]


def cpu_seconds(problem: str) -> tuple[float, float]:
    """Shortest and longest published time, s: `isolated`, `gait` or `inertial` (3.4 GHz Pentium 4)."""
    shortest, longest = _content()["cpu_s"][problem]
    return float(shortest), float(longest)


def text(name: str) -> Any:
    """A figure from the prose: see `published_results.json`."""
    return _content()[name]
