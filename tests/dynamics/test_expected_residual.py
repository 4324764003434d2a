"""The limit of the pelvis residual: exceeded as seldom as it says, and wider for what is known to be in it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from gaitcal.arrays import Array
from gaitcal.dynamics import expected_residual as module
from gaitcal.dynamics.axis_errors import TorqueErrors
from gaitcal.dynamics.expected_residual import BASELINE, PELVIS, TAU, ExpectedResidual, expected_residual
from gaitcal.model.linkage import COORDINATES
from gaitcal.session.result import LoadedTrial, TrialResult
from tests.fake_result import fake_calibration

WEIGHT = 70.0 * 9.81


@lru_cache(maxsize=1)
def walk() -> TrialResult:
    """Standing on both feet: forces that do not change, so that nothing is faster than the motion."""
    trial = fake_calibration().trial("walk")
    assert trial.loads is not None
    wrench = np.zeros_like(trial.loads.reactions.wrench)
    wrench[:, :, 1] = 350.0
    return replace(trial, loads=replace(trial.loads, reactions=replace(trial.loads.reactions, wrench=wrench)))


def loads() -> LoadedTrial:
    found = walk().loads
    assert found is not None
    return found


def held(residual: Array, bar: Array, wrench: Array | None = None) -> ExpectedResidual:
    """Of residuals (nf, 6), with standard errors (6,)."""
    known = loads()
    tau = np.zeros((len(residual), 27))
    tau[:, PELVIS] = bar
    moments = replace(known.final, residual_force=residual[:, :3], residual_moment=residual[:, 3:])
    reactions = known.reactions if wrench is None else replace(known.reactions, wrench=wrench)
    found = expected_residual(moments, TorqueErrors(tau, np.zeros((len(tau), 2))), reactions, walk().body, WEIGHT)
    assert found is not None
    return found


def usual() -> Array:
    return np.asarray(BASELINE * np.repeat([WEIGHT, loads().final.bwh], 3))


def test_without_errors_a_walk_is_expected_to_leave_what_walks_leave() -> None:
    frames = len(walk().body.time)
    found = held(np.zeros((frames, 6)), np.zeros(6))
    assert found.force.expected == pytest.approx(np.sqrt((usual()[:3] ** 2).mean()))
    assert found.moment.expected == pytest.approx(np.sqrt((usual()[3:] ** 2).mean()))
    found = held(np.ones((frames, 6)), np.full(6, 20.0))
    assert found.force.rms == pytest.approx(1.0)
    assert found.force.expected == pytest.approx(np.sqrt((usual()[:3] ** 2).mean() + 400.0))
    assert found.within and found.share < 0.1


def test_errors_of_translations_are_those_of_the_force_and_errors_of_turns_those_of_the_moment() -> None:
    assert [COORDINATES[k] for k in PELVIS[:3]] == ["pelvis_tx", "pelvis_ty", "pelvis_tz"]
    # the lateral axis of tilt comes last, as U has it forward, up and to the right
    assert [COORDINATES[k] for k in PELVIS[3:]] == ["pelvis_list", "pelvis_rotation", "pelvis_tilt"]


@pytest.mark.parametrize("bar", [0.0, 1.0, 4.0])
def test_the_limit_is_exceeded_as_seldom_as_it_says(bar: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors that last through a trial and others that forget themselves, mixed in any share."""
    monkeypatch.setattr(module, "RARE", share := 0.05)
    rng, time = np.random.default_rng(2), walk().body.time
    rho = np.exp(-np.median(np.diff(time)) / TAU)
    drawn, trials = 0, 300
    for _ in range(trials):
        noise = rng.normal(size=(len(time), 6))
        for k in range(1, len(time)):
            noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
        drawn += not held(usual() * (noise + bar * rng.normal(size=6)), bar * usual()).force.within
    assert drawn / trials == pytest.approx(share, abs=0.04)


def test_what_plates_hold_above_the_motions_bandwidth_is_expected() -> None:
    frames, quiet = len(walk().body.time), np.zeros(6)
    still = held(np.zeros((frames, 6)), quiet)
    impact, push = (np.array(loads().reactions.wrench) for _ in range(2))
    impact[50:52, 0, 1] += 600.0
    push[:, 0, 1] += 200.0 * np.sin(2 * np.pi * 0.5 * walk().body.time)
    assert held(np.zeros((frames, 6)), quiet, impact).force.expected > 1.2 * still.force.expected
    assert held(np.zeros((frames, 6)), quiet, push).force.expected < 1.05 * still.force.expected


def test_nothing_is_held_without_errors_or_valid_frames() -> None:
    known = loads()
    assert known.errors is not None
    nothing = replace(known.reactions, valid=np.zeros_like(known.reactions.valid))
    assert expected_residual(known.final, known.errors, nothing, walk().body, WEIGHT) is None
    unknown = known.errors.only(np.zeros(27, dtype=bool))
    assert expected_residual(known.final, unknown, known.reactions, walk().body, WEIGHT) is None
