"""What is installed: data in the wheel, a light import, constraints that fit each other."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import gaitcal
from gaitcal.errors import GaitcalError
from gaitcal.io import toml

ROOT = Path(__file__).parent.parent


def python(code: str, cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_one_version_everywhere() -> None:
    """Of the package, of the citation, and of the newest release in the changelog, which has its date."""
    texts = {
        name: (ROOT / name).read_text(encoding="utf-8") for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md")
    }
    (package,) = re.findall(r'^version = "(.+)"$', texts["pyproject.toml"], re.M)
    (cited,) = re.findall(r"^version: (.+)$", texts["CITATION.cff"], re.M)
    (date,) = re.findall(r'^date-released: "(.+)"$', texts["CITATION.cff"], re.M)
    headings = re.findall(r"^## (.+)$", texts["CHANGELOG.md"], re.M)
    assert cited == package
    assert headings[:2] == ["[Unreleased]", f"[{package}] - {date}"]


def test_what_contributors_are_told_is_there() -> None:
    """Every path and test that `CONTRIBUTING.md` names."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    folders = ("gaitcal/", "models/", "scripts/", "tests/", ".ci/")
    named = {word for word in re.findall(r"[\w./-]+", text) if word.startswith(folders)}
    assert len(named) > 10
    assert {path for path in named if not (ROOT / path.rstrip(".")).exists()} == set()
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py"))
    assert {name for name in re.findall(r"`(test_\w+)`", text) if f"def {name}(" not in tests} == set()


def test_an_incomplete_installation_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(toml, "files", lambda package: tmp_path / package)
    with pytest.raises(GaitcalError, match="install gaitcal again"):
        toml.models_path()


def test_import_loads_no_viewer_plots_cluster_or_command_line(tmp_path: Path) -> None:
    heavy = ["meshcat", "matplotlib", "dask", "distributed", "jinja2", "typer", "rich", "IPython"]
    code = f"import sys, gaitcal; print([name for name in {heavy} if name in sys.modules])"
    assert python(code, tmp_path, PYTHONPATH=str(ROOT)) == "[]"


@pytest.mark.parametrize("command", ["calibrate", "folder"])
def test_commands_load_no_data_frames_and_no_server(command: str, tmp_path: Path) -> None:
    """They are for who asks for a data frame or a page in the browser, and take a third of the imports' time."""
    heavy = ["pandas", "pyarrow", "http.server", "matplotlib"]
    code = f"import sys, gaitcal.cli.{command}; print([name for name in {heavy} if name in sys.modules])"
    assert python(code, tmp_path, PYTHONPATH=str(ROOT)) == "[]"


def test_public_names_are_loaded_when_first_used() -> None:
    assert len(gaitcal.__all__) == len(set(gaitcal.__all__))
    assert set(dir(gaitcal)) == set(gaitcal.__all__), "as in the stub that type checkers read"
    assert all(getattr(gaitcal, name) is not None for name in gaitcal.__all__)
    assert not set(gaitcal.__all__) & {p.stem for p in (ROOT / "gaitcal").iterdir()}, "a package would hide the name"
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = gaitcal.no_such_name


def test_licences_of_others_are_named_and_shipped() -> None:
    """Each licence that a table names, in the metadata and in a notice that goes with the wheel; so others' scripts."""
    metadata = toml.read_toml(ROOT / "pyproject.toml")["project"]
    assert isinstance(metadata, dict)
    expression, notices = str(metadata["license"]), list(metadata["license-files"])
    told = "".join((ROOT / notice).read_text(encoding="utf-8") for notice in notices)
    for path in (ROOT / "models").rglob("*.*"):
        for words in set(re.findall(r"CC BY[-A-Z]* \d\.\d", path.read_text(encoding="utf-8"))):
            assert re.sub("[ ]", "-", words) in expression and words in told, path.name
    shipped = (path for room in ("gaitcal", "models") for path in (ROOT / room).rglob("*LICENSE*"))
    assert {path.relative_to(ROOT).as_posix() for path in shipped} | {"LICENSE"} == set(notices)
    recipe = (ROOT / "scripts" / "tools" / "packaging" / "recipe.yaml").read_text(encoding="utf-8")
    assert f"license: {expression}\n" in recipe and all(f"- {notice}\n" in recipe for notice in notices)


@pytest.mark.slow
def test_wheel_works_without_the_source_tree(tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(tmp_path)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        archive.extractall(tmp_path / "site")
    data = {f"gaitcal/models/{p.relative_to(ROOT / 'models').as_posix()}" for p in (ROOT / "models").rglob("*.*")}
    assert data <= names
    (metadata,) = (tmp_path / "site").glob("gaitcal-*.dist-info/METADATA")
    assert re.search("^License-Expression: .*CC-BY-SA-4.0", metadata.read_text(encoding="utf-8"), re.M)
    assert {"gaitcal/py.typed", "gaitcal/__init__.pyi"} <= names
    assert not [name for name in names if not name.startswith(("gaitcal/", "gaitcal-"))]
    code = "import gaitcal; from gaitcal.io.toml import models_path; print(models_path())"
    assert python(code, tmp_path, PYTHONPATH=str(tmp_path / "site")) == str(tmp_path / "site" / "gaitcal" / "models")
