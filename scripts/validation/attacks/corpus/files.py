"""Attacks on files."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import ezc3d
import numpy as np

from scripts.validation.attacks.attack import FileChange, Kind
from scripts.validation.attacks.corpus.words import (
    CLOCK,
    GAIN,
    NOTHING,
    PLACE,
    POINT,
    RATE,
    SIGN,
    UNITS,
    YAW,
    Row,
    rows,
)


def text(name: str, change: Callable[[str], str], encoding: str = "utf-8") -> FileChange:
    """The text of a file changed."""

    def spoil(folder: Path) -> None:
        path = folder / name
        path.write_bytes(change(path.read_bytes().decode("utf-8", errors="replace")).encode(encoding))

    return spoil


def raw(name: str, change: Callable[[bytes], bytes]) -> FileChange:
    """The bytes of a file changed."""

    def spoil(folder: Path) -> None:
        path = folder / name
        path.write_bytes(change(path.read_bytes()))

    return spoil


def header(old: str, new: str) -> Callable[[str], str]:
    """The first occurrence of a word of the header replaced."""

    def change(content: str) -> str:
        if old not in content:
            raise ValueError(f"the file has no '{old}'")
        return content.replace(old, new, 1)

    return change


def column(name: str, change: Callable[[float], float]) -> FileChange:
    """A column of the force table changed, by a pattern for its names."""

    def spoil(content: str) -> str:
        lines = content.splitlines()
        at = next(i for i, line in enumerate(lines) if line.lower().startswith("time"))
        wanted = [k for k, label in enumerate(lines[at].split()) if re.search(name, label)]
        if not wanted:
            raise ValueError(f"no column like '{name}'")
        for i in range(at + 1, len(lines)):
            cells = lines[i].split()
            for k in wanted:
                if k < len(cells):
                    cells[k] = f"{change(float(cells[k])):.8g}"
            lines[i] = "\t".join(cells)
        return "\n".join(lines) + "\n"

    return text("walk_forces.mot", spoil)


def labels_moved(content: str) -> str:
    """A TRC whose marker names stand one column group too far left."""
    lines = content.splitlines()
    cells = lines[3].split("\t")
    names = [c for c in cells[2:] if c.strip()]
    moved = iter([*names[1:], names[0]])
    lines[3] = "\t".join([*cells[:2], *(next(moved) if c.strip() else c for c in cells[2:])])
    return "\n".join(lines) + "\n"


def twice(content: str) -> str:
    """A marker name twice in the header."""
    return content.replace("L.Thigh.Rear", "R.Thigh.Rear", 1)


def c3d(name: str, change: Callable[[ezc3d.c3d], None]) -> FileChange:
    """Parameters of a C3D changed."""

    def spoil(folder: Path) -> None:
        path = folder / name
        file = ezc3d.c3d(str(path))
        change(file)
        file.write(str(path))

    return spoil


def _corners(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[ezc3d.c3d], None]:
    def spoil(file: ezc3d.c3d) -> None:
        value = file["parameters"]["FORCE_PLATFORM"]["CORNERS"]
        value["value"] = change(np.array(value["value"], dtype=float))

    return spoil


def _rate(factor: float) -> Callable[[ezc3d.c3d], None]:
    def spoil(file: ezc3d.c3d) -> None:
        for group in ("POINT", "ANALOG"):
            value = file["parameters"][group]["RATE"]
            value["value"] = np.array(value["value"]) * factor
        for part in ("points", "analogs"):
            file["header"][part]["frame_rate"] *= factor

    return spoil


def _point_units(word: str) -> Callable[[ezc3d.c3d], None]:
    def spoil(file: ezc3d.c3d) -> None:
        file["parameters"]["POINT"]["UNITS"]["value"] = [word]

    return spoil


def _channels_scaled(factor: float) -> Callable[[ezc3d.c3d], None]:
    def spoil(file: ezc3d.c3d) -> None:
        file["data"]["analogs"] = file["data"]["analogs"] * factor

    return spoil


def attacks() -> Row:
    """Every attack on a file."""
    make = rows(Kind.FILE)

    def row(name: str, bases: str, change: FileChange, *named: str, quick: str = "") -> Row:
        return make(name, bases, change, *named, quick=quick, of_files=True)

    trc, mot, study = "walk.trc", "walk_forces.mot", "study.toml"
    yield from row("unit m in a walk of mm", "subject01", text(trc, header("\tmm\t", "\tm\t")), UNITS)
    yield from row("unit mm in a static trial of m", "p01", text("static.trc", header("\tm\t", "\tmm\t")), UNITS)
    yield from row(
        "walk cut off in the middle",
        "subject01 uf3",
        raw(trc, lambda b: b[: len(b) // 2]),
        "cut|short|cells|row|frame|force",
    )
    yield from row(
        "forces cut off in the middle", "subject01", raw(mot, lambda b: b[: len(b) // 2]), "cover|cells|row|force"
    )
    yield from row("walk in UTF-16", "subject01", text(trc, str, "utf-16"), "UTF", quick="subject01")
    yield from row("study file in UTF-16", "subject01 synthetic", text(study, str, "utf-16"), "UTF")
    yield from row("walk of no bytes", "subject01 pig", _emptied, "empty|bytes|header")
    yield from row("walk missing", "subject01 child", _deleted, "file|not found|no such|exist")
    yield from row(
        "commas for decimal points", "subject01 p01", text(trc, lambda s: s.replace(".", ",")), "number|comma|cell"
    )
    yield from row("marker names one on", "subject01 uf3", text(trc, labels_moved), "label|exchang|marker")
    yield from row("a marker name twice", "subject01", text(trc, twice), "twice|doubled|Thigh.Rear", quick="subject01")
    yield from row(
        "twice the rate in the header",
        "subject01",
        text(trc, lambda s: re.sub(r"^60(\.00)?\t", "120.00\t", s, flags=re.M)),
        RATE,
    )
    yield from row("vertical force of wrong sign", "subject01 p01", column(r"v[y]$", lambda v: -v), SIGN)
    yield from row("forward force of wrong sign", "subject01 p01", column(r"v[x]$", lambda v: -v), SIGN)
    yield from row("forces in kgf", "subject01", column(r"_v[xyz]$", lambda v: v / 9.80665), f"{GAIN}|kgf")
    yield from row("centre of pressure in mm", "subject01 p01", column(r"_p[xyz]$", lambda v: 1000 * v), POINT)
    yield from row(
        "torque in N·mm",
        "subject01 p01",
        column(r"(torque|moment|_m).*[xyz]$", lambda v: 1000 * v),
        "moment|torque|unit",
    )
    yield from row(
        "force time in ms", "subject01", column(r"^time$", lambda v: 1000 * v), rf"{CLOCK}|cover|\btime\b|{RATE}"
    )
    yield from row(
        "force time from 0.2 s later", "subject01 p18", column(r"^time$", lambda v: v + 0.2), rf"{CLOCK}|cover|\btime\b"
    )
    yield from row("zeros for forces", "subject01", column(r"_v[xyz]$", lambda v: 0.0), NOTHING)
    yield from row(
        "forward and sideways columns named for each other",
        "subject01",
        text(mot, lambda s: re.sub(r"_v([xz])\b", lambda m: f"_v{'z' if m[1] == 'x' else 'x'}", s)),
        "exchang|axes|turned|yaw|sign",
    )
    yield from row(
        "C3D of half its bytes", "pig synthetic", raw_walk(lambda b: b[: len(b) // 2]), "short|cut|bytes|frames|end"
    )
    yield from row(
        "C3D with flipped bytes",
        "pig",
        raw_walk(lambda b: b[:600] + bytes(255 - x for x in b[600:1400]) + b[1400:]),
        "c3d|parameter|header|read",
    )
    yield from row("C3D with twice the rate", "pig", c3d("walk.c3d", _rate(2.0)), RATE)
    yield from row("C3D of mm called m", "pig child", c3d("walk.c3d", _point_units("m")), UNITS)
    yield from row(
        "plate corners exchanged",
        "pig child",
        c3d("walk.c3d", _corners(lambda c: c[:, :, ::-1])),
        f"{PLACE}|exchang|{POINT}|corner",
    )
    yield from row(
        "plate corners one on",
        "pig child",
        c3d("walk.c3d", _corners(lambda c: np.roll(c, 1, axis=1))),
        f"{YAW}|{POINT}",
    )
    yield from row(
        "plate corners two on",
        "pig synthetic",
        c3d("walk.c3d", _corners(lambda c: np.roll(c, 2, axis=1))),
        f"{YAW}|{POINT}",
    )
    yield from row(
        "plate corners in metres",
        "pig",
        c3d("walk.c3d", _corners(lambda c: 0.001 * c)),
        f"corner|FORCE_PLATFORM|{UNITS}",
    )
    yield from row(
        "plate corners 60 mm on",
        "pig synthetic",
        c3d("walk.c3d", _corners(lambda c: c + np.array([60.0, 0, 0])[:, None, None])),
        PLACE,
    )
    yield from row("plate channels x 2", "pig child", c3d("walk.c3d", _channels_scaled(2.0)), GAIN)
    yield from row("plate channels / 9.81", "pig", c3d("walk.c3d", _channels_scaled(1 / 9.80665)), GAIN)
    yield from row(
        "a height in centimetres",
        "subject01",
        text(study, lambda s: re.sub(r"height_m = [\d.]+", "height_m = 180.3", s)),
        "height",
    )
    yield from row("no mass", "subject01", text(study, lambda s: re.sub(r"mass_kg = [\d.]+\n", "", s)), "mass")
    yield from row(
        "a height in feet",
        "subject01",
        text(study, lambda s: re.sub(r"height_m = [\d.]+", "height_m = 5.92", s)),
        "height",
    )
    yield from row(
        "mass and height for each other",
        "subject01",
        text(
            study,
            lambda s: re.sub(
                r"height_m = ([\d.]+)", "height_m = 72.6", re.sub(r"mass_kg = ([\d.]+)", "mass_kg = 1.803", s)
            ),
        ),
        "mass|height",
    )
    yield from row(
        "a static trial given twice",
        "subject01",
        text(study, lambda s: s.replace("walk.trc", "static.trc")),
        "same|still|force",
    )


def _walk_file(folder: Path) -> Path:
    return next(path for path in sorted(folder.glob("walk.*")))


def _emptied(folder: Path) -> None:
    _walk_file(folder).write_bytes(b"")


def _deleted(folder: Path) -> None:
    _walk_file(folder).unlink()


def raw_walk(change: Callable[[bytes], bytes]) -> FileChange:
    """The bytes of the walk's file changed."""

    def spoil(folder: Path) -> None:
        path = _walk_file(folder)
        path.write_bytes(change(path.read_bytes()))

    return spoil
