"""Does what a cohort teaches of joint parameters bring people it does not know nearer to the truth?

    priors [--populations offset,structured,wide] [--cohort 20] [--left-out 12] [--seed 0]

Made-up people of populations that the program does not know (`prior_people.py`), with slow waves on every marker.
Priors are learnt of a cohort that walked (`gait`), and of the same people with isolated trials of hips, knees and
ankles besides (`isolated`). People who are not in the cohort, and walked, are calibrated with the default prior and
with these two, all else being equal.

Printed: RMS error of the legs' joint parameters, and how often bars of 95 % cover the truth: nominal, default prior,
priors of either cohort; then the same by joint, and by how well the walk of a person shows a direction of the
parameters. A person takes some 20 s.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.joint_evidence import LEG_PARAMETERS
from gaitcal.calibration.joint_prior import prior_root
from gaitcal.cohort.learn_priors import Rules, learn_cohort, priors_words
from gaitcal.cohort.learning import PersonEvidence
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_TO_SI, Kind
from gaitcal.study.joint_prior import CohortPriors, joint_prior
from scripts.validation.harness import commas
from scripts.validation.prior_people import POPULATIONS, Fit, MadePerson, evidence, fit, person_of, walk_alone

WIDTH = 1.96
LEGS = np.array([JP_INDEX[name] for name in LEG_PARAMETERS])
JOINTS = ("hip", "knee", "talocrural", "subtalar")
SEEN = (0.3, 3.0)
"""Information in units of the default prior's: directions with less are hardly seen in a walk, with more well."""
BANDS = ("hardly seen in the walk", "half seen", "well seen")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One person left out."""

    truth: Array
    """(98,) m, rad."""
    nominal: Array
    fits: Mapping[str, Fit]
    """By prior, the default one first."""
    information: Array
    """(54, 54) of the legs, what the walk says."""


def report(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Lines."""
    for kind in Kind:
        yield _line(outcomes, f"legs, {kind.value}s, {kind.unit}", _chosen(kind, ""))
    for joint in JOINTS:
        for kind in Kind:
            chosen = _chosen(kind, joint)
            if chosen.any():
                yield _line(outcomes, f"{joint}, {kind.value}s, {kind.unit}", chosen)
    for band, name in enumerate(BANDS):
        yield _band(outcomes, band, name)
    yield "bars of 95 % cover: " + ", ".join(f"{name} {_covered(outcomes, name):.0%}" for name in outcomes[0].fits)


def gain(outcomes: Sequence[Outcome], prior: str, kind: Kind) -> float:
    """Part of the RMS error of the legs with the default prior that another prior takes away."""
    default = next(iter(outcomes[0].fits))
    chosen = _chosen(kind, "")
    return 1.0 - _rms(_errors(outcomes, prior)[:, chosen]) / _rms(_errors(outcomes, default)[:, chosen])


def _chosen(kind: Kind, joint: str) -> Array:
    """(54,) which parameters."""
    listed = [JOINT_PARAMETERS[k] for k in LEGS]
    return np.array([p.kind is kind and p.joint.startswith(joint) for p in listed])


def _errors(outcomes: Sequence[Outcome], prior: str) -> Array:
    """(N, 54) m, rad; of the nominal joints for an empty `prior`."""
    return np.array([((o.fits[prior].fitted if prior else o.nominal) - o.truth)[LEGS] for o in outcomes])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _line(outcomes: Sequence[Outcome], name: str, chosen: Array) -> str:
    unit = JP_TO_SI[LEGS]
    default = _rms((_errors(outcomes, next(iter(outcomes[0].fits))) / unit)[:, chosen])
    nominal = _rms((_errors(outcomes, "") / unit)[:, chosen])
    told = []
    for prior in outcomes[0].fits:
        error = _rms((_errors(outcomes, prior) / unit)[:, chosen])
        change = "" if error == default else f" ({100.0 * (error / default - 1.0):+.0f} %)"
        told.append(f"{prior} {error:.2f}{change}")
    return f"{name}: nominal {nominal:.2f}, {', '.join(told)}"


def _band(outcomes: Sequence[Outcome], band: int, name: str) -> str:
    """Errors along the directions that a walk shows so well, in standard deviations of the default prior."""
    told, unit = [], prior_root(LEG_PARAMETERS, None)
    edges = (-np.inf, *SEEN, np.inf)
    count = 0
    for prior in ("", *outcomes[0].fits):
        found = []
        for outcome, error in zip(outcomes, _errors(outcomes, prior), strict=True):
            values, vectors = np.linalg.eigh(outcome.information)
            there = (values >= edges[band]) & (values < edges[band + 1])
            found.append(vectors[:, there].T @ np.linalg.solve(unit, error))
        count = sum(map(len, found))
        told.append(f"{prior or 'nominal'} {_rms(np.concatenate(found)):.2f}" if count else "none")
    return f"directions {name} ({count / len(outcomes):.0f} of 54), default standard deviations: {', '.join(told)}"


def _covered(outcomes: Sequence[Outcome], prior: str) -> float:
    errors = np.array([o.fits[prior].errors[LEGS] for o in outcomes])
    return float(np.mean(np.abs(_errors(outcomes, prior) / errors) < WIDTH))


SHARED = ("--seed",)
COHORTS = ("gait", "isolated")


@dataclass(frozen=True)
class Cohort:
    """What is learnt of the same people by either recording."""

    gait: CohortPriors
    isolated: CohortPriors


def cohort(name: str, people: int, seed: int) -> Cohort:
    """Record and fit a cohort, and learn of it."""
    draw = POPULATIONS[name](np.random.default_rng(seed))
    found: dict[str, list[PersonEvidence]] = {kind: [] for kind in COHORTS}
    rules = None
    for number in range(people):
        made = person_of(draw, (seed, 0, number), isolated=True)
        rules = _rules(made)
        for kind, seen in (("gait", walk_alone(made)), ("isolated", made)):
            found[kind].append(evidence(f"P{number:03d}", seen, fit(seen)))
    if rules is None:
        raise ValueError("a cohort needs people")
    return Cohort(*(learn_cohort(f"{name}, {kind}", found[kind], rules) for kind in COHORTS))


def _rules(made: MadePerson) -> Rules:
    settings = made.study.settings
    return Rules(marker_set=made.study.marker_set.name, hip_centre=settings.hip_rule, ankle_zero=settings.ankle_rule)


def outcomes(name: str, learnt: Cohort, people: int, seed: int) -> Iterator[Outcome]:
    """People who are not in the cohort."""
    draw = POPULATIONS[name](np.random.default_rng(seed))
    for number in range(people):
        made = person_of(draw, (seed, 1, number), isolated=False)
        plain = fit(made)
        told = [fit(made, joint_prior(p, made.study, Path("priors.json"))) for p in (learnt.gait, learnt.isolated)]
        parts = evidence("", made, plain).parts
        yield Outcome(
            truth=made.truth,
            nominal=made.nominal.parameters.joint,
            fits={"default prior": plain, **dict(zip((f"cohort: {kind}" for kind in COHORTS), told, strict=True))},
            information=parts["legs"].information,
        )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Populations and numbers of people."""
    known = list(POPULATIONS)
    parser.add_argument("--populations", type=commas(known), default=known, help=f"of {', '.join(known)}")
    parser.add_argument("--cohort", type=int, default=20, help="people in the cohort")
    parser.add_argument("--left-out", type=int, default=12, help="people who are not")


def run(chosen: argparse.Namespace) -> None:
    """Print the figures, population by population."""
    for name in chosen.populations:
        began = time.monotonic()
        learnt = cohort(name, chosen.cohort, chosen.seed)
        found = list(outcomes(name, learnt, chosen.left_out, chosen.seed))
        print(f"population {name} (seed {chosen.seed}): {chosen.cohort} people learnt of, {len(found)} left out")
        for kind in COHORTS:
            for line in priors_words(getattr(learnt, kind)):
                print(f"  {kind}: {line}")
        for line in report(found):
            print(f"  {line}")
        print(f"  {time.monotonic() - began:.0f} s", flush=True)
