"""Whether a knee's axis lies in the condyles of the femur: distances and angle of both axes, and what is said of them.

For an axis through a with direction u, and the centre m of a condyle of the femur,

    foot of m:  f = a + u (u.(m - a)),      offset = f - m,      distance = |offset|,

and with covariances C_a of the centre and C_u of the direction, taken as independent, and h = u.(m - a), the standard
error of the distance is the root of the trace of P (C_a + h^2 C_u) P / 2, P = 1 - u u^T: the mean over the two
directions across the axis. The angle is that between u and the line through both condyles' centres; its error is the
same root of C_u.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import unit
from gaitcal.page.body_meshes import Mesh
from gaitcal.page.bone_landmarks import KneeEvidence, PersonLandmarks, is_inside
from gaitcal.page.bone_placement import MIRROR, Landmarked, apply, place_of_femur
from gaitcal.page.scene import JointMark

PALPATION_M = 0.008
"""m a coordinate: epicondyles found by different examiners (Della Croce et al., Gait Posture 21:226-237, 2005, give 6
to 21 mm for landmarks of the leg, all directions together)."""
_STANDS = {
    KneeEvidence.BOTH: "The femur stands on the markers of both epicondyles and on the fitted hip centre.",
    KneeEvidence.DEVICE: (
        "The femur stands on the lateral epicondyle's marker, the knee alignment device and the fitted hip centre."
    ),
    KneeEvidence.LATERAL: (
        "Only the lateral epicondyle has a marker: the femur's turn is assumed from the pelvis, and proves nothing."
    ),
    KneeEvidence.NOMINAL: "No landmark of this knee is known: the femur stands on the nominal one, and proves nothing.",
}
_PASSES = {
    "circle": ("through both condyles", "through the {} condyle"),
    "bone": ("through the bone, outside both condyles' circles", "through the bone outside the {} condyle's circle"),
    "outside": ("past both condyles", "past the {} condyle"),
}
"""Where an axis passes: at both condyles, at one."""


@dataclass(frozen=True, kw_only=True)
class AxisInCondyle:
    """One axis at one condyle."""

    distance: float  # m from the condyle's centre to the axis
    radius: float  # m of the condyle's circle
    standard_error: float  # m of the distance, from the fit; NaN where none is known
    inside: bool
    """Whether the axis is within the bone where it passes the centre: the femur as a whole, not the condyle alone."""


@dataclass(frozen=True, kw_only=True)
class AxisInKnee:
    """One axis at both condyles."""

    medial: AxisInCondyle
    lateral: AxisInCondyle
    angle: float  # Rad between the axis and the line through the condyles' centres
    angle_error: float
    """Rad, standard error of the axis's direction, the mean over its two directions; NaN where none is known."""

    @property
    def ends(self) -> dict[str, AxisInCondyle]:
        """Condyle -> the axis there."""
        return {"medial": self.medial, "lateral": self.lateral}


@dataclass(frozen=True, kw_only=True)
class KneeAxis:
    """One knee."""

    side: str
    evidence: KneeEvidence
    misfit: float  # m from the bone's epicondyles to where the markers have them, the larger one
    fitted: AxisInKnee | None  # None where the knee was not fitted
    nominal: AxisInKnee
    centres: Array  # (2, 3) m, medial and lateral condyle, in the thigh
    radii: Array  # (2,) m of their circles
    across: Array  # (3,) unit normal of both circles, in the thigh


def knee_axes(bones: Landmarked, person: PersonLandmarks, joints: tuple[JointMark, ...]) -> tuple[KneeAxis, ...]:
    """Right and left knee."""
    out = []
    bone, pair = bones.bones.meshes["femur"], bones.condyles
    for side in SIDES:
        mark = next(j for j in joints if (j.joint, j.segment) == (f"knee_{side}", f"thigh_{side}"))
        place, mirror = place_of_femur(bones, person, side), MIRROR[side]
        femur = Mesh(apply(place, bone.vertices * mirror), bone.triangles)
        centres = apply(place, np.array([pair.medial.centre, pair.lateral.centre]) * mirror)
        # The sagittal plane is scaled alike: the factor is the length of the map of its y axis.
        radii = np.array([pair.medial.radius, pair.lateral.radius]) * float(np.linalg.norm(place[:, 1]))
        drawn = apply(place, np.array([bones.femur.lateral, bones.femur.medial]) * mirror)
        wanted = np.array([person.point(f"thigh_{side}", f"epicondyle_{end}") for end in ("lat", "med")])
        none = np.full((3, 3), np.nan)
        fitted = (mark.fitted_centre, mark.fitted_axis, mark.centre_spread, mark.axis_spread)
        out.append(
            KneeAxis(
                side=side,
                evidence=person.knees[side],
                misfit=float(np.linalg.norm(drawn - wanted, axis=1).max()),
                fitted=_axis(femur, centres, radii, *fitted) if mark.fitted else None,
                nominal=_axis(femur, centres, radii, mark.nominal_centre, mark.nominal_axis, none, none),
                centres=centres,
                radii=radii,
                across=unit(place[:, 2]),
            )
        )
    return tuple(out)


def _axis(
    femur: Mesh, centres: Array, radii: Array, start: Array, direction: Array, centre_spread: Array, axis_spread: Array
) -> AxisInKnee:
    """The axis through `start` (3,) m along `direction`; spreads as in `JointMark`, NaN where not known."""
    across = np.eye(3) - np.outer(direction, direction)
    tilted = axis_spread @ axis_spread.T

    def error(covariance: Array) -> float:
        return math.sqrt(max(float(np.trace(across @ covariance @ across)), 0.0) / 2.0)

    def condyle(centre: Array, radius: float) -> AxisInCondyle:
        reach = float(direction @ (centre - start))
        passing = start + reach * direction
        return AxisInCondyle(
            distance=float(np.linalg.norm(passing - centre)),
            radius=float(radius),
            standard_error=error(centre_spread @ centre_spread.T + reach**2 * tilted),
            inside=is_inside(femur, passing),
        )

    line = centres[1] - centres[0]
    cosine = abs(float(direction @ line)) / float(np.linalg.norm(line))
    medial, lateral = (condyle(centre, radius) for centre, radius in zip(centres, radii, strict=True))
    return AxisInKnee(medial=medial, lateral=lateral, angle=math.acos(min(1.0, cosine)), angle_error=error(tilted))


def knee_words(knee: KneeAxis) -> list[str]:
    """Where fitted and nominal axis pass, beside the picture of the knee, and what that proves."""
    lines = [] if knee.fitted else ["Not fitted: the axis is the nominal one"]
    for name, axis in (("Fitted (solid)", knee.fitted), ("Nominal (dashed)", knee.nominal)):
        if axis is not None:
            far = [f"{_with_error(1e3 * end.distance, 1e3 * end.standard_error)} mm" for end in axis.ends.values()]
            places = f"{far[0]} from the medial centre, {far[1]} from the lateral one"
            lines.append(f"{name}: {_where(axis)}, {places}, {_degrees(axis)} off their line")
    # How far the bone's epicondyles miss their markers, and palpation's scatter in the two directions across the axis.
    uncertainty = 1e3 * math.hypot(knee.misfit, math.sqrt(2.0) * PALPATION_M)
    sure = f"Its place is uncertain by about {uncertainty:.0f} mm; the nominal axis lies in it by construction."
    return [*lines, f"{_STANDS[knee.evidence]} {sure}"]


def _where(axis: AxisInKnee) -> str:
    places = {
        name: "circle" if end.distance <= end.radius else "bone" if end.inside else "outside"
        for name, end in axis.ends.items()
    }
    if places["medial"] == places["lateral"]:
        return _PASSES[places["medial"]][0]
    return " and ".join(_PASSES[place][1].format(name) for name, place in places.items())


def _degrees(axis: AxisInKnee) -> str:
    return f"{_with_error(math.degrees(axis.angle), math.degrees(axis.angle_error))}°"


def _with_error(value: float, error: float) -> str:
    return f"{value:.0f}" if math.isnan(error) else f"{value:.0f} ± {error:.0f}"
