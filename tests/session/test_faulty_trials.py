"""Bad takes in a folder."""

import pytest

from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.session.draft import study_of
from gaitcal.session.drafting import without_faulty_trials
from gaitcal.study.study import Study
from tests.session.folders import draft, recordings, write


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    files = recordings()
    walk = files["walk"]
    again = walk.frames(walk.time > walk.time[60])
    again = type(again)(source="x", time=again.time, labels=again.labels, markers=again.markers[::-1].copy())
    return study_of(draft(write(tmp_path_factory.mktemp("x") / "person", {**files, "other": again})))


def error(where: str, severity: Severity = Severity.ERROR) -> Finding:
    return Finding(
        code=Code.PLATE_OFFSET, severity=severity, topic="plates", where=where, found="x is wrong", cure="do y"
    )


def test_a_faulty_walk_goes_and_is_told(study: Study) -> None:
    assert [t.name for t in study.trials] == ["static", "other", "walk"]
    rest, findings, faulty = without_faulty_trials(study, (error("other"), error("walk", Severity.WARNING)))
    assert [t.name for t in rest.trials] == ["static", "walk"]
    assert faulty == {"other": "plates: x is wrong; do y"}
    assert all(f.where != "other" for f in findings), "checked again without it"


@pytest.mark.parametrize("where", [("static",), (STUDY,), ("other", "walk"), ("other", "static"), ()])
def test_nothing_goes_where_nothing_would_be_left_or_all_is_in_doubt(study: Study, where: tuple[str, ...]) -> None:
    found = tuple(error(name) for name in where)
    assert without_faulty_trials(study, found) == (study, found, {})
