"""Conventions: each switch by itself, and what a positive value means."""

import itertools

import numpy as np
import pytest

from gaitcal.dynamics.joint_kinetics import COMPONENTS, MomentFrame
from gaitcal.gait.conventions import GROUND_FORCES, Acting, Convention, MomentUnit, Signs
from gaitcal.model.coordinates import COORDINATE_TABLE
from gaitcal.model.linkage import COORDINATES, REACTIONS
from gaitcal.model.subject_model import Subject

SUBJECT = Subject(name="made up", mass=80.0, height=1.75, sex="female")
STANCE = np.array([-120.0])
"""N·m: the ankle of a stance, as the model has it, a plantarflexor moment."""
NAMES = (
    *(n for n in COORDINATES if n.startswith(("hip", "knee", "ankle", "subtalar", "lumbar"))),
    *REACTIONS,
    *COMPONENTS,
)


def test_the_files_of_a_result_have_the_convention_unless_said_otherwise() -> None:
    plain = Convention()
    for name in NAMES:
        np.testing.assert_array_equal(plain.moment(name, STANCE, SUBJECT), STANCE)
    assert plain.senses("ankle_angle_l_moment", "r")[0] == "dorsiflexion"
    np.testing.assert_array_equal(plain.power(STANCE, SUBJECT), STANCE)
    np.testing.assert_array_equal(plain.angle("pelvis_tilt", STANCE, "r"), STANCE)


def test_clinical_moments_are_positive_where_extensors_plantarflexors_abductors_act() -> None:
    clinical = Convention(signs=Signs.CLINICAL)
    assert clinical.moment("ankle_angle_r", STANCE, SUBJECT) == 120.0
    said = {
        name: clinical.senses(f"{name}_moment", "r")[0] for name in ("ankle_angle_r", "knee_angle_l", "hip_adduction_r")
    }
    assert said == {"ankle_angle_r": "plantarflexion", "knee_angle_l": "extension", "hip_adduction_r": "abduction"}
    assert clinical.moment("lumbar_extension", STANCE, SUBJECT) == -120.0, "extension is positive already"
    assert clinical.senses("lumbar_extension_moment", "r")[0] == "extension"


@pytest.mark.parametrize("signs", list(Signs))
def test_an_external_moment_is_the_opposite_of_the_internal_one(signs: Signs) -> None:
    """Either the sign turns or the sense: with clinical signs curves stay, and are named by what they work against."""
    internal, external = (Convention(signs=signs, acting=acting) for acting in Acting)
    for name in NAMES:
        same = np.array_equal(external.moment(name, STANCE, SUBJECT), internal.moment(name, STANCE, SUBJECT))
        one, other = (c.senses(f"{name}_moment", "r") for c in (internal, external))
        assert (same, other) == ((True, one[::-1]) if signs is Signs.CLINICAL else (False, one))


def test_titles_are_named_by_what_is_positive() -> None:
    clinical, external = (Convention(signs=Signs.CLINICAL, acting=acting) for acting in Acting)
    assert clinical.title("ankle_angle_moment") == "Ankle plantarflexion moment"
    assert external.title("ankle_angle_moment") == "Ankle dorsiflexion moment"
    assert Convention().title("knee_adduction_moment") == "Knee adduction moment"
    assert (clinical.title("lumbar_extension"), Convention().title("lumbar_extension")) == (
        "Lumbar flexion",
        "Lumbar extension",
    )
    assert [clinical.title(f"hip_{name}") for name in ("rotation", "rotation_moment", "power")] == [
        "Hip rotation",
        "Hip external rotation moment",
        "Hip power",
    ]


@pytest.mark.parametrize("variable", [*COORDINATE_TABLE, *GROUND_FORCES])
def test_clinical_values_mean_the_same_of_both_sides(variable: str) -> None:
    """A person mirrored left to right has the mirrored person's right curve on the left: nothing of it turns over."""
    clinical = Convention(signs=Signs.CLINICAL)
    right, left = (clinical.values(variable, np.ones(1), side, SUBJECT) for side in "rl")
    middle = COORDINATE_TABLE[variable].group in ("pelvis", "trunk") if variable in COORDINATE_TABLE else False
    mirrors = variable.endswith(("list", "bending", "sideways")) or (middle and variable.endswith("rotation"))
    assert (right == (-left if mirrors else left)).all()
    assert clinical.senses(variable, "r") == clinical.senses(variable, "l")


def test_units_are_per_mass_or_per_weight_times_height() -> None:
    per_kg, bwh = (Convention(unit=unit) for unit in (MomentUnit.NM_PER_KG, MomentUnit.PERCENT_BWH))
    assert per_kg.moment("knee_angle_r", STANCE, SUBJECT) == pytest.approx(-1.5)
    assert bwh.moment("knee_angle_r", STANCE, SUBJECT) == pytest.approx(-100 * 120.0 / (80.0 * 9.81 * 1.75))
    for convention in (per_kg, bwh):
        assert convention.power(STANCE, SUBJECT) == pytest.approx(-1.5) and convention.keys["power_unit"] == "W/kg"


def test_pelvis_angles_are_told_of_the_side_of_the_stride() -> None:
    """As Plug-in Gait has them; joint angles stay."""
    clinical, lean = Convention(signs=Signs.CLINICAL), np.array([5.0])
    signs = {
        (name, side): float(clinical.angle(f"pelvis_{name}", lean, side)[0] / 5.0)
        for name, side in itertools.product(("tilt", "list", "rotation"), "rl")
    }
    assert signs == {
        ("tilt", "r"): -1,
        ("tilt", "l"): -1,
        ("list", "r"): -1,
        ("list", "l"): 1,
        ("rotation", "r"): 1,
        ("rotation", "l"): -1,
    }
    assert clinical.senses("pelvis_list", "l")[0] == "this side up"
    assert Convention().senses("pelvis_list", "l")[0] == "right side down"
    for name in ("hip_flexion", "ankle_angle", "subtalar_angle"):
        assert clinical.angle(name, lean, "r") == 5.0
        assert clinical.senses(name, "r")[0] == Convention().senses(name, "l")[0]


def test_every_variable_says_what_is_positive_and_every_convention_says_itself() -> None:
    for signs, acting, frame, unit in itertools.product(Signs, Acting, MomentFrame, MomentUnit):
        convention = Convention(signs=signs, acting=acting, frame=frame, unit=unit)
        assert all(convention.senses(f"{name}_moment", "r")[0] for name in NAMES)
        text = "\n".join(convention.lines)
        assert acting.words in text and frame.words in text and unit.words in text and unit.power in text
        assert list(convention.keys.values())[:4] == [signs.value, acting.key, frame.key, unit.key]
