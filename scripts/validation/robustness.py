"""How far calibrated joint parameters move when the markers are spoilt, with and without a robust loss.

    python -m scripts.validation robustness [--seed N] [--subjects N] [--noise MM] [--losses none,huber,cauchy]

Synthetic subjects with perturbed joints (six isolated trials and gait) are calibrated from clean and from spoilt
markers; the largest change of any fitted position (mm) and orientation (deg) is printed, median and largest over the
subjects: against the clean markers with the same loss, and against them with least squares, which also counts what the
loss alone changes. Limits: 3 mm and 2 deg. Exit code 1 where a loss that lets outliers go ('cauchy') goes past them
against its own clean fit. Labels that changed places are put back by `calibrate` itself under a robust
loss, before the fit.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, Kind
from gaitcal.person.calibrate import calibrate
from gaitcal.recording.recording import Recording
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role, StudyTrial
from gaitcal.synthetic.measurements import marker_noise
from gaitcal.synthetic.subject import synthesize

Array = NDArray[np.float64]
Spoil = Callable[[StudyTrial, np.random.Generator], Recording]

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

    spoil: str
    loss: str
    against: str
    """Loss of the clean fit that it is compared with."""
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


def changes(study: Study, seed: int, losses: tuple[str, ...], spoils: dict[str, Spoil]) -> Iterator[Change]:
    """Every way of spoiling with every loss."""
    clean = {loss: joint_parameters(study, loss) for loss in dict.fromkeys((*losses, "none"))}
    for name, spoil in spoils.items():
        rng = np.random.default_rng(seed + 1)
        trials = tuple(replace(t, recording=spoil(t, rng)) if t.role is not Role.STATIC else t for t in study.trials)
        for loss in losses:
            spoilt, free = joint_parameters(replace(study, trials=trials), loss)
            for against in dict.fromkeys((loss, "none")):
                yield _change(name, loss, against, spoilt - clean[against][0], free)


def _change(spoil: str, loss: str, against: str, moved: Array, free: tuple[str, ...]) -> Change:
    index = [JP_INDEX[n] for n in free]
    position = np.array([JOINT_PARAMETERS[i].kind is Kind.POSITION for i in index])
    size = np.abs(moved[index]) * np.where(position, 1e3, np.rad2deg(1.0))
    worst = free[int(np.argmax(size / np.where(position, LARGEST_MM, LARGEST_DEG)))]
    return Change(spoil, loss, against, float(size[position].max()), float(size[~position].max()), worst)


def _line(group: list[Change]) -> str:
    one = group[0]
    mm, deg = np.array([[c.position_mm, c.orientation_deg] for c in group]).T
    kind = "its own clean fit" if one.against == one.loss else "clean least squares"
    over = sum(not c.small for c in group)
    mark = f"  over the limit in {over} of {len(group)}" if over else ""
    return (
        f"{one.spoil:28} {one.loss:8} {kind:20} {np.median(mm):7.2f} {mm.max():7.2f} {np.median(deg):7.2f} "
        f"{deg.max():7.2f}{mark}"
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the first subject")
    parser.add_argument("--subjects", type=int, default=1)
    parser.add_argument("--noise", type=float, default=3.0, help="largest amplitude of marker noise, mm")
    parser.add_argument("--losses", default="none,huber,cauchy")
    chosen = parser.parse_args(arguments)
    groups: dict[tuple[str, str, str], list[Change]] = {}
    for seed in range(chosen.seed, chosen.seed + chosen.subjects):
        with tempfile.TemporaryDirectory() as folder:
            study = made_study(Path(folder) / "study", seed, 1e-3 * chosen.noise)
            for change in changes(study, seed, tuple(chosen.losses.split(",")), SPOILS):
                groups.setdefault((change.spoil, change.loss, change.against), []).append(change)
                print(f"subject {seed}: {change}", file=sys.stderr, flush=True)
    print(f"{chosen.subjects} subjects, marker noise up to {chosen.noise:g} mm")
    print(f"{'spoilt by':28} {'loss':8} {'against':20} {'mm':>7} {'worst':>7} {'deg':>7} {'worst':>7}")
    for group in groups.values():
        print(_line(group))
    against_itself = [c for group in groups.values() for c in group if c.loss == c.against == "cauchy"]
    return 0 if all(c.small for c in against_itself) else 1


if __name__ == "__main__":
    sys.exit(main())
