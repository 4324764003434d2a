"""A page of however many and long trials stays under its limit, and says what it leaves out."""

import base64
import json
import re
from typing import Any

import numpy as np
import pytest

from gaitcal.page.page_data import calibration_page_data, curves_left_out, thinned
from gaitcal.page.plain_data import GAP, base64_of, floats, lengths, script_json
from gaitcal.page.scene import person_scene
from gaitcal.page.view import Shown, page_html, sentences
from tests.fake_result import fake_calibration
from tests.page.people import long_motion, standard_errors, subject_model, walking_scene, walking_trial

LIMIT = 25_000_000
"""bytes that a page may have."""
FRAMES = 3334
"""Of a trial of 10 000, one in three."""


def long_trial(name: str, curves: int = 100) -> dict[str, Any]:
    """As many curves with as many parts as a walk on plates has."""
    time = np.arange(FRAMES) * 0.03
    values = np.sin(time)
    values[5] = np.nan
    part = lengths(values)
    curve = {"base": "hip_flexion", "valid": 0, **dict.fromkeys(("value", "se", "own", "nominal"), part), "truth": None}
    return {
        "name": name,
        "frames": 10_000,
        "every": 3,
        "time": floats(time),
        "masks": [base64_of(np.arange(FRAMES, dtype="<u1"))],
        "curves": [curve] * curves,
        "strides": [],
    }


def unpacked(packed: dict[str, Any]) -> np.ndarray:
    raw = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2")
    return np.where(raw == GAP, np.nan, packed["low"] + packed["step"] * (raw.astype(float) + 32767))


def test_a_sheet_of_common_size_stays_as_it_is() -> None:
    sheet = calibration_page_data(fake_calibration())
    assert thinned(sheet) is sheet
    assert curves_left_out(sheet) == ()


def test_what_stays_are_the_same_values_at_their_times() -> None:
    trial = long_trial("walk")
    (short,) = thinned({"trials": [trial]}, most=1_000_000)["trials"]
    factor = short["every"] // 3
    assert factor > 1 and short["frames"] == 10_000
    for part in ("value", "se", "own", "nominal"):
        np.testing.assert_array_equal(unpacked(short["curves"][7][part]), unpacked(trial["curves"][7][part])[::factor])
    assert short["curves"][7]["truth"] is None
    time = np.frombuffer(base64.b64decode(short["time"]), dtype="<f4")
    np.testing.assert_allclose(time, np.arange(FRAMES)[::factor] * 0.03, rtol=1e-6)
    assert base64.b64decode(short["masks"][0]) == bytes(np.arange(FRAMES, dtype="<u1")[::factor])
    assert len(script_json({"trials": [short]})) < 1_200_000


@pytest.mark.slow
def test_long_trials_stay_under_the_limit() -> None:
    model = subject_model()
    trial = walking_trial(model, long_motion(10_000), "long", None)
    scene = person_scene(model, (trial,) * 12, standard_errors())
    data = calibration_page_data(fake_calibration()) | {"trials": [long_trial("long")] * 12}
    shown = Shown(scene, data)
    page = page_html(shown)
    assert LIMIT / 2 < len(page) < LIMIT
    left_out = sentences(shown)
    assert len(left_out) == 2 * 12
    assert re.search(r"holds \d+ of 10000 frames, one in \d+;", left_out[0])
    assert "its curves hold one frame in" in left_out[12]
    assert sentences(Shown(walking_scene())) == ()


def test_the_sheet_may_stand_in_a_script_whatever_it_says() -> None:
    names = ["</script>", "<!--", "\u202e\u2028\ud800", '"\\', "@@PAGE@@"]
    text = script_json({"names": names})
    assert "<" not in text and text.isascii() and json.loads(text)["names"] == names
