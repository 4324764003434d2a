"""Result folders: written whole or not at all, by one writer at a time, and read as they were
written.

A result is written into a hidden folder `.gaitcal-tmp-NAME` beside its place, which is then renamed
to it: an error, a full disk or a signal at any moment leaves the old result, or none where there
was none. What SIGKILL leaves is removed by the next run, which also puts back an old result that
was moved aside when the kill came (`.gaitcal-old-NAME`).

All of this happens under the lock of the result, a `filelock` beside it (inside it where nobody may
write beside it). `dynamics`, `montecarlo` and `export` inside a result are parts of it and have its
lock.

The manifest of a folder says what kind of result it is and lists its files with their SHA-256, and
that of its own content (`SELF`). A folder is replaced only by a result of the same kind, only while
every file in it is listed, and never while it holds an input of the run. What later commands added
to it (`KEPT`) is moved into the new result.
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
from gaitcal.io.atomic import FULL, UNFINISHED, disk_errors, real_path, unbroken

MANIFEST = "manifest.json"  # The file that marks a folder as a result of gaitcal
FILES, HASHES, SELF = "files", "sha256", "own_sha256"
"""Entries of a manifest: names of files, file -> SHA-256, and SHA-256 of all other entries."""
OLD, LOCK = ".gaitcal-old-", ".gaitcal-lock-"
"""Beginnings of hidden names beside or in a folder: what is being replaced, and that somebody
writes now.
"""
_LITTER = frozenset(
    {".DS_Store", "Thumbs.db", "desktop.ini"}
)  # written by file browsers, into any folder they show
WAIT_S = 60.0  # A result of many trials with all its figures is written in less
NOTICE_S = 1.0  # Waiting for longer is logged
POLL_S = 0.05
_NO_LOCKS = frozenset({errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS})
"""What `flock` answers on a file system that has none."""

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


KEPT: dict[ResultKind, tuple[str, ...]] = dict.fromkeys(ResultKind, ()) | {
    ResultKind.CALIBRATION: ("montecarlo", "dynamics", "export", "figures"),
    ResultKind.DYNAMICS: ("figures",),
    ResultKind.SYNTHETIC: ("montecarlo",),
}
"""Folders that later commands put into a result: another run of the first command keeps them."""
PARTS = frozenset(name for names in KEPT.values() for name in names)


# -------------------------------------------------------------------------------------------- manifest and hashes


def read_object(path: Path) -> dict[str, object]:
    """The JSON object in a manifest or summary; empty where there is none, which is then no result
    of ours.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def files_of(folder: Path, besides: Iterable[str] = (), prefix: str = "") -> tuple[str, ...]:
    """Every file below `folder`, as `motion/walk.mot`; a link is a file, whatever it points to."""
    names: list[str] = []
    for entry in sorted(folder.iterdir()):
        if entry.name in {*besides, *_LITTER} or entry.name.startswith((UNFINISHED, LOCK)):
            continue
        if entry.is_dir() and not entry.is_symlink():
            names += files_of(entry, (), f"{prefix}{entry.name}/")
        else:
            names.append(prefix + entry.name)
    return tuple(names)


def sha256_of(path: Path) -> str | None:
    """SHA-256 of a file, hexadecimal; None where there is none, or it cannot be read."""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    except (OSError, ValueError):
        return None
    return digest.hexdigest()


def self_hash(manifest: Mapping[str, object]) -> str:
    """SHA-256 of a manifest's entries, but for the one that holds it."""
    entries = {name: value for name, value in manifest.items() if name != SELF}
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()


def listed(folder: Path) -> dict[str, str]:
    """File -> SHA-256, as the manifest of a folder lists them; empty where there is none.

    InputError where the manifest is not as it was written.
    """
    manifest = read_object(folder / MANIFEST)
    unreadable = not manifest and (folder / MANIFEST).exists()
    if unreadable or (
        (SELF in manifest or HASHES in manifest) and manifest.get(SELF) != self_hash(manifest)
    ):
        message = "is damaged, or was edited: not as gaitcal wrote it; run again what wrote it"
        raise InputError(message, source=folder / MANIFEST, code=Code.DAMAGED_RESULT)
    hashes = manifest.get(HASHES)
    return {str(k): str(v) for k, v in hashes.items()} if isinstance(hashes, dict) else {}


def _write_manifest(folder: Path, manifest: dict[str, object]) -> None:
    manifest[SELF] = self_hash(manifest)
    (folder / MANIFEST).write_text(
        json.dumps(manifest, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )


def refuse_others(target: Path, kind: ResultKind, inputs: Iterable[Path] = ()) -> tuple[str, ...]:
    """Make sure that `target` may become a result of this kind; returns the folders in it that are
    to be kept.

    InputError where it is a file, holds one of the inputs, another kind of result, or a file that
    gaitcal did not write there.
    """

    def refuse(message: str) -> InputError:
        return InputError(message, source=target, code=Code.FOLDER_TAKEN)

    foreign = (
        "holds '{}', which gaitcal did not write there; move it away, or name a new or an empty "
        "folder"
    )
    if not target.exists():
        return ()
    if not target.is_dir():
        raise refuse("is a file; the output needs a folder")
    for path in inputs:
        if path.resolve().is_relative_to(target.resolve()):
            shown = path.resolve().relative_to(target.resolve()).as_posix()
            raise refuse(f"holds '{shown}', an input of this run; name another folder")
    kept = tuple(
        sorted(
            entry.name for entry in target.iterdir() if entry.is_dir() and entry.name in KEPT[kind]
        )
    )
    files = files_of(target, kept)
    if not files and not kept:
        return ()
    manifest = read_object(target / MANIFEST)
    old_kind = next(
        (k for k in ResultKind if "gaitcal" in manifest and k.value == manifest.get("kind")), None
    )
    if old_kind is None:
        raise refuse(foreign.format((*files, *kept)[0]))
    if old_kind is not kind:
        message = f"holds another kind of result ({old_kind.value}, this would be {kind.value})"
        raise refuse(f"{message}; name a new or an empty folder")
    names = manifest.get(FILES)
    ours = {MANIFEST, *(names if isinstance(names, list) else ())}
    if strangers := [name for name in files if name not in ours]:
        raise refuse(foreign.format(strangers[0]))
    return kept


# ------------------------------------------------------------------------------------------------ one writer at a time


@contextmanager
def locked(folder: Path, purpose: str = "", *, wait_s: float | None = None) -> Iterator[None]:
    """Hold the lock of the result that `folder` is or is a part of; within it, taking it again does
    nothing.

    InputError where another process holds it for longer, OSError where no file can be made beside
    or in the folder.

    `purpose`: another lock on the same folder, such as that of a Monte Carlo study which goes on
    for hours. `wait_s`: how long to wait for another process; `WAIT_S` unless given.
    """
    folder = Path(os.path.realpath(folder))
    is_part = folder.name in PARTS and "gaitcal" in read_object(folder.parent / MANIFEST)
    result = folder.parent if is_part else folder
    name = f"{LOCK}{result.name}{'-' if purpose else ''}{purpose.replace(' ', '-')}"
    place = result.with_name(name)
    if result.is_dir() and not place.exists() and not os.access(result.parent, os.W_OK):
        place = result / name
    os.close(
        os.open(place, os.O_RDWR | os.O_CREAT, 0o644)
    )  # filelock waits in vain where no file can be made
    lock = FileLock(place, is_singleton=True)
    _take(lock, folder, WAIT_S if wait_s is None else wait_s)
    try:
        yield
    finally:
        if lock.lock_counter <= 1:
            with suppress(OSError):  # on Windows, where another one has it open
                os.unlink(lock.lock_file)  # noqa: PTH108  who waits for the removed file begins again
        lock.release()


def _take(lock: FileLock, folder: Path, longest_s: float) -> None:
    try:
        with warnings.catch_warnings():
            # Without locks in the system, filelock would warn and take a file for one, which
            # outlives who is killed.
            warnings.filterwarnings("error", "flock not supported", UserWarning)
            try:
                lock.acquire(timeout=min(NOTICE_S, longest_s), poll_interval=POLL_S)
            except Timeout:
                if longest_s > NOTICE_S:
                    message = (
                        "gaitcal: %s is being written by another process; waiting up to %.0f s"
                    )
                    _log.warning(message, folder, longest_s)
                lock.acquire(timeout=max(longest_s - NOTICE_S, 0.0), poll_interval=POLL_S)
    except Timeout:
        message = "is being written by another process; run again when that has ended"
        raise InputError(message, source=folder, code=Code.LOCKED) from None
    except (OSError, UserWarning) as error:
        if isinstance(error, OSError) and error.errno not in _NO_LOCKS:
            raise
        _log.warning(
            "gaitcal: this file system has no locks; run one command at a time on this folder"
        )


def _recover(target: Path) -> None:
    """Put back an old result, or a part of one, that a killed run had moved aside. The lock of
    `target` is held.
    """
    for place in (target, *(target / name for name in PARTS)):
        old = place.with_name(OLD + place.name)
        if place.exists():
            _settle(place, old)
        elif old.exists():
            old.rename(place)


def _settle(place: Path, old: Path) -> None:
    """Move what later commands added to an old result into the new one at `place`, and remove the
    old one.
    """
    kind = read_object(old / MANIFEST).get("kind")
    for name in next((names for of, names in KEPT.items() if of.value == kind), ()):
        if (old / name).is_dir() and not (place / name).exists():
            (old / name).rename(place / name)
    shutil.rmtree(old, ignore_errors=True)


# --------------------------------------------------------------------------------------------------------- writing


@contextmanager
def atomic_directory(
    target: Path | str,
    kind: ResultKind,
    inputs: Iterable[Path] = (),
    carried: Mapping[str, str] | None = None,
) -> Iterator[Path]:
    """Yield an empty folder; on success it becomes `target`, replacing what an earlier run of this
    kind wrote there.

    To the `manifest.json` that the body writes are added the kind and the list of files with their
    SHA-256. Folders that later commands put into the earlier result (`KEPT`) go on into the new
    one. The lock of the target is held.

    InputError where `target` is a file, or a folder that holds one of the `inputs`, another kind of
    result, or files that gaitcal did not write there; where it cannot be written; the disk is full;
    another process writes it.

    `carried`: SHA-256 of files that the body carries over from the earlier result, as that one
    listed them, so that what was damaged there stays damaged here; may be filled by the body.
    """
    target, inputs = real_path(target), tuple(inputs)
    with ExitStack() as stack:
        with disk_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(target))
            _recover(target)
            refuse_others(target, kind, inputs)
            content = stack.enter_context(_empty(target.with_name(UNFINISHED + target.name)))
        with disk_errors(target, only=FULL):
            yield content
        with disk_errors(target):
            kept = refuse_others(target, kind, inputs)
            files = [name for name in files_of(content) if name != MANIFEST]
            hashes = {
                name: (carried or {}).get(name) or sha256_of(content / name) for name in files
            }
            manifest = {
                "gaitcal": "",
                **read_object(content / MANIFEST),
                "kind": kind.value,
                FILES: files,
            }
            more = {"kept_from_earlier_result": list(kept)} if kept else {}
            _write_manifest(content, {**manifest, HASHES: hashes, **more})
            with unbroken():
                old = target.with_name(OLD + target.name)
                if target.exists():
                    target.rename(old)
                try:
                    content.rename(target)
                except OSError:
                    if old.exists():
                        old.rename(target)
                    raise
                _settle(target, old)


def require_room(
    target: Path | str, kind: ResultKind, inputs: Iterable[Path] = ()
) -> tuple[str, ...]:
    """Raise before long work what `atomic_directory` would raise after it; leaves nothing behind.

    Returns the names of the folders of an earlier result that the new one will keep.
    """
    target = real_path(target)
    with disk_errors(target), ExitStack() as stack:
        with suppress(FileNotFoundError):
            target.lstat()  # a name too long, a file where a folder should be
        if target.parent.is_dir():
            stack.enter_context(locked(target))
            _recover(target)
        kept = refuse_others(target, kind, inputs)
        parent = next(folder for folder in target.parents if folder.exists())
        stack.enter_context(tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=parent))
    return kept


@contextmanager
def _empty(folder: Path) -> Iterator[Path]:
    """A new folder, in the place of one that a killed run left; gone afterwards."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        yield folder
    finally:
        with unbroken():
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def amended(folder: Path | str) -> Iterator[Path]:
    """Yield an empty folder; on success the files in it take their places in `folder`, which need
    not be there.

    They are moved when all are written, one rename each, and no signal is felt meanwhile. A
    manifest of `folder` that lists one of them gets its new SHA-256, unless a manifest is among
    them, and is moved last: killed between two renames (some milliseconds), what does not belong
    together is damaged, and the same command makes it anew. InputError where the folder cannot be
    written, the disk is full, or another process writes it.
    """
    folder = real_path(folder)
    with ExitStack() as stack:
        with disk_errors(folder):
            if not folder.is_dir():
                folder.mkdir(parents=True)
                stack.callback(_remove_if_empty, folder)
            stack.enter_context(locked(folder))
            stage = stack.enter_context(_empty(folder / f"{UNFINISHED}files"))
        with disk_errors(folder, only=FULL):
            yield stage
        with disk_errors(folder), unbroken():
            names = [name for name in files_of(stage) if name != MANIFEST]
            manifest = read_object(folder / MANIFEST)
            hashes = manifest.get(HASHES)
            sound = isinstance(hashes, dict) and manifest.get(SELF) == self_hash(manifest)
            new = {name: sha256_of(stage / name) for name in names if sound and name in hashes}  # type: ignore[operator]
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
def file_in_place(target: Path | str) -> Iterator[Path]:
    """Yield a path of the same name for a file that is written whole; beside a manifest, that file
    is an amendment.
    """
    target = real_path(target)
    if "gaitcal" in read_object(target.parent / MANIFEST):
        with amended(target.parent) as stage:
            yield stage / target.name
    else:
        yield target
