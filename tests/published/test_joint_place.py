"""Whether several figures together are an ordinary draw: p is uniform where they are, and small where they are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gaitcal.published.claims import Verdict
from gaitcal.published.noise_sensitivity import Place, joint_p, joint_place, low_p, low_place, not_rejected

DRAWS, FIGURES, REPEATS = 24, 12, 6000


def test_p_of_a_further_draw_is_uniform_whatever_the_distribution() -> None:
    rng = np.random.default_rng(1)
    mixing = rng.normal(size=(FIGURES, FIGURES))
    ps = []
    for _ in range(REPEATS):
        figures = np.exp(rng.standard_t(3, size=(DRAWS + 1, FIGURES)) @ mixing)  # heavy tails, correlated
        ps.append(joint_p(figures[:-1], figures[-1]))
    counts = np.bincount(np.rint((DRAWS + 1) * np.array(ps)).astype(int), minlength=DRAWS + 2)[1:]
    expected = REPEATS / (DRAWS + 1)
    assert counts.sum() == REPEATS
    # chi^2 of 24 degrees of freedom: above 60 in 1 of 15 000 cases, were the seed another
    assert ((counts - expected) ** 2 / expected).sum() < 60.0


def test_a_figure_against_the_correlation_is_no_ordinary_draw() -> None:
    rng = np.random.default_rng(2)
    common = rng.normal(size=(100, 1))
    draws = np.exp(common + 0.1 * rng.normal(size=(100, 3)))
    assert joint_p(draws, np.exp([1.0, 1.0, 1.0])) > 0.1
    assert joint_p(draws, np.exp([1.0, 1.0, -1.0])) == pytest.approx(1 / 101)
    assert joint_p(draws, np.ones(3)) > 0.9


def test_units_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    draws, printed = rng.lognormal(size=(40, 3)), rng.lognormal(size=3)
    units = np.array([1e3, 180 / np.pi, 1e-2])
    assert joint_p(draws * units, printed * units) == joint_p(draws, printed)


def test_too_few_draws_tell_nothing() -> None:
    rng = np.random.default_rng(4)
    assert np.isnan(joint_p(rng.lognormal(size=(19, 3)), np.full(3, 1e6)))
    assert joint_p(rng.lognormal(size=(20, 3)), np.full(3, 1e6)) == pytest.approx(1 / 21)
    assert np.isnan(joint_p(rng.lognormal(size=(30, 30)), np.ones(30)))
    assert np.isnan(low_p(rng.lognormal(size=(19, 3)), np.zeros(3)))
    places = [Place(np.nan, np.nan), Place(0.03, 0.009), Place(0.03, 0.011), Place(0.07, 0.011), Place(0.07, 0.009)]
    verdicts = [not_rejected("", "", place, "").verdict for place in places]
    assert verdicts == [Verdict.NOT_RUN, Verdict.FAILS, Verdict.UNDECIDED, Verdict.UNDECIDED, Verdict.HOLDS]


def test_a_rank_sum_is_low_where_every_figure_is() -> None:
    rng = np.random.default_rng(5)
    draws = rng.lognormal(size=(200, 7))
    assert low_p(draws, np.full(7, np.exp(-1.0))) < 0.02 < joint_p(draws, np.full(7, np.exp(-1.0)))
    assert low_p(draws, np.full(7, np.exp(1.0))) > 0.98
    ps = [low_p(*np.split(rng.lognormal(size=(40, 5)), [39])) for _ in range(2000)]
    assert np.mean(np.array(ps) <= 0.1) == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize(("place", "size"), [(joint_place, 1.2), (low_place, 0.8)])
def test_the_told_error_is_that_of_other_draws(place: Callable[..., Place], size: float) -> None:
    rng = np.random.default_rng(6)
    printed = np.exp(-np.full(5, size))
    places = [place(rng.lognormal(size=(120, 5)), printed) for _ in range(25)]
    scatter = np.std([found.p for found in places])
    assert 0.5 < np.mean([found.error for found in places]) / scatter < 2.0
