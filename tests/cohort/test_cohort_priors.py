"""From recordings to evidence, from people to a file of priors, and from the file to a person."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.calibration.error_sources import ErrorSources, make_nominal_errors
from gaitcal.calibration.joint_prior import combine_joint_priors, factor_prior, select_prior
from gaitcal.cohort.learn_priors import (
    PARTS,
    Rules,
    SessionEvidence,
    compute_part_evidence,
    describe_priors,
    format_priors,
    learn_cohort,
    list_prior_rows,
    select_sessions,
)
from gaitcal.cohort.learning import Evidence, PersonEvidence, Structure, compute_log_density, learn
from gaitcal.errors import Code
from gaitcal.io.toml import get_package_version
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from gaitcal.study.cohort_prior import (
    CohortPriors,
    Person,
    build_mirror,
    build_sided_directions,
    build_symmetric,
    compute_expected_deviations,
    name_other_side,
    predict_prior,
    read_cohort_priors,
)
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.settings import ParameterPriorTable
from gaitcal.study.study import Study, add_cohort_priors, build_cohort_prior
from tests.cohort.made_people import KNEES, NAMES, Array, make_evidence, people, some_information
from tests.commands import refused
from tests.messages import check_text, refuses
from tests.synthetic_studies import write_synthetic_study

RULES = Rules(marker_set="published", hip_centre="bell", ankle_zero="markers")
SPREAD = 0.1
ROUNDED = 1e-7
"""Of a variance: what the nine digits of the file leave open."""


def offset(rng: np.random.Generator, person: Person) -> Array:
    alike, _ = build_sided_directions(NAMES)
    common = alike @ np.linspace(-0.8, 0.8, alike.shape[1])
    out: Array = common + SPREAD * rng.normal(size=len(NAMES))
    return out


def as_default(rng: np.random.Generator, person: Person) -> Array:
    return rng.normal(size=len(NAMES))


@pytest.fixture(scope="module")
def priors() -> CohortPriors:
    return learn_cohort(
        "lab", people(12, offset, np.random.default_rng(1)), RULES, ["its verdict is refused"]
    )


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return Study.load(write_synthetic_study(tmp_path_factory.mktemp("study")))


def written(priors: CohortPriors, folder: Path) -> Path:
    file = folder / "priors.json"
    file.write_text(format_priors(priors), encoding="utf-8")
    return file


def test_the_other_side_of_every_parameter_is_the_mirror_image() -> None:
    reflected = build_mirror(NAMES)
    np.testing.assert_array_equal(reflected @ reflected, np.eye(len(NAMES)))
    assert (
        name_other_side("hip_r.pelvis.ant") == "hip_l.pelvis.ant"
        and name_other_side("back.trunk.lat") == "back.trunk.lat"
    )
    place = {name: k for k, name in enumerate(NAMES)}
    assert reflected[place["hip_l.pelvis.ant"], place["hip_r.pelvis.ant"]] == 1.0
    assert reflected[place["hip_l.pelvis.lat"], place["hip_r.pelvis.lat"]] == -1.0
    alike, opposite = build_sided_directions(NAMES)
    np.testing.assert_allclose(reflected @ alike, alike)
    np.testing.assert_allclose(reflected @ opposite, -opposite)


def test_an_offset_is_learnt_and_read_back(
    priors: CohortPriors, study: Study, tmp_path: Path
) -> None:
    file = written(priors, tmp_path)
    assert read_cohort_priors(file) == priors
    leaning = add_cohort_priors(study, file)
    prior = leaning.joint_prior
    assert prior is not None and prior.people == 12 and prior.left_out == 0
    mean, covariance = select_prior(NAMES, prior)
    alike, _ = build_sided_directions(NAMES)
    common = alike @ np.linspace(-0.8, 0.8, alike.shape[1])
    origin, default = select_prior(NAMES, None)
    unit = np.linalg.inv(factor_prior(NAMES, None))
    assert np.linalg.norm(unit @ (mean - origin) - common) < 0.3 * np.linalg.norm(common)
    assert (np.diag(covariance) < np.diag(default)).all() and (
        np.diag(unit @ covariance @ unit.T) < 1.0
    ).all()
    check_text(prior.notes[0], "lab", 12)
    assert (
        leaning.inputs.keys() - study.inputs.keys() == {"priors.json"}
        and not leaning.changed_inputs()
    )
    assert prior.names == NAMES, "nobody tells of trunk and arms: what is known of them stays"
    rows = list(list_prior_rows(priors))
    assert (
        len(rows) == len(JP_NAMES)
        and rows[0]["unit"] in ("mm", "deg")
        and rows[-1]["learnt"] == "nothing"
    )
    check_text(next(describe_priors(priors)))


def test_people_like_the_default_prior_change_nothing() -> None:
    learnt = learn_cohort("lab", people(16, as_default, np.random.default_rng(2)), RULES)
    part = learnt.parts[0]
    assert part.learning == "nothing" and part.gain == [0.0, 0.0]
    np.testing.assert_array_equal(
        build_symmetric(part.populations[0].spread, len(NAMES)), np.eye(len(NAMES))
    )
    mean, covariance = compute_expected_deviations(part, 0, Person(height=1.7, sex=""), (1.5, 1.9))
    np.testing.assert_allclose(mean, select_prior(NAMES, None)[0])
    np.testing.assert_allclose(covariance, select_prior(NAMES, None)[1], rtol=ROUNDED)
    nobody = predict_prior(learnt, Person(height=1.7, sex=""), Path("priors.json"))
    assert nobody.names == () and nobody.covariance.shape == (0, 0)


def test_the_order_of_people_makes_no_difference(priors: CohortPriors) -> None:
    backwards = people(12, offset, np.random.default_rng(1))[::-1]
    assert learn_cohort("lab", backwards, RULES, ["its verdict is refused"]) == priors


@pytest.mark.slow
@pytest.mark.parametrize("by", ["recording", "name"])
def test_who_is_among_the_people_leans_on_the_others(
    priors: CohortPriors, study: Study, by: str
) -> None:
    """Person 3 as a study of the same recording, or of the same name: their fold is left out."""
    one = people(12, offset, np.random.default_rng(1))[3]
    if by == "recording":
        again = replace(study, inputs={**study.inputs, "walk.c3d": "file 3"})
    else:
        again = replace(study, subject=replace(study.subject, name=one.name))
    prior = build_cohort_prior(priors, again, Path("priors.json"))
    fold = priors.people[3].fold
    left_out = [p.fold for p in priors.people].count(fold)
    assert (prior.people, prior.left_out) == (12 - left_out, left_out)
    check_text(prior.notes[0])
    everybody = people(12, offset, np.random.default_rng(1))
    changed = [replace(p, parts=_louder(p)) if p is everybody[3] else p for p in everybody]
    other = build_cohort_prior(learn_cohort("lab", changed, RULES), again, Path("priors.json"))
    assert not np.allclose(
        build_cohort_prior(learn_cohort("lab", changed, RULES), study, Path("x")).mean,
        build_cohort_prior(priors, study, Path("x")).mean,
    )
    # whatever their own result says, as long as as much is learnt, what they lean on is the same
    np.testing.assert_allclose(other.mean, prior.mean, atol=1e-9)


def _louder(person: PersonEvidence) -> dict[str, object]:
    legs = person.parts["legs"]
    return {**person.parts, "legs": replace(legs, right=1.3 * legs.right)}


def test_too_few_people_are_refused() -> None:
    few = people(7, offset, np.random.default_rng(3))
    with refuses(Code.PRIORS, 7, 8):
        learn_cohort("lab", few, RULES)


@pytest.mark.parametrize(
    ("rule", "value"), [("marker_set", "gait2392"), ("hip_centre", "harrington")]
)
def test_other_markers_or_nominal_joints_are_refused(
    priors: CohortPriors, study: Study, rule: str, value: str
) -> None:
    with refuses(Code.PRIORS, rule, value):
        build_cohort_prior(priors.model_copy(update={rule: value}), study, Path("priors.json"))


def test_another_version_and_another_size_are_told(priors: CohortPriors, study: Study) -> None:
    tall = replace(study, subject=replace(study.subject, height=2.1))
    notes = build_cohort_prior(
        priors.model_copy(update={"gaitcal": "0.0.1"}), tall, Path("priors.json")
    ).notes
    check_text(notes[1], 2.1)
    check_text(notes[2], get_package_version("gaitcal"))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda content: content["parts"][0]["populations"][0]["spread"].__setitem__(0, -5.0),
            "no covariances",
        ),
        (lambda content: content["parts"][0]["populations"][1]["spread"].pop(), "no covariances"),
        (lambda content: content["parts"][1]["unit"].pop(), "no covariances"),
        (lambda content: content["parts"][1]["origin"].pop(), "no covariances"),
        (
            lambda content: content["parts"][0]["parameters"].__setitem__(0, "hip_r.pelvis.up"),
            "no joint parameter",
        ),
        (lambda content: content.update(format=9), "found format 9"),
        (lambda content: content.update(kind="other"), "contains no priors"),
        (lambda content: content.pop("people"), "people"),
    ],
)
def test_damaged_files_are_refused_in_one_line(
    priors: CohortPriors, tmp_path: Path, spoil: Callable[[dict[str, object]], None], words: str
) -> None:
    content = json.loads(format_priors(priors))
    spoil(content)
    file = tmp_path / "priors.json"
    file.write_text(json.dumps(content))
    with refused(words):
        read_cohort_priors(file)
    file.write_text("no JSON")
    with refused("is no JSON"):
        read_cohort_priors(file)


def test_of_several_sessions_the_one_that_tells_most_counts_and_most_rules_win() -> None:
    quiet = people(9, offset, np.random.default_rng(4), scale=0.1)
    loud = [
        replace(p, recordings=frozenset({f"again {p.name}"}))
        for p in people(9, offset, np.random.default_rng(5))
    ]
    other = replace(quiet[0], name="stranger")
    found = [SessionEvidence(p, RULES) for p in (*quiet, *loud)] + [
        SessionEvidence(other, replace(RULES, hip_centre="harrington"))
    ]
    used, rules, others = select_sessions(found)
    assert rules == RULES and [line.split(":")[0] for line in others] == ["stranger"]
    assert [p.name for p in used] == [p.name for p in loud]
    np.testing.assert_array_equal(used[0].parts["legs"].right, loud[0].parts["legs"].right)
    assert used[0].recordings == {"file 0", "again P000"}


CLOSE = 1e-6
"""Relative: of matrices of 1e-4 to 1e4 in m, rad that are inverted twice."""
LEGS = PARTS["legs"]
UNSEEN = 10
OTHER = combine_joint_priors(
    {
        "hip.pelvis.ant": ParameterPriorTable(mean=-7.0, deviation=6.0),
        "hip_l.thigh.ant": ParameterPriorTable(deviation=5.0),
        "knee.thigh.trans": ParameterPriorTable(mean=2.0),
    }
)


def fitted(
    names: tuple[str, ...], prior: JointPrior | None
) -> tuple[ErrorSources, np.ndarray, np.ndarray, np.ndarray]:
    """Errors and deviations (98,) of a fit, all other parameters nominal; and S, S m of its
    markers.
    """
    rng, (mean, covariance) = np.random.default_rng(4), select_prior(names, prior)
    half = np.linalg.inv(factor_prior(names, None)).T @ rng.normal(
        0.0, 2.0, (len(names), len(names) - UNSEEN)
    )
    information, at = half @ half.T, rng.normal(0.0, 0.01, len(names))
    precision = information + np.linalg.inv(covariance)
    found = np.linalg.solve(precision, information @ at + np.linalg.solve(covariance, mean))
    others = tuple(name for name in JP_NAMES if name not in names)
    left = make_nominal_errors(others, prior)
    errors = np.zeros((len(JP_NAMES),) * 2)
    errors[: len(names), : len(names)] = np.linalg.cholesky(np.linalg.inv(precision))
    errors[len(names) :, len(names) :] = left.effects
    influence = ErrorSources(
        (*names, *others),
        errors,
        (*(f"markers/walk/{k}" for k in range(len(names))), *left.sources),
    )
    deviation = np.zeros(len(JP_NAMES))
    deviation[[JP_INDEX[name] for name in names]] = found
    return influence, deviation, information, information @ at


@pytest.mark.parametrize("prior", [None, OTHER], ids=["anatomy", "study"])
@pytest.mark.parametrize(
    "names", [LEGS, tuple(n for n in LEGS if "_r." in n)], ids=["both legs", "one"]
)
def test_the_prior_of_the_fit_is_taken_out_and_what_no_trial_moved_tells_nothing(
    names: tuple[str, ...], prior: JointPrior | None
) -> None:
    influence, deviation, information, right = fitted(names, prior)
    parts = compute_part_evidence(influence, deviation, JP_NAMES, prior)
    unit, origin = (
        factor_prior(LEGS, None)[[LEGS.index(name) for name in names]],
        select_prior(names, None)[0],
    )
    wanted, pulled = unit.T @ information @ unit, unit.T @ (right - information @ origin)
    np.testing.assert_allclose(parts["legs"].information, wanted, atol=CLOSE * np.abs(wanted).max())
    np.testing.assert_allclose(parts["legs"].right, pulled, atol=CLOSE * np.abs(pulled).max())
    assert not parts["trunk and arms"].information.any() and not parts["trunk and arms"].right.any()


def test_exact_errors_are_no_evidence() -> None:
    influence, deviation, *_ = fitted(LEGS, None)
    exact = ErrorSources(
        influence.names,
        influence.effects * (np.arange(len(JP_NAMES)) != len(LEGS) - 1),
        influence.sources,
    )
    assert compute_part_evidence(exact, deviation, JP_NAMES, None) is None


SIZE = len(KNEES)
COMMON = 0.5
EXACT = 1e-9
SINGULAR = 1e-6
"""What rounding leaves of directions that information of less rank does not show."""


def evidence(people: int, spread: Array, mean: Array, seed: int, unseen: int = 0) -> Evidence:
    rng, root = np.random.default_rng(seed), np.linalg.cholesky(spread)
    parts = []
    for _ in range(people):
        deviation = mean + root @ rng.normal(size=SIZE)
        parts.append(make_evidence(deviation, some_information(rng, SIZE, unseen), rng))
    alike, _ = build_sided_directions(KNEES)
    return Evidence(
        information=np.array([p.information for p in parts]).reshape(-1, SIZE, SIZE),
        right=np.array([p.right for p in parts]).reshape(-1, SIZE),
        design=np.repeat(alike[None], people, axis=0),
    )


def effects() -> Array:
    return np.full(build_sided_directions(KNEES)[0].shape[1], COMMON)


def rest() -> Array:
    alike, _ = build_sided_directions(KNEES)
    return np.eye(SIZE) - COMMON * alike @ alike.T


def axes() -> Structure:
    return Structure(rest(), 3.0, np.linalg.eigh(rest())[1])


@pytest.mark.parametrize("structure", [axes(), Structure(rest(), 10.0)], ids=["axes", "whole"])
def test_each_step_is_likelier_and_spreads_are_the_same_on_both_sides(structure: Structure) -> None:
    found = learn(
        evidence(12, 0.1 * np.eye(SIZE), np.zeros(SIZE), 1),
        effects(),
        build_mirror(KNEES),
        structure,
    )
    assert len(found.likelihoods) > 3
    assert (np.diff(found.likelihoods) > -EXACT).all()
    spread, reflected = found.population.spread, build_mirror(KNEES)
    np.testing.assert_allclose(reflected @ spread @ reflected.T, spread, atol=EXACT)
    assert np.linalg.eigvalsh(spread)[0] > 0.0


def test_of_nobody_the_default_prior_is_learnt() -> None:
    for structure in (Structure(rest()), axes(), Structure(rest(), 10.0)):
        nobody = learn(
            evidence(0, np.eye(SIZE), np.zeros(SIZE), 1), effects(), build_mirror(KNEES), structure
        )
        mean, covariance = nobody.population.predict(build_sided_directions(KNEES)[0])
        np.testing.assert_allclose(mean, 0.0)
        np.testing.assert_allclose(covariance, np.eye(SIZE), atol=EXACT)


def test_many_people_tell_mean_and_spread() -> None:
    rng = np.random.default_rng(3)
    alike, _ = build_sided_directions(KNEES)
    mean = alike @ rng.normal(0.0, 0.7, alike.shape[1])
    traits = rng.normal(0.0, 0.3, (SIZE, 2))
    reflected = build_mirror(KNEES)
    spread = 0.05 * np.eye(SIZE) + traits @ traits.T
    spread = 0.5 * (spread + reflected @ spread @ reflected.T)
    found = learn(
        evidence(600, spread, mean, 4), effects(), reflected, Structure(rest(), 5.0)
    ).population
    # 600 people: a variance within some 6 %, a mean within a tenth of its spread
    np.testing.assert_allclose(found.predict(alike)[0], mean, atol=0.1)
    assert np.linalg.norm(found.spread - spread) < 0.15 * np.linalg.norm(spread)


def test_the_likelihood_is_that_of_the_dense_normal_distribution() -> None:
    """With information of full rank, m = S^-1 r is normal with the covariance of people and
    recordings together.
    """
    people, alike = 5, build_sided_directions(KNEES)[0]
    prior, reflected = effects(), build_mirror(KNEES)

    def dense(made: Evidence, spread: Array) -> float:
        blocks = [np.linalg.inv(s) for s in made.information]
        m = np.concatenate([b @ r for b, r in zip(blocks, made.right, strict=True)])
        design = np.vstack(list(made.design))
        whole = design @ np.diag(prior) @ design.T
        for k, block in enumerate(blocks):
            block_of_person = slice(k * SIZE, (k + 1) * SIZE)
            whole[block_of_person, block_of_person] += spread + block
        return float(-m @ np.linalg.solve(whole, m) - np.linalg.slogdet(whole)[1])

    made = evidence(people, 0.1 * np.eye(SIZE), np.zeros(SIZE), 5)
    likelihoods = [
        learn(made, prior, reflected, Structure(spread)).likelihoods[0]
        for spread in (rest(), 0.3 * rest())
    ]
    wanted = [dense(made, spread) for spread in (rest(), 0.3 * rest())]
    assert likelihoods[1] - likelihoods[0] == pytest.approx(wanted[1] - wanted[0], rel=1e-8)
    alone = [
        compute_log_density(made.information[0], made.right[0], mean, spread)
        for mean, spread in ((np.zeros(SIZE), rest()), (alike @ prior, 2.0 * rest()))
    ]
    m, block = (
        np.linalg.solve(made.information[0], made.right[0]),
        np.linalg.inv(made.information[0]),
    )
    for value, (mean, spread) in zip(
        alone, ((np.zeros(SIZE), rest()), (alike @ prior, 2.0 * rest())), strict=True
    ):
        off, whole = m - mean, spread + block
        expected = -0.5 * (off @ np.linalg.solve(whole, off) + np.linalg.slogdet(whole)[1])
        constant = 0.5 * (m @ made.information[0] @ m + np.linalg.slogdet(block)[1])
        assert value == pytest.approx(expected + constant, rel=1e-8)


def test_what_nobody_shows_stays_as_it_was() -> None:
    rng = np.random.default_rng(8)
    vectors = np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0]
    reflected, alike = build_mirror(KNEES), build_sided_directions(KNEES)[0]
    # the same on both sides, so that the other side does not show it
    determined = (vectors[:, : SIZE // 3]) @ vectors[:, : SIZE // 3].T
    determined = 0.5 * (determined + reflected @ determined @ reflected.T)
    values, directions = np.linalg.eigh(determined)
    unseen = directions[:, values < EXACT]
    assert unseen.shape[1] > 0
    people = [make_evidence(0.1 * rng.normal(size=SIZE), 40.0 * determined, rng) for _ in range(30)]
    made = Evidence(
        information=np.array([p.information for p in people]),
        right=np.array([p.right for p in people]),
        design=np.repeat(alike[None], 30, axis=0),
    )
    mean, covariance = learn(made, effects(), reflected, Structure(rest(), 3.0)).population.predict(
        alike
    )
    np.testing.assert_allclose(unseen.T @ mean, 0.0, atol=SINGULAR)
    np.testing.assert_allclose(
        unseen.T @ covariance @ unseen, np.eye(unseen.shape[1]), atol=SINGULAR
    )


def test_people_seen_in_a_mirror_teach_the_same() -> None:
    made, reflected = evidence(10, 0.1 * np.eye(SIZE), np.zeros(SIZE), 10), build_mirror(KNEES)
    turned = Evidence(
        information=reflected @ made.information @ reflected.T,
        right=made.right @ reflected.T,
        design=made.design,
    )
    one, other = (learn(e, effects(), reflected, axes()).population for e in (made, turned))
    np.testing.assert_allclose(one.spread, other.spread, atol=EXACT)
    np.testing.assert_allclose(one.effects, other.effects, atol=EXACT)
