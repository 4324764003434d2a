"""A calibration made of plain numbers: quick, and with any name anywhere."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from gaitcal.analysis.result import Calibration, Loads, Stage, TrialResult, Uncertainty
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.inertial_calibration import InertialFit
from gaitcal.calibration.joint_phases import JointCalibration, PhaseSummary
from gaitcal.calibration.joint_prior import combine_joint_priors
from gaitcal.dynamics.expected_residual import estimate_expected_residual
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.dynamics.measurement_errors import ErrorSource, TorqueErrors
from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.gait.events import find_trial_events
from gaitcal.gait.spatiotemporal import measure_strides
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.linkage import COORDINATES, SEGMENTS, list_coordinates, list_joint_segments
from gaitcal.model.parameters import (
    IP_NAMES,
    JP_INDEX,
    make_symmetric_set,
    read_published_parameters,
)
from gaitcal.model.subject_model import MarkerPlacement, Subject, SubjectModel
from gaitcal.quality.verdict import judge
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role, Trial
from gaitcal.tracking.joint_floor import JointFloor
from gaitcal.tracking.motion import MarkerErrors, Motion
from gaitcal.tracking.spline import build_spline_basis

FRAMES, RATE = 241, 100.0
ANGLE_ERROR = 0.02
"""rad."""
OWN_ANGLE_ERROR = 0.012
"""rad, the part of it that differs from stride to stride."""
STRIDE = 1.0
ERROR_SHARES = {
    ErrorSource.MOTION: 0.2, ErrorSource.JOINT_MARKERS: 0.1, ErrorSource.JOINT_NOMINAL: 0.25,
    ErrorSource.SKIN: 0.05,
    ErrorSource.BANDWIDTH: 0.05, ErrorSource.INERTIA: 0.1, ErrorSource.PLATES: 0.2,
    ErrorSource.FRAMES: 0.05,
}  # fmt: skip
"""Of the variance of every torque."""
HOSTILE = (
    '<script>alert("x")</script> & $\\frac{1}{0}$ ${7*7} {{7*7}} '
    "'\"><img src=http://evil.test/x onerror=alert(1)> \u202e\u4e2d\u6587"
)
FREE = ("hip_r.pelvis.ant", "hip_l.pelvis.ant", "knee_r.thigh.front", "talocrural_l.shank.trans")
UNSEEN = ("subtalar_r.foot.trans", "subtalar_r.talus.trans")


@dataclass(frozen=True)
class Names:
    """Text that comes from a study."""

    subject: str = "S07"
    trial: str = "walk"
    marker: str = "R.Knee"
    file: str = "walk.trc"
    note: str = "forces low-pass filtered at 12 Hz"
    warning: str = "knee_r.thigh.front ended on its bound"


def down(time: np.ndarray, phase: float) -> np.ndarray:
    """A foot that is on the ground for 60 % of each stride, from `phase` (s) on."""
    return ((time - phase) % STRIDE) < 0.6 * STRIDE


def fake_calibration(
    names: Names | None = None,
    *,
    gait: bool = True,
    plates: bool = True,
    valid: bool = True,
    errors: bool = True,
    joint: bool = True,
    cycles: bool = True,
    isolated: bool = True,
) -> Calibration:
    """A whole calibration, or one without force plates, gait, standard errors, joint parameters,
    full cycles.
    """
    names = names or Names()
    rng = np.random.default_rng(3)
    parameters = read_published_parameters()
    fitted = (
        parameters.with_joint(FREE, parameters.joint[[JP_INDEX[n] for n in FREE]] + 0.004)
        if joint
        else parameters
    )
    subject = Subject(names.subject, 70.0, 1.75, "female")
    markers = MarkerPlacement((names.marker,), ("thigh_r",), np.zeros((1, 3)), np.ones(1))
    model = SubjectModel(
        subject=subject, parameters=parameters, nominal=parameters, markers=markers
    )
    trials, study_trials = [], [_study_trial("static", Role.STATIC, None, names)]
    if gait:
        trials.append(held(_gait(names, rng, plates, valid, errors, cycles)))
        study_trials.append(_study_trial(names.trial, Role.GAIT, None, names))
    if isolated:
        trials.append(_isolated(names, rng))
        study_trials.append(_study_trial("knee", Role.JOINT, "knee_r", names))
    study = Study(
        subject=subject,
        marker_set=cast(Any, SimpleNamespace(name="plug-in-gait")),
        trials=tuple(study_trials),
        settings=CalibrationSettings(),
        weights={},
        inputs={names.file: "ab" * 32},
    )
    inertial = gait and plates and valid
    told = (
        ("joint:knee_r", "knee", 9, 7, 0.4, "small step"),
        ("gait", names.trial, 34, 9, 1.2, "`ftol` reached"),
    )
    phases = tuple(
        PhaseSummary(
            name=n, trials=(t,), parameters=p, iterations=i, seconds=s, converged=True, message=m
        )
        for n, t, p, i, s, m in told
    )
    doubt = {
        "severity": Severity.WARNING,
        "topic": "joints",
        "where": STUDY,
        "found": "by 3 mm",
        "cure": "look at it",
    }
    doubts = (Finding(code=Code.TRIALS_DISAGREE, cause=names.warning, **doubt),)
    return Calibration(
        study=study,
        nominal=model,
        model=model.with_parameters(
            fitted.with_inertial(parameters.inertial * 1.02) if inertial else fitted
        ),
        trials=tuple(trials),
        phases=phases if joint else (),
        joint=_joint(fitted) if joint else None,
        inertial=_inertial(parameters.inertial) if inertial else None,
        uncertainty=_uncertainty(joint and errors),
        joint_prior=combine_joint_priors({}),
        unidentifiable=UNSEEN if joint else (),
        notes=(names.note,),
        findings=doubts,
        verdict=judge(doubts, [t.name for t in trials if t.joint is None]),
    )


def with_phase(calibration: Calibration, converged: bool) -> Calibration:
    return replace(
        calibration, phases=tuple(replace(p, converged=converged) for p in calibration.phases)
    )


def _joint(parameters: Any) -> JointCalibration:
    return JointCalibration(
        parameters=parameters, phases=(), free=FREE, errors=cast(Any, ()), unidentifiable=UNSEEN,
        findings=(),
        at_bound=("knee_r.thigh.front",),
    )  # fmt: skip


def _inertial(values: np.ndarray) -> InertialFit:
    free = make_symmetric_set()
    return InertialFit(
        names=free.names, inertial=values * 1.02, jacobian=free.selection,
        residual_jacobian=np.zeros((1, len(free.names))), rms_force=20.0, rms_moment=9.0,
        seeds=1, iterations=5, seconds=0.1, converged=True, message="done",
    )  # fmt: skip


def _uncertainty(known: bool) -> Uncertainty:
    if not known:
        return Uncertainty(None, None)
    return Uncertainty(
        ErrorSources(FREE, np.full((len(FREE), 1), 0.003), ("a",)),
        np.full((len(IP_NAMES), 1), 1e-3),
    )


def _recording(names: Names) -> Recording:
    time = np.arange(FRAMES) / RATE
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    zero = np.zeros((FRAMES, 3))
    plate = ForcePlate(name="1", time=time, force=zero, point=zero, moment=zero, corners=corners)
    source, markers = f"/home/somebody/{names.file}", np.zeros((FRAMES, 1, 3))
    return Recording(
        source=source, time=time, labels=(names.marker,), markers=markers, plates=(plate,)
    )


def _study_trial(name: str, role: Role, joint: str | None, names: Names) -> Trial:
    return Trial(name=name, role=role, joint=joint, recording=_recording(names))


def _errors(names: Names, level: float, segments: tuple[str, ...]) -> MarkerErrors:
    labels = tuple(f"{names.marker}{k}" for k in range(len(segments)))
    distance = np.full((FRAMES, len(labels)), level) * np.linspace(0.5, 1.5, FRAMES)[:, None]
    distance[10:20, 0] = np.nan
    return MarkerErrors(labels, segments, np.ones(len(labels)), distance)


def _joint_floor(floor: MarkerErrors, joints: dict[str, float]) -> JointFloor:
    """A little above the rigid one."""
    ends = {list_joint_segments(joint)[k] for joint in joints for k in (0, -1)}
    return JointFloor(
        replace(floor, distance=1.1 * floor.distance),
        joints,
        tuple(s for s in SEGMENTS if s in ends),
    )


def _motion(
    names: Names, coordinates: tuple[str, ...], level: float, segments: tuple[str, ...]
) -> Motion:
    basis = build_spline_basis(np.arange(FRAMES) / RATE, 30)
    phase = np.linspace(0.0, 5.0, 30)[:, None] + np.arange(len(coordinates))
    coefficients = 0.3 * np.sin(2.0 * phase) + level
    if "pelvis_ty" in coordinates:
        coefficients[:, coordinates.index("pelvis_ty")] = 1.0
    errors = _errors(names, level, segments)
    return Motion(
        name="m",
        coordinates=coordinates,
        basis=basis,
        coefficients=coefficients,
        errors=errors,
        converged=True,
    )


def _isolated(names: Names, rng: np.random.Generator) -> TrialResult:
    segments = list_joint_segments("knee_r")
    own = list_coordinates(segments[0], segments)
    before, after = (_motion(names, own, level, segments * 4) for level in (0.006, 0.004))
    floor, body = (
        _errors(names, 0.003, segments * 4),
        _motion(names, COORDINATES, 0.004, segments * 4),
    )
    return TrialResult(
        name="knee", role=Role.JOINT, joint="knee_r", recording=_recording(names), nominal=before,
        calibrated=after,
        final=_motion(names, own, 0.005, segments * 4), floor=floor,
        joint_floor=_joint_floor(floor, {"knee_r": 0.0032}), body=body, loads=None,
    )  # fmt: skip


def _gait(
    names: Names, rng: np.random.Generator, plates: bool, valid: bool, errors: bool, cycles: bool
) -> TrialResult:
    segments = (
        "pelvis",
        "thigh_r",
        "shank_r",
        "foot_r",
        "thigh_l",
        "shank_l",
        "foot_l",
        "head_trunk",
    )
    before, after = (_motion(names, COORDINATES, level, segments) for level in (0.011, 0.006))
    floor = _errors(names, 0.005, segments)
    loads = _loads(rng, valid, errors, cycles) if plates else None
    events = find_trial_events(
        cast(Any, SimpleNamespace(landmarks={})),
        after,
        loads.reactions if loads else None,
        _recording(names),
    )
    return TrialResult(
        name=names.trial, role=Role.GAIT, joint=None, recording=_recording(names),
        nominal=before, calibrated=after, final=after, body=after, floor=floor,
        joint_floor=_joint_floor(floor, {"hip_r": 0.0053, "knee_r": 0.0054, "ankle_r": 0.0055}),
        loads=loads,
        coordinate_errors=np.full((FRAMES, len(COORDINATES)), ANGLE_ERROR) if errors else None,
        trial_coordinate_errors=np.full((FRAMES, len(COORDINATES)), OWN_ANGLE_ERROR)
        if errors else None,
        events=events, strides=measure_strides(events, after.time, None),
    )  # fmt: skip


def _loads(rng: np.random.Generator, valid: bool, errors: bool, cycles: bool) -> Loads:
    time = np.arange(FRAMES) / RATE
    loaded = np.stack([down(time, 0.2), down(time, 0.7)], axis=1)
    if not cycles:
        loaded[100:] = False
    wrench = np.zeros((FRAMES, 2, 6))
    wrench[:, :, 1] = 700.0 * loaded
    usable = np.full(FRAMES, valid)
    usable[150:170] = False
    legs, notes = np.stack([usable] * 2, axis=1), ("plate 1: right foot",)
    reactions = GroundReactions(
        wrench=wrench, valid=usable, valid_legs=legs, loaded=loaded, resting=loaded, notes=notes
    )

    def moments(scale: float) -> Moments:
        tau = scale * 40.0 * np.sin(6.0 * time)[:, None] * np.ones((1, len(COORDINATES)))
        residual = scale * np.stack([10.0 * np.cos(9.0 * time)] * 3, axis=1)
        return Moments(
            coordinates=COORDINATES, time=time, tau=tau, knee_adduction=0.5 * tau[:, :2],
            residual_force=residual,
            residual_moment=0.2 * residual, bwh=70.0 * 9.81 * 1.75,
        )  # fmt: skip

    stages = {Stage.NOMINAL: moments(1.0), Stage.JP: moments(0.9), Stage.JP_IP: moments(0.7)}
    sizes = np.append(np.full(len(COORDINATES), 2.0), [1.0, 1.0]) * np.ones((FRAMES, 1))
    spread = (
        TorqueErrors.from_sources(
            {source: share * sizes**2 for source, share in ERROR_SHARES.items()}
        )
        if errors
        else None
    )
    return Loads(reactions, stages, spread)


def held(trial: TrialResult) -> TrialResult:
    """The trial with what its errors say of its pelvis residual."""
    loads = trial.loads
    if loads is None or loads.errors is None:
        return trial
    known = estimate_expected_residual(
        loads.final, loads.errors, loads.reactions, trial.body, 70.0 * 9.81
    )
    return replace(trial, loads=replace(loads, expected=known))
