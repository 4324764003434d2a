"""Claims: each verdict turns when the figures behind it do."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gaitcal.published.claims import Verdict, table_claims
from gaitcal.published.inertial_recovery import InertialRecovery, SeedResult
from gaitcal.published.joint_recovery import JointRecovery

Change = Callable[[SeedResult], SeedResult]


def _joint(problem: str, change: Callable[[JointRecovery], JointRecovery]) -> Change:
    return lambda d: replace(d, joints={p: change(r) if p == problem else r for p, r in d.joints.items()})


def _errors(value: float) -> Callable[[JointRecovery], JointRecovery]:
    return lambda r: replace(r, errors=np.full(len(r.names), value))


def _inertial(change: Callable[[InertialRecovery], InertialRecovery]) -> Change:
    return lambda d: replace(d, correct=change(d.correct), random=tuple(change(r) for r in d.random))


def _random(change: Callable[[InertialRecovery], InertialRecovery]) -> Change:
    return lambda d: replace(d, random=tuple(change(r) for r in d.random))


def _verdict(words: str, clean: SeedResult, draws: list[SeedResult]) -> Verdict:
    found = [c for c in table_claims(clean, draws) if words in c.claim]
    assert len(found) == 1, words
    return found[0].verdict


def _third(force: float, torque: float, marker: float) -> Change:
    def change(d: SeedResult) -> SeedResult:
        assert d.third is not None
        return replace(d, third=replace(d.third, force=(10.0, force), torque=(5.0, torque), marker_mm=(6.0, marker)))

    return change


@pytest.mark.parametrize(
    ("words", "good", "bad"),
    [
        ("recovers markers", lambda d: d, _joint("ankle", _errors(0.011))),
        ("recovers markers", lambda d: d, _joint("full leg", lambda r: replace(r, marker_mm=0.2))),
        ("exact inertial", lambda d: d, _inertial(lambda r: replace(r, force=2e-9))),
        ("exact inertial", lambda d: d, _inertial(lambda r: replace(r, errors=replace(r.errors, inertia=1e-5)))),
        ("random seeds either", lambda d: d, _random(lambda r: replace(r, torque=2e-9))),
    ],
)
def test_noiseless(words: str, good: Change, bad: Change, clean: SeedResult, draws: list[SeedResult]) -> None:
    assert _verdict(words, good(clean), draws) is Verdict.HOLDS
    assert _verdict(words, bad(clean), draws) is Verdict.FAILS


@pytest.mark.parametrize(
    ("words", "good", "bad"),
    [
        ("few millimetres", _joint("hip", _errors(0.5)), _joint("hip", _errors(5.5))),
        ("less than a millimetre", _joint("hip", _errors(0.9)), _joint("hip", _errors(1.1))),
        ("far better than the ankle", _joint("ankle", _errors(30.0)), _joint("ankle", _errors(0.1))),
        ("at most about 7 mm", lambda d: d, _joint("knee", lambda r: replace(r, marker_mm=7.5))),
        ("worse than the isolated", _joint("full leg", _errors(9.0)), _joint("full leg", _errors(0.1))),
        (
            "cost less",
            _joint("full leg", lambda r: replace(r, cost=0.0)),
            _joint("full leg", lambda r: replace(r, cost=9.0, cost_at_truth=8.0)),
        ),
        (
            "nearly the residual",
            _inertial(lambda r: replace(r, force=17.0, torque=5.0)),
            _random(lambda r: replace(r, force=99.0)),
        ),
        (
            "much larger errors",
            _random(lambda r: replace(r, errors=replace(r.errors, inertia=1e6, centre=1e3))),
            _random(lambda r: replace(r, errors=replace(r.errors, inertia=1.0))),
        ),
        (
            "almost exactly",
            _inertial(lambda r: replace(r, total_mass=-0.006)),
            _inertial(lambda r: replace(r, total_mass=0.2)),
        ),
        ("together lower both", _third(5.0, 2.0, 6.3), _third(5.0, 2.0, 6.7)),
        ("together lower both", _third(5.0, 2.0, 6.3), _third(7.0, 2.0, 6.3)),
        ("together lower both", _third(5.0, 2.0, 6.3), _third(5.0, 3.5, 6.3)),
    ],
)
def test_noisy(words: str, good: Change, bad: Change, clean: SeedResult, draws: list[SeedResult]) -> None:
    calm = [_joint("knee", _errors(0.3))(_joint("ankle", _errors(1.0))(d)) for d in draws]
    base = [_joint("hip", _errors(0.4))(_joint("full leg", _errors(3.0))(d)) for d in calm]
    assert _verdict(words, clean, [good(d) for d in base]) is Verdict.HOLDS
    assert _verdict(words, clean, [bad(d) for d in base]) is Verdict.FAILS


def test_speed(clean: SeedResult, draws: list[SeedResult]) -> None:
    def timed(seconds: float) -> Change:
        joints = lambda d: {p: replace(r, seconds=seconds) for p, r in d.joints.items()}  # noqa: E731
        return lambda d: _inertial(lambda r: replace(r, seconds=seconds))(replace(d, joints=joints(d)))

    fast, slow = timed(0.10), timed(0.12)  # 11 s, the fastest published, are two whole orders above the first alone
    (told,) = [c for c in table_claims(slow(clean), [slow(d) for d in draws]) if "faster" in c.claim]
    assert told.ours.endswith("91.7 times faster, 1 whole orders")
    assert _verdict("faster", fast(clean), [fast(d) for d in draws]) is Verdict.HOLDS
    assert _verdict("faster", slow(clean), [slow(d) for d in draws]) is Verdict.FAILS


def test_experimental_claims_are_not_testable(clean: SeedResult, draws: list[SeedResult]) -> None:
    found = [c for c in table_claims(clean, draws) if c.verdict is Verdict.NOT_TESTABLE]
    assert len(found) == 5
    assert all("unpublished" in c.ours for c in found)
