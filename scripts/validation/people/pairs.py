"""Two recordings of one person, calibrated each by itself: do their joints differ by as much as their error bars say?

A straight walk against a turn, the first walks of a session against the last, the first strides of a long walk against
the last, one walk against another. The two share the static trial, and the errors that come with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gaitcal import Study
from gaitcal.arrays import Array
from gaitcal.compare.difference import difference_variance, told_parameters
from gaitcal.compare.stride_sets import Common
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.parameters import JP_INDEX
from gaitcal.study.study_trial import Role, Trial
from scripts.validation.error_bars import coverage, shares
from scripts.validation.people.fits import Fit, fitted
from scripts.validation.recordings import CHILDREN, changed, only, study_of_person

LONG_S = 3.0
"""A walk that lasts longer is cut in two, of a stride or more each."""
SESSION = 4
"""Walks from which a session is cut in two."""


@dataclass(frozen=True, kw_only=True)
class Pair:
    kind: str
    person: str
    first: Study
    last: Study


def pairs_of(person: str, study: Study) -> Iterator[Pair]:
    walks, half = study.walks, len(study.walks) // 2
    if person in CHILDREN:
        chosen = [("straight against turn", ("straight",), ("turn",))]
    else:
        chosen = [("walk against walk", (one,), (other,)) for one, other in combinations(walks, 2)]
    if len(walks) >= SESSION:
        chosen.append(("first walks against last", walks[:half], walks[half:]))
    for kind, first, last in chosen:
        yield Pair(kind=kind, person=person, first=only(study, *first), last=only(study, *last))
    for walk in walks:
        alone = only(study, walk)
        (time,) = (t.recording.time for t in alone.moving)
        if time[-1] - time[0] >= LONG_S:
            middle = 0.5 * (time[0] + time[-1])
            begun, ended = (_between(alone, *span) for span in ((time[0], middle), (middle, time[-1])))
            yield Pair(kind="first strides against last", person=person, first=begun, last=ended)


def _between(study: Study, begin: float, end: float) -> Study:
    """The same with moving trials cut, without force plates."""

    def cut(trial: Trial) -> Trial:
        if trial.role is Role.STATIC:
            return trial
        inside = (trial.recording.time >= begin) & (trial.recording.time <= end)
        return replace(trial, recording=replace(trial.recording.frames(inside), plates=()))

    return replace(study, trials=tuple(cut(trial) for trial in study.trials))


def scores(one: Fit, other: Fit) -> Array:
    """Differences of the legs' joint parameters that both fitted, in standard errors of the difference."""
    both = set(told_parameters(other.influence))
    names = [n for n in told_parameters(one.influence) if n in both and n.startswith(LEG_JOINTS)]
    gap = (other.parameters.joint - one.parameters.joint)[[JP_INDEX[n] for n in names]]
    variance = difference_variance((one.influence, other.influence), names, Common.STATIC)
    return np.asarray((gap / np.sqrt(variance))[variance > 0.0])


def every_score(people: Sequence[str], settings: Mapping[str, object]) -> dict[tuple[str, str], Array]:
    """(kind, person) -> differences in standard errors."""
    out: dict[tuple[str, str], list[Array]] = {}
    for person in people:
        fits: dict[tuple[object, ...], Fit] = {}
        for pair in pairs_of(person, changed(study_of_person(person), settings)):
            keys = [tuple(id(t.recording) for t in study.moving) for study in (pair.first, pair.last)]
            for key, study in zip(keys, (pair.first, pair.last), strict=True):
                fits[key] = fits.get(key) or fitted(person, study)
            out.setdefault((pair.kind, person), []).append(scores(fits[keys[0]], fits[keys[1]]))
    return {key: np.concatenate(found) for key, found in out.items()}


def lines(found: Mapping[tuple[str, str], Array]) -> Iterator[str]:
    for kind in dict.fromkeys(kind for kind, _ in found):
        yield f"{kind}: joint parameters of the legs"
        of = {person: z for (k, person), z in found.items() if k == kind}
        yield from (f"  {person:12}{coverage(z)}" for person, z in of.items())
        yield f"  {'all':12}{coverage(np.concatenate(list(of.values())))}"


def figures(found: Mapping[tuple[str, str], Array]) -> dict[str, float]:
    """% of the differences of each kind inside bars of 68 and 95 %."""
    out = {}
    for kind in dict.fromkeys(kind for kind, _ in found):
        within = shares(np.concatenate([z for (k, _), z in found.items() if k == kind]))
        out |= {f"{kind}, {p} %": share for p, share in zip((68, 95), within, strict=True)}
    return out
