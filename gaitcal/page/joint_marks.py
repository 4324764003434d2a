"""Where each joint lies in the two segments it connects: nominal, fitted, and how far the fit can be trusted.

The frames of a joint in its two segments (`export/joint_frames.py`) hold its constants, those before the first
coordinate in the parent and those after the last in the child:

    centre = translation of X            axis = sign * R[:, axis of the coordinate next to that segment]

Standard errors s_p of the joint parameters p spread into centre and axis through the Jacobian,
cov = sum_p s_p^2 (d./dp)(d./dp)^T, parameters taken as uncorrelated (the table of errors tells no more); its matrix
square root is kept, whose columns are the half axes of the one-sigma ellipsoid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.export.joint_frames import frames_of
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX
from gaitcal.model.linkage import JOINTS, Joint
from gaitcal.model.parameters import Parameters

_STEP = 1e-6
"""m, rad: step of the central differences; their error, about 1e-12, is far below a pixel."""


@dataclass(frozen=True, kw_only=True)
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
        for segment in (joint.parent, joint.child):
            names = [p.name for p in JOINT_PARAMETERS if (p.joint, p.segment) == (joint.name, segment)]
            if not names:
                continue
            known = {name: errors[name] for name in names if np.isfinite(errors.get(name, np.nan))}
            columns = [JP_INDEX[name] for name in names]
            nominal_centre, nominal_axis = _centre_and_axis(joint, segment, nominal)
            fitted_centre, fitted_axis = _centre_and_axis(joint, segment, fitted)
            centre_spread, axis_spread = _spreads(joint, segment, fitted, known)
            marks.append(
                JointMark(
                    joint=joint.name,
                    segment=segment,
                    nominal_centre=nominal_centre,
                    fitted_centre=fitted_centre,
                    nominal_axis=nominal_axis,
                    fitted_axis=fitted_axis,
                    centre_spread=centre_spread,
                    axis_spread=axis_spread,
                    fitted=bool(known) or not np.array_equal(nominal.joint[columns], fitted.joint[columns]),
                )
            )
    return tuple(marks)


def _centre_and_axis(joint: Joint, segment: str, parameters: Parameters) -> tuple[Array, Array]:
    """(3,) centre and (3,) axis in that segment: the axis of the coordinate next to it, NaN for a ball joint."""
    frames = frames_of(joint, parameters)
    in_parent = segment == joint.parent
    place = frames.in_parent if in_parent else frames.in_child
    axis = frames.motions[0 if in_parent else -1]
    ball = len(frames.motions) > 2
    centre = place.translation + 0.0  # no negative zeros, which would stand in the page
    return centre, np.full(3, np.nan) if ball else axis.sign * place.rotation[:, axis.axis]


def _spreads(joint: Joint, segment: str, fitted: Parameters, errors: Mapping[str, float]) -> tuple[Array, Array]:
    """(3, 3) of the centre and (3, 3) of the axis: half axes of their one-sigma ellipsoids; NaN without errors."""
    if not errors:
        return np.full((3, 3), np.nan), np.full((3, 3), np.nan)
    columns = []
    for name, error in errors.items():
        value = fitted.joint[JP_INDEX[name]]
        low, high = (
            np.concatenate(_centre_and_axis(joint, segment, fitted.with_joint((name,), np.array([value + step]))))
            for step in (-_STEP, _STEP)
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
