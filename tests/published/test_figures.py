"""Figures: the boxes are the percentiles of the table; files are there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gaitcal.figures.monte_carlo import boxplot_figure, contribution_figure, write_monte_carlo_figures
from gaitcal.model.parameters import leg_parameters
from gaitcal.published.draw import TORQUES, MonteCarloContext
from gaitcal.published.protocol import ReactionFrame, Varied
from gaitcal.published.statistics import levels_of, statistics, variance_contributions
from tests.published.test_statistics import made_up


def test_boxes_are_the_percentiles() -> None:
    table = statistics(made_up(draws=60))
    figure = boxplot_figure(table, ReactionFrame.FOOT)
    axes = np.array(figure.axes).reshape(len(TORQUES) + 1, 4)
    assert [a.get_title() for a in axes[0]] == [
        "joint parameters (JP)",
        "inertial parameters (IP)",
        "JP and IP",
        "marker noise (NP)",
    ]
    row = levels_of(table, Varied.NOISE, "knee_adduction_l", ReactionFrame.FOOT).iloc[1]
    cell = axes[TORQUES.index("knee_adduction"), 3]
    lines = [line.get_ydata() for line in cell.lines]
    heights = {round(float(y), 9) for data in lines for y in np.ravel(data)}
    wanted = {round(float(row[name]), 9) for name in ("p10", "p25", "p50", "p75", "p90", "average")}
    boxes = {round(float(y), 9) for patch in cell.patches for y in patch.get_path().vertices[:, 1]}
    assert wanted <= heights | boxes
    assert axes[-1, 0].get_ylabel() == "marker\ndistance, mm"
    assert [t.get_text() for t in axes[-1, 0].get_xticklabels()] == ["25", "50", "100"]
    assert axes[0, 0].get_ylim()[0] == 0.0


def test_a_study_of_one_set_has_one_column() -> None:
    table = statistics(made_up(draws=30, sets=("ip",)))
    assert len(boxplot_figure(table, ReactionFrame.LAB, "mean", "r").axes) == len(TORQUES) + 1


def test_contributions_are_written_into_the_cells(context: MonteCarloContext) -> None:
    contributions = variance_contributions(context)
    figure = contribution_figure(contributions)
    rows = [t.get_text() for t in figure.axes[0].get_yticklabels()]
    assert len(rows) == len(leg_parameters("r")) + 2
    assert rows[0] == "hip: pelvis ant"
    texts = {(int(t.get_position()[0]), int(t.get_position()[1])): t.get_text() for t in figure.axes[0].texts}
    of = contributions[(contributions["torque"] == "knee_adduction_l") & (contributions["grf"] == "lab")]
    share = of.set_index("parameter")["share"]["knee_l.thigh.front"]
    assert texts[4, rows.index("knee: thigh front")] == f"{share:.0f}"
    image = figure.axes[0].images[0].get_array()
    assert image is not None
    np.testing.assert_allclose((np.asarray(image) ** 2).sum(axis=0), 100.0)


@pytest.mark.slow
def test_files(context: MonteCarloContext, tmp_path: Path) -> None:
    table = statistics(made_up(draws=30))
    written = write_monte_carlo_figures(table, variance_contributions(context), tmp_path)
    assert set(written) == {"figure_3_lab", "figure_3_foot", "figure_4_lab", "figure_4_foot", "contributions"}
    for path in written.values():
        assert path.read_bytes().startswith(b"\x89PNG")
        assert "<svg" in path.with_suffix(".svg").read_text(encoding="utf-8")
