"""Coordinates that the markers of a trial do not determine, and what is known of them besides.

A segment is determined by itself where three of its markers pull in half of the frames and do not lie on one line. Of
every other segment, and of all that have no marker, the coordinates of the joint before it are asked: with H_f the
Gauss-Newton matrix of frame f, every marker that pulls counting as much, errors of 5 mm leave them uncertain by

    s_f^2 = diag( (H_f / MARKER_M^2 + 1 / WIDEST^2)^-1 ),

and a coordinate whose median s_f is above its standard deviation here gets that as a normal prior
(`coordinate_prior.py`): there one frame's markers know less than is known without them. All others get none, as a
prior on angles that markers determine only biases them. Markers of the arms pull on the trunk as on all before them,
but do not count for it: shoulders move against it by centimetres, as the model's do not.

The centre of arms and legs is the static posture, or an arm that hangs along the trunk. The centre of the lumbar joint
is the course that keeps the trunk as it was in the static trial, in the laboratory, while the pelvis moves: with R_p
the pelvis, R_0 the trunk of the static trial with its heading taken off, and psi the heading of the pelvis without
its swing (local straight lines through it, Gaussian weights of 0.35 s, which leave 9 % of what repeats once a second)

    Rz(extension) Rx(bending) Ry(rotation) = R_p^T Ry(psi) R_0.

The pelvis is not pulled by it: the course is found from a motion, and found again where the motion has moved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.chain import root_angles
from gaitcal.model.coordinates import COORDINATE_TABLE, with_side
from gaitcal.model.linkage import JOINT_OF_CHILD, JOINTS, SIDES, Source, segment_kind
from gaitcal.model.trunk import OFF_LINE, spread_off_line
from gaitcal.motion.coordinate_prior import MARKER_M, CoordinatePrior
from gaitcal.motion.rigid import FEWEST_MARKERS

DEVIATION: Mapping[str, float] = {
    with_side(row.name, side): row.spread for side in SIDES for row in COORDINATE_TABLE.values() if row.spread
}
"""Coordinate -> deg."""
POSES = 20
"""Frames that are asked."""
WIDEST = 1.0
"""rad, m: how far a coordinate that nothing tells may be off."""
PULLS = 0.5
"""Share of the frames in which a marker must pull to count."""
LUMBAR = ("lumbar_extension", "lumbar_bending", "lumbar_rotation")
HEADING_S = 0.35
"""s, standard deviation of the weights that smooth the heading."""


def coordinates_asked(
    segments: Sequence[str], of_marker: Sequence[str], local: Array, pulls: BoolArray
) -> tuple[str, ...]:
    """Coordinates before segments that are not determined by themselves, and that something is known of.

    `segments`: of the part that moves, its root first. `of_marker` (nm,) their segments, `local` (nm, 3) m their
    places, `pulls` (nm, nf) whether they are seen with weight.
    """
    counts = pulls.mean(axis=1) >= PULLS
    names = np.array(of_marker, dtype=object)
    asked: list[str] = []
    turns: list[str] = []
    for segment in segments[1:]:
        turns += [e.name for e in JOINT_OF_CHILD[segment].elements if e.source is Source.COORDINATE]
        if not segment_kind(segment).markers:
            continue  # no marker sits on it: its joint is the foot's
        own = local[counts & (names == segment)]
        if len(own) < FEWEST_MARKERS or spread_off_line(own) < OFF_LINE:
            asked += [name for name in turns if name in DEVIATION]
        turns = []
    return tuple(asked)


def undetermined(asked: Sequence[str], coordinates: tuple[str, ...], hessians: Array) -> tuple[str, ...]:
    """Those of the coordinates `asked` that frames with Gauss-Newton matrices (nf, nq, nq), m^2, leave uncertain."""
    inverse = np.linalg.inv(hessians / MARKER_M**2 + np.eye(len(coordinates)) / WIDEST**2)
    s = np.sqrt(np.median(np.diagonal(inverse, axis1=1, axis2=2), axis=0))
    return tuple(name for name in asked if s[coordinates.index(name)] > np.deg2rad(DEVIATION[name]))


def joints_left_open(guessed: Sequence[str]) -> frozenset[str]:
    """The joints of some coordinates: where a prior holds the angle, markers do not tell where the joint lies."""
    return frozenset(joint.name for joint in JOINTS if {e.name for e in joint.elements} & set(guessed))


def about_posture(names: tuple[str, ...], posture: Mapping[str, float]) -> CoordinatePrior:
    """Normal priors about the static posture (coordinate -> rad; what it lacks is zero)."""
    centre = np.array([[posture.get(name, 0.0) for name in names]])
    scale = np.deg2rad([DEVIATION[name] for name in names])
    return CoordinatePrior(names=names, time=np.zeros(1), low=centre, high=centre, scale=scale)


def upright_trunk(time: Array, pelvis: Array, posture: Mapping[str, float]) -> Array:
    """(nf, 3) rad, lumbar coordinates that keep the trunk of a static posture in the laboratory.

    `pelvis`: (nf, 3) rad, tilt, list and rotation.
    """
    standing, lumbar = (
        _rotation(np.array([[posture.get(name, 0.0) for name in names]]))[0]
        for names in (("pelvis_tilt", "pelvis_list", "pelvis_rotation"), LUMBAR)
    )
    turned = _rotation(pelvis)
    away = _smooth(time, np.unwrap(_heading(turned))) - _heading(standing[None])
    zero = np.zeros_like(away)
    kept = _rotation(np.stack([zero, zero, away], axis=1)) @ (standing @ lumbar)
    return np.unwrap(root_angles(turned.transpose(0, 2, 1) @ kept), axis=0)


def _rotation(angles: Array) -> Array:
    """(nf, 3, 3) Rz(a) Rx(b) Ry(c) of angles (nf, 3)."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [ca * cc - sa * sb * sc, -sa * cb, ca * sc + sa * sb * cc],
        [sa * cc + ca * sb * sc, ca * cb, sa * sc - ca * sb * cc],
        [-cb * sc, sb, cb * cc],
    ]
    return np.array(rows).transpose(2, 0, 1)


def _heading(rotation: Array) -> Array:
    """(nf,) rad, turn about the vertical of where x points."""
    out: Array = np.arctan2(-rotation[:, 2, 0], rotation[:, 0, 0])
    return out


def _smooth(time: Array, angle: Array) -> Array:
    """(nf,) rad: at each time the line through its neighbours."""
    out = np.empty_like(angle)
    for k, now in enumerate(time):
        near = slice(*np.searchsorted(time, [now - 4 * HEADING_S, now + 4 * HEADING_S]))
        away = time[near] - now
        weight = np.exp(-0.5 * (away / HEADING_S) ** 2)
        weight /= weight.sum()
        mean = float(weight @ away)
        spread = float(weight @ (away - mean) ** 2)
        slope = float((weight * (away - mean)) @ angle[near]) / spread if spread > 0 else 0.0
        out[k] = float(weight @ angle[near]) - slope * mean
    return out
