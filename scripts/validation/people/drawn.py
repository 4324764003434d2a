"""Do error bars hold the joints of people who are what the prior says? A dozen simulated ones whose truth is known.

The joints of `opensim_truth` lie where OpenSim's model has them, up to 2.4 standard deviations off the prior, the same
in every draw. So the prior is moved instead of the person: its mean is the truth plus a draw from its covariance, and
by that the truth is a draw from the prior. Markers move as the soft tissue of people does (`truth/skin.py`), drawn for
every person. An estimate that takes from either what it should has errors as large as its standard errors, and is
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
from gaitcal.study.study import nominal_of
from scripts.validation.error_bars import bars, rms
from scripts.validation.people.fits import fitted
from scripts.validation.recordings import changed, only
from scripts.validation.truth.people import IsolatedPerson, isolated_person, leg_parameters, static_frames
from scripts.validation.truth.skin import TABLE_MM, Kind, disturbed

DIRECTIONS_MM = ("ant", "sup", "lat")
Rows = dict[tuple[str, str], list[Array]]
"""(trials, joint and unit) -> of each fit, (n, 3) mm or deg: error of the prior's mean, of the fit, standard error."""


def add_fits(
    rows: Rows,
    person: str,
    kind: Kind,
    seed: int,
    trials: Mapping[str, tuple[str, ...]],
    settings: Mapping[str, object],
    folder: Path,
    cache: Path,
) -> None:
    """Fit one person with joints and soft tissue of a seed by each choice of trials, words -> roles, into `rows`."""
    made = isolated_person(person, folder, cache, with_gait=True)
    skin = np.random.default_rng([seed, *person.encode()]).integers(2**31)
    study = changed(disturbed(made.study, kind, TABLE_MM, int(skin)), settings)
    rng = np.random.default_rng([seed, *person.encode(), 1])
    study, truth, draw = prior_about_truth(made, study, rng)
    at, true = np.array([JP_INDEX[name] for name in truth]), np.array(list(truth.values()))
    groups = defaultdict(list)
    for k, name in enumerate(truth):
        joint, direction = name.partition("_")[0], name.rpartition(".")[2]
        groups[f"{joint}, {'mm' if direction in DIRECTIONS_MM else 'deg'}"].append(k)
    for words, roles in trials.items():
        fit = fitted(person, only(study, *roles))
        every = np.stack([draw[at], fit.parameters.joint[at] - true, fit.errors[at]], axis=1) / JP_TO_SI[at, None]
        for group, members in groups.items():
            rows.setdefault((words, group), []).append(every[members])


def prior_about_truth(
    made: IsolatedPerson, study: Study, rng: np.random.Generator
) -> tuple[Study, dict[str, float], Array]:
    """A study of a person with such a prior; the joint parameters of its legs (m, rad), and the draw, as `JP_NAMES`."""
    nominal = nominal_of(study)
    frames = static_frames(nominal, study.static.recording)
    truth = {name: v for side in SIDES for name, v in leg_parameters(made, frames, side).items()}
    at = np.array([JP_INDEX[name] for name in truth])
    draw = rng.multivariate_normal(0 * ANATOMY.mean, ANATOMY.covariance)
    mean = ANATOMY.mean.copy()
    mean[at] = np.array(list(truth.values())) - nominal.parameters.joint[at] + draw[at]
    return replace(study, joint_prior=replace(ANATOMY, mean=mean)), truth, draw


def lines(rows: Rows, out: dict[str, float]) -> Iterator[str]:
    """How large errors are, and how many the bars hold; figures into `out`."""
    yield f"{'joint parameters, RMS':32}{'n':>6}{'prior':>9}{'fitted':>9}{'SE':>7}{'z':>7}{'in 68 %':>9}{'in 95 %':>9}"
    for (words, group), fits in sorted(rows.items()):
        prior, error, se = np.concatenate(fits).T
        shares, z = bars(error, se).shares, rms(error / se)
        yield (
            f"{f'{words}: {group}':32}{len(error):6}{rms(prior):9.2f}{rms(error):9.2f}{rms(se):7.2f}{z:7.2f}"
            f"{shares[0]:9.0f}{shares[1]:9.0f}"
        )
        out |= {f"{words}: {group}: z": z, f"{words}: {group}: in 95 %": shares[1]}
