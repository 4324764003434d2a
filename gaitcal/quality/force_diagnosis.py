"""Findings on the forces of a session: what explains that they disagree with the motion, or that
nothing does.

A fault is an error where it moves a torque of a leg by more than its error bar can hold (`HOLDS`,
RMS); below that it is a warning.

Measured by `python -m scripts.validation force_faults --seed 7`, 378 faults in 18 walks of ten
people, 3 synthetic: right cause first 303, in the set 10, another plate 3, wrong 7, nothing told
55; sizes found over true ones 1.00 (10 to 90 %: 0.86 to 1.10), 125 of 144 within 20 %; nothing told
of the clean walks. Found from, in 80 % of cases: clock 17 ms; place 64 mm; tilt 2, of one plate 3,
of markers 4 deg; yaw 6 deg; gain of all 11, vertical 6, horizontal 20 %, of one plate 18 to 60 %;
offset 20 N; free moment 2.3 times, its sign seldom; signs, axes, units, exchanged plates always or
nearly so. Taken for each other: gain and vertical gain; one plate and all; exchanged axes,
horizontal gain and yaw.

How far a fault of the forces moves the torques of the legs.

    d tau = -J_foot^T (w_foot - w'_foot),      w' the wrench of the ground without the fault

over the frames of the evidence, each plate on the foot that stands at that time.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.expected_residual import ExpectedResidual
from gaitcal.dynamics.inverse_dynamics import FEET, FORCES, Dynamics
from gaitcal.dynamics.measurement_errors import PlateErrors
from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.model.coordinates import LEG_COORDINATES, split_side
from gaitcal.quality.force_causes import ForceFault
from gaitcal.quality.force_choice import ForceFit, Named, Unexplained, choose, told_size
from gaitcal.quality.force_evidence import ForceEvidence
from gaitcal.quality.verdict import FORCES as FORCES_TOPIC

LEGS = [k for k, name in enumerate(FORCES) if split_side(name)[0] in LEG_COORDINATES]
HOLDS = 0.01  # Of body weight times height: what the error bars of leg torques hold with 95 %


@dataclass(frozen=True, kw_only=True)
class ForceDiagnosis:
    """What is wrong with the forces of a session."""

    findings: tuple[Finding, ...] = ()
    faulty: frozenset[str] = (
        frozenset()
    )  # Trials whose forces are at fault: they say nothing of masses
    possible: Mapping[str, PlateErrors] = field(default_factory=dict)
    """Trial -> by how much more its plates are uncertain."""


Told: TypeAlias = tuple[str, str]  # What is wrong, in a clause of its own, and the cure
Words: TypeAlias = Callable[[ForceFit, ForceEvidence], Told]
"""Of one cause, its directions those of the walk of a trial."""


def _of(fit: ForceFit) -> str:
    return f"plate {fit.cause.plates[0]}" if fit.cause.plates else "all plates"


def _are(fit: ForceFit) -> str:
    return f"{_of(fit)} {'is' if fit.cause.plates else 'are'}"


def _far(vector: Array, ways: Sequence[tuple[str, str]], text: str) -> str:
    """`31 mm too far forward and 12 mm too far to the right`, without what is small beside the
    other; `vector` in m.
    """
    most = 0.25e3 * np.abs(vector).max()
    return " and ".join(
        text.format(mm=abs(mm), way=names[0] if mm > 0 else names[1])
        for mm, names in zip(1e3 * vector, ways, strict=True)
        if abs(mm) > most
    )


def _clock(fit: ForceFit, trial: ForceEvidence) -> Told:
    ms = 1e3 * float(fit.x[0])
    return (
        f"the forces come {abs(ms):.0f} ms {'late' if ms > 0 else 'early'}",
        f"make the times of the forces {abs(ms):.0f} ms {'smaller' if ms > 0 else 'larger'}, and "
        "look for the delay "
        "between cameras and plates",
    )


def _place(fit: ForceFit, trial: ForceEvidence) -> Told:
    along_walk = (trial.room[:, [0, 2]] @ fit.x)[[0, 2]]
    way = _far(
        along_walk,
        (("forward", "back"), ("to the right", "to the left")),
        "{mm:.0f} mm too far {way}",
    )
    return (
        f"{_of(fit)} {'lies' if fit.cause.plates else 'lie'} {way} (seen along '{trial.name}')",
        "correct the corners of the plates (or the points of application), or the origin of the "
        "markers",
    )


def _yaw(fit: ForceFit, trial: ForceEvidence) -> Told:
    degrees = float(np.rad2deg((fit.x[0] + np.pi) % (2 * np.pi) - np.pi))
    return (
        f"{_are(fit)} turned by {abs(degrees):.0f} deg about the vertical "
        f"({'anticlockwise' if degrees > 0 else 'clockwise'}, seen from above)",
        "correct the corners of the plates and their order, or the axes of the forces",
    )


def _tilt(fit: ForceFit, trial: ForceEvidence) -> Told:
    degrees, level = (
        np.rad2deg(np.linalg.norm(fit.x)),
        "calibrate the cameras again with the wand level on the plates",
    )
    if fit.cause.kind is ForceFault.MARKERS_TILTED:
        return (
            f"the markers are tilted by {degrees:.1f} deg against the vertical and the plates",
            level,
        )
    message = f"{_are(fit)} tilted by {degrees:.1f} deg against the floor of the markers"
    return message, f"correct the corners of the plates, or {level}"


def _factor(thing: str) -> Words:
    def words(fit: ForceFit, trial: ForceEvidence) -> Told:
        factor, cure = (
            float(told_size(fit)[0]),
            "correct the gain (calibration matrix, amplifier) of the plate",
        )
        percent = 100.0 * (factor - 1.0)
        size = f"{factor:.3g} times what it should be"
        if abs(percent) < 80.0:
            size = f"{abs(percent):.0f} % too {'large' if percent > 0 else 'small'}"
        words = f"the {thing} of {_of(fit)} is {size}"
        if (
            fit.cause.kind is ForceFault.GAIN and not fit.cause.plates
        ):  # it cannot be told from the mass of the person
            return f"{words} (or mass_kg is wrong by the same share)", f"correct mass_kg, or {cure}"
        return words, cure

    return words


def _free_moment(fit: ForceFit, trial: ForceEvidence) -> Told:
    needed = 1.0 + float(fit.x[0])
    size = "has the wrong sign"
    if abs(needed) < 0.05:
        size = "is far too large, or not one of this trial"
    elif needed >= -0.3:
        size = f"is {1.0 / needed:.2g} times what it should be"
    cure = "check unit and sign of the moment about the vertical, and about which point it is given"
    return f"the free moment of {_of(fit)} {size}", cure


def _offset(fit: ForceFit, trial: ForceEvidence) -> Told:
    newtons = float(fit.x[0])
    many = _of(fit) if fit.cause.plates else "each of all plates"
    size = f"{abs(newtons):.0f} N too {'large' if newtons > 0 else 'small'} throughout"
    return f"the vertical force of {many} is {size}", "take away what the empty plate reads"


def _trunk(fit: ForceFit, trial: ForceEvidence) -> Told:
    ways = (("forward of", "behind"), ("to the right of", "to the left of"))
    upright = (
        "markers on the trunk show it upright"
        if trial.trunk_seen
        else "markers do not determine how it turns"
    )
    return (
        f"the trunk's weight lies {_far(fit.x, ways, '{mm:.0f} mm {way}')} where the model has it "
        f"({upright})",
        "a static trial that stands upright, and markers on the trunk (C7, sternum) in all trials",
    )


def _plain(cause: str, cure: str = "turn the sign of that column of the forces") -> Words:
    """`{of}` in the cause: the plates; `{unit}` in either; `{one}` and `{other}`: two plates."""

    def words(fit: ForceFit, trial: ForceEvidence) -> Told:
        one, other = fit.cause.plates if len(fit.cause.plates) == 2 else ("", "")
        return cause.format(of=_of(fit), unit=fit.cause.unit, one=one, other=other), cure

    return words


WORDS: Mapping[ForceFault, tuple[Code, Words]] = {
    ForceFault.CLOCK: (Code.CLOCKS_DIFFER, _clock),
    ForceFault.PLACE: (Code.PLATES_ELSEWHERE, _place),
    ForceFault.YAW: (Code.PLATE_AXES, _yaw),
    ForceFault.TILT: (Code.TILTED, _tilt),
    ForceFault.MARKERS_TILTED: (Code.TILTED, _tilt),
    ForceFault.GAIN: (Code.FORCE_GAIN, _factor("force")),
    ForceFault.VERTICAL_GAIN: (Code.FORCE_GAIN, _factor("vertical force")),
    ForceFault.HORIZONTAL_GAIN: (Code.FORCE_GAIN, _factor("horizontal force")),
    ForceFault.FORE_AFT_GAIN: (Code.FORCE_GAIN, _factor("fore-aft force")),
    ForceFault.SIDEWAYS_GAIN: (Code.FORCE_GAIN, _factor("sideways force")),
    ForceFault.FREE_MOMENT: (Code.FREE_MOMENT, _free_moment),
    ForceFault.OFFSET: (Code.PLATE_OFFSET, _offset),
    ForceFault.SIGN_FORE_AFT: (
        Code.FORCE_SIGN,
        _plain("the fore-aft force of {of} has the wrong sign"),
    ),
    ForceFault.SIGN_SIDEWAYS: (
        Code.FORCE_SIGN,
        _plain("the sideways force of {of} has the wrong sign"),
    ),
    ForceFault.SIGN_HORIZONTAL: (
        Code.FORCE_SIGN,
        _plain("both horizontal forces of {of} have the wrong sign"),
    ),
    ForceFault.SIGN_VERTICAL: (
        Code.FORCE_SIGN,
        _plain("the vertical force of {of} alone has the wrong sign"),
    ),
    ForceFault.AXES: (
        Code.PLATE_AXES,
        _plain(
            "the horizontal axes of {of} are exchanged",
            "exchange the columns (channels) of the horizontal forces",
        ),
    ),
    ForceFault.FORCE_UNIT: (
        Code.FORCE_UNIT,
        _plain("the forces are in {unit}, not in N", "give forces in N"),
    ),
    ForceFault.MOMENT_UNIT: (
        Code.FORCE_UNIT,
        _plain("the moments of the plates are in N·mm, not in N·m", "divide the moments by 1000"),
    ),
    ForceFault.CENTRE_UNIT: (
        Code.FORCE_UNIT,
        _plain("the centre of pressure is in {unit}, not in m", "give points of application in m"),
    ),
    ForceFault.EXCHANGED: (
        Code.PLATES_EXCHANGED,
        _plain(
            "plates {one} and {other} have changed places",
            "exchange their corners, or their channels (columns of forces)",
        ),
    ),
    ForceFault.TRUNK: (Code.TRUNK_WEIGHT, _trunk),
}
"""What a cause is told as."""


def torque_change(trials: Sequence[ForceEvidence], fit: ForceFit) -> tuple[str, float]:
    """The torque that the fault moves most, and by how much: RMS, as a share of body weight times
    height.
    """
    worst, most = "", 0.0
    for trial in trials:
        change = trial.wrenches - fit.cause.undo(trial, fit.x).wrenches
        on_feet = [
            (change * (trial.feet == foot)[:, :, None]).sum(axis=0) for foot in range(len(FEET))
        ]
        dynamics = Dynamics(trial.parameters)
        moved = dynamics.compute_ground_forces(
            dynamics.place(trial.q), np.stack(on_feet, axis=1)[..., None]
        )[:, LEGS, 0]
        size = np.sqrt((moved**2).mean(axis=0)) / trial.bwh
        if size.max() > most:
            worst, most = FORCES[LEGS[int(size.argmax())]], float(size.max())
    return worst, most


def force_findings(trials: Sequence[ForceEvidence]) -> ForceDiagnosis:
    """What explains that motion and forces of these gait trials of one person, over the same
    plates, disagree.
    """
    named, unexplained, possible = choose(trials)
    findings = [_finding(one) for one in named]
    findings += [_unexplained(one) for one in unexplained]
    faulty = {
        t.name
        for one in named
        if one.fits[0].cause.kind is not ForceFault.TRUNK
        for t in one.trials
    }
    return ForceDiagnosis(
        findings=tuple(sorted(findings, key=lambda f: -f.weight)),
        faulty=frozenset(faulty | {one.trial.name for one in unexplained}),
        possible=possible,
    )


def _finding(named: Named) -> Finding:
    """One finding; its rivals in its evidence."""
    trial, (best, *rivals) = named.trials[0], named.fits
    code, describe = WORDS[best.cause.kind]
    cause, cure = describe(best, trial)
    torque, change = torque_change(named.trials, best)
    found = (
        f"without that {100 * best.explained:.0f} % of the disagreement between motion and forces "
        "is gone"
    )
    if torque:
        found += f"; it moves {torque} by {100 * change:.1f} % of body weight times height (RMS)"
    if rivals:
        others = [
            f"{WORDS[fit.cause.kind][1](fit, trial)[0]} ({100 * fit.explained:.0f} %)"
            for fit in rivals
        ]
        found += f"; nearly as well it is explained by: {'; or '.join(others)}"
    if several := len(named.trials) > 1:
        found = f"in trials {', '.join(t.name for t in named.trials)} alike; {found}"
    weight = change / HOLDS
    return Finding(
        severity=Severity.ERROR if weight > 1.0 else Severity.WARNING,
        topic=FORCES_TOPIC,
        where=STUDY if several else trial.name,
        cause=cause,
        found=found,
        cure=cure,
        weight=weight,
        code=code,
    )


def beyond_expected(walk: str, residual: ExpectedResidual, trunk_seen: bool) -> Iterator[Finding]:
    """A pelvis residual that is larger than its errors explain, after the fit."""
    if residual.within:
        return
    force, moment = residual.force, residual.moment
    found = (
        f"the pelvis residual is {force.rms:.0f} N and {moment.rms:.0f} N·m RMS, where its errors "
        "let expect "
    )
    found += (
        f"{force.expected:.0f} N and {moment.expected:.0f} N·m, and 1 walk in 1000 has more than "
    )
    found += f"{force.limit:.0f} N or {moment.limit:.0f} N·m"
    yield _disagreement(walk, trunk_seen, found, residual.share)


def _unexplained(one: Unexplained) -> Finding:
    size = one.size**0.5
    found = f"the disagreement is {size:.1f} times the usual one"
    return _disagreement(one.trial.name, one.trial.trunk_seen, found, size / 2.0)


def _disagreement(walk: str, trunk_seen: bool, found: str, weight: float) -> Finding:
    cause = (
        "motion and forces disagree at the pelvis, and no single fault of the forces explains it"
    )
    cure = (
        "look at the markers of pelvis and trunk, whether each foot was wholly on a plate, and "
        "mass_kg"
    )
    if not trunk_seen:
        cause = (
            "motion and forces disagree at the pelvis, and markers do not determine how the trunk "
            "turns"
        )
        cure = "markers on the trunk (C7, sternum); else look at plates and mass_kg"
    return Finding(
        severity=Severity.WARNING,
        topic=FORCES_TOPIC,
        where=walk,
        cause=cause,
        found=found,
        cure=cure,
        weight=weight,
        code=Code.UNEXPLAINED_RESIDUAL,
    )
