"""Sensitivities of phase 1: whether printed errors are a draw of the noise, by trial length and by absorbed noise.

**Joint place.** The printed figures x are one draw of the noise, or so the question goes. Added to n draws of ours they
make n + 1 draws of which none differs from the others; then no measure of how odd a draw looks among all n + 1 has a
preference either, and

    p = (number of the n + 1 that look as odd as x, or odder) / (n + 1)

is uniform on 1 / (n + 1), ..., 1 whatever the distribution (a permutation test; conformal p value, Vovk, Gammerman and
Shafer 2005). Two measures: *distance* in any direction, the squared Mahalanobis distance of the logarithms (errors are
positive and skewed) from the mean of all n + 1, with the covariance of all; and *low rank sum*, the sum over the
figures of the draw's rank among the n + 1, which asks whether all are low at once, and finds that with far fewer draws.
The standard error of p is that over bootstrap samples of the draws, or the binomial one where that is larger.

**Trial length.** The paper gives 1200 frames and no frame rate. The tables are made at 200 Hz, where 1200 frames are
6 s; at 60 Hz, a usual rate of cameras then, they are 20 s. The same movement is made more slowly, so that the true
motion is the same in the 20 nodes: only the noise, whose frequencies are given in rad/s, meets the trial at another
speed. The side of the rank sum was chosen when the printed errors had been seen to be low against 100 draws: who would
have looked at either side doubles its p.

**Absorbed noise.** To first order a fit leaves of the noise n what is orthogonal to the columns of the marker Jacobian
J (by the coefficients, and by the joint parameters that are free), so that it absorbs the share

    |P n|^2 / |n|^2 = g . M^-1 g / |n|^2,      g = J' n,   M = J' J,

of its sum of squares, summed over draws of the noise. In one frame noise has no preferred direction, so that any motion
whatever, of as many nodes as one likes, absorbs rank(J_f) / (3 * markers) on average. Free joint parameters are columns
of all frames together, and absorb some more.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import rankdata

from gaitcal.arrays import Array
from gaitcal.model.parameters import Parameters
from gaitcal.motion import banded, trial_problem
from gaitcal.published import recovery
from gaitcal.published.claims import Claim, Verdict
from gaitcal.published.protocol import PROBLEMS, table_one
from gaitcal.published.recovery import generators
from gaitcal.published.tables import JOINT_FIGURES, SENSITIVITY, TableRow
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.motion import ISOLATED_FRAMES, NOISE_AMPLITUDE, RATE, marker_noise

LIMIT = 0.05  # p below which the figures are rejected as a draw
DECIDED_ERRORS = 2.0  # Standard errors that p has to be away from the limit, or the answer is undecided
BOOTSTRAPS = 200
_SAME = 1e-9
"""Relative difference of distances that is rounding, and relative size of an eigenvalue or direction that is none."""
RATES = (RATE, 60.0)  # Frames per second, hence lengths, of the isolated trials
DRAWS = 300
"""Of the noise, at each length: of a p near 0.05 the standard error is 0.013 by low rank sum, some 0.02 by distance."""
ABSORPTION_DRAWS = 200
NOISE_MM = 1e3 * NOISE_AMPLITUDE / np.sqrt(2.0)  # RMS of the noise: three coordinates of variance A^2 / 6 each


def _printed(key: str) -> dict[str, float]:
    """Problem -> figure of Table I with noise; those that the table has."""
    return {p: value for p, value in table_one("synthetic_with_noise", key).items() if value is not None}


PARAMETER_ROWS: tuple[tuple[str, str], ...] = tuple(
    (problem, key)
    for problem in PROBLEMS
    for key, *_ in JOINT_FIGURES
    if key != "marker_distance_mm" and problem in _printed(key)
)
"""(problem, key of the figure): the seven errors of joint parameters in Table I with noise."""
_ROW_UNITS = tuple("deg" if key.endswith("deg") else "mm" for _, key in PARAMETER_ROWS)
_DISTANCES = _printed("marker_distance_mm")


@dataclass(frozen=True)
class Place:
    """Where printed figures lie among draws."""

    p: float  # NaN: too few draws to tell
    error: float  # Standard error of `p` from the number of draws

    @property
    def verdict(self) -> Verdict:
        """`HOLDS`: not rejected as a draw; that they are one does not follow."""
        if np.isnan(self.p):
            return Verdict.NOT_RUN
        if abs(self.p - LIMIT) < DECIDED_ERRORS * self.error:
            return Verdict.UNDECIDED
        return Verdict.HOLDS if self.p >= LIMIT else Verdict.FAILS

    @property
    def words(self) -> str:
        """`0.012 +- 0.006 (rejected)`."""
        meaning = {
            Verdict.NOT_RUN: "too few draws",
            Verdict.UNDECIDED: "too near the limit to tell",
            Verdict.HOLDS: "not rejected",
            Verdict.FAILS: "rejected",
        }
        return f"{self.p:.2g} +- {self.error:.1g} ({meaning[self.verdict]})"


def joint_p(draws: Array, printed: Array) -> float:
    """P by distance, of the printed figures (d,) among draws (n, d), all positive.

    NaN for so few draws that none could be below `LIMIT`, or n <= d, where every draw lies as far.
    """
    count, width = draws.shape
    if count <= width or 1.0 / (count + 1) >= LIMIT:
        return float("nan")
    logs = np.log(np.vstack([draws, printed]))
    apart = logs - logs.mean(axis=0)
    # Of orthonormal columns that span `apart`, the length of each row is its Mahalanobis distance up to a factor.
    columns, size, _ = np.linalg.svd(apart, full_matrices=False)
    distance = (columns[:, size > _SAME * size[0]] ** 2).sum(axis=1)
    return float(np.mean(distance >= distance[-1] * (1.0 - _SAME)))


def low_p(draws: Array, printed: Array) -> float:
    """P by low rank sum, one-sided; NaN for so few draws that none could be below `LIMIT`."""
    if 1.0 / (len(draws) + 1) >= LIMIT:
        return float("nan")
    sums = rankdata(np.vstack([draws, printed]), axis=0).sum(axis=1)
    return float(np.mean(sums <= sums[-1]))


def place(test: Callable[[Array, Array], float], draws: Array, printed: Array) -> Place:
    """Of the printed figures (d,) among draws (n, d), by `joint_p` or `low_p`."""
    p, count = test(draws, printed), len(draws)
    if np.isnan(p):
        return Place(p, p)
    rng = np.random.default_rng(0)
    others = [test(draws[rng.integers(count, size=count)], printed) for _ in range(BOOTSTRAPS)]
    return Place(p, max(float(np.std(others)), float(np.sqrt(p * (1.0 - p) / count))))


@dataclass(frozen=True)
class LengthDraws:
    """Table I with noise for one length of the isolated trials."""

    rate: float  # Hz
    problems: list[dict[str, recovery.JointRecovery]]  # Draw by draw

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
        """By distance, of the seven printed errors of joint parameters together."""
        return place(joint_p, *self._seven())

    @cached_property
    def low(self) -> Place:
        """By low rank sum."""
        return place(low_p, *self._seven())

    def _seven(self) -> tuple[Array, Array]:
        """(n, 7) and (7,): ours and the printed ones."""
        ours = np.column_stack([self.values(*row) for row in PARAMETER_ROWS])
        return ours, np.array([_printed(key)[problem] for problem, key in PARAMETER_ROWS])


def trial_lengths(seed: int, draws: int = DRAWS, jobs: int = -1, rates: Iterable[float] = RATES) -> list[LengthDraws]:
    """Phase 1 with the noise of draws 0 to `draws` - 1 under `seed`, those of the tables, for each length."""
    wanted = list(rates)
    found = Parallel(n_jobs=jobs)(delayed(_found)(seed, draw, rate) for rate in wanted for draw in range(draws))
    return [LengthDraws(rate, found[k * draws : (k + 1) * draws]) for k, rate in enumerate(wanted) if draws]


@with_one_blas_thread
def _found(seed: int, draw: int, rate: float) -> dict[str, recovery.JointRecovery]:
    noise, _ = generators(seed, draw)
    return recovery.recover_joints(
        {p: recovery.synthetic_problem(p, noise[k], rate) for k, p in enumerate(PROBLEMS)}, compare=False
    )


def trial_length_rows(lengths: Sequence[LengthDraws]) -> list[TableRow]:
    """Table I with noise for each length, and both p of the seven rows together."""
    rows: list[TableRow] = []
    for length in lengths:
        trials = f"isolated trials of {length.seconds:.0f} s ({ISOLATED_FRAMES} frames at {length.rate:.0f} Hz)"
        for key, title, unit, _ in JOINT_FIGURES:
            for problem, published in _printed(key).items():
                values = length.values(problem, key)
                share = f"{np.mean(values <= published):.0%} of the draws are at or below it"
                rows.append(
                    TableRow(SENSITIVITY, f"{trials}: {title}", problem, unit).over_draws(published, values, share)
                )
        stuck = sum(not f.converged for found in length.problems for f in found.values())
        for column, found_place, meaning in (
            ("p by distance", length.joint, "as far from their mean"),
            ("p by low rank sum", length.low, "as low in all rows together (one-sided)"),
        ):
            notes = (
                f"standard error {found_place.error:.1g}",
                f"share of {len(length.problems)} noise draws and the printed one that are {meaning}",
                f"{stuck} of {len(length.problems) * len(PROBLEMS)} searches did not converge" if stuck else "",
            )
            cell = TableRow(SENSITIVITY, f"{trials}: the seven parameter rows together", column, "")
            rows.append(cell.filled(None, found_place.p, *notes))
    return rows


def trial_length_claims(lengths: Sequence[LengthDraws] | None) -> list[Claim]:
    """Whether the seven printed rows are too low together for the first length and not for the last."""
    first, last = (f"{ISOLATED_FRAMES / rate:.0f}" for rate in (RATES[0], RATES[-1]))
    claim = (
        "the seven printed errors of joint parameters with noise are too low together for a draw where isolated trials "
        f"last {first} s; where they last {last} s that is not rejected"
    )
    with_units = list(zip(PARAMETER_ROWS, _ROW_UNITS, strict=True))
    published = ", ".join(f"{problem} {_printed(key)[problem]} {unit}" for (problem, key), unit in with_units)
    published = f"length not printed; {published}"
    if lengths is None:
        return [Claim(claim, published, "", Verdict.NOT_RUN)]
    parts = []
    for length in lengths:
        errors = (f"{row[0]} {np.median(length.values(*row)):.2f} {unit}" for row, unit in with_units)
        markers = (f"{p} {np.median(length.values(p, 'marker_distance_mm')):.2f}" for p in PROBLEMS)
        parts.append(
            f"{length.seconds:.0f} s: low rank sum p = {length.low.words}, distance p = {length.joint.words}; medians "
            f"{', '.join(errors)}; marker distances {', '.join(markers)} mm"
        )
    ours = f"{'. '.join(parts)}. {len(lengths[0].problems)} draws each, limit {LIMIT:g}; rank sum one-sided"
    return [Claim(claim, published, ours, _low_then_not(lengths[0].low.verdict, lengths[-1].low.verdict))]


def _low_then_not(first: Verdict, last: Verdict) -> Verdict:
    """Verdict on: rejected in the first, not rejected in the last."""
    if Verdict.NOT_RUN in (first, last):
        return Verdict.NOT_RUN
    if first is Verdict.HOLDS or last is Verdict.FAILS:
        return Verdict.FAILS
    return Verdict.UNDECIDED if Verdict.UNDECIDED in (first, last) else Verdict.HOLDS


@dataclass(frozen=True)
class Absorbed:
    """What one of `PROBLEMS` absorbs of the noise."""

    markers: int
    any_motion: float  # Share of the variance that a motion of any number of nodes absorbs
    motion: float  # Share that the motion of 20 nodes absorbs
    whole: float  # Share that the motion and the free joint parameters absorb
    standard_error: float  # Of both shares
    left_mm: Array  # (n,) RMS marker distance that is left of each draw, mm, with all of these


def absorbed_noise(seed: int, draws: int = ABSORPTION_DRAWS, jobs: int = -1) -> dict[str, Absorbed]:
    """Of every one of `PROBLEMS`."""
    return dict(zip(PROBLEMS, Parallel(n_jobs=jobs)(delayed(absorbed)(p, seed, draws) for p in PROBLEMS), strict=True))


@with_one_blas_thread
def absorbed(problem: str, seed: int, draws: int = ABSORPTION_DRAWS) -> Absorbed:
    """What one of `PROBLEMS` absorbs."""
    exact, truth, coefficients = (
        recovery.synthetic_problem(problem, None),
        recovery.true_model().parameters,
        recovery.true_motion(problem).coefficients,
    )
    opened = exact.with_free(recovery.free_parameters(problem))
    rng = np.random.default_rng(np.random.SeedSequence([seed, 2, PROBLEMS.index(problem)]))
    noise = [marker_noise(exact.basis.time, len(exact.labels), rng).transpose(1, 2, 0) for _ in range(draws)]
    size = np.array([(n**2).sum() for n in noise])
    moved, whole = (absorbed_squares(p, truth, coefficients, noise) for p in (exact, opened))
    return Absorbed(
        markers=len(exact.labels),
        any_motion=any_motion_share(exact, truth, coefficients),
        motion=float(moved.sum() / size.sum()),
        whole=float(whole.sum() / size.sum()),
        standard_error=float(np.std(whole - size * whole.sum() / size.sum()) / size.mean() / np.sqrt(draws)),
        left_mm=1e3 * np.sqrt((size - whole) / (len(exact.labels) * len(exact.basis.time))),
    )


def absorbed_squares(
    problem: trial_problem.MotionProblem, parameters: Parameters, coefficients: Array, noise: Sequence[Array]
) -> Array:
    """(n,) |P n|^2, m^2, of displacements (nm, 3, nf) of the markers, for the columns of J at `coefficients`.

    Every marker pulls with the same weight; the parameters that are free in the problem's chain are columns too.
    """
    body = problem.body(parameters)
    equations = problem.equations(coefficients, body)
    factor = banded.BandFactor(equations.band)
    mixed = np.asfortranarray(equations.mixed)
    schur = equations.parameters - mixed.T @ factor.solve(mixed)
    placed = problem.positions(coefficients, body)
    squares = []
    for n in noise:
        _, by_nodes, by_values = problem.with_measured(placed + n).both_gradients(coefficients, body)
        solved = factor.solve(by_nodes.ravel())
        rest = by_values - mixed.T @ solved
        squares.append(float(by_nodes.ravel() @ solved + rest @ np.linalg.solve(schur, rest)))
    return np.array(squares)


def any_motion_share(problem: trial_problem.MotionProblem, parameters: Parameters, coefficients: Array) -> float:
    """Mean over the frames of rank(J_f) / (3 * markers)."""
    frames = problem.frame_hessians(problem.basis.evaluate(coefficients), problem.body(parameters))
    size = np.linalg.eigvalsh(frames)
    ranks = (size > _SAME * size[:, -1:]).sum(axis=1)
    return float(ranks.mean() / (3 * len(problem.labels)))


def absorbed_rows(shares: Mapping[str, Absorbed]) -> list[TableRow]:
    """Shares, and the marker distances that they leave beside the printed ones."""
    rows: list[TableRow] = []
    for problem, share in shares.items():
        title = f"noise that a fit of {share.markers} markers absorbs"
        draws = f"over {len(share.left_mm)} noise draws, standard error {100 * share.standard_error:.2g}"
        for fit, value, note in (
            ("any motion alone, at most on average", share.any_motion, "rank of the projection, frame by frame"),
            ("motion of 20 nodes", share.motion, draws),
            ("motion and joint parameters", share.whole, draws),
        ):
            rows.append(TableRow(SENSITIVITY, f"{title}: {fit}", problem, "%").filled(None, 100.0 * value, note))
        cell = TableRow(SENSITIVITY, f"{title}: marker distance RMS that is left", problem, "mm")
        rows.append(cell.over_draws(_DISTANCES[problem], share.left_mm, "to first order"))
    return rows


def absorbed_claims(shares: Mapping[str, Absorbed] | None) -> list[Claim]:
    """Whether the printed marker distances are among those that noise leaves."""
    claim = "the four printed marker distances with noise together are not rejected as a draw of noise in 41 markers"
    published = ", ".join(f"{p} {_DISTANCES[p]:.2f}" for p in PROBLEMS) + " mm; marker set not printed"
    if shares is None:
        return [Claim(claim, published, "", Verdict.NOT_RUN)]
    left = np.column_stack([share.left_mm for share in shares.values()])
    printed = np.array([_DISTANCES[p] for p in shares])
    most = max(share.any_motion for share in shares.values())
    lowest = list(shares)[int(printed.argmin())]
    needed = most * 3 * next(iter(shares.values())).markers / (3.0 * (1.0 - (printed.min() / NOISE_MM) ** 2))
    found, error = place(joint_p, left, printed), max(share.standard_error for share in shares.values())

    def each(values: Iterable[float], form: str) -> str:
        return ", ".join(f"{name} {value:{form}}" for name, value in zip(shares, values, strict=True))

    ours = (
        f"distance p = {found.words} of {len(left)} draws (limit {LIMIT:g}): on average, to first order, a motion of "
        f"27 coordinates alone absorbs at most {100 * most:.0f} % of the noise, which leaves "
        f"{NOISE_MM * np.sqrt(1 - most):.1f} of {NOISE_MM:.2f} mm; that of 20 nodes "
        f"{each((100 * s.motion for s in shares.values()), '.1f')} %; free joint parameters add to it: "
        f"{each((100 * s.whole for s in shares.values()), '.1f')} % (+-{100 * error:.1f}), leaving "
        f"{each(np.median(left, axis=0), '.2f')} mm (medians); draws that leave as little as printed: "
        f"{each(np.mean(left <= printed, axis=0), '.1%')}. The {lowest}'s {printed.min():.2f} mm would ask for "
        f"{int(needed)} markers or fewer"
    )
    return [Claim(claim, published, ours, found.verdict)]
