"""The true motion told in the static trial's frames: the same body in the same place, doing the
same work.
"""

import numpy as np
import pytest

from gaitcal.dynamics.inverse_dynamics import Dynamics, compute_pelvis_residual
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES
from gaitcal.model.subject_model import MarkerPlacement, SubjectModel
from gaitcal.synthetic.subject import make_synthetic_model, make_true_gait
from gaitcal.synthetic.synthetic_motion import (
    TrueMotion,
    compute_residual_free_wrench,
    compute_synthetic_markers,
    make_standing_pose,
)
from gaitcal.synthetic.synthetic_truth import (
    ExpectedTrial,
    TruthConverter,
    compute_segment_frames,
    compute_static_frames,
)
from gaitcal.tracking.spline import build_spline_basis

SEED = 11
SPLINE = 5e-3
"""N, N·m: derivatives of the told motion are those of a quintic spline through its frames."""


def person() -> SubjectModel:
    """Whose gait `make_true_gait` simulates."""
    model = make_synthetic_model(
        np.random.default_rng(np.random.SeedSequence(SEED).spawn(2)[0]), perturb=True
    )
    np.testing.assert_array_equal(model.parameters.joint, make_true_gait(SEED)[0].joint)
    return model


pytestmark = pytest.mark.slow
Told = tuple[TruthConverter, TrueMotion, np.ndarray, ExpectedTrial]


@pytest.fixture(scope="module")
def told() -> Told:
    model, motion = person(), make_true_gait(SEED)[1]
    wrench = compute_residual_free_wrench(model.parameters, motion)
    converter = TruthConverter(model, compute_static_frames(model))
    return converter, motion, wrench, converter.convert(motion, wrench)


def test_markers_are_where_they_were(told: Told) -> None:
    converter, motion, _, result = told
    model = person()
    own, static = (
        compute_segment_frames(model.parameters, make_standing_pose(model.parameters)),
        compute_static_frames(model).frames,
    )
    m = model.markers
    there = np.array(
        [static[s].local(own[s].point(p)) for s, p in zip(m.segments, m.local, strict=True)]
    )
    placed = MarkerPlacement(
        model.markers.labels, model.markers.segments, there, model.markers.weight
    )
    before = compute_synthetic_markers(model.parameters, model.markers, motion.q)
    after = compute_synthetic_markers(converter.parameters, placed, result.q)
    np.testing.assert_allclose(after, before, atol=1e-12)
    assert np.abs(result.q - motion.q).max() > np.deg2rad(
        1.0
    )  # the angles are others, or this shows nothing


def test_the_same_work_and_nothing_left_at_the_pelvis(told: Told) -> None:
    """Power of all generalised forces is that of the true ones, whatever the coordinates; so is
    that of each joint.
    """
    _, motion, wrench, result = told
    model = person()
    q, v, a = (motion.basis.evaluate(motion.coefficients, k) for k in range(3))
    true = Dynamics(model.parameters).compute_forces(q, v, a, wrench)
    assert np.abs(compute_pelvis_residual(result.q, result.forces)).max() < SPLINE
    for joint in ("hip", "knee_angle", "ankle_angle", "subtalar", "lumbar", "arm", "elbow"):
        columns = [k for k, name in enumerate(COORDINATES) if name.startswith(joint)]
        power = (true[:, columns] * v[:, columns]).sum(axis=1)
        again = (result.forces[:, columns] * result.velocity[:, columns]).sum(axis=1)
        np.testing.assert_allclose(again, power, atol=20 * SPLINE, err_msg=joint)


def test_ankles_are_counted_from_the_static_posture() -> None:
    """Standing, the feet have the dorsiflexion of their heel and toe markers, and no inversion."""
    model = person()
    converter = TruthConverter(model, compute_static_frames(model))
    placed = compute_synthetic_markers(
        model.parameters, model.markers, make_standing_pose(model.parameters)[None]
    )[0]
    marker = dict(zip(model.markers.labels, placed, strict=True))
    still = np.tile(make_standing_pose(model.parameters), (6, 1))
    pose = converter.convert(TrueMotion(build_spline_basis(np.arange(20) / 100.0, 6), still)).q[0]
    for side in "rl":
        sole = marker[f"{side.upper()}.Toe.Tip"] - marker[f"{side.upper()}.Heel"]
        shank = compute_static_frames(model).frames[f"shank_{side}"].rotation[:, 1]
        up = np.arcsin(sole @ shank / np.linalg.norm(sole))
        assert pose[COORDINATE_INDEX[f"ankle_angle_{side}"]] == pytest.approx(up, abs=1e-9)
        assert pose[COORDINATE_INDEX[f"subtalar_angle_{side}"]] == pytest.approx(0.0, abs=1e-9)
