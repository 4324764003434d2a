"""Releases and installations: notes, one version, requirements that agree, a wheel that works;
README and paper.
"""

import importlib.util
import json
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

import gaitcal
from gaitcal.io import toml
from scripts.tools import release

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PACKAGING = ROOT / "scripts/tools/packaging"

ON_CONDA = {"pin": "pinocchio", "meshcat": "meshcat-python", "matplotlib": "matplotlib-base"}
"""Names of packages that conda-forge calls otherwise."""


def test_one_version_everywhere_and_its_notes(capsys: pytest.CaptureFixture[str]) -> None:
    """Of the package, of the citation, and of the newest release in the changelog, which has its
    date.
    """
    package, cited, changelog = (
        (ROOT / name).read_text(encoding="utf-8")
        for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md")
    )
    version = release.version_of()
    assert version == tomllib.loads(package)["project"]["version"]
    assert re.findall(r"^version: (.+)$", cited, re.M) == [version]
    (date,) = re.findall(r'^date-released: "(.+)"$', cited, re.M)
    assert re.findall(r"^## (.+)$", changelog, re.M)[:2] == [
        "[Unreleased]",
        f"[{version}] - {date}",
    ]
    release.main(["--notes"])
    text = capsys.readouterr().out
    assert len(text.splitlines()) > 10 and "\n## [" not in text


def test_versions_that_differ_stop_the_release(tmp_path: Path) -> None:
    for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert release.version_of(tmp_path) == release.version_of()
    cited = (tmp_path / "CITATION.cff").read_text(encoding="utf-8")
    (tmp_path / "CITATION.cff").write_text(
        re.sub("^version: .*$", "version: 9.9.9", cited, flags=re.M), encoding="utf-8"
    )
    with pytest.raises(SystemExit, match="not one version: .*CITATION.cff says 9.9.9"):
        release.version_of(tmp_path)


def test_conda_asks_for_what_pip_asks_for() -> None:
    """Names as conda-forge has them, the same lower bounds but for what is told, the same version
    and command.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = (PACKAGING / "recipe.yaml").read_text(encoding="utf-8")
    assert re.findall(r'^  version: "(.+)"$', recipe, re.M) == [project["version"]]
    assert f"- gaitcal = {project['scripts']['gaitcal']}" in recipe
    run = recipe.split("  run:\n")[1].split("\ntests:")[0]
    asked = dict(re.findall(r"^    - (\S+) >=(\S+)$", run, re.M))
    asked.pop("python")
    wanted = {}
    for line in project["dependencies"]:
        name, bound = re.match(r"([\w-]+)>=([\d.]+)", line).groups()
        wanted[ON_CONDA.get(name, name)] = bound
    other = {"example-robot-data"}  # numbered otherwise on conda-forge, as in environment.yml
    assert asked.keys() == wanted.keys()
    assert {n: v for n, v in asked.items() if n not in other} == {
        n: v for n, v in wanted.items() if n not in other
    }
    environment = (PACKAGING / "environment.yml").read_text(encoding="utf-8")
    assert {name for name in asked if not re.search(rf"^  - {name}\b", environment, re.M)} == set()


def test_containers_carry_what_they_name() -> None:
    """Every file that the Dockerfile copies is there and let through; its user is not root; the
    editor's is JSON.
    """
    docker = (PACKAGING / "Dockerfile").read_text(encoding="utf-8")
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    copied = [
        word
        for line in re.findall(r"^COPY (?!--from)(.+) \S+$", docker, re.M)
        for word in line.split()
    ]
    assert copied
    for name in copied:
        assert (ROOT / name).exists(), name
        assert f"!{name}" in ignored or f"!{name}/**" in ignored, name
    assert re.findall(r"^USER (.+)$", docker, re.M)[-1] not in ("root", "0")
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text(encoding="utf-8"))
    assert "make_venv .venv" in container["postCreateCommand"]


def python(code: str, cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_what_contributors_are_told_is_there() -> None:
    """Every path and test that `CONTRIBUTING.md` names."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    folders = ("gaitcal/", "models/", "scripts/", "tests/", ".ci/")
    named = {word for word in re.findall(r"[\w./-]+", text) if word.startswith(folders)}
    assert len(named) > 10
    assert {path for path in named if not (ROOT / path.rstrip(".")).exists()} == set()
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py"))
    assert {
        name for name in re.findall(r"`(test_\w+)`", text) if f"def {name}(" not in tests
    } == set()


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        (
            "gaitcal",
            ["meshcat", "matplotlib", "dask", "distributed", "jinja2", "typer", "rich", "IPython"],
        ),
        # for who asks for a data frame or a page in the browser; they take a third of the imports'
        # time
        ("gaitcal.cli.calibrate_command", ["pandas", "pyarrow", "http.server", "matplotlib"]),
        ("gaitcal.cli.study_folder", ["pandas", "pyarrow", "http.server", "matplotlib"]),
    ],
)
def test_imports_load_no_library_that_is_for_others(
    module: str, heavy: list[str], tmp_path: Path
) -> None:
    code = f"import sys, {module}; print([name for name in {heavy} if name in sys.modules])"
    assert python(code, tmp_path, PYTHONPATH=str(ROOT)) == "[]"


def test_public_names_are_loaded_when_first_used() -> None:
    assert len(gaitcal.__all__) == len(set(gaitcal.__all__))
    assert set(dir(gaitcal)) == set(gaitcal.__all__), "as in the stub that type checkers read"
    assert all(getattr(gaitcal, name) is not None for name in gaitcal.__all__)
    assert not set(gaitcal.__all__) & {p.stem for p in (ROOT / "gaitcal").iterdir()}, (
        "a package would hide the name"
    )
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = gaitcal.no_such_name


def test_licences_of_others_are_named_and_shipped() -> None:
    """Each licence that a table names, in the metadata and in a notice that goes with the wheel; so
    others' scripts.
    """
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
    assert f"license: {expression}\n" in recipe and all(
        f"- {notice}\n" in recipe for notice in notices
    )


@pytest.mark.slow
def test_wheel_works_without_the_source_tree(tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    subprocess.run(
        [
            sys.executable,
            "-m",
            "hatchling",
            "build",
            "--target",
            "wheel",
            "--directory",
            str(tmp_path),
        ],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        archive.extractall(tmp_path / "site")
    data = {
        f"gaitcal/models/{p.relative_to(ROOT / 'models').as_posix()}"
        for p in (ROOT / "models").rglob("*.*")
    }
    assert data <= names
    (metadata,) = (tmp_path / "site").glob("gaitcal-*.dist-info/METADATA")
    assert re.search(
        "^License-Expression: .*CC-BY-SA-4.0", metadata.read_text(encoding="utf-8"), re.M
    )
    assert {"gaitcal/py.typed", "gaitcal/__init__.pyi"} <= names
    assert not [name for name in names if not name.startswith(("gaitcal/", "gaitcal-"))]
    code = (
        "import gaitcal; from gaitcal.io.toml import find_models_folder; "
        "print(find_models_folder())"
    )
    assert python(code, tmp_path, PYTHONPATH=str(tmp_path / "site")) == str(
        tmp_path / "site" / "gaitcal" / "models"
    )


PAPER = Path(__file__).parents[1] / "docs" / "paper"
SECTIONS = (
    "Summary",
    "Statement of need",
    "State of the field",
    "Software design",
    "Quality control",
    "References",
)


@pytest.fixture(scope="module")
def figures() -> ModuleType:
    spec = importlib.util.spec_from_file_location("paper_figures", PAPER / "figures.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_paper_has_its_parts_and_figures_and_every_reference_is_cited_and_has_a_doi() -> None:
    text = (PAPER / "paper.md").read_text(encoding="utf-8")
    headings = re.findall(r"^# (.+)$", text, re.M)
    assert headings[:4] == list(SECTIONS[:4]) and set(SECTIONS) <= set(headings)
    assert all((PAPER / name).is_file() for name in re.findall(r"!\[.*\]\((.+?)\)", text, re.S))
    assert len(text.split()) < 1750, "JOSS takes 750 to 1750 words"
    entries = re.split(r"^@\w+\{", (PAPER / "paper.bib").read_text(encoding="utf-8"), flags=re.M)[
        1:
    ]
    keys = {
        entry.split(",")[0]: re.findall(r"doi\s*= \{(10\.\d{4,}/\S+)\}", entry) for entry in entries
    }
    assert set(re.findall(r"(?<![\w.])@(\w+)", text)) == set(keys)
    assert all(len(dois) == 1 for dois in keys.values())


def test_the_figure_is_drawn_from_its_table(figures: ModuleType, tmp_path: Path) -> None:
    rows = figures.read(PAPER / "truth.csv")
    assert {row.part for row in rows} == set(figures.PARTS)
    figures.write(rows, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (PAPER / "truth.csv").read_bytes()
    figures.draw(rows, tmp_path / "truth.png")
    assert (tmp_path / "truth.png").stat().st_size > 10_000


MOST_LINES = 120
"""What a visitor reads; the rest is in `docs/`."""


def test_the_readme_is_short_and_its_links_lead_somewhere() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    links = re.findall(r"\]\(([^)#]+)\)", text)
    assert len(links) > 10
    assert [link for link in links if not (ROOT / link).exists()] == []
    scripts = set(re.findall(r"scripts/\w+\.\w+", text))
    assert [name for name in scripts if not (ROOT / name).exists()] == []


def test_a_package_without_its_data_stops_the_release(tmp_path: Path) -> None:
    wheel, sdist = tmp_path / "gaitcal-1-py3-none-any.whl", tmp_path / "gaitcal-1.tar.gz"
    for packed in (release.PACKED, release.PACKED[1:]):
        with zipfile.ZipFile(wheel, "w") as archive:
            for name in packed:
                archive.writestr(f"gaitcal/{name}", "x")
        with tarfile.open(sdist, "w:gz") as tar:
            for name in ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md"):
                tar.add(ROOT / name, f"gaitcal-1/{name}")
        if packed is release.PACKED:
            release.check_content(wheel, sdist)
        else:
            with pytest.raises(SystemExit, match="missing .*models/nominal_subject.json"):
                release.check_content(wheel, sdist)
