"""Attacks on what the study says of its recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from gaitcal import Study, load_marker_set
from scripts.validation.attacks.attack import WALK, Kind, StudyChange, with_recording
from scripts.validation.attacks.corpus.isolated_trials import recording_of
from scripts.validation.attacks.corpus.words import EXCHANGED, MIRROR, MOVED, PERSON, UNITS, WALKS, Row, rows
from scripts.validation.attacks.markers import displaced, exchanged, in_every, labels_of, sides_exchanged, slid
from scripts.validation.attacks.trajectories import axes, scaled


def files_exchanged(a: str, b: str) -> StudyChange:
    """Two trials with each other's file."""

    def change(study: Study) -> Study:
        one, other = recording_of(study, a), recording_of(study, b)
        return with_recording(with_recording(study, a, other), b, one)

    return change


def same_file(name: str, source: str) -> StudyChange:
    """A trial with the file of another."""
    return lambda study: with_recording(study, name, recording_of(study, source))


def marker_set(name: str) -> StudyChange:
    """The marker set of another protocol."""
    return lambda study: replace(study, marker_set=load_marker_set(name))


def weighing(weights: Mapping[str, float]) -> StudyChange:
    """Weights (by key) that the study gives."""

    def change(study: Study) -> Study:
        own = {label: w for key, w in weights.items() for label in labels_of(study.marker_set, key)}
        return replace(study, weights=own)

    return change


def without_a_table(study: Study) -> Study:
    """Every plate declared the right foot's."""
    return replace(
        study, trials=tuple(replace(t, plates={"1": "r", "2": "r"}) if t.name == WALK else t for t in study.trials)
    )


PELVIS = (
    # landmarks, mm (forward, up, right), bases: put on elsewhere, and there in all trials
    (("asis_r",), (0, 30, 0), "subject01 synthetic kad p01"),
    (("asis_l",), (0, 0, -30), "subject01 synthetic multi"),
    (("asis_r",), (-30, 0, 0), "pig p18"),
    (("asis_r", "asis_l"), (0, 30, 0), "subject01 synthetic child"),
    (("asis_r", "asis_l"), (-30, 0, 0), "synthetic kad"),
    (("sacrum",), (0, 40, 0), "subject01 synthetic pig"),
    (("sacrum",), (0, 0, 30), "kad uf3"),
)


def attacks() -> Row:
    """Every attack on the study's own words."""
    row = rows(Kind.STUDY)
    yield from row("static and walk exchanged", "subject01 synthetic pig", files_exchanged("static", WALK), WALKS)
    yield from row("the walk given as static", "pig child", same_file("static", WALK), f"same|{WALKS}")
    yield from row(
        "the static trial given as walk",
        "subject01 synthetic",
        same_file(WALK, "static"),
        "same|still|stand",
        quick="subject01",
    )
    yield from row(
        "the same file for hip and knee",
        "synthetic uf3",
        same_file("hip_r", "knee_r"),
        "same|hip_r|knee_r",
        quick="synthetic",
    )
    yield from row("marker set of another laboratory", "subject01 p01", marker_set("rcnl"), "marker|label|landmark")
    yield from row("marker set of another laboratory", "uf3 pig", marker_set("gait2354"), "marker|label|landmark")
    yield from row(
        "marker set without medial markers", "functional", marker_set("plug-in-gait"), "marker|label|landmark"
    )
    yield from row(
        "heel and toe renamed for each other",
        "subject01 pig uf3",
        in_every(exchanged("heel_r", "toe_r"), exchanged("heel_l", "toe_l")),
        "heel|toe|foot|feet|facing",
        f"{EXCHANGED}|backwards|behind|direction|heading",
    )
    yield from row(
        "knee and ankle renamed for each other",
        "pig",
        in_every(exchanged("knee_lat_r", "ankle_lat_r"), exchanged("knee_lat_l", "ankle_lat_l")),
        "knee|ankle|thigh|shank",
        f"{EXCHANGED}|length|above|below|{MOVED}",
    )
    yield from row(
        "left and right renamed for each other",
        "subject01 synthetic child",
        in_every(sides_exchanged()),
        f"{EXCHANGED}|{MIRROR}|backwards|facing",
    )
    yield from row(
        "left and right thigh renamed for each other",
        "synthetic p01",
        in_every(sides_exchanged("thigh")),
        "thigh",
        f"{EXCHANGED}|{MIRROR}",
    )
    for landmarks, mm, bases in PELVIS:
        axis = ("forward", "up", "right")[[bool(x) for x in mm].index(True)]
        yield from row(
            f"{' and '.join(landmarks)} {max(mm, key=abs):+d} mm {axis} in all trials",
            bases,
            in_every(*(displaced("pelvis", name, mm) for name in landmarks)),
            "asis|sacr|pelvi|hip|" + "|".join(f"{{{name}}}" for name in landmarks),
            MOVED,
        )
    yield from row(
        "pelvis markers 30 mm up in all trials",
        "subject01 synthetic kad",
        in_every(slid("pelvis", (0, 30, 0))),
        "pelvi|hip|asis",
        MOVED,
    )
    yield from row("z mirrored in all trials", "subject01 uf3 pig", in_every(axes((0, 1, 2), (1, 1, -1))), MIRROR)
    yield from row("all trials x 1.1", "subject01 uf3", in_every(scaled(1.1)), f"{PERSON}|{UNITS}|tall")
    yield from row("all trials x 0.9", "pig", in_every(scaled(0.9)), f"{PERSON}|{UNITS}|tall")
    yield from row("thigh cluster weighs nothing", "subject01 p01", weighing({"thigh_r": 0.0}), "thigh|weight")
    yield from row("pelvis weighs nothing", "synthetic", weighing({"pelvis": 0.0}), "pelvis|weight")
    yield from row("both plates declared the right foot's", "subject01 synthetic", without_a_table, "foot|plate")
