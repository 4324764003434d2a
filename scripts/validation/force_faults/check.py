"""Are faults of force plates named, with their size, and clean recordings left in peace?

    force_faults [--cases 360] [--seed N] [--only subject01,pig,...] [--verbose]

Single faults, drawn at random (sizes log-uniform; in one plate or all, in one trial or all of a
session; centre of pressure or moments kept), are put into the recordings of people whose joint
parameters were calibrated once; their trials are then diagnosed as `gaitcal calibrate` does, by the
clean motion. Printed: how each kind of fault was met, the sizes found, what was taken for another,
the smallest size from which 80 % are found, and every clean recording. Real people need the
environment variable GAITCAL_DATA. Exit code 1 where a clean recording is accused, or the right
cause comes first in less than 90 % of the faults that are spoken of.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np

from gaitcal.analysis.fit_joints import fit_joints
from gaitcal.analysis.prepared_trials import (
    MovingTrial,
    compute_trial_reactions,
    estimate_forward_direction,
    prepare_calibration,
    prepare_trial,
)
from gaitcal.errors import InputError
from gaitcal.io.axes import rotate_to_progression
from gaitcal.io.recording import Recording
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.quality.force_causes import ForceFault
from gaitcal.quality.force_choice import ForceFit, NamedFault, choose, fit_causes, get_reported_size
from gaitcal.quality.force_evidence import ForceEvidence, ForceResidual, build_force_evidence
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role, Trial
from gaitcal.synthetic.subject import synthesize
from gaitcal.tracking.motion import Motion, track_motion
from scripts.validation.force_faults.faults import FAULTS, Fault
from scripts.validation.harness import matching, option, say
from scripts.validation.recordings import CHILDREN, SIMULATED, data, study_of_person

SHARED = ("--only", "--seed")
OWN = {"--cases": option(360, "faults"), "--verbose": option(False, "a line for each fault")}
REAL = ("subject01", "pig", *CHILDREN, "kad", "multi")
SYNTHETIC = (1, 2, 3)


@dataclass(frozen=True)
class Person:
    """A study after its joint stage, done once: a fault of the forces does not touch joint
    parameters, and the motion only through the say that plates have in the bandwidth.
    """

    name: str
    model: SubjectModel
    parameters: Parameters
    settings: CalibrationSettings
    trials: tuple[Trial, ...]
    """Gait trials over force plates."""
    motions: tuple[tuple[MovingTrial, Motion], ...]
    clean: tuple[ForceEvidence, ...]

    def evidence(
        self, number: int, change: Callable[[Recording], Recording]
    ) -> ForceEvidence | None:
        """Of the trial of that number, its recording changed; its motion is sought again where its
        markers were.
        """
        before, motion = self.motions[number]
        trial = replace(self.trials[number], recording=change(self.trials[number].recording))
        if trial.recording.markers is not self.trials[number].recording.markers:
            prepared = prepare_trial(trial, self.model, self.settings)
            motion = track_motion(prepared.whole_body_problem, self.parameters)
        else:
            turned = rotate_to_progression(
                trial.recording, estimate_forward_direction(self.model, trial.recording)
            )
            prepared = replace(before, recording=turned)
        return evidence_of(prepared, motion, self.model, self.parameters, self.settings)


def evidence_of(
    prepared: MovingTrial,
    motion: Motion,
    model: SubjectModel,
    parameters: Parameters,
    settings: CalibrationSettings,
) -> ForceEvidence | None:
    reactions = compute_trial_reactions(prepared, model, parameters, motion, settings)
    return build_force_evidence(prepared, prepared.recording, model, parameters, motion, reactions)


def person(name: str, study: Study) -> Person:
    """Joint stage and clean evidence of a study."""
    session = fit_joints(prepare_calibration(preprocess_study(study)))
    model, parameters = session.model, session.parameters
    found = []
    for trial in (t for t in study.moving if t.role is Role.GAIT and t.recording.plates):
        prepared = prepare_trial(trial, model, study.settings)
        motion = track_motion(prepared.whole_body_problem, parameters)
        evidence = evidence_of(prepared, motion, model, parameters, study.settings)
        if evidence is not None:
            found.append((trial, (prepared, motion), evidence))
    trials, motions, clean = zip(*found, strict=True) if found else ((), (), ())
    return Person(name, model, parameters, study.settings, trials, motions, clean)


def people(folder: Path, only: str = "") -> Iterator[Person]:
    """All that can be read, real ones first; `folder` takes the files of synthetic ones."""
    studies: dict[str, Callable[[], Study]] = {}
    if "GAITCAL_DATA" in os.environ:
        studies |= {name: partial(study_of_person, name) for name in REAL}
        studies |= {
            name: partial(Study.load, data() / "opensim_truth" / name / "study.toml")
            for name in SIMULATED
        }
    studies |= {
        path.name: partial(_synthetic, path)
        for path in (folder / f"synthetic{n}" for n in SYNTHETIC)
    }
    for name in matching(only, studies):
        try:
            yield person(name, studies[name]())
        except (InputError, OSError) as fault:
            print(f"{name}: left out: {str(fault)[:150]}")


def _synthetic(folder: Path) -> Study:
    seed = int(folder.name[-1])
    return Study.load(synthesize(folder, seed=seed, noise=True, perturb=seed != SYNTHETIC[-1]))


ONE_PLATE = 0.4
"""Share of faults of one plate alone, where a fault can be of one."""
ONE_TRIAL = 0.5
"""Share of faults in one trial alone, in sessions of several."""


class Outcome(Enum):
    FIRST = "first"
    IN_SET = "in set"
    OTHER_PLATE = "other plate"
    WRONG = "wrong"
    NONE = "none"
    NO_FRAMES = "no frames"
    """No frame of the trial can be judged; nothing is valid."""


@dataclass(frozen=True)
class Case:
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

    @property
    def where(self) -> str:
        return f"{self.person} {','.join(self.trials)} {self.scope}"


def cases(everybody: list[Person], count: int, seed: int) -> Iterator[Case]:
    """`count` faults, every kind in turn, in people drawn at random."""
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        yield case(everybody[int(rng.integers(len(everybody)))], i, rng)


def case(person: Person, number: int, rng: np.random.Generator) -> Case:
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
        evidence[i] = person.evidence(i, fault.change)
    found, *_ = choose([e for e in evidence if e is not None])
    about = [
        n for n in found if {t.name for t in n.trials} & {person.trials[i].name for i in struck}
    ]
    wrongly = [n for n in found if n not in about]
    outcome, best = _outcome(fault, about, wrongly, person, struck, names)
    if outcome is Outcome.NONE and all(evidence[i] is None for i in struck):
        outcome = Outcome.NO_FRAMES
    named = [f"{n.fits[0].cause.kind.value} {','.join(n.fits[0].cause.plates)}" for n in found]
    size = None if outcome is not Outcome.FIRST or best is None else ratio(fault, best)
    causes, scope = (
        max((len(n.fits) for n in about), default=0),
        "all" if fault.plate is None else "one",
    )
    trials = tuple(person.trials[i].name for i in struck)
    return Case(person.name, trials, fault, scope, outcome, "; ".join(named), size, causes)


def _seen_along_the_walk(fault: Fault, trial: ForceEvidence) -> Fault:
    """Columns x and z of a file are sideways and fore-aft where the walk goes along z."""
    other = {
        ForceFault.SIGN_FORE_AFT: ForceFault.SIGN_SIDEWAYS,
        ForceFault.SIGN_SIDEWAYS: ForceFault.SIGN_FORE_AFT,
    }
    along_z = abs(trial.room[0, 0]) < 0.5
    return replace(fault, kind=other[fault.kind]) if along_z and fault.kind in other else fault


def _outcome(
    fault: Fault,
    about: list[NamedFault],
    wrongly: list[NamedFault],
    person: Person,
    struck: list[int],
    names: list[str],
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
        if fault.kind is ForceFault.EXCHANGED:
            return fit.cause.kind is ForceFault.EXCHANGED
        return fit.cause.kind is fault.kind and (plates == of_plate or (single and not plates))

    firsts = [n.fits[0] for n in about]
    if all(same(fit) and fit.cause.unit == fault.unit for fit in firsts):
        return Outcome.FIRST, firsts[0]
    if all(any(same(fit) for fit in n.fits) for n in about):
        return Outcome.IN_SET, None
    if all(n.fits[0].cause.kind is fault.kind for n in about):
        return Outcome.OTHER_PLATE, None
    return Outcome.WRONG, None


def ratio(fault: Fault, fit: ForceFit) -> float | None:
    """Size found over true size; of a factor, of its logarithm's distance from 1; vectors along the
    true one.
    """
    if not fault.size:
        return None
    true, found = np.array(fault.size), get_reported_size(fit)
    if len(true) > 1:
        return float(found @ true / (true @ true))
    if fault.kind is ForceFault.YAW:
        found = (found + np.pi) % (2 * np.pi) - np.pi
        return (
            float(found[0] / true[0]) if abs(true[0]) < 3.0 else float(abs(found[0]) / abs(true[0]))
        )
    if (
        fault.kind is ForceFault.FREE_MOMENT
    ):  # what has to be taken away, as the rest of a large factor is not seen
        return float(-fit.x[0] / (1.0 - 1.0 / true[0]))
    return float(found[0] / true[0])


SPOKEN = (Outcome.FIRST, Outcome.IN_SET, Outcome.OTHER_PLATE, Outcome.WRONG)
FOUND = 0.8


def accused(everybody: list[Person]) -> int:
    """How many clean studies have a named cause, or an unexplained disagreement."""
    return sum(any(choose(person.clean)[:2]) for person in everybody)


def print_clean(everybody: list[Person]) -> None:
    print(
        "clean recordings: |y|^2 a row (1: usual), the best cause there is (not told), what is told"
    )
    for person in everybody:
        for trial in person.clean:
            size, found = fit_causes(ForceResidual([trial]))
            best = (
                f"{found[0].cause.kind.value} gain {found[0].gain:.1f} explained "
                f"{found[0].explained:.2f}"
            )
            print(f"  {person.name:12}{trial.name:10}{size:6.2f}  {best}")
        named, unexplained, _ = choose(person.clean)
        print(f"  {person.name:12}told: {len(named)} causes, {len(unexplained)} unexplained")


def first_share(found: list[Case]) -> float:
    """Of the faults that are spoken of, those whose cause comes first."""
    spoken = [case for case in found if case.outcome in SPOKEN]
    return sum(case.outcome is Outcome.FIRST for case in spoken) / max(1, len(spoken))


def print_table(found: list[Case]) -> None:
    heads = ("n", *(outcome.value for outcome in Outcome))
    print(
        f"\n{'fault':34}"
        + "".join(f"{head:>12}" for head in heads)
        + "   size found / true: median (10-90 %)"
    )
    rows: dict[str, list[Case]] = {}
    for case in found:
        rows.setdefault(f"{case.fault.row}, {case.scope}", []).append(case)
    for row, of_row in sorted(rows.items()):
        print(_line(row, of_row))
    print(_line("together", found))
    print(f"right cause first in {100 * first_share(found):.1f} % of those spoken of")
    within = [abs(case.ratio - 1.0) <= 0.2 for case in found if case.ratio is not None]
    print(f"size within 20 % in {sum(within)} of {len(within)}")
    told = Counter(case.causes for case in found if case.outcome in SPOKEN)
    print("causes told at once: " + ", ".join(f"{n}: {told[n]}" for n in sorted(told)))
    print("\ntaken for another")
    for case in found:
        if case.outcome in (Outcome.IN_SET, Outcome.OTHER_PLATE, Outcome.WRONG):
            print(
                f"  {case.outcome.value:12}{case.fault.row}, {case.fault.words} ({case.where}): "
                f"{case.told}"
            )
    print("\nnothing told")
    for row, of_row in sorted(rows.items()):
        missed = sorted(
            c.fault.words for c in of_row if c.outcome in (Outcome.NONE, Outcome.NO_FRAMES)
        )
        if missed:
            print(f"  {row}: {', '.join(missed)}")
    print(f"\nsmallest size from which {100 * FOUND:.0f} % are found (first or in the set)")
    for row, of_row in sorted(rows.items()):
        if of_row[0].fault.size:
            print(f"  {row:34}{smallest(of_row)}")


def _line(row: str, of_row: list[Case]) -> str:
    counts = Counter(case.outcome for case in of_row)
    ratios = [case.ratio for case in of_row if case.ratio is not None]
    sizes = ""
    if ratios:
        low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
        sizes = f"   {middle:.2f} ({low:.2f}-{high:.2f})"
    return (
        f"{row:34}{len(of_row):12}"
        + "".join(f"{counts[outcome]:12}" for outcome in Outcome)
        + sizes
    )


def smallest(of_row: list[Case]) -> str:
    """The size above which enough faults are found, in words."""
    ordered = sorted(of_row, key=lambda case: magnitude(case))
    hits = np.array(
        [case.outcome in (Outcome.FIRST, Outcome.IN_SET) for case in ordered], dtype=float
    )
    shares = np.cumsum(hits[::-1])[::-1] / np.arange(len(hits), 0, -1)
    enough = np.flatnonzero((shares >= FOUND) & (hits > 0))
    if not len(enough):
        return "-"
    case = ordered[int(enough[0])]
    return f"{case.fault.words} ({int(hits[enough[0] :].sum())} of {len(ordered) - int(enough[0])})"


def magnitude(case: Case) -> float:
    """How large a fault is among those of its row."""
    size = case.fault.size
    if case.fault.kind.value.endswith("gain") or case.fault.row == "free moment":
        return abs(float(np.log(abs(size[0]))))
    return float(np.linalg.norm(size))


LEAST_FIRST = 0.90


def run(chosen: argparse.Namespace) -> tuple[list[Person], list[Case]]:
    with tempfile.TemporaryDirectory() as folder:
        everybody = list(people(Path(folder), chosen.only))
        print_clean(everybody)
        found = []
        for case in cases(everybody, chosen.cases, chosen.seed):
            found.append(case)
            if chosen.verbose:
                size = "" if case.ratio is None else f"size x {case.ratio:.2f}"
                cells = (
                    f"{case.outcome.value:12}{case.fault.row:28}"
                    f"{case.fault.words:26}{case.where:40}"
                )
                say(f"{cells}{size} [{case.told}]")
    print_table(found)
    return everybody, found


def passed(results: tuple[list[Person], list[Case]]) -> bool:
    everybody, found = results
    return not accused(everybody) and first_share(found) >= LEAST_FIRST
