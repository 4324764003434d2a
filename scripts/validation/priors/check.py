"""Does what a cohort teaches of joint parameters bring people it does not know nearer to the truth?

    priors [--populations offset,structured,wide] [--cohort 20] [--left-out 12] [--seed 0]

Made-up people of populations that the program does not know (`priors/populations.py`), with slow waves on every marker
(`priors/people.py`). Priors are learnt of a cohort that walked (`gait`), and of the same people with isolated trials of
hips, knees and ankles besides (`isolated`). People who are not in the cohort, and walked, are calibrated with the
default prior and with these two, all else being equal.

Printed: RMS error of the legs' joint parameters, and how often bars of 95 % cover the truth: nominal, default prior,
priors of either cohort; then the same by joint, and by how well the walk of a person shows a direction of the
parameters. A person takes some 20 s.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal.cohort.learn_priors import Rules, learn_cohort, priors_words
from gaitcal.cohort.learning import PersonEvidence
from gaitcal.study.joint_prior import CohortPriors, joint_prior
from scripts.validation.harness import commas
from scripts.validation.priors.people import MadePerson, evidence, fit, person_of, walk_alone
from scripts.validation.priors.populations import POPULATIONS
from scripts.validation.priors.report import Outcome, report

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
