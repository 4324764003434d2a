"""The figures of `gaitcal figures --for report`: one shows all curves of a kind of one trial, its stance, the nominal
model and, of made-up people, the truth; others show fit, parameters, forces and residuals.

Curves come from the page's data (`page.json`, packed by `page/plain_data.py`), the rest from the tables of the result.
The same result gives the same bytes, whatever the day.
"""

import base64
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.figures import fit
from gaitcal.figures.chart import Chart, chart_figure
from gaitcal.figures.curves import CurveKind, Curves, Trace, curve_chart
from gaitcal.gait.cycles import GROUND_REACTION, FootEvents, GaitCycle, Kind, coordinate_of, kind_of, stances
from gaitcal.gait.moments import parameter_direction, parameter_place, parameter_words, segment_words
from gaitcal.gait.strides import Layout
from gaitcal.model.coordinates import coordinate_words
from gaitcal.model.linkage import LOWER_BODY, SIDES
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.session.parameter_words import Group, Row
from gaitcal.session.trial_result import RmsErrors

GAP: Final = -32768
FULL: Final = 32767


def unpacked(packed: Mapping[str, Any]) -> Array:
    """(n,) values of a packed curve; NaN where there is none."""
    numbers = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2").astype(np.float64)
    values: Array = packed["low"] + packed["step"] * (numbers + FULL)
    values[numbers == GAP] = np.nan
    return values


@dataclass(frozen=True)
class SheetRecording:
    """One trial of a page_data."""

    content: Mapping[str, Any]

    @property
    def name(self) -> str:
        """What it is called; data, not markup."""
        return str(self.content["name"])

    @property
    def isolated(self) -> bool:
        """Whether it shows one joint alone."""
        return self.content["joint"] is not None

    @cached_property
    def time(self) -> Array:
        """(nf,) s, in the clock of the recording, as files and `start` of a stride have it."""
        seconds = np.frombuffer(base64.b64decode(self.content["time"]), dtype="<f4").astype(np.float64)
        return np.asarray(seconds + float(self.content["start"]))

    @cached_property
    def curves(self) -> tuple[Trace, ...]:
        """All of them."""
        masks = [np.frombuffer(base64.b64decode(mask), dtype="<u1") == 1 for mask in self.content["masks"]]

        def part(curve: Mapping[str, Any], key: str) -> Array | None:
            return None if curve[key] is None else unpacked(curve[key])

        return tuple(
            Trace(
                curve["base"],
                curve["side"],
                curve["kind"],
                unpacked(curve["value"]),
                masks[curve["valid"]],
                *(part(curve, key) for key in ("se", "nominal", "truth")),
            )
            for curve in self.content["curves"]
        )

    def of(self, *kinds: str) -> list[Trace]:
        """The curves of these kinds."""
        return [curve for curve in self.curves if curve.kind in kinds]

    @cached_property
    def layout(self) -> Layout:
        """Over the gait cycle where a foot has a complete one, else against time."""
        begin = float(self.content["start"])
        cycles: dict[str, tuple[GaitCycle, ...]] = {
            side: tuple(
                GaitCycle(begin + s["start"], begin + s["stop"], None if s["off"] is None else begin + s["off"])
                for s in self.content["strides"]
                if s["side"] == side and not s["turns"]
            )
            for side in SIDES
        }
        down = {side: stances(self._events(side), self.time) for side in SIDES}
        legs = np.stack([self._valid(side) for side in SIDES], axis=1)
        return Layout(self.time, self._valid(""), legs, down, cycles if any(cycles.values()) else {})

    def _events(self, side: str) -> FootEvents:
        """Kinds of events are told in words: `foot strike`, `foot off`."""
        begin = float(self.content["start"])
        strikes, offs = (
            np.array([begin + e["time"] for e in self.content["events"] if e["side"] == side and e["kind"].endswith(k)])
            for k in ("strike", "off")
        )
        return FootEvents(strikes, offs)

    def _valid(self, side: str) -> BoolArray:
        """(nf,) torques of a leg, or of the whole body, may be used; where there are none, angles."""
        for kind in ("moment", "angle"):
            for curve in self.of(kind):
                if curve.side == side and coordinate_words(curve.base).group != "arm":
                    return curve.valid
        return np.ones(len(self.time), dtype=bool)

    def limit(self) -> tuple[float, float] | None:
        """N and N·m: what is commonly asked of pelvis residuals, where a picture of the page_data draws it."""
        for block in _blocks(self.content.get("sections", {}).values()):
            limits = block.get("limits") or {}
            if "residual_force" in limits and "residual_moment" in limits:
                return float(limits["residual_force"]), float(limits["residual_moment"])
        return None


def _blocks(content: object) -> Iterator[Mapping[str, Any]]:
    """Every block, those inside others, too."""
    if isinstance(content, Mapping):
        if content.get("kind") == "curves":
            yield content
        content = list(content.values())
    if not isinstance(content, str | int | float | None):
        for part in content:  # type: ignore[attr-defined]
            yield from _blocks(part)


HealthyBands = Mapping[str, Mapping[str, tuple[Array, Array]]]
"""Variable of `cycles.csv` -> side -> mean and SD (101,) of healthy people, in its unit, for that person's size."""
GROUND = ("ground_reaction_forward", GROUND_REACTION, "ground_reaction_sideways")
DRAWN_POWERS = ("hip", "knee", "ankle", "lumbar")  # Joints, over all their axes


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a result folder tells."""

    page_data: Mapping[str, Any]  # `page.json`
    summary: Mapping[str, Any]  # `summary.json`
    parameters: Sequence[Mapping[str, Any]] = ()  # Rows of `parameters.csv`; none of further trials
    truth: Mapping[str, float] = field(default_factory=dict)  # Parameter -> true value, of made-up people
    healthy: HealthyBands = field(default_factory=dict)

    @property
    def mass(self) -> float:
        """Kg."""
        return float(self.page_data["person"]["mass"])

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
    trials = [SheetRecording(content) for content in told.page_data["trials"]]
    charts = [fit.fit_chart(_fits(told, trials)), fit.parameters_chart(_groups(told.parameters), told.truth)]
    for number, trial in enumerate(trials, start=1):
        if not trial.isolated:
            charts += _of_walk(told, trial, stem(number, trial.name))
    return [chart for chart in charts if chart is not None]


def _of_walk(told: Told, trial: SheetRecording, name: str) -> Iterator[Chart | None]:
    mass = told.mass
    yield curve_chart(_curves(told, trial, trial.of("angle"), Kind.ANGLE, 1.0), CurveKind.ANGLE, name)
    if moments := trial.of("moment"):
        yield curve_chart(_curves(told, trial, moments, Kind.MOMENT, 1.0 / mass), CurveKind.MOMENT, name)
    if powers := [curve for curve in trial.of("power") if curve.base in DRAWN_POWERS]:
        yield curve_chart(_curves(told, trial, powers, Kind.POWER, 1.0 / mass), CurveKind.POWER, name)
    yield _forces(told, trial, name)
    yield _residuals(trial, name)
    if changes := told.about(trial.name).get("torque_change_bwh"):
        yield fit.moment_change_chart({c.name: float(changes[c.name]) for c in moments if c.name in changes}, name)


def _curves(told: Told, trial: SheetRecording, curves: list[Trace], kind: Kind, factor: float) -> Curves:
    """The whole body is drawn over the right stride, as healthy people are."""
    normal = {
        coordinate_of(name): (factor * sides["r"][0], factor * sides["r"][1])
        for name, sides in told.healthy.items()
        if kind_of(name) is kind
    }
    return Curves(layout=trial.layout, traces={c.name: c.scaled(factor) for c in curves}, normal=normal)


def _forces(told: Told, trial: SheetRecording, name: str) -> Chart | None:
    found = {curve.name: curve for curve in trial.of("force")}
    if not found:
        return None
    force = np.stack([np.stack([found[f"{b}_{s}"].value for b in GROUND], axis=1) for s in SIDES], axis=1)
    legs = np.stack([found[f"{GROUND_REACTION}_{side}"].valid for side in SIDES], axis=1)
    # Packed to 1/65534 of its range, no force is exactly none.
    unloaded = np.abs(force[:, :, 1]) <= np.abs(force[:, :, 1]).max() / 2**16
    force[np.broadcast_to(unloaded[:, :, None], force.shape)] = 0.0
    return fit.forces_chart(trial.time, force / told.mass, legs, name)


def _residuals(trial: SheetRecording, name: str) -> Chart | None:
    found = {curve.kind: curve for curve in trial.of("residual_force", "residual_moment")}
    if len(found) < 2 or not found["residual_force"].valid.any():
        return None
    force, moment = found["residual_force"], found["residual_moment"]
    stages = [("calibrated model", force.value, moment.value)]
    if force.nominal is not None and moment.nominal is not None:
        stages.insert(0, ("nominal model", force.nominal, moment.nominal))
    return fit.residuals_chart(trial.time, force.valid, stages, trial.limit(), name)


def _fits(told: Told, trials: list[SheetRecording]) -> list[fit.FitSummary]:
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
        out.append(fit.FitSummary(_errors(trial.name, about), trial.isolated, legs, rest))
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


DPI: Final = 300  # What journals ask for
FORMATS: Final = ("png", "svg", "pdf")
_UNSIGNED: Final = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
"""Without date and program."""
SALT: Final = "gaitcal"  # Identifiers of an SVG are made of its content and of this, not at random


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
