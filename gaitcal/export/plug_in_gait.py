"""Angles, moments, powers and joint centres with names and signs of Plug-in Gait in C3D files.

| point | x | y | z |
|---|---|---|---|
| `RPelvisAngles` | anterior tilt | this side up | this side forward |
| `RHipAngles` | flexion | adduction | internal rotation |
| `RKneeAngles`, `RAnkleAngles`, `RSubtalarAngles` | flexion; dorsiflexion; inversion | 0 | 0 |
| `RFootProgressAngles` | 0 | 0 | toes in, against the room's axis of progression |
| `RHipMoment` | extension | abduction | external rotation |
| `RKneeMoment` | extension | abduction | 0 |
| `RAnkleMoment`, `RSubtalarMoment` | plantarflexion; eversion | 0 | 0 |
| `RHipPower`, `RKneePower`, `RAnklePower` | 0 | 0 | all axes of the joint together |
| `RNormalisedGRF` | forward along the room's axis of progression | medially | upwards |
| `RHJC`, `RKJC`, `RAJC` | joint centres, in the axes of the file | | |

Moments are internal, per kg of body mass, with the negative sign of our coordinates: the signs of
Vicon's curves, found by correlation (`scripts/validation/vendors`). Its `POINT:MOMENT_UNITS` are
Nmm where N·mm/kg is meant, and `POWER_UNITS` W where W/kg is meant; ours follow. Our knee is one
hinge and our ankle two: axes that cannot move are 0. Power is that of the joint's coordinates, the
sum of torque times angular velocity, for the ankle of both hinges. Ground reactions are those on
the foot, filtered as for the torques, in % of body weight. The subtalar axis has additional points,
as Plug-in Gait has no such axis.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics import inverse_dynamics, joint_kinetics
from gaitcal.export.opensim.osim_writer import list_joint_frames
from gaitcal.gait.strides import FootAxes
from gaitcal.io.c3d.writer import AddedPoint, PointKind
from gaitcal.model.chain import get_chain
from gaitcal.model.coordinates import COORDINATE_TABLE, LOCKED, Coordinate, with_side
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATES, SEGMENTS, SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import GRAVITY

ANGLE_UNITS = {"deg": 180.0 / np.pi, "degrees": 180.0 / np.pi, "rad": 1.0, "radians": 1.0}
"""Spelling of POINT:ANGLE_UNITS -> value of one radian."""
MOMENT_UNITS = {"nmm": 1e3, "nmm/kg": 1e3, "nm": 1.0, "nm/kg": 1.0}
"""Spelling of POINT:MOMENT_UNITS -> value of 1 N·m; all of them mean per kg."""

_MOMENTS: dict[str, list[Coordinate]] = {}
for _row in COORDINATE_TABLE.values():
    if _row.point:
        _MOMENTS.setdefault(_row.point, []).append(_row)
"""First word of a point -> coordinates of its axes, in order."""


def _describe_angles(rows: Sequence[Coordinate]) -> str:
    """Describe the axes of angles: `flexion, 0, 0 (a hinge)`."""
    senses = [
        row.clinical.positive if row.clinical else (row.senses or (row.angle,))[0] for row in rows
    ]
    return ", ".join([*senses, "0", "0"][:3]) + (" (a hinge)" if len(rows) == 1 else "")


def _describe_moments(rows: Sequence[Coordinate]) -> str:
    """Describe the axes of moments, which take the other sense: `internal, per kg: ...`."""
    senses = [row.senses[1] for row in rows if row.senses]
    return "internal, per kg: " + ", ".join([*senses, "0", "0"][:3])


_ANGLES = {
    point: [row for row in rows if row.name not in LOCKED] for point, rows in _MOMENTS.items()
}
# The moment of the pelvis is the residual, no moment of a joint.
del _MOMENTS["Pelvis"]
_POWERS = ("Hip", "Knee", "Ankle")
_DESCRIPTIONS = {
    **{f"{point}Angles": _describe_angles(rows) for point, rows in _ANGLES.items()},
    **{f"{point}Moment": _describe_moments(rows) for point, rows in _MOMENTS.items()},
    "FootProgressAngles": "0, 0, toes in, against the room's axis of progression",
    "NormalisedGRF": "% of body weight: forward, medially, upwards",
    "HipPower": "W/kg: 0, 0, all axes",
    "KneePower": "W/kg: 0, 0, flexion",
    "AnklePower": "W/kg: 0, 0, ankle and subtalar axis",
    "HJC": "hip joint centre",
    "KJC": "knee joint centre",
    "AJC": "centre of the talocrural joint",
}


@dataclass(frozen=True, kw_only=True)
class SavedMotion:
    """Whole-body motion, and the torques of its valid frames."""

    q: Array  # (nf, nq) m, rad
    velocity: Array  # (nf, nq) m/s, rad/s
    torques: Mapping[str, Array] | None
    """Coordinate or knee reaction -> (nf,) N·m; None without force plates, or where the trial is
    refused.
    """
    valid: Mapping[str, BoolArray]
    """Side -> (nf,) frames with valid torques."""
    mass: float
    """kg, of the body."""
    parameters: Parameters
    reactions: Mapping[str, Array] = field(default_factory=dict)
    """Side -> (nf, 3) N on its foot, in the laboratory's axes."""
    frozen: tuple[str, ...] = ()
    """Coordinates that the model holds at zero; they have no points."""


def make_plug_in_gait_points(
    motion: SavedMotion, angle: float, moment: float
) -> tuple[AddedPoint, ...]:
    """Make the points of all frames of a motion.

    Parameters
    ----------
    motion : SavedMotion
        Motion, torques and ground reactions.
    angle : float
        One radian in the unit of the file.
    moment : float
        1 N·m in the unit of the file.

    Returns
    -------
    tuple of AddedPoint
        In the laboratory's axes (x forward, y up, z right), positions in m. Torques and powers are
        NaN in frames that are not valid.
    """
    kinematics = Kinematics(get_chain().body(motion.parameters), motion.q, columns=False)
    axes, origins = kinematics.axes, kinematics.origins
    points = [
        *_make_angles(motion, angle),
        *_make_foot_progress(motion, angle, axes),
        *_make_joint_centres(motion, axes, origins),
    ]
    if motion.torques is not None:
        points += [
            *_make_moments(motion, motion.torques, moment),
            *_make_powers(motion, motion.torques),
            *_make_reactions(motion),
        ]
    return tuple(points)


def _list_points(
    motion: SavedMotion, table: Mapping[str, list[Coordinate]]
) -> Iterator[tuple[str, str, list[str]]]:
    """List first word, side and coordinates of each point with coordinates of the model."""
    for joint, rows in table.items():
        for side in SIDES:
            ours = [with_side(row.name, side) for row in rows]
            if not set(ours) & set(motion.frozen):
                yield joint, side, ours


def _make_angles(motion: SavedMotion, unit: float) -> Iterator[AddedPoint]:
    """Make the points of angles."""
    for joint, side, ours in _list_points(motion, _ANGLES):
        values = np.zeros((len(motion.q), 3))
        for axis, (name, row) in enumerate(zip(ours, _ANGLES[joint], strict=True)):
            sign = row.clinical.sign(side) if row.clinical else 1.0
            values[:, axis] = sign * unit * motion.q[:, COORDINATES.index(name)]
        yield _make_point(side, f"{joint}Angles", PointKind.ANGLE, values)


def _make_moments(
    motion: SavedMotion, torques: Mapping[str, Array], unit: float
) -> Iterator[AddedPoint]:
    """Make the points of moments, NaN in frames that are not valid."""
    for joint, side, ours in _list_points(motion, _MOMENTS):
        values = np.zeros((len(motion.q), 3))
        for axis, name in enumerate(ours):
            values[:, axis] = -unit * torques[name] / motion.mass
        values[~motion.valid[side]] = np.nan
        yield _make_point(side, f"{joint}Moment", PointKind.MOMENT, values)


def _make_powers(motion: SavedMotion, torques: Mapping[str, Array]) -> Iterator[AddedPoint]:
    """Make the points of powers, NaN in frames that are not valid."""
    tau = np.stack([torques.get(name, np.zeros(len(motion.q))) for name in COORDINATES], axis=1)
    found = joint_kinetics.compute_powers(tau, motion.velocity)
    for joint in _POWERS:
        for side in SIDES:
            values = np.zeros((len(motion.q), 3))
            values[:, 2] = (
                found[:, joint_kinetics.POWERS.index(f"{joint.lower()}_{side}")] / motion.mass
            )
            values[~motion.valid[side]] = np.nan
            yield _make_point(side, f"{joint}Power", PointKind.POWER, values)


def _make_reactions(motion: SavedMotion) -> Iterator[AddedPoint]:
    """Make the points of ground reactions, NaN in frames that are not valid."""
    for side, force in motion.reactions.items():
        values = 100.0 * force[:, [0, 2, 1]] / (motion.mass * GRAVITY)
        # z is to the right: medial of the left foot.
        values[:, 1] *= 1.0 if side == "l" else -1.0
        values[~motion.valid[side]] = np.nan
        yield _make_point(side, "NormalisedGRF", PointKind.FORCE, values)


def _make_foot_progress(motion: SavedMotion, unit: float, axes: Array) -> Iterator[AddedPoint]:
    """Make the points of foot progression; `axes`: (ns, 3, 3, nf) of the segments."""
    feet = FootAxes(
        np.stack([axes[SEGMENTS.index(foot), 0].T for foot in inverse_dynamics.FEET], axis=1)
    )
    for side in (side for side in SIDES if f"ankle_angle_{side}" not in motion.frozen):
        values = np.zeros((len(motion.q), 3))
        values[:, 2] = unit * feet.compute_progression(side, 0.0)
        yield _make_point(side, "FootProgressAngles", PointKind.ANGLE, values)


def _make_joint_centres(motion: SavedMotion, axes: Array, origins: Array) -> Iterator[AddedPoint]:
    """Make the points of joint centres."""
    frames = {joint.name: joint for joint in list_joint_frames(motion.parameters)}
    for joint, name in (("hip", "HJC"), ("knee", "KJC"), ("talocrural", "AJC")):
        for side in SIDES:
            frame = frames[f"{joint}_{side}"]
            segment = SEGMENTS.index(frame.parent)
            offset = np.einsum("j,jif->fi", frame.in_parent.translation, axes[segment])
            yield _make_point(side, name, PointKind.POSITION, offset + origins[segment].T)


def _make_point(side: str, name: str, kind: PointKind, values: Array) -> AddedPoint:
    """Make a point with its description."""
    return AddedPoint(
        name=side.upper() + name,
        kind=kind,
        values=values,
        description=f"gaitcal: {_DESCRIPTIONS[name]}",
    )
