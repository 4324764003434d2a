"""What trials do not determine: what is frozen and advised, odd joints and bodies, arms turned
about themselves.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gaitcal as gc
from gaitcal.calibration.identifiability import (
    LARGEST_ARM_ROTATION,
    LARGEST_ORIENTATION,
    LARGEST_POSITION,
    detect_ambiguous_arms,
    exclude_arms,
    find_unobservable_parameters,
    is_same_placement,
    report_ambiguous_arms,
    report_bounds,
    report_undetermined,
)
from gaitcal.errors import Code, Severity
from gaitcal.model.parameters import JP_NAMES
from tests.derivatives import perturbed_parameters, random_trial, started
from tests.messages import check_finding, check_text, numbers
from tests.quality.spoilt import drafted

UNSEEN = ("talocrural_r.shank.front", "subtalar_r.foot.sag")
PARAMETERS = perturbed_parameters(np.random.default_rng(3), 0.0, 0.0)


@pytest.mark.parametrize("together", [0.0, 0.999])
def test_of_two_that_only_their_sum_shows_one_is_kept_at_its_nominal_value(together: float) -> None:
    """Both have a standard error too large; given the one, the other is determined if they go
    together.
    """
    names = ("hip_r.pelvis.ant", "hip_r.thigh.ant", "knee_r.shank.front")
    allowed = np.array([LARGEST_POSITION, LARGEST_POSITION, LARGEST_ORIENTATION])
    errors = np.array([1.5, 2.0, 0.1]) * allowed
    covariance = np.outer(errors, errors) * np.array(
        [[1.0, together, 0.0], [together, 1.0, 0.0], [0.0, 0.0, 1.0]]
    )
    expected = ("hip_r.thigh.ant",) if together else ("hip_r.thigh.ant", "hip_r.pelvis.ant")
    assert find_unobservable_parameters(names, covariance, np.eye(3)) == expected
    seen = np.array([0.8, 0.6, 0.0])
    blind = np.outer(seen, seen) + np.diag([0.0, 0.0, 1.0])
    assert find_unobservable_parameters(names, np.zeros((3, 3)), blind) == ("hip_r.thigh.ant",)


def advice(turned: dict[str, dict[str, float]]) -> dict[str, str]:
    return {f.found.split(".")[0]: f.cure for f in report_undetermined(UNSEEN, "kept", turned)}


def test_an_isolated_trial_is_asked_for_where_there_is_none_and_not_where_one_with_62_deg_was_given() -> (  # noqa: E501
    None
):
    check_text(advice({}).values())
    other = {"ankle_l": {"ankle_angle": 1.1, "subtalar_angle": 0.6}}
    assert advice(other) == advice({})
    told = advice(
        {"ankle_r": {"ankle_angle": np.deg2rad(62.0), "subtalar_angle": np.deg2rad(12.0)}}
    )
    assert all(62 in numbers(line) for line in told.values())
    check_text(told.values())


def test_one_joint_beyond_its_bounds_is_odd_and_many_are_another_body() -> None:
    (one,) = report_bounds(["hip_r.thigh.sup", "hip_r.thigh.ant"])
    check_finding(one, Code.JOINT_AT_BOUND, Severity.WARNING, "hip_r", leg="r")
    (arm,) = report_bounds(["shoulder_l.trunk.front"])
    assert arm.severity is Severity.INFO
    own = ["knee_r.thigh.ant", "knee_r.thigh.sup", "knee_r.shank.ant", "knee_r.shank.sup"]
    assert [f.severity for f in report_bounds(own)] == [Severity.WARNING], (
        "four of one joint are one odd joint"
    )
    *arms, body = report_bounds(
        ["shoulder_l.trunk.front", *own[:2], "knee_l.thigh.ant", "hip_l.thigh.ant"]
    )
    check_finding(body, Code.OTHER_BODY, Severity.ERROR)
    assert [f.severity for f in arms] == [Severity.INFO]
    joints = report_bounds([*own[:2], "knee_l.thigh.ant", "hip_l.thigh.ant"], same_body=True)
    assert [f.severity for f in joints] == [Severity.WARNING] * 3, "odd joints of this body"


def test_markers_that_keep_their_distances_are_on_the_body_that_stood() -> None:
    """Without noise they do; those of a trial in which one of them sits 5 mm elsewhere do not."""
    body, _ = random_trial(np.random.default_rng(4), PARAMETERS, frames=60, nodes=10)
    assert is_same_placement([body])
    local = body.data.local.copy()
    local[list(body.data.segment).index(body.chain.segments.index("thigh_r"))] += 0.005
    moved = replace(body, data=replace(body.data, placed=replace(body.data.placed, local=local)))
    assert not is_same_placement([body, moved]) and not is_same_placement([])


@pytest.mark.parametrize(
    ("side", "turn", "found"), [("r", 1.1, True), ("l", 1.1, True), ("r", 0.9, False)]
)
@pytest.mark.parametrize(
    ("coordinate", "whole"), [("arm_flex", 0.0), ("arm_add", 2.0 * np.pi), ("elbow_flex", 0.0)]
)
def test_an_arm_far_from_where_its_markers_begin(
    side: str, turn: float, found: bool, coordinate: str, whole: float
) -> None:
    """Whole turns are none; most of the time counts, not a moment."""
    body, _ = random_trial(np.random.default_rng(4), PARAMETERS, frames=60, nodes=10)
    _, start = started(body, PARAMETERS)
    coefficients = start.copy()
    coefficients[:, body.chain.coordinates.index(f"{coordinate}_{side}")] += (
        turn * LARGEST_ARM_ROTATION + whole
    )
    turned = detect_ambiguous_arms([body, body], [start, coefficients], PARAMETERS)
    assert list(turned) == ([side] if found else [])
    if found:
        assert turned[side] == pytest.approx(turn * LARGEST_ARM_ROTATION)
        degrees = f"{np.rad2deg(turn * LARGEST_ARM_ROTATION):.0f}"
        check_finding(report_ambiguous_arms(turned)[0], Code.UNDETERMINED, degrees)


def test_only_joints_of_that_arm_stay() -> None:
    left = exclude_arms(JP_NAMES, {"r": 3.0})
    assert {name.split(".")[0] for name in set(JP_NAMES) - set(left)} == {"shoulder_r", "elbow_r"}


@pytest.mark.slow
def test_a_child_whose_elbow_bends_outwards(data_dir: Path, tmp_path: Path) -> None:
    """One walk: without walls the fit turned the right arm by 168 degrees and met its markers worse
    than before.
    """
    for name in ("static.c3d", "straight.c3d"):
        (tmp_path / name).symlink_to(data_dir.resolve() / "children" / "HC002D" / name)
    nominal, fitted, _ = gc.calibrate(drafted(tmp_path)).trial("straight").compute_rms_mm()
    assert fitted < 0.9 * nominal
