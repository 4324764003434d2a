"""Ways to spoil a study: what it says of its recordings and of the person, and recordings that are not its own.

Functions of the study and the words of the table.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from gaitcal import Recording, Study, load_marker_set, synthesize
from scripts.validation.attacks.bases import loaded
from scripts.validation.attacks.spoil_markers import labels_of
from scripts.validation.attacks.spoil_plates import at_times, first_contact, middle_of
from scripts.validation.recordings import WALK

OTHER_SEED = 2
"""Of the other synthetic person."""


def recording_of(study: Study, name: str) -> Recording:
    """The recording of a trial."""
    return next(trial.recording for trial in study.trials if trial.name == name)


def with_trial(study: Study, name: str, **changes: object) -> Study:
    """The study with one trial changed: another `recording`, `plates`, `joint`."""
    trials = tuple(replace(t, **changes) if t.name == name else t for t in study.trials)  # type: ignore[arg-type]
    return replace(study, trials=trials)


def of_base(study: Study, name: str, base: str) -> Study:
    """The trial of another person who wears the same marker set, forces and all."""
    return with_trial(study, name, recording=recording_of(loaded(base), name))


@lru_cache(maxsize=1)
def _other_person() -> Study:
    with tempfile.TemporaryDirectory() as folder:
        return Study.load(synthesize(Path(folder) / "study", seed=OTHER_SEED, noise=True, perturb=True))


def of_another_person(study: Study, name: str) -> Study:
    """The trial of another synthetic person."""
    return with_trial(study, name, recording=recording_of(_other_person(), name))


def same_file(study: Study, name: str, source: str) -> Study:
    """A trial with the file of another."""
    return with_trial(study, name, recording=recording_of(study, source))


def files_exchanged(study: Study, a: str, b: str) -> Study:
    """Two trials with each other's file."""
    return with_trial(same_file(study, a, b), b, recording=recording_of(study, a))


def given_as(study: Study, name: str, source: str) -> Study:
    """The recording of trial `source` under the name of another, its last frame left out: a file of its own."""
    other = recording_of(study, source)
    shorter = replace(other, time=other.time[:-1], markers=other.markers[:-1], plates=())
    return with_trial(study, name, recording=shorter)


def declared(study: Study, *joints: str) -> Study:
    """`hip_r=knee_r`: the trial is said to move that joint."""
    for words in joints:
        name, _, joint = words.partition("=")
        study = with_trial(study, name, joint=joint)
    return study


def assigned(study: Study, *feet: str) -> Study:
    """`1=r`: the study says which foot is on which plate."""
    return with_trial(study, WALK, plates=dict(words.split("=") for words in feet))


def labelled_as(study: Study, markers: str) -> Study:
    """The marker set of another protocol."""
    return replace(study, marker_set=load_marker_set(markers))


def weighing(study: Study, *weights: str) -> Study:
    """`thigh_r=0`: weights (by key) that the study gives."""
    pairs = [words.split("=") for words in weights]
    return replace(study, weights={n: float(w) for key, w in pairs for n in labels_of(study.marker_set, key)})


def mass(study: Study, factor: float) -> Study:
    """Body mass times a factor."""
    return replace(study, subject=replace(study.subject, mass=factor * study.subject.mass))


def height(study: Study, factor: float) -> Study:
    """Height times a factor."""
    return replace(study, subject=replace(study.subject, height=factor * study.subject.height))


def other_sex(study: Study) -> Study:
    """The other anthropometric table."""
    return replace(study, subject=replace(study.subject, sex="female" if study.subject.sex == "male" else "male"))


def cables_exchanged(study: Study) -> Study:
    """The signals of the first plate come from where the second stands, and the other way round."""
    walk = recording_of(study, WALK)
    one, two, *rest = walk.plates
    way = middle_of(one) - middle_of(two)
    first = replace(two, name=one.name, corners=one.corners, point=two.point + way)
    second = replace(one, name=two.name, corners=two.corners, point=one.point - way)
    return with_trial(study, WALK, recording=replace(walk, plates=(first, second, *rest)))


def points_exchanged(study: Study) -> Study:
    """Each force at the centre of pressure of the other plate."""
    walk = recording_of(study, WALK)
    one, two, *rest = walk.plates
    swapped = (replace(one, point=two.point), replace(two, point=one.point), *rest)
    return with_trial(study, WALK, recording=replace(walk, plates=swapped))


def without_plate(study: Study, number: int) -> Study:
    """The walk without one of its plates."""
    walk = recording_of(study, WALK)
    kept = tuple(p for k, p in enumerate(walk.plates, start=1) if k != number)
    return with_trial(study, WALK, recording=replace(walk, plates=kept))


def forces_of(study: Study, base: str) -> Study:
    """The force file of another walk, its first contact at the same moment."""
    walk, other = recording_of(study, WALK), recording_of(loaded(base), WALK)
    own, theirs = (min(t for p in r.plates if (t := first_contact(p)) is not None) for r in (walk, other))
    time = walk.plates[0].time
    told = [replace(at_times(p, time - own + theirs), time=time, corners=None) for p in other.plates]
    plates = tuple(replace(p, name=mine.name) for mine, p in zip(walk.plates, told, strict=False))
    return with_trial(study, WALK, recording=replace(walk, plates=plates))
