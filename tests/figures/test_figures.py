"""Figures as files, what they draw, and the words on them."""

from pathlib import Path
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from gaitcal.dynamics.expected_residual import residual_limits
from gaitcal.figures.chart import SIDE_COLOURS, Panel, chart_figure, plain
from gaitcal.figures.curves import NORMAL_KEY
from gaitcal.figures.fit import forces_chart, parameters_chart
from gaitcal.figures.report import SheetRecording, report_charts, write_charts
from gaitcal.gait.cycles import POINTS
from gaitcal.gait.moments import (
    explained,
    joint_words,
    moment_names,
    moment_numbers,
    moment_of,
    parameter_words,
    segment_words,
)
from gaitcal.gait.normal_bands import BAND_SIGNS, NormalBand
from gaitcal.gait.strides import layout
from gaitcal.model.coordinates import coordinate_words
from gaitcal.model.linkage import COORDINATES, REACTIONS, SEGMENTS, is_translation
from gaitcal.model.parameters import IP_NAMES, JP_NAMES
from gaitcal.results.summary import summary
from gaitcal.session.parameter_words import Group, Row
from gaitcal.session.result import Calibration
from tests.fake_result import ANGLE_ERROR, HOSTILE, Names, fake_calibration
from tests.figures.told import charts, panel_figure, told

SAME = 1e-9
"""Relative: the same sums in another order."""
PACKED = 1 / 60_000
"""Of the range of a curve: a sheet holds 16-bit integers."""


@pytest.mark.slow
def test_each_figure_is_a_png_and_an_svg(whole: Calibration, tmp_path: Path) -> None:
    found = list(charts(whole).values())
    files = write_charts(found, tmp_path / "figures")
    assert [f.name for f in files] == [f"{c.name}.{suffix}" for c in found for suffix in ("png", "svg")]
    assert len({c.name for c in found}) == len(found) == 7
    for file in files:
        if file.suffix == ".svg":
            assert ElementTree.parse(file).getroot().tag.endswith("svg")
        else:
            assert file.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_file_names_and_contents_ignore_what_a_trial_is_called(tmp_path: Path) -> None:
    hostile = fake_calibration(Names(HOSTILE, "../../" + HOSTILE, HOSTILE))
    for file in write_charts(report_charts(told(hostile)), tmp_path, ["svg"]):
        assert file.parent == tmp_path and file.name.isascii() and not set(file.name) & set("<>\"'$&/ ")
        tags = {str(e.tag).lower() for e in ElementTree.parse(file).getroot().iter()}
        assert not [t for t in tags if t.endswith(("script", "image"))]


def test_frames_that_are_not_valid_stay_empty(whole: Calibration) -> None:
    shown = SheetRecording(told(whole).page_data["trials"][0]).layout
    axes = panel_figure(charts(whole)["moments"].panels[0]).axes[0]
    curves = [line for line in axes.lines if len(line.get_xdata()) == 101 and line.get_linewidth() > 1]
    assert len(curves) == 2
    for side, line in zip(("r", "l"), curves, strict=True):
        cycle = shown.main(side)
        at = np.linspace(cycle.start, cycle.stop, 101)
        unknown = (at > 1.5 + 1e-6) & (at < 1.69 - 1e-6)
        values = np.asarray(line.get_ydata())
        assert np.isnan(values[unknown]).all()
        assert np.isfinite(values[(at < 1.49) | (at > 1.70)]).all()


def test_angles_have_the_band_of_their_standard_error(whole: Calibration) -> None:
    chart = charts(whole)["angles"]
    assert "±1 standard error" in [key.label for key in chart.keys]
    knee = next(p for p in chart.panels if p.label.startswith("Knee flexion"))
    bands = [c for c in panel_figure(knee).axes[0].collections if isinstance(c, PolyCollection)]
    assert len(bands) == 2
    for band in bands:
        corners = band.get_paths()[0].vertices
        at = np.isclose(corners[:, 0], 50.0)
        assert np.ptp(corners[at, 1]) == pytest.approx(2 * np.degrees(ANGLE_ERROR), rel=PACKED)
    without = charts(fake_calibration(errors=False))["angles"]
    assert "±1 standard error" not in [key.label for key in without.keys]


def lines_of(panel: Panel, width: float) -> dict[str, np.ndarray]:
    """Side -> what is drawn of it in a line of that width."""
    sides = {colour: side for side, colour in SIDE_COLOURS.items()}
    lines = [line for line in panel_figure(panel).axes[0].lines if line.get_linewidth() == width]
    return {sides[str(line.get_color())]: np.asarray(line.get_ydata()) for line in lines if line.get_color() in sides}


def test_forces_are_drawn_along_their_axes(whole: Calibration) -> None:
    walk = whole.trial("walk")
    force = np.zeros((len(walk.body.time), 2, 3))
    force[:, 0] = 10.0, 100.0, -5.0
    panels = forces_chart(walk.body.time, force, walk.loads.reactions.valid_legs, "w").panels
    for panel, along in zip(panels, (100.0, 10.0, -5.0), strict=True):
        assert np.unique(lines_of(panel, 1.4)["r"]) == pytest.approx(along), panel.label


def test_moments_are_per_body_mass(whole: Calibration) -> None:
    loads = whole.trial("walk").loads
    hip = next(p for p in charts(whole)["moments"].panels if p.label.startswith("Hip flexion"))
    moment = moment_of(loads.final, "hip_flexion_r") / whole.model.subject.mass
    sheet = SheetRecording(told(whole).page_data["trials"][0])
    np.testing.assert_allclose(sheet.time, whole.trial("walk").body.time, atol=1e-6)
    expected = sheet.layout.lay("r", np.where(loads.reactions.valid_r, moment, np.nan))[1]
    assert lines_of(hip, 1.5)["r"] == pytest.approx(expected, abs=PACKED * np.ptp(moment), nan_ok=True)


def test_a_moved_parameter_is_drawn_with_its_standard_error() -> None:
    def row(side: str, error: float | None) -> Row:
        return Row(
            name=f"hip_{side}.pelvis.ant", words="hip centre in the pelvis, forward", place="", direction="forward",
            unit="mm", nominal=10.0, fitted=13.0, error=error, status="fitted",
        )  # fmt: skip

    chart = parameters_chart((Group("Hip", (row("r", 2.0),), (row("l", None),), 0),))
    bars = {
        str(line.get_color()): (list(line.get_xdata()), list(line.get_ydata()))
        for line in panel_figure(chart.panels[0]).axes[0].lines
        if line.get_linewidth() == 1.2
    }
    assert bars[SIDE_COLOURS["r"]][0] == pytest.approx([1.0, 5.0])
    assert bars[SIDE_COLOURS["l"]][0] == pytest.approx([3.0, 3.0])
    assert bars[SIDE_COLOURS["r"]][1][0] < 0.0 < bars[SIDE_COLOURS["l"]][1][0], "the right side above the left one"


def test_all_axes_have_units_and_legends_lie_inside_their_figures(whole: Calibration) -> None:
    for chart in charts(whole).values():
        figure = chart_figure(chart)
        for axes in figure.axes:
            assert axes.get_xlabel().endswith((")", "%)"))
            assert axes.get_ylabel() or axes.get_yticklabels(), chart.name
        legend = figure.legends[0].get_window_extent()
        assert figure.bbox.x0 <= legend.x0 and legend.x1 <= figure.bbox.x1, chart.name
        drawn = [axes.get_tightbbox() for axes in figure.axes]
        assert legend.y0 >= 0 and legend.y1 <= min(box.y0 for box in drawn if box is not None), chart.name


def test_global_settings_of_matplotlib_stay(whole: Calibration) -> None:
    before = dict(matplotlib.rcParams)
    chart_figure(charts(whole)["marker_errors"])
    assert dict(matplotlib.rcParams) == before


def test_changes_are_those_of_the_summary(whole: Calibration) -> None:
    """Drawn, and as `gait/moments.py` computes them."""
    written = summary(whole)["trials"]["walk"]["torque_change_bwh"]
    (panel,) = charts(whole)["moment_change"].panels
    widths = sorted(bar.get_width() for bar in panel_figure(panel).axes[0].patches)
    assert widths == pytest.approx(sorted(written.values()), rel=SAME)
    walk = whole.trial("walk")
    drawn = layout(walk.body, walk.loads.reactions, walk.events)
    numbers = moment_numbers(whole.model, drawn, walk.loads.final, walk.loads.nominal)
    assert {n.name: n.change_bwh for n in numbers} == pytest.approx(written, rel=SAME)


def test_limits_of_the_residuals(whole: Calibration) -> None:
    trial = whole.trial("walk")
    limits = residual_limits(whole.model.parameters, trial.body.q, trial.loads.reactions, trial.recording.plates)
    assert limits.peak_force == pytest.approx(1400.0)
    assert limits.force == pytest.approx(70.0)
    assert limits.moment == pytest.approx(0.01 * limits.centre_height * 1400.0)
    assert 0.5 < limits.centre_height < 1.5


@pytest.mark.parametrize("name", ["$x$", "a$b", "<b>", "\u202eabc", "中文", "x" * 300, "", "\n\t"])
def test_names_are_no_markup_in_figures(name: str) -> None:
    shown = plain(name)
    assert len(shown.replace("\\$", "$")) <= 26
    assert shown.replace("\\$", "").count("$") == 0
    assert shown.isprintable()


def test_everything_has_words() -> None:
    assert all(coordinate_words(n).angle != "positive" for n in COORDINATES if not is_translation(n))
    assert len({parameter_words(n) + n.split(".")[0][-2:] for n in JP_NAMES}) == len(JP_NAMES)
    assert all(parameter_words(n) for n in IP_NAMES)
    assert segment_words("forearm_hand_l") == "left forearm and hand" and joint_words("hip_l") == "left hip"
    assert len({segment_words(s) for s in SEGMENTS}) == len(SEGMENTS)
    assert explained("hip_r.pelvis.ant is far") == "hip_r.pelvis.ant (right hip centre in the pelvis, forward) is far"
    assert explained("file.trc and thigh_r.mass") == "file.trc and thigh_r.mass (right thigh: mass)"


def test_moments_are_named_once(whole: Calibration) -> None:
    names = moment_names(whole.model)
    assert sorted(names) == sorted((*(n for n in COORDINATES if not n.startswith("pelvis")), *REACTIONS))
    assert names.index("knee_adduction_r") == names.index("knee_angle_r") + 1


def test_normal_bands_lie_behind_the_panels_of_their_variables(whole: Calibration) -> None:
    """In the units that are drawn; without a gait cycle there is none, and the legend does not promise one."""
    percent, mean, sd = np.array([0.0, 100.0]), np.array([0.5, 0.5]), np.array([0.1, 0.1])
    common = {"signs": BAND_SIGNS["clinical"], "percent": percent, "mean": mean, "sd": sd}
    bands = {
        name: NormalBand(variable=name, unit=unit, **common)
        for name, unit in (("knee_angle_moment", "N m/kg"), ("hip_flexion", "rad"))
    }
    for kind, title, low, high in (
        ("moments", "Knee flexion", -0.6, -0.4),
        ("angles", "Hip flexion", np.degrees(0.4), np.degrees(0.6)),
    ):
        chart = charts(whole, bands)[kind]
        assert NORMAL_KEY in chart.keys
        for panel in chart.panels:
            (axes,) = panel_figure(panel).axes
            edges = [line.get_ydata() for line in axes.lines if line.get_linestyle() == ":"]
            assert bool(edges) == panel.label.startswith(title)
            if edges:
                np.testing.assert_allclose(edges, [np.full(POINTS, low), np.full(POINTS, high)])
    by_time = charts(fake_calibration(cycles=False), bands)["angles"]
    assert NORMAL_KEY not in by_time.keys
