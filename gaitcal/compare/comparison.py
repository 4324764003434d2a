"""Our model beside a peer's OpenSim model: joint centres and axes, lengths, masses, in our segment frames.

Where both models have at least three of the same markers on a segment, the rigid motion that brings the peer's marker
positions onto ours (Kabsch) takes its joint axes into our segment frame. Axes are told as our joint parameters tell
them: where they cross the segment's sagittal plane, and their orientation, `front` and `trans` with
z = Rx(front) Ry(trans) e_z; for the subtalar axis `trans` and `sag` with x = Ry(trans) Rz(sag) e_x.

A peer's bodies belong to our segments by their names, those of the OpenSim models Gait2354, Gait2392 and Rajagopal2016
and our own.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from gaitcal.compare.osim_reader import read_osim
from gaitcal.compare.peer_model import Axis, LegGeometry, OtherModelError, PeerModel, leg_bodies, our_leg, peer_leg
from gaitcal.model.linkage import SEGMENTS, SIDES
from gaitcal.model.parameters import MASSIVE_SEGMENTS, table
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.rigid import FEWEST_MARKERS, rigid_distances, rigid_fit

DIRECTIONS = ("ant", "sup", "lat")


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """One quantity in both models."""

    quantity: str
    unit: str  # mm, deg, kg, or 1 for a count
    ours: float
    theirs: float
    difference: float  # theirs - ours


def compare(model: SubjectModel, osim: Path | str) -> list[ComparisonRow]:
    """Set `model` beside the OpenSim model in the file `osim` (3.x or 4.x).

    Rows come only for what both models have: masses always; lengths where the peer has the coordinates
    `hip_flexion_r`, `knee_angle_r`, `ankle_angle_r` (and `_l`); centres and axes where markers register the segment.

    Raises
    ------
    InputError
        The file cannot be read, is no OpenSim model, or has neither leg nor segment masses under names known here.
    """
    peer = read_osim(osim)
    rows: list[ComparisonRow] = []
    for side in SIDES:
        poses: dict[str, pin.SE3] = {}
        laid: list[ComparisonRow] = []
        for segment, body in leg_bodies(peer, side).items():
            of_segment = _laid(model, peer, segment, body, poses)
            laid += of_segment if side == SIDES[0] or segment != "pelvis" else []
        theirs = _leg_quantities(side, peer_leg(peer, side, poses))
        ours = _leg_quantities(side, our_leg(model.parameters, side))
        rows += [_row(*name, value, theirs[name]) for name, value in ours.items() if name in theirs]
        rows += laid
    rows += _mass_rows(model, peer)
    if not rows:
        raise OtherModelError(
            "has neither hip_flexion_r, knee_angle_r, ankle_angle_r (or _l) nor a body with a known name such as "
            f"pelvis, femur_r, tibia_r; found the bodies {', '.join(peer.masses)}",
            source=osim,
        )
    return rows


def _row(quantity: str, unit: str, ours: float, theirs: float) -> ComparisonRow:
    difference = float(theirs - ours) + 0.0  # no negative zeros
    return ComparisonRow(
        quantity=quantity, unit=unit, ours=float(ours) + 0.0, theirs=float(theirs) + 0.0, difference=difference
    )


def _leg_quantities(side: str, leg: LegGeometry) -> dict[tuple[str, str], float]:
    """Quantity and its unit -> value, for what is known of a leg."""
    lengths = {
        f"thigh_{side} length, hip centre to knee centre": leg.thigh_length,
        f"shank_{side} length, knee centre to talocrural centre": leg.shank_length,
        f"talocrural_{side} to subtalar_{side} axis": leg.ankle_axes_distance,
    }
    points = {f"hip_{side} centre in pelvis": leg.hip_in_pelvis, f"hip_{side} centre in thigh_{side}": leg.hip_in_thigh}
    flexion_axes = {
        f"knee_{side} axis in thigh_{side}": leg.knee_in_thigh,
        f"knee_{side} axis in shank_{side}": leg.knee_in_shank,
        f"talocrural_{side} axis in shank_{side}": leg.ankle_in_shank,
    }
    out = {(name, "mm"): 1e3 * length for name, length in lengths.items() if length is not None}
    for name, point in points.items():
        if point is not None:
            out |= {(f"{name}, {d}", "mm"): 1e3 * value for d, value in zip(DIRECTIONS, point, strict=True)}
    for name, axis in flexion_axes.items():
        if axis is not None:
            crossing = axis.crossing(2)[:2]
            out |= {(f"{name}, {d}", "mm"): 1e3 * x for d, x in zip(DIRECTIONS[:2], crossing, strict=True)}
            out |= _turns(name, axis, 2, ("front", "trans"))
    if leg.subtalar_in_foot is not None:
        out |= _turns(f"subtalar_{side} axis in foot_{side}", leg.subtalar_in_foot, 0, ("trans", "sag"))
    return out


def _turns(name: str, axis: Axis, along: int, planes: tuple[str, str]) -> dict[tuple[str, str], float]:
    """Deg by which an axis is turned from coordinate axis `along`, about the two others in their order."""
    back, main, next_one = (axis.direction[(along + k) % 3] for k in (-1, 0, 1))
    angles = np.arctan2(-back, main), np.arcsin(np.clip(next_one, -1.0, 1.0))
    return {(f"{name}, {plane}", "deg"): float(np.degrees(a)) for plane, a in zip(planes, angles, strict=True)}


def _laid(
    model: SubjectModel, peer: PeerModel, segment: str, body: str, poses: dict[str, pin.SE3]
) -> list[ComparisonRow]:
    """Lay the peer's `body` on our `segment` by the markers that both have on it, and tell how well that went.

    `poses` gets the pose of the body in our segment, unless fewer than three markers are shared, or all on one line.
    """
    markers = model.markers
    on_segment = [i for i, s in enumerate(markers.segments) if s == segment]
    theirs, ours = [], []
    for i in on_segment:
        label = same_label(markers.labels[i], tuple(peer.markers))
        carrier, position = peer.markers[label] if label is not None else ("", np.zeros(3))
        if segment_of(carrier) == segment and carrier not in _SLIDING and peer.is_below(carrier, body):
            theirs.append(peer.body_pose(carrier, body).act(position))
            ours.append(markers.local[i])
    rows = [_row(f"{segment} markers, and how many the peer shares", "1", len(on_segment), len(theirs))]
    if len(theirs) < FEWEST_MARKERS:
        return rows
    shared = np.array(theirs), np.array(ours)[:, :, None], np.ones((len(theirs), 1))  # one "frame"
    fit = rigid_fit(*shared)
    if fit.determined[0]:
        poses[segment] = pin.SE3(fit.rotation[0], fit.origin[0])
        rms = float(np.sqrt(np.mean(rigid_distances(*shared) ** 2)))
        rows.append(_row(f"{segment} shared markers, RMS distance after registration", "mm", 0.0, 1e3 * rms))
    return rows


def _mass_rows(model: SubjectModel, peer: PeerModel) -> list[ComparisonRow]:
    theirs: dict[str, float] = {}
    for body, mass in peer.masses.items():
        if (segment := segment_of(body)) is not None:
            theirs[segment] = theirs.get(segment, 0.0) + mass
    if not theirs:
        return []
    ours = dict(zip(MASSIVE_SEGMENTS, table(model.parameters.inertial)[:, 0], strict=True))
    titles = {segment: f"{segment} mass" for segment in MASSIVE_SEGMENTS}
    if "head_trunk" in theirs and not any(arm in theirs for arm in ARMS):
        titles["head_trunk"] = "head_trunk and arms mass"
        ours["head_trunk"] += sum(ours[arm] for arm in ARMS)
    rows = [_row(titles[s], "kg", ours[s], theirs[s]) for s in MASSIVE_SEGMENTS if s in theirs]
    return [*rows, _row("total mass", "kg", model.parameters.mass, sum(peer.masses.values()))]


ARMS: tuple[str, ...] = tuple(f"{part}_{side}" for side in SIDES for part in ("upper_arm", "forearm_hand"))

_MIDDLE = {"pelvis": "pelvis", "torso": "head_trunk", "trunk": "head_trunk", "head": "head_trunk"}
_SIDED = {
    "femur": "thigh",
    "patella": "thigh",
    "tibia": "shank",
    "fibula": "shank",
    "pretalus": "foot",
    "talus": "foot",
    "calcn": "foot",
    "toes": "foot",
    "humerus": "upper_arm",
    "ulna": "forearm_hand",
    "radius": "forearm_hand",
    "hand": "forearm_hand",
}
_SLIDING = ("patella_r", "patella_l")
"""Bodies that slide on the segment they are counted with, so that their markers are no part of it."""


def segment_of(body: str) -> str | None:
    """Our segment for a peer's body (the talus counts with the foot), or None."""
    if body in MASSIVE_SEGMENTS:
        return body
    if body in _MIDDLE:
        return _MIDDLE[body]
    stem, _, side = body.rpartition("_")
    if side in SIDES and stem in _SIDED:
        return f"{_SIDED[stem]}_{side}"
    return body if body in SEGMENTS else None


def same_label(label: str, candidates: tuple[str, ...]) -> str | None:
    """The candidate with this name; else the only one that is the same but for case and punctuation; else None."""
    if label in candidates:
        return label
    plain = _plain(label)
    alike = [c for c in candidates if _plain(c) == plain]
    return alike[0] if len(alike) == 1 and plain else None


def _plain(label: str) -> str:
    return "".join(c for c in label.casefold() if c.isalnum())
