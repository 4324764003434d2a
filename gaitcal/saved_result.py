"""What a result folder of `gaitcal calibrate` keeps for further trials: model, marker set, labels, settings, spread."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from gaitcal.errors import InputError
from gaitcal.model.marker_set import MarkerSet, built_in_sets, load_marker_set
from gaitcal.model.model_file import load_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.output import MARKER_SET, load_uncertainty
from gaitcal.ownership import MANIFEST, read_object
from gaitcal.settings import CalibrationSettings
from gaitcal.study.uncertainty import Uncertainty


@dataclass(frozen=True)
class SavedResult:
    """A calibrated person, and how the labels of their recordings are read."""

    model: SubjectModel
    model_file: Path
    marker_set: MarkerSet
    """With the weights of the model."""
    rename: Mapping[str, str]
    """Label in the files -> label in the marker set."""
    settings: CalibrationSettings
    spread: Uncertainty


def load_result(folder: Path) -> SavedResult:
    """Read a result folder.

    Raises
    ------
    InputError
        It is none, or one of its files cannot be read.
    """
    model_file = folder / "model.toml"
    model = load_model(model_file)
    manifest = read_object(folder / MANIFEST)
    settings = manifest.get("settings")
    if not isinstance(settings, dict):
        raise InputError("no result of 'gaitcal calibrate': its manifest.json cannot be read", source=folder)
    known = {k: v for k, v in settings.items() if k in CalibrationSettings.model_fields}
    rename = manifest.get("rename")
    return SavedResult(
        model,
        model_file,
        _marker_set(folder, manifest, model),
        {str(k): str(v) for k, v in rename.items()} if isinstance(rename, dict) else {},
        CalibrationSettings.model_validate(known),
        load_uncertainty(folder / "uncertainty.npz"),
    )


def _marker_set(folder: Path, manifest: Mapping[str, object], model: SubjectModel) -> MarkerSet:
    """As it was saved; of results that saved none, the built-in set, or what the model tells of one's own."""
    weights = dict(zip(model.markers.labels, map(float, model.markers.weight), strict=True))
    if (folder / MARKER_SET).exists():
        return load_marker_set(folder / MARKER_SET).with_weights(weights)
    name = str(manifest.get("marker_set"))
    if name in built_in_sets():
        return load_marker_set(name).with_weights(weights)
    tracking: dict[str, tuple[str, ...]] = {}
    for label, segment in zip(model.markers.labels, model.markers.segments, strict=True):
        tracking[segment] = (*tracking.get(segment, ()), label)
    return MarkerSet(name, "of the model", {}, tracking, weights=weights)
