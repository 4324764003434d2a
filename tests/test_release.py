"""What a release says of itself and needs: notes from the changelog, one version, requirements that agree."""

import json
import re
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from scripts.tools import release

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PACKAGING = ROOT / "scripts/tools/packaging"

CHANGELOG = """# Changelog

## [Unreleased]

## [1.1.0] - 2026-02-03

### Added

- A thing ([the paper]).

## [1.0.0] - 2026-01-02

- The first.

[the paper]: https://example.org/paper
[1.1.0]: https://example.org/1.1.0
"""
ON_CONDA = {"pin": "pinocchio", "meshcat": "meshcat-python", "matplotlib": "matplotlib-base"}
"""Names of packages that conda-forge calls otherwise."""


def test_notes_are_the_section_of_the_version() -> None:
    assert release.notes(CHANGELOG, "1.1.0") == (
        "### Added\n\n- A thing ([the paper]).\n\n[the paper]: https://example.org/paper\n"
    )
    assert release.notes(CHANGELOG, "1.0.0") == "- The first.\n"


@pytest.mark.parametrize(
    "section, told", [("2.0.0", "has no section .2.0.0.; it has Unreleased"), ("Unreleased", "nothing")]
)
def test_a_section_that_tells_nothing_stops_the_release(section: str, told: str) -> None:
    with pytest.raises(SystemExit, match=told):
        release.notes(CHANGELOG, section)


def test_notes_of_our_own_changelog(capsys: pytest.CaptureFixture[str]) -> None:
    version = release.version_of()
    release.main(["--notes"])
    text = capsys.readouterr().out
    assert len(text.splitlines()) > 10 and "\n## [" not in text
    assert version == tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


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


def test_a_release_starts_from_an_empty_folder(tmp_path: Path) -> None:
    (tmp_path / "old.whl").touch()
    with pytest.raises(SystemExit, match="is not empty"):
        release.main(["--allow-changes", "--out", str(tmp_path)])


def test_conda_asks_for_what_pip_asks_for() -> None:
    """Names as conda-forge has them, the same lower bounds but for what is told, the same version and command."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = (PACKAGING / "recipe.yaml").read_text(encoding="utf-8")
    assert re.findall(r'^  version: "(.+)"$', recipe, re.M) == [project["version"]]
    assert f"- gaitcal = {project['scripts']['gaitcal']}" in recipe
    run = recipe.split("  run:\n")[1].split("\ntests:")[0]
    asked = dict(re.findall(r"^    - (\S+) >=(\S+)$", run, re.M))
    asked.pop("python")
    wanted = {}
    for line in project["dependencies"]:
        name, bound = re.match(r"([\w-]+)>=([\d.]+)", line).groups()  # type: ignore[union-attr]
        wanted[ON_CONDA.get(name, name)] = bound
    other = {"example-robot-data"}  # numbered otherwise on conda-forge, as in environment.yml
    assert asked.keys() == wanted.keys()
    assert {n: v for n, v in asked.items() if n not in other} == {n: v for n, v in wanted.items() if n not in other}
    environment = (PACKAGING / "environment.yml").read_text(encoding="utf-8")
    assert {name for name in asked if not re.search(rf"^  - {name}\b", environment, re.M)} == set()


def test_containers_carry_what_they_name() -> None:
    """Every file that the Dockerfile copies is there and let through; its user is not root; the editor's is JSON."""
    docker = (PACKAGING / "Dockerfile").read_text(encoding="utf-8")
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    copied = [word for line in re.findall(r"^COPY (?!--from)(.+) \S+$", docker, re.M) for word in line.split()]
    assert copied
    for name in copied:
        assert (ROOT / name).exists(), name
        assert f"!{name}" in ignored or f"!{name}/**" in ignored, name
    assert re.findall(r"^USER (.+)$", docker, re.M)[-1] not in ("root", "0")
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text(encoding="utf-8"))
    assert "make_venv .venv" in container["postCreateCommand"]
