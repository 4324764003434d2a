"""Names are data: whatever a study calls its subject, markers and files, a result stays in its folder and inert."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pandas as pd
import pytest

from gaitcal.io.toml import toml_table, toml_value
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.model_file import load_model
from gaitcal.results.calibration import read_page
from tests.commands import gaitcal
from tests.synthetic_studies import write_synthetic_study

SUBJECT = " ".join(
    [
        "../../etc",
        "<script>alert(1)</script>",
        "Zoë 测试 \U0001f9b5",
        '"><img src=x onerror=alert(1)>',
        "'; DROP TABLE gait; --",
        "{{ 7 * 7 }} {% raw %} ${x} </title></style>",
        "[bold red]markup[/]",
        "<!--<script> \u05d0\u05d1 --> \\u003c & ]]>",
    ]
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
    "../walk",
    "walk/../../x",
    "<script>",
    "con",
    "walk\n",
    "",
    ".",
    "..",
    "~",
    "w" * 81,
    "walk\x00",
    "C:walk",
    "wälk",
]


def everything(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*")}


class Page(HTMLParser):
    """Elements and attributes that a browser would make of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def dangers(self) -> list[str]:
        found = [
            f"{tag} {name}"
            for tag, attributes in self.tags
            for name in attributes
            if re.match(r"on(error|load$)", name)
        ]
        found += [f"img {a['src']}" for tag, a in self.tags if tag == "img" and a.get("src") == "x"]
        return found


def hostile(folder: Path) -> Path:
    """A study with hostile names of subject and markers, which its own marker set makes part of the model."""
    path = write_synthetic_study(folder)
    columns = {f"{old}_{axis}": f"{new}_{axis}" for old, new in MARKERS.items() for axis in "xyz"}
    for name in ("static.csv", "walk.csv"):
        table = pd.read_csv(folder / name).rename(columns=columns)
        table.to_csv(folder / name, index=False)
    (folder / "own.toml").write_text(own_set(), encoding="utf-8")
    text = path.read_text(encoding="utf-8").replace('"published"', '"own.toml"')
    path.write_text(text.replace('"synthetic"', toml_value(SUBJECT)), encoding="utf-8")
    return path


def own_set() -> str:
    """The published marker set with some markers named otherwise."""
    published = load_marker_set("published")

    def group(table: Mapping[str, tuple[str, ...]]) -> dict[str, list[str]]:
        return {name: [MARKERS.get(label, label) for label in labels] for name, labels in table.items()}

    parts = {"landmarks": published.landmarks, "tracking": published.tracking, "static_only": published.static_only}
    tables = ['description = "<script>alert(4)</script>"\n']
    tables += [toml_table(f"[{name}]", group(table)) for name, table in parts.items()]
    return "\n".join(tables)


@pytest.mark.slow
def test_names_stay_data(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    study = hostile(inside / "study")
    before = everything(tmp_path)
    assert gaitcal("calibrate", study, "--out", inside / "result", "-q").returncode == 0
    made = everything(tmp_path) - before
    assert made and all(name.startswith("inside/result") for name in made)
    summary = json.loads((inside / "result/manifest.json").read_text(encoding="utf-8"))
    assert summary["subject"]["name"] == SUBJECT
    assert set(MARKERS.values()) <= set(load_model(inside / "result/model.toml").markers.labels)
    for name in ("model.osim", "model.urdf", "model.xml"):
        ElementTree.parse(inside / "result" / name)  # names are escaped there, or this would fail
    page = inside / "result/result.html"
    assert Page(page).dangers() == []
    text = page.read_text(encoding="utf-8")
    assert "<script>alert" not in text and "<svg onload" not in text
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
    before = everything(sound.parents[1])
    done = gaitcal("calibrate", study, "--out", sound.parents[1] / "result")
    assert done.returncode == 1
    assert everything(sound.parents[1]) == before
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
    for name, content in old.items():
        (result / name).write_bytes(content)
    command = [sys.executable, "-m", "gaitcal.cli", "calibrate", str(study), "--out", str(result)]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 600
    while child.poll() is None and not list(tmp_path.glob(".gaitcal-tmp-*/*")):
        assert time.monotonic() < deadline
        time.sleep(0.005)
    child.send_signal(signal.SIGTERM)
    _, told = child.communicate(timeout=300)
    assert child.returncode == 143, "it was too fast to be ended"
    assert "Traceback" not in told and told.startswith("gaitcal: ended by SIGTERM; "), told
    assert {p.name: p.read_bytes() for p in result.iterdir()} == old
    assert not list(tmp_path.glob(".gaitcal-*"))
