"""The order of joint-parameter calibration: isolated trials joint by joint, then gait; or everything at once.

An isolated trial is fitted by its joint alone: the proximal segment is free in the laboratory, so that neither the
rest of the body nor an uncalibrated neighbour joint has a say. Gait trials are fitted by the whole linkage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.calibration.joint_calibration import JointFit, JointSettings, calibrate_joints
from gaitcal.model.joint_parameters import gait_parameters, isolated_parameters
from gaitcal.model.linkage import ISOLATED_JOINTS
from gaitcal.model.parameters import Parameters
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import TrialProblem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointTrial:
    """A trial that takes part in joint calibration."""

    problem: TrialProblem
    joint: str | None
    """The joint of an isolated trial; None for gait."""


@dataclass(frozen=True)
class Phase:
    """One phase of a calibration, for the summary."""

    name: str
    trials: tuple[str, ...]
    parameters: int
    iterations: int
    seconds: float
    converged: bool
    message: str

    @property
    def status(self) -> str:
        """`converged` or `not converged`."""
        return "converged" if self.converged else "not converged"


@dataclass(frozen=True)
class JointCalibration:
    """All phases together."""

    parameters: Parameters
    phases: tuple[Phase, ...]
    fits: tuple[JointFit, ...]
    warnings: tuple[str, ...]

    @property
    def free(self) -> tuple[str, ...]:
        """Every joint parameter that some phase fitted, in order."""
        return tuple(dict.fromkeys(name for fit in self.fits for name in fit.free))


def calibrate_sequentially(
    trials: Sequence[JointTrial],
    nominal: Parameters,
    settings: JointSettings,
    sides: tuple[str, ...] = ("r", "l"),
) -> JointCalibration:
    """Isolated trials each for its joint (6, 9 or 12 parameters), then the gait trials with 17 a leg."""
    parameters = nominal
    phases: list[Phase] = []
    fits: list[JointFit] = []
    for joint in ISOLATED_JOINTS:
        own = [trial.problem for trial in trials if trial.joint == joint]
        if own and joint[-1] in sides:
            fit = _fit(own, parameters, isolated_parameters(joint), settings, nominal)
            parameters = fit.parameters
            fits.append(fit)
            phases.append(_phase(f"joint:{joint}", own, fit))
    gait = [trial.problem for trial in trials if trial.joint is None]
    if gait:
        free = tuple(name for side in sides for name in gait_parameters(side))
        fit = _fit(gait, parameters, free, settings, nominal)
        parameters = fit.parameters
        fits.append(fit)
        phases.append(_phase("gait", gait, fit))
    return JointCalibration(parameters, tuple(phases), tuple(fits), _warnings(fits))


def calibrate_simultaneously(
    trials: Sequence[JointTrial],
    nominal: Parameters,
    settings: JointSettings,
    sides: tuple[str, ...] = ("r", "l"),
) -> JointCalibration:
    """All trials at once: every parameter that an isolated trial determines, and 17 a leg where there is gait."""
    wanted: set[str] = set()
    for trial in trials:
        if trial.joint is not None and trial.joint[-1] in sides:
            wanted.update(isolated_parameters(trial.joint))
        elif trial.joint is None:
            wanted.update(name for side in sides for name in gait_parameters(side))
    order = [name for joint in ISOLATED_JOINTS for name in isolated_parameters(joint)]
    free = tuple(name for name in order if name in wanted)
    problems = [trial.problem for trial in trials if trial.joint is None or trial.joint[-1] in sides]
    fit = _fit(problems, nominal, free, settings, nominal)
    phase = _phase("all joints", problems, fit)
    return JointCalibration(fit.parameters, (phase,), (fit,), _warnings([fit]))


def _fit(
    problems: Sequence[TrialProblem],
    parameters: Parameters,
    free: tuple[str, ...],
    settings: JointSettings,
    centre: Parameters,
) -> JointFit:
    starts = [starting_nodes(p.chain, p.constants(parameters), p.data, p.basis) for p in problems]
    return calibrate_joints(problems, parameters, free, starts, settings, centre=centre)


def _phase(name: str, problems: Sequence[TrialProblem], fit: JointFit) -> Phase:
    return Phase(
        name,
        tuple(p.name for p in problems),
        len(fit.free),
        fit.iterations,
        fit.seconds,
        fit.converged,
        fit.message,
    )


def _warnings(fits: Sequence[JointFit]) -> tuple[str, ...]:
    return tuple(
        f"{name} ended on its bound; the trials pull it further from its nominal value than the bound allows"
        for fit in fits
        for name in fit.at_bound
    )
