"""Calibrations that lean on a cohort: the prior in the fit, what is said of it, and the
commands.
"""

import csv
import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gaitcal.calibration.joint_estimate import BY_EVIDENCE, estimate_joints
from gaitcal.calibration.joint_prior import (
    ANATOMY,
    combine_joint_priors,
    factor_prior,
    select_prior,
)
from gaitcal.cohort.cohort_people import Cohort, CohortPerson, read_cohort
from gaitcal.cohort.learn_priors import (
    PRIORS,
    PRIORS_CSV,
    NotUsedError,
    learn_priors,
    read_evidence,
)
from gaitcal.cohort.one_person import CommonSettings, _describe_contradictions
from gaitcal.cohort.outcome import Outcome, compute_fingerprint, write_outcome
from gaitcal.cohort.run_cohort import mark_as_cohort
from gaitcal.errors import Code
from gaitcal.intake.draft_file import format_settings
from gaitcal.io.result_folder import compute_sha256
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from gaitcal.results.saved_result import load_result
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.settings import CalibrationSettings, ParameterPriorTable
from gaitcal.study.study import Study
from tests.calibration.test_joint_estimate import HIP, gait, hip_trial
from tests.commands import run
from tests.derivatives import perturbed_parameters
from tests.messages import check_text, numbers, refuses
from tests.synthetic_studies import write_synthetic_study


def with_priors(study: Path, named: str, *more: str) -> str:
    """The text of a study file that names priors."""
    head, _, settings = study.read_text().partition("[calibration]\n")
    return "\n".join([head, "[calibration]", f'priors = "{named}"', *more, settings])


def prior(mean: np.ndarray, covariance: np.ndarray) -> JointPrior:
    return JointPrior(
        names=HIP, mean=mean, covariance=covariance, file="p", people=9, left_out=0, notes=()
    )


def test_the_default_prior_as_a_learnt_one_gives_the_same() -> None:
    problem, _ = hip_trial(1)
    nominal = perturbed_parameters(np.random.default_rng(2))
    (plain, errors), (same, as_learnt) = (
        estimate_joints(gait(problem), nominal, HIP, replace(BY_EVIDENCE, prior=learnt))
        for learnt in (ANATOMY, prior(*select_prior(HIP, None)))
    )
    np.testing.assert_allclose(same.values, plain.values, atol=1e-9)
    np.testing.assert_allclose(as_learnt.covariance, errors.covariance, rtol=1e-6, atol=1e-15)


def test_without_movement_the_mean_and_spread_of_the_cohort_stay() -> None:
    """A joint that does not move shows where its two sides meet; what it does not show follows by
    the correlations.
    """
    problem, truth = hip_trial(1)
    still = problem.with_measured(np.repeat(problem.data.measured[:, :, :1], 300, axis=2))
    nominal = perturbed_parameters(np.random.default_rng(2))
    off = truth - nominal.joint[[JP_INDEX[name] for name in HIP]]
    rng = np.random.default_rng(3)
    root = rng.normal(0.0, 0.001, (len(HIP), len(HIP)))
    learnt = prior(off, root @ root.T + 1e-8 * np.eye(len(HIP)))
    estimate, errors = estimate_joints(
        gait(still), nominal, HIP, replace(BY_EVIDENCE, prior=learnt)
    )
    np.testing.assert_allclose(estimate.values, truth, atol=2e-4)
    assert (np.diag(learnt.covariance) - np.diag(errors.covariance) > -1e-12).all()


def test_a_joint_that_does_not_move_is_where_the_study_file_expects_it() -> None:
    """H^-1 P0^-1 F, a column a cause: H^-1 by all columns together, F by the prior."""
    problem, _ = hip_trial(1)
    still = problem.with_measured(np.repeat(problem.data.measured[:, :, :1], 300, axis=2))
    nominal = perturbed_parameters(np.random.default_rng(2))
    both = {
        f"hip.{segment}.ant": ParameterPriorTable(mean=-7.0, deviation=0.5)
        for segment in ("pelvis", "thigh")
    }
    study = combine_joint_priors(both)
    estimate, errors = estimate_joints(gait(still), nominal, HIP, replace(BY_EVIDENCE, prior=study))
    off = estimate.values - nominal.joint[[JP_INDEX[name] for name in HIP]]
    place = HIP.index("hip_r.pelvis.ant")
    assert off[place] == pytest.approx(-0.007, abs=0.001)
    assert errors.standard_errors["hip_r.pelvis.ant"] < 0.0005
    own = [errors.sources.index(f"nominal/{name}") for name in HIP]
    wanted = errors.covariance @ np.linalg.solve(
        select_prior(HIP, study)[1], factor_prior(HIP, study)
    )
    np.testing.assert_allclose(errors.effects[:, own], wanted, atol=1e-9)


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
    mark_as_cohort(out)
    people = []
    for number in range(10):
        person = CohortPerson(folder=lab / f"P{number}", name=f"P{number}")
        shutil.copytree(result, out / person.subfolder)
        if number == 9:
            summary = json.loads((out / person.subfolder / "summary.json").read_text())
            (out / person.subfolder / "summary.json").write_text(
                json.dumps(summary | {"verdict": "refused"})
            )
        write_outcome(
            out, Outcome(name=person.name, session="", place=person.subfolder, fingerprint="")
        )
        people.append(person)
    return Cohort(lab, tuple(people)), out


@pytest.mark.slow
def test_from_results_to_priors_and_to_a_person_who_leans_on_them(
    result: Path, cohort: tuple[Cohort, Path], tmp_path: Path
) -> None:
    everybody, out = cohort
    said = learn_priors(everybody, out)
    assert 9 in numbers(said[0])
    check_text(said, "P9")
    with (out / PRIORS_CSV).open() as stream:
        assert len(list(csv.DictReader(stream))) == len(JP_NAMES)
    study = result.parent / "study" / "study.toml"
    told = run("calibrate", study, "--out", tmp_path / "result", "--priors", out / PRIORS).output
    assert "priors: joint parameters lean on 7 people" in " ".join(told.split())
    summary = json.loads((tmp_path / "result" / "summary.json").read_text())
    # all nine are the same recordings: the first of them is found, whose fold has two people
    assert summary["joint_prior"] == {"file": PRIORS, "people": 7, "left_out": 2}
    check_text(summary["notes"], 7)
    manifest = json.loads((tmp_path / "result" / "manifest.json").read_text())
    assert manifest["settings"]["priors"] == PRIORS and manifest["inputs_sha256"][PRIORS]
    plain = json.loads((result / "summary.json").read_text())
    assert "joint_prior" not in plain and not any("lean on" in note for note in plain["notes"])
    # the same file named by the study itself: the same result, and no option beside it
    shutil.copy(out / PRIORS, study.parent / PRIORS)
    own = study.with_name("own.toml")
    own.write_text(with_priors(study, PRIORS))
    assert "lean on 7 people" in " ".join(
        run("calibrate", own, "--out", tmp_path / "own").output.split()
    )
    again = json.loads((tmp_path / "own" / "manifest.json").read_text())
    assert again["settings"] == manifest["settings"] and again["inputs_sha256"][PRIORS]
    assert again["settings"]["priors_sha256"] == again["inputs_sha256"][PRIORS]
    assert (tmp_path / "own" / "parameters.csv").read_text() == (
        tmp_path / "result" / "parameters.csv"
    ).read_text()
    assert load_result(tmp_path / "own").settings.priors == Path(PRIORS)
    with refuses(Code.OPTION, field="--priors"):
        run("calibrate", own, "--out", tmp_path / "neither", "--priors", out / PRIORS)
    assert not (tmp_path / "neither").exists()
    with refuses(NotUsedError):
        read_evidence(tmp_path / "result", "P0")


@pytest.mark.slow
def test_too_few_trustworthy_people_are_one_line(cohort: tuple[Cohort, Path]) -> None:
    everybody, out = cohort
    few = replace(
        everybody, people=(*everybody.people[:4], everybody.people[9], everybody.people[9])
    )
    with refuses(Code.PRIORS, 4, 8, 2):
        learn_priors(few, out)


def test_priors_are_learnt_of_people_who_lean_on_none(tmp_path: Path) -> None:
    with refuses(Code.OPTION, field="--learn-priors"):
        run(
            "cohort",
            tmp_path,
            "--out",
            tmp_path / "out",
            "--learn-priors",
            "--priors",
            tmp_path / "priors.json",
        )
    with refuses(Code.UNREADABLE, source="none.json"):
        run("cohort", tmp_path, "--out", tmp_path / "out", "--priors", tmp_path / "none.json")


@pytest.mark.parametrize("named_by", ["the cohort", "the person's study"])
def test_other_priors_are_another_fingerprint(tmp_path: Path, named_by: str) -> None:
    folder, file = tmp_path / "lab" / "P0", tmp_path / "p.json"
    study = write_synthetic_study(folder)
    if named_by != "the cohort":
        study.write_text(with_priors(study, "../../p.json"))
    person = CohortPerson(folder=folder, name="P0")
    marks = {compute_fingerprint(person, CommonSettings())}
    for content in ("one", "other"):
        file.write_text(content)
        marks.add(
            compute_fingerprint(
                person, CommonSettings(priors=file if named_by == "the cohort" else None)
            )
        )
    assert len(marks) == 3


def test_the_command_learns_when_everybody_has_ended(
    one_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gaitcal.cli import cohort_command as command
    from gaitcal.cohort.run_cohort import FAILURES

    def ended(*_: object, **__: object) -> Counter[str]:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / FAILURES).write_text("person,session,group,folder,cause,what_to_do\n")
        return Counter(trustworthy=9)

    monkeypatch.setattr("gaitcal.cohort.run_cohort.run_cohort", ended)
    monkeypatch.setattr(
        command, "learn", lambda cohort, out, told: ("legs: offset learnt of 9 people",)
    )
    said = run("cohort", one_folder, "--out", tmp_path / "out", "--learn-priors").output
    check_text(said, "priors:", 9, 1, 8)


def test_a_study_that_names_no_priors_is_one_line_with_its_field(tmp_path: Path) -> None:
    study = write_synthetic_study(tmp_path)
    plain = study.read_text()
    study.write_text(with_priors(study, "prior.json"))
    with refuses(Code.NO_FILE, field="calibration.priors", source="study.toml"):
        Study.load(study)
    (tmp_path / "prior.json").write_text("[]")
    with refuses(Code.PRIORS, "priors.json", source="prior.json"):
        Study.load(study)
    for other in ("jp = false", 'protocol = "published"'):
        study.write_text(plain)
        study.write_text(with_priors(study, "prior.json", other))
        with refuses(Code.PRIORS, "prior.json", field="calibration.priors", source="study.toml"):
            Study.load(study)


def test_a_cohort_file_names_priors_for_everyone(one_folder: Path, tmp_path: Path) -> None:
    file = one_folder / "cohort.toml"
    file.write_text(
        '[[person]]\nfolder = "Ann"\n[calibration]\nip = "none"\npriors = "../p.json"\n'
    )
    out = tmp_path / "out"
    with refuses(Code.NO_FILE, field="calibration.priors", source="cohort.toml"):
        run("cohort", file, "--out", out)
    (tmp_path / "p.json").write_text("{}")
    with refuses(Code.PRIORS, source="p.json"):
        run("cohort", file, "--out", out)
    with refuses(Code.OPTION, "cohort.toml", field="--learn-priors"):
        run("cohort", file, "--out", out, "--learn-priors")
    _, settings = read_cohort(file, out)
    assert settings.priors == file.parent / "../p.json"


def test_priors_of_a_cohort_file_are_those_of_everyone_and_no_setting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gaitcal.cli import cohort_command as command

    monkeypatch.setattr(command, "read_cohort_priors", lambda path: None)
    said = CalibrationSettings(ip="none", priors=tmp_path / "p.json")
    priors, settings = command._choose_priors(None, said, learn_priors=False)
    assert priors == (tmp_path / "p.json").resolve()
    assert CommonSettings(calibration=settings, priors=priors).given_settings == {"ip": "none"}
    with refuses(Code.OPTION, "cohort.toml", field="--priors"):
        command._choose_priors(tmp_path / "q.json", said, learn_priors=False)


def test_priors_of_a_persons_own_study_come_before_those_of_the_cohort(tmp_path: Path) -> None:
    (tmp_path / "p.json").write_text("one")
    own = replace(prior(np.zeros(len(HIP)), np.eye(len(HIP))), file="own.json", sha256="ab")
    study = SimpleNamespace(subject=SimpleNamespace(mass=70.0, height=1.7), joint_prior=own)
    person = CohortPerson(folder=tmp_path, name="P0")
    (note,) = _describe_contradictions(
        person, cast(Study, study), CommonSettings(priors=tmp_path / "p.json")
    )
    check_text(note, "p.json", "own.json")
    same = SimpleNamespace(
        **{
            **vars(study),
            "joint_prior": replace(own, sha256=compute_sha256(tmp_path / "p.json") or ""),
        }
    )
    assert not _describe_contradictions(
        person, cast(Study, same), CommonSettings(priors=tmp_path / "p.json")
    )


def test_the_drafted_study_of_a_result_names_the_priors(tmp_path: Path) -> None:
    text = format_settings(
        CalibrationSettings(ip="none"), tmp_path / "lab" / "p.json", tmp_path / "out" / "P0"
    )
    assert text == '\n[calibration]\nip = "none"\npriors = "../../lab/p.json"\n'
    assert format_settings(CalibrationSettings(), None, tmp_path) == ""
