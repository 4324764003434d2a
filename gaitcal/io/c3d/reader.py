"""Read the measured markers and the force plates of a C3D file, in m and s, y up.

A damaged file can make a parser of binary data crash, hang, or ask for all memory. Of 250 real
files with up to 40 bytes changed among their first 1500, eleven ended ezc3d 1.7 by a segmentation
fault and two never returned. ezc3d therefore runs in a separate process that parses one file after
the other. A new process starts when it has died.
"""

import atexit
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code
from gaitcal.io import axes, segment_poses
from gaitcal.io import labels as labelling
from gaitcal.io.c3d import layout
from gaitcal.io.c3d.layout import WORD, C3DHeader
from gaitcal.io.c3d.plates import orient_plates, read_force_plates
from gaitcal.io.recording import Recording, replace_zeros
from gaitcal.io.text_file import FileFault, name_file_in_faults

POINT_UNITS_PER_METRE = {
    "mm": 1e3,
    "millimeters": 1e3,
    "millimetres": 1e3,
    "cm": 1e2,
    "m": 1.0,
    "meters": 1.0,
    "metres": 1.0,
}
"""Lengths that POINT:UNITS may name."""
# Largest coordinate (m) of a measured position; only a damaged float exceeds it
LARGEST_COORDINATE_M = 1e6
# Largest error of the products of the axes of a pose: files hold single precision
ORTHONORMAL_TOLERANCE = 1e-3
NON_POSITION_GROUPS = ("ANGLES", "MOMENTS", "FORCES", "POWERS", "SCALARS", "REACTIONS")
"""POINT parameters that list points which are no positions: angles, moments and the like."""
COMPUTED_GROUPS = (*NON_POSITION_GROUPS, "MODELED_MARKERS")
"""POINT parameters that list computed points, besides those named in TYPE_GROUPS."""
USUAL_VERTICAL = axes.Vertical(2, 1, "the usual practice, as the data do not show it")

# ------------------------------------------------------------------------- ezc3d in its own process

# Longest start of the parser process (s); on a busy machine it loads its libraries slowly
START_SECONDS = 120.0
# Longest time for a small file (s); a sound one takes 0.1 s, and nobody should wait 10 s
BASE_SECONDS = 6.0
SECONDS_PER_BYTE = 1e-6
BASE_MEMORY = 2**30
MEMORY_PER_BYTE = 100
"""Bytes of memory allowed per byte of the file: 16-bit samples become doubles, several times."""
GROUPS = (
    "POINT",
    "ANALOG",
    "FORCE_PLATFORM",
    "TRIAL",
    "EVENT",
    "PROCESSING",
    "SUBJECTS",
    "ROTATION",
)
PARSER_FAULTS = (
    RuntimeError,
    ValueError,
    IndexError,
    KeyError,
    TypeError,
    OverflowError,
    MemoryError,
    OSError,
    SystemError,
)
"""Exceptions of ezc3d and its wrapper on files that they cannot read."""


class ParserDiedError(Exception):
    """The parser process ended, or was ended, without an answer; the text describes how."""


def parse_c3d(path: Path, size: int) -> dict[str, Any]:
    """Parse a C3D file in the parser process.

    `path`: the file. `size`: its size, bytes; it limits time and memory. Returns: `points` (3, np,
    nf) with NaN for missing, `poses` (4, 4, ns, nf or more), `analogs` (na, ns), `parameters`,
    rates and first frame, in the units of the file. Raises ValueError: the parser refuses the file;
    its message. Raises ParserDiedError: the parser did not survive the file.
    """
    kind, content = _PARSER.parse(
        str(path.absolute()), size, BASE_SECONDS + SECONDS_PER_BYTE * size
    )
    if kind == "fault":
        raise ValueError(content)
    return dict(content)


class _Parser:
    """The parser process, used by one thread at a time."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._one_at_a_time = threading.Lock()
        atexit.register(self.end)

    def parse(self, path: str, size: int, seconds: float) -> tuple[str, Any]:
        """Ask for a file; return `content` and its content, or `fault` and the reason."""
        with self._one_at_a_time:
            try:
                if self._process is None:
                    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
                    code = f"import sys; sys.path[:] = {[folder for folder in sys.path if folder]}"
                    command = [
                        sys.executable,
                        "-c",
                        f"{code}; from gaitcal.io.c3d.reader import serve; serve()",
                    ]
                    self._process = subprocess.Popen(
                        command, stdin=pipe, stdout=pipe, stderr=nowhere
                    )
                    self._ask(None, START_SECONDS)
                kind, content = self._ask((path, size), seconds)
            except BaseException:
                # Also Ctrl-C: a late answer must not be taken for that of the next file
                self.end()
                raise
            if kind == "fault":
                # A parser that met a damaged file reads no other
                self.end()
            return kind, content

    def _ask(self, question: tuple[str, int] | None, seconds: float) -> Any:
        """Send a question and return the answer; without one, wait until the process is ready."""
        process = self._process
        if process is None or process.stdin is None or process.stdout is None:
            raise ParserDiedError("it did not begin")
        began = time.monotonic()
        clock = threading.Timer(seconds, process.kill)
        clock.start()
        try:
            if question is not None:
                pickle.dump(question, process.stdin)
                process.stdin.flush()
            return pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            code = process.wait()
            if time.monotonic() - began >= seconds:
                raise ParserDiedError(f"it took longer than {seconds:.0f} s") from None
            how = f"it ended by signal {-code}" if code < 0 else f"it ended with code {code}"
            raise ParserDiedError(how) from None
        finally:
            clock.cancel()

    def end(self) -> None:
        """End the process, if there is one."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()


_PARSER = _Parser()
# A forked process starts a new parser
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_PARSER.__init__)  # type: ignore[misc]


def serve() -> None:
    """Parse one file after the other until the caller has gone; discard what the library prints."""
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        import ezc3d  # noqa: F401  before the first file's time begins

        pickle.dump("ready", out)
        while True:
            out.flush()
            try:
                path, size = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            _limit_memory(BASE_MEMORY + MEMORY_PER_BYTE * size)
            try:
                answer: tuple[str, Any] = ("content", _read_content(path))
            except PARSER_FAULTS as error:
                answer = ("fault", str(error) or type(error).__name__)
            pickle.dump(answer, out, protocol=5)


def _limit_memory(more: int) -> None:
    if sys.platform != "linux":
        return
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + more
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard == resource.RLIM_INFINITY or limit < hard:
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _read_content(path: str) -> dict[str, Any]:
    import ezc3d

    file = ezc3d.c3d(path)
    points = file["data"]["points"][:3]
    if points.shape[1]:
        residuals = np.asarray(file["data"]["meta_points"]["residuals"])[0]
        points[:, residuals < 0] = np.nan
    parameters: dict[str, dict[str, Any]] = {}
    for group in GROUPS:
        content = file["parameters"].get(group, {})
        parameters[group] = {
            name: entry["value"] for name, entry in content.items() if name != "__METADATA__"
        }
    header = file["header"]
    return {
        "points": np.ascontiguousarray(points),
        "poses": np.ascontiguousarray(file["data"]["rotations"]),
        "analogs": np.ascontiguousarray(file["data"]["analogs"][0]),
        "parameters": parameters,
        "first_frame": int(header["points"]["first_frame"]),
        "rate": float(header["points"]["frame_rate"]),
    }


# ------------------------------------------------------------------------------------ the recording


@name_file_in_faults
def read_c3d(path: Path) -> Recording:
    """Read markers and plates of a C3D file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Recording
        Metres, seconds and newtons, y up.

    Raises
    ------
    InputError
        The file cannot be read, or names no marker.
    """
    header = layout.check_c3d_header(path)
    try:
        raw = parse_c3d(path, header.size)
    except ValueError as error:
        raise FileFault(_describe_damage(path, str(error)), code=Code.DAMAGED_RECORDING) from None
    except ParserDiedError as error:
        raise FileFault(
            f"damaged: the parser did not survive it, {error}", code=Code.DAMAGED_RECORDING
        ) from None
    try:
        return _build_recording(path, header, raw)
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise FileFault(_describe_damage(path, str(error)), code=Code.DAMAGED_RECORDING) from None


def _describe_damage(path: Path, error: str) -> str:
    """Describe a file that a library cannot read by its format, not by the library's error."""
    found = "numbers in its header and its parameters contradict each other"
    if any(word in error for word in ("alloc", "Memory", "length_error", "vector")):
        found = "a number in its header or parameters asks for more data than the file can hold"
    found = layout.find_damage(path.read_bytes()) or found
    return f"damaged: {found}; export it again from the program that recorded it"


def _build_recording(path: Path, header: C3DHeader, raw: Mapping[str, Any]) -> Recording:
    parameters: Mapping[str, Mapping[str, Any]] = raw["parameters"]
    points: Array = raw["points"]
    analogs: Array = raw["analogs"]
    if not points.shape[1] and not raw["poses"].shape[2]:
        found = (
            f"found no marker, only {len(analogs)} analog channels"
            if len(analogs)
            else "found no marker"
        )
        raise FileFault(f"{found}; labelled markers are needed, the plates in the same file")
    rate = _read_rate(parameters, float(raw["rate"]))
    per_metre, notes = _read_unit(parameters)
    if not raw["poses"].shape[2] and (
        whole := layout.find_sample_layout(header, parameters, points, analogs)
    ):
        counted, (points, analogs) = points.shape[2], layout.read_samples(path, whole, parameters)
        note = (
            "ANALOG parameters are missing or do not fit the data, which were laid out after the "
            "header."
        )
        if points.shape[2] != counted:
            note = (
                f"The header counts {counted} frames; {points.shape[2]} were read, as many as fill "
                "the file."
            )
        notes += (note,)
    frames = points.shape[2]
    if frames < 1:
        raise FileFault("found no frame of points; at least one is needed")
    first, first_notes = _read_first_frame(parameters, int(raw["first_frame"]))
    notes += first_notes
    computed: dict[str, int] = {}
    poses, names = _read_poses(parameters, raw["poses"], frames, per_metre)
    if points.shape[1] or not names:
        keep, labels, label_notes, computed = _select_markers(parameters, points.shape[1])
        segment_poses.refuse_origins(labels)
        markers = np.ascontiguousarray(points[:, keep].transpose(2, 1, 0)) / per_metre
        if names:
            label_notes += (f"{len(names)} segment poses left out, as the file has markers.",)
    else:
        labels, markers, label_notes = segment_poses.compute_pose_points(names, poses)
    notes += label_notes
    absurd = (np.abs(markers) > LARGEST_COORDINATE_M).any(axis=2)
    if absurd.any():
        notes += (
            f"{int(absurd.sum())} positions beyond {LARGEST_COORDINATE_M:g} m, damaged numbers, "
            "taken as gaps.",
        )
        markers[absurd] = np.nan
    markers, gap_notes = replace_zeros(markers)
    ratio = analogs.shape[1] / frames
    plates, plate_notes = read_force_plates(
        parameters, analogs, first * ratio, rate * ratio, 1.0 / per_metre, markers
    )
    vertical = (
        axes.find_vertical(markers, tuple(plate.to_force_plate() for plate in plates))
        or USUAL_VERTICAL
    )
    oriented_plates, orientation_notes = orient_plates(plates, vertical.direction)
    notes += gap_notes + plate_notes + orientation_notes
    time = (first + np.arange(frames)) / rate
    recording = Recording(
        source=str(path),
        time=time,
        labels=labels,
        markers=markers,
        plates=oriented_plates,
        notes=notes,
        events=labelling.parse_events(parameters),
        facts=labelling.parse_facts(parameters),
        computed=_collect_computed(computed, points, per_metre),
    )
    return (
        recording
        if axes.UP_TO_Y[vertical.axis, vertical.sign].is_identity
        else axes.rotate_vertical_to_y(recording, vertical)
    )


def _read_poses(
    parameters: Mapping[str, Mapping[str, Any]], poses: Array, frames: int, per_metre: float
) -> tuple[Array, tuple[str, ...]]:
    """Read segment poses (nf, ns, 4, 4) m, NaN if unknown, and the names of the segments."""
    names = tuple(
        labelling.clean_label(label)
        for label in _read_texts(parameters.get("ROTATION", {}), "LABELS")
    )[: poses.shape[2]]
    if not names or not frames:
        return np.empty((frames, 0, 4, 4)), ()
    each = poses.shape[3] // frames
    if each * frames != poses.shape[3]:
        found = (
            f"found {poses.shape[3]} poses of each segment; allowed: as many for each of the "
            f"{frames} frames"
        )
        raise FileFault(found, "ROTATION", Code.DAMAGED_RECORDING)
    out = np.array(poses[:, :, : len(names), ::each].transpose(3, 2, 0, 1))
    out[..., :3, 3] /= per_metre
    turns = out[..., :3, :3]
    proper = (
        np.abs(turns @ turns.swapaxes(-1, -2) - np.eye(3)).max(axis=(-2, -1))
        < ORTHONORMAL_TOLERANCE
    )
    proper &= np.linalg.det(np.nan_to_num(turns)) > 0.0
    # Lost poses are written as zeros or as no rotations
    proper &= (np.abs(out[..., :3, 3]) < LARGEST_COORDINATE_M).all(axis=-1)
    out[~proper] = np.nan
    return out, names


def _read_rate(parameters: Mapping[str, Mapping[str, Any]], header: float) -> float:
    values = np.asarray(parameters.get("POINT", {}).get("RATE", []), dtype=np.float64).ravel()
    for rate in [*values.tolist(), header]:
        if np.isfinite(rate) and 0.1 <= rate <= 1e5:
            return float(rate)
    raise FileFault(
        f"found {header:g} Hz; 0.1 to 100000 are allowed", "POINT:RATE", Code.DAMAGED_RECORDING
    )


def _read_first_frame(
    parameters: Mapping[str, Mapping[str, Any]], header: int
) -> tuple[int, tuple[str, ...]]:
    """Read the number of frames before the first one, from TRIAL if the counter overflowed.

    A note reports a counter at its limit without TRIAL.
    """
    stopped = header >= WORD - 2
    start = layout.read_long_number(parameters.get("TRIAL", {}).get("ACTUAL_START_FIELD", ()))
    if (
        start is not None
        and start > 0
        and ((start - 1 - header) % WORD == 0 or (stopped and start > header))
    ):
        return start - 1, ()
    note = (
        f"The first frame is {WORD - 1}, the greatest that the header can hold: times may begin "
        "later."
    )
    return max(0, header), (note,) if stopped else ()


def _read_unit(parameters: Mapping[str, Mapping[str, Any]]) -> tuple[float, tuple[str, ...]]:
    units = parameters.get("POINT", {}).get("UNITS", [])
    name = labelling.clean_label(str(units[0])) if len(units) else ""
    if name.lower() in POINT_UNITS_PER_METRE:
        return POINT_UNITS_PER_METRE[name.lower()], ()
    given = f"'{name[:20]}'" if name else "no unit"
    return 1e3, (f"POINT:UNITS is {given}; millimetres were assumed.",)


def _read_texts(group: Mapping[str, Any], name: str) -> list[str]:
    """Read a list of texts with its continuations NAME2, NAME3, ... (255 entries each)."""
    texts: list[str] = []
    for number in range(1, 100):
        part = group.get(name if number == 1 else f"{name}{number}")
        if part is None or not all(isinstance(text, str) for text in part):
            break
        texts += list(part)
    return texts


def _select_markers(
    parameters: Mapping[str, Mapping[str, Any]], count: int
) -> tuple[list[int], tuple[str, ...], tuple[str, ...], dict[str, int]]:
    """Select the measured, named markers among `count` points.

    Returns their columns, their names, notes on the other points, and the computed points that are
    positions (label -> column).
    """
    group = parameters.get("POINT", {})
    labels = [labelling.clean_label(label) for label in _read_texts(group, "LABELS")][:count]
    labels += [""] * (count - len(labels))
    named = [i for i, label in enumerate(labels) if not labelling.is_unlabelled(label)]
    notes: tuple[str, ...] = ()
    if count > len(named):
        notes += (f"{count - len(named)} unlabelled trajectories left out.",)
    if not named:
        raise FileFault(
            f"found {count} trajectories, none with a name; labelled markers are needed"
        )
    listed = _find_listed_as_computed(group)
    prefix, prefix_notes = labelling.find_common_prefix(
        [labels[i] for i in named if labels[i] not in listed]
    )
    spelt = {i: labels[i].removeprefix(prefix) for i in named}
    by_spelling = labelling.find_computed_points(list(spelt.values()))
    keep = [i for i in named if labels[i] not in listed and spelt[i] not in by_spelling]
    dropped = [spelt[i] for i in named if i not in set(keep)]
    if dropped:
        notes += (f"{len(dropped)} computed points, not markers, left out: {', '.join(dropped)}.",)
    if not keep:
        raise FileFault(f"all {len(named)} named points are computed ones; markers are needed")
    names, repetition_notes = labelling.number_repetitions(spelt[i] for i in keep)
    numbers = _find_listed_as_computed(group, NON_POSITION_GROUPS)
    places = {
        spelt[i]: i
        for i in named
        if i not in set(keep) and labels[i] not in numbers and not labelling.is_number(spelt[i])
    }
    return keep, names, notes + prefix_notes + repetition_notes, places


def _collect_computed(
    places: Mapping[str, int], points: Array, per_metre: float
) -> labelling.ComputedPoints | None:
    if not places:
        return None
    values = points[:, list(places.values())].transpose(2, 1, 0) / per_metre
    known = (
        np.isfinite(values).all(axis=2)
        & (np.abs(values) <= LARGEST_COORDINATE_M).all(axis=2)
        & (values != 0).any(axis=2)
    )
    return labelling.ComputedPoints(tuple(places), np.where(known[:, :, None], values, np.nan))


def _find_listed_as_computed(group: Mapping[str, Any], groups: Sequence[str] = ()) -> set[str]:
    """Find labels in these parameters; without `groups`, in all that list computed points."""
    names = groups or [
        *COMPUTED_GROUPS,
        *(labelling.clean_label(text) for text in _read_texts(group, "TYPE_GROUPS")),
    ]
    return {
        labelling.clean_label(label)
        for name in names
        if name != "LABELS"
        for label in _read_texts(group, name)
    }
