"""Files of bone surfaces, and the landmarks that are found on them."""

import base64
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.page.body_meshes import Mesh, with_fewer_triangles
from gaitcal.page.bone_files import installed_bones, read_vtp
from gaitcal.page.bone_landmarks import (
    NoLandmark,
    condyles,
    fitted_ball,
    hip_bone,
    is_inside,
    long_bone,
    shank_bones,
    volume,
)
from gaitcal.page.bone_placement import landmarked
from tests.page import made_bones as made

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


def vtp(how: str, corners: np.ndarray = CORNERS, points: np.ndarray = POINTS, ends: np.ndarray = ENDS) -> bytes:
    form = "ascii" if how == "ascii" else "binary"
    zipped = ' compressor="vtkZLibDataCompressor"' if how == "zlib" else ""

    def array(name: str, kind: str, values: np.ndarray) -> str:
        return f'<DataArray type="{kind}" Name="{name}" format="{form}">{packed(values, how)}</DataArray>'

    return (
        f'<?xml version="1.0"?><VTKFile type="PolyData" byte_order="LittleEndian"{zipped}><PolyData><Piece>'
        f"<PointData>{array('Normals', 'Float32', points.astype('<f4'))}</PointData>"
        f"<Points>{array('Points', 'Float64', points.astype('<f8'))}</Points>"
        f"<Polys>{array('connectivity', 'Int32', corners.astype('<i4'))}{array('offsets', 'Int32', ends.astype('<i4'))}"
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
"""m: a ball of flat triangles is that much smaller than the ball, and the points of a speck lie beside its pole."""


@settings(max_examples=15, deadline=None)
@given(
    shift=st.tuples(*[st.floats(-0.006, 0.006)] * 4), radii=st.tuples(st.floats(0.016, 0.022), st.floats(0.016, 0.022))
)
def test_head_and_condyles_are_found_where_they_were_put(shift: tuple[float, ...], radii: tuple[float, float]) -> None:
    head = made.HEAD + [shift[0], 0.0, shift[1]]
    balls = {
        name: (centre + [move, 0.0, 0.0], radius)
        for (name, (centre, _)), move, radius in zip(made.CONDYLES.items(), shift[2:], radii, strict=True)
    }
    bone = made.femur(head=head, condyles=balls)
    found, pair = long_bone(bone), condyles(bone)
    np.testing.assert_allclose(found.head.centre, head, atol=FLAT_FACES)
    assert found.head.radius == pytest.approx(made.HEAD_RADIUS, abs=FLAT_FACES)
    np.testing.assert_allclose(found.lateral, made.LATERAL, atol=FLAT_FACES * 2)
    np.testing.assert_allclose(found.medial, made.MEDIAL, atol=FLAT_FACES * 2)
    for ball, (centre, radius) in ((pair.medial, balls["medial"]), (pair.lateral, balls["lateral"])):
        np.testing.assert_allclose(ball.centre, centre, atol=5e-4)
        assert 0.9 * radius < ball.radius <= radius, "off its middle, a slice of a ball is smaller"


def test_hip_bone_and_shank() -> None:
    hip = hip_bone(made.pelvis(), made.HEAD_RADIUS)
    np.testing.assert_allclose(hip.socket, made.SOCKET, atol=FLAT_FACES)
    np.testing.assert_allclose(hip.asis, made.ASIS, atol=FLAT_FACES * 2)
    np.testing.assert_allclose(hip.psis, made.PSIS, atol=FLAT_FACES * 2)
    shank = shank_bones(made.tibia(), made.fibula())
    np.testing.assert_allclose(shank.plateau, made.PLATEAU, atol=2e-3)
    np.testing.assert_allclose(shank.medial, made.MALLEOLI[0], atol=FLAT_FACES * 2)
    np.testing.assert_allclose(shank.lateral, made.MALLEOLI[1], atol=FLAT_FACES * 2)


def test_a_surface_that_is_no_femur_is_told() -> None:
    with pytest.raises(NoLandmark, match="no round head"):
        condyles(made.fibula())


def test_a_mesh_turned_inside_out_is_the_same_bone() -> None:
    bone = made.femur()
    turned = Mesh(bone.vertices, bone.triangles[:, ::-1])
    assert volume(turned) == pytest.approx(-volume(bone))
    np.testing.assert_allclose(condyles(turned).axis, condyles(bone).axis)
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
    centre, radius = fitted_ball(points, counts.astype(float))
    again = fitted_ball(np.repeat(points, counts, axis=0))
    np.testing.assert_allclose(centre, again[0], atol=1e-9)
    assert radius == pytest.approx(again[1])


def test_fewer_triangles_keep_the_shape() -> None:
    bone = made.femur()
    small = with_fewer_triangles(bone, 600)
    assert 300 < len(small.triangles) <= 600
    assert small.triangles.max() == len(small.vertices) - 1
    np.testing.assert_allclose(np.ptp(small.vertices, axis=0), np.ptp(bone.vertices, axis=0), atol=0.012)
    assert with_fewer_triangles(bone, len(bone.triangles)) is bone


def test_the_installed_bones_have_their_landmarks() -> None:
    """`myo-sim`: heads and sockets within millimetres of where its own model has the joints."""
    bones = installed_bones()
    if bones is None:
        pytest.skip("needs the extra `bones`")
    assert "Apache" in bones.licence
    found = landmarked(bones)
    # Joint centres of its file myolegs_chain.xml, and of Rajagopal et al. (2016), from which it is made.
    np.testing.assert_allclose(found.femur.head.centre, [0.0, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(found.femur.middle, [0.0, -0.4044, 0.0], atol=1e-3)
    np.testing.assert_allclose(found.hip.socket, [-0.0563, -0.0785, 0.0773], atol=5e-3)
    np.testing.assert_allclose(found.hip.asis, [0.0, 0.0, 0.1208], atol=1e-3)
    for ball in (found.condyles.medial, found.condyles.lateral):
        assert 0.015 < ball.radius < 0.022
    assert 0.04 < np.linalg.norm(found.condyles.axis) < 0.055
