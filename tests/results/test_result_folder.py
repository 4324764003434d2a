"""Commands that meet folders of earlier commands or hostile names: nothing of the user's is lost,
names stay data.
"""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import pandas as pd
import pytest

from gaitcal.errors import Code
from gaitcal.io.toml import format_toml_table, format_toml_value
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.model_file import load_model
from gaitcal.report.page.page_folder import read_page
from tests.commands import content, gaitcal, run
from tests.kept import copied_person
from tests.messages import check_text, numbers, refuses
from tests.synthetic_studies import write_synthetic_study

DRAWS = ("--vary", "jp", "--levels", 100, "--draws", 4, "--jobs", 1)


@pytest.mark.slow
def test_a_study_is_never_replaced_by_its_result(kept: Path, folder: Path, tmp_path: Path) -> None:
    for out in (folder / "study", folder):
        before = content(out)
        with refuses(Code.FOLDER_TAKEN, "study.toml"):
            run("calibrate", folder / "study/study.toml", "--out", out)
        assert content(out) == before
    synthetic = tmp_path / "S"
    copied_person(kept, synthetic)
    before = content(synthetic)
    with refuses(Code.FOLDER_TAKEN, source="S"):
        run("calibrate", synthetic / "study.toml", "--out", synthetic)
    with refuses(Code.FOLDER_TAKEN, source="S"):
        run("calibrate", folder / "study/study.toml", "--out", synthetic)
    with refuses(Code.FOLDER_TAKEN, source="result"):
        run("synthesize", "--out", folder / "result")
    with refuses(Code.FOLDER_TAKEN, source="S"):
        run("reproduce", "--out", synthetic)
    with refuses(Code.FOLDER_TAKEN, source="S"):
        run("dynamics", folder / "result", folder / "study/walk.csv", "--out", synthetic)
    assert content(synthetic) == before
    demo = tmp_path / "demo"
    (demo / "result").mkdir(parents=True)
    (demo / "result/thesis.tex").touch()
    with refuses(Code.FOLDER_TAKEN, "thesis.tex", source="result"):
        run("demo", "--out", demo)
    assert sorted(content(demo)) == ["result/thesis.tex"]


def test_refused_before_the_work(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "result/mynotes.txt").touch()
    monkeypatch.setattr("gaitcal.analysis.calibrate.calibrate", None)
    with refuses(Code.FOLDER_TAKEN, "mynotes.txt", source="result"):
        run("calibrate", folder / "study/study.toml", "--out", folder / "result")


@pytest.mark.slow
def test_another_calibration_keeps_draws_and_further_trials_and_says_so(folder: Path) -> None:
    study, result = folder / "study/study.toml", folder / "result"
    more = folder / "study/walk.csv", "--forces", folder / "study/walk_forces.csv"
    assert run("dynamics", result, *more).exit_code == 0
    assert run("montecarlo", result, *DRAWS, "-q").exit_code == 0
    assert run("export", result, "--format", "urdf").exit_code == 0
    kept = {name: content(result / name) for name in ("montecarlo", "dynamics", "export")}
    told = run("calibrate", study, "--out", result).stdout
    check_text(told)
    assert {name: content(result / name) for name in kept} == kept
    assert 0 in numbers(run("montecarlo", result, *DRAWS).stdout), "the draws go on"
    study.write_text(
        study.read_text(encoding="utf-8").replace("mass_kg = 69.4", "mass_kg = 70.0"),
        encoding="utf-8",
    )
    assert run("calibrate", study, "--out", result, "--force", "-q").exit_code == 0
    assert content(result / "dynamics") == kept["dynamics"]
    for words in (DRAWS, ("--expect", 4)):
        with refuses(Code.MONTE_CARLO):
            run("montecarlo", result, *words)


@pytest.mark.slow
def test_further_trials_join_those_that_are_there(folder: Path) -> None:
    result, first = folder / "result", folder / "study/walk.csv"
    for name in ("walk2", "walk3"):
        shutil.copy(first, folder / "study" / f"{name}.csv")
    run(
        "dynamics", result, folder / "study/walk2.csv", "--forces", folder / "study/walk_forces.csv"
    )
    before = content(result / "dynamics")
    run("dynamics", result, folder / "study/walk3.csv")
    now = content(result / "dynamics")
    assert {name: now[name] for name in before if "walk2" in name} == {
        n: t for n, t in before.items() if "walk2" in n
    }
    summary = json.loads(now["summary.json"])
    assert list(summary["trials"]) == ["walk2", "walk3"]
    assert summary["trials"]["walk2"] == json.loads(before["summary.json"])["trials"]["walk2"]
    assert any(note.startswith("walk2: ") for note in summary["notes"])
    assert "moments/walk2.csv" in now and "moments/walk3.csv" not in now
    run("dynamics", result, folder / "study/walk2.csv")  # without forces now
    assert "moments/walk2.csv" not in content(result / "dynamics"), (
        "no earlier torques beside the new motion"
    )
    (result / "dynamics/notes.txt").touch()
    with refuses(Code.FOLDER_TAKEN, "notes.txt"):
        run("dynamics", result, folder / "study/walk3.csv")


SUBJECT = (
    "../../etc <script>alert(1)</script> Zoë 测试 \U0001f9b5 \"><img src=x onerror=alert(1)> '; "
    "DROP TABLE gait; -- "
    "{{ 7 * 7 }} {% raw %} ${x} </title></style> [bold red]markup[/] <!--<script> \u05d0\u05d1 --> "
    "\\u003c & ]]>"
)
MARKERS = {
    "R.Bicep": "<script>alert(2)</script>",
    "L.Bicep": "../../L.Bicep",
    "R.Wrist.Lat": "W" * 300,
    "L.Wrist.Lat": "手首 \U0001f9b5",
    "Top.Head": "</script><svg onload=alert(3)>",
    "R.Temple": "{{ 7 * 7 }}",
    "L.Temple": "[red]x[/red]",
}
"""Markers that the study names otherwise, and so does its marker set."""
TRIALS = [
    "../walk", "walk/../../x", "<script>", "con", "walk\n", "", ".", "..", "~", "w" * 81,
    "walk\x00", "C:walk", "wälk",
]  # fmt: skip


DANGERS = re.compile(r"<[^>]*\son(error|load)\s*=|<img[^>]*\ssrc=[\"']?x\b", re.IGNORECASE)
"""Elements and attributes that a browser would run."""


def hostile(folder: Path) -> Path:
    """A study with hostile names of subject and markers, which its own marker set makes part of the
    model.
    """
    path = write_synthetic_study(folder)
    columns = {f"{old}_{axis}": f"{new}_{axis}" for old, new in MARKERS.items() for axis in "xyz"}
    for name in ("static.csv", "walk.csv"):
        table = pd.read_csv(folder / name).rename(columns=columns)
        table.to_csv(folder / name, index=False)
    (folder / "own.toml").write_text(own_set(), encoding="utf-8")
    text = path.read_text(encoding="utf-8").replace('"published"', '"own.toml"')
    path.write_text(text.replace('"synthetic"', format_toml_value(SUBJECT)), encoding="utf-8")
    return path


def own_set() -> str:
    """The published marker set with some markers named otherwise."""
    published = load_marker_set("published")

    def group(table: Mapping[str, tuple[str, ...]]) -> dict[str, list[str]]:
        return {
            name: [MARKERS.get(label, label) for label in labels] for name, labels in table.items()
        }

    parts = {
        "landmarks": published.landmarks,
        "tracking": published.tracking,
        "static_only": published.static_only,
    }
    tables = ['description = "<script>alert(4)</script>"\n']
    tables += [format_toml_table(f"[{name}]", group(table)) for name, table in parts.items()]
    return "\n".join(tables)


@pytest.mark.slow
def test_names_stay_data(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    study = hostile(inside / "study")
    before = set(tmp_path.rglob("*"))
    assert gaitcal("calibrate", study, "--out", inside / "result", "-q").returncode == 0
    made = {path.relative_to(tmp_path).as_posix() for path in set(tmp_path.rglob("*")) - before}
    assert made and all(name.startswith("inside/result") for name in made)
    summary = json.loads((inside / "result/manifest.json").read_text(encoding="utf-8"))
    assert summary["subject"]["name"] == SUBJECT
    assert set(MARKERS.values()) <= set(load_model(inside / "result/model.toml").markers.labels)
    for name in ("model.osim", "model.urdf", "model.xml"):
        ElementTree.parse(inside / "result" / name)  # names are escaped there, or this would fail
    text = (inside / "result/result.html").read_text(encoding="utf-8")
    assert DANGERS.findall(text) == [] and "<script>alert" not in text and "<svg onload" not in text
    shown = read_page(inside / "result")
    assert shown.data is not None and shown.data["person"]["name"] == SUBJECT == shown.scene.subject


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synthetic_study(tmp_path_factory.mktemp("names") / "study")


@pytest.mark.parametrize("name", TRIALS)
def test_trial_names_that_could_be_paths_are_refused(name: str, sound: Path) -> None:
    text = sound.read_text(encoding="utf-8").replace('name = "walk"', f"name = {json.dumps(name)}")
    study = sound.with_name("named.toml")
    study.write_text(text, encoding="utf-8")
    before = set(sound.parents[1].rglob("*"))
    done = gaitcal("calibrate", study, "--out", sound.parents[1] / "result")
    assert done.returncode == 1
    assert set(sound.parents[1].rglob("*")) == before
    assert "trial[2].name" in done.stderr or "\\u0000" in json.dumps(name)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_sigterm_while_writing_leaves_the_old_result(tmp_path: Path) -> None:
    study, result = write_synthetic_study(tmp_path / "study"), tmp_path / "result"
    old = {
        "manifest.json": b'{"gaitcal": "0", "kind": "calibration", "files": ["summary.json"]}',
        "summary.json": b"{}",
    }
    result.mkdir()
    for name, data in old.items():
        (result / name).write_bytes(data)
    command = [sys.executable, "-m", "gaitcal.cli", "calibrate", str(study), "--out", str(result)]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 600
    while child.poll() is None and not list(tmp_path.glob(".gaitcal-tmp-*/*")):
        assert time.monotonic() < deadline
        time.sleep(0.005)
    child.send_signal(signal.SIGTERM)
    _, told = child.communicate(timeout=300)
    assert child.returncode == 143, "it was too fast to be ended"
    assert "Traceback" not in told, told
    check_text(told)
    assert {p.name: p.read_bytes() for p in result.iterdir()} == old
    assert not list(tmp_path.glob(".gaitcal-*"))
