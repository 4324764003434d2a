"""Spoilt markers move calibrated joint parameters by less than 3 mm and 2 deg under a robust loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.arrays import Array
from gaitcal.io.recording import Recording
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind
from gaitcal.session.calibrate import calibrate
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role, StudyTrial
from gaitcal.synthetic.motion import marker_noise
from gaitcal.synthetic.subject import synthesize

Spoil = Callable[[StudyTrial, np.random.Generator], Recording]
Sought = tuple[Array, tuple[str, ...]]
"""Joint parameters, and the names of those fitted."""
SEED = 3

LARGEST_MM, LARGEST_DEG = 3.0, 2.0
MISSING = 0.2
SPIKED = 0.01
SPIKE_M = 0.1
SWAP_S = 1.0


def missing(trial: StudyTrial, rng: np.random.Generator) -> Recording:
    """20 % of the markers missing at random in every frame."""
    markers = trial.recording.markers.copy()
    count = round(MISSING * markers.shape[1])
    for frame in markers:
        frame[rng.permutation(markers.shape[1])[:count]] = np.nan
    return replace(trial.recording, markers=markers)


def lost(trial: StudyTrial, rng: np.random.Generator) -> Recording:
    """One marker of a moving segment lost for half the trial."""
    markers = trial.recording.markers.copy()
    label = {"hip": "{}.Thigh.Front", "knee": "{}.Shank.Front", "ankle": "{}.Toe.Lat"}[
        (trial.joint or "hip_r").split("_")[0]
    ]
    at = trial.recording.labels.index(label.format((trial.joint or "hip_r")[-1].upper()))
    markers[: len(markers) // 2, at] = np.nan
    return replace(trial.recording, markers=markers)


def swap_of(within: bool) -> Spoil:
    """A pair of labels exchanged for a second (half of the gait trial, which lasts one)."""

    def spoil(trial: StudyTrial, rng: np.random.Generator) -> Recording:
        recording = trial.recording
        side = (trial.joint or "hip_r")[-1].upper()
        pair = (
            (f"{side}.Thigh.Front", f"{side}.Thigh.Rear") if within else (f"{side}.Thigh.Front", f"{side}.Shank.Front")
        )
        i, j = (recording.labels.index(label) for label in pair)
        length = min(round(SWAP_S * recording.rate), len(recording.time) // 2)
        start = len(recording.time) // 4
        frames = slice(start, start + length)
        markers = recording.markers.copy()
        markers[frames, i], markers[frames, j] = recording.markers[frames, j], recording.markers[frames, i]
        return replace(recording, markers=markers)

    return spoil


def spikes(trial: StudyTrial, rng: np.random.Generator) -> Recording:
    """1 % of all positions off by 100 mm in a random direction."""
    markers = trial.recording.markers.copy()
    struck = rng.random(markers.shape[:2]) < SPIKED
    direction = rng.normal(size=(int(struck.sum()), 3))
    markers[struck] += SPIKE_M * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return replace(trial.recording, markers=markers)


SPOILS: dict[str, Spoil] = {
    "20 % missing": missing,
    "one lost for half": lost,
    "pair swapped, one segment": swap_of(True),
    "pair swapped, two segments": swap_of(False),
    "100 mm spikes, 1 %": spikes,
}


@dataclass(frozen=True)
class Change:
    """Largest changes of the fitted joint parameters."""

    position_mm: float
    orientation_deg: float
    worst: str

    @property
    def small(self) -> bool:
        """Within the limits."""
        return self.position_mm < LARGEST_MM and self.orientation_deg < LARGEST_DEG


def made_study(folder: Path, seed: int, noise_m: float, trials: tuple[str, ...] | None = None) -> Study:
    """A synthetic subject with perturbed joints and marker noise of amplitude up to `noise_m`."""
    study = Study.load(synthesize(folder, seed=seed, perturb=True))
    rng = np.random.default_rng(seed)

    def with_noise(trial: StudyTrial) -> StudyTrial:
        if trial.role is Role.STATIC:
            return trial
        r = trial.recording
        return replace(
            trial, recording=replace(r, markers=r.markers + marker_noise(r.time, r.markers.shape[1], rng, noise_m))
        )

    kept = [t for t in study.trials if trials is None or t.role is Role.STATIC or t.name in trials]
    settings = study.settings.model_copy(update={"ip": "none"})
    return replace(study, trials=tuple(with_noise(t) for t in kept), settings=settings)


def joint_parameters(study: Study, loss: str) -> tuple[Array, tuple[str, ...]]:
    """(98,) calibrated values and the names of those fitted."""
    settings = study.settings.model_copy(update={"robust": loss})
    done = calibrate(replace(study, settings=settings))
    return done.model.parameters.joint, done.joint.free if done.joint else ()


def change(study: Study, spoil: Spoil, loss: str, clean: dict[str, Sought]) -> Change:
    """How far the joints of the spoilt study lie from those of the clean one, by the same loss."""
    rng = np.random.default_rng(SEED)
    trials = tuple(replace(t, recording=spoil(t, rng)) if t.role is not Role.STATIC else t for t in study.trials)
    spoilt, free = joint_parameters(replace(study, trials=trials), loss)
    index = [JP_INDEX[n] for n in free]
    position = np.array([JOINT_PARAMETERS[i].kind is Kind.POSITION for i in index])
    size = np.abs((spoilt - clean[loss][0])[index]) * np.where(position, 1e3, np.rad2deg(1.0))
    worst = free[int(np.argmax(size / np.where(position, LARGEST_MM, LARGEST_DEG)))]
    return Change(float(size[position].max()), float(size[~position].max()), worst)


LOST = "one lost for half"


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """One isolated trial, the knee's, of a synthetic person."""
    return made_study(tmp_path_factory.mktemp("made") / "study", 2, 0.003, ("knee_r",))


@pytest.fixture(scope="module")
def clean(study: Study) -> dict[str, Sought]:
    """What it gives unspoilt, by loss; sought once for both tests."""
    return {loss: joint_parameters(study, loss) for loss in ("cauchy", "none")}


@pytest.mark.slow
def test_spoilt_markers_move_little(study: Study, clean: dict[str, Sought]) -> None:
    moved = {name: change(study, spoil, "cauchy", clean) for name, spoil in SPOILS.items()}
    lost = moved.pop(LOST)
    assert [(name, found) for name, found in moved.items() if not found.small] == []
    assert lost.position_mm < 4.0 and lost.orientation_deg < 2.0  # no outlier: what it told is gone


@pytest.mark.slow
def test_least_squares_would_not_do(study: Study, clean: dict[str, Sought]) -> None:
    assert not change(study, SPOILS["pair swapped, one segment"], "none", clean).small
