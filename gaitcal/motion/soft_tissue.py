"""Markers that leave the place where the static trial shows them: soft tissue that moves as unknowns of a trial.

The markers of a segment shift and turn together about their middle c, in proportion to some functions psi of time:

    marker m at   c + t + exp(theta x) (l_m - c + sum_r psi_r(t) d_mr) + sum_r psi_r(t) B_m z_r,
    (t, theta) = sum_r psi_r(t) mu_r,      B_m = [1, -(l_m - c) x]  (3, 6),

mu_r what is expected of all markers together, three shifts (m) and three turns (rad), d_mr what a marker does beside
them, and z_r shifts and turns about mu_r. Turns of tracked bones reach 25 degrees in deep flexion, by which lever arms
shorten by a tenth: only z_r, some degrees, is taken for small. z_r are shared by all
frames, and those of the same key by all trials. With R the segment's axes, x_m the marker and v_k the velocity that
variable k gives it, the half gradient and the entries of the Gauss-Newton matrix are

    g_r = sum_t psi_r sum_m w B_m^T R^T r_m,                H_kr = sum_t psi_r sum_m w B_m^T R^T v_k,
    H_rs = sum_t psi_r psi_s sum_m w B_m^T B_m.

A knee is no hinge, it rolls, glides and turns: what it does besides, as unknowns of a trial too. Before it flexes, the
shank slides along x and y and turns about x and y of the axes that flexion turns about, by

    amount_c(t) = z_c2 b_2(phi(t)) + z_c3 b_3(phi(t)),      c: ant, sup (m), front, trans (rad),

phi the knee's angle, tracked with nominal joints. What goes linearly with phi is a hinge that lies elsewhere, and is
left to the joint parameters. b_2 and b_3 are what 1 and phi leave of phi^2, and 1, phi and phi^2 of phi^3, over all
trials of one kind of task, of mean square one: sizes of z are those of the motion in the task. Knees of cadavers
(Walker et al., J Biomech 21:965-974, 1988) are so described to 0.1 degrees.

z are variables of the chain like joint parameters (`Chain.secondary`); their columns are those of a joint that slides
or turns there, times b, so that all equations of a trial hold them. Tracking and torques keep the hinge.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.model.chain import LinkageModel
from gaitcal.model.kinematics import Kinematics, SecondaryMotion
from gaitcal.model.linkage import BENDS, SECONDARY
from gaitcal.motion import banded, marker_residual, spline

LEAST_SPREAD = np.deg2rad(2.0)  # rad: an angle that moves less in a task moves no more with it than one that does
COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")  # of z_r: shifts along and turns about the segment's axes
WIDTH = len(COMPONENTS)
SMALLEST = 1e-3
"""Part of the largest singular value of B below which markers do not show a motion: a turn about their line."""


@dataclass(frozen=True)
class SecondaryColumns:
    """The secondary motions of a trial."""

    kind: str  # of task: trials of one kind share the unknowns
    regressors: dict[str, tuple[Array, Array]]  # coordinate -> (nf,) b_2 and b_3

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(n,) of the chain's variables."""
        return tuple(element.name + bend for name in self.regressors for bend in BENDS for element in SECONDARY[name])

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """(n,) as trials share them, `kind/coordinate/bend/name`."""
        return tuple(
            f"{self.kind}/{name}/{bend}/{element.name}"
            for name in self.regressors
            for bend in BENDS
            for element in SECONDARY[name]
        )

    def at(self, z: Array) -> SecondaryMotion:
        """With the unknowns at z (n,), m and rad."""
        values = z.reshape(len(self.regressors), len(BENDS), -1)
        amounts = {
            name: np.asarray(own.T @ np.array(bends), float)
            for own, (name, bends) in zip(values, self.regressors.items(), strict=True)
        }
        return SecondaryMotion(amounts=amounts, regressors=self.regressors)


def secondary_columns(kind: str, angles: Sequence[Mapping[str, Array]]) -> list[SecondaryColumns]:
    """Per trial of one kind of task, from coordinate -> (nf,) rad."""
    out: list[dict[str, tuple[Array, Array]]] = [{} for _ in angles]
    for name in SECONDARY:
        moved = [k for k, of_trial in enumerate(angles) if name in of_trial]
        if moved:
            both = _bends(np.concatenate([angles[k][name] for k in moved]))
            ends = np.cumsum([len(angles[k][name]) for k in moved])[:-1]
            for k, square, cube in zip(moved, *(np.split(b, ends) for b in both), strict=True):
                out[k][name] = square, cube
    return [SecondaryColumns(kind, regressors) for regressors in out]


def _bends(angle: Array) -> Array:
    """(2, nf) b_2 and b_3 of an angle (nf,) rad; zero where the frames are too few to tell bends from a line."""
    columns = len(BENDS) + 2
    if len(angle) < columns:
        return np.zeros((len(BENDS), len(angle)))
    psi = (angle - angle.mean()) / max(float(angle.std()), LEAST_SPREAD)
    q, r = np.linalg.qr(np.vander(psi, columns, increasing=True))
    size = psi.std() ** np.arange(2, columns)
    return np.sqrt(len(psi)) * (q[:, 2:] * np.sign(np.diag(r)[2:]) * size).T


@dataclass(frozen=True, kw_only=True)
class SegmentTissue:
    """What moves the markers of one segment against it."""

    segment: int  # index into the chain's segments
    carrier: str  # name of the segment
    markers: slice
    pattern: Array  # (nm, 3, 6) B of its markers
    names: tuple[str, ...]  # (nr,) `gait/hip_flexion_r`: the same name on a segment of two trials is the same unknown
    regressors: Array  # (nr, nf) psi
    expected: Array  # (nr, nm, 3) m: what the markers of a person of softness 1 do before anything is fitted
    covariance: Array  # (nr, 6, 6) m^2, m rad, rad^2 of z
    by_marker: Array  # (nr, 3 nm, 3 nm) m^2 of the markers about `expected`, deformation and all
    softness: float = 1.0  # mu is so much of `expected`
    deformation: Array | None = None
    """(nr, nm, 3) m, what the markers were observed to do against each other, in the place of what is expected."""

    @cached_property
    def displacement(self) -> Array:
        """(nm, 3, nf) m, of each marker before anything is fitted."""
        rigid = self.softness * np.array([self.rigid_part(moves) for moves in self.expected])
        deformation = self.deformation
        if deformation is None:
            deformation = self.softness * self.expected - np.array([self.pattern @ moves for moves in rigid])
        # the lever arms that `together` has made B of
        arms = np.stack([self.pattern[:, 1, 5], self.pattern[:, 2, 3], self.pattern[:, 0, 4]], axis=1)
        path = self.regressors.T @ rigid  # (nf, 6)
        deformed = arms[:, :, None] + np.einsum("rmi,rf->mif", deformation, self.regressors)
        turned = np.einsum("fij,mjf->mif", Rotation.from_rotvec(path[:, 3:]).as_matrix(), deformed)
        return np.asarray(turned - arms[:, :, None] + path[:, :3].T)

    def rigid_part(self, moves: Array) -> Array:
        """(6,) the shift and turn nearest to what each marker does, (nm, 3) m."""
        flat = self.pattern.reshape(-1, WIDTH)
        return np.asarray(np.linalg.pinv(flat, rcond=SMALLEST) @ moves.ravel())


@dataclass(frozen=True)
class SoftTissue:
    """What moves the markers of a trial against the linkage besides its motion.

    The columns of segments, regressor by regressor, shifts before turns; and what its joints do beside them.
    """

    groups: tuple[SegmentTissue, ...]
    secondary: SecondaryColumns | None = None  # variables of the chain, before the columns of segments

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """(nz,) of the segments, `regressor/segment/component`."""
        return tuple(f"{n}/{group.carrier}/{c}" for group in self.groups for n in group.names for c in COMPONENTS)

    def shift(self, z: Array, markers: int) -> Array:
        """(markers, 3, nf) m, displacement of every marker of the trial in its segment."""
        out, at = np.zeros((markers, 3, self.groups[0].regressors.shape[1])), 0
        for group in self.groups:
            part = z[at : at + WIDTH * len(group.names)].reshape(-1, WIDTH)
            out[group.markers] = group.pattern @ (part.T @ group.regressors)
            out[group.markers] += group.displacement
            at += part.size
        return out


def together(arms: Array) -> Array:
    """(nm, 3, 6) B of markers at `arms` (nm, 3) m from their middle."""
    out = np.zeros((len(arms), 3, WIDTH))
    out[:, :, :3] = np.eye(3)
    for i in range(3):  # e_j x arm, for e_j the axis turned about
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i, 3 + j], out[:, i, 3 + k] = arms[:, k], -arms[:, j]
    return out


def with_tissue_columns(
    body: LinkageModel,
    basis: spline.SplineBasis,
    data: marker_residual.MarkerData,
    tissue: SoftTissue,
    equations: banded.NormalEquations,
    coefficients: Array,
    *,
    curved: bool = False,
) -> banded.NormalEquations:
    """Normal equations of a trial at `coefficients` with the columns of its soft tissue after its joint parameters.

    `curved`: with half the whole Hessian. A spin e of the segment turns the column b of a marker at x, too, by e x b:
    to  b . (e x x)  comes  r . (e x b),  r = x - measured, together  b . (e x measured).
    """
    q = basis.evaluate(coefficients)
    nq, nz, n_free = q.shape[1], len(tissue.keys), len(body.chain.free)
    placed = Kinematics(body, q, data.secondary)
    segments, columns = placed.segments, placed.columns
    position = marker_residual.position_markers(data.placed, segments, data.shift)
    mixed = np.zeros((basis.nodes, nq, nz))
    by_parameter, corner, gradient = np.zeros((n_free, nz)), np.zeros((nz, nz)), np.zeros(nz)
    spread, at = basis.matrices[0].T.tocsr(), 0
    for group in tissue.groups:
        axes, psi = segments[group.segment, :3], group.regressors  # (3 axes, 3, nf), (nr, nf)
        moved = np.flatnonzero(body.chain.support[:, group.segment])
        turning = moved < nq
        pull, inertia = np.zeros((WIDTH, psi.shape[1])), np.zeros((WIDTH, WIDTH, psi.shape[1]))
        # sum_m w B_m^T and sum_m w B_m^T [x_m x]^T: what all markers make of a velocity and a spin, in the segment
        of_velocity, of_spin = np.zeros((2, WIDTH, 3, psi.shape[1]))
        for m, pattern in zip(range(group.markers.start, group.markers.stop), group.pattern, strict=True):
            weight, arm = data.weight[m], _in_axes(axes, position[m])
            measured = _in_axes(axes, data.measured[m])
            pull += pattern.T @ (weight * (arm - measured))
            arm = measured if curved else arm
            inertia += weight * (pattern.T @ pattern)[:, :, None]
            weighted = pattern.T[:, :, None] * weight
            of_velocity += weighted
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                # (spin x arm)_j = spin_k arm_i - spin_i arm_k,  (spin x arm)_k = spin_i arm_j - spin_j arm_i
                of_spin[:, i] += weighted[:, k] * arm[j] - weighted[:, j] * arm[k]
        velocity, spin = _in_axes(axes, columns[moved, :3]), _in_axes(axes, columns[moved, 3:])
        met = np.zeros((len(moved), WIDTH, psi.shape[1]))
        for i in range(3):
            met += of_velocity[:, i] * velocity[:, None, i]
            met += of_spin[:, i] * spin[:, None, i]
        here = slice(at, at + WIDTH * len(psi))
        gradient[here] = (psi @ pull.T).ravel()
        both = (psi[:, None] * psi).reshape(-1, psi.shape[1]) @ inertia.reshape(-1, psi.shape[1]).T
        corner[here, here] = (
            both.reshape(len(psi), len(psi), WIDTH, WIDTH).transpose(0, 2, 1, 3).reshape(WIDTH * len(psi), -1)
        )
        by_parameter[moved[~turning] - nq, here] = (
            (met[~turning] @ psi.T).transpose(0, 2, 1).reshape(-1, WIDTH * len(psi))
        )
        # frame by frame, one regressor at a time: all at once are too many to stay in the processor's memory
        by_frame = np.ascontiguousarray(met[turning].reshape(-1, psi.shape[1]).T)
        for r, of_regressor in enumerate(psi):
            of_columns = slice(here.start + WIDTH * r, here.start + WIDTH * (r + 1))
            summed = spread @ (of_regressor[:, None] * by_frame)
            mixed[:, moved[turning], of_columns] = summed.reshape(basis.nodes, -1, WIDTH)
        at = here.stop
    return replace(
        equations,
        mixed=np.hstack([equations.mixed, mixed.reshape(-1, nz)]),
        parameters=np.block([[equations.parameters, by_parameter], [by_parameter.T, corner]]),
        parameter_gradient=np.concatenate([equations.parameter_gradient, gradient]),
    )


def tissue_gradient(body: LinkageModel, data: marker_residual.MarkerData, tissue: SoftTissue, q: Array) -> Array:
    """(nz,) half gradient of a trial's marker cost by its soft tissue, at coordinates (nf, nq)."""
    segments = Kinematics(body, q, data.secondary, columns=False).segments
    position = marker_residual.position_markers(data.placed, segments, data.shift)
    out = []
    for group in tissue.groups:
        axes, pull = segments[group.segment, :3], np.zeros((WIDTH, len(q)))
        for m, pattern in zip(range(group.markers.start, group.markers.stop), group.pattern, strict=True):
            pull += pattern.T @ (data.weight[m] * _in_axes(axes, position[m] - data.measured[m]))
        out.append((group.regressors @ pull.T).ravel())
    return np.concatenate(out)


def _in_axes(axes: Array, vectors: Array) -> Array:
    """(..., 3, nf) vectors along three axes (3, 3, nf)."""
    out = np.empty_like(vectors)
    for j, axis in enumerate(axes):
        out[..., j, :] = axis[0] * vectors[..., 0, :] + axis[1] * vectors[..., 1, :] + axis[2] * vectors[..., 2, :]
    return out
