"""Several files take their places in a folder together, or none does, whatever ends the run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gaitcal.errors import InputError
from gaitcal.files import amend
from gaitcal.files.amend import amended, file_in_place
from gaitcal.files.atomic import atomic_directory
from gaitcal.files.ownership import AMENDED, MANIFEST, ResultKind
from gaitcal.files.snapshot import listed, sha256_of

WRITE = """
import os, signal, sys
from pathlib import Path
from gaitcal.files import amend
def die(*_): os.kill(os.getpid(), signal.SIGKILL)
moved = []
if sys.argv[2] != "never":
    move = amend._move
    def dying(*a):
        moved.append(1)
        die() if len(moved) > int(sys.argv[2]) else move(*a)
    amend._move = dying
with amend.amended(Path(sys.argv[1])) as stage:
    for name in ("one", "deeper/two", "three"):
        (stage / name).parent.mkdir(exist_ok=True)
        (stage / name).write_text("new")
        if sys.argv[2] == "never" and name == "three":
            die()
"""


def content(folder: Path) -> dict[str, str]:
    return {p.relative_to(folder).as_posix(): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


OLD = {"one": "old", "deeper/two": "old", "three": "old"}
NEW = dict.fromkeys(OLD, "new")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in OLD.items():
        (tmp_path / "out" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "out" / name).write_text(text)
    return tmp_path / "out"


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("moment", ["never", "0", "1", "2"])
def test_killed_at_any_moment(moment: str, folder: Path) -> None:
    done = subprocess.run([sys.executable, "-c", WRITE, str(folder), moment], check=False)
    assert done.returncode == -signal.SIGKILL
    assert (folder / AMENDED).exists() == (moment != "never")
    with amended(folder):
        pass
    assert content(folder) == (OLD if moment == "never" else NEW)
    assert [p.name for p in folder.parent.iterdir()] == ["out"]
    assert not list(folder.glob(".gaitcal-*"))


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_error_leaves_all_as_it_was(error: type[BaseException], folder: Path, tmp_path: Path) -> None:
    def fail(target: Path) -> None:
        with amended(target) as stage:
            (stage / "one").write_text("new")
            raise error

    for target in (folder, tmp_path / "new"):
        with pytest.raises(error):
            fail(target)
    assert content(folder) == OLD
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_folder_in_the_way_is_told_before_anything_moves(folder: Path) -> None:
    (folder / "three").unlink()
    (folder / "three").mkdir()
    with pytest.raises(InputError, match="three: is a folder"), amended(folder) as stage:
        for name in ("one", "three"):
            (stage / name).write_text("new")
    assert content(folder) == {"one": "old", "deeper/two": "old"}


def test_other_disks_and_links(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "disk").mkdir()
    (folder / "link").symlink_to("../disk")
    replace = Path.replace

    def across(path: Path, target: Path) -> Path:
        if AMENDED in str(path):
            raise OSError(18, os.strerror(18))
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", across)
    with amended(folder) as stage:
        (stage / "link").mkdir()
        (stage / "link/file").write_text("new")
        (stage / "one").write_text("new")
    assert (folder / "link").is_symlink()
    assert content(tmp_path / "disk") == {"file": "new"}
    assert (folder / "one").read_text() == "new"


def test_the_manifest_learns_of_it(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with atomic_directory(out, ResultKind.CALIBRATION) as folder:
        (folder / MANIFEST).write_text('{"gaitcal": "0"}')
        (folder / "report.html").write_text("old")
        (folder / "view.html").write_text("old")
    with amended(out) as stage:
        (stage / "report.html").write_text("new")
        (stage / "export").mkdir()
        (stage / "export/model.osim").write_text("of nobody's list")
    with file_in_place(out / "view.html") as path:
        path.write_text("new")
    assert listed(out) == {name: sha256_of(out / name) for name in ("report.html", "view.html")}
    with file_in_place(tmp_path / "view.html") as path:
        assert path == tmp_path / "view.html"  # no result of ours: nothing but the file
    manifest = json.loads((out / MANIFEST).read_text())
    (out / MANIFEST).write_text(json.dumps({**manifest, "number": 1}))
    with amended(out) as stage:
        (stage / "report.html").write_text("newer")
    with pytest.raises(InputError, match="damaged"):  # a damaged manifest does not become sound by this
        listed(out)


def test_the_lock_is_held(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gaitcal.files.lock.WAIT_S", 0.2)
    with amended(folder):
        code = "import sys; from gaitcal.files import lock; from pathlib import Path\n"
        code += "with lock.locked(Path(sys.argv[1]), wait_s=0.2): pass"
        done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=False)
    assert "is being written by process" in done.stderr
    assert amend.AMENDING not in {p.name for p in folder.iterdir()}
