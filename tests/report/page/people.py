"""Scenes to look at without solving anything: the built-in subject walking, and
variations of it.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_NAMES, ParameterKind, list_gait_parameters
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.report.page.scene import MotionScene, Scene, build_person_scene, build_trial_scene
from gaitcal.synthetic.synthetic_motion import (
    TrueMotion,
    compute_residual_free_wrench,
    compute_synthetic_markers,
    draw_marker_noise,
    simulate_gait,
)
from gaitcal.synthetic.walk import make_walking_ground
from gaitcal.tracking.motion import MarkerErrors, Motion
from gaitcal.tracking.spline import build_spline_basis

FITTED = list_gait_parameters("r") + list_gait_parameters("l")


def subject_model(name: str = "Built-in subject") -> SubjectModel:
    """The built-in subject, as if calibrated: the 34 gait parameters moved by some 8 mm and 4
    degrees.
    """
    model = published_model()
    rng = np.random.default_rng(5)
    size = {ParameterKind.POSITION: 0.008}
    scale = np.array(
        [size.get(p.kind, np.deg2rad(4.0)) if p.name in FITTED else 0.0 for p in JOINT_PARAMETERS]
    )
    fitted = replace(
        model.nominal, joint=model.nominal.joint + scale * rng.standard_normal(len(JP_NAMES))
    )
    return replace(
        model, subject=Subject(name, 69.4, 1.70, "male"), parameters=fitted, landmarks={}, notes=()
    )


def model_markers(scene: Scene, trial: MotionScene) -> Array:
    """(nf, nm, 3) m: where the fitted model has the markers, by the segments' poses of the page."""
    carrying = [scene.segments.index(s) for s in scene.marker_segments]
    placed = zip(carrying, scene.marker_places, strict=True)
    turned = [Rotation.from_quat(trial.turns[:, s]).apply(local) for s, local in placed]
    return np.stack(turned, axis=1) + trial.origins[:, carrying]


def standard_errors() -> dict[str, float]:
    kinds = {p.name: p.kind for p in JOINT_PARAMETERS}
    return {
        name: 0.004 if kinds[name] is ParameterKind.POSITION else np.deg2rad(2.0) for name in FITTED
    }


def walking_scene(
    labels: tuple[str, ...] | None = None, subject: str = "Built-in subject"
) -> Scene:
    """One gait cycle, noisy markers with a gap, two plates, forearms without markers on
    the left.
    """
    model = subject_model(subject)
    if labels is not None:
        model = replace(model, markers=replace(model.markers, labels=labels))
    true = simulate_gait()
    wrench = compute_residual_free_wrench(model.parameters, true)
    first = walking_trial(model, true, "walk", wrench)
    again = walking_trial(model, true, "no plates", None)
    return build_person_scene(model, (first, again), standard_errors())


def walking_trial(
    model: SubjectModel, true: TrueMotion, name: str, wrench: Array | None
) -> MotionScene:
    """The same as the page has it."""
    return build_trial_scene(model, name, "gait", *recorded_walk(model, true, name, wrench))


def recorded_walk(
    model: SubjectModel, true: TrueMotion, name: str, wrench: Array | None
) -> tuple[Motion, Recording, GroundReactions | None]:
    """Noisy markers with a gap; two plates and frames that do not count where there is a wrench."""
    time, placed = true.basis.time, model.markers
    seen = compute_synthetic_markers(model.parameters, placed, true.q)
    measured = seen + draw_marker_noise(time, len(placed.labels), np.random.default_rng(11))
    measured[40:80, 3] = np.nan
    plates, reactions = (), None
    if wrench is not None:
        plates = tuple(
            plate(str(k + 1), time, x, z) for k, (x, z) in enumerate([(0.2, 0.12), (0.85, -0.12)])
        )
        valid, loaded = np.arange(len(time)) < 150, wrench[:, :, 1] > 20.0
        legs = np.stack([valid] * 2, axis=1)
        reactions = GroundReactions(
            wrench=wrench, valid=valid, valid_legs=legs, loaded=loaded, resting=loaded, notes=()
        )
    recording = Recording(
        source="walk.c3d", time=time, labels=placed.labels, markers=measured, plates=plates
    )
    errors = MarkerErrors(
        placed.labels, placed.segments, placed.weight, np.linalg.norm(measured - seen, axis=2)
    )
    motion = Motion(
        name=name, coordinates=COORDINATES, basis=true.basis, coefficients=true.coefficients,
        errors=errors,
        converged=True,
    )  # fmt: skip
    return motion, recording, reactions


def long_scene(frames: int = 10_000) -> Scene:
    """One long walk, with plates under the first steps."""
    model, true = subject_model(), long_motion(frames)
    wrench = compute_residual_free_wrench(model.parameters, true)
    return build_person_scene(
        model, (walking_trial(model, true, "long", wrench),), standard_errors()
    )


def plate(name: str, time, x: float, z: float) -> ForcePlate:
    corners = np.array(
        [[x - 0.3, 0, z - 0.2], [x + 0.3, 0, z - 0.2], [x + 0.3, 0, z + 0.2], [x - 0.3, 0, z + 0.2]]
    )
    none = np.zeros((len(time), 3))
    return ForcePlate(name=name, time=time, force=none, point=none, moment=none, corners=corners)


def long_motion(frames: int) -> TrueMotion:
    """The gait cycle over and over, walking on."""
    true = simulate_gait()
    time = np.arange(frames) / 200.0
    cycle = len(true.q) - 1
    q = true.q[np.arange(frames) % cycle].copy()
    q[:, 0] += (np.arange(frames) // cycle) * (true.q[-1, 0] - true.q[0, 0])
    basis = build_spline_basis(time, max(20, frames // 20))
    phase = np.arange(frames) / cycle
    return TrueMotion(basis, basis.fit(q), phase, make_walking_ground(phase))
