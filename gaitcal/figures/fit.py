"""How near model markers come to measured ones: before, after, and the floor of rigid segments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from gaitcal.figures.chart import Chart, Panel, Size
from gaitcal.figures.style import INK, NOMINAL, NORMAL, WHOLE, Key, dress, plain
from gaitcal.gait.words import segment_words, split_side
from gaitcal.model.linkage import SEGMENTS
from gaitcal.motion.motion import MarkerErrors
from gaitcal.person.result import Calibration, TrialResult

KEYS = (
    Key("nominal model", NOMINAL, kind="ring"),
    Key("calibrated model", WHOLE, kind="dot"),
    Key("rigid-segment floor", INK, kind="tick"),
)
ROW, LEFT = 0.19, 1.42
LOWER_BODY = tuple(s for s in SEGMENTS if split_side(s)[0] in ("pelvis", "thigh", "shank", "talus", "foot"))
WIDTH = 3.6
FEWEST_MARKERS = 3
"""That make the floor of a segment say how rigid it is."""


@dataclass(frozen=True)
class Fit:
    """RMS distance (mm) between measured and model markers; None where there are no markers."""

    label: str
    nominal: float | None
    calibrated: float | None
    floor: float | None
    rigid: bool = True
    """False for one segment with fewer than three markers: whatever they do, it follows them nearly exactly."""

    @property
    def ratio(self) -> float | None:
        """Calibrated over floor; None where the floor says nothing of the person."""
        if self.calibrated is None or not self.floor or not self.rigid:
            return None
        return self.calibrated / self.floor


def trial_fit(trial: TrialResult, *segments: str) -> Fit:
    """Fit of one trial, over all its markers or those of some segments."""

    def mm(errors: MarkerErrors) -> float | None:
        value = errors.rms(*segments)
        return None if value is None else 1e3 * value

    name = segment_words(segments[0]) if len(segments) == 1 else trial.name
    rigid = len(segments) != 1 or int(trial.calibrated.errors.kept(*segments).sum()) >= FEWEST_MARKERS
    return Fit(name, mm(trial.nominal.errors), mm(trial.calibrated.errors), mm(trial.floor), rigid)


def leg_fit(trial: TrialResult) -> Fit:
    """Fit over the markers of pelvis and legs, whose joints the calibration moves."""
    return trial_fit(trial, *LOWER_BODY)


def segment_fits(trial: TrialResult, segments: tuple[str, ...] = SEGMENTS) -> list[Fit]:
    """Fit of each of these segments that has markers in this trial."""
    return [trial_fit(trial, s) for s in segments if trial.calibrated.errors.kept(s).any()]


def fit_chart(calibration: Calibration) -> Chart | None:
    """All trials, then the segments of each whole-body trial; None without any trial."""
    if not calibration.trials:
        return None
    overall = [trial_fit(trial) for trial in calibration.trials]
    panels = []
    if len(overall) > 1 or calibration.trials[0].joint is not None:
        panels.append(_panel(overall, "RMS marker error of each trial", "All trials"))
    for trial in calibration.trials:
        if trial.joint is None:
            panels += [_panel(*part) for part in _parts(trial)]
    return Chart(
        "marker_errors",
        "Marker errors before and after calibration",
        "RMS distance between measured and model markers. The closer a filled dot is to its tick, the better the "
        "joints explain the measured motion. A segment far above its floor is held back by a joint; a high floor "
        "tells of moving skin or a loose marker.",
        tuple(panels),
        KEYS,
        columns=2,
    )


def _parts(trial: TrialResult) -> list[tuple[list[Fit], str, str]]:
    """Legs and the rest apart, each on a scale of its own: errors of arms would squeeze those of legs to nothing."""
    parts = {"Pelvis and legs": LOWER_BODY, "Trunk and arms": tuple(s for s in SEGMENTS if s not in LOWER_BODY)}
    of = {title: segment_fits(trial, segments) for title, segments in parts.items()}
    return [
        (fits, f"RMS marker error of each segment, {title.lower()}", f"{title}, {plain(trial.name, 12)}")
        for title, fits in of.items()
        if fits
    ]


def _panel(fits: list[Fit], label: str, title: str) -> Panel:
    shown = [plain(fit.label, 24) for fit in fits]
    size = Size(WIDTH, 0.66 + ROW * max(len(fits), 2), left=LEFT, right=0.12, bottom=0.38, top=0.26)

    def draw(axes: Axes) -> None:
        dress(axes, xlabel="RMS marker error (mm)", title=title)
        rows = np.arange(len(fits))
        for row, fit in zip(rows, fits, strict=True):
            if fit.nominal is not None and fit.calibrated is not None:
                axes.plot([fit.nominal, fit.calibrated], [row, row], color="#c8c8c8", linewidth=2.2, zorder=1)
            if fit.floor is not None:
                axes.plot([fit.floor], [row], "|", color=INK, markersize=9, markeredgewidth=1.4, zorder=2)
            if fit.nominal is not None:
                axes.plot([fit.nominal], [row], "o", color=NOMINAL, markerfacecolor="white", markersize=5, zorder=3)
            if fit.calibrated is not None:
                axes.plot([fit.calibrated], [row], "o", color=WHOLE, markersize=5.4, zorder=4)
        axes.set_yticks(rows, labels=shown)
        axes.tick_params(axis="y", length=0, labelsize=NORMAL)
        axes.set_ylim(max(len(fits), 2) - 0.4, -0.6)
        axes.set_xlim(left=0.0)
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)

    return Panel(label, draw, size)
