"""Results appear whole or not at all, replace nothing but their own kind, and are read as they were
written.
"""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from gaitcal.errors import Code, InputError
from gaitcal.io import result_folder, snapshot
from gaitcal.io.atomic import write_atomically, write_text_atomically
from gaitcal.io.result_folder import (
    KEPT_FOLDERS,
    MANIFEST,
    OLD_PREFIX,
    ResultKind,
    amend_result,
    check_output_folder,
    compute_sha256,
    lock_result,
    read_listed_hashes,
    write_file_in_place,
    write_result_folder,
)
from gaitcal.io.snapshot import read_whole
from tests.commands import content, refused
from tests.messages import check_text, refuses


def write_result(
    target: Path,
    content: str,
    kind: ResultKind = ResultKind.CALIBRATION,
    inputs: tuple[Path, ...] = (),
) -> None:
    with write_result_folder(target, kind, inputs) as folder:
        (folder / MANIFEST).write_text('{"gaitcal": "0.1.0"}')
        (folder / "motion").mkdir()
        (folder / "motion" / "walk.mot").write_text(content)


def result(target: Path) -> str:
    return (target / "motion" / "walk.mot").read_text()


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_new_then_replaced(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "out"
    write_result(target, "one")
    (target / "motion" / ".DS_Store").touch()
    write_result(target, "two")
    assert result(target) == "two"
    assert names(target) == ["manifest.json", "motion"]
    assert names(target.parent) == ["out"]
    (tmp_path / "plain").mkdir()
    assert target.stat().st_mode == (tmp_path / "plain").stat().st_mode


# ----------------------------------------------------------------------------- whole, or not at all


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt(), SystemExit(2)], ids=repr)
@pytest.mark.parametrize(
    "write", [lambda path: write_result_folder(path, ResultKind.CALIBRATION), amend_result]
)
def test_failure_leaves_the_old_or_none(
    tmp_path: Path, error: BaseException, write: object
) -> None:
    def fail(target: Path) -> None:
        with write(target) as folder:
            (folder / "motion").mkdir()
            (folder / "motion/walk.mot").write_text("half")
            raise error

    with pytest.raises(type(error)):
        fail(tmp_path / "new")
    assert names(tmp_path) == []
    write_result(tmp_path / "out", "one")
    before = content(tmp_path)
    with pytest.raises(type(error)):
        fail(tmp_path / "out")
    assert content(tmp_path) == before


def test_what_a_killed_run_left_is_put_right_by_the_next(tmp_path: Path) -> None:
    target = tmp_path / "out"
    write_result(target, "one")
    write_result(target / "dynamics", "further", ResultKind.DYNAMICS)
    (target / "dynamics").rename(target / f"{OLD_PREFIX}dynamics")
    target.rename(tmp_path / f"{OLD_PREFIX}out")
    assert check_output_folder(target, ResultKind.CALIBRATION) == ("dynamics",)
    assert result(target) == "one"
    assert result(target / "dynamics") == "further"
    assert names(tmp_path) == ["out"]


def test_a_kill_before_later_work_was_moved_loses_none_of_it(tmp_path: Path) -> None:
    """The new result is in its place, the draws still in the old one."""
    target = tmp_path / "out"
    write_result(target, "one")
    (target / "montecarlo").mkdir()
    (target / "montecarlo/draws").write_text("hours")
    target.rename(tmp_path / f"{OLD_PREFIX}out")
    write_result(tmp_path / "new", "two")
    (tmp_path / "new").rename(target)
    check_output_folder(target, ResultKind.CALIBRATION)
    assert result(target) == "two" and (target / "montecarlo/draws").read_text() == "hours"
    assert names(tmp_path) == ["out"]


REPLACE = """
import sys
from pathlib import Path
from gaitcal.io.result_folder import ResultKind, write_result_folder
n = 0
while True:
    n += 1
    with write_result_folder(Path(sys.argv[1]), ResultKind.CALIBRATION) as folder:
        (folder / "manifest.json").write_text('{"gaitcal": "0"}')
        (folder / "motion").mkdir()
        (folder / "motion/walk.mot").write_text(f"{n}\\n" * 1000)
    n == 1 and print(n, flush=True)
"""


def test_kill_at_any_moment_leaves_a_whole_result(tmp_path: Path) -> None:
    """A loop that replaces a result as fast as it can, killed at six different moments."""
    target = tmp_path / "out"
    write_result(target, "0\n" * 1000)
    (target / "montecarlo").mkdir()
    (target / "montecarlo/draws").write_text("hours")
    for number in range(6):
        process = subprocess.Popen(
            [sys.executable, "-c", REPLACE, str(target)], stdout=subprocess.PIPE
        )
        with process.stdout as stream:
            stream.readline()
        time.sleep(0.007 * number)
        process.kill()
        process.wait()
        check_output_folder(target, ResultKind.CALIBRATION)
        assert len(set(result(target).split())) == 1 and result(target).count("\n") == 1000
        assert (target / "montecarlo/draws").read_text() == "hours"
    write_result(target, "end")
    assert names(tmp_path) == ["out"]


def test_full_disk_is_one_line_but_other_errors_of_the_body_stay_themselves(tmp_path: Path) -> None:
    with (
        refuses(Code.NOT_WRITABLE, source="out"),
        write_result_folder(tmp_path / "out", ResultKind.CALIBRATION),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with (
        pytest.raises(PermissionError),
        write_result_folder(tmp_path / "out", ResultKind.CALIBRATION),
    ):
        raise PermissionError(errno.EACCES, "an input file")
    assert names(tmp_path) == []


def test_unwritable_places_end_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for target in (
        tmp_path / "file",
        tmp_path / "file" / "out",
        tmp_path / ("x" * 300),
        Path("/proc/none/out"),
    ):
        for write in (
            lambda path: write_result(path, "one"),
            lambda path: write_text_atomically(path / "deeper" / "file.txt", "text"),
            lambda path: check_output_folder(path, ResultKind.CALIBRATION),
        ):
            with refused(""):
                write(target)
    with refused("no usable path"):
        write_result(tmp_path / "nul\0", "one")
    assert names(tmp_path) == ["file"]


def test_links_stay_links(tmp_path: Path) -> None:
    for name in ("real", "disk"):
        (tmp_path / name).mkdir()
    (tmp_path / "disk/draws").touch()
    (tmp_path / "out").symlink_to("real")
    write_result(tmp_path / "out", "one")
    (tmp_path / "out/montecarlo").symlink_to("../disk")
    write_result(tmp_path / "out", "two")
    assert (tmp_path / "out").is_symlink() and (tmp_path / "real/montecarlo").is_symlink()
    assert result(tmp_path / "real") == "two"
    assert (tmp_path / "out/montecarlo/draws").exists()


# --------------------------------------------------------------------------------- what is not ours


def assert_refused(
    target: Path, kind: ResultKind, told: str, inputs: tuple[Path, ...] = ()
) -> None:
    """In the same line before the work and after it."""
    before = content(target)
    with refused(told):
        check_output_folder(target, kind, inputs)
    with refused(told):
        write_result(target, "two", kind, inputs)
    assert content(target) == before


@pytest.mark.parametrize("there", ResultKind)
def test_only_the_same_kind_is_replaced(there: ResultKind, tmp_path: Path) -> None:
    write_result(tmp_path / "out", "one", there)
    manifest = json.loads((tmp_path / "out" / MANIFEST).read_text())
    assert (manifest["kind"], manifest["files"]) == (there.value, ["motion/walk.mot"])
    coming = ResultKind.COHORT if there is not ResultKind.COHORT else ResultKind.EXAMPLE
    told = f"another kind of result ({there.value}, this would be {coming.value})"
    assert_refused(tmp_path / "out", coming, told)
    write_result(tmp_path / "out", "two", there)
    assert result(tmp_path / "out") == "two"


@pytest.mark.parametrize(
    "name", ["mynotes.txt", "moments/mine.png", "motion/walk.csv", "dynamic/x", "montecarlo"]
)
def test_a_file_that_is_not_ours_is_named(name: str, tmp_path: Path) -> None:
    write_result(tmp_path / "out", "one")
    (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
    (tmp_path / "out" / name).write_text("hours of work")
    assert_refused(
        tmp_path / "out", ResultKind.CALIBRATION, f"contains '{name}', which gaitcal did not write"
    )


@pytest.mark.parametrize(
    "there", [{"notes.txt": "mine"}, {"manifest.json": "{}"}, {"manifest.json": "\0"}]
)
def test_a_folder_of_the_users_is_refused_and_an_empty_one_used(
    tmp_path: Path, there: dict[str, str]
) -> None:
    (tmp_path / "out").mkdir()
    for name, text in there.items():
        (tmp_path / "out" / name).write_text(text)
    assert_refused(tmp_path / "out", ResultKind.CALIBRATION, "which gaitcal did not write")
    (tmp_path / "empty").mkdir()
    write_result(tmp_path / "empty", "one")


def test_a_link_and_a_file_that_appears_during_the_run_are_not_ours(tmp_path: Path) -> None:
    write_result(tmp_path / "out", "one")
    with (
        refuses(Code.FOLDER_TAKEN, "notes.txt", source="out"),
        write_result_folder(tmp_path / "out", ResultKind.CALIBRATION),
    ):
        (tmp_path / "out/notes.txt").write_text("mine")
    assert (tmp_path / "out/notes.txt").read_text() == "mine"
    (tmp_path / "out/notes.txt").unlink()
    (tmp_path / "data").mkdir()
    (tmp_path / "out/data").symlink_to(tmp_path / "data")
    assert_refused(tmp_path / "out", ResultKind.CALIBRATION, "contains 'data'")


def test_inputs_are_never_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "raw").mkdir(parents=True)
    (out / "raw/walk.c3d").touch()
    (tmp_path / "link").symlink_to(out)
    for target in (out, tmp_path / "link", tmp_path):
        assert_refused(
            target,
            ResultKind.CALIBRATION,
            "walk.c3d', an input of this run",
            (out / "raw/walk.c3d",),
        )
    write_result(tmp_path / "result", "one", inputs=(out / "raw/walk.c3d",))


def test_what_later_commands_added_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_result(out, "one")
    for name in KEPT_FOLDERS[ResultKind.CALIBRATION]:
        (out / name / "deeper").mkdir(parents=True)
        (out / name / "deeper/file").write_text(name)
    (out / ".gaitcal-tmp-abc").mkdir()  # a killed run's
    kept = tuple(sorted(KEPT_FOLDERS[ResultKind.CALIBRATION]))
    for text in ("two", "three"):
        assert check_output_folder(out, ResultKind.CALIBRATION) == kept
        write_result(out, text)
    assert result(out) == "three"
    assert {name: (out / name / "deeper/file").read_text() for name in kept} == {
        name: name for name in kept
    }
    assert json.loads((out / MANIFEST).read_text())["kept_from_earlier_result"] == list(kept)
    assert names(tmp_path) == ["out"]


# ------------------------------------------------------------------------------------- single files


def test_a_file_has_its_name_while_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with write_atomically(path) as stage:
        assert stage.name == "a.txt"
        stage.write_text("whole")
        assert not path.exists()
    write_text_atomically(path, "ν\r\n")
    assert path.read_bytes() == "ν\r\n".encode()
    with pytest.raises(UnicodeEncodeError):
        write_text_atomically(path, "\ud800")
    assert path.read_text() == "ν\n"
    with refuses(Code.FOLDER_TAKEN):
        write_text_atomically(tmp_path, "x")
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_files_take_their_places_though_a_signal_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, replace = tmp_path / "out", Path.replace
    for name in ("one", "two"):
        write_text_atomically(out / name, "old")

    def signalled(path: Path, target: Path) -> Path:
        os.kill(os.getpid(), signal.SIGINT)
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", signalled)
    with pytest.raises(KeyboardInterrupt), amend_result(out) as stage:
        for name in ("one", "two", "deeper/three"):
            (stage / name).parent.mkdir(exist_ok=True)
            (stage / name).write_text("new")
    assert content(out) == dict.fromkeys(("deeper/three", "one", "two"), b"new")
    assert names(out) == ["deeper", "one", "two"]


def test_a_folder_in_the_way_is_told_before_anything_moves(tmp_path: Path) -> None:
    write_text_atomically(tmp_path / "one", "old")
    (tmp_path / "three").mkdir()
    with refuses(Code.NOT_WRITABLE, source="three"), amend_result(tmp_path) as stage:
        for name in ("one", "three"):
            (stage / name).write_text("new")
    assert content(tmp_path) == {"one": b"old"}


def test_the_manifest_learns_of_it(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with write_result_folder(out, ResultKind.CALIBRATION) as folder:
        (folder / MANIFEST).write_text('{"gaitcal": "0"}')
        (folder / "report.html").write_text("old")
        (folder / "view.html").write_text("old")
    with amend_result(out) as stage:
        (stage / "report.html").write_text("new")
        (stage / "export").mkdir()
        (stage / "export/model.osim").write_text("of nobody's list")
    with write_file_in_place(out / "view.html") as path:
        path.write_text("new")
    assert read_listed_hashes(out) == {
        name: compute_sha256(out / name) for name in ("report.html", "view.html")
    }
    with write_file_in_place(tmp_path / "view.html") as path:
        assert path == tmp_path / "view.html"  # no result of ours: nothing but the file
    manifest = json.loads((out / MANIFEST).read_text())
    (out / MANIFEST).write_text(json.dumps({**manifest, "number": 1}))
    with amend_result(out) as stage:
        (stage / "report.html").write_text("newer")
    with refuses(Code.DAMAGED_RESULT, source="manifest.json"):
        read_listed_hashes(out)


# ----------------------------------------------------------------------------- one writer at a time

HOLD = """
import sys, time
from pathlib import Path
from gaitcal.io.result_folder import lock_result
with lock_result(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@contextmanager
def held_elsewhere(folder: Path) -> Iterator[None]:
    """By a process, which is killed at the end."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True
    )
    try:
        with process.stdout as stream:
            assert stream.readline() == "held\n"
        yield
    finally:
        process.kill()
        process.wait()


def test_it_is_told_while_waiting_and_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(result_folder, "WAIT_NOTICE_S", 0.1)
    with held_elsewhere(tmp_path / "out"):
        with (
            refused("out: is being written by another process"),
            lock_result(tmp_path / "out", wait_s=0.5),
        ):
            pass
        assert "is being written by another process; waiting" in caplog.text
        with (
            lock_result(tmp_path / "other", wait_s=0.0),
            lock_result(tmp_path / "out", "another purpose", wait_s=0.0),
        ):
            pass
    with lock_result(tmp_path / "out", wait_s=0.0):  # the killed process holds it no longer
        pass
    assert names(tmp_path) == []


def test_again_within_and_in_another_thread(tmp_path: Path) -> None:
    def other() -> None:
        with refused("is being written by"), lock_result(tmp_path / "out", wait_s=0.1):
            pass

    with (
        lock_result(tmp_path / "out"),
        lock_result(tmp_path / "out"),
        ThreadPoolExecutor() as threads,
    ):
        threads.submit(other).result()
    assert names(tmp_path) == []


def test_parts_of_a_result_have_its_lock_and_other_folders_of_such_names_their_own(
    tmp_path: Path,
) -> None:
    result = tmp_path / "result"
    (result / "dynamics").mkdir(parents=True)
    with held_elsewhere(result):
        with lock_result(result / "dynamics", wait_s=0.0):
            pass  # a folder of the user's that is called so
        (result / MANIFEST).write_text('{"gaitcal": "0"}')
        for part in ("dynamics", "montecarlo", "export"):
            with refused("is being written by"), lock_result(result / part, wait_s=0.0):
                pass


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "number", [errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS], ids=errno.errorcode.get
)
def test_a_file_system_without_locks_is_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, number: int
) -> None:
    """In one line; the work goes on."""

    def none(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(pytest.importorskip("fcntl"), "flock", none)
    with lock_result(tmp_path / "out"):
        pass
    (line,) = caplog.messages
    check_text(line)
    assert names(tmp_path) == []


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with write_result_folder(tmp_path / "out", ResultKind.CALIBRATION) as out:
        (out / MANIFEST).write_text(
            json.dumps({"gaitcal": "0", "subject": "Zoë", "number": 0.1}), encoding="utf-8"
        )
        (out / "model.toml").write_text("a = 1\n")
        (out / "splines.npz").write_bytes(bytes(range(200)))
    return tmp_path / "out"


def read(folder: Path, *names: str) -> tuple[bytes, snapshot.Snapshot]:
    return read_whole(folder, names, lambda: (folder / names[0]).read_bytes(), ("model.toml",))


def test_every_file_is_listed_with_its_hash_and_an_edited_one_that_may_be_is_told(
    folder: Path,
) -> None:
    assert read_listed_hashes(folder) == {
        name: compute_sha256(folder / name) for name in ("model.toml", "splines.npz")
    }
    data, files = read(folder, "splines.npz", "marker_set.toml")
    assert data == bytes(range(200))
    assert files.sha256 == {
        "splines.npz": compute_sha256(folder / "splines.npz"),
        "marker_set.toml": None,
    }
    assert files.remarks == ()
    files.require_unchanged()
    (folder / "model.toml").write_text("a = 2\n")
    data, files = read(folder, "model.toml", "splines.npz")
    assert data == b"a = 2\n"
    (remark,) = files.remarks
    check_text(remark, "model.toml")


def test_a_damaged_file_is_named(folder: Path) -> None:
    path = folder / "splines.npz"
    for spoilt in (path.read_bytes()[:100], b"\x01" + path.read_bytes()[1:], b""):
        path.write_bytes(spoilt)
        with refused("splines.npz: is damaged: not as gaitcal wrote it; calibrate again"):
            read(folder, "splines.npz")
    read(folder, "model.toml")  # nothing else suffers
    path.unlink()
    with refused("splines.npz: is missing"):
        read(folder, "splines.npz")


def test_what_changes_while_it_is_read_is_told(folder: Path) -> None:
    for ending in (None, InputError("half a file")):

        def change(ending: InputError | None = ending) -> None:
            (folder / "model.toml").write_text((folder / "model.toml").read_text() + "# changed\n")
            if ending is not None:
                raise ending

        with refuses(Code.CHANGED_FILE, source="out"):
            read_whole(folder, ("model.toml",), change, ("model.toml",))


def test_what_changed_since_it_was_read_is_told(folder: Path) -> None:
    _, files = read(folder, "model.toml", "splines.npz", "marker_set.toml")
    (folder / "marker_set.toml").touch()
    with refuses(Code.CHANGED_FILE, source="marker_set.toml"):
        files.require_unchanged()
