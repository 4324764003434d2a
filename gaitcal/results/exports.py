"""The manifest of a folder of exported files: what was written, from which result, and the SHA-256 of each."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.ownership import MANIFEST, ResultKind, files_of, read_object
from gaitcal.io.package_data import package_version
from gaitcal.io.snapshot import HASHES, SELF, listed, self_hash, sha256_of
from gaitcal.results.calibration import json_text
from gaitcal.results.json_types import Json


def write_export_manifest(
    stage: Path, folder: Path, read: Mapping[str, str | None], subject: str, written: Mapping[str, Mapping[str, Json]]
) -> None:
    """Put a manifest into `stage` that lists its files and those of earlier exports that still lie in `folder`.

    Parameters
    ----------
    stage : holds the files that will join `folder`.
    folder : may hold an earlier export, and a manifest of it; a manifest of another kind of result is left alone.
    read : file of the result that these were made of -> SHA-256.
    subject : the person's name.
    written : file -> what is to be said of it: format, source, notes.

    Raises
    ------
    InputError
        The earlier manifest is damaged.
    """
    earlier = read_object(folder / MANIFEST)
    if earlier and earlier.get("kind") != ResultKind.EXPORT.value:
        return
    if "result" in earlier and not isinstance(earlier.get("written"), dict):
        raise InputError(
            "is damaged; move it away and export again", source=folder / MANIFEST, code=Code.DAMAGED_RESULT
        )
    hashes = {name: digest for name, digest in listed(folder).items() if (folder / name).is_file()}
    hashes |= {name: sha256_of(stage / name) or "" for name in files_of(stage)}
    about = {
        **cast(dict[str, Json], earlier.get("written", {})),
        **{name: dict(words) for name, words in written.items()},
    }
    result: dict[str, Json] = {"subject": subject, "sha256": dict(read)}
    for name in written:
        about[name] = {**cast(dict[str, Json], about[name]), "result": result}
    manifest: dict[str, Json] = {
        "gaitcal": package_version("gaitcal"),
        "kind": ResultKind.EXPORT.value,
        "written": {name: about[name] for name in sorted(about) if name in hashes},
        "files": list[Json](sorted(hashes)),
        HASHES: dict[str, Json](sorted(hashes.items())),
    }
    manifest[SELF] = self_hash(manifest)
    (stage / MANIFEST).write_text(json_text(manifest), encoding="utf-8")
