"""Attacks on isolated joint trials."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from gaitcal import Recording, Study, synthesize
from scripts.validation.attacks.attack import WALK, Kind, StudyChange, with_recording
from scripts.validation.attacks.corpus.words import EXCHANGED, MIRROR, MOVED, PERSON, RATE, STUCK, UNITS, Row, rows
from scripts.validation.attacks.markers import (
    displaced,
    exchanged,
    in_trial,
    mirrored_cluster,
    sides_exchanged,
    slid,
    turned,
)
from scripts.validation.attacks.trajectories import (
    axes,
    backwards,
    delayed,
    frozen,
    hardly_moving,
    noisy,
    other_rate,
    scaled,
)

OTHER_SEED = 2
ALL = "synthetic uf3 functional"
JOINT = r"joint|looks like|hip_|knee_|declared|role"
SMALL = r"small|little|hardly|range|movement|move|deg"


def declared(**joints: str) -> StudyChange:
    """Trial -> the joint it is said to move."""

    def change(study: Study) -> Study:
        trials = tuple(replace(t, joint=joints.get(t.name, t.joint)) for t in study.trials)
        return replace(study, trials=trials)

    return change


@lru_cache(maxsize=1)
def _other_person() -> Study:
    with tempfile.TemporaryDirectory() as folder:
        return Study.load(synthesize(Path(folder) / "study", seed=OTHER_SEED, noise=True, perturb=True))


def of_another(name: str) -> StudyChange:
    """The isolated trial of another synthetic person."""

    def change(study: Study) -> Study:
        other = next(trial.recording for trial in _other_person().trials if trial.name == name)
        return with_recording(study, name, other)

    return change


def recording_of(study: Study, name: str) -> Recording:
    """The recording of a trial."""
    return next(trial.recording for trial in study.trials if trial.name == name)


def given_as(name: str, source: str) -> StudyChange:
    """The recording of trial `source` under the name of another, its last frame left out: a file of its own."""

    def change(study: Study) -> Study:
        other = recording_of(study, source)
        shorter = replace(other, time=other.time[:-1], markers=other.markers[:-1], plates=())
        return with_recording(study, name, shorter)

    return change


def attacks() -> Row:
    """Every attack on an isolated trial."""
    row = rows(Kind.ISOLATED)
    yield from row(
        "hip and knee declared for each other",
        ALL,
        declared(hip_r="knee_r", knee_r="hip_r"),
        JOINT,
        "hip",
        "knee|looks",
    )
    yield from row(
        "right hip declared as left", "synthetic uf3", declared(hip_r="hip_l"), JOINT, r"right|hip_r|left|\bside\b"
    )
    yield from row("knee declared as ankle", "synthetic functional", declared(knee_r="ankle_r"), JOINT, "knee|looks")
    for trial, bases in (("hip_r", ALL), ("knee_r", "synthetic uf3")):
        yield from row(
            f"labels left with right in {trial}",
            bases,
            in_trial(trial, sides_exchanged()),
            trial,
            f"{EXCHANGED}|{MIRROR}|facing",
        )
        yield from row(
            f"z mirrored in {trial}",
            ALL if trial == "hip_r" else "functional synthetic",
            in_trial(trial, axes((0, 1, 2), (1, 1, -1))),
            trial,
            MIRROR,
        )
    yield from row(
        "legs alone left with right in hip_r",
        "synthetic uf3",
        in_trial("hip_r", sides_exchanged("thigh", "shank", "foot")),
        "hip_r",
        f"{EXCHANGED}|{MIRROR}",
    )
    yield from row("of another person, hip_r", "synthetic", of_another("hip_r"), "hip_r|static", f"{PERSON}|{MOVED}")
    yield from row("x 1.03 in hip_r", ALL, in_trial("hip_r", scaled(1.03)), "hip_r|static", PERSON)
    yield from row("x 0.95 in knee_r", "synthetic uf3", in_trial("knee_r", scaled(0.95)), "knee_r|static", PERSON)
    yield from row("hip_r in millimetres", "synthetic", in_trial("hip_r", scaled(1000.0)), UNITS)
    for trial, bases in (("hip_r", "synthetic uf3"), ("knee_r", "functional uf3")):
        yield from row(
            f"hardly any movement in {trial}", bases, in_trial(trial, hardly_moving(0.05)), trial[:-2], SMALL
        )
    yield from row(
        "thigh marker 25 mm up in hip_r",
        ALL,
        in_trial("hip_r", displaced("thigh_r", "thigh_r[1]", (0, 25, 0))),
        "{thigh_r[1]}",
        MOVED,
    )
    yield from row(
        "shank marker 30 mm forward in knee_r, from half on",
        "synthetic uf3",
        in_trial("knee_r", displaced("shank_r", "shank_r[0]", (30, 0, 0), (0.5, 1.0))),
        "{shank_r[0]}",
        MOVED,
    )
    yield from row(
        "thigh slid 25 mm up in hip_r",
        "synthetic uf3",
        in_trial("hip_r", slid("thigh_r", (0, 25, 0))),
        "thigh|{thigh_r}",
        MOVED,
    )
    yield from row(
        "shank turned 12 deg in knee_r",
        "synthetic functional",
        in_trial("knee_r", turned("shank_r", 12.0)),
        "shank|{shank_r}",
        f"{MOVED}|turn",
    )
    yield from row(
        "thigh mirrored in hip_r",
        "synthetic uf3",
        in_trial("hip_r", mirrored_cluster("thigh_r")),
        "thigh|{thigh_r}",
        f"{EXCHANGED}|{MOVED}",
    )
    yield from row(
        "thigh labels exchanged in hip_r",
        "synthetic uf3",
        in_trial("hip_r", exchanged("thigh_r[0]", "thigh_r[1]")),
        "{thigh_r}",
        EXCHANGED,
    )
    yield from row(
        "thigh marker frozen in knee_r",
        "synthetic uf3",
        in_trial("knee_r", frozen("shank_r[1]", (0.3, 0.7))),
        "{shank_r[1]}",
        STUCK,
    )
    yield from row(
        "shank 100 ms late in knee_r",
        "synthetic",
        in_trial("knee_r", delayed("shank_r[0]", 0.1)),
        "{shank_r[0]}",
        rf"\blate\b|{MOVED}",
    )
    yield from row(
        "noise of 20 mm in hip_r", "uf3", in_trial("hip_r", noisy(20.0)), "hip_r", "noise|jump|scatter|out of"
    )
    yield from row(
        "backwards in hip_r", "synthetic uf3", in_trial("hip_r", backwards), "backwards", other_frames=("hip_r",)
    )
    yield from row("four times the frame rate in hip_r", "uf3", in_trial("hip_r", other_rate(4.0)), RATE)
    yield from row(
        "the knee trial given for the hip",
        "synthetic uf3",
        given_as("hip_r", "knee_r"),
        "hip_r|knee_r",
        "joint|looks like|same|move|declared",
    )
    yield from row(
        "the walk given for the hip",
        "synthetic uf3",
        given_as("hip_r", WALK),
        "hip_r",
        "joint|looks like|same|move|declared|walk",
    )
    yield from row(
        "the static trial given for the knee",
        "uf3 functional",
        given_as("knee_r", "static"),
        "knee",
        f"same|still|{SMALL}",
    )
