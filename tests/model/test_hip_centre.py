"""Hip centres by regressions and as a file has them."""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.errors import InputError, Severity
from gaitcal.faults.study import check_study
from gaitcal.io.labels import ComputedPoints
from gaitcal.io.recording import Recording
from gaitcal.model.landmarks import labelled_hips
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.nominal import PUBLISHED, nominal_model
from gaitcal.model.segment_frames import HipCentre, hip_centre
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import nominal_of
from tests.faults.spoilt import sound_study, with_trial
from tests.model.people import published_static

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


def hips_in_laboratory(static: Recording) -> dict[str, np.ndarray]:
    """Plausible hip centres: those of the published subject, each displaced by 12 mm."""
    p = {label: static.markers[0, i] for i, label in enumerate(static.labels)}
    middle = 0.5 * (p["R.ASIS"] + p["L.ASIS"])
    return {"r": middle + [-0.05, -0.08, 0.09], "l": middle + [-0.055, -0.07, -0.085]}


def made(static: Recording, rule: HipCentre) -> SubjectModel:
    return nominal_model(static, load_marker_set("published"), PUBLISHED, hip_centre=rule)


def test_harrington_by_hand() -> None:
    """X = -0.24 150 - 9.9, y = -0.30 240 - 10.9, z = 0.33 240 + 7.3 mm; the left one mirrored."""
    right = hip_centre(HipCentre.HARRINGTON, 240 * MM, 150 * MM, "r")
    np.testing.assert_allclose(right, np.array([-45.9, -82.9, 86.5]) * MM, atol=ROUNDING)
    left = hip_centre(HipCentre.HARRINGTON, 240 * MM, 150 * MM, "l")
    np.testing.assert_allclose(left, right * [1, 1, -1], atol=ROUNDING)


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("labels", [("RHJC", "LHJC"), ("R_HJC", "L_HJC"), ("R.HJC", "L.HJC"), ("HJC_R", "HJC_L")])
def test_hip_centres_of_the_file_are_taken(labels: tuple[str, str], measured: bool) -> None:
    static = published_static()
    hips = hips_in_laboratory(static)
    with_hips = with_points(static, dict(zip(labels, hips.values(), strict=True)), measured=measured)
    model = made(with_hips, HipCentre.GIVEN)
    distance = np.linalg.norm(model.landmarks["hjc_r"][1] - model.landmarks["hjc_l"][1])
    assert distance == pytest.approx(np.linalg.norm(hips["r"] - hips["l"]), abs=ROUNDING)
    gap = np.linalg.norm(model.landmarks["asis_r"][1] - model.landmarks["hjc_r"][1])
    wanted = np.linalg.norm(static.markers[0, static.labels.index("R.ASIS")] - hips["r"])
    assert gap == pytest.approx(wanted, abs=ROUNDING)
    assert any(labels[0] in note for note in model.notes)


def test_hip_centres_of_the_file_are_offered() -> None:
    static = published_static()
    hips = hips_in_laboratory(static)
    model = made(with_points(static, {"RHJC": hips["r"], "LHJC": hips["l"]}, measured=False), HipCentre.HARRINGTON)
    (offer,) = [note for note in model.notes if "hip_centre = 'given'" in note]
    assert "RHJC (computed by another program), LHJC" in offer
    assert not any("'given'" in note for note in made(static, HipCentre.HARRINGTON).notes)


def test_hip_centres_that_are_not_there_are_asked_for() -> None:
    with pytest.raises(InputError, match=r"hip_centre = 'given': the static trial has no hip centre hjc_r and hjc_l"):
        made(published_static(), HipCentre.GIVEN)


def test_exchanged_hip_centres_are_refused() -> None:
    static = published_static()
    hips = hips_in_laboratory(static)
    exchanged = with_points(static, {"RHJC": hips["l"], "LHJC": hips["r"]}, measured=True)
    with pytest.raises(InputError, match=r"hip centre RHJC: found it 1\d\d mm .* sides exchanged"):
        made(exchanged, HipCentre.GIVEN)


@pytest.mark.parametrize("rule", [HipCentre.HARRINGTON, HipCentre.BELL])
def test_the_distance_measured_between_the_bones_is_taken(rule: HipCentre) -> None:
    """Not that of the markers, which soft tissue holds apart; as x goes with the depth, Harrington's x stays."""
    stout = replace(PUBLISHED, asis_distance=0.200)
    model = nominal_model(published_static(), load_marker_set("published"), stout, hip_centre=rule)
    depth = np.linalg.norm(model.landmarks["sacrum"][1])
    np.testing.assert_allclose(model.landmarks["hjc_r"][1], hip_centre(rule, 0.200, depth, "r"), atol=ROUNDING)
    note = next(n for n in model.notes if n.startswith("hip centres by"))
    assert "200 mm between the ASIS (as measured by hand; 245 mm between their markers)" in note


@pytest.mark.parametrize("mm", [110, 290])
def test_a_distance_that_cannot_belong_to_the_markers_is_told(mm: float) -> None:
    wrong = nominal_model(published_static(), load_marker_set("published"), replace(PUBLISHED, asis_distance=mm * MM))
    plain = nominal_model(published_static(), load_marker_set("published"), PUBLISHED)
    np.testing.assert_array_equal(wrong.landmarks["hjc_r"][1], plain.landmarks["hjc_r"][1])
    assert any(f"the measured {mm} mm are not used" in note for note in wrong.notes)


@pytest.mark.parametrize(
    ("shift", "told"), [((0.0, 0.0, 0.0), False), ((0.0, -0.06, 0.0), True), ((0.05, 0.0, 0.0), True)]
)
def test_given_hips_that_are_no_mirror_images_are_doubted(shift: tuple[float, float, float], told: bool) -> None:
    sound = sound_study()
    hips = hips_in_laboratory(sound.static.recording)
    points = {"RHJC": hips["r"] + np.array(shift), "LHJC": hips["l"]}
    given = with_trial(sound, "static", lambda r: with_points(r, points, measured=False))
    given = replace(given, settings=CalibrationSettings(hip_centre="given"))
    found = [f for f in check_study(given) if f.topic == "hip centres"]
    assert bool(found) is told
    if told:
        assert found[0].severity is Severity.WARNING and f"{1e3 * shift[1] - 10:+.0f} mm up" in found[0].found
    (note,) = [n for n in nominal_of(given).notes if n.startswith("hip centres are points")]
    assert "this far from where Harrington 2007 has them: RHJC" in note and "mm, LHJC" in note


def test_labels_of_hip_centres() -> None:
    assert labelled_hips(["RHJC", "L_HJC"]) == {"r": "RHJC", "l": "L_HJC"}
    assert labelled_hips(["rhj", "LHipJC"]) == {"r": "rhj", "l": "LHipJC"}
    assert labelled_hips(["RKJC", "RHEE", "THJC", "RHJCX", "HJC"]) == {}


def test_the_published_protocol_keeps_the_published_regression() -> None:
    assert CalibrationSettings().hip_rule == "harrington"
    assert CalibrationSettings(protocol="published").hip_rule == "bell"
    assert CalibrationSettings(mode="simultaneous").hip_rule == "bell"
    assert CalibrationSettings(protocol="published", hip_centre="harrington").hip_rule == "harrington"
