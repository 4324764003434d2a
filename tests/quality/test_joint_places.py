"""Fitted joints against anatomy: chi^2 of a position, its limit, and the finding."""

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
from gaitcal.study.normal_prior import JointPrior
from tests.messages import check_finding, check_text, numbers

ROOT = Path(__file__).parents[2]
MODEL = published_model(static_only=True)
LEGS = tuple(name for name in JP_NAMES if name.split(".")[0][:-2] in LEG_JOINTS)
EXACT = ErrorSources(LEGS, np.zeros((len(LEGS), 1)), ("markers/walk/R.Knee/x",))


def moved(**by: float) -> Parameters:
    """Expected values, but for some parameters (`hip_r__pelvis__lat=0.03`, m and rad)."""
    offset = np.zeros(len(JP_NAMES))
    for name, d in by.items():
        offset[JP_INDEX[name.replace("__", ".")]] = d
    return drawn(offset)


def find_unusual_joints(
    parameters: Parameters, influence: ErrorSources = EXACT, prior: JointPrior = ANATOMY
) -> list[Finding]:
    """Find warnings on joint positions."""
    found = check_joint_positions(MODEL, parameters, influence, prior)
    return [finding for finding in found if finding.severity is not Severity.INFO]


def drawn(offset: Array) -> Parameters:
    return MODEL.nominal.with_joint(JP_NAMES, MODEL.nominal.joint + ANATOMY.mean + offset)


def test_squares_of_drawn_people_are_chi_squared() -> None:
    """Of people with covariance P and fits with errors E, as many are so far off as computed."""
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


def test_displaced_hip_is_reported_with_its_offset() -> None:
    (one,) = find_unusual_joints(moved(hip_r__pelvis__lat=0.040, hip_r__pelvis__sup=-0.006))
    check_finding(one, Code.JOINT_PLACE, Severity.WARNING, 40, 9, leg="r")
    assert one.weight > 1.0 and 6 not in numbers(one.found) and "joint_prior" in one.cure
    (left,) = find_unusual_joints(moved(hip_l__pelvis__lat=-0.040))
    check_finding(left, Code.JOINT_PLACE, 40, leg="l")


@pytest.mark.parametrize(
    ("far", "code"),
    [
        ({"hip_l__pelvis__lat": -0.030}, Code.JOINT_PLACE),
        ({"knee_l__thigh__sup": -0.034}, Code.KNEE_AXIS),
    ],
)
def test_unusual_position_is_a_note(far: dict[str, float], code: Code) -> None:
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
def test_unusual_hip_distance_is_reported(sign: float) -> None:
    """26 mm a hip is usual; both together 53 mm too far apart are not (a child, ASIS 159 mm)."""
    one_side = {"hip_r__pelvis__lat": sign * 0.026, "hip_r__thigh__lat": sign * 0.026}
    assert find_unusual_joints(moved(**one_side)) == []
    (one,) = find_unusual_joints(
        moved(**one_side, hip_l__pelvis__lat=-sign * 0.026, hip_l__thigh__lat=-sign * 0.026)
    )
    check_finding(one, Code.JOINT_PLACE, 999, 1000, 0.65, 0.82, leg="")


def test_displaced_knee_axis_is_reported() -> None:
    (one,) = find_unusual_joints(moved(knee_l__thigh__sup=-0.045))
    check_finding(one, Code.KNEE_AXIS, 45, leg="l")
    (turned,) = find_unusual_joints(moved(knee_r__shank__trans=np.deg2rad(50.0)))
    check_finding(turned, Code.KNEE_AXIS, 50, leg="r")


def test_usual_scatter_is_not_reported() -> None:
    """Joints drawn from the population, and those within 10 mm and 10 degrees."""
    rng = np.random.default_rng(0)
    root = factor_prior(JP_NAMES, None)
    found = sum(
        len(find_unusual_joints(drawn(root @ rng.normal(size=len(JP_NAMES))))) for _ in range(300)
    )
    looked_at = 300 * (
        1 + len({name.rpartition(".")[0] for name in LEGS})
    )  # joints as segments see them, hips apart
    assert found <= looked_at * RARE + 4 * np.sqrt(looked_at * RARE)
    near = np.array(
        [0.010 if name.endswith(("ant", "sup", "lat")) else np.deg2rad(10) for name in JP_NAMES]
    )
    for _ in range(100):
        assert find_unusual_joints(drawn(rng.uniform(-1.0, 1.0, len(JP_NAMES)) * near)) == []


def test_marker_error_widens_the_limit_and_prior_error_does_not() -> None:
    far = moved(hip_r__pelvis__lat=0.040)
    wide = np.zeros((len(LEGS), 1))
    wide[LEGS.index("hip_r.pelvis.lat")] = 0.010
    assert find_unusual_joints(far, ErrorSources(LEGS, wide, ("markers/walk/R.Thigh/x",))) == []
    assert (
        len(find_unusual_joints(far, ErrorSources(LEGS, wide, ("nominal/hip_r.pelvis.lat",)))) == 1
    )


def test_study_prior_shifts_the_mean_but_does_not_widen_the_limit() -> None:
    far = moved(hip_r__pelvis__lat=0.040, hip_r__thigh__lat=0.040)
    mean = ANATOMY.mean.copy()
    mean[[JP_INDEX["hip_r.pelvis.lat"], JP_INDEX["hip_r.thigh.lat"]]] = 0.035
    assert find_unusual_joints(far, prior=replace(ANATOMY, mean=mean)) == []
    assert (
        len(find_unusual_joints(far, prior=replace(ANATOMY, covariance=100.0 * ANATOMY.covariance)))
        == 1
    )


def test_too_few_markers_for_soft_tissue_are_reported() -> None:
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


def test_explanation_pages_have_the_limits() -> None:
    """In one direction alone, without errors of the fit."""

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

    reported = (ROOT / "docs/explanation/verdict.md").read_text(encoding="utf-8").splitlines()
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
        row = next(line for line in reported if line.startswith(start))
        assert [" ".join(re.findall(r"\d+", cell)) for cell in row.split("|")[2:4]] == found


def test_parameter_three_standard_deviations_off_is_a_note_with_any_error() -> None:
    """There is no warning, and nothing at two standard deviations."""
    wide = np.zeros((len(LEGS), 1))
    wide[LEGS.index("knee_r.thigh.ant")] = 0.030
    errors = ErrorSources(LEGS, wide, ("markers/walk/R.Thigh/x",))
    far, near = moved(knee_r__thigh__ant=0.031), moved(knee_r__thigh__ant=0.020)
    (found,) = check_joint_positions(MODEL, far, errors, ANATOMY)
    assert found.severity is Severity.INFO and found.code is Code.KNEE_AXIS and found.leg == "r"
    assert list(check_joint_positions(MODEL, near, errors, ANATOMY)) == []
