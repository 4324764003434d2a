"""Where the recordings lie that a result was made from: found by name, known by their SHA-256.

A result does not say in which folder its study was, as it may be given away. So recordings are looked for beside the
result, in the folder of the command, where the study that was drafted for it has them, or where the user says; whatever
is found must be what was read then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.ownership import MANIFEST, read_object
from gaitcal.io.snapshot import sha256_of
from gaitcal.io.toml import read_toml

STUDY = "study.toml"


def trial_files(folder: Path) -> dict[str, dict[str, str]]:
    """Trial -> `file` and, where there is one, `forces`, as the manifest of a result names them.

    Raises
    ------
    InputError
        It is no result.
    """
    trials = read_object(folder / MANIFEST).get("trials")
    if not isinstance(trials, dict):
        raise InputError(
            "found no list of its trials' files; calibrate again",
            source=folder / MANIFEST,
            field="trials",
            code=Code.CHANGED_FILE,
        )
    return {str(t): {str(k): str(v) for k, v in files.items()} for t, files in trials.items()}


def find_original(folder: Path, name: str, inputs: Path | None) -> Path:
    """The input `name` (as the manifest of the result in `folder` has it), unchanged since it was read.

    `inputs`: where the user says that recordings lie; it and its subfolders are looked through. Else they are looked
    for beside the result, in it, in the working folder, where its `study.toml` says, and in the folders there.

    Raises
    ------
    InputError
        There is none, or it has changed.
    """
    hashes = read_object(folder / MANIFEST).get("inputs_sha256")
    wanted = hashes.get(name) if isinstance(hashes, Mapping) else None
    changed: Path | None = None
    for path, is_its_place in _places(folder, name, inputs):
        if not path.is_file():
            continue
        if wanted is not None and sha256_of(path) == wanted:
            return path
        changed = changed or (path if is_its_place else None)
    if changed is not None:
        message = "is not the file that the result was made from (another SHA-256); calibrate again"
        raise InputError(message, source=changed, code=Code.CHANGED_FILE)
    where = inputs or folder.resolve().parent
    cure = "" if inputs else "; say with --inputs FOLDER where the recordings lie"
    raise InputError(f"found no '{name}', which the result was made from{cure}", source=where, code=Code.CHANGED_FILE)


def _places(folder: Path, name: str, inputs: Path | None) -> Iterator[tuple[Path, bool]]:
    """Where it may lie, and whether a file of that name there must be it: elsewhere others may share the name."""
    roots = [inputs] if inputs else [folder.resolve().parent, folder, Path.cwd()]
    last = PurePosixPath(name).name
    for root in roots:
        yield root / name, True
        yield root / last, True
    for path in () if inputs else _of_study(folder):
        if path.name == last:
            yield path, False
    for root in roots:
        for path in sorted(root.rglob(last) if inputs else root.glob(f"*/{last}")):
            yield path, False


def _of_study(folder: Path) -> Iterator[Path]:
    """Files of the trials of the study that was drafted into a result; none where it says nothing."""
    try:
        content = read_toml(folder / STUDY)
    except InputError:
        return
    trials = content.get("trial")
    for trial in trials if isinstance(trials, list) else ():
        named = (trial.get(key) for key in ("file", "forces")) if isinstance(trial, Mapping) else ()
        yield from (folder / name for name in named if isinstance(name, str))
