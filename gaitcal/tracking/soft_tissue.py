"""Soft tissue artefacts as unknowns of a trial: markers that move against their segment.

The markers of a segment translate and rotate together about their middle c, in proportion to
functions psi of time:

    marker m at   c + t + exp(theta x) (l_m - c + sum_r psi_r(t) d_mr) + sum_r psi_r(t) B_m z_r,
    (t, theta) = sum_r psi_r(t) mu_r,      B_m = [1, -(l_m - c) x]  (3, 6).

mu_r is the prior mean of all markers together, three translations (m) and three rotations (rad);
d_mr is the deformation, which differs from marker to marker; z_r are translations and rotations
about mu_r. Rotations of clusters reach 25 degrees in deep flexion and shorten lever arms by a
tenth, so only z_r, some degrees, is linearised. z_r are shared by all frames, and those of the same
key by all trials. With R the axes of the segment, x_m the marker and v_k its velocity by variable
k, the half gradient and the entries of the Gauss-Newton matrix are

    g_r = sum_t psi_r sum_m w B_m^T R^T r_m,
    H_kr = sum_t psi_r sum_m w B_m^T R^T v_k,
    H_rs = sum_t psi_r psi_s sum_m w B_m^T B_m.

Secondary motions of the knee, which is no hinge, are unknowns of a trial too. Before it flexes, the
shank translates along x and y and rotates about x and y of the flexion axes, by

    amount_c(t) = z_c2 b_2(phi(t)) + z_c3 b_3(phi(t)),      c: ant, sup (m), front, trans (rad).

phi is the knee angle, tracked with nominal joints. A part linear in phi is equivalent to another
position of the hinge and is left to the joint parameters. b_2 and b_3 are the parts of phi^2
orthogonal to 1 and phi, and of phi^3 orthogonal to 1, phi and phi^2, over all trials of one kind of
task, with mean square one. Knees of cadavers (Walker et al., J Biomech 21:965-974, 1988) are so
described to 0.1 degrees.

z are variables of the chain like joint parameters (`Chain.secondary`). Their columns are those of a
translation or rotation there, times b. Tracking and torques keep the hinge.
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
from gaitcal.tracking import banded, marker_residual, spline

MIN_ANGLE_SPREAD_RAD = np.deg2rad(2.0)
"""rad, least standard deviation of an angle in a task: a smaller one moves soft tissue no more."""
# Components of z_r: translations along and rotations about the axes of the segment
COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")
WIDTH = len(COMPONENTS)
"""Number of components of z_r."""
RANK_TOLERANCE = 1e-3
"""Part of the largest singular value of B below which markers do not determine a motion: a rotation
about their line.
"""


@dataclass(frozen=True)
class SecondaryColumns:
    """Secondary motions of the joints in a trial."""

    kind: str  # of task: trials of one kind share the unknowns
    regressors: dict[str, tuple[Array, Array]]  # coordinate -> (nf,) b_2 and b_3

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(n,) of the chain's variables."""
        return tuple(
            element.name + bend
            for name in self.regressors
            for bend in BENDS
            for element in SECONDARY[name]
        )

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """(n,) as trials share them, `kind/coordinate/bend/name`."""
        return tuple(
            f"{self.kind}/{name}/{bend}/{element.name}"
            for name in self.regressors
            for bend in BENDS
            for element in SECONDARY[name]
        )

    def evaluate(self, z: Array) -> SecondaryMotion:
        """Evaluate the secondary motions.

        Parameters
        ----------
        z
            (n,) m, rad, unknowns.

        Returns
        -------
        SecondaryMotion
        """
        values = z.reshape(len(self.regressors), len(BENDS), -1)
        amounts = {
            name: np.asarray(factors.T @ np.array(bends), float)
            for factors, (name, bends) in zip(values, self.regressors.items(), strict=True)
        }
        return SecondaryMotion(amounts=amounts, regressors=self.regressors)


def build_secondary_columns(
    kind: str, angles: Sequence[Mapping[str, Array]]
) -> list[SecondaryColumns]:
    """Build the secondary motions of the trials of one kind of task.

    Parameters
    ----------
    kind
        Kind of task; its trials share the unknowns.
    angles
        Per trial: coordinate -> (nf,) rad.

    Returns
    -------
    list of SecondaryColumns
        One for each trial.
    """
    out: list[dict[str, tuple[Array, Array]]] = [{} for _ in angles]
    for name in SECONDARY:
        moved = [k for k, of_trial in enumerate(angles) if name in of_trial]
        if moved:
            both = _orthogonalise_bends(np.concatenate([angles[k][name] for k in moved]))
            ends = np.cumsum([len(angles[k][name]) for k in moved])[:-1]
            for k, square, cube in zip(moved, *(np.split(b, ends) for b in both), strict=True):
                out[k][name] = square, cube
    return [SecondaryColumns(kind, regressors) for regressors in out]


def _orthogonalise_bends(angle: Array) -> Array:
    """Compute (2, nf) b_2 and b_3 of an angle (nf,) rad.

    Zero where the frames are too few to distinguish a curve from a line.
    """
    columns = len(BENDS) + 2
    if len(angle) < columns:
        return np.zeros((len(BENDS), len(angle)))
    psi = (angle - angle.mean()) / max(float(angle.std()), MIN_ANGLE_SPREAD_RAD)
    q, r = np.linalg.qr(np.vander(psi, columns, increasing=True))
    size = psi.std() ** np.arange(2, columns)
    return np.sqrt(len(psi)) * (q[:, 2:] * np.sign(np.diag(r)[2:]) * size).T


@dataclass(frozen=True, kw_only=True)
class SegmentTissue:
    """Soft tissue artefact of the markers of one segment."""

    segment: int  # index into the chain's segments
    carrier: str  # name of the segment
    markers: slice
    pattern: Array  # (nm, 3, 6) B of its markers
    # (nr,) `gait/hip_flexion_r`: the same name on a segment of two trials is the same unknown
    names: tuple[str, ...]
    regressors: Array  # (nr, nf) psi
    # (nr, nm, 3) m: displacements of the markers of a person of softness 1 before any fit
    expected: Array
    covariance: Array  # (nr, 6, 6) m^2, m rad, rad^2 of z
    by_marker: Array  # (nr, 3 nm, 3 nm) m^2 of the markers about `expected`, deformation and all
    softness: float = 1.0  # mu is so much of `expected`
    deformation: Array | None = None
    """(nr, nm, 3) m, what the markers were observed to do against each other, in the place of what
    is expected.
    """

    @cached_property
    def displacement(self) -> Array:
        """(nm, 3, nf) m, of each marker before anything is fitted."""
        rigid = self.softness * np.array([self.fit_rigid_part(moves) for moves in self.expected])
        deformation = self.deformation
        if deformation is None:
            deformation = self.softness * self.expected - np.array(
                [self.pattern @ moves for moves in rigid]
            )
        # the lever arms that `build_rigid_pattern` has made B of
        arms = np.stack(
            [self.pattern[:, 1, 5], self.pattern[:, 2, 3], self.pattern[:, 0, 4]], axis=1
        )
        # (nf, 6)
        path = self.regressors.T @ rigid
        deformed = arms[:, :, None] + np.einsum("rmi,rf->mif", deformation, self.regressors)
        rotated = np.einsum("fij,mjf->mif", Rotation.from_rotvec(path[:, 3:]).as_matrix(), deformed)
        return np.asarray(rotated - arms[:, :, None] + path[:, :3].T)

    def fit_rigid_part(self, moves: Array) -> Array:
        """Fit a translation and a rotation to displacements of the markers.

        Parameters
        ----------
        moves
            (nm, 3) m.

        Returns
        -------
        (6,) array
            m, rad.
        """
        flat = self.pattern.reshape(-1, WIDTH)
        return np.asarray(np.linalg.pinv(flat, rcond=RANK_TOLERANCE) @ moves.ravel())


@dataclass(frozen=True)
class SoftTissue:
    """Soft tissue artefacts and secondary joint motions of a trial.

    Columns run over segments, regressors, and components: translations, then rotations.
    """

    groups: tuple[SegmentTissue, ...]
    # variables of the chain, before the columns of segments
    secondary: SecondaryColumns | None = None

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """(nz,) of the segments, `regressor/segment/component`."""
        return tuple(
            f"{n}/{group.carrier}/{c}"
            for group in self.groups
            for n in group.names
            for c in COMPONENTS
        )

    def compute_shift(self, z: Array, markers: int) -> Array:
        """Compute the displacement of every marker of the trial in its segment.

        Parameters
        ----------
        z
            (nz,) m, rad, unknowns of the segments.
        markers
            Number of markers of the trial.

        Returns
        -------
        (markers, 3, nf) array
            m, axes of the segments.
        """
        out, at = np.zeros((markers, 3, self.groups[0].regressors.shape[1])), 0
        for group in self.groups:
            part = z[at : at + WIDTH * len(group.names)].reshape(-1, WIDTH)
            out[group.markers] = group.pattern @ (part.T @ group.regressors)
            out[group.markers] += group.displacement
            at += part.size
        return out


def build_rigid_pattern(arms: Array) -> Array:
    """Build the matrices B of markers that move together.

    Parameters
    ----------
    arms
        (nm, 3) m, positions from their middle.

    Returns
    -------
    (nm, 3, 6) array
    """
    out = np.zeros((len(arms), 3, WIDTH))
    out[:, :, :3] = np.eye(3)
    # e_j x arm, for e_j the axis of rotation
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i, 3 + j], out[:, i, 3 + k] = arms[:, k], -arms[:, j]
    return out


def add_tissue_columns(
    body: LinkageModel,
    basis: spline.SplineBasis,
    data: marker_residual.MarkerData,
    tissue: SoftTissue,
    equations: banded.NormalEquations,
    coefficients: Array,
    *,
    curved: bool = False,
) -> banded.NormalEquations:
    """Add the columns of soft tissue to the normal equations of a trial.

    Parameters
    ----------
    body, basis, data, tissue
        Linkage, splines, markers and soft tissue of the trial.
    equations
        Normal equations without soft tissue.
    coefficients
        (nn, nq) at which the equations were assembled.
    curved
        Add half the whole Hessian instead of the Gauss-Newton matrix.

    Returns
    -------
    NormalEquations
        Soft tissue follows the joint parameters.

    Notes
    -----
    A rotation e of the segment also rotates the column b of a marker at x by e x b. With
    r = x - measured, the term  b . (e x x)  of Gauss-Newton gets  r . (e x b);  their sum is
    b . (e x measured).
    """
    q = basis.evaluate(coefficients)
    nq, nz, n_free = q.shape[1], len(tissue.keys), len(body.chain.free)
    placed = Kinematics(body, q, data.secondary)
    segments, columns = placed.segments, placed.columns
    position = marker_residual.place_markers(data.placed, segments, data.shift)
    mixed = np.zeros((basis.control_points, nq, n_free + nz))
    mixed[:, :, :n_free] = equations.mixed.reshape(len(mixed), nq, n_free)
    by_parameter, corner, gradient = np.zeros((n_free, nz)), np.zeros((nz, nz)), np.zeros(nz)
    spread, at = basis.matrices[0].T.tocsr(), 0
    for group in tissue.groups:
        # (3 axes, 3, nf), (nr, nf)
        axes, psi = segments[group.segment, :3], group.regressors
        nr, nf = psi.shape
        moved = np.flatnonzero(body.chain.support[:, group.segment])
        turning = moved < nq
        weight, pattern = data.weight[group.markers], group.pattern
        # (nm, 3, nf), in the segment
        arm = _express_in_axes(axes, position[group.markers])
        measured = _express_in_axes(axes, data.measured[group.markers])
        # (6, 3 nm) B of all markers side by side, and sum_m w B_m^T r_m
        side_by_side = pattern.reshape(-1, WIDTH).T
        pull = side_by_side @ (weight[:, None] * (arm - measured)).reshape(-1, nf)
        products = np.matmul(pattern.transpose(0, 2, 1), pattern).reshape(len(pattern), -1)
        inertia = products.T @ weight
        # sum_m w B_m^T and sum_m w B_m^T [x_m x]^T: sums over all markers that multiply the linear
        # and the angular velocity of a variable
        of_velocity = (pattern.reshape(len(pattern), -1).T @ weight).reshape(3, WIDTH, nf)
        of_spin = np.zeros((3, WIDTH, nf))
        weighted = weight[:, None] * (measured if curved else arm)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            # (spin x arm)_j = spin_k arm_i - spin_i arm_k
            # (spin x arm)_k = spin_i arm_j - spin_j arm_i
            of_spin[i] = pattern[:, k].T @ weighted[:, j] - pattern[:, j].T @ weighted[:, k]
        velocity, spin = (
            _express_in_axes(axes, columns[moved, :3]),
            _express_in_axes(axes, columns[moved, 3:]),
        )
        met = np.zeros((len(moved), WIDTH, nf))
        for i in range(3):
            met += of_velocity[i] * velocity[:, None, i]
            met += of_spin[i] * spin[:, None, i]
        here = slice(at, at + WIDTH * nr)
        gradient[here] = (psi @ pull.T).ravel()
        both = (psi[:, None] * psi).reshape(-1, nf) @ inertia.T
        corner[here, here] = (
            both.reshape(nr, nr, WIDTH, WIDTH).transpose(0, 2, 1, 3).reshape(WIDTH * nr, -1)
        )
        of_parameters = (met[~turning].reshape(-1, nf) @ psi.T).reshape(-1, WIDTH, nr)
        by_parameter[moved[~turning] - nq, here] = of_parameters.transpose(0, 2, 1).reshape(
            -1, WIDTH * nr
        )
        # One regressor at a time: all at once do not fit the cache of the processor.
        by_frame = np.ascontiguousarray(met[turning].reshape(-1, nf).T)
        for r, of_regressor in enumerate(psi):
            first = n_free + here.start + WIDTH * r
            summed = spread @ (of_regressor[:, None] * by_frame)
            mixed[:, moved[turning], first : first + WIDTH] = summed.reshape(len(mixed), -1, WIDTH)
        at = here.stop
    return replace(
        equations,
        mixed=mixed.reshape(len(mixed) * nq, n_free + nz),
        parameters=np.block([[equations.parameters, by_parameter], [by_parameter.T, corner]]),
        parameter_gradient=np.concatenate([equations.parameter_gradient, gradient]),
    )


def compute_tissue_gradient(
    body: LinkageModel, data: marker_residual.MarkerData, tissue: SoftTissue, q: Array
) -> Array:
    """Compute the half gradient of the marker cost by the soft tissue.

    Parameters
    ----------
    body, data, tissue
        Linkage, markers and soft tissue of the trial.
    q
        (nf, nq) coordinates, m and rad.

    Returns
    -------
    (nz,) array
    """
    segments = Kinematics(body, q, data.secondary, columns=False).segments
    position = marker_residual.place_markers(data.placed, segments, data.shift)
    out = []
    for group in tissue.groups:
        axes, pull = segments[group.segment, :3], np.zeros((WIDTH, len(q)))
        for m, pattern in zip(
            range(group.markers.start, group.markers.stop), group.pattern, strict=True
        ):
            pull += pattern.T @ (
                data.weight[m] * _express_in_axes(axes, position[m] - data.measured[m])
            )
        out.append((group.regressors @ pull.T).ravel())
    return np.concatenate(out)


def _express_in_axes(axes: Array, vectors: Array) -> Array:
    """Express vectors (..., 3, nf) in three axes (3, 3, nf)."""
    out = np.empty_like(vectors)
    for j, axis in enumerate(axes):
        out[..., j, :] = (
            axis[0] * vectors[..., 0, :]
            + axis[1] * vectors[..., 1, :]
            + axis[2] * vectors[..., 2, :]
        )
    return out
