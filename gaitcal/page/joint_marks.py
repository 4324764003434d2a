"""Where each joint lies in the two segments it connects: nominal, fitted, and how far the fit can be trusted.

A joint is a sequence of elements from parent to child (`model/linkage.py`). Those before its first coordinate place the
joint in the parent, those after its last coordinate place it, inverted, in the child:

    T_parent = E_1 ... E_k            T_child = (E_m ... E_n)^-1
    centre = translation of T         axis = sign * T R[:, axis of the coordinate next to it]

Standard errors s_p of the joint parameters p spread into centre and axis through the Jacobian,
cov = sum_p s_p^2 (d./dp)(d./dp)^T, parameters taken as uncorrelated (the table of errors tells no more); its matrix
square root is kept, whose columns are the half axes of the one-sigma ellipsoid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import axis_rotation
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.linkage import JOINTS, ZERO_ANGLES, Element, Joint, Source
from gaitcal.model.parameters import Parameters

Array = NDArray[np.float64]

_STEP = 1e-6
"""m, rad: step of the central differences; their error, about 1e-12, is far below a pixel."""


@dataclass(frozen=True)
class JointMark:
    """One joint as it lies in one of its two segments."""

    joint: str
    segment: str
    nominal_centre: Array
    """(3,) m, segment frame."""
    fitted_centre: Array
    """(3,) m, segment frame."""
    nominal_axis: Array
    """(3,) unit vector, segment frame; NaN where the joint is a ball and has no axis."""
    fitted_axis: Array
    """(3,)"""
    centre_spread: Array
    """(3, 3) m: half axes of the one-sigma ellipsoid as columns; NaN where no error is known."""
    axis_spread: Array
    """(3, 3) of the unit vector: the same for the tip of the axis."""
    fitted: bool
    """Whether any of its parameters in this segment was fitted."""


def joint_marks(nominal: Parameters, fitted: Parameters, errors: Mapping[str, float]) -> tuple[JointMark, ...]:
    """All joints in both their segments.

    Parameters
    ----------
    errors : joint parameter -> standard error (m, rad) of every fitted one.
    """
    marks = []
    for joint in JOINTS:
        for segment, before in ((joint.parent, True), (joint.child, False)):
            elements = _beside(joint, before=before)
            names = [e.name for e in elements if e.source is Source.JOINT_PARAMETER]
            if not names:
                continue
            axis = _axis(joint, before=before)
            centre_0, axis_0 = _place(elements, axis, nominal, before=before)
            centre_1, axis_1 = _place(elements, axis, fitted, before=before)
            known = {name: errors[name] for name in names if np.isfinite(errors.get(name, np.nan))}
            spread = _spread(elements, axis, fitted, known, before=before)
            at = [JP_INDEX[name] for name in names]
            changed = bool(known) or not np.array_equal(nominal.joint[at], fitted.joint[at])
            marks.append(JointMark(joint.name, segment, centre_0, centre_1, axis_0, axis_1, *spread, changed))
    return tuple(marks)


def _beside(joint: Joint, *, before: bool) -> tuple[Element, ...]:
    at = [i for i, e in enumerate(joint.elements) if e.source is Source.COORDINATE]
    return joint.elements[: at[0]] if before else joint.elements[at[-1] + 1 :]


def _axis(joint: Joint, *, before: bool) -> Element | None:
    """The coordinate next to that segment; None for a ball joint."""
    own = [e for e in joint.elements if e.source is Source.COORDINATE]
    return None if len(own) > 2 else own[0 if before else -1]


def _place(
    elements: tuple[Element, ...], axis: Element | None, values: Parameters, *, before: bool
) -> tuple[Array, Array]:
    rotation, translation = np.eye(3), np.zeros(3)
    for e in elements:
        of_jp = e.source is Source.JOINT_PARAMETER
        amount = e.sign * float(values.joint[JP_INDEX[e.name]] if of_jp else values.zero_angles[_ZERO_INDEX[e.name]])
        if e.rotates:
            rotation = rotation @ axis_rotation(e.axis, amount)
        else:
            translation = translation + amount * rotation[:, e.axis]
    if not before:
        rotation, translation = rotation.T, -rotation.T @ translation
    return translation, np.full(3, np.nan) if axis is None else axis.sign * rotation[:, axis.axis]


_ZERO_INDEX = {name: i for i, name in enumerate(ZERO_ANGLES)}


def _spread(
    elements: tuple[Element, ...], axis: Element | None, at: Parameters, errors: Mapping[str, float], *, before: bool
) -> tuple[Array, Array]:
    if not errors:
        return np.full((3, 3), np.nan), np.full((3, 3), np.nan)
    columns = []
    for name, error in errors.items():
        value = at.joint[JP_INDEX[name]]
        low, high = (
            np.concatenate(_place(elements, axis, at.with_joint((name,), np.array([value + d])), before=before))
            for d in (-_STEP, _STEP)
        )
        columns.append(error * (high - low) / (2 * _STEP))
    pulls = np.array(columns).T
    return _root(pulls[:3]), _root(pulls[3:])


def _root(pulls: Array) -> Array:
    """(3, 3) square root of pulls pulls^T: orthogonal columns whose lengths are the standard deviations."""
    if not np.isfinite(pulls).all():
        return np.full((3, 3), np.nan)
    values, vectors = np.linalg.eigh(pulls @ pulls.T)
    out: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return out
