"""The result of a calibration: models of the person, motions, torques and errors of every trial."""

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
from gaitcal.errors import Code, Finding, InputError, Severity, format_note, suggest_name
from gaitcal.gait import cycles, spatiotemporal
from gaitcal.gait.events import GaitEvents
from gaitcal.gait.moments import format_count
from gaitcal.gait.strides import FootAxes
from gaitcal.io.force_plate import BODY_N
from gaitcal.io.recording import Recording
from gaitcal.model import linkage, parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.quality.verdict import Judgement, Verdict
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role
from gaitcal.tracking.joint_floor import JointFloor
from gaitcal.tracking.motion import MarkerErrors, Motion


class Stage(Enum):
    """The models of a calibration, in the order of its stages; each gives torques.

    Attributes
    ----------
    key : str
        In `summary.json`.
    label : str
        In the report.
    short_label : str
        On the command line.
    """

    NOMINAL = ("nominal", "nominal model", "nominal")
    JP = ("jp", "joint parameters calibrated", "JP")
    """Joint parameters calibrated, inertial ones those of the table."""
    JP_IP = ("jp_ip", "joint and inertial parameters calibrated", "JP, then IP")
    COMBINED = ("joint_step", "all parameters refined together", "JP and IP together")

    def __init__(self, key: str, label: str, short_label: str) -> None:
        self.key, self.label, self.short_label = key, label, short_label


@dataclass(frozen=True)
class HeldOut:
    """Marker error of one trial over frames that were not used in the fit."""

    nominal: float
    """m, RMS over the same frames with the nominal joint parameters."""
    calibrated: float
    """m, with joint parameters fitted without them."""
    folds: int
    legs: tuple[float, float] | None = None
    """m, nominal and calibrated, markers of pelvis and legs; None for a functional trial."""


@dataclass(frozen=True)
class Loads:
    """Ground reactions of a gait trial, and the generalised forces with each model."""

    reactions: GroundReactions
    moments: Mapping[Stage, inverse_dynamics.Moments]
    """Of every stage, with the motion of its model; always with the nominal stage."""
    errors: measurement_errors.TorqueErrors | None = None
    """Standard errors of `final`."""
    kinetics: JointKinetics | None = None
    """Powers and moment vectors with the model of `final`; `errors.kinetics` has their standard
    errors.
    """
    expected: ExpectedResidual | None = None
    """The pelvis residual of `final`, with the residual that its errors predict; None if the errors
    are unknown.
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
        """The pelvis residual of every stage; empty if no frame is valid."""
        valid = self.reactions.valid
        if not valid.any():
            return ()
        return tuple(
            compute_residual_magnitudes(stage.label, moments, valid)
            for stage, moments in self.moments.items()
        )


@dataclass(frozen=True, kw_only=True, repr=False)
class TrialResult(Displayed):
    """One moving trial before and after calibration."""

    name: str
    role: Role
    joint: str | None
    """The joint of a functional (single-joint) trial; None otherwise."""
    recording: Recording
    """As tracked: rotated so that x is forward."""
    nominal: Motion
    """Gait: the whole body. Functional trial: the segments of its joint alone."""
    calibrated: Motion
    """With the parameters at the end of the phase of the trial."""
    final: Motion
    """With the parameters at the end of the whole calibration; differs from `calibrated` for
    functional trials that were fitted before gait.
    """
    floor: MarkerErrors
    """Rigid floor of the same markers."""
    joint_floor: JointFloor | None
    """Their joint floor; None if no joint has markers on both of its segments."""
    body: Motion
    """Whole-body motion with the calibrated model (the same as `calibrated` for gait)."""
    loads: Loads | None
    """None without force plates."""
    coordinate_errors: Array | None = None
    """(nf, 27) m, rad: standard errors of `body.q`, from markers through joint parameters and
    motion; gait only.
    """
    trial_coordinate_errors: Array | None = None
    """(nf, 27) m, rad: the part of `coordinate_errors` from the markers of this trial; the rest is
    shared by all strides of the calibration."""
    foot_axes: FootAxes | None = None
    """Directions of the feet, with standard errors from the sources of `coordinate_errors`; gait
    only.
    """
    held_out: HeldOut | None = None
    """Error on frames that were not used in the fit; None unless asked for."""
    bandwidth: Bandwidth | None = None
    """Cut-off frequency of `body`, and the data that chose it."""
    events: GaitEvents = field(default=GaitEvents())
    """Foot strikes and foot offs, each with its source; none in a functional trial."""
    strides: tuple[spatiotemporal.Stride, ...] = ()
    """Speed, steps, stance and swing of each stride of both feet; none in a functional trial."""
    tracking_findings: tuple[Finding, ...] = ()
    """Findings on residuals, angles and torques of `body`; of a further trial also on its forces,
    which a calibration reports for all its trials together."""

    refused_legs: tuple[str, ...] = ()
    """`r`, `l`: legs that the verdict refuses; their numbers are shown, but take part in no mean.
    """

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        """Describe marker distance, torques and refused legs for `Displayed`."""
        before, after, rigid = ("-" if mm is None else f"{mm:.1f}" for mm in self.compute_rms_mm())
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
        """Name under which strides or repetitions are averaged: `gait`, or the trial's name.

        A trial named `gait` that is of another activity gets `(motion)` after its name.
        """
        if self.role is not Role.MOTION:
            return cycles.WALKING
        return f"{self.name} (motion)" if self.name == cycles.WALKING else self.name

    @property
    def is_refused(self) -> bool:
        """Whether the verdict refuses the whole trial."""
        return set(self.refused_legs) == set(linkage.SIDES)

    def compute_rms_mm(self, *segments: str) -> tuple[float | None, float | None, float | None]:
        """Compute the RMS distance between measured and model markers.

        Parameters
        ----------
        *segments : str
            Segments whose markers are used; all if none is given.

        Returns
        -------
        nominal, calibrated, floor : float or None
            mm, with the nominal model, the calibrated model and rigid segments without joints; None
            without markers that have a weight.
        """
        errors = (self.nominal.errors, self.calibrated.errors, self.floor)
        nominal, calibrated, floor = (_convert_to_mm(one.rms(*segments)) for one in errors)
        return nominal, calibrated, floor

    def compute_joint_floor_mm(self, *segments: str) -> float | None:
        """Compute the RMS marker distance that each joint by itself can reach.

        Parameters
        ----------
        *segments : str
            Segments whose markers are used; all if none is given.

        Returns
        -------
        float or None
            mm; None if no joint has markers on both of its segments.
        """
        return None if self.joint_floor is None else _convert_to_mm(self.joint_floor.rms(*segments))

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions about this trial, each note with its name."""
        notes = (
            *self.recording.notes,
            *(self.bandwidth.notes if self.bandwidth else ()),
            *(self.loads.reactions.notes if self.loads else ()),
        )
        remarks = (format_note(f) for f in self.findings if f.severity is Severity.INFO)
        return (*(f"{self.name}: {note}" for note in notes), *remarks)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings on its bandwidth, ground reactions, events and motion."""
        of_events = (replace(f, where=self.name) for f in self.events.findings)
        return (
            *(self.bandwidth.findings if self.bandwidth else ()),
            *self._check_loads(),
            *of_events,
            *self.tracking_findings,
        )

    def _check_loads(self) -> tuple[Finding, ...]:
        """Return the findings of the ground reactions, and one if no stance has torques."""
        if self.loads is None:
            return ()
        reactions = self.loads.reactions
        found = [replace(f, where=self.name) for f in reactions.findings]
        if not reactions.has_torques:
            # A walk that misses the plates is no fault; check_study notes it.
            is_loaded = any(
                np.nan_to_num(plate.force[:, 1]).max() >= BODY_N for plate in self.recording.plates
            )
            is_fault = is_loaded or self.role is not Role.GAIT
            has_swing = reactions.valid_legs.any()
            found.append(
                Finding(
                    severity=Severity.WARNING if is_fault else Severity.INFO,
                    topic="plates",
                    where=self.name,
                    cause="only the swing has torques, no stance"
                    if has_swing
                    else "no torque is valid",
                    found="in no frame is the foot wholly on force plates that carry no other foot",
                    cure="use a trial in which the feet step on plates, or leave out the forces",
                    code=Code.NO_STANCE,
                )
            )
        return tuple(found)

    def exclude_legs(self, legs: Sequence[str] = linkage.SIDES) -> "TrialResult":
        """Return the result without valid torques and error bars of legs that are refused.

        Pelvis, trunk and arms need both legs and are excluded with the first. The reason is among
        the findings that refuse the leg.

        Parameters
        ----------
        legs : sequence of str
            `r`, `l`.

        Returns
        -------
        TrialResult
        """
        if not legs:
            return self
        is_whole = set(legs) == set(linkage.SIDES)
        kept_sides = {*linkage.SIDES} - {*legs}
        # Errors of pelvis and trunk depend on both legs, so they go with either.
        kept = np.array([get_leg(name) in kept_sides for name in linkage.COORDINATES])

        def exclude(errors: Array | None) -> Array | None:
            return None if is_whole or errors is None else np.where(kept, errors, np.nan)

        loads = self.loads
        if loads is not None:
            errors = None if is_whole or loads.errors is None else loads.errors.select(kept)
            loads = replace(loads, reactions=loads.reactions.without(legs), errors=errors)
        feet = self.foot_axes
        if feet is not None and feet.error is not None:
            is_kept = np.array([side in kept_sides for side in linkage.SIDES])
            feet = replace(feet, error=np.where(is_kept, feet.error, np.nan))
        return replace(
            self,
            loads=loads,
            coordinate_errors=exclude(self.coordinate_errors),
            trial_coordinate_errors=exclude(self.trial_coordinate_errors),
            foot_axes=feet,
            refused_legs=tuple(legs),
        )


def _convert_to_mm(metres: float | None) -> float | None:
    return None if metres is None else 1e3 * metres


@dataclass(frozen=True)
class Uncertainty:
    """Errors of the parameters."""

    joint: ErrorSources | None
    """Effect of every source of error on the joint parameters, fitted or not; None: they are taken
    as exact.
    """
    inertial: Array | None
    """(84, n) R with covariance R R^T of the inertial parameters."""
    tissue: FoundTissue = NO_FOUND_TISSUE
    """The soft tissue artefact of gait, for further walks."""

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Parameter -> standard error (m, rad, kg, kg m^2).

        Of joint parameters, fitted or nominal, and of fitted inertial parameters.
        """
        errors = dict(self.joint.standard_errors) if self.joint else {}
        if self.inertial is not None:
            inertial_errors = np.sqrt((self.inertial**2).sum(axis=1))
            for name, error in zip(parameters.IP_NAMES, inertial_errors, strict=True):
                if error > 0:
                    errors[name] = float(error)
        return errors


@dataclass(frozen=True, kw_only=True, repr=False)
class Calibration(Displayed):
    """A calibrated person."""

    study: Study
    """The study that was calibrated."""
    nominal: SubjectModel
    """The model of the static trial, before calibration."""
    model: SubjectModel
    """The model with the calibrated parameters."""
    trials: tuple[TrialResult, ...]
    """Every moving trial, in the order of the study."""
    phases: tuple[joint_phases.PhaseSummary, ...]
    """The fits that were made, in their order, each with its convergence."""
    joint: joint_phases.JointCalibration | None
    """The fit of the joint parameters; None if the settings keep them."""
    inertial: inertial_calibration.InertialFit | None
    """The fit of the inertial parameters; None without ground reactions, or if the settings keep
    them.
    """
    uncertainty: Uncertainty
    """Errors of the parameters; `standard_errors` has them by name."""
    unidentifiable: tuple[str, ...]
    """Parameters to be fitted that these trials do not determine; they keep their nominal value,
    or that of their prior."""
    notes: tuple[str, ...]
    """Assumptions."""
    findings: tuple[Finding, ...]
    """Findings before and after the fit."""
    verdict: Verdict
    """Trustworthy, doubtful or refused, with reasons: the warnings and errors among `findings`, one
    for each cause."""
    static_angles: Mapping[str, float] = field(default_factory=dict)
    """Coordinate -> m, rad, of `model` in the static posture."""
    joint_prior: JointPrior | None = None
    """Prior of the joint parameters before any moving trial; None if the protocol uses none."""
    truth: TruthErrors | None = None
    """Errors against the truth, if the study declares it."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """Trial -> error, of those that the checks removed from the study."""

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        """Describe verdict, parameters and trials for `Displayed`."""
        fitted = self.joint.free if self.joint else ()
        moved = self.inertial is not None and self.inertial.moved
        changed = int((self.nominal.parameters.inertial != self.model.parameters.inertial).sum())
        trials = []
        for trial in self.trials:
            rms = trial.body.errors.rms()
            trials.append(trial.name if rms is None else f"{trial.name} ({1e3 * rms:.1f} mm)")
        reasons = format_count(len(self.verdict.reasons), "reason")
        rows = [
            ("verdict", f"{self.verdict.judgement.value}, {reasons}"),
            (
                "joint parameters",
                f"{len(fitted)} fitted{'' if self.converged else ', not converged'}",
            ),
            (
                "inertial parameters",
                f"{changed} changed, masses fitted" if moved else "of the anthropometric table",
            ),
            ("trials (marker RMS)", shorten(trials)),
        ]
        if self.left_out:
            rows.append(("left out", shorten(list(self.left_out))))
        return f"Calibration of {self.model.subject.name}", rows

    @property
    def warnings(self) -> tuple[str, ...]:
        """The reasons of the verdict, one line each, the worst first."""
        return tuple(reason.line for reason in self.verdict.reasons)

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Parameter -> standard error (m, rad, kg, kg m^2) of every fitted parameter."""
        fitted = set(self.joint.free if self.joint else ()) | set(parameters.IP_NAMES)
        return {
            name: error
            for name, error in self.uncertainty.standard_errors.items()
            if name in fitted
        }

    @property
    def relative_to(self) -> Mapping[str, float] | None:
        """The static angles if the study asks for joint angles relative to them, else None."""
        return self.static_angles if self.study.settings.angles == "relative" else None

    @property
    def converged(self) -> bool:
        """Whether every phase reached its tolerance."""
        return all(phase.converged for phase in self.phases)

    def trial(self, name: str) -> TrialResult:
        """Get a moving trial by its name.

        Parameters
        ----------
        name : str
            As in the study.

        Returns
        -------
        TrialResult

        Raises
        ------
        InputError
            There is no trial of that name.
        """
        for trial in self.trials:
            if trial.name == name:
                return trial
        known = [trial.name for trial in self.trials]
        message = f"found '{name}'; allowed: {', '.join(known)}{suggest_name(name, known)}"
        raise InputError(message, field="trial", code=Code.ARGUMENT)


def remove_refused_results(calibration: Calibration) -> Calibration:
    """Remove valid torques and error bars that the verdict refuses: of legs, trials, or all."""
    verdict = calibration.verdict
    trials = tuple(t.exclude_legs(verdict.list_refused_legs(t.name)) for t in calibration.trials)
    uncertainty = calibration.uncertainty
    if verdict.judgement is Judgement.REFUSED:
        uncertainty = Uncertainty(None, None)
    return replace(calibration, trials=trials, uncertainty=uncertainty)


def _list_adjacent_segments(joint: linkage.Joint) -> tuple[str, ...]:
    """List the nearest segments with markers on either side of a joint, without the pelvis.

    The pelvis is the base segment, which a walk always has.
    """
    ends = [joint.parent, joint.child]
    while not linkage.get_segment(ends[0]).markers:
        ends[0] = linkage.JOINT_OF_CHILD[ends[0]].parent
    while not linkage.get_segment(ends[1]).markers:
        ends[1] = next(j.child for j in linkage.JOINTS if j.parent == ends[1])
    return tuple(segment for segment in ends if segment != "pelvis")


def _list_segments_of_angles() -> dict[str, tuple[str, ...]]:
    """List coordinate of a leg -> segments that need an observed marker for a valid angle."""
    out = {}
    for segment in linkage.LOWER_BODY[1:]:
        adjacent = _list_adjacent_segments(linkage.JOINT_OF_CHILD[segment])
        for name in linkage.list_joint_coordinates([segment]):
            out[name] = adjacent
    return out


SEGMENTS_OF_ANGLE = _list_segments_of_angles()
"""Coordinate of a leg -> segments that need an observed marker for a valid angle."""


def find_valid_angles(
    trial: TrialResult, name: str, unobserved: Mapping[str, BoolArray]
) -> BoolArray:
    """Find the frames with a valid angle: not refused, with observed markers on both segments.

    Parameters
    ----------
    trial : TrialResult
        The trial.
    name : str
        Coordinate.
    unobserved : mapping
        Segment -> (nf,) frames without any marker, from
        `dynamics.ground_reactions.find_unobserved_frames`.

    Returns
    -------
    (nf,) array of bool
    """
    side = get_leg(name)
    refused = side in trial.refused_legs if side else bool(trial.refused_legs)
    out = np.full(len(trial.body.time), not refused)
    for segment in SEGMENTS_OF_ANGLE.get(name, ()):
        out &= ~unobserved.get(segment, np.zeros(len(out), dtype=bool))
    return out
