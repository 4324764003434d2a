"""The soft tissue of the trials of a person: columns by the angles that each task moves, sized by what they all show.

Angles are those of motions tracked with nominal joints and markers in their places. Gait has one scale of the person's
soft tissue, all isolated trials have another (`soft_tissue_artefact.py`); in gait knees are no hinges besides.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from gaitcal.arrays import Array
from gaitcal.calibration.soft_tissue_artefact import (
    SQUARES,
    SoftTissueScale,
    TissuePrior,
    soft_tissue_scale,
    task_regressors,
    tissue_of,
    tissue_prior,
)
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.secondary_motion import SecondaryColumns, secondary_columns
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.trial_problem import TrialProblem

GAIT = "gait"
"""Kind of task of a trial that is no isolated one; that of isolated trials has their joint's name."""
LEAST_SQUARES = 0.01
"""E[s^2] below which columns of squares would move next to nothing: markers by a tenth of what people show."""


@dataclass(frozen=True)
class TaskTissue:
    """What may move the markers of each trial against their bones, and how far."""

    kinds: Mapping[str, str]
    """Trial -> kind of task."""
    regressors: Mapping[str, Mapping[str, Array]]
    """Trial -> coordinate -> (nf,) psi of the joints that its task moves."""
    scales: Mapping[str, SoftTissueScale]
    """Kind of task -> how soft the person is there."""
    secondary: Mapping[str, SecondaryColumns]
    """Trial of gait -> what knees do besides flexing."""

    def of(self, name: str, problem: TrialProblem, known: Collection[str] | None = None) -> SoftTissue | None:
        """The columns of a trial on the markers of some part of the body, or those `known` of them."""
        return tissue_of(problem, self.kinds[name], self.regressors[name], known, secondary=self.secondary.get(name))

    def of_bodies(self, bodies: Mapping[str, TrialProblem], known: Collection[str]) -> dict[str, SoftTissue]:
        """Trial -> the columns `known` on the markers of the whole body; without those that have none."""
        found = {name: self.of(name, body, known) for name, body in bodies.items()}
        return {name: columns for name, columns in found.items() if columns is not None}

    def on(self, name: str, problem: TrialProblem) -> TrialProblem:
        """A trial of some part of the body with the columns of its markers."""
        return replace(problem, tissue=self.of(name, problem))

    def prior(self, problems: Sequence[TrialProblem]) -> TissuePrior:
        """Of the columns that these have."""
        return tissue_prior(problems, self.scales)


def task_tissue(kinds: Mapping[str, str], parts: Mapping[str, TrialProblem], nominal: Parameters) -> TaskTissue:
    """The soft tissue of trials, name -> kind of task, each by the part of the body that is fitted to it."""
    angles = {name: _angles(nominal, parts[name]) for name in kinds}
    regressors, scales = dict[str, Mapping[str, Array]](), dict[str, SoftTissueScale]()
    for kind in dict.fromkeys(kinds.values()):
        names = [name for name in kinds if kinds[name] == kind]
        regressors |= dict(zip(names, task_regressors([angles[n] for n in names], squares=True), strict=True))
    gait = [name for name in kinds if kinds[name] == GAIT]
    secondary = dict(zip(gait, secondary_columns(GAIT, [angles[n] for n in gait]), strict=True))
    for alike in (gait, [name for name in kinds if kinds[name] != GAIT]):
        soft = [replace(parts[n], tissue=tissue_of(parts[n], kinds[n], regressors[n])) for n in alike]
        scale = soft_tissue_scale(soft)
        scales |= {kinds[name]: scale for name in alike}
        if scale.squares < LEAST_SQUARES:
            for n in alike:
                regressors[n] = {c: psi for c, psi in regressors[n].items() if not c.endswith(SQUARES)}
    return TaskTissue(kinds, regressors, scales, secondary)


def _angles(nominal: Parameters, part: TrialProblem) -> dict[str, Array]:
    """Coordinate -> (nf,) rad, of those that a marker of the trial shows."""
    q = tracked_motion(part, nominal).q
    return {name: values for name, values, on in zip(part.chain.coordinates, q.T, part.active, strict=True) if on}


def tissue_of_walk(walk: TrialProblem, nominal: Parameters, known: Collection[str]) -> SoftTissue | None:
    """The soft tissue and secondary motions of a walk that took no part in a calibration: those `known` of its walks
    (`kind/regressor/...`, of an `Influence`), with the angles of this one.
    """
    angles = _angles(nominal, walk)
    (every,) = task_regressors([angles], squares=True)
    regressors = {name: psi for name, psi in every.items() if any(key.startswith(f"{GAIT}/{name}/") for key in known)}
    knees = {name: phi for name, phi in angles.items() if any(key.startswith(f"{GAIT}/{name}/^") for key in known)}
    (secondary,) = secondary_columns(GAIT, [knees])
    return tissue_of(walk, GAIT, regressors, known, secondary if secondary.names else None)
