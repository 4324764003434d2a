"""Skin that moves with joints: found where it is, not found where it is not, and its prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.calibration.joint_estimate import skin_prior
from gaitcal.calibration.skin_evidence import skin_in_words, skin_sizes
from gaitcal.calibration.skin_movement import LARGEST, beside, only, shifts_and_turns, skin_columns, unit_covariance
from gaitcal.motion.soft_tissue import SegmentTissue, SoftTissue
from gaitcal.motion.trial_problem import TrialProblem
from tests.derivatives import perturbed_parameters, random_trial

FRAMES = 400


def hip_trial(seed: int) -> TrialProblem:
    """Pelvis and thigh, with every column that their skin may have."""
    rng = np.random.default_rng(seed)
    problem, nodes = random_trial(
        rng, perturbed_parameters(rng), segments=("pelvis", "thigh_r"), frames=FRAMES, nodes=12, per_segment=4
    )
    q = problem.basis.evaluate(nodes)
    angles = dict(zip(problem.chain.coordinates, q.T, strict=True))
    tissue = skin_columns(problem, angles)
    return replace(problem, tissue=tissue)


def moved(problem: TrialProblem, name: str, size: float, seed: int, noise: float) -> TrialProblem:
    """Markers of the thigh moved with one angle, `size` of the spread that skin has, and white noise (m)."""
    rng = np.random.default_rng(seed)
    tissue = problem.tissue
    assert tissue is not None
    group = next(g for g in tissue.groups if problem.chain.segments[g.segment] == "thigh_r")
    covariance = unit_covariance("thigh_r", problem.data.local[group.markers])
    z = size * rng.multivariate_normal(np.zeros(len(covariance)), covariance).reshape(-1, 3)
    one = SegmentTissue(group.segment, group.markers, (name,), group.regressors[[group.names.index(name)]])
    constants = problem.constants(perturbed_parameters(np.random.default_rng(seed)))
    nodes = problem.basis.fit(rng.normal(0, 0.2, (FRAMES, len(problem.chain.coordinates))))
    displaced = replace(problem, tissue=SoftTissue((one,), tissue.labels)).displaced(z.ravel())
    measured = displaced.positions(nodes, constants) + rng.normal(0, noise, problem.data.measured.shape)
    return problem.with_measured(measured)


@pytest.mark.parametrize("seed", range(4))
def test_the_angle_that_skin_moves_with_is_found(seed: int) -> None:
    sizes = skin_sizes([moved(hip_trial(seed), "hip_flexion_r", 0.5, seed, 0.0005)]).sizes
    assert sizes["thigh_r", "hip_flexion_r"] >= 0.2
    assert all(size <= LARGEST for size in sizes.values())


def test_noise_is_seldom_taken_for_skin() -> None:
    """White noise that deforms the markers by as much: one pair of segment and angle in five at most, as 0.5 asks."""
    found, asked = 0, 0
    for seed in range(12):
        problem = hip_trial(seed)
        found += len(skin_sizes([moved(problem, "hip_flexion_r", 0.0, seed, 0.002)]).sizes)
        asked += sum(len(g.names) for g in problem.tissue.groups) if problem.tissue else 0
    assert found <= asked / 5


def test_skin_that_two_markers_cannot_show_is_assumed() -> None:
    """A third marker in another trial shows it."""
    whole = hip_trial(0)
    problem = moved(whole, "hip_flexion_r", 0.0, 0, 0.0005)
    weight = problem.data.weight.copy()
    group = next(g for g in problem.tissue.groups if problem.chain.segments[g.segment] == "thigh_r")  # type: ignore[union-attr]
    weight[group.markers.start + 2 : group.markers.stop] = 0.0
    two = replace(problem, data=replace(problem.data, weight=weight))
    few = skin_sizes([two])
    sizes = few.sizes
    assert few.hidden == {"thigh_r"} and not skin_sizes([two, problem]).hidden
    assert {name: sizes["thigh_r", name] for name in beside("thigh_r") if ("thigh_r", name) in sizes} == dict.fromkeys(
        group.names, LARGEST
    )
    assert sum(segment == "thigh_r" for segment, _ in skin_sizes([two, problem]).sizes) < len(group.names)
    shown, assumed = skin_in_words({**sizes, ("pelvis", "hip_flexion_r"): 0.2}, few.hidden)
    assert "pelvis by 20" in shown and "thigh_r" not in shown
    assert assumed.startswith("markers of thigh_r are too few to show how skin moves") and "50 %" in assumed


@pytest.mark.parametrize(("from_frame", "hidden"), [(0.2, False), (0.0, True)])
def test_a_third_marker_shows_skin_in_the_frames_in_which_it_is_seen(from_frame: float, hidden: bool) -> None:
    problem = moved(hip_trial(0), "hip_flexion_r", 0.5, 0, 0.0005)
    group = next(g for g in problem.tissue.groups if problem.chain.segments[g.segment] == "thigh_r")  # type: ignore[union-attr]
    weight = problem.data.weight.copy()
    weight[group.markers.start + 2 : group.markers.stop, int(from_frame * weight.shape[1]) :] = 0.0
    seldom = skin_sizes([replace(problem, data=replace(problem.data, weight=weight))])
    assert seldom.hidden == ({"thigh_r"} if hidden else set())
    assert seldom.sizes["thigh_r", "hip_flexion_r"] > 0.1


def test_markers_that_turn_and_shift_together_have_the_spread_of_clusters() -> None:
    local = np.random.default_rng(1).normal(0, 0.1, (5, 3))
    covariance = unit_covariance("thigh_l", local)
    together = np.concatenate([shifts_and_turns(a) for a in local - local.mean(axis=0)])
    mean = np.tile(np.eye(3), 5) / 5
    per_rad = 3.0 / np.pi
    spread = np.sqrt(np.diag(mean @ covariance @ mean.T))
    np.testing.assert_allclose(spread, 1e-3 * per_rad * np.sqrt(8.0**2 + 4.0**2 / 5), rtol=1e-12)
    x = np.array([0.02, -0.1, 0.3])
    np.testing.assert_allclose(shifts_and_turns(x)[:, 3:] @ [0.1, 0.2, 0.3], np.cross([0.1, 0.2, 0.3], x), atol=1e-15)
    assert np.linalg.matrix_rank(together) == 6


def test_skin_moves_with_the_joints_at_both_ends_of_its_segment() -> None:
    assert beside("thigh_r") == ("hip_flexion_r", "hip_adduction_r", "hip_rotation_r", "knee_angle_r")
    assert beside("shank_l") == ("knee_angle_l", "ankle_angle_l")
    assert beside("foot_r") == ("ankle_angle_r", "subtalar_angle_r")
    assert set(beside("pelvis")) == {f"hip_{m}_{s}" for m in ("flexion", "adduction", "rotation") for s in "rl"}
    assert beside("talus_r") == ()


def test_the_prior_joins_the_columns_of_a_segment_over_trials() -> None:
    first, second = hip_trial(1), hip_trial(1)
    sizes = {("thigh_r", "hip_flexion_r"): 0.4, ("pelvis", "hip_rotation_r"): 0.2}
    trials = [replace(p, tissue=only(p.tissue, p.chain.segments, sizes)) for p in (first, second)]
    prior = skin_prior(trials, sizes)
    assert len(prior.keys) == len(set(prior.keys)) == 2 * 4 * 3
    at = [k for k, key in enumerate(prior.keys) if key.startswith("hip_flexion_r/")]
    thigh = next(g for g in trials[0].tissue.groups if trials[0].chain.segments[g.segment] == "thigh_r")  # type: ignore[union-attr]
    expected = 0.4**2 * unit_covariance("thigh_r", first.data.local[thigh.markers])
    np.testing.assert_allclose(prior.covariance[np.ix_(at, at)], expected)
    other = [k for k in range(len(prior.keys)) if k not in at]
    assert not prior.covariance[np.ix_(at, other)].any()
