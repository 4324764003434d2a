"""The case of a folder: the result of a calibration, or a study that is calibrated first."""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import pandas as pd

from gaitcal.errors import InputError
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.model_file import load_model
from gaitcal.motion.spline import spline_basis
from gaitcal.study.monte_carlo.case import MonteCarloCase, case_of, chosen_trial, tracked_markers
from gaitcal.study.person import Study
from gaitcal.study.pipeline import calibrate
from gaitcal.study.progress import Progress, silent

SPLINES, MODEL, STUDY = "splines.npz", "model.toml", "study.toml"


def case_from(folder: Path | str, trial: str | None = None, progress: Progress = silent) -> MonteCarloCase:
    """The calibrated person of a result folder, in its first gait trial with ground reactions or the one named.

    A folder with a `study.toml` and no result (as `gaitcal synthesize` writes it) is calibrated first.

    Raises
    ------
    InputError
        The folder is neither, or no gait trial has ground reactions under every foot.
    """
    folder = Path(folder)
    if (folder / MODEL).exists():
        return _of_result(folder, trial)
    if (folder / STUDY).exists():
        return case_of(calibrate(Study.load(folder / STUDY), progress), trial)
    raise InputError(
        f"found neither {MODEL} nor {STUDY}; allowed: a result folder of 'gaitcal calibrate', or a study folder",
        source=folder,
    )


def _of_result(folder: Path, trial: str | None) -> MonteCarloCase:
    model, path = load_model(folder / MODEL), folder / SPLINES
    try:
        with np.load(path, allow_pickle=False) as stored:
            names = [str(name) for name in stored["trials"]]
            loaded = [name for k, name in enumerate(names) if f"valid_{k}" in stored and stored[f"valid_{k}"].any()]
            name = chosen_trial(tuple(loaded), trial, folder)
            k = names.index(name)
            parts = ("time", "knots", "nodes", "wrench", "valid")
            time, knots, nodes, wrench, valid = (np.array(stored[f"{part}_{k}"]) for part in parts)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InputError(f"cannot be read: {error}; run 'gaitcal calibrate' again", source=path) from None
    whole = nodes.ndim == 2 and nodes.shape[1] == len(COORDINATES) and wrench.shape == (len(time), 2, 6)
    if not whole or not np.array_equal(spline_basis(time, len(nodes)).knots, knots):
        raise InputError(f"found other splines than this version writes for trial '{name}'", source=path)
    markers = tracked_markers(model.markers, _tracked_labels(folder / "marker_errors" / f"{name}.csv"))
    return MonteCarloCase(name, model.subject, model.parameters, markers, time, nodes, wrench, valid.astype(bool))


def _tracked_labels(path: Path) -> tuple[str, ...]:
    """Markers that a trial really had: those with a distance in any frame."""
    try:
        table = pd.read_csv(path, comment="#")
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", source=path) from None
    return tuple(str(label) for label in table.columns if label != "time" and table[label].notna().any())
