"""A model file holds every number exactly, and says in one line what is wrong with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gaitcal.errors import InputError
from gaitcal.model.model_file import load_model, model_text, save_model
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import IP_NAMES, JP_NAMES, Parameters
from gaitcal.model.subject_model import PatientRecord, SubjectModel

FINITE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e290, max_value=1e290)
"""Any double whose value in mm is a double too."""


def bits(a: np.ndarray) -> bytes:
    return np.ascontiguousarray(a, dtype=np.float64).tobytes()


def assert_same(a: SubjectModel, b: SubjectModel) -> None:
    assert (a.subject, a.frozen, a.notes, a.posture) == (b.subject, b.frozen, b.notes, b.posture)
    for x, y in ((a.parameters, b.parameters), (a.nominal, b.nominal)):
        for name in ("joint", "inertial", "zero_angles"):
            assert bits(getattr(x, name)) == bits(getattr(y, name)), name
    assert (a.markers.labels, a.markers.segments) == (b.markers.labels, b.markers.segments)
    assert bits(a.markers.local) == bits(b.markers.local)
    assert bits(a.markers.weight) == bits(b.markers.weight)
    assert {k: (s, bits(p)) for k, (s, p) in a.landmarks.items()} == {
        k: (s, bits(p)) for k, (s, p) in b.landmarks.items()
    }


def test_the_published_model_comes_back(tmp_path: Path) -> None:
    model = replace(published_model(static_only=True), posture={"hip_rotation_r": 0.1, "ankle_angle_l": -1.0 / 3.0})
    save_model(model, tmp_path / "model.toml")
    assert_same(model, load_model(tmp_path / "model.toml"))


def test_what_was_measured_of_the_person_comes_back(tmp_path: Path) -> None:
    model = published_model()
    widths = {"knee_width": {"r": 0.105, "l": 0.107}, "ankle_width": {"r": 0.07}}
    known = {"age": 9.5, "asis_distance": 0.2451, "marker_diameter": 0.014, "session": "2026-03-01, 'after'"}
    record = PatientRecord(birth_date="2016-09-01", diagnosis='CP, "left"', affected_side="left", aids="AFO")
    told = replace(model.subject, **known, **widths, leg_length={"r": 0.71}, record=record)  # type: ignore[arg-type]
    save_model(replace(model, subject=told), tmp_path / "model.toml")
    assert load_model(tmp_path / "model.toml").subject == told


def test_people_can_read_it() -> None:
    text = model_text(published_model())
    assert '"knee_r.thigh.sup"          = { value = -419.8, nominal = -419.8 }' in text
    assert '"talocrural_l.shank.front"  = { value = -7.3, nominal = -7.3 }' in text
    assert '"pelvis.mass"            = { value = 7.752, nominal = 7.752 }' in text


@settings(max_examples=60)
@given(
    joint=arrays(np.float64, len(JP_NAMES), elements=FINITE),
    inertial=arrays(np.float64, len(IP_NAMES), elements=FINITE),
    zero=arrays(np.float64, 4, elements=FINITE, fill=st.nothing()),
    local=arrays(np.float64, (2, 3), elements=FINITE, fill=st.nothing()),
    weight=arrays(np.float64, 2, elements=st.floats(0.0, 1e290)),
    label=st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=8),
)
def test_every_number_comes_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory,
    joint: np.ndarray,
    inertial: np.ndarray,
    zero: np.ndarray,
    local: np.ndarray,
    weight: np.ndarray,
    label: str,
) -> None:
    model = published_model()
    markers = replace(
        model.markers, labels=(label, label + "'"), segments=("pelvis", "foot_l"), local=local, weight=weight
    )
    model = replace(
        model,
        parameters=Parameters(joint, inertial, zero),
        nominal=Parameters(joint[::-1].copy(), inertial[::-1].copy(), zero[::-1].copy()),
        markers=markers,
        frozen=("elbow_flex_r",),
        landmarks={label: ("pelvis", local[0])},
        notes=(label, 'a "quoted" \\ note'),
    )
    path = tmp_path_factory.mktemp("model") / "model.toml"
    save_model(model, path)
    assert_same(model, load_model(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"hip_r.pelvis.ant" ', '"hip_r.pelvis.anterior" ', "which is no parameter; did you mean 'hip_r.pelvis.ant'"),
        ("format = 1", "format = 2", "format: found 2; allowed: 1"),
        ("format = 1", "forms = 1", "unknown key 'forms'; did you mean 'format'?"),
        ('sex = "male"', 'sex = "m"', "subject.sex: found 'm'; allowed: 'male', 'female'"),
        ("mass_kg = 69.4", "mass_kg = 0", "subject.mass_kg: found"),
        ("mass_kg = 69.4", "mass_kg = nan", "subject.mass_kg: found"),
        ("mass_kg = 69.4", "mass_kg = true", "subject.mass_kg: found True"),
        ('segment = "pelvis"\n', 'segment = "pelvus"\n', "which is no segment; did you mean 'pelvis'?"),
        ('label = "R.ASIS"', 'label = "L.ASIS"', "marker 'L.ASIS' is there 2 times"),
        ("frozen = []", 'frozen = ["elbow_r"]', "which is no coordinate; did you mean 'elbow_flex_r'"),
        ("-419.8, nominal", '"x", nominal', "joint_parameters"),
        ("-419.8, nominal", "1e99999999999, nominal", "allowed: a number that a person can have"),
        ("-419.8, nominal", "-inf, nominal", "allowed: a finite number"),
        ("-419.8, nominal", "1e301, nominal", "allowed: a number that a person can have"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = model_text(published_model())
    assert old in text
    path = tmp_path / "model.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def test_a_missing_parameter_is_named(tmp_path: Path) -> None:
    lines = model_text(published_model()).splitlines()
    path = tmp_path / "model.toml"
    path.write_text("\n".join(line for line in lines if not line.startswith('"hip_l')), encoding="utf-8")
    with pytest.raises(InputError, match="joint_parameters: 'hip_l.pelvis.ant' and 5 more missing"):
        load_model(path)


def test_a_number_that_is_none_is_not_written() -> None:
    model = published_model()
    with pytest.raises(ValueError, match="finite numbers only"):
        model_text(model.with_parameters(model.parameters.with_joint(("hip_r.pelvis.ant",), np.array([np.nan]))))
