"""What forces and motion of one walk say in numbers: peaks, changes, pelvis residuals and their limits."""

from __future__ import annotations

from dataclasses import dataclass

from gaitcal.dynamics.expected_residual import ExpectedResidual
from gaitcal.dynamics.residual_limits import ResidualLimits, ResidualMagnitudes, residual_limits
from gaitcal.gait.moments import MomentNumbers, moment_numbers
from gaitcal.gait.strides import Layout, layout
from gaitcal.model.subject_model import SubjectModel
from gaitcal.session.result import TrialResult


@dataclass(frozen=True, kw_only=True)
class GaitNumbers:
    """Of one whole-body trial; without valid torques nothing but its layout."""

    trial: TrialResult
    layout: Layout
    numbers: tuple[MomentNumbers, ...] = ()
    stages: tuple[ResidualMagnitudes, ...] = ()
    """Pelvis residuals with each model; empty where no frame of the whole body is valid."""
    limits: ResidualLimits | None = None
    """What is asked of simulations; given where `stages` are."""
    expected: ExpectedResidual | None = None
    """Of the last of `stages`; None where its errors are not known."""

    def valid_frames(self, side: str = "") -> int:
        """Frames in which the torques of a leg (`r`, `l`) are valid, or those of the whole body (nothing)."""
        return int(self.layout.valid_for(side).sum())


def gait_numbers(model: SubjectModel, trial: TrialResult) -> GaitNumbers | None:
    """The numbers of a walk; None of an isolated trial."""
    if trial.joint is not None:
        return None
    loads = trial.loads
    drawn = layout(trial.body, loads.reactions if loads else None, trial.events)
    if loads is None or not loads.reactions.has_torques:
        return GaitNumbers(trial=trial, layout=drawn)
    stages = loads.residuals
    return GaitNumbers(
        trial=trial,
        layout=drawn,
        numbers=moment_numbers(model, drawn, loads.final, loads.nominal, loads.errors),
        stages=stages,
        limits=residual_limits(model.parameters, trial.body.q, loads.reactions, trial.recording.plates)
        if stages
        else None,
        expected=loads.expected,
    )
