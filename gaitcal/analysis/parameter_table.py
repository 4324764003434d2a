"""Tabulate joint and inertial parameters: nominal, fitted, standard error, status."""

from typing import TYPE_CHECKING, Any

import numpy as np

from gaitcal.analysis.result import Calibration
from gaitcal.model.parameters import IP_NAMES, IP_TO_SI, IP_UNITS, JOINT_PARAMETERS, JP_INDEX

if TYPE_CHECKING:
    import pandas as pd

_INERTIAL_KINDS = {"mass": "mass", "com": "mass centre", "moi": "moment of inertia"}
"""First part of an inertial parameter's name, after its segment -> kind."""


def parameter_table(calibration: Calibration) -> "pd.DataFrame":
    """Tabulate the 98 joint and 84 inertial parameters, a row each, as in `parameters.csv`.

    Parameters
    ----------
    calibration : Calibration
        From `calibrate` or `run_study`.

    Returns
    -------
    pandas.DataFrame
        Columns `name`; `kind` (joint position, joint orientation, mass, mass centre, moment of
        inertia); `segment` whose axes the value refers to; `joint`; `unit` (mm, deg, kg, kg*mm^2);
        `nominal`; `fitted`; `standard_error` (NaN if there is none); `status`: `fitted`, `fixed`
        (mass centres and moments then follow the table and the fitted joints), or `unidentifiable`
        (kept, because these trials do not determine it); `prior_mean` and `prior_sd`: of joint
        parameters before any moving trial (anatomy, study file or cohort). NaN for inertial
        parameters, whose prior is the anthropometric table at the fitted joints, and in the
        published protocol, which bounds the joint parameters instead.
    """
    import pandas as pd

    return pd.DataFrame(list_parameter_rows(calibration))


def list_parameter_rows(calibration: Calibration) -> list[dict[str, Any]]:
    """List the rows of `parameter_table`.

    Parameters
    ----------
    calibration : Calibration
        From `calibrate` or `run_study`.

    Returns
    -------
    list of dict
        Column -> value; `standard_error`, `prior_mean` and `prior_sd` are None if there is none.
    """
    nominal, fitted = calibration.nominal.parameters, calibration.model.parameters
    errors, free = calibration.standard_errors, _list_fitted_names(calibration)
    priors = _index_priors(calibration)

    def make_row(
        name: str, to_si: float, before: float, after: float, **columns: str
    ) -> dict[str, Any]:
        error = errors.get(name)
        status = "fitted" if name in free else "fixed"
        if name in calibration.unidentifiable:
            status = "unidentifiable"
        prior_mean, prior_sd = (
            (None, None) if name not in priors else (float(x / to_si) for x in priors[name])
        )
        return {
            "name": name,
            **columns,
            "nominal": float(before / to_si),
            "fitted": float(after / to_si),
            "standard_error": None if error is None else float(error / to_si),
            "status": status,
            "prior_mean": prior_mean,
            "prior_sd": prior_sd,
        }

    rows = []
    for p, before, after in zip(JOINT_PARAMETERS, nominal.joint, fitted.joint, strict=True):
        kind, unit = f"joint {p.kind.value}", p.kind.unit
        rows.append(
            make_row(
                p.name,
                p.kind.to_si,
                before,
                after,
                kind=kind,
                segment=p.segment,
                joint=p.joint,
                unit=unit,
            )
        )
    for name, unit, to_si, before, after in zip(
        IP_NAMES, IP_UNITS, IP_TO_SI, nominal.inertial, fitted.inertial, strict=True
    ):
        # `thigh_r.com.ant`: segment, quantity, direction.
        segment, quantity = name.split(".", 1)
        kind = _INERTIAL_KINDS[quantity.split(".")[0]]
        rows.append(
            make_row(name, to_si, before, after, kind=kind, segment=segment, joint="", unit=unit)
        )
    return rows


def _index_priors(calibration: Calibration) -> dict[str, tuple[float, float]]:
    """Index the prior mean and standard deviation (m, rad) by joint parameter."""
    prior, nominal = calibration.joint_prior, calibration.nominal.parameters
    if prior is None:
        return {}
    # The prior is one of deviations from nominal values.
    deviations = np.sqrt(np.diag(prior.covariance))
    return {
        name: (float(nominal.joint[JP_INDEX[name]] + mean), float(sd))
        for name, mean, sd in zip(prior.names, prior.mean, deviations, strict=True)
    }


def _list_fitted_names(calibration: Calibration) -> set[str]:
    """List the parameters that the fits may move."""
    names = set(calibration.joint.free if calibration.joint else ())
    inertial = calibration.inertial
    if inertial is not None and inertial.moved:
        for name, derivatives in zip(IP_NAMES, inertial.jacobian, strict=True):
            if np.abs(derivatives).sum() > 0:
                names.add(name)
    return names
