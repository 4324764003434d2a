"""Statistics of the draws of a study: distributions, expected torque errors, variance by parameter.

Convergence (method, section 6): over the last 10 % of the draws the running mean and the running
coefficient of variation, CV = 100 SD / mean, stay within 2 % of their final values, for every
torque's RMS error.

A person's marker distance is converted to expected torque errors (`estimate_expected_errors`) as
in the published discussion: a marker RMS of 4 mm corresponds to less than 25 % of the JP bounds, or
to 50 % of the noise amplitude, and to the torque errors there. Between levels, and from zero at
level zero, values are interpolated linearly.

The variance of each torque error, linearised, is a sum over the parameters. With p the joint
parameters, N the control points, and all derivatives at the undisturbed case,

    d tau / dp = @tau/@p + (@tau/@q B + @tau/@v B' + @tau/@a B'') dN/dp,
    dN/dp = -H_qq^-1 H_qp,

@tau from `dynamics/derivatives.py` (ground reactions constant in the laboratory). Carried with the
foot, whose frame moves by the twist xi = J_foot dq/dp + J_p, the wrench changes by dw = xi x* w and
the torque of joint k by -J_k . dw:

    d force = w x force,        d moment = w x moment + v x force,        xi = [v; w].

Inertial parameters enter by the regressor. For independent uniform disturbances within +-b_i the
variance of an error, averaged over the frames, is

    sum_i b_i^2 / 3 <(d tau / dp_i)^2>,

of which each term is the contribution of parameter i.
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
"""Per cent of the final value, within which running mean and CV must stay (published criterion)."""
LAST_PART = 0.1
"""Part of the draws over which they must stay there."""
FEWEST = 20
"""Fewest draws for a statement on convergence."""
AGREEMENT_DRAWS = 300
"""Draws by which the linearisation is tested."""
EXPECTED = ("average", "p10", "p50", "p90")
"""Columns of `compute_statistics` that expected errors have."""
_ROWS = [(*linkage.COORDINATES, *linkage.REACTIONS).index(name) for name in draw.LEG_TORQUES]


def measure_settling(values: Array) -> tuple[float, float]:
    """Measure how far running mean and CV are from their final values over the last tenth.

    `values`: (n,) in the order of the draws. Returns: `mean, cv` largest deviation, per cent; NaN
    for fewer than `FEWEST` draws.
    """
    n = len(values)
    if n < FEWEST:
        return np.nan, np.nan
    # Scaled to one, so that squares neither overflow nor vanish.
    scale = float(np.abs(values).max()) or 1.0
    x, count = values / scale, np.arange(1, n + 1)
    mean = np.cumsum(x) / count
    # Running standard deviation: var = E[x^2] - E[x]^2.
    spread = np.sqrt(np.maximum(np.cumsum(x * x) / count - mean**2, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        cv = np.where(mean != 0.0, spread / mean, 0.0)
        last = slice(int(np.ceil(n * (1.0 - LAST_PART))) - 1, None)
        deviations = [
            100.0 * np.abs(run[last] - run[-1]).max() / abs(run[-1]) if run[-1] else 0.0
            for run in (mean, cv)
        ]
    return float(deviations[0]), float(deviations[1])


def compute_statistics(draws: pd.DataFrame) -> pd.DataFrame:
    """Compute the distribution of every quantity over the draws of each set and level.

    Parameters
    ----------
    draws : DataFrame
        One row per draw, columns `draw_study.FIELDS`.

    Returns
    -------
    DataFrame
        One row per `set`, `level`, `quantity`, ground-reaction frame (`grf`) and `measure`.
        `quantity` is a torque (`hip_flexion_l`; %BW*H) or the markers of a leg (`markers_l`; mm);
        `measure` is `rms`, `mean` (signed, over the frames of a draw) or `abs_mean`. Failed draws
        are counted in `failed` and not in the distribution. `mean_settles`, `cv_settles` (per cent)
        are given for `rms`; see `measure_settling`.
    """
    rows = []
    for (varied, level), cell in draws.groupby(["set", "level"], sort=False):
        for row in _summarise_cell(cell):
            rows.append({"set": varied, "level": level, **row})
    return pd.DataFrame(rows)


def _summarise_cell(cell: pd.DataFrame) -> list[dict[str, object]]:
    """Summarise the draws of one set at one level, in rows of `compute_statistics`."""
    # Failed draws are counted, but have no values.
    good = cell[cell["failure"] == ""]
    failed = len(cell) - len(good)
    rows = []
    for frame in ReactionFrame:
        for torque in draw.LEG_TORQUES:
            for measure in (*draw.MEASURES, "abs_mean"):
                column = draw.name_torque_column(torque, frame, measure.removeprefix("abs_"))
                row = _summarise_values(measure, "%BW*H", good[column].to_numpy(), failed)
                rows.append({"quantity": torque, "grf": frame.value, **row})
    for side in linkage.SIDES:
        for measure in draw.MEASURES:
            column = draw.name_marker_column(side, measure)
            row = _summarise_values(measure, "mm", good[column].to_numpy(), failed)
            rows.append({"quantity": f"markers_{side}", "grf": "", **row})
    return rows


def _summarise_values(measure: str, unit: str, values: Array, failed: int) -> dict[str, object]:
    """Summarise the distribution of one quantity over draws (n,)."""
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
        row |= dict(zip(("mean_settles", "cv_settles"), measure_settling(values), strict=True))
    return row


def select_unconverged(table: pd.DataFrame) -> pd.DataFrame:
    """Select the torque RMS errors that do not meet the published criterion.

    Parameters
    ----------
    table : DataFrame
        From `compute_statistics`.

    Returns
    -------
    DataFrame
        Its rows; those with too few draws among them.
    """
    torques = table[(table["measure"] == "rms") & table["grf"].ne("")]
    met = (torques["mean_settles"] <= TOLERANCE_PERCENT) & (
        torques["cv_settles"] <= TOLERANCE_PERCENT
    )
    return torques[~met]


def list_cells_with_failures(table: pd.DataFrame) -> pd.DataFrame:
    """List the sets and levels with draws that did not converge.

    Parameters
    ----------
    table : DataFrame
        From `compute_statistics`.

    Returns
    -------
    DataFrame
        Columns `set`, `level`, `draws` (in the distributions), `failed`.
    """
    cells: pd.DataFrame = table[["set", "level", "draws", "failed"]].drop_duplicates(
        ignore_index=True
    )
    return cells[cells["failed"] > 0]


def select_levels(
    table: pd.DataFrame,
    varied: Varied,
    quantity: str,
    frame: ReactionFrame | None = None,
    measure: str = "rms",
) -> pd.DataFrame:
    """Select the rows of one quantity of a set, ordered by level.

    Parameters
    ----------
    table : DataFrame
        From `compute_statistics`.
    varied : Varied
        The set.
    quantity : str
        Torque or markers of a leg.
    frame : ReactionFrame, optional
        Of the ground reactions; None for markers.
    measure : str
        `rms`, `mean` or `abs_mean`.

    Returns
    -------
    DataFrame
    """
    wanted = {
        "set": varied.value,
        "quantity": quantity,
        "grf": frame.value if frame else "",
        "measure": measure,
    }
    return table[(table[list(wanted)] == list(wanted.values())).all(axis=1)].sort_values("level")


@dataclass(frozen=True)
class CauseOfMarkerError:
    """Level at which one cause alone gives a marker distance, and the torque errors there."""

    varied: Varied
    level: float
    """Per cent of the bounds; the highest level of the study if `beyond`."""
    beyond: bool
    """Whether the marker distance is larger than at the highest level; the torque errors are lower
    limits then.
    """
    torques: pd.DataFrame
    """Columns torque, grf, average, p10, p50, p90: RMS errors, %BW*H."""


def estimate_expected_errors(
    table: pd.DataFrame, rms_mm: float, side: str = "l"
) -> tuple[CauseOfMarkerError, ...]:
    """Estimate the torque errors that correspond to a marker RMS, for each cause alone.

    Parameters
    ----------
    table : DataFrame
        From `compute_statistics`; a cause whose set (`jp`, `noise`) it does not have is left out.
    rms_mm : float
        Marker RMS of the leg, mm.
    side : str
        `r` or `l`, of markers and torques; left as published.

    Returns
    -------
    tuple of CauseOfMarkerError
    """
    return tuple(
        _estimate_cause(table, varied, rms_mm, side)
        for varied in (Varied.JP, Varied.NOISE)
        if (table["set"] == varied.value).any()
    )


def _estimate_cause(
    table: pd.DataFrame, varied: Varied, rms_mm: float, side: str
) -> CauseOfMarkerError:
    """Interpolate level and torque errors of one set at a marker RMS."""
    markers = select_levels(table, varied, f"markers_{side}")
    levels = np.concatenate([[0.0], markers["level"].to_numpy(dtype=float)])
    # Level 0 has no error. Interpolation needs a distance that does not fall with the level.
    distance = np.maximum.accumulate(np.concatenate([[0.0], markers["average"].to_numpy()]))
    beyond = bool(rms_mm > distance[-1])
    level = float(np.interp(rms_mm, distance, levels))
    rows = []
    for frame in ReactionFrame:
        for torque in draw.TORQUES:
            errors = select_levels(table, varied, f"{torque}_{side}", frame)
            values = {c: float(np.interp(level, levels, [0.0, *errors[c]])) for c in EXPECTED}
            rows.append({"torque": f"{torque}_{side}", "grf": frame.value, **values})
    return CauseOfMarkerError(varied, level, beyond, pd.DataFrame(rows))


def _linearise_torques(context: draw.MonteCarloContext) -> tuple[dict[ReactionFrame, Array], Array]:
    """Compute the derivatives of the 14 torques at the undisturbed case.

    Returns: `by_joint` ground-reaction frame -> (nf, 14, np) N·m per m or rad of each joint
    parameter that varies; `by_inertial` (nf, 14, 36) N·m per relative change of each symmetric
    inertial parameter.
    """
    case, basis = context.case, context.basis
    q, v, a = (basis.evaluate(case.coefficients, k) for k in range(3))
    derivatives = compute_force_derivatives(case.parameters, context.names, q, v, a, case.wrench)
    nf, nq, n_free = len(q), q.shape[1], len(context.names)
    moved = context.sensitivity.reshape(len(case.coefficients), -1)
    motion = [(basis.matrices[k] @ moved).reshape(nf, nq, n_free) for k in range(3)]
    # Change of the torques at a fixed motion.
    laboratory = derivatives.by_parameter[:, _ROWS]
    # The motion follows the joint parameters: chain rule over position, velocity, acceleration.
    by_motion = (derivatives.by_position, derivatives.by_velocity, derivatives.by_acceleration)
    for derivative, change in zip(by_motion, motion, strict=True):
        laboratory = laboratory + derivative[:, _ROWS] @ change
    # In foot frames the wrenches move with the feet as well.
    foot = laboratory - _compute_load_changes(context, q, motion[0])
    inertial = case.parameters.inertial
    # Chain rule: dynamic parameters by inertial ones, and these by relative changes.
    relative = block_diag(*parameters.compute_dynamic_jacobian(inertial)) @ (
        inertial[:, None] * context.inertial_set.selection
    )
    by_inertial = (context.regressor @ relative).reshape(nf, len(draw.LEG_TORQUES), -1)
    return {ReactionFrame.LAB: laboratory, ReactionFrame.FOOT: foot}, by_inertial


@with_one_blas_thread
def compute_linear_agreement(
    context: draw.MonteCarloContext,
    draws: pd.DataFrame,
    cell: tuple[Varied, int],
    frame: ReactionFrame,
) -> Array:
    """Compute R^2 of the linearised RMS errors as a prediction of the drawn ones.

    Parameters
    ----------
    context : MonteCarloContext
        The case.
    draws : DataFrame
        One row per draw; the first `AGREEMENT_DRAWS` that converged are used.
    cell : (Varied, int)
        Set and level.
    frame : ReactionFrame
        Of the ground reactions.

    Returns
    -------
    (14,) array
        Of each torque of `LEG_TORQUES`.
    """
    varied, level = cell
    is_used = (draws["set"] == varied.value) & (draws["level"] == level) & (draws["failure"] == "")
    used = draws[is_used].head(AGREEMENT_DRAWS)
    by_joint, by_inertial = _linearise_torques(context)
    valid, to_percent = context.case.valid, 100.0 / context.case.subject.bwh
    predicted = np.empty((len(used), len(draw.LEG_TORQUES)))
    for row, number in enumerate(used["draw"]):
        change = draw.draw_disturbance(context, varied, level, int(number))
        # The same random numbers as the draw, so that both errors belong to one disturbance.
        error = np.zeros(context.torques.shape)
        if change.joint is not None:
            error += by_joint[frame] @ change.joint
        if change.inertial is not None:
            error += by_inertial @ change.inertial
        predicted[row] = to_percent * np.sqrt((error[valid] ** 2).mean(axis=0))
    columns = [draw.name_torque_column(torque, frame, "rms") for torque in draw.LEG_TORQUES]
    drawn = used[columns].to_numpy()
    residual = ((drawn - predicted) ** 2).sum(axis=0)
    out: Array = 1.0 - residual / ((drawn - drawn.mean(axis=0)) ** 2).sum(axis=0)
    return out


def _compute_load_changes(context: draw.MonteCarloContext, q: Array, change: Array) -> Array:
    """Compute (nf, 14, np) derivatives of J_k . w for wrenches that move with the feet.

    `q`: (nf, nq) coordinates; `change`: (nf, nq, np) their derivatives by the joint parameters.
    """
    case = context.case
    chain = get_chain(free=context.names, reactions=True)
    nq, first = len(chain.coordinates), len(chain.variables) - len(chain.free)
    placed = Kinematics(chain.body(case.parameters), q)
    columns = placed.columns.transpose(2, 1, 0)
    out = np.zeros((len(q), len(draw.LEG_TORQUES), len(context.names)))
    for foot, segment in enumerate(FEET):
        moves = placed.moves(segment)
        # Twist of the foot per unit of each joint parameter: through the motion, and directly.
        twist = (columns[:, :, :nq] * moves[:nq]) @ change + columns[:, :, first:] * moves[first:]
        velocity, rotation = twist[:, :3].transpose(0, 2, 1), twist[:, 3:].transpose(0, 2, 1)
        force, moment = case.wrench[:, foot, None, :3], case.wrench[:, foot, None, 3:]
        # A wrench that is rotated and moved with the foot, about the laboratory origin.
        force_change = np.cross(rotation, force)
        moment_change = np.cross(rotation, moment) + np.cross(velocity, force)
        wrench_change = np.concatenate([force_change, moment_change], axis=2)
        names = [draw.LEG_TORQUES[k] for k in draw.TORQUES_OF_FOOT[foot]]
        axes = columns[:, :, [chain.variables.index(name) for name in names]]
        out[:, draw.TORQUES_OF_FOOT[foot]] = axes.transpose(0, 2, 1) @ wrench_change.transpose(
            0, 2, 1
        )
    return out


@with_one_blas_thread
def compute_variance_contributions(context: draw.MonteCarloContext) -> pd.DataFrame:
    """Compute the contribution of each parameter to the variance of each torque.

    Parameters
    ----------
    context : MonteCarloContext
        The case.

    Returns
    -------
    DataFrame
        One row per torque, ground-reaction frame and parameter, at 100 % of the bounds. Columns:
        `torque`, `grf`, `parameter`, `kind` (`jp` or `ip`), `rms` (%BW*H, the RMS error that this
        parameter alone causes), `share` (per cent of the variance of the torque when joint and
        inertial parameters vary together).
    """
    (by_joint, by_inertial), settings = _linearise_torques(context), context.settings
    valid, to_percent = context.case.valid, 100.0 / context.case.subject.bwh
    inertial_bound = np.full(len(context.inertial_set.names), settings.inertial_percent / 100.0)
    bounds = np.concatenate([settings.joint_bounds, inertial_bound])
    names = np.array([*context.names, *context.inertial_set.names])
    kinds = np.array(["jp"] * len(context.names) + ["ip"] * len(inertial_bound))
    parts = []
    for frame in ReactionFrame:
        derivatives = np.concatenate([by_joint[frame], by_inertial], axis=2)[valid]
        # A uniform distribution within +-b has the variance b^2 / 3.
        variance = (bounds**2 / 3.0) * ((to_percent * derivatives) ** 2).mean(axis=0)
        for k, torque in enumerate(draw.LEG_TORQUES):
            # A torque that no parameter changes has no shares.
            share = 100.0 * variance[k] / (variance[k].sum() or 1.0)
            columns = {
                "parameter": names,
                "kind": kinds,
                "rms": np.sqrt(variance[k]),
                "share": share,
            }
            parts.append(pd.DataFrame({"torque": torque, "grf": frame.value, **columns}))
    return pd.concat(parts, ignore_index=True)


def compute_variance_shares(
    contributions: pd.DataFrame, frame: ReactionFrame, side: str
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Sum the variance shares of each torque of a leg: its joint parameters, and all others.

    Parameters
    ----------
    contributions : DataFrame
        From `compute_variance_contributions`.
    frame : ReactionFrame
        Of the ground reactions.
    side : str
        `r` or `l`.

    Returns
    -------
    tuple of DataFrame
        Per cent. Rows: the joint parameters of the leg by name, and the others in two groups;
        columns: the torques of the leg, `TORQUES` with the side.
    """
    rows = contributions[contributions["grf"] == frame.value]
    # One row for each parameter, one column for each torque of this leg.
    wide = rows.pivot_table(index="parameter", columns="torque", values="share", sort=False)
    wide = wide[[f"{torque}_{side}" for torque in draw.TORQUES]]
    inertial = set(rows.loc[rows["kind"] == "ip", "parameter"])
    of_leg = [name for name in wide.index if name in parameters.list_leg_parameters(side)]
    elsewhere = [name for name in wide.index if name not in {*of_leg, *inertial}]
    of_bodies = [name for name in wide.index if name in inertial]
    sums = {
        "joint parameters elsewhere": wide.loc[elsewhere].sum(),
        f"inertial parameters ({len(inertial)})": wide.loc[of_bodies].sum(),
    }
    return wide.loc[of_leg], pd.DataFrame(sums).T
