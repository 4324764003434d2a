"""Markers that leave the place where the static trial shows them: skin movement as unknowns of a trial.

Marker m sits in its segment at

    l_m + sum_c z_c e_c phi_c(f)        (c: columns of this marker; e_c one of the segment's axes)

phi_c an angle of a joint beside the segment, counted from the static pose: skin that moves in proportion to it. The
unknowns z are shared by all frames, and those of the same key by all trials. With R the segment's axes, x_m the marker
and v_k the velocity that variable k gives it, the column's half gradient and its entries of the Gauss-Newton matrix are

    g_c = sum_f w phi_c (R^T r)_c,    H_kc = sum_f w phi_c (R^T v_k)_c,    H_cd = sum_f w phi_c phi_d

for d of the same marker and axis, else 0: R^T R = 1. That the markers of a segment move together is told by the prior,
which lets their columns move together (`calibration/skin_movement.py`), not by columns of its own.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.chain import Chain, ChainConstants
from gaitcal.model.kinematics import forward, jacobian, segment_transforms
from gaitcal.motion.banded import NormalEquations
from gaitcal.motion.marker_residual import MarkerData, marker_positions
from gaitcal.motion.spline import SplineBasis, basis_matrix
from gaitcal.records import dataclass


@dataclass(frozen=True)
class SegmentTissue:
    """What moves the markers of one segment against it."""

    segment: int
    """Index into the chain's segments."""
    markers: slice
    """Its markers."""
    names: tuple[str, ...]
    """(nr,) `hip_flexion_r`: the same name in two trials is the same unknown."""
    regressors: Array
    """(nr, nf) phi."""


@dataclass(frozen=True)
class SoftTissue:
    """The columns of a trial, marker by marker, of each regressor by regressor, of each x, y, z."""

    groups: tuple[SegmentTissue, ...]
    labels: tuple[str, ...]
    """(nm,) of all markers of the trial."""

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """(nz,) `regressor/marker/axis`."""
        return tuple(
            f"{name}/{self.labels[m]}/{axis}"
            for group in self.groups
            for m in range(group.markers.start, group.markers.stop)
            for name in group.names
            for axis in "xyz"
        )

    def shift(self, z: Array) -> Array:
        """(nm, 3, nf) m, displacement of every marker in its segment."""
        nf = self.groups[0].regressors.shape[1]
        out, at = np.zeros((len(self.labels), 3, nf)), 0
        for group in self.groups:
            count, nr = group.markers.stop - group.markers.start, len(group.names)
            own = z[at : at + 3 * nr * count].reshape(count, nr, 3)
            out[group.markers] = np.einsum("mri,rf->mif", own, group.regressors)
            at += own.size
        return out


def with_tissue_columns(
    chain: Chain,
    basis: SplineBasis,
    data: MarkerData,
    tissue: SoftTissue,
    equations: NormalEquations,
    nodes: Array,
    constants: ChainConstants,
) -> NormalEquations:
    """The normal equations of a trial at `nodes` with the columns of its soft tissue after its joint parameters."""
    q = basis.evaluate(nodes)
    nf, nq = q.shape
    poses = forward(chain, constants, q)
    segments = segment_transforms(chain, constants, poses)
    columns = jacobian(chain, constants, poses)
    position = marker_positions(chain, constants, data.placed, q, data.shift)
    nz, n_free = len(tissue.keys), len(chain.free)
    mixed = np.zeros((basis.nodes, nq, nz))
    by_parameter, own, gradient = np.zeros((n_free, nz)), np.zeros((nz, nz)), np.zeros(nz)
    spread, at = basis_matrix(basis).T.tocsr(), 0
    for group in tissue.groups:
        axes = segments[group.segment, :3]  # (3 axes, 3, nf)
        moved = np.flatnonzero(chain.support[:, group.segment])
        turning = moved < nq
        velocity, spin = columns[moved, :3], columns[moved, 3:]
        phi, nr = group.regressors, len(group.names)
        for m in range(group.markers.start, group.markers.stop):
            weight, x = data.weight[m], position[m]
            here = slice(at, at + 3 * nr)
            gradient[here] = (phi @ (weight * _in_axes(axes, x - data.measured[m])).T).ravel()
            own[here, here] = np.kron((phi * weight) @ phi.T, np.eye(3))
            local = weight * _in_axes(axes, velocity + _cross(spin, x))
            shaped = local[:, None] * phi[:, None]  # (nk, nr, 3, nf)
            by_parameter[moved[~turning] - nq, here] = shaped[~turning].sum(axis=-1).reshape(-1, 3 * nr)
            rows = shaped[turning].reshape(-1, nf)
            mixed[:, moved[turning], here] = (spread @ rows.T).reshape(basis.nodes, -1, 3 * nr)
            at += 3 * nr
    return replace(
        equations,
        mixed=np.hstack([equations.mixed, mixed.reshape(-1, nz)]),
        parameters=np.block([[equations.parameters, by_parameter], [by_parameter.T, own]]),
        parameter_gradient=np.concatenate([equations.parameter_gradient, gradient]),
    )


def _in_axes(axes: Array, vectors: Array) -> Array:
    """(..., 3, nf) vectors along three axes (3, 3, nf)."""
    out = np.empty_like(vectors)
    for j, axis in enumerate(axes):
        out[..., j, :] = axis[0] * vectors[..., 0, :] + axis[1] * vectors[..., 1, :] + axis[2] * vectors[..., 2, :]
    return out


def _cross(spin: Array, arm: Array) -> Array:
    """(n, 3, nf) spin x arm for (n, 3, nf) and (3, nf); np.cross makes arrays of that size twice over."""
    out = np.empty_like(spin)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i] = spin[:, j] * arm[k] - spin[:, k] * arm[j]
    return out
