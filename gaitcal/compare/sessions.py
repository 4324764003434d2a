"""Two sessions of one person side by side: what differs, and whether the recordings could have missed it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from gaitcal.compare.curve_differences import curve_figures, curve_table, measure_differences
from gaitcal.compare.difference import Difference, difference_table, lines_of, parameter_differences, ranked
from gaitcal.compare.stride_sets import (
    Common,
    Key,
    NotComparableError,
    Session,
    StrideSet,
    common_to,
    identity,
    stride_sets,
)
from gaitcal.gait.moments import counted
from gaitcal.model.subject_model import Subject


@dataclass(frozen=True, kw_only=True)
class SessionComparison:
    """What two sessions differ in."""

    names: tuple[str, str]  # Of A and B
    subjects: tuple[Subject, Subject]
    common: Common
    warnings: tuple[str, ...]  # What to know before any figure: refused or doubtful results, signs of another person
    notes: tuple[str, ...] = ()  # What else was done, a sentence each
    found: tuple[Difference, ...]  # Those that exceed what could be missed first, the largest of them before others
    curves: pd.DataFrame  # `curve_differences.csv`: every percent of every curve

    @property
    def differences(self) -> pd.DataFrame:
        """`differences.csv`: one row a figure."""
        return difference_table(self.found)

    @property
    def lines(self) -> tuple[str, ...]:
        """The comparison in words, warnings first."""
        return (*(f"warning: {text}" for text in self.warnings), *self.words)

    @property
    def words(self) -> tuple[str, ...]:
        """The same without warnings."""
        return (*self.notes, *lines_of(self.names, self.common, self.found))


def compare_sessions(a: Session, b: Session, common: Common | None = None) -> SessionComparison:
    """Set two sessions side by side.

    `common`: what they share, where more is known of it than their files tell: shared joints are not compared.

    Raises
    ------
    InputError
        Their thighs or shanks are of lengths that no two results of one person have.
    """
    person = identity(a, b)
    if person.denied:
        raise NotComparableError(
            f"these are not two results of one person: {'; '.join(person.denied)}", source=f"{a.name}, {b.name}"
        )
    joints_differ = common is None
    common = common or common_to(a, b)
    curves = stride_sets(a), stride_sets(b)
    found = (
        *curve_figures(*curves, common),
        *measure_differences(a, b),
        *(parameter_differences(a, b, common) if joints_differ else ()),
    )
    return SessionComparison(
        names=(a.name, b.name),
        subjects=(a.model.subject, b.model.subject),
        common=common,
        warnings=(*_verdicts(a, b), *(f"of one person? {doubt}" for doubt in person.doubts), *_kinds(a, b, curves)),
        found=ranked(found),
        curves=curve_table(*curves, common),
    )


def _verdicts(*sessions: Session) -> tuple[str, ...]:
    """Of sessions that are not trustworthy, the worst first."""
    order = {"refused": 0, "doubtful": 1}
    told = sorted((s for s in sessions if s.verdict in order), key=lambda s: order[s.verdict])
    return tuple(f"{s.name} is {s.verdict}: {'; '.join(s.reasons) or 'see its report'}" for s in told)


def _kinds(a: Session, b: Session, curves: Sequence[Mapping[Key, StrideSet]]) -> tuple[str, ...]:
    """Where angles do not mean the same, and where there is nothing to compare."""
    out = [f"{s.name}: {remark}" for s in (a, b) for remark in s.remarks]
    if twice := len(a.recordings & b.recordings):
        out.append(f"{counted(twice, 'recording')} in both: differences are smaller than those of two sessions")
    if a.relative != b.relative:
        one = a if a.relative else b
        out.append(f"joint angles of {one.name} are counted from its static posture, the other's are not")
    out += [
        f"{s.name} has no stride that is complete and straight"
        for s, found in zip((a, b), curves, strict=True)
        if not found
    ]
    return tuple(out)
