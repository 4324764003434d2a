"""How joint parameters of people go with their size and sex, and that people are alike on both sides.

The deviations d of a person's joint parameters from their nominal values, in units of what is known of anybody (mean
m0, covariance F F^T; `calibration/joint_prior.py`), are those of people of that size and sex, and the person's own:

    y = F^-1 (d - m0) = X w + u,    u ~ N(0, Sigma),    X = [D B, z D B, x D B],

D positions by body height over `HEIGHT`, z the height in steps of `STEP` (within that of the people it was learnt of),
x half a sex, B the directions in which both sides deviate alike. Without z and x, X = D B. F leaves a mirror image a
mirror image, and mixes no positions with orientations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind

HEIGHT, STEP = 1.70, 0.10
"""m."""
SEXES = {"female": -0.5, "male": 0.5}


@dataclass(frozen=True, kw_only=True)
class Person:
    """What deviations may depend on."""

    height: float
    """m."""
    sex: str


def mirror(names: Sequence[str]) -> Array:
    """(n, n) M: M y are the deviations of a person seen in a mirror. Every name's other side is among the names."""
    place = {name: k for k, name in enumerate(names)}
    out = np.zeros((len(names), len(names)))
    for name, k in place.items():
        parameter = JOINT_PARAMETERS[JP_INDEX[name]]
        out[place[other_side(name)], k] = -1.0 if parameter.mirrored else 1.0
    return out


def other_side(name: str) -> str:
    """The same parameter of the other leg or arm; itself of the back."""
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    if parameter.joint[-2:] not in ("_r", "_l"):
        return name
    swapped = parameter.joint[:-1] + ("l" if parameter.joint[-1] == "r" else "r")
    return name.replace(parameter.joint, swapped, 1)


def sided_directions(names: Sequence[str]) -> tuple[Array, Array]:
    """(n, a) and (n, b) orthonormal directions in which both sides deviate alike, and by the opposite."""
    reflected = mirror(names)
    alike, opposite = list[Array](), list[Array]()
    for k in range(len(names)):
        other = int(np.flatnonzero(reflected[:, k])[0])
        if other < k:
            continue
        for sign, found in ((1.0, alike), (-1.0, opposite)):
            direction = np.eye(len(names))[k] + sign * reflected[:, k]
            length = np.linalg.norm(direction)
            if length > 0.0:
                found.append(direction / length)
    return np.array(alike).reshape(-1, len(names)).T, np.array(opposite).reshape(-1, len(names)).T


def design(names: Sequence[str], person: Person, heights: tuple[float, float], *, by_size: bool) -> Array:
    """(n, k) X of a person. `heights`: m, those of the people it is learnt of; beyond them nothing changes."""
    alike, _ = sided_directions(names)
    position = np.array([JOINT_PARAMETERS[JP_INDEX[name]].kind is Kind.POSITION for name in names])
    sized = np.where(position, person.height / HEIGHT, 1.0)[:, None] * alike
    if not by_size:
        return sized
    height = float(np.clip(person.height, *heights))
    return np.hstack([sized, (height - HEIGHT) / STEP * sized, SEXES.get(person.sex, 0.0) * sized])
