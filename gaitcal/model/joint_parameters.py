"""The catalogue of the joint parameters (JPs): where each joint axis lies in the two segments it connects.

Which joint has which is told once, by the tables of `linkage.py`; this is their list in the order of files and arrays.
Reinbolt et al., IEEE TBME 2007, Table II lists the 27 of one leg; the lists for back, shoulder and elbow
(6, 10, 9) are the natural split of the remaining 98 - 2 * 27 = 44. Positions are `ant sup lat` (x y z),
orientations `front trans sag` (about x, y, z) of the segment's frame: x anterior, y superior, z to the right
on both sides. A left value is the mirror image z -> -z of the right one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.linkage import JOINT_OF_CHILD, JOINTS, LEGS, Source, moved_joints


class Kind(Enum):
    """What a joint parameter is: a position (mm outside, m inside) or an orientation (deg, rad)."""

    POSITION = "position"
    ORIENTATION = "orientation"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "mm" if self is Kind.POSITION else "deg"

    @property
    def to_si(self) -> float:
        """Factor from the unit in files to m or rad."""
        return 1e-3 if self is Kind.POSITION else float(np.pi / 180.0)


@dataclass(frozen=True, kw_only=True)
class JointParameter:
    """One entry of the catalogue."""

    name: str
    """For example `hip_r.pelvis.ant`."""
    joint: str
    """`hip_r`, `back`, ..."""
    segment: str
    """The segment in whose frame it is measured: `pelvis`, `thigh_r`, ..."""
    kind: Kind
    axis: int
    """0, 1, 2: the coordinate (position) or the axis turned about (orientation)."""

    @property
    def mirrored(self) -> bool:
        """Whether the left value has the opposite sign of the right one."""
        lateral = self.axis == 2
        return lateral if self.kind is Kind.POSITION else not lateral


def _catalogue() -> Iterator[JointParameter]:
    """Joint by joint; the parent's before the child's, of each orientations before positions, by axis."""
    for joint in JOINTS:
        moves = next(i for i, e in enumerate(joint.elements) if e.source is Source.COORDINATE)
        for segment, elements in ((joint.parent, joint.elements[:moves]), (joint.child, joint.elements[moves:])):
            for e in sorted(elements, key=lambda e: (not e.rotates, e.axis)):
                if e.source is Source.JOINT_PARAMETER:
                    kind = Kind.ORIENTATION if e.rotates else Kind.POSITION
                    yield JointParameter(name=e.name, joint=joint.name, segment=segment, kind=kind, axis=e.axis)


JOINT_PARAMETERS: tuple[JointParameter, ...] = tuple(_catalogue())
"""All, in the order of every (np,) array of joint parameters."""

JP_NAMES: tuple[str, ...] = tuple(p.name for p in JOINT_PARAMETERS)
JP_INDEX: dict[str, int] = {name: i for i, name in enumerate(JP_NAMES)}
JP_TO_SI: Array = np.array([p.kind.to_si for p in JOINT_PARAMETERS])
"""(np,) factors from mm and deg to m and rad."""


def isolated_parameters(isolated: str) -> tuple[str, ...]:
    """The JPs that an isolated trial of `hip_r`, `knee_r`, `ankle_r` (or `_l`) determines: 6, 9 or 12."""
    joints = [joint.name for joint in moved_joints(isolated)]
    return tuple(p.name for p in JOINT_PARAMETERS if p.joint in joints)


def gait_parameters(side: str) -> tuple[str, ...]:
    """The 17 JPs of one leg that a gait trial determines: the rows of Table II that change from the isolated trials.

    Hip: pelvis and thigh, anterior and superior; knee: all nine; talocrural: all but lateral.
    """
    kept = []
    for p in JOINT_PARAMETERS:
        hip = p.joint == f"hip_{side}" and p.axis != 2
        talocrural = p.joint == f"talocrural_{side}" and not (p.kind is Kind.POSITION and p.axis == 2)
        if hip or talocrural or p.joint == f"knee_{side}":
            kept.append(p.name)
    return tuple(kept)


def leg_parameters(side: str) -> tuple[str, ...]:
    """The JPs of one leg."""
    joints = [JOINT_OF_CHILD[segment].name for segment in LEGS[side]]
    return tuple(p.name for p in JOINT_PARAMETERS if p.joint in joints)
