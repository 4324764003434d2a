"""Markers that the static trial lost, rebuilt from other trials."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.faults.study import check_study
from gaitcal.findings import Severity
from gaitcal.io.recording import Recording
from gaitcal.io.still import still_window
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.rebuilt_markers import Rebuilding, rebuild_lost, without_spikes
from gaitcal.study.study import Study, completed_static, nominal_of
from tests.real_studies import write_study

EXACT_M = 1e-9
"""Rigid motions of a rigid body leave rounding alone."""
PELVIS = {
    "RASI": [0.0, 1.0, 0.12],
    "LASI": [0.0, 1.0, -0.12],
    "RPSI": [-0.15, 1.03, 0.05],
    "LPSI": [-0.15, 1.03, -0.05],
}
SET = MarkerSet(
    name="pelvis alone",
    description="four markers",
    landmarks={"asis_r": ("RASI",), "asis_l": ("LASI",), "sacrum": ("RPSI", "LPSI")},
    tracking={"pelvis": tuple(PELVIS)},
)
RATE = 100.0


def recording(paths: dict[str, Array]) -> Recording:
    markers = np.stack(list(paths.values()), axis=1)
    return Recording(
        source="made", time=np.arange(len(markers)) / RATE, labels=tuple(paths), markers=np.asarray(markers)
    )


def standing(*lost: str) -> Recording:
    return recording({m: np.tile(at, (60, 1)) for m, at in PELVIS.items() if m not in lost})


def moving(seed: int, *lost: str) -> Recording:
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.1, (40, 3)), axis=0))
    shift = np.cumsum(rng.normal(0.0, 0.05, (40, 3)), axis=0)
    return recording({m: turns.apply(at) + shift for m, at in PELVIS.items() if m not in lost})


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), label=st.sampled_from(list(PELVIS)))
def test_a_rigid_body_gives_its_marker_back(seed: int, label: str) -> None:
    done = rebuild_lost(standing(label), SET, [("walk", moving(seed))], "static")
    (marker,) = done.markers
    assert marker.label == label
    assert marker.trial == "walk"
    assert np.abs(marker.place - PELVIS[label]).max() < EXACT_M
    filled = done.static.markers[:, done.static.labels.index(label)]
    assert np.abs(filled - PELVIS[label]).max() < EXACT_M


def test_nothing_is_touched_where_nothing_is_lost() -> None:
    static = standing()
    done = rebuild_lost(static, SET, [("walk", moving(1))], "static")
    assert done.static is static or np.array_equal(done.static.markers, static.markers)
    assert not done.markers
    assert not done.left


def test_the_static_trial_itself_is_asked_first_where_it_shows_the_marker_at_another_time() -> None:
    long = recording(
        {m: np.vstack([np.tile(at, (60, 1)), moving(3).markers[:, k]]) for k, (m, at) in enumerate(PELVIS.items())}
    )
    markers = long.markers.copy()
    markers[:60, long.labels.index("RPSI")] = np.nan
    done = rebuild_lost(replace(long, markers=markers), SET, [], "static")
    (marker,) = done.markers
    assert marker.trial == "static"
    assert np.abs(marker.place - PELVIS["RPSI"]).max() < EXACT_M


def test_two_points_determine_nothing_and_it_is_said() -> None:
    done = rebuild_lost(standing("RPSI", "LPSI"), SET, [("walk", moving(2))], "static")
    assert not done.markers
    assert set(done.left) == {"RPSI", "LPSI"}
    assert "RASI and LASI" in done.left["RPSI"]
    assert "three are needed" in done.left["RPSI"]


def test_points_on_a_line_determine_nothing_and_it_is_said() -> None:
    line = {"A": [0.0, 1.0, 0.0], "B": [0.0, 1.1, 0.0], "C": [0.0, 1.2, 0.0], "D": [0.1, 1.1, 0.0]}
    marker_set = MarkerSet(name="line", description="", landmarks={}, tracking={"pelvis": tuple(line)})
    static = recording({m: np.tile(at, (60, 1)) for m, at in line.items() if m != "D"})
    walk = recording({m: np.tile(at, (60, 1)) for m, at in line.items()})
    done = rebuild_lost(static, marker_set, [("walk", walk)], "static")
    assert "on one line" in done.left["D"]


def test_a_body_that_changed_its_shape_is_told_as_uncertain() -> None:
    """A companion 12 mm elsewhere in the walk: the place is worse, and its uncertainty says so."""
    walk = moving(4)
    bent = walk.markers.copy()
    bent[:, walk.labels.index("LASI")] += 0.012 * (bent[:, 1] - bent[:, 0]) / 0.24
    good = rebuild_lost(standing("RPSI"), SET, [("walk", walk)], "static").markers[0]
    worse = rebuild_lost(standing("RPSI"), SET, [("walk", replace(walk, markers=bent))], "static").markers[0]
    away = float(np.linalg.norm(worse.place - PELVIS["RPSI"]))
    assert away > 10 * EXACT_M
    assert worse.uncertainty > good.uncertainty
    assert away < 2 * worse.uncertainty


def without(study: Study, label: str) -> Study:
    """The study whose static trial lost a marker."""
    static = study.static
    k = static.recording.labels.index(label)
    markers = static.recording.markers.copy()
    markers[:, k] = np.nan
    lost = replace(static, recording=replace(static.recording, markers=markers))
    return replace(study, trials=tuple(lost if t.name == static.name else t for t in study.trials))


@pytest.fixture(scope="module")
def subject01(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Study:
    return Study.load(write_study("subject01", data_dir, tmp_path_factory.mktemp("subject01")))


@pytest.mark.parametrize("label", ["R.Thigh.Front", "L.Shank.Rear", "R.Heel", "L.Toe.Lat"])
def test_a_real_marker_is_rebuilt_as_well_as_is_said(subject01: Study, label: str) -> None:
    """Median 2.3, at most 7.8 mm over 23 markers of this person; said are 4 to 12 mm."""
    recorded = subject01.static.recording
    still = still_window(recorded, subject01.marker_set.labels).frames
    truth = np.nanmean(recorded.markers[still, recorded.labels.index(label)], axis=0)
    done: Rebuilding = completed_static(without(subject01, label))
    (marker,) = done.markers
    assert np.linalg.norm(marker.place - truth) < min(marker.uncertainty, 0.008)


def test_a_lost_landmark_gives_a_model_and_a_finding_and_is_no_evidence(subject01: Study) -> None:
    lost = without(subject01, "R.Heel")
    model, whole = nominal_of(lost), nominal_of(subject01)
    away = model.landmarks["toe_r"][1] - whole.landmarks["toe_r"][1]
    assert np.abs(away).max() < 0.01
    assert any("'R.Heel' rebuilt" in note for note in model.notes)
    findings = check_study(lost)
    assert not [f for f in findings if f.severity is Severity.ERROR]
    (told,) = [f for f in findings if f.topic == "lost markers"]
    assert told.severity is Severity.WARNING
    assert "heel_r" in told.cause


def test_single_positions_out_of_line_are_left_out_and_steps_are_not() -> None:
    """A path that steps aside and stays, noise, and what borders on a gap stay as they are."""
    time = np.arange(200) / 100.0
    path = np.stack([np.sin(4.0 * time), 0.1 * np.cos(9.0 * time), time], axis=1)
    labels = ("spiked", "stepped", "noisy", "beside a gap", "at the ends")
    markers = np.repeat(path[:, None], len(labels), axis=1)
    markers[[40, 90, 140], 0] += [0.0, 0.1, 0.0]
    markers[100:, 1] += 0.1
    markers[:, 2] += np.random.default_rng(1).normal(0.0, 0.03, (200, 3))
    markers[50, 3], markers[51, 3] = np.nan, path[51] + 0.1
    markers[[0, -1], 4] += 0.1
    found, out = without_spikes(Recording(source="x", time=time, labels=labels, markers=markers))
    assert list(out) == ["spiked"] and out["spiked"] == (3, pytest.approx(0.1, abs=0.005))
    gone = np.isnan(found.markers[:, :, 0]) & ~np.isnan(markers[:, :, 0])
    assert np.argwhere(gone).tolist() == [[40, 0], [90, 0], [140, 0]]
