"""The built-in person beside the normal bands, and the bands themselves: the table, its signs, its
source.
"""

import numpy as np
import pytest

from gaitcal.gait.normal_bands import SPEEDS, find_bands_file, read_normal_bands
from scripts.tools import walking_person as walking

SHARE = 0.75
"""Of frames of a leg's stride; of two real adults (OpenSim's subject01, a Plug-in Gait walk) 0.81
to 0.95 are.
"""

PEOPLE = {
    "hip_flexion_moment": ((10, -1), (50, 1)),
    "knee_angle_moment": ((12, -1), (40, 1)),
    "knee_adduction_moment": ((16, -1), (46, -1)),
    "ankle_angle_moment": ((4, 1), (48, -1)),
}
"""Variable -> percent of the stride and sign there: extensors and abductors bear the body, flexors
begin the swing, the heel is let down, the calf pushes off; signs as in
docs/explanation/conventions.md."""


@pytest.fixture(scope="module")
def walk() -> walking.Walk:
    return walking.true_walk()


@pytest.mark.parametrize("speed", [speed.name for speed in SPEEDS])
def test_every_table_says_source_licence_and_signs_and_spans_the_stride(speed: str) -> None:
    text = find_bands_file(speed).read_text(encoding="utf-8")
    said = (
        "# source: children 4 to 17 years, ",
        "n = 83 (Schwartz",
        "# licence: ",
        "CC BY-SA 4.0",
        "# signs: clinical",
    )
    assert all(words in text for words in said)
    bands = read_normal_bands(speed)
    assert len(bands) == 17 and set(PEOPLE) < set(bands)
    for band in bands.values():
        np.testing.assert_array_equal(band.percent, np.arange(0, 101, 2))
        assert (band.sd > 0).all()


def test_the_bands_have_the_signs_of_people() -> None:
    for name, signs in PEOPLE.items():
        band = walking.normal_bands()[name.removesuffix("_moment")]
        means = band.set_index("percent")["mean"]
        assert abs(means[100] - means[0]) < 2 * band["sd"].iloc[0]  # a stride ends as it begins
        for percent, sign in signs:
            assert sign * means[percent] > 0.05


def test_every_centre_of_pressure_is_in_its_sole(walk: walking.Walk) -> None:
    for foot in range(2):
        away = walking.outside_sole(walk, foot)[walk.loaded[:, foot]]
        assert len(away) > 100 and (away <= 0).all()


def test_the_peaks_of_moments_are_those_of_people(walk: walking.Walk) -> None:
    found = walking.peaks(walk, walking.normal_bands())
    assert len(found) == 18 and [p for p in found if abs(p.off) > walking.WITHIN] == []


@pytest.mark.parametrize("foot", [0, 1])
def test_moments_stay_in_the_bands(walk: walking.Walk, foot: int) -> None:
    for stem, band in walking.normal_bands().items():
        assert walking.within(walk, band, stem, foot).mean() > SHARE, stem
