"""What a result folder would tell of a calibration, without the folder."""

import json
from collections.abc import Mapping

from matplotlib.figure import Figure

from gaitcal.figures.chart import Chart, Panel, chart_figure
from gaitcal.figures.report import Told, report_charts
from gaitcal.gait.normal_bands import Bands
from gaitcal.page.page_data import calibration_page_data
from gaitcal.results.summary import summary
from gaitcal.session.result import Calibration
from gaitcal.session.tables import parameter_rows


def told(calibration: Calibration, normal: Bands | None = None) -> Told:
    subject, known = calibration.model.subject, calibration.truth
    return Told(
        page_data=calibration_page_data(calibration),
        summary=json.loads(json.dumps(summary(calibration))),
        parameters=parameter_rows(calibration),
        truth={p.name: p.truth for p in known.parameters} if known else {},
        healthy={name: {s: band.for_person(subject, s) for s in "rl"} for name, band in (normal or {}).items()},
    )


def charts(calibration: Calibration, normal: Bands | None = None) -> Mapping[str, Chart]:
    """Kind of a page (`angles`, `joint_parameters`) -> its chart; of calibrations with one walk."""
    found = report_charts(told(calibration, normal))
    return {chart.name.split("_", 2)[2] if chart.name[0].isdigit() else chart.name: chart for chart in found}


def panel_figure(panel: Panel) -> Figure:
    """One panel alone."""
    return chart_figure(Chart(name="alone", title="", panels=(panel,), keys=()))
