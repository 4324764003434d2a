"""Tables of the strides of a result, computed once from its trials.

Files, page, PDF and figures show these. The means over strides are in `gait/ensemble.py`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.analysis.truth_errors import TruthErrors
from gaitcal.arrays import Array
from gaitcal.gait import ensemble
from gaitcal.gait.cycles import CYCLE_COLUMNS, POINTS, WALKING, validate_stride_table
from gaitcal.gait.peaks import (
    PeakMean,
    PeakValue,
    average_peaks,
    find_phase_peaks,
    find_stride_peaks,
)
from gaitcal.gait.spatiotemporal import (
    MEASURES,
    Average,
    average_measures,
    is_usable_measure,
    select_straight_strides,
)
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.results import table_files
from gaitcal.results.cycle_tables import DIGITS, build_cycle_columns
from gaitcal.results.stride_uses import StrideUse, collect_stride_uses, parse_uses
from gaitcal.results.trial_curves import Curve, build_curves
from gaitcal.results.trial_tables import format_relative_header
from gaitcal.runtime import with_one_blas_thread

if TYPE_CHECKING:
    import pandas as pd

SPATIOTEMPORAL_COLUMNS: Final = (
    *(
        "person",
        "session",
        "trial",
        "side",
        "stride",
        "start",
        "stop",
        "source",
        "variable",
        "unit",
        "value",
        "valid",
    ),
    "turn",
)
TIME_DIGITS: Final = 6
TURN_DIGITS: Final = 1


def build_spatiotemporal_table(subject: Subject, trials: Sequence[TrialResult]) -> "pd.DataFrame":
    """Return `build_spatiotemporal_columns` as a data frame."""
    import pandas as pd

    return pd.DataFrame(build_spatiotemporal_columns(subject, trials)).astype({"stride": "Int64"})


def build_spatiotemporal_columns(
    subject: Subject, trials: Sequence[TrialResult]
) -> dict[str, table_files.Column]:
    """Build `SPATIOTEMPORAL_COLUMNS` of every stride; incomplete ones have no number."""
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
            "valid": int(is_usable_measure(name, stride.side, trial.refused_legs)),
            "turn": stride.turn,
        }
        for trial in trials
        if trial.activity == WALKING
        for stride in trial.strides
        for name, value in stride.measures.items()
    ]
    columns: dict[str, table_files.Column] = {}
    for name in SPATIOTEMPORAL_COLUMNS:
        columns[name] = [row[name] for row in rows]
    # Rounded as in the file, so that written and read tables are equal.
    digits_of = dict.fromkeys(("start", "stop", "value"), TIME_DIGITS) | {"turn": TURN_DIGITS}
    for name, digits in digits_of.items():
        columns[name] = np.round(np.array(columns[name], dtype=np.float64), digits)
    return columns | {"valid": np.array(columns["valid"], dtype=int)}


@with_one_blas_thread
def spatiotemporal(calibration: Calibration) -> "pd.DataFrame":
    """Return speed, cadence, steps, stance, swing and support of every stride, in long form.

    Columns as in `spatiotemporal.csv`: person, session, trial, side, stride (none if the recording
    has only a part of it), start and stop (s), source, variable, unit, value, valid (1: usable),
    turn (deg). Definitions: `gaitcal/gait/spatiotemporal.py`.

    Parameters
    ----------
    calibration
        From `gaitcal.calibrate`.

    Returns
    -------
    pandas.DataFrame
        One row for each measure of each stride.
    """
    return build_spatiotemporal_table(calibration.model.subject, calibration.trials)


def summarise_means(trials: Sequence[TrialResult]) -> dict[str, table_files.Json]:
    """Summarise the spatiotemporal measures over strides and trials.

    Turning strides and refused legs are excluded.

    Parameters
    ----------
    trials
        One trial, or all; of several only walks count.

    Returns
    -------
    dict
        Measure -> unit, mean, SD and number of strides of each leg, symmetry index (%) and its
        error.
    """
    out: dict[str, table_files.Json] = {}
    # the summary of one trial is that of its activity, whatever it is
    walks = trials if len(trials) == 1 else [t for t in trials if t.activity == WALKING]
    for found in average_measures(
        {t.name: select_straight_strides(t.strides, t.refused_legs) for t in walks}
    ):
        entry: dict[str, table_files.Json] = {"unit": found.unit}
        entry |= {
            side: _summarise_average(average)
            for side, average in (("r", found.right), ("l", found.left))
            if average is not None
        }
        if found.symmetry is not None and found.symmetry_error is not None:
            entry["symmetry_percent"] = round(found.symmetry, TIME_DIGITS)
            entry["symmetry_se_percent"] = round(found.symmetry_error, TIME_DIGITS)
        out[found.name] = entry
    return out


def _summarise_average(average: Average) -> dict[str, table_files.Json]:
    known = {
        "mean": average.mean,
        "sd": average.sd,
        "sd_within": average.sd_within,
        "sd_between": average.sd_between,
    }
    figures: dict[str, table_files.Json] = {
        name: round(value, TIME_DIGITS) for name, value in known.items() if value is not None
    }
    return {**figures, "strides": average.n, "trials": average.trials}


def compute_mean_speed(means: Mapping[str, Any]) -> float | None:
    """Compute the mean speed over both legs.

    Parameters
    ----------
    means
        From `summarise_means`.

    Returns
    -------
    float or None
        m/s; None if no stride has a speed.
    """
    of_legs = [side["mean"] for key in "rl" if (side := means.get("speed", {}).get(key))]
    return float(np.mean(of_legs)) if of_legs else None


StrideKey: TypeAlias = tuple[str, str, int]  # Trial, side, number


@dataclass(frozen=True, kw_only=True)
class StrideTables:
    """Curves, strides and peaks of some trials of one subject."""

    subject: Subject
    cycles: Mapping[str, table_files.Column]  # Columns of `cycles.csv`
    uses: tuple[StrideUse, ...]  # Rows of `strides.csv`
    peaks: tuple[PeakMean, ...]  # Rows of `peaks.csv`
    measures: Mapping[str, table_files.Column] = field(default_factory=dict)
    """Columns of `spatiotemporal.csv`."""
    curves: Mapping[str, tuple[Curve, ...]] = field(default_factory=dict)
    """Trial -> its curves over time; empty for tables that are read from files."""
    peaks_of_strides: Mapping[StrideKey, Mapping[str, PeakValue]] = field(default_factory=dict)
    """Peaks of each stride, also of one that turns; empty for tables that are read from files."""
    refused_lines: tuple[str, ...] = ()  # Comment lines on refused trials and legs
    relative_lines: tuple[str, ...] = ()  # Comment lines on relative joint angles

    def get_uses(self, trial: str) -> tuple[StrideUse, ...]:
        """Get the strides of one trial."""
        return tuple(use for use in self.uses if use.trial == trial)


def build_stride_tables(
    model: SubjectModel,
    trials: Sequence[TrialResult],
    relative_to: Mapping[str, float] | None = None,
    truth: TruthErrors | None = None,
) -> StrideTables:
    """Build the tables of strides of trials.

    Parameters
    ----------
    model
        The calibrated subject.
    trials
        Functional (single-joint) trials have curves, but no strides.
    relative_to
        Coordinate -> rad in the static posture, subtracted from the joint angles; None: anatomical.
    truth
        Errors against declared true curves; None if unknown.

    Returns
    -------
    StrideTables
        All tables of these trials.
    """
    curves = {
        t.name: build_curves(
            model, t, relative_to, None if truth is None else truth.get_curves(t.name)
        )
        for t in trials
    }
    columns = build_cycle_columns(model.subject, trials, curves)
    uses = tuple(use for trial in trials for use in collect_stride_uses(trial))
    # Peaks are found once: page, report and `peaks.csv` show the same.
    found = _find_peaks(columns, uses)
    refused = (
        f"{t.name}: {line}"
        for t in trials
        if t.joint is None
        for line in table_files.format_refused_lines(t)
    )
    return StrideTables(
        subject=model.subject,
        cycles=columns,
        uses=uses,
        peaks=_average_peaks(uses, found),
        measures=build_spatiotemporal_columns(model.subject, trials),
        curves=curves,
        peaks_of_strides=found,
        refused_lines=tuple(refused),
        relative_lines=() if relative_to is None else format_relative_header(relative_to),
    )


def join_earlier_strides(
    tables: StrideTables, cycles: "pd.DataFrame | None", uses: "pd.DataFrame | None"
) -> StrideTables:
    """Join the strides of earlier trials and later ones, with the peaks of all.

    Parameters
    ----------
    tables
        Of the later trials.
    cycles, uses
        Rows of `cycles.csv` and `strides.csv` of earlier trials, as text; None: none.

    Returns
    -------
    StrideTables
        Strides of the earlier trials first; `measures` are those of the later trials.
    """
    joined = tables.cycles
    if cycles is not None and len(cycles):
        rows = validate_stride_table(cycles)
        ensemble.require_unique_strides(rows)
        # The text has these digits: rounding removes what reading may change
        rows = rows.assign(**{n: rows[n].round(DIGITS) for n in ("value", "se", "se_stride")})
        joined = {name: rows[name].to_numpy() for name in CYCLE_COLUMNS}
        if len(tables.cycles["value"]):
            joined = {
                n: np.concatenate([v, np.asarray(tables.cycles[n])]) for n, v in joined.items()
            }
    earlier = () if uses is None else parse_uses(uses.to_dict("records"))
    all_uses = (*earlier, *tables.uses)
    peaks = _average_peaks(all_uses, _find_peaks(joined, all_uses))
    return replace(tables, cycles=joined, uses=all_uses, peaks=peaks)


def _find_peaks(
    cycles: Mapping[str, table_files.Column], uses: Iterable[StrideUse]
) -> dict[StrideKey, dict[str, PeakValue]]:
    """Find the peaks of each stride in the columns of `cycles.csv`."""
    curves: dict[StrideKey, dict[str, tuple[Array, Array, Array]]] = {}
    phases: dict[StrideKey, Sequence[str]] = {}
    values, se, stride_error = (
        np.asarray(cycles[name], dtype=np.float64) for name in ("value", "se", "se_stride")
    )
    # Invalid points are no candidates for a peak.
    values = np.where(np.asarray(cycles["valid"]) == 1, values, np.nan)
    # Each variable of each stride is a block of rows, one for each percent
    for k in range(0, len(values), POINTS):
        key = (str(cycles["trial"][k]), str(cycles["side"][k]), int(cycles["stride"][k]))
        rows = slice(k, k + POINTS)
        phases[key] = list(cycles["phase"][rows])
        of_stride = curves.setdefault(key, {})
        of_stride[cycles["variable"][k]] = (values[rows], se[rows], stride_error[rows])
    known = {(use.trial, use.side, use.number): use for use in uses}
    out = {}
    for key, of_stride in curves.items():
        if (use := known.get(key)) is not None:
            out[key] = (
                find_stride_peaks(of_stride, use.cycle.stance)
                if use.activity == WALKING
                else find_phase_peaks(of_stride, phases[key])
            )
    return out


def _average_peaks(
    uses: Iterable[StrideUse], found: Mapping[StrideKey, Mapping[str, PeakValue]]
) -> tuple[PeakMean, ...]:
    """Average the peaks over straight strides and repetitions."""
    return average_peaks(
        (use.activity, use.trial, use.side, found.get((use.trial, use.side, use.number), {}))
        for use in uses
        if not use.turns
    )
