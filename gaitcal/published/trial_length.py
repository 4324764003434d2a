"""A sensitivity: how long the isolated trials last, which the paper does not say.

It gives 1200 frames and no frame rate. The tables are made at 200 Hz, where 1200 frames are 6 s; at 60 Hz, a usual
rate of cameras then, they are 20 s. The same movement is made more slowly, so that the true motion is the same in the
20 nodes: only the noise, whose frequencies are given in rad/s, meets the trial at another speed. Gait stays as it is;
its full leg depends on the isolated trials by the 10 parameters that it leaves alone.

Two tests of `joint_place.py`, at both lengths: distance in any direction, and low rank sum, since a printed set that is
low in every row lies not far in any. The side of the second was chosen when the printed errors had been seen to be low
against 100 draws: who would have looked at either side doubles its p.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from joblib import Parallel, delayed

from gaitcal.arrays import Array
from gaitcal.published.claims import Claim, Verdict
from gaitcal.published.inertial_recovery import generators
from gaitcal.published.joint_place import LIMIT, Place, joint_place, low_place
from gaitcal.published.joint_recovery import FoundFromZero, find_joints, synthetic_problem
from gaitcal.published.published import PROBLEMS, table_one
from gaitcal.published.tables import JOINT_FIGURES, Cell, TableRow
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.motion import ISOLATED_FRAMES, RATE

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
