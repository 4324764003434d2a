"""Ways to spoil a file in place: functions of its path and the words of the table."""

from __future__ import annotations

import re
from pathlib import Path

import ezc3d
import numpy as np


def written(path: Path, text: str, encoding: str = "utf-8") -> None:
    """Other text into a file, its ends of lines as they are."""
    path.write_bytes(text.encode(encoding))


def _text(path: Path) -> str:
    return path.read_bytes().decode("utf-8", errors="replace")


def utf16(path: Path) -> None:
    """Another encoding."""
    written(path, _text(path), "utf-16")


def halved(path: Path) -> None:
    """Cut off in the middle."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def emptied(path: Path) -> None:
    """No byte is left."""
    path.write_bytes(b"")


def deleted(path: Path) -> None:
    """There is no such file."""
    path.unlink()


def flipped(path: Path, first: int, last: int) -> None:
    """Some bytes with every bit turned."""
    content = path.read_bytes()
    path.write_bytes(content[:first] + bytes(255 - x for x in content[first:last]) + content[last:])


def changed(path: Path, found: str, into: str, count: int = 0) -> None:
    """A pattern replaced, everywhere or so many times."""
    text, changes = re.subn(found, into, _text(path), count=count)
    if not changes:
        raise ValueError(f"the file has no '{found}'")
    written(path, text)


def labels_moved(path: Path) -> None:
    """A TRC whose marker names stand one column group too far left."""
    lines = _text(path).splitlines()
    cells = lines[3].split("\t")
    names = [c for c in cells[2:] if c.strip()]
    moved = iter([*names[1:], names[0]])
    lines[3] = "\t".join([*cells[:2], *(next(moved) if c.strip() else c for c in cells[2:])])
    written(path, "\n".join(lines) + "\n")


def column(path: Path, name: str, factor: float, add: float = 0.0) -> None:
    """Columns of a force table, by a pattern for their names, times a factor and so much more."""
    lines = _text(path).splitlines()
    at = next(i for i, line in enumerate(lines) if line.lower().startswith("time"))
    wanted = [k for k, label in enumerate(lines[at].split()) if re.search(name, label)]
    if not wanted:
        raise ValueError(f"no column like '{name}'")
    for i in range(at + 1, len(lines)):
        cells = lines[i].split()
        for k in (k for k in wanted if k < len(cells)):
            cells[k] = f"{factor * float(cells[k]) + add:.8g}"
        lines[i] = "\t".join(cells)
    written(path, "\n".join(lines) + "\n")


def rate(path: Path, factor: float) -> None:
    """A C3D whose header and groups tell another rate."""
    file = ezc3d.c3d(str(path))
    for group in ("POINT", "ANALOG"):
        value = file["parameters"][group]["RATE"]
        value["value"] = np.array(value["value"]) * factor
    for part in ("points", "analogs"):
        file["header"][part]["frame_rate"] *= factor
    file.write(str(path))


def point_units(path: Path, word: str) -> None:
    """A C3D whose lengths are said to be of another unit."""
    file = ezc3d.c3d(str(path))
    file["parameters"]["POINT"]["UNITS"]["value"] = [word]
    file.write(str(path))


def channels(path: Path, factor: float) -> None:
    """Analog channels times a factor."""
    file = ezc3d.c3d(str(path))
    file["data"]["analogs"] = file["data"]["analogs"] * factor
    file.write(str(path))


def corners(path: Path, what: str, size: float = 1.0) -> None:
    """Corners of the plates: of the plates `exchanged`, `rolled` one on or more, `scaled`, or `shifted` by mm in x."""
    file = ezc3d.c3d(str(path))
    value = file["parameters"]["FORCE_PLATFORM"]["CORNERS"]
    c = np.array(value["value"], dtype=float)
    value["value"] = {
        "exchanged": c[:, :, ::-1],
        "rolled": np.roll(c, int(size), axis=1),
        "scaled": size * c,
        "shifted": c + np.array([size, 0, 0])[:, None, None],
    }[what]
    file.write(str(path))
