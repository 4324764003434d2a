"""Our model beside a peer's OpenSim model: joint centres and axes, lengths, masses, in our segment frames.

Where both models have at least three of the same markers on a segment, the rigid motion that brings the peer's marker
positions onto ours (Kabsch) takes its joint axes into our segment frame. Axes are told as our joint parameters tell
them: where they cross the segment's sagittal plane, and their orientation, `front` and `trans` with
z = Rx(front) Ry(trans) e_z; for the subtalar axis `trans` and `sag` with x = Ry(trans) Rz(sag) e_x.

Which of our segments a peer's body belongs to, and which of its markers is which of ours.

Body names as in the OpenSim models Gait2354, Gait2392 and Rajagopal2016, and our own.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from gaitcal.compare.leg_geometry import Axis, LegGeometry, leg_bodies, our_leg, peer_leg
from gaitcal.compare.osim_reader import read_osim
from gaitcal.compare.peer_model import PeerModel
from gaitcal.errors import InputError
from gaitcal.model.inertial_parameters import MASSIVE_SEGMENTS, table
from gaitcal.model.linkage import SEGMENTS, SIDES
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.rigid import rigid_distances, rigid_fit

Array = NDArray[np.float64]

DIRECTIONS = ("ant", "sup", "lat")


@dataclass(frozen=True)
class ComparisonRow:
    """One quantity in both models."""

    quantity: str
    unit: str
    """mm, deg, kg, or 1 for a count."""
    ours: float
    theirs: float
    difference: float
    """theirs - ours."""


@dataclass(frozen=True)
class _Registration:
    """How well a peer's body could be laid on our segment."""

    segment: str
    markers: int
    """Our markers on the segment."""
    common: int
    pose: pin.SE3 | None
    """Of the peer's body in our segment frame; None with fewer than three common markers, or all on one line."""
    rms: float
    """m, of the marker distances that remain."""


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
        bodies = leg_bodies(peer, side)
        registered = [_register(model, peer, segment, body) for segment, body in bodies.items()]
        poses = {r.segment: r.pose for r in registered if r.pose is not None}
        rows += _leg_rows(side, our_leg(model.parameters, side), peer_leg(peer, side, poses))
        for r in registered:
            if side == SIDES[0] or r.segment != "pelvis":
                rows += _registration_rows(r)
    rows += _mass_rows(model, peer)
    if not rows:
        raise InputError(
            "has neither hip_flexion_r, knee_angle_r, ankle_angle_r (or _l) nor a body with a known name such as "
            f"pelvis, femur_r, tibia_r; found the bodies {', '.join(peer.masses)}",
            source=osim,
        )
    return rows


def _row(quantity: str, unit: str, ours: float, theirs: float) -> ComparisonRow:
    return ComparisonRow(quantity, unit, float(ours) + 0.0, float(theirs) + 0.0, float(theirs - ours) + 0.0)


def _leg_rows(side: str, ours: LegGeometry, theirs: LegGeometry) -> list[ComparisonRow]:
    rows: list[ComparisonRow] = []
    lengths = (
        (f"thigh_{side} length, hip centre to knee centre", ours.thigh_length, theirs.thigh_length),
        (f"shank_{side} length, knee centre to talocrural centre", ours.shank_length, theirs.shank_length),
        (f"talocrural_{side} to subtalar_{side} axis", ours.ankle_axes_distance, theirs.ankle_axes_distance),
    )
    for quantity, a, b in lengths:
        if a is not None and b is not None:
            rows.append(_row(quantity, "mm", 1e3 * a, 1e3 * b))
    points = (
        (f"hip_{side} centre in pelvis", ours.hip_in_pelvis, theirs.hip_in_pelvis),
        (f"hip_{side} centre in thigh_{side}", ours.hip_in_thigh, theirs.hip_in_thigh),
    )
    for quantity, p, o in points:
        if p is not None and o is not None:
            rows += [_row(f"{quantity}, {d}", "mm", 1e3 * p[i], 1e3 * o[i]) for i, d in enumerate(DIRECTIONS)]
    axes = (
        (f"knee_{side} axis in thigh_{side}", ours.knee_in_thigh, theirs.knee_in_thigh),
        (f"knee_{side} axis in shank_{side}", ours.knee_in_shank, theirs.knee_in_shank),
        (f"talocrural_{side} axis in shank_{side}", ours.ankle_in_shank, theirs.ankle_in_shank),
    )
    for quantity, u, v in axes:
        if u is not None and v is not None:
            rows += _flexion_axis_rows(quantity, u, v)
    if ours.subtalar_in_foot is not None and theirs.subtalar_in_foot is not None:
        both = [_inversion_angles(axis) for axis in (ours.subtalar_in_foot, theirs.subtalar_in_foot)]
        rows += [
            _row(f"subtalar_{side} axis in foot_{side}, {d}", "deg", both[0][i], both[1][i])
            for i, d in enumerate(("trans", "sag"))
        ]
    return rows


def _flexion_axis_rows(quantity: str, ours: Axis, theirs: Axis) -> list[ComparisonRow]:
    p, o = ours.crossing(2), theirs.crossing(2)
    rows = [_row(f"{quantity}, {d}", "mm", 1e3 * p[i], 1e3 * o[i]) for i, d in enumerate(DIRECTIONS[:2])]
    both = [_flexion_angles(axis) for axis in (ours, theirs)]
    return rows + [_row(f"{quantity}, {d}", "deg", both[0][i], both[1][i]) for i, d in enumerate(("front", "trans"))]


def _flexion_angles(axis: Axis) -> tuple[float, float]:
    x, y, z = axis.direction
    return float(np.degrees(np.arctan2(-y, z))), float(np.degrees(np.arcsin(np.clip(x, -1.0, 1.0))))


def _inversion_angles(axis: Axis) -> tuple[float, float]:
    x, y, z = axis.direction
    return float(np.degrees(np.arctan2(-z, x))), float(np.degrees(np.arcsin(np.clip(y, -1.0, 1.0))))


def _register(model: SubjectModel, peer: PeerModel, segment: str, body: str) -> _Registration:
    markers = model.markers
    local, target = [], []
    own = [i for i, s in enumerate(markers.segments) if s == segment]
    for i in own:
        label = same_label(markers.labels[i], tuple(peer.markers))
        at, position = peer.markers[label] if label is not None else ("", np.zeros(3))
        if segment_of(at) == segment and moves_with_segment(at) and peer.is_below(at, body):
            local.append(peer.body_pose(at, body).act(position))
            target.append(markers.local[i])
    if len(local) < 3:
        return _Registration(segment, len(own), len(local), None, 0.0)
    shared = np.array(local), np.array(target)[:, :, None], np.ones((len(local), 1))
    fit = rigid_fit(*shared)
    pose = pin.SE3(fit.rotation[0], fit.origin[0]) if fit.determined[0] else None
    return _Registration(segment, len(own), len(local), pose, float(np.sqrt(np.mean(rigid_distances(*shared) ** 2))))


def _registration_rows(r: _Registration) -> list[ComparisonRow]:
    rows = [_row(f"{r.segment} markers, and how many the peer shares", "1", r.markers, r.common)]
    if r.pose is not None:
        rows.append(_row(f"{r.segment} shared markers, RMS distance after registration", "mm", 0.0, 1e3 * r.rms))
    return rows


def _mass_rows(model: SubjectModel, peer: PeerModel) -> list[ComparisonRow]:
    theirs: dict[str, float] = {}
    for body, mass in peer.masses.items():
        segment = segment_of(body)
        if segment is not None:
            theirs[segment] = theirs.get(segment, 0.0) + mass
    if not theirs:
        return []
    ours = dict(zip(MASSIVE_SEGMENTS, table(model.parameters.inertial)[:, 0], strict=True))
    rows = []
    armless = "head_trunk" in theirs and not any(arm in theirs for arm in ARMS)
    for segment in MASSIVE_SEGMENTS:
        if segment == "head_trunk" and armless:
            whole = ours[segment] + sum(ours[arm] for arm in ARMS)
            rows.append(_row("head_trunk and arms mass", "kg", whole, theirs[segment]))
        elif segment in theirs:
            rows.append(_row(f"{segment} mass", "kg", ours[segment], theirs[segment]))
    rows.append(_row("total mass", "kg", model.parameters.mass, sum(peer.masses.values())))
    return rows


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
    if body in _MIDDLE:
        return _MIDDLE[body]
    stem, _, side = body.rpartition("_")
    if side in SIDES and stem in _SIDED:
        return f"{_SIDED[stem]}_{side}"
    return body if body in SEGMENTS else None


def moves_with_segment(body: str) -> bool:
    """Whether a marker on this body may stand for its segment."""
    return body not in _SLIDING


def same_label(label: str, candidates: tuple[str, ...]) -> str | None:
    """The candidate with this name; else the only one that is the same but for case and punctuation; else None."""
    if label in candidates:
        return label
    plain = _plain(label)
    alike = [c for c in candidates if _plain(c) == plain]
    return alike[0] if len(alike) == 1 and plain else None


def _plain(label: str) -> str:
    return "".join(c for c in label.casefold() if c.isalnum())
