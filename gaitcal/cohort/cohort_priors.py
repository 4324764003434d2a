"""From what the results of many people say to the file of priors that the next person leans on."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.joint_prior import prior_deviations, prior_of, prior_root
from gaitcal.codes import Code
from gaitcal.cohort.learning import FEWEST, PartPrior, Population, folds_of, heights_of, learn_part
from gaitcal.cohort.person_evidence import PARTS, PersonEvidence
from gaitcal.errors import InputError
from gaitcal.io.toml import package_version
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX
from gaitcal.study.joint_prior import (
    FORMAT,
    KIND,
    CohortPriors,
    Person,
    StoredPart,
    StoredPerson,
    StoredPopulation,
    expected,
    name_hash,
)

DIGITS = 9
COLUMNS = ("name", "unit", "mean", "sd", "default_sd", "learnt")


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What nominal joints depend on: the same in everybody that is learnt of, and in whom it is used for."""

    marker_set: str
    hip_centre: str
    ankle_zero: str


def learn_cohort(
    cohort: str,
    people: Sequence[PersonEvidence],
    rules: Rules,
    left_out: Sequence[str] = (),
    told: Callable[[str], None] = lambda text: None,
) -> CohortPriors:
    """What people teach of the next one.

    Parameters
    ----------
    cohort : what it is called.
    people : each once; their order makes no difference.
    left_out : who did not count, and why, a line each.
    told : called at the beginning of each step.

    Raises
    ------
    InputError
        They are too few.
    """
    if len(people) < FEWEST:
        raise InputError(
            f"{len(people)} people can be learnt of; allowed: {FEWEST} or more"
            + (f" (left out: {reasons})" if (reasons := counted(left_out)) else ""),
            code=Code.PRIORS,
        )
    people = sorted(people, key=lambda p: p.name)
    folds = folds_of([p.name for p in people])
    parts = [learn_part(part, names, people, folds, told) for part, names in PARTS.items()]
    return CohortPriors(
        format=FORMAT,
        kind=KIND,
        gaitcal=package_version("gaitcal"),
        cohort=cohort,
        marker_set=rules.marker_set,
        hip_centre=rules.hip_centre,
        ankle_zero=rules.ankle_zero,
        heights_m=[float(h) for h in heights_of(people)],
        left_out=list(left_out),
        people=[
            StoredPerson(name_sha256=name_hash(cohort, p.name), recordings_sha256=sorted(p.recordings), fold=int(fold))
            for p, fold in zip(people, folds, strict=True)
        ],
        parts=[_stored(part, prior) for part, prior in zip(PARTS, parts, strict=True)],
    )


def counted(reasons: Sequence[str]) -> str:
    """Reasons, each with how many people it holds for, the most frequent first."""
    return "; ".join(f"{reason} ({count})" for reason, count in Counter(reasons).most_common())


def _stored(part: str, prior: PartPrior) -> StoredPart:
    return StoredPart(
        part=part,
        parameters=list(prior.names),
        origin=_numbers(prior_of(prior.names, None)[0]),
        unit=_lower(prior_root(prior.names, None)),
        learning=prior.learning.value,
        by_size=prior.by_size,
        wider=prior.wider,
        gain=_numbers(np.array(prior.gain)),
        populations=[_population(p) for p in prior.populations],
    )


def _population(population: Population) -> StoredPopulation:
    return StoredPopulation(
        effects=_numbers(population.effects),
        effect_covariance=_lower(population.effect_covariance),
        spread=_lower(population.spread),
    )


def _lower(matrix: Array) -> list[float]:
    return _numbers(matrix[np.tril_indices(len(matrix))])


def _numbers(values: Array) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values]


def priors_text(priors: CohortPriors) -> str:
    """The content of `priors.json`."""
    return json.dumps(priors.model_dump(), ensure_ascii=False) + "\n"


def priors_rows(priors: CohortPriors) -> Iterator[dict[str, object]]:
    """The rows of `priors.csv`, for people: mean and standard deviation of a person of middle height, in mm and deg."""
    low, high = priors.heights_m
    person = Person(height=0.5 * (low + high), sex="")
    for part in priors.parts:
        mean, covariance = expected(part, 0, person, (low, high))
        spread = np.sqrt(np.diag(covariance))
        default = prior_deviations(part.parameters)
        for name, m, sd, plain in zip(part.parameters, mean, spread, default, strict=True):
            kind = JOINT_PARAMETERS[JP_INDEX[name]].kind
            numbers = (float(value / kind.to_si) for value in (m, sd, plain))
            row = dict(zip(COLUMNS, (name, kind.unit, *(round(value, 4) for value in numbers)), strict=False))
            yield {**row, "learnt": part.learning}


def priors_words(priors: CohortPriors) -> Iterator[str]:
    """What was learnt, a line each part."""
    for part in priors.parts:
        gain, error = part.gain
        size = ", by size and sex" if part.by_size else ""
        wider = f", variances times {part.wider:g}" if part.wider > 1.0 else ""
        yield (
            f"{part.part}: {part.learning}{size}{wider} learnt of {len(priors.people)} people; people left out are "
            f"likelier by {gain:.1f} +/- {error:.1f} (log) than by the default prior"
        )
