"""From people to a file of priors, and from the file to a person."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.calibration.joint_prior import prior_of, prior_root
from gaitcal.cohort.cohort_priors import Rules, learn_cohort, priors_rows, priors_text, priors_words
from gaitcal.cohort.person_evidence import PersonEvidence
from gaitcal.cohort.result_evidence import Found, one_each
from gaitcal.errors import InputError
from gaitcal.io.toml import package_version
from gaitcal.model.parameters import JP_NAMES
from gaitcal.study.joint_prior import (
    CohortPriors,
    Person,
    expected,
    joint_prior,
    mirror,
    other_side,
    prior_of_person,
    read_cohort_priors,
    sided_directions,
    symmetric,
    with_cohort_priors,
)
from gaitcal.study.study import Study
from tests.cohort.made_people import NAMES, Array, people
from tests.synthetic_studies import write_synthetic_study

RULES = Rules(marker_set="published", hip_centre="bell", ankle_zero="markers")
SPREAD = 0.1
ROUNDED = 1e-7
"""Of a variance: what the nine digits of the file leave open."""


def offset(rng: np.random.Generator, person: Person) -> Array:
    alike, _ = sided_directions(NAMES)
    common = alike @ np.linspace(-0.8, 0.8, alike.shape[1])
    out: Array = common + SPREAD * rng.normal(size=len(NAMES))
    return out


def as_default(rng: np.random.Generator, person: Person) -> Array:
    return rng.normal(size=len(NAMES))


@pytest.fixture(scope="module")
def priors() -> CohortPriors:
    return learn_cohort("lab", people(12, offset, np.random.default_rng(1)), RULES, ["its verdict is refused"])


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return Study.load(write_synthetic_study(tmp_path_factory.mktemp("study")))


def written(priors: CohortPriors, folder: Path) -> Path:
    file = folder / "priors.json"
    file.write_text(priors_text(priors), encoding="utf-8")
    return file


def test_the_other_side_of_every_parameter_is_the_mirror_image() -> None:
    reflected = mirror(NAMES)
    np.testing.assert_array_equal(reflected @ reflected, np.eye(len(NAMES)))
    assert other_side("hip_r.pelvis.ant") == "hip_l.pelvis.ant" and other_side("back.trunk.lat") == "back.trunk.lat"
    place = {name: k for k, name in enumerate(NAMES)}
    assert reflected[place["hip_l.pelvis.ant"], place["hip_r.pelvis.ant"]] == 1.0
    assert reflected[place["hip_l.pelvis.lat"], place["hip_r.pelvis.lat"]] == -1.0
    alike, opposite = sided_directions(NAMES)
    np.testing.assert_allclose(reflected @ alike, alike)
    np.testing.assert_allclose(reflected @ opposite, -opposite)


def test_an_offset_is_learnt_and_read_back(priors: CohortPriors, study: Study, tmp_path: Path) -> None:
    file = written(priors, tmp_path)
    assert read_cohort_priors(file) == priors
    leaning = with_cohort_priors(study, file)
    prior = leaning.joint_prior
    assert prior is not None and prior.people == 12 and prior.left_out == 0
    mean, covariance = prior_of(NAMES, prior)
    alike, _ = sided_directions(NAMES)
    common = alike @ np.linspace(-0.8, 0.8, alike.shape[1])
    origin, default = prior_of(NAMES, None)
    unit = np.linalg.inv(prior_root(NAMES, None))
    assert np.linalg.norm(unit @ (mean - origin) - common) < 0.3 * np.linalg.norm(common)
    assert (np.diag(covariance) < np.diag(default)).all() and (np.diag(unit @ covariance @ unit.T) < 1.0).all()
    assert "12 people of the cohort 'lab'" in prior.notes[0]
    assert leaning.inputs.keys() - study.inputs.keys() == {"priors.json"} and not leaning.changed_inputs()
    assert prior.names == NAMES, "nobody tells of trunk and arms: what is known of them stays"
    rows = list(priors_rows(priors))
    assert len(rows) == len(JP_NAMES) and rows[0]["unit"] in ("mm", "deg") and rows[-1]["learnt"] == "nothing"
    assert "legs: offset" in next(priors_words(priors))


def test_people_like_the_default_prior_change_nothing() -> None:
    learnt = learn_cohort("lab", people(16, as_default, np.random.default_rng(2)), RULES)
    part = learnt.parts[0]
    assert part.learning == "nothing" and part.gain == [0.0, 0.0]
    np.testing.assert_array_equal(symmetric(part.populations[0].spread, len(NAMES)), np.eye(len(NAMES)))
    mean, covariance = expected(part, 0, Person(height=1.7, sex=""), (1.5, 1.9))
    np.testing.assert_allclose(mean, prior_of(NAMES, None)[0])
    np.testing.assert_allclose(covariance, prior_of(NAMES, None)[1], rtol=ROUNDED)
    nobody = prior_of_person(learnt, Person(height=1.7, sex=""), Path("priors.json"))
    assert nobody.names == () and nobody.covariance.shape == (0, 0)


def test_the_order_of_people_makes_no_difference(priors: CohortPriors) -> None:
    backwards = people(12, offset, np.random.default_rng(1))[::-1]
    assert learn_cohort("lab", backwards, RULES, ["its verdict is refused"]) == priors


@pytest.mark.slow
@pytest.mark.parametrize("by", ["recording", "name"])
def test_who_is_among_the_people_leans_on_the_others(priors: CohortPriors, study: Study, by: str) -> None:
    """Person 3 as a study of the same recording, or of the same name: their fold is left out."""
    one = people(12, offset, np.random.default_rng(1))[3]
    if by == "recording":
        again = replace(study, inputs={**study.inputs, "walk.c3d": "file 3"})
    else:
        again = replace(study, subject=replace(study.subject, name=one.name))
    prior = joint_prior(priors, again, Path("priors.json"))
    fold = priors.people[3].fold
    left_out = [p.fold for p in priors.people].count(fold)
    assert (prior.people, prior.left_out) == (12 - left_out, left_out)
    assert "left out" in prior.notes[0]
    everybody = people(12, offset, np.random.default_rng(1))
    changed = [replace(p, parts=_louder(p)) if p is everybody[3] else p for p in everybody]
    other = joint_prior(learn_cohort("lab", changed, RULES), again, Path("priors.json"))
    assert not np.allclose(
        joint_prior(learn_cohort("lab", changed, RULES), study, Path("x")).mean,
        joint_prior(priors, study, Path("x")).mean,
    )
    # whatever their own result says, as long as as much is learnt, what they lean on is the same
    np.testing.assert_allclose(other.mean, prior.mean, atol=1e-9)


def _louder(person: PersonEvidence) -> dict[str, object]:
    legs = person.parts["legs"]
    return {**person.parts, "legs": replace(legs, right=1.3 * legs.right)}


def test_too_few_people_are_refused() -> None:
    few = people(7, offset, np.random.default_rng(3))
    with pytest.raises(InputError, match="7 people can be learnt of; allowed: 8 or more"):
        learn_cohort("lab", few, RULES)


@pytest.mark.parametrize(
    ("rule", "value", "words"),
    [("marker_set", "gait2392", "marker_set: learnt with 'gait2392'"), ("hip_centre", "harrington", "hip_centre")],
)
def test_other_markers_or_nominal_joints_are_refused(
    priors: CohortPriors, study: Study, rule: str, value: str, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        joint_prior(priors.model_copy(update={rule: value}), study, Path("priors.json"))


def test_another_version_and_another_size_are_told(priors: CohortPriors, study: Study) -> None:
    tall = replace(study, subject=replace(study.subject, height=2.1))
    notes = joint_prior(priors.model_copy(update={"gaitcal": "0.0.1"}), tall, Path("priors.json")).notes
    assert "2.10 m is outside" in notes[1] and f"gaitcal 0.0.1, not {package_version('gaitcal')}" in notes[2]


def _without_covariance(content: dict[str, object]) -> None:
    content["parts"][0]["populations"][0]["spread"][0] = -5.0  # type: ignore[index]


def _short(content: dict[str, object]) -> None:
    content["parts"][0]["populations"][1]["spread"].pop()  # type: ignore[index]


def _unknown(content: dict[str, object]) -> None:
    content["parts"][0]["parameters"][0] = "hip_r.pelvis.up"  # type: ignore[index]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_without_covariance, "no covariances"),
        (_short, "no covariances"),
        (lambda content: content["parts"][1]["unit"].pop(), "no covariances"),
        (lambda content: content["parts"][1]["origin"].pop(), "no covariances"),
        (_unknown, "no joint parameter"),
        (lambda content: content.update(format=9), "found format 9"),
        (lambda content: content.update(kind="other"), "holds no priors"),
        (lambda content: content.pop("people"), "people"),
    ],
)
def test_damaged_files_are_refused_in_one_line(
    priors: CohortPriors, tmp_path: Path, spoil: Callable[[dict[str, object]], None], words: str
) -> None:
    content = json.loads(priors_text(priors))
    spoil(content)
    file = tmp_path / "priors.json"
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match=words) as raised:
        read_cohort_priors(file)
    assert "\n" not in str(raised.value)
    file.write_text("no JSON")
    with pytest.raises(InputError, match="is no JSON"):
        read_cohort_priors(file)


def test_of_several_sessions_the_one_that_tells_most_counts_and_most_rules_win() -> None:
    quiet = people(9, offset, np.random.default_rng(4), scale=0.1)
    loud = [replace(p, recordings=frozenset({f"again {p.name}"})) for p in people(9, offset, np.random.default_rng(5))]
    other = replace(quiet[0], name="stranger")
    found = [Found(p, RULES) for p in (*quiet, *loud)] + [Found(other, replace(RULES, hip_centre="harrington"))]
    used, rules, told = one_each(found)
    assert rules == RULES and [line.split(":")[0] for line in told] == ["stranger"]
    assert [p.name for p in used] == [p.name for p in loud]
    np.testing.assert_array_equal(used[0].parts["legs"].right, loud[0].parts["legs"].right)
    assert used[0].recordings == {"file 0", "again P000"}
