"""People of a known population, of each of whom recordings tell something."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gaitcal.cohort.learn_priors import PARTS
from gaitcal.cohort.learning import PartEvidence, PersonEvidence
from gaitcal.study.joint_prior import Person

Array = NDArray[np.float64]
NAMES = PARTS["legs"]
KNEES = tuple(name for name in NAMES if name.startswith("knee"))


def told(deviation: Array, information: Array, rng: np.random.Generator) -> PartEvidence:
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
    count: int, draw: Callable[[np.random.Generator, Person], Array], rng: np.random.Generator, *, scale: float = 1.0
) -> list[PersonEvidence]:
    """People with evidence of legs alone, the same of everybody in kind; `draw`: deviations of a person."""
    size, upper = len(NAMES), len(PARTS["trunk and arms"])
    shown = scale * some_information(np.random.default_rng(7), size)
    nothing = PartEvidence(information=np.zeros((upper, upper)), right=np.zeros(upper))
    out = []
    for number in range(count):
        person = Person(height=float(rng.uniform(1.5, 1.9)), sex="male" if number % 2 else "female")
        legs = told(draw(rng, person), shown, rng)
        out.append(
            PersonEvidence(
                name=f"P{number:03d}",
                person=person,
                recordings=frozenset({f"file {number}"}),
                parts={"legs": legs, "trunk and arms": nothing},
            )
        )
    return out
