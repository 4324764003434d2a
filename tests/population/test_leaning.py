"""Calibrations that lean on a cohort: the prior in the fit, what is said of it, and the commands."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from gaitcal.calibration.joint_estimate import estimate_joints
from gaitcal.calibration.joint_prior import prior_deviations
from gaitcal.cli import app
from gaitcal.cohort.fingerprint import fingerprint
from gaitcal.cohort.learn_priors import PRIORS, PRIORS_CSV, learn_priors
from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.outcome import Outcome, keep
from gaitcal.cohort.people import Cohort, CohortPerson
from gaitcal.cohort.tables import mark
from gaitcal.compare.shared_model import require_fit_to_share
from gaitcal.errors import InputError, UsageError
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.population.result_evidence import NotUsedError, evidence_of
from gaitcal.results.sessions import load_session
from gaitcal.study.joint_prior import JointPrior
from tests.calibration.test_joint_estimate import HIP, hip_trial
from tests.derivatives import perturbed_parameters
from tests.synthetic_studies import write_synthetic_study


def run(*words: object) -> Result:
    result = CliRunner().invoke(app, [str(word) for word in words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def prior(mean: np.ndarray, covariance: np.ndarray) -> JointPrior:
    return JointPrior(names=HIP, mean=mean, covariance=covariance, file="p", people=9, left_out=0, notes=())


def test_the_default_prior_as_a_learnt_one_gives_the_same() -> None:
    problem, _ = hip_trial(1)
    nominal = perturbed_parameters(np.random.default_rng(2))
    default = prior(np.zeros(len(HIP)), np.diag(prior_deviations(HIP) ** 2))
    (plain, errors), (same, as_learnt) = (
        estimate_joints([problem], nominal, HIP, learnt=learnt) for learnt in (None, default)
    )
    np.testing.assert_allclose(same.values, plain.values, atol=1e-9)
    np.testing.assert_allclose(as_learnt.covariance, errors.covariance, rtol=1e-6, atol=1e-15)


def test_without_movement_the_mean_and_spread_of_the_cohort_stay() -> None:
    """A joint that does not move shows where its two sides meet; what it does not show follows by the correlations."""
    problem, truth = hip_trial(1)
    still = problem.with_measured(np.repeat(problem.data.measured[:, :, :1], 300, axis=2))
    nominal = perturbed_parameters(np.random.default_rng(2))
    off = truth - nominal.joint[[JP_INDEX[name] for name in HIP]]
    rng = np.random.default_rng(3)
    root = rng.normal(0.0, 0.001, (len(HIP), len(HIP)))
    learnt = prior(off, root @ root.T + 1e-8 * np.eye(len(HIP)))
    estimate, errors = estimate_joints([still], nominal, HIP, learnt=learnt)
    np.testing.assert_allclose(estimate.values, truth, atol=2e-4)
    assert (np.diag(learnt.covariance) - np.diag(errors.covariance) > -1e-12).all()


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One person, calibrated by itself."""
    folder = tmp_path_factory.mktemp("person")
    study = write_synthetic_study(folder / "study")
    text = study.read_text().replace('hip_centre = "bell"', 'hip_centre = "harrington"')
    study.write_text(text)
    run("calibrate", study, "--out", folder / "result")
    return folder / "result"


@pytest.fixture(scope="module")
def cohort(result: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Cohort, Path]:
    """Nine people with the same result, and one who is refused."""
    out, lab = tmp_path_factory.mktemp("cohort"), tmp_path_factory.mktemp("lab")
    mark(out)
    people = []
    for number in range(10):
        person = CohortPerson(folder=lab / f"P{number}", name=f"P{number}")
        shutil.copytree(result, out / person.place)
        if number == 9:
            summary = json.loads((out / person.place / "summary.json").read_text())
            (out / person.place / "summary.json").write_text(json.dumps(summary | {"verdict": "refused"}))
        keep(out, Outcome(name=person.name, session="", place=person.place, fingerprint=""))
        people.append(person)
    return Cohort(lab, tuple(people)), out


@pytest.mark.slow
def test_from_results_to_priors_and_to_a_person_who_leans_on_them(
    result: Path, cohort: tuple[Cohort, Path], tmp_path: Path
) -> None:
    everybody, out = cohort
    said = learn_priors(everybody, out)
    assert "not learnt of: P9: its verdict is refused" in said and "of 9 people" in said[0]
    with (out / PRIORS_CSV).open() as stream:
        assert len(list(csv.DictReader(stream))) == 98
    study = result.parent / "study" / "study.toml"
    told = run("calibrate", study, "--out", tmp_path / "result", "--priors", out / PRIORS).output
    assert "priors: joint parameters lean on 7 people" in " ".join(told.split())
    summary = json.loads((tmp_path / "result" / "summary.json").read_text())
    # all nine are the same recordings: the first of them is found, whose fold has two people
    assert summary["joint_prior"] == {"file": PRIORS, "people": 7, "left_out": 2}
    assert any(note.startswith("joint parameters lean on 7 people") for note in summary["notes"])
    manifest = json.loads((tmp_path / "result" / "manifest.json").read_text())
    assert manifest["settings"]["priors"] == PRIORS and manifest["inputs_sha256"][PRIORS]
    plain = json.loads((result / "summary.json").read_text())
    assert "joint_prior" not in plain and not any("lean on" in note for note in plain["notes"])
    with pytest.raises(NotUsedError, match="priors of a cohort itself"):
        evidence_of(tmp_path / "result", "P0")
    leaning, by_itself = (load_session(folder)[0] for folder in (tmp_path / "result", result))
    with pytest.raises(InputError, match="leans on priors of a cohort"):
        require_fit_to_share(replace(by_itself, name="a"), leaning)


@pytest.mark.slow
def test_too_few_trustworthy_people_are_one_line(cohort: tuple[Cohort, Path]) -> None:
    everybody, out = cohort
    with pytest.raises(InputError, match=r"4 people can be learnt of; allowed: 8 or more") as raised:
        learn_priors(replace(everybody, people=everybody.people[:4]), out)
    assert "\n" not in str(raised.value)


def test_priors_are_learnt_of_people_who_lean_on_none(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="not with --priors"):
        run("cohort", tmp_path, "--out", tmp_path / "out", "--learn-priors", "--priors", tmp_path / "priors.json")
    with pytest.raises(InputError, match="cannot be read"):
        run("cohort", tmp_path, "--out", tmp_path / "out", "--priors", tmp_path / "none.json")


def test_other_priors_are_another_fingerprint(tmp_path: Path) -> None:
    person = CohortPerson(folder=tmp_path, name="P0")
    marks = [fingerprint(person, CommonSettings())]
    for content in ("one", "other"):
        (tmp_path / "priors.txt").write_text(content)
        marks.append(fingerprint(person, CommonSettings(priors=tmp_path / "priors.txt")))
    assert len(set(marks)) == 3


def test_the_command_learns_when_everybody_has_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from gaitcal.cohort.tables import FAILURES, Written
    from gaitcal.commands import cohort as command

    def ended(*_: object, **__: object) -> Written:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / FAILURES).write_text("person,session,group,folder,cause,what_to_do\n")
        return Written({"trustworthy": 9})

    (tmp_path / "lab" / "Ann").mkdir(parents=True)
    (tmp_path / "lab" / "Ann" / "walk.c3d").write_bytes(b"")
    monkeypatch.setattr(command, "run_cohort", ended)
    monkeypatch.setattr(command, "learn_priors", lambda cohort, out, told: ("legs: offset learnt of 9 people",))
    said = run("cohort", tmp_path / "lab", "--out", tmp_path / "out", "--learn-priors").output
    assert "legs: offset learnt of 9 people" in said and "priors:" in said
