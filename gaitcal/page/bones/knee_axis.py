"""Whether a knee's axis lies in the condyles of the femur: distances and angle, both axes, both knees.

For the line through a with direction u, and the centre m of a condyle,

    foot of m:  f = a + u (u.(m - a)),      offset = f - m,      distance = |offset|,

and with covariances C_a of the centre and C_u of the direction, taken as independent, and h = u.(m - a), the standard
error of the distance is the root of the trace of P (C_a + h^2 C_u) P / 2, P = 1 - u u^T: the mean over the two
directions across the axis. The angle is that between u and the line through both condyles' centres; its error is the
same root of C_u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import unit
from gaitcal.page.body_meshes import Mesh
from gaitcal.page.bones.bone_landmarks import MEDIAL
from gaitcal.page.bones.bone_shape import is_inside
from gaitcal.page.bones.person_landmarks import KneeEvidence, PersonLandmarks
from gaitcal.page.bones.placement import Landmarked, apply, place_of_femur
from gaitcal.page.joint_marks import JointMark


@dataclass(frozen=True, kw_only=True)
class AxisInCondyle:
    """One axis at one condyle."""

    distance: float
    """m from the condyle's centre to the axis."""
    forward: float
    """m by which the axis passes before the centre."""
    above: float
    """m by which it passes above."""
    radius: float
    """m of the condyle's circle."""
    standard_error: float
    """m of the distance, from the fit; NaN where none is known."""

    inside: bool
    """Whether the axis is within the bone where it passes the centre: the femur as a whole, not the condyle alone."""

    @property
    def within(self) -> bool:
        """Whether the axis passes inside the condyle's circle."""
        return self.distance <= self.radius


@dataclass(frozen=True, kw_only=True)
class AxisInKnee:
    """One axis at both condyles."""

    medial: AxisInCondyle
    lateral: AxisInCondyle
    angle: float
    """Rad between the axis and the line through the condyles' centres."""
    angle_error: float
    """Rad, standard error of the axis's direction, the mean over its two directions; NaN where none is known."""


@dataclass(frozen=True, kw_only=True)
class KneeAxis:
    """One knee."""

    side: str
    evidence: KneeEvidence
    misfit: float
    """m from the bone's epicondyles to where the markers have them, the larger one."""
    fitted: AxisInKnee | None
    """None where the knee was not fitted."""
    nominal: AxisInKnee
    centres: Array
    """(2, 3) m, medial and lateral condyle, in the thigh."""
    radii: Array
    """(2,) m of their circles."""
    across: Array
    """(3,) unit normal of both circles, in the thigh."""


@dataclass(frozen=True)
class _Femur:
    """A person's femur, in the thigh."""

    surface: Mesh
    centres: Array
    """(2, 3) m, medial and lateral condyle."""
    radii: Array
    """(2,) m"""


def knee_axes(bones: Landmarked, person: PersonLandmarks, joints: tuple[JointMark, ...]) -> tuple[KneeAxis, ...]:
    """Right and left knee."""
    out = []
    for side in SIDES:
        mark = next(j for j in joints if (j.joint, j.segment) == (f"knee_{side}", f"thigh_{side}"))
        place, mirror = place_of_femur(bones, person, side), np.ones(3) if side == "r" else MEDIAL
        pair = bones.condyles
        own = np.array([pair.medial.centre, pair.lateral.centre]) * mirror
        bone = bones.bones.meshes["femur"]
        femur = _Femur(
            Mesh(apply(place, bone.vertices * mirror), bone.triangles),
            apply(place, own),
            # The sagittal plane is scaled alike: the factor is the length of the map of its y axis.
            np.array([pair.medial.radius, pair.lateral.radius]) * float(np.linalg.norm(place[:, 1])),
        )
        drawn = apply(place, np.array([bones.femur.lateral, bones.femur.medial]) * mirror)
        wanted = np.array([person.point(f"thigh_{side}", f"epicondyle_{end}") for end in ("lat", "med")])
        out.append(
            KneeAxis(
                side=side,
                evidence=person.knees[side],
                misfit=float(np.linalg.norm(drawn - wanted, axis=1).max()),
                fitted=_axis(mark.fitted_centre, mark.fitted_axis, femur, mark) if mark.fitted else None,
                nominal=_axis(mark.nominal_centre, mark.nominal_axis, femur, None),
                centres=femur.centres,
                radii=femur.radii,
                across=unit(place[:, 2]),
            )
        )
    return tuple(out)


def _axis(start: Array, direction: Array, femur: _Femur, mark: JointMark | None) -> AxisInKnee:
    medial, lateral = (_at(start, direction, femur, condyle, mark) for condyle in range(2))
    line = femur.centres[1] - femur.centres[0]
    cosine = abs(float(direction @ line)) / float(np.linalg.norm(line))
    error = float("nan")
    if mark is not None and np.isfinite(mark.axis_spread).all():
        error = _across(direction, mark.axis_spread @ mark.axis_spread.T)
    return AxisInKnee(medial=medial, lateral=lateral, angle=float(np.arccos(min(1.0, cosine))), angle_error=error)


def _across(direction: Array, covariance: Array) -> float:
    """Standard error across a direction: of the two components there, the root of the mean variance."""
    across = np.eye(3) - np.outer(direction, direction)
    return float(np.sqrt(np.trace(across @ covariance @ across) / 2.0))


def _at(start: Array, direction: Array, femur: _Femur, condyle: int, mark: JointMark | None) -> AxisInCondyle:
    centre = femur.centres[condyle]
    reach = float(direction @ (centre - start))
    passing = start + reach * direction
    offset = passing - centre
    error = float("nan")
    if mark is not None and np.isfinite(mark.centre_spread).all() and np.isfinite(mark.axis_spread).all():
        spread = mark.centre_spread @ mark.centre_spread.T + reach**2 * mark.axis_spread @ mark.axis_spread.T
        error = _across(direction, spread)
    return AxisInCondyle(
        distance=float(np.linalg.norm(offset)),
        forward=float(offset[0]),
        above=float(offset[1]),
        radius=float(femur.radii[condyle]),
        standard_error=error,
        inside=is_inside(femur.surface, passing),
    )
