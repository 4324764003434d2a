"""`spatiotemporal.csv`, in long form, and its means in `summary.json`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from gaitcal.gait.progression import TURNING
from gaitcal.gait.spatiotemporal import MEASURES
from gaitcal.gait.symmetry import Average, MeasureMeans, counting, counts, measure_means
from gaitcal.model.subject_model import Subject
from gaitcal.results.json_types import Json
from gaitcal.results.table_file import Column
from gaitcal.runtime import with_one_blas_thread
from gaitcal.session.result import Calibration, TrialResult

if TYPE_CHECKING:
    import pandas as pd  # loaded by who asks for a data frame: it takes a third of a second

SPATIOTEMPORAL: Final = "spatiotemporal.csv"
SPATIOTEMPORAL_COLUMNS: Final = (
    *("person", "session", "trial", "side", "stride", "start", "stop", "source", "variable", "unit", "value", "valid"),
    "turn",
)
SPATIOTEMPORAL_HEADER: Final = (
    "strides of each foot, numbered as in cycles.csv; without a number: the recording holds a part of it alone",
    "start, stop: s, the strikes of that foot; source: what told them (file, plates, motion)",
    "lengths between heels at strikes on the ground, or on a treadmill's belt, along the line from the strike of that",
    "foot to its next one (Huxham et al. 2006), width across it; the step is the one that ends the stride",
    "speed: stride length / stride time; cadence: 120 / stride time; _percent: of the stride",
    "valid: 0 of a leg that is refused, and of steps and supports beside one; turn: deg to the left by which the",
    "pelvis turns over the stride, empty where not known; means in summary.json are of what is valid, without strides",
    f"that turn by more than {TURNING:g} deg",
)
"""Comment lines above the header."""
DIGITS: Final = 6
TURN_DIGITS: Final = 1


def spatiotemporal_table(subject: Subject, trials: Sequence[TrialResult]) -> pd.DataFrame:
    """`spatiotemporal_columns` as a data frame."""
    import pandas as pd

    return pd.DataFrame(spatiotemporal_columns(subject, trials)).astype({"stride": "Int64"})


def spatiotemporal_columns(subject: Subject, trials: Sequence[TrialResult]) -> dict[str, Column]:
    """Every measure of every stride of the gait trials, with `SPATIOTEMPORAL_COLUMNS`; strides without number: None."""
    rows = [
        {
            "person": subject.name,
            "session": subject.session,
            "trial": trial.name,
            "side": stride.side,
            "stride": stride.number,
            "start": stride.start,
            "stop": stride.stop,
            "source": " ".join(dict.fromkeys(source.value for source in stride.sources)),
            "variable": name,
            "unit": MEASURES[name],
            "value": value,
            "valid": int(counts(name, stride.side, trial.refused_legs)),
            "turn": stride.turn,
        }
        for trial in trials
        for stride in trial.strides
        for name, value in stride.measures.items()
    ]
    columns: dict[str, Column] = {name: [row[name] for row in rows] for name in SPATIOTEMPORAL_COLUMNS}
    for name, digits in {"start": DIGITS, "stop": DIGITS, "value": DIGITS, "turn": TURN_DIGITS}.items():
        columns[name] = np.round(np.array(columns[name], dtype=np.float64), digits)
    return columns | {"valid": np.array(columns["valid"], dtype=int)}


@with_one_blas_thread
def spatiotemporal(calibration: Calibration) -> pd.DataFrame:
    """Speed, cadence, steps, stance, swing and support of every stride of a calibration's walks, in long form.

    Columns as in `spatiotemporal.csv`: person, session, trial, side, stride (none where the recording holds only a part
    of it), start and stop (s), source, variable, unit, value, valid (1: may be used),
    turn (deg). Definitions: `gaitcal/gait/spatiotemporal.py`.
    """
    return spatiotemporal_table(calibration.model.subject, calibration.trials)


def spatiotemporal_means(trials: Sequence[TrialResult]) -> tuple[MeasureMeans, ...]:
    """Means of both legs over strides and trials, without strides that turn and legs that are refused."""
    return measure_means({t.name: counting(t.strides, t.refused_legs) for t in trials})


def means_summary(trials: Sequence[TrialResult]) -> dict[str, Json]:
    """Measure -> unit, mean, SD and number of strides of each leg, and symmetry index (%), as `summary.json` has it."""
    out: dict[str, Json] = {}
    for found in spatiotemporal_means(trials):
        entry: dict[str, Json] = {"unit": found.unit}
        entry |= {side: _entry(of) for side, of in (("r", found.right), ("l", found.left)) if of is not None}
        if found.symmetry is not None:
            entry["symmetry_percent"] = round(found.symmetry, DIGITS)
        out[found.name] = entry
    return out


def _entry(average: Average) -> dict[str, Json]:
    known = {"mean": average.mean, "sd": average.sd, "sd_within": average.sd_within, "sd_between": average.sd_between}
    figures: dict[str, Json] = {name: round(value, DIGITS) for name, value in known.items() if value is not None}
    return {**figures, "strides": average.n, "trials": average.trials}
