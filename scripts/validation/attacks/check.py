"""Does anything wrong go unnoticed? Clean studies are spoilt in many ways; each must end so that
one can live with it.

    attacks [--all] [--jobs 2] [--only REGEX] [--base NAME ...] [--list]
    attacks --quick        # a dozen, in less than a minute
    attacks --clean        # every finding on the clean recordings, more of them

Each attack (a row of `attacks/corpus.toml`) changes one thing in one short study (static trial,
walk, isolated trials: `recordings.py`), which is then checked and calibrated as `gaitcal calibrate`
would. Without options each is made on one study, the studies taking turns; with `--all`, `--only`
or `--base` on every study that it is meant for. It ends as one of

refused     an error stops the run
named       a new message names the cause: it holds the words that the table lists, marker, trial or
            plate among them
harmless    no new message, and every leg torque, leg angle and hip, knee and ankle centre lies
            within the error bar of its own run around the clean run: the RMS over frames of
            |difference| / max(1.96 standard errors, floor) is at most 1; floors: 0.2 % of body
            weight times height, 1 deg, 5 mm
alarmed     something new is said, but not the cause
silent      nothing new is said, and a result moved by more than its own error bar
crash       an exception that is no error of gaitcal's

New is a message (warnings and errors of checks and of the calibration; notes do not count) whose
words, numbers left out, the clean run does not say. Real recordings are read from the folder that
GAITCAL_DATA names; without it only the synthetic person is attacked. Exit code 1 where more than 2
% end silent, more than 10 % alarmed, or anything crashes.

How far a run moved results is told in error bars. For each torque and angle x of the legs, with its
standard error s in every frame f of a walk, and for each centre of hip, knee and ankle:

    bar_f  = max(1.96 s_f, floor)
    moved  = sqrt(mean_f (|x_f - x0_f| / bar_f)^2)            x0: the clean run

so that moved <= 1 is inside the error bar that the run itself prints. Floors: 0.2 % of body weight
times height, 1 deg, 5 mm. Torques count where both runs call the frame valid. A hip's centre is
compared as a point, knee and ankle across their axes, along which a hinge tells nothing; s of a
centre is that of its position in the segment above it. Centres are compared in the laboratory,
after the one rigid motion that brings all markers of one recording on those of the other. An
isolated trial has no error bars of its own angles: there the axis of its knee or ankle is compared,
as an angle, with that of its two orientations in the segment above; floor 2 deg.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from gaitcal import COORDINATES, Calibration, GaitcalError, Study, calibrate
from gaitcal.analysis.result import TrialResult
from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Severity
from gaitcal.quality.study_checks import check_study
from gaitcal.quality.verdict import Judgement
from scripts.validation.attacks.corpus import (
    Attack,
    CorpusError,
    Kind,
    by_title,
    corpus,
    once_each,
    pattern,
    spoilt,
)
from scripts.validation.harness import option, say, side_by_side
from scripts.validation.recordings import EVERY, SYNTHETIC, loaded
from scripts.validation.truth.check import across, joint_tracks, whole_turn

ANGLES = tuple(
    f"{name}_{side}"
    for side in "rl"
    for name in (
        "hip_flexion",
        "hip_adduction",
        "hip_rotation",
        "knee_angle",
        "ankle_angle",
        "subtalar_angle",
    )
)
PLACES = {
    "hip": ("hip_{s}.pelvis.ant", "hip_{s}.pelvis.sup", "hip_{s}.pelvis.lat"),
    "knee": ("knee_{s}.thigh.ant", "knee_{s}.thigh.sup"),
    "ankle": ("talocrural_{s}.shank.ant", "talocrural_{s}.shank.sup"),
}
"""Joint -> the parameters whose standard errors are that of its centre in the segment above."""
DIRECTIONS = {
    "knee": ("knee_{s}.thigh.front", "knee_{s}.thigh.trans"),
    "ankle": ("talocrural_{s}.shank.front", "talocrural_{s}.shank.trans"),
}
"""Joint -> the parameters whose standard errors are that of its axis in the segment above."""
WITHIN = 1.96
FLOOR_BWH, FLOOR_RAD, FLOOR_M, FLOOR_AXIS_RAD = 0.002, np.deg2rad(1.0), 0.005, np.deg2rad(2.0)


@dataclass(frozen=True, kw_only=True)
class Curves:
    time: Array
    """(nf,) s."""
    labels: tuple[str, ...]
    markers: Array
    """(nf, nm, 3) m, as tracked."""
    angles: Array
    """(nf, 12) rad."""
    angle_bars: Array | None
    """(nf, 12) rad; None for isolated trials, which have no error bars of their own."""
    torques: Array | None
    """(nf, 14) N·m: those of the angles and both knee adductions; None without force plates."""
    torque_bars: Array | None
    """(nf, 14) N·m."""
    valid: BoolArray
    """(nf,) where torques count."""
    centres: Mapping[str, tuple[Array, Array]]
    """`hip_r`, ... -> centre (nf, 3) m and axis of flexion (nf, 3)."""
    centre_bars: Mapping[str, float]
    """m."""
    axis_bars: Mapping[str, float] = field(default_factory=dict)
    """rad; of isolated trials."""


def curves(calibration: Calibration) -> dict[str, Curves]:
    """Trial -> what it came to; of an isolated trial the centres of its own leg."""
    return {trial.name: _curves(calibration, trial) for trial in calibration.trials}


def _curves(calibration: Calibration, trial: TrialResult) -> Curves:
    at = [COORDINATES.index(name) for name in ANGLES]
    loads, errors = trial.loads, calibration.uncertainty.standard_errors
    angle_bars = torques = torque_bars = None
    valid = np.zeros(len(trial.body.time), dtype=np.bool_)
    if trial.coordinate_errors is not None:
        angle_bars = np.maximum(WITHIN * trial.coordinate_errors[:, at], FLOOR_RAD)
    if loads is not None:
        valid = loads.reactions.valid
        torques = np.hstack([loads.final.tau[:, at], loads.final.knee_adduction])
        spread = (
            np.zeros_like(torques)
            if loads.errors is None
            else loads.errors.all_forces[:, [*at, 27, 28]]
        )
        torque_bars = np.maximum(WITHIN * spread, FLOOR_BWH * calibration.model.subject.bwh)
    sides = "rl" if trial.joint is None else trial.joint[-1]
    tracks = joint_tracks(calibration.model.parameters, trial.body)

    def bar(names: tuple[str, ...], side: str, floor: float) -> float:
        return max(
            WITHIN
            * float(np.linalg.norm([errors.get(name.format(s=side), 0.0) for name in names])),
            floor,
        )

    return Curves(
        time=trial.body.time,
        labels=trial.recording.labels,
        markers=trial.recording.markers,
        angles=trial.body.q[:, at],
        angle_bars=angle_bars,
        torques=torques,
        torque_bars=torque_bars,
        valid=valid,
        centres={f"{joint}_{s}": tracks[f"{joint}_{s}"] for joint in PLACES for s in sides},
        centre_bars={
            f"{joint}_{s}": bar(names, s, FLOOR_M) for joint, names in PLACES.items() for s in sides
        },
        axis_bars={
            f"{joint}_{s}": bar(names, s, FLOOR_AXIS_RAD)
            for joint, names in DIRECTIONS.items()
            for s in sides
            if trial.joint == f"{joint}_{s}"
        },
    )


@dataclass(frozen=True)
class Movement:
    bars: float
    """In its own error bars."""
    words: str
    """Which, and its RMS in its unit."""


def largest(found: Mapping[str, Curves], clean: Mapping[str, Curves]) -> Movement | None:
    """The largest movement of any result of the trials that both runs have; None where there is
    none.
    """
    both = [
        movement
        for name, curve in found.items()
        if name in clean
        for movement in _movements(name, curve, clean[name])
        if np.isfinite(movement.bars)
    ]
    return max(both, key=lambda m: m.bars, default=None)


def _movements(trial: str, found: Curves, clean: Curves) -> list[Movement]:
    here, there = _shared_frames(found.time, clean.time)
    if len(here) == 0:
        return []
    out = []
    if found.angle_bars is not None:
        gap = np.abs(found.angles[here] - clean.angles[there])
        out += _columns(trial, ANGLES, gap, found.angle_bars[here], np.rad2deg(1.0), "deg")
    if found.torques is not None and found.torque_bars is not None and clean.torques is not None:
        both = found.valid[here] & clean.valid[there]
        if both.any():
            gap = np.abs(found.torques[here] - clean.torques[there])[both]
            names = [
                f"moment of {name}" for name in (*ANGLES, "knee_adduction_r", "knee_adduction_l")
            ]
            out += _columns(trial, names, gap, found.torque_bars[here][both], 1.0, "N·m")
    labels = [label for label in clean.labels if label in found.labels]
    before = clean.markers[there][:, [clean.labels.index(label) for label in labels]]
    after = found.markers[here][:, [found.labels.index(label) for label in labels]]
    rotation, origin = whole_turn(before, after)
    for joint, (centre, direction) in found.centres.items():
        if joint not in clean.centres:  # declared for another leg
            continue
        point, axis = (array[there] @ rotation.T for array in clean.centres[joint])
        if joint in found.axis_bars:
            turn = np.arccos(np.clip(np.abs((direction[here] * axis).sum(axis=1)), 0, 1))[:, None]
            bars = np.full_like(turn, found.axis_bars[joint])
            out += _columns(trial, [f"axis of {joint}"], turn, bars, np.rad2deg(1.0), "deg")
        gap = centre[here] - (point + origin)
        if not joint.startswith("hip"):
            gap = across(gap, axis)
        size = np.linalg.norm(gap, axis=1)[:, None]
        bars = np.full_like(size, found.centre_bars[joint])
        out += _columns(trial, [f"centre of {joint}"], size, bars, 1e3, "mm")
    return out


def _columns(
    trial: str, names: Sequence[str], gap: Array, bars: Array, unit: float, word: str
) -> list[Movement]:
    moved = np.sqrt(np.mean((gap / bars) ** 2, axis=0))
    sizes = unit * np.sqrt(np.mean(gap**2, axis=0))
    return [
        Movement(float(m), f"{trial}: {name} {s:.3g} {word}")
        for name, m, s in zip(names, moved, sizes, strict=True)
    ]


def _shared_frames(a: Array, b: Array) -> tuple[Array, Array]:
    """Indices of the frames of a and b of the same time, within half a frame."""
    step = min(np.median(np.diff(a)), np.median(np.diff(b)))
    nearest = np.clip(np.searchsorted(b, a), 1, len(b) - 1)
    nearest -= (a - b[nearest - 1]) < (b[nearest] - a)
    same = np.abs(b[nearest] - a) < 0.5 * step
    return np.flatnonzero(same), nearest[same]


SHARED = ("--jobs", "--only", "--list", "--json")
OWN = {
    "--all": option(False, "every attack on every base that it is meant for"),
    "--base": option([], "clean study; may be repeated", choices=list(EVERY)),
    "--quick": option(False, "the few that run as a test"),
    "--clean": option(False, "what is said of the clean recordings, no attack"),
}
SILENT_SHARE, ALARMED_SHARE = 0.02, 0.10
"""Largest shares of all attacks that may end so."""
LONGEST = 320
"""Letters of a message that are shown."""
CATCH_ALL = re.compile(r"look at plate positions, force sign and clock|held near nominal values")
"""Sentences that list every possible cause, or that speak of trials which the study has not: they
name nothing.
"""


class Ending(str, Enum):
    REFUSED = "refused"
    NAMED = "named"
    HARMLESS = "harmless"
    ALARMED = "alarmed"
    SILENT = "silent"
    CRASH = "crash"


@dataclass(frozen=True, kw_only=True)
class Run:
    """What a check and a calibration said, and came to."""

    refused: tuple[str, ...]
    """Why there is no result."""
    messages: tuple[str, ...] = ()
    """Everything that is said to a user who gets one: facts that need no action do not count."""
    curves: Mapping[str, Curves] = field(default_factory=dict)
    base: str = ""
    """Of a clean study."""
    seconds: float = 0.0


@dataclass(frozen=True)
class Result:
    attack: str
    """Its title."""
    kind: Kind
    ending: Ending
    messages: tuple[str, ...] = ()
    """What was said that is new, or the error."""
    moved: float | None = None
    """Largest movement of a result, in error bars; None where no result was made or none can be
    compared.
    """
    where: str = ""
    """Which result that is, and how far in its own unit."""
    seconds: float = 0.0
    cause_told: bool = True
    """Whether the error of a refused study names the cause."""

    @property
    def line(self) -> str:
        moved = "" if self.moved is None else f" {self.moved:.1f} error bars"
        return f"  {self.ending.value:9}{self.attack}" + (
            f":{moved} ({self.where})" if self.where else ""
        )


def calibrated(study: Study) -> Run:
    findings = check_study(study)
    if errors := [f for f in findings if f.severity is Severity.ERROR]:
        return Run(refused=tuple(f"{f.where}: {f.topic}: {f.evidence}; {f.cure}" for f in errors))
    calibration = calibrate(study, checked=findings)
    return Run(
        refused=refusal(calibration), messages=warned(calibration), curves=curves(calibration)
    )


def refusal(calibration: Calibration) -> tuple[str, ...]:
    """Why a finished calibration is refused; empty where it is not."""
    verdict = calibration.verdict
    wrong = verdict.judgement is Judgement.REFUSED
    return tuple(
        reason.line for reason in verdict.reasons if wrong and reason.severity is Severity.ERROR
    )


def warned(calibration: Calibration) -> tuple[str, ...]:
    late = [
        f"phase {p.name} did not converge: {p.message}"
        for p in calibration.phases
        if not p.converged
    ]
    return (*(reason.line for reason in calibration.verdict.reasons), *late)


def new(messages: Iterable[str], clean: Iterable[str]) -> tuple[str, ...]:
    """The messages that the clean run does not have; another number is no new message."""

    def bare(message: str) -> str:
        return re.sub(r"\s+", " ", re.sub(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "#", message))

    known = {bare(message) for message in clean}
    return tuple(message for message in dict.fromkeys(messages) if bare(message) not in known)


def names_cause(message: str, patterns: Sequence[str]) -> bool:
    return not CATCH_ALL.search(message) and all(
        re.search(pattern, message, re.IGNORECASE) for pattern in patterns
    )


def run_clean(base: str) -> Run:
    start = perf_counter()
    found = calibrated(loaded(base))
    return replace(found, base=base, seconds=perf_counter() - start)


def attacked(attack: Attack, clean: Run) -> Result:
    start = perf_counter()
    patterns = [pattern(words, loaded(attack.base).marker_set) for words in attack.named]

    def result(
        ending: Ending, messages: tuple[str, ...], moved: float | None = None, where: str = ""
    ) -> Result:
        told, seconds = any(names_cause(m, patterns) for m in messages), perf_counter() - start
        if told and ending is Ending.ALARMED:
            ending = Ending.NAMED
        return Result(attack.title, attack.kind, ending, messages, moved, where, seconds, told)

    try:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = calibrated(spoilt(attack, Path(folder))())
    except GaitcalError as error:
        return result(Ending.REFUSED, (str(error),))
    except CorpusError:
        raise
    except Exception:  # noqa: BLE001 - whatever else comes is what is looked for
        return result(Ending.CRASH, (traceback.format_exc(limit=-3),))
    if found.refused:
        return result(Ending.REFUSED, found.refused)
    said = new(found.messages, clean.messages)
    same_frames = {
        name: c
        for name, c in found.curves.items()
        if not (attack.other_frames and name == attack.where)
    }
    movement = largest(same_frames, clean.curves)
    moved, where = (
        (None, "no result to compare") if movement is None else (movement.bars, movement.words)
    )
    if said:
        return result(Ending.ALARMED, said, moved, where)
    return result(
        Ending.SILENT if moved is None or moved > 1.0 else Ending.HARMLESS, said, moved, where
    )


def run_title(title: str, clean: Run) -> Result:
    """The attack of that title, in another process."""
    return attacked(by_title()[title], clean)


def lines(results: Sequence[Result]) -> Iterator[str]:
    def counts(of: Sequence[Result]) -> list[int]:
        return [sum(r.ending is ending for r in of) for ending in Ending]

    yield f"{'':22}" + "".join(f"{ending.value:>10}" for ending in Ending) + f"{'all':>8}"
    for kind in (*(k for k in Kind if any(r.kind is k for r in results)), None):
        of_kind = [r for r in results if kind in (None, r.kind)]
        row = "".join(f"{c:10d}" for c in counts(of_kind))
        yield f"{kind.value if kind else 'all':22}{row}{len(of_kind):8d}"
    yield f"{'per cent':22}" + "".join(
        f"{100 * c / max(len(results), 1):10.1f}" for c in counts(results)
    )
    bad = {
        e.value: [r for r in results if r.ending is e]
        for e in (Ending.CRASH, Ending.SILENT, Ending.ALARMED)
    }
    bad["refused, but with other words than expected"] = [
        r for r in results if r.ending is Ending.REFUSED and not r.cause_told
    ]
    for words, found in bad.items():
        if found:
            yield f"\n{words}: {len(found)}"
        for r in sorted(found, key=lambda r: -(r.moved or 0.0)):
            yield r.line
            told = (" ".join(message.split()) for message in r.messages)
            yield from (f"      {m if len(m) <= LONGEST else m[:LONGEST] + ' ...'}" for m in told)


def passed(results: Sequence[Result]) -> bool:
    count = {ending: sum(r.ending is ending for r in results) for ending in Ending}
    return (
        count[Ending.CRASH] == 0
        and count[Ending.SILENT] <= SILENT_SHARE * len(results)
        and count[Ending.ALARMED] <= ALARMED_SHARE * len(results)
    )


def chosen_attacks(chosen: argparse.Namespace) -> list[Attack]:
    there, every = os.environ.get("GAITCAL_DATA"), corpus()
    wide = chosen.all or chosen.quick or chosen.base or chosen.only
    return [
        attack
        for attack in (every if wide else once_each(every))
        if (not chosen.only or re.search(chosen.only, attack.title, re.IGNORECASE))
        and (not chosen.base or attack.base in chosen.base)
        and (not chosen.quick or attack.quick)
        and (there or attack.base == SYNTHETIC)
    ]


def print_clean(clean: Iterable[Run]) -> None:
    for one in clean:
        say(
            f"{one.base}: {len(one.messages)} messages, {one.seconds:.1f} "
            f"s{' REFUSED' if one.refused else ''}"
        )
        for message in dict.fromkeys((*one.refused, *one.messages)):
            say(f"    {message}")


def run(chosen: argparse.Namespace) -> list[Result]:
    attacks = chosen_attacks(chosen)
    if chosen.list:
        say(*(attack.title for attack in attacks), f"{len(attacks)} attacks")
        return []
    bases = (
        chosen.base or list(EVERY)
        if chosen.clean
        else list(dict.fromkeys(attack.base for attack in attacks))
    )
    clean = list(side_by_side([partial(run_clean, base) for base in bases], chosen.jobs))
    if chosen.clean:
        print_clean(clean)
        return []
    of_base = {one.base: one for one in clean if not one.refused}
    if refused := [one for one in clean if one.refused]:
        say("clean studies that are refused, whose attacks are left out:")
        print_clean(refused)
        attacks = [attack for attack in attacks if attack.base in of_base]
    results: list[Result] = []
    tasks = [partial(run_title, attack.title, of_base[attack.base]) for attack in attacks]
    for result in side_by_side(tasks, chosen.jobs):
        results.append(result)
        print(f"{len(results):4d} of {len(attacks)}{result.line}", file=sys.stderr, flush=True)
    say(*lines(results))
    if refused:
        raise SystemExit(1)
    return results
