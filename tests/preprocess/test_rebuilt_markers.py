"""Markers that the static trial lost are rebuilt from the other trials."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.errors import Severity
from gaitcal.io.recording import Recording, find_still_window
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.present_markers import get_path
from gaitcal.preprocess.rebuilt_markers import MarkerReconstruction, reconstruct_markers
from gaitcal.preprocess.study_model import build_nominal_model, rebuild_static
from gaitcal.study.study import Study
from tests.messages import check_text
from tests.model.people import without
from tests.quality.spoilt import findings, serious, with_trial

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


def recorded(paths: dict[str, Array]) -> Recording:
    """Markers (nf, 3) m at 100 Hz."""
    markers = np.stack(list(paths.values()), axis=1) if paths else np.empty((2, 0, 3))
    return Recording(
        source="made", time=np.arange(len(markers)) / 100.0, labels=tuple(paths), markers=markers
    )


def standing(*lost: str) -> Recording:
    return recorded({m: np.tile(at, (60, 1)) for m, at in PELVIS.items() if m not in lost})


def moving(seed: int, *lost: str) -> Recording:
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.1, (40, 3)), axis=0))
    shift = np.cumsum(rng.normal(0.0, 0.05, (40, 3)), axis=0)
    return recorded({m: turns.apply(at) + shift for m, at in PELVIS.items() if m not in lost})


def rebuilt(
    static: Recording, *walks: Recording, marker_set: MarkerSet = SET
) -> MarkerReconstruction:
    return reconstruct_markers(static, marker_set, [("walk", walk) for walk in walks], "static")


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), label=st.sampled_from(list(PELVIS)))
def test_a_rigid_body_gives_its_marker_back(seed: int, label: str) -> None:
    done = rebuilt(standing(label), moving(seed))
    (marker,) = done.markers
    assert (marker.label, marker.trial) == (label, "walk")
    assert np.abs(marker.position - PELVIS[label]).max() < EXACT_M
    assert np.abs(get_path(done.static, label) - PELVIS[label]).max() < EXACT_M


def test_nothing_is_touched_where_nothing_is_lost() -> None:
    done = rebuilt(standing(), moving(1))
    assert np.array_equal(done.static.markers, standing().markers)
    assert not done.markers and not done.not_reconstructed


def test_the_static_trial_itself_is_asked_first_where_it_shows_the_marker_at_another_time() -> None:
    long = recorded(
        {m: np.vstack([get_path(standing(), m), get_path(moving(3), m)]) for m in PELVIS}
    )
    (marker,) = rebuilt(lost_from(long, "RPSI", slice(0, 60))).markers
    assert marker.trial == "static"
    assert np.abs(marker.position - PELVIS["RPSI"]).max() < EXACT_M


def lost_from(recording: Recording, label: str, frames: slice = slice(None)) -> Recording:
    markers = recording.markers.copy()
    markers[frames, recording.labels.index(label)] = np.nan
    return replace(recording, markers=markers)


def test_two_points_and_points_on_a_line_determine_nothing() -> None:
    done = rebuilt(standing("RPSI", "LPSI"), moving(2))
    assert not done.markers and set(done.not_reconstructed) == {"RPSI", "LPSI"}
    check_text(done.not_reconstructed["RPSI"], "RASI and LASI", "pelvis")
    line = {"A": [0.0, 1.0, 0.0], "B": [0.0, 1.1, 0.0], "C": [0.0, 1.2, 0.0], "D": [0.1, 1.1, 0.0]}
    marker_set = MarkerSet(
        name="line", description="", landmarks={}, tracking={"pelvis": tuple(line)}
    )
    walk = recorded({m: np.tile(at, (60, 1)) for m, at in line.items()})
    check_text(
        rebuilt(without(walk, "D"), walk, marker_set=marker_set).not_reconstructed["D"],
        "A, B, C",
        "pelvis",
    )


def test_a_changed_shape_makes_the_position_uncertain() -> None:
    """A companion 12 mm elsewhere in the walk: the place is worse, and its uncertainty says so."""
    walk = moving(4)
    bent = walk.markers.copy()
    bent[:, walk.labels.index("LASI")] += 0.012 * (bent[:, 1] - bent[:, 0]) / 0.24
    good, worse = (
        rebuilt(standing("RPSI"), w).markers[0] for w in (walk, replace(walk, markers=bent))
    )
    away = float(np.linalg.norm(worse.position - PELVIS["RPSI"]))
    assert 10 * EXACT_M < away < 2 * worse.uncertainty and worse.uncertainty > good.uncertainty


def that_lost(study: Study, label: str) -> Study:
    """The study whose static trial lost a marker."""
    return with_trial(study, study.static.name, lambda r: lost_from(r, label))


@pytest.fixture(scope="module")
def subject01(real_study: Callable[[str], Study]) -> Study:
    return real_study("subject01")


@pytest.mark.parametrize("label", ["R.Thigh.Front", "L.Shank.Rear", "R.Heel", "L.Toe.Lat"])
def test_a_real_marker_is_reconstructed_within_its_uncertainty(
    subject01: Study, label: str
) -> None:
    """Median 2.3, at most 7.8 mm over 23 markers of this person; said are 4 to 12 mm."""
    recorded = subject01.static.recording
    still = find_still_window(recorded, subject01.marker_set.labels).frames
    truth = np.nanmean(recorded.markers[still, recorded.labels.index(label)], axis=0)
    done: MarkerReconstruction = rebuild_static(that_lost(subject01, label))
    (marker,) = done.markers
    assert np.linalg.norm(marker.position - truth) < min(marker.uncertainty, 0.008)


def test_a_lost_landmark_gives_a_model_and_a_finding_and_is_no_evidence(subject01: Study) -> None:
    lost = that_lost(subject01, "R.Heel")
    model, whole = build_nominal_model(lost), build_nominal_model(subject01)
    assert np.abs(model.landmarks["toe_r"][1] - whole.landmarks["toe_r"][1]).max() < 0.01
    assert any("'R.Heel'" in note for note in model.notes)
    assert [f for f in serious(lost) if f.severity is Severity.ERROR] == []
    (finding,) = findings(lost, "lost markers")
    assert finding.severity is Severity.WARNING and "heel_r" in finding.cause
