"""Evidence of all trials: whose every error is, what each phase was fitted to, and what is said of skin."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gaitcal.calibration.evidence_part import EvidenceTrial
from gaitcal.calibration.identifiability import beyond_bounds
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_evidence import calibrate_by_evidence
from gaitcal.calibration.joint_phases import JointCalibration
from gaitcal.calibration.marker_moves import source_of
from gaitcal.calibration.skin_evidence import skin_in_words
from gaitcal.calibration.skin_movement import SIZES, only, skin_columns
from gaitcal.dynamics.torque_sources import Source
from gaitcal.findings import Severity
from gaitcal.model.joint_parameters import JP_NAMES
from gaitcal.motion.trial_problem import TrialProblem
from tests.derivatives import perturbed_parameters, random_trial

MOVING = ("thigh_r", "hip_flexion_r")
"""The one segment whose skin moves, and with what."""
WHITE = 0.001
"""m: noise of every marker."""


def walk_with_skin() -> tuple[TrialProblem, TrialProblem]:
    """A whole body that moves at random, and its first posture held: markers of the thigh drift with the hip."""
    rng = np.random.default_rng(11)
    body, nodes = random_trial(rng, perturbed_parameters(rng, 0.0, 0.0), frames=120, nodes=10)
    q = body.basis.evaluate(nodes)
    angles = {MOVING[1]: q[:, body.chain.coordinates.index(MOVING[1])] - q[0, body.chain.coordinates.index(MOVING[1])]}
    sliding = only(skin_columns(body, angles), body.chain.segments, {MOVING: 1.0})
    assert sliding is not None
    drifting = replace(body, tissue=sliding).displaced(rng.normal(0, 2.0 * SIZES["thigh"].own, 12))
    parameters = perturbed_parameters(rng, 0.0, 0.0)
    seen = drifting.positions(nodes, drifting.constants(parameters))
    still = body.with_measured(np.repeat(body.data.measured[:, :, :1], 120, axis=2))
    walk = body.with_measured(seen + rng.normal(0, WHITE, seen.shape))
    return replace(walk, name="nominal"), replace(still, name="static")


@cache
def calibrated() -> JointCalibration:
    """A walk whose name is a word of our own, from nominal joints that are a little wrong."""
    walk, still = walk_with_skin()
    nominal = perturbed_parameters(np.random.default_rng(12), 0.005, 0.03)
    return calibrate_by_evidence([EvidenceTrial(walk, walk, None)], nominal, still, JointSettings(), ("r", "l"))


def test_every_column_of_influence_is_of_the_source_that_made_it() -> None:
    found = calibrated()
    by_source: dict[Source, set[str]] = {}
    for name in found.influence.clusters:
        by_source.setdefault(source_of(name), set()).add(name)
    assert len(set(found.influence.clusters)) == len(found.influence.clusters)
    # every joint parameter has its prior, of legs, trunk and arms alike
    assert by_source[Source.JOINT_NOMINAL] == {f"nominal/{name}" for name in JP_NAMES}
    assert {name.split("/")[0] for name in by_source[Source.SKIN]} == {"skin"}
    markers = {"/".join(name.split("/")[:2]) for name in by_source[Source.JOINT_MARKERS]}
    assert {"markers/nominal", "markers/nominal, trunk and arms"} <= markers
    assert all(name.startswith("markers/") for name in by_source[Source.JOINT_MARKERS])
    assert set(by_source) == {Source.JOINT_NOMINAL, Source.SKIN, Source.JOINT_MARKERS}


def test_phases_name_the_recordings_and_tell_their_noise() -> None:
    legs, upper = calibrated().phases
    assert legs.trials == upper.trials == ("nominal",)
    assert set(upper.noise) == {"nominal"}
    assert "nominal" in legs.noise and all(name.split(", ")[0] == "nominal" for name in legs.noise)
    # white noise, whose tail of correlation at 100 Hz is floored at 0.25 s of the cameras' own
    assert upper.noise["nominal"] == pytest.approx(WHITE, rel=0.5)


def test_skin_that_was_found_is_said_and_none_is_not() -> None:
    found = calibrated()
    assert {segment for segment, _ in found.skin} == {MOVING[0]}
    (said,) = found.notes
    assert "thigh_r" in said and "%" in said
    assert set(found.tissue) == {"nominal"}
    assert skin_in_words({}) == ()
    (said,) = skin_in_words({("thigh_r", "a"): 0.1, ("thigh_r", "b"): 0.5, ("shank_l", "a"): 0.2})
    assert "thigh_r by 10 to 50 %, shank_l by 20 %" in said


def test_one_joint_beyond_its_bounds_is_odd_and_many_are_another_body() -> None:
    (one,) = beyond_bounds(["hip_r.thigh.sup", "hip_r.thigh.ant"])
    assert (one.severity, one.leg) == (Severity.WARNING, "r") and "hip_r lies further" in one.cause
    (arm,) = beyond_bounds(["shoulder_l.trunk.front"])
    assert arm.severity is Severity.INFO
    own = ["knee_r.thigh.ant", "knee_r.thigh.sup", "knee_r.shank.ant", "knee_r.shank.sup"]
    assert [f.severity for f in beyond_bounds(own)] == [Severity.WARNING], "four of one joint are one odd joint"
    *arms, body = beyond_bounds(["shoulder_l.trunk.front", *own[:2], "knee_l.thigh.ant", "hip_l.thigh.ant"])
    assert body.severity is Severity.ERROR and "does not show the body" in body.cause
    assert [f.severity for f in arms] == [Severity.INFO]


def walk_with_a_knee_that_rolls() -> tuple[TrialProblem, TrialProblem]:
    """What the right knee carries moves 60 mm forward for every rad that it bends; all else is as the model has it."""
    rng = np.random.default_rng(21)
    body, nodes = random_trial(rng, perturbed_parameters(rng, 0.0, 0.0), frames=120, nodes=10)
    knee = body.basis.evaluate(nodes)[:, body.chain.coordinates.index("knee_angle_r")]
    beyond = np.array([body.chain.segments[s] in ("shank_r", "talus_r", "foot_r") for s in body.data.segment])
    rolled = body.data.measured + rng.normal(0, 0.2 * WHITE, body.data.measured.shape)
    rolled[beyond, 0] += 0.06 * (knee - knee.mean())
    still = body.with_measured(np.repeat(body.data.measured[:, :, :1], 120, axis=2))
    return replace(body.with_measured(rolled), name="walk"), replace(still, name="static")


def test_joints_that_are_quiet_by_themselves_are_not_pushed_by_one_that_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    walk, still = walk_with_a_knee_that_rolls()
    truth = perturbed_parameters(np.random.default_rng(21), 0.0, 0.0)
    nominal = perturbed_parameters(np.random.default_rng(22), 0.01, 0.03)
    trials = [EvidenceTrial(walk, walk, None)]
    quiet = calibrate_by_evidence(trials, nominal, still, JointSettings(), ("r", "l"))
    monkeypatch.setattr("gaitcal.calibration.leg_evidence.QUIET", 0.0)
    pushed = calibrate_by_evidence(trials, nominal, still, JointSettings(), ("r", "l"))
    alone = {name.removeprefix("walk, ").removesuffix(" alone") for name in quiet.phases[0].noise} - {"walk"}
    assert {"hip_l", "knee_l", "ankle_l"} <= alone
    assert "knee_r" not in alone
    assert quiet.phases[0].trials == ("walk",), "a joint of a walk is not another recording"
    assert set(pushed.phases[0].noise) == {"walk"}
    left = [k for k, name in enumerate(JP_NAMES) if name.split(".")[0] in ("hip_l", "knee_l")]
    error, without = (np.abs(c.parameters.joint - truth.joint)[left].max() for c in (quiet, pushed))
    assert error < 0.7 * without
    bars, wider = ([c.influence.standard_errors[JP_NAMES[k]] for k in left] for c in (quiet, pushed))
    assert np.mean(bars) < 0.5 * np.mean(wider)
