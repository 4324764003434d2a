"""The chart pages of a result, from what its folder holds: curves from the sheet, the rest from its tables.

One figure shows all curves of a kind of one trial, its stance, the nominal model and, of made-up people, the truth.

Charts as files: the same result gives the same bytes, whatever the day.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.figures.chart import Chart, chart_figure
from gaitcal.figures.curves import Curves, Trace, angle_chart, moment_chart, power_chart
from gaitcal.figures.fit import (
    FitSummary,
    Forces,
    Residuals,
    Stage,
    fit_chart,
    forces_chart,
    moment_change_chart,
    parameters_chart,
    residuals_chart,
)
from gaitcal.figures.sheet import SheetCurve, SheetRecording
from gaitcal.gait.cycles import GROUND_REACTION, Kind, coordinate_of, kind_of
from gaitcal.gait.moments import parameter_direction, parameter_place, parameter_words, segment_words
from gaitcal.model.linkage import LOWER_BODY, SIDES
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.session.parameter_words import Group, Row
from gaitcal.session.trial_result import RmsErrors

HealthyBands = Mapping[str, Mapping[str, tuple[Array, Array]]]
"""Variable of `cycles.csv` -> side -> mean and SD (101,) of healthy people, in its unit, for that person's size."""
GROUND = ("ground_reaction_forward", GROUND_REACTION, "ground_reaction_sideways")
DRAWN_POWERS = ("hip", "knee", "ankle", "lumbar")
"""Joints, over all their axes."""


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a result folder tells."""

    sheet: Mapping[str, Any]
    """`page.json`."""
    summary: Mapping[str, Any]
    """`summary.json`."""
    parameters: Sequence[Mapping[str, Any]] = ()
    """Rows of `parameters.csv`; none of further trials."""
    truth: Mapping[str, float] = field(default_factory=dict)
    """Parameter -> true value, of made-up people."""
    healthy: HealthyBands = field(default_factory=dict)

    @property
    def mass(self) -> float:
        """Kg."""
        return float(self.sheet["person"]["mass"])

    def about(self, trial: str) -> Mapping[str, Any]:
        """What the summary says of one trial."""
        found: Mapping[str, Any] = self.summary.get("trials", {}).get(trial, {})
        return found


def stem(number: int, name: str) -> str:
    """Beginning of a file name for a trial: plain letters, whatever the trial is called."""
    plain = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:24]
    return f"{number:02d}_{plain}" if plain else f"{number:02d}"


def report_charts(told: Told) -> list[Chart]:
    """All of them, in order; nothing is drawn yet."""
    trials = [SheetRecording(content) for content in told.sheet["trials"]]
    charts = [fit_chart(_fits(told, trials)), parameters_chart(_groups(told.parameters), told.truth)]
    for number, trial in enumerate(trials, start=1):
        if not trial.isolated:
            charts += _of_walk(told, trial, stem(number, trial.name))
    return [chart for chart in charts if chart is not None]


def _of_walk(told: Told, trial: SheetRecording, name: str) -> Iterator[Chart | None]:
    mass = told.mass
    yield angle_chart(_curves(told, trial, trial.of("angle"), Kind.ANGLE, 1.0), name)
    if moments := trial.of("moment"):
        yield moment_chart(_curves(told, trial, moments, Kind.MOMENT, 1.0 / mass), name)
    if powers := [curve for curve in trial.of("power") if curve.base in DRAWN_POWERS]:
        yield power_chart(_curves(told, trial, powers, Kind.POWER, 1.0 / mass), name)
    yield _forces(told, trial, name)
    yield _residuals(trial, name)
    if changes := told.about(trial.name).get("torque_change_bwh"):
        yield moment_change_chart({c.name: float(changes[c.name]) for c in moments if c.name in changes}, name)


def _curves(told: Told, trial: SheetRecording, curves: list[SheetCurve], kind: Kind, factor: float) -> Curves:
    """Gaps where a value does not count; the whole body is drawn over the right stride, as healthy people are."""

    def scaled(values: Array | None) -> Array | None:
        return None if values is None else factor * values

    traces = {
        c.name: Trace(
            c.side,
            factor * c.masked(c.value),
            None if c.nominal is None else factor * c.masked(c.nominal),
            scaled(c.error),
            scaled(c.truth),
        )
        for c in curves
    }
    normal = {
        coordinate_of(name): (factor * sides["r"][0], factor * sides["r"][1])
        for name, sides in told.healthy.items()
        if kind_of(name) is kind
    }
    return Curves(layout=trial.layout, traces=traces, normal=normal)


def _forces(told: Told, trial: SheetRecording, name: str) -> Chart | None:
    found = {curve.name: curve for curve in trial.of("force")}
    if not found:
        return None
    percent = 100.0 / float(told.sheet["person"]["weight"])
    force = np.stack([np.stack([found[f"{b}_{s}"].value for b in GROUND], axis=1) for s in SIDES], axis=1)
    legs = np.stack([found[f"{GROUND_REACTION}_{side}"].valid for side in SIDES], axis=1)
    # Packed to 1/65534 of its range, no force is exactly none.
    unloaded = np.abs(force[:, :, 1]) <= np.abs(force[:, :, 1]).max() / 2**16
    force[np.broadcast_to(unloaded[:, :, None], force.shape)] = 0.0
    return forces_chart(Forces(time=trial.time, force=percent * force, valid_legs=legs), name)


def _residuals(trial: SheetRecording, name: str) -> Chart | None:
    found = {curve.kind: curve for curve in trial.of("residual_force", "residual_moment")}
    if len(found) < 2 or not found["residual_force"].valid.any():
        return None
    force, moment = found["residual_force"], found["residual_moment"]
    stages = [Stage("calibrated model", force.value, moment.value)]
    if force.nominal is not None and moment.nominal is not None:
        stages.insert(0, Stage("nominal model", force.nominal, moment.nominal))
    shown = Residuals(time=trial.time, valid=force.valid, stages=tuple(stages), limit=trial.limit())
    return residuals_chart(shown, name)


def _fits(told: Told, trials: list[SheetRecording]) -> list[FitSummary]:
    """Marker errors as `summary.json` has them."""
    out = []
    for trial in trials:
        if not (about := told.about(trial.name)):
            continue
        segments = {
            name: _errors(segment_words(name), of, rigid=int(of["markers"]) >= FEWEST_MARKERS)
            for name, of in about.get("segments", {}).items()
        }
        legs = tuple(errors for name, errors in segments.items() if name in LOWER_BODY)
        rest = tuple(errors for name, errors in segments.items() if name not in LOWER_BODY)
        out.append(FitSummary(_errors(trial.name, about), trial.isolated, legs, rest))
    return out


def _errors(label: str, about: Mapping[str, Any], *, rigid: bool = True) -> RmsErrors:
    rms = about["rms_mm"]
    return RmsErrors(
        label=label,
        nominal=rms.get("nominal"),
        calibrated=rms.get("calibrated"),
        floor=rms.get("rigid_floor"),
        rigid=rigid,
    )


def _groups(parameters: Sequence[Mapping[str, Any]]) -> tuple[Group, ...]:
    """The joint parameters that were fitted, in the order of their table."""
    rows = [_row(entry) for entry in parameters if str(entry["kind"]).startswith("joint ")]
    groups = []
    for joint in dict.fromkeys(row.part for row in rows):
        own = [row for row in rows if row.part == joint and row.status != "fixed"]
        right, left = (tuple(row for row in own if (row.side == "l") is of_left) for of_left in (False, True))
        if own:
            groups.append(Group(joint, right, left, 0))
    return tuple(groups)


def _row(entry: Mapping[str, Any]) -> Row:
    name, error = str(entry["name"]), entry["standard_error"]
    return Row(
        name=name,
        words=parameter_words(name),
        place=parameter_place(name),
        direction=parameter_direction(name),
        unit=str(entry["unit"]),
        nominal=float(entry["nominal"]),
        fitted=float(entry["fitted"]),
        error=None if error is None or not math.isfinite(error) else float(error),
        status=str(entry["status"]),
    )


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
