"""Write the stride files of a result, and read those of earlier trials.

The files are `cycles.csv`, its mean curves `ensemble.csv`, `peaks.csv`, `spatiotemporal.csv`,
`strides.csv` and, of the whole result, `gait_profile.csv`.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gaitcal.gait import ensemble, profile_score
from gaitcal.gait.cycles import CYCLE_COLUMNS
from gaitcal.gait.peaks import make_peak_columns
from gaitcal.gait.strides import TURNING
from gaitcal.io.result_folder import compute_sha256
from gaitcal.results import cycle_tables, table_files
from gaitcal.results.normal_curves import NormTables
from gaitcal.results.stride_tables import SPATIOTEMPORAL_COLUMNS, StrideTables, join_earlier_strides
from gaitcal.results.stride_uses import STRIDE_COLUMNS, STRIDES, STRIDES_HEADER, build_use_columns

if TYPE_CHECKING:
    import pandas as pd

SPATIOTEMPORAL: Final = "spatiotemporal.csv"
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
ENSEMBLE: Final = "ensemble.csv"
STRIDE_FILES: Final = {
    cycle_tables.CYCLES: CYCLE_COLUMNS,
    SPATIOTEMPORAL: SPATIOTEMPORAL_COLUMNS,
    STRIDES: STRIDE_COLUMNS,
}
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
    folder: Path, tables: StrideTables, earlier: EarlierStrides = NO_STRIDES
) -> None:
    """Write all files of strides, the rows of earlier trials first.

    Parameters
    ----------
    folder
        The result folder that is being written.
    tables
        Of the trials that are written.
    earlier
        From `read_earlier_strides`.
    """
    rows, lines = earlier[cycle_tables.CYCLES]
    refused = tables.refused_lines
    measures: table_files.Table = tables.measures
    found, of_measures = earlier[SPATIOTEMPORAL]
    if found is not None and len(found):
        import pandas as pd

        measures = pd.concat([found, pd.DataFrame(measures, dtype=object)], ignore_index=True)
    # Means and peaks are over all trials of the folder, so they are computed anew.
    joined = join_earlier_strides(tables, rows, earlier[STRIDES][0])
    turning = _list_turning_strides(joined.cycles)
    means = _compute_mean_curves(joined.cycles)
    use_columns = build_use_columns(tables.subject, joined.uses)
    header = (*cycle_tables.CYCLE_HEADER, *tables.relative_lines)
    for file, table, comments in (
        (cycle_tables.CYCLES, joined.cycles, (*lines, *refused, *header)),
        (ENSEMBLE, means, (*turning, *ENSEMBLE_HEADER)),
        (PEAKS, make_peak_columns(joined.peaks), (*turning, *PEAKS_HEADER)),
        (SPATIOTEMPORAL, measures, (*of_measures, *refused, *SPATIOTEMPORAL_HEADER)),
        (STRIDES, use_columns, (*earlier[STRIDES][1], *refused, *STRIDES_HEADER)),
    ):
        table_files.write_csv(table, folder / file, comments)


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


def write_profile(folder: Path, norm: NormTables, scores: Sequence[profile_score.Score]) -> None:
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
    norm: NormTables, scores: Sequence[profile_score.Score]
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
    known_norm: dict[str, table_files.Json] = {
        "words": norm.label,
        "remark": norm.remark,
        "steps": {name: list(figures) for name, figures in norm.steps.items()},
    }
    described: dict[str, table_files.Json] = {k: v for k, v in known_norm.items() if v}
    out: dict[str, table_files.Json] = {"norm": described}
    sides: dict[str, dict[str, table_files.Json]] = {}
    for s in scores:
        known = {"score": s.score, "se": s.error, "norm": s.norm}
        figures: dict[str, table_files.Json] = {
            name: round(value, 4) for name, value in known.items() if np.isfinite(value)
        }
        sides.setdefault(s.side, {})[s.variable] = {**figures, "strides": s.strides}
    return out | ({"gait_profile": dict(sides)} if sides else {})


def _compute_mean_curves(strides: Mapping[str, table_files.Column]) -> dict[str, NDArray[Any]]:
    if not len(strides["value"]):
        return {name: np.empty(0) for name in ensemble.ENSEMBLE_COLUMNS}
    curves = ensemble.compute_mean_curves(strides)
    return {
        name: np.round(v, cycle_tables.DIGITS) if v.dtype.kind == "f" else v
        for name, v in curves.items()
    }


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
        # A file that was changed by hand is not continued.
        if file in hashes and compute_sha256(folder / file) == hashes[file]:
            table, comments = table_files.read_csv(folder / file)
            lines = tuple(line for line in comments if line.startswith(prefixes))
            table = table[table["trial"].isin(names)]
        out[file] = table, lines
    return out
