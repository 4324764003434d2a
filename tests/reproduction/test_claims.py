"""Claims of the paper: each verdict turns when the figures behind it do."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gaitcal.reproduction.claims import ClaimOutcome, check_claims
from gaitcal.reproduction.recovery import InertialRecovery, JointRecovery, SeedResult

Change = Callable[[SeedResult], SeedResult]


def _joint(problem: str, errors: float | None = None, **figures: float) -> Change:
    """The recovery of one problem with all errors so large, or other figures."""

    def change(r: JointRecovery) -> JointRecovery:
        changes = figures if errors is None else figures | {"errors": np.full(len(r.names), errors)}
        return replace(r, **changes)  # type: ignore[arg-type]

    return lambda d: replace(d, joints=d.joints | {problem: change(d.joints[problem])})


def _random(errors: dict[str, float] | None = None, **figures: float) -> Change:
    """Recoveries from random seeds with other figures, and other errors of inertia, mass
    or centre.
    """

    def change(r: InertialRecovery) -> InertialRecovery:
        return replace(r, errors=replace(r.errors, **errors or {}), **figures)

    return lambda d: replace(d, random=tuple(change(r) for r in d.random))


def _inertial(errors: dict[str, float] | None = None, **figures: float) -> Change:
    """The same of those from the correct seed, too."""

    def change(d: SeedResult) -> SeedResult:
        correct = replace(d.correct, errors=replace(d.correct.errors, **errors or {}), **figures)
        return replace(_random(errors, **figures)(d), correct=correct)

    return change


def _same(d: SeedResult) -> SeedResult:
    return d


def _verdict(words: str, clean: SeedResult, draws: list[SeedResult]) -> ClaimOutcome:
    (found,) = [c for c in check_claims(clean, draws) if words in c.claim]
    return found.verdict


def _third(force: float, torque: float, marker: float) -> Change:
    def change(d: SeedResult) -> SeedResult:
        assert d.third is not None
        return replace(
            d,
            third=replace(
                d.third, force=(10.0, force), torque=(5.0, torque), marker_mm=(6.0, marker)
            ),
        )

    return change


@pytest.mark.parametrize(
    ("words", "bad"),
    [
        ("recovers markers", _joint("ankle", 0.011)),
        ("recovers markers", _joint("full leg", marker_mm=0.2)),
        ("exact inertial", _inertial(force=2e-9)),
        ("exact inertial", _inertial({"inertia": 1e-5})),
        ("random seeds either", _random(torque=2e-9)),
    ],
)
def test_noiseless(words: str, bad: Change, clean: SeedResult, draws: list[SeedResult]) -> None:
    assert _verdict(words, clean, draws) is ClaimOutcome.HOLDS
    assert _verdict(words, bad(clean), draws) is ClaimOutcome.FAILS


@pytest.mark.parametrize(
    ("words", "good", "bad"),
    [
        ("few millimetres", _joint("hip", 0.5), _joint("hip", 5.5)),
        ("less than a millimetre", _joint("hip", 0.9), _joint("hip", 1.1)),
        ("far better than the ankle", _joint("ankle", 30.0), _joint("ankle", 0.1)),
        ("at most about 7 mm", _same, _joint("knee", marker_mm=7.5)),
        ("worse than the isolated", _joint("full leg", 9.0), _joint("full leg", 0.1)),
        (
            "cost less",
            _joint("full leg", cost=0.0),
            _joint("full leg", cost=9.0, cost_at_truth=8.0),
        ),
        ("nearly the residual", _inertial(force=17.0, torque=5.0), _random(force=99.0)),
        ("much larger errors", _random({"inertia": 1e6, "centre": 1e3}), _random({"inertia": 1.0})),
        ("almost exactly", _inertial(total_mass=-0.006), _inertial(total_mass=0.2)),
        ("together lower both", _third(5.0, 2.0, 6.3), _third(5.0, 2.0, 6.7)),
        ("together lower both", _third(5.0, 2.0, 6.3), _third(7.0, 2.0, 6.3)),
        ("together lower both", _third(5.0, 2.0, 6.3), _third(5.0, 3.5, 6.3)),
    ],
)
def test_noisy(
    words: str, good: Change, bad: Change, clean: SeedResult, draws: list[SeedResult]
) -> None:
    for calm in (
        _joint("knee", 0.3),
        _joint("ankle", 1.0),
        _joint("hip", 0.4),
        _joint("full leg", 3.0),
    ):
        draws = [calm(d) for d in draws]
    assert _verdict(words, clean, [good(d) for d in draws]) is ClaimOutcome.HOLDS
    assert _verdict(words, clean, [bad(d) for d in draws]) is ClaimOutcome.FAILS


def test_speed(clean: SeedResult, draws: list[SeedResult]) -> None:
    def timed(seconds: float) -> Change:
        def change(d: SeedResult) -> SeedResult:
            joints = {p: replace(r, seconds=seconds) for p, r in d.joints.items()}
            return _inertial(seconds=seconds)(replace(d, joints=joints))

        return change

    fast, slow = (
        timed(0.10),
        timed(0.12),
    )  # 11 s, the fastest published, are two whole orders above the first alone
    (slow_claim,) = [
        c for c in check_claims(slow(clean), [slow(d) for d in draws]) if "faster" in c.claim
    ]
    assert slow_claim.ours.endswith("91.7 times faster, 1 whole orders")
    assert _verdict("faster", fast(clean), [fast(d) for d in draws]) is ClaimOutcome.HOLDS
    assert _verdict("faster", slow(clean), [slow(d) for d in draws]) is ClaimOutcome.FAILS
