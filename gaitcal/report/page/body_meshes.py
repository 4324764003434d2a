"""Fit the human body meshes of example-robot-data to a subject; capsules replace missing meshes.

Each mesh has its own unit and its origin at the proximal joint; x forward, y up, z to the right.
The reference body (that package's `human.urdf`) gives the joint positions in each mesh. A limb mesh
is scaled along its length, so that its joints meet the subject's joint centres, and across by a
girth that depends on body mass and height. Pelvis and trunk are scaled to hip and shoulder centres.
Each mesh moves with its segment. Plain balls of 5800 triangles are drawn with 480.
"""

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.model.kinematics import compute_body_poses
from gaitcal.model.linkage import COORDINATES, SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel

MESHES: dict[str, tuple[Array, Array]] = {
    name: (np.array(low), np.array(high))
    for name, low, high in (
        ("abdomen", (-14.9, -2.8, -15.4), (15.1, 27.1, 14.6)),
        ("elbow", (-6.25, -6.25, -6.25), (6.25, 6.25, 6.25)),
        ("foot", (-9.5, -11.4, -8.9), (31.0, 5.1, 9.1)),
        ("hand", (-4.5, -27.5, -8.3), (7.6, 4.4, 8.3)),
        ("head", (-15.8, 4.2, -16.1), (16.2, 46.2, 16.0)),
        ("knee", (-6.25, -6.25, -6.25), (6.25, 6.25, 6.25)),
        ("lowerarm", (-7.3, -40.6, -7.7), (8.2, -0.1, 7.9)),
        ("lowerleg", (-9.0, -70.2, -9.0), (8.9, -3.2, 9.0)),
        ("neck", (-9.25, -9.25, -9.25), (9.25, 9.25, 9.25)),
        ("pelvis", (-20.0, -15.9, -20.0), (17.1, 16.6, 19.2)),
        ("shoulder", (-8.75, -8.75, -8.75), (8.75, 8.75, 8.75)),
        ("torso", (-20.1, 22.9, -20.2), (16.9, 74.9, 19.8)),
        ("upperarm", (-8.6, -53.1, -8.6), (8.5, -7.1, 8.6)),
        ("upperleg", (-10.6, -62.3, -10.3), (10.4, 6.2, 10.6)),
    )
}
"""The meshes in use and their bounding boxes in their unit; a substitute for a missing mesh fills
its box.
"""

PACKAGE = "example-robot-data"
_FOLDER = "robots/human_description/meshes"
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
BALLS = ("abdomen", "elbow", "knee", "neck", "shoulder")
_RINGS, _AROUND = 13, 20
_MOST_TRIANGLES = (
    1_500  # Of a mesh on the page: a processor without a graphics card draws them, too
)
_COARSER = 1.2  # Factor of the grid's cells from one attempt at fewer triangles to the next
_SLACK = 0.05  # Of the longest side: how far a mesh may leave the box that places it
_MOST_VERTICES = 65_536  # What 16-bit corner numbers in the page can name
REFERENCE_MASS, REFERENCE_HEIGHT = 74.7, 1.787  # kg, m of the reference body: sums over its URDF
_HIP_DROP, _HIP_FORWARD = 0.100, 0.023  # m: lumbar joint to mid-hip
_FOOT_LENGTH = 0.271
_HEAD_FORWARD = 0.05  # m that the head is carried before the line from lumbar joint to shoulders
FOOT_OF_HEIGHT, _FOREARM_OF_HEIGHT, _HEAD_OF_HEIGHT, _ANKLE_OF_HEIGHT = 0.152, 0.1545, 0.130, 0.039
"""Foot length, elbow to wrist, chin to vertex, ankle centre above the floor, as shares of body
height (Drillis and Contini 1966; forearm: de Leva 1996)."""
_HEAD_MARKER_OF_HEIGHT, _VERTEX_OVER_MARKERS = 0.08, 0.03
"""Of body height: so far above the shoulders a marker is one of the head; the vertex over the
highest of them, between a marker on it and a band around the forehead."""


@dataclass(frozen=True)
class Mesh:
    """A closed surface."""

    vertices: Array  # (nv, 3) in the unit of the mesh
    triangles: IntArray  # (nt, 3)


@dataclass(frozen=True)
class BodyMeshes:
    """All meshes of a body."""

    meshes: dict[str, Mesh]
    replaced: tuple[
        str, ...
    ]  # Those drawn as capsules, because the package has no such mesh or an unreadable one


@dataclass(frozen=True)
class FittedMesh:
    """One mesh, fixed in one segment."""

    mesh: str
    segment: str
    place: Array  # (3, 4) affine map from the unit of the mesh to the segment frame, m


def fit_body_meshes(model: SubjectModel) -> tuple[FittedMesh, ...]:
    """Fit the body meshes to a subject.

    Parameters
    ----------
    model
        The calibrated subject.

    Returns
    -------
    tuple of FittedMesh
        Lengths from joint centres, girths from mass and height.
    """
    tall = model.subject.height / REFERENCE_HEIGHT
    girth = float(np.sqrt(model.subject.mass / REFERENCE_MASS / tall))
    jp = model.parameters
    meshes = [*_fit_trunk(model, jp, girth), _fit_pelvis(jp, girth)]
    for side in SIDES:
        meshes += [
            *_fit_leg(jp, side, girth),
            _fit_foot(model, side),
            *_fit_arm(model, jp, side, girth),
        ]
    return tuple(meshes)


def _fit_limb(
    mesh: str, segment: str, ends: tuple[Array, Array], heights: tuple[float, float], across: float
) -> FittedMesh:
    """Fit a mesh: its `heights` (own unit) go to the joint centres `ends` (proximal, distal)."""
    along = (ends[0] - ends[1]) / (heights[0] - heights[1])
    scale = float(np.linalg.norm(along))
    y = along / scale
    x = np.cross(y, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    axes = np.column_stack([x, y, np.cross(x, y)])
    scaled = axes * np.array([across, scale, across])
    return FittedMesh(mesh, segment, np.column_stack([scaled, ends[0] - heights[0] * along]))


def _scale_mesh(
    mesh: str, segment: str, origin: Array, scale: tuple[float, float, float]
) -> FittedMesh:
    """Scale a mesh along the axes of its segment, with its origin at `origin` (m); m per unit."""
    return FittedMesh(mesh, segment, np.column_stack([np.diag(scale), origin]))


def _fit_trunk(model: SubjectModel, jp: Parameters, girth: float) -> list[FittedMesh]:
    """Fit the torso to the shoulders, and neck and head to the body height."""
    lumbar = jp.centre("back", "head_trunk")
    half = (
        float(jp.centre("shoulder_r", "head_trunk")[2] - jp.centre("shoulder_l", "head_trunk")[2])
        / 2
    )
    # Meshes have their sizes in units of the artist: 42 units for the head, 27.1 for the abdomen.
    head = _HEAD_OF_HEIGHT * model.subject.height / 42.0
    neck = compute_vertex_height(model) - 46.2 * head
    thick = 0.0056 * girth
    high = (neck - 0.03) / 52.0
    return [
        _scale_mesh(
            "abdomen", "head_trunk", lumbar, (0.0074 * girth, 0.45 * neck / 27.1, 0.0076 * girth)
        ),
        _scale_mesh(
            "torso",
            "head_trunk",
            lumbar + [0.0, 0.05 - 22.9 * high, 0.0],
            (0.00578 * girth, high, half / 22.0),
        ),
        _scale_mesh(
            "neck", "head_trunk", lumbar + [_HEAD_FORWARD / 2, neck, 0.0], (thick, 0.0075, thick)
        ),
        _scale_mesh("head", "head_trunk", lumbar + [_HEAD_FORWARD, neck, 0.0], (head, head, head)),
    ]


def compute_vertex_height(model: SubjectModel) -> float:
    """Compute the distance (m) of lumbar joint and top of the head.

    It follows from the body height and from the markers of the head, if there are any.
    """
    jp, height = model.parameters, model.subject.height
    lumbar = jp.centre("back", "head_trunk")[1]
    shoulders = (
        jp.centre("shoulder_r", "head_trunk")[1] + jp.centre("shoulder_l", "head_trunk")[1]
    ) / 2 - lumbar
    on_trunk = [segment == "head_trunk" for segment in model.markers.segments]
    head = model.markers.local[on_trunk, 1] - lumbar
    vertex = max(
        height - _compute_lumbar_height(jp, height),
        float(shoulders) + 0.9 * _HEAD_OF_HEIGHT * height,
    )
    has_markers = (head > shoulders + _HEAD_MARKER_OF_HEIGHT * height).any()
    return min(vertex, float(head.max()) + _VERTEX_OVER_MARKERS * height) if has_markers else vertex


def _compute_lumbar_height(jp: Parameters, height: float) -> float:
    """Compute the height (m) of the lumbar joint above the floor of the upright subject."""
    thighs = [
        jp.centre(f"hip_{s}", f"thigh_{s}")[1] - jp.centre(f"knee_{s}", f"thigh_{s}")[1]
        for s in SIDES
    ]
    shanks = [
        jp.centre(f"knee_{s}", f"shank_{s}")[1] - jp.centre(f"talocrural_{s}", f"shank_{s}")[1]
        for s in SIDES
    ]
    # Upwards from the floor: ankle, shank, thigh, pelvis, m.
    hips = (jp.centre("hip_r", "pelvis")[1] + jp.centre("hip_l", "pelvis")[1]) / 2
    return (
        (sum(thighs) + sum(shanks)) / 2
        + jp.centre("back", "pelvis")[1]
        - hips
        + _ANKLE_OF_HEIGHT * height
    )


def _fit_pelvis(jp: Parameters, girth: float) -> FittedMesh:
    hips = (jp.centre("hip_r", "pelvis") + jp.centre("hip_l", "pelvis")) / 2
    back = jp.centre("back", "pelvis")
    rise = max(float(back[1] - hips[1]), 0.02) / _HIP_DROP
    origin = np.array([hips[0] - _HIP_FORWARD * girth, back[1] - 0.05 * rise, hips[2]])
    return _scale_mesh(
        "pelvis", "pelvis", origin, (0.00643 * girth, 0.005897 * rise, 0.005897 * girth)
    )


def _fit_leg(jp: Parameters, side: str, girth: float) -> list[FittedMesh]:
    thigh, shank = f"thigh_{side}", f"shank_{side}"
    hip, knee = (
        jp.centre(f"hip_{side}", f"thigh_{side}"),
        jp.centre(f"knee_{side}", f"thigh_{side}"),
    )
    top, ankle = (
        jp.centre(f"knee_{side}", f"shank_{side}"),
        jp.centre(f"talocrural_{side}", f"shank_{side}"),
    )
    return [
        _fit_limb("upperleg", thigh, (hip, knee), (7.8, -60.8), 0.0065 * girth),
        _fit_limb("lowerleg", shank, (top, ankle), (0.0, -66.7), 0.0066 * girth),
        _scale_mesh("knee", shank, top, (0.0056 * girth,) * 3),
    ]


def _fit_foot(model: SubjectModel, side: str) -> FittedMesh:
    """Fit the foot mesh: ankle centre, upright at zero nominal coordinates, x to the toe."""
    foot, talus = f"foot_{side}", f"talus_{side}"
    upright = compute_upright_poses(model.nominal)[0][foot][:, 1].copy()
    axes, origins = compute_upright_poses(model.parameters)
    ankle = axes[foot] @ (origins[talus] - origins[foot])
    z = np.cross([1.0, 0.0, 0.0], upright)
    z /= np.linalg.norm(z)
    rotation = np.column_stack([np.cross(upright, z), upright, z])
    length = FOOT_OF_HEIGHT * model.subject.height
    return FittedMesh(
        "foot", foot, np.column_stack([rotation * (0.0067 * length / _FOOT_LENGTH), ankle])
    )


def compute_upright_poses(parameters: Parameters) -> tuple[dict[str, Array], dict[str, Array]]:
    """Compute segment -> (3, 3) rotation from laboratory to segment, and (3,) m origin.

    All coordinates are zero.
    """
    axes, origins = compute_body_poses(parameters, np.zeros((1, len(COORDINATES))))
    return {s: x[..., 0] for s, x in axes.items()}, {s: x[..., 0] for s, x in origins.items()}


def _fit_arm(model: SubjectModel, jp: Parameters, side: str, girth: float) -> list[FittedMesh]:
    upper, fore = f"upper_arm_{side}", f"forearm_hand_{side}"
    shoulder, elbow = jp.centre(f"shoulder_{side}", upper), jp.centre(f"elbow_{side}", upper)
    top, end = jp.centre(f"elbow_{side}", fore), locate_wrist(model, jp, side)
    hand = 0.0061 * model.subject.height / REFERENCE_HEIGHT
    return [
        _scale_mesh("shoulder", upper, shoulder, (0.00585 * girth,) * 3),
        _fit_limb("upperarm", upper, (shoulder, elbow), (-8.3, -54.3), 0.0062 * girth),
        _fit_limb("lowerarm", fore, (top, end), (0.0, -44.8), 0.0064 * girth),
        _scale_mesh("elbow", fore, top, (0.0055 * girth,) * 3),
        _scale_mesh("hand", fore, end, (hand, hand, hand)),
    ]


def locate_wrist(model: SubjectModel, jp: Parameters, side: str) -> Array:
    """Locate the (3,) m wrist in the forearm: its landmark, else by a share of body height."""
    known = model.landmarks.get(f"wrist_{side}")
    if known is not None and known[0] == f"forearm_hand_{side}":
        return known[1]
    down = np.array([0.0, _FOREARM_OF_HEIGHT * model.subject.height, 0.0])
    out: Array = jp.centre(f"elbow_{side}", f"forearm_hand_{side}") - down
    return out


def read_body_meshes() -> BodyMeshes:
    """Read the human meshes of the installed example-robot-data.

    Returns
    -------
    BodyMeshes
        With capsules for missing meshes.
    """
    files = _find_files()
    meshes, replaced = {}, []
    for name in MESHES:
        if name in BALLS:
            meshes[name] = make_round_body(*MESHES[name])
            continue
        try:
            whole = _check_mesh(name, read_stl(files[name].read_bytes()))
            meshes[name] = with_fewer_triangles(whole, _MOST_TRIANGLES)
        except (KeyError, OSError, ValueError):
            meshes[name] = make_round_body(*MESHES[name], blunt=2.0)
            replaced.append(name)
    return BodyMeshes(meshes, tuple(replaced))


def _check_mesh(name: str, mesh: Mesh) -> Mesh:
    """Raise ValueError if a mesh has another shape or unit than expected."""
    low, high = MESHES[name]
    slack = _SLACK * (high - low).max()
    low_off, high_off = (
        np.abs(mesh.vertices.min(axis=0) - low),
        np.abs(mesh.vertices.max(axis=0) - high),
    )
    if max(low_off.max(), high_off.max()) > slack or len(mesh.vertices) > _MOST_VERTICES:
        raise ValueError(name)
    return mesh


def _find_files() -> dict[str, Path]:
    try:
        listed = distribution(PACKAGE).files or ()
    except PackageNotFoundError:
        return {}
    paths = (Path(str(f.locate())) for f in listed if _FOLDER in f.as_posix())
    return {path.name.split("_mesh")[0]: path for path in paths}


def read_stl(content: bytes) -> Mesh:
    """Read a binary STL and join equal corners.

    Raises
    ------
    ValueError
        The content is not a binary STL, or is truncated.
    """
    # Binary STL: 80 bytes of header, the number of triangles, then 50 bytes for each.
    count = int.from_bytes(content[80:84], "little")
    if len(content) < 84 + count * _STL.itemsize or count == 0:
        raise ValueError("not a binary STL")
    corners = (
        np.frombuffer(content, dtype=_STL, count=count, offset=84)["corners"]
        .reshape(-1, 3)
        .astype(float)
    )
    if not np.isfinite(corners).all():
        raise ValueError("not a binary STL")
    order = np.lexsort(corners.T[::-1])  # as np.unique(axis=0), in a sixth of its time
    ordered = corners[order]
    new = np.append(True, np.any(ordered[1:] != ordered[:-1], axis=1))
    vertex = np.empty(len(order), dtype=np.intp)
    vertex[order] = np.cumsum(new) - 1
    return Mesh(ordered[new], vertex.reshape(-1, 3))


def make_round_body(low: Array, high: Array, blunt: float = 1.0) -> Mesh:
    """Make a body of revolution in a box: an ellipsoid, or with `blunt` 2 nearly a capsule."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, _RINGS + 1)[1:-1]
    longitude = np.linspace(0.0, 2 * np.pi, _AROUND, endpoint=False)
    # blunt > 1 makes the ends rounder, as those of a capsule.
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
    # Corner 0 is the lower pole, then ring after ring of `_AROUND` corners, the last corner is the
    # upper pole.
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


def with_fewer_triangles(mesh: Mesh, most: int) -> Mesh:
    """Reduce a mesh to at most `most` triangles by averaging corners in cells of a grid.

    A mesh with no more triangles is returned unchanged.
    """
    if len(mesh.triangles) <= most:
        return mesh
    # Cells begin at half an edge and grow until few enough triangles have three different corners.
    corners = mesh.vertices[mesh.triangles]
    cell = 0.5 * float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
    while True:
        x, y, z = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64).T
        group = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_inverse=True)[
            1
        ].reshape(-1)
        triangles = group[mesh.triangles]
        low, middle, high = np.sort(triangles, axis=1).T
        size = group.max() + 1
        kept = (low != middle) & (middle != high)
        # The same three cells twice are one triangle, or two that lie on each other.
        _, first = np.unique(((low * size + middle) * size + high)[kept], return_index=True)
        if len(first) <= most:
            break
        cell *= _COARSER
    count = np.bincount(group)
    means = np.column_stack([np.bincount(group, mesh.vertices[:, k]) / count for k in range(3)])
    used, vertex = np.unique(triangles[kept][np.sort(first)], return_inverse=True)
    return Mesh(means[used], vertex.reshape(-1, 3))
