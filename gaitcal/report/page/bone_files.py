"""Read bone meshes from the package `myo-sim`, if installed, or from OpenSim's `Geometry` folder.

Both contain the bones of the same musculoskeletal models (Rajagopal et al. 2016 and earlier ones),
in metres, in the frame of each body. Only right bones are read; left ones are mirror images.
`myo-sim` is not imported, as that would load a physics engine.

`.vtp` files (VTK XML PolyData) contain numbers as text, or as base64 after a header with their byte
counts, with or without zlib. Polygons with more than three corners become fans of triangles. Data
appended after the XML are not read: OpenSim's files have none.
"""

import base64
import xml.etree.ElementTree as ET
import zlib
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gaitcal.arrays import Array, IntArray
from gaitcal.errors import Code, InputError
from gaitcal.report.page.body_meshes import Mesh, read_stl, with_fewer_triangles

PACKAGE = "myo-sim"
EXTRA = "bones"
_FOLDER = "myo_sim/models/meshes"
_FEMUR_LENGTH = (0.2, 0.7)  # m: a femur of another length is in another unit, or no femur
_TYPES = {
    "Float32": "f4", "Float64": "f8", "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4", "Int64": "i8", "UInt64": "u8",
}  # fmt: skip

_FILES: dict[str, tuple[tuple[str, ...], int]] = {
    "femur": (("r_femur", "femur_r", "femur_rv", "femur"), 1200),
    "tibia": (("r_tibia", "tibia_r", "tibia_rv", "tibia"), 1200),
    "fibula": (("r_fibula", "fibula_r", "fibula_rv", "fibula"), 1200),
    "pelvis": (("r_pelvis", "pelvis_rv"), 1200),
    "sacrum": (("sacrum",), 1200),
    "talus": (("r_talus", "talus_rv", "talus"), 1200),
    "foot": (("r_foot", "foot"), 1200),
    "toes": (("r_bofoot", "bofoot"), 700),
    "humerus": (("humerus", "humerus_rv"), 1200),
    "ulna": (("ulna", "ulna_rv"), 1200),
    "radius": (("radius", "radius_rv"), 1200),
    "ribs": (("hat_ribs_scap",), 5000),
    "spine": (("hat_spine",), 3000),
    "thoracic spine": (("hat_thoracic",), 1800),
    "lumbar spine": (("hat_lumbar",), 1000),
    "neck": (("hat_cervical",), 800),
    "skull": (("hat_skull",), 2200),
    "jaw": (("hat_jaw",), 600),
}
"""Bone, by its name in a page -> what its file may be called without ending, and how many triangles
of it are shown.
"""
_WHOLE_SPINE = {"thoracic spine", "lumbar spine", "neck"}  # What `spine` is in one file
NEEDED: tuple[str, ...] = ("femur", "tibia", "fibula", "pelvis")
"""Without these, whose landmarks place all others, there are no bones."""


@dataclass(frozen=True)
class BoneMeshes:
    """Bones of the right side and of the middle."""

    meshes: dict[str, Mesh]  # As they are in the files, m: landmarks are found on these
    source: str  # Where they are from, for the page
    licence: str  # Text of their licence; empty where the source has none

    def reduce_bone(self, bone: str) -> Mesh:
        """Reduce a bone to the number of triangles on the page."""
        return with_fewer_triangles(self.meshes[bone], _FILES[bone][1])


def find_installed_bones() -> BoneMeshes | None:
    """Find the bones of the installed `myo-sim`; None if it is missing or incomplete."""
    try:
        package = distribution(PACKAGE)
    except PackageNotFoundError:
        return None
    paths = (Path(str(f.locate())) for f in package.files or () if f.parent.as_posix() == _FOLDER)
    try:
        meshes = _read({path.name: path for path in paths}, Path(_FOLDER))
    except InputError:
        return None
    return BoneMeshes(
        meshes,
        f"{PACKAGE} {package.version} (Apache-2.0)",
        package.read_text("licenses/LICENSE") or "",
    )


def read_bone_folder(folder: Path) -> BoneMeshes:
    """Read a folder of `.vtp` or `.stl` files with OpenSim's names.

    Parameters
    ----------
    folder
        The folder.

    Returns
    -------
    BoneMeshes
        Bones, m.

    Raises
    ------
    InputError
        The folder is missing, a file is not a surface, a required bone is missing, or the unit is
        not the metre.
    """
    if not folder.is_dir():
        message = "found no such folder; allowed: OpenSim's `Geometry`, or one like it"
        raise InputError(message, source=folder, code=Code.NO_FILE)
    files = {path.name: path for path in sorted(folder.iterdir()) if path.is_file()}
    return BoneMeshes(_read(files, folder), f"the folder {folder.name}", "")


def _read(files: dict[str, Path], source: Path) -> dict[str, Mesh]:
    readers = {".stl": read_stl, ".vtp": read_vtp}
    meshes = {}
    for bone, (stems, _) in _FILES.items():
        path = next(
            (files[s + ending] for s in stems for ending in readers if s + ending in files), None
        )
        if path is None:
            continue
        try:
            meshes[bone] = readers[path.suffix](path.read_bytes())
        except (OSError, ValueError) as error:
            raise InputError(
                f"cannot be read as a surface: {error}", source=path, code=Code.BONES
            ) from error
    if missing := [bone for bone in NEEDED if bone not in meshes]:
        names = "; ".join(f"{bone}: {' or '.join(_FILES[bone][0])}" for bone in missing)
        message = f"found no {', '.join(missing)}; needed (.vtp or .stl): {names}"
        raise InputError(message, source=source, code=Code.BONES)
    # The height of the femur shows unit and axes of the files.
    length = float(np.ptp(meshes["femur"].vertices[:, 1]))
    low, high = _FEMUR_LENGTH
    if not low <= length <= high:
        message = (
            f"found a femur that is {length:.3g} high along y; allowed: {low:g} to {high:g} m "
            "(metres, y up)"
        )
        raise InputError(message, source=source, code=Code.BONES)
    # A whole spine or its regions, not both on top of each other.
    if "spine" in meshes:
        meshes = {bone: mesh for bone, mesh in meshes.items() if bone not in _WHOLE_SPINE}
    return meshes


def read_vtp(content: bytes) -> Mesh:
    """Read a surface, with polygons as triangles.

    Raises ValueError: the content is not such a file, is damaged, or has an unsupported encoding.
    """
    # Entities can expand to gigabytes.
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
        points = _read_array(root, piece, "Points/DataArray").reshape(-1, 3).astype(float)
        corners = _read_array(root, piece, "Polys/DataArray[@Name='connectivity']").astype(np.intp)
        ends = _read_array(root, piece, "Polys/DataArray[@Name='offsets']").astype(np.intp)
        if len(corners) and not (corners.min() >= 0 and corners.max() < len(points)):
            raise ValueError("corners beyond the points")
        vertices.append(points)
        triangles.append(count + _split_polygons(corners, ends))
        count += len(points)
    if (
        not triangles
        or not sum(map(len, triangles))
        or not all(np.isfinite(v).all() for v in vertices)
    ):
        raise ValueError("no surface")
    return Mesh(np.vstack(vertices), np.vstack(triangles))


def _split_polygons(corners: IntArray, ends: IntArray) -> IntArray:
    """Split polygons, given by consecutive corners up to each end, into (nt, 3) triangles."""
    starts = np.concatenate([[0], ends[:-1]]) if len(ends) else ends
    if len(ends) and (np.any(np.diff(ends) < 0) or ends[0] < 0 or ends[-1] > len(corners)):
        raise ValueError("polygons beyond the corners")
    fans = [
        (corners[a], corners[k], corners[k + 1])
        for a, b in zip(starts, ends, strict=True)
        for k in range(a + 1, b - 1)
    ]
    return np.array(fans, dtype=np.intp).reshape(-1, 3)


def _read_array(root: ET.Element, piece: ET.Element, path: str) -> NDArray[np.generic]:
    found = piece.find(path)
    if found is None or found.get("type") not in _TYPES:
        raise ValueError(f"no {path}")
    # VTK's XML: ASCII, or base64 with a size before the data, compressed in blocks or not.
    order = "<" if root.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    kind = np.dtype(order + _TYPES[found.get("type", "")])
    parts = (found.text or "").split()
    form, compressor = found.get("format", "ascii"), root.get("compressor")
    if form == "ascii":
        return np.array(parts, dtype=kind.newbyteorder("="))
    if form != "binary":
        raise ValueError(f"data in the format '{form}'")
    if compressor not in (None, "vtkZLibDataCompressor"):
        raise ValueError(f"data packed by {compressor}")
    packed, counts = "".join(parts), np.dtype(order + _TYPES[root.get("header_type", "UInt32")])
    if compressor:
        return np.frombuffer(_decode_blocks(packed, counts), dtype=kind)
    raw = base64.b64decode(packed)
    # The first number is the size of the data in bytes.
    (size,) = np.frombuffer(raw[: counts.itemsize], counts)
    return np.frombuffer(raw[counts.itemsize : counts.itemsize + int(size)], dtype=kind)


def _decode_blocks(text: str, counts: np.dtype[np.generic]) -> bytes:
    """Decode compressed blocks of base64.

    The header is encoded separately: number of blocks, block size, size of the last block, then the
    compressed size of each block.
    """

    def encoded(size: int) -> int:
        return 4 * -(-size // 3)  # characters of base64 for so many bytes

    blocks = int(
        np.frombuffer(
            base64.b64decode(text[: encoded(counts.itemsize)])[: counts.itemsize], counts
        )[0]
    )
    header = encoded((3 + blocks) * counts.itemsize)
    # Header: number of blocks, size of a block, size of the last one, compressed sizes.
    sizes = np.frombuffer(base64.b64decode(text[:header]), counts)[3 : 3 + blocks].astype(int)
    raw, out, at = base64.b64decode(text[header:]), b"", 0
    try:
        for size in sizes:
            out += zlib.decompress(raw[at : at + size])
            at += size
    except zlib.error as error:
        raise ValueError("damaged data") from error
    return out
