"""What became of a person, as it is kept on disk beside the results: a small file each, and the strides as Parquet.

`state/people/P01/pre.json` and `.parquet` belong to `people/P01/pre`. They are written whole when the person has ended,
so that nothing but people at work is lost, whatever ends the run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from gaitcal.codes import Code
from gaitcal.cohort.people import CohortPerson
from gaitcal.io.atomic import atomic_text
from gaitcal.io.ownership import read_object
from gaitcal.model.linkage import SIDES

STATE = "state"
AGAIN = "run the same command again: it tries this person once more"
Cell: TypeAlias = str | int | float | None
"""Of the table of people."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How one person ended."""

    name: str
    session: str
    place: str
    """Folder of the result within that of the cohort."""
    fingerprint: str
    """Of what it follows from."""
    cause: str = ""
    """Why there is no result; empty where there is one."""
    action: str = ""
    """What to do about it."""
    code: str = ""
    """Kind of the cause: `gaitcal explain` tells of it."""
    passing: bool = False
    """Whether the cause was of the moment, as a full disk, so that the next run tries again."""
    result: str = ""
    """SHA-256 by which the manifest of the result tells itself."""
    seconds: float = 0.0
    mebibytes: float = 0.0
    """Largest memory of the worker until then."""
    row: Mapping[str, Cell] = field(default_factory=dict)
    """Of the table of people."""
    reasons: Sequence[Mapping[str, str]] = ()
    """Of its verdict, the worst first: severity, cause, action."""
    curves: str = ""
    """Mean curves over the stride (`mean_curves.py`)."""
    computed: bool = True
    """Whether this run did it; False where nothing had changed."""

    @property
    def key(self) -> tuple[str, str]:
        """Name and session, by which tables are sorted."""
        return self.name, self.session

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return bool(self.cause)

    @property
    def verdict(self) -> str:
        """Of the result; `failed` where there is none."""
        return "failed" if self.failed else str(self.row.get("verdict") or "")

    @property
    def strideless(self) -> bool:
        """There are walks, and no stride of either leg counts: nothing of their gait is known."""
        return bool(self.row.get("walks")) and not any(self.row.get(f"strides_{side}") for side in SIDES)

    @property
    def first_cause(self) -> str:
        """Why it failed, or the worst reason of its verdict."""
        return self.cause or str(self.row.get("first_cause") or "")


def state_file(out: Path, place: str, ending: str) -> Path:
    """A file of the state of a person."""
    return out / STATE / f"{place}{ending}"


def keep(out: Path, outcome: Outcome) -> None:
    """Write an outcome, whole or not at all."""
    content = asdict(replace(outcome, row={**outcome.row}))
    atomic_text(
        state_file(out, outcome.place, ".json"), json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n"
    )


def forget(out: Path, place: str) -> None:
    """Remove the outcome of an earlier run, as far as the disk lets us: it no longer holds."""
    with suppress(OSError):
        state_file(out, place, ".json").unlink(missing_ok=True)


@dataclass(frozen=True)
class Outcomes:
    """What became of everyone when a run has ended."""

    out: Path
    """Folder of the cohort."""
    failed: Mapping[tuple[str, str], Outcome] = field(default_factory=dict)
    """Those without a result as the run returned them, by name and session: the disk may not have taken them."""

    def of(self, person: CohortPerson) -> Outcome:
        """As the run returned it, else as it is kept on disk; a failure where it is neither."""
        return self.failed.get(person.key) or kept(self.out, person) or _not_kept(person)


def _not_kept(person: CohortPerson) -> Outcome:
    return Outcome(
        name=person.name,
        session=person.session,
        place=person.place,
        fingerprint="",
        code=Code.WORKER.value,
        cause="what became of it was not found on disk when the tables were written",
        action=AGAIN,
        passing=True,
    )


def kept(out: Path, person: CohortPerson) -> Outcome | None:
    """The outcome of an earlier run; None where there is none that can be read."""
    content: dict[str, Any] = read_object(state_file(out, person.place, ".json"))
    try:
        return Outcome(**content)
    except TypeError:
        return None
