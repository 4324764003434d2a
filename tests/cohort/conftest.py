"""A laboratory of four people whose calibrations are stubs."""

from pathlib import Path

import pytest

from gaitcal.cohort import outcome as tasks
from gaitcal.cohort.cohort_people import CohortPerson
from gaitcal.cohort.one_person import CommonSettings, PersonError
from gaitcal.errors import Code
from tests.cohort.stubs import write_result


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of those who were calibrated. Zed's recordings are at fault, Yan's calibration is."""
    called: list[str] = []

    def stub(person: CohortPerson, out: Path, common: CommonSettings) -> None:
        called.append(person.name)
        if person.name == "Zed":
            raise PersonError(
                "the static trial is restless", "record it again", code=Code.STILLNESS
            )
        if person.name == "Yan":
            raise ZeroDivisionError("by zero")
        write_result(person, out, common)

    monkeypatch.setattr(tasks, "calibrate_person", stub)
    return called


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    for name in ("Ann", "Bob", "Yan", "Zed"):
        (tmp_path / "lab" / name).mkdir(parents=True)
        (tmp_path / "lab" / name / "walk.c3d").write_text(name)
    return tmp_path / "lab"


@pytest.fixture
def one_folder(tmp_path: Path) -> Path:
    """A laboratory of one person, whose walk is an empty file."""
    (tmp_path / "lab" / "Ann").mkdir(parents=True)
    (tmp_path / "lab" / "Ann" / "walk.c3d").write_bytes(b"")
    return tmp_path / "lab"
