"""Fitted joints against where people have them: the chi^2 of a place, when one is doubted, and what
is said of it.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import chdtri

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import ANATOMY, COVARIANCE, factor_prior
from gaitcal.errors import Code, Finding, Severity
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JP_INDEX, JP_NAMES, JP_TO_SI, Parameters
from gaitcal.quality.joint_positions import RARE, UNUSUAL, JointPosition, check_joint_positions
from gaitcal.quality.verdict import Judgement, judge
from gaitcal.study.cohort_prior import JointPrior
from tests.messages import check_finding, check_text, numbers

ROOT = Path(__file__).parents[2]
MODEL = published_model(static_only=True)
LEGS = tuple(name for name in JP_NAMES if name.split(".")[0][:-2] in LEG_JOINTS)
EXACT = ErrorSources(LEGS, np.zeros((len(LEGS), 1)), ("markers/walk/R.Knee/x",))


def moved(**by: float) -> Parameters:
    """Where all is expected, but for some parameters (`hip_r__pelvis__lat=0.03`, m and rad)."""
    offset = np.zeros(len(JP_NAMES))
    for name, d in by.items():
        offset[JP_INDEX[name.replace("__", ".")]] = d
    return drawn(offset)


def told(
    parameters: Parameters, influence: ErrorSources = EXACT, prior: JointPrior = ANATOMY
) -> list[Finding]:
    """What makes doubtful."""
    found = check_joint_positions(MODEL, parameters, influence, prior)
    return [finding for finding in found if finding.severity is not Severity.INFO]


def drawn(offset: Array) -> Parameters:
    return MODEL.nominal.with_joint(JP_NAMES, MODEL.nominal.joint + ANATOMY.mean + offset)


def test_squares_of_drawn_people_are_chi_squared() -> None:
    """Of people who scatter by P and fits that miss them by E, as many are so far away as the
    probability says.
    """
    rng = np.random.default_rng(4)
    at = [JP_INDEX[f"hip_r.pelvis.{way}"] for way in ("ant", "sup", "lat")]
    scatter, error = COVARIANCE[np.ix_(at, at)], np.diag([4e-3, 2e-3, 9e-3]) ** 2
    drawn = rng.multivariate_normal(np.zeros(3), scatter + error, size=4000)
    names = tuple(JP_NAMES[k] for k in at)
    found = [
        JointPosition(names=names, offset=d, scatter=scatter, error=error).probability
        for d in drawn
    ]
    for share in (0.5, 0.1, 0.02):
        assert np.mean(np.array(found) < share) == pytest.approx(
            share, abs=4 * np.sqrt(share / 4000)
        )


def test_a_hip_beside_its_socket_is_doubted_and_says_where() -> None:
    (one,) = told(moved(hip_r__pelvis__lat=0.040, hip_r__pelvis__sup=-0.006))
    check_finding(one, Code.JOINT_PLACE, Severity.WARNING, 40, 9, leg="r")
    assert one.weight > 1.0 and 6 not in numbers(one.found) and "joint_prior" in one.cure
    (left,) = told(moved(hip_l__pelvis__lat=-0.040))
    check_finding(left, Code.JOINT_PLACE, 40, leg="l")


@pytest.mark.parametrize(
    ("far", "code"),
    [
        ({"hip_l__pelvis__lat": -0.030}, Code.JOINT_PLACE),
        ({"knee_l__thigh__sup": -0.034}, Code.KNEE_AXIS),
    ],
)
def test_what_is_unusual_is_named_in_a_note_that_doubts_nothing(
    far: dict[str, float], code: Code
) -> None:
    (note,) = check_joint_positions(MODEL, moved(**far), EXACT, ANATOMY)
    distance = round(1e3 * abs(*far.values()))
    check_finding(note, code, Severity.INFO, 20, distance, leg="l", cure="")
    assert judge([note], ["walk"]).judgement is Judgement.TRUSTWORTHY
    assert (
        list(
            check_joint_positions(
                MODEL, moved(**{name: 0.7 * d for name, d in far.items()}), EXACT, ANATOMY
            )
        )
        == []
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_hips_that_are_too_far_apart_together_are_doubted(sign: float) -> None:
    """26 mm a hip is nobody's alone; both together 53 mm too far apart are (a child of 159 mm
    between the ASIS).
    """
    one_side = {"hip_r__pelvis__lat": sign * 0.026, "hip_r__thigh__lat": sign * 0.026}
    assert told(moved(**one_side)) == []
    (one,) = told(
        moved(**one_side, hip_l__pelvis__lat=-sign * 0.026, hip_l__thigh__lat=-sign * 0.026)
    )
    check_finding(one, Code.JOINT_PLACE, 999, 1000, 0.65, 0.82, leg="")


def test_a_knee_axis_beside_the_epicondyles_is_doubted() -> None:
    (one,) = told(moved(knee_l__thigh__sup=-0.045))
    check_finding(one, Code.KNEE_AXIS, 45, leg="l")
    (turned,) = told(moved(knee_r__shank__trans=np.deg2rad(50.0)))
    check_finding(turned, Code.KNEE_AXIS, 50, leg="r")


def test_what_people_scatter_by_accuses_nobody() -> None:
    """Joints drawn from anatomy's own population, and those within 10 mm and 10 degrees, as
    simulated ones are.
    """
    rng = np.random.default_rng(0)
    root = factor_prior(JP_NAMES, None)
    found = sum(len(told(drawn(root @ rng.normal(size=len(JP_NAMES))))) for _ in range(300))
    looked_at = 300 * (
        1 + len({name.rpartition(".")[0] for name in LEGS})
    )  # joints as segments see them, hips apart
    assert found <= looked_at * RARE + 4 * np.sqrt(looked_at * RARE)
    near = np.array(
        [0.010 if name.endswith(("ant", "sup", "lat")) else np.deg2rad(10) for name in JP_NAMES]
    )
    for _ in range(100):
        assert told(drawn(rng.uniform(-1.0, 1.0, len(JP_NAMES)) * near)) == []


def test_a_wide_error_bar_of_the_markers_excuses_and_that_of_the_prior_does_not() -> None:
    far = moved(hip_r__pelvis__lat=0.040)
    wide = np.zeros((len(LEGS), 1))
    wide[LEGS.index("hip_r.pelvis.lat")] = 0.010
    assert told(far, ErrorSources(LEGS, wide, ("markers/walk/R.Thigh/x",))) == []
    assert len(told(far, ErrorSources(LEGS, wide, ("nominal/hip_r.pelvis.lat",)))) == 1


def test_what_a_study_knows_of_a_person_is_expected_but_a_wide_prior_is_no_excuse() -> None:
    far = moved(hip_r__pelvis__lat=0.040, hip_r__thigh__lat=0.040)
    mean = ANATOMY.mean.copy()
    mean[[JP_INDEX["hip_r.pelvis.lat"], JP_INDEX["hip_r.thigh.lat"]]] = 0.035
    assert told(far, prior=replace(ANATOMY, mean=mean)) == []
    assert len(told(far, prior=replace(ANATOMY, covariance=100.0 * ANATOMY.covariance))) == 1


def test_too_few_markers_to_show_moving_skin_are_told() -> None:
    markers = MODEL.markers
    thigh = [k for k, segment in enumerate(markers.segments) if segment == "thigh_r"]
    weight = markers.weight.copy()
    weight[thigh[2:]] = 0.0
    few = replace(MODEL, markers=replace(markers, weight=weight))
    far = moved(knee_r__thigh__sup=-0.045)
    found = [
        next(check_joint_positions(model, far, EXACT, ANATOMY)).found for model in (MODEL, few)
    ]
    assert "too few markers" not in found[0]
    check_text(found[1], 2)


def test_pages_tell_from_where_on_a_joint_is_named() -> None:
    """In one direction alone, without errors of the fit's own markers."""

    def limits(joint: str, segment: str, *ways: str) -> list[str]:
        at = [k for k, name in enumerate(JP_NAMES) if name.startswith(f"{joint}.{segment}.")]
        curvature = np.linalg.inv(COVARIANCE[np.ix_(at, at)])
        size = {
            JP_NAMES[k].split(".")[2]: curvature[i, i] ** -0.5 / JP_TO_SI[k]
            for i, k in enumerate(at)
        }
        return [
            " ".join(f"{np.sqrt(chdtri(len(at), level)) * size[way]:.0f}" for way in ways)
            for level in (RARE, UNUSUAL)
        ]

    told = (ROOT / "docs/explanation/verdict.md").read_text(encoding="utf-8").splitlines()
    for start, found in (
        ("| hip", limits("hip_r", "pelvis", "lat", "sup", "ant")),
        ("| knee axis, in the thigh", limits("knee_r", "thigh", "sup", "trans", "front")),
        ("| talocrural", limits("talocrural_r", "shank", "lat", "trans")),
        (
            "| subtalar",
            [
                " ".join(of)
                for of in zip(
                    *(limits("subtalar_r", s, "trans") for s in ("talus", "foot")), strict=True
                )
            ],
        ),
    ):
        row = next(line for line in told if line.startswith(start))
        assert [" ".join(re.findall(r"\d+", cell)) for cell in row.split("|")[2:4]] == found


def test_a_parameter_three_scatters_of_people_off_is_named_however_wide_its_error_bar() -> None:
    """Nothing of it is doubted, and at two scatters nothing is said."""
    wide = np.zeros((len(LEGS), 1))
    wide[LEGS.index("knee_r.thigh.ant")] = 0.030
    errors = ErrorSources(LEGS, wide, ("markers/walk/R.Thigh/x",))
    far, near = moved(knee_r__thigh__ant=0.031), moved(knee_r__thigh__ant=0.020)
    (found,) = check_joint_positions(MODEL, far, errors, ANATOMY)
    assert found.severity is Severity.INFO and found.code is Code.KNEE_AXIS and found.leg == "r"
    assert list(check_joint_positions(MODEL, near, errors, ANATOMY)) == []
