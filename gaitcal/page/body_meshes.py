"""The human body meshes of example-robot-data; capsules where that package has none.

They are shown as they are, but for those that are mere balls of 5800 triangles, for which 480 do as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.page.body_fit import MESHES

PACKAGE = "example-robot-data"
_FOLDER = "robots/human_description/meshes"
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
BALLS = ("abdomen", "elbow", "knee", "neck", "shoulder")
_RINGS, _AROUND = 13, 20
_SLACK = 0.05
"""Of the longest side: how far a mesh may leave the box that `body_fit` places it by."""
_MOST_VERTICES = 65_536
"""What 16-bit corner numbers in the page can name."""


@dataclass(frozen=True)
class Mesh:
    """A closed surface."""

    vertices: Array
    """(nv, 3) in the mesh's own unit."""
    triangles: IntArray
    """(nt, 3)"""


@dataclass(frozen=True)
class BodyMeshes:
    """All meshes of a body."""

    meshes: dict[str, Mesh]
    replaced: tuple[str, ...]
    """Those drawn as capsules, because the package has no such mesh or an unreadable one."""


def body_meshes() -> BodyMeshes:
    """Read the human meshes of the installed example-robot-data; capsules for those it lacks."""
    files = _files()
    meshes, replaced = {}, []
    for name in MESHES:
        if name in BALLS:
            meshes[name] = round_body(*MESHES[name])
            continue
        try:
            meshes[name] = _as_expected(name, read_stl(files[name].read_bytes()))
        except (KeyError, OSError, ValueError):
            meshes[name] = round_body(*MESHES[name], blunt=2.0)
            replaced.append(name)
    return BodyMeshes(meshes, tuple(replaced))


def _as_expected(name: str, mesh: Mesh) -> Mesh:
    """ValueError for a mesh of another shape or unit than the one that `body_fit` places."""
    low, high = MESHES[name]
    slack = _SLACK * (high - low).max()
    low_off, high_off = np.abs(mesh.vertices.min(axis=0) - low), np.abs(mesh.vertices.max(axis=0) - high)
    if max(low_off.max(), high_off.max()) > slack or len(mesh.vertices) > _MOST_VERTICES:
        raise ValueError(name)
    return mesh


def _files() -> dict[str, Path]:
    try:
        listed = distribution(PACKAGE).files or ()
    except PackageNotFoundError:
        return {}
    paths = (Path(str(f.locate())) for f in listed if _FOLDER in f.as_posix())
    return {path.name.split("_mesh")[0]: path for path in paths}


def read_stl(content: bytes) -> Mesh:
    """A binary STL, equal corners joined.

    Raises
    ------
    ValueError
        It is none, or is cut off.
    """
    count = int.from_bytes(content[80:84], "little")
    if len(content) < 84 + count * _STL.itemsize or count == 0:
        raise ValueError("not a binary STL")
    corners = np.frombuffer(content, dtype=_STL, count=count, offset=84)["corners"].reshape(-1, 3).astype(float)
    if not np.isfinite(corners).all():
        raise ValueError("not a binary STL")
    order = np.lexsort(corners.T[::-1])  # as np.unique(axis=0), in a sixth of its time
    ordered = corners[order]
    new = np.append(True, np.any(ordered[1:] != ordered[:-1], axis=1))
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.cumsum(new) - 1
    return Mesh(ordered[new], place.reshape(-1, 3))


def round_body(low: Array, high: Array, blunt: float = 1.0) -> Mesh:
    """A body of revolution that fills a box: an ellipsoid, or with `blunt` 2 nearly a capsule."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, _RINGS + 1)[1:-1]
    longitude = np.linspace(0.0, 2 * np.pi, _AROUND, endpoint=False)
    radius = np.cos(latitude) ** (1.0 / blunt)
    ring = np.stack(
        [
            np.outer(radius, np.cos(longitude)),
            np.repeat(np.sin(latitude)[:, None], _AROUND, axis=1),
            np.outer(radius, np.sin(longitude)),
        ],
        axis=-1,
    )
    points = np.vstack([[0.0, -1.0, 0.0], ring.reshape(-1, 3), [0.0, 1.0, 0.0]])
    # Corner 0 is the lower pole, then ring after ring of `_AROUND` corners, the last corner is the upper pole.
    corner = np.arange(_AROUND)
    following = (corner + 1) % _AROUND
    pole = len(points) - 1
    top = pole - _AROUND
    triangles = [np.column_stack([np.zeros(_AROUND, dtype=np.intp), 1 + corner, 1 + following])]
    for k in range(_RINGS - 2):
        below, above = 1 + k * _AROUND, 1 + (k + 1) * _AROUND
        triangles.append(np.column_stack([below + corner, above + corner, below + following]))
        triangles.append(np.column_stack([below + following, above + corner, above + following]))
    triangles.append(np.column_stack([np.full(_AROUND, pole), top + following, top + corner]))
    return Mesh((low + high) / 2 + points * (high - low) / 2, np.vstack(triangles))
