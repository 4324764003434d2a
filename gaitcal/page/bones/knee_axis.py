"""Whether a knee's axis lies in the condyles of the femur: distances and angle, both axes, both knees.

For the line through a with direction u, and the centre m of a condyle,

    foot of m:  f = a + u (u.(m - a)),      offset = f - m,      distance = |offset|,

and with covariances C_a of the centre and C_u of the direction, taken as independent, and h = u.(m - a), the standard
error of the distance is the root of the trace of P (C_a + h^2 C_u) P / 2, P = 1 - u u^T: the mean over the two
directions across the axis. The angle is that between u and the line through both condyles' centres; its error is the
same root of C_u.

What the page says of each knee: where its axes pass the condyles, and what the bone stands on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import unit
from gaitcal.page.body_meshes import Mesh
from gaitcal.page.bones.bone_files import is_inside
from gaitcal.page.bones.bone_landmarks import MEDIAL, KneeEvidence, PersonLandmarks
from gaitcal.page.bones.placement import Landmarked, apply, place_of_femur
from gaitcal.page.scene import JointMark


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


PALPATION_M = 0.008
"""m a coordinate: epicondyles found by different examiners (Della Croce et al., Gait Posture 21:226-237, 2005, give 6
to 21 mm for landmarks of the leg, all directions together)."""
_LOW_MISFIT = 0.005
"""m: below it, a bone's epicondyles lie where the markers say."""
_STANDS = {
    KneeEvidence.BOTH: "The femur stands on the markers of both epicondyles and on the fitted hip centre.",
    KneeEvidence.DEVICE: (
        "The femur stands on the lateral epicondyle's marker, the knee alignment device and the fitted hip centre."
    ),
    KneeEvidence.LATERAL: (
        "Only the lateral epicondyle has a marker: the femur's turn about its length is assumed from the pelvis of the "
        "static trial, so an axis that is turned in the horizontal plane proves nothing."
    ),
    KneeEvidence.NOMINAL: "No landmark of this knee is known: the femur stands on the nominal one, and proves nothing.",
}


class _Place(Enum):
    """Where an axis passes a condyle."""

    CONDYLE = "within the circle of the condyle"
    BONE = "outside the circle, within the femur"
    PAST = "outside the femur"


_AT_BOTH = {
    _Place.CONDYLE: "through both condyles",
    _Place.BONE: "through the bone, outside both condyles' circles",
    _Place.PAST: "past both condyles",
}
_AT_ONE = {
    _Place.CONDYLE: "through the {} condyle",
    _Place.BONE: "through the bone outside the {} condyle's circle",
    _Place.PAST: "past the {} condyle",
}


def knee_words(knee: KneeAxis) -> list[str]:
    """One sentence for the fitted axis, or that there is none, and one for the nominal axis."""
    nominal = (
        f"Nominal axis: {_of(knee.nominal)} It lies there by construction, and proves nothing: the bone stands on "
    )
    nominal += "the epicondyles that define this axis."
    if knee.fitted is None:
        return ["Not fitted: the axis is the nominal one.", nominal]
    error = "" if math.isnan(knee.fitted.medial.standard_error) else "± is of the fit alone; "
    sure = f"{error}the bone's place is uncertain by about {1e3 * _uncertainty(knee):.0f} mm"
    return [f"Fitted axis: {_of(knee.fitted)} {sure[0].upper()}{sure[1:]}.", nominal]


def _uncertainty(knee: KneeAxis) -> float:
    """Of the bone's place across the axis, m: how far its epicondyles miss their markers, and palpation's scatter."""
    return math.hypot(knee.misfit, math.sqrt(2.0) * PALPATION_M)


def knee_brief(knee: KneeAxis) -> list[str]:
    """The same in few words, to stand beside the picture of the knee."""
    axes = {"Fitted (solid)": knee.fitted, "Nominal (dashed)": knee.nominal}
    lines = [f"{name}: {_where(axis)}, {_brief(axis)}" for name, axis in axes.items() if axis is not None]
    if knee.evidence in (KneeEvidence.LATERAL, KneeEvidence.NOMINAL):
        lines.append("No marker on the medial epicondyle: how far the bone is turned is assumed")
    return lines


def _where(axis: AxisInKnee) -> str:
    places = {"medial": _place(axis.medial), "lateral": _place(axis.lateral)}
    if places["medial"] == places["lateral"]:
        return _AT_BOTH[places["medial"]]
    return " and ".join(_AT_ONE[place].format(name) for name, place in places.items())


def _place(end: AxisInCondyle) -> _Place:
    if end.within:
        return _Place.CONDYLE
    return _Place.BONE if end.inside else _Place.PAST


def _brief(axis: AxisInKnee) -> str:
    far = [f"{1e3 * end.distance:.0f}{_error(end)} mm" for end in (axis.medial, axis.lateral)]
    turned = f"{_degrees(axis)} off their line"
    return f"{far[0]} from the medial centre, {far[1]} from the lateral one, {turned}"


def evidence_words(knee: KneeAxis) -> str:
    """What the femur stands on, and by how much it misses its own epicondyles."""
    words = _STANDS[knee.evidence]
    if knee.misfit > _LOW_MISFIT and knee.evidence is KneeEvidence.BOTH:
        words += f" Its epicondyles lie {1e3 * knee.misfit:.0f} mm from where the markers have them."
    return words


def _of(axis: AxisInKnee) -> str:
    ends = {"medial": axis.medial, "lateral": axis.lateral}
    places = "; ".join(f"{name} {_end_words(end)}" for name, end in ends.items())
    turned = f"turned {_degrees(axis)} against the line of their centres"
    return f"{_where(axis)}, {turned}. From the centre: {places}."


def _end_words(end: AxisInCondyle) -> str:
    parts = [
        f"{abs(1e3 * off):.0f} mm {forth if off > 0 else back}"
        for off, forth, back in ((end.forward, "in front", "behind"), (end.above, "above", "below"))
        if abs(off) >= 0.0005
    ]
    return f"{1e3 * end.distance:.0f}{_error(end)} mm" + (f" ({', '.join(parts)})" if parts else "")


def _error(end: AxisInCondyle) -> str:
    return "" if math.isnan(end.standard_error) else f" ± {1e3 * end.standard_error:.0f}"


def _degrees(axis: AxisInKnee) -> str:
    error = "" if math.isnan(axis.angle_error) else f" ± {math.degrees(axis.angle_error):.0f}"
    return f"{math.degrees(axis.angle):.0f}{error}°"
