"""On which files a person's result depends: what a study names, wherever it lies, and what a draft reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.outcome import fingerprint, inputs_of
from gaitcal.cohort.people import CohortPerson, read_cohort
from gaitcal.errors import InputError

STUDY = """
[subject]
name = "Ann"
mass_kg = 60
height_m = 1.7
sex = "female"

[markers]
set = "../../sets/own.toml"

[[trial]]
name = "static"
role = "static"
file = "data/raw/static.c3d"

[[trial]]
name = "walk"
role = "gait"
file = "../shared/walk.trc"
forces = "data/raw/loads.xml"
"""
LOADS = '<ExternalLoads><ExternalForce name="r"/><datafile>forces.mot</datafile></ExternalLoads>'
NAMED = (
    "data/raw/static.c3d",
    "../shared/walk.trc",
    "data/raw/loads.xml",
    "data/raw/forces.mot",
    "../../sets/own.toml",
)


@pytest.fixture(params=["study.toml", "before.toml"])
def ann(request: pytest.FixtureRequest, tmp_path: Path) -> CohortPerson:
    folder = tmp_path / "lab" / "Ann"
    folder.mkdir(parents=True)
    (folder / request.param).write_text(STUDY)
    for name in NAMED:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(LOADS if path.suffix == ".xml" else name)
    return CohortPerson(folder=folder, name="Ann")


@pytest.mark.parametrize("name", NAMED)
def test_every_file_that_a_study_names_counts(ann: CohortPerson, name: str) -> None:
    first = fingerprint(ann, CommonSettings())
    path = ann.folder / name
    kept = path.read_bytes()
    path.write_bytes(kept + b" ")
    changed = fingerprint(ann, CommonSettings())
    path.unlink()
    missing = fingerprint(ann, CommonSettings())
    assert len({first, changed, missing}) == 3
    path.write_bytes(kept)
    assert fingerprint(ann, CommonSettings()) == first


def test_one_of_several_missing_files_that_comes_back_is_seen(ann: CohortPerson) -> None:
    for name in NAMED[:2]:
        (ann.folder / name).unlink()
    before = fingerprint(ann, CommonSettings())
    (ann.folder / NAMED[0]).write_text("again")
    assert fingerprint(ann, CommonSettings()) != before


def test_no_file_counts_twice(ann: CohortPerson) -> None:
    (ann.folder / "notes.txt").write_text("no recording")
    files = inputs_of(ann.folder)
    whole = [path.resolve() for path in files.values()]
    assert len(set(whole)) == len(whole) == len(NAMED) + 1
    assert "../shared/walk.trc" in files
    assert "data/raw/static.c3d" in files


def test_a_draft_reads_tables_that_an_xml_names(tmp_path: Path) -> None:
    folder = tmp_path / "Bob"
    (folder / "deep" / "tables").mkdir(parents=True)
    (folder / "deep" / "loads.xml").write_text(LOADS.replace("forces.mot", "tables/forces.mot"))
    (folder / "deep" / "tables" / "forces.mot").write_text("1")
    (folder / "deep" / "tables" / "other.mot").write_text("2")
    assert set(inputs_of(folder)) == {"deep/loads.xml", "deep/tables/forces.mot"}


def test_a_name_too_long_for_a_folder_reads_nothing(tmp_path: Path) -> None:
    assert inputs_of(tmp_path / ("x" * 300)) == {}


def test_joint_parameters_that_a_cohort_file_expects_are_known_ones(tmp_path: Path) -> None:
    (tmp_path / "Ann").mkdir()
    file = tmp_path / "cohort.toml"
    text = '[[person]]\nfolder = "Ann"\n[calibration.joint_prior]\n"hip.pelvis.NAME" = { mean = -7 }\n'
    file.write_text(text.replace("NAME", "ant"))
    assert read_cohort(file, tmp_path / "out")[1].joint_prior["hip.pelvis.ant"].mean == -7.0
    file.write_text(text.replace("NAME", "front"))
    with pytest.raises(InputError, match=r"cohort.toml: calibration.joint_prior: found 'hip.pelvis.front'"):
        read_cohort(file, tmp_path / "out")
