"""Normal bands, scores against norms, conventions: units and signs as in `cycles.csv`, one line for
what is wrong.
"""

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.analysis.result import Calibration
from gaitcal.dynamics.joint_kinetics import COMPONENTS, MomentFrame
from gaitcal.errors import Code
from gaitcal.gait.conventions import GROUND_FORCES, Acting, Convention, MomentUnit, Signs
from gaitcal.gait.cycles import list_variables
from gaitcal.gait.normal_bands import (
    BAND_SIGNS,
    SHIPPED,
    SLOWEST,
    SPEEDS,
    compute_free_steps,
    estimate_leg_length,
    find_bands_file,
    make_user_norm,
    read_normal_bands,
    select_norm,
)
from gaitcal.gait.normal_bands import FREE as FREE_SPEEDS
from gaitcal.gait.profile_score import ANGLES, BOTH, GPS, compute_profile_scores
from gaitcal.model.coordinates import COORDINATE_TABLE
from gaitcal.model.linkage import COORDINATES, PELVIS_ANGLES, REACTIONS
from gaitcal.model.subject_model import GRAVITY, Subject
from gaitcal.results.cycle_tables import build_cycle_table
from tests.messages import check_text, refuses

PERSON = Subject("x", 60.0, 1.7, "female")
COLUMNS = "variable,unit,percent,mean,sd\n"
ROWS = "hip_flexion,deg,0,1,1\nhip_flexion,deg,9,1,1\n"
HEADER = f"# source: Somebody 2020, 50 adults\n# signs: gaitcal\n{COLUMNS}"


def written(folder: Path, rows: str, signs: str = "gaitcal", header: str = HEADER) -> Path:
    path = folder / "normal.csv"
    path.write_text(header.replace("signs: gaitcal", f"signs: {signs}") + rows, encoding="utf-8")
    return path


def test_values_lie_on_straight_lines_between_percents_and_nowhere_else(tmp_path: Path) -> None:
    bands = read_normal_bands(
        written(tmp_path, "hip_flexion,deg,10,30,5\nhip_flexion,deg,20,40,7\n")
    )
    (band,) = bands.values()
    assert (band.variable, band.source, band.signs) == (
        "hip_flexion", "Somebody 2020, 50 adults", BAND_SIGNS["gaitcal"],
    )  # fmt: skip
    mean, sd = band.scale_to_person(PERSON)
    assert mean[[10, 15, 20]].tolist() == [30.0, 35.0, 40.0] and sd[15] == 6.0
    assert np.isnan(mean[[0, 9, 21, 100]]).all()


@pytest.mark.parametrize(
    "variable, unit, one",
    [
        ("knee_angle", "deg", 1.0),
        ("knee_angle", "rad", 57.29577951308232),
        ("knee_angle_moment", "N m/kg", 60.0),
        ("knee_angle_moment", "N·m/kg", 60.0),
        ("knee_angle_moment", "Nmm/kg", 0.06),
        ("knee_angle_moment", "%BW*H", 0.01 * 60.0 * 9.80665 * 1.7),
        ("knee_angle_moment", "Nm", 1.0),
        ("hip_power", "W/kg", 60.0),
        ("ground_reaction_vertical", "BW", 60.0 * 9.80665),
        ("ground_reaction_vertical", "%BW", 0.6 * 9.80665),
        ("ground_reaction_vertical", "N/kg", 60.0),
    ],
)
def test_units_become_those_of_the_table_of_strides(
    tmp_path: Path, variable: str, unit: str, one: float
) -> None:
    rows = f"{variable},{unit},0,1,0.5\n{variable},{unit},100,1,0.5\n"
    mean, sd = read_normal_bands(written(tmp_path, rows))[variable].scale_to_person(PERSON)
    assert mean[50] == pytest.approx(one, rel=1e-3) and sd[50] == pytest.approx(0.5 * one, rel=1e-3)


@pytest.mark.parametrize(
    "variable, signs, right, left",
    [
        ("hip_flexion", "clinical", 1, 1),
        ("hip_flexion_moment", "gaitcal", 1, 1),
        ("hip_flexion_moment", "external", -1, -1),
        ("hip_flexion_moment", "Clinical", -1, -1),
        ("pelvis_tilt", "clinical", -1, -1),
        ("pelvis_list", "clinical", -1, 1),
        ("pelvis_rotation", "clinical", 1, -1),
        ("pelvis_list", "external", 1, 1),
        ("hip_power", "clinical", 1, 1),
    ],
)
def test_signs_become_those_of_the_table_of_strides(
    tmp_path: Path, variable: str, signs: str, right: int, left: int
) -> None:
    unit = {"moment": "N m", "power": "W"}.get(variable.rpartition("_")[2], "deg")
    path = written(tmp_path, f"{variable},{unit},0,2,1\n{variable},{unit},100,2,1\n", signs)
    band = read_normal_bands(path)[variable]
    for side, sign in (("r", right), ("l", left)):
        mean, sd = band.scale_to_person(PERSON, side)
        assert mean[0] == 2.0 * sign and sd[0] == 1.0


@pytest.mark.parametrize(
    "text",
    [
        HEADER,
        f"{HEADER}hip_flexion,deg,0,1\n",
        f"{HEADER}hip_flexion_r,deg,0,1,1\n",
        f"{HEADER}hip_flexoin,deg,0,1,1\n",
        f"{HEADER}hip_flexion,N m,0,1,1\n",
        f"{HEADER}hip_flexion,deg,101,1,1\n",
        f"{HEADER}hip_flexion,deg,0,nan,1\n",
        f"{HEADER}hip_flexion,deg,0,1,-1\n",
        f"{HEADER}hip_flexion,deg,0,1,x\n",
        f"{HEADER}hip_flexion,deg,0,1,1\n",
        f"{HEADER}hip_flexion,deg,5,1,1\nhip_flexion,deg,5,1,1\n",
        f"{HEADER}hip_flexion,deg,0,1,1\nhip_flexion,rad,5,1,1\n",
        COLUMNS + ROWS,
        f"# signs: mine\n{COLUMNS}{ROWS}",
        f"# signs: clinical\n# signs: external\n{COLUMNS}{ROWS}",
        f"# signs: gaitcal\nname,mean\n{ROWS}",
    ],
)
def test_what_is_wrong_is_one_line_with_the_line_of_the_file(tmp_path: Path, text: str) -> None:
    with refuses(Code.NORMAL_BANDS, source="normal.csv"):
        read_normal_bands(written(tmp_path, "", header=text))


def test_a_file_that_a_spreadsheet_program_saved_is_the_same_file(tmp_path: Path) -> None:
    padded = (
        '"# source: Somebody, 2020",,,\n# signs: '
        f"clinical,,,,\n,,,,\n{COLUMNS[:-1]},,\n{ROWS},,,,\n"
    )
    path = tmp_path / "normal.csv"
    path.write_text(padded.replace("\n", "\r\n"), encoding="utf-8-sig", newline="")
    band = read_normal_bands(path)["hip_flexion"]
    assert (band.source, band.signs, band.percent.tolist()) == (
        "Somebody, 2020",
        BAND_SIGNS["clinical"],
        [0.0, 9.0],
    )
    twice = "# signs: opensim\n# signs: GaitCal\n# source: a\n# source: b\n"
    band = read_normal_bands(written(tmp_path, COLUMNS + ROWS, header=twice))["hip_flexion"]
    assert band.signs is BAND_SIGNS["gaitcal"] and band.source == "a; b"


def test_bands_that_come_with_the_program_have_names() -> None:
    assert "hip_flexion_moment" in read_normal_bands("schwartz2008")
    assert all(find_bands_file(name).is_file() for name in SHIPPED)
    with refuses(Code.NORMAL_BANDS, "schwartz2008", source="schwartz"):
        read_normal_bands("schwartz")


def test_every_variable_of_the_table_of_strides_may_have_a_band(whole: Calibration) -> None:
    assert set(build_cycle_table(whole.model, whole.trials)["variable"]) <= set(list_variables())


CHILD = Subject("c", 30.0, 1.34, "female", age=9.0, leg_length={"r": 0.70, "l": 0.70})
FREE = "schwartz2008-free"


def at(relative: float, leg: float = 0.70) -> float:
    return relative * float(np.sqrt(GRAVITY * leg))


@pytest.mark.parametrize(
    ("relative", "words"),
    [(0.2, "very slow"), (0.3, "slow"), (0.43, "free"), (0.55, "fast"), (0.7, "very fast")],
)
def test_a_child_is_compared_with_children_of_its_speed(relative: float, words: str) -> None:
    norm = select_norm(CHILD, at(relative))
    check_text(norm.label, words, 4, 17, 83, 2008)
    assert set(ANGLES) < set(norm.bands)
    check_text(norm.remark, f"{relative:.2f}", words, 0.7)


def test_the_same_speed_is_another_one_for_a_longer_leg() -> None:
    tall = Subject("t", 60.0, 1.75, "male", age=16.0)
    check_text(select_norm(tall, at(0.37)).label)
    check_text(select_norm(CHILD, at(0.37)).label)
    assert estimate_leg_length(tall)[0] == pytest.approx(0.91)
    check_text(estimate_leg_length(tall)[1])


@pytest.mark.parametrize(
    ("subject", "why"),
    [
        (Subject("a", 70.0, 1.75, "male", age=35.0), "No norm for an age of 35 years"),
        (
            Subject("b", 12.0, 0.95, "male", age=3.99),
            "No norm for an age of 3.9 years: the built-in norms",
        ),
        (Subject("d", 70.0, 1.75, "male", age=18.0), "No norm for an age of 18 years"),
        (Subject("e", 48.0, 1.58, "female"), "No norm: the age is not given"),
        (Subject("s", 28.0, 1.33, "female"), "No norm: the age is not given"),
    ],
)
def test_only_children_are_compared_with_children(subject: Subject, why: str) -> None:
    norm = select_norm(subject, 1.2)
    assert not norm.bands and not norm.steps and why in norm.remark
    asked = make_user_norm(read_normal_bands(FREE), FREE, subject)
    assert asked.bands
    check_text(asked.remark, 4, 17)


@pytest.mark.parametrize("speed", [0.05, 4.0])
def test_no_curves_for_who_walks_slower_or_faster_than_they_did(speed: float) -> None:
    norm = select_norm(CHILD, speed)
    assert not norm.bands and norm.steps and f"{speed:.2f} m/s" in norm.remark
    check_text(norm.remark, 0.158, 0.705)
    check_text(select_norm(CHILD, None).remark)


def test_speeds_are_in_order_with_outer_limits_one_sd_beyond_those_of_the_paper() -> None:
    sd = FREE_SPEEDS["speed"][1]
    assert [s.high for s in SPEEDS] == sorted(s.high for s in SPEEDS)
    assert (SLOWEST, SPEEDS[-1].high) == pytest.approx((SPEEDS[0].high - sd, SPEEDS[-2].high + sd))


def test_steps_scale_with_the_leg() -> None:
    """Speed is cadence times step length, non-dimensional or not, within what means over people
    leave.
    """
    short, long = compute_free_steps(0.6), compute_free_steps(0.9)
    assert long["step_length"][0] / short["step_length"][0] == pytest.approx(1.5)
    assert long["speed"][0] / short["speed"][0] == pytest.approx(np.sqrt(1.5))
    for steps in (short, long):
        assert steps["cadence"][0] / 60.0 * steps["step_length"][0] == pytest.approx(
            steps["speed"][0], rel=0.01
        )


def strides(
    offset: dict[str, float], error: float = 0.0, alternate: float = 0.0
) -> dict[str, np.ndarray]:
    """Two strides of each leg that are the norm's mean, plus deg; `alternate`: added to the second
    one.
    """
    rows, bands = [], read_normal_bands(FREE)
    for side, number, name in itertools.product("rl", (1, 2), ANGLES):
        mean, _ = bands[name].scale_to_person(CHILD, side)
        value = mean + offset.get(f"{name}_{side}", 0.0) + (number == 2) * alternate
        columns = {"side": side, "variable": name, "value": value, "se": error, "se_stride": 0.0}
        rows.append(pd.DataFrame({**columns, "valid": 1, "turn": 0.0, "activity": "gait"}))
    table = pd.concat(rows, ignore_index=True)
    return {str(name): table[name].to_numpy() for name in table}


def scores(table: dict[str, np.ndarray]) -> dict[tuple[str, str], float]:
    return {
        (s.side, s.variable): s.score
        for s in compute_profile_scores(table, read_normal_bands(FREE), CHILD)
    }


def test_the_score_of_the_norm_itself_is_zero_and_healthy_people_have_their_spread() -> None:
    found = compute_profile_scores(strides({}), read_normal_bands(FREE), CHILD)
    assert len(found) == 21 and all(s.score == pytest.approx(0.0, abs=1e-12) for s in found)
    healthy = next(s.norm for s in found if s.variable == GPS and s.side == BOTH)
    assert 5.0 < healthy < 7.0, "Baker's healthy children: a median of 5.2"


def test_a_profile_by_hand() -> None:
    """Offsets make each angle's score; 15 angles count for both legs, the pelvis of left strides
    once.
    """
    offsets = {
        "knee_angle_r": 12.0,
        "hip_rotation_l": -9.0,
        "pelvis_tilt_l": 4.0,
        "pelvis_tilt_r": 5.0,
    }
    found = scores(strides(offsets))
    assert found["r", "knee_angle"] == pytest.approx(12.0) and found[
        "l", "hip_rotation"
    ] == pytest.approx(9.0)
    assert found["r", GPS] == pytest.approx(np.sqrt((12.0**2 + 5.0**2) / 9))
    assert found["l", GPS] == pytest.approx(np.sqrt((9.0**2 + 4.0**2) / 9))
    assert found[BOTH, GPS] == pytest.approx(np.sqrt((12.0**2 + 9.0**2 + 4.0**2) / 15))


def test_errors_of_scores() -> None:
    """Far from the norm an error of all strides moves the score by itself; strides add SD /
    sqrt(n).
    """
    offset = {f"{name}_{side}": 20.0 for name in ANGLES for side in "rl"}
    shared = compute_profile_scores(strides(offset, error=3.0), read_normal_bands(FREE), CHILD)[0]
    assert shared.error == pytest.approx(3.0, rel=1e-3)
    moving = compute_profile_scores(strides(offset, alternate=2.0), read_normal_bands(FREE), CHILD)[
        0
    ]
    assert (moving.score, moving.error) == (pytest.approx(21.0), pytest.approx(1.0))
    near = compute_profile_scores(strides({}, error=3.0), read_normal_bands(FREE), CHILD)[0]
    draws = np.abs(3.0 * np.random.default_rng(1).standard_normal(100_000))
    assert near.error == pytest.approx(draws.std(), rel=0.15), (
        "near 0 a score is no linear function of the error"
    )


def test_nothing_is_scored_without_an_angle(tmp_path: Path) -> None:
    bands = read_normal_bands(FREE)
    assert (
        compute_profile_scores(
            strides({}), {n: b for n, b in bands.items() if n not in PELVIS_ANGLES}, CHILD
        )
        == ()
    )
    lost = strides({})
    lost["valid"] = np.where((lost["variable"] == "foot_progression") & (lost["side"] == "l"), 0, 1)
    assert {s.side for s in compute_profile_scores(lost, bands, CHILD)} == {"r"}, (
        "the other side has its score, both have none"
    )


SUBJECT = Subject(name="made up", mass=80.0, height=1.75, sex="female")
STANCE = np.array([-120.0])
"""N·m: the ankle of a stance, as the model has it, a plantarflexor moment."""
NAMES = (
    *(n for n in COORDINATES if n.startswith(("hip", "knee", "ankle", "subtalar", "lumbar"))),
    *REACTIONS,
    *COMPONENTS,
)


def test_the_files_of_a_result_have_the_default_convention() -> None:
    plain = Convention()
    for name in NAMES:
        np.testing.assert_array_equal(plain.moment(name, STANCE, SUBJECT), STANCE)
    assert plain.senses("ankle_angle_l_moment", "r")[0] == "dorsiflexion"
    np.testing.assert_array_equal(plain.power(STANCE, SUBJECT), STANCE)
    np.testing.assert_array_equal(plain.angle("pelvis_tilt", STANCE, "r"), STANCE)


def test_clinical_moments_are_positive_where_extensors_plantarflexors_abductors_act() -> None:
    clinical = Convention(signs=Signs.CLINICAL)
    senses = {
        "ankle_angle_r": "plantarflexion", "knee_angle_l": "extension",
        "hip_adduction_r": "abduction",
        "lumbar_extension": "extension",
    }  # fmt: skip
    assert {name: clinical.senses(f"{name}_moment", "r")[0] for name in senses} == senses
    assert clinical.moment("ankle_angle_r", STANCE, SUBJECT) == 120.0
    assert clinical.moment("lumbar_extension", STANCE, SUBJECT) == -120.0, (
        "extension is positive already"
    )


@pytest.mark.parametrize("signs", list(Signs))
def test_an_external_moment_is_the_opposite_of_the_internal_one(signs: Signs) -> None:
    """Either the sign turns or the sense: with clinical signs curves stay, and are named by what
    they work against.
    """
    internal, external = (Convention(signs=signs, acting=acting) for acting in Acting)
    for name in NAMES:
        same = np.array_equal(
            external.moment(name, STANCE, SUBJECT), internal.moment(name, STANCE, SUBJECT)
        )
        one, other = (c.senses(f"{name}_moment", "r") for c in (internal, external))
        assert (same, other) == ((True, one[::-1]) if signs is Signs.CLINICAL else (False, one))


def test_titles_are_named_by_what_is_positive() -> None:
    clinical, external = (Convention(signs=Signs.CLINICAL, acting=acting) for acting in Acting)
    for convention, variable, title in (
        (clinical, "ankle_angle_moment", "Ankle plantarflexion moment"),
        (external, "ankle_angle_moment", "Ankle dorsiflexion moment"),
        (Convention(), "knee_adduction_moment", "Knee adduction moment"),
        (clinical, "lumbar_extension", "Lumbar flexion"),
        (Convention(), "lumbar_extension", "Lumbar extension"),
        (clinical, "hip_rotation", "Hip rotation"),
        (clinical, "hip_rotation_moment", "Hip external rotation moment"),
        (clinical, "hip_power", "Hip power"),
    ):
        assert convention.title(variable) == title


@pytest.mark.parametrize("variable", [*COORDINATE_TABLE, *GROUND_FORCES])
def test_clinical_values_mean_the_same_of_both_sides(variable: str) -> None:
    """A person mirrored left to right has the mirrored person's right curve on the left: nothing of
    it turns over.
    """
    clinical = Convention(signs=Signs.CLINICAL)
    right, left = (clinical.values(variable, np.ones(1), side, SUBJECT) for side in "rl")
    middle = (
        COORDINATE_TABLE[variable].group in ("pelvis", "trunk")
        if variable in COORDINATE_TABLE
        else False
    )
    mirrors = variable.endswith(("list", "bending", "sideways")) or (
        middle and variable.endswith("rotation")
    )
    assert (right == (-left if mirrors else left)).all()
    assert clinical.senses(variable, "r") == clinical.senses(variable, "l")


def test_units_are_per_mass_or_per_weight_times_height() -> None:
    per_kg, bwh = (Convention(unit=unit) for unit in (MomentUnit.NM_PER_KG, MomentUnit.PERCENT_BWH))
    assert per_kg.moment("knee_angle_r", STANCE, SUBJECT) == pytest.approx(-1.5)
    assert bwh.moment("knee_angle_r", STANCE, SUBJECT) == pytest.approx(
        -100 * 120.0 / (80.0 * 9.81 * 1.75)
    )
    for convention in (per_kg, bwh):
        assert (
            convention.power(STANCE, SUBJECT) == pytest.approx(-1.5)
            and convention.keys["power_unit"] == "W/kg"
        )


def test_pelvis_angles_depend_on_the_side_of_the_stride() -> None:
    """As Plug-in Gait has them; joint angles stay."""
    clinical, lean = Convention(signs=Signs.CLINICAL), np.array([5.0])
    for name, right, left in (("tilt", -1, -1), ("list", -1, 1), ("rotation", 1, -1)):
        assert clinical.angle(f"pelvis_{name}", lean, "r") == 5.0 * right
        assert clinical.angle(f"pelvis_{name}", lean, "l") == 5.0 * left
    check_text(clinical.senses("pelvis_list", "l")[0])
    check_text(Convention().senses("pelvis_list", "l")[0])
    for name in ("hip_flexion", "ankle_angle", "subtalar_angle"):
        assert clinical.angle(name, lean, "r") == 5.0
        assert clinical.senses(name, "r")[0] == Convention().senses(name, "l")[0]


def test_every_variable_has_a_positive_sense_and_every_convention_a_description() -> None:
    for signs, acting, frame, unit in itertools.product(Signs, Acting, MomentFrame, MomentUnit):
        convention = Convention(signs=signs, acting=acting, frame=frame, unit=unit)
        assert all(convention.senses(f"{name}_moment", "r")[0] for name in NAMES)
        text = "\n".join(convention.lines)
        assert (
            acting.label in text
            and frame.label in text
            and unit.label in text
            and unit.power in text
        )
        assert list(convention.keys.values())[:4] == [signs.value, acting.key, frame.key, unit.key]
