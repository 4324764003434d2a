"""All charts of a calibration, in the order of the report: for the page, and as PNG and SVG files for papers."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.residual_limits import ResidualLimits, ResidualMagnitudes, residual_limits
from gaitcal.figures.chart import Chart, chart_figure
from gaitcal.figures.curves import Curves, Trace, angle_chart, moment_chart
from gaitcal.figures.fit import TrialFit, fit_chart, segment_fits, trial_fit
from gaitcal.figures.forces import Forces, Residuals, Stage, forces_chart, residuals_chart
from gaitcal.figures.parameters import moment_change_chart, parameters_chart
from gaitcal.gait.moments import MomentNumbers, moment_names, moment_numbers, moment_of
from gaitcal.gait.normal_bands import Bands
from gaitcal.gait.strides import Layout, cycle_sentence, layout
from gaitcal.gait.variables import Kind, coordinate_of, kind_of
from gaitcal.gait.words import split_side
from gaitcal.model.linkage import COORDINATES, LOWER_BODY, SEGMENTS, is_translation
from gaitcal.person.parameter_words import joint_groups
from gaitcal.person.result import Calibration, LoadedTrial, TrialResult


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
        fit_chart(_fits(calibration)),
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
        angles=angle_chart(_angles(calibration, trial, drawn, normal), name),
        forces=forces_chart(_forces(calibration, trial, loads), name) if loads else None,
    )
    if loads is None or not loads.reactions.has_torques:
        return view
    numbers = moment_numbers(model, drawn, loads.final, loads.nominal, loads.errors)
    view = replace(
        view,
        moments=moment_chart(_moments(calibration, trial, loads, drawn, normal), name),
        change=moment_change_chart(trial.name, {n.name: n.change_bwh for n in numbers}, name),
        numbers=numbers,
    )
    if not loads.reactions.valid.any():
        return view
    steps = loads.residuals
    limits = residual_limits(model.parameters, trial.body.q, loads.reactions, trial.recording.plates)
    shown = Residuals(
        trial=trial.name,
        time=trial.body.time,
        valid=loads.reactions.valid,
        stages=tuple(Stage(s.name, s.force, s.moment) for s in steps),
        limit=(limits.force, limits.moment),
    )
    return replace(view, residuals=residuals_chart(shown, name), stages=steps, limits=limits)


def _fits(calibration: Calibration) -> list[TrialFit]:
    above = tuple(s for s in SEGMENTS if s not in LOWER_BODY)
    return [
        TrialFit(trial_fit(t), t.joint is not None, tuple(segment_fits(t, LOWER_BODY)), tuple(segment_fits(t, above)))
        for t in calibration.trials
    ]


def _angles(calibration: Calibration, trial: TrialResult, drawn: Layout, normal: Bands | None) -> Curves:
    frozen = set(calibration.model.frozen)
    before, after = np.degrees(trial.nominal.q), np.degrees(trial.body.q)
    known = calibration.truth.of(trial.name).coordinates if calibration.truth else {}

    def trace(name: str) -> Trace:
        column = trial.body.coordinates.index(name)
        old = trial.nominal.coordinates.index(name)
        error = None if trial.coordinate_errors is None else np.degrees(trial.coordinate_errors[:, column])
        true = known[name].truth if name in known else None
        return Trace(split_side(name)[1], after[:, column], before[:, old], error, true)

    names = [n for n in COORDINATES if not is_translation(n) and n not in frozen]
    bands = _normal(calibration, normal, Kind.ANGLE, 1.0)
    return Curves(trial=trial.name, layout=drawn, traces={n: trace(n) for n in names}, normal=bands)


def _moments(
    calibration: Calibration, trial: TrialResult, loads: LoadedTrial, drawn: Layout, normal: Bands | None
) -> Curves:
    mass = calibration.model.subject.mass
    known = calibration.truth.of(trial.name).forces if calibration.truth else {}

    def trace(name: str) -> Trace:
        value, nominal = (
            np.where(loads.reactions.valid_for(name), moment_of(forces, name) / mass, np.nan)
            for forces in (loads.final, loads.nominal)
        )
        errors = None if loads.errors is None else moment_of(loads.errors, name) / mass
        true = known[name].truth / mass if name in known else None
        return Trace(split_side(name)[1], value, nominal, errors, true)

    bands = _normal(calibration, normal, Kind.MOMENT, 1.0 / mass)
    names = moment_names(calibration.model)
    return Curves(trial=trial.name, layout=drawn, traces={n: trace(n) for n in names}, normal=bands)


def _normal(
    calibration: Calibration, normal: Bands | None, kind: Kind, factor: float
) -> dict[str, tuple[Array, Array]]:
    """The whole body is drawn over the right stride, and both legs of healthy people are alike."""
    of_kind = {coordinate_of(name): band for name, band in (normal or {}).items() if kind_of(name) is kind}
    found = {name: band.for_person(calibration.model.subject, "r") for name, band in of_kind.items()}
    return {name: (factor * mean, factor * sd) for name, (mean, sd) in found.items()}


def _forces(calibration: Calibration, trial: TrialResult, loads: LoadedTrial) -> Forces:
    return Forces(
        trial=trial.name,
        time=trial.body.time,
        force=100.0 * loads.reactions.wrench[:, :, :3] / calibration.model.subject.weight,
        valid_legs=loads.reactions.valid_legs,
    )


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
