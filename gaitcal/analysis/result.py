"""What a calibration returns: the person's models and, trial by trial, how well they do."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from gaitcal.analysis.trial_bandwidth import Bandwidth
from gaitcal.analysis.truth_errors import TruthErrors
from gaitcal.arrays import Array, BoolArray
from gaitcal.calibration import inertial_calibration, joint_phases
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.soft_tissue_artefact import NO_FOUND_TISSUE, FoundTissue
from gaitcal.display import Displayed, shorten
from gaitcal.dynamics import inverse_dynamics, measurement_errors
from gaitcal.dynamics.expected_residual import (
    ExpectedResidual,
    ResidualMagnitudes,
    compute_residual_magnitudes,
)
from gaitcal.dynamics.ground_reactions import GroundReactions, get_leg
from gaitcal.dynamics.joint_kinetics import JointKinetics
from gaitcal.errors import Code, Finding, InputError, Severity, nearest, note_of
from gaitcal.gait import cycles, spatiotemporal
from gaitcal.gait.events import GaitEvents
from gaitcal.gait.strides import FootAxes
from gaitcal.io.force_plate import BODY_N
from gaitcal.io.recording import Recording
from gaitcal.model import linkage, parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.quality.verdict import Judgement, Verdict
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role
from gaitcal.tracking.joint_floor import JointFloor
from gaitcal.tracking.motion import MarkerErrors, Motion


class Stage(Enum):
    """The models of a calibration, in the order in which they are reached; each gives torques of
    its own.

    `key`: in `summary.json`; `words`: in the report; `short`: on the command line.
    """

    NOMINAL = ("nominal", "nominal model", "nominal")
    JP = ("jp", "joint parameters calibrated", "JP")
    """Joint parameters calibrated, inertial ones those of the table."""
    JP_IP = ("jp_ip", "joint and inertial parameters calibrated", "JP, then IP")
    COMBINED = ("joint_step", "all parameters refined together", "JP and IP together")

    def __init__(self, key: str, words: str, short: str) -> None:
        self.key, self.words, self.short = key, words, short


@dataclass(frozen=True)
class HeldOut:
    """Marker error of one trial over frames that did not take part in the fit."""

    nominal: float
    """m, RMS over the same frames with the nominal joint parameters."""
    calibrated: float
    """m, with joint parameters fitted without them."""
    folds: int
    legs: tuple[float, float] | None = None
    """m, nominal and calibrated over the markers of pelvis and legs; None for an isolated trial."""


@dataclass(frozen=True)
class Loads:
    """Ground reactions of a gait trial, and the generalised forces with each model."""

    reactions: GroundReactions
    moments: Mapping[Stage, inverse_dynamics.Moments]
    """Of every model that was reached, with the motion that belongs to it; the nominal one is
    always there.
    """
    errors: measurement_errors.TorqueErrors | None = None
    """Standard errors of `final`."""
    kinetics: JointKinetics | None = None
    """Powers and moment vectors with the model of `final`; `errors.kinetics` has their standard
    errors.
    """
    expected: ExpectedResidual | None = None
    """The pelvis residual of `final` against what its errors let expect; None where they are not
    known.
    """

    @property
    def nominal(self) -> inverse_dynamics.Moments:
        """With the nominal model and the motion tracked with it."""
        return self.moments[Stage.NOMINAL]

    @property
    def final(self) -> inverse_dynamics.Moments:
        """With the model that the calibration ended with."""
        return self.moments[max(self.moments, key=list(Stage).index)]

    @property
    def residuals(self) -> tuple[ResidualMagnitudes, ...]:
        """Of every model that was reached; empty where no frame is valid."""
        valid = self.reactions.valid
        if not valid.any():
            return ()
        return tuple(
            compute_residual_magnitudes(stage.words, moments, valid)
            for stage, moments in self.moments.items()
        )


@dataclass(frozen=True, kw_only=True, repr=False)
class TrialResult(Displayed):
    """One moving trial before and after calibration."""

    name: str
    role: Role
    joint: str | None
    """The joint of an isolated trial."""
    recording: Recording
    """As tracked: turned so that x is forward."""
    nominal: Motion
    """Gait: the whole body. Isolated trial: the segments of its joint alone."""
    calibrated: Motion
    """With the parameters at the end of the trial's own phase."""
    final: Motion
    """With the parameters at the end of the whole calibration: the same, but for isolated trials
    before gait.
    """
    floor: MarkerErrors
    """Rigid-segment floor of the same markers."""
    joint_floor: JointFloor | None
    """Their joint floor; None where no joint shows markers on both of its segments."""
    body: Motion
    """Whole-body motion with the calibrated model (the same as `calibrated` for gait)."""
    loads: Loads | None
    """None without force plates."""
    coordinate_errors: Array | None = None
    """(nf, 27) m, rad: standard errors of `body.q`, from markers through joint parameters and
    motion; gait only.
    """
    own_coordinate_errors: Array | None = None
    """(nf, 27) m, rad: the part of `coordinate_errors` that this trial's own markers make; the rest
    is shared by all strides of the calibration."""
    foot_axes: FootAxes | None = None
    """Where the feet point, with `coordinate_errors`' errors; gait only."""
    held_out: HeldOut | None = None
    """Error on frames that took no part in the fit; None unless asked for."""
    bandwidth: Bandwidth | None = None
    """How fast `body` may change, and who said so."""
    events: GaitEvents = field(default=GaitEvents())
    """When the feet meet and leave the ground, each moment with its source; none in an isolated
    trial.
    """
    strides: tuple[spatiotemporal.Stride, ...] = ()
    """Speed, steps, stance and swing of each stride of both feet; none in an isolated trial."""
    doubts: tuple[Finding, ...] = ()
    """What residuals, angles and torques of `body` say against it, and of a further trial its
    forces, too: those of a calibration are told for its trials together."""

    refused_legs: tuple[str, ...] = ()
    """`r`, `l`: the verdict refuses these legs; their numbers are there to be looked at, and count
    for nothing.
    """

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        before, after, rigid = ("-" if mm is None else f"{mm:.1f}" for mm in self.rms_mm())
        rows = [
            ("motion", f"{len(self.body.time)} frames, {len(self.strides)} strides"),
            (
                "marker distance",
                f"RMS {after} mm; {before} mm with the nominal model, {rigid} mm of rigid segments",
            ),
        ]
        if self.loads is not None:
            right, left = (int(valid.sum()) for valid in self.loads.reactions.valid_legs.T)
            rows.append(("torques", f"valid in {right} frames right, {left} frames left"))
        if self.refused_legs:
            rows.append(("refused", f"legs {', '.join(self.refused_legs)}"))
        return f"Trial {self.name} ({self.joint or self.role.value})", rows

    @property
    def activity(self) -> str:
        """`gait` of a walk, else the trial's own name: whose strides, or repetitions, belong
        together. A trial called `gait` that is none is no walk for its name.
        """
        if self.role is not Role.MOTION:
            return cycles.WALKING
        return f"{self.name} (motion)" if self.name == cycles.WALKING else self.name

    @property
    def is_refused(self) -> bool:
        """The verdict refuses the whole of it."""
        return set(self.refused_legs) == set(linkage.SIDES)

    def rms_mm(self, *segments: str) -> tuple[float | None, float | None, float | None]:
        """RMS marker distance (mm) with the nominal and the calibrated model and of rigid segments,
        over all markers with weight or those of some segments; None where there are none.
        """
        nominal, calibrated, floor = (
            None if (value := errors.rms(*segments)) is None else 1e3 * value
            for errors in (self.nominal.errors, self.calibrated.errors, self.floor)
        )
        return nominal, calibrated, floor

    def joint_floor_mm(self, *segments: str) -> float | None:
        """RMS marker distance (mm) that each joint by itself can reach, over the same markers; None
        where none is.
        """
        value = None if self.joint_floor is None else self.joint_floor.rms(*segments)
        return None if value is None else 1e3 * value

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed about this trial, each with its name."""
        of_motion = self.bandwidth.notes if self.bandwidth else ()
        notes = (
            *self.recording.notes,
            *of_motion,
            *(self.loads.reactions.notes if self.loads else ()),
        )
        remarks = (note_of(f) for f in self.findings if f.severity is Severity.INFO)
        return (*(f"{self.name}: {note}" for note in notes), *remarks)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What speaks against its markers, its motion and its ground reactions."""
        of_events = (replace(f, where=self.name) for f in self.events.findings)
        return (
            *(self.bandwidth.findings if self.bandwidth else ()),
            *self._of_loads(),
            *of_events,
            *self.doubts,
        )

    def _of_loads(self) -> tuple[Finding, ...]:
        if self.loads is None:
            return ()
        found = [replace(f, where=self.name) for f in self.loads.reactions.findings]
        if not self.loads.reactions.has_torques:
            swing = self.loads.reactions.valid_legs.any()
            # of walks, that nobody stepped on a plate is a finding of its own: no fault where feet
            # passed beside them
            loaded = any(
                np.nan_to_num(plate.force[:, 1]).max() >= BODY_N for plate in self.recording.plates
            )
            found.append(
                Finding(
                    severity=Severity.WARNING
                    if loaded or self.role is not Role.GAIT
                    else Severity.INFO,
                    topic="plates",
                    where=self.name,
                    cause="no stance has torques; those of the swing remain"
                    if swing
                    else "no torque is valid",
                    found="no frame has a foot on the ground wholly on force plates of its own",
                    cure="use a trial in which feet step on plates, or leave the forces out",
                    code=Code.NO_STANCE,
                )
            )
        return tuple(found)

    def refused(self, legs: Sequence[str] = linkage.SIDES) -> "TrialResult":
        """The same with no torque valid and no error bar of these legs, nor of the pelvis, trunk
        and arms.

        What is wrong with them is told elsewhere.
        """
        if not legs:
            return self
        loads, errors, own = self.loads, self.coordinate_errors, self.own_coordinate_errors
        whole = set(legs) == set(linkage.SIDES)
        kept = np.array(
            [get_leg(name) in {*linkage.SIDES} - {*legs} for name in linkage.COORDINATES]
        )
        if loads is not None:
            of_torques = None if whole or loads.errors is None else loads.errors.select(kept)
            loads = replace(loads, reactions=loads.reactions.exclude_legs(legs), errors=of_torques)
        errors, own = (
            None if whole or e is None else np.where(kept, e, np.nan) for e in (errors, own)
        )
        feet = self.foot_axes
        if feet is not None and feet.error is not None:
            known = np.array([side not in legs for side in linkage.SIDES])
            feet = replace(feet, error=np.where(known, feet.error, np.nan))
        return replace(
            self,
            loads=loads,
            coordinate_errors=errors,
            own_coordinate_errors=own,
            foot_axes=feet,
            refused_legs=tuple(legs),
        )


@dataclass(frozen=True)
class Uncertainty:
    """How far the fitted parameters can be trusted."""

    joint: ErrorSources | None
    """ErrorSources of every source of error on the joint parameters, fitted or not; None: they
    count as exact.
    """
    inertial: Array | None
    """(84, n) R with covariance R R^T of the inertial parameters."""
    tissue: FoundTissue = NO_FOUND_TISSUE
    """The soft tissue artefact of gait, for further walks."""

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Parameter name -> standard error (SI) of joint parameters, fitted or nominal, and fitted
        inertial ones.
        """
        errors = dict(self.joint.standard_errors) if self.joint else {}
        if self.inertial is not None:
            each = np.sqrt((self.inertial**2).sum(axis=1))
            errors |= {
                name: float(e) for name, e in zip(parameters.IP_NAMES, each, strict=True) if e > 0
            }
        return errors


@dataclass(frozen=True, kw_only=True, repr=False)
class Calibration(Displayed):
    """A calibrated person."""

    study: Study
    """What was calibrated."""
    nominal: SubjectModel
    """The model of the static trial, before calibration."""
    model: SubjectModel
    """With the calibrated parameters."""
    trials: tuple[TrialResult, ...]
    """Every moving trial, in the order of the study."""
    phases: tuple[joint_phases.Phase, ...]
    """The fits that were made, in their order, each with its convergence."""
    joint: joint_phases.JointCalibration | None
    """None where the settings leave joint parameters alone."""
    inertial: inertial_calibration.InertialFit | None
    """None without ground reactions, or where the settings leave inertial parameters alone."""
    uncertainty: Uncertainty
    """How the parameters would scatter; `standard_errors` gives it by name."""
    unidentifiable: tuple[str, ...]
    """Parameters that were to be fitted and that these trials cannot see; they keep their nominal
    value, or stay where their prior holds them."""
    notes: tuple[str, ...]
    """What was assumed."""
    findings: tuple[Finding, ...]
    """What was found, before and after the fit."""
    verdict: Verdict
    """How far it can be believed, with reasons: what of `findings` is no note, one a cause."""
    static_angles: Mapping[str, float] = field(default_factory=dict)
    """Coordinate -> m, rad: with which `model` meets the static posture."""
    truth: TruthErrors | None = None
    """How near it came, where the study names the truth."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """Trial -> error, of those that the checks took out of the study."""

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        fitted = self.joint.free if self.joint else ()
        moved = self.inertial is not None and self.inertial.moved
        rows = [
            ("verdict", f"{self.verdict.judgement.value}, {len(self.verdict.reasons)} reasons"),
            (
                "joint parameters",
                f"{len(fitted)} fitted{'' if self.converged else ', not converged'}",
            ),
            ("inertial parameters", "fitted" if moved else "of the anthropometric table"),
            ("trials", shorten([trial.name for trial in self.trials])),
        ]
        if self.left_out:
            rows.append(("left out", shorten(list(self.left_out))))
        return f"Calibration of {self.model.subject.name}", rows

    @property
    def warnings(self) -> tuple[str, ...]:
        """The reasons of the verdict, a line each, the worst first."""
        return tuple(reason.line for reason in self.verdict.reasons)

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Parameter name -> standard error (m, rad, kg, kg m^2) of every fitted parameter."""
        fitted = set(self.joint.free if self.joint else ()) | set(parameters.IP_NAMES)
        return {
            name: error
            for name, error in self.uncertainty.standard_errors.items()
            if name in fitted
        }

    @property
    def relative_to(self) -> Mapping[str, float] | None:
        """The static angles, where the study asks for joint angles that are counted from them."""
        return self.static_angles if self.study.settings.angles == "relative" else None

    @property
    def converged(self) -> bool:
        """Whether every phase reached its tolerance."""
        return all(phase.converged for phase in self.phases)

    def trial(self, name: str) -> TrialResult:
        """The moving trial of that name.

        Raises
        ------
        InputError
            There is none.
        """
        for trial in self.trials:
            if trial.name == name:
                return trial
        known = [trial.name for trial in self.trials]
        message = f"found '{name}'; allowed: {', '.join(known)}{nearest(name, known)}"
        raise InputError(message, field="trial", code=Code.ARGUMENT)


def withdrawn(calibration: Calibration) -> Calibration:
    """The same without valid torques and error bars of what its verdict refuses: legs, trials, or
    the whole.
    """
    verdict = calibration.verdict
    trials = tuple(t.refused(verdict.list_refused_legs(t.name)) for t in calibration.trials)
    uncertainty = calibration.uncertainty
    if verdict.judgement is Judgement.REFUSED:
        uncertainty = Uncertainty(None, None)
    return replace(calibration, trials=trials, uncertainty=uncertainty)


def _shown_by(joint: linkage.Joint) -> tuple[str, ...]:
    """The nearest segments on either side of a joint that carry markers, but for the pelvis, whose
    frame they make.
    """
    ends = [joint.parent, joint.child]
    while not linkage.get_segment(ends[0]).markers:
        ends[0] = linkage.JOINT_OF_CHILD[ends[0]].parent
    while not linkage.get_segment(ends[1]).markers:
        ends[1] = next(j.child for j in linkage.JOINTS if j.parent == ends[1])
    return tuple(segment for segment in ends if segment != "pelvis")


SHOWN_BY = {
    name: _shown_by(linkage.JOINT_OF_CHILD[s])
    for s in linkage.LOWER_BODY[1:]
    for name in linkage.list_joint_coordinates([s])
}
"""Coordinate of a leg -> segments of which some marker must be seen where the angle is to count."""


def angle_counts(trial: TrialResult, name: str, unseen: Mapping[str, BoolArray]) -> BoolArray:
    """(nf,) where an angle may be used: not refused, and between segments that some marker shows.

    `unseen`: of `dynamics.ground_reactions.find_unobserved_frames`.
    """
    side = get_leg(name)
    refused = side in trial.refused_legs if side else bool(trial.refused_legs)
    out = np.full(len(trial.body.time), not refused)
    for segment in SHOWN_BY.get(name, ()):
        out &= ~unseen.get(segment, np.zeros(len(out), dtype=bool))
    return out
