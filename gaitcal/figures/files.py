"""Charts as files: the same result gives the same bytes, whatever the day."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from gaitcal.figures.chart import Chart, chart_figure

DPI: Final = 300
"""What journals ask for."""
FORMATS: Final = ("png", "svg", "pdf")
_UNSIGNED: Final = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
"""Without date and program."""
SALT: Final = "gaitcal"
"""Identifiers of an SVG are made of its content and of this, not at random."""


def write_charts(charts: Iterable[Chart], folder: Path | str, formats: Sequence[str] = ("png", "svg")) -> list[Path]:
    """Draw every chart into `folder` (made if missing), a file a format; returns the files."""
    import matplotlib as mpl

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with mpl.rc_context({"svg.hashsalt": SALT, "pdf.fonttype": 42}):  # letters of a PDF stay letters
        for chart in charts:
            figure = chart_figure(chart)
            for suffix in formats:
                path = folder / f"{chart.name}.{suffix}"
                figure.savefig(path, dpi=DPI, metadata=_UNSIGNED[suffix])
                written.append(path)
    return written
