"""Angles of the two sessions of made-up people (`made_up.py`), through result folders: inside their error bars?

Both sessions walk the very same walk, so that all that differs is error: of markers that were put on anew and of their
noise. Strides do not vary otherwise, and what is theirs is the error of their own markers alone.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gaitcal import Study, calibrate, write_results
from gaitcal.arrays import Array
from gaitcal.compare.difference import shared_variance
from gaitcal.compare.session import Session, common_to
from gaitcal.compare.stride_sets import mean_over, stride_sets
from gaitcal.results.sessions import load_session
from gaitcal.synthetic.subject import synthetic_model
from scripts.validation.error_bars import coverage
from scripts.validation.sessions.made_up import record_session

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


def report(seeds: range) -> Iterator[str]:
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
