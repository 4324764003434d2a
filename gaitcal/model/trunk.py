"""The trunk in the static posture and the shoulders on it, from whatever landmarks there are.

    origin  lumbar joint L
    y       unit(S - L), S the middle of the shoulder centres
    z       to the right: the line of the acromia, else the normal n of the plane of the midline landmarks (C7, T10,
            jugular notch, xiphoid; the sagittal plane of Wu et al., J Biomech 38:981-992, 2005), else the pelvis's
            lateral direction made horizontal; each across y

The shoulder centres lie, by what is known of the person,

1. below both acromia, by 17 % of their distance along y (Rab, Petuskey and Bagley 2002);
2. the same with one acromion and its mirror image across the sagittal plane, whose normal is z as above;
3. beside S = M - a y, M the middle of C7 and jugular notch, a the height of M above the shoulders in de Leva's
   table (mean of CERV-MIDS and SUPR-MIDS: 52 mm in men, 74 mm in women, in proportion to height), each half the
   nominal subject's shoulder width from it, in proportion to height;
4. straight above the lumbar joint as the person stands, at the nominal subject's height and width.

Only 1 and 2 are measured. How the trunk then moves is what its markers say, however few (`motion/undetermined.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.anthropometry import default_length
from gaitcal.model.knee_and_ankle import NOMINAL_HEIGHT, SIDE_WORDS
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import SIDES
from gaitcal.model.marker_roles import MarkerSet
from gaitcal.model.segment_frames import Frame, across, frame_yz, sign, unit
from gaitcal.model.subject_model import Subject

IN_A_PLANE = 3
"""Landmarks that a plane goes through."""
OFF_LINE = 0.020
"""m, RMS distance of these markers from the straight line that is nearest to them. Skin that moves by 5 mm turns
markers which are nearer to one line by more than 15 degrees about it."""
TWISTED = np.deg2rad(30.0)
"""More than this between the plane of the midline landmarks and the pelvis's sagittal plane, and one is mislabelled."""
SHOULDER_BELOW_ACROMION = 0.17
"""Of the distance between the acromia, along the trunk: Rab, Petuskey and Bagley, Gait & Posture 15 (2002)."""
SHOULDER_UP, SHOULDER_OUT = 0.3519, 0.165
"""m from the lumbar joint in the nominal subject."""
_WORDS = {"c7": "C7", "t10": "T10", "jugular_notch": "jugular notch", "xiphoid": "xiphoid"}
MIDLINE = tuple(_WORDS)
"""Landmarks in the trunk's sagittal plane."""
_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, kw_only=True)
class Trunk:
    """Head and trunk in the static posture, laboratory."""

    frame: Frame
    shoulders: dict[str, Array]
    """`sjc_r`, `sjc_l`: (3,) m."""
    seen: bool
    """Whether any marker with weight shows it."""
    notes: tuple[str, ...]


def trunk_of(posture: StaticPosture, marker_set: MarkerSet, pelvis: Frame, lumbar: Array, subject: Subject) -> Trunk:
    """The trunk as its landmarks show it, or upright on the pelvis.

    Parameters
    ----------
    pelvis, lumbar : frame of the pelvis and (3,) m lumbar joint in the static posture.
    subject : whose height and sex give the proportions where no acromion is known.
    """
    seen = any(m in posture.markers and marker_set.weight(m) > 0 for m in marker_set.tracking.get("head_trunk", ()))
    shoulders, z, notes = _shoulders(posture, pelvis, lumbar, subject)
    y = unit(0.5 * (shoulders["sjc_r"] + shoulders["sjc_l"]) - lumbar)
    if not seen:
        notes = ("head and trunk are taken to stand upright, as no marker with weight shows them",)
    return Trunk(frame=frame_yz(lumbar, y, z), shoulders=shoulders, seen=seen, notes=notes)


def spread_off_line(points: Array) -> float:
    """RMS distance (m) of points (n, 3) from the straight line nearest to them."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(np.sqrt((values[1:] ** 2).sum() / len(points)))


def _shoulders(
    posture: StaticPosture, pelvis: Frame, lumbar: Array, subject: Subject
) -> tuple[dict[str, Array], Array, tuple[str, ...]]:
    """Shoulder centres, (3,) the direction that z is taken from, and what was assumed."""
    p = posture.landmarks
    known = [side for side in SIDES if posture.has(f"acromion_{side}")]
    if len(known) == len(SIDES):
        right, left = p["acromion_r"], p["acromion_l"]
        notes = ("shoulder centres 17 % of the distance between the acromia below them (Rab 2002)",)
        return _below(right, left, lumbar), right - left, notes
    z, told = _lateral(posture, pelvis)
    if known:
        side, other = known[0], next(s for s in SIDES if s != known[0])
        middle = [p[name] for name in MIDLINE if posture.has(name)] or [lumbar]
        acromion = p[f"acromion_{side}"]
        mirrored = acromion - 2.0 * float((acromion - np.mean(middle, axis=0)) @ z) * z
        right, left = (acromion, mirrored) if side == "r" else (mirrored, acromion)
        why = f"acromion, {SIDE_WORDS[other]}: {posture.why_not(f'acromion_{other}')}"
        note = f"{why}; taken as the mirror image of the other across the {told}"
        return _below(right, left, lumbar), right - left, (note,)
    if posture.has("c7", "jugular_notch"):
        middle_of_neck = 0.5 * (p["c7"] + p["jugular_notch"])
        down = neck_above_shoulders(subject)
        centre = middle_of_neck - down * unit(middle_of_neck - lumbar)
        out = SHOULDER_OUT / NOMINAL_HEIGHT * subject.height
        sideways = across(z, unit(centre - lumbar))
        note = (
            f"no acromion is known: shoulder centres {1e3 * down:.0f} mm below the middle of C7 and jugular notch "
            f"(de Leva 1996) and {1e3 * out:.0f} mm beside it (nominal subject), both in proportion to height; the "
            f"trunk faces along the {told}"
        )
        return {f"sjc_{side}": centre + sign(side) * out * sideways for side in SIDES}, z, (note,)
    note = (
        "neither acromia nor both C7 and jugular notch are known: shoulder centres straight above the lumbar joint in "
        f"the static trial, as in the nominal subject, in proportion to height; the trunk faces along the {told}"
    )
    return _above(lumbar, _horizontal(z), subject.height), z, (note,)


def neck_above_shoulders(subject: Subject) -> float:
    """Height (m) of the middle of cervicale and suprasternale above that of the shoulder centres, along the trunk."""
    whole = [default_length(name, subject) for name in ("Trunk", "Trunk2")]
    return float(np.mean(whole)) - default_length("Trunk3", subject)


def _lateral(posture: StaticPosture, pelvis: Frame) -> tuple[Array, str]:
    """(3,) unit vector to the trunk's right, and the plane that it is the normal of, in words."""
    of_pelvis = _horizontal(pelvis.rotation[:, 2])
    there = [name for name in MIDLINE if posture.has(name)]
    points = np.array([posture.landmarks[name] for name in there])
    if len(there) < IN_A_PLANE or spread_off_line(points) < OFF_LINE:
        return of_pelvis, "pelvis's sagittal plane"
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    normal = normal if normal @ of_pelvis > 0 else -normal
    angle = float(np.arccos(np.clip(normal @ of_pelvis, -1.0, 1.0)))
    names = ", ".join(_WORDS[name] for name in there)
    if angle > TWISTED:
        return of_pelvis, (
            f"pelvis's sagittal plane (that of {names} is turned by {np.rad2deg(angle):.0f} deg against it, more than "
            f"{np.rad2deg(TWISTED):.0f} deg: one of them is not where its name says)"
        )
    return normal, f"plane of {names}"


def _below(right: Array, left: Array, lumbar: Array) -> dict[str, Array]:
    """Shoulder centres below the acromia, each (3,) m."""
    down = -SHOULDER_BELOW_ACROMION * float(np.linalg.norm(right - left)) * unit(0.5 * (right + left) - lumbar)
    return {"sjc_r": right + down, "sjc_l": left + down}


def _above(lumbar: Array, sideways: Array, height: float) -> dict[str, Array]:
    """The nominal subject's shoulder centres straight above the lumbar joint; `sideways` (3,) horizontal."""
    scale = height / NOMINAL_HEIGHT
    above = lumbar + scale * SHOULDER_UP * _UP
    return {f"sjc_{side}": above + sign(side) * scale * SHOULDER_OUT * sideways for side in SIDES}


def _horizontal(direction: Array) -> Array:
    return unit(direction - (direction @ _UP) * _UP)
