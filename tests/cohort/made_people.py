"""Made-up people of cohorts: with evidence of a known population, or as they are kept on disk
without calibration.
"""

import base64
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gaitcal.cohort.cohort_page import PAGE
from gaitcal.cohort.cohort_people import CohortPerson
from gaitcal.cohort.learn_priors import PARTS
from gaitcal.cohort.learning import PartEvidence, PersonEvidence
from gaitcal.cohort.one_person import SHAPE, CommonSettings
from gaitcal.cohort.outcome import STRIDES, Outcome, Outcomes, get_state_path, write_outcome
from gaitcal.cohort.run_cohort import mark_as_cohort, write_tables
from gaitcal.report.page.plain_data import GAP
from gaitcal.study.cohort_prior import Person

Array = NDArray[np.float64]
NAMES = PARTS["legs"]
KNEES = tuple(name for name in NAMES if name.startswith("knee"))


def make_evidence(deviation: Array, information: Array, rng: np.random.Generator) -> PartEvidence:
    """What recordings of so much information say of a deviation."""
    values, vectors = np.linalg.eigh(information)
    noise = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=len(values)))
    return PartEvidence(information=information, right=information @ deviation + noise)


def some_information(rng: np.random.Generator, size: int, unseen: int = 0) -> Array:
    """A random information matrix with so many directions that nothing is known of."""
    vectors = np.linalg.qr(rng.normal(size=(size, size)))[0]
    values = np.concatenate([np.zeros(unseen), rng.uniform(2.0, 50.0, size - unseen)])
    return (vectors * values) @ vectors.T


def people(
    count: int,
    draw: Callable[[np.random.Generator, Person], Array],
    rng: np.random.Generator,
    *,
    scale: float = 1.0,
) -> list[PersonEvidence]:
    """People with evidence of legs alone, the same of everybody in kind; `draw`: deviations of a
    person.
    """
    size, upper = len(NAMES), len(PARTS["trunk and arms"])
    shown = scale * some_information(np.random.default_rng(7), size)
    nothing = PartEvidence(information=np.zeros((upper, upper)), right=np.zeros(upper))
    out = []
    for number in range(count):
        person = Person(height=float(rng.uniform(1.5, 1.9)), sex="male" if number % 2 else "female")
        legs = make_evidence(draw(rng, person), shown, rng)
        out.append(
            PersonEvidence(
                name=f"P{number:03d}",
                person=person,
                recordings=frozenset({f"file {number}"}),
                parts={"legs": legs, "trunk and arms": nothing},
            )
        )
    return out


KNEE = ("warning", "the knee axis passes far from the epicondyles", "look at the static trial")
FORCES = ("error", "the forces do not fit the motion", "look at the plates")


@dataclass(frozen=True, kw_only=True)
class Kept:
    """One person."""

    name: str
    session: str = ""
    group: str = ""
    verdict: str = "trustworthy"
    reasons: tuple[tuple[str, str, str], ...] = ()
    cause: str = ""
    """Why there is no result."""
    row: dict[str, Any] = field(default_factory=dict)
    curves: tuple[int | None, int | None] = (100, 200)
    """Height, in packed steps, of every curve of the right and the left leg; None: not known."""

    @property
    def person(self) -> CohortPerson:
        return CohortPerson(
            folder=Path("/lab") / "x", name=self.name, session=self.session, group=self.group
        )

    @property
    def outcome(self) -> Outcome:
        person = self.person
        ids = {
            "name": self.name,
            "session": self.session,
            "place": person.subfolder,
            "fingerprint": "1",
        }
        if self.cause:
            return Outcome(**ids, cause=self.cause, action="record it again")
        row = {
            "person": self.name,
            "session": self.session,
            "folder": person.subfolder,
            "mass_kg": 60.0,
            "height_m": 1.7,
        }
        row |= {"page": f"{person.subfolder}/result.html", "verdict": self.verdict}
        row |= {"verdict_r": self.verdict, "verdict_l": self.verdict}
        row["first_cause"] = self.reasons[0][1] if self.reasons else ""
        listed = tuple(
            dict(zip(("severity", "cause", "action"), words, strict=True)) for words in self.reasons
        )
        return Outcome(**ids, row={**row, **self.row}, reasons=listed, curves=packed(*self.curves))


def packed(right: int | None, left: int | None) -> str:
    """Curves of one height for each leg, as text."""
    out = np.full(SHAPE, GAP, dtype="<i2")
    for k, height in enumerate((right, left)):
        if height is not None:
            out[:, k] = height
    return base64.b64encode(out.tobytes()).decode()


def write_cohort(out: Path, people: list[Kept], common: CommonSettings | None = None) -> Path:
    """Keep these people in a cohort's folder and write its tables; the page."""
    mark_as_cohort(out)
    for one in people:
        outcome = one.outcome
        write_outcome(out, outcome)
        if not outcome.failed:
            pq.write_table(
                pa.table({name: [] for name in STRIDES.names}, schema=STRIDES),
                get_state_path(out, outcome.place, ".parquet"),
            )
    everyone = sorted((one.person for one in people), key=lambda person: person.key)
    write_tables(everyone, Path("/lab"), Outcomes(out), common or CommonSettings())
    return out / PAGE


def some_people() -> list[Kept]:
    """Two groups, each verdict, a person with two sessions, one without a result."""
    return [
        Kept(
            name="Ann",
            group="a",
            row={
                "speed_r": 1.0,
                "speed_l": 1.2,
                "knee_flexion_swing_r": 60.0,
                "knee_flexion_swing_l": 50.0,
            },
        ),
        Kept(
            name="Bob",
            group="a",
            verdict="doubtful",
            reasons=(KNEE,),
            curves=(300, 300),
            row={"speed_r": 1.4, "speed_l": 1.4},
        ),
        Kept(
            name="Cid",
            group="a",
            verdict="refused",
            reasons=(FORCES, KNEE),
            curves=(9000, 9000),
            row={"speed_r": 0.7},
        ),
        Kept(
            name="Dan",
            session="post",
            group="b",
            curves=(10, None),
            row={"speed_r": 1.3, "speed_l": 1.3},
        ),
        Kept(
            name="Dan",
            session="pre",
            group="b",
            curves=(30, None),
            row={"speed_r": 0.9, "speed_l": 0.9},
        ),
        Kept(name="Eve", group="b", curves=(100, 100)),
        Kept(name="Zed", group="b", cause="the static trial is restless"),
    ]
