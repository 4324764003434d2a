"""The folder that `gaitcal compare A B --out` writes: `differences.csv`, `curve_differences.csv`, `comparison.txt`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from gaitcal.compare.curve_differences import CURVE_HEADER
from gaitcal.compare.difference import DIFFERENCES_HEADER
from gaitcal.compare.sessions import SessionComparison
from gaitcal.files.atomic import atomic_directory
from gaitcal.files.ownership import MANIFEST, ResultKind
from gaitcal.files.package_data import package_version
from gaitcal.files.snapshot import sha256_of
from gaitcal.results.calibration import json_text
from gaitcal.results.json_types import Json
from gaitcal.results.table_file import write_csv

DIFFERENCES, CURVES, WORDS = "differences.csv", "curve_differences.csv", "comparison.txt"
SHARED = "shared_parameters.csv"
SHARED_HEADER = (
    "joint parameters of a and b, each in its own segment frames: by its own trials alone, and by those of both; se:",
    "standard error",
)


def write_comparison(
    comparison: SessionComparison, folder: Path, results: Sequence[Path], shared: pd.DataFrame | None = None
) -> Path:
    """Write the tables and the words of a comparison of two `results`, whole or not at all. Returns the folder.

    `shared`: the joint parameters of a shared model.

    Raises
    ------
    InputError
        The folder cannot be written, or holds something else than an earlier comparison.
    """
    told = tuple(one_line(f"warning: {text}") for text in comparison.warnings)
    with atomic_directory(folder, ResultKind.COMPARISON, [result / MANIFEST for result in results]) as out:
        names = tuple(map(one_line, comparison.names))
        sessions = {f"session_{key}": name for key, name in zip("ab", names, strict=True)}
        hashes = {f"manifest_{key}_sha256": sha256_of(path / MANIFEST) for key, path in zip("ab", results, strict=True)}
        content: dict[str, Json] = {
            "gaitcal": package_version("gaitcal"),
            **sessions,
            **hashes,
            "common": comparison.common.name.lower(),
        }
        (out / MANIFEST).write_text(json_text(content), encoding="utf-8")
        head = (*told, f"a: {names[0]}; b: {names[1]}; {comparison.common.words}")
        write_csv(comparison.differences, out / DIFFERENCES, (*head, *DIFFERENCES_HEADER))
        write_csv(comparison.curves, out / CURVES, (*head, *CURVE_HEADER))
        if shared is not None:
            write_csv(shared, out / SHARED, SHARED_HEADER)
        (out / WORDS).write_text("".join(f"{one_line(line)}\n" for line in comparison.lines), encoding="utf-8")
    return folder


def one_line(text: str) -> str:
    """Names are data: what would begin a new line of a file, or moves a cursor, becomes a blank."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())
