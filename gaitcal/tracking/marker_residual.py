"""Marker residuals and their normal equations, frame by frame, without a marker Jacobian.

Marker m of segment s is at x_m = o_s + R_s l_m = T_s [l_m; 1]. Its residual is r_m = x_m -
measured_m, with weight w_m >= 0 in each frame (0 where it was not observed). J_k = [v; w] is the
spatial velocity (about the laboratory origin) that variable k gives to all segments after it. Cost,
half gradient and Gauss-Newton matrix of  sum_m w_m |r_m|^2  are

    g_k  = J_k . sum_{m after k} w_m [r_m; x_m x r_m]
    H_kl = J_k . Y_l J_l   (l after k)
    Y_l  = sum_{m after l} w_m [1, -x~_m; x~_m, -x~_m x~_m].

Y_l is the spatial inertia of point masses w_m at the markers. H is therefore the joint-space
inertia matrix of that model, as `pin.crba` computes it, for all frames at once and with weights
that may differ in every frame. Sums over the markers of a segment are transformed with the segment:

    sum w [x; 1] [x; 1]^T = T_s P_s T_s^T,  P_s = sum w [l; 1] [l; 1]^T,
    sum w x x r = sum_j T_sj x (sum w [l; 1]_j r).

P_s is constant as long as the weights are. Sums run from the tips to the root, once for each
distinct set of segments. Newton's matrix adds the curvature of the marker paths. With r_m already
multiplied by its weight, the second derivative of marker m by variables k before l (or k = l) is
w_k x (v_l + w_l x x_m), so that half the Hessian gains

    sum_{m after l} r_m . (w_k x (v_l + w_l x x_m))  =  w_k . p_l,
    p_l = v_l x F_l + C_l w_l - tr(C_l) w_l,
    F_l = sum r_m,     C_l = sum x_m r_m^T.

Far from the measured markers this term is large. With joint parameters off by 10 mm and 10 degrees,
Gauss-Newton alone converges by a factor of about two a step, with it by factors of hundreds.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.model.chain import Chain, LinkageModel
from gaitcal.model.kinematics import Kinematics, SecondaryMotion

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_ALL = slice(None)


@dataclass(frozen=True)
class PlacedMarkers:
    """Positions of markers in their segments, sorted by segment."""

    segment: IntArray  # (nm,) index into the chain's segments, not decreasing
    local: Array  # (nm, 3) m, position in the segment frame

    @cached_property
    def groups(self) -> list[tuple[int, slice]]:
        """Segments that carry markers, and the slice of their markers."""
        edges = np.flatnonzero(np.diff(self.segment)) + 1
        bounds = [0, *edges.tolist(), len(self.segment)]
        return (
            [(int(self.segment[a]), slice(a, b)) for a, b in pairwise(bounds)]
            if len(self.segment)
            else []
        )

    @cached_property
    def extended(self) -> Array:
        """(nm, 4) [l; 1]."""
        return np.concatenate([self.local, np.ones((len(self.local), 1))], axis=1)


@dataclass(frozen=True)
class MarkerData:
    """Markers of one trial: positions in their segments and measured positions.

    Axes of arrays: marker, xyz, frame.
    """

    placed: PlacedMarkers
    measured: Array  # (nm, 3, nf) m; any finite number where the weight is zero
    weight: Array  # (nm, nf) >= 0
    # (nm, 3, nf) m, how far each marker is from its place, in its segment's axes
    shift: Array | None = None
    # movement of joints besides that along their coordinates
    secondary: SecondaryMotion | None = None

    @property
    def segment(self) -> IntArray:
        """(nm,) of `placed`."""
        return self.placed.segment

    @property
    def local(self) -> Array:
        """(nm, 3) of `placed`, m."""
        return self.placed.local

    @cached_property
    def moments(self) -> Array:
        """(n, 4, 4, nf or 1) P_s of the n segments that carry markers.

        One frame is enough where the weights are constant.
        """
        weight, extended = self.weight, self.placed.extended
        if self.shift is not None:
            ones = np.ones((len(weight), 1, weight.shape[1]))
            moved = np.concatenate([self.local[:, :, None] + self.shift, ones], axis=1)
            return np.array(
                [
                    np.einsum("mf,maf,mbf->abf", weight[m], moved[m], moved[m])
                    for _, m in self.placed.groups
                ]
            )
        if (weight == weight[:, :1]).all():
            weight = weight[:, :1]
        products = (extended[:, :, None] * extended[:, None, :]).reshape(-1, 16)
        out = [products[markers].T @ weight[markers] for _, markers in self.placed.groups]
        return np.array(out).reshape(len(out), 4, 4, -1)

    def select_frames(self, part: slice | IntArray) -> "MarkerData":
        """Return the same markers in some frames.

        Parameters
        ----------
        part
            Frames, as a slice or as indices.

        Returns
        -------
        MarkerData
        """
        if isinstance(part, slice) and part == slice(0, self.weight.shape[1]):
            return self
        shift = None if self.shift is None else self.shift[:, :, part]
        secondary = None if self.secondary is None else self.secondary.frames(part)
        return MarkerData(
            self.placed, self.measured[:, :, part], self.weight[:, part], shift, secondary
        )


@dataclass(frozen=True, kw_only=True)
class FrameEquations:
    """Cost and normal equations of every frame in a block."""

    cost: float  # m^2, sum over markers and frames
    gradient: Array  # (nq + np, nf) half gradient
    columns: Array  # (nq + np, 6, nf) J_k
    # (nq + np, 6, nf) Y_k J_k, with the markers' curvature if asked for; none where no matrix was
    weighted_columns: Array

    def compute_products(self, first: slice = _ALL, second: slice = _ALL) -> Array:
        """Compute J_k . Y_l J_l for variables k of `first` and l of `second`.

        Returns: (nf, n, n') H_kl wherever l comes after k.
        """
        left = np.ascontiguousarray(self.columns[first].transpose(2, 0, 1))
        return left @ np.ascontiguousarray(self.weighted_columns[second].transpose(2, 1, 0))

    def sum_products(self, part: slice) -> Array:
        """Return (n, n): the products of all variables of `part`, summed over the frames."""
        left, right = self.columns[part], self.weighted_columns[part]
        return left.reshape(len(left), -1) @ right.reshape(len(right), -1).T


class VariablePairs:
    """Pairs of variables that move a common marker.

    Variables are the coordinates of a chain, followed by its free joint parameters.
    """

    def __init__(self, chain: Chain, with_markers: BoolArray, held: tuple[str, ...] = ()) -> None:
        """Find the pairs.

        Parameters
        ----------
        chain : linkage of the trial.
        with_markers : (segments,) whether a segment carries a marker with weight.
        held : coordinates that keep their values.
        """
        # support (variables, segments): 1 where a variable moves a segment with a marker
        support = chain.support * with_markers
        support[[chain.coordinates.index(name) for name in held]] = 0
        active = np.asarray(support.any(axis=1))
        nq = len(chain.coordinates)
        within = (
            ((support[:, None, :] <= support[None, :, :]).all(axis=2))
            & active[:, None]
            & active[None, :]
        )
        # within[l, k]: every segment that l moves, k moves too
        first, second = np.nonzero(np.tril(within | within.T))
        # Of two variables that move the same segments, curvature depends on which is farther from
        # the ground.
        after = chain.after[np.ix_(chain.at_variables, chain.at_variables)][first, second]
        self.deep = np.where(after, first, second)
        self.shallow = np.where(after, second, first)
        self.first, self.second = first, second
        self.coordinates = np.flatnonzero(first < nq)
        self.mixed = np.flatnonzero((first >= nq) & (second < nq))
        self.parameters = np.flatnonzero(second >= nq)
        self.active = active


def compute_marker_positions(
    body: LinkageModel,
    placed: PlacedMarkers,
    q: Array,
    shift: Array | None = None,
    secondary: SecondaryMotion | None = None,
) -> Array:
    """Compute the positions of the model markers.

    Parameters
    ----------
    body
        Linkage with its joint parameters.
    placed
        Markers in their segments.
    q
        (nf, nq) coordinates, m and rad.
    shift, secondary
        As in `MarkerData`.

    Returns
    -------
    (nm, 3, nf) array
        m, laboratory axes.
    """
    return place_markers(placed, Kinematics(body, q, secondary, columns=False).segments, shift)


def place_markers(placed: PlacedMarkers, segments: Array, shift: Array | None) -> Array:
    """Transform markers from their segments to the laboratory.

    Parameters
    ----------
    placed
        Markers in their segments.
    segments
        (ns, 4, 3, nf) axes and origin (m) of each segment in the laboratory.
    shift
        (nm, 3, nf) m, displacement of the markers in their segments; None: none.

    Returns
    -------
    (nm, 3, nf) array
        m, laboratory axes.
    """
    nf = segments.shape[-1]
    out = np.empty((len(placed.segment), 3, nf))
    for s, markers in placed.groups:
        np.matmul(
            placed.extended[markers],
            segments[s].reshape(4, 3 * nf),
            out=out[markers].reshape(-1, 3 * nf),
        )
        if shift is not None:
            out[markers] += np.einsum("mjf,jif->mif", shift[markers], segments[s, :3])
    return out


def assemble_frame_equations(
    body: LinkageModel,
    pairs: VariablePairs,
    data: MarkerData,
    q: Array,
    *,
    hessian: bool = True,
    curved: bool = False,
) -> FrameEquations:
    """Compute cost, half gradient and matrix of every frame.

    Parameters
    ----------
    body
        Linkage with its joint parameters.
    pairs
        Variables that move markers; the columns of all others are zero.
    data
        Markers of these frames.
    q
        (nf, nq) coordinates, m and rad.
    hessian
        Whether the matrix is needed.
    curved
        Half the full Hessian instead of the Gauss-Newton matrix.

    Returns
    -------
    FrameEquations
    """
    placed, chain = Kinematics(body, q, data.secondary), body.chain
    segments, columns = placed.segments, placed.columns
    columns[~pairs.active] = 0.0
    # per segment -> per distinct set of segments -> per variable (moved_set picks the set that it
    # moves)
    arms, cost = _sum_segment_arms(data, segments)
    forces = _sum_moved_segments(chain, _compute_segment_forces(segments, arms))[chain.moved_set]
    gradient = np.einsum("kif,kif->kf", columns, forces)
    if not hessian:
        return FrameEquations(
            cost=cost, gradient=gradient, columns=columns, weighted_columns=np.empty((0, 6, len(q)))
        )
    weighted_columns = _apply_inertia(
        _sum_moved_segments(chain, _compute_segment_inertias(data, segments)),
        chain.moved_set,
        columns,
    )
    if curved:
        # C_l = sum x r^T of each segment: T_s [l; 1] against the same arms that give its force
        first = np.einsum("sjaf,sjbf->sabf", segments, arms)
        summed = _sum_moved_segments(chain, first.reshape(len(first), 9, -1))[chain.moved_set]
        weighted_columns[:, 3:] += compute_curvature_forces(
            columns, forces[:, :3], summed.reshape(len(summed), 3, 3, -1)
        )
    return FrameEquations(
        cost=cost, gradient=gradient, columns=columns, weighted_columns=weighted_columns
    )


def _sum_segment_arms(data: MarkerData, segments: Array) -> tuple[Array, float]:
    """Return (ns, 4, 3, nf) sums of w [l; 1]_j r over the markers of each segment, and the cost."""
    ns, nf = len(segments), segments.shape[-1]
    r = place_markers(data.placed, segments, data.shift)
    r -= data.measured
    pull = data.weight[:, None] * r
    cost = float(np.vdot(pull, r))
    arms = np.zeros((ns, 4, 3, nf))
    # one small matrix product a segment, over all its markers and frames at once
    for s, markers in data.placed.groups:
        flat = pull[markers].reshape(-1, 3 * nf)
        np.matmul(data.placed.extended[markers].T, flat, out=arms[s].reshape(4, 3 * nf))
        if data.shift is not None:
            arms[s, :3] += np.einsum("mjf,mif->jif", data.shift[markers], pull[markers])
    return arms, cost


def _compute_segment_forces(segments: Array, arms: Array) -> Array:
    """Return (ns, 6, nf) force and moment of the residuals of each segment."""
    out = np.empty((len(segments), 6, segments.shape[-1]))
    out[:, :3] = arms[:, 3]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.einsum("sjf,sjf->sf", segments[:, :, j], arms[:, :, k], out=out[:, 3 + i])
        out[:, 3 + i] -= np.einsum("sjf,sjf->sf", segments[:, :, k], arms[:, :, j])
    return out


def _compute_segment_inertias(data: MarkerData, segments: Array) -> Array:
    """Return (ns, 10, nf) mass, first and second moments of the weights of each segment."""
    ns, nf = len(segments), segments.shape[-1]
    carriers = [s for s, _ in data.placed.groups]
    placed = segments[carriers]
    # T P T^T takes two products; where weights never change the first is one matrix for all frames
    if data.moments.shape[-1] == 1:
        rotated = np.matmul(data.moments[..., 0], placed.reshape(-1, 4, 3 * nf)).reshape(
            placed.shape
        )
    else:
        rotated = np.einsum("sjkf,skif->sjif", data.moments, placed)
    out = np.zeros((ns, 10, nf))
    out[carriers, 0] = data.moments[:, 3, 3]
    out[carriers, 1:4] = rotated[:, 3]
    for row, (i, j) in enumerate(_PAIRS):
        out[carriers, 4 + row] = np.einsum("sjf,sjf->sf", placed[:, :, i], rotated[:, :, j])
    return out


def _sum_moved_segments(chain: Chain, of_segments: Array) -> Array:
    """Return (n, rows, nf) sums over each distinct set of segments that variables move."""
    ns, rows, nf = of_segments.shape
    return np.matmul(chain.moved_sets, of_segments.reshape(ns, rows * nf)).reshape(-1, rows, nf)


def _apply_inertia(inertia: Array, of_variable: IntArray, columns: Array) -> Array:
    """Return (nk, 6, nf) Y_k J_k: momenta m v - h x w and h x v + (tr S) w - S w."""
    y = inertia[of_variable]
    mass, h, s = y[:, 0], (y[:, 1], y[:, 2], y[:, 3]), y[:, 4:]
    v, w = (
        (columns[:, 0], columns[:, 1], columns[:, 2]),
        (columns[:, 3], columns[:, 4], columns[:, 5]),
    )
    trace = s[:, 0] + s[:, 1] + s[:, 2]
    second = ((s[:, 0], s[:, 3], s[:, 4]), (s[:, 3], s[:, 1], s[:, 5]), (s[:, 4], s[:, 5], s[:, 2]))
    out = np.empty_like(columns)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i] = mass * v[i] - h[j] * w[k] + h[k] * w[j]
        out[:, 3 + i] = h[j] * v[k] - h[k] * v[j] + (trace - second[i][i]) * w[i]
        out[:, 3 + i] -= second[i][j] * w[j] + second[i][k] * w[k]
    return out


def compute_curvature_forces(columns: Array, force: Array, first: Array) -> Array:
    """Compute p_l of the curvature of the marker paths.

    `columns`: (nk, 6, nf) J_l. `force`: (nk, 3, nf) F_l. `first`: (nk, 3, 3, nf) C_l. Returns: (nk,
    3, nf).
    """
    v, w = columns[:, :3], columns[:, 3:]
    trace = first[:, 0, 0] + first[:, 1, 1] + first[:, 2, 2]
    out = np.empty_like(w)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i] = v[:, j] * force[:, k] - v[:, k] * force[:, j] - trace * w[:, i]
        out[:, i] += first[:, i, 0] * w[:, 0] + first[:, i, 1] * w[:, 1] + first[:, i, 2] * w[:, 2]
    return out
