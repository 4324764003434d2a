"""How many spline nodes a second? Frames left out of the fit, predicted by it.

    python scripts/check_nodes.py STUDY.toml [STUDY.toml ...]

Every moving trial of the studies (its first 600 frames) is tracked with the nominal model, a tenth of its frames left
out, singly or in runs of five. Printed: RMS distance of all weighted markers in those frames, mm, for each rate. Too
few nodes cannot follow the person; too many follow the noise of the frames that were used.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import NodeRule, trial_problem
from gaitcal.person.prepare import prepare_trial
from gaitcal.recording import Recording
from gaitcal.study.study import Role, Study, nominal_of

RATES = (8, 10, 12, 15, 20, 25, 30, 40)
RUNS = (1, 5)
FRAMES = 600
SHARE = 0.1


def left_out(frames: int, run: int) -> np.ndarray:
    """(frames,) bool: runs of `run` frames, about a tenth of all, the ends kept."""
    held = np.zeros(frames, dtype=bool)
    starts = np.arange(10, frames - 10 - run, 2 * run)
    count = min(len(starts) // 2, max(4, int(SHARE * frames / run)))
    for start in np.random.default_rng(7).choice(starts, size=count, replace=False):
        held[start : start + run] = True
    return held


def prediction_error(model: SubjectModel, recording: Recording, held: np.ndarray, rate: float) -> float:
    """RMS over weighted markers of the frames left out, mm."""
    rule = NodeRule(per_second=rate)
    markers = recording.markers.copy()
    markers[held] = np.nan
    used = trial_problem(recording.source, model, replace(recording, markers=markers), rule)
    whole = trial_problem(recording.source, model, recording, rule)
    if used.data.measured.shape != whole.data.measured.shape:
        return float("nan")  # a marker seen in those frames alone
    constants = used.constants(model.parameters)
    tracked = track_nodes(used, constants, starting_nodes(used.chain, constants, used.data, used.basis))
    away = ((used.positions(tracked.nodes, constants) - whole.data.measured) ** 2).sum(axis=1) * whole.data.weight
    return float(1e3 * np.sqrt(away[:, held].sum() / whole.data.weight[:, held].sum()))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("studies", nargs="+", type=Path, metavar="STUDY.toml")
    print(f"{'mm in the frames left out; nodes a second:':<44}" + "".join(f"{rate:>8}" for rate in RATES))
    for file in parser.parse_args(arguments).studies:
        study = Study.load(file)
        model = nominal_of(study)
        for trial in study.trials:
            if trial.role is Role.STATIC:
                continue
            whole = prepare_trial(trial, model, study.settings).recording
            recording = replace(whole, time=whole.time[:FRAMES], markers=whole.markers[:FRAMES])
            for run in RUNS:
                held = left_out(len(recording.time), run)
                errors = [prediction_error(model, recording, held, float(rate)) for rate in RATES]
                name = f"{study.subject.name} {trial.name}, {held.sum()} frames in runs of {run}"
                print(f"{name:<44}" + "".join(f"{error:8.3f}" for error in errors), flush=True)


if __name__ == "__main__":
    main()
