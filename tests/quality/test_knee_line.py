"""Epicondyle lines of both legs, or one, against pelvis, malleoli and flexion axes in walks."""

import numpy as np
import pytest

from gaitcal.errors import Code, Finding, Severity
from gaitcal.model.body_plan import compute_body_axes
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.quality.knee_axes import (
    ODD_BOTH,
    OddLine,
    check_knee_lines,
    find_odd_lines,
    measure_bending,
)
from gaitcal.quality.static_landmarks import collect_landmarks
from gaitcal.study.study import Study
from tests.messages import check_finding
from tests.quality.spoilt import Array, findings, moved, with_trial


def find_knee_lines(study: Study) -> list[Finding]:
    return findings(study, code=Code.KNEE_MARKERS)


def measure_knees(study: Study) -> tuple[dict[str, Array], dict[str, float]]:
    trials = preprocess_study(study).trials
    return collect_landmarks(next(t for t in trials if t.is_static)), measure_bending(trials)


def displace_epicondyles(study: Study, lateral: float, medial: float, sides: str = "RL") -> Study:
    """Displace epicondyles of the static trial forward, m."""
    for side in sides:
        for end, by in (("Lat", lateral), ("Med", medial)):
            study = with_trial(
                study, "static", moved(f"{side}.Knee.{end}", lambda x, by=by: x + [by, 0.0, 0.0])
            )  # type: ignore[misc]
    return study


def test_both_knees_give_one_finding_with_degrees_and_markers(sound: Study) -> None:
    assert (
        find_knee_lines(sound) == []
        and find_knee_lines(displace_epicondyles(sound, 0.01, 0.0)) == []
    ), "ten millimetres are below the floor"
    (found,) = find_knee_lines(displace_epicondyles(sound, 0.02, -0.02))
    labels = ("R.Knee.Lat", "L.Knee.Med")
    check_finding(found, Code.KNEE_MARKERS, Severity.WARNING, *labels, topic="landmarks", leg="")


def test_opposite_rotation_and_single_knee(sound: Study) -> None:
    (back,) = find_knee_lines(displace_epicondyles(sound, -0.025, 0.025))
    check_finding(back, Code.KNEE_MARKERS, leg="")
    left = displace_epicondyles(sound, 0.022, -0.022, "L")
    p, turns = measure_knees(left)
    (one,) = find_odd_lines(p, turns)
    assert one.sides == ("l",) and one.angle == pytest.approx(25.0, abs=8.0)
    (said,) = check_knee_lines(preprocess_study(left).trials, ())
    check_finding(said, Code.KNEE_MARKERS, leg="l")


def turned(p: dict[str, Array], degrees: float, names: tuple[str, ...]) -> dict[str, Array]:
    """Landmarks of both legs rotated about the vertical through their mean, lateral ends
    forward.
    """
    axes = compute_body_axes(p)
    out = dict(p)
    for side, way in (("r", 1.0), ("l", -1.0)):
        own = [f"{name}_{side}" for name in names]
        centre = np.mean([p[name] for name in own], axis=0)
        a = way * np.deg2rad(degrees)
        x, y, z = axes.T
        for name in own:
            u, v, w = (p[name] - centre) @ axes
            out[name] = (
                centre
                + (u * np.cos(a) + w * np.sin(a)) * x
                + v * y
                + (w * np.cos(a) - u * np.sin(a)) * z
            )
    return out


def test_twisted_bones_are_not_reported(sound: Study) -> None:
    p, turns = measure_knees(sound)
    twisted = turned(p, 35.0, ("knee_lat", "knee_med"))
    assert list(find_odd_lines(twisted, turns)) == []  # the axis of bending went along
    (found,) = find_odd_lines(twisted, {side: x + 35.0 for side, x in turns.items()})
    assert isinstance(found, OddLine) and found.sides == ("r", "l")
    assert found.angle == pytest.approx(35.0, abs=4.0)


def test_without_malleoli_two_pieces_of_evidence_remain(sound: Study) -> None:
    p, turns = measure_knees(displace_epicondyles(sound, 0.02, -0.02))
    some = {name: x for name, x in p.items() if not name.startswith("ankle_med")}
    (found,) = find_odd_lines(some, turns)
    assert set(found.side_evidence) == {"bending", "pelvis"}
    assert found.baseline > ODD_BOTH * 4.3
    assert (
        list(find_odd_lines({n: x for n, x in some.items() if not n.startswith("asis")}, turns))
        == []
    )
