"""The undisturbed case: a model in motion with its ground reactions, small enough to travel with every task.

The draws disturb it: its own markers, without noise, are what each disturbed model is fitted to, and its own torques
are what each disturbed torque is compared with.

The case of a folder: the result of a calibration, or a study that is calibrated first.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gaitcal.errors import InputError, nearest
from gaitcal.files.package_data import models_path
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.model_file import load_model
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import MarkerPlacement, Subject
from gaitcal.motion.spline import spline_basis
from gaitcal.person.calibrate import calibrate
from gaitcal.person.result import Calibration
from gaitcal.runtime import Progress, silent
from gaitcal.study.study import Study
from gaitcal.synthetic.measurements import ground_reactions
from gaitcal.synthetic.motion import gait_motion

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class MonteCarloCase:
    """A model, its motion and the ground reactions on its feet."""

    name: str
    subject: Subject
    parameters: Parameters
    markers: MarkerPlacement
    time: Array
    """(nf,) s."""
    nodes: Array
    """(nn, 27) m, rad: quintic splines on clamped uniform knots over `time`."""
    wrench: Array
    """(nf, 2, 6) N, N·m about the laboratory origin, on the right and left foot."""
    valid: BoolArray
    """(nf,) frames whose torques count."""

    def fingerprint(self) -> Mapping[str, str]:
        """SHA-256 of each part: two cases with the same fingerprint give the same draws."""
        s, p, m = self.subject, self.parameters, self.markers
        return {
            "subject": _hash([repr((s.mass, s.height)).encode()]),
            "joint parameters": _hash([p.joint.tobytes(), p.zero_angles.tobytes()]),
            "inertial parameters": _hash([p.inertial.tobytes()]),
            "markers": _hash([repr((m.labels, m.segments)).encode(), m.local.tobytes(), m.weight.tobytes()]),
            "motion": _hash([self.time.tobytes(), np.ascontiguousarray(self.nodes).tobytes()]),
            "ground reactions": _hash([np.ascontiguousarray(self.wrench).tobytes(), self.valid.tobytes()]),
        }


def _hash(parts: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


def nominal_case() -> MonteCarloCase:
    """The built-in subject of the reproduction: one gait cycle, 208 frames, ground reactions without residual."""
    gait = json.loads((models_path() / "nominal_subject.json").read_text(encoding="utf-8"))["nominal_gait"]
    model, motion = published_model(), gait_motion()
    return MonteCarloCase(
        "nominal subject",
        model.subject,
        model.parameters,
        model.markers,
        motion.basis.time,
        motion.nodes,
        ground_reactions(model.parameters, motion, gait["cycle_s"]),
        np.ones(len(motion.basis.time), dtype=bool),
    )


def case_of(calibration: Calibration, trial: str | None = None) -> MonteCarloCase:
    """A calibrated person in one gait trial: the first with valid ground reactions, or the one named.

    Raises
    ------
    InputError
        No such trial, or none with a frame in which every foot on the ground is on a force plate.
    """
    loaded = {t.name: t for t in calibration.trials if t.loads is not None and t.loads.reactions.valid.any()}
    chosen = loaded[chosen_trial(tuple(loaded), trial, calibration.study.source)]
    reactions = chosen.loads.reactions if chosen.loads is not None else None
    if reactions is None:
        raise InputError("found no ground reactions", source=calibration.study.source)
    model, errors = calibration.model, chosen.body.errors
    return MonteCarloCase(
        chosen.name,
        model.subject,
        model.parameters,
        tracked_markers(model.markers, tuple(np.array(errors.labels)[errors.kept()].tolist())),
        chosen.body.time,
        chosen.body.nodes,
        reactions.wrench,
        reactions.valid,
    )


def chosen_trial(loaded: tuple[str, ...], wanted: str | None, source: object) -> str:
    """The trial to study, among those with valid ground reactions."""
    if not loaded:
        raise InputError(
            "found no gait trial with ground reactions under every foot; a Monte Carlo study of torques needs one",
            source=source,
        )
    if wanted is not None and wanted not in loaded:
        raise InputError(
            f"found '{wanted}'; allowed: {', '.join(loaded)}{nearest(wanted, loaded)}", source=source, field="--trial"
        )
    return wanted or loaded[0]


def tracked_markers(markers: MarkerPlacement, labels: tuple[str, ...]) -> MarkerPlacement:
    """Those markers of a model that a trial really had."""
    kept = [i for i, label in enumerate(markers.labels) if label in labels]
    return MarkerPlacement(
        tuple(markers.labels[i] for i in kept),
        tuple(markers.segments[i] for i in kept),
        markers.local[kept],
        markers.weight[kept],
    )


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
