"""Learn priors of joint parameters from the results of a cohort (`gaitcal cohort --learn-priors`).

A calibration gives the estimate d^ of deviations d from nominal joints, with covariance C, which
contains the prior of the fit, N(m0, F F^T). In its units, x = F^-1 (d - m0), the prior is N(0, 1).
With the estimate x^ and its covariance C_x, the information S and mean m of the recordings alone
are

    S_x = C_x^-1 - 1 (without negative parts),      S_x m_x = C_x^-1 x^
    <=>      S m = C^-1 d^ - (F F^T)^-1 m0.

People are compared in units of the anatomical prior, y = G^-1 (d - a), in which x = F^-1 G y - F^-1
(m0 - a), whatever the prior of their fit.
"""

import csv
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_phases import LEG_PARAMETERS, UPPER_PARAMETERS
from gaitcal.calibration.joint_prior import (
    combine_joint_priors,
    factor_prior,
    get_prior_deviations,
    select_prior,
)
from gaitcal.cohort.cohort_people import Cohort
from gaitcal.cohort.learning import (
    FEWEST,
    PartEvidence,
    PersonEvidence,
    assign_folds,
    get_height_range,
    learn_part,
)
from gaitcal.cohort.outcome import read_outcome
from gaitcal.errors import Code, InputError
from gaitcal.io.result_folder import MANIFEST, amend_result, read_json_object
from gaitcal.io.toml import get_package_version
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES
from gaitcal.results.cycles_export import read_trial_files
from gaitcal.results.saved_result import load_result
from gaitcal.results.session_difference import list_observed_parameters
from gaitcal.results.summary import JOINT_PRIOR, SUMMARY
from gaitcal.runtime import Progress, silent
from gaitcal.study import cohort_prior
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.settings import Protocol

PRIORS, PRIORS_CSV = "priors.json", "priors.csv"
COLUMNS = ("name", "unit", "mean", "sd", "default_sd", "learnt")
DIGITS = 9
TRUSTED = "trustworthy"
PARTS = {"legs": LEG_PARAMETERS, "trunk and arms": UPPER_PARAMETERS}
"""Joint parameters that are fitted together, and so learnt together."""
RANK = 1e-9
"""Part of the largest eigenvalue of C below which C is singular."""


class NotUsedError(Exception):
    """Why a result cannot be used."""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What nominal joints depend on; equal in all people to learn from and to use it for."""

    marker_set: str
    hip_centre: str
    ankle_zero: str


@dataclass(frozen=True)
class SessionEvidence:
    """One session of one person, and the rules of its calibration."""

    evidence: PersonEvidence
    rules: Rules


def learn_priors(cohort: Cohort, out: Path, progress: Progress = silent) -> Sequence[str]:
    """Learn priors from the results of a cohort, and write `priors.json` and `priors.csv`.

    Parameters
    ----------
    cohort : Cohort
        The people.
    out : Path
        Folder of the cohort, with their results.
    progress : callable
        Called with a line of text at the beginning of each step.

    Returns
    -------
    sequence of str
        What was learnt and which results were not used, a line each.

    Raises
    ------
    InputError
        Too few people.
    """
    found, left_out = list[SessionEvidence](), list[str]()
    for person in cohort.people:
        # Only finished, trustworthy results; the reason for every other one is reported.
        outcome = read_outcome(out, person)
        try:
            if outcome is None or outcome.failed:
                raise NotUsedError("it has no result")
            found.append(read_evidence(out / person.subfolder, person.name))
        except (NotUsedError, InputError) as reason:
            left_out.append(f"{person.label}: {str(reason).replace(f'{out}/', '')}")
    people, rules, others = select_sessions(found)
    left_out += others
    reasons = [line.split(": ", 1)[1] for line in left_out]
    if rules is None:
        message = f"no result can be used to learn priors: {_count_reasons(reasons)}"
        raise InputError(message, source=out, code=Code.PRIORS)
    priors = learn_cohort(
        cohort.source.resolve().name or "cohort", people, rules, reasons, progress
    )
    with amend_result(out) as stage:
        (stage / PRIORS).write_text(format_priors(priors), encoding="utf-8")
        with (stage / PRIORS_CSV).open("w", encoding="utf-8", newline="") as stream:
            table = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(list_prior_rows(priors))
    return (*describe_priors(priors), *(f"not used: {line}" for line in left_out))


def read_evidence(folder: Path, name: str) -> SessionEvidence:
    """Read the likelihood of joint parameters from a result folder of `gaitcal calibrate`.

    `folder`: the result. `name`: of the person. Raises NotUsedError: its verdict is not
    "trustworthy", it was calibrated with priors of a cohort, or its joint parameters were not
    calibrated by the default protocol. Raises InputError: it is damaged.
    """
    summary, manifest = read_json_object(folder / SUMMARY), read_json_object(folder / MANIFEST)
    verdict = summary.get("verdict")
    if verdict != TRUSTED:
        raise NotUsedError(f"its verdict is {verdict}")
    # A result that leans on a cohort would count that cohort twice.
    if JOINT_PRIOR in summary:
        raise NotUsedError("it was calibrated with priors of a cohort")
    saved = load_result(folder)
    settings, subject, errors = saved.settings, saved.model.subject, saved.uncertainty.joint
    parts = None
    if errors is not None and settings.decided_by is Protocol.EVIDENCE and settings.jp:
        # m and rad, deviations from the nominal joints.
        deviation = saved.model.parameters.joint - saved.model.nominal.joint
        parts = compute_part_evidence(
            errors, deviation, JP_NAMES, combine_joint_priors(settings.joint_prior)
        )
    if parts is None:
        raise NotUsedError("its joint parameters were not calibrated by the default protocol")
    hashes = manifest.get("inputs_sha256")
    files = (files.get("file", "") for files in read_trial_files(folder).values())
    recordings = frozenset(
        str(hashes[file]) for file in files if isinstance(hashes, dict) and file in hashes
    )
    person = cohort_prior.Person(height=subject.height, sex=subject.sex)
    marker_set = str(manifest.get("marker_set") or "")
    return SessionEvidence(
        PersonEvidence(name=name, person=person, recordings=recordings, parts=parts),
        Rules(marker_set=marker_set, hip_centre=settings.hip_rule, ankle_zero=settings.ankle_rule),
    )


def compute_part_evidence(
    errors: ErrorSources, deviation: Array, names: tuple[str, ...], prior: JointPrior | None
) -> dict[str, PartEvidence] | None:
    """Compute the likelihood of the joint parameters of every part of the body.

    `errors`: of joint parameters; those that no trial moved have no information. `deviation`: (98,)
    m, rad: fitted minus nominal, in the order of `names`. `names`: all joint parameters. `prior`:
    of the calibration; the anatomical prior if not given. Returns: part -> likelihood; None if the
    covariance of the errors is singular.
    """
    out, observed = {}, set(list_observed_parameters(errors))
    for part, wanted in PARTS.items():
        free = [name for name in wanted if name in observed]
        information, right = np.zeros((len(wanted),) * 2), np.zeros(len(wanted))
        if free:
            mean, root = select_prior(free, prior)[0], factor_prior(free, prior)
            # In units of the prior: C_x = R R^T is then at most the identity.
            rows = np.linalg.solve(
                root, errors.effects[[errors.names.index(name) for name in free]]
            )
            values, vectors = np.linalg.eigh(rows @ rows.T)
            # A singular covariance has no likelihood.
            if values[0] <= RANK * values[-1]:
                return None
            estimate = vectors.T @ np.linalg.solve(
                root, deviation[[names.index(name) for name in free]] - mean
            )
            # C_x and S_x have the same eigenvectors: information of the recordings along each.
            added = np.maximum(1.0 / values - 1.0, 0.0)
            # From units of the prior of the fit to those of the anatomical prior.
            chosen = [wanted.index(name) for name in free]
            basis = vectors.T @ np.linalg.solve(root, factor_prior(wanted, None)[chosen])
            shift = vectors.T @ np.linalg.solve(root, mean - select_prior(free, None)[0])
            information = (basis.T * added) @ basis
            right = basis.T @ (np.where(added > 0.0, estimate / values, 0.0) + added * shift)
        out[part] = PartEvidence(information=information, right=right)
    return out


def select_sessions(
    found: Sequence[SessionEvidence],
) -> tuple[list[PersonEvidence], Rules | None, list[str]]:
    """Select one session of each person, with the rules that most people have.

    Returns: `people` each person's session with the most information; with the recordings of all
    sessions, by which a person is recognised; `rules` None without sessions; `others` people who
    have other rules, a line each.
    """
    by_rules: dict[Rules, list[PersonEvidence]] = {}
    for one in found:
        by_rules.setdefault(one.rules, []).append(one.evidence)
    if not by_rules:
        return [], None, []

    def count_people(rules: Rules) -> int:
        return len({person.name for person in by_rules[rules]})

    # Deviations by different rules have different zeros: one set of rules only. The second key
    # makes ties reproducible.
    rules = max(by_rules, key=lambda r: (count_people(r), astuple(r)))
    used = {p.name for p in by_rules[rules]}
    people = []
    for name in sorted(used):
        # Sessions of one person are not independent: the one with the most information counts.
        best = max((p for p in by_rules[rules] if p.name == name), key=lambda p: p.information_gain)
        sessions = (one.evidence.recordings for one in found if one.evidence.name == name)
        people.append(replace(best, recordings=frozenset().union(*sessions)))
    others = sorted({one.evidence.name for one in found} - used)
    return (
        people,
        rules,
        [f"{name}: other marker set, hip rule or ankle zero than most" for name in others],
    )


def learn_cohort(
    cohort: str,
    people: Sequence[PersonEvidence],
    rules: Rules,
    left_out: Sequence[str] = (),
    progress: Progress = silent,
) -> cohort_prior.CohortPriors:
    """Learn the priors of all parts of the body.

    `cohort`: its name. `people`: each person once; their order makes no difference. `left_out`:
    reasons for which results were not used, one for each. `progress`: called with a line of text at
    the beginning of each step. Raises InputError: too few people.
    """
    if len(people) < FEWEST:
        others = f" (not used: {_count_reasons(left_out)})" if left_out else ""
        message = f"found {len(people)} people to learn from; allowed: {FEWEST} or more{others}"
        raise InputError(message, code=Code.PRIORS)
    # The order of people must not change the result.
    people = sorted(people, key=lambda p: p.name)
    folds = assign_folds([p.name for p in people])
    parts = []
    for part, names in PARTS.items():
        prior = learn_part(part, names, people, folds, progress)
        populations = [
            cohort_prior.StoredPopulation(
                effects=_list_numbers(population.effects),
                effect_covariance=_list_lower(population.effect_covariance),
                spread=_list_lower(population.spread),
            )
            for population in prior.populations
        ]
        parts.append(
            cohort_prior.StoredPart(
                part=part,
                parameters=list(names),
                origin=_list_numbers(select_prior(names, None)[0]),
                unit=_list_lower(factor_prior(names, None)),
                learning=prior.learning.value,
                by_size=prior.by_size,
                wider=prior.wider,
                gain=_list_numbers(np.array(prior.gain)),
                populations=populations,
            )
        )
    return cohort_prior.CohortPriors(
        format=cohort_prior.FORMAT,
        kind=cohort_prior.KIND,
        gaitcal=get_package_version("gaitcal"),
        cohort=cohort,
        marker_set=rules.marker_set,
        hip_centre=rules.hip_centre,
        ankle_zero=rules.ankle_zero,
        heights_m=[float(h) for h in get_height_range(people)],
        left_out=list(left_out),
        people=[
            cohort_prior.StoredPerson(
                name_sha256=cohort_prior.hash_name(cohort, p.name),
                recordings_sha256=sorted(p.recordings),
                fold=int(fold),
            )
            for p, fold in zip(people, folds, strict=True)
        ],
        parts=parts,
    )


def _count_reasons(reasons: Sequence[str]) -> str:
    """List reasons with the number of results that each applies to, the most frequent first."""
    return "; ".join(f"{reason} ({count})" for reason, count in Counter(reasons).most_common())


def _list_lower(matrix: Array) -> list[float]:
    """List the lower triangle of a matrix, row by row."""
    return _list_numbers(matrix[np.tril_indices(len(matrix))])


def _list_numbers(values: Array) -> list[float]:
    """List numbers with `DIGITS` digits."""
    return [float(f"{value:.{DIGITS}g}") for value in values]


def format_priors(priors: cohort_prior.CohortPriors) -> str:
    """Format priors as the content of `priors.json`."""
    return json.dumps(priors.model_dump(), ensure_ascii=False) + "\n"


def list_prior_rows(priors: cohort_prior.CohortPriors) -> Iterator[dict[str, object]]:
    """List the rows of `priors.csv`, for readers.

    `priors`: from `learn_cohort`. Yields: columns `COLUMNS`: mean and standard deviation of a
    person of middle height, mm and deg.
    """
    low, high = priors.heights_m
    person = cohort_prior.Person(height=0.5 * (low + high), sex="")
    for part in priors.parts:
        mean, covariance = cohort_prior.compute_expected_deviations(part, 0, person, (low, high))
        spread, default = np.sqrt(np.diag(covariance)), get_prior_deviations(part.parameters)
        for name, *values in zip(part.parameters, mean, spread, default, strict=True):
            kind = JOINT_PARAMETERS[JP_INDEX[name]].kind
            numbers = (round(float(value / kind.to_si), 4) for value in values)
            yield dict(zip(COLUMNS, (name, kind.unit, *numbers, part.learning), strict=True))


def describe_priors(priors: cohort_prior.CohortPriors) -> Iterator[str]:
    """Describe what was learnt, a line for each part of the body."""
    for part in priors.parts:
        gain, error = part.gain
        size = ", by size and sex" if part.by_size else ""
        wider = f", variances times {part.wider:g}" if part.wider > 1.0 else ""
        yield (
            f"{part.part}: {part.learning}{size}{wider} learnt from {len(priors.people)} people; "
            f"log likelihood of people left out {gain:.1f} +/- {error:.1f} above that of the "
            "default prior"
        )
