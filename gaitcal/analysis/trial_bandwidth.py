"""Choose the bandwidth of a trial's motion: given by the settings, by its markers or force plates.

Joint parameters take the cut-off that the markers ask for (`tracking/bandwidth.py`). The motion of
a walk over force plates may take another one, at which forces and motion agree best,

    f = argmin sum_t |F(t; f)|^2,       F the pelvis residual force.

Frames and plate forces of the sum do not depend on f: plates are filtered at 50 Hz here, whatever
the settings ask for. Filtered at f, both would agree the better the less of them remains. The
plates choose f and have no other influence on the motion. Their influence is limited:

- F depends on the trunk and hardly on the feet: f differs by half an octave at most from that of
  the markers.
- If mass or model are wrong, or all markers move together, F falls with f without a minimum. Plates
  choose only if half of the f found would raise sum |F|^2 by the factor `DECISIVE`.

The trial has one final motion, which is that of the torques.
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

PLATES_HZ = 50.0
"""Hz, cut-off of the plates while they choose."""
JOINTS_HZ = 12.0
"""Hz, lowest cut-off while joint parameters are fitted, which need no accelerations. Smoothed at
the 2 Hz that the markers of a slow functional trial ask for, knee axes were 7.5 mm off instead of
2.5 (12 and 25 Hz alike)."""
ENDS_S = 0.1
"""s at either end that plates do not use: accelerations there depend on one side only."""
FEWEST_LOADED = 20
"""Fewest valid frames for plates to choose."""
REACH = float(np.sqrt(2.0))
"""Largest factor between the cut-off of the plates and that of the markers: half an octave."""
DECISIVE = 1.25
"""Least factor by which sum |F|^2 is larger at half of the f of the plates."""
AT_LIMIT = 0.99
"""Part of the highest cut-off of the frame rate from which it is reported."""
WORSE = 1.2
"""Ratio of the marker error to that at the markers' cut-off from which it is reported."""
WORSE_M = 3e-4
"""m, the same as a difference; both must be exceeded."""


class ChosenBy(Enum):
    """What chose the bandwidth of a trial's motion."""

    MARKERS = "markers"
    PLATES = "plates"
    GIVEN = "given"


@dataclass(frozen=True, kw_only=True)
class Bandwidth:
    """The bandwidth of one trial."""

    motion_hz: float
    """Cut-off: half of the amplitude of an oscillation at it remains in the motion."""
    joints_hz: float
    """The same while joint parameters are fitted."""
    chosen_by: ChosenBy
    """What chose `motion_hz`."""
    penalised: bool
    """False: only the number of spline nodes limits the motion."""
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


def choose_bandwidth(
    problem: trial_problem.MotionProblem,
    trial: Trial,
    model: SubjectModel,
    settings: CalibrationSettings,
) -> Bandwidth:
    """Choose the bandwidth of a trial.

    Parameters
    ----------
    problem : MotionProblem
        What the joint parameters of the trial are fitted to, with the nodes of the settings if
        given.
    trial : Trial
        Rotated so that x is forward.
    model : SubjectModel
        Its nominal parameters are used, so that a calibration and further trials choose alike.
    settings : CalibrationSettings
        Of the study.

    Returns
    -------
    Bandwidth
    """
    if settings.nodes is not None:
        return _take_given_nodes(problem)
    # Of a trial too long to be smoothed as a whole, the part on the plates is used.
    loaded = _find_loaded_frames(trial.recording)
    motion = bandwidth.DenseMotion(problem, model.nominal, loaded if loaded.any() else None)
    markers = motion.choose_cutoff()
    if settings.nodes_per_second is not None:
        chosen = _take_given_nodes(problem)
    elif settings.bandwidth_hz != AUTOMATIC:
        hz = float(settings.bandwidth_hz)
        note = f"motion smoothed at {hz:.1f} Hz (half amplitude), as set"
        chosen = Bandwidth(
            motion_hz=hz, joints_hz=hz, chosen_by=ChosenBy.GIVEN, penalised=True, notes=(note,)
        )
    else:
        plates = None
        if trial.recording.plates and not trial.joint:
            plates = _choose_by_plates(motion, markers, trial, model)
        chosen = _take_cutoffs(markers, plates, motion)
    findings = _check_smoothing(trial.name, motion, chosen.motion_hz, markers)
    return replace(chosen, findings=findings)


def _take_given_nodes(problem: trial_problem.MotionProblem) -> Bandwidth:
    """Compute the bandwidth of splines with a given number of nodes.

    Least squares passes half of the amplitude at 0.5 oscillations per span.
    """
    time, nodes = problem.basis.time, problem.basis.control_points
    hz = 0.5 * (nodes - spline.DEGREE) / float(time[-1] - time[0])
    note = f"motion limited to {hz:.1f} Hz (half amplitude) by {nodes} spline nodes, as set"
    return Bandwidth(
        motion_hz=hz, joints_hz=hz, chosen_by=ChosenBy.GIVEN, penalised=False, notes=(note,)
    )


def _take_cutoffs(markers: float, plates: float | None, motion: bandwidth.DenseMotion) -> Bandwidth:
    """Build the bandwidth from the cut-offs (Hz) of markers and, if they chose one, plates."""
    if plates is None:
        hz, chosen_by = markers, ChosenBy.MARKERS
        note = f"motion smoothed at {hz:.1f} Hz (half amplitude), chosen by its markers"
    else:
        hz, chosen_by = plates, ChosenBy.PLATES
        note = (
            f"motion smoothed at {hz:.1f} Hz (half amplitude), where motion and force plates agree "
            f"best; markers alone: {markers:.1f} Hz"
        )
    if hz > AT_LIMIT * motion.highest:
        rate = spline.compute_frame_rate(motion.problem.basis)
        note += f"; the limit of {rate:.0f} frames per second"
    # Joints need the full range of motion: a cut-off of at least what the markers choose, Hz.
    joints = max(markers, hz, min(JOINTS_HZ, motion.highest))
    return Bandwidth(
        motion_hz=hz, joints_hz=joints, chosen_by=chosen_by, penalised=True, notes=(note,)
    )


def _choose_by_plates(
    dense: bandwidth.DenseMotion, markers: float, trial: Trial, model: SubjectModel
) -> float | None:
    """Compute the cut-off (Hz) at which motion and plates agree best; None if undecided."""
    basis = dense.problem.basis
    # Ground reactions need a motion for the feet; that of the markers is near enough.
    motion = build_motion(dense.problem, model.nominal, dense.smooth_at(markers).coefficients)
    reactions = compute_motion_reactions(
        model, model.nominal, motion, trial.recording, trial.plates, PLATES_HZ
    )
    frames = (
        reactions.valid
        & (basis.time >= basis.time[0] + ENDS_S)
        & (basis.time <= basis.time[-1] - ENDS_S)
    )
    if frames.sum() < FEWEST_LOADED:
        return None
    dynamics, wrench = Dynamics(model.nominal), reactions.wrench[frames]

    def sum_squared_residuals(smoothed: bandwidth.SmoothedMotion) -> float:
        q, v, a = (basis.evaluate(smoothed.coefficients, k)[frames] for k in range(3))
        return float((dynamics.compute_residual_force(q, v, a, wrench) ** 2).sum())

    # The pelvis residual has a minimum in the cut-off: noise above it, lost accelerations below.
    hz = dense.minimise_criterion(
        sum_squared_residuals, markers / REACH, min(markers * REACH, dense.highest)
    )
    # A residual that other errors dominate hardly depends on the cut-off, and decides nothing.
    at_half = sum_squared_residuals(dense.smooth_at(0.5 * hz))
    is_decided = at_half >= DECISIVE * sum_squared_residuals(dense.smooth_at(hz))
    return hz if is_decided else None


def _check_smoothing(
    name: str, motion: bandwidth.DenseMotion, hz: float, markers: float
) -> tuple[Finding, ...]:
    """Report a marker error much larger than at the cut-off (Hz) that the markers choose."""
    error, best = motion.smooth_at(hz).rms, motion.smooth_at(markers).rms
    # m, against the cut-off that the markers themselves choose.
    if error <= WORSE * best or error <= best + WORSE_M:
        return ()
    finding = Finding(
        severity=Severity.WARNING,
        topic="bandwidth",
        where=name,
        cause="the motion is smoothed too much",
        found=f"marker error about {1e3 * error:.1f} mm RMS at {hz:.1f} Hz, {1e3 * best:.1f} mm at "
        f"the {markers:.1f} Hz that the markers choose",
        cure='set bandwidth_hz = "auto", and remove nodes from the study file',
        code=Code.SMOOTHED_TOO_MUCH,
    )
    return (finding,)


def _find_loaded_frames(recording: Recording) -> Array:
    """Compute (nf,) 1 in frames with a loaded plate, else 0."""
    out = np.zeros(len(recording.time), dtype=bool)
    for plate in recording.plates:
        out |= np.nan_to_num(resample_wrench(plate, recording.time))[:, 1] > LOADED_N
    return out.astype(np.float64)
