"""Kinematics against Pinocchio and the published geometry, the table of coordinates, and a model as
a file.
"""

import pickle
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gaitcal.gait.conventions import Convention, Signs
from gaitcal.model.chain import Chain, LinkageModel, build_linkage, get_chain
from gaitcal.model.coordinates import (
    COORDINATE_TABLE,
    GROUPS,
    JOINT_TABLE,
    LOCKED,
    TRANSLATION_RANGES,
    group_of,
    split_side,
    with_side,
)
from gaitcal.model.kinematics import Kinematics, SecondaryMotion
from gaitcal.model.linkage import (
    COORDINATES,
    ISOLATED_JOINTS,
    JOINTS,
    REACTIONS,
    SECONDARY,
    SECONDARY_VARIABLES,
    SEGMENT_TABLE,
    SEGMENTS,
    ZERO_ANGLES,
    Source,
    get_segment,
    is_translation,
    make_root_elements,
)
from gaitcal.model.model_file import format_model, load_model, save_model
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    IP_NAMES,
    JOINT_PARAMETERS,
    JP_NAMES,
    MASSIVE_SEGMENTS,
    QUANTITIES,
    Parameters,
    compute_dynamic_jacobian,
    compute_dynamic_parameters,
    find_impossible_bodies,
    is_physical,
    list_gait_parameters,
    list_isolated_parameters,
    make_full_set,
    make_symmetric_set,
    read_published_parameters,
    view_as_table,
)
from gaitcal.model.subject_model import PatientRecord, SubjectModel
from tests.derivatives import Array, assert_derivative, perturbed_parameters
from tests.messages import refuses
from tests.model.people import posed
from tests.refusal import refusal

EXACT = 1e-13
"""m, rad: the same arithmetic in another order."""


def test_counts_are_those_of_the_paper() -> None:
    """Of the published linkage; joints that somebody added are not counted."""
    joints = [joint for joint in JOINTS if split_side(joint.name)[0] in PUBLISHED]
    segments = ["pelvis", *(joint.child for joint in joints)]
    parameters = [p for p in JOINT_PARAMETERS if split_side(p.joint)[0] in PUBLISHED]
    turns = [e for joint in joints for e in joint.elements if e.source is Source.COORDINATE]
    assert (len(segments), len(make_root_elements("pelvis")) + len(turns), len(parameters)) == (
        14,
        27,
        98,
    )
    massive = [segment for segment in segments if segment in MASSIVE_SEGMENTS]
    assert len(massive) * len(QUANTITIES) == 84
    assert [len(list_isolated_parameters(j)) for j in ISOLATED_JOINTS] == [6, 9, 12, 6, 9, 12]
    assert len(list_gait_parameters("r")) == 17
    kinds = {get_segment(segment).name for segment in segments}
    symmetric = [name for name in make_symmetric_set().names if name.split(".")[0] in kinds]
    assert len(symmetric) == 36 and make_full_set().names == IP_NAMES
    centres = [name for name in symmetric if ".com." in name]
    assert centres[:5] == [
        "pelvis.com.ant",
        "pelvis.com.sup",
        "thigh.com.sup",
        "shank.com.sup",
        "foot.com.ant",
    ]
    assert centres[5:] == [
        f"{body}.com.sup" for body in ("head_trunk", "upper_arm", "forearm_hand")
    ]


def test_every_joint_parameter_enters_exactly_once() -> None:
    used = [
        e.name for joint in JOINTS for e in joint.elements if e.source is Source.JOINT_PARAMETER
    ]
    assert sorted(used) == sorted(JP_NAMES)


CATALOGUE = """
hip        pelvis: ant sup lat               thigh: ant sup lat
knee       thigh: front trans ant sup        shank: front trans ant sup lat
talocrural shank: front trans ant sup lat
subtalar   talus: trans sup                  foot: trans sag ant sup lat
back       pelvis: ant sup lat               trunk: ant sup lat
shoulder   trunk: front trans ant sup lat    upperarm: trans sag ant sup lat
elbow      upperarm: front trans ant sup     forearm: front trans ant sup lat
"""
PUBLISHED = {row.split()[0]: row.split()[1:] for row in CATALOGUE.strip().splitlines()}
"""Joint without its side -> its joint parameters as the paper lists them."""


def test_the_catalogue_is_in_the_order_of_table_ii() -> None:
    """Of files and of every array: right leg, left leg, back, right arm, left arm."""
    leg, arm = ("hip", "knee", "talocrural", "subtalar"), ("shoulder", "elbow")
    right_and_left = [[f"{j}_{side}" for side in "rl" for j in limb] for limb in (leg, arm)]
    names, place = [], ""
    for joint in (*right_and_left[0], "back", *right_and_left[1]):
        for word in PUBLISHED[split_side(joint)[0]]:
            if word.endswith(":"):
                place = word[:-1]
            else:
                names.append(f"{joint}.{place}.{word}")
    assert names == [name for name in JP_NAMES if split_side(name.split(".")[0])[0] in PUBLISHED]
    assert {p.segment for p in JOINT_PARAMETERS} == set(SEGMENTS)


def rotation(axis: int, angle: float) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = pin.exp3(angle * np.eye(3)[axis])
    return out


def translation(*offset: float) -> np.ndarray:
    out = np.eye(4)
    out[:3, 3] = offset
    return out


def documented(
    joint: str, jp: dict[str, float], zero: dict[str, float], q: dict[str, float]
) -> np.ndarray:
    """The pose (4, 4) of a joint's child in its parent as Reinbolt writes it, product by
    product.
    """
    kind, _, side = joint.partition("_")
    s = -1.0 if side == "l" else 1.0

    def tr(place: str) -> np.ndarray:
        return translation(*(jp.get(f"{joint}.{place}.{d}", 0.0) for d in ("ant", "sup", "lat")))

    def a(place: str) -> np.ndarray:
        return rotation(0, jp[f"{joint}.{place}.front"]) @ rotation(1, jp[f"{joint}.{place}.trans"])

    def b(place: str) -> np.ndarray:
        return rotation(1, jp[f"{joint}.{place}.trans"]) @ rotation(2, jp[f"{joint}.{place}.sag"])

    def angle(name: str) -> float:
        return q[f"{name}_{side}" if side else name]

    inverse = np.linalg.inv
    if kind == "hip":
        turn = rotation(0, s * angle("hip_adduction")) @ rotation(1, s * angle("hip_rotation"))
        return tr("pelvis") @ rotation(2, angle("hip_flexion")) @ turn @ inverse(tr("thigh"))
    if kind == "knee":
        return (
            tr("thigh")
            @ a("thigh")
            @ rotation(2, -angle("knee_angle"))
            @ inverse(tr("shank") @ a("shank"))
        )
    if kind == "talocrural":
        return tr("shank") @ a("shank") @ rotation(2, angle("ankle_angle") + zero[f"{joint}.zero"])
    if kind == "subtalar":
        inversion = rotation(0, s * angle("subtalar_angle") + zero[f"{joint}.zero"])
        return (
            tr("talus")
            @ rotation(1, jp[f"{joint}.talus.trans"])
            @ inversion
            @ inverse(tr("foot") @ b("foot"))
        )
    if kind == "back":
        turn = rotation(0, angle("lumbar_bending")) @ rotation(1, angle("lumbar_rotation"))
        return tr("pelvis") @ rotation(2, angle("lumbar_extension")) @ turn @ inverse(tr("trunk"))
    if kind == "shoulder":
        turn = rotation(2, angle("arm_flex")) @ rotation(0, s * angle("arm_add"))
        return tr("trunk") @ a("trunk") @ turn @ inverse(tr("upperarm") @ b("upperarm"))
    turn = rotation(2, angle("elbow_flex"))
    return tr("upperarm") @ a("upperarm") @ turn @ inverse(tr("forearm") @ a("forearm"))


def test_every_joint_is_the_product_that_the_papers_write() -> None:
    rng = np.random.default_rng(7)
    parameters = perturbed_parameters(rng)
    jp = dict(zip(JP_NAMES, parameters.joint + rng.normal(0, 0.3, len(JP_NAMES)), strict=True))
    zero = dict(zip(ZERO_ANGLES, parameters.zero_angles, strict=True))
    q = dict(zip(COORDINATES, rng.normal(0, 0.5, len(COORDINATES)), strict=True))
    turned = replace(parameters, joint=np.array(list(jp.values())))
    axes, origin = posed(Chain(), turned, np.array(list(q.values())))
    pose = {
        name: translation(*origin[name])
        @ np.block([[axes[name], np.zeros((3, 1))], [np.eye(4)[3:]]])
        for name in axes
    }
    pelvis = translation(*(q[f"pelvis_t{axis}"] for axis in "xyz")) @ rotation(2, q["pelvis_tilt"])
    pelvis = pelvis @ rotation(0, q["pelvis_list"]) @ rotation(1, q["pelvis_rotation"])
    np.testing.assert_allclose(pose["pelvis"], pelvis, atol=EXACT)
    for joint in (joint for joint in JOINTS if split_side(joint.name)[0] in PUBLISHED):
        relative = np.linalg.solve(pose[joint.parent], pose[joint.child])
        np.testing.assert_allclose(
            relative, documented(joint.name, jp, zero, q), atol=EXACT, err_msg=joint.name
        )


def opened_body(rng: np.random.Generator) -> tuple[LinkageModel, Array]:
    """A linkage with all joint parameters and the knees' secondary motions free, and coordinates
    (5, nq).
    """
    chain = Chain(free=(*JP_NAMES, *SECONDARY_VARIABLES))
    return chain.body(perturbed_parameters(rng)), rng.normal(0, 0.5, (5, len(COORDINATES)))


def test_segments_and_columns_are_those_of_body_frames_and_finite_differences() -> None:
    rng = np.random.default_rng(3)
    body, q = opened_body(rng)
    chain, nq = body.chain, len(COORDINATES)
    amounts = {name: rng.normal(0, 0.05, (4, len(q))) for name in SECONDARY}
    regressors = {name: (rng.normal(0, 1, len(q)), rng.normal(0, 1, len(q))) for name in SECONDARY}

    def placed(x: Array, frame: int) -> Array:
        """Segment frames (ns, 4, 3) of one frame with its coordinates and free variables at x."""
        moved = {name: values[:, [frame]].copy() for name, values in amounts.items()}
        joint_parameters = [
            k for k, name in enumerate(chain.free) if name not in SECONDARY_VARIABLES
        ]
        for k, name in enumerate(chain.free):
            if name in SECONDARY_VARIABLES:
                coordinate, motion, bend = SECONDARY_VARIABLES[name]
                row = [e.name for e in SECONDARY[coordinate]].index(motion)
                moved[coordinate][row] += x[nq + k] * regressors[coordinate][bend][frame]
        free_values = body.free_values + x[nq:][joint_parameters]
        secondary = SecondaryMotion(amounts=moved, regressors={})
        at = replace(body, free_values=free_values)
        return Kinematics(at, x[None, :nq], secondary, columns=False).segments[..., 0]

    found = Kinematics(body, q, SecondaryMotion(amounts=amounts, regressors=regressors))
    for frame in range(2):
        x = np.concatenate([q[frame], np.zeros(len(chain.free))])
        np.testing.assert_allclose(found.segments[..., frame], placed(x, frame), atol=EXACT)
        spatial, segments = found.columns[..., frame], found.segments[..., frame]
        moves = chain.support[:, :, None, None] > 0
        turned = np.cross(spatial[:, None, None, 3:], segments[None])
        turned[:, :, 3] += spatial[:, None, :3]
        expected = np.where(moves, turned, 0.0).reshape(len(spatial), -1).T
        assert_derivative(expected, lambda x, frame=frame: placed(x, frame), x)
    data = body.model.createData()
    pin.framesForwardKinematics(body.model, data, body.fill_configurations(q)[0])
    at_rest = Kinematics(body, q[:1], SecondaryMotion(amounts={}, regressors={}), columns=False)
    for s, name in enumerate(chain.segments):
        place = data.oMf[body.model.getFrameId(name)]
        np.testing.assert_allclose(place.translation, at_rest.origins[s, :, 0], atol=EXACT)
        np.testing.assert_allclose(place.rotation, at_rest.axes[s, :, :, 0].T, atol=EXACT)


def test_a_free_joint_parameter_is_a_joint_whose_coordinate_is_its_value() -> None:
    """A model in which it is locked, and one in which it is free, place all segments alike."""
    rng = np.random.default_rng(8)
    parameters, q = perturbed_parameters(rng), rng.normal(0, 0.4, (3, len(COORDINATES)))
    locked = Kinematics(Chain().body(parameters), q).segments
    free = Chain(free=JP_NAMES).body(read_published_parameters())
    moved = free.with_free(parameters)
    np.testing.assert_allclose(Kinematics(moved, q).segments, locked, atol=EXACT)


def test_a_knee_whose_secondary_motion_is_not_given_has_none() -> None:
    """One leg may show no marker: the joints of its secondary motions stay at zero."""
    rng = np.random.default_rng(9)
    body, q = (
        Chain(secondary=True).body(perturbed_parameters(rng)),
        rng.normal(0, 0.4, (3, len(COORDINATES))),
    )
    zero = {name: (np.zeros(3), np.zeros(3)) for name in SECONDARY}
    amounts = {"knee_angle_r": rng.normal(0, 0.05, (4, 3))}
    both = {**amounts, "knee_angle_l": np.zeros((4, 3))}
    one, all_given = (
        Kinematics(body, q, SecondaryMotion(amounts=given, regressors=zero)).segments
        for given in (amounts, both)
    )
    np.testing.assert_array_equal(one, all_given)
    with pytest.raises(ValueError, match="secondary"):
        Kinematics(opened_body(rng)[0], q)


def test_work_spaces_are_lent_to_one_user_at_a_time_and_kept_for_the_next() -> None:
    chain = Chain()
    with chain.lend_work_space() as one, chain.lend_work_space() as other:
        assert one is not other
    with chain.lend_work_space() as again:
        assert again is one or again is other
    again = pickle.loads(pickle.dumps(get_chain(free=("hip_r.pelvis.ant",), reactions=True)))
    assert again is get_chain("pelvis", SEGMENTS, ("hip_r.pelvis.ant",), reactions=True)


def test_a_model_that_is_kept_for_others_gets_no_inertias() -> None:
    """Trials of the same chain and parameters share a body; who asks for inertias gets one of its
    own.
    """
    parameters = read_published_parameters()
    kept = get_chain().body(parameters)
    assert sum(body.mass for body in build_linkage(parameters).model.inertias) > 1.0
    assert get_chain().body(parameters) is kept
    assert sum(body.mass for body in kept.model.inertias) == 0.0


def test_published_subject_stands_as_documented() -> None:
    """Ankle centre 72 mm in front of and 31 mm above the heel, foot turned 6 degrees medially, at
    zero coordinates.
    """
    axes, origin = posed(Chain(), read_published_parameters())
    for side, sign in (("r", 1.0), ("l", -1.0)):
        foot, shank = axes[f"foot_{side}"].T, axes[f"shank_{side}"].T
        # the talus angle is printed with three decimals of a degree: 1e-5 rad
        np.testing.assert_allclose(foot[1], shank[1], atol=1e-5)
        turn = np.rad2deg(np.arctan2(foot[0] @ shank[2], foot[0] @ shank[0]))
        np.testing.assert_allclose(turn, -6.0 * sign, atol=1e-3)
        ankle = origin[f"talus_{side}"] - origin[f"foot_{side}"]
        # the foot point is printed with 0.01 mm
        np.testing.assert_allclose(foot[:2] @ ankle, [0.072, 0.031], atol=2e-5)


def test_left_is_the_mirror_image_of_right() -> None:
    rng = np.random.default_rng(2)
    drawn = {name: rng.normal(0, 0.3) for name in COORDINATES if name.endswith("_r")}
    q = np.array([drawn.get(f"{name[:-2]}_r", 0.0) for name in COORDINATES])
    _, origin = posed(Chain(), read_published_parameters(), q)
    for name in (name for name in SEGMENTS if name.endswith("_r")):
        np.testing.assert_allclose(origin[name] * [1, 1, -1], origin[f"{name[:-2]}_l"], atol=EXACT)


def test_reactions_of_both_knees_are_mirror_images() -> None:
    """Their axes are x of the knee frames, of opposite senses: adduction is positive on
    both sides.
    """
    chain = Chain(reactions=True)
    placed = Kinematics(chain.body(read_published_parameters()), np.zeros((1, len(COORDINATES))))
    right, left = (placed.axis(name)[0] for name in REACTIONS)
    np.testing.assert_allclose(right * [-1, -1, 1], left, atol=EXACT)
    assert right[0] > 0.9


def test_dynamic_parameters_are_those_of_pinocchio_and_differentiate() -> None:
    inertial = read_published_parameters().inertial
    for row, phi in zip(view_as_table(inertial), compute_dynamic_parameters(inertial), strict=True):
        inertia = pin.Inertia(row[0], row[1:4], np.diag(row[4:7]))
        np.testing.assert_allclose(inertia.toDynamicParameters(), phi, atol=1e-15)
    jac = compute_dynamic_jacobian(inertial)
    whole = np.zeros((len(MASSIVE_SEGMENTS), 10, len(MASSIVE_SEGMENTS), 7))
    for s in range(len(MASSIVE_SEGMENTS)):
        whole[s, :, s] = jac[s]
    assert_derivative(
        whole.reshape(-1, len(IP_NAMES)), lambda x: compute_dynamic_parameters(x), inertial
    )


@pytest.mark.parametrize(
    ("mass", "moments", "possible"),
    [
        (1.0, (1, 2, 2.9), True),
        (1.0, (1, 2, 3.1), False),
        (1.0, (3.1, 1, 2), False),
        (1.0, (-1, 2, 2), False),
    ]
    + [(0.0, (1, 2, 2.9), False), (-1.0, (1, 2, 2.9), False)],
)
def test_a_possible_body_has_mass_and_moments_that_make_a_triangle(
    mass: float, moments: tuple[float, ...], possible: bool
) -> None:
    rows = view_as_table(read_published_parameters().inertial).copy()
    rows[3, 0], rows[3, 4:7] = mass, moments
    found = is_physical(rows.ravel())
    assert found[3] == possible and found.sum() == len(MASSIVE_SEGMENTS) - 1 + possible
    assert find_impossible_bodies(rows.ravel()) == (() if possible else (MASSIVE_SEGMENTS[3],))


def bases(names: tuple[str, ...]) -> tuple[str, ...]:
    """Each once, without its side."""
    return tuple(dict.fromkeys(split_side(name)[0] for name in names))


def test_every_angle_joint_and_segment_has_its_row_in_the_order_of_the_linkage() -> None:
    angles = tuple(name for name in COORDINATES if not is_translation(name))
    assert tuple(name for name in COORDINATE_TABLE if name not in LOCKED) == bases(angles)
    assert bases(REACTIONS) == LOCKED and set(LOCKED) <= set(COORDINATE_TABLE)
    assert set(TRANSLATION_RANGES) == set(COORDINATES) - set(angles)
    assert tuple(JOINT_TABLE) == bases(tuple(joint.name for joint in JOINTS))
    assert {get_segment(segment).name for segment in SEGMENTS} == set(SEGMENT_TABLE)


def test_rows_say_what_pages_and_files_need() -> None:
    clinical = Convention(signs=Signs.CLINICAL)
    for row in COORDINATE_TABLE.values():
        assert row.group in GROUPS and row.title and row.angle and row.moment
        assert (row.usual[0] < row.usual[1]) != (row.name in LOCKED), row.name
        assert row.clinical is None or row.group in ("pelvis", "trunk"), (
            "angles of legs have one sign"
        )
        for side in "rl":
            assert group_of(with_side(row.name, side)) == row.group
        against = clinical.senses(f"{row.name}_moment", "r")[0]
        assert against == clinical.senses(row.name, "r")[1], (
            "an internal moment acts against the positive angle"
        )


FINITE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e290, max_value=1e290)
"""Any double whose value in mm is a double too."""


def plain(model: SubjectModel) -> dict[str, Any]:
    """What a model holds, numbers by their bits."""

    def own(value: Any) -> Any:
        return value.astype(np.float64).tobytes() if isinstance(value, np.ndarray) else value

    parts = {
        "": model,
        **{name: getattr(model, name) for name in ("parameters", "nominal", "markers")},
    }
    return {
        **{
            f"{part}.{f.name}": own(getattr(x, f.name))
            for part, x in parts.items()
            for f in fields(x)
        },
        **dict.fromkeys((f".{part}" for part in parts), None),
        ".landmarks": {name: (segment, own(at)) for name, (segment, at) in model.landmarks.items()},
    }


def assert_comes_back(model: SubjectModel, folder: Path) -> None:
    save_model(model, folder / "model.toml")
    assert plain(load_model(folder / "model.toml")) == plain(model)


def test_the_published_model_and_what_was_measured_of_the_person_come_back(tmp_path: Path) -> None:
    model = published_model(static_only=True)
    widths = {"knee_width": {"r": 0.105, "l": 0.107}, "ankle_width": {"r": 0.07}}
    known = {
        "age": 9.5,
        "asis_distance": 0.2451,
        "marker_diameter": 0.014,
        "session": "2026-03-01, 'after'",
    }
    record = PatientRecord(
        birth_date="2016-09-01", diagnosis='CP, "left"', affected_side="left", aids="AFO"
    )
    told = replace(model.subject, **known, **widths, leg_length={"r": 0.71}, record=record)  # type: ignore[arg-type]
    posture = {"hip_rotation_r": 0.1, "ankle_angle_l": -1.0 / 3.0}
    assert_comes_back(replace(model, subject=told, posture=posture), tmp_path)


def test_people_can_read_it() -> None:
    text = format_model(published_model())
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
        model.markers,
        labels=(label, label + "'"),
        segments=("pelvis", "foot_l"),
        local=local,
        weight=weight,
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
    assert_comes_back(model, tmp_path_factory.mktemp("model"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"hip_r.pelvis.ant" ',
            '"hip_r.pelvis.anterior" ',
            "which is no parameter; did you mean 'hip_r.pelvis.ant'",
        ),
        ("format = 1", "format = 2", "format: found 2; allowed: 1"),
        ("format = 1", "forms = 1", "unknown key 'forms'; did you mean 'format'?"),
        ('sex = "male"', 'sex = "m"', "subject.sex: found 'm'; allowed: 'male', 'female'"),
        ("mass_kg = 69.4", "mass_kg = 0", "subject.mass_kg: found"),
        ("mass_kg = 69.4", "mass_kg = nan", "subject.mass_kg: found"),
        ("mass_kg = 69.4", "mass_kg = true", "subject.mass_kg: found True"),
        (
            'segment = "pelvis"\n',
            'segment = "pelvus"\n',
            "which is no segment; did you mean 'pelvis'?",
        ),
        ('label = "R.ASIS"', 'label = "L.ASIS"', "marker 'L.ASIS' is there 2 times"),
        (
            "frozen = []",
            'frozen = ["elbow_r"]',
            "which is no coordinate; did you mean 'elbow_flex_r'",
        ),
        ("-419.8, nominal", '"x", nominal', "joint_parameters"),
        ("-419.8, nominal", "1e99999999999, nominal", "allowed: a number that a person can have"),
        ("-419.8, nominal", "-inf, nominal", "allowed: a finite number"),
        ("-419.8, nominal", "1e301, nominal", "allowed: a number that a person can have"),
        ('"hip_l', '#"hip_l', "joint_parameters: 'hip_l.pelvis.ant' and 5 more missing"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = format_model(published_model())
    assert old in text
    path = tmp_path / "model.toml"
    path.write_text(text.replace(old, new, -1 if new.startswith("#") else 1), encoding="utf-8")
    said = refusal(load_model, path)
    assert str(path) in said and message in said


def test_a_number_that_is_none_is_not_written() -> None:
    model = published_model()
    with refuses(ValueError, "nan"):
        format_model(
            model.with_parameters(
                model.parameters.with_joint(("hip_r.pelvis.ant",), np.array([np.nan]))
            )
        )
