"""`python -m scripts.validation priors`: its populations, and what it prints of figures that are known."""

from dataclasses import replace

import numpy as np

from gaitcal.calibration.error_sources import nominal_errors
from gaitcal.calibration.joint_prior import prior_deviations
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_NAMES, Kind
from gaitcal.study.joint_prior import Person, mirror
from scripts.validation.people.fits import Fit
from scripts.validation.priors import POPULATIONS, Outcome, report, scaled

ANYBODY = Person(height=1.7, sex="male")


def test_offsets_are_the_same_on_both_sides_and_wide_people_have_none() -> None:
    means = {}
    for name, population in POPULATIONS.items():
        draw, rng = population(np.random.default_rng(1)), np.random.default_rng(2)
        means[name] = np.mean([draw(rng, ANYBODY) for _ in range(400)], axis=0) / scaled(1.0, 1.0)
    np.testing.assert_allclose(
        mirror(JP_NAMES) @ means["offset"], means["offset"], atol=0.7
    )  # 2 mm / sqrt(400), 7-fold
    assert np.abs(means["wide"]).max() < 1.5 and np.abs(means["offset"]).max() > 7.0


def _fit(joint: np.ndarray) -> Fit:
    """Joint parameters with error bars as large as those of nominal ones."""
    nominal, errors = published_model(), nominal_errors()
    bars = np.array([errors.standard_errors[name] for name in JP_NAMES])
    fitted = replace(nominal.parameters, joint=joint)
    return Fit(name="made up", nominal=nominal, parameters=fitted, errors=bars, influence=errors)


def test_errors_and_bars() -> None:
    """A fit that halves the error of every parameter, with bars of twice the error that remains."""
    unit = prior_deviations(JP_NAMES)
    outcomes = [
        Outcome(
            truth=np.zeros(len(JP_NAMES)),
            nominal=unit,
            fits={"default prior": _fit(0.5 * unit), "cohort": _fit(0.25 * unit)},
            information=np.diag(np.repeat([0.0, 1.0, 10.0], 18)),
        )
    ]
    said = list(report(outcomes))
    legs = [k for k, p in enumerate(JOINT_PARAMETERS) if p.kind is Kind.POSITION and p.name.startswith(LEG_JOINTS)]
    rms = 1e3 * np.sqrt(np.mean(unit[legs] ** 2))
    assert said[0] == (
        f"legs, positions, mm: nominal {rms:.2f}, default prior {rms / 2:.2f}, cohort {rms / 4:.2f} (-50 %)"
    )
    assert said[-1] == "bars of 95 % cover: default prior 100%, cohort 100%"
    assert any(line.startswith("directions half seen (18 of 54)") for line in said)
