"""How a trial's signals are laid along the horizontal axis, by gait cycle or by time, and along
which line strides go.

That line is from the foot's strike to its next one (`gait/spatiotemporal.py`), pointed to where the
pelvis faces, so that walking backwards is no turn. With its direction theta about the vertical, and
R the pelvis in the laboratory,

    Ry(-theta) R = Rz(tilt) Rx(list) Ry(rotation)

are the angles of the pelvis against a laboratory that is turned into the line: the same for any
direction in the room. Because the rotation comes last, tilt and list change, too: a forward tilt in
the room is a list of who walks across. A stride turns by what the pelvis faces otherwise at its end
than at its beginning, where gait itself is the same.
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
"""deg: who turns by more within a stride does not walk straight. From strike to strike of straight
walks the pelvis faces the same to 6 deg (27 strides of eight people)."""
AXES: Final = "ZXY"
LEG_PARTS: Final = ("thigh", "shank", "talus", "foot")


@dataclass(frozen=True)
class Layout:
    """The horizontal axis of one trial."""

    time: Array  # (nf,) s
    valid: BoolArray  # (nf,) torques of the whole body may be used
    valid_legs: BoolArray  # (nf, 2) torques of the right and the left leg may be used
    cycles: Mapping[
        str, tuple[GaitCycle, ...]
    ]  # side -> complete cycles; empty where drawn against time

    @property
    def by_cycle(self) -> bool:
        """Whether signals are drawn over the gait cycle."""
        return bool(self.cycles)

    def _get_foot(self, side: str) -> str:
        """Over whose strides a side is drawn: the whole body over those of the right foot, if it
        has any.
        """
        return side or ("r" if self.cycles["r"] else "l")

    def select_main_cycle(self, side: str) -> GaitCycle:
        """The stride that is drawn in full: the one with the largest share of frames valid for that
        leg.
        """
        foot = self._get_foot(side)
        return select_best_cycle(self.cycles[foot], self.time, self.get_valid_frames(foot))

    def get_valid_frames(self, side: str) -> BoolArray:
        """(nf,) torques of a leg (`r`, `l`), or of the whole body (nothing), may be used."""
        return np.asarray(self.valid_legs[:, SIDES.index(side)]) if side else self.valid

    def count_complete(self, side: str) -> int:
        """How many strides of a leg have no frame without valid torques."""
        valid = self.get_valid_frames(side)
        inside = (
            valid[(self.time >= c.start) & (self.time <= c.stop)] for c in self.cycles.get(side, ())
        )
        return sum(bool(frames.size and frames.all()) for frames in inside)

    def select_drawn_frames(self, side: str) -> BoolArray:
        """(nf,) frames of the main stride, or all."""
        if not self.by_cycle:
            return np.ones(len(self.time), dtype=bool)
        cycle = self.select_main_cycle(side)
        return np.asarray((self.time >= cycle.start) & (self.time <= cycle.stop), dtype=np.bool_)


def make_layout(motion: Motion, reactions: GroundReactions | None, events: GaitEvents) -> Layout:
    """Over the gait cycle where both feet of a whole-body motion have a complete one, else against
    time.
    """
    time = motion.time
    valid = reactions.valid if reactions else np.ones(len(time), dtype=bool)
    legs = reactions.valid_legs if reactions else np.ones((len(time), 2), dtype=bool)
    cycles = list_strides(events)
    return Layout(time, valid, legs, cycles if all(cycles.values()) else {})


def list_strides(events: GaitEvents) -> dict[str, tuple[GaitCycle, ...]]:
    """Side -> all complete cycles of that foot, whether the other foot has any or not; of no gait,
    what repeats.
    """
    if events.repeats:
        return dict.fromkeys(SIDES, events.repeats)
    right, left = (events.select_foot(side) for side in SIDES)
    return {"r": find_gait_cycles(right, left), "l": find_gait_cycles(left, right)}


def get_pelvis_angles(motion: Motion) -> Array:
    """(nf, 3) rad, `PELVIS_ANGLES` against the room."""
    return motion.q[:, [motion.coordinates.index(name) for name in PELVIS_ANGLES]]


def compute_facing(angles: Array) -> Array:
    """(nf,) rad, unwrapped: where the pelvis points, to the left of the room's x axis.

    `angles`: (nf, 3) rad, `PELVIS_ANGLES`.
    """
    forward = Rotation.from_euler(AXES, angles).as_matrix()[:, :, 0]
    return np.unwrap(np.arctan2(-forward[:, 2], forward[:, 0]))


def measure_out_of_plane(axes: Array, line: Array | float) -> tuple[Array, Array]:
    """By how much unit vectors point out of the vertical plane along a line, as a star stands above
    an equator.

    arcsin(u . left), left = (-sin(line), 0, -cos(line)); a turn w of u adds w . e, e = (u x left) /
    |u x left|.

    `axes`: (..., 3) on the laboratory's axes.
    `line`: (...) or one, rad to the left of the room's x axis.

    Returns
    -------
    (...) rad, to the left; and e (..., 3).
    """
    left = np.stack([-np.sin(line), np.zeros_like(line), -np.cos(line)], axis=-1)
    about = cross(axes, left)
    length = np.linalg.norm(about, axis=-1, keepdims=True)
    return np.arcsin(np.clip((axes * left).sum(axis=-1), -1.0, 1.0)), about / np.where(
        length > 0.0, length, 1.0
    )


@dataclass(frozen=True)
class FootAxes:
    """Where the long axes of both feet point; order right, left."""

    axes: Array  # (nf, 2, 3) unit vectors on the laboratory's axes
    error: Array | None = None
    """(nf, 2) rad, standard error of `progression` in each stride, by markers and by where heel and
    toe markers sit.
    """
    marker_error: Array | None = (
        None  # (nf, 2) rad, the part of it that this trial's own markers make
    )

    def compute_progression(self, side: str, line: float, inside: BoolArray | None = None) -> Array:
        """(nf,) rad: how far the foot points inwards of a line of progression, the nearer way along
        it.

        Plug-in Gait's `FootProgressAngles`: how far the axis points out of the vertical plane along
        the line, which does not grow where the heel is above the toes. Toes in (internal) is
        positive on both sides.

        `inside`: (nf,) frames that tell whether the foot goes along the line or backwards; None:
        all.
        """
        axes = self.axes[:, SIDES.index(side)]
        off, _ = measure_out_of_plane(axes, line)
        counted = axes if inside is None else axes[inside]
        backwards = (counted @ np.array([np.cos(line), 0.0, -np.sin(line)])).sum() < 0.0
        return off if (side == "r") != backwards else -off


def compute_foot_axes(motion: Motion, parameters: Parameters, lines: Array) -> tuple[Array, Array]:
    """Long axes u (nf, 2, 3) of both feet, and what each coordinate (nf, 2, nq) adds to
    `out_of_plane` of them.

    u is x of the foot's frame, from heel to toe marker as in the static trial; `lines`: (nf, 2)
    rad.
    """
    chain = get_chain()
    placed = Kinematics(chain.body(parameters), motion.q)
    axes, turns = placed.axes, placed.columns_by_frame[:, :, 3:]  # (nf, nq, 3)
    u = np.stack([axes[chain.segments.index(foot), 0].T for foot in FEET], axis=1)
    _, about = measure_out_of_plane(u, lines)
    moved = np.einsum("fqi,fki->fkq", turns, about)
    for k, side in enumerate(SIDES):
        above = {*PELVIS_ANGLES, *list_joint_coordinates(f"{part}_{side}" for part in LEG_PARTS)}
        moved[:, k, [i for i, name in enumerate(motion.coordinates) if name not in above]] = 0.0
    return u, moved


def measure_turn(time: Array, faced: Array, start: float, stop: float) -> float:
    """Deg to the left, by which `faced` (nf,) rad turns from `start` to `stop` (s)."""
    begin, end = np.interp([start, stop], time, faced)
    return float(np.degrees(end - begin))


def is_turning(turn: float | None) -> bool:
    """Whether a stride that turns by so much (deg) is no straight one; one of which it is not known
    counts as such.
    """
    return turn is not None and abs(turn) > TURNING


def express_along_line(angles: Array, line: float, inside: BoolArray) -> Array:
    """(nf, 3) rad, `PELVIS_ANGLES` against a line of progression; NaN where an angle is not known.

    `angles`: (nf, 3) rad, against the room. `line`: rad, direction of progression, to the left of
    the room's x axis. `inside`: (nf,) frames of the stride; the line is turned about where the
    pelvis faces backwards in them.
    """
    known = np.isfinite(angles).all(axis=1)
    out = np.full(angles.shape, np.nan)
    if not known.any():
        return out
    within = compute_facing(angles[known])[inside[known]]
    if len(within) and np.cos(float(np.mean(within)) - line) < 0.0:
        line += np.pi
    turned = Rotation.from_euler("y", -line) * Rotation.from_euler(AXES, angles[known])
    out[known] = np.unwrap(turned.as_euler(AXES), axis=0)
    return out
