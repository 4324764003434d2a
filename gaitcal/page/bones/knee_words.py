"""What the page says of each knee: where its axes pass the condyles, and what the bone stands on."""

from __future__ import annotations

import math

from gaitcal.page.bones.knee_axis import AxisInCondyle, AxisInKnee, KneeAxis
from gaitcal.page.bones.person_landmarks import KneeEvidence

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


def knee_words(knee: KneeAxis) -> list[str]:
    """One sentence for the fitted axis, or that there is none, and one for the nominal axis."""
    fitted = "Not fitted: the axis is the nominal one." if knee.fitted is None else f"Fitted axis: {_of(knee.fitted)}"
    return [fitted, f"Nominal axis: {_of(knee.nominal)}"]


def evidence_words(knee: KneeAxis) -> str:
    """What the femur stands on, and by how much it misses its own epicondyles."""
    words = _STANDS[knee.evidence]
    if knee.misfit > _LOW_MISFIT and knee.evidence is KneeEvidence.BOTH:
        words += f" Its epicondyles lie {1e3 * knee.misfit:.0f} mm from where the markers have them."
    return words


def _of(axis: AxisInKnee) -> str:
    ends = {"medial": axis.medial, "lateral": axis.lateral}
    through = [name for name, end in ends.items() if end.inside]
    where = {0: "past both condyles", 1: f"through the {''.join(through)} condyle only", 2: "through both condyles"}
    places = "; ".join(f"{name} {_at(end)}" for name, end in ends.items())
    turned = f"turned {math.degrees(axis.angle):.0f}° against the line of their centres"
    return f"{where[len(through)]}, {turned}. From the centre: {places}."


def _at(end: AxisInCondyle) -> str:
    error = "" if math.isnan(end.standard_error) else f" ± {1e3 * end.standard_error:.0f}"
    parts = [
        f"{abs(1e3 * off):.0f} mm {forth if off > 0 else back}"
        for off, forth, back in ((end.forward, "in front", "behind"), (end.above, "above", "below"))
        if abs(off) >= 0.0005
    ]
    return f"{1e3 * end.distance:.0f}{error} mm" + (f" ({', '.join(parts)})" if parts else "")
