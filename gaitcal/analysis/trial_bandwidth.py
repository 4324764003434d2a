"""The bandwidth of a trial's motion: given by the settings, or chosen by its markers and its force
plates.

Joint parameters take the cut-off that the markers ask for (`tracking/bandwidth.py`). The motion of
a walk over force plates may take another one, which brings forces and motion together,

    f = argmin sum_t |F(t; f)|^2,       F the pelvis residual force,

over frames and plate forces that do not change with f: plates are filtered at 50 Hz here, whatever
the settings say. Filtered at f themselves, they would agree with the motion the better the less of
either is left. The plates choose f alone and take no further part in the motion, and their say is
limited:

- F weighs the trunk and hardly sees a foot: they move f by half an octave at most.
- Where mass or model are wrong, or all markers shake together, F falls with f for ever: plates are
  asked only where half of the f found so would raise sum |F|^2.

One motion leaves the trial, the one that the torques are of.
"""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.ground_reactions import compute_motion_reactions
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.force_plate import LOADED_N, resample_wrench
from gaitcal.io.recording import Recording
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.settings import AUTOMATIC, CalibrationSettings
from gaitcal.study.study_trial import Trial
from gaitcal.tracking import bandwidth, spline, trial_problem
from gaitcal.tracking.motion import build_motion

PLATES_HZ = 50.0  # Of the plates while they choose
JOINTS_HZ = 12.0
"""At least, while joint parameters are fitted: they ask for no accelerations, and a motion smoothed
at the 2 Hz that the markers of a slow isolated trial ask for gave knee axes 7.5 mm off where 2.5
were to be had (12 and 25 Hz alike)."""
ENDS_S = (
    0.1  # s at either end that have no say, whatever f: accelerations there lean on one side only
)
FEWEST_LOADED = 20  # Valid frames below which plates have no say
REACH = float(np.sqrt(2.0))  # Factor by which plates may change the markers' cut-off
TOLD = 1.25  # Plates tell f where sum |F|^2 is so much larger with half of it
AT_LIMIT = 0.99  # Of the highest cut-off
SUFFERS, SUFFERS_M = 1.2, 3e-4
"""A fit suffers where its marker error is 1.2 times, and 0.3 mm above, that with the cut-off its
markers ask for.
"""


class ChosenBy(Enum):
    """Who chose the bandwidth of a trial's motion."""

    MARKERS = "markers"
    PLATES = "plates"
    GIVEN = "given"


@dataclass(frozen=True, kw_only=True)
class Bandwidth:
    """The bandwidth of one trial."""

    motion_hz: float
    """Half of an oscillation at it is in the motion."""
    joints_hz: float
    """The same while joint parameters are fitted."""
    by: ChosenBy
    """Who chose `motion_hz`."""
    penalised: bool
    """False: the number of nodes alone limits the motion."""
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


def bandwidth_of(
    problem: trial_problem.MotionProblem,
    trial: Trial,
    model: SubjectModel,
    settings: CalibrationSettings,
) -> Bandwidth:
    """The bandwidth of a trial.

    `problem`: what its joint parameters are fitted by, with the nodes of the settings if these give
    any. `trial`: turned so that x is forward. `model`: tracked with its nominal parameters, so that
    a calibration and further trials choose alike.
    """
    if settings.nodes is not None:
        return _given_nodes(problem)
    # Where a trial is too long to be looked at as a whole, a walk is where its plates are.
    loaded = _loaded(trial.recording)
    motion = bandwidth.DenseMotion(problem, model.nominal, loaded if loaded.any() else None)
    markers = motion.choose_cutoff()
    if settings.nodes_per_second is not None:
        chosen = _given_nodes(problem)
    elif settings.bandwidth_hz != AUTOMATIC:
        hz = float(settings.bandwidth_hz)
        note = f"motion smoothed at {hz:.1f} Hz (half amplitude), as the settings say"
        chosen = Bandwidth(
            motion_hz=hz, joints_hz=hz, by=ChosenBy.GIVEN, penalised=True, notes=(note,)
        )
    else:
        plates = (
            _by_plates(motion, markers, trial, model)
            if trial.recording.plates and not trial.joint
            else None
        )
        chosen = _chosen(markers, plates, motion)
    return replace(chosen, findings=_suffering(trial.name, motion, chosen.motion_hz, markers))


def _given_nodes(problem: trial_problem.MotionProblem) -> Bandwidth:
    """That of splines of a given number of nodes: least squares passes half of 0.5 oscillations a
    span.
    """
    time = problem.basis.time
    hz = 0.5 * (problem.basis.nodes - spline.DEGREE) / float(time[-1] - time[0])
    note = (
        f"the motion passes half of {hz:.1f} Hz: {problem.basis.nodes} spline nodes, as the "
        "settings say"
    )
    return Bandwidth(motion_hz=hz, joints_hz=hz, by=ChosenBy.GIVEN, penalised=False, notes=(note,))


def _chosen(markers: float, plates: float | None, motion: bandwidth.DenseMotion) -> Bandwidth:
    hz = markers if plates is None else plates
    by = ChosenBy.MARKERS if plates is None else ChosenBy.PLATES
    if plates is None:
        note = f"motion smoothed at {hz:.1f} Hz (half amplitude), which its markers ask for"
    else:
        note = (
            f"motion smoothed at {hz:.1f} Hz (half amplitude), where it and the force plates agree "
            "best; its markers "
            f"alone ask for {markers:.1f} Hz"
        )
    if hz > AT_LIMIT * motion.highest:
        note += (
            f"; frames at {spline.compute_frame_rate(motion.problem.basis):.0f} Hz allow no more"
        )
    joints = max(markers, hz, min(JOINTS_HZ, motion.highest))
    return Bandwidth(motion_hz=hz, joints_hz=joints, by=by, penalised=True, notes=(note,))


def _by_plates(
    dense: bandwidth.DenseMotion, markers: float, trial: Trial, model: SubjectModel
) -> float | None:
    """Hz: where motion and plates agree best; None where they do not tell."""
    basis = dense.problem.basis
    seen = build_motion(dense.problem, model.nominal, dense.smooth_at(markers).coefficients)
    reactions = compute_motion_reactions(
        model, model.nominal, seen, trial.recording, trial.plates, PLATES_HZ
    )
    frames = (
        reactions.valid
        & (basis.time >= basis.time[0] + ENDS_S)
        & (basis.time <= basis.time[-1] - ENDS_S)
    )
    if frames.sum() < FEWEST_LOADED:
        return None
    dynamics, wrench = Dynamics(model.nominal), reactions.wrench[frames]

    def disagreement(smoothed: bandwidth.SmoothedMotion) -> float:
        q, v, a = (basis.evaluate(smoothed.coefficients, k)[frames] for k in range(3))
        return float((dynamics.compute_residual_force(q, v, a, wrench) ** 2).sum())

    hz = dense.minimise_criterion(
        disagreement, markers / REACH, min(markers * REACH, dense.highest)
    )
    told = disagreement(dense.smooth_at(0.5 * hz)) >= TOLD * disagreement(dense.smooth_at(hz))
    return hz if told else None


def _suffering(
    name: str, motion: bandwidth.DenseMotion, hz: float, markers: float
) -> tuple[Finding, ...]:
    """Where the markers are met much worse than with the cut-off that they ask for."""
    here, best = motion.smooth_at(hz).rms, motion.smooth_at(markers).rms
    if here <= SUFFERS * best or here <= best + SUFFERS_M:
        return ()
    found = (
        f"markers are met to about {1e3 * here:.1f} mm RMS with {hz:.1f} Hz, to {1e3 * best:.1f} "
        "mm with the "
    )
    found += f"{markers:.1f} Hz that they ask for"
    finding = Finding(
        severity=Severity.WARNING,
        topic="bandwidth",
        where=name,
        cause="the motion is smoothed too much",
        found=found,
        cure='set bandwidth_hz = "auto", and leave nodes out',
        code=Code.SMOOTHED_TOO_MUCH,
    )
    return (finding,)


def _loaded(recording: Recording) -> Array:
    """(nf,) 1 in frames in which a plate carries somebody, else 0."""
    out = np.zeros(len(recording.time), dtype=bool)
    for plate in recording.plates:
        out |= np.nan_to_num(resample_wrench(plate, recording.time))[:, 1] > LOADED_N
    return out.astype(np.float64)
