"""The files of strides in a result folder: `cycles.csv`, its mean curves `ensemble.csv` and
`peaks.csv`, and `spatiotemporal.csv` in long form, with its means for `summary.json`.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.arrays import Array
from gaitcal.gait import ensemble, normal_bands, profile_score
from gaitcal.gait.cycles import CYCLE_COLUMNS, POINTS, WALKING, typed
from gaitcal.gait.peaks import PeakMean, peak_columns, peak_means, phase_peaks, stride_peaks
from gaitcal.gait.spatiotemporal import MEASURES, Average, counting, counts, measure_means
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
    "strides of each foot, numbered as in cycles.csv; without a number: the recording holds a part "
    "of it alone",
    "start, stop: s, the strikes of that foot; source: what told them (file, plates, motion)",
    "lengths between heels at strikes on the ground, or on a treadmill's belt, along the line from "
    "the strike of that",
    "foot to its next one (Huxham et al. 2006), width across it; the step is the one that ends the "
    "stride",
    "speed: stride length / stride time; cadence: 120 / stride time; _percent: of the stride",
    "valid: 0 of a leg that is refused, and of steps and supports beside one; turn: deg to the "
    "left by which the",
    "pelvis turns over the stride, empty where not known; means in summary.json are of what is "
    "valid, without strides",
    f"that turn by more than {TURNING:g} deg",
)
"""Comment lines above the header."""
TIME_DIGITS: Final = 6
TURN_DIGITS: Final = 1


def spatiotemporal_table(subject: Subject, trials: Sequence[TrialResult]) -> "pd.DataFrame":
    """`spatiotemporal_columns` as a data frame."""
    import pandas as pd

    return pd.DataFrame(spatiotemporal_columns(subject, trials)).astype({"stride": "Int64"})


def spatiotemporal_columns(
    subject: Subject, trials: Sequence[TrialResult]
) -> dict[str, table_files.Column]:
    """Every measure of every stride of the gait trials, with `SPATIOTEMPORAL_COLUMNS`; strides
    without number: None.
    """
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
        if trial.activity == WALKING
        for stride in trial.strides
        for name, value in stride.measures.items()
    ]
    columns: dict[str, table_files.Column] = {
        name: [row[name] for row in rows] for name in SPATIOTEMPORAL_COLUMNS
    }
    for name, digits in {
        "start": TIME_DIGITS,
        "stop": TIME_DIGITS,
        "value": TIME_DIGITS,
        "turn": TURN_DIGITS,
    }.items():
        columns[name] = np.round(np.array(columns[name], dtype=np.float64), digits)
    return columns | {"valid": np.array(columns["valid"], dtype=int)}


@with_one_blas_thread
def spatiotemporal(calibration: Calibration) -> "pd.DataFrame":
    """Speed, cadence, steps, stance, swing and support of every stride of a calibration's walks, in
    long form.

    Columns as in `spatiotemporal.csv`: person, session, trial, side, stride (none where the
    recording holds only a part of it), start and stop (s), source, variable, unit, value, valid (1:
    may be used), turn (deg). Definitions: `gaitcal/gait/spatiotemporal.py`.
    """
    return spatiotemporal_table(calibration.model.subject, calibration.trials)


def means_summary(trials: Sequence[TrialResult]) -> dict[str, table_files.Json]:
    """Measure -> unit; of each leg mean, SD and number of strides; symmetry index (%) and its
    error.

    Over strides and trials, without strides that turn and legs that are refused.
    """
    out: dict[str, table_files.Json] = {}
    walks = (
        trials if len(trials) == 1 else [t for t in trials if t.activity == WALKING]
    )  # one trial tells of itself
    for found in measure_means({t.name: counting(t.strides, t.refused_legs) for t in walks}):
        entry: dict[str, table_files.Json] = {"unit": found.unit}
        entry |= {
            side: _entry(of)
            for side, of in (("r", found.right), ("l", found.left))
            if of is not None
        }
        if found.symmetry is not None and found.symmetry_error is not None:
            entry["symmetry_percent"] = round(found.symmetry, TIME_DIGITS)
            entry["symmetry_se_percent"] = round(found.symmetry_error, TIME_DIGITS)
        out[found.name] = entry
    return out


def _entry(average: Average) -> dict[str, table_files.Json]:
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
    "(empty where no trial has two strides); sd_error: what of sd and sd_within is measurement "
    "error, at most",
    "se: standard error of the mean, with the errors that all strides share",
)
"""Comment lines above the header."""

PEAKS: Final = "peaks.csv"
PEAKS_HEADER: Final = (
    "peaks of each stride or repetition in its phase, then means over all repetitions and all "
    "strides, of gait the",
    "straight ones; units and signs as in cycles.csv; window: of the stance and the swing of that "
    "foot; highest and",
    "lowest: only where the curve turns within it; of activities other than gait: in a whole phase "
    "of cycles.csv",
    "n of so many strides have it; sd over strides; se of the mean, with the errors that all "
    "strides share",
)
"""Comment lines above the header."""


EarlierStrides: TypeAlias = "Mapping[str, tuple[pd.DataFrame | None, tuple[str, ...]]]"
"""File of `STRIDE_FILES` -> rows of trials that a folder holds already, as text (None: none), and
comment lines about them."""
NO_STRIDES: Final[EarlierStrides] = dict.fromkeys(STRIDE_FILES, (None, ()))


def write_stride_files(
    folder: Path,
    model: SubjectModel,
    trials: Sequence[TrialResult],
    relative_to: Mapping[str, float] | None = None,
    earlier: EarlierStrides = NO_STRIDES,
) -> Mapping[str, table_files.Column]:
    """Write all files of strides of gait trials, those of earlier ones before them; returns columns
    of `cycles.csv`.

    `relative_to`: coordinate -> rad in the static posture, from which joint angles are counted.
    """
    cycles = cycle_tables.write_cycles(
        folder / cycle_tables.CYCLES, model, trials, relative_to, *earlier[cycle_tables.CYCLES]
    )
    rows, lines = earlier[SPATIOTEMPORAL]
    strides = cycles if isinstance(cycles, Mapping) else _numbers(cycles)
    table_files.write_csv(
        _mean_curves(strides), folder / ENSEMBLE, (*_turning_lines(strides), *ENSEMBLE_HEADER)
    )
    table: table_files.Table = spatiotemporal_columns(model.subject, trials)
    if rows is not None and len(rows):
        import pandas as pd

        table = pd.concat([rows, pd.DataFrame(table, dtype=object)], ignore_index=True)
    refused = (
        f"{t.name}: {line}"
        for t in trials
        if t.joint is None
        for line in table_files.refused_lines(t)
    )
    table_files.write_csv(
        peak_columns(_peaks(strides, table)),
        folder / PEAKS,
        (*_turning_lines(strides), *PEAKS_HEADER),
    )
    table_files.write_csv(
        table, folder / SPATIOTEMPORAL, (*lines, *refused, *SPATIOTEMPORAL_HEADER)
    )
    return strides


PROFILE: Final = "gait_profile.csv"
PROFILE_HEADER: Final = (
    "Gait Variable Scores of nine angles and Gait Profile Score (gps), deg, as Baker et al. 2009: "
    "RMS distance of",
    "straight strides from healthy people's mean; side both: the pelvis once, of left strides, and "
    "the other angles of",
    "both sides",
    "se: standard error, by strides and by what all strides share; norm: what healthy people have, "
    "RMS",
)
"""Comment lines above the header."""


def write_profile(
    folder: Path, norm: normal_bands.Norm, scores: Sequence[profile_score.Score]
) -> None:
    """Write `gait_profile.csv`; nothing where no norm fits or an angle is missing."""
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
    table_files.write_csv(table, folder / PROFILE, (*PROFILE_HEADER, f"norm: {norm.words}"))


def profile_summary(
    norm: normal_bands.Norm, scores: Sequence[profile_score.Score]
) -> dict[str, table_files.Json]:
    """Whom the person is held against, and the scores, as `summary.json` has them."""
    told: dict[str, table_files.Json] = {
        k: v for k, v in {"words": norm.words, "remark": norm.remark}.items() if v
    }
    out: dict[str, table_files.Json] = {"norm": told}
    sides: dict[str, dict[str, table_files.Json]] = {}
    for s in scores:
        known = {"score": s.score, "se": s.error, "norm": s.norm}
        figures: dict[str, table_files.Json] = {
            name: round(value, 4) for name, value in known.items() if np.isfinite(value)
        }
        sides.setdefault(s.side, {})[s.variable] = {**figures, "strides": s.strides}
    return out | ({"gait_profile": dict(sides)} if sides else {})


def mean_speed(means: Mapping[str, Any]) -> float | None:
    """m/s, over both legs, of the means of `summary.json`; None where no stride tells it."""
    of_legs = [side["mean"] for key in "rl" if (side := means.get("speed", {}).get(key))]
    return float(np.mean(of_legs)) if of_legs else None


def _numbers(strides: "pd.DataFrame") -> dict[str, table_files.Column]:
    """The columns of a table of strides that may hold text, each stride once."""
    table = typed(strides)
    ensemble.require_once(table)
    return {name: table[name].to_numpy() for name in CYCLE_COLUMNS}


def _mean_curves(strides: Mapping[str, table_files.Column]) -> dict[str, NDArray[Any]]:
    if not len(strides["value"]):
        return {name: np.empty(0) for name in ensemble.ENSEMBLE_COLUMNS}
    curves = ensemble.mean_curves(strides)
    return {
        name: np.round(v, cycle_tables.DIGITS) if v.dtype.kind == "f" else v
        for name, v in curves.items()
    }


def _peaks(
    strides: Mapping[str, table_files.Column], measures: table_files.Table
) -> tuple[PeakMean, ...]:
    """Of straight strides, and of repetitions; `measures`: of `spatiotemporal.csv`, which know
    where stance ends.
    """
    rows = zip(
        *(measures[name] for name in ("trial", "side", "stride", "variable", "value")), strict=True
    )
    toe_off = {
        (t, s, int(n)): float(v)
        for t, s, n, name, v in rows
        if name == "stance_percent" and n not in ("", None)
    }
    values, se, own = (
        np.asarray(strides[name], dtype=np.float64) for name in ("value", "se", "se_stride")
    )
    values = np.where(np.asarray(strides["valid"]) == 1, values, np.nan)
    curves: dict[tuple[str, str, str, int], dict[str, tuple[Array, Array, Array]]] = {}
    phases: dict[tuple[str, str, str, int], Sequence[str]] = {}
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
                own[k : k + POINTS],
            )
    return peak_means(
        (
            *key[:3],
            stride_peaks(found, toe_off.get(key[1:]))
            if key[0] == WALKING
            else phase_peaks(found, phases[key]),
        )
        for key, found in curves.items()
    )


def _turning_lines(strides: Mapping[str, table_files.Column]) -> tuple[str, ...]:
    """A comment line that names the strides that turn; none where all go straight."""
    turning = np.flatnonzero(np.abs(np.asarray(strides["turn"], dtype=np.float64)) > TURNING)
    named = dict.fromkeys(
        (strides["trial"][k], strides["side"][k], strides["stride"][k]) for k in turning
    )
    if not named:
        return ()
    words = ", ".join(f"{trial} {side} {stride}" for trial, side, stride in named)
    return (
        f"left out, strides that turn by more than {TURNING:g} deg (trial, side, stride): {words}",
    )


def earlier_strides(folder: Path, hashes: Mapping[str, str], kept: Iterable[str]) -> EarlierStrides:
    """Rows of the trials `kept`, with the comment lines about them; none of a file that is not as
    it was written.

    `hashes`: file -> SHA-256 as it was written.
    """
    names, out = tuple(kept), {}
    for file in STRIDE_FILES:
        table, lines = None, tuple[str, ...]()
        if file in hashes and compute_sha256(folder / file) == hashes[file]:
            table, comments = table_files.read_csv(folder / file)
            # with the word that follows: a trial may be called `se`, of which the head speaks as
            # well
            lines = tuple(
                line
                for line in comments
                if line.startswith(tuple(f"{name}: {table_files.VERDICT}" for name in names))
            )
            table = table[table["trial"].isin(names)]
        out[file] = table, lines
    return out
