"""What takes part where all trials of a person decide, and what the fit of a part of the body gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

from gaitcal.calibration.identifiability import Turns
from gaitcal.calibration.influence import Influence
from gaitcal.calibration.joint_estimate import JointEstimate
from gaitcal.calibration.joint_phases import Phase
from gaitcal.calibration.skin_evidence import NO_SKIN_FOUND, SkinFound
from gaitcal.findings import Finding
from gaitcal.model.parameters import Parameters
from gaitcal.motion.bandwidth import with_bandwidth
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.records import dataclass


@dataclass(frozen=True)
class EvidenceTrial:
    """A trial that takes part."""

    body: TrialProblem
    """The whole body."""
    fitted: TrialProblem
    """An isolated trial on the segments of its joint; gait on the whole body."""
    joint: str | None
    """The joint of an isolated trial; None for gait."""

    @property
    def name(self) -> str:
        """Of the recording, whatever part of the body is fitted to it."""
        return self.body.name


@dataclass(frozen=True, kw_only=True)
class Part:
    """What the fit of one part of the body gives."""

    free: tuple[str, ...]
    parameters: Parameters
    errors: Influence
    """Of `free`."""
    phase: Phase
    findings: tuple[Finding, ...] = ()
    turned: Turns = field(default_factory=dict)
    """How far isolated trials move their joints."""
    skin: SkinFound = NO_SKIN_FOUND
    tissue: Mapping[str, SoftTissue] = field(default_factory=dict)
    """Trial -> the columns of that skin on the markers of the whole body."""


def phase_of(name: str, trials: Sequence[EvidenceTrial], pieces: Sequence[str], estimate: JointEstimate) -> Phase:
    """`pieces`: what the noise of each of the `trials` is told as; a joint of a walk alone is not the walk."""
    return Phase(
        name=name,
        trials=tuple(dict.fromkeys(t.name for t in trials)),
        parameters=len(estimate.free) + len(estimate.keys),
        iterations=estimate.iterations,
        seconds=estimate.seconds,
        converged=estimate.converged,
        message=estimate.message,
        noise=dict(zip(pieces, estimate.noise, strict=True)),
    )


def segments_of(body: TrialProblem, segments: tuple[str, ...], nominal: Parameters) -> TrialProblem:
    """Some segments of a whole body, the first free in the laboratory, with the same bandwidth."""
    part = body.part(segments[0], segments)
    return with_bandwidth(part, nominal, body.smoothing.cutoff_hz) if body.smoothing else part
