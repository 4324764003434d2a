"""How near model markers come to measured ones: before, after, and the floor of rigid segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gaitcal.figures.chart import Chart, Panel, Size
from gaitcal.figures.style import INK, NOMINAL, WHOLE, Key, dress, dress_rows, plain
from gaitcal.session.marker_fit import RmsErrors

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KEYS = (
    Key(label="nominal model", colour=NOMINAL, kind="ring"),
    Key(label="calibrated model", colour=WHOLE, kind="dot"),
    Key(label="rigid-segment floor", colour=INK, kind="tick"),
)
ROW, LEFT = 0.19, 1.42
WIDTH = 3.6


@dataclass(frozen=True)
class TrialFit:
    """Marker errors of one trial."""

    overall: RmsErrors
    isolated: bool
    """Whether it shows one joint alone, whose segments are not told."""
    legs: tuple[RmsErrors, ...]
    """Segments of pelvis and legs that have markers."""
    rest: tuple[RmsErrors, ...]
    """Those of trunk and arms: on a scale of their own, which would squeeze the errors of legs to nothing."""


def fit_chart(trials: Sequence[TrialFit]) -> Chart | None:
    """All trials, then the segments of each whole-body trial; None without any trial."""
    if not trials:
        return None
    panels = []
    if len(trials) > 1 or trials[0].isolated:
        panels.append(_panel([t.overall for t in trials], "RMS marker error of each trial", "All trials"))
    for trial in trials:
        for title, fits in (("Pelvis and legs", trial.legs), ("Trunk and arms", trial.rest)):
            if fits and not trial.isolated:
                words = f"RMS marker error of each segment, {title.lower()}"
                panels.append(_panel(list(fits), words, f"{title}, {plain(trial.overall.label, 12)}"))
    return Chart(
        name="marker_errors",
        title="Marker errors before and after calibration",
        panels=tuple(panels),
        keys=KEYS,
        columns=2,
    )


def _panel(fits: list[RmsErrors], label: str, title: str) -> Panel:
    shown = [plain(fit.label, 24) for fit in fits]
    size = Size(width=WIDTH, height=0.66 + ROW * max(len(fits), 2), left=LEFT, right=0.12, bottom=0.38, top=0.26)

    def draw(axes: Axes) -> None:
        dress(axes, xlabel="RMS marker error (mm)", title=title)
        for row, fit in enumerate(fits):
            if fit.nominal is not None and fit.calibrated is not None:
                axes.plot([fit.nominal, fit.calibrated], [row, row], color="#c8c8c8", linewidth=2.2, zorder=1)
            if fit.floor is not None:
                axes.plot([fit.floor], [row], "|", color=INK, markersize=9, markeredgewidth=1.4, zorder=2)
            if fit.nominal is not None:
                axes.plot([fit.nominal], [row], "o", color=NOMINAL, markerfacecolor="white", markersize=5, zorder=3)
            if fit.calibrated is not None:
                axes.plot([fit.calibrated], [row], "o", color=WHOLE, markersize=5.4, zorder=4)
        dress_rows(axes, shown, least=2)
        axes.set_xlim(left=0.0)
        axes.spines["left"].set_visible(False)

    return Panel(label, draw, size)
