"""Do two recordings of one person differ by as much as their error bars say?

    sessions [--parts real,made-up,angles] [--people 10] [--seed 0] [--out DIR]

real      every walk of `labs_c3d/multi` calibrated by itself: how many differences of curves are
          inside bars of 68 and 95 % (joint parameters of real recordings: `people --parts pairs`).
          How strides vary is taken from one calibration of all walks, so that what calibrations
          differ by is not in it
made-up   two sessions of a person of our own linkage: the same joints, markers put on anew by 10
          mm, other noise; errors of the joint parameters of each, and of their difference
angles    the angles of the same people's sessions, through result folders: inside their error bars?

A made-up person (`gaitcal synthesize --perturb`: wrong in every joint parameter by up to 10 mm and
10 deg) walks the very same walk twice. Every marker of a session, landmark or not, sits `PLACED`
from its place along each axis (normal), in the static trial and in the walk, which has the
published waves besides. Truth is told in the frames that each static trial makes. `--out` keeps the
results of `real`, and reads them if they are there.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from gaitcal import Study, calibrate, write_results
from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.gait.cycles import get_curve_kind
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, ParameterKind
from gaitcal.model.segment_frames import HipCentre
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.session_report import load_session
from gaitcal.results.session_difference import (
    compute_difference_variance,
    compute_shared_variance,
    list_observed_parameters,
    pool_strides,
)
from gaitcal.results.stride_sets import (
    Common,
    RecordedSession,
    StrideSet,
    average_known,
    collect_stride_sets,
    find_common,
)
from gaitcal.synthetic.subject import make_synthetic_model, record_motion
from gaitcal.synthetic.synthetic_motion import (
    draw_marker_noise,
    make_standing_pose,
    simulate_static_trial,
    simulate_two_strides,
)
from gaitcal.synthetic.synthetic_truth import compute_static_frames
from scripts.validation.harness import coverage, option, rms, say, side_by_side
from scripts.validation.people.fits import fitted
from scripts.validation.recordings import only, study_of_person, write_folder

SHARED = ("--jobs", "--seed")
OWN = {
    "--people": option(10, "made-up people"),
    "--out": option(Path, "folder that keeps the results"),
}
PLACED = 0.006
"""m along each axis: 10 mm in space, as landmarks are palpated (Della Croce et al. 2005)."""
ABOVE_FLOOR = np.array([0.0, 0.05, 0.0])
"""m, wherever a marker was put."""
EVERY = 10
"""Percent: nearer ones say the same."""
PERSON = "multi"
"""Five walks over force plates."""
Key = TypeVar("Key")


@dataclass(frozen=True)
class MadeSession:
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
    fitted: Array
    """(2, n) m, rad: errors of each session's joints."""
    stated: Array
    """(2, n) m, rad: their standard errors."""
    nominal: Array
    """(2, n) m, rad: errors of the nominal joints."""
    difference: Array
    """(n,) in standard errors: fitted B - A by `parameter_differences`."""


def two_sessions(seed: int) -> tuple[SubjectModel, list[np.random.Generator]]:
    """A made-up person, and what draws each session."""
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)]
    return make_synthetic_model(streams[0], perturb=True), streams[1:]


def record_session(person: SubjectModel, rng: np.random.Generator, folder: Path) -> SubjectModel:
    """Write one session's study and recordings; returns the person with the markers where they were
    put.
    """
    moved = person.markers.local + rng.normal(0.0, PLACED, person.markers.local.shape)
    worn = replace(person, markers=replace(person.markers, local=moved))

    standing = simulate_static_trial(standing=make_standing_pose(person.parameters))
    static = record_motion("made up", standing, worn, worn.markers.labels)
    walk = record_motion(
        "made up", simulate_two_strides(person.parameters), worn, published_model().markers.labels
    )
    noise = draw_marker_noise(walk.time, len(walk.labels), rng)
    static = replace(static, markers=static.markers + ABOVE_FLOOR)
    walk = replace(walk, markers=walk.markers + ABOVE_FLOOR + noise)
    write_folder(folder, {"static": static, "walk": walk}, ("made up", 69.4, 1.70, "male"))
    return worn


def made_session(person: SubjectModel, rng: np.random.Generator) -> MadeSession:
    with tempfile.TemporaryDirectory() as name:
        worn = record_session(person, rng, Path(name))
        study = Study.load(Path(name) / "study.toml")
    truth, found = (
        compute_static_frames(worn, HipCentre(study.settings.hip_rule)).parameters.joint,
        fitted("made up", study),
    )
    return MadeSession(
        truth, found.nominal.parameters.joint, found.parameters.joint, found.influence
    )


def outcome(seed: int) -> Outcome:
    person, streams = two_sessions(seed)
    a, b = (made_session(person, rng) for rng in streams)
    told = set(list_observed_parameters(b.influence))
    names = tuple(
        n for n in list_observed_parameters(a.influence) if n in told and n.startswith(LEG_JOINTS)
    )
    index = [JP_INDEX[n] for n in names]
    fitted = np.array([s.fitted[index] for s in (a, b)])
    truth = np.array([s.truth[index] for s in (a, b)])
    variance = compute_difference_variance((a.influence, b.influence), names, Common.PERSON)
    return Outcome(
        names=names,
        fitted=fitted - truth,
        stated=np.array([[s.influence.standard_errors[n] for n in names] for s in (a, b)]),
        nominal=np.array([s.nominal[index] for s in (a, b)]) - truth,
        difference=(fitted[1] - fitted[0]) / np.sqrt(variance),
    )


def report(outcomes: list[Outcome]) -> Iterator[str]:
    """Errors and their coverage, coverage of differences."""
    kinds = [JOINT_PARAMETERS[JP_INDEX[n]].kind for n in outcomes[0].names]
    for kind, factor in ((ParameterKind.POSITION, 1e3), (ParameterKind.ORIENTATION, 180.0 / np.pi)):
        chosen = [k is kind for k in kinds]
        columns = ("nominal", "fitted", "stated")
        found = [factor * rms([getattr(o, name)[:, chosen] for o in outcomes]) for name in columns]
        yield "joint {}s, {} RMS: nominal {:.2f}, fitted {:.2f} (stated {:.2f})".format(
            kind.value, kind.unit, *found
        )
    yield f"joints: {coverage(np.concatenate([(o.fitted / o.stated).ravel() for o in outcomes]))}"
    yield (
        "differences between sessions: "
        f"{coverage(np.concatenate([o.difference for o in outcomes]))}"
    )


def gathered(parts: Iterable[tuple[Key, Array]]) -> dict[Key, Array]:
    out: dict[Key, list[Array]] = {}
    for key, values in parts:
        out.setdefault(key, []).append(values[np.isfinite(values)])
    return {key: np.concatenate(found) for key, found in out.items()}


def session_variance(
    a: RecordedSession, b: RecordedSession, pair: tuple[StrideSet, StrideSet]
) -> Array:
    """(101,) of the difference of two sessions' curves: errors that strides of one
    session share.
    """
    shared, frames = (
        [average_known(getattr(s, name)) for s in pair] for name in ("shared", "frames")
    )
    return compute_shared_variance(
        find_common(a, b), (shared[0], shared[1]), (frames[0], frames[1])
    )


def angle_scores(a: RecordedSession, b: RecordedSession) -> dict[str, Array]:
    """Angle -> differences of both legs' curves in standard errors. Of strides that do not vary,
    only errors differ.
    """

    def scores() -> Iterator[tuple[str, Array]]:
        one, other = collect_stride_sets(a), collect_stride_sets(b)
        for key in (key for key in one if key in other):
            pair = one[key], other[key]
            variance = session_variance(a, b, pair) + sum(
                average_known(s.stride_error) ** 2 for s in pair
            )
            yield (
                key[1],
                (
                    (average_known(pair[1].values) - average_known(pair[0].values))
                    / np.sqrt(variance)
                )[::EVERY],
            )

    return gathered(scores())


def angles_report(seeds: range) -> Iterator[str]:
    found = gathered((name, z) for seed in seeds for name, z in _of_person(seed).items())
    for name, z in found.items():
        yield f"{name}: {coverage(z)}"
    yield f"angles of {len(seeds)} made-up people: {coverage(np.concatenate(list(found.values())))}"


def _of_person(seed: int) -> dict[str, Array]:
    person, streams = two_sessions(seed)
    sessions = []
    for rng in streams:
        with tempfile.TemporaryDirectory() as name:
            record_session(person, rng, Path(name))
            calibration = calibrate(Study.load(Path(name) / "study.toml"))
            sessions.append(load_session(write_results(calibration, Path(name) / "result"))[0])
    return angle_scores(*sessions)


def results(out: Path) -> tuple[list[RecordedSession], RecordedSession]:
    """Every walk calibrated by itself, and all together; what lies in `out` already is read."""
    study = study_of_person(PERSON)
    found = []
    for name, trials in (*((walk, (walk,)) for walk in study.walks), ("all", study.walks)):
        result = out / PERSON / name
        if not (result / "manifest.json").exists():
            write_results(calibrate(only(study, *trials)), result)
        found.append(load_session(result)[0])
    return found[:-1], found[-1]


def curve_scores(walks: list[RecordedSession], together: RecordedSession) -> Mapping[object, Array]:
    """Kind -> differences of the curves of two walks in standard errors, every tenth percent."""
    alone = {key: pool_strides([s.values]) for key, s in collect_stride_sets(together).items()}
    spread = {
        key: np.where(found.freedom > 1, found.variance, np.nan) for key, found in alone.items()
    }
    sets = {session.name: collect_stride_sets(session) for session in walks}

    def scores() -> Iterator[tuple[object, Array]]:
        for a, b in itertools.combinations(walks, 2):
            one, other = sets[a.name], sets[b.name]
            for key in (key for key in one if key in other and key in spread):
                pair = one[key], other[key]
                counts = [np.maximum(np.isfinite(s.values).sum(axis=0), 1) for s in pair]
                variance = spread[key] * (1.0 / counts[0] + 1.0 / counts[1])
                variance = variance + np.nan_to_num(session_variance(a, b, pair))
                with np.errstate(invalid="ignore", divide="ignore"):
                    z = (average_known(pair[1].values) - average_known(pair[0].values)) / np.sqrt(
                        variance
                    )
                yield get_curve_kind(key[1]), z[::EVERY]

    return gathered(scores())


def real_report(out: Path | None) -> Iterator[str]:
    with tempfile.TemporaryDirectory() as folder:
        for kind, z in curve_scores(*results(out or Path(folder))).items():
            yield f"{PERSON}: {kind.words}s: {coverage(z)}"  # type: ignore[attr-defined]


PARTS = {
    "real": lambda c: say(*real_report(c.out)),
    "made-up": lambda c: say(
        *report(list(side_by_side([partial(outcome, s) for s in _seeds(c)], c.jobs)))
    ),
    "angles": lambda c: say(*angles_report(_seeds(c))),
}


def _seeds(chosen: argparse.Namespace) -> range:
    return range(chosen.seed, chosen.seed + chosen.people)
