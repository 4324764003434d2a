"""Scenes of one person joined: the trials of several runs around one body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gaitcal.page.scene import Scene, TrialScene


def with_trials(scene: Scene, further: Scene, names: Mapping[str, str] | None = None) -> Scene | None:
    """The scene with the trials of another one after its own; None where they have other segments.

    Parameters
    ----------
    names : other names for trials of `further`: old -> new.
    """
    if further.segments != scene.segments:
        return None
    told = names or {}
    trials = (
        replace(_with_markers(trial, further.labels, scene.labels), name=told.get(trial.name, trial.name))
        for trial in further.trials
    )
    return replace(scene, trials=(*scene.trials, *trials))


def after_trials(scene: Scene, earlier: Scene) -> Scene | None:
    """The scene with those trials of an earlier one before its own whose names it does not have; None as above."""
    names = {trial.name for trial in scene.trials}
    kept = tuple(trial for trial in earlier.trials if trial.name not in names)
    joined = with_trials(replace(scene, trials=()), replace(earlier, trials=kept))
    return None if joined is None else replace(joined, trials=(*joined.trials, *scene.trials))


def _with_markers(trial: TrialScene, labels: tuple[str, ...], wanted: tuple[str, ...]) -> TrialScene:
    """The trial with the measured markers in the order of another model; NaN for one that it did not have."""
    if labels == wanted:
        return trial
    measured = np.full((len(trial.time), len(wanted), 3), np.nan, dtype=np.float32)
    for k, label in enumerate(wanted):
        if label in labels:
            measured[:, k] = trial.measured[:, labels.index(label)]
    return replace(trial, measured=measured)
