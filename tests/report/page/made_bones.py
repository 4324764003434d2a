"""Bones made of balls, whose landmarks are known: nobody's, but enough to place and to look at."""

from pathlib import Path

import numpy as np

from gaitcal.report.page.body_meshes import Mesh, make_round_body

HEAD, HEAD_RADIUS = np.zeros(3), 0.024
LATERAL, MEDIAL = np.array([0.0, -0.404, 0.046]), np.array([0.0, -0.404, -0.046])
CONDYLES = {
    "medial": (np.array([-0.006, -0.410, -0.022]), 0.020),
    "lateral": (np.array([-0.006, -0.408, 0.022]), 0.019),
}
SOCKET, ASIS, PSIS = (
    np.array([-0.056, -0.078, 0.078]),
    np.array([0.0, 0.0, 0.120]),
    np.array([-0.138, 0.017, 0.040]),
)
PLATEAU, MALLEOLI = (
    np.array([-0.004, -0.025, 0.0]),
    (np.array([0.0, -0.39, -0.03]), np.array([0.0, -0.39, 0.034])),
)
SPECK = 0.002


def ball(centre: np.ndarray, radius: float) -> Mesh:
    return make_round_body(centre - radius, centre + radius)


def joined(*parts: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    triangles = [part.triangles + start for part, start in zip(parts, starts, strict=False)]
    return Mesh(np.vstack([part.vertices for part in parts]), np.vstack(triangles))


def femur(
    head: np.ndarray = HEAD, radius: float = HEAD_RADIUS, condyles: dict | None = None
) -> Mesh:
    condyles = condyles or CONDYLES
    shaft = make_round_body(np.array([-0.014, -0.39, 0.005]), np.array([0.014, 0.01, 0.03]))
    ends = [ball(end - SPECK * np.sign(end) * [0, 0, 1], SPECK) for end in (LATERAL, MEDIAL)]
    return joined(
        ball(head, radius), shaft, *(ball(centre, r) for centre, r in condyles.values()), *ends
    )


def pelvis() -> Mesh:
    """A shell around the socket, and the two spines."""
    inner = ball(SOCKET, HEAD_RADIUS)
    shell = joined(ball(SOCKET, HEAD_RADIUS + 0.01), Mesh(inner.vertices, inner.triangles[:, ::-1]))
    return joined(shell, ball(ASIS - [SPECK, 0, 0], SPECK), ball(PSIS + [SPECK, 0, 0], SPECK))


def tibia() -> Mesh:
    """A lens that is the plateau, a rod, and the medial malleolus."""
    lens = make_round_body(PLATEAU - [0.025, 0.012, 0.035], PLATEAU + [0.025, 0.0, 0.035])
    rod = make_round_body(np.array([-0.01, -0.4, -0.01]), np.array([0.01, -0.03, 0.01]))
    return joined(lens, rod, ball(MALLEOLI[0] + [0, 0, SPECK], SPECK))


def fibula() -> Mesh:
    rod = make_round_body(np.array([-0.005, -0.4, 0.02]), np.array([0.005, -0.05, 0.03]))
    return joined(rod, ball(MALLEOLI[1] - [0, 0, SPECK], SPECK))


ALL = {"r_femur": femur, "r_pelvis": pelvis, "r_tibia": tibia, "r_fibula": fibula}


def stl(mesh: Mesh) -> bytes:
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows = np.zeros(len(mesh.triangles), dtype=kind)
    rows["corners"] = mesh.vertices[mesh.triangles]
    return bytes(80) + len(rows).to_bytes(4, "little") + rows.tobytes()


def folder_of_bones(folder: Path) -> Path:
    """A folder like OpenSim's `Geometry`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in ALL.items():
        (folder / f"{name}.stl").write_bytes(stl(make()))
    return folder
