"""Two sessions of made-up people: the same joints, markers put on anew, other noise; what a shared model makes of them.

A person of `gaitcal synthesize --perturb` (wrong in every joint parameter by up to 10 mm and 10 deg) walks twice. Every
marker of a session, landmark or not, sits `PLACED` mm from its place along each axis (normal), in the static trial and
in the walk; the walk has the published waves besides. Truth is told in the frames that each static trial makes.

Angles of the two sessions, through result folders: inside their error bars?

Both sessions walk the very same walk, so that all that differs is error: of markers that were put on anew and of their
noise. Strides do not vary otherwise, and what is theirs is the error of their own markers alone.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaitcal import Study, calibrate, write_results
from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.compare.difference import difference_variance, shared_variance, told_parameters
from gaitcal.compare.shared_model import JointKnowledge, joined
from gaitcal.compare.stride_sets import Common, Session, common_to, mean_over, stride_sets
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind
from gaitcal.model.segment_frames import HipCentre
from gaitcal.model.subject_model import SubjectModel
from gaitcal.results.sessions import load_session
from gaitcal.session.joint_parameters import fit_joints
from gaitcal.session.session import session_of
from gaitcal.study.study import nominal_of
from gaitcal.synthetic.motion import (
    TrueMotion,
    marker_noise,
    standing_pose,
    static_motion,
    synthetic_markers,
    two_strides,
)
from gaitcal.synthetic.subject import synthetic_model
from gaitcal.synthetic.truth import in_static_frames
from scripts.validation.error_bars import coverage

PLACED = 0.006
"""m along each axis: 10 mm in space, as landmarks are palpated (Della Croce et al. 2005)."""
STUDY = """
[subject]
name = "made up"
mass_kg = 69.4
height_m = 1.70
sex = "male"

[markers]
set = "published"

[[trial]]
name = "static"
role = "static"
file = "static.c3d"

[[trial]]
name = "walk"
role = "gait"
file = "walk.c3d"
"""


@dataclass(frozen=True, kw_only=True)
class MadeSession:
    """One session's fit, and what it should have found."""

    truth: Array
    """(98,) m, rad, in its own frames."""
    nominal: Array
    """(98,)."""
    fitted: Array
    """(98,)."""
    influence: ErrorSources


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Errors of the joint parameters of one person's two sessions."""

    names: tuple[str, ...]
    alone: Array
    """(2, n) m, rad: each session by itself."""
    shared: Array
    """(2, n) m, rad: both together."""
    errors_alone: Array
    """(2, n) m, rad: standard errors."""
    errors_shared: Array
    nominal: Array
    """(2, n) m, rad: errors of the nominal joints."""
    difference: Array
    """(n,) in standard errors: fitted B - A by `parameter_differences`."""


def record_session(person: SubjectModel, rng: np.random.Generator, folder: Path) -> SubjectModel:
    """Write one session's study and recordings; returns the person with the markers where they were put."""
    moved = person.markers.local + rng.normal(0.0, PLACED, person.markers.local.shape)
    worn = replace(person, markers=replace(person.markers, local=moved))
    standing = static_motion(standing=standing_pose(person.parameters))
    tracking = published_model().markers.labels
    write_c3d(folder / "static.c3d", _recording(worn, standing, worn.markers.labels, None))
    write_c3d(folder / "walk.c3d", _recording(worn, two_strides(person.parameters), tracking, rng))
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    return worn


def made_session(person: SubjectModel, rng: np.random.Generator) -> MadeSession:
    """Record and fit one session."""
    with tempfile.TemporaryDirectory() as name:
        worn = record_session(person, rng, Path(name))
        study = Study.load(Path(name) / "study.toml")
    nominal = nominal_of(study)
    stage = fit_joints(session_of(study, nominal))
    if stage.joint is None:
        raise RuntimeError("no joint parameters were fitted")
    truth = in_static_frames(worn, HipCentre(study.settings.hip_rule)).joint
    return MadeSession(
        truth=truth, nominal=nominal.parameters.joint, fitted=stage.parameters.joint, influence=stage.joint.errors
    )


def outcome(seed: int) -> Outcome:
    """One person, two sessions, each alone and both together."""
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)]
    person = synthetic_model(streams[0], perturb=True)
    sessions = [made_session(person, rng) for rng in streams[1:]]
    told = [set(told_parameters(s.influence)) for s in sessions]
    names = tuple(n for n in told_parameters(sessions[0].influence) if n in told[1] and n.startswith(LEG_JOINTS))
    index = [JP_INDEX[n] for n in names]
    known = [_knowledge(s, names) for s in sessions]
    both = joined(names, *known, placed_anew=True)
    truth = np.array([s.truth[index] for s in sessions])
    return Outcome(
        names=names,
        alone=np.array([k.fitted for k in known]) - truth,
        shared=np.array([both.a, both.b]) - truth,
        errors_alone=np.array([np.sqrt(np.diag(k.covariance)) for k in known]),
        errors_shared=np.array(both.errors),
        nominal=np.array([k.nominal for k in known]) - truth,
        difference=_standardised(sessions, names, known),
    )


def report(outcomes: list[Outcome]) -> list[str]:
    """Lines: errors alone and shared, coverage of both, coverage of differences."""
    lines = []
    for kind, factor in ((Kind.POSITION, 1e3), (Kind.ORIENTATION, 180.0 / np.pi)):
        chosen = [JOINT_PARAMETERS[JP_INDEX[n]].kind is kind for n in outcomes[0].names]

        def rms(name: str, factor: float = factor, chosen: list[bool] = chosen) -> float:
            values = np.concatenate([getattr(o, name)[:, chosen].ravel() for o in outcomes])
            return float(factor * np.sqrt(np.mean(values**2)))

        lines.append(
            f"joint {kind.value}s, {kind.unit} RMS: nominal {rms('nominal'):.2f}, alone {rms('alone'):.2f} "
            f"(stated {rms('errors_alone'):.2f}), shared {rms('shared'):.2f} (stated {rms('errors_shared'):.2f})"
        )
    better = sum(
        float(np.mean((o.shared / o.errors_alone) ** 2)) < float(np.mean((o.alone / o.errors_alone) ** 2))
        for o in outcomes
    )
    lines.append(f"nearer the truth together than alone: {better} of {len(outcomes)} people")
    for told, errors, bars in (("alone", "alone", "errors_alone"), ("shared", "shared", "errors_shared")):
        z = np.concatenate([(getattr(o, errors) / getattr(o, bars)).ravel() for o in outcomes])
        lines.append(f"{told}: {coverage(z)}")
    lines.append(f"differences between sessions: {coverage(np.concatenate([o.difference for o in outcomes]))}")
    return lines


def _knowledge(session: MadeSession, names: tuple[str, ...]) -> JointKnowledge:
    index, rows = [JP_INDEX[n] for n in names], [session.influence.free.index(n) for n in names]
    found = session.influence.parameters[rows]
    return JointKnowledge(nominal=session.nominal[index], fitted=session.fitted[index], covariance=found @ found.T)


def _standardised(sessions: list[MadeSession], names: tuple[str, ...], known: list[JointKnowledge]) -> Array:
    a, b = sessions
    variance = difference_variance((a.influence, b.influence), names, Common.PERSON)
    out: Array = (known[1].fitted - known[0].fitted) / np.sqrt(variance)
    return out


def _recording(
    model: SubjectModel, motion: TrueMotion, labels: tuple[str, ...], noise: np.random.Generator | None
) -> Recording:
    every = synthetic_markers(model.parameters, model.markers, motion.q)
    chosen = every[:, [model.markers.labels.index(label) for label in labels]]
    chosen = chosen + np.array([0.0, 0.05, 0.0])  # above the floor, wherever a marker was put
    if noise is not None:
        chosen = chosen + marker_noise(motion.basis.time, len(labels), noise)
    return Recording(source="made up", time=motion.basis.time, labels=labels, markers=chosen)


EVERY = 10
"""Percent: nearer ones say the same."""


def angle_scores(a: Session, b: Session) -> dict[str, Array]:
    """Angle -> differences of both legs' curves in standard errors."""
    one, other = stride_sets(a), stride_sets(b)
    out: dict[str, list[Array]] = {}
    for key in (key for key in one if key in other):
        pair = one[key], other[key]
        shared, frames = ([mean_over(getattr(s, name)) for s in pair] for name in ("shared", "frames"))
        own = sum(mean_over(s.own) ** 2 for s in pair)
        variance = shared_variance(common_to(a, b), (shared[0], shared[1]), (frames[0], frames[1])) + own
        z = ((mean_over(pair[1].values) - mean_over(pair[0].values)) / np.sqrt(variance))[::EVERY]
        out.setdefault(key[1], []).append(z[np.isfinite(z)])
    return {name: np.concatenate(parts) for name, parts in out.items()}


def angles_report(seeds: range) -> Iterator[str]:
    """A line for each angle, and one for all."""
    found: dict[str, list[Array]] = {}
    for seed in seeds:
        for name, z in _of_person(seed).items():
            found.setdefault(name, []).append(z)
    for name, parts in found.items():
        yield f"{name}: {coverage(np.concatenate(parts))}"
    yield f"angles of {len(seeds)} made-up people: {coverage(np.concatenate([z for p in found.values() for z in p]))}"


def _of_person(seed: int) -> dict[str, Array]:
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)]
    person = synthetic_model(streams[0], perturb=True)
    sessions = []
    for rng in streams[1:]:
        with tempfile.TemporaryDirectory() as name:
            record_session(person, rng, Path(name))
            calibration = calibrate(Study.load(Path(name) / "study.toml"))
            sessions.append(load_session(write_results(calibration, Path(name) / "result"))[0])
    return angle_scores(*sessions)
