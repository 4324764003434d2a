"""The published subject, as a model and as a file, and the programs that it is read by."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gaitcal.export.opensim.osim_writer import write_osim
from gaitcal.model.nominal import published_model
from gaitcal.model.subject_model import SubjectModel
from tests.export.peer_programs import peer


@pytest.fixture
def osim() -> Any:
    """OpenSim without output and log file."""
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
    """With its markers, and no landmark."""
    return replace(published_model(), landmarks={}, notes=())


@pytest.fixture
def osim_file(published: SubjectModel, tmp_path: Path) -> Path:
    """The subject as a file of OpenSim."""
    write_osim(published, tmp_path / "m.osim")
    return tmp_path / "m.osim"
