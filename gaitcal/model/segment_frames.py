"""Segment frames and joint centres of pelvis and legs in the static posture (laboratory).

Every frame is x anterior, y superior, z to the right. With unit(a) = a / |a| and a - (a.y) y the
part of a across y:

    pelvis   origin mid-ASIS; z = unit(R.ASIS - L.ASIS); y across z and the line to the
             sacrum; x = y x z
    thigh    origin hip centre; y = unit(HJC - KJC), KJC mid-epicondyles; z the epicondylar line
             across y
    shank    origin KJC; y = unit(KJC - AJC), AJC mid-malleoli; z the malleolar line across y
    foot     origin heel marker; x = unit(toe - heel); z = unit(x x y_shank); y = z x x  (OrthoTrak)

The lumbar joint is the nominal subject's, scaled by the distance between the two ASIS.

Hip centres, by a regression or as the file has them. In the pelvis frame, right side; PW is the
distance between the two ASIS, PD that from their middle to the middle of the two PSIS (or the one
sacral marker between them):

    Bell        x = -0.193 PW            y = -0.304 PW             z = 0.359 PW
    OrthoTrak   x = -0.22 PW             y = -0.34 PW              z = 0.32 PW
    Harrington  x = -0.24 PD - 9.9 mm    y = -0.30 PW - 10.9 mm    z = 0.33 PW + 7.3 mm

Bell, Pedersen and Brand, J Biomech 23:617-621, 1990, as Reinbolt et al. 2007 quote them; OrthoTrak
as deduced from the differences that the latter print in Table II; Harrington, Zavatsky, Lawson,
Yuan and Theologis, J Biomech 40:595-602, 2007, from magnetic resonance images of 8 adults, 14
children and 10 children with cerebral palsy: of the regressions held against images the nearest
(Mantovani, Ng and Lamontagne, Gait Posture 44:48-54, 2016; Sangeux, Peters and Baker, Gait Posture
34:324-328, 2011 and 40:20-25, 2014; Peters, Baker, Morris and Sangeux, Gait Posture 36:282-286,
2012). PD is a distance of marker centres, and so is PW unless somebody measured it by hand, between
the bones; OrthoTrak's factors are for markers. The radius and the skin beneath the markers are not
taken off.

Centres and axes of knee and ankle, in order of preference: the middle between the lateral and the
medial marker; a knee alignment device, whose rod has the direction of the knee's axis; neither, and
then the direction comes from the segment above: the pelvis's z for the knee, the knee's z turned
outwards by the tibial torsion for the ankle. Without a medial marker the centre C lies h inwards of
the lateral marker M along z, where z is the part of that direction across the line from C to the
joint above:

    C = M -+ h z(C),      h = width / 2 + radius of the marker,

the width as measured by hand, else h in proportion to height. For the knee this is the `chord` of
Davis et al. 1991.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, cross
from gaitcal.errors import Code, InputError
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import SIDE_WORDS, SIDES
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.model.subject_model import Subject

_NOMINAL_ASIS = 0.245  # m, of the nominal subject
_NOMINAL_LUMBAR = (-0.095, 0.077, 0.0)
"""m in its pelvis frame: about the third lumbar vertebra, as in Anderson and Pandy 1999."""
# m; joint widths below are the nominal subject's, between marker centres, and go with height
NOMINAL_HEIGHT = 1.70
WIDTH = {"knee": 0.1118, "ankle": 0.0852, "elbow": 0.080}
MARKER_DIAMETER_M = 0.014  # usual in clinics, assumed if not given
PLAUSIBLE_WIDTH = (0.5, 1.8)
"""Allowed measured width as a multiple of that in proportion to height; others are typing
errors.
"""
TIBIAL_TORSION = np.deg2rad(
    5.0
)  # the malleolar line is turned outwards by this much against the epicondylar one
SETTLED, ROUNDS = 1e-15, 200
"""m or share of height by which a joint centre moves at most in the last round of a fixed-point
iteration.
"""
FARTHEST_GIVEN = 0.40
"""Share of the distance between the ASIS by which a given hip centre may lie off Harrington's. The
regression misses hips by some 5 %, of the people here by 12 % at worst; the other side's hip lies
75 % away."""
DOUBTED_GIVEN, UNEVEN_GIVEN = 0.22, 0.15
"""The same from which given hips are doubted, as Plug-in Gait's hips are up to 15 % off
Harrington's; and how far the two may be from mirror images of each other."""
PLAUSIBLE_SHARE = (0.6, 1.1)
"""Allowed distance between the ASIS as measured by hand over that between their markers: 0.86 to
1.00 of seven people; less of stout ones, and hardly more, as bones lie inside of the skin."""


@dataclass(frozen=True)
class Frame:
    """A segment frame in the laboratory."""

    rotation: Array  # (3, 3), columns the axes
    origin: Array  # (3,) m

    def local(self, point: Array) -> Array:
        """Transform a point (3,) of the laboratory to coordinates of the segment, m."""
        return self.rotation.T @ (point - self.origin)

    def point(self, local: Array) -> Array:
        """Transform coordinates (3,) of the segment to a point of the laboratory, m."""
        return self.origin + self.rotation @ local


def normalise(a: Array) -> Array:
    """Normalise a vector to its direction."""
    return a / np.linalg.norm(a)


def project_across(a: Array, y: Array) -> Array:
    """Compute the direction of the part of `a` at right angles to the unit vector `y`."""
    return normalise(a - (a @ y) * y)


def build_frame(origin: Array, y: Array, towards_z: Array) -> Frame:
    """Build the frame with a given y axis whose z axis is nearest to a direction.

    Parameters
    ----------
    origin, y, towards_z : (3,) array
        Origin (m), unit y axis, and direction of z; laboratory.

    Returns
    -------
    Frame
        z is the part of `towards_z` at right angles to y.
    """
    z = project_across(towards_z, y)
    return Frame(np.column_stack([cross(y, z), y, z]), origin)


def build_pelvis_frame(right: Array, left: Array, sacrum: Array) -> Frame:
    """Build the frame of the pelvis from both ASIS and the sacrum (3,) m."""
    middle, z = 0.5 * (right + left), normalise(right - left)
    y = normalise(cross(z, middle - sacrum))
    return Frame(np.column_stack([cross(y, z), y, z]), middle)


def sign(side: str) -> float:
    """Return +1 for the right side, -1 for the left side."""
    return 1.0 if side == "r" else -1.0


def fit_rigid_motions(points: Array, paths: Array) -> tuple[Array, Array]:
    """Fit rigid motions to point paths (Kabsch 1976).

    Parameters
    ----------
    points : (n, 3) array
        Points of the rigid body, m.
    paths : (nf, n, 3) array
        Their measured positions, m.

    Returns
    -------
    tuple of array
        R (nf, 3, 3) and o (nf, 3) m with R points + o nearest to the paths.
    """
    middle, middles = points.mean(axis=0), paths.mean(axis=1)
    rotation = find_nearest_rotation(
        np.einsum("fni,nj->fij", paths - middles[:, None], points - middle)
    )
    return rotation, middles - rotation @ middle


def find_nearest_rotation(matrix: Array) -> Array:
    """Find the rotations nearest to matrices.

    Parameters
    ----------
    matrix : (..., 3, 3) array
        Any matrices.

    Returns
    -------
    (..., 3, 3) array
        Rotations with determinant 1.
    """
    u, _, vt = np.linalg.svd(matrix)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def compute_position_variance(points: Array, place: Array) -> float:
    """Compute the variance of a position that points carry rigidly, for variance one of each point.

    It is 1/n + trace([r] I^-1 [r]^T) / 3, with the inertia I of n unit masses at the points and r
    from their middle to the position.

    Parameters
    ----------
    points : (n, 3) array
        Points of the rigid body, m.
    place : (3,) array
        Position, m.

    Returns
    -------
    float
        Variance over that of a point.
    """
    away, (x, y, z) = points - points.mean(axis=0), place - points.mean(axis=0)
    inertia = np.eye(3) * (away**2).sum() - away.T @ away
    lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return 1.0 / len(points) + float(np.trace(lever @ np.linalg.pinv(inertia) @ lever.T)) / 3.0


def measure_distance_from_line(points: Array) -> float:
    """Measure the RMS distance (m) of points (n, 3) from the nearest line."""
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(np.sqrt((sizes[1:] ** 2).sum() / len(points)))


class HipCentre(Enum):
    """Source of the nominal hip centre."""

    BELL = "bell"
    ORTHOTRAK = "orthotrak"
    HARRINGTON = "harrington"
    GIVEN = "given"
    """Points of the static trial that are hip centres."""


_FRACTIONS = {HipCentre.BELL: (-0.193, -0.304, 0.359), HipCentre.ORTHOTRAK: (-0.22, -0.34, 0.32)}
_HARRINGTON = ((-0.24, -0.0099), (-0.30, -0.0109), (0.33, 0.0073))
"""Factor and constant (m) of x (by PD), y and z (by PW)."""
_PRINTED = {
    HipCentre.BELL: "Bell 1990",
    HipCentre.ORTHOTRAK: "OrthoTrak",
    HipCentre.HARRINGTON: "Harrington 2007",
}


@dataclass(frozen=True)
class PelvicWidth:
    """Distance between the two ASIS, m."""

    markers: float  # between the centres of their markers
    measured: float | None = None  # by hand; None if not given

    @property
    def is_plausible(self) -> bool:
        """Whether the distance was measured by hand and can belong to these markers."""
        return (
            self.measured is not None
            and PLAUSIBLE_SHARE[0] <= self.measured / self.markers <= PLAUSIBLE_SHARE[1]
        )

    def get_width(self, rule: HipCentre) -> float:
        """Get the width PW that a regression uses.

        Parameters
        ----------
        rule : HipCentre
            The regression.

        Returns
        -------
        float
            m.
        """
        if self.measured is None or not self.is_plausible or rule is HipCentre.ORTHOTRAK:
            return self.markers
        return self.measured

    def describe(self, rule: HipCentre) -> str:
        """Describe the width that a regression uses, and why the other one is not used."""
        taken, markers = (
            f"{1e3 * self.get_width(rule):.0f} mm between the ASIS",
            f"{1e3 * self.markers:.0f} mm",
        )
        if self.measured is None:
            return taken
        if not self.is_plausible:
            low, high = PLAUSIBLE_SHARE
            why = (
                f"the measured {1e3 * self.measured:.0f} mm are not used: allowed: {low:g} to "
                f"{high:g} times that"
            )
            return f"{taken} (between their markers; {why})"
        if rule is HipCentre.ORTHOTRAK:
            return (
                f"{taken} (between their markers, which it is made for; measured "
                f"{1e3 * self.measured:.0f} mm)"
            )
        return f"{taken} (as measured by hand; {markers} between their markers)"


def compute_hip_centre(
    rule: HipCentre, asis_distance: float, pelvic_depth: float, side: str
) -> Array:
    """Compute the hip centre in the pelvis frame by a regression.

    Parameters
    ----------
    rule : HipCentre
        One of the regressions.
    asis_distance, pelvic_depth : float
        PW and PD, m.
    side : str
        `r` or `l`.

    Returns
    -------
    (3,) array
        m, pelvis frame.
    """
    if rule is HipCentre.HARRINGTON:
        sizes = (pelvic_depth, asis_distance, asis_distance)
        ant, sup, lat = (
            factor * size + more for (factor, more), size in zip(_HARRINGTON, sizes, strict=True)
        )
    else:
        ant, sup, lat = asis_distance * np.array(_FRACTIONS[rule])
    return np.array([ant, sup, lat if side == "r" else -lat])


def _locate_hips(
    posture: StaticPosture, pelvis: Frame, rule: HipCentre, width: PelvicWidth
) -> tuple[Mapping[str, Array], list[str]]:
    """Locate the hip centres (3,) m in the laboratory, with notes about their source.

    Raises InputError if the file's are required and missing, or implausible.
    """
    depth = float(np.linalg.norm(pelvis.origin - posture.landmarks["sacrum"]))
    regression = HipCentre.HARRINGTON if rule is HipCentre.GIVEN else rule
    hips = {
        s: pelvis.point(compute_hip_centre(regression, width.get_width(regression), depth, s))
        for s in SIDES
    }
    gaps = {
        s: 1e3 * float(np.linalg.norm(posture.hips[s] - hips[s]))
        for s in SIDES
        if s in posture.hips
    }
    if rule is not HipCentre.GIVEN:
        back = (
            f" and {1e3 * depth:.0f} mm from their middle to the sacral markers"
            if rule is HipCentre.HARRINGTON
            else ""
        )
        notes = [
            f"hip centres by the {_PRINTED[rule]} regression from {width.describe(rule)}{back}"
        ]
        if len(gaps) == len(SIDES):
            labels = ", ".join(posture.hip_labels[s] for s in SIDES)
            away = ", ".join(f"{gaps[s]:.0f} mm ({s})" for s in SIDES)
            notes.append(
                f"the static trial has hip centres {labels}, {away} from these; hip_centre = "
                "'given' takes them instead"
            )
        return hips, notes
    missing = [f"hjc_{side}" for side in SIDES if side not in gaps]
    if missing:
        raise InputError(
            f"the static trial has no hip centre {' and '.join(missing)}; allowed: markers or "
            "computed "
            "points called RHJC, LHJC (R_HJC, RHJ, ...), landmarks hjc_r and hjc_l of the marker "
            "set, or another "
            "hip_centre",
            source=posture.source,
            field="calibration.hip_centre = 'given'",
            code=Code.GIVEN_BY_FILE,
        )
    most = 1e3 * FARTHEST_GIVEN * width.markers
    for side in SIDES:
        if gaps[side] > most:
            raise InputError(
                f"found it {gaps[side]:.0f} mm from its position by the pelvis's markers; allowed: "
                f"at most {most:.0f} mm; "
                "are the sides swapped?",
                source=posture.source,
                field=f"hip centre {posture.hip_labels[side]}",
                code=Code.GIVEN_BY_FILE,
            )
    away = ", ".join(f"{posture.hip_labels[s]} {gaps[s]:.0f} mm" for s in SIDES)
    return posture.hips, [
        f"hip centres are points of the file, this far from where Harrington 2007 has them: {away}"
    ]


def compute_half_width(joint: str, height: float) -> float:
    """Compute the distance from a lateral marker's centre to the joint centre.

    Parameters
    ----------
    joint : str
        `knee`, `ankle` or `elbow`.
    height : float
        Body height, m.

    Returns
    -------
    float
        m, in proportion to height.
    """
    return 0.5 * WIDTH[joint] * height / NOMINAL_HEIGHT


@dataclass(frozen=True)
class JointWidths:
    """Distances of knee and ankle centres from their lateral markers."""

    height: float  # m
    measured: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """(`knee` or `ankle`, side) -> m across the joint."""
    marker_diameter: float | None = None  # m; None if not given
    # m between the ASIS, measured by hand, for the hips; None if not given
    asis_distance: float | None = None

    @classmethod
    def from_subject(cls, subject: Subject) -> "JointWidths":
        """Collect the measured widths of a person.

        Parameters
        ----------
        subject : Subject
            The person.

        Returns
        -------
        JointWidths
            m.
        """
        widths = {"knee": subject.knee_width, "ankle": subject.ankle_width}
        measured = {
            (joint, side): width
            for joint, by_side in widths.items()
            for side, width in by_side.items()
        }
        return cls(subject.height, measured, subject.marker_diameter, subject.asis_distance)

    @property
    def marker_radius(self) -> float:
        """Radius of the markers, m."""
        return 0.5 * (MARKER_DIAMETER_M if self.marker_diameter is None else self.marker_diameter)

    def is_measured(self, joint: str, side: str) -> bool:
        """Return whether there is a plausible measured width."""
        width = self.measured.get((joint, side))
        low, high = PLAUSIBLE_WIDTH
        return (
            width is not None
            and low <= width / (2.0 * compute_half_width(joint, self.height)) <= high
        )

    def compute_inset(self, joint: str, side: str) -> float:
        """Compute the distance from the lateral marker's centre inwards to the joint centre.

        Parameters
        ----------
        joint, side : str
            `knee` or `ankle`; `r` or `l`.

        Returns
        -------
        float
            m.
        """
        if self.is_measured(joint, side):
            return 0.5 * self.measured[joint, side] + self.marker_radius
        return compute_half_width(joint, self.height)


def _locate_joint_centre(
    posture: StaticPosture,
    joint: str,
    side: str,
    above: Array,
    z_above: Array,
    turn: float,
    widths: JointWidths,
) -> tuple[Array, Array]:
    """Locate the centre of a knee or an ankle and the direction of its axis.

    `joint`, `side`: `knee` or `ankle`; `r` or `l`. `above`: (3,) centre of the proximal joint, m.
    `z_above`: (3,) z axis of the proximal segment, used without a medial marker or device. `turn`:
    rotation of the axis about y against `z_above`, rad. `widths`: distances from the lateral
    markers. Returns: centre (m) and direction of z, laboratory.
    """
    lateral = posture.landmarks[f"{joint}_lat_{side}"]
    s = sign(side)
    if posture.has(f"{joint}_med_{side}"):
        medial = posture.landmarks[f"{joint}_med_{side}"]
        return 0.5 * (lateral + medial), s * (lateral - medial)
    if posture.has(f"{joint}_axis_{side}"):
        z_above, turn = s * (posture.landmarks[f"{joint}_axis_{side}"] - lateral), 0.0
    inwards = s * widths.compute_inset(joint, side)
    centre, z = lateral, z_above
    for _ in range(ROUNDS):
        before = centre
        axes = build_frame(centre, normalise(above - centre), z_above).rotation
        z = axes @ make_axis_rotation(1, turn)[:, 2]
        centre = lateral - inwards * z
        if np.abs(centre - before).max() <= SETTLED * widths.height:
            break
    return centre, z


def _describe_inset(widths: JointWidths, joint: str, side: str) -> str:
    """Describe the assumed distance of a joint centre from the lateral marker."""
    inwards = f"{1e3 * widths.compute_inset(joint, side):.1f} mm inwards of the lateral marker's"
    if not widths.is_measured(joint, side):
        return f"{inwards}, in proportion to height"
    assumed = "" if widths.marker_diameter is not None else " (assumed: not given)"
    width, diameter = 1e3 * widths.measured[joint, side], 2e3 * widths.marker_radius
    return (
        f"{inwards}: half of the measured {width:.0f} mm and of the marker's {diameter:.0f} "
        f"mm{assumed}"
    )


def _describe_axis(posture: StaticPosture, joint: str, side: str) -> str:
    """Describe the axis of a joint without a medial marker."""
    if posture.has(f"{joint}_axis_{side}"):
        return "its axis is that of the knee alignment device, across the thigh"
    if joint == "knee":
        return "its axis is the pelvis's lateral direction across the thigh in the static posture"
    return f"a tibial torsion of {np.rad2deg(TIBIAL_TORSION):.0f} deg is assumed"


def _describe_centres(posture: StaticPosture, widths: JointWidths) -> list[str]:
    """Describe centres and axes without a medial marker, and implausible measured widths."""
    notes: list[str] = []
    for joint in ("knee", "ankle"):
        # one note for both sides if their descriptions are equal
        found: dict[tuple[str, str], list[str]] = {}
        for side in SIDES:
            if not posture.has(f"{joint}_med_{side}"):
                how = _describe_inset(widths, joint, side), _describe_axis(posture, joint, side)
                found.setdefault(how, []).append(side)
        for (at, along), sides in found.items():
            where = "both sides" if len(sides) == len(SIDES) else SIDE_WORDS[sides[0]]
            notes.append(
                f"{joint}, {where}: no medial marker; its centre is assumed {at}, and {along}"
            )
    return notes + _describe_unused_widths(widths)


def _describe_unused_widths(widths: JointWidths) -> list[str]:
    """Describe the measured widths that no person of this height has."""
    notes: list[str] = []
    for (joint, side), width in widths.measured.items():
        if not widths.is_measured(joint, side):
            expected_mm = 2e3 * compute_half_width(joint, widths.height)
            notes.append(
                f"{joint}, {SIDE_WORDS[side]}: a width of {1e3 * width:.0f} mm is not used: found, "
                "that is, "
                f"{1e3 * width / expected_mm:.1f} times the {expected_mm:.0f} mm of a person of "
                "this height; allowed: "
                f"{PLAUSIBLE_WIDTH[0]:g} to {PLAUSIBLE_WIDTH[1]:g} times"
            )
    return notes


@dataclass(frozen=True)
class LowerBody:
    """Frames and joint centres of pelvis and legs, laboratory."""

    frames: dict[str, Frame]  # segment -> frame; no talus
    # `hjc_r kjc_r ajc_r` (and `_l`), `lumbar`: (3,) m in the laboratory
    centres: dict[str, Array]
    notes: tuple[str, ...]


def measure_lower_body(
    posture: StaticPosture, height: float, rule: HipCentre, *, widths: JointWidths | None = None
) -> LowerBody:
    """Measure frames and joint centres of pelvis and legs in the static posture.

    Parameters
    ----------
    posture : StaticPosture
        Landmarks, m, laboratory.
    height : float
        Body height, m.
    rule : HipCentre
        Source of the hip centres.
    widths : JointWidths, optional
        Measured widths; in proportion to height if not given.

    Returns
    -------
    LowerBody
        Frames of all segments but the tali, joint centres, and notes.

    Raises
    ------
    InputError
        The file's hip centres are required and missing, or implausible.
    """
    widths = widths or JointWidths(height)
    p = posture.landmarks
    pelvis = build_pelvis_frame(p["asis_r"], p["asis_l"], p["sacrum"])
    asis = float(np.linalg.norm(p["asis_r"] - p["asis_l"]))
    frames = {"pelvis": pelvis}
    centres = {"lumbar": pelvis.point(np.array(_NOMINAL_LUMBAR) * (asis / _NOMINAL_ASIS))}
    hips, notes = _locate_hips(posture, pelvis, rule, PelvicWidth(asis, widths.asis_distance))
    notes.append("lumbar joint as in the nominal subject, scaled by the distance between the ASIS")
    for side in SIDES:
        hip, heel = hips[side], p[f"heel_{side}"]
        knee, towards_z = _locate_joint_centre(
            posture, "knee", side, hip, pelvis.rotation[:, 2], 0.0, widths
        )
        thigh = build_frame(hip, normalise(hip - knee), towards_z)
        torsion = -sign(side) * TIBIAL_TORSION
        ankle, towards_z = _locate_joint_centre(
            posture, "ankle", side, knee, thigh.rotation[:, 2], torsion, widths
        )
        shank = build_frame(knee, normalise(knee - ankle), towards_z)
        x = normalise(p[f"toe_{side}"] - heel)
        z = normalise(cross(x, shank.rotation[:, 1]))
        foot = Frame(np.column_stack([x, cross(z, x), z]), heel)
        frames |= {f"thigh_{side}": thigh, f"shank_{side}": shank, f"foot_{side}": foot}
        centres |= {f"hjc_{side}": hip, f"kjc_{side}": knee, f"ajc_{side}": ankle}
    return LowerBody(frames, centres, (*notes, *_describe_centres(posture, widths)))
