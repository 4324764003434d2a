"""Surfaces from VTK's `.vtp` files (XML PolyData), as OpenSim's `Geometry` folder has them.

Numbers stand as text, or as base64 behind a header that counts their bytes, with or without zlib. Polygons of more
than three corners become fans of triangles. Data appended behind the XML is not read: OpenSim's files have none.
"""

from __future__ import annotations

import base64
import xml.etree.ElementTree as ET
import zlib
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gaitcal.arrays import Array, IntArray
from gaitcal.page.body_meshes import Mesh

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
