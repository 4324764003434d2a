"""`report.html`: one page that holds everything, needs no network and runs no script.

All text from the study (names of people, trials, markers, files; notes; settings) is data. The template escapes it, and
figures draw it as outlines.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from gaitcal.dynamics.torque_sources import Source
from gaitcal.figures.calibration import charts_of
from gaitcal.figures.chart import Chart, panel_figure
from gaitcal.figures.style import Key
from gaitcal.files.package_data import package_version
from gaitcal.gait.normal_bands import Bands
from gaitcal.gait.progression import TURNING
from gaitcal.gait.words import coordinate_title, explained
from gaitcal.page.sections.answers import answers
from gaitcal.page.sections.blocks import number, visible
from gaitcal.page.sections.error_sources import ErrorSources, error_sources
from gaitcal.page.sections.provenance import default_manifest, flat
from gaitcal.page.sections.sections import walks_of
from gaitcal.page.sections.trial_rows import phase_words, trial_facts, trial_fits
from gaitcal.page.sections.truth_rows import near_truth
from gaitcal.page.steps import step_rows
from gaitcal.page.svg import SvgPage
from gaitcal.person.parameter_words import blind_spots, counts_sentence, fixed_joints, inertial_groups, joint_groups
from gaitcal.person.result import Calibration, TrialResult

LONGEST_NAME = 40
COLOURS = {
    Source.MOTION: "#0072b2",
    Source.JOINT_MARKERS: "#56b4e9",
    Source.JOINT_NOMINAL: "#cc79a7",
    Source.SKIN: "#e69f00",
    Source.BANDWIDTH: "#f0e442",
    Source.INERTIA: "#009e73",
    Source.PLATES: "#d55e00",
    Source.FRAMES: "#999999",
}


@dataclass(frozen=True)
class ShownChart:
    """A chart as the template places it."""

    chart: Chart
    panels: tuple[Markup, ...]
    swatches: tuple[tuple[Markup, str], ...]
    wide: bool
    """Panels wider than a third of the page."""


def write_report(
    calibration: Calibration,
    path: Path | str,
    *,
    manifest: Mapping[str, object] | None = None,
    normal: Bands | None = None,
) -> None:
    """Write the report of a calibration as one self-contained page.

    Parameters
    ----------
    calibration : what `calibrate` returns; whatever it lacks (force plates, gait trials, standard errors) is left out
        of the page, or the page says so.
    path : the file, replaced if it exists.
    manifest : versions, settings and hashes of the inputs; made from `calibration` where not given.
    normal : bands of healthy people, drawn behind angles and moments.
    """
    Path(path).write_text(report_html(calibration, manifest=manifest, normal=normal), encoding="utf-8")


def report_html(
    calibration: Calibration, *, manifest: Mapping[str, object] | None = None, normal: Bands | None = None
) -> str:
    """The page as text."""
    charts = charts_of(calibration, normal)
    svg = SvgPage()

    def show(chart: Chart) -> ShownChart:
        panels = tuple(svg.add(panel_figure(p), f"{p.label}. {chart.title}") for p in chart.panels)
        wide = any(p.size.width > 3.0 for p in chart.panels)
        return ShownChart(chart, panels, tuple((swatch(key), key.label) for key in chart.keys), wide)

    def sources(trial: TrialResult) -> ErrorSources | None:
        return error_sources(trial, calibration.model.subject.mass)

    made = dict(manifest) if manifest is not None else default_manifest(calibration)
    template = environment().get_template("report.html")
    return template.render(
        calibration=calibration,
        subject=calibration.model.subject,
        version=made.get("gaitcal") or package_version("gaitcal"),
        date=datetime.datetime.now().astimezone().strftime("%d %B %Y, %H:%M").lstrip("0"),
        facts=trial_facts(calibration),
        answers=answers(calibration, walks_of(calibration)),
        charts=charts,
        steps=step_rows(calibration.trials),
        turning=TURNING,
        band_sources=tuple(dict.fromkeys(band.source for band in (normal or {}).values() if band.source)),
        fits=trial_fits(calibration),
        joints=joint_groups(calibration),
        inertias=inertial_groups(calibration),
        blind=blind_spots(calibration),
        fixed=fixed_joints(calibration),
        counts=counts_sentence(calibration),
        manifest=list(flat(made)),
        error_sources=sources,
        source_colours=COLOURS,
        show=show,
        sprite=svg.sprite,
        near_truth=near_truth(calibration),
        phase_words=phase_words,
        coordinate_title=coordinate_title,
    )


def data(text: object) -> Markup:
    """Text from the study, isolated so that its writing direction stays its own; control characters become `?`."""
    return Markup("<bdi>{}</bdi>").format(visible(text))


def name(text: object) -> Markup:
    """A name from the study as tables show it: a very long one is cut, the whole appears on pointing at it."""
    whole = visible(text)
    if len(whole) <= LONGEST_NAME:
        return Markup("<bdi>{}</bdi>").format(whole)
    return Markup('<bdi title="{}">{}…</bdi>').format(whole, whole[: LONGEST_NAME - 1])


def swatch(key: Key) -> Markup:
    """A small picture of a line, band or dot for the legend."""
    colour = Markup('stroke="{0}" fill="{0}"').format(key.colour)
    shape = {
        "line": Markup('<line x1="1" y1="6" x2="27" y2="6" {} stroke-width="{}"{}/>').format(
            colour, round(1.6 * key.width, 1), _dashes(key)
        ),
        "band": Markup('<rect x="2" y="1" width="24" height="10" fill="{}" fill-opacity=".25"/>').format(key.colour),
        "area": Markup('<rect x="2" y="1" width="24" height="10" fill="{}"/>').format(key.colour),
        "dot": Markup('<circle cx="14" cy="6" r="4.2" {}/>').format(colour),
        "ring": Markup('<circle cx="14" cy="6" r="4" fill="#fff" stroke="{}" stroke-width="1.5"/>').format(key.colour),
        "tick": Markup('<line x1="14" y1="0" x2="14" y2="12" {} stroke-width="2.4"/>').format(colour),
    }[key.kind]
    return Markup('<svg class="swatch" viewBox="0 0 28 12" aria-hidden="true">{}</svg>').format(shape)


def _dashes(key: Key) -> Markup:
    if not key.dashes:
        return Markup("")
    return Markup(' stroke-dasharray="{}"').format(" ".join(f"{1.6 * key.width * v:.1f}" for v in key.dashes))


def environment() -> Environment:
    """Templates of the report, with its filters; everything is escaped."""
    environment = Environment(
        loader=PackageLoader("gaitcal.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = number
    environment.filters["data"] = data
    environment.filters["name"] = name
    environment.filters["visible"] = visible
    environment.filters["explained"] = explained
    return environment
