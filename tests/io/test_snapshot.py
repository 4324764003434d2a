"""What is read is what was written; what changes while a command runs is told."""

import json
from pathlib import Path

import pytest

from gaitcal.errors import InputError
from gaitcal.io import snapshot
from gaitcal.io.result_folder import MANIFEST, ResultKind, atomic_directory, listed, sha256_of
from gaitcal.io.snapshot import read_whole


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with atomic_directory(tmp_path / "out", ResultKind.CALIBRATION) as out:
        (out / MANIFEST).write_text(json.dumps({"gaitcal": "0", "subject": "Zoë", "number": 0.1}), encoding="utf-8")
        (out / "model.toml").write_text("a = 1\n")
        (out / "splines.npz").write_bytes(bytes(range(200)))
    return tmp_path / "out"


def read(folder: Path, *names: str) -> tuple[bytes, snapshot.Snapshot]:
    return read_whole(folder, names, lambda: (folder / names[0]).read_bytes(), ("model.toml",))


def test_every_file_is_listed_with_its_hash(folder: Path) -> None:
    assert listed(folder) == {name: sha256_of(folder / name) for name in ("model.toml", "splines.npz")}
    content, files = read(folder, "splines.npz", "marker_set.toml")
    assert content == bytes(range(200))
    assert files.sha256 == {"splines.npz": sha256_of(folder / "splines.npz"), "marker_set.toml": None}
    assert files.remarks == ()
    files.require_unchanged()


@pytest.mark.parametrize("spoil", [lambda b: b[:100], lambda b: b"\x01" + b[1:], lambda b: b""])
def test_a_damaged_file_is_named(folder: Path, spoil: object) -> None:
    path = folder / "splines.npz"
    path.write_bytes(spoil(path.read_bytes()))  # type: ignore[operator]
    with pytest.raises(InputError, match=r"splines\.npz: is damaged.*calibrate again"):
        read(folder, "splines.npz")
    read(folder, "model.toml")  # nothing else suffers
    path.unlink()
    with pytest.raises(InputError, match=r"splines\.npz: is missing"):
        read(folder, "splines.npz")


def test_an_edited_file_that_may_be_is_told(folder: Path) -> None:
    (folder / "model.toml").write_text("a = 2\n")
    content, files = read(folder, "model.toml", "splines.npz")
    assert content == b"a = 2\n"
    (remark,) = files.remarks
    assert remark.startswith("model.toml is not as 'gaitcal calibrate' wrote it")


def test_what_changes_while_it_is_read_is_read_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshot, "AGAIN_S", 0.0)
    seen: list[str] = []

    def change() -> str:
        seen.append((folder / "model.toml").read_text())
        if len(seen) < 3:
            (folder / "model.toml").write_text(f"a = {len(seen)} # while it is read\n")
        return seen[-1]

    found, files = read_whole(folder, ("model.toml",), change, ("model.toml",))
    assert len(seen) == 3
    assert found == (folder / "model.toml").read_text()
    files.require_unchanged()
    numbers = iter(range(1000))
    with pytest.raises(InputError, match="goes on changing"):
        read_whole(
            folder,
            ("model.toml",),
            lambda: (folder / "model.toml").write_text(f"b = {next(numbers)}\n"),
            editable=("model.toml",),
        )


def test_what_changed_since_it_was_read_is_told(folder: Path) -> None:
    _, files = read(folder, "model.toml", "splines.npz", "marker_set.toml")
    (folder / "marker_set.toml").touch()
    with pytest.raises(InputError, match=r"marker_set\.toml: changed while this ran; nothing was written, run again"):
        files.require_unchanged()
