"""All charts of a calibration, in the order of the report. The page and the files for papers both come from here.

Each figure as a file for papers: PNG at 300 dpi and SVG.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from gaitcal.dynamics.residual_limits import ResidualLimits, ResidualMagnitudes, residual_limits
from gaitcal.figures.chart import Chart, chart_figure
from gaitcal.figures.curves import angle_chart, moment_chart
from gaitcal.figures.fit import fit_chart
from gaitcal.figures.forces import forces_chart, residuals_chart
from gaitcal.figures.parameters import moment_change_chart, parameters_chart
from gaitcal.gait.moments import MomentNumbers, moment_numbers
from gaitcal.gait.strides import Layout, cycle_sentence, layout
from gaitcal.person.parameter_words import joint_groups
from gaitcal.person.result import Calibration, TrialResult


@dataclass(frozen=True)
class GaitView:
    """What the report shows of one whole-body trial. Without force plates only the angles."""

    trial: TrialResult
    layout: Layout
    axis: str
    """What the horizontal axis is, in words."""
    angles: Chart
    moments: Chart | None
    forces: Chart | None
    residuals: Chart | None
    change: Chart | None
    numbers: tuple[MomentNumbers, ...]
    stages: tuple[ResidualMagnitudes, ...]
    limits: ResidualLimits | None

    @property
    def valid_frames(self) -> int:
        """Frames in which every foot on the ground is on a plate."""
        return int(self.layout.valid.sum())


@dataclass(frozen=True)
class Charts:
    """Everything there is to see."""

    fit: Chart | None
    parameters: Chart | None
    gait: tuple[GaitView, ...]

    def all(self) -> list[Chart]:
        """In the order of the report."""
        found = [self.fit, self.parameters]
        for part in ("angles", "moments", "forces", "residuals", "change"):
            found += [getattr(view, part) for view in self.gait]
        return [chart for chart in found if chart is not None]


def charts_of(calibration: Calibration) -> Charts:
    """Prepare all charts; nothing is drawn yet."""
    gait = [(stem(i, t.name), t) for i, t in enumerate(calibration.trials, start=1) if t.joint is None]
    return Charts(
        fit_chart(calibration),
        parameters_chart(joint_groups(calibration)),
        tuple(_gait_view(calibration, trial, name) for name, trial in gait),
    )


def stem(number: int, name: str) -> str:
    """Beginning of a file name for a trial: plain letters, whatever the trial is called."""
    plain = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:24]
    return f"{number:02d}_{plain}" if plain else f"{number:02d}"


def _gait_view(calibration: Calibration, trial: TrialResult, name: str) -> GaitView:
    drawn = layout(calibration.model, trial.body, trial.loads.reactions if trial.loads else None)
    angles = angle_chart(calibration, trial, drawn, name)
    loads = trial.loads
    if loads is None:
        return GaitView(trial, drawn, cycle_sentence(drawn), angles, None, None, None, None, (), (), None)
    forces = forces_chart(calibration, trial, loads, name)
    if not loads.reactions.valid.any():
        return GaitView(trial, drawn, cycle_sentence(drawn), angles, None, forces, None, None, (), (), None)
    numbers = moment_numbers(calibration.model, drawn, loads.final, loads.nominal, loads.errors)
    found = loads.residuals
    limit = residual_limits(calibration.model.parameters, trial.body.q, loads.reactions, trial.recording.plates)
    return GaitView(
        trial,
        drawn,
        cycle_sentence(drawn),
        angles,
        moment_chart(calibration, trial, loads, drawn, name),
        forces,
        residuals_chart(trial, loads, found, limit, name),
        moment_change_chart(trial, numbers, name),
        numbers,
        found,
        limit,
    )


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
