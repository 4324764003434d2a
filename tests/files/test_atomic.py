"""Results appear whole or not at all, whatever ends the run."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gaitcal.errors import InputError
from gaitcal.files import atomic
from gaitcal.files.atomic import atomic_directory, atomic_file, atomic_text, require_room
from gaitcal.files.ownership import ResultKind

OURS = '{"gaitcal": "0.1.0"}'


def write_result(target: Path, content: str) -> None:
    with atomic_directory(target, ResultKind.CALIBRATION) as folder:
        (folder / "manifest.json").write_text(OURS)
        (folder / "motion").mkdir()
        (folder / "motion" / "walk.mot").write_text(content)


def result(target: Path) -> str:
    return (target / "motion" / "walk.mot").read_text()


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


@pytest.fixture(params=["exchange", "two renames"])
def both_ways(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """With the one-step exchange, and as on systems that have none."""
    if request.param == "two renames":
        monkeypatch.setattr(atomic, "_exchange", lambda one, other: False)
    return str(request.param)


@pytest.mark.usefixtures("both_ways")
def test_new_then_replaced(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "out"
    write_result(target, "one")
    assert result(target) == "one"
    (target / "motion" / ".DS_Store").touch()
    write_result(target, "two")
    assert result(target) == "two"
    assert names(target) == ["manifest.json", "motion"]
    assert names(target.parent) == ["out"]


def test_permissions_are_those_of_any_new_folder(tmp_path: Path) -> None:
    write_result(tmp_path / "out", "one")
    (tmp_path / "plain").mkdir()
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="renameat2 is Linux's")
def test_exchange_is_one_step_here(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / name).touch()
    assert atomic._exchange(tmp_path / "a", tmp_path / "b")
    assert names(tmp_path / "a") == ["b"]
    assert names(tmp_path / "b") == ["a"]
    assert not atomic._exchange(tmp_path / "a", tmp_path / "missing")


@pytest.mark.usefixtures("both_ways")
@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt(), SystemExit(2)], ids=repr)
def test_failure_leaves_the_old_or_none(tmp_path: Path, error: BaseException) -> None:
    def fail(target: Path) -> None:
        with atomic_directory(target, ResultKind.CALIBRATION) as folder:
            (folder / "half").touch()
            raise error

    with pytest.raises(type(error)):
        fail(tmp_path / "new")
    assert names(tmp_path) == []
    write_result(tmp_path / "out", "one")
    with pytest.raises(type(error)):
        fail(tmp_path / "out")
    assert names(tmp_path) == ["out"]
    assert result(tmp_path / "out") == "one"


def test_interrupt_between_the_two_renames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "out"
    write_result(target, "one")
    monkeypatch.setattr(atomic, "_exchange", lambda one, other: False)
    rename = Path.rename

    def interrupted(path: Path, to: Path) -> Path:
        if path.name == "content":
            raise KeyboardInterrupt
        return rename(path, to)

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_result(target, "two")
    assert names(tmp_path) == ["out"]
    assert result(target) == "one"


def test_killed_between_the_two_renames_is_put_back_by_the_next_run(tmp_path: Path) -> None:
    target = tmp_path / "out"
    write_result(target, "one")
    target.rename(atomic._old(target))
    with pytest.raises(ValueError), atomic_directory(target, ResultKind.CALIBRATION):
        raise ValueError
    assert names(tmp_path) == ["out"]
    assert result(target) == "one"


@pytest.mark.usefixtures("both_ways")
@pytest.mark.parametrize("content", [{"notes.txt": "mine"}, {"manifest.json": "{}"}, {"manifest.json": "\0"}])
def test_foreign_folder_is_refused_and_kept(tmp_path: Path, content: dict[str, str]) -> None:
    target = tmp_path / "out"
    target.mkdir()
    for name, text in content.items():
        (target / name).write_text(text)
    with pytest.raises(InputError, match="gaitcal did not write there"):
        write_result(target, "one")
    assert {name: (target / name).read_text() for name in names(target)} == content
    assert names(tmp_path) == ["out"]


@pytest.mark.usefixtures("both_ways")
def test_empty_folder_is_used(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    write_result(tmp_path / "out", "one")
    assert result(tmp_path / "out") == "one"


@pytest.mark.usefixtures("both_ways")
def test_link_to_a_folder_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "out").symlink_to("real")
    write_result(tmp_path / "out", "one")
    write_result(tmp_path / "out", "two")
    assert (tmp_path / "out").is_symlink()
    assert result(tmp_path / "real") == "two"


def test_unwritable_places_end_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for target in (tmp_path / "file", tmp_path / "file" / "out", tmp_path / ("x" * 300), Path("/proc/none/out")):
        with pytest.raises(InputError) as caught:
            write_result(target, "one")
        assert len(str(caught.value).splitlines()) == 1
        with pytest.raises(InputError):
            atomic_text(target / "deeper" / "file.txt", "text")
        with pytest.raises(InputError) as early:
            require_room(target, ResultKind.CALIBRATION)
        assert str(early.value).splitlines() == [str(early.value)]
    with pytest.raises(InputError, match="no usable path"):
        write_result(tmp_path / "nul\0", "one")
    assert names(tmp_path) == ["file"]


def test_room_is_looked_for_without_a_trace(tmp_path: Path) -> None:
    write_result(tmp_path / "out", "one")
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis/chapter.tex").touch()
    for target in ("out", "new", "deeper/new"):
        require_room(tmp_path / target, ResultKind.CALIBRATION)
    with pytest.raises(InputError, match="holds 'chapter.tex'"):
        require_room(tmp_path / "thesis", ResultKind.CALIBRATION)
    assert names(tmp_path) == ["out", "thesis"]


@pytest.mark.skipif(os.geteuid() == 0 if hasattr(os, "geteuid") else True, reason="root may write everywhere")
def test_folder_without_write_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o555)
    with pytest.raises(InputError, match="cannot be written: Permission denied"):
        write_result(tmp_path / "out", "one")


def test_full_disk_is_one_line_but_other_errors_of_the_body_stay_themselves(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No space left"), atomic_directory(tmp_path / "out", ResultKind.CALIBRATION):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(PermissionError), atomic_directory(tmp_path / "out", ResultKind.CALIBRATION):
        raise PermissionError(errno.EACCES, "an input file")
    assert names(tmp_path) == []


KILLED = """
import os, signal, sys
from gaitcal.files.atomic import atomic_directory
from gaitcal.files.ownership import ResultKind
with atomic_directory(sys.argv[1], ResultKind.CALIBRATION) as folder:
    (folder / "manifest.json").write_text('{"gaitcal": 0}')
    print(folder.parent.name, flush=True)
    {wait}
"""


def start(target: Path, wait: str) -> tuple[subprocess.Popen[str], str]:
    command = [sys.executable, "-c", KILLED.replace("{wait}", wait), str(target)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process.stdout as stream:
        return process, stream.readline().strip()


@pytest.mark.parametrize("earlier", [True, False])
def test_killed_process_leaves_the_old_or_none_and_is_cleaned_up_after(tmp_path: Path, earlier: bool) -> None:
    target = tmp_path / "out"
    if earlier:
        write_result(target, "one")
    process, left = start(target, "os.kill(os.getpid(), signal.SIGKILL)")
    assert process.wait() == -signal.SIGKILL
    assert names(tmp_path) == [left] + ["out"] * earlier
    if earlier:
        assert result(target) == "one"
    write_result(tmp_path / "other", "two")
    assert left in names(tmp_path)  # another target's
    write_result(target, "two")
    assert names(tmp_path) == ["other", "out"]


def test_a_run_that_still_writes_is_left_alone(tmp_path: Path) -> None:
    target = tmp_path / "out"
    process, busy = start(target, "__import__('time').sleep(60)")
    try:
        write_result(target, "one")
        assert names(tmp_path) == [busy, "out"]
    finally:
        process.terminate()
        process.wait()


def test_kill_at_any_moment_leaves_a_whole_result(tmp_path: Path) -> None:
    """A loop that replaces a result as fast as it can, killed at 12 different moments."""
    target = tmp_path / "out"
    code = (
        "import sys; from tests_atomic import write_result; from pathlib import Path; n = 0\n"
        "while True: n += 1; write_result(Path(sys.argv[1]), f'{n}\\n' * 1000); n == 1 and print(n, flush=True)\n"
    )
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "tests_atomic.py").write_text(Path(__file__).read_text())
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path / "code"), *filter(None, sys.path)])}
    for number in range(12):
        command = [sys.executable, "-c", code, str(target)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment)
        assert process.stdout is not None
        with process.stdout as stream:
            stream.readline()
        time.sleep(0.003 * number)
        process.kill()
        process.wait()
        text = result(target)
        assert text.count("\n") == 1000
        assert len(set(text.split())) == 1
    write_result(target, "end")
    assert names(tmp_path) == ["code", "out"]


def test_text_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    atomic_text(path, "µ\n")
    atomic_text(path, "ν\r\n")
    assert path.read_bytes() == "ν\r\n".encode()
    with pytest.raises(UnicodeEncodeError):
        atomic_text(path, "\ud800")
    assert path.read_text() == "ν\n"
    with pytest.raises(InputError, match="is a folder"):
        atomic_text(tmp_path, "x")
    assert names(tmp_path) == ["a.txt"]


def test_file_keeps_its_name_while_written(tmp_path: Path) -> None:
    with atomic_file(tmp_path / "page.html") as path:
        assert path.name == "page.html"
        path.write_text("whole")
        assert not (tmp_path / "page.html").exists()
    assert (tmp_path / "page.html").read_text() == "whole"
    assert names(tmp_path) == ["page.html"]
