"""Command `figures`: draw the variables of a result folder for a paper."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import pandas as pd

from gaitcal.cli import export_commands, options
from gaitcal.cli.console import Console
from gaitcal.errors import Code, InputError, UsageError, suggest_name
from gaitcal.gait import conventions, cycles, moments
from gaitcal.gait.ensemble import ensemble
from gaitcal.gait.normal_bands import Norm, read_normal_bands
from gaitcal.io import result_folder, snapshot
from gaitcal.quality.verdict import Judgement, Verdict
from gaitcal.report.figures.chart import FORMATS, Chart, write_charts
from gaitcal.report.figures.journal_figures import (
    Strides,
    build_moment_arm_charts,
    build_paper_charts,
)
from gaitcal.results.cycle_tables import CYCLES
from gaitcal.results.normal_curves import NORMAL_CURVES, build_norm_tables
from gaitcal.results.result_tables import read_result_tables
from gaitcal.results.stride_files import PEAKS
from gaitcal.results.stride_uses import STRIDES, average_toe_offs
from gaitcal.results.summary import SUMMARY, parse_verdict

FOLDER = "figures"
MILLIMETRES: Final = {"mm": 1.0, "cm": 10.0, "in": 25.4, "": 1.0}
ALLOWED_WIDTHS_MM: Final = (40.0, 400.0)
COLUMN_MM: Final = 85.0
"""Width of one column in most journals."""


def draw_figures(
    console: Console,
    result: options.AnyResult,
    out: options.FiguresFolder = None,
    only: options.Only = None,
    width: options.Width = None,
    formats: options.Pictures = "svg,pdf",
    normal: options.FigureBands = None,
    convention: options.FigureSigns = None,
    external: options.FigureExternal = False,
    units: options.FigureUnits = None,
) -> None:
    """Draw the figures of a result or of further trials.

    Raises
    ------
    UsageError
        An option is invalid.
    InputError
        The folder is not a result, or there is nothing to draw.
    """
    endings = _parse_formats(formats)
    width_mm = COLUMN_MM if width is None else _parse_width(width)
    signs = export_commands.choose_convention(
        convention or conventions.Signs.CLINICAL.value, None, units or "Nm/kg", external=external
    )
    if not result.is_dir():
        message = "no such folder; allowed: a result of 'gaitcal calibrate' or 'gaitcal dynamics'"
        raise InputError(message, source=result, code=Code.NO_RESULT)
    read_files = (SUMMARY, CYCLES, STRIDES, PEAKS, NORMAL_CURVES)
    # Peaks and normative curves are optional.
    names = [name for name in read_files if (result / name).exists()]
    with console.show_progress() as step:
        step("reading the result")
        (strides, verdict), read = snapshot.read_whole(
            result, names, lambda: _read_strides(result, normal)
        )
        charts = build_paper_charts(strides, signs, width_mm) if signs else []
        for table in _read_moment_arms(result, only or ()):
            charts += build_moment_arm_charts(table, width_mm)
        charts = select_charts(charts, only or ())
        folder = out or result / FOLDER
        with result_folder.amend_result(folder) as stage:
            step(f"drawing {moments.format_count(len(charts), 'figure')}")
            files = write_charts(charts, stage, endings)
            read.require_unchanged()
    for remark in read.remarks:
        console.print_line(f"warning: {remark}")
    # A figure for a paper must not hide doubts about its result.
    if verdict.judgement is not Judgement.TRUSTWORTHY:
        console.print_line(f"warning: the result is {verdict.judgement.value}. {verdict.sentence}")
    for file in files:
        console.print_line(f"wrote {folder / file.name}")


MOMENT_ARMS = "moment_arms"


def _read_moment_arms(result: Path, only: Sequence[str]) -> list[pd.DataFrame]:
    """Read the table of muscles that `export --into --muscles` wrote into this folder, if any.

    Raises InputError: `only` names moment arms and there is no table, or there are several.
    """
    found = sorted(
        path for folder in (result, result / "export") for path in folder.glob("*.muscles.csv")
    )
    names = [name.strip() for text in only for name in text.split(",")]
    requested = any(name.startswith(MOMENT_ARMS) for name in names)
    if (requested and not found) or len(found) > 1:
        files = ", ".join(path.name for path in found) or "none"
        out = result / "export" / "NAME.osim"
        message = (
            f"found {files}; allowed: one; gaitcal export {result} --into MODEL.osim --out {out} "
            "--muscles writes it"
        )
        raise InputError(message, source=result, field="*.muscles.csv", code=Code.NOTHING_TO_SHOW)
    return [pd.read_csv(path) for path in found]


def select_charts(charts: Sequence[Chart], only: Iterable[str]) -> list[Chart]:
    """Select charts by name.

    `only`: comma-separated names, or their first or last parts; empty: all charts. Raises
    UsageError: no chart has such a name. Raises InputError: there is no chart at all.
    """
    if not charts:
        message = "found nothing to draw: the result has no complete stride"
        raise InputError(message, field=CYCLES, code=Code.NOTHING_TO_SHOW)
    wanted = [name.strip().lower() for names in only for name in names.split(",") if name.strip()]
    names = [chart.name for chart in charts]
    for word in wanted:
        if not any(_is_named(name, word) for name in names):
            message = (
                f"found '{word}'; allowed: {', '.join(names)}, or words with which they begin or "
                "end"
            )
            raise UsageError(f"{message}{suggest_name(word, names)}", field="--only")
    if not wanted:
        return list(charts)
    return [chart for chart in charts if any(_is_named(chart.name, word) for word in wanted)]


def _is_named(name: str, word: str) -> bool:
    """Whether a name begins or ends with these words, which underscores separate."""
    return f"_{name}_".startswith(f"_{word}_") or f"_{name}_".endswith(f"_{word}_")


def _parse_formats(text: str) -> list[str]:
    """Parse comma-separated formats."""
    found = list(dict.fromkeys(part.strip().lower() for part in text.split(",") if part.strip()))
    for name in found or [text]:
        if name not in FORMATS:
            message = f"found '{name}'; allowed: {', '.join(FORMATS)}, with commas between them"
            raise UsageError(f"{message}{suggest_name(name, FORMATS)}", field="--format")
    return found


def _parse_width(text: str) -> float:
    """Parse a width such as `85mm`, `8.5cm`, `3.35in` or `85` to mm."""
    low, high = ALLOWED_WIDTHS_MM
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(mm|cm|in|)\s*", text.lower())
    width = float(match[1]) * MILLIMETRES[match[2]] if match else 0.0
    if not low <= width <= high:
        message = f"found '{text}'; allowed: {low:g}mm to {high:g}mm, such as 85mm, 17cm or 3.35in"
        raise UsageError(message, field="--width")
    return width


def _read_strides(folder: Path, normal: Path | None) -> tuple[Strides, Verdict]:
    """Strides of a result and the verdict on it; bands of the file that the user names, else those
    the result was made with.
    """
    tables = read_result_tables(folder)
    subject, norm = tables.model.subject, tables.norm
    if normal is not None:
        norm = build_norm_tables(Norm(bands=read_normal_bands(normal)), subject)
    strides = _select_activity(pd.DataFrame(tables.strides.cycles), folder)
    return Strides(
        table=ensemble(strides),
        subject=subject,
        offs=average_toe_offs(tables.strides.uses),
        healthy={name: curve.sides for name, curve in norm.curves.items()},
    ), parse_verdict(tables.summary)


def _select_activity(strides: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """Select strides of walks, or, if there is none, the repetitions of another activity."""
    found = list(strides["activity"].unique())
    if cycles.WALKING in found or not found:
        return strides[strides["activity"] == cycles.WALKING]
    if len(found) > 1:
        message = (
            f"contains no walk but several other activities: {', '.join(found)}; only one can be "
            "drawn"
        )
        raise InputError(message, source=folder / CYCLES, code=Code.NOTHING_TO_SHOW)
    return strides
