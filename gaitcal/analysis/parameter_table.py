"""Tabulate joint and inertial parameters: nominal, fitted, standard error, status."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitcal.analysis.result import Calibration
from gaitcal.model.parameters import IP_NAMES, IP_TO_SI, IP_UNITS, JOINT_PARAMETERS

if TYPE_CHECKING:
    import pandas as pd


def parameter_table(calibration: Calibration) -> "pd.DataFrame":
    """One row for each of the 98 joint and 84 inertial parameters, as in `parameters.csv`.

    Columns: `name`, `kind` (joint position, joint orientation, mass, mass centre, moment of
    inertia), `segment` whose axes it is told in, `joint`, `unit` (mm, deg, kg, kg*mm^2), `nominal`,
    `fitted`, `standard_error` (NaN where none), `status`: `fitted`, `fixed` (of mass centres and
    moments, by the table, from where the joints are now), or `unidentifiable` (kept, as these
    trials do not show it).
    """
    import pandas as pd

    return pd.DataFrame(parameter_rows(calibration))


def parameter_rows(calibration: Calibration) -> list[dict[str, Any]]:
    """The rows of `parameter_table`, by the names of its columns; `standard_error` is None where
    there is none.
    """
    nominal, fitted, inertial = (
        calibration.nominal.parameters,
        calibration.model.parameters,
        calibration.inertial,
    )
    errors, free = (
        calibration.standard_errors,
        set(calibration.joint.free if calibration.joint else ()),
    )
    if inertial is not None and inertial.moved:
        free |= {
            n
            for n, moved in zip(IP_NAMES, np.abs(inertial.jacobian).sum(axis=1) > 0, strict=True)
            if moved
        }
    kinds = {"mass": "mass", "com": "mass centre", "moi": "moment of inertia"}

    def row(
        name: str,
        kind: str,
        segment: str,
        joint: str,
        unit: str,
        values: Sequence[float],
        to_si: float,
    ) -> dict[str, Any]:
        error = errors.get(name)
        return {
            "name": name,
            "kind": kind,
            "segment": segment,
            "joint": joint,
            "unit": unit,
            "nominal": float(values[0] / to_si),
            "fitted": float(values[1] / to_si),
            "standard_error": None if error is None else float(error / to_si),
            "status": "unidentifiable"
            if name in calibration.unidentifiable
            else "fitted"
            if name in free
            else "fixed",
        }

    rows = [
        row(p.name, f"joint {p.kind.value}", p.segment, p.joint, p.kind.unit, values, p.kind.to_si)
        for p, *values in zip(JOINT_PARAMETERS, nominal.joint, fitted.joint, strict=True)
    ]
    for name, unit, to_si, *values in zip(
        IP_NAMES, IP_UNITS, IP_TO_SI, nominal.inertial, fitted.inertial, strict=True
    ):
        segment, quantity = name.split(".", 1)
        rows.append(row(name, kinds[quantity.split(".")[0]], segment, "", unit, values, to_si))
    return rows
