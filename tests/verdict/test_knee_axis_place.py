"""A fitted knee axis against the epicondyles: distances, their errors, and when an axis is doubted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.calibration.influence import Influence
from gaitcal.findings import Severity
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.page.joint_marks import joint_marks
from gaitcal.verdict.knee_axis_place import CAUSE, knee_axis_findings, passes_of

NAMES = ("ant", "sup", "front", "trans")
MODEL = published_model(static_only=True)
LATERAL_ONLY = replace(MODEL, landmarks={k: v for k, v in MODEL.landmarks.items() if not k.startswith("knee_med")})


def errors(place: float = 0.003, turn: float = 0.04) -> Influence:
    names = tuple(f"knee_{side}.thigh.{name}" for side in "rl" for name in NAMES)
    size = np.diag([place, place, turn, turn] * 2)
    return Influence(names, size, tuple(f"source {k}" for k in range(8)))


def moved(model: SubjectModel, side: str, by: tuple[float, float, float, float]) -> Parameters:
    """The knee's axis in the thigh, moved forward and up (m), turned about x and y (rad)."""
    names = tuple(f"knee_{side}.thigh.{name}" for name in NAMES)
    values = model.nominal.joint[[JP_INDEX[name] for name in names]]
    return model.nominal.with_joint(names, values + np.array(by))


@pytest.mark.parametrize("side", ["r", "l"])
def test_distances_are_those_of_the_axis_that_is_drawn(side: str) -> None:
    """Against the joint's frames that other programs are given."""
    fitted = moved(MODEL, side, (0.012, -0.031, 0.2, -0.1))
    mark = next(
        j for j in joint_marks(MODEL.nominal, fitted, {}) if (j.joint, j.segment) == (f"knee_{side}", f"thigh_{side}")
    )
    for one, landmark in zip(passes_of(MODEL, fitted, errors(), side), ("knee_lat", "knee_med"), strict=True):
        away = mark.fitted_centre - MODEL.landmarks[f"{landmark}_{side}"][1]
        offset = away - (away @ mark.fitted_axis) * mark.fitted_axis
        np.testing.assert_allclose(one.offset, offset, atol=1e-12)
        assert one.palpated and one.distance > 0.01


def test_the_error_is_that_of_drawn_axes() -> None:
    by, rng = (0.0, -0.03, 0.1, 0.0), np.random.default_rng(1)
    sizes = np.array([0.003, 0.003, 0.04, 0.04])
    known = passes_of(MODEL, moved(MODEL, "r", by), errors(), "r")
    drawn = [
        passes_of(MODEL, moved(MODEL, "r", tuple(by + d)), errors(), "r") for d in sizes * rng.normal(size=(2000, 4))
    ]
    for k, one in enumerate(known):
        assert one.error == pytest.approx(np.std([axes[k].distance for axes in drawn]), rel=0.1)


def test_an_axis_outside_the_bone_is_doubted_and_says_where() -> None:
    (told,) = knee_axis_findings(MODEL, moved(MODEL, "r", (0.0, -0.04, 0.0, 0.0)), errors())
    assert (told.severity, told.leg, told.cause) == (Severity.WARNING, "r", CAUSE)
    assert "right knee" in told.found and "palpated lateral" in told.found and "palpated medial" in told.found
    assert "40 mm below" in told.found and "the fit alone says" in told.found
    assert told.weight > 1.0 and "record an isolated knee trial" in told.cure and "jp = false" in told.cure
    (told,) = knee_axis_findings(MODEL, moved(MODEL, "r", (0.0, -0.04, 0.0, 0.0)), errors(), {"knee_r"})
    assert "record an isolated" not in told.cure


def test_too_few_markers_to_show_moving_skin_are_told() -> None:
    fitted = moved(MODEL, "r", (0.0, -0.04, 0.0, 0.0))
    markers = MODEL.markers
    thigh = [k for k, segment in enumerate(markers.segments) if segment == "thigh_r"]
    weight = markers.weight.copy()
    weight[thigh[2:]] = 0.0
    few = replace(MODEL, markers=replace(markers, weight=weight))
    found = [next(knee_axis_findings(model, fitted, errors())).found for model in (MODEL, few)]
    assert "too few markers" not in found[0] and "2 on the thigh" in found[1]


def test_a_wide_error_bar_excuses() -> None:
    fitted = moved(MODEL, "l", (0.0, -0.04, 0.0, 0.0))
    assert next(knee_axis_findings(MODEL, fitted, errors())).leg == "l"
    assert list(knee_axis_findings(MODEL, fitted, errors(place=0.03))) == []


def test_axes_within_10_mm_and_10_degrees_are_never_doubted() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        shift, turn = rng.normal(size=2), rng.normal(size=2)
        shift *= 0.010 / np.linalg.norm(shift)
        turn *= np.deg2rad(10.0) / np.linalg.norm(turn)
        fitted = moved(MODEL, "r", (*shift, *turn))
        for model in (MODEL, LATERAL_ONLY):
            for told in knee_axis_findings(model, fitted, errors(0.0, 0.0)):
                assert told.severity is Severity.INFO


def test_without_a_medial_marker_its_place_is_assumed_and_excuses_more() -> None:
    fitted = moved(MODEL, "r", (0.0, -0.01, 0.25, 0.0))
    palpated, assumed = (passes_of(model, fitted, errors(), "r")[1] for model in (MODEL, LATERAL_ONLY))
    assert palpated.palpated and not assumed.palpated and "assumed medial" in assumed.words
    assert assumed.distance == pytest.approx(palpated.distance, abs=0.002)
    assert assumed.times < 0.9 * palpated.times


def test_nothing_is_said_of_a_knee_that_was_not_fitted_or_has_no_marker() -> None:
    assert list(knee_axis_findings(MODEL, MODEL.nominal, errors())) == []
    bare = replace(MODEL, landmarks={k: v for k, v in MODEL.landmarks.items() if not k.startswith("knee")})
    assert list(knee_axis_findings(bare, moved(MODEL, "r", (0.0, -0.06, 0.0, 0.0)), errors())) == []
