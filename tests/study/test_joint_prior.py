"""What a study file says of joint parameters before any trial: names, means, deviations, and who
comes first.
"""

from pathlib import Path

import numpy as np
import pytest

from gaitcal.calibration.joint_prior import COVARIANCE, MEAN, combine_joint_priors, select_prior
from gaitcal.errors import Code
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.settings import CalibrationSettings, ParameterPriorTable
from gaitcal.study.study import Study
from gaitcal.study.study_file import load_study_file
from tests.messages import check_text, refuses
from tests.refusal import refusal
from tests.synthetic_studies import write_synthetic_study

HIPS = ("hip_r.pelvis.ant", "hip_r.thigh.ant")


def said(**tables: dict[str, float]) -> JointPrior:
    """`hip__pelvis__ant` for `hip.pelvis.ant`."""
    told = {
        name.replace("__", "."): ParameterPriorTable.model_validate(table)
        for name, table in tables.items()
    }
    return combine_joint_priors(told)


def test_nothing_said_is_anatomy() -> None:
    prior = combine_joint_priors({})
    assert prior.names == JP_NAMES and not prior.describe_fallback(JP_NAMES)
    np.testing.assert_array_equal(prior.mean, MEAN)
    np.testing.assert_array_equal(prior.covariance, COVARIANCE)


def test_means_and_deviations_change_and_correlations_stay() -> None:
    prior = said(
        hip__pelvis__ant={"mean": -7.0, "deviation": 6.0}, hip__thigh__ant={"deviation": 3.0}
    )
    mean, covariance = select_prior(HIPS, prior)
    np.testing.assert_allclose(mean, [-0.007, 0.0])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.006, 0.003])
    correlation = 12.0 / np.hypot(12.0, 4.0)  # by the table: 12 mm, 4 mm apart
    assert covariance[0, 1] == pytest.approx(0.006 * 0.003 * correlation)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    others = [k for k, name in enumerate(JP_NAMES) if not name.startswith(("hip_r.", "hip_l."))]
    np.testing.assert_array_equal(
        prior.covariance[np.ix_(others, others)], COVARIANCE[np.ix_(others, others)]
    )
    check_text(prior.describe_fallback(HIPS))
    assert not prior.describe_fallback(("hip_r.pelvis.sup",))


def test_the_left_is_the_mirror_image_and_what_is_said_of_a_side_comes_first() -> None:
    prior = said(
        hip_l__pelvis__ant={"mean": 1.0}, hip__pelvis__ant={"mean": 4.0, "deviation": 5.0},
        hip__pelvis__lat={"mean": 3.0}, knee__thigh__front={"mean": 2.0},
        hip_l__thigh__lat={"mean": 8.0},
    )  # fmt: skip
    at = {name: float(prior.mean[k]) for name, k in JP_INDEX.items()}
    assert (at["hip_r.pelvis.ant"], at["hip_l.pelvis.ant"]) == pytest.approx((0.004, 0.001))
    assert prior.covariance[(JP_INDEX["hip_l.pelvis.ant"],) * 2] == pytest.approx(0.005**2)
    assert (at["hip_r.pelvis.lat"], at["hip_l.pelvis.lat"]) == pytest.approx((0.003, -0.003))
    assert (at["knee_r.thigh.front"], at["knee_l.thigh.front"]) == pytest.approx(
        np.deg2rad((2.0, -2.0))
    )
    assert (at["hip_r.thigh.lat"], at["hip_l.thigh.lat"]) == pytest.approx((0.0, 0.008))


def test_a_cohort_comes_before_the_study_file() -> None:
    learnt = JointPrior(
        names=HIPS[:1], mean=np.array([0.002]), covariance=np.eye(1) * 1e-6, notes=("lean",)
    )
    told = {
        "hip.pelvis.ant": ParameterPriorTable(mean=9.0),
        "hip.thigh.ant": ParameterPriorTable(mean=5.0),
    }
    prior = combine_joint_priors(told, learnt)
    mean, covariance = select_prior(HIPS, prior)
    np.testing.assert_allclose(mean, [0.002, 0.005])
    np.testing.assert_allclose(covariance, np.diag([1e-6, 160e-6]))
    assert prior.describe_fallback(HIPS) != prior.describe_fallback(HIPS[1:]) and prior.notes[
        1:
    ] == ("lean",)
    check_text(prior.describe_fallback(HIPS))
    check_text(prior.notes[0], "hip.pelvis.ant", "hip.thigh.ant")
    check_text(prior.describe_fallback(HIPS[1:]))


def written(folder: Path, text: str) -> Path:
    """A study file with so much more in its last table, `[calibration]`."""
    study = write_synthetic_study(folder)
    study.write_text(study.read_text() + text)
    return study


def test_it_is_written_and_read_back(tmp_path: Path) -> None:
    entries = (
        '"hip.pelvis.ant" = { mean = -7, deviation = 12.5 }\n"knee_r.thigh.trans" = { deviation = '
        "3 }\n"
    )
    text = f"\n[calibration.joint_prior]\n{entries}"
    file = load_study_file(written(tmp_path, text))
    told = file.calibration.joint_prior
    assert told["hip.pelvis.ant"] == ParameterPriorTable(mean=-7.0, deviation=12.5)
    again = tmp_path / "again.toml"
    again.write_text(file.to_toml(tmp_path))
    assert load_study_file(again).calibration == file.calibration
    assert Study.load(again).settings.joint_prior == told
    stored = CalibrationSettings.model_validate_json(
        file.calibration.model_dump_json(include={"joint_prior"})
    )
    assert stored.joint_prior == told, "as manifest.json has it"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            '"hip.pelvis.anr" = { mean = 1 }',
            "joint_prior: found 'hip.pelvis.anr', which is no joint parameter; did",
        ),
        ('"up" = { mean = 1 }', "allowed: those of parameters.csv, with or without their side"),
        ('"hip.pelvis.ant" = { sd = 1 }', "unknown key 'sd'; allowed: mean, deviation"),
        ('"hip.pelvis.ant" = { deviation = 0 }', "found 0; allowed: a number at least 0.01"),
    ],
)
def test_what_cannot_be_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    assert words in refusal(Study.load, written(tmp_path, f"\n[calibration.joint_prior]\n{text}\n"))


def test_only_the_evidence_asks_for_it(tmp_path: Path) -> None:
    study = written(tmp_path, '\n[calibration.joint_prior]\n"hip.pelvis.ant" = { mean = 1 }\n')
    study.write_text(study.read_text().replace("[calibration]\n", "[calibration]\njp = false\n"))
    with refuses(Code.PRIORS, "evidence", field="calibration.joint_prior", source="study.toml"):
        Study.load(study)
