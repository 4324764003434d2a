"""How much of the marker noise a motion can absorb: why the printed marker distances cannot be reached.

To first order a fit leaves of the noise n what is orthogonal to the columns of the marker Jacobian J (by the nodes,
and by the joint parameters that are free), so that it absorbs the share

    |P n|^2 / |n|^2 = g . M^-1 g / |n|^2,      g = J' n,   M = J' J,

of its sum of squares; |P n|^2 and |n|^2 are summed over draws of the noise itself. In one frame noise has no preferred
direction (its variance is the same in every coordinate of every marker), so that any motion whatever, of as many nodes
as one likes, absorbs rank(J_f) / (3 * markers) on average, to first order. That is the most there is for a motion
alone. Free joint parameters are columns of all frames together, not of one, and absorb some more.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from gaitcal.arrays import Array
from gaitcal.model.parameters import Parameters
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.published.claims import Claim, Verdict
from gaitcal.published.joint_place import LIMIT, joint_place, not_rejected
from gaitcal.published.joint_recovery import free_parameters, synthetic_problem, true_model, true_motion
from gaitcal.published.published import PROBLEMS, table_one
from gaitcal.published.tables import Cell, TableRow
from gaitcal.published.trial_length import PRINTED, SENSITIVITY
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.measurements import NOISE_AMPLITUDE, marker_noise

NOISE_MM = 1e3 * NOISE_AMPLITUDE / np.sqrt(2.0)
"""RMS of the noise: three coordinates of variance A^2 / 6 each."""
DRAWS = 200
_ZERO = 1e-9
"""Relative size of an eigenvalue that is none."""


@dataclass(frozen=True)
class Absorbed:
    """What one of `PROBLEMS` absorbs of the noise."""

    markers: int
    any_motion: float
    """Share of the variance that a motion of any number of nodes absorbs."""
    motion: float
    """Share that the motion of 20 nodes absorbs."""
    whole: float
    """Share that the motion and the free joint parameters absorb."""
    standard_error: float
    """Of both shares."""
    left_mm: Array
    """(n,) RMS marker distance that is left of each draw, mm, with all of these."""


@with_one_blas_thread
def absorbed(problem: str, seed: int, draws: int = DRAWS) -> Absorbed:
    """What one of `PROBLEMS` absorbs."""
    exact, truth, nodes = synthetic_problem(problem, None), true_model().parameters, true_motion(problem).nodes
    opened = exact.with_free(free_parameters(problem))
    rng = np.random.default_rng(np.random.SeedSequence([seed, 2, PROBLEMS.index(problem)]))
    noise = [marker_noise(exact.basis.time, len(exact.labels), rng).transpose(1, 2, 0) for _ in range(draws)]
    size = np.array([(n**2).sum() for n in noise])
    moved, whole = (absorbed_squares(p, truth, nodes, noise) for p in (exact, opened))
    return Absorbed(
        markers=len(exact.labels),
        any_motion=any_motion_share(exact, truth, nodes),
        motion=float(moved.sum() / size.sum()),
        whole=float(whole.sum() / size.sum()),
        standard_error=float(np.std(whole - size * whole.sum() / size.sum()) / size.mean() / np.sqrt(draws)),
        left_mm=1e3 * np.sqrt((size - whole) / (len(exact.labels) * len(exact.basis.time))),
    )


def absorbed_squares(problem: TrialProblem, parameters: Parameters, nodes: Array, noise: Sequence[Array]) -> Array:
    """(n,) |P n|^2, m^2, of displacements (nm, 3, nf) of the markers, for the columns of J at `nodes`.

    Every marker pulls with the same weight; the parameters that are free in the problem's chain are columns too.
    """
    constants = problem.constants(parameters)
    equations = problem.equations(nodes, constants)
    factor = BandFactor(equations.band)
    mixed = np.asfortranarray(equations.mixed)
    schur = equations.parameters - mixed.T @ factor.solve(mixed)
    placed = problem.positions(nodes, constants)
    squares = []
    for n in noise:
        _, by_nodes, by_values = problem.with_measured(placed + n).both_gradients(nodes, constants)
        solved = factor.solve(by_nodes.ravel())
        rest = by_values - mixed.T @ solved
        squares.append(float(by_nodes.ravel() @ solved + rest @ np.linalg.solve(schur, rest)))
    return np.array(squares)


def any_motion_share(problem: TrialProblem, parameters: Parameters, nodes: Array) -> float:
    """Mean over the frames of rank(J_f) / (3 * markers)."""
    frames = problem.frame_hessians(problem.basis.evaluate(nodes), problem.constants(parameters))
    size = np.linalg.eigvalsh(frames)
    ranks = (size > _ZERO * size[:, -1:]).sum(axis=1)
    return float(ranks.mean() / (3 * len(problem.labels)))


def absorbed_noise(seed: int, draws: int = DRAWS, jobs: int = -1) -> dict[str, Absorbed]:
    """Of every one of `PROBLEMS`."""
    return dict(zip(PROBLEMS, Parallel(n_jobs=jobs)(delayed(absorbed)(p, seed, draws) for p in PROBLEMS), strict=True))


def absorbed_rows(shares: Mapping[str, Absorbed]) -> list[TableRow]:
    """Shares, and the marker distances that they leave beside the printed ones."""
    rows: list[TableRow] = []
    for problem, share in shares.items():
        title = f"noise that a fit of {share.markers} markers absorbs"
        draws = f"over {len(share.left_mm)} noise draws, standard error {100 * share.standard_error:.2g}"
        for words, value, note in (
            ("any motion alone, at most on average", share.any_motion, "rank of the projection, frame by frame"),
            ("motion of 20 nodes", share.motion, draws),
            ("motion and joint parameters", share.whole, draws),
        ):
            rows.append(Cell(SENSITIVITY, f"{title}: {words}", problem, "%").filled(None, 100.0 * value, note))
        cell = Cell(SENSITIVITY, f"{title}: marker distance RMS that is left", problem, "mm")
        rows.append(cell.over_draws(_printed(problem), share.left_mm, "to first order"))
    return rows


def _printed(problem: str) -> float:
    """RMS marker distance, mm."""
    value = table_one(PRINTED, "marker_distance_mm")[problem]
    if value is None:
        raise ValueError(f"Table I has no marker distance of {problem}")
    return value


_CLAIM = "the four printed marker distances with noise together are not rejected as a draw of noise in 41 markers"
_PUBLISHED = ", ".join(f"{p} {_printed(p):.2f}" for p in PROBLEMS) + " mm; marker set not printed"


def absorbed_claims(shares: Mapping[str, Absorbed] | None) -> list[Claim]:
    """Whether the printed marker distances are among those that noise leaves."""
    if shares is None:
        return [Claim(_CLAIM, _PUBLISHED, "", Verdict.NOT_RUN)]
    left = np.column_stack([share.left_mm for share in shares.values()])
    printed = np.array([_printed(p) for p in shares])
    most = max(share.any_motion for share in shares.values())
    lowest = list(shares)[int(printed.argmin())]
    needed = most * 3 * next(iter(shares.values())).markers / (3.0 * (1.0 - (printed.min() / NOISE_MM) ** 2))
    place, error = joint_place(left, printed), max(share.standard_error for share in shares.values())

    def each(values: Iterable[float], form: str) -> str:
        return ", ".join(f"{name} {value:{form}}" for name, value in zip(shares, values, strict=True))

    words = (
        f"distance p = {place.words} of {len(left)} draws (limit {LIMIT:g}): on average, to first order, a motion of "
        f"27 coordinates alone absorbs at most {100 * most:.0f} % of the noise, which leaves "
        f"{NOISE_MM * np.sqrt(1 - most):.1f} of {NOISE_MM:.2f} mm; that of 20 nodes "
        f"{each((100 * s.motion for s in shares.values()), '.1f')} %; free joint parameters add to it: "
        f"{each((100 * s.whole for s in shares.values()), '.1f')} % (+-{100 * error:.1f}), leaving "
        f"{each(np.median(left, axis=0), '.2f')} mm (medians); draws that leave as little as printed: "
        f"{each(np.mean(left <= printed, axis=0), '.1%')}. The {lowest}'s {printed.min():.2f} mm would ask for "
        f"{int(needed)} markers or fewer"
    )
    return [not_rejected(_CLAIM, _PUBLISHED, place, words)]
