"""Which joint parameters the trials cannot see, where no prior holds them.

A parameter whose standard error, from the markers alone, is larger than what anybody would believe
about a joint (20 mm, 20 degrees) is not determined. It is frozen at its present value, the worst
first: given it, the covariance of the others becomes cov - cov_k cov_k^T / cov_kk, and the search
goes on until every remaining parameter is determined. Directions along which S, the reduced
Gauss-Newton matrix in units of the noise, vanishes count with an unbounded variance, and so does an
axis about which the joint hardly moved in its isolated trials: what residuals say of it there is
noise that turns with the joint.

One marker on an upper arm does not tell how it is turned about its length, and the model's upper
arm does not turn so. Where a real one does, a fit of its joints may find an elbow that bends the
other way, with the whole arm half a turn about: a motion far from the one that the markers begin
with. The joints of that arm are then left where they were.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.reduced_problem import NULL
from gaitcal.errors import STUDY, Code, Finding, Severity, listed
from gaitcal.model import coordinates, linkage
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, ParameterKind, Parameters
from gaitcal.tracking import motion, rigid, trial_problem
from gaitcal.tracking.start import find_start_coefficients

LARGEST_POSITION = 0.020  # m, standard error above which a joint position counts as not determined
LARGEST_ORIENTATION = np.deg2rad(20.0)  # rad, the same for an axis' direction
NEEDED_TURN = np.deg2rad(
    25.0
)  # Range of motion a joint needs for its axis to be found (Reinbolt et al. 2007).
LEAST_TURN = np.deg2rad(5.0)
"""Range of motion below which an isolated trial says nothing of an axis: of the size of what skin
movement feigns.
"""
UNBOUNDED = (
    1e6  # Variance, in squares of the largest error believed, of what the markers cannot see at all
)
# Leg joint parameters beyond their bounds from which no single joint is odd: the body is another
# one
MANY_BEYOND = 4
PLACED_ANEW = 0.001
"""m, RMS: no hand puts markers on another body, or on anew, so that all distances within segments
stay to this.
"""
LARGEST_ARM_TURN = np.deg2rad(90.0)
"""From where a coordinate begins, the median over a trial: no noise and no bound of joint
parameters turns so far.
"""
MOVEMENTS = {
    "hip_flexion": "flexion",
    "hip_adduction": "abduction",
    "knee_angle": "flexion",
    "ankle_angle": "dorsiflexion",
    "subtalar_angle": "inversion",
}
"""Coordinate, without its side, that shows an axis in an isolated trial -> what that movement is
called.
"""
Turns = Mapping[str, Mapping[str, float]]
"""Joint of isolated trials -> its coordinates, without their side -> the largest range (rad) in any
of these trials.
"""


def _axes(isolated: str) -> dict[str, tuple[str, ...]]:
    """Joint of the linkage -> its coordinates of `MOVEMENTS`, for what an isolated trial moves."""
    return {
        joint.name: tuple(
            name for e in joint.elements if (name := coordinates.split_side(e.name)[0]) in MOVEMENTS
        )
        for joint in linkage.moved_joints(isolated)
    }


def unseen_parameters(
    free: Sequence[str], covariance: Array, information: Array, unmoved: Sequence[str] = ()
) -> tuple[str, ...]:
    """Names of the free parameters that the trials of a fit do not determine, worst first;
    `unmoved` come first.

    `covariance` (np, np) along the directions that S, `information` (np, np), tells at all.
    """
    position = [JOINT_PARAMETERS[JP_INDEX[name]].kind is ParameterKind.POSITION for name in free]
    allowed = np.where(position, LARGEST_POSITION, LARGEST_ORIENTATION)
    values, vectors = np.linalg.eigh(information)
    null = (
        vectors[:, values <= NULL * max(float(values.max(initial=0.0)), 1e-300)] / allowed[:, None]
    )
    covariance = covariance / np.outer(allowed, allowed) + UNBOUNDED * null @ null.T
    unseen = [name for name in free if name in unmoved]
    kept = [k for k, name in enumerate(free) if name not in unmoved]
    while kept:
        variances = covariance[kept, kept]
        worst = int(np.argmax(variances))
        if variances[worst] <= 1.0:
            break
        k = kept.pop(worst)
        unseen.append(free[k])
        covariance = covariance - np.outer(covariance[:, k], covariance[k]) / covariance[k, k]
    return tuple(unseen)


def unmoved_parameters(
    free: Sequence[str], joint: str, turned: Mapping[str, float]
) -> tuple[str, ...]:
    """Free parameters of the axes of an isolated joint about which its trials moved by less than
    `LEAST_TURN`.

    `turned`: coordinate, without its side -> the largest range (rad) in any of them (`turns_of`).
    """
    still = {
        axis
        for axis, names in _axes(joint).items()
        if max(turned[name] for name in names) < LEAST_TURN
    }
    return tuple(name for name in free if name.split(".")[0] in still)


def _turns(
    problem: trial_problem.MotionProblem, coefficients: Array, joint: str
) -> dict[str, float]:
    """Coordinate of an isolated joint, without its side -> its range (rad) over a trial."""
    ranges = dict(
        zip(
            problem.chain.coordinates,
            np.ptp(problem.basis.evaluate(coefficients), axis=0).tolist(),
            strict=True,
        )
    )
    return {
        name: ranges[f"{name}_{joint[-1]}"] for names in _axes(joint).values() for name in names
    }


def turns_of(
    problems: Sequence[trial_problem.MotionProblem],
    coefficients: Sequence[Array],
    joints: Sequence[str | None],
) -> dict[str, dict[str, float]]:
    """How far isolated trials move their joints; `joints` names that of each problem, None for
    gait.
    """
    out: dict[str, dict[str, float]] = {}
    for problem, own, joint in zip(problems, coefficients, joints, strict=True):
        if joint is not None:
            found = out.setdefault(joint, {})
            for name, turned in _turns(problem, own, joint).items():
                found[name] = max(found.get(name, 0.0), turned)
    return out


def small_turns(
    problem: trial_problem.MotionProblem, coefficients: Array, joint: str
) -> tuple[Finding, ...]:
    """Movements of an isolated trial that are too small to show their axis."""
    return tuple(
        Finding(
            severity=Severity.INFO if turned >= LEAST_TURN else Severity.WARNING,
            topic="range of motion",
            where=problem.name,
            cause=f"{joint} hardly moved in {MOVEMENTS[name]}",
            found=f"found {np.rad2deg(turned):.0f} deg; about {np.rad2deg(NEEDED_TURN):.0f} deg "
            "show that axis",
            cure="its error bar is the wider; record the trial again with a larger movement",
            leg=joint[-1],
            code=Code.SMALL_MOVEMENT,
        )
        for name, turned in _turns(problem, coefficients, joint).items()
        if turned < NEEDED_TURN
    )


def _advice(joint: str, kind: str, turned: Mapping[str, float]) -> str:
    """What to record for a joint of the model, where isolated trials have `turned` the joint that
    it belongs to.
    """
    if not turned:
        needed = f"at least {np.rad2deg(NEEDED_TURN):.0f} deg of movement"
        return (
            f"add an isolated {kind} trial of the {linkage.SIDE_WORDS[joint[-1]]} leg with {needed}"
        )
    had = " and ".join(
        f"{np.rad2deg(angle):.0f} deg in {MOVEMENTS[name]}" for name, angle in turned.items()
    )
    axes = _axes(f"{kind}_{joint[-1]}")[joint]
    small = [MOVEMENTS[n] for n, angle in turned.items() if angle < NEEDED_TURN and n in axes]
    if small:
        return (
            f"the isolated {kind} trial moves {had}; move {' and '.join(small)} further to learn "
            "more"
        )
    return (
        f"the isolated {kind} trial moves {had}, enough: these stay as uncertain as their error "
        "bars say"
    )


def _finding(
    code: Code, cause: str, found: str, cure: str, leg: str = "", severity: Severity = Severity.INFO
) -> Finding:
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


def in_words(unseen: Sequence[str], done: str, turned: Turns) -> tuple[Finding, ...]:
    """One note a joint: what is not determined, what was done, what to record given what was
    (`turned`).

    Its error bar says the rest.
    """
    out = []
    for joint in dict.fromkeys(JOINT_PARAMETERS[JP_INDEX[name]].joint for name in unseen):
        of_joint = [name for name in unseen if JOINT_PARAMETERS[JP_INDEX[name]].joint == joint]
        kind = coordinates.JOINT_TABLE[coordinates.split_side(joint)[0]].power
        cause, found = (
            f"{joint} is not fully determined",
            f"{', '.join(of_joint)} not determined; {done}",
        )
        advice = _advice(joint, kind, turned.get(f"{kind}_{joint[-1]}", {}))
        out.append(_finding(Code.UNDETERMINED, cause, found, advice, joint[-1]))
    return tuple(out)


def worn_as_standing(problems: Sequence[trial_problem.MotionProblem]) -> bool:
    """Whether the markers of legs and pelvis sit in trials just as in the static trial: on this
    body, wherever joints are found. False where skin or cameras leave that open, and of points that
    are no markers.
    """
    floors = [motion.compute_rigid_floor(problem) for problem in problems if problem.noise is None]
    shown = [
        (floor, s)
        for floor in floors
        for s in linkage.LOWER_BODY
        if floor.select_observed(s).sum() >= rigid.FEWEST_MARKERS
    ]
    apart = [floor.rms(segment) or 0.0 for floor, segment in shown]
    return bool(apart) and len(floors) == len(problems) and max(apart) < PLACED_ANEW


def beyond_bounds(names: Sequence[str], *, same_body: bool = False) -> tuple[Finding, ...]:
    """Of joint parameters on their bounds, or beyond; notes where no leg moves by them.

    `same_body`: markers show that the static trial is of the body of the others.
    """
    legs = [name for name in names if name.split(".")[0].rpartition("_")[0] in linkage.LEG_JOINTS]
    many = (
        not same_body
        and len(legs) >= MANY_BEYOND
        and len({name.split(".")[0] for name in legs}) > 1
    )
    out = []
    for joint in dict.fromkeys(name.split(".")[0] for name in names):
        of_joint = [name for name in names if name.split(".")[0] == joint]
        leg = of_joint[0] in legs
        if not (leg and many):
            out.append(
                _finding(
                    Code.JOINT_AT_BOUND,
                    f"{joint} lies further from where the static trial has it than people do",
                    f"{listed(of_joint)} on the bound of how far it may move, or beyond",
                    "look at the landmarks of the static trial, and whether the trials are of this "
                    "person and joint",
                    joint[-1] if leg else "",
                    Severity.WARNING if leg else Severity.INFO,
                )
            )
    if many:
        found = (
            f"{len(legs)} joint parameters are on the bound of how far they may move, or beyond: "
            f"{listed(legs)}"
        )
        cause = "the static trial does not show the body of the moving trials"
        cure = "is it of another person, or of another day, with the markers in other places?"
        out.append(_finding(Code.OTHER_BODY, cause, found, cure, severity=Severity.ERROR))
    return tuple(out)


def arm_ambiguity(
    problems: Sequence[trial_problem.MotionProblem],
    coefficients: Sequence[Array],
    parameters: Parameters,
) -> Mapping[str, float]:
    """Side -> rad by which its arm is turned from where rigid fits with `parameters` begin, where
    that is too far.
    """
    out: dict[str, float] = {}
    arm = [row.name for row in coordinates.COORDINATE_TABLE.values() if row.group == "arm"]
    for problem, own in zip(problems, coefficients, strict=True):
        start = find_start_coefficients(problem.build_body(parameters), problem.data, problem.basis)
        apart = np.abs(np.angle(np.exp(1j * problem.basis.evaluate(own - start))))
        median = dict(
            zip(problem.chain.coordinates, np.median(apart, axis=0).tolist(), strict=True)
        )
        for side in linkage.SIDES:
            most = max(
                (median[name] for name in (f"{angle}_{side}" for angle in arm) if name in median),
                default=0.0,
            )
            if most > max(LARGEST_ARM_TURN, out.get(side, 0.0)):
                out[side] = most
    return out


def without_arms(free: Sequence[str], sides: Mapping[str, float]) -> tuple[str, ...]:
    """The joint parameters that are none of these arms."""
    joints = {f"{joint}_{side}" for joint in ("shoulder", "elbow") for side in sides}
    return tuple(name for name in free if name.split(".")[0] not in joints)


def ambiguous_arm_findings(sides: Mapping[str, float]) -> tuple[Finding, ...]:
    """A note an arm."""
    return tuple(
        _finding(
            Code.UNDETERMINED,
            f"shoulder and elbow of the {linkage.SIDE_WORDS[side]} arm stay nominal",
            f"their fit turned the arm by {np.rad2deg(turn):.0f} degrees, which no arm does: its "
            "markers do not tell "
            "how the upper arm is turned about its length",
            "nothing, where only legs matter; a second marker on the upper arm tells it",
        )
        for side, turn in sides.items()
    )
