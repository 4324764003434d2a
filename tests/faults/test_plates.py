"""Forces against the motion: signs, places, gain and mass, free moments, and which foot stands on which plate."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import Code, Finding, Severity
from gaitcal.faults.study import check_study
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.subject_model import GRAVITY
from gaitcal.session.draft import study_of
from gaitcal.session.drafting import draft_of
from gaitcal.session.folder import read_folder
from gaitcal.session.person_facts import Options
from gaitcal.study.study import Study
from tests.faults.spoilt import Change, findings, plate, sound_study, with_corners, with_trial
from tests.real_studies import write_study

ERROR, WARNING, INFO = Severity.ERROR, Severity.WARNING, Severity.INFO


def negated(axis: int) -> Change:
    """One component of the force of both plates with the other sign, and the reader's turn where it is the vertical."""
    sign = np.ones(3)
    sign[axis] = -1.0
    whole = -1.0 if axis == 1 else 1.0
    return lambda r: plate(2, lambda p: replace(p, force=whole * sign * p.force))(
        plate(1, lambda p: replace(p, force=whole * sign * p.force))(r)
    )


@pytest.mark.parametrize(
    ("axis", "words"),
    [
        (0, ("drive first and brake later",)),
        (2, ("push outwards",)),
        (1, ("drive first", "push outwards", "of the vertical column alone")),
    ],
)
def test_reversed_forces(sound: Study, axis: int, words: tuple[str, ...]) -> None:
    (found,) = [
        f for f in findings(with_trial(sound, "walk", negated(axis)), "forces", WARNING) if "wrong sign" in f.cause
    ]
    assert all(word in f"{found.found} {found.cure}" for word in words)
    assert (len(words) > 1) == ("vertical" in found.cure)


@pytest.mark.parametrize("name", ["HC002D", "HC030A", "HC032A"])
def test_who_turns_over_one_plate_pushes_outwards_with_that_leg(name: str, data_dir: Path) -> None:
    study = study_of(draft_of(read_folder(data_dir / "children" / name), Options(sex="male")))
    spoilt = with_trial(study, "turn", lambda r: replace(r, plates=r.plates[1:]))
    assert [f.line for f in check_study(spoilt) if f.code is Code.FORCE_SIGN] == []


def test_a_step_of_a_foot_without_toe_is_a_fact_and_accuses_no_plate(sound: Study) -> None:
    """Nobody can tell how far the other foot is: it is not `inf mm` away."""

    def toeless(r: Recording) -> Recording:
        return replace(r, labels=tuple("X" if label == "L.Toe.Tip" else label for label in r.labels))

    study = with_trial(sound, "walk", toeless)
    assert findings(study, "plate to foot", WARNING) == []
    told = [f.found for f in findings(study, "plate to foot", INFO) if "mm from" in f.found]
    assert told and all("the left foot, whose step it may be, shows no heel and toe then" in words for words in told)


@pytest.mark.parametrize(("shift", "side"), [(0.05, "right"), (-0.05, "left")])
def test_plates_beside_both_feet(sound: Study, shift: float, side: str) -> None:
    def beside(p: ForcePlate) -> ForcePlate:
        return replace(p, point=p.point + [0.0, 0.0, shift])

    study = with_trial(sound, "walk", lambda r: plate(2, beside)(plate(1, beside)(r)))
    (found,) = findings(study, "plate to foot", WARNING)
    assert f"lie to the {side} of the line heel-toe of both feet" in found.found
    assert findings(with_trial(sound, "walk", plate(1, beside)), "plate to foot", WARNING) == []


@pytest.mark.parametrize(("gain", "mass"), [(1.2, 69.4), (0.85, 69.4), (1.0, 80.0)])
def test_forces_that_do_not_carry_the_walker(sound: Study, gain: float, mass: float) -> None:
    def louder(p: ForcePlate) -> ForcePlate:
        return replace(p, force=gain * p.force, moment=gain * p.moment)

    study = with_trial(sound, "walk", lambda r: plate(2, louder)(plate(1, louder)(r)))
    study = replace(study, subject=replace(study.subject, mass=mass))
    (found,) = findings(study, "body mass", WARNING)
    assert f"subject.mass_kg is {mass:g}" in found.found
    carried = float(found.found.partition("carry ")[2].split()[0])
    assert carried == pytest.approx(gain * 69.4, rel=0.03)


@pytest.mark.parametrize("acceleration", [0.6, -0.6])
def test_plates_carry_more_than_the_mass_of_a_body_that_is_speeding_up(sound: Study, acceleration: float) -> None:
    """The pelvis gains speed upwards, m/s^2, and the plates push as much harder: the same mass as before."""
    gain = 1.0 + acceleration / GRAVITY

    def rising(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        pelvis = [recording.labels.index(label) for label in sound.marker_set.tracking["pelvis"]]
        markers[:, pelvis, 1] += 0.5 * acceleration * recording.time[:, None] ** 2
        plates = tuple(replace(p, force=gain * p.force, moment=gain * p.moment) for p in recording.plates)
        return replace(recording, markers=markers, plates=plates)

    (told,) = findings(with_trial(sound, "walk", rising), "body mass", INFO)
    assert float(told.found.partition("carry ")[2].split()[0]) == pytest.approx(69.4, rel=0.03)


def test_foot_beside_its_plate(sound: Study) -> None:
    model = published_model()
    walk = next(t for t in sound.trials if t.name == "walk").recording
    toe = float(np.median(walk.markers[40:100, walk.labels.index("R.Toe.Tip"), 0]))
    assert model.markers.labels == walk.labels

    def told(study: Study, severity: Severity) -> list[Finding]:
        return [f for f in findings(study, "plate to foot", severity) if "rests partly beside it (" in f.found]

    beside = with_trial(sound, "walk", with_corners(toe - 0.04))
    assert "right foot" in told(beside, INFO)[0].found and not told(beside, WARNING), "the left one is on its plate"
    alone = with_trial(beside, "walk", lambda r: replace(r, plates=r.plates[:1]))
    assert "right foot" in told(alone, WARNING)[0].found, "no step says that the plates are in place"
    on_it = with_trial(sound, "walk", with_corners(toe + 0.06))
    assert not told(on_it, INFO) and not told(on_it, WARNING)


def test_plate_given_to_the_wrong_foot(sound: Study) -> None:
    trials = tuple(replace(t, plates={"1": "l"}) if t.name == "walk" else t for t in sound.trials)
    found = findings(replace(sound, trials=trials), "plate to foot", ERROR)
    assert "left foot" in found[0].found and 'plates = { 1 = "r" }' in found[0].cure


def test_mass_against_standing_force(sound: Study) -> None:
    static = sound.static.recording
    weight = 69.4 * 9.81
    force = np.tile([0.0, weight / 2, 0.0], (len(static.time), 1))
    zero = np.zeros_like(force)
    both = tuple(ForcePlate(name=name, time=static.time, force=force, point=zero, moment=zero) for name in "12")
    study = with_trial(sound, "static", lambda r: replace(r, plates=both))
    assert "69.4 kg" in findings(study, "body mass", INFO)[0].found
    heavier = replace(study, subject=replace(study.subject, mass=80.0))
    told = findings(heavier, "body mass", WARNING)
    assert [f.where for f in told] == ["static", "walk"], "standing and walking say so"
    assert "69.4 kg while standing; subject.mass_kg is 80" in told[0].found


def test_a_mass_is_wrong_where_no_trial_contradicts(sound: Study) -> None:
    """Standing on 69.4 kg, walking on what plates with another gain make of it; and offsets that nobody knows."""
    mass = sound.subject.mass
    zero = np.zeros((2, 3))

    def standing(kg: float, plates: int) -> Study:
        force = np.tile([0.0, kg * 9.80665 / plates, 0.0], (2, 1))
        time = sound.static.recording.time[[0, -1]]
        on = tuple(ForcePlate(name=str(i), time=time, force=force, point=zero, moment=zero) for i in range(plates))
        return with_trial(sound, "static", lambda r: replace(r, plates=on))

    (alone,) = [f for f in findings(standing(1.2 * mass, 1), "body mass", INFO) if f.where == "static"]
    assert "but not in all trials" in alone.found and "in walk" in alone.found
    assert not findings(standing(1.2 * mass, 1), "body mass", WARNING)
    heavier = replace(standing(mass, 2), subject=replace(sound.subject, mass=1.1 * mass))
    assert [f.where for f in findings(heavier, "body mass", WARNING)] == ["static", "walk"], "the walk alone cannot"
    lone = replace(standing(1.07 * mass, 2), trials=standing(1.07 * mass, 2).trials[:1])
    assert not findings(lone, "body mass", WARNING), "two plates, either of them 20 N off"


def test_plates_that_touch_are_one_surface(sound: Study) -> None:
    """A foot across the border of two plates is fine; beside both of them it is not."""

    def bordered(end: float) -> Change:
        """Plate 1 ends at x = `end`, where plate 3 begins."""
        beyond = np.array([[10.0, 0.0, -10.0], [end, 0.0, -10.0], [end, 0.0, 10.0], [10.0, 0.0, 10.0]])

        def spoil(r: Recording) -> Recording:
            more = replace(r.plates[0], name="3", force=0.0 * r.plates[0].force, corners=beyond)
            return replace(with_corners(end)(r), plates=(*with_corners(end)(r).plates, more))

        return spoil

    walk = next(t for t in sound.trials if t.name == "walk").recording
    loaded = np.nan_to_num(walk.plates[0].force[:, 1]) > 300.0
    middle = float(np.median(walk.plates[0].point[loaded, 0]))
    partly = findings(with_trial(sound, "walk", bordered(middle)), "plate to foot", INFO)
    assert not any("plate 1" in f.found and "partly beside" in f.found for f in partly)
    alone = findings(with_trial(sound, "walk", with_corners(middle)), "plate to foot", INFO)
    assert any("plate 1" in f.found and "partly beside" in f.found and "none" not in f.cure for f in alone)


@pytest.mark.parametrize(("axis", "name"), [(0, "Fx"), (2, "Fz")])
def test_a_horizontal_channel_that_never_changes_is_missing(sound: Study, axis: int, name: str) -> None:
    def dead(p: ForcePlate) -> ForcePlate:
        force = p.force.copy()
        force[:, axis] = 0.0
        return replace(p, force=force)

    found = [f for f in findings(with_trial(sound, "walk", plate(1, dead)), "plates", WARNING) if "missing" in f.cause]
    assert [f.cause for f in found] == [f"a horizontal force of plate 1 is missing: {name} is constant"]
    assert not [f for f in findings(sound, "plates", WARNING) if "missing" in f.cause]


REAL = {"subject01": "walk", "pig_c3d": "gait"}
"""Study -> its walk over plates."""


def times(factor: float) -> Change:
    """Free moments times a factor."""

    def spoil(recording: Recording) -> Recording:
        return replace(recording, plates=tuple(replace(p, moment=factor * p.moment) for p in recording.plates))

    return spoil


def backwards(recording: Recording) -> Recording:
    """From the end to the beginning: a body that walks backwards, and turns its feet the other way."""
    plates = tuple(
        replace(p, force=p.force[::-1], point=p.point[::-1], moment=p.moment[::-1]) for p in recording.plates
    )
    return replace(recording, markers=recording.markers[::-1].copy(), plates=plates)


def of_free_moment(study: Study) -> list[Finding]:
    return [f for f in check_study(study) if f.code is Code.FREE_MOMENT]


def test_a_wrong_sign_is_told_and_a_wrong_size_is_not_taken_for_one() -> None:
    sound = sound_study()
    [told] = of_free_moment(with_trial(sound, "walk", times(-1.0)))
    assert told.cause == "the free moment of all plates has the wrong sign"
    assert "whole steps" in told.found
    assert of_free_moment(with_trial(sound, "walk", times(0.1))) == []
    assert of_free_moment(with_trial(sound, "walk", times(-0.1))) == [], "too small to tell, and to matter"


def test_backwards_and_with_another_sign_wrong_nothing_is_said() -> None:
    """Both turn the moment round, or may: the cause is told elsewhere."""
    sound = sound_study()
    assert of_free_moment(with_trial(sound, "walk", backwards)) == []

    def pushing_outwards(recording: Recording) -> Recording:
        return replace(recording, plates=tuple(replace(p, force=p.force * [-1, 1, -1]) for p in recording.plates))

    spoilt = with_trial(with_trial(sound, "walk", times(-1.0)), "walk", pushing_outwards)
    assert of_free_moment(spoilt) == []
    assert any(f.code is Code.FORCE_SIGN for f in check_study(spoilt))


@pytest.mark.parametrize("name", REAL)
def test_real_people_have_the_usual_sign(name: str, data_dir: Path, tmp_path: Path) -> None:
    study = Study.load(write_study(name, data_dir, tmp_path))
    assert of_free_moment(study) == []
    assert len(of_free_moment(with_trial(study, REAL[name], times(-1.0)))) == 1
