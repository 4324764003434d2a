"""Each figure as a file for papers: PNG at 300 dpi and SVG."""

from __future__ import annotations

from pathlib import Path

from gaitcal.report.charts import charts_of
from gaitcal.report.figures.chart import chart_figure
from gaitcal.study.result import Calibration

DPI = 300
"""What journals ask for."""


def write_figures(calibration: Calibration, folder: Path | str) -> list[Path]:
    """Write every figure of the report into `folder` (made if missing) as PNG (300 dpi) and SVG.

    File names are plain ASCII: the number and a simplified name of the trial, then what is shown.

    Returns
    -------
    The files, in the order of the report.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for chart in charts_of(calibration).all():
        figure = chart_figure(chart)
        for suffix in ("png", "svg"):
            path = folder / f"{chart.name}.{suffix}"
            nothing = {"Date": None, "Creator": None, "Format": None, "Type": None} if suffix == "svg" else None
            figure.savefig(path, dpi=DPI, metadata=nothing)
            written.append(path)
    return written
