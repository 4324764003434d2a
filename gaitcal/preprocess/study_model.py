"""The nominal model of a study: from its static trial, with the markers that this one lost rebuilt.

Markers of the trunk that walks have and the static trial lacks are put where they belong by the
walks themselves: in every frame the markers of the pelvis tell where the lumbar joint is and where
the pelvis faces. The mean of a trunk marker in axes through that joint, y up and z along the
pelvis's lateral direction made horizontal, is its place in a person whose trunk stands as it is
carried on average while walking. A note says that the trunk's angles count from its mean posture in
those walks.
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
from gaitcal.preprocess.rebuilt_markers import Rebuilding, rebuild_lost
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role

FEWEST_FRAMES = 20
"""In which a marker must be seen beside three of the pelvis; a mean over less is a posture, not a
habit.
"""
SINGULAR = 1e-2
"""m, RMS distance of pelvis markers from a line below which they do not tell how the pelvis is
turned.
"""


def rebuild_static(clean: Study) -> Rebuilding:
    """Rebuild what the first static trial of a study lost, where its other trials show it.

    Parameters
    ----------
    clean
        A study of clean trials.
    """
    others = [(t.name, t.recording) for t in (*clean.further_statics, *clean.moving)]
    marker_set = clean.marker_set.with_weights(clean.weights)
    return rebuild_lost(clean.static.recording, marker_set, others, clean.static.name)


def build_nominal_model(study: Study) -> SubjectModel:
    """Make the nominal model of a study as it was read.

    It follows from the static trial, the marker set and anthropometry; where the static trial lacks
    the markers of the trunk, the walks place them.

    Raises
    ------
    InputError
        The static trial does not give a model.
    """
    segment_of, noise = study.marker_set.segment_of, study.marker_set.noise
    trials = tuple(clean_trial(trial, segment_of, noise) for trial in study.trials)
    clean = replace(study, trials=trials)
    return build_nominal_from_clean(clean, rebuild_static(clean))


def build_nominal_from_clean(clean: Study, completed: Rebuilding) -> SubjectModel:
    """Make the nominal model of a study of clean trials, whose static trial is completed.

    Raises
    ------
    InputError
        The static trial does not give a model.
    """
    model_of = partial(
        nominal.nominal_model,
        marker_set=clean.marker_set,
        subject=clean.subject,
        hip_centre=clean.hip_centre,
        ankle_zero=AnkleZero(clean.settings.ankle_rule),
        weights=clean.weights,
    )
    walks = [trial.recording for trial in clean.trials if trial.role is Role.GAIT]
    try:
        return build_model_with_trunk(model_of, completed.static, clean.marker_set, walks)
    except InputError as fault:
        raise InputError(
            f"{fault}{completed.describe_failures(str(fault))}", code=fault.code
        ) from fault


def build_model_with_trunk(
    model_of: Callable[[Recording], SubjectModel],
    static: Recording,
    marker_set: MarkerSet,
    walks: Sequence[Recording],
) -> SubjectModel:
    """The model that `model_of` makes of a static trial, with the trunk of the walks where it shows
    none.
    """
    model = model_of(static)
    placed = zip(model.markers.segments, model.markers.weight, strict=True)
    if (
        sum(segment == "head_trunk" and weight > 0 for segment, weight in placed)
        >= trunk.PLANE_LANDMARKS
    ):
        return model
    static = marker_set.rename_labels(static)
    in_static = set(model.markers.labels)
    wanted = [
        m
        for m in marker_set.tracking.get("head_trunk", ())
        if marker_set.weight(m) > 0 and m not in in_static
    ]
    found: dict[str, list[Array]] = {label: [] for label in wanted}
    for walk in (marker_set.rename_labels(walk) for walk in walks):
        at, axes, origins = _compute_standing_axes(model, walk)
        for label in set(wanted) & set(walk.labels):
            path = walk.markers[at, walk.labels.index(label)]
            here = np.isfinite(path).all(axis=1)
            found[label].append(np.einsum("fji,fj->fi", axes[here], path[here] - origins[here]))
    places = {
        label: np.concatenate(parts).mean(axis=0)
        for label, parts in found.items()
        if sum(map(len, parts)) >= FEWEST_FRAMES
    }
    if not places:
        return model
    window = np.zeros(len(static.time), dtype=bool)
    window[find_still_window(static, model.markers.labels).frames] = True
    _, axes, origins = _compute_standing_axes(model, static.frames(window))
    origin, upright = origins.mean(axis=0), _make_upright_axes(axes[:, :, 2].mean(axis=0))
    points = np.array([origin + upright @ place for place in places.values()])
    kept = [
        i for i, label in enumerate(static.labels) if label not in places
    ]  # columns of nothing but gaps
    added = np.broadcast_to(points, (len(static.time), *points.shape))
    note = (
        f"{', '.join(places)} are not in the static trial and were placed by the walks: the trunk "
        "is taken to stand as "
        "it is carried on average while walking"
    )
    return model_of(
        replace(
            static,
            labels=(*(static.labels[i] for i in kept), *places),
            markers=np.concatenate([static.markers[:, kept], added], axis=1),
            notes=(*static.notes, note),
        )
    )


def _compute_standing_axes(model: SubjectModel, walk: Recording) -> tuple[IntArray, Array, Array]:
    """Frames (k,) in which the pelvis is known; (k, 3, 3) axes x forward, y up, z right, (k, 3) m
    lumbar joint.
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
    turns = segment_frames.find_nearest_rotation(moments)
    origins: Array = middle + turns @ (model.landmarks["lumbar"][1] - centre)
    return known, np.array([_make_upright_axes(lateral) for lateral in turns[:, :, 2]]), origins


def _make_upright_axes(lateral: Array) -> Array:
    """(3, 3) axes in columns, z along a (3,) direction made horizontal."""
    up = np.array([0.0, 1.0, 0.0])
    z = segment_frames.normalise(lateral - (lateral @ up) * up)
    return np.column_stack([np.cross(up, z), up, z])
