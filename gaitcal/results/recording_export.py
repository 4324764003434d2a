"""Write the recordings of a result as C3D files with angles, moments, powers, events and centres.

A C3D recording keeps all that ezc3d can write (`io/c3d/writer.py`); the rest is reported. A
recording of another format becomes a C3D of its markers and, if its forces can be synchronised with
the markers, its plates. Torques are written in valid frames only, and not for refused trials.
"""

import itertools
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.errors import Code, InputError
from gaitcal.export.plug_in_gait import (
    ANGLE_UNITS,
    MOMENT_UNITS,
    SavedMotion,
    make_plug_in_gait_points,
)
from gaitcal.gait import event_checks, moments
from gaitcal.io import formats, result_folder, segment_poses, toml
from gaitcal.io.axes import AxisPermutation
from gaitcal.io.c3d.reader import POINT_UNITS_PER_METRE
from gaitcal.io.c3d.writer import (
    AddedPoint,
    C3DOriginal,
    PointKind,
    open_c3d_original,
    supplement_c3d,
    write_c3d,
)
from gaitcal.io.csv_recordings import EVENT_FILE
from gaitcal.io.labels import FootEvent
from gaitcal.io.recording import Recording, find_visible
from gaitcal.io.snapshot import Snapshot, read_whole
from gaitcal.quality.verdict import Judgement
from gaitcal.results.cycles_export import find_original, read_trial_files
from gaitcal.results.saved_result import MODEL, SPLINES, SavedWalk, list_moving_trials, load_trial
from gaitcal.results.summary import SUMMARY

PREFIX = "gc"  # Before our names where the file has points of such names already
SINGLE = 2.0**-23  # Relative rounding of a 32-bit float
SAME_TIME = 1e-6  # s
# m, between a marker of the file and of the result: both are the same number, turned by quarters
SAME_PLACE = 1e-6


def write_recordings(
    folder: Path, inputs: Path | None, out: Path, *, instead: bool = False
) -> tuple[dict[str, tuple[str, str, tuple[str, ...]]], Snapshot]:
    """Write a C3D file `TRIAL.c3d` for every moving trial of a result.

    Parameters
    ----------
    folder
        The result.
    inputs
        Folder of the recordings, if they are not beside the result.
    out
        Folder of the new files.
    instead
        Replace points of the same names by another program; else our points get other names.

    Returns
    -------
    dict
        Trial -> its input as the manifest names it, the SHA-256 of the input, and notes.
    Snapshot
        The files of the result that were read.

    Raises
    ------
    InputError
        The result or a recording is damaged, missing or changed.
    """
    files = read_trial_files(folder)
    names = list_moving_trials(folder)
    tables = [
        table
        for name in names
        for table in (f"markers/{name}.trc", f"moments/{name}.csv", f"forces/{name}.mot")
    ]
    tables = [table for table in tables if (folder / table).exists()]
    # All files of the result at one moment: a run in between would mix two results.
    saved, snapshot = read_whole(
        folder,
        (MODEL, SPLINES, SUMMARY, *tables),
        lambda: [load_trial(folder, k, name) for k, name in enumerate(names)],
    )
    written = {}
    for trial in saved:
        if "file" not in files.get(trial.name, {}):
            raise InputError(
                f"trial '{trial.name}' was not made from a file",
                source=folder,
                code=Code.CHANGED_FILE,
            )
        paths = {
            kind: find_original(folder, name, inputs) for kind, name in files[trial.name].items()
        }
        notes = _write_trial(
            trial, paths, out / f"{trial.name}.c3d", out / f".{trial.name}.c3d", instead=instead
        )
        source = files[trial.name]["file"]
        written[trial.name] = source, result_folder.compute_sha256(paths["file"]) or "", notes
    return written, snapshot


def _write_trial(
    trial: SavedWalk, paths: Mapping[str, Path], target: Path, between: Path, *, instead: bool
) -> tuple[str, ...]:
    """Write the C3D of one trial and return notes; `between` is a temporary file, removed again."""
    recording = formats.read_recording(paths["file"], forces=paths.get("forces"))
    notes: tuple[str, ...] = ()
    is_synthetic = segment_poses.has_poses(recording.labels)
    if is_synthetic and paths["file"].suffix.lower() == ".c3d":
        notes = (
            "written anew: without poses and events of the file, with the points that stand for "
            "its body",
        )
    # A C3D file is supplemented, and everything else of it stays. Other formats become C3D first.
    if paths["file"].suffix.lower() == ".c3d" and not is_synthetic:
        source, same = paths["file"], formats.read_recording(paths["file"])
    else:
        notes += _convert_to_c3d(recording, between)
        source, same = between, formats.read_recording(between)
    original = open_c3d_original(source, len(recording.time))
    # The study may use a section of the recording only.
    rows = _match_frames(recording.time, trial.motion.time, paths["file"])
    per_metre = POINT_UNITS_PER_METRE.get(original.get_unit("UNITS").strip().lower(), 1e3)
    turn = _find_file_axes(trial.markers, original.get_positions()[rows] / per_metre, paths["file"])
    kept = set(same.labels) if instead else set(original.labels)
    points, named = _build_points(trial, original, rows, turn, per_metre, kept)
    events, event_notes = _select_new_events(trial, recording, corrected="events" in paths)
    group = {
        "VERSION": [f"gaitcal {toml.get_package_version('gaitcal')}"],
        "TRIAL": [trial.name],
        **{key.upper(): [value] for key, value in trial.facts.items()},
        "REASONS": [text[:255] for text in trial.reasons[:255]],
        "PREFIX": [named],
    }
    units = {"ANGLE_UNITS": "deg", "MOMENT_UNITS": "Nmm", "POWER_UNITS": "W", "FORCE_UNITS": "N"}
    # Write, read back and compare: markers, plates and events must be as before.
    lost = supplement_c3d(original, target, points, events, ("GAITCAL", group), units)
    _require_same(same, formats.read_recording(target), target, exact=original.header.is_float)
    between.unlink(missing_ok=True)
    if not original.header.is_float:
        notes += ("the file was one of integers and is one of 32-bit floats now",)
    if lost:
        notes += (f"not copied as in the file: {', '.join(lost)}",)
    if named:
        hint = "" if instead else ", --replace writes them in place of the file's"
        notes += (f"the file has points of these names; ours begin with {named}{hint}",)
    if replaced := [point.name for point in points if point.name in original.labels]:
        other_points = "all other points and frames are those of the other program"
        notes += (
            f"{moments.format_count(len(replaced), 'point')} of the file replaced "
            f"({', '.join(replaced)}); {other_points}",
        )
    return (*_summarise_points(trial, points), *notes, *event_notes)


def _convert_to_c3d(recording: Recording, target: Path) -> tuple[str, ...]:
    """Write markers and plates of a recording as C3D, without plates that a C3D cannot contain."""
    filled, notes = _fill_last_frame(recording)
    try:
        write_c3d(target, filled)
    except InputError as fault:
        if not recording.plates:
            raise
        write_c3d(target, replace(recording, plates=()))
        why = str(fault).removeprefix(f"{target}: ")
        return (f"without its force plates, which a C3D cannot hold as they are ({why})",)
    return notes


def _fill_last_frame(recording: Recording) -> tuple[Recording, tuple[str, ...]]:
    """Repeat the last plate samples to fill the last frame of the C3D."""
    frames = len(recording.time)
    plates, longest = [], 0
    for plate in recording.plates:
        # C3D has the same number of plate samples in every marker frame.
        ratio = (len(plate.time) - 1) // max(1, frames - 1)
        more = ratio - 1 if ratio > 1 and len(plate.time) == ratio * (frames - 1) + 1 else 0
        step = float(np.median(np.diff(plate.time))) if more else 0.0
        plates.append(
            replace(
                plate,
                time=np.concatenate([plate.time, plate.time[-1] + step * np.arange(1, more + 1)]),
                force=_repeat_last(plate.force, more),
                point=_repeat_last(plate.point, more),
                moment=_repeat_last(plate.moment, more),
            )
        )
        longest = max(longest, more)
    note = f"the last sample of the plates repeated {longest} times, to fill the last frame"
    return replace(recording, plates=tuple(plates)), (note,) if longest else ()


def _repeat_last(values: Array, more: int) -> Array:
    """(ns + more, 3): the last row repeated."""
    return np.concatenate([values, np.repeat(values[-1:], more, axis=0)])


def _match_frames(file: Array, trial: Array, source: Path) -> IntArray:
    """Return the (nf,) frames of the file at the times of the trial."""
    rows = np.clip(np.searchsorted(file, trial - SAME_TIME), 0, len(file) - 1)
    if np.abs(file[rows] - trial).max() > SAME_TIME:
        message = "its frames are at other times than those of the result"
        raise InputError(message, source=source, code=Code.CHANGED_FILE)
    return np.asarray(rows, dtype=np.intp)


def _find_file_axes(markers: Recording, places: Array, source: Path) -> AxisPermutation:
    """Find the permutation of axes from the result to the file by comparing marker coordinates.

    Each marker has the same numbers in both, in another order and with other signs. `places`: (nf,
    np, 3) m, the points of the file.
    """
    visible = find_visible(markers.markers)
    frames = np.flatnonzero(visible.sum(axis=1) >= min(3, visible.sum(axis=1).max()))
    # a few frames are enough, as marker positions must agree exactly
    frames = frames[:: max(1, len(frames) // 5)]
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            # A reflection would exchange right and left.
            if np.linalg.det(matrix) < 0:
                continue
            axes = AxisPermutation((order[0], order[1], order[2]), (signs[0], signs[1], signs[2]))
            if len(frames) and all(
                _are_among(axes.apply(markers.markers[i, visible[i]]), places[i]) for i in frames
            ):
                return axes
    raise InputError(
        "its markers are not those of the result", source=source, code=Code.CHANGED_FILE
    )


def _are_among(wanted: Array, among: Array) -> bool:
    """Return whether every point (n, 3) equals one of the others (m, 3)."""
    gaps = np.abs(wanted[:, None] - among[None]).max(axis=2)
    return bool((np.nanmin(gaps, axis=1) < SAME_PLACE).all())


def _build_points(
    trial: SavedWalk,
    original: C3DOriginal,
    rows: IntArray,
    turn: AxisPermutation,
    per_metre: float,
    kept: set[str],
) -> tuple[list[AddedPoint], str]:
    """Build our points in the frames, axes and units of the file, and the prefix of their names.

    The prefix keeps names of `kept` points free.
    """
    motion = SavedMotion(
        q=trial.motion.q,
        velocity=trial.motion.velocity,
        torques=trial.torques,
        valid=trial.valid,
        mass=trial.model.subject.mass,
        parameters=trial.model.parameters,
        reactions=trial.reactions,
        frozen=tuple(trial.model.frozen),
    )
    angle = ANGLE_UNITS.get(original.get_unit("ANGLE_UNITS").strip().lower(), ANGLE_UNITS["deg"])
    moment = MOMENT_UNITS.get(
        original.get_unit("MOMENT_UNITS").strip().lower(), MOMENT_UNITS["nmm"]
    )
    points = make_plug_in_gait_points(motion, angle, moment)
    heads = {label.partition(":")[0] for label in original.labels if ":" in label}
    head = f"{heads.pop()}:" if len(heads) == 1 else ""

    def is_free(prefix: str) -> bool:
        return kept.isdisjoint(f"{head}{prefix}{point.name}" for point in points)

    # the first prefix with which no name of the file is taken
    start = next(filter(is_free, ("", PREFIX, *(f"{PREFIX}{n}" for n in range(2, 100)))))
    out = []
    for point in points:
        values = np.full((original.frames, 3), np.nan)
        # Positions are in axes and unit of the file; angles and moments have no laboratory axes.
        places = point.kind is PointKind.POSITION
        values[rows] = turn.apply(point.values) * per_metre if places else point.values
        out.append(replace(point, name=f"{head}{start}{point.name}", values=values))
    return out, start


def _select_new_events(
    trial: SavedWalk, recording: Recording, *, corrected: bool
) -> tuple[list[FootEvent], tuple[str, ...]]:
    """Select the events of a walk that the file lacks, in order of time.

    None are added if the events of the file were corrected.
    """
    if not trial.events:
        return [], ()
    # Events that the user corrected may contradict those of the file; both together would be wrong.
    if corrected and recording.events:
        return [], (
            f"{len(recording.events)} events of the file kept; those that were corrected stand in "
            f"{EVENT_FILE}",
        )

    def is_known(event: FootEvent) -> bool:
        return any(
            e.side == event.side
            and e.moment is event.moment
            and abs(e.time - event.time) < event_checks.SAME_EVENT
            for e in recording.events
        )

    new = [event for event in trial.events if not is_known(event)]
    kept = f"{len(recording.events)} events of the file kept, " if recording.events else ""
    return new, (f"{kept}{len(new)} events added",)


def _require_same(old: Recording, new: Recording, target: Path, *, exact: bool) -> None:
    """InputError unless markers, plates and the file's own events read back as they were."""
    same = old.labels == new.labels and len(old.plates) == len(new.plates)
    if same:
        rounding = 0.0 if exact else SINGLE
        same = np.allclose(old.markers, new.markers, rtol=rounding, atol=0.0, equal_nan=True)
    same = same and all(
        np.array_equal(a.wrench(), b.wrench()) for a, b in zip(old.plates, new.plates, strict=True)
    )
    if not (same and set(old.events) <= set(new.events)):
        message = "reads back with other markers, plates or events; please report it"
        raise InputError(message, source=target, code=Code.INTERNAL)


POINT_TITLES = {
    PointKind.ANGLE: "angles",
    PointKind.POSITION: "joint centres",
    PointKind.MOMENT: "moments",
    PointKind.POWER: "powers",
    PointKind.FORCE: "ground reactions",
}


def _summarise_points(trial: SavedWalk, points: list[AddedPoint]) -> tuple[str, ...]:
    """List the kinds of points that were added, and why others are missing."""
    counts = Counter(point.kind for point in points)
    parts = [f"{counts[kind]} {title}" for kind, title in POINT_TITLES.items() if counts[kind]]
    summary = (", ".join(parts),)
    if Judgement.REFUSED.value in trial.facts.values() and trial.torques is None:
        return (*summary, "the trial is refused: no moments and no powers")
    if trial.torques is None:
        return (*summary, "no force plates, so no moments and no powers")
    shares = ", ".join(
        f"{side} leg {100 * trial.valid[s].mean():.0f} %"
        for s, side in (("r", "right"), ("l", "left"))
    )
    return (*summary, f"moments and powers in valid frames: {shares}")
