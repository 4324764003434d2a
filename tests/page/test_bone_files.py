import base64
import zlib

import numpy as np
import pytest

from gaitcal.page.bone_files import read_vtp

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
