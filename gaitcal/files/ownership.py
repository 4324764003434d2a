"""Whose files lie in an output folder: what a run may replace, what it keeps, and what it must not touch.

The manifest of a folder says what kind of result it is and lists the files that were written. A folder may be replaced
only by a result of the same kind, only while every file in it is in that list, and never while it holds an input of
the run. What later commands added to it (`KEPT`) is not replaced but goes on into the new result.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path, PurePosixPath

from gaitcal.codes import Code
from gaitcal.errors import InputError

MANIFEST = "manifest.json"
"""The file that marks a folder as a result of gaitcal."""
PEOPLE = "people"
"""Folder of the results of all people within that of a cohort."""
OLD, UNFINISHED, LOCK = ".gaitcal-old-", ".gaitcal-tmp-", ".gaitcal-lock-"
"""Beginnings of hidden names beside a target: what waits for an interrupted exchange, what a killed run left, and who
writes now."""
AMENDING, AMENDED = ".gaitcal-tmp-files", ".gaitcal-put-files"
"""Hidden folders inside one: files that will join it, being written, and complete."""
_HIDDEN = (UNFINISHED, LOCK, AMENDED)
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

_TRIAL_FILES = (
    *("motion/*.mot", "motion/*.csv", "moments/*.sto", "moments/*.csv", "marker_errors/*.csv", "markers/*.trc"),
    *("forces/*.mot", "forces/*.xml", "cycles.csv", "ensemble.csv", "spatiotemporal.csv", "summary.json"),
)
_KNOWN: dict[ResultKind, tuple[str, ...]] = {
    ResultKind.CALIBRATION: (
        *_TRIAL_FILES,
        *("parameters.csv", "model.toml", "model.osim", "model.urdf", "model.xml", "report.html", "view.html"),
        *("splines.npz", "scene.npz", "uncertainty.npz", "figures/*.png", "figures/*.svg"),
    ),
    ResultKind.DYNAMICS: _TRIAL_FILES,
    ResultKind.SYNTHETIC: (
        *("study.toml", "truth.csv", "static.c3d", "gait.c3d"),
        *(f"{joint}_{side}.c3d" for joint in ("hip", "knee", "ankle") for side in "rl"),
    ),
    ResultKind.REPRODUCTION: ("tables.csv", "claims.csv", "draws.csv", "times.csv", "montecarlo.csv", "README.txt"),
    ResultKind.EXPORT: (),
    ResultKind.COHORT: (),
    ResultKind.COMPARISON: (),
    ResultKind.EXAMPLE: (),
}
"""Names that results had whose manifest lists no files."""


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
    kept = tuple(sorted(entry.name for entry in target.iterdir() if _is_kept(entry, kind)))
    files = list(_files(target, kept))
    if not files and not kept:
        return ()
    manifest = read_object(target / MANIFEST)
    old_kind = _kind_of(manifest)
    if old_kind is None:
        raise InputError(_foreign((*files, *kept)[0]), source=target, code=Code.FOLDER_TAKEN)
    if old_kind is not kind:
        message = f"holds another kind of result ({old_kind.value}, this would be {kind.value})"
        raise InputError(f"{message}; name a new or an empty folder", source=target, code=Code.FOLDER_TAKEN)
    listed = manifest.get("files")
    for name in files:
        if not (name in listed if isinstance(listed, list) else _known(name, kind)) and name != MANIFEST:
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


def _kind_of(manifest: dict[str, object]) -> ResultKind | None:
    """The kind that a manifest tells; of manifests that tell none, the one that wrote such keys."""
    if "gaitcal" not in manifest:
        return None
    named = manifest.get("kind")
    if named is not None:
        return next((kind for kind in ResultKind if kind.value == named), None)
    if manifest["gaitcal"] == "synthetic subject":
        return ResultKind.SYNTHETIC
    if "inputs_sha256" in manifest:
        return ResultKind.CALIBRATION
    return ResultKind.DYNAMICS if set(manifest) == {"gaitcal", "subject"} else None


def _is_kept(entry: Path, kind: ResultKind) -> bool:
    """Whether another run keeps it: what a later command added, and what waits for an interrupted exchange."""
    return entry.is_dir() and (entry.name in KEPT[kind] or entry.name.startswith(OLD))


def _files(folder: Path, besides: Iterable[str], prefix: str = "") -> Iterator[str]:
    """Every file below `folder` as `motion/walk.mot`; a link is a file, whatever it points to."""
    left_out = set(besides)
    for entry in sorted(folder.iterdir()):
        if entry.name in left_out or entry.name in _LITTER or entry.name.startswith(_HIDDEN):
            continue
        if entry.is_dir() and not entry.is_symlink():
            yield from _files(entry, (), f"{prefix}{entry.name}/")
        else:
            yield prefix + entry.name


def files_of(folder: Path) -> tuple[str, ...]:
    """Every file below a folder of ours, as `motion/walk.mot`."""
    return tuple(_files(folder, ()))


def _known(name: str, kind: ResultKind) -> bool:
    """Whether results of this kind had a file of this name before manifests listed them."""
    path = PurePosixPath(name)
    patterns = map(PurePosixPath, _KNOWN[kind])
    return any(len(path.parts) == len(p.parts) and path.match(str(p)) for p in patterns)
