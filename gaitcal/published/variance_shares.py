"""Which joint parameters of a leg make the errors of its torques: shares of variance, ready to be told."""

from __future__ import annotations

import pandas as pd

from gaitcal.model.joint_parameters import leg_parameters
from gaitcal.published.leg_torques import TORQUES
from gaitcal.published.settings import ReactionFrame


def variance_shares(contributions: pd.DataFrame, frame: ReactionFrame, side: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Per cent of the variance of each of a leg's seven torques: by each of its joint parameters, and by all others.

    Parameters
    ----------
    contributions : rows of parameter, kind, torque, grf and share (per cent), as a Monte Carlo study has them.
    side : `r` or `l`.

    Returns
    -------
    Rows: the leg's joint parameters by name, and the rest in two groups; columns: its torques, `TORQUES` with the side.
    """
    rows = contributions[contributions["grf"] == frame.value]
    wide = rows.pivot_table(index="parameter", columns="torque", values="share", sort=False)
    wide = wide[[f"{torque}_{side}" for torque in TORQUES]]
    inertial = set(rows.loc[rows["kind"] == "ip", "parameter"])
    of_leg = [name for name in wide.index if name in leg_parameters(side)]
    rest = {
        "joint parameters elsewhere": [name for name in wide.index if name not in {*of_leg, *inertial}],
        f"inertial parameters ({len(inertial)})": [name for name in wide.index if name in inertial],
    }
    groups = pd.DataFrame({label: wide.loc[names].sum() for label, names in rest.items()}).T
    return wide.loc[of_leg], groups
