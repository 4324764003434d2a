"""Recorded poses of a person's Pinocchio model in MeshCat: in a browser, in a notebook, or as a
file.

Everything is drawn in laboratory axes (x forward, y up, z to the right), turned once by `UPRIGHT`,
as MeshCat's z axis points up. A browser plays the motion by itself: it gets the pose of every
moving node at every frame once.
"""

import asyncio
import socket
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

import coal
import numpy as np
import pinocchio as pin
from meshcat import geometry
from meshcat.commands import SetAnimation
from meshcat.servers import zmqserver
from meshcat.visualizer import ViewerWindow, Visualizer
from numpy.typing import NDArray
from pinocchio.visualize import MeshcatVisualizer
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array, IntArray
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.errors import Code, InputError
from gaitcal.io.atomic import write_atomically
from gaitcal.io.recording import Recording
from gaitcal.model.chain import build_model
from gaitcal.model.linkage import COORDINATES, SEGMENTS
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.page import scene
from gaitcal.report.page.body_meshes import fit_body_meshes, read_body_meshes
from gaitcal.runtime import with_one_blas_thread
from gaitcal.tracking.motion import Motion

BODY, MEASURED, FORCE, PLATE, JOINT = 0xD3C4B0, 0x0072B2, 0x009E73, 0x56738C, 0x8A3FFC
"""Colours of the page (`page/scripts/body.js`)."""
FLOOR, BACKGROUND = 0xE6EBEF, (0.933, 0.949, 0.961)
METRES_PER_NEWTON: Final = 0.001
"""Length of an arrow, as on the page."""
MARKER_RADIUS: Final = 0.0105
"""m, as on the page."""
ARROW: Final = {"shaft": (0.88, 0.014, 0.014), "head": (0.12, 0.0, 0.042)}
"""Part of an arrow of unit length -> its length, radius at the tip, radius at the base."""
AXIS_OF_HEIGHT: Final = 0.056
"""Half the drawn length of a joint axis, of body height, as on the page."""
HIDDEN: Final = 1e-6
"""Scale of a hidden node: at zero MeshCat would divide by it."""
ENDLESS: Final = 1_000_000
"""Repetitions of a motion that plays until it is stopped."""
FIELD_OF_VIEW_DEG, ASPECT = 32.0, 1.5
"""Vertical angle of the camera, and width over height of the pane that it is placed for."""
DIRECTION: Final = (0.75, 0.3, 0.85)
"""From the person to the camera, as on the page: from before, above and the right."""
MARGIN_M: Final = (0.3, 0.3, 0.3)
"""How far a body reaches beyond the origins of its segments."""
UPRIGHT: Final = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""From laboratory axes to MeshCat's."""
FLOOR_M, GRID_M = 20.0, 0.5
"""Side of the floor, and of MeshCat's grid; distance of the grid's lines."""
LOOPBACK: Final = "127.0.0.1"


@with_one_blas_thread
def view(
    model: SubjectModel,
    motion: Motion,
    recording: Recording | None = None,
    ground: GroundReactions | None = None,
) -> "MotionViewer":
    """Show and play a tracked motion of the Pinocchio model in MeshCat.

    In a notebook the viewer is shown where it is the last expression of a cell; elsewhere
    `viewer.open()` opens `viewer.url` in a browser. Its server answers this computer only, and ends
    with `viewer.close()` or the program.

    Parameters
    ----------
    model
        The person's model, with the parameters that the motion was tracked with.
    motion
        From `gaitcal.track`, all coordinates.
    recording
        The one that was tracked, whose markers and force plates are shown; None: neither.
    ground
        From `gaitcal.ground_reactions`, at the frames of the motion, 1 mm of arrow per N; None: no
        arrows.

    Returns
    -------
    Pinocchio's `MeshcatVisualizer` of the person, which plays: `viewer.pause()`,
    `viewer.show(frame)`, `viewer.play(speed)`, `viewer.save(path)`, `viewer.close()`;
    `viewer.viewer` is MeshCat's visualizer.

    Raises
    ------
    InputError
        The motion is of a part of the body only, or recording or forces have other frames than the
        motion.
    """
    if motion.coordinates != COORDINATES:
        message = (
            f"the viewer needs a motion of the whole body, with all {len(COORDINATES)} coordinates"
        )
        raise InputError(message, field="motion", code=Code.ARGUMENT)
    frames = len(motion.time)
    for field, found in (
        ("recording", frames if recording is None else len(recording.markers)),
        ("ground", frames if ground is None else len(ground.wrench)),
    ):
        if found != frames:
            message = f"found {found} frames; the motion has {frames}"
            raise InputError(message, field=field, code=Code.ARGUMENT)
    return MotionViewer(model, motion, recording, ground)


class MotionViewer(MeshcatVisualizer):  # type: ignore[misc]
    """A person's motion in MeshCat; made by `gaitcal.view`."""

    def __init__(
        self,
        model: SubjectModel,
        motion: Motion,
        recording: Recording | None,
        ground: GroundReactions | None,
    ) -> None:
        linkage = build_model(model.parameters)
        segments = [
            s
            for s, shown in zip(SEGMENTS, scene.find_tracked_segments(motion), strict=True)
            if shown
        ]
        super().__init__(linkage, visual_model=body_geometry(model, linkage, segments))
        self.time = motion.time
        self.frame = 0
        self._playing: tuple[float, float] | None = None
        self._server = _Server()
        self.initViewer(Visualizer(window=_Window(self._server.zmq_url, self._server.web_url)))
        with ExitStack() as otherwise:
            otherwise.callback(self.close)
            self._draw(model, motion, recording, ground)
            otherwise.pop_all()

    def _draw(
        self,
        model: SubjectModel,
        motion: Motion,
        recording: Recording | None,
        ground: GroundReactions | None,
    ) -> None:
        """Make all nodes, and play."""
        self.loadViewerModel("gaitcal")
        self._root = self.viewer["gaitcal"]
        self._poses = self._body_poses(motion.q)
        self._set_stage()
        self._add_joints(model)
        plates = (
            np.zeros((0, 4, 3)) if recording is None else scene.collect_plate_corners(recording)
        )
        self._add_plates(plates)
        if recording is not None:
            self._poses |= self._add_markers(model, recording)
        if ground is not None:
            self._poses |= self._add_arrows(ground, plates)
        self.play()

    def show(self, frame: int) -> None:
        """Stop at a frame of the motion (from 0).

        Raises InputError: The motion has no such frame.
        """
        if not 0 <= frame < len(self.time):
            message = f"found {frame}; allowed: 0 to {len(self.time) - 1}"
            raise InputError(message, field="frame", code=Code.ARGUMENT)
        if self._playing is not None:
            self._animate(1.0, play=False)
            self._playing = None
        self.frame = frame
        for path, pose in self._poses.items():
            self.viewer[path].set_transform(pose.matrix(frame))

    def play(self, speed: float = 1.0) -> None:
        """Play the motion from its beginning again and again, in every browser that shows it.

        Raises InputError: the speed is not above zero.
        """
        if not speed > 0.0:
            raise InputError(f"found {speed}; allowed: above 0", field="speed", code=Code.ARGUMENT)
        self._animate(speed, play=True)
        self._playing = (time.monotonic(), speed)

    def pause(self) -> None:
        """Stop at the frame that a browser shows which was open when `play` was called."""
        if self._playing is not None:
            began, speed = self._playing
            seconds = speed * (time.monotonic() - began) % max(np.ptp(self.time), 1e-9)
            self.show(int(np.searchsorted(self.time - self.time[0], seconds, side="right")) - 1)

    @property
    def url(self) -> str:
        """Address of the viewer, on this computer alone."""
        return self._server.web_url

    def open(self) -> "MotionViewer":
        """Open the viewer in the default browser."""
        self.viewer.open()
        return self

    def save(self, path: Path | str) -> None:
        """Write what is shown as one HTML file that opens offline, and plays if the viewer does.

        Raises InputError: `path` cannot be written.
        """
        with write_atomically(path) as target:
            target.write_text(self.viewer.static_html(), encoding="utf-8")

    def close(self) -> None:
        """End the server. What a browser has stays there; nothing can be changed any more."""
        self.viewer.window.zmq_socket.close(0)
        self._server.close()

    def __enter__(self) -> "MotionViewer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<motion of {len(self.time)} frames at {self.url}>"

    def _repr_html_(self) -> str:
        html: str = self.viewer.jupyter_cell(height=520).data
        return html

    def _body_poses(self, q: Array) -> dict[str, "_Poses"]:
        """Poses of body meshes at each frame, by Pinocchio's forward kinematics; q: (nf, nq)."""
        placements = np.empty((len(q), self.visual_model.ngeoms, 4, 4))
        for k, posture in enumerate(q):
            pin.updateGeometryPlacements(
                self.model, self.data, self.visual_model, self.visual_data, posture
            )
            placements[k] = [placement.homogeneous for placement in self.visual_data.oMg]
        names = (
            self.getViewerNodeName(g, pin.GeometryType.VISUAL)
            for g in self.visual_model.geometryObjects
        )
        return {
            name: _Poses(placements[:, i, :3, 3], np.ones(len(q)), placements[:, i, :3, :3])
            for i, name in enumerate(names)
        }

    def _add_joints(self, model: SubjectModel) -> None:
        """Centres and axes of the joints, each in the first of its segments that is shown, drawn
        over the body.
        """
        half = AXIS_OF_HEIGHT * model.subject.height
        material = _over_the_body(JOINT)
        done = set[str]()
        for mark in scene.build_joint_marks(model.nominal, model.parameters, {}):
            if not self.visual_model.existGeometryName(mark.segment):
                continue
            node = self.viewer[f"{self.viewerVisualGroupName}/{mark.segment}/{mark.joint}"]
            balls = [mark.fitted_centre] if mark.joint not in done else []
            # The shoulder has an axis in either segment that is no axis of the other one.
            if np.isfinite(mark.fitted_axis).all() and (balls or mark.joint.startswith("shoulder")):
                ends = mark.fitted_centre + np.outer([-half, half], mark.fitted_axis)
                balls += [*ends]
                rod = node["axis"]
                rod.set_object(geometry.Cylinder(2 * half, 0.0034), material)
                rod.set_transform(
                    _matrix(mark.fitted_centre, _from_y_to(mark.fitted_axis[None])[0])
                )
            for i, centre in enumerate(balls):
                node[f"{i}"].set_object(geometry.Sphere(0.0085 if i == 0 else 0.0075), material)
                node[f"{i}"].set_transform(_matrix(centre, np.eye(3)))
            done.add(mark.joint)

    def _add_plates(self, plates: NDArray[np.floating[Any]]) -> None:
        """Force plates; plates: (np, 4, 3) m."""
        for i, corners in enumerate(plates):
            raised = np.asarray(corners, dtype=float) + [0.0, 0.002, 0.0]
            area = geometry.TriangularMeshGeometry(raised, np.array([[0, 1, 2], [0, 2, 3]]))
            self._root[f"plates/{i + 1}/area"].set_object(
                area, geometry.MeshBasicMaterial(color=PLATE, opacity=0.28, depthWrite=False)
            )
            outline = geometry.PointsGeometry(raised.astype(np.float32).T)
            self._root[f"plates/{i + 1}/outline"].set_object(
                geometry.LineLoop(outline, geometry.LineBasicMaterial(color=PLATE))
            )

    def _add_markers(self, model: SubjectModel, recording: Recording) -> dict[str, "_Poses"]:
        """The measured markers of the model, where they are visible."""
        places = scene.collect_measured_markers(model, recording, slice(None)).astype(float)
        out = {}
        for i, label in enumerate(model.markers.labels):
            path = f"gaitcal/markers/{i + 1} {label.replace('/', '_')}"
            material = geometry.MeshPhongMaterial(color=MEASURED, shininess=30, specular=0x333333)
            self.viewer[path].set_object(geometry.Sphere(MARKER_RADIUS), material)
            out[path] = _poses(places[:, i], np.ones(len(places)))
        return out

    def _add_arrows(
        self, ground: GroundReactions, plates: NDArray[np.floating[Any]]
    ) -> dict[str, "_Poses"]:
        """Ground reactions, from the centre of pressure."""
        level = float(np.median(plates[:, :, 1])) if len(plates) else 0.0
        forces, centres = (
            x.astype(float) for x in scene.compute_force_arrows(ground.wrench, level)
        )
        out = {}
        for foot, side in enumerate(("right", "left")):
            path = f"gaitcal/forces/{side}"
            begin = 0.0
            for part, (length, top, bottom) in ARROW.items():
                node = self.viewer[f"{path}/{part}"]
                node.set_object(
                    geometry.Cylinder(length, radiusTop=top, radiusBottom=bottom),
                    _over_the_body(FORCE, 0x002A1E),
                )
                node.set_transform(_matrix(np.array([0.0, begin + length / 2, 0.0]), np.eye(3)))
                begin += length
            sizes = np.linalg.norm(forces[:, foot], axis=1)
            turns = _from_y_to(forces[:, foot] / sizes[:, None])
            out[path] = _poses(centres[:, foot], METRES_PER_NEWTON * sizes, turns)
        return out

    def _set_stage(self) -> None:
        """Floor, colours, and a camera that has the whole motion in its picture.

        MeshCat's camera looks at the origin of its world, wherever it is: the middle of the motion
        is put there.
        """
        body = np.concatenate([pose.places for pose in self._poses.values()])
        low, high = body.min(axis=0) - MARGIN_M, body.max(axis=0) + MARGIN_M
        middle = (low + high) / 2
        self._root.set_transform(UPRIGHT @ _matrix(-middle, np.eye(3)))
        camera = self.viewer["/Cameras/default/rotated/<object>"]
        camera.set_property("fov", FIELD_OF_VIEW_DEG)
        camera.set_property("position", list(_distance(high - low) * np.array(DIRECTION)))
        ground = middle * [1.0, 0.0, 1.0]
        floor = self._root["floor"]
        floor.set_object(
            geometry.Box([FLOOR_M, 0.004, FLOOR_M]), geometry.MeshBasicMaterial(color=FLOOR)
        )
        floor.set_transform(_matrix(ground - [0.0, 0.006, 0.0], np.eye(3)))
        lines = np.round(ground / GRID_M) * GRID_M - middle
        self.viewer["/Grid"].set_transform(_matrix(UPRIGHT[:3, :3] @ lines, np.eye(3)))
        self.viewer["/Grid"].set_property("color", [1.0, 1.0, 1.0, 0.25])
        self.viewer["/Axes"].set_property("visible", False)
        self.setBackgroundColor(col_top=BACKGROUND)

    def _animate(self, speed: float, play: bool) -> None:
        """Hand the whole motion to the browsers, at most `MOST_FRAMES` of it as on the page."""
        kept = slice(None, None, max(1, -(-len(self.time) // scene.MOST_FRAMES)))
        seconds = (self.time[kept] - self.time[0]) / speed
        clips = [
            {
                "path": self.viewer[path].path.lower(),
                "clip": {"fps": 1, "name": "motion", "tracks": tracks},
            }
            for path, tracks in (
                (path, pose.tracks(seconds, kept)) for path, pose in self._poses.items()
            )
        ]
        self.viewer.window.send(SetAnimation(_Clips(clips), play=play, repetitions=ENDLESS))


def body_geometry(
    model: SubjectModel, linkage: pin.Model, segments: Sequence[str]
) -> pin.GeometryModel:
    """Make the body meshes of a person's segments, one geometry a segment, called like it.

    `model`: the person, whose size and joint centres the meshes are fitted to. `linkage`: from
    `build_model` with the model's parameters: its body frames carry the meshes. `segments`: those
    that get a mesh, if there is one for them.
    """
    meshes = read_body_meshes().meshes
    out = pin.GeometryModel()
    fitted = fit_body_meshes(model)
    for segment in segments:
        corners, triangles, count = list[Array](), list[IntArray](), 0
        for part in (part for part in fitted if part.segment == segment):
            mesh, turn = meshes[part.mesh], part.place[:, :3]
            corners.append(mesh.vertices @ turn.T + part.place[:, 3])
            # The outside of a mirror image would be its inside.
            triangles.append(
                count + (mesh.triangles if np.linalg.det(turn) > 0 else mesh.triangles[:, ::-1])
            )
            count += len(mesh.vertices)
        if not count:
            continue
        frame = linkage.frames[linkage.getFrameId(segment, pin.FrameType.BODY)]
        surface = coal.BVHModelOBBRSS()
        surface.beginModel(sum(map(len, triangles)), count)
        surface.addVertices(np.concatenate(corners))
        surface.addTriangles(np.concatenate(triangles))
        surface.endModel()
        shape = pin.GeometryObject(segment, frame.parentJoint, frame.placement, surface)
        shape.meshColor = np.array([*(channel / 255 for channel in BODY.to_bytes(3, "big")), 1.0])
        out.addGeometryObject(shape)
    return out


@dataclass(frozen=True)
class _Poses:
    """A node at every frame, in laboratory axes."""

    places: Array  # (nf, 3) m
    sizes: Array  # (nf,) scale; `HIDDEN` where it is hidden
    turns: Array | None = (
        None  # (nf, 3, 3) from the node's axes to the laboratory's; None: as these
    )

    def matrix(self, frame: int) -> Array:
        """(4, 4) at a frame."""
        turn = np.eye(3) if self.turns is None else self.turns[frame]
        return _matrix(self.places[frame], self.sizes[frame] * turn)

    def tracks(self, seconds: Array, kept: slice) -> list[dict[str, Any]]:
        """For a browser: what changes, at the times (s) of the frames `kept`."""
        values = [("position", "vector3", self.places[kept])]
        if np.ptp(self.sizes) > 0.0:
            values.append(("scale", "vector3", np.repeat(self.sizes[kept, None], 3, axis=1)))
        if self.turns is not None:
            values.append(
                ("quaternion", "quaternion", Rotation.from_matrix(self.turns[kept]).as_quat())
            )
        return [
            {
                "name": f".{name}",
                "type": kind,
                "times": _packed(seconds),
                "values": _packed(value.ravel()),
            }
            for name, kind, value in values
        ]


def _poses(places: Array, sizes: Array, turns: Array | None = None) -> _Poses:
    """Of a node that is hidden where its place (nf, 3) is not known (NaN), and waits there at the
    last known one.
    """
    known = np.asarray(np.isfinite(places).all(axis=1))
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    last[last < 0] = np.argmax(known)
    held = places[last] if known.any() else np.zeros_like(places)
    return _Poses(held, np.where(known, sizes, HIDDEN), None if turns is None else turns[last])


class _Clips:
    """Tracks of all nodes, as MeshCat's command to play them takes them."""

    def __init__(self, clips: list[dict[str, Any]]) -> None:
        self._clips = clips

    def lower(self) -> list[dict[str, Any]]:
        """As messages hold it."""
        return self._clips


def _packed(values: Array) -> Any:
    """Numbers as a browser takes them without decoding each."""
    return geometry.pack_numpy_array(values.astype(np.float32))["array"]


def _matrix(place: Array, turn: Array) -> Array:
    """(4, 4) homogeneous transform of a place (3,) and a matrix (3, 3)."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, place
    return out


def _from_y_to(directions: Array) -> Array:
    """(n, 3, 3) shortest rotations that bring the y axis to unit vectors (n, 3); any for a vector
    that is not known.
    """
    x, y, z = np.nan_to_num(directions, nan=1.0).T
    quaternions = np.stack([z, np.zeros_like(x), -x, 1.0 + y], axis=1)
    # To the opposite direction all ways are as short: half a turn about x.
    quaternions[np.linalg.norm(quaternions, axis=1) < 1e-9] = [1.0, 0.0, 0.0, 0.0]
    out: Array = Rotation.from_quat(quaternions).as_matrix()
    return out


def _over_the_body(colour: int, emissive: int = 0) -> geometry.MeshPhongMaterial:
    """A material that the body does not hide."""
    return geometry.MeshPhongMaterial(
        color=colour,
        emissive=emissive,
        shininess=20,
        specular=0x222222,
        transparent=True,
        depthTest=False,
    )


def _distance(size: Array) -> float:
    """Factor of `DIRECTION` at which a box (3,) m around the camera's target is just in the
    picture.
    """
    away = np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    right = np.cross([0.0, 1.0, 0.0], away)
    right /= np.linalg.norm(right)
    half = np.tan(np.deg2rad(FIELD_OF_VIEW_DEG) / 2)
    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * size
    wide = np.abs(corners @ right) / (ASPECT * half)
    tall = np.abs(corners @ np.cross(away, right)) / half
    return float((corners @ away + np.maximum(wide, tall)).max() / np.linalg.norm(DIRECTION))


class _Window(ViewerWindow):  # type: ignore[misc]
    """MeshCat's connection to a server that runs already, whose address is known."""

    def __init__(self, zmq_url: str, web_url: str) -> None:
        self.server_proc, self.zmq_url, self.web_url = None, zmq_url, web_url
        self.connect_zmq()


class _Server:
    """MeshCat's server in a thread of this program, which answers this computer only.

    The program that MeshCat itself would start listens on every network, to which recordings of
    patients do not belong.
    """

    def __init__(self) -> None:
        self.zmq_url = self.web_url = ""
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="gaitcal viewer", daemon=True)
        self._thread.start()
        self._ready.wait()

    def _run(self) -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        bridge = _Bridge(
            zmq_url=f"tcp://{LOOPBACK}:{_free_port()}", host=LOOPBACK, port=_free_port()
        )
        self.zmq_url, self.web_url, self._loop = bridge.zmq_url, bridge.web_url, bridge.ioloop
        self._ready.set()
        bridge.run()
        bridge.close()

    def close(self) -> None:
        """End the thread."""
        self._loop.add_callback(self._loop.stop)
        self._thread.join()


class _Bridge(zmqserver.ZMQWebSocketBridge):  # type: ignore[misc]
    """MeshCat's server, on this computer alone and without lines on the terminal."""

    def make_app(self) -> Any:
        """The web application, which `listen`s on the loopback address."""
        app = zmqserver.tornado.web.Application(
            [
                (r"/static/(.*)", zmqserver.StaticFileHandlerNoCache, _FILES),
                (r"/", _Connection, {"bridge": self}),
            ],
            log_function=lambda handler: None,
        )
        self.server: Any = None

        def listen(port: int) -> None:
            self.server = type(app).listen(app, port, address=LOOPBACK)

        app.listen = listen
        return app

    def close(self) -> None:
        """Free both ports."""
        self.server.stop()
        self.zmq_stream.close()
        self.ioloop.close(all_fds=True)


class _Connection(zmqserver.WebSocketHandler):  # type: ignore[misc]
    """A browser that shows the viewer."""

    def open(self) -> None:
        """Send it all that there is."""
        self.bridge.websocket_pool.add(self)
        self.bridge.send_scene(self)

    def on_close(self) -> None:
        """Send it nothing any more."""
        self.bridge.websocket_pool.discard(self)


_FILES: Final = {"path": zmqserver.VIEWER_ROOT, "default_filename": zmqserver.VIEWER_HTML}


def _free_port() -> int:
    """Find a free port of the loopback address."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
