"""Parts `skin` and `drawn`: do error bars hold the joints of simulated people whose markers move as
people's skin does?

The joints of `opensim_truth` lie where OpenSim's model has them, up to 2.4 standard deviations off
the prior, the same in every draw. So in part `drawn` the prior is moved instead of the person: its
mean is the truth plus a draw from its covariance, and by that the truth is a draw from the prior.
Markers move as the soft tissue of people does (`truth/skin.py`), drawn for every person. An
estimate that takes from either what it should has errors as large as its standard errors, and is
nearer than the prior alone; whatever else is a fault of the estimate, not of these two people.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaitcal import Study
from gaitcal.arrays import Array
from gaitcal.calibration.joint_prior import ANATOMY
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import JP_INDEX, JP_TO_SI
from gaitcal.preprocess.study_model import build_nominal_model
from scripts.validation.harness import bars, rms
from scripts.validation.people.fits import fitted
from scripts.validation.recordings import changed, data, only
from scripts.validation.truth.people import (
    IsolatedPerson,
    isolated_person,
    leg_parameters,
    static_frames,
)
from scripts.validation.truth.skin import TABLE_MM, Kind, disturbed

TRIALS = {"gait": ("gait",), "isolated": ("joint",), "gait and isolated": ("gait", "joint")}
"""Words -> roles of the trials that are calibrated."""
WAVES_MM = 10.0
"""Of the published waves; other kinds have the size of their table."""
DIRECTIONS_MM = ("ant", "sup", "lat")
Rows = dict[tuple[str, str], list[Array]]
"""(trials, joint and unit) -> of each fit, (n, 3) mm or deg: error of the prior's mean, of the fit,
standard error.
"""


def add_fits(
    rows: Rows,
    person: str,
    kind: Kind,
    seed: int,
    settings: Mapping[str, object],
    cache: Path,
    *,
    drawn: bool,
) -> None:
    """Fit one person with the soft tissue of a seed by each choice of trials; `drawn`: with a prior
    of that seed.
    """
    made = isolated_person(person, data() / "opensim_truth", cache, with_gait=True)
    streams = [np.random.default_rng([seed, *person.encode(), *more]) for more in ((), (1,))]
    size = WAVES_MM if kind is Kind.SINUSOIDS and not drawn else TABLE_MM
    study = changed(
        disturbed(made.study, kind, size, int(streams[0].integers(2**31)) if drawn else seed),
        settings,
    )
    truth, nominal = true_parameters(made, study)
    at, true = np.array([JP_INDEX[name] for name in truth]), np.array(list(truth.values()))
    prior = nominal[at] - true
    if drawn:
        study, draw = prior_about_truth(made, study, streams[1])
        prior = draw[at]
    groups = defaultdict(list)
    for k, name in enumerate(truth):
        joint, direction = name.partition("_")[0], name.rpartition(".")[2]
        groups[f"{joint}, {'mm' if direction in DIRECTIONS_MM else 'deg'}"].append(k)
    for words, roles in TRIALS.items():
        fit = fitted(person, only(study, *roles))
        every = (
            np.stack([prior, fit.parameters.joint[at] - true, fit.errors[at]], axis=1)
            / JP_TO_SI[at, None]
        )
        for group, members in groups.items():
            rows.setdefault((words, group), []).append(every[members])


def true_parameters(made: IsolatedPerson, study: Study) -> tuple[dict[str, float], Array]:
    """Joint parameters of the legs (m, rad), and all nominal ones (98,)."""
    nominal = build_nominal_model(study)
    frames = static_frames(nominal, study.static.recording)
    truth = {
        name: value for side in SIDES for name, value in leg_parameters(made, frames, side).items()
    }
    return truth, nominal.parameters.joint


def prior_about_truth(
    made: IsolatedPerson, study: Study, rng: np.random.Generator
) -> tuple[Study, Array]:
    """A study of a person with a prior of which the person is a draw; and the draw, as
    `JP_NAMES`.
    """
    truth, nominal = true_parameters(made, study)
    at = np.array([JP_INDEX[name] for name in truth])
    draw = rng.multivariate_normal(0 * ANATOMY.mean, ANATOMY.covariance)
    mean = ANATOMY.mean.copy()
    mean[at] = np.array(list(truth.values())) - nominal[at] + draw[at]
    return replace(study, joint_prior=replace(ANATOMY, mean=mean)), draw


def hips_in_space(rows: Rows) -> Rows:
    """Distances of hips in space: sqrt(3) times the errors along each axis, in the mean square."""
    return {
        (words, "hip in space, mm"): [np.sqrt(3.0) * f for f in rows[words, "hip, mm"]]
        for words in TRIALS
    }


def lines(rows: Rows, out: dict[str, float], label: str = "") -> Iterator[str]:
    """How large errors are, and how many the bars hold; figures into `out`, whose names begin with
    `label`.
    """
    yield (
        f"{'joint parameters, RMS':44}{'n':>6}{'prior':>9}{'fitted':>9}"
        f"{'SE':>7}{'z':>7}{'in 68 %':>9}{'in 95 %':>9}"
    )
    for (words, group), fits in sorted(rows.items()):
        prior, error, se = np.concatenate(fits).T
        name, shares, z = f"{label}{words}: {group}", bars(error, se).shares, rms(error / se)
        yield (
            f"{name:44}{len(error):6}{rms(prior):9.2f}{rms(error):9.2f}{rms(se):7.2f}{z:7.2f}"
            f"{shares[0]:9.0f}{shares[1]:9.0f}"
        )
        out |= {f"{name}: RMS": rms(error), f"{name}: z": z, f"{name}: in 95 %": shares[1]}
