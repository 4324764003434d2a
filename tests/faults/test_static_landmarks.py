"""The static trial by itself: exchanged and displaced landmarks, a wrong height, bent people; nothing on sound ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gaitcal.errors import Finding, Severity
from gaitcal.faults.evidence import MarkerEvidence
from gaitcal.faults.role import standing_legs, standing_straight
from gaitcal.faults.static_landmarks import (
    Displaced,
    Exchange,
    exchanged,
    faults,
    height_factor,
    landmarks,
    proportions,
)
from gaitcal.faults.study import check_study, examined
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.recording import Recording
from gaitcal.model import body_plan as body_build
from gaitcal.model.body_plan import body_axes, cost, cost_of_build, measures
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Trial
from gaitcal.synthetic.motion import standing_pose, static_motion, synthetic_markers
from gaitcal.synthetic.subject import on_the_floor, recording_of, synthetic_model
from tests.faults.spoilt import Array, Change, moved, swapped, with_trial
from tests.real_studies import REAL, study_text

ERROR, WARNING = Severity.ERROR, Severity.WARNING
STANDS = """
subject = {{ name = "synthetic", mass_kg = {mass}, height_m = 1.70, sex = "male" }}
markers = {{ set = "published" }}
trial = [{{ name = "static", role = "static", file = "static.c3d" }}]
"""


def evidence(study: Study, trial: Trial) -> MarkerEvidence:
    return MarkerEvidence.of(trial, study.marker_set, study.subject, study.settings, None)


def body(study: Study) -> tuple[dict[str, Array], float]:
    return landmarks(evidence(study, study.static)), study.subject.height


@pytest.fixture(scope="module")
def people(
    data_dir: Path, sound: Study, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[dict[str, Array], float]]:
    """Landmarks and height of a synthetic and four real people."""
    out = {"synthetic": body(sound)}
    for name in REAL:
        path = tmp_path_factory.mktemp(name) / "study.toml"
        text = study_text(name, data_dir)
        first = text.index("[[trial]]", text.index("[[trial]]") + 1)
        path.write_text(text[:first], encoding="utf-8")
        out[name] = body(Study.load(path))
    return out


def spoilt(study: Study, change: Change) -> list[Finding]:
    found = check_study(with_trial(study, "static", change))
    return [f for f in found if f.where == "static" and f.severity is not Severity.INFO]


def test_no_landmark_of_sound_people_is_accused(people: dict[str, tuple[dict[str, Array], float]]) -> None:
    for name, (p, height) in people.items():
        assert list(faults(p, height)) == [], name
        assert height_factor(p, height) == 1.0
        assert max(abs(m.z) for m in measures(p, height)) < 3.0, name


def test_a_foot_without_a_landmark_turns_nobody(people: dict[str, tuple[dict[str, Array], float]]) -> None:
    """Forward comes from the pelvis then: toes that turn out by 26 degrees are no displacement."""
    for name, (p, height) in people.items():
        for lost in ("toe_l", "heel_r", "ankle_lat_l"):
            some = {landmark: x for landmark, x in p.items() if landmark != lost}
            assert list(faults(some, height)) == [], (name, lost)
    p, _ = people["subject01"]
    outward = Rotation.from_rotvec([0.0, -0.45, 0.0]).as_matrix()
    for lost, kept in (("toe_l", "r"), ("heel_r", "l")):
        some = {landmark: x for landmark, x in p.items() if landmark != lost}
        heel, toe = some[f"heel_{kept}"], some[f"toe_{kept}"]
        before, after = body_axes(some), body_axes({**some, f"toe_{kept}": heel + outward @ (toe - heel)})
        assert before is not None and after is not None
        assert np.allclose(before, after)
        assert before[:, 0] @ body_axes(p)[:, 0] > np.cos(np.deg2rad(6.0))  # type: ignore[index]


@pytest.mark.parametrize("lost", ["L.Toe.Tip", "R.Heel", "R.Knee.Lat", "L.ASIS"])
def test_without_a_required_marker_no_other_is_accused(sound: Study, lost: str) -> None:
    def without(r: Recording) -> Recording:
        kept = [i for i, label in enumerate(r.labels) if label != lost]
        return replace(r, labels=tuple(r.labels[i] for i in kept), markers=r.markers[:, kept])

    def wrong(r: Recording) -> Recording:
        return without(moved("L.Ankle.Lat", lambda x: x + [0.05, 0.05, 0.0])(r))

    assert "'L.Ankle.Lat'" in spoilt(sound, moved("L.Ankle.Lat", lambda x: x + [0.05, 0.05, 0.0]))[0].cause
    found = spoilt(sound, wrong)
    errors = [f for f in found if f.severity is ERROR]
    if lost in ("L.Toe.Tip", "R.Heel"):  # rebuilt from the walk: the ankle is judged beside it
        assert [f.topic for f in errors] == ["landmarks"]
        assert "'L.Ankle.Lat'" in errors[0].cause
    else:
        assert [f.topic for f in errors] == ["static trial"]
        assert all(lost in f.found for f in found)


EXCHANGES = [
    (("knee_med_r", "knee_med_l"),),
    (("knee_lat_r", "knee_lat_l"),),
    (("ankle_med_r", "ankle_med_l"),),
    (("ankle_lat_r", "ankle_lat_l"),),
    (("knee_lat_l", "knee_med_l"),),
    (("ankle_lat_r", "ankle_med_r"),),
    (("asis_r", "asis_l"),),
    (("heel_r", "toe_r"),),
    (("heel_r", "heel_l"), ("toe_r", "toe_l")),
    (("knee_lat_r", "knee_lat_l"), ("knee_med_r", "knee_med_l")),
]


@pytest.mark.parametrize("pairs", EXCHANGES, ids=lambda pairs: "+".join(a for a, _ in pairs))
def test_exchanged_landmarks_are_found_on_everybody(
    people: dict[str, tuple[dict[str, Array], float]], pairs: tuple[tuple[str, str], ...]
) -> None:
    for name, (p, height) in people.items():
        if all(landmark in p for pair in pairs for landmark in pair):
            first = next(faults(exchanged(p, pairs), height))
            assert isinstance(first, Exchange) and first.pairs == pairs, (name, first)


# The same ones every time: of 1780 draws 10 are missed, heels across a foot that is turned out, whom nothing but the
# foot's own direction would betray, and feet do turn.
@pytest.mark.slow
@settings(max_examples=40, derandomize=True)
@given(
    person=st.sampled_from(["synthetic", *REAL]),
    landmark=st.sampled_from(["ankle_lat", "ankle_med", "knee_lat", "heel"]),
    side=st.sampled_from("rl"),
    direction=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 0.3),
)
def test_a_landmark_90_mm_off_is_found_and_named(
    people: dict[str, tuple[dict[str, Array], float]],
    person: str,
    landmark: str,
    side: str,
    direction: tuple[float, ...],
) -> None:
    p, height = people[person]
    name = f"{landmark}_{side}"
    if name not in p:
        return
    away = 0.09 * np.array(direction) / np.linalg.norm(direction)
    first = next(faults({**p, name: p[name] + away}, height))
    assert isinstance(first, Displaced)
    told = (first.landmark, *(other for other, _ in first.rivals))
    # A heel straight up leaves both feet as unlike each other as the other heel down: of uf3 that one is told.
    assert name in told or (landmark == "heel" and first.landmark.startswith("heel"))
    assert 0.05 < first.size < 0.14


@pytest.mark.slow
def test_how_often_a_landmark_40_mm_off_is_found(people: dict[str, tuple[dict[str, Array], float]]) -> None:
    """In nine of ten cases on thirteen people; three of four are asked for here, as only two people stand for all."""
    rng = np.random.default_rng(1)
    told, named, of = 0, 0, 0
    for p, height in (people[name] for name in ("subject01", "uf3")):
        for name in p:
            if name == "sacrum":
                continue
            away = rng.normal(size=3)
            found = list(faults({**p, name: p[name] + 0.04 * away / np.linalg.norm(away)}, height))
            of += 1
            told += bool(found)
            if found and isinstance(found[0], Displaced):
                named += name in (found[0].landmark, *(other for other, _ in found[0].rivals))
    assert told > 0.75 * of
    assert named > 0.7 * of


def test_medial_knee_labels_across_are_an_error_with_labels_and_cure(sound: Study) -> None:
    (found,) = spoilt(sound, swapped("R.Knee.Med", "L.Knee.Med"))
    assert (found.severity, found.topic) == (ERROR, "landmarks")
    assert "'R.Knee.Med' and 'L.Knee.Med' carry each other's labels" in found.cause
    assert "knee width" in found.found and "people of this height have" in found.found
    assert '"R.Knee.Med" = "L.Knee.Med"' in found.cure


def test_a_landmark_off_its_bone_is_told_with_side_and_millimetres(sound: Study) -> None:
    (found,) = spoilt(sound, moved("R.Ankle.Lat", lambda x: x + [0.0, 0.035, 0.0]))
    assert (found.severity, found.leg) == (WARNING, "r")
    assert "'R.Ankle.Lat' lies about 3" in found.cause and "mostly up" in found.cause


def test_a_knee_as_wide_as_two_is_refused(sound: Study) -> None:
    found = spoilt(sound, moved("R.Knee.Lat", lambda x: x + [0.0, 0.0, 0.145]))
    assert found[0].severity is ERROR
    assert "knee width, right 25" in found[0].found and "'R.Knee.Lat'" in found[0].cause


def test_markers_of_thigh_and_shank_exchanged(sound: Study) -> None:
    found = spoilt(sound, swapped("R.Thigh.Upper", "R.Shank.Rear"))
    assert [f.severity for f in found] == [ERROR]
    assert "'R.Thigh.Upper'" in found[0].found and "nearest: shank_r" in found[0].found


@pytest.mark.parametrize("factor", [0.87, 1.15])
def test_a_height_that_no_length_goes_with(people: dict[str, tuple[dict[str, Array], float]], factor: float) -> None:
    for name, (p, height) in people.items():
        found = height_factor(p, factor * height)
        assert abs(found * factor - 1.0) < 0.08, name
        assert list(faults(p, factor * height)) == [], name


def bent(knee: float, other: float) -> Recording:
    """The synthetic person standing with right and left knee bent by so many degrees, hips and ankles following."""
    motion = static_motion()
    model = published_model(static_only=True)
    q = motion.q.copy()
    names = list(COORDINATES)
    for side, angle in (("r", np.deg2rad(knee)), ("l", np.deg2rad(other))):
        q[:, names.index(f"hip_flexion_{side}")] += 0.5 * angle
        q[:, names.index(f"knee_angle_{side}")] += angle
        q[:, names.index(f"ankle_angle_{side}")] += 0.5 * angle
    markers = synthetic_markers(model.parameters, model.markers, q)
    return Recording(source="bent", time=motion.basis.time, labels=model.markers.labels, markers=markers)


@pytest.mark.parametrize(
    ("knees", "cause", "severity"),
    [((15.0, 12.0), None, None), ((45.0, 42.0), "bent knees", WARNING), ((50.0, 5.0), "unevenly", WARNING)],
)
def test_how_somebody_stands_is_told_and_no_landmark_accused(
    sound: Study, knees: tuple[float, float], cause: str | None, severity: Severity | None
) -> None:
    trial = evidence(sound, replace(sound.static, recording=bent(*knees)))
    stands = standing_legs(landmarks(trial), sound.subject.height)
    assert stands is not None and np.allclose(stands.knees, knees, atol=2.0)
    assert list(proportions(trial)) == []
    found = list(standing_straight(trial))
    assert [(f.severity, cause in f.cause) for f in found if cause] == ([(severity, True)] if cause else [])
    assert bool(found) is bool(cause)


@pytest.mark.parametrize(("share", "severity"), [(0.479, None), (0.455, Severity.INFO), (0.41, WARNING)])
def test_legs_are_doubted_where_hardly_anybody_has_them(
    sound: Study, share: float, severity: Severity | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Legs of one person in twelve, in fifty, in three thousand, where no other length speaks against a height."""
    trial = evidence(sound, sound.static)
    monkeypatch.setattr("gaitcal.faults.static_landmarks.hip_height", lambda t: share * t.subject.height)
    assert [f.severity for f in proportions(trial)] == ([] if severity is None else [severity])


@pytest.mark.parametrize("seed", range(1, 7))
def test_somebody_who_is_built_otherwise_is_not_accused(seed: int, tmp_path: Path) -> None:
    """Every joint axis turned by up to 10 degrees, every joint shifted by up to 10 mm, in both of its segments."""
    model = synthetic_model(np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0]), perturb=True)
    standing = on_the_floor(model, static_motion(standing=standing_pose(model.parameters)))
    write_c3d(tmp_path / "static.c3d", recording_of("static", standing, model, model.markers.labels))
    (tmp_path / "study.toml").write_text(STANDS.format(mass=model.subject.mass), encoding="utf-8")
    study = Study.load(tmp_path / "study.toml")
    (static,) = examined(study).trials
    assert list(proportions(static)) == []
    p, height = landmarks(static), study.subject.height
    assert cost_of_build(p, height) < 0.8 * cost(measures(p, height))


def test_the_cost_of_build_is_the_least_of_turns_and_shifts(sound: Study) -> None:
    """Against the same least squares solved densely; one landmark alone is no build."""
    rng = np.random.default_rng(3)
    standing, height = body(sound)
    p = {name: point + 0.01 * rng.normal(size=3) for name, point in standing.items()}
    z = np.array([m.z for m in measures(p, height)])
    columns = [(np.array([m.z for m in measures(q, height)]) - z) * scale for q, scale in body_build.moved(p)]
    stacked = np.vstack([np.stack(columns, axis=1), np.eye(len(columns))])
    least = np.linalg.lstsq(stacked, np.concatenate([z, np.zeros(len(columns))]), rcond=None)[1]
    assert cost_of_build(p, height) == pytest.approx(float(least[0]), rel=1e-8)
