"""Centres of pressure outside the feet are reported, by frame, and only there."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.dynamics.off_sole import DIVIDED, IDENTICAL_CENTRE_M, compute_sole_edge
from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.force_plate import build_plate_from_moment, resample_wrench
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.subject_model import Subject
from gaitcal.preprocess.clean_trial import clean_trial
from gaitcal.preprocess.plate_contacts import Feet
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.foot_on_plate import check_contacts, check_pressure_outside_sole
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role, Trial
from tests.messages import check_finding, numbers
from tests.quality import spoilt
from tests.quality.spoilt import Array, Change, drafted, plates

RECORDINGS = Path(__file__).parent / "recordings"
UP = np.array([0.0, 1.0, 0.0])
HEIGHT = 1.70


def evidence(recording: Recording, plates: dict[str, str] | None = None) -> TrialEvidence:
    """A walk of the published markers."""
    trial = Trial(name="walk", role=Role.GAIT, recording=recording, plates=plates or {})
    subject = Subject("synthetic", 69.4, HEIGHT, "male")
    marker_set = load_marker_set("published")
    return TrialEvidence(
        trial=clean_trial(trial, marker_set.segment_of),
        marker_set=marker_set,
        subject=subject,
        settings=CalibrationSettings(),
    )


def find_pressure_faults(trial: TrialEvidence) -> list[Finding]:
    """Find faults of centres of pressure, with no other findings."""
    return list(check_pressure_outside_sole(trial, ()))


def outline(back: float, front: float, left: float, right: float) -> Array:
    """(4, 3) m, the corners of a plate."""
    return np.array(
        [[back, 0.0, left], [front, 0.0, left], [front, 0.0, right], [back, 0.0, right]]
    )


@cache
def divided_walk() -> Recording:
    return read_recording(
        RECORDINGS / "divided_total.csv", forces=RECORDINGS / "divided_total_forces.csv"
    )


@pytest.mark.parametrize("corners", [False, True])
@pytest.mark.parametrize("named", [False, True])
def test_divided_total_force_is_reported(named: bool, corners: bool) -> None:
    """With and without plate corners, and with and without named feet."""
    recording = divided_walk()
    if corners:
        own = zip(recording.plates, (0.0, -0.6), strict=True)
        recording = replace(
            recording,
            plates=tuple(replace(p, corners=outline(-0.7, 1.9, z, z + 0.6)) for p, z in own),
        )
    trial = evidence(recording, {"1": "r", "2": "l"} if named else None)
    (found,) = find_pressure_faults(trial)
    assert (found.severity, found.leg, found.cause) == (
        Severity.WARNING,
        "",
        f"{DIVIDED} (plates 1 and 2)",
    )
    check_finding(found, Code.DIVIDED_FORCE, 0.02, 0.1, 0.54, 0.62, 220, 416)
    assert [f for f in check_contacts(trial) if f.severity is not Severity.INFO] == []


@pytest.mark.parametrize("every", [0.5, 1.0])
def test_total_force_on_both_plates_gives_one_finding(every: float) -> None:
    """Half of it, or all, on each: far from both feet most of the time, which is not repeated."""
    recording = divided_walk()
    total = np.sum([resample_wrench(p, recording.time) for p in recording.plates], axis=0) * every
    both = [
        build_plate_from_moment(
            name, recording.time, total[:, :3], total[:, 3:], np.zeros(3), UP, None
        )
        for name in "12"
    ]
    trial = evidence(replace(recording, plates=tuple(both)))
    (found,) = find_pressure_faults(trial)
    assert found.cause.startswith(DIVIDED) and "0.00-1.03 s" in found.found
    assert [
        f
        for f in check_contacts(trial)
        if f.severity is not Severity.INFO and f.topic == "plate to foot"
    ] == []


AHEAD = np.array([1.0, 0.0])
TIME = np.arange(101) / 100.0
LOADED = slice(20, 81)


def standing(toe: Array, other: Array | None = None) -> Recording:
    """The right foot stands, its toe marker 0.19 m from the heel along `toe`; the left heel at
    `other`, or swings.
    """
    line = 0.19 * toe / np.linalg.norm(toe)
    markers = np.zeros((len(TIME), 4, 3))
    markers[:, 1, [0, 2]] = line
    markers[:, :2, 1] = 0.03
    markers[:, 2:, [0, 2]] = [np.zeros(2) if other is None else other] + np.array(
        [np.zeros(2), line]
    )
    markers[:, 2:, 1] = 0.03
    if other is None:
        markers[:, 2:] += np.outer(TIME, [1.5, 0.0, 0.0])[:, None] + [0.0, 0.1, -0.2]
    labels = ("R.Heel", "R.Toe.Tip", "L.Heel", "L.Toe.Tip")
    return Recording(source="made up", time=TIME, labels=labels, markers=markers, plates=())


def pressed(path: Array, load: Array, name: str = "1", corners: Array | None = None) -> ForcePlate:
    """A plate with the centre of pressure `path` (n, 2) m under loads (n,) N in the loaded frames,
    and nothing else.
    """
    force, point = np.zeros((len(TIME), 3)), np.zeros((len(TIME), 3))
    force[LOADED, 1] = load
    point[LOADED, 0], point[LOADED, 2] = path.T
    return ForcePlate(
        name=name, time=TIME, force=force, point=point, moment=np.zeros_like(force), corners=corners
    )


def edge_of(recording: Recording, foot: int = 0) -> Array:
    """(m, 2) m, the edge of a sole of somebody who stands."""
    feet = Feet(recording.time, evidence(recording).landmark).build_points(HEIGHT)
    return compute_sole_edge(feet, foot, slice(0, 1))[0]


ARCH = 60.0 + 640.0 * np.sin(np.linspace(0.0, np.pi, 61))
"""N: 60 at first, 700 at most, 60 at last."""
weights = st.lists(st.floats(0.01, 1.0), min_size=12, max_size=12)


@settings(max_examples=25)
@given(weights, weights, st.floats(0.0, 2.0 * np.pi), st.floats(0.0, 2.0 * np.pi))
def test_pressure_inside_the_sole_is_accepted_and_80_mm_off_reported(
    first: list[float], last: list[float], turn: float, way: float
) -> None:
    recording = standing(np.array([np.cos(turn), np.sin(turn)]))
    edge = edge_of(recording)
    ends = [np.array(w) @ edge / np.sum(w) for w in (first, last)]
    path = ends[0] + np.linspace(0.0, 1.0, 61)[:, None] * (ends[1] - ends[0])
    assert find_pressure_faults(evidence(replace(recording, plates=(pressed(path, ARCH),)))) == []

    out = np.array([np.cos(way), np.sin(way)])
    path = path + (float((edge @ out).max()) + 0.08 - path @ out)[:, None] * out
    trial = evidence(replace(recording, plates=(pressed(path, ARCH),)))
    (found,) = [
        f
        for f in (*find_pressure_faults(trial), *check_contacts(trial))
        if f.severity is not Severity.INFO
    ]
    if found.leg:  # otherwise it is so far from both feet that `contacts` says so
        assert (found.code, found.leg) == (Code.PRESSURE_LEAVES_FOOT, "r")
        assert {0.2, 0.8, 100} <= {*numbers(found.found)}


@pytest.mark.parametrize(
    "way",
    [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)],
    ids=["front", "rear", "right", "left"],
)
def test_direction_and_duration_of_pressure_outside(way: tuple[float, float]) -> None:
    recording = standing(AHEAD)
    edge = edge_of(recording)
    path = np.tile(edge.mean(axis=0), (61, 1))
    path[30:50] = edge[(edge @ way).argmax()] + 0.06 * np.array(way)
    (found,) = find_pressure_faults(
        evidence(replace(recording, plates=(pressed(path, np.full(61, 600.0)),)))
    )
    check_finding(found, Code.PRESSURE_LEAVES_FOOT, 0.5, 0.69, 60, 33)
    assert (
        find_pressure_faults(
            evidence(replace(recording, plates=(pressed(path, np.full(61, 600.0)),)), {"1": "none"})
        )
        == []
    )


def test_noise_of_moments_at_small_loads_is_not_reported() -> None:
    """1 N·m of noise moves the centre of 25 N by 40 mm, and that of 600 N by 2 mm."""
    recording = standing(AHEAD)
    edge = edge_of(recording)
    heel, tip = edge[:, 0].min() + 0.01, edge[:, 0].max() - 0.01
    load = np.interp(np.arange(61), [0, 15, 45, 60], [25.0, 600.0, 600.0, 25.0])
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0.0, 1.0, (61, 2)) / load[:, None]
        path = np.column_stack([np.linspace(heel, tip, 61), np.zeros(61)]) + noise
        assert (
            find_pressure_faults(evidence(replace(recording, plates=(pressed(path, load),)))) == []
        )


def test_both_feet_on_one_plate_include_the_ground_between() -> None:
    """Unless its corners hold one of them alone."""
    recording = standing(AHEAD, np.array([0.0, -0.25]))
    between = np.tile([0.08, -0.10], (61, 1))
    load = np.full(61, 650.0)
    assert (
        find_pressure_faults(evidence(replace(recording, plates=(pressed(between, load),)))) == []
    )
    alone = pressed(between, load, corners=outline(-0.1, 0.4, -0.12, 0.3))
    (found,) = find_pressure_faults(evidence(replace(recording, plates=(alone,))))
    check_finding(found, Code.PRESSURE_LEAVES_FOOT)
    other = pressed(np.tile([0.08, -0.25], (61, 1)), load, "2")
    (found,) = find_pressure_faults(
        evidence(replace(recording, plates=(pressed(between, load), other)))
    )
    assert found.leg == "r", "the left foot has a plate of its own"


def test_a_foot_across_two_plates_is_not_divided() -> None:
    """The centre on either side of the border is near to it, but not the same point."""
    recording = standing(AHEAD)
    parts = [
        np.tile([0.1, z], (61, 1)) for z in (-3.0 * IDENTICAL_CENTRE_M, 3.0 * IDENTICAL_CENTRE_M)
    ]
    two = tuple(
        pressed(path, np.full(61, 300.0), name) for path, name in zip(parts, "12", strict=True)
    )
    assert find_pressure_faults(evidence(replace(recording, plates=two))) == []


@cache
def real_walks(name: str, data: Path) -> tuple[TrialEvidence, ...]:
    """The walks over plates of one folder."""
    file = data / name / "study.toml"
    study = Study.load(file) if file.exists() else drafted(data / name)
    return walks_of(study)


def walks_of(study: Study) -> tuple[TrialEvidence, ...]:
    walks = [t for t in study.trials if t.role is Role.GAIT and t.recording.plates]
    return tuple(spoilt.evidence(study, t) for t in walks)


@pytest.fixture(scope="module")
def treadmill(real_study: Callable[[str], Study]) -> TrialEvidence:
    (walk,) = walks_of(real_study("subject01"))
    return walk


@pytest.mark.parametrize(
    "name",
    [
        "children/HC002D",
        "children/HC032A",
        "labs_c3d/kad",
        "labs_c3d/multi",
        "opensim_truth/p01",
        "opensim_truth/p18",
    ],
)
def test_real_walks_have_pressure_under_the_feet(name: str, data_dir: Path) -> None:
    """Adults, children, turns, feet across two plates, two feet one after the other on
    one plate.
    """
    walks = real_walks(name, data_dir)
    assert walks and [f.line for walk in walks for f in find_pressure_faults(walk)] == []


def with_recording(trial: TrialEvidence, change: Change) -> TrialEvidence:
    return replace(trial, trial=replace(trial.trial, recording=change(trial.recording)))


def moved(trial: TrialEvidence, x: float, z: float, number: int | None = None) -> TrialEvidence:
    """Some plates, or all, displaced by m."""
    return with_recording(trial, plates(lambda p: replace(p, point=p.point + [x, 0.0, z]), number))


def test_displaced_plates_of_a_treadmill(treadmill: TrialEvidence) -> None:
    assert (
        find_pressure_faults(treadmill) == [] == find_pressure_faults(moved(treadmill, 0.03, 0.0))
    )
    (both,) = find_pressure_faults(moved(treadmill, -0.12, 0.0))
    check_finding(both, Code.PLATES_ELSEWHERE, leg="")
    (one,) = find_pressure_faults(moved(treadmill, 0.0, 0.08, 1))
    check_finding(one, Code.PRESSURE_LEAVES_FOOT, 1, leg="r")


@pytest.mark.parametrize(
    ("topic", "cause", "legs"),
    [
        ("time", "clocks differ", []),
        ("plates", "plate 2: saturated", ["r"]),
        ("displaced markers", "marker '{heel}'", ["l"]),
    ],
)
def test_one_fault_gives_one_finding(
    treadmill: TrialEvidence, topic: str, cause: str, legs: list[str]
) -> None:
    """Faults of other checks, unless notes: time offset, the plate, the heel marker."""
    walk = moved(treadmill, -0.12, 0.0)
    cause = cause.format(heel=walk.marker_set.landmarks["heel_r"][0])
    blamed = walk.warning(topic, cause, "", code=Code.CLOCKS_DIFFER)
    assert [f.leg for f in check_pressure_outside_sole(walk, [blamed])] == legs
    assert (
        len(list(check_pressure_outside_sole(walk, [replace(blamed, severity=Severity.INFO)]))) == 1
    )


def test_partly_loaded_stance_is_no_time_offset(sound: Study) -> None:
    """Loaded 0.3 s after the foot came down, and free before it leaves."""

    def part(p: ForcePlate) -> ForcePlate:
        loaded = p.time[p.force[:, 1] > 50.0]
        inside = (p.time > loaded[0] + 0.3) & (p.time < loaded[-1] - 0.05)
        return replace(p, force=p.force * inside[:, None])

    walk = spoilt.with_trial(sound, "walk", lambda r: replace(r, plates=(part(r.plates[0]),)))
    found = list(check_contacts(spoilt.evidence(walk, walk.trials[1])))
    assert found and Code.CLOCKS_DIFFER not in {f.code for f in found}


def test_late_forces_are_a_time_offset(data_dir: Path) -> None:
    """On a floor, where only the ends of a loading leave the foot."""
    for walk in real_walks("labs_c3d/multi", data_dir):
        (found,) = find_pressure_faults(
            with_recording(walk, plates(lambda p: replace(p, time=p.time + 0.12)))
        )
        check_finding(found, Code.LOADED_IN_AIR)


@pytest.mark.parametrize(
    ("corners", "severity", "stands"),
    [(0.0, Severity.WARNING, True), (5.0, Severity.INFO, False), (None, Severity.WARNING, False)],
    ids=["dead", "missed", "no outline"],
)
def test_unloaded_plates_are_a_fault_only_under_a_foot(
    corners: float | None, severity: Severity, stands: bool
) -> None:
    square = None if corners is None else outline(corners - 0.5, corners + 0.5, -0.5, 0.5)
    plate = pressed(np.zeros((61, 2)), np.zeros(61), corners=square)
    recording = replace(standing(AHEAD), plates=(plate,))
    (found,) = check_contacts(evidence(recording))
    unseen = replace(
        recording, labels=("R.Heel", "a", "L.Heel", "b")
    )  # toes that the static trial alone has
    assert [f.severity for f in check_contacts(evidence(unseen))] == [Severity.WARNING]
    parts = ("right foot", 0.0, 1.0) if stands else ()
    check_finding(found, Code.NO_STEP_ON_PLATE, severity, *parts)
    assert ("foot" in found.found) == stands
