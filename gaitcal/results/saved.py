"""What a result folder of `gaitcal calibrate` keeps for further trials: model, labels, settings, uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from gaitcal.calibration.influence import Influence
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.findings import Finding
from gaitcal.io.ownership import MANIFEST, read_object
from gaitcal.io.snapshot import Snapshot, read_whole
from gaitcal.model.marker_roles import MarkerSet
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.model_file import load_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.results.summary import STATIC_ANGLES
from gaitcal.results.verdict import SUMMARY, of_the_model
from gaitcal.session.result import Uncertainty
from gaitcal.study.settings import CalibrationSettings

MODEL, MARKER_SET, UNCERTAINTY = "model.toml", "marker_set.toml", "uncertainty.npz"


@dataclass(frozen=True, kw_only=True)
class SavedResult:
    """A calibrated person, and how the labels of their recordings are read."""

    model: SubjectModel
    files: Snapshot
    """What was read, to be compared when the work is done."""
    marker_set: MarkerSet
    """With the weights of the model."""
    rename: Mapping[str, str]
    """Label in the files -> label in the marker set."""
    settings: CalibrationSettings
    uncertainty: Uncertainty
    doubts: tuple[Finding, ...] = ()
    """What its verdict says of every further trial."""
    relative_to: Mapping[str, float] | None = None
    """Coordinate -> rad in the static posture, where joint angles are counted from it."""


def load_result(folder: Path) -> SavedResult:
    """Read a result folder. Model and marker set may have been edited, which `files.remarks` tells.

    Raises
    ------
    InputError
        It is none, or one of its files is damaged, missing, or cannot be read.
    """
    editable = (MODEL, MARKER_SET)
    saved, files = read_whole(folder, (*editable, UNCERTAINTY, SUMMARY), lambda: _read(folder), editable)
    return replace(saved, files=files)


def load_result_model(folder: Path) -> tuple[SubjectModel, Snapshot, tuple[Finding, ...]]:
    """The model of a result folder alone, which may have been edited, and what speaks against it.

    Raises
    ------
    InputError
        As of `load_result`.
    """

    def read() -> tuple[SubjectModel, tuple[Finding, ...]]:
        return load_model(folder / MODEL), of_the_model(read_object(folder / SUMMARY))

    (model, doubts), files = read_whole(folder, (MODEL, SUMMARY), read, (MODEL,))
    return model, files, doubts


def _read(folder: Path) -> SavedResult:
    model = load_model(folder / MODEL)
    manifest = read_object(folder / MANIFEST)
    settings = manifest.get("settings")
    if not isinstance(settings, dict):
        raise InputError(
            "no result of 'gaitcal calibrate': its manifest.json cannot be read", source=folder, code=Code.NO_RESULT
        )
    known = {k: v for k, v in settings.items() if k in CalibrationSettings.model_fields}
    rename = manifest.get("rename")
    summary = read_object(folder / SUMMARY)
    chosen = CalibrationSettings.model_validate(known)
    return SavedResult(
        model=model,
        files=Snapshot(folder, {}),
        marker_set=load_marker_set(folder / MARKER_SET).with_weights(
            dict(zip(model.markers.labels, map(float, model.markers.weight), strict=True))
        ),
        rename={str(k): str(v) for k, v in rename.items()} if isinstance(rename, dict) else {},
        settings=chosen,
        uncertainty=load_uncertainty(folder / UNCERTAINTY),
        doubts=of_the_model(summary),
        relative_to=_static_angles(summary, folder) if chosen.angles == "relative" else None,
    )


def _static_angles(summary: Mapping[str, object], folder: Path) -> dict[str, float]:
    angles = summary.get(STATIC_ANGLES)
    if not isinstance(angles, dict) or not angles:
        raise InputError(
            "found none; angles = 'relative' needs them: calibrate again", source=folder / SUMMARY, code=Code.NO_RESULT
        )
    return {str(name): float(np.deg2rad(value)) for name, value in angles.items()}


def save_uncertainty(uncertainty: Uncertainty, path: Path) -> None:
    """What further trials need for standard errors: influences on the joint parameters, spread of the inertial."""
    arrays: dict[str, np.ndarray] = {}
    if uncertainty.joint is not None:
        arrays["joint_free"] = np.array(uncertainty.joint.free, dtype=str)
        arrays["joint_clusters"] = np.array(uncertainty.joint.clusters, dtype=str)
        arrays["joint"] = uncertainty.joint.parameters
    if uncertainty.inertial is not None:
        arrays["inertial"] = uncertainty.inertial
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def load_uncertainty(path: Path) -> Uncertainty:
    """Read back what `save_uncertainty` wrote."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            joint = None
            if "joint" in stored:
                names = tuple(str(n) for n in stored["joint_free"])
                joint = Influence(names, stored["joint"], tuple(str(c) for c in stored["joint_clusters"]))
            return Uncertainty(joint, stored.get("inertial"))
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InputError(f"cannot be read: {error}", source=path, code=Code.DAMAGED_RESULT) from None
