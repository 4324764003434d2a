"""Spoilt markers move calibrated joint parameters by less than 3 mm and 2 deg under a
robust loss.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.arrays import Array
from gaitcal.io.recording import Recording
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, ParameterKind
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role
from gaitcal.synthetic.synthetic_motion import draw_marker_noise
from tests.kept import kept_person
from tests.quality.spoilt import gone, swapped, with_trial

Spoil = Callable[[Recording, np.random.Generator], Recording]
Sought = tuple[Array, tuple[str, ...]]
"""(98,) calibrated joint parameters, and the names of those fitted."""
SEED = 3
LARGEST_MM, LARGEST_DEG = 3.0, 2.0


def missing(recording: Recording, rng: np.random.Generator) -> Recording:
    """20 % of the markers missing at random in every frame."""
    markers = recording.markers.copy()
    for frame in markers:
        frame[rng.permutation(markers.shape[1])[: round(0.2 * markers.shape[1])]] = np.nan
    return replace(recording, markers=markers)


def lost(recording: Recording, _: np.random.Generator) -> Recording:
    """One marker of the moving segment lost for half the trial."""
    return gone(slice(0, len(recording.time) // 2), "R.Shank.Front")(recording)


def exchanged(other: str) -> Spoil:
    """The labels of a thigh marker and another one exchanged for a second."""

    def spoil(recording: Recording, _: np.random.Generator) -> Recording:
        start = len(recording.time) // 4
        return swapped("R.Thigh.Front", other, slice(start, start + round(recording.rate)))(
            recording
        )

    return spoil


def spikes(recording: Recording, rng: np.random.Generator) -> Recording:
    """1 % of all positions off by 100 mm in a random direction."""
    markers = recording.markers.copy()
    struck = rng.random(markers.shape[:2]) < 0.01
    direction = rng.normal(size=(int(struck.sum()), 3))
    markers[struck] += 0.1 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return replace(recording, markers=markers)


def pushed(recording: Recording, _: np.random.Generator) -> Recording:
    """One marker 80 mm higher for a second."""
    markers = recording.markers.copy()
    start, marker = len(markers) // 3, list(recording.labels).index("R.Shank.Front")
    markers[start : start + round(recording.rate), marker, 1] += 0.08
    return replace(recording, markers=markers)


SPOILS: dict[str, Spoil] = {
    "20 % missing": missing,
    "one lost for half": lost,
    "pair swapped, one segment": exchanged("R.Thigh.Rear"),
    "pair swapped, two segments": exchanged("R.Shank.Front"),
    "100 mm spikes, 1 %": spikes,
}


def fit_joint_parameters(study: Study, loss: str) -> Sought:
    settings = study.settings.model_copy(update={"robust": loss})
    done = calibrate(replace(study, settings=settings))
    return done.model.parameters.joint, done.joint.free if done.joint else ()


@pytest.fixture(scope="module")
def study(kept: Path) -> Study:
    """One isolated trial, the knee's, of a synthetic person, with marker noise of up to 3 mm."""
    person = Study.load(kept_person(kept, seed=3, perturb=True, whole=True))
    rng = np.random.default_rng(2)
    kept = tuple(t for t in person.trials if t.role is Role.STATIC or t.name == "knee_r")
    knee = replace(person, trials=kept, settings=person.settings.model_copy(update={"ip": "none"}))
    return with_trial(
        knee,
        "knee_r",
        lambda r: replace(
            r, markers=r.markers + draw_marker_noise(r.time, r.markers.shape[1], rng, 0.003)
        ),
    )


@pytest.fixture(scope="module")
def clean(study: Study) -> dict[str, Sought]:
    """What it gives unspoilt, by loss; sought once for both tests."""
    return {loss: fit_joint_parameters(study, loss) for loss in ("cauchy", "none")}


def change(study: Study, spoil: Spoil, loss: str, clean: dict[str, Sought]) -> tuple[float, float]:
    """Largest changes (mm, deg) of the fitted joint parameters of the spoilt study, by the same
    loss.
    """
    rng = np.random.default_rng(SEED)
    spoilt, free = fit_joint_parameters(
        with_trial(study, "knee_r", lambda recording: spoil(recording, rng)), loss
    )
    index = [JP_INDEX[n] for n in free]
    position = np.array([JOINT_PARAMETERS[i].kind is ParameterKind.POSITION for i in index])
    size = np.abs((spoilt - clean[loss][0])[index]) * np.where(position, 1e3, np.rad2deg(1.0))
    return float(size[position].max()), float(size[~position].max())


@pytest.mark.slow
@pytest.mark.parametrize("name", SPOILS)
def test_spoilt_markers_move_little(name: str, study: Study, clean: dict[str, Sought]) -> None:
    millimetres, degrees = change(study, SPOILS[name], "cauchy", clean)
    # a marker that is lost is no outlier: what it told is gone
    assert (
        millimetres < (4.0 if name == "one lost for half" else LARGEST_MM) and degrees < LARGEST_DEG
    )


@pytest.mark.slow
def test_least_squares_would_not_do(study: Study, clean: dict[str, Sought]) -> None:
    """Of a marker that is pushed away for a second, which no check puts back."""
    millimetres, degrees = change(study, pushed, "none", clean)
    assert millimetres >= LARGEST_MM or degrees >= LARGEST_DEG
