"""Read one trial of a study: labels of the marker set, and the times that the study selects.

The module also places trunk markers that walks have and the static trial lacks. In every frame the
markers of the pelvis give the position of the lumbar joint and the direction of the pelvis. The
mean of a trunk marker in axes through that joint, y up and z along the pelvis's lateral direction
made horizontal, is its position in the static posture. The trunk is thus assumed to stand as it is
carried on average while walking. A note reports that trunk angles count from that mean posture.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.errors import Code, InputError
from gaitcal.io.csv_recordings import apply_corrected_events, find_event_tables
from gaitcal.io.force_plate import STANCE_S
from gaitcal.io.formats import read_recording
from gaitcal.io.opensim_files import find_loads_tables
from gaitcal.io.recording import (
    Recording,
    find_runs,
    find_still_window,
    find_visible,
    format_spans,
    measure_duration,
)
from gaitcal.io.segment_poses import make_upright_posture
from gaitcal.model import linkage, rebuilt_markers, segment_frames, trunk
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.subject_model import PointNoise, SubjectModel
from gaitcal.study.study_file import TrialTable

OTHER_UNIT_RATIO = 100.0
"""Least ratio of the durations of forces and markers that shows times in ms.

Laboratories crop markers to a tenth or a twentieth of the forces.
"""


class Role(str, Enum):
    """Role of a trial."""

    STATIC = "static"
    """Standing still."""
    JOINT = "joint"
    """One joint moved in isolation."""
    GAIT = "gait"
    """Walking."""
    MOTION = "motion"
    """Any other activity of the whole body."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One trial of a study."""

    name: str
    role: Role
    joint: str | None = None
    """The joint of a functional trial (`role = "joint"`)."""
    recording: Recording
    """Labels as in the marker set; only the frames that the study asks for."""
    plates: Mapping[str, str] = field(default_factory=dict)
    """Plate name -> "r", "l" or "none", if the study or the file of the forces gives it."""
    filter_hz: float | str | None = None
    """Cut-off of the force filter of this trial, `none`, or None for that of the settings."""
    file_labels: tuple[str, ...] = ()
    """Labels as in the file."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """`file`; where forces have one of their own, `forces`; where a person corrected events,
    `events`.
    """
    outliers: tuple[rebuilt_markers.Outlier, ...] | None = None
    """Markers that were left out where they were metres away from the body; None: not looked for
    yet.
    """
    spikes: rebuilt_markers.Spikes = field(default_factory=dict)
    """Single positions out of line that were left out."""
    cut: str = ""
    """What was left out of the recording as it does not show the pelvis; empty: nothing."""


BRIDGED_S = 0.2
"""Without three markers the splines carry a pelvis over so much; more hides a part of a step."""


def cleaned_trial(
    trial: Trial, segment_of: Mapping[str, str], noise: PointNoise | None = None
) -> Trial:
    """The trial without markers metres away from the body and, where it moves, without single
    positions out of line, cut to the longest part that shows the pelvis it hangs on; `segment_of`:
    label -> segment; `noise`: of the set.
    """
    if trial.outliers is not None:
        return trial
    recording, outliers = rebuilt_markers.without_outliers(trial.recording, segment_of)
    if trial.role is Role.STATIC:
        return replace(trial, recording=recording, outliers=outliers)
    recording, spikes = rebuilt_markers.without_spikes(recording, noise)
    trial, time = (
        replace(trial, recording=recording, outliers=outliers, spikes=spikes),
        recording.time,
    )
    if linkage.carrier_of(trial.joint) not in ("", "pelvis"):
        return trial
    pelvis = [i for i, label in enumerate(recording.labels) if segment_of.get(label) == "pelvis"]
    lost = find_visible(recording.markers[:, pelvis]).sum(axis=1) < 3
    lasting = [run for run in find_runs(lost) if measure_duration(time, run) > BRIDGED_S]
    if not lasting or lost.all():
        return trial
    edges = [0, *(edge for run in lasting for edge in (run.start, run.stop)), len(time)]
    start, stop = max(zip(edges[::2], edges[1::2], strict=True), key=lambda part: part[1] - part[0])
    frames = np.arange(len(time))
    words = (
        f"fewer than three pelvis markers in {100 * np.mean(lost):.0f} % of the frames "
        f"({format_spans(time, lasting)}): "
    )
    words += (
        f"the trial is cut to {time[start]:.2f}-{time[stop - 1]:.2f} s, the longest part that "
        "shows the pelvis"
    )
    kept = recording.frames((frames >= start) & (frames < stop)).with_notes(words)
    return replace(trial, recording=kept, cut=words)


def read_trial(trial: TrialTable, rename: Mapping[str, str], marker_set: MarkerSet) -> Trial:
    """Read one trial of a study file with the labels of the marker set.

    Parameters
    ----------
    trial
        Table `[[trial]]` with absolute paths.
    rename
        Label in the file -> label in the marker set, before the aliases of the set.
    marker_set
        Marker set of the study.

    Returns
    -------
    Trial
        The trial, not cleaned.

    Raises
    ------
    InputError
        One line: file, field, what was found, what is allowed.
    """
    whole = apply_corrected_events(read_recording(trial.file, forces=trial.forces), trial.file)
    recording = marker_set.renamed(_rename_labels(whole, rename))
    known = [plate.name for plate in recording.plates]
    for name in trial.plates:
        if name not in known:
            message = f"found plate '{name}'; the recording has {', '.join(known) or 'none'}"
            raise _make_fault(message, trial.file, f"trial '{trial.name}'.plates")
    if trial.time is not None:
        time, (low, high) = recording.time, trial.time
        inside = (time >= low - 1e-9) & (time <= high + 1e-9)
        if inside.sum() < 2:
            message = (
                f"found [{low:g}, {high:g}]; the recording runs from {time[0]:g} to {time[-1]:g} s"
            )
            raise _make_fault(message, trial.file, f"trial '{trial.name}'.time")
        recording = recording.frames(inside)
    if trial.role == Role.STATIC.value:
        recording = make_upright_posture(recording)
    recording = _note_partial_forces(recording, trial)
    files = {"file": trial.file}
    if trial.forces is not None:
        files |= {"forces": trial.forces} | {
            f"table{k}": path for k, path in enumerate(find_loads_tables(trial.forces))
        }
    if recording.corrected:
        files["events"] = find_event_tables(trial.file)[0]
    return Trial(
        name=trial.name,
        role=Role(trial.role),
        joint=trial.joint,
        recording=recording,
        plates={**recording.feet, **trial.plates},
        filter_hz=trial.filter_hz,
        file_labels=whole.labels,
        files=files,
    )


def _make_fault(message: str, source: object, field: str) -> InputError:
    return InputError(message, source=source, field=field, code=Code.PART_OF_TRIAL)


def _rename_labels(recording: Recording, rename: Mapping[str, str]) -> Recording:
    labels = tuple(rename.get(label, label) for label in recording.labels)
    changed = [f"{old} -> {rename[old]}" for old in recording.labels if old in rename]
    doubled = sorted({label for label in labels if labels.count(label) > 1}) if changed else ()
    if doubled:
        message = f"found '{doubled[0]}' twice after renaming; a label names one marker"
        raise InputError(
            message, source=recording.source, field="markers.rename", code=Code.UNKNOWN_LABEL
        )
    renamed = replace(recording, labels=labels)
    return renamed.with_notes(f"markers renamed: {', '.join(changed)}") if changed else renamed


def _note_partial_forces(recording: Recording, trial: TrialTable) -> Recording:
    """Add a note if forces cover a part of the trial; InputError if less than a step."""
    if trial.role not in ("gait", "motion"):
        return recording
    time, source = recording.time, trial.forces or trial.file
    step, whole = float(np.median(np.diff(time))), float(np.ptp(time))
    for plate in recording.plates:
        lasts = float(np.ptp(plate.time))
        if lasts > OTHER_UNIT_RATIO * whole and trial.time is None:
            message = (
                f"found forces that last {lasts:g} s and markers that last {whole:g} s; one of the "
                "two times is in "
            )
            raise _make_fault(
                message + "another unit (ms?); both must be in s", source, f"plate {plate.name}"
            )
        start, stop = max(plate.time[0], time[0]), min(plate.time[-1], time[-1])
        if stop - start < min(STANCE_S, whole - step):
            message = (
                f"found forces from {plate.time[0]:g} to {plate.time[-1]:g} s and markers from "
                f"{time[0]:g} to "
                f"{time[-1]:g} s; both must last for a step together: are these the forces of this "
                "trial?"
            )
            raise _make_fault(message, source, f"plate {plate.name}")
        if start > time[0] + step or stop < time[-1] - step:
            note = (
                f"Plate {plate.name}: forces from {start:.2f} to {stop:.2f} s only; no torques "
                "beyond."
            )
            recording = recording.with_notes(note)
    return recording


FEWEST_TRUNK_FRAMES = 20
"""Least number of frames in which a trunk marker must be visible with three of the pelvis.

A mean over fewer frames is a single posture.
"""
SINGULAR_M = 1e-2
"""Least RMS distance (m) of pelvis markers from a line that shows the rotation of the pelvis."""


def build_model_with_trunk(
    model_of: Callable[[Recording], SubjectModel],
    static: Recording,
    marker_set: MarkerSet,
    walks: Sequence[Recording],
) -> SubjectModel:
    """Build the model of a static trial, with the trunk of the walks if it shows none.

    Parameters
    ----------
    model_of
        Function that builds the model of a static recording.
    static
        Recording of the static trial.
    marker_set
        Marker set of the study.
    walks
        Recordings of walks.

    Returns
    -------
    SubjectModel
        The model; a note if walks placed trunk markers.
    """
    model = model_of(static)
    placed = zip(model.markers.segments, model.markers.weight, strict=True)
    if (
        sum(segment == "head_trunk" and weight > 0 for segment, weight in placed)
        >= trunk.IN_A_PLANE
    ):
        return model
    static = marker_set.renamed(static)
    in_static = set(model.markers.labels)
    wanted = [
        m
        for m in marker_set.tracking.get("head_trunk", ())
        if marker_set.weight(m) > 0 and m not in in_static
    ]
    found: dict[str, list[Array]] = {label: [] for label in wanted}
    for walk in (marker_set.renamed(walk) for walk in walks):
        at, axes, origins = _compute_standing_axes(model, walk)
        for label in set(wanted) & set(walk.labels):
            path = walk.markers[at, walk.labels.index(label)]
            here = np.isfinite(path).all(axis=1)
            found[label].append(np.einsum("fji,fj->fi", axes[here], path[here] - origins[here]))
    places = {
        label: np.concatenate(parts).mean(axis=0)
        for label, parts in found.items()
        if sum(map(len, parts)) >= FEWEST_TRUNK_FRAMES
    }
    if not places:
        return model
    window = np.zeros(len(static.time), dtype=bool)
    window[find_still_window(static, model.markers.labels).frames] = True
    _, axes, origins = _compute_standing_axes(model, static.frames(window))
    origin, upright = origins.mean(axis=0), _build_upright_axes(axes[:, :, 2].mean(axis=0))
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
    """Compute axes (k, 3, 3) and lumbar joint (k, 3) m in the k frames with a known pelvis.

    Axes are x forward, y up, z right. The frames come first.
    """
    column = {label: i for i, label in enumerate(walk.labels)}
    pelvis = model.markers.on("pelvis", column)
    local = model.markers.local[pelvis]
    measured = walk.markers[:, [column[model.markers.labels[i]] for i in pelvis]]
    known = np.flatnonzero(find_visible(measured).all(axis=1))
    if (
        len(pelvis) < trunk.IN_A_PLANE
        or segment_frames.off_line(local) < SINGULAR_M
        or not len(known)
    ):
        return np.empty(0, dtype=np.intp), np.empty((0, 3, 3)), np.empty((0, 3))
    centre, middle = local.mean(axis=0), measured[known].mean(axis=1)
    turns = _fit_rotations(
        (measured[known] - middle[:, None]).transpose(0, 2, 1) @ (local - centre)
    )
    origins: Array = middle + turns @ (model.landmarks["lumbar"][1] - centre)
    return known, np.array([_build_upright_axes(lateral) for lateral in turns[:, :, 2]]), origins


def _fit_rotations(moments: Array) -> Array:
    """Fit rotations (k, 3, 3) to sums of measured times local positions (k, 3, 3) (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(moments)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    out: Array = u @ vt
    return out


def _build_upright_axes(lateral: Array) -> Array:
    """Build (3, 3) axes in columns, y up, z along a (3,) direction made horizontal."""
    up = np.array([0.0, 1.0, 0.0])
    z = segment_frames.unit(lateral - (lateral @ up) * up)
    return np.column_stack([np.cross(up, z), up, z])
