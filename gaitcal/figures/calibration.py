"""All charts of a calibration, in the order of the report: for the page, and as PNG and SVG files for papers."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

from gaitcal.dynamics.residual_limits import ResidualLimits, ResidualMagnitudes, residual_limits
from gaitcal.figures.chart import Chart, chart_figure
from gaitcal.figures.curves import angle_chart, moment_chart
from gaitcal.figures.fit import fit_chart
from gaitcal.figures.forces import forces_chart, residuals_chart
from gaitcal.figures.parameters import moment_change_chart, parameters_chart
from gaitcal.gait.moments import MomentNumbers, moment_numbers
from gaitcal.gait.normal_bands import Bands
from gaitcal.gait.strides import Layout, cycle_sentence, layout
from gaitcal.person.parameter_words import joint_groups
from gaitcal.person.result import Calibration, TrialResult


@dataclass(frozen=True, kw_only=True)
class GaitView:
    """What the report shows of one whole-body trial: without force plates only the angles."""

    trial: TrialResult
    layout: Layout
    axis: str
    """What the horizontal axis is, in words."""
    angles: Chart
    moments: Chart | None = None
    forces: Chart | None = None
    residuals: Chart | None = None
    change: Chart | None = None
    numbers: tuple[MomentNumbers, ...] = ()
    stages: tuple[ResidualMagnitudes, ...] = ()
    limits: ResidualLimits | None = None

    def valid_frames(self, side: str = "") -> int:
        """Frames in which the torques of a leg (`r`, `l`) are valid, or those of the whole body (nothing)."""
        return int(self.layout.valid_for(side).sum())


@dataclass(frozen=True)
class Charts:
    """Everything there is to see."""

    fit: Chart | None
    parameters: Chart | None
    gait: tuple[GaitView, ...]

    def all(self) -> list[Chart]:
        """In the order of the report."""
        kinds = ("angles", "moments", "forces", "residuals", "change")
        of_gait = (getattr(view, kind) for kind in kinds for view in self.gait)
        return [chart for chart in (self.fit, self.parameters, *of_gait) if chart is not None]


def charts_of(calibration: Calibration, normal: Bands | None = None) -> Charts:
    """Prepare all charts; nothing is drawn yet. `normal`: bands of healthy people behind angles and moments."""
    gait = [(stem(i, t.name), t) for i, t in enumerate(calibration.trials, start=1) if t.joint is None]
    return Charts(
        fit_chart(calibration),
        parameters_chart(
            joint_groups(calibration),
            {p.name: p.truth for p in calibration.truth.parameters} if calibration.truth else None,
        ),
        tuple(_gait_view(calibration, trial, name, normal) for name, trial in gait),
    )


def stem(number: int, name: str) -> str:
    """Beginning of a file name for a trial: plain letters, whatever the trial is called."""
    plain = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:24]
    return f"{number:02d}_{plain}" if plain else f"{number:02d}"


def _gait_view(calibration: Calibration, trial: TrialResult, name: str, normal: Bands | None) -> GaitView:
    loads, model = trial.loads, calibration.model
    drawn = layout(trial.body, loads.reactions if loads else None, trial.events)
    view = GaitView(
        trial=trial,
        layout=drawn,
        axis=cycle_sentence(drawn),
        angles=angle_chart(calibration, trial, drawn, name, normal),
        forces=forces_chart(calibration, trial, loads, name) if loads else None,
    )
    if loads is None or not loads.reactions.has_torques:
        return view
    numbers = moment_numbers(model, drawn, loads.final, loads.nominal, loads.errors)
    view = replace(
        view,
        moments=moment_chart(calibration, trial, loads, drawn, name, normal),
        change=moment_change_chart(trial, numbers, name),
        numbers=numbers,
    )
    if not loads.reactions.valid.any():
        return view
    steps = loads.residuals
    limits = residual_limits(model.parameters, trial.body.q, loads.reactions, trial.recording.plates)
    return replace(view, residuals=residuals_chart(trial, loads, steps, limits, name), stages=steps, limits=limits)


DPI = 300
"""What journals ask for."""


def write_figures(calibration: Calibration, folder: Path | str, normal: Bands | None = None) -> list[Path]:
    """Write every figure of the report into `folder` (made if missing) as PNG (300 dpi) and SVG.

    File names are plain ASCII: the number and a simplified name of the trial, then what is shown.

    Returns
    -------
    The files, in the order of the report.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for chart in charts_of(calibration, normal).all():
        figure = chart_figure(chart)
        for suffix in ("png", "svg"):
            path = folder / f"{chart.name}.{suffix}"
            # Without date and program, the same result gives the same file.
            unsigned = {"Date": None, "Creator": None, "Format": None, "Type": None} if suffix == "svg" else None
            figure.savefig(path, dpi=DPI, metadata=unsigned)
            written.append(path)
    return written
