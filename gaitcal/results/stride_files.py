"""Write the stride files of a result and the means of `spatiotemporal.csv` for `summary.json`.

The files are `cycles.csv`, its mean curves `ensemble.csv`, `peaks.csv` and `spatiotemporal.csv`.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.arrays import Array
from gaitcal.gait import ensemble, normal_bands, profile_score
from gaitcal.gait.cycles import CYCLE_COLUMNS, POINTS, WALKING, validate_stride_table
from gaitcal.gait.peaks import (
    PeakMean,
    average_peaks,
    find_phase_peaks,
    find_stride_peaks,
    make_peak_columns,
)
from gaitcal.gait.spatiotemporal import (
    MEASURES,
    Average,
    average_measures,
    is_usable_measure,
    select_straight_strides,
)
from gaitcal.gait.strides import TURNING
from gaitcal.io.result_folder import compute_sha256
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.results import cycle_tables, table_files
from gaitcal.runtime import with_one_blas_thread

if TYPE_CHECKING:
    import pandas as pd

SPATIOTEMPORAL: Final = "spatiotemporal.csv"
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
SPATIOTEMPORAL_HEADER: Final = (
    "strides of each foot, numbered as in cycles.csv; without a number: the recording has only a "
    "part of the stride",
    "start, stop: s, the strikes of that foot; source: where they come from (file, plates, motion)",
    "lengths between heels at strikes on the ground, or on a treadmill's belt, along the line from "
    "the strike of that",
    "foot to its next one (Huxham et al. 2006), width across it; the step is the one that ends the "
    "stride",
    "speed: stride length / stride time; cadence: 120 / stride time; _percent: of the stride",
    "valid: 0 for a refused leg, and for steps and supports that include one; turn: rotation of "
    "the pelvis to the",
    "left over the stride, deg, empty if unknown; means in summary.json are of valid values, "
    "without strides that",
    f"turn by more than {TURNING:g} deg",
)
"""Comment lines above the header."""
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


ENSEMBLE: Final = "ensemble.csv"
STRIDE_FILES: Final = {cycle_tables.CYCLES: CYCLE_COLUMNS, SPATIOTEMPORAL: SPATIOTEMPORAL_COLUMNS}
"""With their columns, those that are read back when further trials join them."""
ENSEMBLE_HEADER: Final = (
    "mean curves of cycles.csv over its repetitions and strides, of gait straight ones, where "
    "valid; units as there",
    "n strides of so many trials at that percent; sd over strides; sd_within strides of a trial, "
    "sd_between trials",
    "(empty if no trial has two strides); sd_error: upper limit of the measurement error in sd and "
    "sd_within",
    "se: standard error of the mean, with the errors that all strides share",
)
"""Comment lines above the header."""

PEAKS: Final = "peaks.csv"
PEAKS_HEADER: Final = (
    "peaks of each stride or repetition in its phase, then means over all repetitions and all "
    "strides, of gait the",
    "straight ones; units and signs as in cycles.csv; window: of the stance and the swing of that "
    "foot; highest and",
    "lowest: only if it has an extremum within it; of activities other than gait: in a whole phase "
    "of cycles.csv",
    "n of so many strides have it; sd over strides; se of the mean, with the errors that all "
    "strides share",
)
"""Comment lines above the header."""


EarlierStrides: TypeAlias = "Mapping[str, tuple[pd.DataFrame | None, tuple[str, ...]]]"
"""File of `STRIDE_FILES` -> rows of earlier trials in a folder, as text (None: none), and comment
lines about them."""
NO_STRIDES: Final[EarlierStrides] = dict.fromkeys(STRIDE_FILES, (None, ()))


def write_stride_files(
    folder: Path,
    model: SubjectModel,
    trials: Sequence[TrialResult],
    relative_to: Mapping[str, float] | None = None,
    earlier: EarlierStrides = NO_STRIDES,
) -> Mapping[str, table_files.Column]:
    """Write all files of strides, the rows of earlier trials first.

    Parameters
    ----------
    folder
        The result folder that is being written.
    model
        The calibrated subject.
    trials
        Trials with strides.
    relative_to
        Coordinate -> rad in the static posture, subtracted from the joint angles; None: anatomical.
    earlier
        From `read_earlier_strides`.

    Returns
    -------
    dict
        The columns of `cycles.csv`.
    """
    cycles = cycle_tables.write_cycles(
        folder / cycle_tables.CYCLES, model, trials, relative_to, *earlier[cycle_tables.CYCLES]
    )
    rows, lines = earlier[SPATIOTEMPORAL]
    strides = cycles if isinstance(cycles, Mapping) else _convert_to_numbers(cycles)
    table_files.write_csv(
        _compute_mean_curves(strides),
        folder / ENSEMBLE,
        (*_list_turning_strides(strides), *ENSEMBLE_HEADER),
    )
    table: table_files.Table = build_spatiotemporal_columns(model.subject, trials)
    if rows is not None and len(rows):
        import pandas as pd

        table = pd.concat([rows, pd.DataFrame(table, dtype=object)], ignore_index=True)
    refused = (
        f"{t.name}: {line}"
        for t in trials
        if t.joint is None
        for line in table_files.format_refused_lines(t)
    )
    table_files.write_csv(
        make_peak_columns(_compute_peaks(strides, table)),
        folder / PEAKS,
        (*_list_turning_strides(strides), *PEAKS_HEADER),
    )
    table_files.write_csv(
        table, folder / SPATIOTEMPORAL, (*lines, *refused, *SPATIOTEMPORAL_HEADER)
    )
    return strides


PROFILE: Final = "gait_profile.csv"
PROFILE_HEADER: Final = (
    "Gait Variable Scores of nine angles and Gait Profile Score (gps), deg, as Baker et al. 2009: "
    "RMS difference of",
    "straight strides from the normative mean; side both: the pelvis once, of left strides, and "
    "the other angles of",
    "both sides",
    "se: standard error, from strides and from errors that all strides share; norm: score of the "
    "normative group, RMS",
)
"""Comment lines above the header."""


def write_profile(
    folder: Path, norm: normal_bands.Norm, scores: Sequence[profile_score.Score]
) -> None:
    """Write `gait_profile.csv`; nothing if there are no scores.

    Parameters
    ----------
    folder
        The result folder that is being written.
    norm
        Normative data.
    scores
        Gait Variable Scores and Gait Profile Scores, deg.
    """
    if not scores:
        return
    table: dict[str, table_files.Column] = {
        "side": [s.side for s in scores],
        "variable": [s.variable for s in scores],
    }
    table |= {
        name: np.round([getattr(s, field) for s in scores], 4)
        for name, field in (("score", "score"), ("se", "error"), ("norm", "norm"))
    }
    table["strides"] = np.array([s.strides for s in scores])
    table_files.write_csv(table, folder / PROFILE, (*PROFILE_HEADER, f"norm: {norm.label}"))


def summarise_profile(
    norm: normal_bands.Norm, scores: Sequence[profile_score.Score]
) -> dict[str, table_files.Json]:
    """Summarise normative data and scores for `summary.json`.

    Parameters
    ----------
    norm
        Normative data.
    scores
        Gait Variable Scores and Gait Profile Scores, deg.

    Returns
    -------
    dict
        `norm`, and `gait_profile` if there are scores.
    """
    described: dict[str, table_files.Json] = {
        k: v for k, v in {"words": norm.label, "remark": norm.remark}.items() if v
    }
    out: dict[str, table_files.Json] = {"norm": described}
    sides: dict[str, dict[str, table_files.Json]] = {}
    for s in scores:
        known = {"score": s.score, "se": s.error, "norm": s.norm}
        figures: dict[str, table_files.Json] = {
            name: round(value, 4) for name, value in known.items() if np.isfinite(value)
        }
        sides.setdefault(s.side, {})[s.variable] = {**figures, "strides": s.strides}
    return out | ({"gait_profile": dict(sides)} if sides else {})


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


def _convert_to_numbers(strides: "pd.DataFrame") -> dict[str, table_files.Column]:
    """Convert the text columns of a table of strides, in which each stride occurs once."""
    table = validate_stride_table(strides)
    ensemble.require_unique_strides(table)
    return {name: table[name].to_numpy() for name in CYCLE_COLUMNS}


def _compute_mean_curves(strides: Mapping[str, table_files.Column]) -> dict[str, NDArray[Any]]:
    if not len(strides["value"]):
        return {name: np.empty(0) for name in ensemble.ENSEMBLE_COLUMNS}
    curves = ensemble.compute_mean_curves(strides)
    return {
        name: np.round(v, cycle_tables.DIGITS) if v.dtype.kind == "f" else v
        for name, v in curves.items()
    }


def _compute_peaks(
    strides: Mapping[str, table_files.Column], measures: table_files.Table
) -> tuple[PeakMean, ...]:
    """Compute mean peaks over straight strides and repetitions.

    `measures`: `spatiotemporal.csv`, which gives the end of stance.
    """
    rows = zip(
        *(measures[name] for name in ("trial", "side", "stride", "variable", "value")), strict=True
    )
    toe_off = {
        (t, s, int(n)): float(v)
        for t, s, n, name, v in rows
        if name == "stance_percent" and n not in ("", None)
    }
    values, se, stride_error = (
        np.asarray(strides[name], dtype=np.float64) for name in ("value", "se", "se_stride")
    )
    values = np.where(np.asarray(strides["valid"]) == 1, values, np.nan)
    curves: dict[tuple[str, str, str, int], dict[str, tuple[Array, Array, Array]]] = {}
    phases: dict[tuple[str, str, str, int], Sequence[str]] = {}
    # each variable of each stride is a block of rows, one for each percent
    for k in range(0, len(values), POINTS):
        if not abs(strides["turn"][k]) > TURNING:
            key = (
                *(strides[name][k] for name in ("activity", "trial", "side")),
                int(strides["stride"][k]),
            )
            phases[key] = list(strides["phase"][k : k + POINTS])
            of_stride = curves.setdefault(key, {})
            of_stride[strides["variable"][k]] = (
                values[k : k + POINTS],
                se[k : k + POINTS],
                stride_error[k : k + POINTS],
            )
    return average_peaks(
        (
            *key[:3],
            find_stride_peaks(found, toe_off.get(key[1:]))
            if key[0] == WALKING
            else find_phase_peaks(found, phases[key]),
        )
        for key, found in curves.items()
    )


def _list_turning_strides(strides: Mapping[str, table_files.Column]) -> tuple[str, ...]:
    """List the turning strides in a comment line; none if all are straight."""
    turning = np.flatnonzero(np.abs(np.asarray(strides["turn"], dtype=np.float64)) > TURNING)
    named = dict.fromkeys(
        (strides["trial"][k], strides["side"][k], strides["stride"][k]) for k in turning
    )
    if not named:
        return ()
    names = ", ".join(f"{trial} {side} {stride}" for trial, side, stride in named)
    return (
        f"left out, strides that turn by more than {TURNING:g} deg (trial, side, stride): {names}",
    )


def read_earlier_strides(
    folder: Path, hashes: Mapping[str, str], kept: Iterable[str]
) -> EarlierStrides:
    """Read the rows of earlier trials and their comment lines.

    Parameters
    ----------
    folder
        Folder of further trials.
    hashes
        File -> SHA-256 as it was written.
    kept
        Names of the trials that stay.

    Returns
    -------
    dict
        File -> rows as text and comment lines; None for a file that has changed.
    """
    names, out = tuple(kept), {}
    # the whole prefix, as a trial may have a name that begins another line, such as `se`
    prefixes = tuple(f"{name}: {table_files.VERDICT}" for name in names)
    for file in STRIDE_FILES:
        table, lines = None, tuple[str, ...]()
        if file in hashes and compute_sha256(folder / file) == hashes[file]:
            table, comments = table_files.read_csv(folder / file)
            lines = tuple(line for line in comments if line.startswith(prefixes))
            table = table[table["trial"].isin(names)]
        out[file] = table, lines
    return out
