"""Every fault of a study ends in exit code 1 and one clear line, and leaves an existing result
folder as it was.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.study.study import Study
from tests.commands import Done, content, gaitcal
from tests.synthetic_studies import write_synthetic_study


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sound synthetic study."""
    folder = tmp_path_factory.mktemp("study")
    write_synthetic_study(folder)
    return folder


@pytest.fixture
def study(made: Path, tmp_path: Path) -> Path:
    """A copy of the sound study, to be spoilt."""
    return Path(shutil.copytree(made, tmp_path / "study")) / "study.toml"


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def change_table(path: Path, change: Callable[[pd.DataFrame], pd.DataFrame]) -> None:
    change(pd.read_csv(path)).to_csv(path, index=False)


def text_named_c3d(study: Path) -> None:
    (study.parent / "walk.c3d").write_text("time,RASI_x\n0.0,1.0\n" * 50, encoding="utf-8")
    replace(study, 'file = "walk.csv"', 'file = "walk.c3d"')


def _table(name: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> Callable[[Path], None]:
    return lambda study: change_table(study.parent / name, change)


def _text(old: str, new: str) -> Callable[[Path], None]:
    return lambda study: replace(study, old, new)


FAULTS: dict[str, tuple[Callable[[Path], None], tuple[str, ...]]] = {
    "missing file": (
        lambda study: (study.parent / "walk.csv").unlink(),
        ("study.toml", "trial[2].file", "walk.csv", "walk_forces.csv"),
    ),
    "text named .c3d": (text_named_c3d, ("walk.c3d", "not a C3D file")),
    "renamed marker not there": (
        _text('set = "published"', 'set = "published"\nrename = { "RASIS" = "R.ASIS" }'),
        ("study.toml", "markers.rename", "RASIS", "R.ASIS"),
    ),
    "segment never seen": (
        _table(
            "walk.csv",
            lambda t: t.assign(**{c: np.nan for c in t if c.startswith(("L.Thigh", "L.Knee"))}),
        ),
        ("walk.csv", "L.Thigh.Front", "thigh_l has no other marker"),
    ),
    "forces of another time": (
        _table("walk_forces.csv", lambda t: t.assign(time=t["time"] + 2.0)),
        ("walk_forces.csv", "forces from 2 to 3.035 s", "markers from 0 to 1.035 s"),
    ),
}
"""What is done to the study, and what the line has to name; of single checks and of study files:
`tests/faults`, `tests/study`."""


def assert_refused(ending: Done, named: tuple[str, ...]) -> None:
    (line,) = ending.stderr.splitlines()
    assert (
        ending == Done(1, "", f"{line}\n")
        and line.startswith("gaitcal: ")
        and "internal error" not in line
    )
    assert all(part in line for part in named), line


def former_result(folder: Path) -> dict[str, bytes]:
    """A folder that looks like an earlier result, and its content."""
    folder.mkdir()
    manifest = '{"gaitcal": "0", "kind": "calibration", "files": ["summary.json"]}'
    (folder / "manifest.json").write_text(manifest, encoding="utf-8")
    (folder / "summary.json").write_text("{}", encoding="utf-8")
    return content(folder)


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_told_in_one_line(fault: str, study: Path) -> None:
    spoil, named = FAULTS[fault]
    spoil(study)
    result = study.parent.parent / "result"
    before = former_result(result)
    assert_refused(gaitcal("calibrate", study, "--out", result), named)
    assert content(result) == before
    assert sorted(p.name for p in study.parent.parent.iterdir()) == ["result", "study"]


def test_rename_of_markers_that_some_trials_wear(study: Path) -> None:
    for name in ("static.csv", "walk.csv"):
        change_table(
            study.parent / name,
            lambda t: t.rename(columns={f"R.ASIS_{a}": f"RASIS_{a}" for a in "xyz"}),
        )
    change_table(
        study.parent / "static.csv",
        lambda t: t.rename(columns={f"R.Heel_{a}": f"RHEE_{a}" for a in "xyz"}),
    )
    replace(
        study,
        'set = "published"',
        'set = "published"\nrename = { "RASIS" = "R.ASIS", "RHEE" = "R.Heel" }',
    )
    assert gaitcal("check", study, "-q") == Done(0, "", "")


def test_output_is_looked_at_before_the_work(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Study, "load", lambda _: pytest.fail("the study was read first"))
    assert_refused(
        gaitcal("calibrate", study, "--out", study.parent / "walk.csv" / "result"),
        ("walk.csv", "written"),
    )
