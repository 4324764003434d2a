"""`gaitcal cohort --learn-priors`: what all people of a cohort say of the next one."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

from gaitcal.codes import Code
from gaitcal.cohort.cohort_priors import COLUMNS, counted, learn_cohort, priors_rows, priors_text, priors_words
from gaitcal.cohort.outcome import kept
from gaitcal.cohort.people import Cohort
from gaitcal.cohort.result_evidence import Found, NotUsedError, evidence_of, one_each
from gaitcal.errors import InputError
from gaitcal.io.result_folder import amended

PRIORS, PRIORS_CSV = "priors.json", "priors.csv"


def learn_priors(cohort: Cohort, out: Path, told: Callable[[str], None] = lambda text: None) -> Sequence[str]:
    """Learn of the results in the folder of a cohort, and write `priors.json` and `priors.csv` into it.

    Returns what was learnt and who did not count, a line each.

    Raises
    ------
    InputError
        Fewer people than can be learnt of.
    """
    found, left_out = list[Found](), list[str]()
    for person in cohort.people:
        outcome = kept(out, person)
        if outcome is None or outcome.failed:
            left_out.append(f"{person.words}: it has no result")
            continue
        try:
            found.append(evidence_of(out / person.place, person.name))
        except NotUsedError as reason:
            left_out.append(f"{person.words}: {reason}")
        except InputError as fault:
            left_out.append(f"{person.words}: {str(fault).replace(f'{out}/', '')}")
    people, rules, others = one_each(found)
    left_out += others
    reasons = [line.split(": ", 1)[1] for line in left_out]
    if rules is None:
        raise InputError(
            f"nobody's joint parameters can be learnt of: {counted(reasons)}", source=out, code=Code.PRIORS
        )
    name = cohort.source.resolve().name or "cohort"
    priors = learn_cohort(name, people, rules, reasons, told)
    with amended(out) as stage:
        (stage / PRIORS).write_text(priors_text(priors), encoding="utf-8")
        with (stage / PRIORS_CSV).open("w", encoding="utf-8", newline="") as stream:
            table = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(priors_rows(priors))
    return (*priors_words(priors), *(f"not learnt of: {line}" for line in left_out))
