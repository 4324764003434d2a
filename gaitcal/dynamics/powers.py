"""Joint powers: what the structures that cross a joint do, net, in a second.

    P_k = tau_k v_k      of a coordinate: its generalised force times its rate,
    P   = sum_k P_k      of a joint: over its coordinates.

Positive: work is done on the segments (generated, concentric); negative: it is taken from them (absorbed, eccentric).
At joints whose axes meet in one point (hip, back) and at hinges (knee, elbow) the sum is the joint moment times the
angular velocity of the distal segment relative to the proximal one, M . w; the ankle holds both of its hinges, whose
axes do not meet. The pelvis has no joint: its residual is none of the body's.
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.coordinates import JOINT_TABLE, split_side
from gaitcal.model.linkage import COORDINATES, JOINTS, Source


def _joints() -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for joint in JOINTS:
        kind, side = split_side(joint.name)
        name = JOINT_TABLE[kind].power + (f"_{side}" if side else "")
        own = tuple(e.name for e in joint.elements if e.source is Source.COORDINATE)
        found[name] = (*found.get(name, ()), *own)
    return found


POWER_JOINTS: dict[str, tuple[str, ...]] = _joints()
"""Joint (`hip_r`, ..., `lumbar`, `shoulder_r`, `elbow_r`) -> its coordinates."""
POWERS: tuple[str, ...] = (*POWER_JOINTS, *(name for own in POWER_JOINTS.values() if len(own) > 1 for name in own))
"""Order of every array of powers: of each joint, then of each coordinate of those that have several."""
POWER_SUMS: Array = np.array(
    [[float(c == name or c in POWER_JOINTS.get(name, ())) for c in COORDINATES] for name in POWERS]
)
"""(np, nq) which coordinates' powers make each power."""
POWER_COORDINATES: dict[str, tuple[str, ...]] = {name: POWER_JOINTS.get(name, (name,)) for name in POWERS}


def power_name(name: str) -> str:
    """What a power is called in files: `hip_power_r` of `hip_r`, `hip_flexion_power_r` of `hip_flexion_r`."""
    sided = name[-2:] in ("_r", "_l")
    return f"{name[:-2]}_power{name[-2:]}" if sided else f"{name}_power"


def powers(tau: Array, velocity: Array) -> Array:
    """(nf, np) W, in the order of `POWERS`, from generalised forces and rates of the coordinates (nf, nq)."""
    out: Array = (tau * velocity) @ POWER_SUMS.T
    return out
