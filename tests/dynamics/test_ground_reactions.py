"""From force plates to torques in scripts: the same as in a calibration, and clear words for what cannot be."""

from dataclasses import replace

import numpy as np
import pytest

import gaitcal as gc
from gaitcal.dynamics.foot_contact import RESTING
from gaitcal.dynamics.ground_reactions import foot_points, unseen_frames
from gaitcal.io.recording import Recording
from gaitcal.synthetic.motion import gait_motion
from tests.synthetic_studies import made_plates, made_recording

UNEXPLAINED_N = 5.0
"""RMS of the pelvis residual that filter and splines leave of data without noise; 2.4 N in a calibration."""


@pytest.fixture(scope="module")
def walk() -> Recording:
    motion = gait_motion()
    return replace(made_recording(motion), plates=made_plates(motion))


@pytest.fixture(scope="module")
def tracked(walk: Recording) -> gc.Motion:
    return gc.track(gc.published_model(), walk)


def test_plates_of_a_recording_give_torques(walk: Recording, tracked: gc.Motion) -> None:
    model = gc.published_model()
    ground = gc.ground_reactions(model, tracked, walk)
    assert ground.wrench.shape == (len(walk.time), 2, 6)
    assert ground.valid.mean() > 0.5
    moments = gc.inverse_dynamics(model, tracked, ground.wrench)
    assert np.sqrt(np.mean(moments.residual_force[ground.valid] ** 2)) < UNEXPLAINED_N
    unfiltered = gc.ground_reactions(model, tracked, walk, cutoff_hz=None)
    assert any("not filtered" in note for note in unfiltered.notes)
    left = gc.ground_reactions(model, tracked, walk, plates={"1": "l", "2": "none"})
    assert not left.loaded[:, 0].any() and left.loaded[:, 1].any()


@pytest.mark.parametrize(("share", "told"), [(0.22, False), (0.28, True)])
def test_forces_that_the_motion_contradicts_are_told(
    walk: Recording, tracked: gc.Motion, share: float, told: bool
) -> None:
    """A share of body weight too much on the first plate; a quarter is the limit. The frames stay valid."""
    model = gc.published_model()
    more = share * model.subject.weight * np.array([0.0, 1.0, 0.0])
    first = walk.plates[0]
    pressed = first.force[:, 1:2] > 100.0
    spoilt = replace(first, force=first.force + pressed * more)
    found = gc.ground_reactions(model, tracked, replace(walk, plates=(spoilt, walk.plates[1])), cutoff_hz=None)
    assert any("it differs by up to" in warning for warning in found.warnings) == told
    assert found.valid.any()


def test_what_cannot_be_is_one_clear_line(walk: Recording, tracked: gc.Motion) -> None:
    model = gc.published_model()
    with pytest.raises(gc.InputError, match=r"forces: found tuple; allowed: an array .* gaitcal.ground_reactions"):
        gc.inverse_dynamics(model, tracked, walk.plates)  # type: ignore[arg-type]
    with pytest.raises(gc.InputError, match="found no force plates"):
        gc.ground_reactions(model, tracked, replace(walk, plates=()))
    with pytest.raises(gc.InputError, match="found '3'; allowed: 1, 2"):
        gc.ground_reactions(model, tracked, walk, plates={"3": "r"})
    with pytest.raises(gc.InputError, match=f"all {len(gc.COORDINATES)} coordinates"):
        gc.ground_reactions(model, replace(tracked, coordinates=tracked.coordinates[:6]), walk)


def test_forces_that_the_motion_contradicts_are_told_where_they_count(walk: Recording, tracked: gc.Motion) -> None:
    """Plates that read half as much again; with one plate alone no frame of the other foot's step counts."""
    model = gc.published_model()
    heavy = replace(walk, plates=tuple(replace(p, force=1.5 * p.force, moment=1.5 * p.moment) for p in walk.plates))
    contradiction = "vertical force is not what the motion asks for"
    assert any(contradiction in warning for warning in gc.ground_reactions(model, tracked, heavy).warnings)
    for plates in ({}, {"2": "none"}):
        reactions = gc.ground_reactions(model, tracked, walk, plates=plates)
        assert reactions.valid.any()
        assert not any(contradiction in warning for warning in reactions.warnings)


def test_a_belt_under_the_feet_changes_no_speed(tracked: gc.Motion) -> None:
    model, belt = gc.published_model(), 1.3
    drift = np.zeros_like(tracked.q)
    drift[:, 0] = -belt * tracked.time
    carried = replace(tracked, nodes=tracked.nodes + tracked.basis.fit(drift))
    still, moving = (foot_points(model, m, model.parameters) for m in (tracked, carried))
    for name in ("heel", "toe"):
        path, speed = getattr(still, name), getattr(still, f"{name}_speed")
        np.testing.assert_allclose(speed, np.linalg.norm(np.gradient(path, tracked.time, axis=0), axis=2), rtol=1e-9)
        np.testing.assert_allclose(getattr(moving, f"{name}_speed"), speed, atol=0.5 * RESTING)


def test_a_leg_that_no_weighted_marker_shows_is_not_valid(walk: Recording, tracked: gc.Motion) -> None:
    """Nor does a marker without weight show it."""
    model, errors, hidden = gc.published_model(), tracked.errors, slice(60, 70)
    shank = np.array([s == "shank_r" for s in errors.segments])
    lightest = np.flatnonzero(shank)[0]
    distance, weight = errors.distance.copy(), errors.weight.copy()
    distance[hidden, shank & (np.arange(len(shank)) != lightest)] = np.nan
    weight[lightest] = 0.0
    motion = replace(tracked, errors=replace(errors, distance=distance, weight=weight))
    (name, lost), *others = unseen_frames(motion).items()
    assert name == "shank_r" and others == []
    np.testing.assert_array_equal(np.flatnonzero(lost), np.arange(60, 70))
    before, after = (gc.ground_reactions(model, m, walk) for m in (tracked, motion))
    assert before.valid[hidden].all(), "valid while the shank is seen"
    np.testing.assert_array_equal(after.valid, before.valid & ~lost)
