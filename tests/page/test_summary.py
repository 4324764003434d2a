"""What the page says of the numbers: verdicts, largest changes, signs, and the order of markers."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gaitcal.errors import Severity
from gaitcal.faults.force_diagnosis import beyond_expected
from gaitcal.gait.moments import parameter_words
from gaitcal.model.linkage import COORDINATE_INDEX
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from gaitcal.page.joints import joint_blocks
from gaitcal.page.plain_data import number
from gaitcal.page.summary import top_lines
from gaitcal.page.trust import marker_fits
from gaitcal.session.parameter_words import blind_spots, counts_sentence, joint_groups, range_of_motion
from gaitcal.session.result import Calibration, Stage
from gaitcal.session.trial_result import RmsErrors
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.settings import CalibrationSettings, ParameterPriorTable
from tests.fake_result import fake_calibration, held

SAID = CalibrationSettings(joint_prior={name: ParameterPriorTable(deviation=3.0) for name in JP_NAMES})


@pytest.fixture(scope="module")
def whole() -> Calibration:
    return fake_calibration()


def agreement(calibration: Calibration) -> dict[str, str]:
    """The line of how model, markers and forces agree."""
    return top_lines(calibration, ())[1]


def with_final(calibration: Calibration, **changes: np.ndarray) -> Calibration:
    """Other generalised forces with the calibrated model, in the one gait trial."""
    walk, *others = calibration.trials
    assert walk.loads is not None
    moments = {**walk.loads.moments, Stage.JP_IP: replace(walk.loads.final, **changes)}
    assert walk.loads.final is walk.loads.moments[Stage.JP_IP]
    return replace(calibration, trials=(replace(walk, loads=replace(walk.loads, moments=moments)), *others))


@pytest.mark.parametrize(("floor", "tone"), [(1.0, "good"), (0.7, "plain"), (0.5, "plain")])
def test_the_tone_follows_from_error_over_floor(whole: Calibration, floor: float, tone: str) -> None:
    """6 mm over what each joint reaches, 5 mm times `floor`; over the rigid floor where there is no joint."""
    walk, *others = whole.trials
    nearer = replace(walk.floor, distance=floor * walk.floor.distance)
    assert walk.joint_floor is not None
    lower = replace(walk.floor, distance=0.1 * walk.floor.distance)
    by_joints = replace(walk, floor=lower, joint_floor=replace(walk.joint_floor, errors=nearer), loads=None)
    for trial in (by_joints, replace(walk, floor=nearer, joint_floor=None, loads=None)):
        line = agreement(replace(whole, trials=(trial, *others)))
        assert line["tone"] == tone and line["text"].startswith("Marker fit ")


def test_a_ratio_is_error_over_floor() -> None:
    fit = RmsErrors(label="leg", nominal=9.0, calibrated=6.0, floor=4.0)
    assert fit.ratio == pytest.approx(1.5)
    assert replace(fit, rigid=False).ratio is None


@pytest.mark.parametrize(("part", "factor"), [("residual_force", 20.0), ("residual_moment", 60.0)])
def test_one_residual_above_its_limit_is_beyond_its_errors(whole: Calibration, part: str, factor: float) -> None:
    assert (agreement(whole)["tone"], "too high" in agreement(whole)["text"]) == ("good", False)
    final = whole.trials[0].loads
    assert final is not None
    larger = with_final(whole, **{part: factor * getattr(final.final, part)})
    larger = replace(larger, trials=(held(larger.trials[0]), *larger.trials[1:]))
    assert (agreement(larger)["tone"], "too high" in agreement(larger)["text"]) == ("look", True)
    loads = larger.trials[0].loads
    assert loads is not None and loads.expected is not None
    (told,) = beyond_expected("walk", loads.expected, trunk_seen=True)
    assert told.severity is Severity.WARNING and told.weight > 1.0, "what the page holds up, the verdict does"
    assert f"{loads.expected.force.limit:.0f} N or {loads.expected.moment.limit:.0f} N·m" in told.found


def test_numbers_are_set_with_minus_signs_and_thin_spaces() -> None:
    assert number(-1234.56) == "\N{MINUS SIGN}1\u202f234.6"
    assert number(0.04, 1, True) == "0.0" and number(0.06, 1, True) == "+0.1" and number(-0.04) == "0.0"
    assert number(None) == number(float("nan")) == "\N{EN DASH}"


def test_markers_with_little_weight_come_last_and_the_worst_first(whole: Calibration) -> None:
    walk = whole.trials[0]
    errors = walk.calibrated.errors
    size = np.linspace(1.0, 2.0, len(errors.labels))
    weight = np.ones(len(errors.labels))
    weight[-1] = 0.5
    weighted = replace(walk.calibrated, errors=replace(errors, distance=errors.distance * size, weight=weight))
    assert [m.label for m in marker_fits(replace(walk, calibrated=weighted))] == [
        *reversed(errors.labels[:-1]),
        errors.labels[-1],
    ]


def test_a_change_is_fitted_minus_nominal(whole: Calibration) -> None:
    rows = {row.name: row for group in joint_groups(whole) for row in (*group.right, *group.left)}
    assert rows["hip_l.pelvis.ant"].change == pytest.approx(4.0)  # mm
    assert (rows["hip_l.pelvis.ant"].side, rows["hip_l.pelvis.ant"].part) == ("l", "hip")


@pytest.mark.parametrize(
    ("settings", "learnt", "kept"),
    [
        (CalibrationSettings(protocol="published"), None, "keep their nominal values"),
        (CalibrationSettings(), None, "stay near their nominal values"),
        (CalibrationSettings(), False, "stay near their nominal values"),
        (CalibrationSettings(), True, "stay near what the cohort has"),
        (SAID, None, "stay near what the study file expects"),
        (SAID, True, "stay near what the cohort has"),
    ],
)
def test_what_becomes_of_an_unseen_parameter(
    whole: Calibration, settings: CalibrationSettings, learnt: bool | None, kept: str
) -> None:
    """`learnt`: by a cohort, of all of them; one that teaches nothing leaves them at their nominal values."""
    prior = None
    if learnt is not None:
        names = whole.unidentifiable if learnt else ()
        count = len(names)
        prior = JointPrior(
            names=names, mean=np.zeros(count), covariance=1e-4 * np.eye(count), file="priors.json", people=12
        )
    person = replace(whole, study=replace(whole.study, settings=settings, joint_prior=prior))
    assert any(kept in sentence for sentence in blind_spots(person))
    ending = counts_sentence(person)
    assert ending.endswith("All others keep their nominal values.")
    assert ("stays near what the cohort has" in ending) == bool(learnt)
    shown = json.dumps(joint_blocks(person))
    assert ("12 people of a cohort (priors.json)" in shown) == (prior is not None)


def test_an_unseen_parameter_that_a_cohort_moves_is_shown(whole: Calibration) -> None:
    name = whole.unidentifiable[0]
    words = parameter_words(name) + ", not determined"
    assert words not in json.dumps(joint_blocks(whole))
    moved = whole.model.parameters.with_joint((name,), whole.nominal.parameters.joint[[JP_INDEX[name]]] + 0.1)
    person = replace(whole, model=whole.model.with_parameters(moved))
    (row,) = [row for g in joint_groups(person) for row in (*g.right, *g.left) if row.name == name]
    shown = json.dumps(joint_blocks(person))
    assert words in shown and f'"{row.fitted:.1f}"' in shown


@pytest.mark.parametrize(("share", "advice"), [(0.01, "are needed. Add an isolated trial"), (1.0, "do not move it in")])
def test_what_would_show_an_unseen_parameter(whole: Calibration, share: float, advice: str) -> None:
    """The subtalar joint moves by some 34 degrees, or by a hundredth of that."""
    walk = whole.trials[0]
    still = replace(walk.calibrated, coefficients=share * walk.calibrated.coefficients)
    person = replace(whole, trials=(replace(walk, calibrated=still),))
    angle = np.degrees(walk.body.q[:, COORDINATE_INDEX["subtalar_angle_r"]])
    assert range_of_motion(person, "subtalar_r") == pytest.approx(share * np.ptp(angle))
    (sentence,) = [text for text in blind_spots(person) if "subtalar" in text]
    assert advice in sentence
