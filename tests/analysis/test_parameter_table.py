"""The table of parameters, `parameters.csv`."""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.analysis.parameter_table import parameter_table
from gaitcal.calibration.joint_prior import combine_joint_priors
from gaitcal.model.parameters import JP_NAMES
from gaitcal.study.settings import ParameterPriorTable
from tests.fake_result import fake_calibration


def test_joint_parameters_have_their_prior_in_the_unit_of_the_row() -> None:
    given = {"hip_r.pelvis.ant": ParameterPriorTable(mean=-7.0, deviation=6.0)}
    calibration = replace(fake_calibration(), joint_prior=combine_joint_priors(given))
    table = parameter_table(calibration).set_index("name")
    row = table.loc["hip_r.pelvis.ant"]
    assert row["unit"] == "mm"
    assert row["prior_mean"] - row["nominal"] == pytest.approx(-7.0)
    assert row["prior_sd"] == pytest.approx(6.0)
    # Axes are in degrees, and every joint parameter has a prior by anatomy.
    hinge = table.loc["knee_r.thigh.front"]
    anatomy = combine_joint_priors({})
    at = anatomy.names.index("knee_r.thigh.front")
    assert hinge["prior_sd"] == pytest.approx(np.rad2deg(np.sqrt(anatomy.covariance[at, at])))
    assert set(table.index[table["prior_sd"].notna()]) == set(JP_NAMES)


def test_without_a_prior_the_columns_are_empty() -> None:
    table = parameter_table(replace(fake_calibration(), joint_prior=None))
    assert table[["prior_mean", "prior_sd"]].isna().all(axis=None)
