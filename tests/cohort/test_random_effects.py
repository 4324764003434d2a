"""Mean and spread of people: against known ones, the dense likelihood, and identities."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.cohort.learning import Axes, Evidence, Known, Structure, Whole, learn, log_density
from gaitcal.study.joint_prior import mirror, sided_directions
from tests.cohort.made_people import KNEES, Array, some_information, told

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
        parts.append(told(deviation, some_information(rng, SIZE, unseen), rng))
    alike, _ = sided_directions(KNEES)
    return Evidence(
        information=np.array([p.information for p in parts]).reshape(-1, SIZE, SIZE),
        right=np.array([p.right for p in parts]).reshape(-1, SIZE),
        design=np.repeat(alike[None], people, axis=0),
    )


def effects() -> Array:
    return np.full(sided_directions(KNEES)[0].shape[1], COMMON)


def rest() -> Array:
    alike, _ = sided_directions(KNEES)
    return np.eye(SIZE) - COMMON * alike @ alike.T


def axes() -> Axes:
    values, vectors = np.linalg.eigh(rest())
    return Axes(vectors, values, 3.0)


@pytest.mark.parametrize("structure", [axes(), Whole(rest(), 10.0)], ids=["axes", "whole"])
def test_each_step_is_likelier_and_spreads_are_the_same_on_both_sides(structure: Structure) -> None:
    found = learn(evidence(12, 0.1 * np.eye(SIZE), np.zeros(SIZE), 1), effects(), mirror(KNEES), structure)
    assert len(found.rises) > 3
    assert (np.diff(found.rises) > -EXACT).all()
    spread, reflected = found.population.spread, mirror(KNEES)
    np.testing.assert_allclose(reflected @ spread @ reflected.T, spread, atol=EXACT)
    assert np.linalg.eigvalsh(spread)[0] > 0.0


def test_of_nobody_the_default_prior_is_learnt() -> None:
    for structure in (Known(rest()), axes(), Whole(rest(), 10.0)):
        nobody = learn(evidence(0, np.eye(SIZE), np.zeros(SIZE), 1), effects(), mirror(KNEES), structure)
        mean, covariance = nobody.population.expected(sided_directions(KNEES)[0])
        np.testing.assert_allclose(mean, 0.0)
        np.testing.assert_allclose(covariance, np.eye(SIZE), atol=EXACT)


def test_many_people_tell_mean_and_spread() -> None:
    rng = np.random.default_rng(3)
    alike, _ = sided_directions(KNEES)
    mean = alike @ rng.normal(0.0, 0.7, alike.shape[1])
    traits = rng.normal(0.0, 0.3, (SIZE, 2))
    reflected = mirror(KNEES)
    spread = 0.05 * np.eye(SIZE) + traits @ traits.T
    spread = 0.5 * (spread + reflected @ spread @ reflected.T)
    found = learn(evidence(600, spread, mean, 4), effects(), reflected, Whole(rest(), 5.0)).population
    # 600 people: a variance within some 6 %, a mean within a tenth of its spread
    np.testing.assert_allclose(found.expected(alike)[0], mean, atol=0.1)
    assert np.linalg.norm(found.spread - spread) < 0.15 * np.linalg.norm(spread)


def test_the_likelihood_is_that_of_the_dense_normal_distribution() -> None:
    """With information of full rank, m = S^-1 r is normal with the covariance of people and recordings together."""
    people, alike = 5, sided_directions(KNEES)[0]
    prior, reflected = effects(), mirror(KNEES)

    def dense(made: Evidence, spread: Array) -> float:
        blocks = [np.linalg.inv(s) for s in made.information]
        m = np.concatenate([b @ r for b, r in zip(blocks, made.right, strict=True)])
        design = np.vstack(list(made.design))
        whole = design @ np.diag(prior) @ design.T
        for k, block in enumerate(blocks):
            own = slice(k * SIZE, (k + 1) * SIZE)
            whole[own, own] += spread + block
        return float(-m @ np.linalg.solve(whole, m) - np.linalg.slogdet(whole)[1])

    made = evidence(people, 0.1 * np.eye(SIZE), np.zeros(SIZE), 5)
    told = [learn(made, prior, reflected, Known(spread)).rises[0] for spread in (rest(), 0.3 * rest())]
    wanted = [dense(made, spread) for spread in (rest(), 0.3 * rest())]
    assert told[1] - told[0] == pytest.approx(wanted[1] - wanted[0], rel=1e-8)
    alone = [
        log_density(made.information[0], made.right[0], mean, spread)
        for mean, spread in ((np.zeros(SIZE), rest()), (alike @ prior, 2.0 * rest()))
    ]
    m, block = np.linalg.solve(made.information[0], made.right[0]), np.linalg.inv(made.information[0])
    for value, (mean, spread) in zip(alone, ((np.zeros(SIZE), rest()), (alike @ prior, 2.0 * rest())), strict=True):
        off, whole = m - mean, spread + block
        expected = -0.5 * (off @ np.linalg.solve(whole, off) + np.linalg.slogdet(whole)[1])
        constant = 0.5 * (m @ made.information[0] @ m + np.linalg.slogdet(block)[1])
        assert value == pytest.approx(expected + constant, rel=1e-8)


def test_what_nobody_shows_stays_as_it_was() -> None:
    rng = np.random.default_rng(8)
    vectors = np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0]
    reflected, alike = mirror(KNEES), sided_directions(KNEES)[0]
    # the same on both sides, so that the other side does not show it
    seen = (vectors[:, : SIZE // 3]) @ vectors[:, : SIZE // 3].T
    seen = 0.5 * (seen + reflected @ seen @ reflected.T)
    values, directions = np.linalg.eigh(seen)
    unseen = directions[:, values < EXACT]
    assert unseen.shape[1] > 0
    people = [told(0.1 * rng.normal(size=SIZE), 40.0 * seen, rng) for _ in range(30)]
    made = Evidence(
        information=np.array([p.information for p in people]),
        right=np.array([p.right for p in people]),
        design=np.repeat(alike[None], 30, axis=0),
    )
    mean, covariance = learn(made, effects(), reflected, Whole(rest(), 3.0)).population.expected(alike)
    np.testing.assert_allclose(unseen.T @ mean, 0.0, atol=SINGULAR)
    np.testing.assert_allclose(unseen.T @ covariance @ unseen, np.eye(unseen.shape[1]), atol=SINGULAR)


def test_the_order_of_people_makes_no_difference() -> None:
    made = evidence(10, 0.1 * np.eye(SIZE), np.zeros(SIZE), 9)
    one, other = (learn(e, effects(), mirror(KNEES), axes()).population for e in (made, made.of(np.arange(10)[::-1])))
    np.testing.assert_allclose(one.spread, other.spread, atol=EXACT)
    np.testing.assert_allclose(one.effects, other.effects, atol=EXACT)


def test_people_seen_in_a_mirror_teach_the_same() -> None:
    made, reflected = evidence(10, 0.1 * np.eye(SIZE), np.zeros(SIZE), 10), mirror(KNEES)
    turned = Evidence(
        information=reflected @ made.information @ reflected.T, right=made.right @ reflected.T, design=made.design
    )
    one, other = (learn(e, effects(), reflected, axes()).population for e in (made, turned))
    np.testing.assert_allclose(one.spread, other.spread, atol=EXACT)
    np.testing.assert_allclose(one.effects, other.effects, atol=EXACT)
