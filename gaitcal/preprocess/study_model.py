"""Make the nominal model of a study from its completed static trial.

Trunk markers that walks have and the static trial lacks are placed by the walks: in every frame the
pelvis markers give the position of the lumbar joint and the direction of the pelvis. The mean of a
trunk marker in axes through that joint, y up and z along the horizontal part of the pelvis's
lateral direction, is its position in a person whose trunk has its mean posture of walking. A note
reports that the angles of the trunk count from that posture.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.errors import InputError
from gaitcal.io.recording import Recording, find_still_window, find_visible
from gaitcal.model import nominal, segment_frames, trunk
from gaitcal.model.ankle_zero import AnkleZero
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess.clean_trial import clean_trial
from gaitcal.preprocess.rebuilt_markers import MarkerReconstruction, reconstruct_markers
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role

FEWEST_TRUNK_FRAMES = 20
"""Frames in which a trunk marker must be visible with three of the pelvis: a mean over fewer is not
the usual posture.
"""
SINGULAR = 1e-2
"""m, smallest RMS distance of the pelvis markers from a line: the rotation about a line is free."""


def rebuild_static(clean: Study) -> MarkerReconstruction:
    """Reconstruct the markers that the first static trial of a study lost, from its other trials.

    Returns: the completed static trial.
    """
    others = [(t.name, t.recording) for t in (*clean.further_statics, *clean.moving)]
    marker_set = clean.marker_set.with_weights(clean.weights)
    return reconstruct_markers(clean.static.recording, marker_set, others, clean.static.name)


def build_nominal_model(study: Study) -> SubjectModel:
    """Make the nominal model of a study as it was read.

    It follows from the static trial, the marker set and anthropometry. If the static trial lacks
    the trunk markers, the walks place them.

    Parameters
    ----------
    study
        As it was read.

    Returns
    -------
    SubjectModel
        Nominal.

    Raises
    ------
    InputError
        The static trial gives no model.
    """
    segment_of, noise = study.marker_set.segment_of, study.marker_set.noise
    trials = tuple(clean_trial(trial, segment_of, noise) for trial in study.trials)
    clean = replace(study, trials=trials)
    return build_nominal_from_clean(clean, rebuild_static(clean))


def build_nominal_from_clean(clean: Study, completed: MarkerReconstruction) -> SubjectModel:
    """Make the nominal model of a study of clean trials with a completed static trial.

    Parameters
    ----------
    clean
        A study of clean trials.
    completed
        Its static trial, see `rebuild_static`.

    Returns
    -------
    SubjectModel
        Nominal.

    Raises
    ------
    InputError
        The static trial gives no model.
    """
    build_model = partial(
        nominal.nominal_model,
        marker_set=clean.marker_set,
        subject=clean.subject,
        hip_centre=clean.hip_centre,
        ankle_zero=AnkleZero(clean.settings.ankle_rule),
        weights=clean.weights,
    )
    walks = [trial.recording for trial in clean.trials if trial.role is Role.GAIT]
    try:
        return build_model_with_trunk(build_model, completed.static, clean.marker_set, walks)
    except InputError as fault:
        raise InputError(
            f"{fault}{completed.describe_failures(str(fault))}", code=fault.code
        ) from fault


def build_model_with_trunk(
    build_model: Callable[[Recording], SubjectModel],
    static: Recording,
    marker_set: MarkerSet,
    walks: Sequence[Recording],
) -> SubjectModel:
    """Make a model with the trunk of the walks if the static trial shows none.

    `build_model`: makes a model from a static trial. Returns: that of the static trial alone if it
    shows the trunk, or the walks do not either.
    """
    model = build_model(static)
    placed = zip(model.markers.segments, model.markers.weight, strict=True)
    on_trunk = sum(segment == "head_trunk" and weight > 0 for segment, weight in placed)
    if on_trunk >= trunk.PLANE_LANDMARKS:
        return model
    static = marker_set.renamed(static)
    in_static = set(model.markers.labels)
    wanted = [
        m
        for m in marker_set.tracking.get("head_trunk", ())
        if marker_set.weight(m) > 0 and m not in in_static
    ]
    # positions relative to the lumbar joint, in every frame of every walk
    found: dict[str, list[Array]] = {label: [] for label in wanted}
    for walk in (marker_set.renamed(walk) for walk in walks):
        frames, axes, origins = _compute_standing_axes(model, walk)
        for label in set(wanted) & set(walk.labels):
            path = walk.markers[frames, walk.labels.index(label)]
            visible = np.isfinite(path).all(axis=1)
            local = np.einsum("fji,fj->fi", axes[visible], path[visible] - origins[visible])
            found[label].append(local)
    positions = {
        label: np.concatenate(parts).mean(axis=0)
        for label, parts in found.items()
        if sum(map(len, parts)) >= FEWEST_TRUNK_FRAMES
    }
    if not positions:
        return model
    # the same relative to the lumbar joint of the static trial
    window = np.zeros(len(static.time), dtype=bool)
    window[find_still_window(static, model.markers.labels).frames] = True
    _, axes, origins = _compute_standing_axes(model, static.frames(window))
    origin, upright = origins.mean(axis=0), _make_upright_axes(axes[:, :, 2].mean(axis=0))
    points = np.array([origin + upright @ position for position in positions.values()])
    # columns of these labels have nothing but gaps
    kept = [i for i, label in enumerate(static.labels) if label not in positions]
    added = np.broadcast_to(points, (len(static.time), *points.shape))
    note = (
        f"placed by the walks, not in the static trial: {', '.join(positions)}; the static posture "
        "of the trunk is its mean posture while walking"
    )
    return build_model(
        replace(
            static,
            labels=(*(static.labels[i] for i in kept), *positions),
            markers=np.concatenate([static.markers[:, kept], added], axis=1),
            notes=(*static.notes, note),
        )
    )


def _compute_standing_axes(model: SubjectModel, walk: Recording) -> tuple[IntArray, Array, Array]:
    """Compute frames (k,), axes (k, 3, 3) forward, up, right, and lumbar joint (k, 3) m of a walk.

    Frames in which a pelvis marker is not visible are left out.
    """
    column = {label: i for i, label in enumerate(walk.labels)}
    pelvis = model.markers.find_markers("pelvis", column)
    local = model.markers.local[pelvis]
    measured = walk.markers[:, [column[model.markers.labels[i]] for i in pelvis]]
    known = np.flatnonzero(find_visible(measured).all(axis=1))
    if (
        len(pelvis) < trunk.PLANE_LANDMARKS
        or segment_frames.measure_distance_from_line(local) < SINGULAR
        or not len(known)
    ):
        return np.empty(0, dtype=np.intp), np.empty((0, 3, 3)), np.empty((0, 3))
    centre, middle = local.mean(axis=0), measured[known].mean(axis=1)
    moments = (measured[known] - middle[:, None]).transpose(0, 2, 1) @ (local - centre)
    rotations = segment_frames.find_nearest_rotation(moments)
    origins: Array = middle + rotations @ (model.landmarks["lumbar"][1] - centre)
    return known, np.array([_make_upright_axes(lateral) for lateral in rotations[:, :, 2]]), origins


def _make_upright_axes(lateral: Array) -> Array:
    """Make axes (3, 3) in columns, y up, z along the horizontal part of a direction (3,)."""
    up = np.array([0.0, 1.0, 0.0])
    z = segment_frames.normalise(lateral - (lateral @ up) * up)
    return np.column_stack([np.cross(up, z), up, z])
