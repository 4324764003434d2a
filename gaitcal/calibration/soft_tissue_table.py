"""Soft tissue artefact of thigh and shank by knee flexion, measured on people with tracked bones.

Per radian of knee flexion from the static posture a marker at x moves relative to its bone by

    d(x) = s (Phi(x) beta + e_shift + e_turn x (x - c) + e_own),

s is the softness of the person, c the middle of the segment's markers. Phi(x) beta is the mean of
people, linear in six functions of the position x (from the knee centre, in thigh lengths) and one
of the task

    1,  x/W,  z/W,  k,  k x/W,  k z/W,  g,
    k = exp(-|y| / H),  g = 1/2 in walks and runs, -1/2 elsewhere:

Skin in front of the thigh moves down and that behind it up. Skin over the epicondyles moves back,
skin over the fibular head down and back. The rest differs between people: the whole cluster is
translated (`shift`) and rotated (`turn`), every marker moves individually (`per_marker`), and beta
is known from few people (`covariance`). Lengths are for a thigh of 0.42 m and scale with its
length.

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
DECAY_LENGTH, HALF_WIDTH = 0.15, 0.20
"""H and W in thigh lengths: decay of the sliding of skin with the distance from the knee, and half
the width of a thigh."""
THIGH_M = 0.42
"""Length of the thigh that the figures are for."""


def evaluate_place_functions(place: Array, *, gait: bool) -> Array:
    """Evaluate the functions of position and task.

    Parameters
    ----------
    place : (nm, 3) array
        Positions from the knee centre in thigh lengths, axes of a right segment.
    gait : bool
        Whether the task is a walk or a run, in which thighs stay near the vertical.

    Returns
    -------
    (nm, 7) array
        Phi.
    """
    x, y, z = place.T
    near = np.exp(-np.abs(y) / DECAY_LENGTH)
    one = np.ones_like(x)
    task = one * (0.5 if gait else -0.5)
    return np.stack(
        [
            one,
            x / HALF_WIDTH,
            z / HALF_WIDTH,
            near,
            near * x / HALF_WIDTH,
            near * z / HALF_WIDTH,
            task,
        ],
        axis=1,
    )


@dataclass(frozen=True, kw_only=True)
class SkinField:
    """Soft tissue artefact of one kind of segment, per radian of knee flexion."""

    coefficients: Array
    """(7, 3) m, beta."""
    covariance: Array
    """(21, 21) m^2 of beta, function by function, x, y, z."""
    shift: float
    """m, standard deviation of each component of the cluster's shift among people."""
    turn: float
    """rad, the same of its rotation."""
    per_marker: float
    """m, the same of each marker by itself."""

    def compute_mean(self, functions: Array) -> Array:
        """Compute the mean displacement (nm, 3) m of markers with functions Phi (nm, 7)."""
        return np.asarray(functions @ self.coefficients)

    def compute_uncertainty(self, functions: Array) -> Array:
        """Compute the covariance (3 nm, 3 nm) m^2 of that mean: few people were measured."""
        by_marker = np.kron(functions, np.eye(3))
        return np.asarray(by_marker @ self.covariance @ by_marker.T)


SkinTable = Mapping[str, SkinField]
"""`thigh`, `shank` -> its skin."""


def read_table(file: Path) -> dict[str, SkinField]:
    """Read the artefact of all segments from a file of `models/` or of `--learn`.

    Parameters
    ----------
    file : Path
        JSON file, mm and deg.

    Returns
    -------
    dict
        `thigh`, `shank` -> SkinField, m and rad.
    """
    content = json.loads(file.read_text(encoding="utf-8"))
    return {
        name: SkinField(
            coefficients=1e-3 * np.array(row["coefficients_mm"]),
            covariance=1e-6 * np.array(row["covariance_mm2"]),
            shift=1e-3 * row["shift_mm"],
            turn=float(np.deg2rad(row["turn_deg"])),
            per_marker=1e-3 * row["own_mm"],
        )
        for name, row in content["segments"].items()
    }


@lru_cache(maxsize=1)
def load_people_table() -> SkinTable:
    """Load the built-in table of people's soft tissue artefact, once."""
    return read_table(find_models_folder() / FILE)
