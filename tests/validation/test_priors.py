"""`python -m scripts.validation priors`: its populations, and what it prints of figures that are
known.
"""

from dataclasses import replace

import numpy as np

from gaitcal.calibration.error_sources import make_nominal_errors
from gaitcal.calibration.joint_prior import get_prior_deviations
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_NAMES, ParameterKind
from scripts.validation.people.fits import Fit
from scripts.validation.priors import Outcome, report


def _fit(joint: np.ndarray) -> Fit:
    """Joint parameters with error bars as large as those of nominal ones."""
    nominal, errors = published_model(), make_nominal_errors()
    bars = np.array([errors.standard_errors[name] for name in JP_NAMES])
    fitted = replace(nominal.parameters, joint=joint)
    return Fit(name="made up", nominal=nominal, parameters=fitted, errors=bars, influence=errors)


def test_errors_and_bars() -> None:
    """A fit that halves the error of every parameter, with bars of twice the error that remains."""
    unit, third = (
        get_prior_deviations(JP_NAMES),
        sum(name.startswith(LEG_JOINTS) for name in JP_NAMES) // 3,
    )
    outcomes = [
        Outcome(
            truth=np.zeros(len(JP_NAMES)),
            nominal=unit,
            fits={"default prior": _fit(0.5 * unit), "cohort": _fit(0.25 * unit)},
            information=np.diag(np.repeat([0.0, 1.0, 10.0], third)),
        )
    ]
    said = list(report(outcomes))
    legs = [
        k
        for k, p in enumerate(JOINT_PARAMETERS)
        if p.kind is ParameterKind.POSITION and p.name.startswith(LEG_JOINTS)
    ]
    rms = 1e3 * np.sqrt(np.mean(unit[legs] ** 2))
    assert said[0] == (
        f"legs, positions, mm: nominal {rms:.2f}, default prior {rms / 2:.2f}, cohort "
        f"{rms / 4:.2f} (-50 %)"
    )
    assert said[-1] == "bars of 95 % cover: default prior 100%, cohort 100%"
    assert any(line.startswith(f"directions half seen ({third} of {3 * third})") for line in said)
