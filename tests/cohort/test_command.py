"""`gaitcal cohort` from bare folders to tables, on made-up people."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest

from gaitcal.cli.cohort import _teller, duration
from gaitcal.cli.console import Console
from gaitcal.codes import Code
from gaitcal.cohort.people import people_in
from gaitcal.errors import InputError, UsageError
from gaitcal.io.result_folder import listed
from tests.cohort.kept import Kept, write_cohort
from tests.commands import run
from tests.session.folders import recordings, write


def test_usage(tmp_path: Path) -> None:
    assert run("cohort", tmp_path).exit_code == 2
    with pytest.raises(UsageError, match="--jobs: found 0"):
        run("cohort", tmp_path, "--out", tmp_path / "out", "--jobs", 0)
    with pytest.raises(InputError, match="no sub-folder holds recordings"):
        run("cohort", tmp_path, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_durations() -> None:
    assert [duration(s) for s in (12, 200, 7500)] == ["12 s", "3 min", "2 h 05 min"]


def test_tables_of_markers_are_recordings_and_tables_of_forces_are_not(tmp_path: Path) -> None:
    write(tmp_path / "Ann", recordings(), forces="grf")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "list.csv").write_text("a;b\n1;2\n")
    cohort = people_in(tmp_path, tmp_path / "out")
    assert ([p.name for p in cohort.people], cohort.ignored) == (["Ann"], ("notes",))


def test_lines_name_people_without_a_session(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tell = _teller(Console(quiet=False, verbose=True), lambda text: None, 2)
    for session in ("", "pre"):
        one = replace(Kept(name="P1", session=session).outcome, computed=False)
        tell(one, 1, None)
    assert capsys.readouterr().out == "P1: trustworthy, unchanged (1 of 2)\nP1 pre: trustworthy, unchanged (1 of 2)\n"


@pytest.mark.parametrize(
    "words",
    [
        ("view", "COHORT", "--html", "page.html"),
        ("compare", "COHORT", "COHORT"),
        ("compare", "COHORT", "--osim", "model.osim"),
        ("dynamics", "COHORT", "walk.c3d"),
        ("export", "COHORT"),
        ("export", "COHORT", "--format", "cycles"),
        ("figures", "COHORT"),
        ("figures", "COHORT", "--for", "paper"),
        ("montecarlo", "COHORT"),
    ],
)
def test_a_cohort_is_no_result_of_one_person(tmp_path: Path, words: tuple[str, ...]) -> None:
    write_cohort(tmp_path, [Kept(name="Ann")])
    one = tmp_path / "people" / "Ann"
    one.mkdir(parents=True)
    (one / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match=f"is a cohort; name the result of one person, .* such as {one}") as caught:
        run(*(tmp_path if word == "COHORT" else word for word in words))
    assert caught.value.code is Code.NO_RESULT


def test_the_manifest_of_a_cohort_is_signed(tmp_path: Path) -> None:
    write_cohort(tmp_path, [Kept(name="Ann")])
    assert {"people.csv", "cohort.html"} < set(listed(tmp_path))
    manifest = tmp_path / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"people": 1', '"people": 2'))
    with pytest.raises(InputError, match="is damaged, or was edited"):
        listed(tmp_path)


@pytest.mark.slow
def test_from_bare_folders_to_tables(tmp_path: Path) -> None:
    """One is calibrated, one has nobody who tells the mass, one has a file that is none; a second run does nothing."""
    lab, out = tmp_path / "lab", tmp_path / "out"
    write(lab / "Ann" / "day 1", recordings(), forces="grf")
    write(lab / "Bob", recordings(), forces="grf")
    (lab / "Cid").mkdir()
    (lab / "Cid" / "walk.c3d").write_bytes(b"no recording")
    (lab / "people.csv").write_text("person,group,sex,mass_kg,height_m\nAnn,controls,m,69.4,1.70\n")
    command = ("cohort", lab, "--out", out, "--jobs", 1)
    first = run(*command)
    assert first.exit_code == 1, first.output
    assert "1 of 3" in first.stdout
    assert f"page: {out / 'cohort.html'}" in first.stdout
    assert (out / "cohort.html").is_file()
    with (out / "people.csv").open(newline="") as stream:
        (ann,) = csv.DictReader(stream)
    assert (ann["person"], ann["session"], ann["group"]) == ("Ann", "day 1", "controls")
    result = out / ann["folder"]
    assert json.loads((result / "manifest.json").read_text())["subject"]["name"] == "Ann"
    assert 'session = "day 1"' in (result / "study.toml").read_text()
    with (out / "failures.csv").open(newline="") as stream:
        bob, cid = csv.DictReader(stream)
    assert bob["cause"] == "no file says subject.mass_kg"
    assert bob["what_to_do"] == "give mass_kg in people.csv or cohort.toml"
    assert (cid["person"], bob["code"], cid["code"]) == ("Cid", "GC-211", "GC-223")
    written = (result / "manifest.json").stat().st_mtime_ns
    again = run(*command)
    assert again.exit_code == 1
    assert "failed: Bob: no file says" in again.stdout
    assert " of 3" not in again.stdout
    assert (result / "manifest.json").stat().st_mtime_ns == written
