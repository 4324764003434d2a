"""What the draws of a study say: distributions, what a marker error may mean, and which parameter
matters.

Convergence (method, section 6): over the last 10 % of the draws the running mean and the running
coefficient of variation, CV = 100 SD / mean, stay within 2 % of their final values, for every
torque's RMS error.

A person's marker distance is turned into the torque errors to expect (`expect`) as the published
discussion does by hand: a marker RMS of 4 mm corresponds to less than 25 % of the JP bounds, or to
50 % of the noise amplitude, and to the torque errors there. Between levels, and from nothing at
level zero, straight lines.

Which parameter matters is the variance of each torque error, linearised, shared out parameter by
parameter. With p the joint parameters, N the nodes, and all derivatives at the undisturbed case,

    d tau / dp = @tau/@p + (@tau/@q B + @tau/@v B' + @tau/@a B'') dN/dp,          dN/dp = -H_qq^-1 H_qp,

@tau from `dynamics/derivatives.py` (ground reactions fixed in the laboratory). Carried along with
the foot, whose frame moves by the twist xi = J_foot dq/dp + J_p, the wrench changes by dw = xi x* w
and the torque of joint k by -J_k . dw:

    d force = w x force,        d moment = w x moment + v x force,        xi = [v; w].

Inertial parameters enter by the regressor. For independent uniform disturbances within +-b_i the
variance of an error,
averaged over the frames, is a sum:  sum_i b_i^2 / 3 <(d tau / dp_i)^2>;  each term is what parameter i contributes.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.linalg import block_diag

from gaitcal.arrays import Array
from gaitcal.dynamics.derivatives import compute_force_derivatives
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.model import linkage, parameters
from gaitcal.model.chain import get_chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.montecarlo import draw
from gaitcal.montecarlo.protocol import ReactionFrame, Varied
from gaitcal.runtime import with_one_blas_thread

PERCENTILES = (10, 25, 50, 75, 90)
TOLERANCE_PERCENT = 2.0
LAST_PART = 0.1
FEWEST = 20
"""Draws below which nothing is said of convergence."""
EXPECTED = ("average", "p10", "p50", "p90")
"""Columns of `statistics` that are told of the errors to expect."""


def settling(values: Array) -> tuple[float, float]:
    """How far the running mean and CV of `values` (n,) are, over the last tenth, from their final
    values, per cent.

    In the order of the draws; NaN for too few.
    """
    n = len(values)
    if n < FEWEST:
        return np.nan, np.nan
    scale = float(np.abs(values).max()) or 1.0
    x, count = values / scale, np.arange(1, n + 1)
    mean = np.cumsum(x) / count
    spread = np.sqrt(np.maximum(np.cumsum(x * x) / count - mean**2, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        cv = np.where(mean != 0.0, spread / mean, 0.0)
        last = slice(int(np.ceil(n * (1.0 - LAST_PART))) - 1, None)
        apart = [
            100.0 * np.abs(run[last] - run[-1]).max() / abs(run[-1]) if run[-1] else 0.0
            for run in (mean, cv)
        ]
    return float(apart[0]), float(apart[1])


def statistics(draws: pd.DataFrame) -> pd.DataFrame:
    """One row per set, level, quantity, ground-reaction frame and measure.

    `quantity` is a torque (`hip_flexion_l`; %BW*H) or the markers of a leg (`markers_l`; mm);
    `measure` is `rms`, `mean` (signed, over the frames of a draw) or `abs_mean`. Failed draws are
    counted in `failed` and left out of the distribution. `mean_settles`, `cv_settles` (per cent)
    are given for `rms`; see `settling`.
    """
    rows = [
        {"set": varied, "level": level, **row}
        for (varied, level), cell in draws.groupby(["set", "level"], sort=False)
        for row in _cell(cell)
    ]
    return pd.DataFrame(rows)


def _cell(cell: pd.DataFrame) -> list[dict[str, object]]:
    good = cell[cell["failure"] == ""]
    failed = len(cell) - len(good)
    rows = []
    for frame in ReactionFrame:
        for torque in draw.LEG_TORQUES:
            for measure in (*draw.MEASURES, "abs_mean"):
                values = good[
                    draw.torque_column(torque, frame, measure.removeprefix("abs_"))
                ].to_numpy()
                rows.append(
                    {
                        "quantity": torque,
                        "grf": frame.value,
                        **_distribution(measure, "%BW*H", values, failed),
                    }
                )
    for side in linkage.SIDES:
        for measure in draw.MEASURES:
            values = good[draw.marker_column(side, measure)].to_numpy()
            rows.append(
                {
                    "quantity": f"markers_{side}",
                    "grf": "",
                    **_distribution(measure, "mm", values, failed),
                }
            )
    return rows


def _distribution(measure: str, unit: str, values: Array, failed: int) -> dict[str, object]:
    shown = np.abs(values) if measure == "abs_mean" else values
    row: dict[str, object] = {
        "measure": measure,
        "unit": unit,
        "draws": len(values),
        "failed": failed,
        "average": shown.mean() if len(shown) else np.nan,
        "sd": shown.std() if len(shown) else np.nan,
    }
    points = np.percentile(shown, PERCENTILES) if len(shown) else np.full(len(PERCENTILES), np.nan)
    row |= {f"p{p}": value for p, value in zip(PERCENTILES, points, strict=True)}
    if measure == "rms":
        row |= dict(zip(("mean_settles", "cv_settles"), settling(values), strict=True))
    return row


def unconverged(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of `statistics` whose torque RMS does not meet the published criterion (or has too few
    draws to tell).
    """
    torques = table[(table["measure"] == "rms") & table["grf"].ne("")]
    met = (torques["mean_settles"] <= TOLERANCE_PERCENT) & (
        torques["cv_settles"] <= TOLERANCE_PERCENT
    )
    return torques[~met]


def left_out(table: pd.DataFrame) -> pd.DataFrame:
    """Columns `set`, `level`, `draws` (in the distributions), `failed`: cells with draws that did
    not converge.
    """
    cells: pd.DataFrame = table[["set", "level", "draws", "failed"]].drop_duplicates(
        ignore_index=True
    )
    return cells[cells["failed"] > 0]


def levels_of(
    table: pd.DataFrame,
    varied: Varied,
    quantity: str,
    frame: ReactionFrame | None = None,
    measure: str = "rms",
) -> pd.DataFrame:
    """The rows of one quantity of a set, ordered by level; markers have no frame."""
    wanted = {
        "set": varied.value,
        "quantity": quantity,
        "grf": frame.value if frame else "",
        "measure": measure,
    }
    return table[(table[list(wanted)] == list(wanted.values())).all(axis=1)].sort_values("level")


@dataclass(frozen=True)
class CauseOfMarkerError:
    """What level of one cause alone would give the marker distance."""

    varied: Varied
    level: float
    """Per cent of the bounds; the highest level studied where `beyond`."""
    beyond: bool
    """The marker distance is larger than at the highest level: the torque errors are lower limits.
    """
    torques: pd.DataFrame
    """torque, grf, average, p10, p50, p90: RMS errors, %BW*H."""


def expect(table: pd.DataFrame, rms_mm: float, side: str = "l") -> tuple[CauseOfMarkerError, ...]:
    """JP and noise levels that correspond to a marker RMS (mm) of a leg, and the torque errors to
    expect there.

    `table`: from `statistics`, with the sets `jp` or `noise` in it; a set that is not there is left
    out. `side`: whose markers and torques; left as published.
    """
    causes = (Varied.JP, Varied.NOISE)
    return tuple(
        _cause(table, varied, rms_mm, side)
        for varied in causes
        if (table["set"] == varied.value).any()
    )


def _cause(table: pd.DataFrame, varied: Varied, rms_mm: float, side: str) -> CauseOfMarkerError:
    markers = levels_of(table, varied, f"markers_{side}")
    levels = np.concatenate([[0.0], markers["level"].to_numpy(dtype=float)])
    distance = np.maximum.accumulate(np.concatenate([[0.0], markers["average"].to_numpy()]))
    beyond = bool(rms_mm > distance[-1])
    level = float(np.interp(rms_mm, distance, levels))
    rows = []
    for frame in ReactionFrame:
        for torque in draw.TORQUES:
            errors = levels_of(table, varied, f"{torque}_{side}", frame)
            values = {c: float(np.interp(level, levels, [0.0, *errors[c]])) for c in EXPECTED}
            rows.append({"torque": f"{torque}_{side}", "grf": frame.value, **values})
    return CauseOfMarkerError(varied, level, beyond, pd.DataFrame(rows))


_ROWS = [(*linkage.COORDINATES, *linkage.REACTIONS).index(name) for name in draw.LEG_TORQUES]


def linear_torques(context: draw.MonteCarloContext) -> tuple[dict[ReactionFrame, Array], Array]:
    """Derivatives of the 14 torques at the undisturbed case: by joint parameters (nf, 14, np) N·m
    per m or rad, in either frame, and (nf, 14, 36) N·m per relative change of each symmetric
    inertial parameter.
    """
    case, basis = context.case, context.basis
    q, v, a = (basis.evaluate(case.coefficients, k) for k in range(3))
    slopes = compute_force_derivatives(case.parameters, context.names, q, v, a, case.wrench)
    nf, nq, n_free = len(q), q.shape[1], len(context.names)
    moved = context.sensitivity.reshape(len(case.coefficients), -1)
    motion = [(basis.matrices[k] @ moved).reshape(nf, nq, n_free) for k in range(3)]
    laboratory = slopes.by_parameter[:, _ROWS]
    for slope, change in zip(
        (slopes.by_position, slopes.by_velocity, slopes.by_acceleration), motion, strict=True
    ):
        laboratory = laboratory + slope[:, _ROWS] @ change
    carried = laboratory - _carried(context, q, motion[0])
    inertial = case.parameters.inertial
    relative = block_diag(*parameters.compute_dynamic_jacobian(inertial)) @ (
        inertial[:, None] * context.inertial_set.selection
    )
    by_inertial = (context.regressor @ relative).reshape(nf, len(draw.LEG_TORQUES), -1)
    return {ReactionFrame.LAB: laboratory, ReactionFrame.FOOT: carried}, by_inertial


@with_one_blas_thread
def linear_agreement(
    context: draw.MonteCarloContext,
    draws: pd.DataFrame,
    cell: tuple[Varied, int],
    frame: ReactionFrame,
) -> Array:
    """(14,) R^2 of the linearised RMS errors as a prediction of those of the first 300 draws of a
    set at a level.
    """
    varied, level = cell
    of = draws[
        (draws["set"] == varied.value) & (draws["level"] == level) & (draws["failure"] == "")
    ].head(300)
    by_joint, by_inertial = linear_torques(context)
    valid, to_percent = context.case.valid, 100.0 / context.case.subject.bwh
    predicted = np.empty((len(of), len(draw.LEG_TORQUES)))
    for row, number in enumerate(of["draw"]):
        change = draw.disturb(context, varied, level, int(number))
        error = np.zeros(context.torques.shape)
        if change.joint is not None:
            error += by_joint[frame] @ change.joint
        if change.inertial is not None:
            error += by_inertial @ change.inertial
        predicted[row] = to_percent * np.sqrt((error[valid] ** 2).mean(axis=0))
    drawn = of[[draw.torque_column(torque, frame, "rms") for torque in draw.LEG_TORQUES]].to_numpy()
    residual = ((drawn - predicted) ** 2).sum(axis=0)
    out: Array = 1.0 - residual / ((drawn - drawn.mean(axis=0)) ** 2).sum(axis=0)
    return out


def _carried(context: draw.MonteCarloContext, q: Array, change: Array) -> Array:
    """(nf, 14, np) change of J_k . w where the wrenches move with the feet."""
    case = context.case
    chain = get_chain(free=context.names, reactions=True)
    nq, first = len(chain.coordinates), len(chain.variables) - len(chain.free)
    placed = Kinematics(chain.body(case.parameters), q)
    columns = placed.columns.transpose(2, 1, 0)
    out = np.zeros((len(q), len(draw.LEG_TORQUES), len(context.names)))
    for foot, segment in enumerate(FEET):
        after = placed.moves(segment)
        twist = (columns[:, :, :nq] * after[:nq]) @ change + columns[:, :, first:] * after[first:]
        velocity, turn = twist[:, :3].transpose(0, 2, 1), twist[:, 3:].transpose(0, 2, 1)
        force, moment = case.wrench[:, foot, None, :3], case.wrench[:, foot, None, 3:]
        moved = np.concatenate(
            [np.cross(turn, force), np.cross(turn, moment) + np.cross(velocity, force)], axis=2
        )
        names = [draw.LEG_TORQUES[k] for k in draw.OF_FOOT[foot]]
        axes = columns[:, :, [chain.variables.index(name) for name in names]]
        out[:, draw.OF_FOOT[foot]] = axes.transpose(0, 2, 1) @ moved.transpose(0, 2, 1)
    return out


@with_one_blas_thread
def variance_contributions(context: draw.MonteCarloContext) -> pd.DataFrame:
    """One row per torque, ground-reaction frame and parameter, at 100 % of the bounds.

    Columns: `torque`, `grf`, `parameter`, `kind` (`jp` or `ip`), `rms` (%BW*H, the RMS error that
    this parameter alone causes), `share` (per cent of the variance of the torque when joint and
    inertial parameters vary together).
    """
    (by_joint, by_inertial), settings = linear_torques(context), context.settings
    valid, to_percent = context.case.valid, 100.0 / context.case.subject.bwh
    inertial_bound = np.full(len(context.inertial_set.names), settings.inertial_percent / 100.0)
    bounds = np.concatenate([settings.joint_bounds, inertial_bound])
    names = np.array([*context.names, *context.inertial_set.names])
    kinds = np.array(["jp"] * len(context.names) + ["ip"] * len(inertial_bound))
    parts = []
    for frame in ReactionFrame:
        slopes = np.concatenate([by_joint[frame], by_inertial], axis=2)[valid]
        variance = (bounds**2 / 3.0) * ((to_percent * slopes) ** 2).mean(axis=0)
        for k, torque in enumerate(draw.LEG_TORQUES):
            share = (
                100.0 * variance[k] / (variance[k].sum() or 1.0)
            )  # where nothing changes a torque: none of it
            columns = {
                "parameter": names,
                "kind": kinds,
                "rms": np.sqrt(variance[k]),
                "share": share,
            }
            parts.append(pd.DataFrame({"torque": torque, "grf": frame.value, **columns}))
    return pd.concat(parts, ignore_index=True)


def variance_shares(
    contributions: pd.DataFrame, frame: ReactionFrame, side: str
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Per cent of the variance of each of a leg's seven torques: by each of its joint parameters,
    and by all others.

    `contributions`: rows of parameter, kind, torque, grf and share (per cent), as a Monte Carlo
    study has them. `side`: `r` or `l`.

    Returns
    -------
    Rows: the leg's joint parameters by name, and the rest in two groups; columns: its torques,
    `TORQUES` with the side.
    """
    rows = contributions[contributions["grf"] == frame.value]
    wide = rows.pivot_table(index="parameter", columns="torque", values="share", sort=False)
    wide = wide[[f"{torque}_{side}" for torque in draw.TORQUES]]
    inertial = set(rows.loc[rows["kind"] == "ip", "parameter"])
    of_leg = [name for name in wide.index if name in parameters.list_leg_parameters(side)]
    rest = {
        "joint parameters elsewhere": [
            name for name in wide.index if name not in {*of_leg, *inertial}
        ],
        f"inertial parameters ({len(inertial)})": [name for name in wide.index if name in inertial],
    }
    groups = pd.DataFrame({label: wide.loc[names].sum() for label, names in rest.items()}).T
    return wide.loc[of_leg], groups
