"""The studies that faults are put into, and what is kept of each: its joint stage, done once.

A fault of the forces does not touch the joint parameters, and the motion of its trial only through the say that plates
have in the bandwidth: the motion is reused, or tracked again where that is asked for or markers were changed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from gaitcal.errors import InputError
from gaitcal.faults.force_evidence import ForceEvidence, force_evidence
from gaitcal.io.axes import turn_to_progression
from gaitcal.io.recording import Recording
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion, tracked_motion
from gaitcal.session.joint_parameters import fit_joints
from gaitcal.session.session import MovingTrial, forward_direction, measured_reactions, prepare_trial, session_of
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, nominal_of
from gaitcal.study.study_trial import Role, StudyTrial
from gaitcal.synthetic.subject import synthesize
from scripts.validation.harness import matching
from scripts.validation.recordings import CHILDREN, SIMULATED, data, study_of_person

REAL = ("subject01", "pig", *CHILDREN, "kad", "multi")
SYNTHETIC = (1, 2, 3)


@dataclass(frozen=True, kw_only=True)
class Person:
    """A study after its joint stage."""

    name: str
    model: SubjectModel
    parameters: Parameters
    settings: CalibrationSettings
    trials: tuple[StudyTrial, ...]
    """Gait trials over force plates."""
    motions: tuple[tuple[MovingTrial, Motion], ...]
    clean: tuple[ForceEvidence, ...]

    def evidence(
        self, number: int, change: Callable[[Recording], Recording], *, track: bool = False
    ) -> ForceEvidence | None:
        """Of the trial of that number, its recording changed; `track`: its motion is sought again."""
        before, motion = self.motions[number]
        trial = replace(self.trials[number], recording=change(self.trials[number].recording))
        if track or trial.recording.markers is not self.trials[number].recording.markers:
            prepared = prepare_trial(trial, self.model, self.settings)
            motion = tracked_motion(prepared.body, self.parameters)
        else:
            turned = turn_to_progression(trial.recording, forward_direction(self.model, trial.recording))
            prepared = replace(before, recording=turned)
        return evidence_of(prepared, motion, self.model, self.parameters, self.settings)


def evidence_of(
    prepared: MovingTrial, motion: Motion, model: SubjectModel, parameters: Parameters, settings: CalibrationSettings
) -> ForceEvidence | None:
    """What `gaitcal calibrate` looks at."""
    reactions = measured_reactions(prepared, model, parameters, motion, settings)
    return force_evidence(prepared, prepared.recording, model, parameters, motion, reactions)


def person(name: str, study: Study) -> Person:
    """Joint stage and clean evidence of a study."""
    model = nominal_of(study)
    parameters = fit_joints(session_of(study, model)).parameters
    trials, motions, clean = [], [], []
    for trial in study.moving:
        if trial.role is Role.GAIT and trial.recording.plates:
            prepared = prepare_trial(trial, model, study.settings)
            motion = tracked_motion(prepared.body, parameters)
            evidence = evidence_of(prepared, motion, model, parameters, study.settings)
            if evidence is not None:
                trials.append(trial)
                motions.append((prepared, motion))
                clean.append(evidence)
    return Person(
        name=name,
        model=model,
        parameters=parameters,
        settings=study.settings,
        trials=tuple(trials),
        motions=tuple(motions),
        clean=tuple(clean),
    )


def people(folder: Path, only: str = "") -> Iterator[Person]:
    """All that can be read, real ones first; `folder` takes the files of synthetic ones."""
    studies = _studies(folder)
    for name in matching(only, studies):
        try:
            yield person(name, studies[name]())
        except (InputError, OSError) as fault:
            print(f"{name}: left out: {str(fault)[:150]}")


def _studies(folder: Path) -> dict[str, Callable[[], Study]]:
    out: dict[str, Callable[[], Study]] = {}
    if "GAITCAL_DATA" in os.environ:
        out |= {name: partial(study_of_person, name) for name in REAL}
        out |= {name: partial(Study.load, data() / "opensim_truth" / name / "study.toml") for name in SIMULATED}
    for seed in SYNTHETIC:
        out[f"synthetic{seed}"] = partial(_synthetic, folder / f"synthetic{seed}", seed)
    return out


def _synthetic(folder: Path, seed: int) -> Study:
    return Study.load(synthesize(folder, seed=seed, noise=True, perturb=seed != SYNTHETIC[-1]))
