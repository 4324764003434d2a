"""Whose files lie in an output folder: what a run may replace, what it keeps, and what it must not touch.

The manifest of a folder says what kind of result it is and lists the files that were written. A folder may be replaced
only by a result of the same kind, only while every file in it is in that list, and never while it holds an input of
the run. What later commands added to it (`KEPT`) is not replaced but goes on into the new result.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path

from gaitcal.codes import Code
from gaitcal.errors import InputError

MANIFEST = "manifest.json"
"""The file that marks a folder as a result of gaitcal."""
PEOPLE = "people"
"""Folder of the results of all people within that of a cohort."""
OLD, UNFINISHED, LOCK = ".gaitcal-old-", ".gaitcal-tmp-", ".gaitcal-lock-"
"""Beginnings of hidden names beside or in a folder: what is being replaced, what is being written, and that somebody
writes now."""
_LITTER = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})  # written by file browsers, into any folder they show


class ResultKind(Enum):
    """What an output folder holds."""

    CALIBRATION = "calibration"
    DYNAMICS = "further trials"
    SYNTHETIC = "synthetic study"
    REPRODUCTION = "reproduction"
    EXPORT = "files for other programs"
    COHORT = "cohort"
    COMPARISON = "comparison of two results"
    EXAMPLE = "example recordings"


KEPT: dict[ResultKind, tuple[str, ...]] = {
    ResultKind.CALIBRATION: ("montecarlo", "dynamics", "export", "figures"),
    ResultKind.DYNAMICS: ("figures",),
    ResultKind.SYNTHETIC: ("montecarlo",),
    ResultKind.REPRODUCTION: (),
    ResultKind.EXPORT: (),
    ResultKind.COHORT: (),
    ResultKind.COMPARISON: (),
    ResultKind.EXAMPLE: (),
}
"""Folders that later commands put into a result: another run of the first command keeps them."""
PARTS = frozenset(name for names in KEPT.values() for name in names)


def refuse_others(target: Path, kind: ResultKind, inputs: Iterable[Path] = ()) -> tuple[str, ...]:
    """Make sure that `target` may become a result of this kind; returns the folders in it that are to be kept.

    Raises
    ------
    InputError
        It is a file, holds one of the inputs, another kind of result, or a file that gaitcal did not write there.
    """
    if not target.exists():
        return ()
    if not target.is_dir():
        raise InputError("is a file; the output needs a folder", source=target, code=Code.FOLDER_TAKEN)
    for path in inputs:
        if path.resolve().is_relative_to(target.resolve()):
            shown = path.resolve().relative_to(target.resolve()).as_posix()
            raise InputError(
                f"holds '{shown}', an input of this run; name another folder", source=target, code=Code.FOLDER_TAKEN
            )
    kept = tuple(sorted(entry.name for entry in target.iterdir() if entry.is_dir() and entry.name in KEPT[kind]))
    files = list(_files(target, kept))
    if not files and not kept:
        return ()
    manifest = read_object(target / MANIFEST)
    old_kind = next((k for k in ResultKind if "gaitcal" in manifest and k.value == manifest.get("kind")), None)
    if old_kind is None:
        raise InputError(_foreign((*files, *kept)[0]), source=target, code=Code.FOLDER_TAKEN)
    if old_kind is not kind:
        message = f"holds another kind of result ({old_kind.value}, this would be {kind.value})"
        raise InputError(f"{message}; name a new or an empty folder", source=target, code=Code.FOLDER_TAKEN)
    listed = manifest.get("files")
    ours = {MANIFEST, *(listed if isinstance(listed, list) else ())}
    for name in files:
        if name not in ours:
            raise InputError(_foreign(name), source=target, code=Code.FOLDER_TAKEN)
    return kept


def refuse_cohort(folder: Path) -> None:
    """InputError, naming the result of one of its people, where a cohort is taken for the result of one person."""
    if read_object(folder / MANIFEST).get("kind") != ResultKind.COHORT.value:
        return
    results = (path.parent for level in ("*", "*/*") for path in sorted(folder.glob(f"{PEOPLE}/{level}/{MANIFEST}")))
    one = next(results, None)
    such = "" if one is None else f", such as {one.as_posix()}"
    raise InputError(
        f"is a cohort; name the result of one person, a folder in its {PEOPLE}/{such}",
        source=folder,
        code=Code.NO_RESULT,
    )


def _foreign(name: str) -> str:
    return f"holds '{name}', which gaitcal did not write there; move it away, or name a new or an empty folder"


def read_object(path: Path) -> dict[str, object]:
    """The JSON object in a manifest or summary; empty where there is none, which is then no result of ours."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _files(folder: Path, besides: Iterable[str], prefix: str = "") -> Iterator[str]:
    """Every file below `folder` as `motion/walk.mot`; a link is a file, whatever it points to."""
    left_out = set(besides)
    for entry in sorted(folder.iterdir()):
        if entry.name in left_out or entry.name in _LITTER or entry.name.startswith((UNFINISHED, LOCK)):
            continue
        if entry.is_dir() and not entry.is_symlink():
            yield from _files(entry, (), f"{prefix}{entry.name}/")
        else:
            yield prefix + entry.name


def files_of(folder: Path) -> tuple[str, ...]:
    """Every file below a folder of ours, as `motion/walk.mot`."""
    return tuple(_files(folder, ()))
