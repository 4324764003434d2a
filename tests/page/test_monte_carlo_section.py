"""A Monte Carlo study in the report of its person: figures, what the marker error means, and nothing twice."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from pathlib import Path

import pytest

from gaitcal.figures.monte_carlo import write_monte_carlo_figures
from gaitcal.montecarlo.case import nominal_case
from gaitcal.montecarlo.leg_torques import TORQUES
from gaitcal.montecarlo.settings import MonteCarloSettings, Plan
from gaitcal.montecarlo.statistics import expect, statistics
from gaitcal.montecarlo.study import MonteCarloStudy
from gaitcal.page import report_html
from gaitcal.page.monte_carlo import add_monte_carlo
from tests.fake_result import HOSTILE, Names, fake_calibration
from tests.montecarlo.test_statistics import made_up
from tests.page.test_report import ACTIVE, SECTIONS, Page

RMS = 1.5


@pytest.fixture(scope="module")
def study() -> MonteCarloStudy:
    draws = made_up(draws=30)
    return MonteCarloStudy(
        case=nominal_case(),
        settings=MonteCarloSettings(),
        plan=Plan(draws=30),
        draws=draws,
        statistics=statistics(draws),
        computed=30,
    )


@pytest.fixture(scope="module")
def figures(study: MonteCarloStudy, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return dict(write_monte_carlo_figures(study.statistics, None, tmp_path_factory.mktemp("figures")))


def test_figures_and_readings_stand_in_the_report(
    study: MonteCarloStudy, figures: dict[str, Path], tmp_path: Path
) -> None:
    path = tmp_path / "report.html"
    path.write_text(report_html(fake_calibration()), encoding="utf-8")
    assert add_monte_carlo(path, study, figures, RMS)
    first = path.read_text(encoding="utf-8")
    page = Page(first)
    assert page.sections == [*SECTIONS[:6], "montecarlo", *SECTIONS[6:]]
    assert page.tags & ACTIVE == {"img"}
    pictures = [value for name, value in page.attributes if name == "src"]
    assert len(pictures) == 4
    content = {base64.b64decode(p.removeprefix("data:image/svg+xml;base64,")) for p in pictures}
    assert content == {path.with_suffix(".svg").read_bytes() for path in figures.values()}
    text = " ".join(page.text.split())
    for cause, words in zip(expect(study.statistics, RMS), ("Joint parameters (JP)", "Marker noise (NP)"), strict=True):
        assert f"{words}: {'more than ' if cause.beyond else ''}{cause.level:.0f} % of the bounds" in text
        of = cause.torques
        knee = of[(of["torque"] == f"{TORQUES[3]}_l") & (of["grf"] == "foot")].iloc[0]
        assert f"<td>{knee.average:.2f}</td><td>{knee.p10:.2f} to {knee.p90:.2f}</td></tr>" in first
    assert "to 1.5 mm" in text and "10 degrees" in text

    assert add_monte_carlo(path, replace(study, plan=replace(study.plan, draws=4321)), figures, None)
    second = path.read_text(encoding="utf-8")
    assert Page(second).sections == page.sections, "replaced, not added"
    assert "4\u202f321 times" in second and "What this person's marker error means" not in second


def test_a_page_without_a_place_stays_as_it_is(
    study: MonteCarloStudy, figures: dict[str, Path], tmp_path: Path
) -> None:
    path = tmp_path / "report.html"
    path.write_text("<p>of an earlier version</p>", encoding="utf-8")
    assert not add_monte_carlo(path, study, figures, RMS)
    assert path.read_text(encoding="utf-8") == "<p>of an earlier version</p>"


def test_hostile_names_neither_forge_the_place_nor_run(
    study: MonteCarloStudy, figures: dict[str, Path], tmp_path: Path
) -> None:
    place = '<div id="montecarlo-begin" hidden></div>'
    path = tmp_path / "report.html"
    path.write_text(report_html(fake_calibration(Names(place, place, place))), encoding="utf-8")
    odd = replace(study, case=replace(study.case, name=HOSTILE))
    assert add_monte_carlo(path, odd, figures, RMS)
    page = Page(path.read_text(encoding="utf-8"))
    assert page.tags & ACTIVE == {"img"}
    assert not [k for k, _ in page.attributes if k.startswith("on")]
    assert not re.search(r"<script", path.read_text(encoding="utf-8"))
