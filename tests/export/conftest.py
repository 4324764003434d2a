"""A subject with the published parameters and markers, and variants of it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitcal.export.osim import write_osim
from gaitcal.io.toml import models_path
from gaitcal.model.parameters import published_subject
from gaitcal.model.subject_model import MarkerPlacement, Subject, SubjectModel
from tests.export.peer_programs import peer

_SEGMENT = {"headtrunk": "head_trunk", "upperarm": "upper_arm", "forearmhand": "forearm_hand"}


def published_markers() -> MarkerPlacement:
    """The marker set of `models/nominal_subject.json`, static-only markers left out, left side mirrored."""
    data = json.loads((models_path() / "nominal_subject.json").read_text(encoding="utf-8"))
    labels, segments, local = [], [], []
    for body, markers in data["markers_local_mm_right_side"].items():
        segment = _SEGMENT.get(body, body)
        central = body in ("pelvis", "headtrunk")
        for name, position in markers.items():
            if name in data["static_only_markers"]:
                continue
            for side, sign in (("", 1.0),) if central else (("r", 1.0), ("l", -1.0)):
                labels.append(f"{side.upper()}.{name}" if side else name)
                segments.append(f"{segment}_{side}" if side else segment)
                local.append(np.array(position) * [1e-3, 1e-3, sign * 1e-3])
    return MarkerPlacement(tuple(labels), tuple(segments), np.array(local), np.ones(len(labels)))


@pytest.fixture
def osim() -> Any:
    """OpenSim, told to be quiet and to leave no log file behind."""
    opensim = peer("opensim")
    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Error")
    return opensim


@pytest.fixture
def mujoco() -> Any:
    """MuJoCo."""
    return peer("mujoco")


@pytest.fixture(scope="session")
def published() -> SubjectModel:
    parameters = published_subject()
    subject = Subject("published", 69.4, 1.70, "male")
    return SubjectModel(subject=subject, parameters=parameters, nominal=parameters, markers=published_markers())


@pytest.fixture
def own(published: SubjectModel, tmp_path: Path) -> Path:
    """The subject as a file of OpenSim."""
    write_osim(published, tmp_path / "m.osim")
    return tmp_path / "m.osim"
