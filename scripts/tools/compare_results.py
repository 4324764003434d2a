"""Two result folders, file by file: the same numbers within a relative tolerance, and the same
words.

    python -m scripts.tools.compare_results BEFORE AFTER [--rtol 1e-9]

For changes of the code that must not change a result: make the folder with both versions, then
compare. Tables (CSV, MOT, STO, TRC, Parquet) and arrays (NPZ) are compared column by column,
relative to the largest value of the column; other text (JSON, TOML, XML) number by number, relative
to the number or to 1. Times, versions and hashes may differ. Pages and pictures are not compared,
and said so. Exit code 1 where anything differs.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

RTOL = 1e-9
NOT_COMPARED = {".html", ".png", ".svg", ".c3d"}
MAY_DIFFER = re.compile(
    r'"?(seconds|cpu_seconds|gaitcal|python|platform|when|sha256|[\w./-]*": "[0-9a-f]{64})"?'
)
"""Beginnings of lines that tell of the run, not of its result."""
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
HEADER = re.compile(r"[A-Za-z]")


def differences(before: Path, after: Path, rtol: float = RTOL) -> Iterator[str]:
    """One line for each file that is missing on a side or holds other content."""
    names = [
        {p.relative_to(folder) for p in folder.rglob("*") if p.is_file()}
        for folder in (before, after)
    ]
    for name in sorted(names[0] ^ names[1]):
        yield f"{name}: only in {before if name in names[0] else after}"
    for name in sorted(names[0] & names[1]):
        if name.suffix not in NOT_COMPARED and (
            found := difference(before / name, after / name, rtol)
        ):
            yield f"{name}: {found}"


def difference(before: Path, after: Path, rtol: float) -> str:
    """What differs between two files, the largest figure first; empty where nothing does."""
    if before.suffix == ".npz":
        return _arrays(dict(np.load(before)), dict(np.load(after)), rtol)
    if before.suffix == ".parquet":
        frames = [pd.read_parquet(path) for path in (before, after)]
        return _arrays(*({c: f[c].to_numpy() for c in f.columns} for f in frames), rtol)
    texts = [path.read_text(encoding="utf-8") for path in (before, after)]
    lines = [[x for x in text.splitlines() if not MAY_DIFFER.match(x.strip())] for text in texts]
    if before.suffix in {".csv", ".mot", ".sto", ".trc"}:
        return _tables(lines[0], lines[1], rtol)
    return _plain(lines[0], lines[1], rtol)


def _arrays(before: dict[str, np.ndarray], after: dict[str, np.ndarray], rtol: float) -> str:
    if list(before) != list(after):
        return f"holds {sorted(set(before) ^ set(after))} on one side only"
    told: list[str] = []
    apart: dict[str, float] = {}
    for name, a in before.items():
        b = after[name]
        if a.shape != b.shape:
            told.append(f"{name}: shape {a.shape} and {b.shape}")
        elif np.issubdtype(a.dtype, np.number):
            apart[name] = _apart(a.astype(float), b.astype(float)) if a.size else 0.0
        elif not (a == b).all():
            told.append(f"{name}: other words")
    worst = sorted((name for name in apart if apart[name] > rtol), key=lambda name: -apart[name])
    told += [f"{name} apart by {apart[name]:.1e}" for name in worst[:3]]
    return "; ".join(told) + (f" and {len(worst) - 3} more" if len(worst) > 3 else "")


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference relative to the largest value; infinite where one has a gap and the other
    none.
    """
    if (np.isnan(a) != np.isnan(b)).any():
        return np.inf
    known = ~np.isnan(a)
    scale = float(np.abs(a[known]).max(initial=0.0))
    return (
        float(np.abs(a - b)[known].max(initial=0.0)) / scale
        if scale
        else float(np.abs(b[known]).max(initial=0.0))
    )


def _tables(before: list[str], after: list[str], rtol: float) -> str:
    """Rows of numbers below their header, column by column; all other lines as text."""
    rows = [[re.split(r"[,\t]", line) for line in lines] for lines in (before, after)]
    if [len(r) for r in rows[0]] != [len(r) for r in rows[1]]:
        return f"{len(before)} and {len(after)} lines, or other columns"
    columns: dict[int, tuple[list[float], list[float]]] = {}
    for one, other in zip(*rows, strict=True):
        for k, cells in enumerate(zip(one, other, strict=True)):
            values = [_number(cell) for cell in cells]
            if values[0] is None or values[1] is None:
                if cells[0] != cells[1] and _plain([cells[0]], [cells[1]], rtol):
                    return f"'{cells[0][:60]}' and '{cells[1][:60]}'"
            else:
                columns.setdefault(k, ([], []))[0].append(values[0])
                columns[k][1].append(values[1])
    apart = {k: _apart(np.array(a), np.array(b)) for k, (a, b) in columns.items()}
    worst = max(apart, key=lambda k: apart[k], default=None)
    return (
        ""
        if worst is None or apart[worst] <= rtol
        else f"column {worst + 1} apart by {apart[worst]:.1e}"
    )


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _plain(before: list[str], after: list[str], rtol: float) -> str:
    if len(before) != len(after):
        return f"{len(before)} and {len(after)} lines"
    worst, told = 0.0, ""
    for one, other in zip(before, after, strict=True):
        if NUMBER.sub("#", one) != NUMBER.sub("#", other):
            return f"'{one.strip()[:80]}' and '{other.strip()[:80]}'"
        for a, b in zip(NUMBER.findall(one), NUMBER.findall(other), strict=True):
            apart = abs(float(a) - float(b)) / max(1.0, abs(float(a)))
            if apart > worst:
                worst, told = apart, f"{a} and {b} in '{one.strip()[:60]}'"
    return told if worst > rtol else ""


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--rtol", type=float, default=RTOL)
    chosen = parser.parse_args(arguments)
    found = list(differences(chosen.before, chosen.after, chosen.rtol))
    for line in found:
        print(line)
    skipped = sum(path.suffix in NOT_COMPARED for path in chosen.before.rglob("*"))
    apart = f"{len(found)} files differ by more than {chosen.rtol:g}"
    print(f"{apart}; {skipped} pages, pictures and C3D files not compared")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
