"""A moving trial as a result folder keeps it: read back for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.faults.verdict import Judgement
from gaitcal.io.metadata import FootEvent, FootMoment
from gaitcal.io.ownership import read_object
from gaitcal.io.recording import Recording
from gaitcal.io.trc import parse_trc
from gaitcal.model.linkage import COORDINATES, REACTIONS, SIDES, is_translation
from gaitcal.model.model_file import load_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import MarkerErrors, Motion
from gaitcal.motion.spline import spline_basis
from gaitcal.results.saved import MODEL
from gaitcal.results.verdict import SUMMARY

SPLINES = "splines.npz"


@dataclass(frozen=True, kw_only=True)
class SavedTrial:
    """One moving trial of a result folder: its motion, torques and verdict."""

    name: str
    model: SubjectModel
    motion: Motion
    markers: Recording
    """As it was tracked: y up, x forward."""
    torques: Mapping[str, Array] | None
    """Coordinate or knee reaction -> (nf,) N·m; None without force plates, or where the trial is refused."""
    valid: Mapping[str, BoolArray]
    """Side -> (nf,) frames whose torques count."""
    facts: Mapping[str, str]
    """Verdict and the like, of the summary."""
    reasons: tuple[str, ...]
    """Of the verdict, as far as they concern the trial."""
    events: tuple[FootEvent, ...]
    """Of a walk, in order of time; those of the file too."""


def moving_trials(folder: Path) -> list[str]:
    """Names of the trials whose motion a result holds, in the order of its `splines.npz`."""
    try:
        with np.load(folder / SPLINES, allow_pickle=False) as stored:
            return [str(name) for name in stored["trials"]]
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(
            f"cannot be read: {error}; calibrate again", source=folder / SPLINES, code=Code.DAMAGED_RESULT
        ) from None


def load_trial(folder: Path, k: int, name: str) -> SavedTrial:
    """The trial `name`, the `k`-th of `moving_trials`; the caller sees to it that files are whole (`read_whole`)."""
    model = load_model(folder / MODEL)
    with np.load(folder / SPLINES, allow_pickle=False) as stored:
        time, nodes = np.array(stored[f"time_{k}"]), np.array(stored[f"nodes_{k}"])
    motion = Motion(
        name=name,
        coordinates=COORDINATES,
        basis=spline_basis(time, len(nodes)),
        nodes=nodes,
        errors=MarkerErrors((), (), np.zeros(0), np.zeros((len(time), 0))),
        converged=True,
    )
    summary = read_object(folder / SUMMARY)
    trials = summary.get("trials")
    of_trial = trials.get(name, {}) if isinstance(trials, dict) else {}
    facts = {key: str(of_trial[key]) for key in ("verdict", "verdict_r", "verdict_l") if key in of_trial}
    facts.setdefault("verdict", str(summary.get("verdict", "")))
    torques, valid = _torques(folder / "moments" / f"{name}.csv", len(time))
    refused = Judgement.REFUSED.value in (facts["verdict"], summary.get("verdict"))
    return SavedTrial(
        name=name,
        model=model,
        motion=motion,
        markers=parse_trc(folder / "markers" / f"{name}.trc"),
        torques=None if refused else torques,
        valid=valid,
        facts=facts,
        reasons=_reasons(summary, name),
        events=saved_events(of_trial.get("events")),
    )


def saved_events(stored: object) -> tuple[FootEvent, ...]:
    """Foot strikes and offs of the summary."""
    entries = [entry for entry in stored if isinstance(entry, dict)] if isinstance(stored, list) else []
    known = {moment.value: moment for moment in FootMoment}
    return tuple(
        FootEvent(known[e["event"]], e["side"], float(e["time"]))
        for e in entries
        if e.get("event") in known and e.get("side") in SIDES and isinstance(e.get("time"), int | float)
    )


def _torques(path: Path, frames: int) -> tuple[Mapping[str, Array] | None, Mapping[str, BoolArray]]:
    """Torques of a trial (N·m) and the frames in which they count, by side; None without force plates."""
    if not path.exists():
        return None, {side: np.zeros(frames, dtype=bool) for side in SIDES}
    table = pd.read_csv(path, comment="#")
    names = [name for name in (*COORDINATES, *REACTIONS) if not is_translation(name)]
    valid = {s: table[f"valid_{s}" if f"valid_{s}" in table else "valid"].to_numpy() == 1 for s in SIDES}
    return {name: table[name].to_numpy(dtype=np.float64) for name in names if name in table}, valid


def _reasons(summary: Mapping[str, object], trial: str) -> tuple[str, ...]:
    stored = summary.get("reasons")
    entries = [entry for entry in stored if isinstance(entry, dict)] if isinstance(stored, list) else []
    concern = [entry for entry in entries if not entry.get("trials") or trial in entry["trials"]]
    return tuple(f"{entry.get('cause')}: {entry.get('evidence')}" for entry in concern)
