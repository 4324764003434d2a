"""Recordings of one person, each a result of its own: do they differ by as much as their error bars say?

Joint parameters: straight against turn of each child, walk against walk of one person; all on one static trial each.
Curves: walk against walk, how strides vary being taken from one calibration of all walks, so that what calibrations
differ by is not in it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaitcal import InputError, Study, calibrate, write_results
from gaitcal.arrays import Array
from gaitcal.checks import check_study
from gaitcal.commands.console import Talk
from gaitcal.commands.init import options_of, study_or_draft
from gaitcal.compare.difference import Difference
from gaitcal.compare.difference_error import pooled, shared_variance
from gaitcal.compare.parameter_differences import parameter_differences
from gaitcal.compare.session import Session, common_to
from gaitcal.compare.stride_sets import mean_over, stride_sets
from gaitcal.gait.variables import Kind, kind_of
from gaitcal.intake.draft_text import study_of
from gaitcal.results.sessions import load_session
from gaitcal.study.study_trial import Role
from sessions.coverage import coverage

ALL = "all"
"""Name of the result of all walks together."""


@dataclass(frozen=True)
class Person:
    """One person's results, a walk each."""

    name: str
    walks: tuple[Session, ...]
    together: Session | None
    """All walks in one calibration; None where there are but two, of two kinds."""


def person(folder: Path, out: Path) -> Person:
    """Calibrate every walk of a folder of recordings by itself; what lies in `out` already is read."""
    talk = Talk(quiet=True, verbose=False)
    source = study_or_draft(folder, options_of(None, None, "male", None), talk)  # no file of these says it
    study = Study.load(source) if isinstance(source, Path) else study_of(source)
    several = len(study.walks) > 2
    found = {}
    for name in (*study.walks, *([ALL] if several else [])):
        chosen = [t for t in study.trials if t.role is Role.STATIC or name in (t.name, ALL)]
        result = out / folder.name / name
        if not (result / "manifest.json").exists():
            one = replace(study, trials=tuple(chosen))
            write_results(calibrate(one, checked=check_study(one)), result)
        found[name] = load_session(result)[0]
    together = found.pop(ALL, None)
    return Person(folder.name, tuple(found.values()), together)


def pairs(of: Person) -> Iterator[tuple[Session, Session]]:
    """Every two walks."""
    yield from itertools.combinations(of.walks, 2)


def parameter_scores(of: Person) -> tuple[Array, Array]:
    """Differences in standard errors: of the legs' joint parameters, and of trunk and arms."""
    found: list[Difference] = []
    for a, b in pairs(of):
        found += parameter_differences(a, b, common_to(a, b))
    scores = [[d.difference / d.se for d in found if d.beyond_legs is upper and d.se > 0.0] for upper in (False, True)]
    return np.array(scores[0]), np.array(scores[1])


def curve_scores(of: Person) -> dict[Kind, Array]:
    """Kind -> differences of the curves of two walks in standard errors, every tenth percent."""
    if of.together is None:
        return {}
    alone = {key: pooled([s.values]) for key, s in stride_sets(of.together).items()}
    spread = {key: np.where(found.freedom > 1, found.variance, np.nan) for key, found in alone.items()}
    sets = {session.name: stride_sets(session) for session in of.walks}
    out: dict[Kind, list[Array]] = {}
    for a, b in pairs(of):
        one, other = sets[a.name], sets[b.name]
        for key in (key for key in one if key in other and key in spread):
            means = [mean_over(s[key].values) for s in (one, other)]
            c = [(mean_over(s[key].shared), mean_over(s[key].frames)) for s in (one, other)]
            shared = shared_variance(common_to(a, b), (c[0][0], c[1][0]), (c[0][1], c[1][1]))
            counts = [np.maximum(np.isfinite(s[key].values).sum(axis=0), 1) for s in (one, other)]
            variance = spread[key] * (1.0 / counts[0] + 1.0 / counts[1]) + np.nan_to_num(shared)
            with np.errstate(invalid="ignore", divide="ignore"):
                z = ((means[1] - means[0]) / np.sqrt(variance))[::10]
            out.setdefault(kind_of(key[1]), []).append(z[np.isfinite(z)])
    return {kind: np.concatenate(parts) for kind, parts in out.items()}


def report(data: Path, out: Path) -> Iterator[str]:
    """Lines, person by person, and over all children."""
    legs: list[Array] = []
    folders = [*sorted((data / "children").iterdir()), data / "labs_c3d" / "multi"]
    for folder in folders:
        try:
            of = person(folder, out)
        except InputError as error:
            yield f"{folder.name}: {error}"
            continue
        scores, upper = parameter_scores(of)
        yield f"{of.name}: joint parameters of the legs: {coverage(scores)}"
        if len(upper):
            yield f"{of.name}: of trunk and arms: {coverage(upper)}"
        for kind, z in curve_scores(of).items():
            yield f"{of.name}: {kind.words}s: {coverage(z)}"
        if folder.parent.name == "children":
            legs.append(scores)
    if legs:
        yield f"straight against turn, all children: joint parameters of the legs: {coverage(np.concatenate(legs))}"
