"""Net moments between two segments as vectors: in the frame of either segment, and about the joint's own axes.

M is the moment that the proximal segment puts on the distal one, about the joint centre, net of all structures that
cross the joint. Three turns of the linkage pass through that centre, about axes a_k; their generalised forces are

    tau_k = a_k . M,      so that      M = A^-1 tau,      A's rows being the a_k.

All three are coordinates at the hip and the back; a knee adds its locked reaction and, held still, the joint parameter
of its turn about the length; an ankle the two joint parameters of its hinge. Told are the components m_i = e_i . M:

    proximal, distal     e_1, e_2, e_3 = z, x, y of that segment (x forward, y up, z right: Wu and Cavanagh, J Biomech
                         28:1257-1261, 1995)
    joint coordinate     e_1 = z of the proximal segment, e_3 = y of the distal one, e_2 = e_3 x e_1 / |e_3 x e_1|, the
    system               floating axis (Grood and Suntay, J Biomech Eng 105:136-144, 1983)

The axes e_1 and e_3 are not at right angles to each other. m_i is the orthogonal projection ("motor torque": what turns
the joint about that axis), not the part of M along it (Desroches, Cheze and Dumas, J Biomech Eng 132:114503, 2010). How
much the frame matters: Schache and Baker, Gait Posture 25:440-452, 2007.

Derivatives. Turning the proximal segment by a small p and the distal one by d, M staying, moves m_i by p . g_i +
d . h_i,

    proximal   g_i = e_i x M;    distal   h_i = e_i x M;    joint   g_1 = e_1 x M,  h_3 = e_3 x M,
    g_2 = e_1 x (b x e_3),  h_2 = e_3 x (e_1 x b),   b = (M - m_2 e_2) / |e_3 x e_1|.

A variable x_j of the chain that turns about w_j what comes after it moves a_k, where it comes before turn k, so that

    d m_i / d x_j = w_j . (g_i [j moves the proximal] + h_i [j moves the distal] - sum_k c_ik (a_k x M) [j before k])

besides c_i . d tau, with c_i = A^-T e_i.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, cross
from gaitcal.dynamics.inverse_dynamics import FORCES, PlacedLinkage
from gaitcal.model.chain import chain_of
from gaitcal.model.linkage import COORDINATES, JOINTS, SIDES, joint_segments
from gaitcal.model.parameters import JP_INDEX, Parameters


class MomentFrame(Enum):
    """Along which axes a joint moment is told. `words`: in files and on pages."""

    COORDINATES = ("coordinates", "about the axis of each coordinate of the model (generalised force)")
    """About the axis of each coordinate."""
    PROXIMAL = ("proximal", "in the frame of the proximal segment (x forward, y up, z right; ISB)")
    """Along the axes of the proximal segment."""
    DISTAL = ("distal", "in the frame of the distal segment (x forward, y up, z right; ISB)")
    """Along the axes of the distal segment."""
    JCS = (
        "jcs",
        "orthogonal projection on the axes of the joint coordinate system (Grood and Suntay 1983): z of the "
        "proximal segment, the floating axis, y of the distal segment",
    )
    """Projected on the axes of the joint coordinate system."""

    def __init__(self, key: str, words: str) -> None:
        self.key, self.words = key, words


VECTOR_FRAMES = (MomentFrame.PROXIMAL, MomentFrame.DISTAL, MomentFrame.JCS)
"""Those of a moment that is a vector: the order of every array of three frames."""


@dataclass(frozen=True, kw_only=True)
class NetJoint:
    """Two segments, and the three turns through the centre of the joint between them."""

    name: str
    """`hip_r`."""
    proximal: str
    distal: str
    turns: tuple[str, str, str]
    """Coordinates, a reaction, joint parameters, in their order along the linkage."""
    components: tuple[str, str, str]
    """Names of the moments about z, x and y."""
    signs: tuple[float, float, float]
    """About z, x and y: in the sense of the coordinates, which mean the same on both sides."""


_LEG = {
    "hip": ("hip_flexion_{0} hip_adduction_{0} hip_rotation_{0}", "flexion adduction rotation"),
    "knee": ("knee_angle_{0} knee_adduction_{0} knee_{0}.shank.trans", "angle adduction rotation"),
    "ankle": ("talocrural_{0}.shank.front talocrural_{0}.shank.trans ankle_angle_{0}", "angle inversion rotation"),
}
"""Joint -> its turns in their order, and what moments about z, x and y are called."""
_BACK = ("lumbar_extension", "lumbar_bending", "lumbar_rotation")
_SIGNS = {e.name: e.sign for joint in JOINTS for e in joint.elements}


def _joint_of_leg(kind: str, side: str) -> NetJoint:
    segments, (turns, components) = joint_segments(f"{kind}_{side}"), _LEG[kind]
    first, second, third = turns.format(side).split()
    about_z, about_x, about_y = (f"{kind}_{component}_{side}" for component in components.split())
    across = 1.0 if side == "r" else -1.0
    return NetJoint(
        name=f"{kind}_{side}",
        proximal=segments[0],
        distal=segments[-1],
        turns=(first, second, third),
        components=(about_z, about_x, about_y),
        signs=(next(_SIGNS[t] for t in (first, second, third) if t in COORDINATES), across, across),
    )


NET_JOINTS = (
    *(_joint_of_leg(kind, side) for side in SIDES for kind in _LEG),
    NetJoint(
        name="lumbar", proximal="pelvis", distal="head_trunk", turns=_BACK, components=_BACK, signs=(1.0, 1.0, 1.0)
    ),
)
"""Legs, right and left, then the back: the order of every array of joint moments."""
HELD: tuple[str, ...] = tuple(name for joint in NET_JOINTS for name in joint.turns if name in JP_INDEX)
"""Joint parameters among their turns, as `Dynamics` takes them."""
ALL_FORCES: tuple[str, ...] = (*FORCES, *HELD)
"""The 35 generalised forces that the moments follow from."""
COMPONENTS: tuple[str, ...] = tuple(name for joint in NET_JOINTS for name in joint.components)
"""Name of every component, joint by joint: `hip_flexion_r`, `knee_rotation_r`, `ankle_inversion_r`."""


@dataclass(frozen=True)
class MomentSlopes:
    """Moments of all joints and what they depend on; rows run over joint, frame (`VECTOR_FRAMES`), component."""

    values: Array
    """(nf, 63) N·m."""
    by_force: Array
    """(nf, 63, 35) per generalised force (`ALL_FORCES`), posture and joint parameters staying."""
    by_position: Array
    """(nf, 63, nq) per coordinate, generalised forces staying."""
    by_parameter: Array
    """(nf, 63, np) per free joint parameter, generalised forces staying; in the order of the chain."""
    by_turn: dict[str, Array]
    """Segment -> (nf, 63, 3) per turn of its axes in the laboratory (rad), bodies and joints staying."""


def moment_slopes(parameters: Parameters, q: Array, forces: Array, free: tuple[str, ...] = ()) -> MomentSlopes:
    """At coordinates (nf, nq), with generalised forces (nf, 35); `free` are joint parameters to derive by."""
    chain = chain_of(free=(*free, *(name for name in HELD if name not in free)), reactions=True)
    placed = PlacedLinkage(chain, chain.constants(parameters.joint, parameters.zero_angles), q)
    nf, width = len(q), 3 * len(VECTOR_FRAMES)
    rows = width * len(NET_JOINTS)
    wanted = np.array([placed.names.index(n) for n in (*COORDINATES, *(n for n in chain.free if n in free))])
    values, by_force = np.empty((nf, rows)), np.zeros((nf, rows, len(ALL_FORCES)))
    by_variable = np.zeros((nf, rows, len(wanted)))
    by_turn = {segment: np.zeros((nf, rows, 3)) for joint in NET_JOINTS for segment in (joint.proximal, joint.distal)}
    for j, joint in enumerate(NET_JOINTS):
        axes = np.stack([placed.axis(name) for name in joint.turns], axis=1)  # (nf, 3, 3), an axis a row
        columns = [ALL_FORCES.index(name) for name in joint.turns]
        moment = np.asarray(np.linalg.solve(axes, forces[:, columns, None])[:, :, 0], dtype=np.float64)
        e, g, h = _components(placed.frame(joint.proximal), placed.frame(joint.distal), moment)
        signs = np.tile(joint.signs, len(VECTOR_FRAMES))[:, None]
        e, g, h = (signs * x for x in (e, g, h))
        at = slice(width * j, width * (j + 1))
        values[:, at] = (e @ moment[:, :, None])[:, :, 0]
        share = np.linalg.solve(axes.transpose(0, 2, 1), e.transpose(0, 2, 1)).transpose(0, 2, 1)  # c_i, a row each
        by_force[:, at, columns] = share
        by_turn[joint.proximal][:, at] += g
        by_turn[joint.distal][:, at] += h
        above = np.flatnonzero(placed.moves(joint.distal)[wanted])  # and so those that move the proximal segment
        own = wanted[above]
        turning = placed.columns[:, own, 3:].transpose(0, 2, 1)  # (nf, 3, variables)
        found = (g @ turning) * placed.moves(joint.proximal)[own] + h @ turning
        for k, name in enumerate(joint.turns):
            lever = share[:, :, k, None] * cross(axes[:, k], moment)[:, None]
            found -= (lever @ turning) * (placed.rank[own] < placed.rank[placed.names.index(name)])
        by_variable[:, at][:, :, above] = found
    split = len(COORDINATES)
    return MomentSlopes(values, by_force, by_variable[:, :, :split], by_variable[:, :, split:], by_turn)


def _components(proximal: Array, distal: Array, moment: Array) -> tuple[Array, Array, Array]:
    """(nf, 9, 3) each: e_i of the three frames, g_i and h_i, from segment axes (nf, 3, 3), one a row, and M (nf, 3)."""
    order = [2, 0, 1]
    e, still = [proximal[:, order], distal[:, order]], np.zeros_like(proximal)
    across = moment[:, None]
    first, third = proximal[:, 2], distal[:, 1]
    normal = cross(third, first)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    floating = normal / length
    e.append(np.stack([first, floating, third], axis=1))
    b = (moment - (moment * floating).sum(axis=1, keepdims=True) * floating) / length
    nothing = np.zeros_like(moment)
    g = [cross(e[0], across), still]
    g.append(np.stack([cross(first, moment), cross(first, cross(b, third)), nothing], axis=1))
    h = [still, cross(e[1], across)]
    h.append(np.stack([nothing, cross(third, cross(first, b)), cross(third, moment)], axis=1))
    return np.concatenate(e, axis=1), np.concatenate(g, axis=1), np.concatenate(h, axis=1)
