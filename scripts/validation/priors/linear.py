"""The same question without fits: people's deviations are real, what their recordings say of them is linear.

What trials say of joint parameters, the information S, is taken from a few people who are recorded and fitted
(`priors/people.py`); everybody else has the S of one of these, and S m drawn about their own deviations. Hundreds of
people of many populations take seconds each; what a linear fit cannot show is told by the fits of `check.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.influence import Influence
from gaitcal.calibration.joint_prior import prior_of, prior_root
from gaitcal.model.hip_centre import HipCentre
from gaitcal.model.joint_parameters import JP_INDEX, JP_NAMES
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.nominal import nominal_model, published_model
from gaitcal.model.subject_model import Subject
from gaitcal.population.person_evidence import PARTS, PartEvidence, PersonEvidence
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.people_design import Person
from gaitcal.synthetic.motion import standing_pose, static_motion
from gaitcal.synthetic.truth import in_static_frames
from scripts.validation.priors.people import (
    HEIGHTS,
    Fit,
    evidence,
    fit,
    nominal_error,
    person_of,
    recording,
    walk_alone,
)
from scripts.validation.priors.populations import POSITION, Draw
from scripts.validation.priors.report import Outcome

STANDING = 12
"""Frames."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What one recorded person's trials say: part of the body -> information."""

    gait: dict[str, Array]
    isolated: dict[str, Array]


@dataclass(frozen=True, kw_only=True)
class LinearPerson:
    """A person, and how far the nominal joints of a study are from theirs."""

    person: Person
    deviation: Array
    """(98,) m, rad."""
    shown: Shown


def shown(draw: Draw, people: int, seed: int) -> list[Shown]:
    """Of people who are recorded and fitted."""
    out = []
    for number in range(people):
        made = person_of(draw, (seed, 2, number), isolated=True)
        kinds = (walk_alone(made), made)
        gait, isolated = (
            {part: e.information for part, e in evidence("", one, fit(one)).parts.items()} for one in kinds
        )
        out.append(Shown(gait=gait, isolated=isolated))
    return out


def linear_person(draw: Draw, seed: tuple[int, ...], seen: Sequence[Shown]) -> LinearPerson:
    """Draw a person, and tell their joints in the frames of a static trial."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    person = Person(height=float(rng.uniform(*HEIGHTS)), sex="male" if rng.random() < 0.5 else "female")
    published = published_model(static_only=True)
    size = person.height / published.subject.height
    at_size = np.where(POSITION, size, 1.0)
    joint = published.parameters.joint - nominal_error() + draw(rng, person) / at_size
    plain = replace(published.parameters, joint=joint)
    tall = replace(
        published,
        parameters=replace(plain, joint=joint * at_size),
        markers=replace(published.markers, local=size * published.markers.local),
    )
    still = recording("static", tall, static_motion(STANDING, standing_pose(plain)), size, rng)
    subject = Subject("made up", 70.0, person.height, person.sex)
    nominal = nominal_model(
        still, marker_set=load_marker_set("published"), subject=subject, hip_centre=HipCentre.HARRINGTON
    )
    truth = in_static_frames(tall, HipCentre.HARRINGTON).joint
    return LinearPerson(
        person=person, deviation=truth - nominal.parameters.joint, shown=seen[int(rng.integers(len(seen)))]
    )


def told_of(one: LinearPerson, kind: str, name: str, rng: np.random.Generator) -> PersonEvidence:
    """What recordings of a kind, `gait` or `isolated`, say of a person."""
    parts = {}
    for part, names in PARTS.items():
        index = [JP_INDEX[n] for n in names]
        information: Array = getattr(one.shown, kind)[part] * (part == "legs")  # which alone are looked at
        values, vectors = np.linalg.eigh(information)
        noise = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=len(values)))
        deviation = np.linalg.solve(prior_root(names, None), one.deviation[index] - prior_of(names, None)[0])
        parts[part] = PartEvidence(information=information, right=information @ deviation + noise)
    return PersonEvidence(name=name, person=one.person, recordings=frozenset(), parts=parts)


def linear_fit(said: PersonEvidence, prior: JointPrior | None) -> Fit:
    """Deviations from nominal joints, and their errors, by what recordings say and a prior."""
    fitted, root = np.zeros(len(JP_NAMES)), np.zeros((len(JP_NAMES),) * 2)
    for part, names in PARTS.items():
        index, origin, unit = [JP_INDEX[n] for n in names], prior_of(names, None)[0], prior_root(names, None)
        mean, covariance = prior_of(names, prior)
        precision = unit.T @ np.linalg.solve(covariance, unit)
        found = np.linalg.inv(precision + said.parts[part].information)
        pulled = unit.T @ np.linalg.solve(covariance, mean - origin)
        fitted[index] = origin + unit @ found @ (said.parts[part].right + pulled)
        root[np.ix_(index, index)] = unit @ np.linalg.cholesky(found)
    return Fit(fitted=fitted, influence=Influence(JP_NAMES, root, JP_NAMES))


def linear_outcome(one: LinearPerson, said: PersonEvidence, priors: dict[str, JointPrior | None]) -> Outcome:
    """As of a person who was fitted; parameters are told from the nominal ones."""
    return Outcome(
        truth=one.deviation,
        nominal=np.zeros(len(JP_NAMES)),
        fits={name: linear_fit(said, prior) for name, prior in priors.items()},
        information=said.parts["legs"].information,
    )
