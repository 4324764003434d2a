"""Forces against motion: signs, positions, gain and mass, free moments, and the foot on each
plate.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.subject_model import GRAVITY
from gaitcal.study.study import Study
from tests.messages import check_finding
from tests.quality.spoilt import (
    Change,
    backwards,
    drafted,
    findings,
    plates,
    recording_of,
    relabelled,
    times,
    with_corners,
    with_trial,
)

ERROR, WARNING, INFO = Severity.ERROR, Severity.WARNING, Severity.INFO


def negated(axis: int) -> Change:
    """One force component of both plates negated, with the reader's reversal for the
    vertical one.
    """
    sign = np.ones(3)
    sign[axis] = -1.0
    return plates(lambda p: replace(p, force=(-sign if axis == 1 else sign) * p.force))


@pytest.mark.parametrize(
    ("axis", "names"),
    [(0, ("fore-aft",)), (2, ("sideways",)), (1, ("fore-aft", "sideways", "vertical"))],
)
def test_reversed_forces(sound: Study, axis: int, names: tuple[str, ...]) -> None:
    (found,) = findings(
        with_trial(sound, "walk", negated(axis)), "forces", WARNING, code=Code.FORCE_SIGN
    )
    check_finding(found, Code.FORCE_SIGN, *names)
    assert (len(names) > 1) == ("vertical" in found.cure)


@pytest.mark.parametrize("name", ["HC002D", "HC030A", "HC032A"])
def test_turn_over_one_plate_has_no_wrong_sign(name: str, data_dir: Path) -> None:
    spoilt = with_trial(
        drafted(data_dir / "children" / name), "turn", lambda r: replace(r, plates=r.plates[1:])
    )
    assert findings(spoilt, code=Code.FORCE_SIGN) == []


def test_step_of_a_foot_without_toe_is_a_note(sound: Study) -> None:
    """The distance of the other foot is unknown: it is not `inf mm`."""
    study = with_trial(sound, "walk", relabelled("L.Toe.Tip", "X"))
    assert findings(study, "plate to foot", WARNING) == []
    found = findings(study, "plate to foot", INFO, code=Code.UNDER_NO_FOOT)
    assert found
    for one in found:
        check_finding(one, Code.UNDER_NO_FOOT, "left foot")


@pytest.mark.parametrize(("shift", "side"), [(0.05, "right"), (-0.05, "left")])
def test_plates_beside_both_feet(sound: Study, shift: float, side: str) -> None:
    def beside(p: ForcePlate) -> ForcePlate:
        return replace(p, point=p.point + [0.0, 0.0, shift])

    study = with_trial(sound, "walk", plates(beside))
    (found,) = findings(study, "plate to foot", WARNING)
    check_finding(found, Code.PLATES_ELSEWHERE, side)
    assert findings(with_trial(sound, "walk", plates(beside, 1)), "plate to foot", WARNING) == []


@pytest.mark.parametrize(("gain", "mass"), [(1.2, 69.4), (0.85, 69.4), (1.0, 80.0)])
def test_forces_that_do_not_match_body_weight(sound: Study, gain: float, mass: float) -> None:
    study = with_trial(sound, "walk", plates(times(gain)))
    study = replace(study, subject=replace(study.subject, mass=mass))
    (found,) = findings(study, "body mass", WARNING)
    check_finding(found, Code.BODY_MASS, "subject.mass_kg", f"{mass:g}")
    carried = float(found.found.partition("carry ")[2].split()[0])
    assert carried == pytest.approx(gain * 69.4, rel=0.03)


@pytest.mark.parametrize("acceleration", [0.6, -0.6])
def test_mass_accounts_for_vertical_acceleration(sound: Study, acceleration: float) -> None:
    """The pelvis accelerates upwards, m/s^2, and the plates push harder: the mass is the same."""
    gain = 1.0 + acceleration / GRAVITY

    def rising(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        pelvis = [recording.labels.index(label) for label in sound.marker_set.tracking["pelvis"]]
        markers[:, pelvis, 1] += 0.5 * acceleration * recording.time[:, None] ** 2
        return plates(times(gain))(replace(recording, markers=markers))

    (reported,) = findings(with_trial(sound, "walk", rising), "body mass", INFO)
    assert float(reported.found.partition("carry ")[2].split()[0]) == pytest.approx(69.4, rel=0.03)


def test_foot_beside_its_plate(sound: Study) -> None:
    walk = recording_of(sound)
    toe = float(np.median(walk.markers[40:100, walk.labels.index("R.Toe.Tip"), 0]))

    def reported(study: Study, severity: Severity) -> list[Finding]:
        return [
            f
            for f in findings(study, "plate to foot", severity)
            if "rests partly beside it (" in f.found
        ]

    beside = with_trial(sound, "walk", with_corners(toe - 0.04))
    assert not reported(beside, WARNING), "the left one is on its plate"
    check_finding(reported(beside, INFO)[0], Code.FOOT_BESIDE_PLATE)
    alone = with_trial(beside, "walk", lambda r: replace(r, plates=r.plates[:1]))
    check_finding(reported(alone, WARNING)[0], Code.FOOT_BESIDE_PLATE)
    on_it = with_trial(sound, "walk", with_corners(toe + 0.06))
    assert not reported(on_it, INFO) and not reported(on_it, WARNING)


def test_plate_given_to_the_wrong_foot(sound: Study) -> None:
    trials = tuple(replace(t, plates={"1": "l"}) if t.name == "walk" else t for t in sound.trials)
    found = findings(replace(sound, trials=trials), "plate to foot", ERROR)
    check_finding(found[0], Code.WRONG_FOOT, 'plates = { 1 = "r" }')


def test_mass_is_wrong_if_standing_and_walking_agree(sound: Study) -> None:
    """Standing on plates, walking on plates of another gain; and unknown offsets."""
    mass = sound.subject.mass

    def standing(kg: float, count: int, declared: float = mass) -> Study:
        force = np.tile([0.0, kg * 9.80665 / count, 0.0], (2, 1))
        time, zero = sound.static.recording.time[[0, -1]], np.zeros((2, 3))
        on = tuple(
            ForcePlate(name=str(i), time=time, force=force, point=zero, moment=zero)
            for i in range(count)
        )
        study = with_trial(sound, "static", lambda r: replace(r, plates=on))
        return replace(study, subject=replace(sound.subject, mass=declared))

    check_finding(findings(standing(mass, 2), "body mass", INFO)[0], Code.BODY_MASS, 69.4)
    reported = findings(standing(mass, 2, 1.1 * mass), "body mass", WARNING)
    assert [f.where for f in reported] == ["static", "walk"], "the walk alone cannot"
    check_finding(reported[0], Code.BODY_MASS, "subject.mass_kg", 69.4, 76.34)
    contradicted = [
        f for f in findings(standing(1.2 * mass, 1), "body mass") if f.where == "static"
    ]
    assert [f.severity for f in contradicted] == [INFO]
    check_finding(contradicted[0], Code.BODY_MASS, "walk")
    lone = replace(standing(1.07 * mass, 2), trials=standing(1.07 * mass, 2).trials[:1])
    assert not findings(lone, "body mass", WARNING), "two plates, either of them 20 N off"


def test_plates_that_touch_are_one_surface(sound: Study) -> None:
    """A foot across the border of two plates is valid; beside both of them it is not."""

    def bordered(end: float) -> Change:
        """Plate 1 ends at x = `end`, where plate 3 begins."""
        beyond = np.array(
            [[10.0, 0.0, -10.0], [end, 0.0, -10.0], [end, 0.0, 10.0], [10.0, 0.0, 10.0]]
        )

        def spoil(r: Recording) -> Recording:
            more = replace(r.plates[0], name="3", force=0.0 * r.plates[0].force, corners=beyond)
            return replace(with_corners(end)(r), plates=(*with_corners(end)(r).plates, more))

        return spoil

    walk = recording_of(sound)
    loaded = np.nan_to_num(walk.plates[0].force[:, 1]) > 300.0
    middle = float(np.median(walk.plates[0].point[loaded, 0]))
    for plate, beside in ((bordered(middle), 0), (with_corners(middle), 1)):
        found = findings(with_trial(sound, "walk", plate), "plate to foot", INFO)
        reported = [f for f in found if "plate 1" in f.found and "partly beside" in f.found]
        assert len(reported) == beside and not any("none" in f.cure for f in reported)


def of_free_moment(study: Study) -> list[Finding]:
    return findings(study, code=Code.FREE_MOMENT)


def turned_by(factor: float) -> Change:
    """Free moments times a factor."""
    return plates(lambda p: replace(p, moment=factor * p.moment))


def test_wrong_sign_is_reported_and_wrong_size_is_not(sound: Study) -> None:
    [reported] = of_free_moment(with_trial(sound, "walk", turned_by(-1.0)))
    check_finding(reported, Code.FREE_MOMENT)
    for small in (0.1, -0.1):  # too small to tell, and to matter
        assert of_free_moment(with_trial(sound, "walk", turned_by(small))) == []


def test_backward_walking_and_other_wrong_signs_are_not_reported(sound: Study) -> None:
    """Both reverse the moment, or may: the cause is reported elsewhere."""
    assert of_free_moment(with_trial(sound, "walk", backwards)) == []
    pushing_outwards = plates(lambda p: replace(p, force=p.force * [-1, 1, -1], moment=-p.moment))
    assert of_free_moment(with_trial(sound, "walk", pushing_outwards)) == []
    assert findings(with_trial(sound, "walk", pushing_outwards), code=Code.FORCE_SIGN)


@pytest.mark.parametrize(("name", "walk"), [("subject01", "walk"), ("pig_c3d", "gait")])
def test_real_people_have_the_usual_sign(
    name: str, walk: str, real_study: Callable[[str], Study]
) -> None:
    study = real_study(name)
    assert of_free_moment(study) == []
    assert len(of_free_moment(with_trial(study, walk, turned_by(-1.0)))) == 1
