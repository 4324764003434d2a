"""What files, plates and the user say of the person."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.intake.subject_metadata import (
    Options,
    check_mass,
    collect_subject,
    weigh_standing,
    weigh_walking,
)
from gaitcal.intake.trial_movement import detect_standing
from gaitcal.io.formats import read_recording
from gaitcal.io.labels import Facts
from gaitcal.io.recording import ForcePlate
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.subject_model import GRAVITY
from tests.intake.folders import recordings
from tests.messages import check_text


def test_the_user_before_the_static_before_the_others() -> None:
    files = [("static", Facts(mass=70.0)), ("walk", Facts(mass=80.0, height=1.7, name="Jane Doe"))]
    found = collect_subject("p07", Options(), files, None)
    assert found["name"].value == "p07", "never the patient's name"
    assert found["mass_kg"].value == 70.0
    assert not found["mass_kg"].certain
    check_text(found["mass_kg"].reason, 80)
    assert found["height_m"].value == 1.7 and found["height_m"].certain
    assert "sex" not in found
    said = collect_subject("p07", Options(mass=75.0, sex="female"), files, None)
    assert said["mass_kg"].value == 75.0
    check_text(said["mass_kg"].reason, 70)


def test_lengths_that_the_clinic_measured_are_drafted() -> None:
    found = collect_subject(
        "x", Options(), [("static", Facts(asis_distance=0.245, marker_diameter=0.014))], None
    )
    assert (found["asis_distance_mm"].value, found["marker_diameter_mm"].value) == (245.0, 14.0)


def test_plates_give_a_missing_mass_and_contradict_a_given_one() -> None:
    weighed_here = collect_subject("x", Options(), [("static", Facts())], ("static", 66.04))
    assert weighed_here["mass_kg"].value == 66.0 and not weighed_here["mass_kg"].certain
    against = collect_subject("x", Options(), [("static", Facts(mass=80.0))], ("static", 66.04))
    assert against["mass_kg"].value == 80.0
    assert not against["mass_kg"].certain
    check_text(against["mass_kg"].reason, 66.0)


@pytest.mark.parametrize(("reach", "expected"), [(1.0, 70.0), (0.05, None)])
def test_only_who_stands_wholly_on_plates_is_weighed(reach: float, expected: float | None) -> None:
    static, marker_set = recordings()["static"], load_marker_set("gait2354")
    posture, _ = detect_standing(static, marker_set)
    assert posture is not None
    middle = static.markers[0].mean(axis=0)
    corners = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) * reach + [
        middle[0],
        0.0,
        middle[2],
    ]
    force = np.tile([0.0, 70.0 * GRAVITY, 0.0], (len(static.time), 1))
    plate = ForcePlate(
        name="1", time=static.time, force=force, point=0 * force, moment=0 * force, corners=corners
    )
    mass = weigh_standing(replace(static, plates=(plate,)), marker_set, posture)
    assert mass == (None if expected is None else pytest.approx(expected))
    without_corners = replace(plate, corners=None)
    assert weigh_standing(replace(static, plates=(without_corners,)), marker_set, posture) is None


def test_whole_strides_weigh_who_never_stands_on_plates(data_dir: Path) -> None:
    """Five walks of 53.5 kg over plates that touch: feet that straddle two of them weigh
    nothing.
    """
    folder = data_dir / "labs_c3d" / "multi"
    found = {k: weigh_walking(read_recording(folder / f"walk0{k}.c3d").plates) for k in range(3, 8)}
    assert [k for k, mass in found.items() if mass is not None] == [4, 5]
    assert found[4] == pytest.approx(53.5, rel=0.03) and found[5] == pytest.approx(53.5, rel=0.03)
    half_on = read_recording(data_dir / "pig_c3d" / "gait.c3d").plates
    assert weigh_walking(half_on) is None
    first, second, third = read_recording(folder / "walk04.c3d").plates
    late = replace(third, force=np.where(third.time[:, None] < 3.69, 0.0, third.force))
    assert weigh_walking([first, second, late]) is None, (
        "the third foot is on something else for 50 ms: 4 % less"
    )
    known = collect_subject("x", Options(), [("static", Facts())], None, walks=("walk04", 53.8))[
        "mass_kg"
    ]
    assert known.value == 53.8 and not known.certain
    check_text(known.reason, "walk04")


def test_a_figure_in_another_unit_is_likely_and_comes_after_all_others() -> None:
    doubt = Facts(
        doubtful={
            "height": ("Height = 179: 1.79 m if cm", 1.79),
            "knee_width_r": ("RKneeWidth = 12", 0.12),
        }
    )
    found = collect_subject("x", Options(), [("static", doubt), ("walk", Facts())], None)
    assert found["height_m"].value == 1.79 and not found["height_m"].certain
    check_text(found["height_m"].reason, 179, 1.79)
    assert found["knee_width_mm"].value == {"r": 120.0} and not found["knee_width_mm"].certain
    assert (
        collect_subject("x", Options(), [("static", doubt), ("walk", Facts(height=1.8))], None)[
            "height_m"
        ].value
        == 1.8
    )


@pytest.mark.parametrize(
    ("mass", "plates", "parts"),
    [
        (66.5, ("static", 64.0), ()),
        (146.6, ("static", 64.0), (2.29, 64.0, 66.5, "in lb")),
        (652.0 / 2, ("static", 33.2), (33.2, "in N")),
        (271.74, None, (14, 124, 1.33, 123.3, "in lb", 27.7, "in N")),
        (27.7, None, ()),
    ],
)
def test_an_impossible_mass_is_an_error_unless_the_user_gives_it(
    mass: float, plates: tuple[str, float] | None, parts: tuple[str | float, ...]
) -> None:
    files = [("static", Facts(mass=mass, height=1.33))]
    fault = check_mass(collect_subject("x", Options(), files, plates), Options(), plates)
    assert bool(parts) == bool(fault)
    if fault:
        check_text(fault, *parts)
    said = Options(mass=mass)
    assert check_mass(collect_subject("x", said, files, plates), said, plates) == ""
