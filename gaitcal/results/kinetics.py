"""Joint powers and moment vectors of a trial in a result folder: written, and read back for exports."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.subject_model import SubjectModel
from gaitcal.results.table_file import refused_lines, write_csv
from gaitcal.session.kinetic_tables import POWER_HEADER, VECTOR_HEADER, power_table, vector_table
from gaitcal.session.result import TrialResult

if TYPE_CHECKING:
    import pandas as pd

POWER_FOLDER, VECTOR_FOLDER = "powers", "moment_vectors"
DIGITS = 6
"""A millionth of a watt or newton metre."""


def write_kinetics(trial: TrialResult, model: SubjectModel, out: Path) -> None:
    """`powers/TRIAL.csv` and `moment_vectors/TRIAL.csv` of a trial with force plates; else nothing."""
    loads = trial.loads
    if loads is None or loads.kinetics is None:
        return
    of_powers = power_table(loads, loads.kinetics, model.subject.mass)
    of_vectors = vector_table(loads, loads.kinetics)
    tables = ((POWER_FOLDER, of_powers, POWER_HEADER), (VECTOR_FOLDER, of_vectors, VECTOR_HEADER))
    for folder, table, header in tables:
        (out / folder).mkdir(exist_ok=True)
        write_csv(_short(table), out / folder / f"{trial.name}.csv", (*refused_lines(trial), *header))


def read_vectors(folder: Path, trial: str) -> pd.DataFrame | None:
    """The moment vectors of a trial of a result; None where there are none: no force plates."""
    import pandas as pd

    path = folder / VECTOR_FOLDER / f"{trial}.csv"
    return pd.read_csv(path, comment="#") if path.exists() else None


def _short(table: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Rounded, but for the time."""
    return {name: values if name == "time" else np.round(values, DIGITS) for name, values in table.items()}
