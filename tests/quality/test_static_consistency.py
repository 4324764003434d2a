"""One body in all trials: random faults of a sound study are named, the sound one has none."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.io.recording import Recording
from gaitcal.model.rotations import compute_root_angles
from gaitcal.model.segment_frames import find_nearest_rotation
from gaitcal.preprocess.joint_links import compute_joint_links
from gaitcal.preprocess.marker_clusters import align_points, fit_clusters
from gaitcal.preprocess.preprocessed_study import preprocess_study, preprocess_trial
from gaitcal.preprocess.static_disagreement import (
    compute_offset_limit,
    find_contradictions,
    find_possible_moves,
)
from gaitcal.preprocess.swapped_labels import find_swaps_by_lengths
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.study_checks import check_further, check_study
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Trial
from tests.messages import check_finding, numbers
from tests.quality.spoilt import Change, moved, scaled, serious, swapped, with_trial, without

Array = NDArray[np.float64]

BODY = ("one body", "body size", "displaced markers", "joint")
SIZE_MM = 35.0
"""Well above the 8 to 10 mm of skin, whatever the direction."""
ROUNDING = 1e-9
"""m: a rigid cluster without noise."""


@pytest.fixture(scope="module")
def trials(sound: Study) -> dict[str, TrialEvidence]:
    return {t.name: t for t in preprocess_study(sound).trials}


def report_contradictions(study: Study) -> list[Finding]:
    return [f for f in check_study(study) if f.topic in BODY]


def check_further_trial(study: Study, trials: dict[str, TrialEvidence]) -> list[Finding]:
    """Check the walk against a saved model."""
    evidence = preprocess_trial(
        study.trials[1], trials["walk"].model, study.marker_set, study.settings
    )  # type: ignore[arg-type]
    return [f for f in check_further(evidence) if f.topic in BODY]


def some_way(trial: TrialEvidence, segment: str, size: float) -> Array:
    """(1, 3) m in the plane of a cluster's markers."""
    static = trial.clusters[segment].static
    way = static[0] - static[1]
    return np.asarray(size * way / np.linalg.norm(way))[None]


def turned_with(trial: TrialEvidence, segment: str, labels: tuple[str, ...], by: Array) -> Change:
    """Displace markers by (n, 3) m in static axes, which move with the segment."""
    rotation = trial.clusters[segment].rotation

    def change(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        for label, own in zip(labels, by, strict=True):
            markers[:, recording.labels.index(label)] += rotation @ own
        return replace(recording, markers=markers)

    return change


def test_sound_study_has_no_contradictions(sound: Study) -> None:
    assert report_contradictions(sound) == []


def test_small_contradictions_are_not_reported(
    sound: Study, trials: dict[str, TrialEvidence]
) -> None:
    """A thigh cluster rotated by 12 deg about its length is an error of that size there only."""
    walk = trials["walk"]
    cluster = walk.clusters["thigh_r"]
    at = cluster.static - cluster.static.mean(axis=0)
    by = Rotation.from_euler("y", 12.0, degrees=True).apply(at) - at
    turned = walk.with_recording(turned_with(walk, "thigh_r", cluster.labels, by)(walk.recording))
    assert find_contradictions(turned.clusters, turned.links) == ()
    before, after = (
        np.rad2deg([m.rotation for m in find_possible_moves(t.clusters, t.links).values()])
        for t in (walk, turned)
    )
    assert before.max() < 2.0
    place = list(turned.clusters).index("thigh_r")
    assert 3.0 < after[place, 1] < 12.0 and np.delete(after, place, axis=0).max() < 3.0


def test_a_sound_cluster_has_the_static_shape_and_keeps_it(
    trials: dict[str, TrialEvidence],
) -> None:
    for cluster in trials["walk"].clusters.values():
        assert np.abs(cluster.offsets).max() < ROUNDING and np.nanmax(cluster.strayed) < ROUNDING


@pytest.mark.parametrize(
    ("seed", "segment"), list(enumerate(("foot_r", "foot_l", "thigh_r", "shank_l")))
)
def test_a_displaced_marker_is_named_with_its_size(
    sound: Study, trials: dict[str, TrialEvidence], seed: int, segment: str
) -> None:
    walk = trials["walk"]
    cluster = walk.clusters[segment]
    label = cluster.labels[np.random.default_rng(seed).integers(cluster.marker_count)]
    spoilt = with_trial(
        sound, "walk", turned_with(walk, segment, (label,), some_way(walk, segment, 1e-3 * SIZE_MM))
    )
    (found,) = report_contradictions(spoilt)
    assert f"'{label}'" in found.cause and (found.where, found.leg) == ("walk", segment[-1])
    assert abs(float(found.found.split(" mm off")[0]) - SIZE_MM) < 0.35 * SIZE_MM
    assert f'weights = {{ "{label}" = 0 }}' in found.cure
    assert report_contradictions(replace(spoilt, weights={label: 0.0})) == [], (
        "the cure silences it"
    )


def test_marker_displaced_in_all_trials_gives_one_finding(
    sound: Study, trials: dict[str, TrialEvidence]
) -> None:
    spoilt = with_trial(sound, "static", moved("R.Shank.Front", lambda x: x + [0.0, 0.03, 0.0]))
    found = [f for f in report_contradictions(spoilt) if "'R.Shank.Front'" in f.cause]
    assert [f.where for f in found] == [STUDY]
    check_finding(found[0], Code.MARKER_OFF_STATIC)


@pytest.mark.parametrize(
    "pair", [("R.Thigh.Upper", "R.Thigh.Front"), ("L.Shank.Upper", "L.Shank.Rear")]
)
def test_swapped_labels_give_one_error(sound: Study, pair: tuple[str, str]) -> None:
    (found,) = serious(with_trial(sound, "walk", swapped(*pair)))
    assert found.severity is Severity.ERROR and all(
        f"'{label}'" in found.evidence for label in pair
    )


@pytest.mark.parametrize(
    ("segment", "change", "shift", "code"),
    [
        (
            "thigh_r",
            Rotation.from_euler("y", 30.0, degrees=True).as_matrix(),
            0.02,
            Code.CLUSTER_SLID,
        ),
        ("foot_l", np.diag([1.0, 1.0, -1.0]), 0.0, Code.CLUSTER_MIRRORED),
    ],
    ids=["turned", "mirrored"],
)
def test_a_turned_or_mirrored_cluster_is_an_error(
    sound: Study,
    trials: dict[str, TrialEvidence],
    segment: str,
    change: Array,
    shift: float,
    code: Code,
) -> None:
    """The functional knee trial has it as the static trial."""
    cluster = trials["walk"].clusters[segment]
    away = cluster.static - cluster.static.mean(axis=0)
    by = away @ (change - np.eye(3)).T + [0.0, shift, 0.0]
    found = report_contradictions(
        with_trial(sound, "walk", turned_with(trials["walk"], segment, cluster.labels, by))
    )[0]
    check_finding(found, code, Severity.ERROR, leg=segment[-1])
    assert not shift or numbers(found.found)[1] == pytest.approx(1e3 * shift, abs=2.0)


def test_another_size_of_one_trial_and_of_the_static_one(sound: Study) -> None:
    (one,) = report_contradictions(with_trial(sound, "knee_r", scaled(1.03)))
    check_finding(one, Code.BODY_SIZE, "knee_r", 1.03, where="knee_r", topic="body size")
    (static,) = report_contradictions(with_trial(sound, "static", scaled(1.03)))
    assert static.where == "static" and static.severity is Severity.ERROR


@pytest.mark.parametrize("joint", ["knee_l", "hip_r", "ankle_l"])
def test_a_trial_declared_for_another_joint_names_the_one_that_moves(
    sound: Study, joint: str
) -> None:
    spoilt = replace(
        sound, trials=tuple(replace(t, joint=joint) if t.joint else t for t in sound.trials)
    )
    (found,) = [f for f in report_contradictions(spoilt) if f.topic == "joint"]
    assert found.severity is Severity.ERROR
    check_finding(found, Code.OTHER_JOINT, joint, "knee_r")


def test_alignment_and_rotations_are_exact() -> None:
    rng = np.random.default_rng(5)
    for _ in range(10):
        angles = rng.uniform(-1.0, 1.0, 3)
        rotation = Rotation.from_euler("ZXY", angles).as_matrix()
        np.testing.assert_allclose(compute_root_angles(rotation)[1:], angles[1:], atol=ROUNDING)
        np.testing.assert_allclose(find_nearest_rotation(2.0 * rotation), rotation, atol=ROUNDING)
        points, shift = rng.normal(size=(4, 3)), rng.normal(size=3)
        turn, back = align_points(points, points @ rotation.T + shift, rng.uniform(0.5, 2.0, 4))
        np.testing.assert_allclose(turn, rotation, atol=ROUNDING)
        np.testing.assert_allclose(back, shift, atol=ROUNDING)


def test_a_segment_with_two_markers_borrows_the_hip_centre(
    sound: Study, trials: dict[str, TrialEvidence]
) -> None:
    walk = trials["walk"]
    assert walk.stance is not None
    fewer = fit_clusters(
        walk.recording, walk.stance, sound.marker_set.landmarks, lambda m: m != "R.Thigh.Rear"
    )
    assert fewer["thigh_r"].labels[-1] == "hip centre" and fewer["thigh_r"].reduced
    assert not fewer["thigh_l"].borrowed


def test_the_odd_walk_of_three_is_named(sound: Study, trials: dict[str, TrialEvidence]) -> None:
    walk, rng = sound.trials[1], np.random.default_rng(0)

    def again(name: str) -> Trial:
        noise = 1e-4 * rng.normal(size=walk.recording.markers.shape)
        return replace(
            walk,
            name=name,
            recording=replace(walk.recording, markers=walk.recording.markers + noise),
        )

    three = replace(sound, trials=(*sound.trials, again("walk2"), again("walk3")))
    assert report_contradictions(three) == []
    label, by = (
        trials["walk"].clusters["thigh_r"].labels[:1],
        some_way(trials["walk"], "thigh_r", 0.011),
    )
    (found,) = report_contradictions(
        with_trial(three, "walk2", turned_with(trials["walk"], "thigh_r", label, by))
    )
    check_finding(found, Code.ODD_WALK, 2, where="walk2")


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("label", ["R.Thigh.Upper", "R.Thigh.Front", "R.Thigh.Rear"])
def test_in_a_further_trial_the_marker_itself_is_named(
    sound: Study, trials: dict[str, TrialEvidence], label: str, axis: int
) -> None:
    """Checked against the saved model."""
    spoilt = with_trial(
        sound,
        "walk",
        turned_with(trials["walk"], "thigh_r", (label,), 0.04 * np.eye(3)[axis][None]),
    )
    (found,) = check_further_trial(spoilt, trials)
    check_finding(found, Code.MARKER_OFF_STATIC, label)
    assert check_further_trial(sound, trials) == []


def test_constant_flexion_is_no_displaced_marker(trials: dict[str, TrialEvidence]) -> None:
    walk = trials["walk"]
    hip = walk.clusters["pelvis"].rotation.transpose(0, 2, 1) @ walk.clusters["thigh_r"].rotation
    bent = np.argsort(np.abs(compute_root_angles(hip)[:, 0]))[-12:]
    part = replace(
        walk.recording, time=walk.recording.time[:12], markers=walk.recording.markers[bent]
    )
    centres = {**walk.stance.centres, "hip_r": walk.stance.centres["hip_r"] + [0.08, 0.0, 0.0]}
    clusters = fit_clusters(part, walk.stance, {}, lambda _: True)
    links = compute_joint_links(clusters, centres)
    assert links["hip_r"].far > 0.1 and find_contradictions(clusters, links) == ()
    near = {joint: replace(link, far=0.0) for joint, link in links.items()}
    assert find_contradictions(clusters, near) != ()


def test_limits_grow_with_tall_people(sound: Study, trials: dict[str, TrialEvidence]) -> None:
    tall = replace(sound, subject=replace(sound.subject, height=2.1))
    walk = next(t for t in preprocess_study(tall).trials if t.name == "walk")
    for segment, cluster in walk.clusters.items():
        assert compute_offset_limit(cluster) == pytest.approx(
            1.2 * compute_offset_limit(trials["walk"].clusters[segment])
        )
    for joint, link in walk.links.items():
        assert link.reach == pytest.approx(1.2 * trials["walk"].links[joint].reach, rel=0.01)


@pytest.mark.parametrize("scatter", [0.0, 0.02])
def test_scatter_of_cluster_sizes_widens_the_limit(
    sound: Study, trials: dict[str, TrialEvidence], scatter: float
) -> None:
    spoilt = sound
    clusters = trials["walk"].clusters
    for (segment, cluster), way in zip(
        clusters.items(), np.linspace(-1.0, 1.0, len(clusters)), strict=True
    ):
        size = 0.981 + scatter * way
        by = (size - 1.0) * (cluster.static - cluster.static.mean(axis=0))
        for name in ("walk", "knee_r"):
            spoilt = with_trial(
                spoilt, name, turned_with(trials[name], segment, cluster.labels, by)
            )
    assert any(f.topic == "body size" for f in report_contradictions(spoilt)) == (scatter == 0.0)


@pytest.mark.parametrize("label", ["R.Thigh.Upper", "R.Thigh.Front"])
def test_of_two_markers_both_are_named_and_neither_is_left_out(sound: Study, label: str) -> None:
    two = with_trial(sound, "walk", without("R.Thigh.Rear"))
    assert report_contradictions(two) == []
    (found,) = report_contradictions(
        with_trial(two, "walk", moved(label, lambda x: x + [0.0, 0.05, 0.0]))
    )
    assert (
        "'R.Thigh.Upper'" in found.cause
        and "'R.Thigh.Front'" in found.cause
        and "weights" not in found.cure
    )


def test_displaced_marker_does_not_blame_two_others(trials: dict[str, TrialEvidence]) -> None:
    """Three markers on a foot, one displaced: swapping the others may halve the error but is
    wrong.
    """
    trio = ("R.Heel", "R.Midfoot.Sup", "R.Toe.Tip")
    walk, rng = trials["walk"], np.random.default_rng(7)
    few = without(*set(walk.templates["foot_r"][0]) - set(trio))(walk.recording)
    for wrong in trio:
        for _ in range(40):
            way = rng.normal(size=3)
            by = rng.uniform(0.03, 0.12) * way / np.linalg.norm(way)
            spoilt = walk.with_recording(turned_with(walk, "foot_r", (wrong,), by[None])(few))
            found = find_swaps_by_lengths(spoilt.recording, spoilt.templates)
            assert all(wrong in (one.label, one.other) for one in found)
