"""Read and write files of OpenSim: markers in TRC, ground reactions in MOT and STO, ExternalLoads.

TRC (Motion Analysis): marker coordinates, tab-separated. Marker names, data columns and frames are
counted instead of read from the header, and times are those of the Time column. Line 3 gives the
unit; the vertical is found from the data.

MOT, STO (OpenSim, SIMM): the header ends at `endheader`; its counts are not used. Files of forces
are in m, N and N·m, as OpenSim's ExternalLoads define, and no offset is removed. They have y up; a
file with forces along another axis is rotated as markers are (`axes.py`).

ExternalLoads (`grf.xml`): a table of forces (`datafile`, relative to its folder; it overrides the
`data_source_name` of single forces). Each ExternalForce has a body and the beginning of its column
names: with `ground_force_v` the columns are `ground_force_vx`, `_vy`, `_vz`. Each becomes a plate
of that name on the foot of that body. A force on another body than a foot, or one expressed in the
frame of a moving body, is refused.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from pathlib import Path, PureWindowsPath

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError, find_side, suggest_name
from gaitcal.io import atomic, axes, text_file
from gaitcal.io.force_tables import (
    Forces,
    PlateColumns,
    build_plate,
    find_plates,
    orient_forces,
    tabulate_plates,
)
from gaitcal.io.labels import clean_label, find_common_prefix, is_unlabelled, number_repetitions
from gaitcal.io.recording import ForcePlate, Recording, replace_zeros, require_plain_labels

TRC_UNITS_PER_METRE = {"mm": 1000.0, "cm": 100.0, "m": 1.0, "millimeters": 1000.0, "meters": 1.0}
LONGEST_HEADER = 20
AXIS_LINE = re.compile(r"(\s*[XYZ]\d+)*\s*", re.IGNORECASE)  # X1 Y1 Z1 X2 ..., or nothing
USUAL_VERTICAL = axes.Vertical(1, 1, "the usual practice, as the data do not show it")

# ---------------------------------------------------------------------------------------------- TRC


def read_trc(path: Path) -> Recording:
    """Read the markers of a TRC file.

    `path`: the file. Returns: metres, y up. Raises InputError: the file cannot be read.
    """
    return axes.make_y_up(parse_trc(path), USUAL_VERTICAL)


@text_file.name_file_in_faults
def parse_trc(path: Path) -> Recording:
    """Read the markers of a TRC file in the axes of the file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Recording
        Metres.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    lines = [_collapse_double_tabs(line) for line in text_file.read_lines(path)]
    starts = [line.split("\t")[0].strip().lower() for line in lines[:LONGEST_HEADER]]
    label_line = next((i for i, start in enumerate(starts) if start.startswith("frame#")), None)
    if label_line is None:
        needed = f"a line that begins with 'Frame#' is needed among the first {LONGEST_HEADER}"
        raise text_file.FileFault(f"found no line of marker names; {needed}")
    separator = "\t" if "\t" in lines[label_line] else None
    facts = _read_header_values(lines[:label_line])
    start = label_line + 1
    while start < len(lines) and AXIS_LINE.fullmatch(lines[start]):
        start += 1
    width = len(lines[start].rstrip().split(separator)) if start < len(lines) else 0
    names = _parse_marker_names(lines[label_line], separator, width)
    # Cortex writes unnamed trajectories after the others, without a cell in the line of names
    widest = max((len(line.rstrip().split(separator)) for line in lines[start:]), default=0)
    unnamed, rest = divmod(widest - 2 - 3 * len(names), 3)
    names += [""] * (unnamed if rest == 0 else 0)
    table = text_file.parse_rows(lines, start, 2 + 3 * len(names), separator, short_step=3)
    text_file.require_increasing(table.values[:, 1], table.lines)
    time, notes = text_file.undo_rounding(table.values[:, 1])
    frames = len(time)
    if table.filled_rows:
        notes += (
            f"{table.filled_rows} rows end before their last markers, which were taken as gaps.",
        )
    if facts.get("numframes", str(frames)) not in (str(frames), f"{frames}.0"):
        notes += (f"Header declares {facts['numframes'][:20]} frames; {frames} found.",)
    keep = [i for i, name in enumerate(names) if not is_unlabelled(name)]
    if len(keep) < len(names):
        notes += (f"{len(names) - len(keep)} unlabelled trajectories left out.",)
    if not keep:
        raise text_file.FileFault("found no marker with a name", f"line {label_line + 1}")
    unit = TRC_UNITS_PER_METRE.get(facts.get("units", "mm").lower())
    if unit is None:
        name = facts["units"]
        raise text_file.FileFault(
            f"found '{name[:20]}'; allowed are mm, cm and m"
            f"{suggest_name(name, TRC_UNITS_PER_METRE)}",
            "Units",
        )
    if "units" not in facts:
        notes += ("The header names no unit; millimetres were taken.",)
    markers = table.values[:, 2:].reshape(frames, len(names), 3)[:, keep] / unit
    markers, gap_notes = replace_zeros(markers)
    prefix, prefix_notes = find_common_prefix([names[i] for i in keep])
    labels, repetition_notes = number_repetitions(names[i].removeprefix(prefix) for i in keep)
    notes += gap_notes + prefix_notes + repetition_notes
    return Recording(source=str(path), time=time, labels=labels, markers=markers, notes=notes)


@text_file.name_file_in_faults
def write_trc(path: Path, recording: Recording) -> None:
    """Write markers as a TRC file in metres, y up; numbers read back to the same bits.

    A gap is NaN, as OpenSim refuses a row that ends with an empty cell.

    Parameters
    ----------
    path
        File to write.
    recording
        Markers, m.

    Raises
    ------
    InputError
        A name cannot be written as text, or the file cannot be written.
    """
    require_plain_labels(recording)
    rate = recording.rate if len(recording.time) > 1 else 0.0
    frames, markers = len(recording.time), len(recording.labels)
    rows = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:.6g}\t{rate:.6g}\t{frames}\t{markers}\tm\t{rate:.6g}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(recording.labels) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(markers) for axis in "XYZ"),
        "",
    ]
    with (
        atomic.write_atomically(path) as part,
        part.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.write("\n".join(rows) + "\n")
        numbers = text_file.format_number_lines(
            np.column_stack([recording.time, recording.markers.reshape(frames, -1)]), "\t", "NaN"
        )
        file.writelines(
            f"{index}\t{line}"
            for index, line in enumerate(numbers.splitlines(keepends=True), start=1)
        )


def _read_header_values(lines: Sequence[str]) -> dict[str, str]:
    """Read the two header lines of keys and values, keys in lower case."""
    for keys, values in pairwise(lines):
        if "units" in keys.lower():
            separator = "\t" if "\t" in keys else None
            given = [keys.lower().split(separator), values.split(separator)]
            # Tabs may be doubled in one of the two lines
            filled = [list(filter(str.strip, cells)) for cells in given]
            names, entries = filled if len(filled[0]) == len(filled[1]) else given
            return {key.strip(): entry.strip() for key, entry in zip(names, entries, strict=False)}
    return {}


def _collapse_double_tabs(line: str) -> str:
    """Collapse the tabs of a line where all of them are doubled, as some programs write.

    A gap in a line with single tabs leaves some tabs single, so that the line is unchanged.
    """
    runs = re.findall(r"\t+", line.rstrip())
    doubled = bool(runs) and all(len(run) % 2 == 0 for run in runs) and not line.startswith("\t")
    return line.replace("\t\t", "\t") if doubled else line


def _parse_marker_names(line: str, separator: str | None, width: int) -> list[str]:
    """Parse marker names by position, three columns each; by order if only that fits `width`."""
    cells = [clean_label(cell) for cell in line.split(separator)]
    # Some files have further tabs before 'Time'
    first = next((i for i, cell in enumerate(cells[1:], start=1) if cell), 0)
    cells = cells[:1] + cells[first:]
    if len(cells) < 3 or cells[1].lower() != "time":
        raise text_file.FileFault(
            "'Frame#' must be followed by 'Time' and marker names", "marker names"
        )
    filled = [i for i, cell in enumerate(cells[2:]) if cell]
    if not filled:
        raise text_file.FileFault("found no marker name after 'Time'", "marker names")
    by_place = all(i % 3 == 0 for i in filled) and (len(filled) > 1 or len(cells) > 3)
    if by_place and not (width < 2 + filled[-1] + 1 and width == 2 + 3 * len(filled)):
        return cells[2 : 2 + filled[-1] + 1 : 3]
    return [cells[2 + i] for i in filled]


# ----------------------------------------------------------------------------------------- MOT, STO

MOT_LONGEST_HEADER = 500


@dataclass(frozen=True)
class StorageTable:
    """Content of a MOT or STO file."""

    time: Array  # (rows,) s, as written
    names: tuple[str, ...]  # Columns after time
    values: Array  # (rows, columns), in the units of the file
    in_degrees: bool | None  # Unit of angles by the header; None if not given

    def get_column(self, name: str) -> Array:
        """Get the values (rows,) of one column."""
        return np.asarray(self.values[:, self.names.index(name)])

    def format_text(self, title: str, comments: tuple[str, ...] = ()) -> str:
        """Format the table as the text of a file; numbers read back to the same bits.

        Parameters
        ----------
        title
            First line.
        comments
            Further lines of the header.

        Returns
        -------
        str
            Text of the file.
        """
        header = [
            title,
            "version=1",
            f"nRows={len(self.time)}",
            f"nColumns={len(self.names) + 1}",
            f"inDegrees={'yes' if self.in_degrees else 'no'}",
            *comments,
            "endheader",
            "\t".join(("time", *self.names)),
        ]
        return (
            "\n".join(header)
            + "\n"
            + text_file.format_number_lines(
                np.column_stack([self.time, self.values]), "\t", missing="nan"
            )
        )


def read_table(path: str | PathLike[str]) -> StorageTable:
    """Read any MOT or STO table.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    StorageTable
        Values in the units of the file.

    Raises
    ------
    InputError
        The file cannot be read; one line with file, field, the value found and the allowed ones.
    """
    return _read_table(Path(path))


@text_file.name_file_in_faults
def _read_table(path: Path) -> StorageTable:
    lines = text_file.read_lines(path)
    header = [line.strip().lower() for line in lines[:MOT_LONGEST_HEADER]]
    if "endheader" not in header:
        raise text_file.FileFault(f"found no line 'endheader' among the first {MOT_LONGEST_HEADER}")
    end = header.index("endheader")
    first = next((i for i in range(end + 1, len(lines)) if lines[i].strip()), None)
    if first is None:
        raise text_file.FileFault("the file ends after its header")
    separator = "\t" if "\t" in lines[first] else None
    names = [name.strip() for name in lines[first].rstrip().split(separator)]
    if names[0].lower() != "time":
        raise text_file.FileFault(
            f"found '{names[0][:40]}'; the first column must be 'time'", f"line {first + 1}"
        )
    rows = text_file.parse_rows(lines, first + 1, len(names), separator)
    time = rows.values[:, 0]
    text_file.require_increasing(time, rows.lines)
    entries = (line.partition("=") for line in header[:end])
    angles = next((value.strip() for key, _, value in entries if key.strip() == "indegrees"), None)
    in_degrees = None if angles is None else angles in ("yes", "true", "1")
    return StorageTable(time, tuple(names[1:]), rows.values[:, 1:], in_degrees)


@text_file.name_file_in_faults
def read_mot_forces(path: Path) -> Forces:
    """Read plates "1", "2", ... of a MOT or STO file, in order of their columns.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Forces
        m, N, N·m, y up.

    Raises
    ------
    InputError
        The file cannot be read, or has no force columns.
    """
    table = read_table(path)
    found = find_plates(table.names)
    if not found:
        names = ", ".join(table.names[:6])
        raise text_file.FileFault(
            f"found no force columns among {names}...; names like ground_force_vx are needed"
        )
    time, notes = text_file.undo_rounding(table.time)
    plates = []
    for number, columns in enumerate(found, start=1):
        plate, plate_notes = build_plate(str(number), time, table.values, columns)
        plates.append(plate)
        notes += (
            *plate_notes,
            f"Plate {number} holds the columns {columns.names[0]} and following.",
        )
    return orient_forces(path, plates, notes)


@text_file.name_file_in_faults
def write_forces_mot(path: Path, plates: tuple[ForcePlate, ...]) -> None:
    """Write plates with common times as an OpenSim MOT file.

    Columns are ground_force_1_vx, _px, ground_moment_1_mx, and so on.

    Parameters
    ----------
    path
        File to write.
    plates
        Plates, m, N, N·m, y up.

    Raises
    ------
    InputError
        The plates have different times, or the file cannot be written.
    """
    time, values = tabulate_plates(plates)
    kinds = ("ground_force_{}_v", "ground_force_{}_p", "ground_moment_{}_m")
    names = []
    for k in range(len(plates)):
        for kind in kinds:
            for axis in "xyz":
                names.append(f"{kind.format(k + 1)}{axis}")
    atomic.write_text_atomically(
        path, StorageTable(time, tuple(names), values, True).format_text(path.name)
    )


# ------------------------------------------------------------------------------------ ExternalLoads

FOOT_BODY = re.compile(
    r"calc|foot|toe|talus|heel|mtp|forefoot|hindfoot|rearfoot|midfoot", re.IGNORECASE
)
"""Names of bodies of a foot in common models."""
GROUND_NAMES = ("", "ground", "/ground", "/", "unassigned")
NO_COLUMNS = ("", "unassigned")  # Identifiers that name no columns


@dataclass(frozen=True, kw_only=True)
class ExternalForce:
    """One force of an ExternalLoads file as written there."""

    name: str
    body: str
    frames: dict[str, str]  # `force` and `point` -> the body in whose frame they are expressed
    columns: dict[str, str]
    """`force`, `point`, `moment` -> beginning of its column names; empty if not given."""
    table: str  # File of its columns, as written; empty if not given


@text_file.name_file_in_faults
def read_external_loads(path: Path) -> Forces:
    """Read the plates of an ExternalLoads file, and the foot of each.

    Parameters
    ----------
    path
        The .xml file.

    Returns
    -------
    Forces
        m, N, N·m, y up; `feet` has the foot of each plate.

    Raises
    ------
    InputError
        The file or its table cannot be read, or a force does not act from the ground on a foot.
    """
    forces, off = _read_forces(path)
    notes = tuple(f"The force '{name}' is switched off in the file and left out." for name in off)
    if not forces:
        raise text_file.FileFault("found no ExternalForce that is switched on")
    tables = {name: read_table(_locate_table(path, name)) for name in _name_tables(forces)}
    names, _ = number_repetitions(clean_label(force.name) or "force" for force in forces)
    plates, feet = [], {}
    for name, force in zip(names, forces, strict=True):
        field = f"ExternalForce {name}"
        table = tables[force.table]
        if not force.columns["force"]:
            notes += (f"The force '{name}' has no columns and was left out.",)
            continue
        found = _find_columns(force, table)
        side = find_side(force.body)
        if not (side and FOOT_BODY.search(force.body)):
            if not np.nan_to_num(table.values[:, list(found.columns["force"].values())]).any():
                notes += (
                    f"The force '{name}' on {force.body} is zero throughout and was left out.",
                )
                continue
            allowed = "allowed are forces on the right and left foot (calcn_r, calcn_l)"
            raise text_file.FileFault(f"found a force on '{force.body}'; {allowed}", field)
        for quantity, frame in force.frames.items():
            if frame.lower() not in GROUND_NAMES:
                raise text_file.FileFault(
                    f"found its {quantity} expressed in '{frame}'; allowed is ground", field
                )
        time, time_notes = text_file.undo_rounding(table.time)
        plate, plate_notes = build_plate(name, time, table.values, found)
        plates.append(plate)
        feet[name] = side
        columns = (
            f"Plate {name} holds the columns {force.columns['force']}x and following, on "
            f"{force.body}."
        )
        notes += (*(n for n in time_notes if n not in notes), *plate_notes, columns)
    if not plates:
        raise text_file.FileFault("found no force on a foot")
    return orient_forces(path, plates, notes, feet)


@text_file.name_file_in_faults
def find_loads_tables(path: Path) -> tuple[Path, ...]:
    """Find the tables of an ExternalLoads file.

    Parameters
    ----------
    path
        Any file of forces.

    Returns
    -------
    tuple of Path
        Empty for a file of another kind.

    Raises
    ------
    InputError
        The .xml file cannot be read, or a table does not exist.
    """
    if path.suffix.lower() != ".xml":
        return ()
    forces, _ = _read_forces(path)
    return tuple(_locate_table(path, name) for name in _name_tables(forces))


def _name_tables(forces: Sequence[ExternalForce]) -> list[str]:
    """Name each table once, in order of first use."""
    return list(dict.fromkeys(force.table for force in forces))


def find_existing_tables(path: Path) -> tuple[Path, ...]:
    """Find the tables of a file that may be no ExternalLoads file; empty if it cannot be read."""
    try:
        return find_loads_tables(path)
    except InputError:
        return ()


def _read_forces(path: Path) -> tuple[list[ExternalForce], list[str]]:
    """Read the forces that are switched on, and the names of the others."""
    text_file.check_readable(path)
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, ValueError, LookupError, OSError) as error:
        raise text_file.FileFault(f"is not well-formed XML: {error}") from None
    loads = root if root.tag == "ExternalLoads" else root.find(".//ExternalLoads")
    if loads is None:
        raise text_file.FileFault(f"found <{root.tag}>; a file with <ExternalLoads> is needed")

    def text(element: ET.Element, tag: str) -> str:
        found = (element.findtext(tag) or "").strip()
        return "" if found.lower() in NO_COLUMNS else found

    common = (loads.findtext("datafile") or "").strip()
    forces, off = [], []
    for element in loads.iter("ExternalForce"):
        name = element.get("name", "")
        if (
            text(element, "isDisabled").lower() == "true"
            or text(element, "appliesForce").lower() == "false"
        ):
            off.append(name)
            continue
        identifiers = {
            "force": "force_identifier",
            "point": "point_identifier",
            "moment": "torque_identifier",
        }
        force = ExternalForce(
            name=name,
            body=text(element, "applied_to_body").rpartition("/")[2],
            frames={
                quantity: text(element, f"{quantity}_expressed_in_body")
                for quantity in ("force", "point")
            },
            columns={quantity: text(element, tag) for quantity, tag in identifiers.items()},
            table=common or text(element, "datafile") or text(element, "data_source_name"),
        )
        forces.append(force)
    return forces, off


def _locate_table(path: Path, name: str) -> Path:
    """Locate a table as written, or by its name alone in the folder of the file."""
    if not name:
        raise text_file.FileFault("names no table of forces", "datafile")
    written = PureWindowsPath(name)  # Accepts / and \\
    for candidate in (path.parent / Path(*written.parts), path.parent / written.name):
        if candidate.is_file():
            return candidate
    raise text_file.FileFault(
        f"found '{name}', which does not exist beside it", "datafile", Code.NO_FILE
    )


def _find_columns(force: ExternalForce, table: StorageTable) -> PlateColumns:
    """Find the columns of one force in its table."""
    found = PlateColumns()
    lower = [name.lower() for name in table.names]
    for quantity, start in force.columns.items():
        if not start:
            continue
        names = [f"{start}{axis}" for axis in "xyz"]
        if not all(name.lower() in lower for name in names):
            names = [name for name in table.names if name.startswith(start)]
        if len(names) != 3:
            message = f"found {len(names)} columns; {start}x, {start}y and {start}z are needed"
            raise text_file.FileFault(message, f"ExternalForce {force.name}, {quantity}")
        found.columns[quantity] = {
            axis: lower.index(name.lower()) for axis, name in enumerate(names)
        }
        found.names += names
    return found
