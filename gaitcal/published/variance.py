"""Which parameter matters: the variance of each torque error, linearised, shared out parameter by parameter.

With p the joint parameters, N the nodes, and all derivatives at the undisturbed case,

    d tau / dp = @tau/@p + (@tau/@q B + @tau/@v B' + @tau/@a B'') dN/dp,          dN/dp = -H_qq^-1 H_qp,

@tau from `dynamics/derivatives.py` (ground reactions fixed in the laboratory). Carried along with the foot, whose frame
moves by the twist xi = J_foot dq/dp + J_p, the wrench changes by dw = xi x* w and the torque of joint k by -J_k . dw:

    d force = w x force,        d moment = w x moment + v x force,        xi = [v; w].

Inertial parameters enter by the regressor. For independent uniform disturbances within +-b_i the variance of an error,
averaged over the frames, is a sum:  sum_i b_i^2 / 3 <(d tau / dp_i)^2>;  each term is what parameter i contributes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.linalg import block_diag

from gaitcal.arrays import Array
from gaitcal.dynamics.derivatives import force_derivatives
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.model.chain import Chain
from gaitcal.model.inertial_parameters import dynamic_jacobian
from gaitcal.model.kinematics import forward, jacobian
from gaitcal.model.linkage import COORDINATES, REACTIONS
from gaitcal.motion.spline import basis_matrix
from gaitcal.published.context import MonteCarloContext
from gaitcal.published.draw import disturb, torque_column
from gaitcal.published.leg_torques import LEG_TORQUES, OF_FOOT
from gaitcal.published.settings import ReactionFrame, Varied
from gaitcal.runtime import with_one_blas_thread

_ROWS = [(*COORDINATES, *REACTIONS).index(name) for name in LEG_TORQUES]


@dataclass(frozen=True)
class LinearTorques:
    """Derivatives of the 14 torques by what the study varies."""

    by_joint: dict[ReactionFrame, Array]
    """(nf, 14, np) N·m per m or rad."""
    by_inertial: Array
    """(nf, 14, 36) N·m per relative change of each symmetric inertial parameter."""


def linear_torques(context: MonteCarloContext) -> LinearTorques:
    """Derivatives at the undisturbed case."""
    case, basis = context.case, context.basis
    q, v, a = (basis.evaluate(case.nodes, k) for k in range(3))
    slopes = force_derivatives(case.parameters, context.names, q, v, a, case.wrench)
    nf, nq, n_free = len(q), q.shape[1], len(context.names)
    moved = context.sensitivity.reshape(len(case.nodes), -1)
    motion = [(basis_matrix(basis, k) @ moved).reshape(nf, nq, n_free) for k in range(3)]
    laboratory = slopes.by_parameter[:, _ROWS]
    for slope, change in zip((slopes.by_position, slopes.by_velocity, slopes.by_acceleration), motion, strict=True):
        laboratory = laboratory + slope[:, _ROWS] @ change
    carried = laboratory - _carried(context, q, motion[0])
    return LinearTorques({ReactionFrame.LAB: laboratory, ReactionFrame.FOOT: carried}, _by_inertial(context))


@with_one_blas_thread
def linear_agreement(
    context: MonteCarloContext, draws: pd.DataFrame, cell: tuple[Varied, int], frame: ReactionFrame, most: int = 300
) -> Array:
    """(14,) R^2 of the linearised RMS errors as a prediction of those of at most `most` draws of a set at a level."""
    varied, level = cell
    of = draws[(draws["set"] == varied.value) & (draws["level"] == level) & (draws["failure"] == "")].head(most)
    linear, valid, to_percent = linear_torques(context), context.case.valid, 100.0 / context.case.subject.bwh
    predicted = np.empty((len(of), len(LEG_TORQUES)))
    for row, number in enumerate(of["draw"]):
        change = disturb(context, varied, level, int(number))
        error = np.zeros(context.torques.shape)
        if change.joint is not None:
            error += linear.by_joint[frame] @ change.joint
        if change.inertial is not None:
            error += linear.by_inertial @ change.inertial
        predicted[row] = to_percent * np.sqrt((error[valid] ** 2).mean(axis=0))
    drawn = of[[torque_column(torque, frame, "rms") for torque in LEG_TORQUES]].to_numpy()
    residual = ((drawn - predicted) ** 2).sum(axis=0)
    out: Array = 1.0 - residual / ((drawn - drawn.mean(axis=0)) ** 2).sum(axis=0)
    return out


def _carried(context: MonteCarloContext, q: Array, change: Array) -> Array:
    """(nf, 14, np) change of J_k . w where the wrenches move with the feet."""
    case = context.case
    chain = Chain(free=context.names, reactions=True)
    place = [chain.coordinates.index(name) for name in COORDINATES]
    expanded = np.zeros((len(q), len(chain.coordinates)))
    expanded[:, place] = q
    constants = chain.constants(case.parameters.joint, case.parameters.zero_angles)
    columns = jacobian(chain, constants, forward(chain, constants, expanded)).transpose(2, 1, 0)
    nk = len(chain.coordinates)
    out = np.zeros((len(q), len(LEG_TORQUES), len(context.names)))
    for foot, segment in enumerate(FEET):
        after = chain.support[:, chain.segments.index(segment)]
        twist = (columns[:, :, place] * after[place]) @ change + columns[:, :, nk:] * after[nk:]
        velocity, turn = twist[:, :3].transpose(0, 2, 1), twist[:, 3:].transpose(0, 2, 1)
        force, moment = case.wrench[:, foot, None, :3], case.wrench[:, foot, None, 3:]
        moved = np.concatenate([np.cross(turn, force), np.cross(turn, moment) + np.cross(velocity, force)], axis=2)
        names = [LEG_TORQUES[k] for k in OF_FOOT[foot]]
        axes = columns[:, :, [chain.coordinates.index(name) for name in names]]
        out[:, OF_FOOT[foot]] = axes.transpose(0, 2, 1) @ moved.transpose(0, 2, 1)
    return out


def _by_inertial(context: MonteCarloContext) -> Array:
    """(nf, 14, 36): the regressor, times the derivative of the dynamic parameters, segment by segment."""
    inertial = context.case.parameters.inertial
    slopes: Array = block_diag(*dynamic_jacobian(inertial))
    relative = slopes @ (inertial[:, None] * context.inertial_set.selection)
    return (context.regressor @ relative).reshape(-1, len(LEG_TORQUES), relative.shape[1])


@with_one_blas_thread
def variance_contributions(context: MonteCarloContext) -> pd.DataFrame:
    """One row per torque, ground-reaction frame and parameter, at 100 % of the bounds.

    Columns: `torque`, `grf`, `parameter`, `kind` (`jp` or `ip`), `rms` (%BW*H, the RMS error that this parameter alone
    causes), `share` (per cent of the variance of the torque when joint and inertial parameters vary together).
    """
    linear, settings = linear_torques(context), context.settings
    valid, to_percent = context.case.valid, 100.0 / context.case.subject.bwh
    inertial_bound = np.full(len(context.inertial_set.names), settings.inertial_percent / 100.0)
    bounds = np.concatenate([settings.joint_bounds, inertial_bound])
    names = np.array([*context.names, *context.inertial_set.names])
    kinds = np.array(["jp"] * len(context.names) + ["ip"] * len(inertial_bound))
    parts = []
    for frame in ReactionFrame:
        slopes = np.concatenate([linear.by_joint[frame], linear.by_inertial], axis=2)[valid]
        variance = (bounds**2 / 3.0) * ((to_percent * slopes) ** 2).mean(axis=0)
        for k, torque in enumerate(LEG_TORQUES):
            share = 100.0 * variance[k] / variance[k].sum()
            columns = {"parameter": names, "kind": kinds, "rms": np.sqrt(variance[k]), "share": share}
            parts.append(pd.DataFrame({"torque": torque, "grf": frame.value, **columns}))
    return pd.concat(parts, ignore_index=True)
