"""Detect joint parameters that the trials do not determine, in fits without a prior.

A parameter is undetermined if its standard error from the markers alone exceeds 20 mm or 20
degrees, more than a joint can be off. The worst one is fixed at its present value. The covariance
of the others is then cov - cov_k cov_k^T / cov_kk, and the search continues until all remaining
parameters are determined. Directions in which S, the reduced Gauss-Newton matrix in units of the
noise, vanishes have an unbounded variance. So does an axis about which the joint hardly moved in
its functional trials: its residuals are noise that rotates with the joint.

One marker on an upper arm does not determine its rotation about its length, and the model's upper
arm does not rotate so. A fit may then find an elbow that bends backwards with the arm rotated by
half a turn. The joints of that arm keep their nominal parameters.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.reduced_problem import NULL
from gaitcal.errors import STUDY, Code, Finding, Severity, join_names
from gaitcal.model import coordinates, linkage
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, ParameterKind, Parameters
from gaitcal.tracking import motion, rigid, trial_problem
from gaitcal.tracking.start import find_start_coefficients

# m, standard error above which a joint position counts as not determined
LARGEST_POSITION = 0.020
LARGEST_ORIENTATION = np.deg2rad(20.0)  # rad, the same for an axis' direction
# rad, range of motion that determines the axis of a joint (Reinbolt et al. 2007)
NEEDED_RANGE = np.deg2rad(25.0)
LEAST_RANGE = np.deg2rad(5.0)
"""rad, range of motion below which a functional trial does not determine an axis: the size of
apparent rotations by soft tissue."""
# Variance of unobservable directions, in squares of the largest plausible error
UNBOUNDED = 1e6
# Leg joint parameters at their bounds from which the static trial is taken as of another body
MANY_AT_BOUND = 4
SAME_PLACEMENT_M = 0.001
"""m, RMS: markers that are attached again, or to another body, change distances within segments by
more than this."""
LARGEST_ARM_ROTATION = np.deg2rad(90.0)
"""rad, median over a trial of a coordinate's change from its start: noise and bounds of joint
parameters cause less."""
MOVEMENTS = {
    "hip_flexion": "flexion",
    "hip_adduction": "abduction",
    "knee_angle": "flexion",
    "ankle_angle": "dorsiflexion",
    "subtalar_angle": "inversion",
}
"""Coordinate, without its side, that determines an axis in a functional trial -> its movement."""
RangesOfMotion = Mapping[str, Mapping[str, float]]
"""Joint of isolated trials -> its coordinates, without their side -> the largest range (rad) in any
of these trials.
"""


def _list_shown_axes(isolated: str) -> dict[str, tuple[str, ...]]:
    """List the coordinates of `MOVEMENTS` of each joint that a functional trial moves."""
    axes: dict[str, tuple[str, ...]] = {}
    for joint in linkage.list_moved_joints(isolated):
        names = [coordinates.split_side(e.name)[0] for e in joint.elements]
        axes[joint.name] = tuple(name for name in names if name in MOVEMENTS)
    return axes


def find_unobservable_parameters(
    free: Sequence[str], covariance: Array, information: Array, unmoved: Sequence[str] = ()
) -> tuple[str, ...]:
    """Find free parameters that the trials of a fit do not determine.

    Parameters
    ----------
    free : sequence of str
        Free joint parameters.
    covariance : (np, np) array
        Covariance along the directions that S determines, m and rad.
    information : (np, np) array
        S.
    unmoved : sequence of str
        Parameters of axes about which the joint did not move.

    Returns
    -------
    tuple of str
        `unmoved` first, then the worst first.
    """
    position = [JOINT_PARAMETERS[JP_INDEX[name]].kind is ParameterKind.POSITION for name in free]
    allowed = np.where(position, LARGEST_POSITION, LARGEST_ORIENTATION)
    values, vectors = np.linalg.eigh(information)
    null = (
        vectors[:, values <= NULL * max(float(values.max(initial=0.0)), 1e-300)] / allowed[:, None]
    )
    covariance = covariance / np.outer(allowed, allowed) + UNBOUNDED * null @ null.T
    unobservable = [name for name in free if name in unmoved]
    kept = [k for k, name in enumerate(free) if name not in unmoved]
    while kept:
        variances = covariance[kept, kept]
        worst = int(np.argmax(variances))
        if variances[worst] <= 1.0:
            break
        k = kept.pop(worst)
        unobservable.append(free[k])
        covariance = covariance - np.outer(covariance[:, k], covariance[k]) / covariance[k, k]
    return tuple(unobservable)


def find_unmoved_parameters(
    free: Sequence[str], joint: str, turned: Mapping[str, float]
) -> tuple[str, ...]:
    """Find parameters of axes about which a functional trial moved by less than `LEAST_RANGE`.

    Parameters
    ----------
    free : sequence of str
        Free joint parameters.
    joint : str
        Joint of the functional trials.
    turned : mapping of str to float
        Coordinate without its side -> largest range, rad (`measure_ranges_of_motion`).

    Returns
    -------
    tuple of str
        Names among `free`.
    """
    still = {
        axis
        for axis, names in _list_shown_axes(joint).items()
        if max(map(turned.__getitem__, names)) < LEAST_RANGE
    }
    return tuple(name for name in free if name.split(".")[0] in still)


def _measure_ranges(
    problem: trial_problem.MotionProblem, coefficients: Array, joint: str
) -> dict[str, float]:
    """Measure the range (rad) of each coordinate, without its side, over a functional trial."""
    ranges = dict(
        zip(
            problem.chain.coordinates,
            np.ptp(problem.basis.evaluate(coefficients), axis=0).tolist(),
            strict=True,
        )
    )
    return {
        name: ranges[f"{name}_{joint[-1]}"]
        for names in _list_shown_axes(joint).values()
        for name in names
    }


def measure_ranges_of_motion(
    problems: Sequence[trial_problem.MotionProblem],
    coefficients: Sequence[Array],
    joints: Sequence[str | None],
) -> dict[str, dict[str, float]]:
    """Measure how far functional trials move their joints.

    Parameters
    ----------
    problems : sequence of MotionProblem
        The trials.
    coefficients : sequence of (nn, nq) array
        Their motions.
    joints : sequence of str or None
        Joint of each functional trial; None for gait.

    Returns
    -------
    dict
        Joint -> coordinate without its side -> largest range, rad.
    """
    out: dict[str, dict[str, float]] = {}
    for problem, nodes, joint in zip(problems, coefficients, joints, strict=True):
        if joint is not None:
            found = out.setdefault(joint, {})
            for name, turned in _measure_ranges(problem, nodes, joint).items():
                found[name] = max(found.get(name, 0.0), turned)
    return out


def report_small_ranges(
    problem: trial_problem.MotionProblem, coefficients: Array, joint: str
) -> tuple[Finding, ...]:
    """Report movements of a functional trial that are too small to determine their axis."""
    return tuple(
        Finding(
            severity=Severity.INFO if turned >= LEAST_RANGE else Severity.WARNING,
            topic="range of motion",
            where=problem.name,
            cause=f"{joint} hardly moved in {MOVEMENTS[name]}",
            found=f"found {np.rad2deg(turned):.0f} deg; about {np.rad2deg(NEEDED_RANGE):.0f} deg "
            "show that axis",
            cure="its error bar is the wider; record the trial again with a larger movement",
            leg=joint[-1],
            code=Code.SMALL_MOVEMENT,
        )
        for name, turned in _measure_ranges(problem, coefficients, joint).items()
        if turned < NEEDED_RANGE
    )


def _describe_advice(joint: str, kind: str, turned: Mapping[str, float]) -> str:
    """Describe the trial to record for a joint, given the ranges (rad) of its functional trials."""
    if not turned:
        needed = f"at least {np.rad2deg(NEEDED_RANGE):.0f} deg of movement"
        return (
            f"add an isolated {kind} trial of the {linkage.SIDE_WORDS[joint[-1]]} leg with {needed}"
        )
    had = " and ".join(
        f"{np.rad2deg(angle):.0f} deg in {MOVEMENTS[name]}" for name, angle in turned.items()
    )
    axes = _list_shown_axes(f"{kind}_{joint[-1]}")[joint]
    small = [MOVEMENTS[n] for n, angle in turned.items() if angle < NEEDED_RANGE and n in axes]
    if small:
        return f"the isolated {kind} trial has {had}; record more {' and '.join(small)}"
    return (
        f"the isolated {kind} trial has {had}, which suffices; the error bars include the "
        "remaining uncertainty"
    )


def _make_finding(
    code: Code, cause: str, found: str, cure: str, leg: str = "", severity: Severity = Severity.INFO
) -> Finding:
    """Make a finding about joint parameters."""
    return Finding(
        severity=severity,
        topic="joint parameters",
        where=STUDY,
        cause=cause,
        found=found,
        cure=cure,
        leg=leg,
        weight=10.0 if severity is Severity.ERROR else 1.0,
        code=code,
    )


def report_undetermined(
    undetermined: Sequence[str], done: str, turned: RangesOfMotion
) -> tuple[Finding, ...]:
    """Report the undetermined parameters of each joint, and the trial to record.

    Parameters
    ----------
    undetermined : sequence of str
        Undetermined joint parameters.
    done : str
        Treatment of these parameters, for the message.
    turned : mapping
        Ranges of motion of the functional trials, rad.

    Returns
    -------
    tuple of Finding
        One for each joint.
    """
    out = []
    for joint in dict.fromkeys(JOINT_PARAMETERS[JP_INDEX[name]].joint for name in undetermined):
        of_joint = [
            name for name in undetermined if JOINT_PARAMETERS[JP_INDEX[name]].joint == joint
        ]
        kind = coordinates.JOINT_TABLE[coordinates.split_side(joint)[0]].power
        cause, found = (
            f"{joint} is not fully determined",
            f"{', '.join(of_joint)} not determined; {done}",
        )
        advice = _describe_advice(joint, kind, turned.get(f"{kind}_{joint[-1]}", {}))
        out.append(_make_finding(Code.UNDETERMINED, cause, found, advice, joint[-1]))
    return tuple(out)


def is_same_placement(problems: Sequence[trial_problem.MotionProblem]) -> bool:
    """Return whether markers of pelvis and legs have the same placement as in the static trial.

    False if soft tissue or camera noise leave that open, and for points that are no markers.
    """
    floors = [motion.compute_rigid_floor(problem) for problem in problems if problem.noise is None]
    shown = [
        (floor, s)
        for floor in floors
        for s in linkage.LOWER_BODY
        if floor.select_observed(s).sum() >= rigid.FEWEST_MARKERS
    ]
    distances = [floor.rms(segment) or 0.0 for floor, segment in shown]
    return bool(distances) and len(floors) == len(problems) and max(distances) < SAME_PLACEMENT_M


def report_bounds(names: Sequence[str], *, same_body: bool = False) -> tuple[Finding, ...]:
    """Report joint parameters on their bounds or beyond.

    Parameters
    ----------
    names : sequence of str
        Joint parameters.
    same_body : bool
        Whether markers show that the static trial is of the same body as the others.

    Returns
    -------
    tuple of Finding
        Warnings for leg joints and notes for others; an error if many leg parameters are affected.
    """
    legs = [name for name in names if name.split(".")[0].rpartition("_")[0] in linkage.LEG_JOINTS]
    many = (
        not same_body
        and len(legs) >= MANY_AT_BOUND
        and len({name.split(".")[0] for name in legs}) > 1
    )
    out = []
    for joint in dict.fromkeys(name.split(".")[0] for name in names):
        of_joint = [name for name in names if name.split(".")[0] == joint]
        leg = of_joint[0] in legs
        if not (leg and many):
            out.append(
                _make_finding(
                    Code.JOINT_AT_BOUND,
                    f"{joint} is further from its position in the static trial than in people",
                    f"{join_names(of_joint)} on the bound of how far it may move, or beyond",
                    "look at the landmarks of the static trial, and whether the trials are of this "
                    "person and joint",
                    joint[-1] if leg else "",
                    Severity.WARNING if leg else Severity.INFO,
                )
            )
    if many:
        found = (
            f"{len(legs)} joint parameters are on the bound of how far they may move, or beyond: "
            f"{join_names(legs)}"
        )
        cause = "the static trial does not show the body of the moving trials"
        cure = "is it of another person, or of another day, with the markers in other places?"
        out.append(_make_finding(Code.OTHER_BODY, cause, found, cure, severity=Severity.ERROR))
    return tuple(out)


def detect_ambiguous_arms(
    problems: Sequence[trial_problem.MotionProblem],
    coefficients: Sequence[Array],
    parameters: Parameters,
) -> Mapping[str, float]:
    """Detect arms that a fit has rotated too far from the start of rigid fits.

    Parameters
    ----------
    problems : sequence of MotionProblem
        Trials with trunk and arms.
    coefficients : sequence of (nn, nq) array
        Their fitted motions.
    parameters : Parameters
        Parameters of the rigid fits.

    Returns
    -------
    mapping of str to float
        Side -> rotation, rad.
    """
    out: dict[str, float] = {}
    arm = [row.name for row in coordinates.COORDINATE_TABLE.values() if row.group == "arm"]
    for problem, nodes in zip(problems, coefficients, strict=True):
        start = find_start_coefficients(problem.build_body(parameters), problem.data, problem.basis)
        rotation = np.abs(np.angle(np.exp(1j * problem.basis.evaluate(nodes - start))))
        median = dict(
            zip(problem.chain.coordinates, np.median(rotation, axis=0).tolist(), strict=True)
        )
        for side in linkage.SIDES:
            names = [f"{angle}_{side}" for angle in arm]
            most = max((median[name] for name in names if name in median), default=0.0)
            if most > max(LARGEST_ARM_ROTATION, out.get(side, 0.0)):
                out[side] = most
    return out


def exclude_arms(free: Sequence[str], sides: Mapping[str, float]) -> tuple[str, ...]:
    """Exclude the joint parameters of these arms."""
    joints = {f"{joint}_{side}" for joint in ("shoulder", "elbow") for side in sides}
    return tuple(name for name in free if name.split(".")[0] not in joints)


def report_ambiguous_arms(sides: Mapping[str, float]) -> tuple[Finding, ...]:
    """Report that the joints of these arms keep their nominal parameters."""
    return tuple(
        _make_finding(
            Code.UNDETERMINED,
            f"shoulder and elbow of the {linkage.SIDE_WORDS[side]} arm stay nominal",
            f"their fit turned the arm by {np.rad2deg(turn):.0f} degrees, which no arm does: its "
            "markers do not determine the rotation of the upper arm about its length",
            "nothing, if only the legs matter; a second marker on the upper arm determines it",
        )
        for side, turn in sides.items()
    )
