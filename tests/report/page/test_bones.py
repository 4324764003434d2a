"""Files of bone surfaces, and the landmarks that are found on them."""

import base64
import json
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.errors import InputError
from gaitcal.model.nominal import published_model
from gaitcal.report.page.body_meshes import Mesh, read_body_meshes, with_fewer_triangles
from gaitcal.report.page.bone_files import find_installed_bones, read_bone_folder, read_vtp
from gaitcal.report.page.bone_landmarks import (
    KneeEvidence,
    NoLandmark,
    collect_person_landmarks,
    compute_volume,
    find_condyles,
    find_hip_bone,
    find_long_bone,
    find_shank_bones,
    fit_ball,
    is_inside,
)
from gaitcal.report.page.bone_placement import (
    MIRROR,
    Landmarked,
    apply_map,
    describe_knee,
    find_landmarks,
    fit_bones,
    map_femur,
    map_shank,
    measure_knee_axes,
)
from gaitcal.report.page.page_html import PageContent, render_page
from gaitcal.report.page.scene import JointMark, Scene, build_joint_marks
from gaitcal.report.page.scene_file import dump_scene_json
from tests.messages import refuses
from tests.report.page import made_bones as made
from tests.report.page.walked_blocks import held

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 2]], dtype=float)
CORNERS, ENDS = np.array([0, 1, 2, 3, 0, 1, 4]), np.array([4, 7])
TRIANGLES = [[0, 1, 2], [0, 2, 3], [0, 1, 4]]


def packed(values: np.ndarray, how: str) -> str:
    if how == "ascii":
        return " ".join(map(repr, values.ravel().tolist()))
    raw = values.tobytes()
    if how == "binary":
        return base64.b64encode(np.uint32(len(raw)).tobytes() + raw).decode()
    half = len(raw) // 2
    blocks = [zlib.compress(raw[:half]), zlib.compress(raw[half:])]
    header = np.array([2, half, len(raw) - half, *map(len, blocks)], dtype="<u4").tobytes()
    return base64.b64encode(header).decode() + base64.b64encode(b"".join(blocks)).decode()


def vtp(
    how: str, corners: np.ndarray = CORNERS, points: np.ndarray = POINTS, ends: np.ndarray = ENDS
) -> bytes:
    form = "ascii" if how == "ascii" else "binary"
    zipped = ' compressor="vtkZLibDataCompressor"' if how == "zlib" else ""

    def array(name: str, kind: str, values: np.ndarray) -> str:
        return (
            f'<DataArray type="{kind}" Name="{name}" '
            f'format="{form}">{packed(values, how)}</DataArray>'
        )

    return (
        '<?xml version="1.0"?><VTKFile type="PolyData" '
        f'byte_order="LittleEndian"{zipped}><PolyData><Piece>'
        f"<PointData>{array('Normals', 'Float32', points.astype('<f4'))}</PointData>"
        f"<Points>{array('Points', 'Float64', points.astype('<f8'))}</Points>"
        f"<Polys>{array('connectivity', 'Int32', corners.astype('<i4'))}"
        f"{array('offsets', 'Int32', ends.astype('<i4'))}"
        "</Polys></Piece></PolyData></VTKFile>"
    ).encode()


@pytest.mark.parametrize("how", ["ascii", "binary", "zlib"])
def test_polygons_come_as_triangles(how: str) -> None:
    mesh = read_vtp(vtp(how))
    np.testing.assert_array_equal(mesh.vertices, POINTS)
    assert mesh.triangles.tolist() == TRIANGLES


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"solid", "XML"),
        (b"<VTKFile type='ImageData'/>", "PolyData"),
        (b"<VTKFile type='PolyData'/>", "no surface"),
        (b"<!DOCTYPE a [<!ENTITY b 'c'>]><VTKFile type='PolyData'/>", "document type"),
        (vtp("ascii", CORNERS + 1), "beyond the points"),
        (vtp("ascii", ends=np.array([4, 9])), "beyond the corners"),
        (vtp("ascii", points=POINTS * np.nan), "float|no surface"),
        (vtp("binary").replace(b"binary", b"appended"), "appended"),
        (vtp("zlib").replace(b"vtkZLib", b"vtkLZ4"), "vtkLZ4"),
    ],
)
def test_what_is_no_surface_is_told(content: bytes, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        read_vtp(content)


@pytest.mark.parametrize("how", ["ascii", "binary", "zlib"])
def test_a_cut_file_is_no_surface(how: str) -> None:
    whole = vtp(how)
    for end in range(0, len(whole) - 1, 37):
        with pytest.raises(ValueError):
            read_vtp(whole[:end])


FLAT_FACES = 2e-4
"""m: a ball of flat triangles is that much smaller than the ball, and the points of a speck lie
beside its pole.
"""


@settings(max_examples=15, deadline=None)
@given(
    shift=st.tuples(*[st.floats(-0.006, 0.006)] * 4),
    radii=st.tuples(st.floats(0.016, 0.022), st.floats(0.016, 0.022)),
)
def test_head_and_condyles_are_found_where_they_were_put(
    shift: tuple[float, ...], radii: tuple[float, float]
) -> None:
    head = made.HEAD + [shift[0], 0.0, shift[1]]
    balls = {
        name: (centre + [move, 0.0, 0.0], radius)
        for (name, (centre, _)), move, radius in zip(
            made.CONDYLES.items(), shift[2:], radii, strict=True
        )
    }
    bone = made.femur(head=head, condyles=balls)
    found, pair = find_long_bone(bone), find_condyles(bone)
    np.testing.assert_allclose(found.head.centre, head, atol=FLAT_FACES)
    assert found.head.radius == pytest.approx(made.HEAD_RADIUS, abs=FLAT_FACES)
    np.testing.assert_allclose(found.lateral, made.LATERAL, atol=FLAT_FACES * 2)
    np.testing.assert_allclose(found.medial, made.MEDIAL, atol=FLAT_FACES * 2)
    for ball, (centre, radius) in (
        (pair.medial, balls["medial"]),
        (pair.lateral, balls["lateral"]),
    ):
        np.testing.assert_allclose(ball.centre, centre, atol=5e-4)
        assert 0.9 * radius < ball.radius <= radius, "off its middle, a slice of a ball is smaller"


def test_hip_bone_and_shank() -> None:
    hip = find_hip_bone(made.pelvis(), made.HEAD_RADIUS)
    np.testing.assert_allclose(hip.socket, made.SOCKET, atol=FLAT_FACES)
    np.testing.assert_allclose(hip.asis, made.ASIS, atol=FLAT_FACES * 2)
    np.testing.assert_allclose(hip.psis, made.PSIS, atol=FLAT_FACES * 2)
    shank = find_shank_bones(made.tibia(), made.fibula())
    np.testing.assert_allclose(shank.plateau, made.PLATEAU, atol=2e-3)
    np.testing.assert_allclose(shank.medial, made.MALLEOLI[0], atol=FLAT_FACES * 2)
    np.testing.assert_allclose(shank.lateral, made.MALLEOLI[1], atol=FLAT_FACES * 2)


def test_a_surface_that_is_no_femur_is_told() -> None:
    with refuses(NoLandmark):
        find_condyles(made.fibula())


def test_a_mesh_turned_inside_out_is_the_same_bone() -> None:
    bone = made.femur()
    turned = Mesh(bone.vertices, bone.triangles[:, ::-1])
    assert compute_volume(turned) == pytest.approx(-compute_volume(bone))
    np.testing.assert_allclose(find_condyles(turned).axis, find_condyles(bone).axis)
    assert is_inside(turned, made.HEAD)


def test_inside_and_outside() -> None:
    ball = made.ball(np.array([0.1, 0.2, 0.3]), 0.05)
    rng = np.random.default_rng(3)
    for point in np.array([0.1, 0.2, 0.3]) + rng.uniform(-0.08, 0.08, (60, 3)):
        far = np.linalg.norm(point - [0.1, 0.2, 0.3])
        if abs(far - 0.05) > 2e-3:
            assert is_inside(ball, point) == (far < 0.05)


def test_weights_count_as_repeated_points() -> None:
    rng = np.random.default_rng(1)
    points, counts = rng.normal(size=(12, 3)), rng.integers(1, 5, 12)
    centre, radius = fit_ball(points, counts.astype(float))
    again = fit_ball(np.repeat(points, counts, axis=0))
    np.testing.assert_allclose(centre, again[0], atol=1e-9)
    assert radius == pytest.approx(again[1])


def test_fewer_triangles_keep_the_shape() -> None:
    bone = made.femur()
    small = with_fewer_triangles(bone, 600)
    assert 300 < len(small.triangles) <= 600
    assert small.triangles.max() == len(small.vertices) - 1
    np.testing.assert_allclose(
        np.ptp(small.vertices, axis=0), np.ptp(bone.vertices, axis=0), atol=0.012
    )
    assert with_fewer_triangles(bone, len(bone.triangles)) is bone


def test_the_installed_bones_have_their_landmarks() -> None:
    """`myo-sim`: heads and sockets within millimetres of where its own model has the joints."""
    bones = find_installed_bones()
    if bones is None:
        pytest.skip("needs the extra `bones`")
    assert "Apache" in bones.licence
    found = find_landmarks(bones)
    # Joint centres of its file myolegs_chain.xml, and of Rajagopal et al. (2016), from which it is
    # made.
    np.testing.assert_allclose(found.femur.head.centre, [0.0, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(found.femur.middle, [0.0, -0.4044, 0.0], atol=1e-3)
    np.testing.assert_allclose(found.hip.socket, [-0.0563, -0.0785, 0.0773], atol=5e-3)
    np.testing.assert_allclose(found.hip.asis, [0.0, 0.0, 0.1208], atol=1e-3)
    for ball in (found.condyles.medial, found.condyles.lateral):
        assert 0.015 < ball.radius < 0.022
    assert 0.04 < np.linalg.norm(found.condyles.axis) < 0.055


EXACT = 1e-9
"""m: affine maps of numbers of about 1 m."""


@pytest.fixture(scope="module")
def bones(tmp_path_factory: pytest.TempPathFactory) -> Landmarked:
    return find_landmarks(
        read_bone_folder(made.folder_of_bones(tmp_path_factory.mktemp("bones") / "Geometry"))
    )


@pytest.fixture(scope="module")
def person():
    return collect_person_landmarks(published_model(static_only=True))


@pytest.mark.parametrize("side", ["r", "l"])
def test_a_femur_stands_on_hip_and_epicondyles(side: str, bones: Landmarked, person) -> None:
    place, bone, mirror = map_femur(bones, person, side), bones.femur, MIRROR[side]
    thigh = f"thigh_{side}"
    np.testing.assert_allclose(
        apply_map(place, bone.head.centre * mirror), person.point(thigh, "hip"), atol=EXACT
    )
    np.testing.assert_allclose(
        apply_map(place, bone.middle * mirror), person.point(thigh, "knee"), atol=EXACT
    )
    drawn = apply_map(place, (bone.lateral - bone.medial) * mirror) - place[:, 3]
    wanted = person.point(thigh, "epicondyle_lat") - person.point(thigh, "epicondyle_med")
    along = place[:, 1] / np.linalg.norm(place[:, 1])
    level = [v - (v @ along) * along for v in (drawn, wanted)]
    np.testing.assert_allclose(level[0], level[1], atol=1e-3 * np.linalg.norm(wanted))
    assert np.linalg.norm(place[:, 0]) == pytest.approx(np.linalg.norm(place[:, 1])), (
        "round condyles stay round"
    )


def test_plateaus_lie_under_condyles_and_malleoli_at_the_ankle(bones: Landmarked, person) -> None:
    for side, mirror in MIRROR.items():
        shank = map_shank(bones, person, side)
        middle = 0.5 * (bones.shank.lateral + bones.shank.medial) * mirror
        np.testing.assert_allclose(
            apply_map(shank, middle), person.point(f"shank_{side}", "ankle"), atol=EXACT
        )
        plateau = apply_map(shank, bones.shank.plateau * mirror)
        assert -0.045 < plateau[1] < -0.02, "below the knee's middle by a condyle"


def test_left_is_the_mirror_image_of_right(bones: Landmarked, person) -> None:
    """The published person is symmetric: so must be the bones."""
    placed = fit_bones(bones, person, 1.7)
    by_side = {(b.mesh, b.segment): b.place for b in placed if b.segment != "pelvis"}
    for (mesh, segment), right in by_side.items():
        if segment.endswith("_r"):
            left = by_side[mesh, segment[:-1] + "l"]
            points = bones.bones.meshes[mesh].vertices[::7]
            np.testing.assert_allclose(
                apply_map(left, points), apply_map(right, points) * MIRROR["l"], atol=1e-6
            )
    right, left = (b.place for b in placed if b.mesh == "pelvis")
    np.testing.assert_allclose(
        apply_map(right, bones.hip.socket), person.point("pelvis", "hip_r"), atol=EXACT
    )
    np.testing.assert_allclose(
        apply_map(left, bones.hip.socket), person.point("pelvis", "hip_l"), atol=EXACT
    )


@pytest.mark.parametrize("without", ["nothing", "knee_med", "knee"])
def test_no_fitted_knee_axis_moves_a_bone(without: str, bones: Landmarked) -> None:
    """What makes the picture evidence: the bones would stand where they do whatever the
    knee's fit.
    """
    model = published_model(static_only=True)
    model = replace(
        model, landmarks={k: v for k, v in model.landmarks.items() if not k.startswith(without)}
    )
    names = (
        "knee_r.thigh.ant",
        "knee_r.thigh.sup",
        "knee_r.thigh.front",
        "knee_r.thigh.trans",
        "knee_r.shank.front",
    )
    moved = model.with_parameters(
        model.parameters.with_joint(names, np.array([0.03, -0.5, 0.3, -0.2, 0.2]))
    )
    before, after = (fit_bones(bones, collect_person_landmarks(m), 1.7) for m in (model, moved))
    for a, b in zip(before, after, strict=True):
        np.testing.assert_array_equal(a.place, b.place)
    marks = build_joint_marks(model.nominal, moved.parameters, {})
    knee = measure_knee_axes(bones, collect_person_landmarks(moved), marks)[0]
    assert knee.fitted is not None and knee.fitted.medial.distance > 0.03
    assert not knee.fitted.medial.inside and "past both condyles" in describe_knee(knee)[0]


def marks_through(
    bones: Landmarked, person, shift: np.ndarray, error: float = np.nan, tilt: float = np.nan
) -> tuple[JointMark, ...]:
    """Knee marks through the condyles' centres, moved by `shift` (m)."""
    marks = []
    for side, mirror in MIRROR.items():
        place = map_femur(bones, person, side)
        centres = apply_map(
            place, np.array([bones.condyles.medial.centre, bones.condyles.lateral.centre]) * mirror
        )
        axis = (centres[1] - centres[0]) / np.linalg.norm(centres[1] - centres[0])
        marks.append(
            JointMark(
                joint=f"knee_{side}",
                segment=f"thigh_{side}",
                nominal_centre=centres.mean(axis=0),
                fitted_centre=centres.mean(axis=0) + shift,
                nominal_axis=axis,
                fitted_axis=axis,
                centre_spread=np.eye(3) * error,
                axis_spread=np.eye(3) * tilt,
                fitted=True,
            )
        )
    return tuple(marks)


def test_distances_to_an_axis_are_what_it_was_moved_by(bones: Landmarked, person) -> None:
    shift = np.array([0.006, -0.008, 0.0])
    for knee in measure_knee_axes(bones, person, marks_through(bones, person, shift)):
        assert (
            knee.nominal.angle < 1e-7
            and knee.nominal.medial.distance < EXACT
            and knee.nominal.lateral.inside
        )
        for end in (knee.fitted.medial, knee.fitted.lateral):
            assert end.distance == pytest.approx(0.01, rel=1e-2)
        assert "10 mm from the medial centre" in describe_knee(knee)[0]


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        (np.array([0.0, -0.018, 0.0]), "through both condyles"),
        (np.array([0.0, 0.022, 0.0]), "through the bone, outside both condyles' circles"),
        (np.array([0.0, -0.06, 0.0]), "past both condyles"),
    ],
)
def test_an_axis_outside_the_circle_is_not_through_the_condyle(
    shift: np.ndarray, words: str, bones: Landmarked, person
) -> None:
    """The shaft is bone as well, above and between the condyles."""
    (knee, _) = measure_knee_axes(bones, person, marks_through(bones, person, shift))
    ends = [
        replace(end, inside=end.distance <= end.radius or shift[1] > 0)
        for end in (knee.fitted.medial, knee.fitted.lateral)
    ]
    knee = replace(knee, fitted=replace(knee.fitted, medial=ends[0], lateral=ends[1]))
    assert words in describe_knee(knee)[0]


def test_what_an_axis_proves_is_said(bones: Landmarked, person) -> None:
    (knee, _) = measure_knee_axes(
        bones, person, marks_through(bones, person, np.zeros(3), 0.002, 0.03)
    )
    assert (
        "Its position is uncertain by about 23 mm; the nominal"
        in describe_knee(replace(knee, misfit=0.020))[2]
    ), "root of 20^2 + 2 * 8^2"


TURNS = {
    "left": np.diag([1.0, 1.0, -1.0]),
    "backwards": np.diag([-1.0, 1.0, -1.0]),
    "quarter turn": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "quarter turn back": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "mirrored front to back": np.diag([-1.0, 1.0, 1.0]),
}


@pytest.mark.parametrize(
    ("turn", "which"),
    [
        (turn, which)
        for turn in TURNS
        for which in (("femur",), ("pelvis",), ("fibula", "tibia"))
        if not (
            turn == "mirrored front to back" and "tibia" in which
        )  # its made rods are alike from front and back
    ],
)
def test_a_left_or_turned_bone_is_told(
    turn: str, which: tuple[str, ...], bones: Landmarked
) -> None:
    meshes = dict(bones.bones.meshes)
    for bone in which:
        triangles = meshes[bone].triangles[:, :: 1 if np.linalg.det(TURNS[turn]) > 0 else -1]
        meshes[bone] = replace(
            meshes[bone], vertices=meshes[bone].vertices @ TURNS[turn].T, triangles=triangles
        )
    with refuses(InputError):
        find_landmarks(replace(bones.bones, meshes=meshes))


def test_the_standard_error_is_that_of_drawn_axes(bones: Landmarked, person) -> None:
    """Across the axis, against 20 000 drawn centres and directions, which move the axis alike at
    the condyle.
    """
    sigma, tilt, rng = 0.0015, 0.07, np.random.default_rng(0)
    marks = marks_through(bones, person, np.zeros(3), sigma, tilt)
    knee = measure_knee_axes(bones, person, marks)[0]
    start = marks[0].fitted_centre + sigma * rng.normal(size=(20_000, 3))
    direction = marks[0].fitted_axis + tilt * rng.normal(size=(20_000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    away = knee.centres[0] - start
    offset = away - np.einsum("ij,ij->i", away, direction)[:, None] * direction
    drawn = np.sqrt(np.mean(np.sum(offset**2, axis=1)) / 2)
    assert knee.fitted.medial.standard_error == pytest.approx(drawn, rel=0.02)
    turned = np.cross(direction, marks[0].fitted_axis)
    assert knee.fitted.angle_error == pytest.approx(
        np.sqrt(np.mean(np.sum(turned**2, axis=1)) / 2), rel=0.02
    )


def test_what_a_knee_stands_on_is_told(bones: Landmarked) -> None:
    model = published_model(static_only=True)
    lateral = {k: v for k, v in model.landmarks.items() if not k.startswith("knee_med")}
    device = lateral | {f"knee_axis_{s}": lateral[f"knee_lat_{s}"] for s in "rl"}
    none = {k: v for k, v in lateral.items() if not k.startswith(("knee", "kjc"))}
    cases = {
        KneeEvidence.BOTH: (model.landmarks, "markers of both epicondyles"),
        KneeEvidence.LATERAL: (lateral, "assumed from the pelvis"),
        KneeEvidence.DEVICE: (device, "knee alignment device"),
        KneeEvidence.NOMINAL: (none, "proves nothing"),
    }
    for evidence, (landmarks, words) in cases.items():
        person = collect_person_landmarks(replace(model, landmarks=dict(landmarks)))
        assert set(person.knees.values()) == {evidence} and person.complete
        knee = measure_knee_axes(
            bones, person, build_joint_marks(model.nominal, model.parameters, {})
        )[0]
        assert words in describe_knee(knee)[2] and describe_knee(knee)[0].startswith("Not fitted")


def test_a_page_holds_bones_and_says_where_they_are_from(scene: Scene, bones: Landmarked) -> None:
    html = render_page(PageContent(scene), bones.bones)
    found = held(html)["scene"]["bones"]
    assert found["why"] is None and found["source"].startswith("the folder Geometry")
    assert set(found["meshes"]) == {"femur", "tibia", "fibula", "pelvis"}
    assert [knee["joint"] for knee in found["knees"]] == ["knee_r", "knee_l"]


def test_a_page_without_bones_says_how_to_get_them(scene: Scene) -> None:
    assert (
        "gaitcal[bones]" in json.loads(dump_scene_json(scene, read_body_meshes()))["bones"]["why"]
    )


def test_a_folder_that_is_none_is_told(tmp_path: Path) -> None:
    with refuses(InputError, "nowhere"):
        read_bone_folder(tmp_path / "nowhere")
    folder = made.folder_of_bones(tmp_path / "Geometry")
    (folder / "r_tibia.stl").unlink()
    with refuses(InputError, "tibia", "r_tibia"):
        read_bone_folder(folder)
    (folder / "r_tibia.stl").write_bytes(b"solid")
    with refuses(InputError, "r_tibia.stl"):
        read_bone_folder(folder)


@pytest.mark.parametrize(
    ("bone", "message"),
    [
        (replace(made.femur(), vertices=1e3 * made.femur().vertices), "allowed: 0.2 to 0.7 m"),
        (made.fibula(), "on its surface"),
    ],
    ids=["in millimetres", "of another shape"],
)
def test_a_femur_that_is_none_is_told(bone: Mesh, message: str, tmp_path: Path) -> None:
    folder = made.folder_of_bones(tmp_path / "Geometry")
    (folder / "r_femur.stl").write_bytes(made.stl(bone))
    with pytest.raises(InputError, match=message):
        find_landmarks(read_bone_folder(folder))
