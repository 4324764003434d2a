"""Sessions made of plain numbers: strides of one angle and one moment, a calibrated model, errors
by source.
"""

from dataclasses import replace

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import factor_prior, get_prior_deviations
from gaitcal.gait.cycles import CYCLE_COLUMNS, POINTS
from gaitcal.model.nominal import published_model
from gaitcal.results.session_difference import compute_placement_errors
from gaitcal.results.stride_sets import RecordedSession

NAMES = ("hip_r.pelvis.ant", "hip_r.thigh.ant", "knee_r.thigh.front", "talocrural_r.shank.sup")
"""Two views of one bone end, an axis, and a mean that is not nominal."""
STANCE = 60.0
SHARED = {"knee_angle": 2.0, "knee_angle_moment": 1.0}
"""Variable -> deg, N·m: the error that all strides share."""
OWN = 0.5
SD = 1.0
"""Of strides, an offset each."""


def made_session(
    name: str = "first",
    seed: int = 0,
    strides: int = 6,
    swing: float = 0.0,
    person: str = "S07",
    **changes: object,
) -> RecordedSession:
    """`swing`: deg added to the right knee in swing."""
    rng, percent = np.random.default_rng(seed), np.arange(POINTS)
    same = {
        "person": person,
        "session": "",
        "trial": "walk",
        "percent": percent,
        "valid": 1,
        "se_stride": OWN,
    }
    same |= {"turn": 0.0, "activity": "gait", "phase": ""}
    parts, measures = [], []
    for side in ("r", "l"):
        for stride in range(1, strides + 1):
            offset = rng.normal(0.0, SD)
            for variable, shared in SHARED.items():
                curve = 30.0 + 30.0 * np.cos(2.0 * np.pi * (percent - 75.0) / 100.0) + offset
                curve = curve + swing * (percent > STANCE) * (
                    side == "r" and variable == "knee_angle"
                )
                own = {"side": side, "stride": stride, "variable": variable, "value": curve}
                parts.append(
                    pd.DataFrame({**same, **own, "se": np.hypot(shared, OWN)})[list(CYCLE_COLUMNS)]
                )
            for measure, value in (
                ("stance_percent", STANCE),
                ("stride_time", 1.1 + 0.01 * offset),
            ):
                measures.append(
                    {
                        "trial": "walk",
                        "side": side,
                        "stride": stride,
                        "variable": measure,
                        "value": value,
                    }
                )
    model = published_model()
    whole = pd.DataFrame(measures).assign(valid=1, turn=0.0)
    made = RecordedSession(
        name=name,
        model=replace(model, subject=replace(model.subject, name=person)),
        model_key=name,
        statics=("static",),
        recordings=frozenset({name}),
        influence=made_influence(rng),
        strides=pd.concat(parts, ignore_index=True),
        measures=whole,
        verdict="trustworthy",
    )
    return replace(made, **changes)


def made_influence(rng: np.random.Generator) -> ErrorSources:
    """Three columns of markers, and half of each cause of nominal errors."""
    markers = rng.normal(0.0, 1.0, (len(NAMES), 3)) * get_prior_deviations(NAMES)[:, None] / 5.0
    clusters = (*(f"markers/walk/{k}" for k in range(3)), *(f"nominal/{name}" for name in NAMES))
    return ErrorSources(NAMES, np.hstack([markers, 0.5 * factor_prior(NAMES, None)]), clusters)


def placed_anew() -> Array:
    """(4, 4) Q by hand: each parameter by itself, but for the two views of the hip, which move by
    the same.
    """
    out = np.diag(compute_placement_errors(NAMES) ** 2)
    out[0, 1] = out[1, 0] = out[0, 0]
    return out
