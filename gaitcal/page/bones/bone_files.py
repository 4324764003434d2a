"""Where bones come from: the package `myo-sim` if it is installed, or OpenSim's `Geometry` folder.

Both hold the bones of the same musculoskeletal models (Rajagopal et al. 2016 and its forerunners), in metres, each in
the frame of its body. `myo-sim` is never imported, as that would load a physics engine: only its files are read.
Only right bones are read; left ones are their mirror images.

Surfaces from VTK's `.vtp` files (XML PolyData), as OpenSim's `Geometry` folder has them.

Numbers stand as text, or as base64 behind a header that counts their bytes, with or without zlib. Polygons of more
than three corners become fans of triangles. Data appended behind the XML is not read: OpenSim's files have none.

Measuring a bone's surface: outward normals, spheres, circles, and the same shape with fewer triangles.

A sphere |p - c|^2 = r^2 is linear in (c, r^2 - c.c) and solved by least squares; so is a circle in two coordinates.
"""

from __future__ import annotations

import base64
import xml.etree.ElementTree as ET
import zlib
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gaitcal.arrays import Array, IntArray
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.page.body_meshes import Mesh, read_stl

_TYPES = {
    "Float32": "f4", "Float64": "f8", "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4",
    "UInt32": "u4", "Int64": "i8", "UInt64": "u8",
}  # fmt: skip
_ZLIB = "vtkZLibDataCompressor"


def read_vtp(content: bytes) -> Mesh:
    """A surface; its polygons as triangles.

    Raises
    ------
    ValueError
        It is no such file, is damaged, or is packed in a way that is not read here.
    """
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise ValueError("a document type, which no geometry file needs")
    try:
        root = ET.fromstring(content)
    except ET.ParseError as error:
        raise ValueError("not XML") from error
    if root.tag != "VTKFile" or root.get("type") != "PolyData":
        raise ValueError("not a VTK PolyData file")
    vertices: list[Array] = []
    triangles: list[IntArray] = []
    count = 0
    for piece in root.iter("Piece"):
        points = _array(root, piece, "Points/DataArray").reshape(-1, 3).astype(float)
        corners = _array(root, piece, "Polys/DataArray[@Name='connectivity']").astype(np.intp)
        ends = _array(root, piece, "Polys/DataArray[@Name='offsets']").astype(np.intp)
        if len(corners) and not (corners.min() >= 0 and corners.max() < len(points)):
            raise ValueError("corners beyond the points")
        vertices.append(points)
        triangles.append(count + _fans(corners, ends))
        count += len(points)
    if not triangles or not sum(map(len, triangles)) or not all(np.isfinite(v).all() for v in vertices):
        raise ValueError("no surface")
    return Mesh(np.vstack(vertices), np.vstack(triangles))


def _fans(corners: IntArray, ends: IntArray) -> IntArray:
    """(nt, 3) triangles of polygons whose corners stand one after the other, up to each end."""
    starts = np.concatenate([[0], ends[:-1]]) if len(ends) else ends
    if len(ends) and (np.any(np.diff(ends) < 0) or ends[0] < 0 or ends[-1] > len(corners)):
        raise ValueError("polygons beyond the corners")
    fans = [
        (corners[a], corners[k], corners[k + 1]) for a, b in zip(starts, ends, strict=True) for k in range(a + 1, b - 1)
    ]
    return np.array(fans, dtype=np.intp).reshape(-1, 3)


def _array(root: ET.Element, piece: ET.Element, path: str) -> NDArray[np.generic]:
    found = piece.find(path)
    if found is None or found.get("type") not in _TYPES:
        raise ValueError(f"no {path}")
    kind = np.dtype(_TYPES[found.get("type", "")])
    text = found.text or ""
    form = found.get("format", "ascii")
    if form == "ascii":
        return np.array(text.split(), dtype=kind)
    if form != "binary":
        raise ValueError(f"data in the format '{form}'")
    order: Literal["<", ">"] = "<" if root.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    counts = np.dtype(_TYPES[root.get("header_type", "UInt32")]).newbyteorder(order)
    compressor = root.get("compressor")
    if compressor not in (None, _ZLIB):
        raise ValueError(f"data packed by {compressor}")
    packed = "".join(text.split())
    raw = _inflated(packed, counts) if compressor else _plain(packed, counts)
    return np.frombuffer(raw, dtype=kind.newbyteorder(order))


def _plain(text: str, counts: np.dtype[np.generic]) -> bytes:
    raw = base64.b64decode(text)
    (size,) = np.frombuffer(raw[: counts.itemsize], counts)
    return raw[counts.itemsize : counts.itemsize + int(size)]


def _inflated(text: str, counts: np.dtype[np.generic]) -> bytes:
    """Header: number of blocks, their size, size of the last, then each block's packed size; encoded by itself."""
    blocks = int(np.frombuffer(base64.b64decode(text[: _encoded(counts.itemsize)])[: counts.itemsize], counts)[0])
    header = _encoded((3 + blocks) * counts.itemsize)
    sizes = np.frombuffer(base64.b64decode(text[:header]), counts)[3 : 3 + blocks].astype(int)
    raw, out, at = base64.b64decode(text[header:]), b"", 0
    try:
        for size in sizes:
            out += zlib.decompress(raw[at : at + size])
            at += size
    except zlib.error as error:
        raise ValueError("damaged data") from error
    return out


def _encoded(size: int) -> int:
    """Characters of base64 for so many bytes."""
    return 4 * -(-size // 3)


_COARSER = 1.2
_PARTS = 5
"""Parts of a triangle's side between points spread over it."""


def volume(mesh: Mesh) -> float:
    """m^3, positive where the corners of the triangles go round counter-clockwise seen from outside."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def vertex_normals(mesh: Mesh) -> Array:
    """(nv, 3) outward unit vectors, the triangles around weighted by their area."""
    faces, _ = face_normals(mesh)
    sums = np.zeros_like(mesh.vertices)
    for k in range(3):
        np.add.at(sums, mesh.triangles[:, k], faces)
    out: Array = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
    return out


def face_normals(mesh: Mesh) -> tuple[Array, Array]:
    """(nt, 3) outward normals as long as the area (m^2), and (nt, 3) the triangles' middles, m."""
    corners = mesh.vertices[mesh.triangles]
    outward = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return outward * (1.0 if volume(mesh) > 0 else -1.0), corners.mean(axis=1)


def spread_points(mesh: Mesh) -> tuple[Array, Array, Array]:
    """Points (n, 3) spread over the whole surface, outward unit normals (n, 3) and the area (n,) each stands for.

    A few large triangles weigh as they should in a fit to these, which they do not by their corners alone.
    """
    outward, _ = face_normals(mesh)
    area = np.linalg.norm(outward, axis=1)
    places = [(i + 1 / 3, j + 1 / 3) for i in range(_PARTS) for j in range(_PARTS - i)]
    shares = np.array([(a / _PARTS, b / _PARTS, 1.0 - (a + b) / _PARTS) for a, b in places])
    points = np.einsum("pc,tcd->tpd", shares, mesh.vertices[mesh.triangles]).reshape(-1, 3)
    normals = np.repeat(outward / np.maximum(area, 1e-30)[:, None], len(shares), axis=0)
    return points, normals, np.repeat(area / len(shares), len(shares))


def fitted_ball(points: Array, weights: Array | None = None) -> tuple[Array, float]:
    """Centre (d,) and radius (m) of the sphere, or in two dimensions the circle, nearest to points (n, d)."""
    root = np.ones(len(points)) if weights is None else np.sqrt(weights)
    rows = np.column_stack([2.0 * points, np.ones(len(points))]) * root[:, None]
    solution = np.linalg.lstsq(rows, np.sum(points**2, axis=1) * root, rcond=None)[0]
    centre = solution[:-1]
    return centre, float(np.sqrt(max(solution[-1] + centre @ centre, 0.0)))


def is_inside(mesh: Mesh, point: Array) -> bool:
    """Whether a point (3,) m lies inside a closed surface.

    The solid angles of all triangles, seen from the point, add up to 4 pi inside and to 0 outside (Van Oosterom and
    Strackee 1983, IEEE Trans Biomed Eng 30).
    """
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a))]
    angles = 2.0 * np.arctan2(triple, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
    return abs(float(angles.sum())) > 2.0 * np.pi


def with_fewer_triangles(mesh: Mesh, most: int) -> Mesh:
    """The shape with at most so many triangles: corners that share a cell of a grid become their mean.

    A mesh that has no more is returned as it is.
    """
    if len(mesh.triangles) <= most:
        return mesh
    corners = mesh.vertices[mesh.triangles]
    cell = 0.5 * float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
    while True:
        group = _grouped(mesh, cell)
        triangles, keys = _kept(mesh, group)
        ordered = np.sort(keys)
        if int((ordered[1:] != ordered[:-1]).sum()) + len(keys[:1]) <= most:
            return _clustered(mesh, group, triangles, keys)
        cell *= _COARSER


def _grouped(mesh: Mesh, cell: float) -> IntArray:
    """The cell that each corner lies in, as its number among those that hold some."""
    x, y, z = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64).T
    _, group = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_inverse=True)
    return group.reshape(-1)


def _kept(mesh: Mesh, group: IntArray) -> tuple[IntArray, IntArray]:
    """Triangles (n, 3) between three cells, and (n,) a number that only those between the same three share."""
    a, b, c = group[mesh.triangles.T]
    kept = (a != b) & (b != c) & (c != a)
    a, b, c = (corner[kept] for corner in (a, b, c))
    i, k = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    size = group.max() + 1
    return np.stack([a, b, c], axis=1), (i * size + (a + b + c - i - k)) * size + k


def _clustered(mesh: Mesh, group: IntArray, triangles: IntArray, keys: IntArray) -> Mesh:
    """The mean corners of the cells. The same three twice are one triangle, or two that lie on each other."""
    count = np.bincount(group)
    means = np.column_stack([np.bincount(group, mesh.vertices[:, k]) / count for k in range(3)])
    _, first = np.unique(keys, return_index=True)
    triangles = triangles[np.sort(first)]
    used, place = np.unique(triangles, return_inverse=True)
    return Mesh(means[used], place.reshape(-1, 3))


PACKAGE = "myo-sim"
EXTRA = "bones"
_FOLDER = "myo_sim/models/meshes"
_READERS = {".stl": read_stl, ".vtp": read_vtp}
_ALLOWED_LENGTH = (0.2, 0.7)
"""m of a femur: anything else is in another unit, or no femur."""


@dataclass(frozen=True)
class _Bone:
    """What a bone's file may be called, and how many triangles of it are shown."""

    stems: tuple[str, ...]
    most: int = 1200


_BONES: dict[str, _Bone] = {
    "femur": _Bone(("r_femur", "femur_r", "femur_rv", "femur")),
    "tibia": _Bone(("r_tibia", "tibia_r", "tibia_rv", "tibia")),
    "fibula": _Bone(("r_fibula", "fibula_r", "fibula_rv", "fibula")),
    "pelvis": _Bone(("r_pelvis", "pelvis_rv")),
    "sacrum": _Bone(("sacrum",)),
    "talus": _Bone(("r_talus", "talus_rv", "talus")),
    "foot": _Bone(("r_foot", "foot")),
    "toes": _Bone(("r_bofoot", "bofoot"), 700),
    "humerus": _Bone(("humerus", "humerus_rv")),
    "ulna": _Bone(("ulna", "ulna_rv")),
    "radius": _Bone(("radius", "radius_rv")),
    "ribs": _Bone(("hat_ribs_scap",), 5000),
    "spine": _Bone(("hat_spine",), 3000),
    "thoracic spine": _Bone(("hat_thoracic",), 1800),
    "lumbar spine": _Bone(("hat_lumbar",), 1000),
    "neck": _Bone(("hat_cervical",), 800),
    "skull": _Bone(("hat_skull",), 2200),
    "jaw": _Bone(("hat_jaw",), 600),
}
BONES: tuple[str, ...] = tuple(_BONES)
"""All bones that can be shown, by the name they have in a page."""
_WHOLE_SPINE = {"thoracic spine", "lumbar spine", "neck"}
"""What `spine` is in one file."""
NEEDED: tuple[str, ...] = ("femur", "tibia", "fibula", "pelvis")
"""Without these, whose landmarks place all others, there are no bones."""


@dataclass(frozen=True)
class BoneMeshes:
    """Bones of the right side and the middle."""

    meshes: dict[str, Mesh]
    """As they are in the files, m: landmarks are found on these."""
    source: str
    """Where they are from, for the page."""
    licence: str
    """Text of their licence; empty where the source has none."""

    def shown(self, bone: str) -> Mesh:
        """The bone with as many triangles as the page shows of it."""
        return with_fewer_triangles(self.meshes[bone], _BONES[bone].most)


def installed_bones() -> BoneMeshes | None:
    """The bones of the installed `myo-sim`; None where it is not installed, or no longer has what is needed."""
    try:
        package = distribution(PACKAGE)
    except PackageNotFoundError:
        return None
    paths = (Path(str(f.locate())) for f in package.files or () if f.parent.as_posix() == _FOLDER)
    try:
        meshes = _read({path.name: path for path in paths})
        _check(meshes, Path(_FOLDER))
    except InputError:
        return None
    return BoneMeshes(meshes, f"{PACKAGE} {package.version} (Apache-2.0)", package.read_text("licenses/LICENSE") or "")


def bones_of_folder(folder: Path) -> BoneMeshes:
    """The bones of a folder of `.vtp` or `.stl` files with OpenSim's names.

    Raises
    ------
    InputError
        No such folder, a file that is no surface, a bone that is needed is missing, or the unit is not the metre.
    """
    if not folder.is_dir():
        raise InputError(
            "found no such folder; allowed: OpenSim's `Geometry`, or one like it", source=folder, code=Code.NO_FILE
        )
    meshes = _read({path.name: path for path in sorted(folder.iterdir()) if path.is_file()})
    _check(meshes, folder)
    return BoneMeshes(meshes, f"the folder {folder.name}", "")


def _read(files: dict[str, Path]) -> dict[str, Mesh]:
    meshes = {}
    for bone, about in _BONES.items():
        names = [stem + ending for stem in about.stems for ending in _READERS if stem + ending in files]
        if names:
            path = files[names[0]]
            try:
                meshes[bone] = _READERS[path.suffix](path.read_bytes())
            except (OSError, ValueError) as error:
                raise InputError(f"cannot be read as a surface: {error}", source=path, code=Code.BONES) from error
    if "spine" in meshes:
        meshes = {bone: mesh for bone, mesh in meshes.items() if bone not in _WHOLE_SPINE}
    return meshes


def _check(meshes: dict[str, Mesh], source: Path) -> None:
    missing = [bone for bone in NEEDED if bone not in meshes]
    if missing:
        names = "; ".join(f"{bone}: {' or '.join(_BONES[bone].stems)}" for bone in missing)
        raise InputError(
            f"found no {', '.join(missing)}; needed (.vtp or .stl): {names}", source=source, code=Code.BONES
        )
    length = float(np.ptp(meshes["femur"].vertices[:, 1]))
    low, high = _ALLOWED_LENGTH
    if not low <= length <= high:
        raise InputError(
            f"found a femur that is {length:.3g} high along y; allowed: {low:g} to {high:g} m (metres, y up)",
            source=source,
            code=Code.BONES,
        )
