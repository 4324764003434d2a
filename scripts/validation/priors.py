"""Does what a cohort teaches of joint parameters bring people it does not know nearer to the truth?

    priors [--parts offset,structured,wide] [--cohort 20] [--left-out 12] [--seed 0]

Made-up people of populations that the program does not know (how the joints of their linkage
deviate from nominal ones), with slow waves on every marker. Priors are learnt of a cohort that
walked (`gait`), and of the same people with isolated trials of hips, knees and ankles besides
(`isolated`). People who are not in the cohort, and walked, are calibrated with the default prior
and with these two, all else being equal.

Printed: RMS error of the legs' joint parameters, and how often bars of 95 % cover the truth:
nominal, default prior, priors of either cohort; then the same by joint, and by how well the walk of
a person shows a direction of the parameters. A person takes some 20 s.

The published person's linkage is changed by what the population says, its joints about where a
study takes them to be nominal, and then made as tall as the person is. As both segments of a joint
have their frames from one static posture, what is told of them in those frames goes together.
Markers move as in `gaitcal synthesize`: slow waves of up to 10 mm, none in the static trial. Frames
are thinned to 100 Hz in the walk, 33 Hz in isolated trials.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from gaitcal import Study
from gaitcal.arrays import Array
from gaitcal.calibration.joint_phases import LEG_PARAMETERS
from gaitcal.calibration.joint_prior import factor_prior
from gaitcal.cohort.learn_priors import Rules, compute_part_evidence, describe_priors, learn_cohort
from gaitcal.cohort.learning import PersonEvidence
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import ISOLATED_JOINTS, LEG_JOINTS
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, JP_TO_SI, ParameterKind
from gaitcal.model.segment_frames import HipCentre
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.study.cohort_prior import (
    HEIGHT_STEP_M,
    REFERENCE_HEIGHT_M,
    CohortPriors,
    Person,
    build_mirror,
)
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.study import build_cohort_prior
from gaitcal.synthetic.synthetic_motion import (
    TrueMotion,
    compute_synthetic_markers,
    draw_marker_noise,
    make_standing_pose,
    simulate_isolated_trial,
    simulate_static_trial,
    simulate_two_strides,
)
from gaitcal.synthetic.synthetic_truth import compute_static_frames
from scripts.validation.harness import option, rms, say, shares
from scripts.validation.people.fits import Fit, fitted
from scripts.validation.recordings import only, write_folder

SHARED = ("--seed",)
OWN = {
    "--cohort": option(20, "people in the cohort"),
    "--left-out": option(12, "people who are not"),
}
POSITION = np.array([p.kind is ParameterKind.POSITION for p in JOINT_PARAMETERS])
Draw = Callable[[np.random.Generator, Person], Array]
"""(98,) m, rad: deviations of a new person."""


def scaled(millimetres: float, degrees: float) -> Array:
    return np.where(POSITION, 1e-3 * millimetres, np.deg2rad(degrees))


def both_sides(values: Array) -> Array:
    paired = np.array([p.joint[-2:] in ("_r", "_l") for p in JOINT_PARAMETERS])
    return 0.5 * (values + build_mirror(JP_NAMES) @ values) * np.where(paired, np.sqrt(2.0), 1.0)


def offset(rng: np.random.Generator) -> Draw:
    """Everybody deviates by nearly the same: uniform within 10 mm and 10 deg; their own spread is 2
    mm and 2 deg.
    """
    common = both_sides(rng.uniform(-1.0, 1.0, len(JP_NAMES)) * scaled(10.0, 10.0))
    return lambda own, person: common + own.normal(size=len(common)) * scaled(2.0, 2.0)


def wide(rng: np.random.Generator) -> Draw:
    """No deviation in common; each parameter independent, uniform within 10 mm and 10 deg as
    `synthesize --perturb`.
    """
    return lambda own, person: own.uniform(-1.0, 1.0, len(JP_NAMES)) * scaled(10.0, 10.0)


def structured(rng: np.random.Generator) -> Draw:
    """Three traits move many parameters of both sides together (4 mm, 4 deg each), size moves them
    by 4 mm and 3 deg for 10 cm, an offset by 4 mm and 4 deg; their own spread is 1.5 mm, 1.5 deg.
    """
    count = len(JP_NAMES)
    traits = np.array([both_sides(rng.normal(size=count) * scaled(4.0, 4.0)) for _ in range(3)])
    size = both_sides(rng.normal(size=count) * scaled(4.0, 3.0))
    common = both_sides(rng.normal(size=count) * scaled(4.0, 4.0))

    def draw(own: np.random.Generator, person: Person) -> Array:
        by_size = (person.height - REFERENCE_HEIGHT_M) / HEIGHT_STEP_M * size
        out: Array = (
            common
            + by_size
            + own.normal(size=3) @ traits
            + own.normal(size=count) * scaled(1.5, 1.5)
        )
        return out

    return draw


POPULATIONS: dict[str, Callable[[np.random.Generator], Draw]] = {
    "offset": offset,
    "wide": wide,
    "structured": structured,
}
"""Of a generator that makes the population, what draws its people."""


HEIGHTS = (1.50, 1.90)
"""m."""
ABOVE_FLOOR = 0.02
"""m: the lowest marker."""
EVERY = {"static": 1, "gait": 2}
"""Frame of the published recordings that is kept; of isolated trials, `EVERY_ISOLATED`."""
EVERY_ISOLATED = 6
TRANSLATIONS = slice(3, 6)


@dataclass(frozen=True, kw_only=True)
class MadePerson:
    study: Study
    truth: Array
    """(98,) m, rad, in the frames of the study's static trial."""
    nominal: SubjectModel
    person: Person


def person_of(draw: Draw, seed: tuple[int, ...], *, isolated: bool) -> MadePerson:
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2)]
    person = Person(
        height=float(streams[0].uniform(*HEIGHTS)),
        sex="male" if streams[0].random() < 0.5 else "female",
    )
    return recorded(person, draw(streams[0], person), streams[1], isolated=isolated)


def recorded(
    person: Person, deviation: Array, rng: np.random.Generator, *, isolated: bool
) -> MadePerson:
    """Record a person whose joints deviate so (98,) from those that the study takes to be
    nominal.
    """
    published = published_model(static_only=True)
    size = person.height / published.subject.height
    at_size = np.where(POSITION, size, 1.0)
    joint = (
        published.parameters.joint
        - (nominal_error() if deviation.any() else 0.0)
        + deviation / at_size
    )
    parameters = replace(published.parameters, joint=joint)
    pose = make_standing_pose(parameters)
    motions = {
        "static": simulate_static_trial(standing=pose),
        "gait": simulate_two_strides(parameters),
    }
    if isolated:
        motions |= {name: simulate_isolated_trial(name, pose) for name in ISOLATED_JOINTS}
    tall = replace(
        published,
        parameters=replace(parameters, joint=joint * at_size),
        markers=replace(published.markers, local=size * published.markers.local),
    )
    with tempfile.TemporaryDirectory() as name:
        recordings = {
            trial: recording(trial, tall, motion, size, rng) for trial, motion in motions.items()
        }
        study = Study.load(
            write_folder(Path(name), recordings, ("made up", 70.0, person.height, person.sex))
        )
    truth = compute_static_frames(tall, HipCentre(study.settings.hip_rule)).parameters.joint
    return MadePerson(study=study, truth=truth, nominal=build_nominal_model(study), person=person)


@cache
def nominal_error() -> Array:
    """(98,) m, rad: what a study's nominal joints of the published person miss, which no population
    has.
    """
    published = published_model().subject
    person = Person(height=published.height, sex=published.sex)
    plain = recorded(person, np.zeros(len(JP_NAMES)), np.random.default_rng(0), isolated=False)
    out: Array = plain.truth - plain.nominal.parameters.joint
    return out


def fit(made: MadePerson, prior: JointPrior | None = None) -> Fit:
    return fitted("made up", replace(made.study, joint_prior=prior))


def evidence(name: str, made: MadePerson, found: Fit) -> PersonEvidence:
    parts = compute_part_evidence(
        found.influence, found.parameters.joint - made.nominal.parameters.joint, JP_NAMES, None
    )
    if parts is None:
        raise RuntimeError("errors of joint parameters without rank")
    return PersonEvidence(name=name, person=made.person, recordings=frozenset(), parts=parts)


def recording(
    trial: str, model: SubjectModel, motion: TrueMotion, size: float, rng: np.random.Generator
) -> Recording:
    """Markers of a trial; noise unless it is static. `size`: of the person against the published
    one.
    """
    q = motion.q.copy()
    q[:, TRANSLATIONS] *= size
    every = compute_synthetic_markers(model.parameters, model.markers, q)
    every[:, :, 1] += ABOVE_FLOOR - every[:, :, 1].min()
    labels = model.markers.labels if trial == "static" else published_model().markers.labels
    chosen = every[:, [model.markers.labels.index(label) for label in labels]]
    time = motion.basis.time
    if trial != "static":
        chosen = chosen + draw_marker_noise(time, len(labels), rng)
    step = EVERY.get(trial, EVERY_ISOLATED)
    return Recording(source="made up", time=time[::step], labels=labels, markers=chosen[::step])


LEGS = np.array([JP_INDEX[name] for name in LEG_PARAMETERS])
SEEN = (0.3, 3.0)
"""Information in units of the default prior's: directions with less are hardly seen in a walk, with
more well.
"""
BANDS = ("hardly seen in the walk", "half seen", "well seen")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    truth: Array
    """(98,) m, rad."""
    nominal: Array
    fits: Mapping[str, Fit]
    """By prior, the default one first."""
    information: Array
    """(54, 54) of the legs, what the walk says."""


def report(outcomes: Sequence[Outcome]) -> Iterator[str]:
    for kind in ParameterKind:
        yield _line(outcomes, f"legs, {kind.value}s, {kind.unit}", _chosen(kind, ""))
    for joint in LEG_JOINTS:
        for kind in ParameterKind:
            chosen = _chosen(kind, joint)
            if chosen.any():
                yield _line(outcomes, f"{joint}, {kind.value}s, {kind.unit}", chosen)
    for band, name in enumerate(BANDS):
        yield _band(outcomes, band, name)
    bars = {
        name: np.array([o.fits[name].errors[LEGS] for o in outcomes]) for name in outcomes[0].fits
    }
    covered = (
        f"{name} {shares(_errors(outcomes, name) / of_fit)[1]:.0f}%"
        for name, of_fit in bars.items()
    )
    yield f"bars of 95 % cover: {', '.join(covered)}"


def _chosen(kind: ParameterKind, joint: str) -> Array:
    listed = [JOINT_PARAMETERS[k] for k in LEGS]
    return np.array([p.kind is kind and p.joint.startswith(joint) for p in listed])


def _errors(outcomes: Sequence[Outcome], prior: str) -> Array:
    """(N, 54) m, rad; of the nominal joints for an empty `prior`."""
    return np.array(
        [
            ((o.fits[prior].parameters.joint if prior else o.nominal) - o.truth)[LEGS]
            for o in outcomes
        ]
    )


def _line(outcomes: Sequence[Outcome], name: str, chosen: Array) -> str:
    unit = JP_TO_SI[LEGS]
    default = rms((_errors(outcomes, next(iter(outcomes[0].fits))) / unit)[:, chosen])
    nominal = rms((_errors(outcomes, "") / unit)[:, chosen])
    told = []
    for prior in outcomes[0].fits:
        error = rms((_errors(outcomes, prior) / unit)[:, chosen])
        change = "" if error == default else f" ({100.0 * (error / default - 1.0):+.0f} %)"
        told.append(f"{prior} {error:.2f}{change}")
    return f"{name}: nominal {nominal:.2f}, {', '.join(told)}"


def _band(outcomes: Sequence[Outcome], band: int, name: str) -> str:
    """Errors along the directions that a walk shows so well, in standard deviations of the default
    prior.
    """
    told, unit = [], factor_prior(LEG_PARAMETERS, None)
    edges = (-np.inf, *SEEN, np.inf)
    count = 0
    for prior in ("", *outcomes[0].fits):
        found = []
        for outcome, error in zip(outcomes, _errors(outcomes, prior), strict=True):
            values, vectors = np.linalg.eigh(outcome.information)
            there = (values >= edges[band]) & (values < edges[band + 1])
            found.append(vectors[:, there].T @ np.linalg.solve(unit, error))
        count = sum(map(len, found))
        told.append(f"{prior or 'nominal'} {rms(np.concatenate(found)):.2f}" if count else "none")
    share = f"{count / len(outcomes):.0f} of {len(LEGS)}"
    return f"directions {name} ({share}), default standard deviations: {', '.join(told)}"


COHORTS = ("gait", "isolated")


def cohort(name: str, people: int, seed: int) -> dict[str, CohortPriors]:
    """Record and fit a cohort, and learn of the same people by either recording."""
    draw = POPULATIONS[name](np.random.default_rng(seed))
    found: dict[str, list[PersonEvidence]] = {kind: [] for kind in COHORTS}
    rules = None
    for number in range(people):
        made = person_of(draw, (seed, 0, number), isolated=True)
        settings = made.study.settings
        rules = Rules(
            marker_set=made.study.marker_set.name,
            hip_centre=settings.hip_rule,
            ankle_zero=settings.ankle_rule,
        )
        for kind, recorded_by in (
            ("gait", replace(made, study=only(made.study, "gait"))),
            ("isolated", made),
        ):
            found[kind].append(evidence(f"P{number:03d}", recorded_by, fit(recorded_by)))
    if rules is None:
        raise ValueError("a cohort needs people")
    return {kind: learn_cohort(f"{name}, {kind}", found[kind], rules) for kind in COHORTS}


def outcomes(
    name: str, learnt: Mapping[str, CohortPriors], people: int, seed: int
) -> Iterator[Outcome]:
    draw = POPULATIONS[name](np.random.default_rng(seed))
    for number in range(people):
        made = person_of(draw, (seed, 1, number), isolated=False)
        plain = fit(made)
        told = {
            f"cohort: {k}": fit(made, build_cohort_prior(p, made.study, Path("priors.json")))
            for k, p in learnt.items()
        }
        parts = evidence("", made, plain).parts
        yield Outcome(
            truth=made.truth,
            nominal=made.nominal.parameters.joint,
            fits={"default prior": plain, **told},
            information=parts["legs"].information,
        )


def measured(name: str, chosen: argparse.Namespace) -> None:
    learnt = cohort(name, chosen.cohort, chosen.seed)
    found = list(outcomes(name, learnt, chosen.left_out, chosen.seed))
    say(
        f"population {name} (seed {chosen.seed}): {chosen.cohort} people learnt of, {len(found)} "
        "left out"
    )
    for kind in COHORTS:
        say(*(f"  {kind}: {line}" for line in describe_priors(learnt[kind])))
    say(*(f"  {line}" for line in report(found)))


PARTS = {name: partial(measured, name) for name in POPULATIONS}
