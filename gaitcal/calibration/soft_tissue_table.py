"""How skin markers of thigh and shank move against the bone as the knee flexes, as bones of people
have it.

Per radian of knee flexion from the static posture a marker at x moves against its bone by

    d(x) = s (Phi(x) beta + e_shift + e_turn x (x - c) + e_own),

s how soft the person is, c the middle of the segment's markers. Phi(x) beta is what people have in
common, linear in six functions of the place x (from the knee's centre, in thigh lengths) and one of
the task

    1,  x/W,  z/W,  k,  k x/W,  k z/W,  g,      k = exp(-|y| / H),  g = 1/2 in walks and runs, -1/2 elsewhere:

skin in front of the thigh goes down and that behind it up, skin over the epicondyles goes back,
skin over the fibular head goes down and back. The rest differs from person to person: the whole
cluster shifts (`shift`) and turns (`turn`), every marker moves by itself (`own`), and beta is known
from few people (`covariance`). Lengths are those of a thigh of 0.42 m and grow in proportion to it.

The figures are in `models/soft_tissue.json`, which `python -m scripts.validation bones --learn
FILE` derives from recordings of skin markers and tracked bones.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.toml import find_models_folder

FILE = "soft_tissue.json"
NEAR, ACROSS = 0.15, 0.20
"""H and W in thigh lengths: how far beyond the knee its skin still slides over it, and half the
width of a thigh.
"""
THIGH_M = 0.42
"""Length of the thigh that the figures are for."""


def place_functions(place: Array, *, gait: bool) -> Array:
    """Evaluate the functions of a place and a task.

    Parameters
    ----------
    place : (nm, 3) from the knee's centre in thigh lengths, axes of a right segment.
    gait : whether the task is a walk or a run, in which thighs stay near the vertical.

    Returns
    -------
    (nm, 7) Phi.
    """
    x, y, z = place.T
    near = np.exp(-np.abs(y) / NEAR)
    one = np.ones_like(x)
    task = one * (0.5 if gait else -0.5)
    return np.stack(
        [one, x / ACROSS, z / ACROSS, near, near * x / ACROSS, near * z / ACROSS, task], axis=1
    )


@dataclass(frozen=True, kw_only=True)
class SkinField:
    """The skin of one kind of segment, per radian of knee flexion."""

    coefficients: Array
    """(7, 3) m, beta."""
    covariance: Array
    """(21, 21) m^2 of beta, function by function, x, y, z."""
    shift: float
    """m, standard deviation of each component of the cluster's shift among people."""
    turn: float
    """rad, the same of its rotation."""
    own: float
    """m, the same of each marker by itself."""

    def mean(self, functions: Array) -> Array:
        """(nm, 3) m of markers with functions Phi (nm, 7)."""
        return np.asarray(functions @ self.coefficients)

    def uncertainty(self, functions: Array) -> Array:
        """(3 nm, 3 nm) m^2 of that mean, as few people were measured."""
        by_marker = np.kron(functions, np.eye(3))
        return np.asarray(by_marker @ self.covariance @ by_marker.T)


SkinTable = Mapping[str, SkinField]
"""`thigh`, `shank` -> its skin."""


def read_table(file: Path) -> dict[str, SkinField]:
    """Read the skin of all segments from a file of `models/` or of `--learn`."""
    content = json.loads(file.read_text(encoding="utf-8"))
    return {
        name: SkinField(
            coefficients=1e-3 * np.array(row["coefficients_mm"]),
            covariance=1e-6 * np.array(row["covariance_mm2"]),
            shift=1e-3 * row["shift_mm"],
            turn=float(np.deg2rad(row["turn_deg"])),
            own=1e-3 * row["own_mm"],
        )
        for name, row in content["segments"].items()
    }


@lru_cache(maxsize=1)
def people_table() -> SkinTable:
    """The skin of people that gaitcal brings."""
    return read_table(find_models_folder() / FILE)
