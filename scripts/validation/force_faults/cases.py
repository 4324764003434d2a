"""One fault in one study: what is told of it.

The studies that faults are put into, and what is kept of each: its joint stage, done once.

A fault of the forces does not touch the joint parameters, and the motion of its trial only through the say that plates
have in the bandwidth: the motion is reused, or tracked again where that is asked for or markers were changed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np

from gaitcal.errors import InputError
from gaitcal.faults.force_causes import Kind
from gaitcal.faults.force_choice import ForceFit, Named, choose, told_size
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
from gaitcal.study.study_trial import Role, Trial
from gaitcal.synthetic.subject import synthesize
from scripts.validation.force_faults.faults import FAULTS, Fault
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
    trials: tuple[Trial, ...]
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


ONE_PLATE = 0.4
"""Share of faults of one plate alone, where a fault can be of one."""
ONE_TRIAL = 0.5
"""Share of faults in one trial alone, in sessions of several."""


class Outcome(Enum):
    """How a fault was met."""

    FIRST = "first"
    IN_SET = "in set"
    OTHER_PLATE = "other plate"
    WRONG = "wrong"
    NONE = "none"
    NO_FRAMES = "no frames"
    """No frame of the trial can be judged; nothing is valid."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One fault and how it was met."""

    person: str
    trials: tuple[str, ...]
    fault: Fault
    scope: str
    outcome: Outcome
    told: str
    ratio: float | None
    """Size found over true size, where it was named first."""
    causes: int
    """How many were told."""


def cases(everybody: list[Person], count: int, seed: int, *, track: bool) -> Iterator[Case]:
    """`count` faults, every kind in turn, in people drawn at random."""
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        yield case(everybody[int(rng.integers(len(everybody)))], i, rng, track=track)


def case(person: Person, number: int, rng: np.random.Generator, *, track: bool) -> Case:
    """The fault of that number in one or all trials of a person."""
    make = FAULTS[number % len(FAULTS)]
    alone = len(person.trials) > 1 and rng.random() < ONE_TRIAL
    struck = [int(rng.integers(len(person.trials)))] if alone else list(range(len(person.trials)))
    loaded = [p.name for p in person.clean[struck[0]].plates]
    names = [p.name for p in person.trials[struck[0]].recording.plates]
    plate = names.index(str(rng.choice(loaded))) if rng.random() < ONE_PLATE else None
    fault = _seen_along_the_walk(make(rng, plate), person.clean[struck[0]])
    evidence: list[ForceEvidence | None] = list(person.clean)
    for i in struck:
        evidence[i] = person.evidence(i, fault.change, track=track)
    found, _ = choose([e for e in evidence if e is not None])
    about = [n for n in found if {t.name for t in n.trials} & {person.trials[i].name for i in struck}]
    wrongly = [n for n in found if n not in about]
    outcome, best = _outcome(fault, about, wrongly, person, struck, names)
    if outcome is Outcome.NONE and all(evidence[i] is None for i in struck):
        outcome = Outcome.NO_FRAMES
    named = [f"{n.fits[0].cause.kind.value} {','.join(n.fits[0].cause.plates)}" for n in found]
    return Case(
        person=person.name,
        trials=tuple(person.trials[i].name for i in struck),
        fault=fault,
        scope="all" if fault.plate is None else "one",
        outcome=outcome,
        told="; ".join(named),
        ratio=None if outcome is not Outcome.FIRST or best is None else ratio(fault, best, person, struck[0]),
        causes=max((len(n.fits) for n in about), default=0),
    )


def _seen_along_the_walk(fault: Fault, trial: ForceEvidence) -> Fault:
    """Columns x and z of a file are sideways and fore-aft where the walk goes along z."""
    other = {Kind.SIGN_FORE_AFT: Kind.SIGN_SIDEWAYS, Kind.SIGN_SIDEWAYS: Kind.SIGN_FORE_AFT}
    along_z = abs(trial.room[0, 0]) < 0.5
    return replace(fault, kind=other[fault.kind]) if along_z and fault.kind in other else fault


def _outcome(
    fault: Fault, about: list[Named], wrongly: list[Named], person: Person, struck: list[int], names: list[str]
) -> tuple[Outcome, ForceFit | None]:
    """Of the findings on the struck trials; a finding on another trial is wrong."""
    if wrongly:
        return Outcome.WRONG, None
    if not about:
        return Outcome.NONE, None
    of_plate = () if fault.plate is None else (names[fault.plate],)
    single = all(len(person.clean[i].plates) == 1 for i in struck)

    def same(fit: ForceFit) -> bool:
        plates = fit.cause.plates
        if fault.kind is Kind.EXCHANGED:
            return fit.cause.kind is Kind.EXCHANGED
        return fit.cause.kind is fault.kind and (plates == of_plate or (single and not plates))

    firsts = [n.fits[0] for n in about]
    if all(same(fit) and fit.cause.unit == fault.unit for fit in firsts):
        return Outcome.FIRST, firsts[0]
    if all(any(same(fit) for fit in n.fits) for n in about):
        return Outcome.IN_SET, None
    if all(n.fits[0].cause.kind is fault.kind for n in about):
        return Outcome.OTHER_PLATE, None
    return Outcome.WRONG, None


def ratio(fault: Fault, fit: ForceFit, person: Person, trial: int) -> float | None:
    """Size found over true size; of a factor, of its logarithm's distance from 1; vectors along the true one."""
    if not fault.size:
        return None
    true, found = np.array(fault.size), told_size(fit)
    if len(true) > 1:
        return float(found @ true / (true @ true))
    if fault.kind is Kind.YAW:
        found = (found + np.pi) % (2 * np.pi) - np.pi
        return float(found[0] / true[0]) if abs(true[0]) < 3.0 else float(abs(found[0]) / abs(true[0]))
    if fault.kind is Kind.FREE_MOMENT:  # what has to be taken away, as the rest of a large factor is not seen
        return float(-fit.x[0] / (1.0 - 1.0 / true[0]))
    return float(found[0] / true[0])
