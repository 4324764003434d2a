"""Strides of a trial: layout of curves over the gait cycle, lines of progression, turns.

The line of progression of a stride is from the foot's strike to its next one
(`gait/spatiotemporal.py`), directed to where the pelvis faces, so that walking backwards is no
turn. With its direction theta about the vertical, and R the orientation of the pelvis in the
laboratory,

    Ry(-theta) R = Rz(tilt) Rx(list) Ry(rotation)

are the angles of the pelvis relative to a laboratory that is rotated into the line, the same for
any direction in the room. Rotation is the last angle, so tilt and list change as well: a forward
tilt in the room is a list of a person who walks across it. The turn of a stride is the change of
direction of the pelvis from its beginning to its end, where the phase of gait is the same.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.gait.cycles import GaitCycle, find_gait_cycles, select_best_cycle
from gaitcal.gait.events import GaitEvents
from gaitcal.model.chain import get_chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import PELVIS_ANGLES, SIDES, list_joint_coordinates
from gaitcal.model.parameters import Parameters
from gaitcal.tracking.motion import Motion

TURNING: Final = 15.0
"""deg: a stride that turns by more is not straight. From strike to strike of straight walks the
direction of the pelvis changes by up to 6 deg (27 strides of eight people).
"""
AXES: Final = "ZXY"
"""Order of the rotations tilt, list, rotation."""
LEG_PARTS: Final = ("thigh", "shank", "talus", "foot")


@dataclass(frozen=True)
class Layout:
    """Horizontal axis of the curves of one trial: gait cycles or time."""

    time: Array  # (nf,) s
    valid: BoolArray  # (nf,) torques of the whole body may be used
    valid_legs: BoolArray  # (nf, 2) torques of the right and the left leg may be used
    cycles: Mapping[str, tuple[GaitCycle, ...]]
    """Side -> complete cycles; empty where curves are drawn over time."""

    @property
    def by_cycle(self) -> bool:
        """Whether curves are drawn over the gait cycle."""
        return bool(self.cycles)

    def _get_foot(self, side: str) -> str:
        """Get the foot whose strides a side is drawn over; for the whole body the right, if any."""
        return side or ("r" if self.cycles["r"] else "l")

    def select_main_cycle(self, side: str) -> GaitCycle:
        """Select the stride that is drawn in full: the one with the largest share of valid frames.

        `side`: leg, or the whole body.
        """
        foot = self._get_foot(side)
        return select_best_cycle(self.cycles[foot], self.time, self.get_valid_frames(foot))

    def get_valid_frames(self, side: str) -> BoolArray:
        """Get the frames (nf,) with valid torques of a leg (`r`, `l`) or of the body (empty)."""
        return np.asarray(self.valid_legs[:, SIDES.index(side)]) if side else self.valid

    def select_drawn_frames(self, side: str) -> BoolArray:
        """Select the frames of the main stride, or all where curves are drawn over time.

        `side`: leg, or the whole body. Returns: (nf,).
        """
        if not self.by_cycle:
            return np.ones(len(self.time), dtype=bool)
        cycle = self.select_main_cycle(side)
        inside = (self.time >= cycle.start) & (self.time <= cycle.stop)
        return np.asarray(inside, dtype=np.bool_)


def make_layout(motion: Motion, reactions: GroundReactions | None, events: GaitEvents) -> Layout:
    """Make the layout: gait cycles where both feet have a complete one, else time.

    Parameters
    ----------
    motion : Motion
        Motion of the whole body.
    reactions : GroundReactions or None
        Forces under the feet; None without force plates: all frames count as valid.
    events : GaitEvents
        Events of the trial.

    Returns
    -------
    Layout
    """
    time = motion.time
    valid = reactions.valid if reactions else np.ones(len(time), dtype=bool)
    legs = reactions.valid_legs if reactions else np.ones((len(time), 2), dtype=bool)
    cycles = list_strides(events)
    return Layout(time, valid, legs, cycles if all(cycles.values()) else {})


def list_strides(events: GaitEvents) -> dict[str, tuple[GaitCycle, ...]]:
    """List all complete cycles of each side, or the repetitions of an activity that is no gait.

    Parameters
    ----------
    events : GaitEvents
        Events of the trial.

    Returns
    -------
    dict
        `r`, `l` -> cycles; one side may have none.
    """
    if events.repeats:
        return dict.fromkeys(SIDES, events.repeats)
    right, left = (events.select_foot(side) for side in SIDES)
    return {"r": find_gait_cycles(right, left), "l": find_gait_cycles(left, right)}


def get_pelvis_angles(motion: Motion) -> Array:
    """Get the angles `PELVIS_ANGLES` (nf, 3) rad of the pelvis in the laboratory."""
    return motion.q[:, [motion.coordinates.index(name) for name in PELVIS_ANGLES]]


def compute_facing(angles: Array) -> Array:
    """Compute the direction of the pelvis about the vertical.

    Parameters
    ----------
    angles : (nf, 3) Array
        rad, `PELVIS_ANGLES` in the laboratory.

    Returns
    -------
    (nf,) Array
        rad, to the left of the room's x axis, unwrapped.
    """
    forward = Rotation.from_euler(AXES, angles).as_matrix()[:, :, 0]
    return np.unwrap(np.arctan2(-forward[:, 2], forward[:, 0]))


def measure_out_of_plane(axes: Array, line: Array | float) -> tuple[Array, Array]:
    """Measure the angle of unit vectors out of the vertical plane along a line.

    The angle is arcsin(u . left) with left = (-sin(line), 0, -cos(line)). A small rotation w of u
    adds w . e to it, with e = (u x left) / |u x left|.

    Parameters
    ----------
    axes : (..., 3) Array
        Unit vectors u in the laboratory's axes.
    line : (...) Array or float
        rad, direction of the line to the left of the room's x axis.

    Returns
    -------
    angle : (...) Array
        rad, to the left.
    direction : (..., 3) Array
        e, derivative of the angle with respect to a rotation.
    """
    left = np.stack([-np.sin(line), np.zeros_like(line), -np.cos(line)], axis=-1)
    about = cross(axes, left)
    length = np.linalg.norm(about, axis=-1, keepdims=True)
    angle = np.arcsin(np.clip((axes * left).sum(axis=-1), -1.0, 1.0))
    # An axis straight to the left has no direction e: it stays zero.
    return angle, about / np.where(length > 0.0, length, 1.0)


@dataclass(frozen=True)
class FootAxes:
    """Directions of the long axes of both feet; order right, left."""

    axes: Array  # (nf, 2, 3) unit vectors on the laboratory's axes
    error: Array | None = None
    """(nf, 2) rad, standard error of the progression angle, by markers of the trial and by the
    positions of heel and toe markers.
    """
    marker_error: Array | None = None
    """(nf, 2) rad, the part of `error` that the markers of the trial make."""

    def compute_progression(self, side: str, line: float, inside: BoolArray | None = None) -> Array:
        """Compute the foot progression angle against a line.

        The angle is Plug-in Gait's `FootProgressAngles`: the angle of the axis out of the vertical
        plane along the line, which does not grow where the heel is above the toes.

        Parameters
        ----------
        side : {"r", "l"}
            Foot.
        line : float
            rad, line of progression to the left of the room's x axis.
        inside : (nf,) BoolArray, optional
            Frames that decide whether the foot goes along the line or backwards; default: all.

        Returns
        -------
        (nf,) Array
            rad, positive for toes in (internal) on both sides.
        """
        axes = self.axes[:, SIDES.index(side)]
        off, _ = measure_out_of_plane(axes, line)
        counted = axes if inside is None else axes[inside]
        backwards = (counted @ np.array([np.cos(line), 0.0, -np.sin(line)])).sum() < 0.0
        return off if (side == "r") != backwards else -off


def compute_foot_axes(motion: Motion, parameters: Parameters, lines: Array) -> tuple[Array, Array]:
    """Compute the long axes of both feet, and the derivatives of their progression angles.

    The long axis is x of the foot's frame: from heel to toe marker in the static trial.

    Parameters
    ----------
    motion : Motion
        Motion of the whole body.
    parameters : Parameters
        Calibrated parameters.
    lines : (nf, 2) Array
        rad, lines of progression; right, left.

    Returns
    -------
    axes : (nf, 2, 3) Array
        Unit vectors in the laboratory's axes.
    derivatives : (nf, 2, nq) Array
        Change of the angle of `measure_out_of_plane` with each coordinate.
    """
    chain = get_chain()
    kinematics = Kinematics(chain.body(parameters), motion.q)
    # Rotation per unit of each coordinate, (nf, nq, 3).
    rotations = kinematics.columns_by_frame[:, :, 3:]
    u = np.stack([kinematics.axes[chain.segments.index(foot), 0].T for foot in FEET], axis=1)
    _, direction = measure_out_of_plane(u, lines)
    derivatives = np.einsum("fqi,fki->fkq", rotations, direction)
    # Only the coordinates between the ground and the foot move it.
    for k, side in enumerate(SIDES):
        above = {*PELVIS_ANGLES, *list_joint_coordinates(f"{part}_{side}" for part in LEG_PARTS)}
        others = [i for i, name in enumerate(motion.coordinates) if name not in above]
        derivatives[:, k, others] = 0.0
    return u, derivatives


def measure_turn(time: Array, faced: Array, start: float, stop: float) -> float:
    """Measure the turn of the pelvis between two times.

    Parameters
    ----------
    time, faced : (nf,) Array
        s; rad, direction of the pelvis (`compute_facing`).
    start, stop : float
        s

    Returns
    -------
    float
        deg, to the left.
    """
    begin, end = np.interp([start, stop], time, faced)
    return float(np.degrees(end - begin))


def is_turning(angle: float | None) -> bool:
    """Check whether a stride that turns by this angle (deg) is not straight; None is straight."""
    return angle is not None and abs(angle) > TURNING


def express_along_line(angles: Array, line: float, inside: BoolArray) -> Array:
    """Express the angles of the pelvis relative to a line of progression.

    Parameters
    ----------
    angles : (nf, 3) Array
        rad, `PELVIS_ANGLES` in the laboratory; NaN where not known.
    line : float
        rad, direction of progression to the left of the room's x axis.
    inside : (nf,) BoolArray
        Frames of the stride; the line is reversed where the pelvis faces backwards in them.

    Returns
    -------
    (nf, 3) Array
        rad; NaN where not known.
    """
    known = np.isfinite(angles).all(axis=1)
    out = np.full(angles.shape, np.nan)
    if not known.any():
        return out
    # Backwards walking is not a turn: the line then points to where the pelvis faces.
    directions = compute_facing(angles[known])[inside[known]]
    if len(directions) and np.cos(float(np.mean(directions)) - line) < 0.0:
        line += np.pi
    rotated = Rotation.from_euler("y", -line) * Rotation.from_euler(AXES, angles[known])
    out[known] = np.unwrap(rotated.as_euler(AXES), axis=0)
    return out
