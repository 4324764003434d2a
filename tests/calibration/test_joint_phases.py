"""Phases one after the other: what one knows is the prior of the next, and what nobody
sees stays.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.calibration.joint_estimate import JointSearch, JointSettings
from gaitcal.calibration.joint_phases import (
    JointCalibration,
    JointProblem,
    calibrate_in_phases,
    get_parameters_for_trial,
    plan_sequential_phases,
    plan_simultaneous_phases,
)
from gaitcal.calibration.joint_prior import WEAK
from gaitcal.calibration.soft_tissue_artefact import (
    GAIT,
    SoftTissueScale,
    TaskTissue,
    compute_task_regressors,
)
from gaitcal.errors import Code
from gaitcal.model.parameters import Parameters, read_published_parameters
from gaitcal.tracking.trial_problem import MotionProblem
from tests.calibration.test_joint_search import KNEE, PART, knee_trial, values
from tests.derivatives import noisy, perturbed_parameters, random_trial, started
from tests.messages import check_finding

PUBLISHED, WEAKLY = (JointSettings(prior=p, equal_weights=True) for p in (None, WEAK))
WEAK_LEAVES = 3e-4
"""m, rad: of the weak prior against markers that err by what cameras do at least."""


def two_trials(noise: float = 1e-4) -> tuple[list[MotionProblem], Parameters]:
    """Of one knee, white noise."""
    rng = np.random.default_rng(11)
    truth, trials = perturbed_parameters(rng), []
    for name, frames in (("isolated", 60), ("walk", 50)):
        problem, _ = random_trial(
            rng, truth, frames=frames, nodes=8, root="thigh_r", segments=PART, per_segment=5
        )
        trials.append(replace(noisy(problem, rng, noise), name=name))
    return trials, truth


def taking_part(trials: list[MotionProblem]) -> list[JointProblem]:
    """The knee alone, then a walk."""
    return [JointProblem(t, t, joint) for t, joint in zip(trials, ("knee_r", None), strict=True)]


def in_sequence(
    trials: list[MotionProblem], nominal: Parameters, how: JointSettings
) -> JointCalibration:
    return calibrate_in_phases(
        plan_sequential_phases(taking_part(trials), {"r": KNEE}), nominal, how
    )


def test_what_an_earlier_phase_knows_counts_like_its_markers() -> None:
    """One trial after the other comes to the solution of both at once, and to its error bars."""
    trials, truth = two_trials()
    after = in_sequence(trials, truth, WEAKLY)
    together = calibrate_in_phases(
        plan_simultaneous_phases(taking_part(trials), {"r": KNEE}), truth, WEAKLY
    )
    alone = in_sequence(trials, truth, PUBLISHED)
    same = values(together.parameters, KNEE)
    gap, without = (np.linalg.norm(values(c.parameters, KNEE) - same) for c in (after, alone))
    assert gap < 0.05 * without
    first, both, only = (
        np.array([c.errors.standard_errors[n] for n in KNEE]) for c in (after, together, alone)
    )
    np.testing.assert_allclose(
        first, both, rtol=0.2
    )  # noises of two trials, each known to some 10 %
    assert np.median(both / only) < 0.9


def test_soft_tissue_moves_no_flat_fit_and_a_posterior_is_as_wide_as_it_makes_it() -> None:
    """An isolated trial whose markers may lie anywhere leaves the knee to the walk."""
    trials, truth = two_trials()
    rigid = plan_sequential_phases(taking_part(trials), {"r": KNEE})
    (psi,) = compute_task_regressors([{"knee_angle_r": np.random.default_rng(4).normal(size=60)}])
    soft = TaskTissue(
        kinds={"isolated": "knee_r", "walk": GAIT},
        regressors={"isolated": psi, "walk": {}},
        scales={"knee_r": SoftTissueScale(1e6)},
        secondary={},
        nominal=truth,
        table={},
        fitted=False,
    )
    phases = [phase.with_tissue(soft) for phase in rigid]
    assert phases[0].tissue.keys and not phases[1].tissue.keys
    for how in (PUBLISHED, WEAKLY):
        considered = replace(how, fits_tissue=False)
        plain, wide = (calibrate_in_phases(some[:1], truth, considered) for some in (rigid, phases))
        np.testing.assert_array_equal(plain.parameters.joint, wide.parameters.joint)
        assert all(
            wide.errors.standard_errors[n] > 1.5 * plain.errors.standard_errors[n] for n in KNEE
        )
    both, after, walk = (
        values(
            calibrate_in_phases(some, truth, replace(WEAKLY, fits_tissue=False)).parameters, KNEE
        )
        for some in (rigid, phases, rigid[1:])
    )
    assert np.linalg.norm(after - walk) < 0.05 * np.linalg.norm(both - walk)


def test_equal_weights_are_those_of_the_plain_sum_of_squares_whatever_the_noises() -> None:
    """And the errors those of trials that are not equally noisy: H^-1 (sum nu^2 S_t) H^-1."""
    trials, truth = two_trials()
    trials[0] = noisy(trials[0], np.random.default_rng(5), 0.004)
    found = calibrate_in_phases(
        plan_simultaneous_phases(taking_part(trials), {"r": KNEE}), truth, PUBLISHED
    )
    plain = JointSearch(trials, truth, KNEE, [started(t, truth)[1] for t in trials]).run()
    np.testing.assert_allclose(values(found.parameters, KNEE), plain.values, atol=1e-8)
    (phase,) = found.phases
    assert phase.noise["isolated"] > 3 * phase.noise["walk"]
    scores = sum(
        phase.noise[t.name] ** 2 * s.hessian
        for t, s in zip(trials, plain.state.trials, strict=True)
    )
    inverse = np.linalg.inv(plain.state.hessian)
    expected = np.sqrt(np.diag(inverse @ scores @ inverse))
    np.testing.assert_allclose([found.errors.standard_errors[n] for n in KNEE], expected, rtol=1e-5)


def test_phases_are_the_published_ones_and_trials_keep_what_they_were_fitted_with() -> None:
    trials, nominal = two_trials()
    done = in_sequence(trials, nominal, PUBLISHED)
    named = [(p.name, p.trials, p.parameters) for p in done.phases]
    assert named == [("joint:knee_r", ("isolated",), 9), (GAIT, ("walk",), 9)]
    assert all(p.marker_noise is None and set(p.noise) == set(p.trials) for p in done.phases)
    assert get_parameters_for_trial(done, "walk", nominal) is not nominal
    np.testing.assert_array_equal(
        get_parameters_for_trial(done, "walk", nominal).joint, done.parameters.joint
    )
    assert (
        np.abs(
            get_parameters_for_trial(done, "isolated", nominal).joint - done.parameters.joint
        ).max()
        > 1e-6
    )
    assert get_parameters_for_trial(done, "another", nominal) is nominal


@pytest.mark.parametrize("name", ["knee_r", GAIT])
def test_an_activity_is_of_its_own_kind_whatever_its_trial_is_called(name: str) -> None:
    problem, _ = knee_trial(1)
    kinds = {
        JointProblem(problem, problem, *of).kind for of in (("knee_r",), (None,), (None, name))
    }
    assert len(kinds) == 3


@pytest.mark.parametrize("how", [PUBLISHED, WEAKLY])
def test_without_noise_the_truth_is_found(how: JointSettings) -> None:
    problem, truth = knee_trial(1)
    start = truth.with_joint(KNEE, values(read_published_parameters(), KNEE))
    trial = JointProblem(problem, problem, "knee_r")
    done = calibrate_in_phases(plan_sequential_phases([trial], {"r": ()}), start, how)
    near = 1e-8 if how is PUBLISHED else WEAK_LEAVES
    np.testing.assert_allclose(values(done.parameters, KNEE), values(truth, KNEE), atol=near)


def test_a_knee_that_does_not_move_is_frozen_or_held_by_its_prior() -> None:
    problem, truth = knee_trial(1)
    still = problem.with_measured(
        np.repeat(problem.data.measured[:, :, :1], problem.data.measured.shape[2], axis=2)
    )
    trial, nominal = (
        JointProblem(still, still, "knee_r"),
        truth.with_joint(KNEE, values(truth, KNEE) + 0.003),
    )
    phases = plan_sequential_phases([trial], {"r": ()})
    frozen, held = (calibrate_in_phases(phases, nominal, how) for how in (PUBLISHED, WEAKLY))
    assert set(frozen.unidentifiable) == set(KNEE) and not frozen.free
    np.testing.assert_array_equal(values(frozen.parameters, KNEE), values(nominal, KNEE))
    check_finding(frozen.findings[-1], Code.UNDETERMINED)
    # held by a prior, two sides of a joint share what only their sum tells: sqrt(1/2) of anatomy's
    # 10 mm each
    assert held.free == KNEE and held.errors.standard_errors["knee_r.thigh.sup"] > 0.006
    assert frozen.errors.standard_errors["knee_r.thigh.sup"] == pytest.approx(0.010)
