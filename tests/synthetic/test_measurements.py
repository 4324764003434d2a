"""Synthetic measurements: markers where they belong, noise as published."""

from __future__ import annotations

import json

import numpy as np

from gaitcal.io.toml import models_path
from gaitcal.model.nominal import published_model
from gaitcal.synthetic.motion import NOISE_AMPLITUDE, NOISE_OMEGA, marker_noise, standing_pose, synthetic_markers
from gaitcal.synthetic.truth import segment_frames
from gaitcal.synthetic.walk import GAIT_CYCLE


def test_markers_are_points_of_their_segments_in_the_order_of_the_labels() -> None:
    model, pose = published_model(static_only=True), standing_pose()
    frames = segment_frames(model.parameters, pose)
    expected = [frames[s].point(local) for s, local in zip(model.markers.segments, model.markers.local, strict=True)]
    markers = synthetic_markers(model.parameters, model.markers, pose[None])
    np.testing.assert_allclose(markers[0], expected, atol=1e-14)


def test_the_cycle_is_that_of_the_nominal_gait() -> None:
    told = json.loads((models_path() / "nominal_subject.json").read_text(encoding="utf-8"))["nominal_gait"]
    assert told["cycle_s"] == GAIT_CYCLE


def test_noise_is_one_sinusoid_for_each_coordinate() -> None:
    """A sin(omega t + phi): second differences are the values times 2 (cos(omega dt) - 1), the same in every frame."""
    step = 0.005
    noise = marker_noise(step * np.arange(400), 200, np.random.default_rng(0)).reshape(400, -1)
    assert 0.99 * NOISE_AMPLITUDE < np.abs(noise).max() <= NOISE_AMPLITUDE
    curvature = (noise[:-2] - 2 * noise[1:-1] + noise[2:]) / step**2
    squared = -(curvature * noise[1:-1]).sum(axis=0) / (noise[1:-1] ** 2).sum(axis=0)
    np.testing.assert_allclose(curvature, -squared * noise[1:-1], atol=1e-6)
    omega = np.arccos(1 - squared * step**2 / 2) / step
    assert omega.max() <= NOISE_OMEGA < 1.01 * omega.max()
    start = noise[0] / np.abs(noise).max(axis=0)  # any phase: as many begin above as below zero, few at it
    assert abs(np.mean(start > 0) - 0.5) < 0.1
    assert np.mean(np.abs(start) > 0.5) > 0.5
