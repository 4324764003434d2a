"""The bandwidth of a trial's motion: given by the settings, or chosen by its markers and its force plates.

Joint parameters take the cut-off that the markers ask for (`motion/bandwidth.py`). Velocities, accelerations and
torques of a walk over force plates take the one that brings forces and motion together,

    f = argmin sum_t |F(t; f)|^2,       F the pelvis residual force,

over frames and plate forces that do not change with f: plates are filtered at 50 Hz here, whatever the settings say.
Filtered at f themselves, they would agree with the motion the better the less of either is left. The plates choose f
alone and take no further part in the motion. One motion leaves the trial, the one that the torques are of: on truths
its accelerations are nearer than, or as near as, those at the markers' f, and angles hardly differ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from gaitcal.arrays import BoolArray
from gaitcal.dynamics.ground_reactions import reactions_of_motion
from gaitcal.dynamics.inverse_dynamics import Dynamics, pelvis_residual
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.bandwidth import CutoffScan, Smoothed
from gaitcal.motion.motion import motion_of
from gaitcal.motion.roughness import frame_rate
from gaitcal.motion.spline import DEGREE
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.recording import resample_wrench
from gaitcal.recording.force_plate import LOADED_N
from gaitcal.recording.recording import Recording
from gaitcal.study.settings import AUTOMATIC, CalibrationSettings
from gaitcal.study.study import StudyTrial

PLATES_HZ = 50.0
"""Of the plates while they choose."""
ENDS_S = 0.1
"""s at either end that have no say, whatever f: accelerations there lean on one side only."""
FEWEST_LOADED = 20
"""Valid frames below which plates have no say."""
SUFFERS, SUFFERS_M = 1.2, 3e-4
"""A fit suffers where its noise is 1.2 times, and its marker error 0.3 mm above, that with the highest cut-off."""


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
    warnings: tuple[str, ...] = ()


def bandwidth_of(
    problem: TrialProblem, trial: StudyTrial, recording: Recording, model: SubjectModel, settings: CalibrationSettings
) -> Bandwidth:
    """The bandwidth of a trial.

    Parameters
    ----------
    problem : what its joint parameters are fitted by, with the nodes of the settings if these give any.
    trial, recording : as read, and turned so that x is forward.
    model : whose parameters the trial is tracked with on the way.
    """
    if settings.nodes is not None:
        return _given_nodes(problem)
    # Where a trial is too long to be looked at as a whole, a walk is where its plates are.
    loaded = _loaded(recording)
    scan = CutoffScan(problem, model.parameters, loaded if loaded.any() else None)
    if settings.nodes_per_second is not None:
        given = _given_nodes(problem)
        return _told(given, scan, scan.with_nodes(2.0 * given.motion_hz, given.motion_hz))
    if settings.bandwidth_hz != AUTOMATIC:
        hz = float(settings.bandwidth_hz)
        note = f"motion smoothed at {hz:.1f} Hz (half amplitude), as the settings say"
        given = Bandwidth(motion_hz=hz, joints_hz=hz, by=ChosenBy.GIVEN, penalised=True, notes=(note,))
        return _told(given, scan, scan.smoothed(hz, scan.at(0)))
    markers = scan.by_markers()
    plates = _by_plates(scan, markers, trial, recording, model) if recording.plates and not trial.joint else None
    chosen = _chosen(markers, plates, scan)
    return _told(chosen, scan, _nearest(scan, chosen.motion_hz))


def _given_nodes(problem: TrialProblem) -> Bandwidth:
    """That of splines of a given number of nodes: least squares passes half of 0.5 oscillations a span."""
    time = problem.basis.time
    hz = 0.5 * (problem.basis.nodes - DEGREE) / float(time[-1] - time[0])
    note = f"the motion passes half of {hz:.1f} Hz: {problem.basis.nodes} spline nodes, as the settings say"
    return Bandwidth(motion_hz=hz, joints_hz=hz, by=ChosenBy.GIVEN, penalised=False, notes=(note,))


def _chosen(markers: float, plates: float | None, scan: CutoffScan) -> Bandwidth:
    hz = markers if plates is None else plates
    by = ChosenBy.MARKERS if plates is None else ChosenBy.PLATES
    asked = "its markers ask for (cross-validation)"
    if plates is None:
        note = f"motion smoothed at {hz:.1f} Hz (half amplitude), which {asked}"
    else:
        note = (
            f"motion smoothed at {hz:.1f} Hz (half amplitude), where it and the force plates agree best; {markers:.1f} "
            f"Hz is what {asked}"
        )
    if hz >= scan.cutoffs[0]:
        note += f"; frames at {frame_rate(scan.problem.basis):.0f} Hz allow no more"
    return Bandwidth(motion_hz=hz, joints_hz=max(markers, hz), by=by, penalised=True, notes=(note,))


def _by_plates(
    scan: CutoffScan, markers: float, trial: StudyTrial, recording: Recording, model: SubjectModel
) -> float | None:
    """Hz: where motion and plates agree best; None where too few frames are valid."""
    seen = _nearest(scan, markers)
    motion = motion_of(seen.problem, model.parameters, seen.nodes)
    reactions = reactions_of_motion(model, model.parameters, motion, recording, trial.plates, PLATES_HZ)
    time = motion.time
    frames = reactions.valid & (time >= time[0] + ENDS_S) & (time <= time[-1] - ENDS_S)
    if frames.sum() < FEWEST_LOADED:
        return None
    dynamics, wrench = Dynamics(model.parameters), reactions.wrench[frames]

    def disagreement(smoothed: Smoothed) -> float:
        q, v, a = (smoothed.problem.basis.evaluate(smoothed.nodes, k)[frames] for k in range(3))
        return float((pelvis_residual(q, dynamics.forces(q, v, a, wrench))[:, :3] ** 2).sum())

    return scan.least(disagreement)


def _told(bandwidth: Bandwidth, scan: CutoffScan, chosen: Smoothed) -> Bandwidth:
    """With a warning where the markers are met much worse than they could be."""
    best = scan.at(0)
    if chosen.noise <= SUFFERS * best.noise or chosen.rms <= best.rms + SUFFERS_M:
        return bandwidth
    warning = (
        f"markers are met to {1e3 * chosen.rms:.1f} mm RMS at {bandwidth.motion_hz:.1f} Hz, to {1e3 * best.rms:.1f} mm "
        f"where {best.cutoff_hz:.0f} Hz pass: the motion is smoothed more than they say"
    )
    return replace(bandwidth, warnings=(warning,))


def _nearest(scan: CutoffScan, hz: float) -> Smoothed:
    """The one tracked with the cut-off nearest to `hz`."""
    return min(scan.tracked, key=lambda smoothed: abs(np.log(smoothed.cutoff_hz / hz)))


def _loaded(recording: Recording) -> BoolArray:
    """(nf,) frames in which a plate carries somebody."""
    out = np.zeros(len(recording.time), dtype=bool)
    for plate in recording.plates:
        out |= np.nan_to_num(resample_wrench(plate, recording.time))[:, 1] > LOADED_N
    return out
