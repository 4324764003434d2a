"""Ways to spoil the markers of one recording: labels exchanged or missing, markers that sit
elsewhere on their segment than the static trial says, trajectories that are not what the cameras
saw, ways to stand wrong, and what goes wrong with all markers of a file at once (unit, axes,
clock).

Every function of the table (`corpus.toml`) takes the recording, the marker set, which tells which
label is what, and the words of the table. A key is a landmark (`knee_lat_r`), a segment (`thigh_r`:
all its markers), one of a segment's (`thigh_r[0]`), or a label. Displacements are along the body's
axes: (forward, up, right) of the pelvis in the first whole frame, carried on by the segment. A part
of a trial is its beginning and end, as shares of the frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from gaitcal import MarkerSet, Recording
from gaitcal.arrays import Array
from gaitcal.model.segment_frames import fit_rigid_motions

Part: TypeAlias = tuple[float, float]
Vector: TypeAlias = tuple[float, float, float]
"""Forward, up, right."""

WHOLE: Part = (0.0, 1.0)
MM = 1e-3
NEIGHBOUR = {"thigh": "pelvis", "shank": "foot", "foot": "shank", "pelvis": "thigh"}
"""Segment whose markers help to tell the turn of one that has fewer than three."""
PAIRED = "thigh,shank,foot,upper_arm,forearm_hand,asis"
"""What has a left and a right."""
NOISE_SEED = 7
HIP_BELOW_ASIS = np.array([-0.05, -0.09, 0.0])
"""m forward, up, right: roughly the middle of the hips from the middle of both ASIS."""


def labels_of(markers: MarkerSet, key: str) -> tuple[str, ...]:
    """The labels that a key stands for."""
    if key in markers.landmarks:
        return markers.landmarks[key]
    name, _, index = key.rstrip("]").partition("[")
    if name in markers.tracking:
        group = (*markers.tracking[name], *markers.static_only.get(name, ()))
        return (markers.tracking[name][int(index)],) if index else tuple(dict.fromkeys(group))
    return (key,)


def columns(recording: Recording, markers: MarkerSet, *keys: str) -> list[int]:
    """Columns of the markers of some keys that the recording has."""
    out = []
    for key in keys:
        found = [
            recording.labels.index(label)
            for label in labels_of(markers, key)
            if label in recording.labels
        ]
        if not found:
            raise KeyError(f"the recording has no marker for '{key}'")
        out += found
    return out


def frames(recording: Recording, part: Part) -> slice:
    """The frames of a part of the trial."""
    count = len(recording.time)
    return slice(round(part[0] * count), round(part[1] * count))


def put(recording: Recording, at: Sequence[int], part: Part, values: Array) -> Recording:
    """The recording with other positions (nf, nm, 3) of some columns in a part of the trial."""
    markers = recording.markers.copy()
    where = frames(recording, part)
    markers[where, at] = values[where]
    return replace(recording, markers=markers)


def _relabelled(
    recording: Recording, source: Sequence[int], target: Sequence[int], part: Part
) -> Recording:
    """The columns `source` under the labels of `target` in a part of the trial."""
    values = recording.markers.copy()
    values[:, target] = recording.markers[:, source]
    return put(recording, list(target), part, values[:, target])


def exchanged(
    recording: Recording, markers: MarkerSet, a: str, b: str, part: Part = WHOLE
) -> Recording:
    """Two markers, or two segments' or landmarks' markers one by one, under each other's label."""
    i, j = columns(recording, markers, a), columns(recording, markers, b)
    count = min(len(i), len(j))
    return _relabelled(recording, [*j[:count], *i[:count]], [*i[:count], *j[:count]], part)


def sides_exchanged(
    recording: Recording, markers: MarkerSet, names: str = PAIRED, part: Part = WHOLE
) -> Recording:
    """Left labels on the right and right ones on the left."""
    pairs: dict[int, int] = {}
    for name in names.split(","):
        try:
            right, left = (columns(recording, markers, f"{name}_{side}") for side in "rl")
        except KeyError:
            continue
        pairs |= dict(zip(right, left, strict=False)) | dict(zip(left, right, strict=False))
    return _relabelled(recording, list(pairs.values()), list(pairs), part)


def rotated_labels(recording: Recording, markers: MarkerSet, segment: str) -> Recording:
    """Each marker of a segment under the label of the next."""
    at = columns(recording, markers, segment)
    return _relabelled(recording, [*at[1:], at[0]], at, WHOLE)


def removed(recording: Recording, markers: MarkerSet, *keys: str) -> Recording:
    """Markers that the file does not have."""
    gone = {label for key in keys for label in labels_of(markers, key)}
    kept = [i for i, label in enumerate(recording.labels) if label not in gone]
    labels = tuple(recording.labels[i] for i in kept)
    return replace(recording, labels=labels, markers=recording.markers[:, kept])


def body_axes(recording: Recording, markers: MarkerSet, frame: int) -> Array:
    """(3, 3) columns forward, up, right of the pelvis in a frame, horizontal."""
    right, left = (
        recording.markers[frame, columns(recording, markers, f"asis_{side}")].mean(axis=0)
        for side in "rl"
    )
    across = (right - left) * [1.0, 0.0, 1.0]
    across /= np.linalg.norm(across)
    up = np.array([0.0, 1.0, 0.0])
    return np.column_stack([np.cross(up, across), up, across])


def segment_frames(recording: Recording, markers: MarkerSet, segment: str) -> tuple[Array, Array]:
    """(nf, 3, 3) body axes carried along by a segment, and (nf, 3) the middle of its markers."""
    own = columns(recording, markers, segment)
    helped = own
    if len(own) < 3:
        name, _, side = segment.partition("_")
        other = NEIGHBOUR[name] if NEIGHBOUR[name] == "pelvis" else f"{NEIGHBOUR[name]}_{side}"
        helped = columns(recording, markers, segment, other)
    asis = columns(recording, markers, "asis_r", "asis_l")
    whole = np.isfinite(recording.markers[:, helped]).all(axis=(1, 2))
    first = int(np.flatnonzero(whole & np.isfinite(recording.markers[:, asis]).all(axis=(1, 2)))[0])
    turns, _ = fit_rigid_motions(
        recording.markers[first, helped], recording.markers[whole][:, helped]
    )
    carried = turns @ body_axes(recording, markers, first)
    seen = np.flatnonzero(whole)
    nearest = np.abs(np.arange(len(whole))[:, None] - seen).argmin(axis=1)
    with np.errstate(all="ignore"):
        middle = recording.markers[seen][:, own].mean(axis=1)
    return carried[nearest], middle[nearest]


def _carried(
    recording: Recording,
    markers: MarkerSet,
    segment: str,
    change: Callable[[Array], Array],
    key: str = "",
    part: Part = WHOLE,
) -> Recording:
    """Markers of a segment (or one key's) moved within it: `change` of (nf, nm, 3) m from the
    middle of its markers.
    """
    axes, middle = segment_frames(recording, markers, segment)
    at = columns(recording, markers, key or segment)
    local = np.einsum("fji,fmj->fmi", axes, recording.markers[:, at] - middle[:, None])
    moved = np.einsum("fij,fmj->fmi", axes, change(local)) + middle[:, None]
    return put(recording, at, part, moved)


def displaced(
    recording: Recording, markers: MarkerSet, segment: str, key: str, mm: Vector, part: Part = WHOLE
) -> Recording:
    """One marker (or landmark) of a segment elsewhere on it."""
    return _carried(recording, markers, segment, lambda local: local + MM * np.array(mm), key, part)


def slid(recording: Recording, markers: MarkerSet, segment: str, mm: Vector) -> Recording:
    """All markers of a segment displaced together."""
    return _carried(recording, markers, segment, lambda local: local + MM * np.array(mm))


def turned(recording: Recording, markers: MarkerSet, segment: str, degrees: float) -> Recording:
    """All markers of a segment turned together about the vertical through their middle."""
    turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    return _carried(recording, markers, segment, lambda local: local @ turn.T)


def mirrored_cluster(recording: Recording, markers: MarkerSet, segment: str) -> Recording:
    """The markers of a segment as on the other side of its middle: a cluster of the other
    handedness.
    """
    return _carried(recording, markers, segment, lambda local: local * [1.0, 1.0, -1.0])


def _tracks(
    recording: Recording,
    markers: MarkerSet,
    key: str,
    change: Callable[[Array], Array],
    part: Part = WHOLE,
) -> Recording:
    """Trajectories (nf, nm, 3) of the markers of a key changed."""
    at = columns(recording, markers, key)
    return put(recording, at, part, change(recording.markers[:, at].copy()))


def away(
    recording: Recording, markers: MarkerSet, key: str, metres: Vector, part: Part = WHOLE
) -> Recording:
    """A marker elsewhere in the laboratory."""
    return _tracks(recording, markers, key, lambda x: x + list(metres), part)


def frozen(recording: Recording, markers: MarkerSet, key: str, part: Part) -> Recording:
    """A marker that stays where it was at the beginning of the part."""
    return ghost(recording, markers, key, (0.0, 0.0, 0.0), part)


def ghost(recording: Recording, markers: MarkerSet, key: str, mm: Vector, part: Part) -> Recording:
    """A gap filled with a reflection elsewhere, standing still in the room."""
    start = frames(recording, part).start
    return _tracks(
        recording,
        markers,
        key,
        lambda x: np.broadcast_to(x[start] + MM * np.array(mm), x.shape),
        part,
    )


def interpolated(recording: Recording, markers: MarkerSet, key: str, part: Part) -> Recording:
    """A gap filled by a straight line."""
    where = frames(recording, part)
    share = np.clip(
        (np.arange(len(recording.time)) - where.start) / (where.stop - where.start), 0, 1
    )[:, None, None]
    stop = min(where.stop, len(recording.time) - 1)
    return _tracks(
        recording, markers, key, lambda x: x[where.start] + share * (x[stop] - x[where.start]), part
    )


def pattern_filled(
    recording: Recording, markers: MarkerSet, key: str, source: str, part: Part
) -> Recording:
    """A gap filled by the way of another marker, as from the frame before the gap."""
    start = frames(recording, part).start
    other = recording.markers[:, columns(recording, markers, source)[:1]]
    return _tracks(recording, markers, key, lambda x: x[start] + other - other[start], part)


def put_on_again(recording: Recording, markers: MarkerSet, mm: float) -> Recording:
    """Every marker elsewhere on the body, as on another day."""
    way = np.random.default_rng(NOISE_SEED).normal(size=(recording.markers.shape[1], 3))
    return replace(recording, markers=recording.markers + MM * mm / np.sqrt(3.0) * way)


def spline_filled(recording: Recording, markers: MarkerSet, key: str, part: Part) -> Recording:
    """A gap filled by a cubic spline through five frames on either side."""
    where, time = frames(recording, part), recording.time
    around = [
        *range(max(where.start - 5, 0), where.start),
        *range(where.stop, min(where.stop + 5, len(time))),
    ]
    return _tracks(
        recording, markers, key, lambda x: CubicSpline(time[around], x[around])(time), part
    )


def low_passed(recording: Recording, markers: MarkerSet, keys: str, hertz: float) -> Recording:
    """Trajectories smoothed by a Butterworth filter, there and back."""
    smooth = partial(sosfiltfilt, butter(2, hertz, fs=recording.rate, output="sos"), axis=0)
    for key in keys.split(","):
        recording = _tracks(recording, markers, key, lambda x: _bridged(x, smooth))
    return recording


def _bridged(values: Array, change: Callable[[Array], Array]) -> Array:
    """`change` of trajectories whose gaps are bridged, with the gaps put back."""
    flat = values.reshape(len(values), -1).copy()
    gaps = ~np.isfinite(flat)
    frame = np.arange(len(flat))
    for column, gap in zip(flat.T, gaps.T, strict=True):
        if gap.any() and not gap.all():
            column[gap] = np.interp(frame[gap], frame[~gap], column[~gap])
    out = change(flat)
    out[gaps] = np.nan
    return out.reshape(values.shape)


def delayed(recording: Recording, markers: MarkerSet, key: str, seconds: float) -> Recording:
    """Markers that come later than the others."""
    t = recording.time

    def late(x: Array) -> Array:
        return np.column_stack([np.interp(t - seconds, t, column) for column in x.T])

    return _tracks(recording, markers, key, lambda x: _bridged(x, late))


def drifting(recording: Recording, markers: MarkerSet, key: str, mm: Vector) -> Recording:
    """A marker that creeps away over the whole trial, along the laboratory's axes."""
    share = np.linspace(0, 1, len(recording.time))[:, None, None]
    return _tracks(recording, markers, key, lambda x: x + MM * share * np.array(mm))


def lost(recording: Recording, markers: MarkerSet, key: str, part: Part) -> Recording:
    """Markers that are not seen in a part."""
    return _tracks(recording, markers, key, lambda x: np.full_like(x, np.nan), part)


def noisy(recording: Recording, markers: MarkerSet, mm: float, key: str = "") -> Recording:
    """White noise on every coordinate of all markers, or those of a key."""
    noise = MM * mm * np.random.default_rng(NOISE_SEED).normal(size=recording.markers.shape)
    at = columns(recording, markers, key) if key else list(range(len(recording.labels)))
    return put(recording, at, WHOLE, (recording.markers + noise)[:, at])


def knees_bent(
    recording: Recording, markers: MarkerSet, degrees: float, sides: str = "rl"
) -> Recording:
    """Knees flexed by so many degrees over feet that stay flat: half of it in the hip, half in the
    ankle.
    """
    return _posed(recording, markers, np.full(len(recording.time), degrees), sides)


def knees_bending(recording: Recording, markers: MarkerSet, degrees: float) -> Recording:
    """The person goes down and up every two seconds while the static trial is recorded."""
    phase = np.pi * (recording.time - recording.time[0])
    return _posed(recording, markers, degrees * 0.5 * (1 - np.cos(phase)), "rl")


def _posed(recording: Recording, markers: MarkerSet, degrees: Array, sides: str) -> Recording:
    out = recording.markers.copy()
    at_asis = columns(recording, markers, "asis_r", "asis_l")
    known = np.flatnonzero(np.isfinite(recording.markers[:, at_asis]).all(axis=(1, 2)))
    axes = body_axes(recording, markers, int(known[0]))
    forward = Rotation.from_rotvec(np.deg2rad(0.5 * degrees)[:, None] * axes[:, 2]).as_matrix()
    back = np.swapaxes(forward, 1, 2)
    still = np.broadcast_to(np.eye(3), forward.shape)
    hip = np.nanmean(recording.markers[:, at_asis], axis=1) + axes @ HIP_BELOW_ASIS
    for side in sides:
        ends = (f"{end}_lat_{side}" for end in ("knee", "ankle"))
        knee, ankle = (
            np.nanmean(recording.markers[:, columns(recording, markers, end)], axis=1)
            for end in ends
        )
        knee_now = hip + np.einsum("fij,fj->fi", forward, knee - hip)
        ankle_now = knee_now + np.einsum("fij,fj->fi", back, ankle - knee)
        for name, end, old, new, turn in (
            ("thigh", "knee", knee, knee_now, forward),
            ("shank", "ankle", knee, knee_now, back),
            ("foot", "", ankle, ankle_now, still),
        ):
            landmarks = [
                key
                for key in (f"{end}_lat_{side}", f"{end}_med_{side}")
                if key in markers.landmarks
            ]
            at = list(dict.fromkeys(columns(recording, markers, f"{name}_{side}", *landmarks)))
            out[:, at] = new[:, None] + np.einsum(
                "fij,fmj->fmi", turn, recording.markers[:, at] - old[:, None]
            )
    return replace(recording, markers=out)


def scaled(recording: Recording, markers: MarkerSet, factor: float) -> Recording:
    """All positions times a factor: another unit, or a person of another size."""
    return replace(recording, markers=factor * recording.markers)


def axes(
    recording: Recording, markers: MarkerSet, order: Vector, signs: Vector = (1.0, 1.0, 1.0)
) -> Recording:
    """Axes of the markers in another order, or turned round."""
    return replace(
        recording, markers=recording.markers[:, :, [int(k) for k in order]] * np.array(signs)
    )


def tilted(recording: Recording, markers: MarkerSet, degrees: float) -> Recording:
    """The room of the markers tilted against that of the plates."""
    turn = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
    return replace(recording, markers=recording.markers @ turn.T)


def other_rate(recording: Recording, markers: MarkerSet, factor: float) -> Recording:
    """A header that tells `factor` times the true frame rate; the forces keep their own clock."""
    return replace(recording, time=recording.time / factor)


def frames_dropped(recording: Recording, markers: MarkerSet, part: Part) -> Recording:
    """Frames that the file lacks, the rest moved up, and the times numbered on, as if there had
    been no gap.
    """
    gone = np.arange(len(recording.time))[frames(recording, part)]
    kept = np.delete(recording.markers, gone, axis=0)
    return replace(recording, time=recording.time[: len(kept)], markers=kept)


def frame_lost(recording: Recording, markers: MarkerSet, share: float, count: int) -> Recording:
    """So many frames are missing at a share of the trial, and the times are numbered on as if
    nothing were.
    """
    length = len(recording.time)
    at = round(share * length)
    return frames_dropped(recording, markers, (at / length, (at + count) / length))


def frame_twice(recording: Recording, markers: MarkerSet, share: float) -> Recording:
    """One frame stands in the file twice, and the last one is left out."""
    at = round(share * len(recording.time))
    twice = np.insert(recording.markers, at, recording.markers[at], axis=0)
    return replace(recording, markers=twice[:-1])


def backwards(recording: Recording, markers: MarkerSet) -> Recording:
    """Played from the end to the beginning."""
    return replace(recording, markers=recording.markers[::-1].copy())


def hardly_moving(recording: Recording, markers: MarkerSet, share: float) -> Recording:
    """Every marker stays near its mean."""
    mean = np.nanmean(recording.markers, axis=0)
    return replace(recording, markers=mean + share * (recording.markers - mean))


def cropped(recording: Recording, markers: MarkerSet, part: Part) -> Recording:
    """Only a part of the frames."""
    where = frames(recording, part)
    return replace(recording, time=recording.time[where], markers=recording.markers[where])
