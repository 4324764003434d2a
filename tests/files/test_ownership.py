"""Which folders a run may replace: its own kind of result, with nothing in it but what gaitcal wrote."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gaitcal.errors import InputError
from gaitcal.files import atomic
from gaitcal.files.atomic import atomic_directory, require_room
from gaitcal.files.ownership import KEPT, MANIFEST, ResultKind

OLD_MANIFESTS = {
    ResultKind.CALIBRATION: {"gaitcal": "0.1.0", "settings": {}, "inputs_sha256": {}},
    ResultKind.DYNAMICS: {"gaitcal": "0.1.0", "subject": "x"},
    ResultKind.SYNTHETIC: {"gaitcal": "synthetic subject", "seed": 0},
    ResultKind.REPRODUCTION: {"gaitcal": "0.1.0", "kind": "reproduction"},
}
"""As versions wrote them that listed no files."""


def write(
    target: Path, kind: ResultKind = ResultKind.CALIBRATION, text: str = "one", inputs: tuple[Path, ...] = ()
) -> None:
    with atomic_directory(target, kind, inputs) as folder:
        (folder / MANIFEST).write_text('{"gaitcal": "0.1.0"}')
        (folder / "motion").mkdir()
        (folder / "motion" / "own figure.png").write_text(text)


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def assert_refused(target: Path, kind: ResultKind, told: str, inputs: tuple[Path, ...] = ()) -> None:
    before = content(target)
    with pytest.raises(InputError, match=told) as early:
        require_room(target, kind, inputs)
    with pytest.raises(InputError, match=told) as late:
        write(target, kind, "two", inputs)
    assert str(early.value) == str(late.value)
    assert len(str(late.value).splitlines()) == 1
    assert content(target) == before


@pytest.mark.parametrize("there", ResultKind)
@pytest.mark.parametrize("coming", ResultKind)
def test_only_the_same_kind_is_replaced(there: ResultKind, coming: ResultKind, tmp_path: Path) -> None:
    write(tmp_path / "out", there)
    manifest = json.loads((tmp_path / "out" / MANIFEST).read_text())
    assert (manifest["kind"], manifest["files"]) == (there.value, ["motion/own figure.png"])
    if there is coming:
        write(tmp_path / "out", coming, "two")
        assert (tmp_path / "out/motion/own figure.png").read_text() == "two"
    else:
        assert_refused(
            tmp_path / "out", coming, rf"another kind of result \({there.value}, this would be {coming.value}\)"
        )


@pytest.mark.parametrize("name", ["mynotes.txt", "moments/mine.png", "motion/walk.csv", "dynamic/x", "montecarlo"])
def test_a_file_that_is_not_ours_is_named(name: str, tmp_path: Path) -> None:
    write(tmp_path / "out")
    (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
    (tmp_path / "out" / name).write_text("hours of work")
    assert_refused(tmp_path / "out", ResultKind.CALIBRATION, f"holds '{name}', which gaitcal did not write there")


def test_a_link_is_not_ours(tmp_path: Path) -> None:
    write(tmp_path / "out")
    (tmp_path / "data").mkdir()
    (tmp_path / "out/data").symlink_to(tmp_path / "data")
    assert_refused(tmp_path / "out", ResultKind.CALIBRATION, "holds 'data'")


def test_a_file_that_appears_during_the_run_is_kept(tmp_path: Path) -> None:
    write(tmp_path / "out")
    with pytest.raises(InputError, match="notes.txt"), atomic_directory(tmp_path / "out", ResultKind.CALIBRATION):
        (tmp_path / "out/notes.txt").write_text("mine")
    assert (tmp_path / "out/notes.txt").read_text() == "mine"


@pytest.mark.parametrize("kind", OLD_MANIFESTS)
def test_manifests_without_a_list_know_the_names_of_their_time(kind: ResultKind, tmp_path: Path) -> None:
    names = {
        ResultKind.CALIBRATION: "figures/01_walk_moments.svg",
        ResultKind.DYNAMICS: "moments/walk.csv",
        ResultKind.SYNTHETIC: "hip_r.c3d",
        ResultKind.REPRODUCTION: "tables.csv",
    }
    out = tmp_path / "out"
    (out / names[kind]).parent.mkdir(parents=True)
    (out / names[kind]).touch()
    (out / MANIFEST).write_text(json.dumps(OLD_MANIFESTS[kind]))
    require_room(out, kind)
    other = ResultKind.SYNTHETIC if kind is ResultKind.CALIBRATION else ResultKind.CALIBRATION
    assert_refused(out, other, "another kind of result")
    for foreign in ("motion/deeper.txt", f"my own/{names[kind]}"):
        (out / foreign).parent.mkdir(parents=True, exist_ok=True)
        (out / foreign).touch()
        assert_refused(out, kind, f"holds '{foreign}'")
        (out / foreign).unlink()


def test_inputs_are_never_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "raw").mkdir(parents=True)
    (out / "raw/walk.c3d").touch()
    (tmp_path / "link").symlink_to(out)
    for target in (out, tmp_path / "link", tmp_path):
        assert_refused(target, ResultKind.CALIBRATION, "walk.c3d', an input of this run", (out / "raw/walk.c3d",))
    write(tmp_path / "result", inputs=(out / "raw/walk.c3d",))


@pytest.mark.parametrize("links", [True, False], ids=["hard links", "copies"])
@pytest.mark.parametrize("one_step", [True, False], ids=["exchange", "two renames"])
def test_what_later_commands_added_is_kept(
    links: bool, one_step: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError

    if not links:
        monkeypatch.setattr(os, "link", refuse)
    if not one_step:
        monkeypatch.setattr(atomic, "_exchange", lambda one, other: False)
    out = tmp_path / "out"
    write(out)
    for name in KEPT[ResultKind.CALIBRATION]:
        (out / name / "deeper").mkdir(parents=True)
        (out / name / "deeper/file").write_text(name)
    (out / ".gaitcal-tmp-abc").mkdir()  # a killed run's
    names = tuple(sorted(KEPT[ResultKind.CALIBRATION]))
    for text in ("two", "three"):
        assert require_room(out, ResultKind.CALIBRATION) == names
        write(out, text=text)
    assert (out / "motion/own figure.png").read_text() == "three"
    assert {name: (out / name / "deeper/file").read_text() for name in names} == {name: name for name in names}
    assert json.loads((out / MANIFEST).read_text())["kept_from_earlier_result"] == list(names)
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_what_a_killed_exchange_left_is_looked_at_before_the_work(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out)
    (out / "montecarlo").mkdir()
    out.rename(atomic._old(out))
    assert require_room(out, ResultKind.CALIBRATION) == ("montecarlo",)
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_a_kept_folder_that_is_a_link_stays_one(tmp_path: Path) -> None:
    out, store = tmp_path / "out", tmp_path / "large disk"
    write(out)
    store.mkdir()
    (store / "draws").touch()
    (out / "montecarlo").symlink_to("../large disk")
    write(out, text="two")
    assert (out / "montecarlo").is_symlink() and (out / "montecarlo/draws").exists()


KILLED = """
import os, signal, sys
from gaitcal.files import atomic
from gaitcal.files.ownership import ResultKind
def die(*_): os.kill(os.getpid(), signal.SIGKILL)
atomic.{moment} = die
with atomic.atomic_directory(sys.argv[1], ResultKind.CALIBRATION) as folder:
    (folder / "manifest.json").write_text('{{"gaitcal": "0"}}')
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("moment", ["also_at", "_put", "_exchange", "sign"])
def test_killed_while_carrying_over_leaves_the_old_with_all_it_held(moment: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out)
    (out / "montecarlo").mkdir()
    (out / "montecarlo/draws").write_text("hours")
    before = content(out)
    done = subprocess.run([sys.executable, "-c", KILLED.format(moment=moment), str(out)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert content(out) == before
    write(out, text="two")
    assert (out / "montecarlo/draws").read_text() == "hours"
