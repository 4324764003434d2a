"""Key points of a body in video (OpenCap, Pose2Sim): joint centres and points of the feet, and axes that follow.

Programs that find a body in pictures (OpenPose's BODY_25 and HALPE_26, which OpenCap and Pose2Sim use) write hips,
knees, ankles, heels, toes, shoulders, elbows and wrists under the labels below. No point shows how thigh and shank turn
about their length, and none but the hips is on the pelvis. Axes of segments, x forward, y up, z right, as far as the
points show them:

    pelvis      z from the left hip to the right one; y upwards across z, so that it has no tilt; trunk alike
    thigh       y from knee to hip, shank from ankle to knee; z the pelvis's across y
    foot        x from the heel to the middle of the toes; z across x, along the line of the toes

They make a standing posture as segment poses do (`segment_poses.py`), and the frame of the pelvis. All else is followed
by the key points themselves: how a leg turns about its length is then told by knee, ankle and foot together.
"""

from collections.abc import Collection, Mapping

import numpy as np

from gaitcal.arrays import Array, cross

_JOINTS = {"thigh": "Hip", "shank": "Knee", "foot": "Ankle", "uarm": "Shoulder", "larm": "Elbow", "hand": "Wrist"}
_FOOT = ("Heel", "BigToe", "SmallToe")
_BOTH = tuple((side, side.lower()) for side in "RL")
NEEDED = tuple(f"{side}{name}" for side, _ in _BOTH for name in ("Hip", "Knee", "Ankle", *_FOOT))
"""Labels without which a recording is none of key points."""
AUGMENTED = "_study"
"""How labels of markers end that OpenCap and Pose2Sim make of key points, which they leave in the same file."""
CARRIER: Mapping[str, str] = {
    **{f"{side}{name}": f"{s}_{segment}" for side, s in _BOTH for segment, name in _JOINTS.items()},
    **{f"{side}{name}": f"{s}_foot" for side, s in _BOTH for name in _FOOT},
}
"""Key point -> the segment at whose origin, or on which, it lies."""


def holds_key_points(labels: Collection[str]) -> bool:
    """Whether a recording with these labels is one of key points, without markers that were made of them."""
    return set(NEEDED) <= set(labels) and not any(label.endswith(AUGMENTED) for label in labels)


def segments_of(at: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
    """Axes (nf, 3, 3) and origins (nf, 3) m of segments, called as those of poses; `at`: key point -> (nf, 3) m."""
    joints = {f"{s}_{segment}": f"{side}{name}" for side, s in _BOTH for segment, name in _JOINTS.items()}
    origin = {segment: at[label] for segment, label in joints.items() if label in at}
    origin["pelvis"] = 0.5 * (at["RHip"] + at["LHip"])
    right = _unit(at["RHip"] - at["LHip"])
    rotation = {"pelvis": _axes(np.broadcast_to([0.0, 1.0, 0.0], right.shape), right, keeps=right)}
    if {"r_uarm", "l_uarm"} <= set(origin):
        origin["torso"], rotation["torso"] = 0.5 * (origin["r_uarm"] + origin["l_uarm"]), rotation["pelvis"]
    for side, s in _BOTH:
        hip, knee, ankle, heel, big, small = (at[label] for label in NEEDED if label.startswith(side))
        rotation[f"{s}_thigh"] = _axes(hip - knee, right)
        rotation[f"{s}_shank"] = _axes(knee - ankle, right)
        origin[f"{s}_toes"] = 0.5 * (big + small)
        x = _unit(origin[f"{s}_toes"] - heel)
        y = _unit(cross(small - big if side == "R" else big - small, x))
        rotation[f"{s}_foot"] = np.stack([x, y, cross(x, y)], axis=2)
    return rotation, origin


def _axes(up: Array, right: Array, keeps: Array | None = None) -> Array:
    """(nf, 3, 3) columns x, y, z with y along `up` and z near `right`; or with z as it `keeps` it, and y near `up`."""
    y = _unit(up) if keeps is None else _unit(up - np.sum(up * right, axis=1, keepdims=True) * right)
    x = _unit(cross(y, right))
    return np.stack([x, y, cross(x, y)], axis=2)


def _unit(a: Array) -> Array:
    length = np.linalg.norm(a, axis=1, keepdims=True)
    return np.asarray(a / np.where(length > 0.0, length, np.nan))
