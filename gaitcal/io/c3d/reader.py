"""C3D files: the measured markers and the force plates of one trial, in metres and seconds, y up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.axes import UP_TO_Y, Vertical, find_vertical, turn_up
from gaitcal.io.c3d.layout import C3DHeader, check_c3d_header, events_of, facts_of, is_askew, read_samples
from gaitcal.io.c3d.parser import ParserDiedError, parse_c3d
from gaitcal.io.c3d.plates import measured_plates, stand_up
from gaitcal.io.labels import ComputedPoints, clean, common_prefix, computed_points, is_number, is_unlabelled, unique
from gaitcal.io.recording import Recording, zeros_to_missing

PER_METRE = {"mm": 1e3, "millimeters": 1e3, "millimetres": 1e3, "cm": 1e2, "m": 1.0, "meters": 1.0, "metres": 1.0}
"""Lengths that POINT:UNITS may name."""
ABSURD_M = 1e6
"""No place lies so far off; only a damaged float does."""
COMPUTED_GROUPS = ("ANGLES", "MOMENTS", "FORCES", "POWERS", "SCALARS", "REACTIONS", "MODELED_MARKERS")
"""POINT parameters that list computed points, besides those named in TYPE_GROUPS."""
NUMBERS = tuple(name for name in COMPUTED_GROUPS if name != "MODELED_MARKERS")
"""Those whose points are no places: three numbers of another kind."""
USUAL_VERTICAL = Vertical(2, 1, "the usual practice, as the data do not tell")


def read_c3d(path: Path) -> Recording:
    """Markers and plates of a C3D file; InputError where it cannot be read or names no marker."""
    header = check_c3d_header(path)
    try:
        raw = parse_c3d(path, header.size)
    except ValueError as error:
        raise InputError(
            f"damaged or not a C3D file: the parser says '{str(error)[:120]}'", source=path, code=Code.DAMAGED_RECORDING
        ) from None
    except ParserDiedError as error:
        raise InputError(
            f"damaged: the parser did not survive it, {error}", source=path, code=Code.DAMAGED_RECORDING
        ) from None
    try:
        return _recording(path, header, raw)
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise InputError(
            f"damaged: its parameters contradict each other ({error})", source=path, code=Code.DAMAGED_RECORDING
        ) from None


def _recording(path: Path, header: C3DHeader, raw: Mapping[str, Any]) -> Recording:
    parameters: Mapping[str, Mapping[str, Any]] = raw["parameters"]
    rate = _rate(path, parameters, float(raw["rate"]))
    points: Array = raw["points"]
    analogs: Array = raw["analogs"]
    per_metre, notes = _unit(parameters)
    if is_askew(header, points, analogs):
        points, analogs = read_samples(path, header, parameters)
        notes += ("ANALOG parameters are missing or do not fit the data, which were laid out after the header.",)
    frames = points.shape[2]
    if frames < 1:
        raise InputError("found no frame of points; at least one is needed", source=path, code=Code.FILE_FORMAT)
    first = _first_frame(parameters, int(raw["first_frame"]))
    keep, labels, label_notes, computed = _markers(path, parameters, points.shape[1])
    notes += label_notes
    markers = np.ascontiguousarray(points[:, keep].transpose(2, 1, 0)) / per_metre
    absurd = (np.abs(markers) > ABSURD_M).any(axis=2)
    if absurd.any():
        notes += (f"{int(absurd.sum())} positions beyond {ABSURD_M:g} m, damaged numbers, taken as gaps.",)
        markers[absurd] = np.nan
    markers, gap_notes = zeros_to_missing(markers)
    ratio = analogs.shape[1] / frames
    plates, plate_notes = measured_plates(parameters, analogs, first * ratio, rate * ratio, 1.0 / per_metre)
    vertical = find_vertical(markers, tuple(plate.as_plate() for plate in plates)) or USUAL_VERTICAL
    standing, turn_notes = stand_up(plates, vertical.direction)
    notes += gap_notes + plate_notes + turn_notes
    time = (first + np.arange(frames)) / rate
    recording = Recording(
        source=str(path),
        time=time,
        labels=labels,
        markers=markers,
        plates=standing,
        notes=notes,
        events=events_of(parameters),
        facts=facts_of(parameters),
        computed=_computed(computed, points, per_metre),
    )
    return recording if UP_TO_Y[vertical.axis, vertical.sign].is_identity else turn_up(recording, vertical)


def _rate(path: Path, parameters: Mapping[str, Mapping[str, Any]], header: float) -> float:
    values = np.asarray(parameters.get("POINT", {}).get("RATE", []), dtype=np.float64).ravel()
    for rate in [*values.tolist(), header]:
        if np.isfinite(rate) and 0.1 <= rate <= 1e5:
            return float(rate)
    raise InputError(
        f"found {header:g} Hz; 0.1 to 100000 are allowed", source=path, field="POINT:RATE", code=Code.DAMAGED_RECORDING
    )


def _first_frame(parameters: Mapping[str, Mapping[str, Any]], header: int) -> int:
    """Frames before the first one of the file. The header's 16 bits are completed from TRIAL where they agree."""
    words = np.asarray(parameters.get("TRIAL", {}).get("ACTUAL_START_FIELD", []), dtype=np.int64).ravel()
    if len(words) == 2:
        actual = (int(words[0]) & 0xFFFF) + ((int(words[1]) & 0xFFFF) << 16) - 1
        if actual >= 0 and actual % 65536 == header % 65536:
            return actual
    return max(0, header)


def _unit(parameters: Mapping[str, Mapping[str, Any]]) -> tuple[float, tuple[str, ...]]:
    units = parameters.get("POINT", {}).get("UNITS", [])
    name = clean(str(units[0])) if len(units) else ""
    if name.lower() in PER_METRE:
        return PER_METRE[name.lower()], ()
    given = f"'{name[:20]}'" if name else "no unit"
    return 1e3, (f"POINT:UNITS holds {given}; millimetres were taken.",)


def _texts(group: Mapping[str, Any], name: str) -> list[str]:
    """A list of text with its continuations NAME2, NAME3, ... (255 entries each)."""
    texts: list[str] = []
    for number in range(1, 100):
        part = group.get(name if number == 1 else f"{name}{number}")
        if part is None or not all(isinstance(text, str) for text in part):
            break
        texts += list(part)
    return texts


def _markers(
    path: Path, parameters: Mapping[str, Mapping[str, Any]], count: int
) -> tuple[list[int], tuple[str, ...], tuple[str, ...], dict[str, int]]:
    """Places of the measured, named markers among `count` points, their names, notes on the rest, and the computed
    points that are places (label -> place), not angles or moments.
    """
    group = parameters.get("POINT", {})
    labels = [clean(label) for label in _texts(group, "LABELS")][:count]
    labels += [""] * (count - len(labels))
    named = [i for i, label in enumerate(labels) if not is_unlabelled(label)]
    notes: tuple[str, ...] = ()
    if count > len(named):
        notes += (f"{count - len(named)} unlabelled trajectories left out.",)
    if not named:
        raise InputError(
            f"found {count} trajectories, none with a name; labelled markers are needed",
            source=path,
            code=Code.FILE_FORMAT,
        )
    listed = _listed_as_computed(group)
    prefix, prefix_notes = common_prefix([labels[i] for i in named if labels[i] not in listed])
    spelt = {i: labels[i].removeprefix(prefix) for i in named}
    by_spelling = computed_points(list(spelt.values()))
    keep = [i for i in named if labels[i] not in listed and spelt[i] not in by_spelling]
    dropped = [spelt[i] for i in named if i not in set(keep)]
    if dropped:
        notes += (f"{len(dropped)} computed points, not markers, left out: {', '.join(dropped)}.",)
    if not keep:
        raise InputError(
            f"all {len(named)} named points are computed ones; markers are needed", source=path, code=Code.FILE_FORMAT
        )
    names, repetition_notes = unique(spelt[i] for i in keep)
    numbers = _listed_as_computed(group, NUMBERS)
    places = {spelt[i]: i for i in named if i not in set(keep) and labels[i] not in numbers and not is_number(spelt[i])}
    return keep, names, notes + prefix_notes + repetition_notes, places


def _computed(places: Mapping[str, int], points: Array, per_metre: float) -> ComputedPoints | None:
    if not places:
        return None
    values = points[:, list(places.values())].transpose(2, 1, 0) / per_metre
    known = np.isfinite(values).all(axis=2) & (np.abs(values) <= ABSURD_M).all(axis=2) & (values != 0).any(axis=2)
    return ComputedPoints(tuple(places), np.where(known[:, :, None], values, np.nan))


def _listed_as_computed(group: Mapping[str, Any], groups: Sequence[str] = ()) -> set[str]:
    names = groups or [*COMPUTED_GROUPS, *(clean(text) for text in _texts(group, "TYPE_GROUPS"))]
    return {clean(label) for name in names if name != "LABELS" for label in _texts(group, name)}
