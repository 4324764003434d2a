"""Figures as files, what they draw, and the words on them."""

from pathlib import Path

import matplotlib
import pytest
from matplotlib.figure import Figure

from gaitcal.analysis.result import Calibration
from gaitcal.dynamics.expected_residual import compute_residual_limits
from gaitcal.gait.conventions import Convention
from gaitcal.gait.cycles import validate_stride_table
from gaitcal.gait.ensemble import ensemble
from gaitcal.gait.moments import (
    describe_joint,
    describe_parameter,
    describe_segment,
    explain_parameters,
    list_moments,
    summarise_moments,
)
from gaitcal.gait.strides import make_layout
from gaitcal.model.coordinates import describe_coordinate
from gaitcal.model.linkage import COORDINATES, REACTIONS, SEGMENTS, is_translation
from gaitcal.model.parameters import IP_NAMES, JP_NAMES
from gaitcal.report.figures.chart import Chart, Panel, clean_name, draw_chart, write_charts
from gaitcal.report.figures.journal_figures import Strides, build_paper_charts
from gaitcal.results.cycle_tables import build_cycle_table
from gaitcal.results.summary import summarise_calibration

SAME = 1e-9
"""Relative: the same sums in another order."""


def panel_figure(panel: Panel) -> Figure:
    """One panel alone."""
    return draw_chart(Chart(name="alone", title="", panels=(panel,), keys=()))


def charts(calibration: Calibration, convention: Convention | None = None) -> dict[str, Chart]:
    """Name of a file -> its chart."""
    table = build_cycle_table(calibration.model, calibration.trials)
    strides = Strides(
        table=ensemble(validate_stride_table(table)),
        subject=calibration.model.subject,
        offs={"r": 61.0},
    )
    return {chart.name: chart for chart in build_paper_charts(strides, convention or Convention())}


def test_all_axes_have_units_and_legends_lie_inside_their_figures(whole: Calibration) -> None:
    for chart in charts(whole).values():
        figure = draw_chart(chart)
        for axes in figure.axes:
            assert axes.get_xlabel().endswith("%)")
            assert axes.get_ylabel() or axes.get_yticklabels(), chart.name
        legend = figure.legends[0].get_window_extent()
        assert figure.bbox.x0 <= legend.x0 and legend.x1 <= figure.bbox.x1, chart.name
        drawn = [axes.get_tightbbox() for axes in figure.axes]
        assert legend.y0 >= 0 and legend.y1 <= min(box.y0 for box in drawn if box is not None), (
            chart.name
        )


def test_global_settings_of_matplotlib_stay(whole: Calibration, tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    write_charts(list(charts(whole).values())[:1], tmp_path, ["svg"])
    assert dict(matplotlib.rcParams) == before


def test_changes_are_those_of_the_summary(whole: Calibration) -> None:
    written = summarise_calibration(whole)["trials"]["walk"]["torque_change_bwh"]
    walk = whole.trial("walk")
    drawn = make_layout(walk.body, walk.loads.reactions, walk.events)
    numbers = summarise_moments(whole.model, drawn, walk.loads.final, walk.loads.nominal)
    assert {n.name: n.change_bwh for n in numbers} == pytest.approx(written, rel=SAME)


def test_limits_of_the_residuals(whole: Calibration) -> None:
    trial = whole.trial("walk")
    limits = compute_residual_limits(
        whole.model.parameters, trial.body.q, trial.loads.reactions, trial.recording.plates
    )
    assert limits.peak_force == pytest.approx(1400.0)
    assert limits.force == pytest.approx(70.0)
    assert limits.moment == pytest.approx(0.01 * limits.centre_height * 1400.0)
    assert 0.5 < limits.centre_height < 1.5


@pytest.mark.parametrize("name", ["$x$", "a$b", "<b>", "\u202eabc", "中文", "x" * 300, "", "\n\t"])
def test_names_are_no_markup_in_figures(name: str) -> None:
    shown = clean_name(name)
    assert len(shown.replace("\\$", "$")) <= 26
    assert shown.replace("\\$", "").count("$") == 0
    assert shown.isprintable()


def test_everything_has_words() -> None:
    assert all(
        describe_coordinate(n).angle != "positive" for n in COORDINATES if not is_translation(n)
    )
    assert len({describe_parameter(n) + n.split(".")[0][-2:] for n in JP_NAMES}) == len(JP_NAMES)
    assert all(describe_parameter(n) for n in IP_NAMES)
    assert (
        describe_segment("forearm_hand_l") == "left forearm and hand"
        and describe_joint("hip_l") == "left hip"
    )
    assert len({describe_segment(s) for s in SEGMENTS}) == len(SEGMENTS)
    assert (
        explain_parameters("hip_r.pelvis.ant is far")
        == "hip_r.pelvis.ant (right hip centre in the pelvis, forward) is far"
    )
    assert (
        explain_parameters("file.trc and thigh_r.mass")
        == "file.trc and thigh_r.mass (right thigh: mass)"
    )


def test_moments_are_named_once(whole: Calibration) -> None:
    names = list_moments(whole.model)
    assert sorted(names) == sorted(
        (*(n for n in COORDINATES if not n.startswith("pelvis")), *REACTIONS)
    )
    assert names.index("knee_adduction_r") == names.index("knee_angle_r") + 1
