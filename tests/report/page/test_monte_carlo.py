"""A Monte Carlo study in a sheet: its numbers, ranked; replaced and never twice; names are data."""

import json
from dataclasses import replace
from typing import Any

import pandas as pd
import pytest

from gaitcal.model.linkage import LEGS, list_joint_coordinates
from gaitcal.montecarlo.case import make_nominal_case
from gaitcal.montecarlo.draw import LEG_TORQUES
from gaitcal.montecarlo.draw_statistics import (
    compute_statistics,
    estimate_expected_errors,
    select_levels,
)
from gaitcal.montecarlo.draw_study import MonteCarloStudy
from gaitcal.montecarlo.protocol import MonteCarloSettings, Plan, ReactionFrame, Varied
from gaitcal.report.page.monte_carlo_sections import (
    PART,
    add_monte_carlo,
    build_monte_carlo_blocks,
    collect_expected_errors,
)
from gaitcal.report.page.page_data import build_calibration_page_data
from gaitcal.report.page.plain_data import format_number
from tests.fake_result import HOSTILE, fake_calibration
from tests.montecarlo.test_draw_statistics import made_up
from tests.report.page.walked_blocks import headings, rows_of, tables, words

RMS = 1.5


def study_of(draws: pd.DataFrame) -> MonteCarloStudy:
    return MonteCarloStudy(
        case=make_nominal_case(),
        settings=MonteCarloSettings(),
        plan=Plan(draws=30),
        draws=draws,
        statistics=compute_statistics(draws),
        computed=30,
    )


@pytest.fixture(scope="module")
def study() -> MonteCarloStudy:
    return study_of(made_up(draws=30))


@pytest.fixture(scope="module")
def contributions() -> pd.DataFrame:
    names = {
        "knee_l.thigh.front": 70.0,
        "hip_l.pelvis.ant": 20.0,
        "hip_r.pelvis.ant": 8.0,
        "thigh_l.mass": 2.0,
    }
    return pd.DataFrame(
        [
            {
                "torque": torque,
                "grf": f.value,
                "parameter": p,
                "kind": "ip" if "mass" in p else "jp",
                "share": share,
            }
            for torque in LEG_TORQUES
            for f in ReactionFrame
            for p, share in names.items()
        ]
    )


def test_expected_errors_are_ranked_and_those_of_the_statistics(study: MonteCarloStudy) -> None:
    found = collect_expected_errors(study.statistics, RMS, "r")["knee_adduction_r"]
    assert [e.average for e in found] == sorted((e.average for e in found), reverse=True)
    assert {e.varied for e in found} == {Varied.JP, Varied.IP, Varied.NOISE}
    for cause in estimate_expected_errors(study.statistics, RMS, "r"):
        (ours,) = (e for e in found if e.varied is cause.varied)
        of = cause.torques[
            (cause.torques["torque"] == "knee_adduction_r") & (cause.torques["grf"] == "lab")
        ].iloc[0]
        assert (ours.average, ours.low, ours.high) == pytest.approx(
            (of["average"], of["p10"], of["p90"])
        )
        assert ours.level == cause.level
    (inertial,) = (e for e in found if e.varied is Varied.IP)
    last = select_levels(study.statistics, Varied.IP, "knee_adduction_r", ReactionFrame.LAB).iloc[
        -1
    ]
    assert (inertial.level, inertial.average) == (last["level"], last["average"])


def test_the_knee_adduction_moment_comes_first_in_both_units(study: MonteCarloStudy) -> None:
    blocks = build_monte_carlo_blocks(study, RMS)
    assert headings(blocks)[1] == "Expected error of your knee adduction moment, RMS over the trial"
    rows = rows_of(tables(blocks, "Left")[0])
    found = collect_expected_errors(study.statistics, RMS, "l")["knee_adduction_l"]
    subject = study.case.subject
    assert [row[0] for row in rows.values()] == [format_number(e.average, 2) for e in found]
    to_kg = subject.bwh / 100.0 / subject.mass
    assert [row[1] for row in rows.values()] == [format_number(to_kg * e.average, 3) for e in found]
    assert len(tables(blocks, "Left")) == len(list_joint_coordinates(LEGS["l"])) + 1, (
        "adduction, and what a leg has"
    )


def test_without_a_marker_error_every_source_is_at_its_highest_level(
    study: MonteCarloStudy,
) -> None:
    blocks = build_monte_carlo_blocks(study)
    assert "Each source by itself, at the highest level" in words(blocks)
    assert any("up to 10.0 mm and 10.0 deg" in row for row in rows_of(tables(blocks, "Right")[0]))


def test_a_marker_error_beyond_the_study_is_said() -> None:
    blocks = build_monte_carlo_blocks(study_of(made_up(draws=30)), 50.0)
    assert sum("and more than that" in row for row in rows_of(tables(blocks, "Right")[0])) == 2


def test_parameters_are_ranked_by_their_part_of_the_variance(
    study: MonteCarloStudy, contributions: pd.DataFrame
) -> None:
    rows = rows_of(tables(build_monte_carlo_blocks(study, RMS, contributions), "Parameter")[0])
    assert rows == {
        "knee axis in the thigh, frontal tilt": ["70"],
        "hip centre in the pelvis, forward": ["20"],
        "joint parameters elsewhere": ["8"],
        "inertial parameters (1)": ["2"],
    }


def test_a_study_joins_the_sheet_and_replaces_an_earlier_one(
    study: MonteCarloStudy, contributions: pd.DataFrame
) -> None:
    sheet = build_calibration_page_data(fake_calibration())
    before = json.dumps(sheet)
    first = add_monte_carlo(sheet, study, marker_rms=RMS, contributions=contributions)
    assert json.dumps(sheet) == before, "the sheet that was given stays as it is"
    kept = [b for b in first["sections"]["trust"] if b.get("part") != PART]
    assert kept == sheet["sections"]["trust"] and len(first["sections"]["trust"]) > len(kept)
    longer = replace(study, plan=replace(study.plan, draws=4321))
    second = add_monte_carlo(first, longer)
    text = words(second["sections"]["trust"])
    assert text.count("A Monte Carlo study of trial") == 1 and "4\u202f321 times" in text
    assert "Which parameter matters" not in text
    json.dumps(second, allow_nan=False)


def test_failed_draws_open_convergence_and_hostile_names_are_said(study: MonteCarloStudy) -> None:
    draws = made_up(draws=30)
    draws.loc[draws["draw"] == 0, "failure"] = "did not settle"
    odd = study_of(draws)
    text = words(
        build_monte_carlo_blocks(
            replace(odd, case=replace(odd.case, name=HOSTILE), notes=("kept",))
        )
    )
    assert (
        "12 of 360 draws did not converge" in text
        and "More draws are needed" in text
        and "kept." in text
    )
    assert "\u202e" not in text and "<script>" in text


def test_a_set_that_was_not_disturbed_is_left_out() -> None:
    blocks: list[dict[str, Any]] = build_monte_carlo_blocks(
        study_of(made_up(draws=30, sets=("jp",))), RMS
    )
    assert len(rows_of(tables(blocks, "Right")[0])) == 1
