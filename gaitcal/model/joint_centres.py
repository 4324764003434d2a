"""Where the nominal hip centres lie: by a regression from the pelvis's landmarks, or as the file has them.

In the pelvis frame (origin midway between the ASIS, x forward, y up, z to the right), right side; PW is the distance
between the two ASIS, PD that from their middle to the middle of the two PSIS (or the one sacral marker between them):

    Bell        x = -0.193 PW            y = -0.304 PW             z = 0.359 PW
    OrthoTrak   x = -0.22 PW             y = -0.34 PW              z = 0.32 PW
    Harrington  x = -0.24 PD - 9.9 mm    y = -0.30 PW - 10.9 mm    z = 0.33 PW + 7.3 mm

Bell, Pedersen and Brand, J Biomech 23:617-621, 1990, as Reinbolt et al. 2007 quote them; OrthoTrak as deduced from the
differences that the latter print in Table II; Harrington, Zavatsky, Lawson, Yuan and Theologis, J Biomech 40:595-602,
2007, from magnetic resonance images of 8 adults, 14 children and 10 children with cerebral palsy.

Harrington's is the one to start with: of the regressions held against images it is nearest (12 mm in 67 adults by
computed tomography, Mantovani, Ng and Lamontagne, Gait Posture 44:48-54, 2016; nearest of all in adults and in
children with cerebral palsy by ultrasound, Sangeux, Peters and Baker, Gait Posture 34:324-328, 2011 and 40:20-25, 2014,
and Peters, Baker, Morris and Sangeux, Gait Posture 36:282-286, 2012), and children are among its own people. PD is a
distance of marker centres, and so is PW unless somebody measured it by hand, between the bones: soft tissue holds the
markers of stout people apart, and Plug-in Gait takes the measured one (its `InterAsisDistance`), too. The radius and
the skin beneath the markers are not taken off: with a radius of 7 mm hips would lie 4 mm further back, and hips that
move in isolated trials do not say so. OrthoTrak's factors are for markers.

Centres and axes of knee and ankle in the static posture (laboratory), from the best that the trial has.

In order of preference: the middle between the lateral and the medial marker; a knee alignment device, whose rod has the
direction of the knee's axis; neither, and then the direction comes from the segment above: the pelvis's z for the knee,
the knee's z turned outwards by the tibial torsion for the ankle. Without a medial marker the centre C lies h inwards of
the lateral marker M along z, where z is the part of that direction across the line from C to the joint above:

    C = M -+ h z(C),      h = width / 2 + radius of the marker,

the width as measured by hand, else h in proportion to height. For the knee this is the `chord` of Davis et al. 1991.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.model.chain import axis_rotation
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import Subject


class HipCentre(Enum):
    """Where the nominal hip centre comes from."""

    BELL = "bell"
    ORTHOTRAK = "orthotrak"
    HARRINGTON = "harrington"
    GIVEN = "given"
    """Points of the static trial that are hip centres."""


_FRACTIONS = {HipCentre.BELL: (-0.193, -0.304, 0.359), HipCentre.ORTHOTRAK: (-0.22, -0.34, 0.32)}
_HARRINGTON = ((-0.24, -0.0099), (-0.30, -0.0109), (0.33, 0.0073))
"""Factor and constant (m) of x (by PD), y and z (by PW)."""
_PRINTED = {HipCentre.BELL: "Bell 1990", HipCentre.ORTHOTRAK: "OrthoTrak", HipCentre.HARRINGTON: "Harrington 2007"}
FARTHEST_GIVEN = 0.40
"""Share of the distance between the ASIS by which a given hip centre may lie off Harrington's. The regression misses
hips by some 5 %, of the people here by 12 % at worst; the other side's hip lies 75 % away."""
DOUBTED_GIVEN, UNEVEN_GIVEN = 0.22, 0.15
"""The same from which given hips are doubted, as Plug-in Gait's own lie up to 15 % off Harrington's; and how far the
two may be from mirror images of each other."""
PLAUSIBLE_SHARE = (0.6, 1.1)
"""Allowed distance between the ASIS as measured by hand over that between their markers: 0.86 to 1.00 of seven people;
less of stout ones, and hardly more, as bones lie inside of the skin."""


@dataclass(frozen=True)
class PelvicWidth:
    """The distance between the two ASIS, m."""

    markers: float
    """Between the centres of their markers."""
    measured: float | None = None
    """By hand; None where nobody told."""

    @property
    def is_plausible(self) -> bool:
        """Whether there is a measured distance that can belong to these markers."""
        return self.measured is not None and PLAUSIBLE_SHARE[0] <= self.measured / self.markers <= PLAUSIBLE_SHARE[1]

    def of(self, rule: HipCentre) -> float:
        """PW of a regression."""
        if self.measured is None or not self.is_plausible or rule is HipCentre.ORTHOTRAK:
            return self.markers
        return self.measured

    def words(self, rule: HipCentre) -> str:
        """Which is taken, and what speaks against it."""
        taken, markers = f"{1e3 * self.of(rule):.0f} mm between the ASIS", f"{1e3 * self.markers:.0f} mm"
        if self.measured is None:
            return taken
        if not self.is_plausible:
            low, high = PLAUSIBLE_SHARE
            return (
                f"{taken} (between their markers; the measured {1e3 * self.measured:.0f} mm are not used: allowed: "
                f"{low:g} to {high:g} times that)"
            )
        if rule is HipCentre.ORTHOTRAK:
            return f"{taken} (between their markers, which it is made for; measured {1e3 * self.measured:.0f} mm)"
        return f"{taken} (as measured by hand; {markers} between their markers)"


def hip_centre(rule: HipCentre, asis_distance: float, pelvic_depth: float, side: str) -> Array:
    """(3,) m, hip centre in the pelvis frame by a regression.

    Parameters
    ----------
    asis_distance : PW, m.
    pelvic_depth : PD, m.
    """
    if rule is HipCentre.HARRINGTON:
        sizes = (pelvic_depth, asis_distance, asis_distance)
        ant, sup, lat = (factor * size + more for (factor, more), size in zip(_HARRINGTON, sizes, strict=True))
    else:
        ant, sup, lat = asis_distance * np.array(_FRACTIONS[rule])
    return np.array([ant, sup, lat if side == "r" else -lat])


def regression_note(rule: HipCentre, width: PelvicWidth, pelvic_depth: float) -> str:
    """What the notes say of nominal hip centres by a regression."""
    depth = f" and {1e3 * pelvic_depth:.0f} mm from their middle to the sacral markers"
    return (
        f"hip centres by the {_PRINTED[rule]} regression from {width.words(rule)}"
        f"{depth if rule is HipCentre.HARRINGTON else ''}"
    )


def given_hips(posture: StaticPosture, regression: Mapping[str, Array], asis_distance: float) -> Mapping[str, Array]:
    """Side -> (3,) m in the laboratory: the hip centres that the static trial itself has.

    `regression`: the same by Harrington's equations, from which they may not lie too far.

    Raises
    ------
    InputError
        There are none; or one lies where no hip can be, as when the sides are exchanged.
    """
    missing = [f"hjc_{side}" for side in SIDES if side not in posture.hips]
    if missing:
        raise InputError(
            f"the static trial has no hip centre {' and '.join(missing)}; allowed: markers or computed "
            "points called RHJC, LHJC (R_HJC, RHJ, ...), landmarks hjc_r and hjc_l of the marker set, or another "
            "hip_centre",
            source=posture.source,
            field="calibration.hip_centre = 'given'",
            code=Code.GIVEN_BY_FILE,
        )
    for side in SIDES:
        gap = float(np.linalg.norm(posture.hips[side] - regression[side]))
        if gap > FARTHEST_GIVEN * asis_distance:
            raise InputError(
                f"found it {1e3 * gap:.0f} mm from where the pelvis's markers tell; allowed: at most "
                f"{1e3 * FARTHEST_GIVEN * asis_distance:.0f} mm; are the sides exchanged?",
                source=posture.source,
                field=f"hip centre {posture.hip_labels[side]}",
                code=Code.GIVEN_BY_FILE,
            )
    return posture.hips


def given_note(posture: StaticPosture, regression: Mapping[str, Array]) -> str:
    """That the hip centres are those of the file, and how far they lie from Harrington's."""
    gaps = ", ".join(
        f"{posture.hip_labels[s]} {1e3 * np.linalg.norm(posture.hips[s] - regression[s]):.0f} mm" for s in SIDES
    )
    return f"hip centres are points of the file, this far from where Harrington 2007 has them: {gaps}"


def offer_note(posture: StaticPosture, used: Mapping[str, Array]) -> list[str]:
    """That the static trial has hip centres which are not used, and how far they are from those that are."""
    if not all(side in posture.hips for side in SIDES):
        return []
    gaps = ", ".join(f"{1e3 * np.linalg.norm(posture.hips[s] - used[s]):.0f} mm ({s})" for s in SIDES)
    labels = ", ".join(posture.hip_labels[s] for s in SIDES)
    return [f"the static trial has hip centres {labels}, {gaps} from these; hip_centre = 'given' takes them instead"]


NOMINAL_HEIGHT = 1.70
"""m; joint widths below are the nominal subject's, between marker centres, and go with height."""
SIDE_WORDS = {"r": "right", "l": "left"}
WIDTH = {"knee": 0.1118, "ankle": 0.0852, "elbow": 0.080}
MARKER_DIAMETER_M = 0.014
"""m, of the markers of most clinics, where nothing tells."""
PLAUSIBLE_WIDTH = (0.5, 1.8)
"""Allowed measured width as a multiple of that in proportion to height; a width outside of it is a slip of the pen."""
TIBIAL_TORSION = np.deg2rad(5.0)
"""The malleolar line is turned outwards by this much against the epicondylar one."""
SETTLED, ROUNDS = 1e-15, 200
"""m or share of height by which a joint centre moves at most in the last round of a fixed-point iteration."""


def half_width(joint: str, height: float) -> float:
    """Distance (m) from a lateral marker's centre to the middle of the joint, for a person of this height (m)."""
    return 0.5 * WIDTH[joint] * height / NOMINAL_HEIGHT


@dataclass(frozen=True)
class JointWidths:
    """How far inwards of their lateral markers knees and ankles have their centres."""

    height: float
    """m."""
    measured: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """(`knee` or `ankle`, side) -> m across the joint."""
    marker_diameter: float | None = None
    """m; None where nobody told."""
    asis_distance: float | None = None
    """m between the ASIS, measured by hand, for the hips (`hip_centre.py`); None where nobody told."""

    @classmethod
    def of(cls, subject: Subject) -> JointWidths:
        """Those of a person."""
        widths = {"knee": subject.knee_width, "ankle": subject.ankle_width}
        measured = {(joint, side): width for joint, by_side in widths.items() for side, width in by_side.items()}
        return cls(subject.height, measured, subject.marker_diameter, subject.asis_distance)

    @property
    def marker_radius(self) -> float:
        """M."""
        return 0.5 * (MARKER_DIAMETER_M if self.marker_diameter is None else self.marker_diameter)

    def is_measured(self, joint: str, side: str) -> bool:
        """Whether there is a measured width that a person can have."""
        width = self.measured.get((joint, side))
        low, high = PLAUSIBLE_WIDTH
        return width is not None and low <= width / (2.0 * half_width(joint, self.height)) <= high

    def inwards(self, joint: str, side: str) -> float:
        """m, from the lateral marker's centre to that of the joint."""
        if self.is_measured(joint, side):
            return 0.5 * self.measured[joint, side] + self.marker_radius
        return half_width(joint, self.height)


def joint_centre(
    posture: StaticPosture, joint: str, side: str, above: Array, z_above: Array, turn: float, widths: JointWidths
) -> tuple[Array, Array]:
    """Joint centre (3,) m, and the direction (3,) its segment's z is taken from, to the right.

    `above`: (3,) m, centre of the joint above; `z_above`: (3,) direction to fall back on, turned by `turn` rad.
    """
    lateral = posture.landmarks[f"{joint}_lat_{side}"]
    s = 1.0 if side == "r" else -1.0
    if posture.has(f"{joint}_med_{side}"):
        medial = posture.landmarks[f"{joint}_med_{side}"]
        return 0.5 * (lateral + medial), s * (lateral - medial)
    if posture.has(f"{joint}_axis_{side}"):
        z_above, turn = s * (posture.landmarks[f"{joint}_axis_{side}"] - lateral), 0.0
    inwards = s * widths.inwards(joint, side)
    centre, z = lateral, z_above
    for _ in range(ROUNDS):
        before = centre
        z = _across(above - centre, z_above) @ axis_rotation(1, turn)[:, 2]
        centre = lateral - inwards * z
        if np.abs(centre - before).max() <= SETTLED * widths.height:
            break
    return centre, z


def _across(y: Array, towards_z: Array) -> Array:
    """(3, 3) axes with this direction of y whose z is nearest to another direction."""
    y = y / np.linalg.norm(y)
    z = towards_z - (towards_z @ y) * y
    z = z / np.linalg.norm(z)
    return np.column_stack([np.cross(y, z), y, z])


def centre_notes(posture: StaticPosture, widths: JointWidths) -> list[str]:
    """How the centres and axes were found that no medial marker shows; a width that no person has."""
    notes: list[str] = []
    for joint in ("knee", "ankle"):
        sides = [side for side in SIDES if not posture.has(f"{joint}_med_{side}")]
        told = {side: (_place(joint, side, widths), _axis(posture, joint, side)) for side in sides}
        for words in dict.fromkeys(told.values()):
            same = [side for side in sides if told[side] == words]
            where = "both sides" if len(same) == 2 else SIDE_WORDS[same[0]]
            notes.append(f"{joint}, {where}: no medial marker; its centre is assumed {words[0]}, and {words[1]}")
    for (joint, side), width in widths.measured.items():
        if not widths.is_measured(joint, side):
            usual = 2e3 * half_width(joint, widths.height)
            notes.append(
                f"{joint}, {SIDE_WORDS[side]}: a width of {1e3 * width:.0f} mm is not used: found, that is, "
                f"{1e3 * width / usual:.1f} times the {usual:.0f} mm of a person of this height; allowed: "
                f"{PLAUSIBLE_WIDTH[0]:g} to {PLAUSIBLE_WIDTH[1]:g} times"
            )
    return notes


def _place(joint: str, side: str, widths: JointWidths) -> str:
    inwards = f"{1e3 * widths.inwards(joint, side):.1f} mm inwards of the lateral marker's"
    if not widths.is_measured(joint, side):
        return f"{inwards}, in proportion to height"
    assumed = "" if widths.marker_diameter is not None else " (assumed: nothing tells it)"
    width, diameter = 1e3 * widths.measured[joint, side], 2e3 * widths.marker_radius
    return f"{inwards}: half of the measured {width:.0f} mm and of the marker's {diameter:.0f} mm{assumed}"


def _axis(posture: StaticPosture, joint: str, side: str) -> str:
    if posture.has(f"{joint}_axis_{side}"):
        return "its axis is that of the knee alignment device, across the thigh"
    if joint == "knee":
        return "its axis is the pelvis's lateral direction across the thigh in the static posture"
    return f"a tibial torsion of {np.rad2deg(TIBIAL_TORSION):.0f} deg is assumed"
