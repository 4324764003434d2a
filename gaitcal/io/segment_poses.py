"""Derive markers of a body from recordings without markers: segment poses or key points.

Segment poses: markerless programs (Theia) write a C3D group ROTATION, a 4x4 matrix per segment and
frame: for segment s and frame f its axes R (columns, laboratory) and its origin o. A pose with the
error dp (m, each axis) and a small rotation dt (rad, about each axis) moves the four corners

    p_k = o + R d_k,      d_k = L/sqrt(3) (1 1 1), (1 -1 -1), (-1 1 -1), (-1 -1 1),
    L = sqrt(3/2) sigma_p/sigma_t

of a regular tetrahedron about its origin, for which  sum d_k = 0  and  sum d_k d_k^T = (4 L^2 / 3)
1, so that

    sum_k |dp_k|^2 = 4 |dp|^2 + (8 L^2 / 3) |dt|^2 = 4 (|dp|^2 + (sigma_p / sigma_t)^2 |dt|^2):

the sum of squares of four points is the residual of position and rotation, each weighted by its
standard deviation. Four points with coordinate errors of 2 sigma_p are therefore equivalent to the
pose. A pose is tracked exactly as four markers, and no later module uses matrices.
sigma_p / sigma_t is `LENGTH_PER_TURN` for all segments.

Axes: programs differ in which axis points up. Hips, knees, ankles and toes of the file determine
it: up is from knee to hip in the thighs, right from the left hip to the right one in the pelvis,
each the nearest axis. The points have x forward, y up, z right. The origin of thigh, shank, foot,
upper arm, forearm and hand is its joint; that of the toes their joint with the foot. All other
landmarks follow (`_place_landmarks`). Points beside the joints show the axes of the segments; ASIS
and sacrum are where Harrington 2007 has them for these hips.

The standing posture is built (`make_upright_posture`): the segments of the file with their axes
aligned, each at its mean position on its parent. All trials of a person give the same posture, and
standing is not needed.

Key points: programs that find a body in video (OpenPose's BODY_25 and HALPE_26, used by OpenCap and
Pose2Sim) write hips, knees, ankles, heels, toes, shoulders, elbows and wrists under the labels
below. No point shows the axial rotation of thigh and shank, and only the hips are on the pelvis.
Axes of segments, x forward, y up, z right, as far as the points show them:

    pelvis      z from the left hip to the right one; y upwards across z, so that it has no tilt;
                trunk alike
    thigh       y from knee to hip, shank from ankle to knee; z the pelvis's across y
    foot        x from the heel to the middle of the toes; z across x, along the line of the toes

They define a standing posture as segment poses do, and the frame of the pelvis. All other segments
are tracked by the key points themselves: knee, ankle and foot together show the axial rotation of a
leg.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array, cross
from gaitcal.errors import Code
from gaitcal.io.recording import Recording
from gaitcal.io.text_file import FileFault

LENGTH_PER_TURN = 0.005 / np.deg2rad(2.0)  # m per rad, sigma_p / sigma_t: 5 mm for 2 degrees
CORNERS = (
    np.sqrt(0.5) * LENGTH_PER_TURN * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
)
"""(4, 3) m, d_k in the segment's axes; L / sqrt(3) = sqrt(1/2) sigma_p / sigma_t."""
PARENT: Mapping[str, str] = {
    "pelvis": "",
    "torso": "pelvis",
    **{
        f"{side}_{segment}": f"{side}_{parent}" if parent not in ("pelvis", "torso") else parent
        for side in "rl"
        for segment, parent in (
            ("thigh", "pelvis"),
            ("shank", "thigh"),
            ("foot", "shank"),
            ("toes", "foot"),
            ("uarm", "torso"),
            ("larm", "uarm"),
            ("hand", "larm"),
        )
    },
}
"""Segment by Theia's name (`r_thigh_4X4`) -> its parent; parents come first."""
NEEDED_SEGMENTS = tuple(
    name for name in PARENT if name == "pelvis" or name[2:] in ("thigh", "shank", "foot", "toes")
)
_BY_CODE = (
    "th thigh thigh, sk shank shank, ft foot foot, to toes toes, ar arm uarm, fa forearm larm, ha "
    "hand hand"
)
VISUAL3D: dict[str, str] = {
    "rpv": "pelvis",
    "rta": "torso",
    "rtk": "torso",
    "thorax/ab": "torso",
    "trunk": "torso",
}
"""Segment by Visual3D's name, or that of its table (RTH, Right Thigh) -> Theia's name.

Qualisys passes Theia's files through Visual3D, so that they have its names.
"""
VISUAL3D |= {"rhe": "head", "lab": "worldbody", "vlb": "worldbody"}
for _code, _word, _segment in map(str.split, _BY_CODE.split(",")):
    for _side, _sided in (("r", "right"), ("l", "left")):
        VISUAL3D |= dict.fromkeys((f"{_side}{_code}", f"{_sided} {_word}"), f"{_side}_{_segment}")
# Segments that the model does not have
IGNORED_SEGMENTS = ("worldbody", "head", "neck", "r_clavicle", "l_clavicle")
END_SEGMENTS = ("toes", "uarm", "larm", "hand")
"""Segments of which only the origin, their joint, is used.

Toes bend against the foot. The axial rotation of an arm is the least certain output of markerless
programs, and the model has no coordinate for it.
"""
# Share of its length by which a direction must lie along an axis of its segment: within 37 degrees
ALIGNED_SHARE = 0.8
THIGH_RANGE_M = 0.1, 0.8  # From hip to knee, of anybody
JOINT_AXIS_OFFSET_M = {"knee": 0.05, "ankle": 0.04, "elbow": 0.04}
"""m from a joint to the points that show its axis; any length shows the same."""
HEEL_RATIO = 0.35  # From ankle to heel over that from ankle to toes, along the foot
# From the middle of the ASIS to the sacrum over the distance of the ASIS, of the nominal subject
PELVIS_DEPTH_RATIO = 0.69
# From shoulder up to acromion over the distance of the two: Rab 2002, as the trunk is made of
# acromia
ACROMION_RATIO = 0.17
_NOT_OF_KEY_POINTS = (*(f"{side}_" for side in "rl"), "torso", "heel", "toe")
"""Corners of other segments than the pelvis, and landmarks that key points are themselves."""
_SHARED = ("r_thigh", "l_thigh", "r_shank", "l_shank", "r_foot", "l_foot")
"""Of key points: joints that are points of both their segments."""
POSTURE_FRAMES, POSTURE_RATE_HZ = 60, 100.0
FLOOR_CLEARANCE_M = 0.03  # m, height of the lowest point of the upright body
_JOINTS = {
    "thigh": "Hip",
    "shank": "Knee",
    "foot": "Ankle",
    "uarm": "Shoulder",
    "larm": "Elbow",
    "hand": "Wrist",
}
_FOOT = ("Heel", "BigToe", "SmallToe")
_BOTH = tuple((side, side.lower()) for side in "RL")
KEY_POINTS = tuple(
    f"{side}{name}" for side, _ in _BOTH for name in ("Hip", "Knee", "Ankle", *_FOOT)
)
"""Labels that a recording of key points must have."""
AUGMENTED_SUFFIX = "_study"
"""Ending of labels of markers that OpenCap and Pose2Sim derive from key points in the same file."""
SEGMENT_OF_KEY_POINT: Mapping[str, str] = {
    **{f"{side}{name}": f"{s}_{segment}" for side, s in _BOTH for segment, name in _JOINTS.items()},
    **{f"{side}{name}": f"{s}_foot" for side, s in _BOTH for name in _FOOT},
}
"""Key point -> the segment at whose origin, or on which, it is located."""


def has_poses(labels: Collection[str]) -> bool:
    """Return whether labels include the points of segment poses, or of a key point pelvis."""
    return "pelvis_pose1" in labels


def compute_pose_points(
    labels: Sequence[str], poses: Array
) -> tuple[tuple[str, ...], Array, tuple[str, ...]]:
    """Compute the points that represent segment poses.

    Parameters
    ----------
    poses
        (nf, ns, 4, 4) Poses, m; NaN where unknown.

    Returns
    -------
    labels, points, notes
        Names of np points, (nf, np, 3) m, and notes.

    Raises
    ------
    FileFault
        Segments of the legs are missing or repeated, or lengths or axes are not those of a body.
    """
    stems = [label.strip().lower().removesuffix("_4x4") for label in labels]
    theirs = [VISUAL3D.get(stem, stem) for stem in stems]
    if not set(NEEDED_SEGMENTS) <= set(stems) and set(NEEDED_SEGMENTS) <= set(theirs):
        stems = theirs
    column = {stem: i for i, stem in enumerate(stems) if stem in PARENT}
    if missing := [name for name in NEEDED_SEGMENTS if name not in column]:
        shown = ", ".join(labels[:12]) + (", ..." if len(labels) > 12 else "")
        raise FileFault(
            f"no marker, but poses of {shown}; missing: "
            f"{', '.join(f'{name}_4X4' for name in missing)}; segment poses "
            "must be called as Theia or Visual3D call them (r_thigh_4X4, RTH)",
            "ROTATION:LABELS",
            Code.TOO_LITTLE_SEEN,
        )
    if twice := [labels[stems.index(stem)] for stem in column if stems.count(stem) > 1]:
        raise FileFault(
            f"found two poses of {', '.join(twice)}", "ROTATION:LABELS", Code.DAMAGED_RECORDING
        )
    if lost := [
        labels[column[name]]
        for name in NEEDED_SEGMENTS
        if not np.isfinite(poses[:, column[name]]).all((1, 2)).any()
    ]:
        raise FileFault(
            f"no frame has a pose of right-handed axes of {', '.join(lost)}",
            "ROTATION",
            Code.TOO_LITTLE_SEEN,
        )
    rotation = {name: poses[:, i, :3, :3] for name, i in column.items()}
    origin = {name: poses[:, i, :3, 3] for name, i in column.items()}
    thigh = float(
        _average_known(
            np.linalg.norm(origin["r_shank"] - origin["r_thigh"], axis=1, keepdims=True)
        )[0]
    )
    if not THIGH_RANGE_M[0] < thigh < THIGH_RANGE_M[1]:
        allowed = f"{THIGH_RANGE_M[0]:g} to {THIGH_RANGE_M[1]:g} m; look at the units, POINT:UNITS"
        raise FileFault(
            f"from hip to knee it is {thigh:.2g} m; allowed: {allowed}",
            "pose of r_thigh",
            Code.UNIT_OF_LENGTH,
        )
    axes = _find_axes(rotation, origin)
    rotation = {name: r @ axes for name, r in rotation.items()}
    points = _compute_points(rotation, origin)
    others = [
        label
        for label, stem in zip(labels, stems, strict=True)
        if stem not in PARENT and stem not in IGNORED_SEGMENTS
    ]
    notes = (
        f"poses of {len(column)} segments, no markers: four points stand for each, which err by "
        "its position and turn",
        *([f"segments not used: {', '.join(others)}"] if others else []),
    )
    return tuple(points), np.stack(list(points.values()), axis=1), notes


def refuse_origins(labels: Collection[str]) -> None:
    """Refuse points named as the segments of a body, as they do not show rotations.

    Raises
    ------
    FileFault
        All labels are names of segments.
    """
    segments = [VISUAL3D.get(label.lower(), "") for label in labels]
    if set(NEEDED_SEGMENTS) <= set(segments) and all(segments):
        found = (
            "its points are the origins of Visual3D's segments, which do not show how these turn"
        )
        remedy = "export the poses (group ROTATION), or take Theia's file pose_*.c3d"
        raise FileFault(f"{found}; {remedy}", "POINT:LABELS", Code.TOO_LITTLE_SEEN)


def _find_axes(rotation: Mapping[str, Array], origin: Mapping[str, Array]) -> Array:
    """Find (3, 3) columns: forward, up and right in the axes of the segments."""

    def find_axis(description: str, segment: str, start: str, end: str) -> Array:
        direction = _average_known(_express_in(rotation[segment], origin[end] - origin[start]))
        largest = int(np.argmax(np.abs(direction)))
        if not np.abs(direction[largest]) >= ALIGNED_SHARE * np.linalg.norm(direction):
            found = ", ".join(f"{1e3 * x:.0f}" for x in direction)
            raise FileFault(
                f"found ({found}) mm {description}; allowed: along an axis of the segment",
                f"pose of {segment}",
                Code.LANDMARKS,
            )
        return np.asarray(np.sign(direction[largest]) * np.eye(3)[largest])

    right = find_axis("from hip to hip", "pelvis", "l_thigh", "r_thigh")
    ups = {
        s: find_axis("from knee to hip", s, s.replace("thigh", "shank"), s)
        for s in ("r_thigh", "l_thigh")
    }
    ups |= {
        s: find_axis("from ankle to knee", s, s.replace("shank", "foot"), s)
        for s in ("r_shank", "l_shank")
    }
    up = ups["r_thigh"]
    forward = np.cross(up, right)
    toes = {
        s: find_axis("from ankle to toes", s, s, s.replace("foot", "toes"))
        for s in ("r_foot", "l_foot")
    }
    wrong = [s for s, way in ups.items() if way @ up < 1.0] + [
        s for s, way in toes.items() if way @ forward < 1.0
    ]
    if wrong or not forward.any():
        raise FileFault(
            "its axes point otherwise than those of r_thigh and pelvis; allowed: the same axis "
            "up, forward and right "
            f"in all segments (found wrong: {', '.join(wrong) or 'pelvis'})",
            "poses",
            Code.LANDMARKS,
        )
    return np.column_stack([forward, up, right])


def _express_in(rotation: Array, vectors: Array) -> Array:
    """Express (nf, 3) vectors of the laboratory in axes (nf, 3, 3)."""
    return np.asarray(np.einsum("fji,fj->fi", rotation, vectors))


def _average_known(vectors: Array) -> Array:
    """Average (nf, 3) vectors over the frames in which they are known."""
    known = vectors[np.isfinite(vectors).all(axis=1)]
    return np.asarray(known.mean(axis=0) if len(known) else np.full(3, np.nan))


def _compute_offsets(
    rotation: Mapping[str, Array], origin: Mapping[str, Array]
) -> dict[str, Array]:
    """Compute segment -> (3,) m mean position of its origin in its parent; below an arm joint."""
    out: dict[str, Array] = {}
    for name, parent in PARENT.items():
        if name in origin and parent in origin:
            away = origin[name] - origin[parent]
            length = float(_average_known(np.linalg.norm(away, axis=1, keepdims=True))[0])
            out[name] = np.array([0.0, -length, 0.0])
            if not parent.endswith(END_SEGMENTS):
                out[name] = _average_known(_express_in(rotation[parent], away))
    return out


def _compute_points(rotation: Mapping[str, Array], origin: Mapping[str, Array]) -> dict[str, Array]:
    """Compute label -> (nf, 3) m: corners, ends and landmarks of segments with x forward, y up."""
    out: dict[str, Array] = {}
    for name in origin:
        if name.endswith(END_SEGMENTS):
            out[f"{name}_origin"] = origin[name]
        else:
            for k, corner in enumerate(CORNERS, 1):
                out[f"{name}_pose{k}"] = origin[name] + rotation[name] @ corner
    for landmark, (segment, local) in _place_landmarks(_compute_offsets(rotation, origin)).items():
        axes = "torso" if segment.endswith(END_SEGMENTS) else segment
        if segment in origin and axes in rotation:
            out[landmark] = origin[segment] + rotation[axes] @ local
    return out


def _place_landmarks(offset: Mapping[str, Array]) -> dict[str, tuple[str, Array]]:
    """Place landmarks: landmark -> segment and (3,) m from its origin, forward, up and right.

    Landmarks of an arm are in the axes of the torso.
    """
    hips = offset["r_thigh"], offset["l_thigh"]
    width = max((0.5 * float(np.linalg.norm(hips[0] - hips[1])) - 0.0073) / 0.33, 0.0)
    depth = PELVIS_DEPTH_RATIO * width
    # Harrington's hips lie 0.24 depth + 9.9 mm behind the ASIS and 0.30 width + 10.9 mm below them
    middle = 0.5 * (hips[0] + hips[1]) + [0.24 * depth + 0.0099, 0.30 * width + 0.0109, 0.0]
    out = {"sacrum": ("pelvis", middle - [depth, 0.0, 0.0])}
    for side, s in (("r", 1.0), ("l", -1.0)):
        out[f"asis_{side}"] = "pelvis", middle + [0.0, 0.0, 0.5 * s * width]
        out[f"hjc_{side}"] = f"{side}_thigh", np.zeros(3)
        for joint, segment in (("knee", "shank"), ("ankle", "foot"), ("elbow", "larm")):
            for word, away in (("lat", s), ("med", -s)):
                out[f"{joint}_{word}_{side}"] = (
                    f"{side}_{segment}",
                    np.array([0.0, 0.0, away * JOINT_AXIS_OFFSET_M[joint]]),
                )
        toes = offset[f"{side}_toes"]
        out[f"toe_{side}"] = f"{side}_foot", toes
        out[f"heel_{side}"] = f"{side}_foot", toes * [-HEEL_RATIO, 1.0, 1.0]
        if {"r_uarm", "l_uarm"} <= set(offset):
            up = ACROMION_RATIO * float(np.linalg.norm(offset["r_uarm"] - offset["l_uarm"]))
            out[f"acromion_{side}"] = "torso", offset[f"{side}_uarm"] + [0.0, up, 0.0]
    return out


def add_landmarks(recording: Recording) -> Recording:
    """Add the pelvis's corners and landmarks to a recording of key points.

    Parameters
    ----------
    recording
        Any recording.

    Returns
    -------
    Recording
        With the added points and a note; the same one if it has no key points.
    """
    if has_poses(recording.labels) or not has_key_points(recording.labels):
        return recording
    rotation, origin = _build_segments(_collect_paths(recording))
    made = {
        k: path
        for k, path in _compute_points(rotation, origin).items()
        if not k.startswith(_NOT_OF_KEY_POINTS)
    }
    made |= {f"{name}_origin": origin[name] for name in _SHARED}
    return replace(
        recording,
        labels=(*recording.labels, *made),
        markers=np.concatenate([recording.markers, np.stack(list(made.values()), axis=1)], axis=1),
    ).with_notes(
        "key points of video, no markers: the pelvis has no tilt, as nothing shows it between two "
        "hips"
    )


def _collect_paths(recording: Recording) -> dict[str, Array]:
    """Collect label -> (nf, 3) m."""
    return {label: recording.markers[:, i] for i, label in enumerate(recording.labels)}


def _recover_poses(at: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
    """Recover axes (nf, 3, 3) and origins (nf, 3) m of the segments from their corners."""
    rotation, origin = dict[str, Array](), dict[str, Array]()
    for name in PARENT:
        corners = [at[label] for k in range(1, 5) if (label := f"{name}_pose{k}") in at]
        if len(corners) == len(CORNERS):
            origin[name] = np.mean(corners, axis=0)
            size = float((CORNERS**2).sum()) / 3.0
            rotation[name] = (
                np.einsum("kfi,kj->fij", np.array(corners) - origin[name], CORNERS) / size
            )
        elif f"{name}_origin" in at:
            origin[name] = at[f"{name}_origin"]
    return rotation, origin


def make_upright_posture(recording: Recording) -> Recording:
    """Build the standing posture of a recording of poses or key points.

    Parameters
    ----------
    recording
        Any recording.

    Returns
    -------
    Recording
        A still recording of the posture, with a note; the same one if it has markers.
    """
    if not has_poses(recording.labels):
        return recording
    at = _collect_paths(recording)
    rotation, origin = _build_segments(at) if has_key_points(at) else _recover_poses(at)
    offset = _compute_offsets(rotation, origin)
    place = {"pelvis": np.zeros(3)}
    for name, parent in PARENT.items():
        if parent in place and name in offset:
            place[name] = place[parent] + offset[name]
    aligned = dict.fromkeys((name for name in place if name in rotation), np.eye(3)[None])
    points = _compute_points(aligned, {name: here[None] for name, here in place.items()})
    points |= {f"{name}_origin": place[name][None] for name in _SHARED if name in place}
    for label, segment in SEGMENT_OF_KEY_POINT.items():
        if label in at and segment in place:
            away = at[label] - origin[segment]
            local = (
                _average_known(_express_in(rotation[segment], away))
                if segment in rotation
                else np.zeros(3)
            )
            points[label] = (place[segment] + local)[None]
    labels = tuple(label for label in recording.labels if label in points)
    posture = np.stack([points[label] for label in labels], axis=1)
    posture[..., 1] += FLOOR_CLEARANCE_M - np.nanmin(posture[..., 1])
    return replace(
        recording,
        time=np.arange(POSTURE_FRAMES) / POSTURE_RATE_HZ,
        labels=labels,
        markers=np.repeat(posture, POSTURE_FRAMES, axis=0),
        plates=(),
        events=(),
        computed=None,
    ).with_notes(
        "posture made of a movement: the axes of all segments in line, each on the one before it "
        "as on average over "
        f"{len(recording.time)} frames; angles count from the axes that poses or key points show"
    )


# --------------------------------------------------------------------------------------- key points


def has_key_points(labels: Collection[str]) -> bool:
    """Return whether labels are those of key points, without markers derived from them."""
    return set(KEY_POINTS) <= set(labels) and not any(
        label.endswith(AUGMENTED_SUFFIX) for label in labels
    )


def _build_segments(at: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
    """Build the segments of key points.

    `at`: key point -> (nf, 3) m. Returns: segment, named as those of poses -> axes (nf, 3, 3), and
    origin (nf, 3) m.
    """
    joints = {
        f"{s}_{segment}": f"{side}{name}" for side, s in _BOTH for segment, name in _JOINTS.items()
    }
    origin = {segment: at[label] for segment, label in joints.items() if label in at}
    origin["pelvis"] = 0.5 * (at["RHip"] + at["LHip"])
    right = _normalise(at["RHip"] - at["LHip"])
    rotation = {
        "pelvis": _build_axes(np.broadcast_to([0.0, 1.0, 0.0], right.shape), right, keeps=right)
    }
    if {"r_uarm", "l_uarm"} <= set(origin):
        origin["torso"], rotation["torso"] = (
            0.5 * (origin["r_uarm"] + origin["l_uarm"]),
            rotation["pelvis"],
        )
    for side, s in _BOTH:
        hip, knee, ankle, heel, big, small = (
            at[label] for label in KEY_POINTS if label.startswith(side)
        )
        rotation[f"{s}_thigh"] = _build_axes(hip - knee, right)
        rotation[f"{s}_shank"] = _build_axes(knee - ankle, right)
        origin[f"{s}_toes"] = 0.5 * (big + small)
        x = _normalise(origin[f"{s}_toes"] - heel)
        y = _normalise(cross(small - big if side == "R" else big - small, x))
        rotation[f"{s}_foot"] = np.stack([x, y, cross(x, y)], axis=2)
    return rotation, origin


def _build_axes(up: Array, right: Array, keeps: Array | None = None) -> Array:
    """Build (nf, 3, 3) columns x, y, z with y along `up` and z near `right`, or the reverse.

    With `keeps`, z is exactly `right` and y near `up`.
    """
    y = (
        _normalise(up)
        if keeps is None
        else _normalise(up - np.sum(up * right, axis=1, keepdims=True) * right)
    )
    x = _normalise(cross(y, right))
    return np.stack([x, y, cross(x, y)], axis=2)


def _normalise(a: Array) -> Array:
    length = np.linalg.norm(a, axis=1, keepdims=True)
    return np.asarray(a / np.where(length > 0.0, length, np.nan))
