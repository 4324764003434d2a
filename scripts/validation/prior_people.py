"""A made-up person of a population: recorded standing and walking, with or without isolated trials, and fitted.

The published person's linkage is changed by what the population says, its joints about where a study takes them to be
nominal, and then made as tall as the person is. As both segments of a joint have their frames from one static posture,
what is told of them in those frames goes together. Markers move as in `gaitcal synthesize`: slow waves of up to
10 mm, none in the static trial. Frames are thinned to 100 Hz in the walk, 33 Hz in isolated trials.

Populations of people that the program does not know: how the joints of their linkage deviate from nominal ones.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from gaitcal import Study
from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.cohort.learn_priors import parts_of
from gaitcal.cohort.learning import PersonEvidence
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import ISOLATED_JOINTS
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_NAMES, Kind
from gaitcal.model.segment_frames import HipCentre
from gaitcal.model.subject_model import SubjectModel
from gaitcal.session.joint_parameters import fit_joints
from gaitcal.session.session import session_of
from gaitcal.study.joint_prior import HEIGHT, STEP, JointPrior, Person, mirror
from gaitcal.study.study import nominal_of
from gaitcal.study.study_file import Markers, StudyFile, SubjectTable, TrialTable
from gaitcal.study.study_trial import Role
from gaitcal.synthetic.motion import (
    TrueMotion,
    isolated_motion,
    marker_noise,
    standing_pose,
    static_motion,
    synthetic_markers,
    two_strides,
)
from gaitcal.synthetic.truth import in_static_frames

POSITION = np.array([p.kind is Kind.POSITION for p in JOINT_PARAMETERS])
Draw = Callable[[np.random.Generator, Person], Array]
"""(98,) m, rad: deviations of a new person."""


def scaled(millimetres: float, degrees: float) -> Array:
    """(98,) m, rad."""
    return np.where(POSITION, 1e-3 * millimetres, np.deg2rad(degrees))


def both_sides(values: Array) -> Array:
    """(98,) the same on both sides."""
    reflected = mirror(JP_NAMES)
    return 0.5 * (values + reflected @ values) * np.where(_paired(), np.sqrt(2.0), 1.0)


def _paired() -> Array:
    return np.array([p.joint[-2:] in ("_r", "_l") for p in JOINT_PARAMETERS])


def offset(rng: np.random.Generator) -> Draw:
    """Everybody deviates by nearly the same: uniform within 10 mm and 10 deg; their own spread is 2 mm and 2 deg."""
    common = both_sides(rng.uniform(-1.0, 1.0, len(JP_NAMES)) * scaled(10.0, 10.0))
    return lambda own, person: common + own.normal(size=len(common)) * scaled(2.0, 2.0)


def wide(rng: np.random.Generator) -> Draw:
    """No deviation in common; each parameter independent, uniform within 10 mm and 10 deg as `synthesize --perturb`."""
    return lambda own, person: own.uniform(-1.0, 1.0, len(JP_NAMES)) * scaled(10.0, 10.0)


def structured(rng: np.random.Generator) -> Draw:
    """Three traits move many parameters of both sides together (4 mm, 4 deg each), size moves them by 4 mm and 3 deg
    for 10 cm, an offset by 4 mm and 4 deg; their own spread is 1.5 mm, 1.5 deg.
    """
    count = len(JP_NAMES)
    traits = np.array([both_sides(rng.normal(size=count) * scaled(4.0, 4.0)) for _ in range(3)])
    size = both_sides(rng.normal(size=count) * scaled(4.0, 3.0))
    common = both_sides(rng.normal(size=count) * scaled(4.0, 4.0))

    def draw(own: np.random.Generator, person: Person) -> Array:
        by_size = (person.height - HEIGHT) / STEP * size
        out: Array = common + by_size + own.normal(size=3) @ traits + own.normal(size=count) * scaled(1.5, 1.5)
        return out

    return draw


POPULATIONS: dict[str, Callable[[np.random.Generator], Draw]] = {
    "offset": offset,
    "wide": wide,
    "structured": structured,
}
"""Of a generator that makes the population, what draws its people."""


HEIGHTS = (1.50, 1.90)
"""m."""
ABOVE_FLOOR = 0.02
"""m: the lowest marker."""
EVERY = {"static": 1, "gait": 2}
"""Frame of the published recordings that is kept; of isolated trials, `EVERY_ISOLATED`."""
EVERY_ISOLATED = 6
TRANSLATIONS = slice(3, 6)


@dataclass(frozen=True, kw_only=True)
class MadePerson:
    """Recordings and truth."""

    study: Study
    truth: Array
    """(98,) m, rad, in the frames of the study's static trial."""
    nominal: SubjectModel
    isolated: bool
    person: Person


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Joint parameters of a person."""

    fitted: Array
    """(98,) m, rad."""
    influence: ErrorSources

    @property
    def errors(self) -> Array:
        """(98,) m, rad: standard errors."""
        known = self.influence.standard_errors
        return np.array([known[name] for name in JP_NAMES])


def person_of(draw: Draw, seed: tuple[int, ...], *, isolated: bool) -> MadePerson:
    """Draw and record a person."""
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2)]
    person = Person(height=float(streams[0].uniform(*HEIGHTS)), sex="male" if streams[0].random() < 0.5 else "female")
    return recorded(person, draw(streams[0], person), streams[1], isolated=isolated)


def recorded(person: Person, deviation: Array, rng: np.random.Generator, *, isolated: bool) -> MadePerson:
    """Record a person whose joints deviate so (98,) from those that the study takes to be nominal."""
    published = published_model(static_only=True)
    size = person.height / published.subject.height
    at_size = np.where(POSITION, size, 1.0)
    joint = published.parameters.joint - (nominal_error() if deviation.any() else 0.0) + deviation / at_size
    parameters = replace(published.parameters, joint=joint)
    pose = standing_pose(parameters)
    motions = {"static": static_motion(standing=pose), "gait": two_strides(parameters)}
    if isolated:
        motions |= {name: isolated_motion(name, pose) for name in ISOLATED_JOINTS}
    tall = replace(
        published,
        parameters=replace(parameters, joint=joint * at_size),
        markers=replace(published.markers, local=size * published.markers.local),
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for trial, motion in motions.items():
            write_c3d(folder / f"{trial}.c3d", recording(trial, tall, motion, size, rng))
        (folder / "study.toml").write_text(_study(person, tuple(motions)), encoding="utf-8")
        study = Study.load(folder / "study.toml")
    truth = in_static_frames(tall, HipCentre(study.settings.hip_rule)).joint
    return MadePerson(study=study, truth=truth, nominal=nominal_of(study), isolated=isolated, person=person)


@cache
def nominal_error() -> Array:
    """(98,) m, rad: what a study's nominal joints of the published person miss, which no population has."""
    published = published_model().subject
    plain = recorded(
        Person(height=published.height, sex=published.sex),
        np.zeros(len(JP_NAMES)),
        np.random.default_rng(0),
        isolated=False,
    )
    out: Array = plain.truth - plain.nominal.parameters.joint
    return out


def walk_alone(made: MadePerson) -> MadePerson:
    """The same person without the isolated trials."""
    trials = tuple(trial for trial in made.study.trials if trial.role is not Role.JOINT)
    return replace(made, study=replace(made.study, trials=trials), isolated=False)


def fit(made: MadePerson, prior: JointPrior | None = None) -> Fit:
    """Calibrate the joint parameters."""
    stage = fit_joints(session_of(replace(made.study, joint_prior=prior), made.nominal))
    if stage.joint is None:
        raise RuntimeError("no joint parameters were fitted")
    return Fit(fitted=stage.parameters.joint, influence=stage.joint.errors)


def evidence(name: str, made: MadePerson, found: Fit) -> PersonEvidence:
    """What a person's recordings say."""
    parts = parts_of(found.influence, found.fitted - made.nominal.parameters.joint, JP_NAMES, None)
    if parts is None:
        raise RuntimeError("errors of joint parameters without rank")
    return PersonEvidence(name=name, person=made.person, recordings=frozenset(), parts=parts)


def recording(trial: str, model: SubjectModel, motion: TrueMotion, size: float, rng: np.random.Generator) -> Recording:
    """Markers of a trial; noise unless it is static. `size`: of the person against the published one."""
    q = motion.q.copy()
    q[:, TRANSLATIONS] *= size
    every = synthetic_markers(model.parameters, model.markers, q)
    every[:, :, 1] += ABOVE_FLOOR - every[:, :, 1].min()
    labels = model.markers.labels if trial == "static" else published_model().markers.labels
    chosen = every[:, [model.markers.labels.index(label) for label in labels]]
    time = motion.basis.time
    if trial != "static":
        chosen = chosen + marker_noise(time, len(labels), rng)
    step = EVERY.get(trial, EVERY_ISOLATED)
    return Recording(source="made up", time=time[::step], labels=labels, markers=chosen[::step])


def _study(person: Person, trials: tuple[str, ...]) -> str:
    entries = []
    for name in trials:
        file = Path(f"{name}.c3d")
        role = name if name == "static" else "gait" if name == "gait" else "joint"
        entries.append(TrialTable(name=name, role=role, file=file, joint=name if role == "joint" else None))  # type: ignore[arg-type]
    subject = SubjectTable(name="made up", mass_kg=70.0, height_m=person.height, sex=person.sex)  # type: ignore[arg-type]
    return StudyFile(subject=subject, markers=Markers(set="published"), trial=tuple(entries)).to_toml()
