"""One writer at a time for a folder, across processes; the lock dies with its holder and leaves nothing behind."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from gaitcal.errors import InputError
from gaitcal.io import result_folder
from gaitcal.io.result_folder import MANIFEST, locked

HOLD = """
import sys, time
from pathlib import Path
from gaitcal.io.result_folder import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(float(sys.argv[2]))
"""
COUNT = """
import sys, time
from pathlib import Path
from gaitcal.io.result_folder import locked
path = Path(sys.argv[1])
for _ in range(40):
    with locked(path.parent):
        number = int(path.read_text())
        time.sleep(0.001)
        path.write_text(str(number + 1))
"""


def holder(folder: Path, seconds: float) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder), str(seconds)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    with process.stdout as stream:
        assert stream.readline() == "held\n"
    return process


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_no_change_of_several_processes_is_lost(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/number").write_text("0")
    command = [sys.executable, "-c", COUNT, str(tmp_path / "out/number")]
    for process in [subprocess.Popen(command) for _ in range(4)]:
        assert process.wait() == 0
    assert (tmp_path / "out/number").read_text() == "160"
    assert names(tmp_path) == ["out"]


def test_it_is_told_while_waiting_and_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(result_folder, "NOTICE_S", 0.1)
    process = holder(tmp_path / "out", 60)
    try:
        told = "out: is being written by another process"
        with pytest.raises(InputError, match=told), locked(tmp_path / "out", wait_s=0.5):
            pass
        assert "is being written by another process; waiting" in caplog.text
        with locked(tmp_path / "other", wait_s=0.0), locked(tmp_path / "out", "another purpose", wait_s=0.0):
            pass
    finally:
        process.kill()
        process.wait()
    with locked(tmp_path / "out", wait_s=0.0):  # the killed process holds it no longer
        pass
    assert names(tmp_path) == []


def test_again_within_and_in_another_thread(tmp_path: Path) -> None:
    others: list[str] = []

    def other() -> None:
        try:
            with locked(tmp_path / "out", wait_s=0.1):
                others.append("had it too")
        except InputError as error:
            others.append(str(error))

    with locked(tmp_path / "out"), locked(tmp_path / "out"):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert "is being written by" in others[0]
    assert names(tmp_path) == []


def test_parts_of_a_result_have_its_lock_and_other_folders_of_such_names_their_own(tmp_path: Path) -> None:
    result = tmp_path / "result"
    (result / "dynamics").mkdir(parents=True)
    process = holder(result, 60)
    try:
        with locked(result / "dynamics", wait_s=0.0):
            pass  # a folder of the user's that is called so
        (result / MANIFEST).write_text('{"gaitcal": "0"}')
        for part in ("dynamics", "montecarlo", "export"):
            with pytest.raises(InputError, match="is being written by"), locked(result / part, wait_s=0.0):
                pass
    finally:
        process.kill()
        process.wait()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS], ids=errno.errorcode.get)
def test_a_file_system_without_locks_is_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, number: int
) -> None:
    """In one line; the work goes on."""

    def none(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(pytest.importorskip("fcntl"), "flock", none)
    with locked(tmp_path / "out"):
        pass
    (line,) = caplog.messages
    assert "no locks; run one command at a time" in line
    assert names(tmp_path) == []
