"""Read a result of `gaitcal calibrate`: model and settings for further trials; single trials."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np

from gaitcal.analysis.result import Uncertainty
from gaitcal.arrays import Array, BoolArray
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.soft_tissue_artefact import AngleUnit, FoundTissue
from gaitcal.errors import Code, Finding, InputError
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.io.opensim_files import parse_trc, read_table
from gaitcal.io.recording import Recording
from gaitcal.io.result_folder import MANIFEST, read_json_object
from gaitcal.io.snapshot import Snapshot, read_whole
from gaitcal.model.linkage import COORDINATES, REACTIONS, SIDES, is_translation
from gaitcal.model.marker_set import MarkerSet, load_marker_set
from gaitcal.model.model_file import load_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.quality.verdict import Judgement
from gaitcal.results.summary import (
    STATIC_ANGLES,
    SUMMARY,
    find_model_doubts,
    get_entries,
    get_table,
)
from gaitcal.study.settings import CalibrationSettings
from gaitcal.tracking.motion import MarkerErrors, Motion
from gaitcal.tracking.spline import build_spline_basis

MODEL, MARKER_SET, UNCERTAINTY = "model.toml", "marker_set.toml", "uncertainty.npz"
AGAIN: Final = "run it again"
OTHER_MODEL: Final = f"made by an earlier run with another model than {MODEL} now is"
DYNAMICS: Final = "dynamics"  # Folder of a result that `gaitcal dynamics` writes


@dataclass(frozen=True, kw_only=True)
class SavedResult:
    """A calibrated subject, and how the labels of its recordings are read."""

    model: SubjectModel
    files: Snapshot  # What was read, to be compared when the work is done
    marker_set: MarkerSet  # With the weights of the model
    rename: Mapping[str, str]  # Label in the files -> label in the marker set
    settings: CalibrationSettings
    uncertainty: Uncertainty
    doubts: tuple[Finding, ...] = ()  # Findings of its verdict that concern every further trial
    relative_to: Mapping[str, float] | None = None
    """Coordinate -> rad in the static posture, where joint angles are counted from it."""


def load_result(folder: Path) -> SavedResult:
    """Read a result; model and marker set may have been edited, which `files.remarks` reports.

    Parameters
    ----------
    folder
        A result folder.

    Returns
    -------
    SavedResult
        What further trials need.

    Raises
    ------
    InputError
        The folder is not a result, or one of its files is damaged, missing or unreadable.
    """
    editable = (MODEL, MARKER_SET)
    saved, files = read_whole(
        folder, (*editable, UNCERTAINTY, SUMMARY), lambda: _read(folder), editable
    )
    return replace(saved, files=files)


def load_result_model(folder: Path) -> tuple[SubjectModel, Snapshot, tuple[Finding, ...]]:
    """Read the model of a result, which may have been edited.

    Parameters
    ----------
    folder
        A result folder.

    Returns
    -------
    SubjectModel
        The model.
    Snapshot
        The files that were read.
    tuple of Finding
        Findings of the calibration that concern the model.

    Raises
    ------
    InputError
        As of `load_result`.
    """

    def read() -> tuple[SubjectModel, tuple[Finding, ...]]:
        return load_model(folder / MODEL), find_model_doubts(read_json_object(folder / SUMMARY))

    (model, doubts), files = read_whole(folder, (MODEL, SUMMARY), read, (MODEL,))
    return model, files, doubts


def load_settings(folder: Path) -> CalibrationSettings:
    """Read the settings of the study of a result.

    Parameters
    ----------
    folder
        A result folder.

    Returns
    -------
    CalibrationSettings
        Unknown entries of another version are ignored.

    Raises
    ------
    InputError
        The folder is not a result.
    """
    settings = get_table(read_json_object(folder / MANIFEST), "settings")
    if not settings:
        message = "no result of 'gaitcal calibrate': its manifest.json cannot be read"
        raise InputError(message, source=folder, code=Code.NO_RESULT)
    known = {k: v for k, v in settings.items() if k in CalibrationSettings.model_fields}
    return CalibrationSettings.model_validate(known)


def _read(folder: Path) -> SavedResult:
    model = load_model(folder / MODEL)
    manifest = read_json_object(folder / MANIFEST)
    summary, settings = read_json_object(folder / SUMMARY), load_settings(folder)
    return SavedResult(
        model=model,
        files=Snapshot(folder, {}),
        marker_set=load_marker_set(folder / MARKER_SET).with_weights(
            dict(zip(model.markers.labels, map(float, model.markers.weight), strict=True))
        ),
        rename={k: str(v) for k, v in get_table(manifest, "rename").items()},
        settings=settings,
        uncertainty=load_uncertainty(folder / UNCERTAINTY),
        doubts=find_model_doubts(summary),
        relative_to=_read_static_angles(summary, folder) if settings.angles == "relative" else None,
    )


def _read_static_angles(summary: Mapping[str, object], folder: Path) -> dict[str, float]:
    angles = summary.get(STATIC_ANGLES)
    if not isinstance(angles, dict) or not angles:
        message = "found none; angles = 'relative' needs them: calibrate again"
        raise InputError(message, source=folder / SUMMARY, code=Code.NO_RESULT)
    return {str(name): float(np.deg2rad(value)) for name, value in angles.items()}


def save_uncertainty(uncertainty: Uncertainty, path: Path) -> None:
    """Write `uncertainty.npz`: joint error sources, inertial covariance root, soft tissue artefact.

    Parameters
    ----------
    uncertainty
        Of a finished calibration.
    path
        The file.
    """
    arrays: dict[str, np.ndarray] = {}
    if uncertainty.joint is not None:
        arrays["joint_free"] = np.array(uncertainty.joint.names, dtype=str)
        arrays["joint_clusters"] = np.array(uncertainty.joint.sources, dtype=str)
        arrays["joint"] = uncertainty.joint.effects
    if uncertainty.inertial is not None:
        arrays["inertial"] = uncertainty.inertial
    # NumPy stores no mappings: names and values side by side.
    for name, values in (
        ("tissue", uncertainty.tissue.values),
        ("softness", uncertainty.tissue.softness),
    ):
        arrays[f"{name}_names"], arrays[name] = (
            np.array(list(values), dtype=str),
            np.array(list(values.values())),
        )
    units = uncertainty.tissue.units
    arrays["unit_names"] = np.array(list(units), dtype=str)
    arrays["units"] = np.array([[unit.size, unit.bend] for unit in units.values()]).reshape(-1, 2)
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def load_uncertainty(path: Path) -> Uncertainty:
    """Read `uncertainty.npz`.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Uncertainty
        As `save_uncertainty` wrote it.

    Raises
    ------
    InputError
        The file is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            joint = None
            if "joint" in stored:
                names = tuple(str(n) for n in stored["joint_free"])
                joint = ErrorSources(
                    names, stored["joint"], tuple(str(c) for c in stored["joint_clusters"])
                )
            found = FoundTissue()  # of results that were tracked with markers in their places
            if "tissue" in stored:
                values, softness = (
                    dict(zip(map(str, stored[f"{name}_names"]), stored[name].tolist(), strict=True))
                    for name in ("tissue", "softness")
                )
                names_of_units = map(str, stored["unit_names"])
                units = {
                    name: AngleUnit(*unit)
                    for name, unit in zip(names_of_units, stored["units"].tolist(), strict=True)
                }
                found = FoundTissue(values, softness, units)
            return Uncertainty(joint, stored.get("inertial"), found)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InputError(
            f"cannot be read: {error}", source=path, code=Code.DAMAGED_RESULT
        ) from None


SPLINES = "splines.npz"


@dataclass(frozen=True, kw_only=True)
class SavedWalk:
    """One moving trial of a result: its motion, torques and verdict."""

    name: str
    model: SubjectModel
    motion: Motion
    markers: Recording  # As it was tracked: y up, x forward
    torques: Mapping[str, Array] | None
    """Coordinate or knee reaction -> (nf,) N·m; None without force plates, or where the trial is
    refused.
    """
    valid: Mapping[str, BoolArray]  # Side -> (nf,) frames whose torques count
    reactions: Mapping[
        str, Array
    ]  # Side -> (nf, 3) N on its foot, laboratory's axes; none without force plates
    facts: Mapping[str, str]  # Verdict and the like, of the summary
    reasons: tuple[str, ...]  # Of the verdict, as far as they concern the trial
    events: tuple[FootEvent, ...]  # Of a walk, in order of time; those of the file too


def list_moving_trials(folder: Path) -> list[str]:
    """List the trials of a result with a motion, in the order of `splines.npz`.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    try:
        with np.load(folder / SPLINES, allow_pickle=False) as stored:
            return [str(name) for name in stored["trials"]]
    except (OSError, ValueError, KeyError, EOFError) as error:
        message = f"cannot be read: {error}; calibrate again"
        raise InputError(message, source=folder / SPLINES, code=Code.DAMAGED_RESULT) from None


def load_recorded_coordinates(folder: Path) -> dict[str, Array]:
    """Load the coordinates in the trials that move them.

    Parameters
    ----------
    folder
        A result folder.

    Returns
    -------
    dict
        Coordinate -> values (m, rad) in the frames of `select_moving_frames`; empty without
        motions.
    """
    found = []
    for k, _ in enumerate(list_moving_trials(folder)):
        with np.load(folder / SPLINES, allow_pickle=False) as stored:
            time, coefficients = np.array(stored[f"time_{k}"]), np.array(stored[f"nodes_{k}"])
        found.append(build_spline_basis(time, len(coefficients)).evaluate(coefficients))
    return select_moving_frames(found) if found else {}


def select_moving_frames(motions: Sequence[Array]) -> dict[str, Array]:
    """Select, for each coordinate, the trials with at least half of its largest range.

    Parameters
    ----------
    motions
        (nf, 27) of each trial, m and rad.

    Returns
    -------
    dict
        Coordinate -> values (m, rad) in the frames of these trials.
    """
    ranges = np.array([np.ptp(q, axis=0) for q in motions])
    moves = ranges >= 0.5 * ranges.max(axis=0)
    out = {}
    for k, name in enumerate(COORDINATES):
        moving = [q[:, k] for q, moved in zip(motions, moves[:, k], strict=True) if moved]
        out[name] = np.concatenate(moving)
    return out


def load_trial(folder: Path, k: int, name: str) -> SavedWalk:
    """Load one moving trial; the caller ensures that its files are unchanged (`read_whole`).

    Parameters
    ----------
    folder
        A result folder.
    k
        Position of the trial in `list_moving_trials`.
    name
        Its name.

    Returns
    -------
    SavedWalk
        Motion, markers, torques and verdict.
    """
    model = load_model(folder / MODEL)
    with np.load(folder / SPLINES, allow_pickle=False) as stored:
        time, coefficients = np.array(stored[f"time_{k}"]), np.array(stored[f"nodes_{k}"])
    # Knots follow from times and number of coefficients; motion and derivatives are exact.
    motion = Motion(
        name=name,
        coordinates=COORDINATES,
        basis=build_spline_basis(time, len(coefficients)),
        coefficients=coefficients,
        errors=MarkerErrors((), (), np.zeros(0), np.zeros((len(time), 0))),
        converged=True,
    )
    summary = read_json_object(folder / SUMMARY)
    of_trial = get_table(get_table(summary, "trials"), name)
    facts: dict[str, str] = {
        key: str(of_trial[key]) for key in ("verdict", "verdict_r", "verdict_l") if key in of_trial
    }
    facts.setdefault("verdict", str(summary.get("verdict", "")))
    torques, valid = _read_torques(folder / "moments" / f"{name}.csv", len(time))
    # A refused walk has curves in its file, but no torque may be used.
    refused = Judgement.REFUSED.value in (facts["verdict"], summary.get("verdict"))
    return SavedWalk(
        name=name,
        model=model,
        motion=motion,
        markers=parse_trc(folder / "markers" / f"{name}.trc"),
        torques=None if refused else torques,
        valid=valid,
        reactions=_read_reactions(folder / "forces" / f"{name}.mot"),
        facts=facts,
        reasons=_list_reasons(summary, name),
        events=parse_events(of_trial),
    )


def parse_events(of_trial: Mapping[str, object]) -> tuple[FootEvent, ...]:
    """Parse foot strikes and foot offs from the entry of a trial in `summary.json`."""
    known = {moment.value: moment for moment in FootMoment}
    return tuple(
        FootEvent(known[e["event"]], e["side"], float(e["time"]))
        for e in get_entries(of_trial, "events")
        if e.get("event") in known
        and e.get("side") in SIDES
        and isinstance(e.get("time"), int | float)
    )


def _read_reactions(path: Path) -> dict[str, Array]:
    if not path.exists():
        return {}
    table = read_table(path)
    out = {}
    for side in SIDES:
        parts = [table.get_column(f"ground_force_{side}_v{axis}") for axis in "xyz"]
        out[side] = np.stack(parts, axis=1)
    return out


def _read_torques(
    path: Path, frames: int
) -> tuple[Mapping[str, Array] | None, Mapping[str, BoolArray]]:
    """Read torques of a trial (N·m) and valid frames by side; None without force plates."""
    if not path.exists():
        return None, {side: np.zeros(frames, dtype=bool) for side in SIDES}
    import pandas as pd

    table = pd.read_csv(path, comment="#")
    names = [name for name in (*COORDINATES, *REACTIONS) if not is_translation(name)]
    valid = {
        s: table[f"valid_{s}" if f"valid_{s}" in table else "valid"].to_numpy() == 1 for s in SIDES
    }
    return {name: table[name].to_numpy(dtype=np.float64) for name in names if name in table}, valid


def _list_reasons(summary: Mapping[str, object], trial: str) -> tuple[str, ...]:
    concern = [
        e for e in get_entries(summary, "reasons") if not e.get("trials") or trial in e["trials"]
    ]
    return tuple(f"{entry.get('cause')}: {entry.get('evidence')}" for entry in concern)


def select_stale_trials(folder: Path, trials: list[str], digest: str | None) -> tuple[str, ...]:
    """Select the trials that were made with another model.

    Parameters
    ----------
    folder
        Folder of further trials.
    trials
        Names.
    digest
        SHA-256 of the present model.

    Returns
    -------
    tuple of str
        Names.
    """
    digests = get_table(read_json_object(folder / MANIFEST), "model_sha256")
    return tuple(name for name in trials if digests.get(name) != digest)
