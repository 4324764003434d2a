"""The true motion and the true generalised forces, told as a calibration without error would find them.

A calibration measures joint angles between segment frames that it makes from the static trial's landmarks, and a
synthetic person's own segment frames are others, by up to the drawn 10 degrees. Segments are where they are: at every
frame the coordinates q' of the linkage told in those frames (`truth.py`) are those that put its segments where the true
ones are,

    X_s(q) F_s = X'_s(q'),      F_s the static frame of segment s in its true one, constant,

solved by Gauss-Newton over the corners of each segment; the linkages are one, so the residual is rounding. Ankle angles
are counted from the static posture (`model/ankle_zero.py`): dorsiflexion as its landmarks have it, no inversion. The
forces are those of the same bodies about the axes of the coordinates q', with products of inertia that segments have
about axes that are not their principal ones (a calibration's bodies have none: what that makes is part of its error).
Velocities and accelerations are those of the quintic spline through q', at three times as many instants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.interpolate import make_interp_spline

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model.ankle_zero import AnkleZero, standing_ankles
from gaitcal.model.chain import Chain, forward, jacobian, segment_poses
from gaitcal.model.linkage import COORDINATE_INDEX, SIDES, ZERO_ANGLES
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters, table
from gaitcal.model.segment_frames import Frame
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.spline import to_bspline
from gaitcal.synthetic.motion import TrueMotion, standing_pose
from gaitcal.synthetic.truth import StaticFrames, segment_frames

DEGREE = 5
REACH = 0.1
"""m from a segment's origin to its corners."""
STEPS, TOLERANCE = 30, 1e-8
"""Gauss-Newton steps, and the step (m, rad) that ends them: its square, the next one, is rounding."""
FINER = 3
"""Instants a frame at which a motion is told, so that accelerations are right at its ends, too."""


@dataclass(frozen=True, kw_only=True)
class ToldMotion:
    """One trial of the truth, as a calibration without error would tell it."""

    time: Array
    """(nf,) s."""
    q: Array
    """(nf, nq) m, rad."""
    velocity: Array
    """(nf, nq) m/s, rad/s."""
    acceleration: Array
    """(nf, nq) m/s^2, rad/s^2."""
    forces: Array | None
    """(nf, nt) N·m (pelvis translations: N), the 27 coordinates and the two knee reactions; None without plates."""


class Teller:
    """Tells motions of one person: its linkage in the static trial's frames, found once."""

    def __init__(self, model: SubjectModel, static: StaticFrames, zero_rule: AnkleZero = AnkleZero.MARKERS) -> None:
        self._true, still = model.parameters, standing_pose(model.parameters)
        own = segment_frames(self._true, still)
        massive = [s for s in own if s in static.frames]
        self._offset = {s: _in(own[s], static.frames[s]) for s in massive}
        self._inertia = _turned_inertia(self._true.inertial, self._offset)
        posture = standing_ankles(static.posture, static.legs, {}, zero_rule).dorsiflexion
        told, pose = static.parameters, self._coordinates(static.parameters, still[None])[0]
        zero = told.zero_angles.copy()
        for side in SIDES:
            mirrored = 1.0 if side == "r" else -1.0
            ankle, subtalar = (pose[COORDINATE_INDEX[f"{name}_{side}"]] for name in ("ankle_angle", "subtalar_angle"))
            zero[ZERO_ANGLES.index(f"talocrural_{side}.zero")] += ankle - posture[side]
            zero[ZERO_ANGLES.index(f"subtalar_{side}.zero")] += mirrored * subtalar
        self.parameters = Parameters(told.joint, told.inertial, zero)
        """Of the linkage in static frames, its ankle angles counted from the static posture."""
        self._standing_off = self._coordinates(self.parameters, still[None])[0] - still

    def tell(self, motion: TrueMotion, wrench: Array | None = None) -> ToldMotion:
        """A motion of the true linkage, with its forces where wrenches (nf, 2, 6) on the feet are given."""
        time = motion.basis.time
        finer = np.interp(np.arange(FINER * (len(time) - 1) + 1) / FINER, np.arange(len(time)), time)
        true = to_bspline(motion.basis, motion.nodes)(finer)
        spline = make_interp_spline(
            finer, self._coordinates(self.parameters, true, true + self._standing_off), k=DEGREE
        )
        q, velocity, acceleration = (spline(time, k) for k in range(3))
        forces = None if wrench is None else self._dynamics().forces(q, velocity, acceleration, wrench)
        return ToldMotion(time=time, q=q, velocity=velocity, acceleration=acceleration, forces=forces)

    def _dynamics(self) -> Dynamics:
        """Of the told linkage with the true bodies, products of inertia too."""
        dynamics = Dynamics(self.parameters)
        linkage, centres = dynamics.linkage, table(self.parameters.inertial)
        for row, segment in zip(centres, MASSIVE_SEGMENTS, strict=True):
            body = pin.Inertia(float(row[0]), row[1:4], self._inertia[segment])
            linkage.model.inertias[linkage.segment_joint[segment]] = linkage.segment_placement[segment].act(body)
        return dynamics

    def _coordinates(self, told: Parameters, q: Array, start: Array | None = None) -> Array:
        """(nf, nq) coordinates of the linkage `told` that put its segments where the true ones are at q (nf, nq),
        sought from `start`.
        """
        chain = Chain()
        wanted = _corners(chain, self._true, q, self._offset)
        constants, out = chain.constants(told.joint, told.zero_angles), (q if start is None else start).copy()
        moves = np.stack([chain.support[:, chain.segments.index(s)] for s in self._offset])
        for _ in range(STEPS):
            poses = forward(chain, constants, out)
            points = _corners(chain, told, out)
            columns = jacobian(chain, constants, poses).transpose(2, 0, 1)
            turned = np.cross(columns[:, :, None, None, 3:], points[:, None])
            rows = (columns[:, :, None, None, :3] + turned) * moves.T[None, :, :, None, None]
            rows = rows.reshape(*rows.shape[:2], -1)
            gap = (wanted - points).reshape(len(q), -1, 1)
            step = np.linalg.solve(rows @ rows.transpose(0, 2, 1), rows @ gap)[..., 0]
            out += step
            if np.abs(step).max() < TOLERANCE:
                break
        return out


def _in(frame: Frame, other: Frame) -> Frame:
    """`other` as seen from `frame`."""
    return Frame(frame.rotation.T @ other.rotation, frame.local(other.origin))


def _corners(chain: Chain, parameters: Parameters, q: Array, offset: dict[str, Frame] | None = None) -> Array:
    """(nf, ns, 4, 3) m: origin and three corners of the frames that `offset` places in segments, or of their own."""
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, q))
    local = np.concatenate([np.zeros((1, 3)), REACH * np.eye(3)])
    out = []
    for k, segment in enumerate(chain.segments):
        if segment not in MASSIVE_SEGMENTS:  # the talus has no frame of its own
            continue
        place = None if offset is None else offset[segment]
        points = local if place is None else np.array([place.point(p) for p in local])
        out.append(np.einsum("cj,jif->fci", points, axes[k]) + origins[k].T[:, None])
    return np.stack(out, axis=1)


def _turned_inertia(inertial: Array, offset: dict[str, Frame]) -> dict[str, Array]:
    """Segment -> (3, 3) kg m^2 about the mass centre, in the axes of its static frame."""
    return {
        segment: offset[segment].rotation.T @ np.diag(row[4:7]) @ offset[segment].rotation
        for row, segment in zip(table(inertial), MASSIVE_SEGMENTS, strict=True)
    }
