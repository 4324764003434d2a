"""Draws whose motion is fitted a given number of iterations from the undisturbed motion, not to the end.

The paper does not say when its re-fits end. Two iterations, at the two ends of what one would use:

- *Gauss-Newton*, the whole step of the normal equations, damped only where it would raise the cost;
- *steepest descent*, every node scaled by its own diagonal entry of the Gauss-Newton matrix (of the undisturbed
  motion), as far as the line's minimum.

Nothing of the disturbance is known at the start: the motion is the undisturbed one, without the first-order change
that starts the re-fits of the study (`context.py`). No iteration leaves that motion; the end is the study's own draw.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import Enum

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from gaitcal.arrays import Array
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.track import track_nodes
from gaitcal.published.case import MonteCarloCase
from gaitcal.published.context import MonteCarloContext
from gaitcal.published.draw import COLUMNS, DisturbedModel, disturb, disturbed_model, draw, errors_of
from gaitcal.published.settings import PUBLISHED_LEVELS, MonteCarloSettings, Varied
from gaitcal.runtime import with_one_blas_thread

SETS = (Varied.JP, Varied.NOISE)
"""Inertial parameters alone need no re-fit."""
CONVERGED = -1
"""Number of iterations of a re-fit that goes on to its end."""
PROBE = 1e-5
"""Part of a step by which positions are differenced along it."""


class Iteration(Enum):
    """How the motion is fitted."""

    GAUSS_NEWTON = "Gauss-Newton"
    STEEPEST_DESCENT = "steepest descent"

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of iterations that are looked at; the last is the end of the re-fit."""
        of_descent = (30,) if self is Iteration.STEEPEST_DESCENT else ()
        return (0, 1, 2, 3, 5, 10, *of_descent, CONVERGED)


def unfinished_draws(
    case: MonteCarloCase, settings: MonteCarloSettings, draws: int, jobs: int = -1, levels: Sequence[int] = ()
) -> pd.DataFrame:
    """Draws 0 to `draws` - 1 of `SETS` at the levels (the published ones unless given), after each number of steps.

    Columns: `iteration`, `iterations` (`CONVERGED`: to the end), `set`, `level`, `draw`, `failure`, then `COLUMNS`.
    """
    cells = [(varied, level) for varied in SETS for level in levels or PUBLISHED_LEVELS]
    parts = Parallel(n_jobs=jobs)(delayed(_cell)(case, settings, varied, level, draws) for varied, level in cells)
    return pd.concat(parts, ignore_index=True)


@with_one_blas_thread
def _cell(case: MonteCarloCase, settings: MonteCarloSettings, varied: Varied, level: int, draws: int) -> pd.DataFrame:
    context = MonteCarloContext(case, settings)
    rows = [row for number in range(draws) for row in _rows(context, varied, level, number)]
    keys = ("iteration", "iterations", "set", "level", "draw", "failure")
    return pd.DataFrame(rows, columns=[*keys, *COLUMNS])


def _rows(context: MonteCarloContext, varied: Varied, level: int, number: int) -> Iterator[tuple[object, ...]]:
    model = disturbed_model(context, disturb(context, varied, level, number))
    for iteration in Iteration:
        key = (iteration.value,)
        rest = (varied.value, level, number)
        counts = [count for count in iteration.counts if count != CONVERGED]
        for count, nodes in zip(counts, path(context, model, iteration, counts), strict=True):
            yield (*key, count, *rest, "", *errors_of(context, model, nodes))
        end = draw(context, varied, level, number)
        yield (*key, CONVERGED, *rest, end.failure, *end.values)


def path(
    context: MonteCarloContext, model: DisturbedModel, iteration: Iteration, counts: Sequence[int]
) -> Iterator[Array]:
    """The nodes (nn, nq) after each of a rising sequence of numbers of iterations from the undisturbed motion."""
    nodes, done = context.case.nodes, 0
    advance = _gauss_newton if iteration is Iteration.GAUSS_NEWTON else _steepest_descent
    for count in counts:
        nodes = advance(context, model, nodes, count - done)
        done = count
        yield nodes


def _gauss_newton(context: MonteCarloContext, model: DisturbedModel, nodes: Array, steps: int) -> Array:
    """So many steps with a new matrix each; one that raised the cost and was damped counts too."""
    rule = DescentSettings(gain=0.0, kept_gain=0.0, most_steps=steps, keep_within=0.0, curved_tries=0)
    return track_nodes(model.problem, model.constants, nodes, rule).nodes if steps else nodes


def _steepest_descent(context: MonteCarloContext, model: DisturbedModel, nodes: Array, steps: int) -> Array:
    problem, constants = model.problem, model.constants
    for _ in range(steps):
        _, gradient = problem.gradient(nodes, constants)
        step = -gradient / context.undisturbed_diagonal
        ahead, behind = (problem.positions(nodes + part * step, constants) for part in (PROBE, -PROBE))
        slope = (ahead - behind) / (2.0 * PROBE)
        bend = float(np.einsum("mcf,mcf,mf->", slope, slope, problem.data.weight))
        if bend > 0.0:
            nodes = nodes - float(np.vdot(gradient, step)) / bend * step
    return nodes
