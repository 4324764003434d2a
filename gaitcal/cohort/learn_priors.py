"""`gaitcal cohort --learn-priors`: what all people of a cohort say of the next one.

A calibration says of deviations d from nominal joints the estimate d^ with covariance C, in which
the prior of the fit, N(m0, F F^T), counts already. In its units, x = F^-1 (d - m0), that is N(0,
1), and with x^ and its covariance C_x what the recordings alone say is

    S_x = C_x^-1 - 1 (nothing of it negative),      S_x m_x = C_x^-1 x^      <=>      S m = C^-1 d^ - (F F^T)^-1 m0,

m being where they alone would have it. People are compared in units of anatomy's prior, y = G^-1 (d
- a), in which x = F^-1 G y - F^-1 (m0 - a), whatever prior their fit had.
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
    factor_prior,
    get_prior_deviations,
    make_study_prior,
    select_prior,
)
from gaitcal.cohort.cohort_people import Cohort
from gaitcal.cohort.learning import (
    FEWEST,
    PartEvidence,
    PersonEvidence,
    folds_of,
    heights_of,
    learn_part,
)
from gaitcal.cohort.outcome import kept
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
from gaitcal.study.settings import Protocol

PRIORS, PRIORS_CSV = "priors.json", "priors.csv"
COLUMNS = ("name", "unit", "mean", "sd", "default_sd", "learnt")
DIGITS = 9
TRUSTED = "trustworthy"
PARTS = {"legs": LEG_PARAMETERS, "trunk and arms": UPPER_PARAMETERS}
"""Joint parameters that are fitted together, and so learnt together."""
RANK = 1e-9  # Part of the largest eigenvalue of C below which a direction would be known exactly


class NotUsedError(Exception):
    """Why a result teaches nothing, in words."""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What nominal joints depend on: the same in everybody that is learnt of, and in whom it is
    used for.
    """

    marker_set: str
    hip_centre: str
    ankle_zero: str


@dataclass(frozen=True)
class Found:
    """One session of one person, and by which rules it was calibrated."""

    evidence: PersonEvidence
    rules: Rules


def learn_priors(cohort: Cohort, out: Path, progress: Progress = silent) -> Sequence[str]:
    """Learn of the results in the folder of a cohort, and write `priors.json` and `priors.csv` into
    it.

    Returns what was learnt and who did not count, a line each.

    Raises InputError: Fewer people than can be learnt of.
    """
    found, left_out = list[Found](), list[str]()
    for person in cohort.people:
        outcome = kept(out, person)
        try:
            if outcome is None or outcome.failed:
                raise NotUsedError("it has no result")
            found.append(evidence_of(out / person.place, person.name))
        except (NotUsedError, InputError) as reason:
            left_out.append(f"{person.words}: {str(reason).replace(f'{out}/', '')}")
    people, rules, others = one_each(found)
    left_out += others
    reasons = [line.split(": ", 1)[1] for line in left_out]
    if rules is None:
        message = f"nobody's joint parameters can be learnt of: {_counted(reasons)}"
        raise InputError(message, source=out, code=Code.PRIORS)
    priors = learn_cohort(
        cohort.source.resolve().name or "cohort", people, rules, reasons, progress
    )
    with amend_result(out) as stage:
        (stage / PRIORS).write_text(priors_text(priors), encoding="utf-8")
        with (stage / PRIORS_CSV).open("w", encoding="utf-8", newline="") as stream:
            table = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(priors_rows(priors))
    return (*priors_words(priors), *(f"not learnt of: {line}" for line in left_out))


def evidence_of(folder: Path, name: str) -> Found:
    """What a result folder of `gaitcal calibrate` says.

    Raises NotUsedError: Its verdict is not "trustworthy", it leans on a cohort itself, or its joint
    parameters were not calibrated by the evidence. Raises InputError: It is damaged.
    """
    summary, manifest = read_json_object(folder / SUMMARY), read_json_object(folder / MANIFEST)
    if (verdict := summary.get("verdict")) != TRUSTED:
        raise NotUsedError(f"its verdict is {verdict}")
    if JOINT_PRIOR in summary:
        raise NotUsedError("it was calibrated with priors of a cohort itself")
    saved = load_result(folder)
    settings, subject, errors = saved.settings, saved.model.subject, saved.uncertainty.joint
    parts = None
    if errors is not None and settings.decided_by is Protocol.EVIDENCE and settings.jp:
        deviation = saved.model.parameters.joint - saved.model.nominal.joint
        parts = parts_of(errors, deviation, JP_NAMES, make_study_prior(settings.joint_prior))
    if parts is None:
        raise NotUsedError("its joint parameters were not calibrated by the evidence of all trials")
    hashes = manifest.get("inputs_sha256")
    files = (files.get("file", "") for files in read_trial_files(folder).values())
    recordings = frozenset(
        str(hashes[file]) for file in files if isinstance(hashes, dict) and file in hashes
    )
    person = cohort_prior.Person(height=subject.height, sex=subject.sex)
    marker_set = str(manifest.get("marker_set") or "")
    return Found(
        PersonEvidence(name=name, person=person, recordings=recordings, parts=parts),
        Rules(marker_set=marker_set, hip_centre=settings.hip_rule, ankle_zero=settings.ankle_rule),
    )


def parts_of(
    errors: ErrorSources,
    deviation: Array,
    names: tuple[str, ...],
    prior: cohort_prior.JointPrior | None,
) -> dict[str, PartEvidence] | None:
    """What a calibration says of every part of the body; None where its errors are no covariance of
    rank.

    `errors`: of joint parameters by source; those that no trial moved tell nothing.
    `deviation`: (98,) m, rad: fitted minus nominal, in the order of `names`.
    `prior`: of the calibration; anatomy's unless given.
    """
    out, moved_by_trials = {}, set(list_observed_parameters(errors))
    for part, wanted in PARTS.items():
        free = [name for name in wanted if name in moved_by_trials]
        information, right = np.zeros((len(wanted),) * 2), np.zeros(len(wanted))
        if free:
            mean, root = select_prior(free, prior)[0], factor_prior(free, prior)
            rows = np.linalg.solve(
                root, errors.parameters[[errors.free.index(name) for name in free]]
            )
            values, vectors = np.linalg.eigh(rows @ rows.T)
            if values[0] <= RANK * values[-1]:
                return None
            estimate = vectors.T @ np.linalg.solve(
                root, deviation[[names.index(name) for name in free]] - mean
            )
            # eigenvectors of C_x are those of S_x: what the recordings add along each
            added = np.maximum(1.0 / values - 1.0, 0.0)
            # from units of the fit's prior to those of anatomy's
            chosen = [wanted.index(name) for name in free]
            turned = vectors.T @ np.linalg.solve(root, factor_prior(wanted, None)[chosen])
            moved = vectors.T @ np.linalg.solve(root, mean - select_prior(free, None)[0])
            information = (turned.T * added) @ turned
            right = turned.T @ (np.where(added > 0.0, estimate / values, 0.0) + added * moved)
        out[part] = PartEvidence(information=information, right=right)
    return out


def one_each(found: Sequence[Found]) -> tuple[list[PersonEvidence], Rules | None, list[str]]:
    """Each person once, from the session that tells most; the rules that most have; and who has
    others.

    Recordings of all sessions of a person are kept, by which they are recognised.
    """
    by_rules: dict[Rules, list[PersonEvidence]] = {}
    for one in found:
        by_rules.setdefault(one.rules, []).append(one.evidence)
    if not by_rules:
        return [], None, []
    rules = max(by_rules, key=lambda r: (len({p.name for p in by_rules[r]}), astuple(r)))
    used = {p.name for p in by_rules[rules]}
    people = []
    for name in sorted(used):
        best = max((p for p in by_rules[rules] if p.name == name), key=lambda p: p.seen)
        every = frozenset().union(
            *(one.evidence.recordings for one in found if one.evidence.name == name)
        )
        people.append(replace(best, recordings=every))
    others = sorted({one.evidence.name for one in found} - used)
    return (
        people,
        rules,
        [f"{name}: other markers, nominal hips or ankle zeros than most" for name in others],
    )


def learn_cohort(
    cohort: str,
    people: Sequence[PersonEvidence],
    rules: Rules,
    left_out: Sequence[str] = (),
    progress: Progress = silent,
) -> cohort_prior.CohortPriors:
    """What people teach of the next one.

    Parameters
    ----------
    cohort
        What it is called.
    people
        Each once; their order makes no difference.
    left_out
        Who did not count, and why, a line each.
    progress
        Called at the beginning of each step.

    Raises InputError: They are too few.
    """
    if len(people) < FEWEST:
        others = f" (left out: {_counted(left_out)})" if left_out else ""
        message = f"{len(people)} people can be learnt of; allowed: {FEWEST} or more{others}"
        raise InputError(message, code=Code.PRIORS)
    people = sorted(people, key=lambda p: p.name)
    folds = folds_of([p.name for p in people])
    parts = []
    for part, names in PARTS.items():
        prior = learn_part(part, names, people, folds, progress)
        populations = [
            cohort_prior.StoredPopulation(
                effects=_numbers(population.effects),
                effect_covariance=_lower(population.effect_covariance),
                spread=_lower(population.spread),
            )
            for population in prior.populations
        ]
        parts.append(
            cohort_prior.StoredPart(
                part=part,
                parameters=list(names),
                origin=_numbers(select_prior(names, None)[0]),
                unit=_lower(factor_prior(names, None)),
                learning=prior.learning.value,
                by_size=prior.by_size,
                wider=prior.wider,
                gain=_numbers(np.array(prior.gain)),
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
        heights_m=[float(h) for h in heights_of(people)],
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


def _counted(reasons: Sequence[str]) -> str:
    """Reasons, each with how many people it holds for, the most frequent first."""
    return "; ".join(f"{reason} ({count})" for reason, count in Counter(reasons).most_common())


def _lower(matrix: Array) -> list[float]:
    return _numbers(matrix[np.tril_indices(len(matrix))])


def _numbers(values: Array) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values]


def priors_text(priors: cohort_prior.CohortPriors) -> str:
    """The content of `priors.json`."""
    return json.dumps(priors.model_dump(), ensure_ascii=False) + "\n"


def priors_rows(priors: cohort_prior.CohortPriors) -> Iterator[dict[str, object]]:
    """The rows of `priors.csv`, for people: mean and standard deviation of a person of middle
    height, in mm and deg.
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


def priors_words(priors: cohort_prior.CohortPriors) -> Iterator[str]:
    """What was learnt, a line each part."""
    for part in priors.parts:
        gain, error = part.gain
        size = ", by size and sex" if part.by_size else ""
        wider = f", variances times {part.wider:g}" if part.wider > 1.0 else ""
        yield (
            f"{part.part}: {part.learning}{size}{wider} learnt of {len(priors.people)} people; "
            "people left out are "
            f"likelier by {gain:.1f} +/- {error:.1f} (log) than by the default prior"
        )
