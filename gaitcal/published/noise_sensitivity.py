"""Whether several printed figures together are rejected as a draw of the noise: where they lie among draws of ours.

The printed figures x are one draw of the noise, or so the question goes. Added to n draws of ours they make n + 1
draws of which none differs from the others; then no measure of how odd a draw looks among all n + 1 has a preference
either, and

    p = (number of the n + 1 that look as odd as x, or odder) / (n + 1)

is uniform on 1 / (n + 1), ..., 1 whatever the distribution (a permutation test; conformal p value, Vovk, Gammerman and
Shafer 2005). Two measures:

- *distance* in any direction: the squared Mahalanobis distance from the mean of all n + 1, with the covariance of all.
  Figures are errors, positive and skewed: their logarithms are compared;
- *low rank sum*: the sum over the figures of the draw's rank among the n + 1. It asks one thing, whether all figures
  are low at once, and finds that with far fewer draws.

Other draws of ours would have given another p. Its standard error is that over bootstrap samples of the draws, or the
binomial one where that is larger (of a p so small that hardly a draw of ours is as odd, the bootstrap knows nothing).

A sensitivity: how long the isolated trials last, which the paper does not say.

It gives 1200 frames and no frame rate. The tables are made at 200 Hz, where 1200 frames are 6 s; at 60 Hz, a usual
rate of cameras then, they are 20 s. The same movement is made more slowly, so that the true motion is the same in the
20 nodes: only the noise, whose frequencies are given in rad/s, meets the trial at another speed. Gait stays as it is;
its full leg depends on the isolated trials by the 10 parameters that it leaves alone.

Two tests of `joint_place.py`, at both lengths: distance in any direction, and low rank sum, since a printed set that is
low in every row lies not far in any. The side of the second was chosen when the printed errors had been seen to be low
against 100 draws: who would have looked at either side doubles its p.

How much of the marker noise a motion can absorb: why the printed marker distances cannot be reached.

To first order a fit leaves of the noise n what is orthogonal to the columns of the marker Jacobian J (by the nodes,
and by the joint parameters that are free), so that it absorbs the share

    |P n|^2 / |n|^2 = g . M^-1 g / |n|^2,      g = J' n,   M = J' J,

of its sum of squares; |P n|^2 and |n|^2 are summed over draws of the noise itself. In one frame noise has no preferred
direction (its variance is the same in every coordinate of every marker), so that any motion whatever, of as many nodes
as one likes, absorbs rank(J_f) / (3 * markers) on average, to first order. That is the most there is for a motion
alone. Free joint parameters are columns of all frames together, not of one, and absorb some more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import rankdata

from gaitcal.arrays import Array
from gaitcal.model.parameters import Parameters
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.published.claims import Claim, Verdict
from gaitcal.published.inertial_recovery import generators
from gaitcal.published.joint_recovery import (
    FoundFromZero,
    find_joints,
    free_parameters,
    synthetic_problem,
    true_model,
    true_motion,
)
from gaitcal.published.protocol import PROBLEMS, table_one
from gaitcal.published.tables import JOINT_FIGURES, Cell, TableRow
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.motion import ISOLATED_FRAMES, NOISE_AMPLITUDE, RATE, marker_noise

LIMIT = 0.05
"""p below which the figures are rejected as a draw."""
SURE = 2.0
"""Standard errors that p has to be away from the limit, or the answer is undecided."""
BOOTSTRAPS = 200
_SAME = 1e-9
"""Relative difference of distances that is rounding, and relative size of a direction that is none."""


@dataclass(frozen=True)
class Place:
    """Where printed figures lie among draws."""

    p: float
    """NaN: too few draws to tell."""
    error: float
    """Standard error of `p` from the number of draws."""

    @property
    def verdict(self) -> Verdict:
        """`HOLDS`: not rejected as a draw; that they are one does not follow."""
        if np.isnan(self.p):
            return Verdict.NOT_RUN
        if abs(self.p - LIMIT) < SURE * self.error:
            return Verdict.UNDECIDED
        return Verdict.HOLDS if self.p >= LIMIT else Verdict.FAILS

    @property
    def words(self) -> str:
        """`0.012 +- 0.006 (rejected)`."""
        told = {
            Verdict.NOT_RUN: "too few draws",
            Verdict.UNDECIDED: "too near the limit to tell",
            Verdict.HOLDS: "not rejected",
            Verdict.FAILS: "rejected",
        }
        return f"{self.p:.2g} +- {self.error:.1g} ({told[self.verdict]})"


def joint_place(draws: Array, printed: Array) -> Place:
    """By distance, of the printed figures (d,) among draws (n, d), all positive."""
    return _with_error(joint_p, draws, printed)


def low_place(draws: Array, printed: Array) -> Place:
    """By low rank sum, of the printed figures (d,) among draws (n, d)."""
    return _with_error(low_p, draws, printed)


def joint_p(draws: Array, printed: Array) -> float:
    """P by distance.

    NaN for so few draws that none could be below `LIMIT`, or n <= d, where every draw lies as far.
    """
    count, width = draws.shape
    if count <= width or _too_few(count):
        return float("nan")
    logs = np.log(np.vstack([draws, printed]))
    apart = logs - logs.mean(axis=0)
    # Of orthonormal columns that span `apart`, the length of each row is its Mahalanobis distance up to a factor.
    columns, size, _ = np.linalg.svd(apart, full_matrices=False)
    distance = (columns[:, size > _SAME * size[0]] ** 2).sum(axis=1)
    return float(np.mean(distance >= distance[-1] * (1.0 - _SAME)))


def low_p(draws: Array, printed: Array) -> float:
    """P by low rank sum, one-sided; NaN for so few draws that none could be below `LIMIT`."""
    if _too_few(len(draws)):
        return float("nan")
    sums = rankdata(np.vstack([draws, printed]), axis=0).sum(axis=1)
    return float(np.mean(sums <= sums[-1]))


def _too_few(count: int) -> bool:
    return 1.0 / (count + 1) >= LIMIT


def _with_error(test: Callable[[Array, Array], float], draws: Array, printed: Array) -> Place:
    p, count = test(draws, printed), len(draws)
    if np.isnan(p):
        return Place(p, p)
    rng = np.random.default_rng(0)
    others = [test(draws[rng.integers(count, size=count)], printed) for _ in range(BOOTSTRAPS)]
    return Place(p, max(float(np.std(others)), float(np.sqrt(p * (1.0 - p) / count))))


def not_rejected(claim: str, published: str, place: Place, words: str) -> Claim:
    """The claim that printed figures together are not rejected as a draw."""
    return Claim(claim, published, words, place.verdict)


CAMERAS_HZ = 60.0
RATES = (RATE, CAMERAS_HZ)
DRAWS = 300
"""Of the noise, at each length: of a p near 0.05 the standard error is 0.013 by low rank sum, some 0.02 by distance."""
PRINTED = "synthetic_with_noise"
SENSITIVITY = "sensitivity"
"""Of `tables.csv`: the table that these rows are in."""

PARAMETER_ROWS: tuple[tuple[str, str], ...] = tuple(
    (problem, key)
    for problem in PROBLEMS
    for key, *_ in JOINT_FIGURES
    if key != "marker_distance_mm" and table_one(PRINTED, key)[problem] is not None
)
"""(problem, key of the figure): the seven errors of joint parameters in Table I with noise."""


@dataclass(frozen=True)
class LengthDraws:
    """Table I with noise for one length of the isolated trials."""

    rate: float
    """Hz."""
    problems: list[dict[str, FoundFromZero]]
    """Draw by draw."""

    @property
    def seconds(self) -> float:
        """Of an isolated trial."""
        return ISOLATED_FRAMES / self.rate

    def values(self, problem: str, key: str) -> Array:
        """(n,) a figure of Table I, draw by draw; NaN where the problem has none of its kind."""
        figure = next(f for k, _, _, f in JOINT_FIGURES if k == key)
        values = [figure(found[problem]) for found in self.problems]
        return np.array([np.nan if value is None else value for value in values])

    @cached_property
    def joint(self) -> Place:
        """By distance, of the seven printed errors of joint parameters together; see `joint_place.py`."""
        return joint_place(*self._seven())

    @cached_property
    def low(self) -> Place:
        """By low rank sum."""
        return low_place(*self._seven())

    def _seven(self) -> tuple[Array, Array]:
        """(n, 7) and (7,): ours and the printed ones."""
        ours = np.column_stack([self.values(*row) for row in PARAMETER_ROWS])
        return ours, np.array([table_one(PRINTED, key)[problem] for problem, key in PARAMETER_ROWS])


def trial_lengths(seed: int, draws: int = DRAWS, jobs: int = -1, rates: Iterable[float] = RATES) -> list[LengthDraws]:
    """Phase 1 with the noise of draws 0 to `draws` - 1 under `seed`, those of the tables, for each length."""
    tasks = [(rate, draw) for rate in rates for draw in range(draws)]
    found = Parallel(n_jobs=jobs)(delayed(_found)(seed, draw, rate) for rate, draw in tasks)
    of_rate: dict[float, list[dict[str, FoundFromZero]]] = {}
    for (rate, _), one in zip(tasks, found, strict=True):
        of_rate.setdefault(rate, []).append(one)
    return [LengthDraws(rate, problems) for rate, problems in of_rate.items()]


@with_one_blas_thread
def _found(seed: int, draw: int, rate: float) -> dict[str, FoundFromZero]:
    noise, _ = generators(seed, draw)
    return find_joints({p: synthetic_problem(p, noise[k], rate) for k, p in enumerate(PROBLEMS)})


def trial_length_rows(lengths: Sequence[LengthDraws]) -> list[TableRow]:
    """Table I with noise for each length, and both p of the seven rows together."""
    rows: list[TableRow] = []
    for length in lengths:
        words = f"isolated trials of {length.seconds:.0f} s ({ISOLATED_FRAMES} frames at {length.rate:.0f} Hz)"
        for key, title, unit, _ in JOINT_FIGURES:
            for problem, published in table_one(PRINTED, key).items():
                if published is not None:
                    values = length.values(problem, key)
                    cell = Cell(SENSITIVITY, f"{words}: {title}", problem, unit)
                    rows.append(cell.over_draws(published, values, _place(values, published)))
        stuck = sum(not f.converged for found in length.problems for f in found.values())
        for column, place, told in (
            ("p by distance", length.joint, "as far from their mean"),
            ("p by low rank sum", length.low, "as low in all rows together (one-sided)"),
        ):
            rows.append(
                Cell(SENSITIVITY, f"{words}: the seven parameter rows together", column, "").filled(
                    None,
                    place.p,
                    f"standard error {place.error:.1g}",
                    f"share of {len(length.problems)} noise draws and the printed one that are {told}",
                    f"{stuck} of {len(length.problems) * len(PROBLEMS)} searches did not converge" if stuck else "",
                )
            )
    return rows


def _place(values: Array, published: float) -> str:
    return f"{np.mean(values <= published):.0%} of the draws are at or below it"


def trial_length_claims(lengths: Sequence[LengthDraws] | None) -> list[Claim]:
    """Whether the seven printed rows are too low together for the first length and not for the last."""
    if lengths is None:
        return [Claim(_CLAIM, _PUBLISHED, "", Verdict.NOT_RUN)]
    told = []
    for length in lengths:
        errors = (f"{problem} {np.median(length.values(*row)):.2f} {unit}" for row, problem, unit in _ROW_WORDS)
        markers = (f"{p} {np.median(length.values(p, 'marker_distance_mm')):.2f}" for p in PROBLEMS)
        told.append(
            f"{length.seconds:.0f} s: low rank sum p = {length.low.words}, distance p = {length.joint.words}; medians "
            f"{', '.join(errors)}; marker distances {', '.join(markers)} mm"
        )
    words = f"{'. '.join(told)}. {len(lengths[0].problems)} draws each, limit {LIMIT:g}; rank sum one-sided"
    return [Claim(_CLAIM, _PUBLISHED, words, _low_then_not(lengths[0].low.verdict, lengths[-1].low.verdict))]


def _low_then_not(first: Verdict, last: Verdict) -> Verdict:
    """Verdict on: rejected in the first, not rejected in the last."""
    if Verdict.NOT_RUN in (first, last):
        return Verdict.NOT_RUN
    if first is Verdict.HOLDS or last is Verdict.FAILS:
        return Verdict.FAILS
    return Verdict.UNDECIDED if Verdict.UNDECIDED in (first, last) else Verdict.HOLDS


_CLAIM = (
    "the seven printed errors of joint parameters with noise are too low together for a draw where isolated trials "
    f"last {ISOLATED_FRAMES / RATES[0]:.0f} s; where they last {ISOLATED_FRAMES / RATES[-1]:.0f} s that is not rejected"
)
_ROW_WORDS = tuple((row, row[0], "deg" if row[1].endswith("deg") else "mm") for row in PARAMETER_ROWS)
"""The row, its problem and unit."""
_PUBLISHED = "length not printed; " + ", ".join(
    f"{problem} {table_one(PRINTED, row[1])[problem]} {unit}" for row, problem, unit in _ROW_WORDS
)


NOISE_MM = 1e3 * NOISE_AMPLITUDE / np.sqrt(2.0)
"""RMS of the noise: three coordinates of variance A^2 / 6 each."""
ABSORPTION_DRAWS = 200
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
def absorbed(problem: str, seed: int, draws: int = ABSORPTION_DRAWS) -> Absorbed:
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


def absorbed_noise(seed: int, draws: int = ABSORPTION_DRAWS, jobs: int = -1) -> dict[str, Absorbed]:
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


_DISTANCE_CLAIM = (
    "the four printed marker distances with noise together are not rejected as a draw of noise in 41 markers"
)
_PRINTED_DISTANCES = ", ".join(f"{p} {_printed(p):.2f}" for p in PROBLEMS) + " mm; marker set not printed"


def absorbed_claims(shares: Mapping[str, Absorbed] | None) -> list[Claim]:
    """Whether the printed marker distances are among those that noise leaves."""
    if shares is None:
        return [Claim(_DISTANCE_CLAIM, _PRINTED_DISTANCES, "", Verdict.NOT_RUN)]
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
    return [not_rejected(_DISTANCE_CLAIM, _PRINTED_DISTANCES, place, words)]
