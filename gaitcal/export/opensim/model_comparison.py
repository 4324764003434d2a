"""Comparison of our model with an OpenSim model: joint centres and axes, lengths, masses.

Where both models have at least three common markers on a segment, the rigid motion that brings the
marker positions of the other model onto ours (Kabsch) expresses its joint axes in our segment
frame. Axes are given as by our joint parameters: the point at which they cross the sagittal plane
of the segment, and their orientation, `front` and `trans` with z = Rx(front) Ry(trans) e_z; for the
subtalar axis `trans` and `sag` with x = Ry(trans) Rz(sag) e_x.

Bodies are assigned to our segments by their names: those of the OpenSim models Gait2354, Gait2392
and Rajagopal2016, and ours.

Differences are also described in sentences: `their hip centres lie 42 mm behind ours (right 41,
left 43)`. Both sides are described together by their mean; lateral differences and rotations of the
left side are mirrored first.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal.errors import Code, InputError
from gaitcal.export.opensim import osim_correspondence, osim_reader, osim_registration
from gaitcal.export.opensim.peer_model import (
    Axis,
    LegGeometry,
    PeerModel,
    find_leg_bodies,
    measure_our_leg,
    measure_peer_leg,
)
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import MASSIVE_SEGMENTS, view_as_table
from gaitcal.model.subject_model import SubjectModel

DIRECTIONS = ("ant", "sup", "lat")


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """One quantity in both models."""

    quantity: str
    unit: str  # mm, deg, kg, or 1 for a count
    ours: float
    theirs: float
    difference: float  # theirs - ours


@dataclass(frozen=True)
class _Registered:
    """Registration of a body on our segment."""

    segment: str
    markers: int
    """Our markers on the segment."""
    common: int
    """Markers that both models have."""
    found: osim_registration.Registration | None
    """None with fewer than three common markers, or all on one line."""


def compare_with_osim(model: SubjectModel, osim: Path | str) -> list[ComparisonRow]:
    """Compare our model with an OpenSim model (3.x or 4.x).

    There are rows only for quantities of both models: masses always; lengths where the file has the
    coordinates `hip_flexion_r`, `knee_angle_r`, `ankle_angle_r` (and `_l`); centres and axes where
    markers register the segment.

    Parameters
    ----------
    model : SubjectModel
        Our model.
    osim : Path or str
        OpenSim model file.

    Returns
    -------
    list of ComparisonRow

    Raises
    ------
    InputError
        The file cannot be read, is no OpenSim model, or has no leg and no body with a known name.
    """
    peer = osim_reader.read_osim(osim)
    rows: list[ComparisonRow] = []
    for side in SIDES:
        bodies = find_leg_bodies(peer, side)
        registered = [_register(model, peer, segment, body) for segment, body in bodies.items()]
        poses = {r.segment: r.found.pose for r in registered if r.found is not None}
        ours = measure_our_leg(model.parameters, side)
        rows += _compare_legs(side, ours, measure_peer_leg(peer, side, poses))
        for r in registered:
            # The pelvis belongs to both legs: list it once.
            if side == SIDES[0] or r.segment != "pelvis":
                rows += _list_registration_rows(r)
    rows += _compare_masses(model, peer)
    if not rows:
        message = (
            "has neither hip_flexion_r, knee_angle_r, ankle_angle_r (or _l) nor a body with a "
            "known name such as pelvis, femur_r, tibia_r; found the bodies "
            f"{', '.join(peer.masses)}"
        )
        raise InputError(message, source=osim, code=Code.OTHER_MODEL)
    return rows


def _make_row(quantity: str, unit: str, ours: float, theirs: float) -> ComparisonRow:
    """Make a row, without negative zeros."""
    difference = float(theirs - ours) + 0.0  # no negative zeros
    return ComparisonRow(
        quantity=quantity,
        unit=unit,
        ours=float(ours) + 0.0,
        theirs=float(theirs) + 0.0,
        difference=difference,
    )


def _compare_legs(side: str, ours: LegGeometry, theirs: LegGeometry) -> list[ComparisonRow]:
    """Compare the quantities of both legs, in the order of ours."""
    known = _list_leg_quantities(side, theirs)
    return [
        _make_row(*name, value, known[name])
        for name, value in _list_leg_quantities(side, ours).items()
        if name in known
    ]


def _list_leg_quantities(side: str, leg: LegGeometry) -> dict[tuple[str, str], float]:
    """List the known quantities of a leg: name and unit -> value."""
    lengths = {
        f"thigh_{side} length, hip centre to knee centre": leg.thigh_length,
        f"shank_{side} length, knee centre to talocrural centre": leg.shank_length,
        f"talocrural_{side} to subtalar_{side} axis": leg.ankle_axes_distance,
    }
    points = {
        f"hip_{side} centre in pelvis": leg.hip_in_pelvis,
        f"hip_{side} centre in thigh_{side}": leg.hip_in_thigh,
    }
    flexion_axes = {
        f"knee_{side} axis in thigh_{side}": leg.knee_in_thigh,
        f"knee_{side} axis in shank_{side}": leg.knee_in_shank,
        f"talocrural_{side} axis in shank_{side}": leg.ankle_in_shank,
    }
    out = {(name, "mm"): 1e3 * length for name, length in lengths.items() if length is not None}
    for name, point in points.items():
        if point is not None:
            for direction, value in zip(DIRECTIONS, point, strict=True):
                out[f"{name}, {direction}", "mm"] = 1e3 * value
    for name, axis in flexion_axes.items():
        if axis is not None:
            # The point at which the axis crosses the sagittal plane has no lateral coordinate.
            for direction, value in zip(DIRECTIONS[:2], axis.find_crossing(2)[:2], strict=True):
                out[f"{name}, {direction}", "mm"] = 1e3 * value
            out |= _measure_axis_angles(name, axis, 2, ("front", "trans"))
    if leg.subtalar_in_foot is not None:
        out |= _measure_axis_angles(
            f"subtalar_{side} axis in foot_{side}", leg.subtalar_in_foot, 0, ("trans", "sag")
        )
    return out


def _measure_axis_angles(
    name: str, axis: Axis, along: int, planes: tuple[str, str]
) -> dict[tuple[str, str], float]:
    """Measure angles (deg) of an axis from coordinate axis `along`, about the two other ones."""
    back, main, next_one = (axis.direction[(along + k) % 3] for k in (-1, 0, 1))
    angles = np.arctan2(-back, main), np.arcsin(np.clip(next_one, -1.0, 1.0))
    return {
        (f"{name}, {plane}", "deg"): float(np.degrees(a))
        for plane, a in zip(planes, angles, strict=True)
    }


def _register(model: SubjectModel, peer: PeerModel, segment: str, body: str) -> _Registered:
    """Register a body on our segment by the common markers."""
    theirs, ours = osim_registration.find_shared_markers(model, peer, segment, body)
    markers = model.markers.segments.count(segment)
    return _Registered(
        segment,
        markers,
        len(theirs),
        osim_registration.register_body(segment, body, markers, theirs, ours),
    )


def _list_registration_rows(r: _Registered) -> list[ComparisonRow]:
    """List the rows of one registration: common markers, distances."""
    rows = [
        _make_row(f"{r.segment} markers, and how many the peer shares", "1", r.markers, r.common)
    ]
    if r.found is not None:
        rows.append(
            _make_row(
                f"{r.segment} shared markers, RMS distance after registration",
                "mm",
                0.0,
                1e3 * r.found.rms,
            )
        )
    return rows


def _compare_masses(model: SubjectModel, peer: PeerModel) -> list[ComparisonRow]:
    """Compare masses of segments and of the whole body."""
    theirs: dict[str, float] = {}
    for body, mass in peer.masses.items():
        segment = osim_correspondence.find_segment(body)
        if segment is not None:
            theirs[segment] = theirs.get(segment, 0.0) + mass
    if not theirs:
        return []
    ours = dict(zip(MASSIVE_SEGMENTS, view_as_table(model.parameters.inertial)[:, 0], strict=True))
    titles = {segment: f"{segment} mass" for segment in MASSIVE_SEGMENTS}
    if "head_trunk" in theirs and not any(arm in theirs for arm in osim_correspondence.ARMS):
        titles["head_trunk"] = "head_trunk and arms mass"
        ours["head_trunk"] += sum(ours[arm] for arm in osim_correspondence.ARMS)
    rows = [_make_row(titles[s], "kg", ours[s], theirs[s]) for s in MASSIVE_SEGMENTS if s in theirs]
    return [*rows, _make_row("total mass", "kg", model.parameters.mass, sum(peer.masses.values()))]


LEAST_MM, LEAST_DEG, LEAST_SHARE = 5.0, 3.0, 0.02
"""Smallest differences that are described: landmarks are not palpated more accurately. That of
masses is relative to ours.
"""
_MM = {
    "ant": ("in front of", "behind"),
    "sup": ("above", "below"),
    "lat": ("further out than", "further in than"),
}
_PLANES = {
    "front": "in the frontal plane",
    "trans": "in the transverse plane",
    "sag": "in the sagittal plane",
}
_KNEE, _ANKLE = "knee_{s} axis in thigh_{s}", "talocrural_{s} axis in shank_{s}"
_POINTS = {
    "hip_{s} centre in pelvis": "hip centres",
    _KNEE: "knee axes, in the thigh,",
    _ANKLE: "ankle axes",
}
_ROTATIONS = {
    _KNEE: "knee axes",
    _ANKLE: "ankle axes",
    "subtalar_{s} axis in foot_{s}": "subtalar axes",
}
_LENGTHS = {
    "thigh_{s} length, hip centre to knee centre": "thighs",
    "shank_{s} length, knee centre to talocrural centre": "shanks",
}


def describe_osim_differences(rows: Sequence[ComparisonRow]) -> tuple[str, ...]:
    """Describe relevant differences in sentences, the largest first; one sentence if there is none.

    Parameters
    ----------
    rows : sequence of ComparisonRow
        Result of `compare_with_osim`.

    Returns
    -------
    tuple of str
    """
    differences = _list_differences({row.quantity: row for row in rows})
    sentences = sorted(differences, key=lambda difference: -difference[0])
    if sentences:
        return tuple(text for _, text in sentences)
    return (
        f"no centre differs by {LEAST_MM:g} mm, no axis by {LEAST_DEG:g} deg, no mass by "
        f"{LEAST_SHARE:.0%}",
    )


def _list_differences(rows: Mapping[str, ComparisonRow]) -> Iterator[tuple[float, str]]:
    """List each relevant difference: its size in units of its threshold, and a sentence."""
    for pattern, title in _POINTS.items():
        for direction, (positive, negative) in _MM.items():
            quantity = f"{pattern}, {direction}"
            found = _average_sides(rows, quantity, LEAST_MM, mirrored=direction == "lat")
            if found:
                mean, each = found
                where = positive if mean >= 0 else negative
                text = f"their {title} lie {abs(mean):.0f} mm {where} ours{each}"
                yield abs(mean) / LEAST_MM, text
    for pattern, title in _ROTATIONS.items():
        for direction, plane in _PLANES.items():
            quantity = f"{pattern}, {direction}"
            found = _average_sides(rows, quantity, LEAST_DEG, mirrored=direction != "sag")
            if found:
                mean, each = found
                angle = f"{abs(mean):.0f} deg {plane}"
                text = f"their {title} are rotated by {angle} relative to ours{each}"
                yield abs(mean) / LEAST_DEG, text
    for pattern, title in _LENGTHS.items():
        found = _average_sides(rows, pattern, LEAST_MM)
        if found:
            mean, each = found
            longer = "longer" if mean > 0 else "shorter"
            text = f"their {title} are {abs(mean):.0f} mm {longer} than ours{each}"
            yield abs(mean) / LEAST_MM, text
    row = rows.get("total mass")
    if row is not None and abs(row.difference) >= LEAST_SHARE * row.ours:
        share = abs(row.difference) / max(row.ours, 1e-9) / LEAST_SHARE
        more = "more" if row.difference > 0 else "less"
        yield share, f"their body weighs {abs(row.difference):.1f} kg {more} than ours"


def _average_sides(
    rows: Mapping[str, ComparisonRow], quantity: str, least: float, *, mirrored: bool = False
) -> tuple[float, str] | None:
    """Average theirs - ours over both sides, and list the sides; None if smaller than `least`.

    `mirrored`: the left side has the opposite sign.
    """
    sides: dict[str, float] = {}
    for side in SIDES:
        row = rows.get(quantity.format(s=side))
        if row is not None:
            sides[side] = -row.difference if mirrored and side == "l" else row.difference
    mean = sum(sides.values()) / len(sides) if sides else 0.0
    if abs(mean) < least:
        return None
    if len(sides) < len(SIDES):
        return mean, ""
    sign = 1.0 if mean > 0 else -1.0
    return mean, f" (right {sign * sides['r']:.0f}, left {sign * sides['l']:.0f})"
