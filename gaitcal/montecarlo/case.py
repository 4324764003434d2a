"""The undisturbed case of a Monte Carlo study: a model in motion with its ground reactions.

It is small enough to be sent with every task. The draws disturb it: each disturbed model is fitted
to its markers, which are without noise, and each disturbed torque is compared with its torques. The
case is the built-in subject of the reproduction, a calibrated person in one gait trial, or the
person of a folder: the result of a calibration, or a study that is calibrated first.
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
from gaitcal.errors import Code, InputError, suggest_name
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
"""Files of a result folder and of a study folder."""
_ARRAYS = ("time", "knots", "nodes", "wrench", "valid")
"""Arrays of each trial in `splines.npz`, their names followed by the number of the trial."""


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
    """(nf,) frames with valid torques."""

    def compute_fingerprint(self) -> Mapping[str, str]:
        """Compute a hash of each part: cases with equal fingerprints give equal draws.

        Returns
        -------
        mapping
            Part -> SHA-256.
        """
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
    """Compute SHA-256 of byte strings, each preceded by its length to keep them apart."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


@with_one_blas_thread
def make_nominal_case() -> MonteCarloCase:
    """Make the case of the built-in subject of the reproduction.

    Returns
    -------
    MonteCarloCase
        One gait cycle, 208 frames, ground reactions without residual.
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
def make_case(calibration: Calibration, trial: str | None = None) -> MonteCarloCase:
    """Make the case of a calibrated person in one gait trial.

    Parameters
    ----------
    calibration : Calibration
        The person.
    trial : str, optional
        Name of the trial; the first with valid ground reactions if not given.

    Returns
    -------
    MonteCarloCase

    Raises
    ------
    InputError
        No such trial, or none with a frame in which every foot on the ground is on a force plate.
    """
    reactions = {}
    for t in calibration.trials:
        if t.loads and t.loads.reactions.valid.any():
            reactions[t.name] = t.loads.reactions
    name = _choose_trial(tuple(reactions), trial, calibration.study.source)
    model, motion = calibration.model, calibration.trial(name).body
    # Markers that the trial does not show cannot be disturbed.
    observed = np.array(motion.errors.labels)[motion.errors.select_observed()].tolist()
    return MonteCarloCase(
        name=name,
        subject=model.subject,
        parameters=model.parameters,
        markers=_select_markers(model.markers, observed),
        time=motion.time,
        coefficients=motion.coefficients,
        wrench=reactions[name].wrench,
        valid=reactions[name].valid,
    )


def _choose_trial(loaded: tuple[str, ...], wanted: str | None, source: object) -> str:
    """Choose the trial to study among those with valid ground reactions."""
    if not loaded:
        message = (
            "found no gait trial with ground reactions under every foot; a Monte Carlo study of "
            "torques needs one"
        )
        raise InputError(message, source=source, code=Code.MONTE_CARLO)
    if wanted is not None and wanted not in loaded:
        message = f"found '{wanted}'; allowed: {', '.join(loaded)}{suggest_name(wanted, loaded)}"
        raise InputError(message, source=source, field="--trial", code=Code.OPTION)
    return wanted or loaded[0]


def _select_markers(markers: MarkerPlacement, labels: Container[str]) -> MarkerPlacement:
    """Select the markers of a model that a trial has."""
    kept = [i for i, label in enumerate(markers.labels) if label in labels]
    names = tuple(markers.labels[i] for i in kept)
    segments = tuple(markers.segments[i] for i in kept)
    return MarkerPlacement(names, segments, markers.local[kept], markers.weight[kept])


def load_case(
    folder: Path | str, trial: str | None = None, progress: Progress = silent
) -> MonteCarloCase:
    """Load the case of a result folder, or calibrate a study folder.

    Parameters
    ----------
    folder : path
        A result of `gaitcal calibrate`, or a folder with a `study.toml` (as `gaitcal synthesize`
        writes it), which is calibrated.
    trial : str, optional
        Name of the trial; the first with valid ground reactions if not given.
    progress : callable
        Called with a line of text at the beginning of each step.

    Returns
    -------
    MonteCarloCase

    Raises
    ------
    InputError
        The folder is neither, or no gait trial has ground reactions under every foot.
    """
    return read_case(folder, trial, progress)[0]


@with_one_blas_thread
def read_case(
    folder: Path | str, trial: str | None = None, progress: Progress = silent
) -> tuple[MonteCarloCase, Snapshot]:
    """Load a case as `load_case` does, with a snapshot of its files.

    The snapshot is compared with the files at the end of the work.

    Parameters
    ----------
    folder, trial, progress
        As of `load_case`.

    Returns
    -------
    MonteCarloCase, Snapshot

    Raises
    ------
    InputError
        As of `load_case`.
    """
    folder = Path(folder)
    require_person(folder)
    if (folder / MODEL).exists():
        # The name of the trial decides which file of marker errors belongs to the case.
        name, _ = read_whole(folder, (SPLINES,), lambda: _choose_stored_trial(folder, trial))
        files = (MODEL, SPLINES, _name_marker_errors(name))
        return read_whole(folder, files, lambda: _read_result(folder, name), (MODEL,))
    if (folder / STUDY).exists():
        study = Study.load(folder / STUDY)
        return make_case(calibrate(study, progress), trial), study.as_read
    message = (
        f"found neither {MODEL} nor {STUDY}; allowed: a result folder of 'gaitcal calibrate', or a "
        "study folder"
    )
    raise InputError(message, source=folder, code=Code.NO_RESULT)


@contextmanager
def _open_splines(path: Path) -> Iterator[Mapping[str, Array]]:
    """Open the arrays of `splines.npz`; InputError if it is damaged."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            yield stored
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error) as error:
        message = f"cannot be read: {error}; run 'gaitcal calibrate' again"
        raise InputError(message, source=path, code=Code.DAMAGED_RESULT) from None


def _choose_stored_trial(folder: Path, trial: str | None) -> str:
    """Choose the trial of a result folder to study."""
    with _open_splines(folder / SPLINES) as stored:
        names = enumerate(str(name) for name in stored["trials"])
        loaded = tuple(
            name for k, name in names if f"valid_{k}" in stored and stored[f"valid_{k}"].any()
        )
    return _choose_trial(loaded, trial, folder)


def _read_result(folder: Path, name: str) -> MonteCarloCase:
    """Read the case of a trial from a result folder."""
    model, path = load_model(folder / MODEL), folder / SPLINES
    with _open_splines(path) as stored:
        k = [str(trial) for trial in stored["trials"]].index(name)
        time, knots, coefficients, wrench, valid = (
            np.array(stored[f"{array}_{k}"]) for array in _ARRAYS
        )
    has_shapes = (
        coefficients.ndim == 2
        and coefficients.shape[1] == len(COORDINATES)
        and wrench.shape == (len(time), 2, 6)
    )
    if not has_shapes or not np.array_equal(
        build_spline_basis(time, len(coefficients)).knots, knots
    ):
        message = f"found other splines than this version writes for trial '{name}'"
        raise InputError(message, source=path, code=Code.DAMAGED_RESULT)
    errors = folder / _name_marker_errors(name)
    try:
        table = pd.read_csv(errors, comment="#")
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot be read: {error}", source=errors, code=Code.DAMAGED_RESULT
        ) from None
    # A column without any distance belongs to a marker that was never visible.
    observed = [label for label in table.columns if table[label].notna().any()]
    return MonteCarloCase(
        name=name,
        subject=model.subject,
        parameters=model.parameters,
        markers=_select_markers(model.markers, observed),
        time=time,
        coefficients=coefficients,
        wrench=wrench,
        valid=valid.astype(bool),
    )


def _name_marker_errors(trial: str) -> str:
    """Name the file of a trial's marker errors in a result folder."""
    return f"marker_errors/{trial}.csv"
