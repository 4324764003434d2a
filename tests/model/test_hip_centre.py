"""Hip centres by regressions and as a file has them."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gaitcal.errors import InputError, Severity
from gaitcal.io.labels import ComputedPoints
from gaitcal.io.recording import Recording
from gaitcal.model.landmarks import find_hip_labels
from gaitcal.model.nominal import PUBLISHED
from gaitcal.model.segment_frames import HipCentre, compute_hip_centre
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.study.settings import CalibrationSettings
from tests.messages import check_note, check_text, refuses
from tests.model.people import from_published, published_static
from tests.quality.spoilt import findings, sound_study, with_trial
from tests.refusal import refusal

ROUNDING = 1e-12
"""m, of coordinates of a metre."""
MM = 1e-3


def with_points(static: Recording, points: dict[str, np.ndarray], *, measured: bool) -> Recording:
    """The static trial with further points, as markers or as what another program computed."""
    tracks = np.stack([np.broadcast_to(p, (len(static.time), 3)) for p in points.values()], axis=1)
    if not measured:
        return replace(static, computed=ComputedPoints(tuple(points), tracks))
    markers = np.concatenate([static.markers, tracks], axis=1)
    return replace(static, labels=(*static.labels, *points), markers=markers)


def hips_in_laboratory(static: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Plausible hip centres, right and left: those of the published subject, each displaced by 12
    mm.
    """
    middle = static.markers[0, [static.labels.index(f"{side}.ASIS") for side in "RL"]].mean(axis=0)
    return middle + [-0.05, -0.08, 0.09], middle + [-0.055, -0.07, -0.085]


def test_harrington_by_hand() -> None:
    """X = -0.24 150 - 9.9, y = -0.30 240 - 10.9, z = 0.33 240 + 7.3 mm; the left one mirrored."""
    right = compute_hip_centre(HipCentre.HARRINGTON, 240 * MM, 150 * MM, "r")
    np.testing.assert_allclose(right, np.array([-45.9, -82.9, 86.5]) * MM, atol=ROUNDING)
    left = compute_hip_centre(HipCentre.HARRINGTON, 240 * MM, 150 * MM, "l")
    np.testing.assert_allclose(left, right * [1, 1, -1], atol=ROUNDING)


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize(
    "labels", [("RHJC", "LHJC"), ("R_HJC", "L_HJC"), ("R.HJC", "L.HJC"), ("HJC_R", "HJC_L")]
)
def test_hip_centres_of_the_file_are_taken(labels: tuple[str, str], measured: bool) -> None:
    static = published_static()
    right, left = hips_in_laboratory(static)
    with_hips = with_points(
        static, dict(zip(labels, (right, left), strict=True)), measured=measured
    )
    model = from_published(with_hips, hip_centre=HipCentre.GIVEN)
    for place, end, there in (
        ("hjc_l", "hjc_r", left - right),
        ("asis_r", "hjc_r", static.markers[0, static.labels.index("R.ASIS")] - right),
    ):
        apart = np.linalg.norm(model.landmarks[place][1] - model.landmarks[end][1])
        assert apart == pytest.approx(np.linalg.norm(there), abs=ROUNDING)
    assert any(labels[0] in note for note in model.notes)


def test_hip_centres_of_the_file_are_offered_and_asked_for() -> None:
    static = published_static()
    right, left = hips_in_laboratory(static)
    there = with_points(static, {"RHJC": right, "LHJC": left}, measured=False)
    (offer,) = [
        n
        for n in from_published(there, hip_centre=HipCentre.HARRINGTON).notes
        if "hip_centre = 'given'" in n
    ]
    check_text(offer, "RHJC", "LHJC")
    assert not any(
        "'given'" in note for note in from_published(hip_centre=HipCentre.HARRINGTON).notes
    )
    with refuses(InputError, "hip_centre = 'given'", "hjc_r", "hjc_l"):
        from_published(hip_centre=HipCentre.GIVEN)
    exchanged = with_points(static, {"RHJC": left, "LHJC": right}, measured=True)
    said = refusal(from_published, exchanged, hip_centre=HipCentre.GIVEN)
    assert re.search(r"hip centre RHJC: found it 1\d\d mm .* sides swapped", said)


@pytest.mark.parametrize("rule", [HipCentre.HARRINGTON, HipCentre.BELL])
def test_the_distance_measured_between_the_bones_is_taken(rule: HipCentre) -> None:
    """Not that of the markers, which soft tissue holds apart; as x goes with the depth,
    Harrington's x stays.
    """
    stout = replace(PUBLISHED, asis_distance=0.200)
    model = from_published(subject=stout, hip_centre=rule)
    depth = np.linalg.norm(model.landmarks["sacrum"][1])
    np.testing.assert_allclose(
        model.landmarks["hjc_r"][1], compute_hip_centre(rule, 0.200, depth, "r"), atol=ROUNDING
    )
    note = next(n for n in model.notes if n.startswith("hip centres by"))
    check_text(note, "ASIS", 200, 245)


@pytest.mark.parametrize("mm", [110, 290])
def test_a_distance_that_cannot_belong_to_the_markers_is_told(mm: float) -> None:
    wrong = from_published(subject=replace(PUBLISHED, asis_distance=mm * MM))
    np.testing.assert_array_equal(
        wrong.landmarks["hjc_r"][1], from_published().landmarks["hjc_r"][1]
    )
    check_note(wrong.notes, "ASIS", mm)


@pytest.mark.parametrize(
    ("shift", "told"),
    [((0.0, 0.0, 0.0), False), ((0.0, -0.06, 0.0), True), ((0.05, 0.0, 0.0), True)],
)
def test_given_hips_that_are_no_mirror_images_are_doubted(
    shift: tuple[float, float, float], told: bool
) -> None:
    sound = sound_study()
    right, left = hips_in_laboratory(sound.static.recording)
    points = {"RHJC": right + np.array(shift), "LHJC": left}
    given = with_trial(sound, "static", lambda r: with_points(r, points, measured=False))
    given = replace(given, settings=CalibrationSettings(hip_centre="given"))
    found = findings(given, "hip centres")
    assert [f.severity for f in found] == [Severity.WARNING] * told
    assert all(f"{1e3 * shift[1] - 10:+.0f} mm up" in f.found for f in found)
    (note,) = [
        n for n in build_nominal_model(given).notes if n.startswith("hip centres are points")
    ]
    check_text(note, "Harrington 2007", "RHJC", "LHJC")


@pytest.mark.parametrize(
    ("labels", "found"),
    [
        ("RHJC L_HJC", ["RHJC", "L_HJC"]),
        ("rhj LHipJC", ["rhj", "LHipJC"]),
        ("RKJC RHEE THJC RHJCX HJC", []),
    ],
)
def test_labels_of_hip_centres(labels: str, found: list[str]) -> None:
    assert find_hip_labels(labels.split()) == dict(zip("rl", found, strict=False))


@pytest.mark.parametrize(
    ("settings", "hip", "ankle"),
    [
        ({}, "harrington", "auto"),
        ({"protocol": "published"}, "bell", "markers"),
        ({"mode": "simultaneous"}, "bell", "markers"),
        (
            {"protocol": "published", "hip_centre": "harrington", "ankle_zero": "sole"},
            "harrington",
            "sole",
        ),
    ],
)
def test_the_published_protocol_keeps_the_published_rules(
    settings: dict[str, Any], hip: str, ankle: str
) -> None:
    chosen = CalibrationSettings(**settings)
    assert (chosen.hip_rule, chosen.ankle_rule) == (hip, ankle)
