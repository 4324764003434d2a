"""Markers of the trunk that walks have and the static trial lacks, put where they belong by the walks themselves.

In every frame the markers of the pelvis tell where the lumbar joint is and where the pelvis faces. The mean of a
trunk marker in axes through that joint, y up and z along the pelvis's lateral direction made horizontal, is its place
in a person whose trunk stands as it is carried on average while walking: the static trial gets it there. What that
assumes is told: the trunk's angles count from its mean posture in those walks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.io.recording import Recording, seen_mask
from gaitcal.io.still import still_window
from gaitcal.model.marker_roles import MarkerSet
from gaitcal.model.segment_frames import unit
from gaitcal.model.subject_model import SubjectModel
from gaitcal.model.trunk import IN_A_PLANE, spread_off_line

FEWEST_FRAMES = 20
"""In which a marker must be seen beside three of the pelvis; a mean over less is a posture, not a habit."""
SINGULAR = 1e-2
"""m, RMS distance of pelvis markers from a line below which they do not tell how the pelvis is turned."""


def model_with_trunk(
    model_of: Callable[[Recording], SubjectModel], static: Recording, marker_set: MarkerSet, walks: Sequence[Recording]
) -> SubjectModel:
    """The model that `model_of` makes of a static trial, with the trunk of the walks where it shows none."""
    model = model_of(static)
    placed = zip(model.markers.segments, model.markers.weight, strict=True)
    if sum(segment == "head_trunk" and weight > 0 for segment, weight in placed) >= IN_A_PLANE:
        return model
    more = with_trunk_of_walks(marker_set.renamed(static), model, marker_set, walks)
    return model if more is None else model_of(more)


def with_trunk_of_walks(
    static: Recording, model: SubjectModel, marker_set: MarkerSet, walks: Sequence[Recording]
) -> Recording | None:
    """The static trial with markers of head and trunk that only walks have; None where there are none.

    `model`: of the static trial, whose pelvis they are placed on.
    """
    in_static = set(model.markers.labels)
    wanted = [m for m in marker_set.tracking.get("head_trunk", ()) if marker_set.weight(m) > 0 and m not in in_static]
    found: dict[str, list[Array]] = {label: [] for label in wanted}
    for walk in (marker_set.renamed(walk) for walk in walks):
        column = {label: i for i, label in enumerate(walk.labels)}
        poses = _standing_axes(model, walk)
        for label in wanted:
            if label in column:
                at, axes, origins = poses
                seen = at[np.isfinite(walk.markers[at, column[label]]).all(axis=1)]
                here = np.isin(at, seen)
                away = walk.markers[seen, column[label]] - origins[here]
                found[label].append(np.einsum("fji,fj->fi", axes[here], away))
    places = {
        label: np.concatenate(parts).mean(axis=0)
        for label, parts in found.items()
        if parts and sum(len(part) for part in parts) >= FEWEST_FRAMES
    }
    if not places:
        return None
    axes, origin = _of_static(model, static)
    points = np.array([origin + axes @ place for place in places.values()])
    kept = [i for i, label in enumerate(static.labels) if label not in places]  # columns of nothing but gaps
    added = np.broadcast_to(points, (len(static.time), *points.shape))
    note = (
        f"{', '.join(places)} are not in the static trial and were placed by the walks: the trunk is taken to stand as "
        "it is carried on average while walking"
    )
    return replace(
        static,
        labels=(*(static.labels[i] for i in kept), *places),
        markers=np.concatenate([static.markers[:, kept], added], axis=1),
        notes=(*static.notes, note),
    )


def _standing_axes(model: SubjectModel, walk: Recording) -> tuple[IntArray, Array, Array]:
    """Frames (k,) in which the pelvis is known; (k, 3, 3) axes x forward, y up, z right, (k, 3) m lumbar joint."""
    column = {label: i for i, label in enumerate(walk.labels)}
    pelvis = [
        i
        for i, (label, segment) in enumerate(zip(model.markers.labels, model.markers.segments, strict=True))
        if segment == "pelvis" and label in column
    ]
    local = model.markers.local[pelvis]
    measured = walk.markers[:, [column[model.markers.labels[i]] for i in pelvis]]
    known = np.flatnonzero(seen_mask(measured).all(axis=1))
    if len(pelvis) < IN_A_PLANE or spread_off_line(local) < SINGULAR or not len(known):
        return np.empty(0, dtype=np.intp), np.empty((0, 3, 3)), np.empty((0, 3))
    centre, middle = local.mean(axis=0), measured[known].mean(axis=1)
    turns = _rotations((measured[known] - middle[:, None]).transpose(0, 2, 1) @ (local - centre))
    origins: Array = middle + turns @ (model.landmarks["lumbar"][1] - centre)
    return known, np.array([_upright(lateral) for lateral in turns[:, :, 2]]), origins


def _rotations(moments: Array) -> Array:
    """(k, 3, 3) rotations nearest to sums of measured times local positions (k, 3, 3) (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(moments)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    out: Array = u @ vt
    return out


def _of_static(model: SubjectModel, static: Recording) -> tuple[Array, Array]:
    """The same of the static trial, in the mean while the person stands still."""
    window = np.zeros(len(static.time), dtype=bool)
    window[still_window(static, model.markers.labels).frames] = True
    _, axes, origins = _standing_axes(model, static.frames(window))
    middle: Array = origins.mean(axis=0)
    return _upright(axes[:, :, 2].mean(axis=0)), middle


def _upright(lateral: Array) -> Array:
    """(3, 3) axes in columns, z along a (3,) direction made horizontal."""
    up = np.array([0.0, 1.0, 0.0])
    z = unit(lateral - (lateral @ up) * up)
    return np.column_stack([np.cross(up, z), up, z])
