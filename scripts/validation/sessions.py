"""Do two recordings of one person differ by as much as their error bars say, and does a shared model help?

    sessions [--parts real,made-up,angles] [--people 10] [--seed 0] [--out DIR]

real      every walk of `labs_c3d/multi` calibrated by itself: how many differences of curves are inside bars of 68 and
          95 % (joint parameters of real recordings: `people --parts pairs`)
made-up   two sessions of a person of our own linkage: the same joints, markers put on anew by 10 mm, other noise;
          errors of the joint parameters of each alone and of both together (`gaitcal compare A B --shared-model`)
angles    the angles of the same people's sessions, through result folders: inside their error bars?

`--out` keeps the results of `real`, and reads them if they are there.

Walks of one recorded person, each a result of its own: do their curves differ by as much as their error bars say?

How strides vary is taken from one calibration of all walks, so that what calibrations differ by is not in it. Joint
parameters of two recordings: `python -m scripts.validation people`, part `pairs`.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from gaitcal import calibrate, write_results
from gaitcal.arrays import Array
from gaitcal.compare.difference import pooled, shared_variance
from gaitcal.compare.stride_sets import Session, common_to, mean_over, stride_sets
from gaitcal.gait.cycles import Kind, kind_of
from gaitcal.results.sessions import load_session
from scripts.validation import made_up_sessions
from scripts.validation.error_bars import coverage
from scripts.validation.harness import commas, say, side_by_side
from scripts.validation.recordings import only, study_of_person

SHARED = ("--jobs", "--seed")


def _real(chosen: argparse.Namespace) -> Iterable[str]:
    with tempfile.TemporaryDirectory() as folder:
        yield from real_report(chosen.out or Path(folder))


def _seeds(chosen: argparse.Namespace) -> range:
    return range(chosen.seed, chosen.seed + chosen.people)


def _outcomes(chosen: argparse.Namespace) -> list[made_up_sessions.Outcome]:
    return list(side_by_side([partial(made_up_sessions.outcome, seed) for seed in _seeds(chosen)], chosen.jobs))


PARTS: dict[str, Callable[[argparse.Namespace], Iterable[str]]] = {
    "real": _real,
    "made-up": lambda chosen: made_up_sessions.report(_outcomes(chosen)),
    "angles": lambda chosen: made_up_sessions.angles_report(_seeds(chosen)),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Parts and people."""
    parser.add_argument("--parts", type=commas(PARTS), default=list(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--people", type=int, default=10, help="made-up people")
    parser.add_argument("--out", type=Path, help="folder that keeps the results")


def run(chosen: argparse.Namespace) -> None:
    """Print the figures, part by part."""
    for part in chosen.parts:
        for line in PARTS[part](chosen):
            say(line)


PERSON = "multi"
"""Five walks over force plates."""


def results(out: Path) -> tuple[list[Session], Session]:
    """Every walk calibrated by itself, and all together; what lies in `out` already is read."""
    study = study_of_person(PERSON)
    found = []
    for name, trials in (*((walk, (walk,)) for walk in study.walks), ("all", study.walks)):
        result = out / PERSON / name
        if not (result / "manifest.json").exists():
            write_results(calibrate(only(study, *trials)), result)
        found.append(load_session(result)[0])
    return found[:-1], found[-1]


def curve_scores(walks: list[Session], together: Session) -> dict[Kind, Array]:
    """Kind -> differences of the curves of two walks in standard errors, every tenth percent."""
    alone = {key: pooled([s.values]) for key, s in stride_sets(together).items()}
    spread = {key: np.where(found.freedom > 1, found.variance, np.nan) for key, found in alone.items()}
    sets = {session.name: stride_sets(session) for session in walks}
    out: dict[Kind, list[Array]] = {}
    for a, b in itertools.combinations(walks, 2):
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


def real_report(out: Path) -> Iterator[str]:
    """A line for each kind of curve."""
    for kind, z in curve_scores(*results(out)).items():
        yield f"{PERSON}: {kind.words}s: {coverage(z)}"
