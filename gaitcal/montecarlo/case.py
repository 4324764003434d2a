"""The undisturbed case: a model in motion with its ground reactions, small enough to travel with
every task.

The draws disturb it: its own markers, without noise, are what each disturbed model is fitted to,
and its own torques are what each disturbed torque is compared with. It is the built-in subject of
the reproduction, a calibrated person in one gait trial, or the person of a folder: the result of a
calibration, or a study that is calibrated first.

Two real people stand beside the unpublished experimental trial: `subject01` (a walk with ground
reactions) and `uf3` (isolated trials of six joints and a walk), from the folder that GAITCAL_DATA
names, as any user's study.
"""

import hashlib
import zlib
from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import pandas as pd

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.result import Calibration
from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Code, InputError, nearest
from gaitcal.io.snapshot import Snapshot, read_whole, require_person
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.model_file import load_model
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import MarkerPlacement, Subject
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.study.study import Study
from gaitcal.synthetic.synthetic_motion import compute_residual_free_wrench, simulate_gait
from gaitcal.tracking.spline import build_spline_basis

SPLINES, MODEL, STUDY = "splines.npz", "model.toml", "study.toml"


@dataclass(frozen=True, kw_only=True)
class MonteCarloCase:
    """A model, its motion and the ground reactions on its feet."""

    name: str
    subject: Subject
    parameters: Parameters
    markers: MarkerPlacement
    time: Array
    """(nf,) s."""
    coefficients: Array
    """(nn, 27) m, rad: quintic splines on clamped uniform knots over `time`."""
    wrench: Array
    """(nf, 2, 6) N, N·m about the laboratory origin, on the right and left foot."""
    valid: BoolArray
    """(nf,) frames whose torques count."""

    def fingerprint(self) -> Mapping[str, str]:
        """SHA-256 of each part: two cases with the same fingerprint give the same draws."""
        s, p, m = self.subject, self.parameters, self.markers
        return {
            "subject": _hash(repr((s.mass, s.height)).encode()),
            "joint parameters": _hash(p.joint.tobytes(), p.zero_angles.tobytes()),
            "inertial parameters": _hash(p.inertial.tobytes()),
            "markers": _hash(
                repr((m.labels, m.segments)).encode(), m.local.tobytes(), m.weight.tobytes()
            ),
            "motion": _hash(self.time.tobytes(), self.coefficients.tobytes()),
            "ground reactions": _hash(self.wrench.tobytes(), self.valid.tobytes()),
        }


def _hash(*parts: bytes) -> str:
    """SHA-256 of byte strings, each with its length before it, so that none runs into the next."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


@with_one_blas_thread
def nominal_case() -> MonteCarloCase:
    """The built-in subject of the reproduction: one gait cycle, 208 frames, ground reactions
    without residual.
    """
    model, motion = published_model(), simulate_gait()
    return MonteCarloCase(
        name="nominal subject",
        subject=model.subject,
        parameters=model.parameters,
        markers=model.markers,
        time=motion.basis.time,
        coefficients=motion.coefficients,
        wrench=compute_residual_free_wrench(model.parameters, motion),
        valid=np.ones(len(motion.basis.time), dtype=bool),
    )


@with_one_blas_thread
def case_of(calibration: Calibration, trial: str | None = None) -> MonteCarloCase:
    """A calibrated person in one gait trial: the first with valid ground reactions, or the one
    named.

    Raises InputError: No such trial, or none with a frame in which every foot on the ground is on a
    force plate.
    """
    reactions = {
        t.name: t.loads.reactions
        for t in calibration.trials
        if t.loads and t.loads.reactions.valid.any()
    }
    name = _chosen_trial(tuple(reactions), trial, calibration.study.source)
    model, motion = calibration.model, calibration.trial(name).body
    return MonteCarloCase(
        name=name,
        subject=model.subject,
        parameters=model.parameters,
        markers=_tracked(
            model.markers, np.array(motion.errors.labels)[motion.errors.select_observed()].tolist()
        ),
        time=motion.time,
        coefficients=motion.coefficients,
        wrench=reactions[name].wrench,
        valid=reactions[name].valid,
    )


def _chosen_trial(loaded: tuple[str, ...], wanted: str | None, source: object) -> str:
    """The trial to study, among those with valid ground reactions."""
    if not loaded:
        message = (
            "found no gait trial with ground reactions under every foot; a Monte Carlo study of "
            "torques needs one"
        )
        raise InputError(message, source=source, code=Code.MONTE_CARLO)
    if wanted is not None and wanted not in loaded:
        message = f"found '{wanted}'; allowed: {', '.join(loaded)}{nearest(wanted, loaded)}"
        raise InputError(message, source=source, field="--trial", code=Code.OPTION)
    return wanted or loaded[0]


def _tracked(markers: MarkerPlacement, labels: Container[str]) -> MarkerPlacement:
    """Those markers of a model that a trial really had."""
    kept = [i for i, label in enumerate(markers.labels) if label in labels]
    names, segments = (tuple(of[i] for i in kept) for of in (markers.labels, markers.segments))
    return MarkerPlacement(names, segments, markers.local[kept], markers.weight[kept])


def case_from(
    folder: Path | str, trial: str | None = None, progress: Progress = silent
) -> MonteCarloCase:
    """The calibrated person of a result folder, in its first gait trial with ground reactions or
    the one named.

    A folder with a `study.toml` and no result (as `gaitcal synthesize` writes it) is calibrated
    first.

    Raises InputError: The folder is neither, or no gait trial has ground reactions under every
    foot.
    """
    return read_case(folder, trial, progress)[0]


@with_one_blas_thread
def read_case(
    folder: Path | str, trial: str | None = None, progress: Progress = silent
) -> tuple[MonteCarloCase, Snapshot]:
    """As `case_from`, and the files that it was made from, to be compared when the work is done."""
    folder = Path(folder)
    require_person(folder)
    if (folder / MODEL).exists():
        name, _ = read_whole(folder, (SPLINES,), lambda: _trial_of(folder, trial))
        files = (MODEL, SPLINES, _marker_errors(name))
        return read_whole(folder, files, lambda: _of_result(folder, name), (MODEL,))
    if (folder / STUDY).exists():
        study = Study.load(folder / STUDY)
        return case_of(calibrate(study, progress), trial), study.as_read
    message = (
        f"found neither {MODEL} nor {STUDY}; allowed: a result folder of 'gaitcal calibrate', or a "
        "study folder"
    )
    raise InputError(message, source=folder, code=Code.NO_RESULT)


@contextmanager
def _splines(path: Path) -> Iterator[Mapping[str, Array]]:
    """The arrays of `splines.npz`; InputError on what NumPy, zipfile and zlib raise where it is not
    what it seems.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            yield stored
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error) as error:
        message = f"cannot be read: {error}; run 'gaitcal calibrate' again"
        raise InputError(message, source=path, code=Code.DAMAGED_RESULT) from None


def _trial_of(folder: Path, trial: str | None) -> str:
    """The trial of a result to study: the one named, or the first with valid ground reactions."""
    with _splines(folder / SPLINES) as stored:
        names = enumerate(str(name) for name in stored["trials"])
        loaded = tuple(
            name for k, name in names if f"valid_{k}" in stored and stored[f"valid_{k}"].any()
        )
    return _chosen_trial(loaded, trial, folder)


def _of_result(folder: Path, name: str) -> MonteCarloCase:
    model, path = load_model(folder / MODEL), folder / SPLINES
    with _splines(path) as stored:
        k = [str(trial) for trial in stored["trials"]].index(name)
        parts = ("time", "knots", "nodes", "wrench", "valid")
        time, knots, coefficients, wrench, valid = (
            np.array(stored[f"{part}_{k}"]) for part in parts
        )
    whole = (
        coefficients.ndim == 2
        and coefficients.shape[1] == len(COORDINATES)
        and wrench.shape == (len(time), 2, 6)
    )
    if not whole or not np.array_equal(build_spline_basis(time, len(coefficients)).knots, knots):
        message = f"found other splines than this version writes for trial '{name}'"
        raise InputError(message, source=path, code=Code.DAMAGED_RESULT)
    errors = folder / _marker_errors(name)
    try:
        table = pd.read_csv(errors, comment="#")
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot be read: {error}", source=errors, code=Code.DAMAGED_RESULT
        ) from None
    return MonteCarloCase(
        name=name,
        subject=model.subject,
        parameters=model.parameters,
        markers=_tracked(
            model.markers, [label for label in table.columns if table[label].notna().any()]
        ),
        time=time,
        coefficients=coefficients,
        wrench=wrench,
        valid=valid.astype(bool),
    )


def _marker_errors(trial: str) -> str:
    return f"marker_errors/{trial}.csv"
