"""Write result folders completely or not at all, by one writer at a time, and check them.

A result is written into a hidden folder `.gaitcal-tmp-NAME` beside its target, which is then
renamed. An error, a full disk or a signal at any moment leaves the old result, or none. The next
run removes what SIGKILL leaves, and restores an old result that had been moved aside
(`.gaitcal-old-NAME`).

All of this happens under the lock of the result, a `filelock` beside it (inside it if the parent
folder is not writable). `dynamics`, `montecarlo` and `export` inside a result are parts of it and
share its lock.

The manifest of a folder has the kind of result, and lists its files with their SHA-256 and that of
its own content (`SELF_HASH`). A folder is replaced only by a result of the same kind, only if every
file in it is listed, and never if it holds an input of the run. Folders that later commands added
(`KEPT_FOLDERS`) are moved into the new result.
"""

import errno
import hashlib
import json
import logging
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from enum import Enum
from pathlib import Path

from filelock import FileLock, Timeout

from gaitcal.errors import Code, InputError
from gaitcal.io.atomic import (
    DISK_FULL,
    UNFINISHED_PREFIX,
    convert_disk_errors,
    defer_signals,
    resolve_path,
)

MANIFEST = "manifest.json"  # The file that marks a folder as a result of gaitcal
FILES, HASHES, SELF_HASH = "files", "sha256", "own_sha256"
"""Entries of a manifest: names of files, file -> SHA-256, and SHA-256 of all other entries."""
OLD_PREFIX, LOCK_PREFIX = ".gaitcal-old-", ".gaitcal-lock-"
"""First parts of hidden names beside or in a folder: of a result being replaced, and of a lock."""
# Files that file browsers write into any folder they show
_LITTER = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
# Longest wait (s) for another writer; a result of many trials with figures is written in less
LOCK_WAIT_S = 60.0
WAIT_NOTICE_S = 1.0  # Waiting for longer is logged
POLL_S = 0.05
_NO_LOCKS = frozenset({errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS})
"""Error numbers of `flock` on a file system without locks."""

_log = logging.getLogger(__name__)


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


KEPT_FOLDERS: dict[ResultKind, tuple[str, ...]] = dict.fromkeys(ResultKind, ()) | {
    ResultKind.CALIBRATION: ("montecarlo", "dynamics", "export", "figures"),
    ResultKind.DYNAMICS: ("figures",),
    ResultKind.SYNTHETIC: ("montecarlo",),
}
"""Folders that later commands put into a result: another run of the first command keeps them."""
PART_FOLDERS = frozenset(name for names in KEPT_FOLDERS.values() for name in names)


# ------------------------------------------------------------------------------ manifest and hashes


def read_json_object(path: Path) -> dict[str, object]:
    """Read the JSON object of a manifest or summary.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    dict
        Empty if there is no such file or it is no JSON object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def list_files(folder: Path, besides: Iterable[str] = (), prefix: str = "") -> tuple[str, ...]:
    """List all files below a folder by names such as `motion/walk.mot`; a link counts as a file.

    Parameters
    ----------
    folder
        The folder.
    besides
        Names of entries of the folder to leave out.
    prefix
        Beginning of the names.

    Returns
    -------
    tuple of str
        Sorted, without temporary and system files.
    """
    names: list[str] = []
    for entry in sorted(folder.iterdir()):
        if entry.name in {*besides, *_LITTER} or entry.name.startswith(
            (UNFINISHED_PREFIX, LOCK_PREFIX)
        ):
            continue
        if entry.is_dir() and not entry.is_symlink():
            names += list_files(entry, (), f"{prefix}{entry.name}/")
        else:
            names.append(prefix + entry.name)
    return tuple(names)


def compute_sha256(path: Path) -> str | None:
    """Compute the SHA-256 of a file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    str or None
        Hexadecimal; None if the file cannot be read.
    """
    digest = hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    except (OSError, ValueError):
        return None
    return digest.hexdigest()


def hash_manifest(manifest: Mapping[str, object]) -> str:
    """Compute the SHA-256 of a manifest's entries without the entry that holds it.

    Parameters
    ----------
    manifest
        Entries of `manifest.json`.

    Returns
    -------
    str
        Hexadecimal.
    """
    entries = {name: value for name, value in manifest.items() if name != SELF_HASH}
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()


def read_listed_hashes(folder: Path) -> dict[str, str]:
    """Read file -> SHA-256 from the manifest of a folder.

    Parameters
    ----------
    folder
        Result folder.

    Returns
    -------
    dict
        Empty if there is no manifest.

    Raises
    ------
    InputError
        The manifest is damaged or was edited.
    """
    manifest = read_json_object(folder / MANIFEST)
    unreadable = not manifest and (folder / MANIFEST).exists()
    if unreadable or (
        (SELF_HASH in manifest or HASHES in manifest)
        and manifest.get(SELF_HASH) != hash_manifest(manifest)
    ):
        message = "is damaged, or was edited: not as gaitcal wrote it; run its command again"
        raise InputError(message, source=folder / MANIFEST, code=Code.DAMAGED_RESULT)
    hashes = manifest.get(HASHES)
    return {str(k): str(v) for k, v in hashes.items()} if isinstance(hashes, dict) else {}


def _write_manifest(folder: Path, manifest: dict[str, object]) -> None:
    manifest[SELF_HASH] = hash_manifest(manifest)
    (folder / MANIFEST).write_text(
        json.dumps(manifest, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )


def check_replaceable(
    target: Path, kind: ResultKind, inputs: Iterable[Path] = ()
) -> tuple[str, ...]:
    """Check that `target` may become a result of this kind.

    `target`: output folder. `inputs`: files that the run reads. Returns: folders in it that are
    kept. Raises InputError: it is a file, or holds an input, another kind of result, or a file that
    gaitcal did not write.
    """

    def refuse(message: str) -> InputError:
        return InputError(message, source=target, code=Code.FOLDER_TAKEN)

    foreign = (
        "contains '{}', which gaitcal did not write; move it away, or give a new or an empty folder"
    )
    if not target.exists():
        return ()
    if not target.is_dir():
        raise refuse("is a file; the output needs a folder")
    for path in inputs:
        if path.resolve().is_relative_to(target.resolve()):
            shown = path.resolve().relative_to(target.resolve()).as_posix()
            raise refuse(f"contains '{shown}', an input of this run; give another folder")
    kept = tuple(
        sorted(
            entry.name
            for entry in target.iterdir()
            if entry.is_dir() and entry.name in KEPT_FOLDERS[kind]
        )
    )
    files = list_files(target, kept)
    if not files and not kept:
        return ()
    manifest = read_json_object(target / MANIFEST)
    old_kind = next(
        (k for k in ResultKind if "gaitcal" in manifest and k.value == manifest.get("kind")), None
    )
    if old_kind is None:
        raise refuse(foreign.format((*files, *kept)[0]))
    if old_kind is not kind:
        message = f"contains another kind of result ({old_kind.value}, this would be {kind.value})"
        raise refuse(f"{message}; give a new or an empty folder")
    names = manifest.get(FILES)
    ours = {MANIFEST, *(names if isinstance(names, list) else ())}
    if strangers := [name for name in files if name not in ours]:
        raise refuse(foreign.format(strangers[0]))
    return kept


# ----------------------------------------------------------------------------- one writer at a time


@contextmanager
def lock_result(folder: Path, purpose: str = "", *, wait_s: float | None = None) -> Iterator[None]:
    """Hold the lock of the result that `folder` is or belongs to; nested locks do nothing.

    Parameters
    ----------
    folder
        Result folder, or a part of one.
    purpose
        Name of another lock on the same folder, such as that of a long Monte Carlo study.
    wait_s
        Longest wait for another process, s; `LOCK_WAIT_S` unless given.

    Raises
    ------
    InputError
        Another process holds the lock for longer.
    OSError
        No file can be created beside or in the folder.
    """
    folder = Path(os.path.realpath(folder))
    is_part = folder.name in PART_FOLDERS and "gaitcal" in read_json_object(
        folder.parent / MANIFEST
    )
    result = folder.parent if is_part else folder
    name = f"{LOCK_PREFIX}{result.name}{'-' if purpose else ''}{purpose.replace(' ', '-')}"
    place = result.with_name(name)
    if result.is_dir() and not place.exists() and not os.access(result.parent, os.W_OK):
        place = result / name
    # Without permission to create the file, filelock would wait in vain
    os.close(os.open(place, os.O_RDWR | os.O_CREAT, 0o644))
    lock = FileLock(place, is_singleton=True)
    _take_lock(lock, folder, LOCK_WAIT_S if wait_s is None else wait_s)
    try:
        yield
    finally:
        if lock.lock_counter <= 1:
            # A process that waits for the removed file begins again. On Windows the file cannot
            # be removed while another process has it open.
            with suppress(OSError):
                os.unlink(lock.lock_file)  # noqa: PTH108
        lock.release()


def _take_lock(lock: FileLock, folder: Path, longest_s: float) -> None:
    try:
        with warnings.catch_warnings():
            # Without locks in the system, filelock would warn and take a file for one, which
            # outlives who is killed.
            warnings.filterwarnings("error", "flock not supported", UserWarning)
            try:
                lock.acquire(timeout=min(WAIT_NOTICE_S, longest_s), poll_interval=POLL_S)
            except Timeout:
                if longest_s > WAIT_NOTICE_S:
                    message = (
                        "gaitcal: %s is being written by another process; waiting up to %.0f s"
                    )
                    _log.warning(message, folder, longest_s)
                lock.acquire(timeout=max(longest_s - WAIT_NOTICE_S, 0.0), poll_interval=POLL_S)
    except Timeout:
        message = "is being written by another process; run again when that has ended"
        raise InputError(message, source=folder, code=Code.LOCKED) from None
    except (OSError, UserWarning) as error:
        if isinstance(error, OSError) and error.errno not in _NO_LOCKS:
            raise
        _log.warning(
            "gaitcal: this file system has no locks; run one command at a time on this folder"
        )


def _restore_old_result(target: Path) -> None:
    """Restore an old result, or a part of one, that a killed run had moved aside, under lock."""
    for place in (target, *(target / name for name in PART_FOLDERS)):
        old = place.with_name(OLD_PREFIX + place.name)
        if place.exists():
            _keep_added_folders(place, old)
        elif old.exists():
            old.rename(place)


def _keep_added_folders(place: Path, old: Path) -> None:
    """Move folders that later commands added from the old result to the new one; remove the old."""
    kind = read_json_object(old / MANIFEST).get("kind")
    for name in next((names for k, names in KEPT_FOLDERS.items() if k.value == kind), ()):
        if (old / name).is_dir() and not (place / name).exists():
            (old / name).rename(place / name)
    shutil.rmtree(old, ignore_errors=True)


# ------------------------------------------------------------------------------------------ writing


@contextmanager
def write_result_folder(
    target: Path | str,
    kind: ResultKind,
    inputs: Iterable[Path] = (),
    carried: Mapping[str, str] | None = None,
) -> Iterator[Path]:
    """Yield an empty folder; on success it replaces `target`, under the lock of the target.

    The kind and the list of files with their SHA-256 are added to the `manifest.json` that the body
    writes. Folders that later commands added to the earlier result (`KEPT_FOLDERS`) are kept.

    Parameters
    ----------
    target
        Folder of the result.
    kind
        Kind of the result.
    inputs
        Files that the run reads.
    carried
        SHA-256, as listed earlier, of files copied from the earlier result. A file that was damaged
        there stays detectable. The body may fill it.

    Yields
    ------
    Path
        The empty folder.

    Raises
    ------
    InputError
        `target` must not be replaced (`check_replaceable`) or cannot be written, the disk is full,
        or another process writes it.
    """
    target, inputs = resolve_path(target), tuple(inputs)
    with ExitStack() as stack:
        with convert_disk_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(lock_result(target))
            _restore_old_result(target)
            check_replaceable(target, kind, inputs)
            content = stack.enter_context(
                _make_empty_folder(target.with_name(UNFINISHED_PREFIX + target.name))
            )
        with convert_disk_errors(target, only=DISK_FULL):
            yield content
        with convert_disk_errors(target):
            kept = check_replaceable(target, kind, inputs)
            files = [name for name in list_files(content) if name != MANIFEST]
            hashes = {
                name: (carried or {}).get(name) or compute_sha256(content / name) for name in files
            }
            manifest = {
                "gaitcal": "",
                **read_json_object(content / MANIFEST),
                "kind": kind.value,
                FILES: files,
            }
            more = {"kept_from_earlier_result": list(kept)} if kept else {}
            _write_manifest(content, {**manifest, HASHES: hashes, **more})
            with defer_signals():
                old = target.with_name(OLD_PREFIX + target.name)
                if target.exists():
                    target.rename(old)
                try:
                    content.rename(target)
                except OSError:
                    if old.exists():
                        old.rename(target)
                    raise
                _keep_added_folders(target, old)


def check_output_folder(
    target: Path | str, kind: ResultKind, inputs: Iterable[Path] = ()
) -> tuple[str, ...]:
    """Raise before long work what `write_result_folder` would raise after it.

    Parameters
    ----------
    target
        Output folder; nothing is left behind in it.
    kind
        Kind of the new result.
    inputs
        Files that the run reads.

    Returns
    -------
    tuple of str
        Folders of an earlier result that will be kept.

    Raises
    ------
    InputError
        As `write_result_folder`.
    """
    target = resolve_path(target)
    with convert_disk_errors(target), ExitStack() as stack:
        with suppress(FileNotFoundError):
            target.lstat()  # a name too long, a file where a folder should be
        if target.parent.is_dir():
            stack.enter_context(lock_result(target))
            _restore_old_result(target)
        kept = check_replaceable(target, kind, inputs)
        parent = next(folder for folder in target.parents if folder.exists())
        stack.enter_context(tempfile.TemporaryDirectory(prefix=UNFINISHED_PREFIX, dir=parent))
    return kept


@contextmanager
def _make_empty_folder(folder: Path) -> Iterator[Path]:
    """Create an empty folder in place of one that a killed run left; remove it afterwards."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        yield folder
    finally:
        with defer_signals():
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def amend_result(folder: Path | str) -> Iterator[Path]:
    """Yield an empty folder; on success its files are moved into `folder`.

    Files are moved when all are written, and signals are deferred meanwhile. A manifest of `folder`
    gets the new SHA-256 of listed files, unless the body writes one, and is moved last. After a
    kill between two renames (some milliseconds) the files fail the check, and the command can be
    repeated.

    Parameters
    ----------
    folder
        Result folder; created if it does not exist.

    Yields
    ------
    Path
        The empty folder.

    Raises
    ------
    InputError
        The folder cannot be written, the disk is full, or another process writes it.
    """
    folder = resolve_path(folder)
    with ExitStack() as stack:
        with convert_disk_errors(folder):
            if not folder.is_dir():
                folder.mkdir(parents=True)
                stack.callback(_remove_if_empty, folder)
            stack.enter_context(lock_result(folder))
            stage = stack.enter_context(_make_empty_folder(folder / f"{UNFINISHED_PREFIX}files"))
        with convert_disk_errors(folder, only=DISK_FULL):
            yield stage
        with convert_disk_errors(folder), defer_signals():
            names = [name for name in list_files(stage) if name != MANIFEST]
            manifest = read_json_object(folder / MANIFEST)
            hashes = manifest.get(HASHES)
            sound = isinstance(hashes, dict) and manifest.get(SELF_HASH) == hash_manifest(manifest)
            new = {name: compute_sha256(stage / name) for name in names if sound and name in hashes}  # type: ignore[operator]
            if new and not (stage / MANIFEST).exists():
                _write_manifest(stage, {**manifest, HASHES: {**hashes, **new}})  # type: ignore[dict-item]
            if (stage / MANIFEST).exists():
                names.append(MANIFEST)
            for name in names:
                if (folder / name).is_dir():
                    message = "is a folder; the name of a file is needed"
                    raise InputError(message, source=folder / name, code=Code.NOT_WRITABLE)
            for name in names:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (stage / name).replace(folder / name)


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


@contextmanager
def write_file_in_place(target: Path | str) -> Iterator[Path]:
    """Yield a path at which to write one file; beside a manifest, the file amends the result.

    Parameters
    ----------
    target
        The file.

    Yields
    ------
    Path
        Path with the same name.

    Raises
    ------
    InputError
        As `amend_result`.
    """
    target = resolve_path(target)
    if "gaitcal" in read_json_object(target.parent / MANIFEST):
        with amend_result(target.parent) as stage:
            yield stage / target.name
    else:
        yield target
