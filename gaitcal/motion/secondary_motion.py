"""Motions of a joint that go with its angle, as unknowns of a trial: a knee is no hinge, it rolls, glides and turns.

Before the knee flexes, the shank slides along x and y and turns about x and y of the axes that flexion turns about, by

    amount_c(t) = z_c2 b_2(phi(t)) + z_c3 b_3(phi(t)),      c: ant, sup (m), front, trans (rad),

phi the knee's angle, tracked with nominal joints. What goes linearly with phi is a hinge that lies elsewhere, and is
left to the joint parameters. b_2 and b_3 are what 1 and phi leave of phi^2, and 1, phi and phi^2 of phi^3, over all
trials of one kind of task, of mean square one: sizes of z are those of the motion in the task. Knees of cadavers
(Walker et al., J Biomech 21:965-974, 1988) are so described to 0.1 degrees.

z are variables of the chain like joint parameters (`Chain.secondary`); their columns are those of a joint that slides
or turns there, times b, so that all equations of a trial hold them. Tracking and torques keep the hinge.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.kinematics import SecondaryMotion
from gaitcal.model.linkage import BENDS, SECONDARY

LEAST_SPREAD = np.deg2rad(2.0)
"""rad: an angle that moves less in a task moves no more with it than one that moves so much."""


@dataclass(frozen=True)
class SecondaryColumns:
    """The secondary motions of a trial."""

    kind: str
    """Of task: trials of one kind share the unknowns."""
    regressors: dict[str, tuple[Array, Array]]
    """Coordinate -> (nf,) b_2 and b_3."""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(n,) of the chain's variables."""
        return tuple(element.name + bend for name in self.regressors for bend in BENDS for element in SECONDARY[name])

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """(n,) as trials share them, `kind/coordinate/bend/name`."""
        return tuple(
            f"{self.kind}/{name}/{bend}/{element.name}"
            for name in self.regressors
            for bend in BENDS
            for element in SECONDARY[name]
        )

    def at(self, z: Array) -> SecondaryMotion:
        """With the unknowns at z (n,), m and rad."""
        values = z.reshape(len(self.regressors), len(BENDS), -1)
        amounts = {
            name: np.asarray(own.T @ np.array(bends), float)
            for own, (name, bends) in zip(values, self.regressors.items(), strict=True)
        }
        return SecondaryMotion(amounts=amounts, regressors=self.regressors)


def secondary_columns(kind: str, angles: Sequence[Mapping[str, Array]]) -> list[SecondaryColumns]:
    """Per trial of one kind of task, from coordinate -> (nf,) rad."""
    out: list[dict[str, tuple[Array, Array]]] = [{} for _ in angles]
    for name in SECONDARY:
        moved = [k for k, of_trial in enumerate(angles) if name in of_trial]
        if moved:
            both = _bends(np.concatenate([angles[k][name] for k in moved]))
            ends = np.cumsum([len(angles[k][name]) for k in moved])[:-1]
            for k, square, cube in zip(moved, *(np.split(b, ends) for b in both), strict=True):
                out[k][name] = square, cube
    return [SecondaryColumns(kind, regressors) for regressors in out]


def _bends(angle: Array) -> Array:
    """(2, nf) b_2 and b_3 of an angle (nf,) rad; zero where the frames are too few to tell bends from a line."""
    columns = len(BENDS) + 2
    if len(angle) < columns:
        return np.zeros((len(BENDS), len(angle)))
    psi = (angle - angle.mean()) / max(float(angle.std()), LEAST_SPREAD)
    q, r = np.linalg.qr(np.vander(psi, columns, increasing=True))
    size = psi.std() ** np.arange(2, columns)
    out: Array = np.sqrt(len(psi)) * (q[:, 2:] * np.sign(np.diag(r)[2:]) * size).T
    return out
