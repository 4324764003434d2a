"""What the page says of each knee: where its axes pass the condyles, and what the bone stands on."""

from __future__ import annotations

import math
from enum import Enum

from gaitcal.page.bones.knee_axis import AxisInCondyle, AxisInKnee, KneeAxis
from gaitcal.page.bones.person_landmarks import KneeEvidence

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
    places = "; ".join(f"{name} {_at(end)}" for name, end in ends.items())
    turned = f"turned {_degrees(axis)} against the line of their centres"
    return f"{_where(axis)}, {turned}. From the centre: {places}."


def _at(end: AxisInCondyle) -> str:
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
