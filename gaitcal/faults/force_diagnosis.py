"""Findings on the forces of a session: what explains that they disagree with the motion, or that nothing does.

A fault is an error where it moves a torque of a leg by more than its error bar can hold (`HOLDS`, RMS); below that it
is a warning.

Measured by `python -m scripts.validation force_faults --seed 7`, 378 faults in 18 walks of ten people, 3 synthetic:
right cause first 303, in the set 10, another plate 3, wrong 7, nothing told 55; sizes found over true ones 1.00 (10 to
90 %: 0.86 to 1.10), 125 of 144 within 20 %; nothing told of the clean walks. Found from, in 80 % of cases: clock 17 ms;
place 64 mm; tilt 2, of one plate 3, of markers 4 deg; yaw 6 deg; gain of all 11, vertical 6, horizontal 20 %, of one
plate 18 to 60 %; offset 20 N; free moment 2.3 times, its sign seldom; signs, axes, units, exchanged plates always or
nearly so. Taken for each other: gain and vertical gain; one plate and all; exchanged axes, horizontal gain and yaw.

Causes in words: what is wrong and how large it is, and what to do about it.

How far a fault of the forces moves the torques of the legs.

    d tau = -J_foot^T (w_foot - w'_foot),      w' the wrench of the ground without the fault

over the frames of the evidence, each plate on the foot that stands at that time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.dynamics.expected_residual import ExpectedResidual
from gaitcal.dynamics.inverse_dynamics import FEET, FORCES, Dynamics
from gaitcal.faults.force_causes import Kind
from gaitcal.faults.force_choice import ForceFit, Named, Unexplained, choose, told_size
from gaitcal.faults.force_evidence import ForceEvidence
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.model.coordinates import LEG_COORDINATES, split_side


class Told(NamedTuple):
    """A cause in words."""

    cause: str
    """What is wrong, in a clause of its own."""
    cure: str


def told(fit: ForceFit, trial: ForceEvidence) -> Told:
    """One cause, its directions those of the walk of `trial`."""
    return WORDS[fit.cause.kind](fit, trial)


def _of(fit: ForceFit) -> str:
    names = fit.cause.plates
    return f"plate {names[0]}" if names else "all plates"


def _subject(fit: ForceFit, thing: str) -> str:
    return f"{thing} of {_of(fit)}"


def _along_walk(fit: ForceFit, trial: ForceEvidence) -> Array:
    """(2,) forward and to the right, of a vector in the room."""
    out: Array = (trial.room[:, [0, 2]] @ fit.x)[[0, 2]]
    return out


def _way(vector: Array) -> str:
    """`31 mm too far forward and 12 mm too far to the right`, without what is small beside the other."""
    words = []
    for value, names in zip(1e3 * vector, (("forward", "back"), ("to the right", "to the left")), strict=True):
        if abs(value) > 0.25e3 * np.abs(vector).max():
            words.append(f"{abs(value):.0f} mm too far {names[0] if value > 0 else names[1]}")
    return " and ".join(words)


def _clock(fit: ForceFit, trial: ForceEvidence) -> Told:
    ms = 1e3 * float(fit.x[0])
    return Told(
        f"the forces come {abs(ms):.0f} ms {'late' if ms > 0 else 'early'}",
        f"make the times of the forces {abs(ms):.0f} ms {'smaller' if ms > 0 else 'larger'}, and look for the delay "
        "between cameras and plates",
    )


def _place(fit: ForceFit, trial: ForceEvidence) -> Told:
    verb = "lie" if not fit.cause.plates else "lies"
    return Told(
        f"{_of(fit)} {verb} {_way(_along_walk(fit, trial))} (seen along '{trial.name}')",
        "correct the corners of the plates (or the points of application), or the origin of the markers",
    )


def _yaw(fit: ForceFit, trial: ForceEvidence) -> Told:
    degrees = float(np.rad2deg((fit.x[0] + np.pi) % (2 * np.pi) - np.pi))
    verb = "are" if not fit.cause.plates else "is"
    return Told(
        f"{_of(fit)} {verb} turned by {abs(degrees):.0f} deg about the vertical "
        f"({'anticlockwise' if degrees > 0 else 'clockwise'}, seen from above)",
        "correct the corners of the plates and their order, or the axes of the forces",
    )


def _tilt(fit: ForceFit, trial: ForceEvidence) -> Told:
    degrees = float(np.rad2deg(np.linalg.norm(fit.x)))
    verb = "are" if not fit.cause.plates else "is"
    return Told(
        f"{_of(fit)} {verb} tilted by {degrees:.1f} deg against the floor of the markers",
        "correct the corners of the plates, or calibrate the cameras again with the wand level on the plates",
    )


def _markers_tilted(fit: ForceFit, trial: ForceEvidence) -> Told:
    degrees = float(np.rad2deg(np.linalg.norm(fit.x)))
    return Told(
        f"the markers are tilted by {degrees:.1f} deg against the vertical and the plates",
        "calibrate the cameras again with the wand level on the plates",
    )


def _factor(thing: str, cure: str) -> Callable[[ForceFit, ForceEvidence], Told]:
    def words(fit: ForceFit, trial: ForceEvidence) -> Told:
        factor = float(told_size(fit)[0])
        percent = 100.0 * (factor - 1.0)
        if abs(percent) < 80.0:
            size = f"is {abs(percent):.0f} % too {'large' if percent > 0 else 'small'}"
        else:
            size = f"is {factor:.3g} times what it should be"
        or_mass = " (or mass_kg is wrong by the same share)" if _is_mass(fit) else ""
        return Told(f"{_subject(fit, thing)} {size}{or_mass}", f"correct mass_kg, or {cure}" if or_mass else cure)

    return words


def _is_mass(fit: ForceFit) -> bool:
    """The gain of all plates cannot be told from the mass of the person."""
    return fit.cause.kind is Kind.GAIN and not fit.cause.plates


def _free_moment(fit: ForceFit, trial: ForceEvidence) -> Told:
    needed = 1.0 + float(fit.x[0])
    cure = "check unit and sign of the moment about the vertical, and about which point it is given"
    if needed < -0.3:
        return Told(f"the {_subject(fit, 'free moment')} has the wrong sign", cure)
    if abs(needed) < 0.05:
        return Told(f"the {_subject(fit, 'free moment')} is far too large, or not one of this trial", cure)
    size = 1.0 / needed
    return Told(f"the {_subject(fit, 'free moment')} is {size:.2g} times what it should be", cure)


def _offset(fit: ForceFit, trial: ForceEvidence) -> Told:
    newtons = float(fit.x[0])
    many = "each of all plates" if not fit.cause.plates else _of(fit)
    return Told(
        f"the vertical force of {many} is {abs(newtons):.0f} N too {'large' if newtons > 0 else 'small'} throughout",
        "take away what the empty plate reads",
    )


def _plain(cause: str, cure: str) -> Callable[[ForceFit, ForceEvidence], Told]:
    """`{of}` in the cause: the plates."""
    return lambda fit, trial: Told(cause.format(of=_of(fit), unit=fit.cause.unit), cure.format(unit=fit.cause.unit))


def _exchanged(fit: ForceFit, trial: ForceEvidence) -> Told:
    one, other = fit.cause.plates
    return Told(
        f"plates {one} and {other} have changed places", "exchange their corners, or their channels (columns of forces)"
    )


def _trunk(fit: ForceFit, trial: ForceEvidence) -> Told:
    forward, right = 1e3 * fit.x
    words = []
    for value, names in ((forward, ("forward of", "behind")), (right, ("to the right of", "to the left of"))):
        if abs(value) > 0.25 * max(abs(forward), abs(right)):
            words.append(f"{abs(value):.0f} mm {names[0] if value > 0 else names[1]}")
    seen = "markers on the trunk show it upright" if trial.trunk_seen else "markers do not determine how it turns"
    return Told(
        f"the trunk's weight lies {' and '.join(words)} where the model has it ({seen})",
        "a static trial that stands upright, and markers on the trunk (C7, sternum) in all trials",
    )


SIGN = "turn the sign of that column of the forces"
CHANNELS = "correct the gain (calibration matrix, amplifier) of the plate"
WORDS: Mapping[Kind, Callable[[ForceFit, ForceEvidence], Told]] = {
    Kind.CLOCK: _clock,
    Kind.PLACE: _place,
    Kind.YAW: _yaw,
    Kind.TILT: _tilt,
    Kind.MARKERS_TILTED: _markers_tilted,
    Kind.GAIN: _factor("the force", CHANNELS),
    Kind.VERTICAL_GAIN: _factor("the vertical force", CHANNELS),
    Kind.HORIZONTAL_GAIN: _factor("the horizontal force", CHANNELS),
    Kind.FORE_AFT_GAIN: _factor("the fore-aft force", CHANNELS),
    Kind.SIDEWAYS_GAIN: _factor("the sideways force", CHANNELS),
    Kind.FREE_MOMENT: _free_moment,
    Kind.OFFSET: _offset,
    Kind.SIGN_FORE_AFT: _plain("the fore-aft force of {of} has the wrong sign", SIGN),
    Kind.SIGN_SIDEWAYS: _plain("the sideways force of {of} has the wrong sign", SIGN),
    Kind.SIGN_HORIZONTAL: _plain("both horizontal forces of {of} have the wrong sign", SIGN),
    Kind.SIGN_VERTICAL: _plain("the vertical force of {of} alone has the wrong sign", SIGN),
    Kind.AXES: _plain(
        "the horizontal axes of {of} are exchanged", "exchange the columns (channels) of the horizontal forces"
    ),
    Kind.FORCE_UNIT: _plain("the forces are in {unit}, not in N", "give forces in N"),
    Kind.MOMENT_UNIT: _plain("the moments of the plates are in N·mm, not in N·m", "divide the moments by 1000"),
    Kind.CENTRE_UNIT: _plain("the centre of pressure is in {unit}, not in m", "give points of application in m"),
    Kind.EXCHANGED: _exchanged,
    Kind.TRUNK: _trunk,
}
CODES: Mapping[Kind, Code] = {
    Kind.CLOCK: Code.CLOCKS_DIFFER,
    Kind.PLACE: Code.PLATES_ELSEWHERE,
    Kind.YAW: Code.PLATE_AXES,
    Kind.AXES: Code.PLATE_AXES,
    **dict.fromkeys((Kind.TILT, Kind.MARKERS_TILTED), Code.TILTED),
    **dict.fromkeys((Kind.GAIN, Kind.VERTICAL_GAIN, Kind.HORIZONTAL_GAIN), Code.FORCE_GAIN),
    **dict.fromkeys((Kind.FORE_AFT_GAIN, Kind.SIDEWAYS_GAIN), Code.FORCE_GAIN),
    Kind.FREE_MOMENT: Code.FREE_MOMENT,
    Kind.OFFSET: Code.PLATE_OFFSET,
    **dict.fromkeys((Kind.SIGN_FORE_AFT, Kind.SIGN_SIDEWAYS), Code.FORCE_SIGN),
    **dict.fromkeys((Kind.SIGN_HORIZONTAL, Kind.SIGN_VERTICAL), Code.FORCE_SIGN),
    **dict.fromkeys((Kind.FORCE_UNIT, Kind.MOMENT_UNIT, Kind.CENTRE_UNIT), Code.FORCE_UNIT),
    Kind.EXCHANGED: Code.PLATES_EXCHANGED,
    Kind.TRUNK: Code.TRUNK_WEIGHT,
}


LEGS = [k for k, name in enumerate(FORCES) if split_side(name)[0] in LEG_COORDINATES]
HOLDS = 0.01
"""Of body weight times height: what the error bars of leg torques hold with 95 %."""


def torque_change(trials: Sequence[ForceEvidence], fit: ForceFit) -> tuple[str, float]:
    """The torque that the fault moves most, and by how much: RMS, as a share of body weight times height."""
    worst, most = "", 0.0
    for trial in trials:
        change = trial.wrenches - fit.cause.undo(trial, fit.x).wrenches
        size = np.sqrt((_of_feet(trial, change) ** 2).mean(axis=0)) / trial.bwh
        if size.max() > most:
            worst, most = FORCES[LEGS[int(size.argmax())]], float(size.max())
    return worst, most


def _of_feet(trial: ForceEvidence, change: Array) -> Array:
    """(k, torques of the legs) N·m, from changes of plates' wrenches (plates, k, 6)."""
    on_feet = np.stack([(change * (trial.feet == foot)[:, :, None]).sum(axis=0) for foot in range(len(FEET))], axis=1)
    moved: Array = Dynamics(trial.parameters).of_ground(trial.q, on_feet[..., None])[:, LEGS, 0]
    return moved


TOPIC = "forces"


@dataclass(frozen=True, kw_only=True)
class ForceDiagnosis:
    """What is wrong with the forces of a session."""

    findings: tuple[Finding, ...] = ()
    faulty: frozenset[str] = frozenset()
    """Trials whose forces are at fault: they say nothing of masses."""


def force_findings(trials: Sequence[ForceEvidence]) -> ForceDiagnosis:
    """What explains that motion and forces of these gait trials of one person, over the same plates, disagree."""
    named, unexplained = choose(trials)
    findings = [finding for one in named for finding in _findings(one)]
    findings += [_unexplained(one) for one in unexplained]
    faulty = {t.name for one in named if one.fits[0].cause.kind is not Kind.TRUNK for t in one.trials}
    return ForceDiagnosis(
        findings=tuple(sorted(findings, key=lambda f: -f.weight)),
        faulty=frozenset(faulty | {one.trial.name for one in unexplained}),
    )


def _findings(named: Named) -> list[Finding]:
    """One finding; its rivals in its evidence."""
    best, *rivals = named.fits
    first = told(best, named.trials[0])
    torque, change = torque_change(named.trials, best)
    found = f"without that {100 * best.explained:.0f} % of the disagreement between motion and forces is gone"
    if torque:
        found += f"; it moves {torque} by {100 * change:.1f} % of body weight times height (RMS)"
    if rivals:
        words = [f"{told(fit, named.trials[0]).cause} ({100 * fit.explained:.0f} %)" for fit in rivals]
        found += f"; nearly as well it is explained by: {'; or '.join(words)}"
    where = named.trials[0].name
    if len(named.trials) > 1:
        where = STUDY
        found = f"in trials {', '.join(t.name for t in named.trials)} alike; {found}"
    weight = change / HOLDS
    return [
        Finding(
            severity=Severity.ERROR if weight > 1.0 else Severity.WARNING,
            topic=TOPIC,
            where=where,
            cause=first.cause,
            found=found,
            cure=first.cure,
            weight=weight,
            code=CODES[best.cause.kind],
        )
    ]


def beyond_expected(walk: str, residual: ExpectedResidual, trunk_seen: bool) -> Iterator[Finding]:
    """A pelvis residual that is larger than its errors explain, after the fit."""
    if residual.within:
        return
    force, moment = residual.force, residual.moment
    found = f"the pelvis residual is {force.rms:.0f} N and {moment.rms:.0f} N·m RMS, where its errors let expect "
    found += f"{force.expected:.0f} N and {moment.expected:.0f} N·m, and 1 walk in 1000 has more than "
    found += f"{force.limit:.0f} N or {moment.limit:.0f} N·m"
    yield _disagreement(walk, trunk_seen, found, residual.share)


def _unexplained(one: Unexplained) -> Finding:
    size = one.size**0.5
    found = f"the disagreement is {size:.1f} times the usual one"
    return _disagreement(one.trial.name, one.trial.trunk_seen, found, size / 2.0)


def _disagreement(walk: str, trunk_seen: bool, found: str, weight: float) -> Finding:
    cause = "motion and forces disagree at the pelvis, and no single fault of the forces explains it"
    cure = "look at the markers of pelvis and trunk, whether each foot was wholly on a plate, and mass_kg"
    if not trunk_seen:
        cause = "motion and forces disagree at the pelvis, and markers do not determine how the trunk turns"
        cure = "markers on the trunk (C7, sternum); else look at plates and mass_kg"
    return Finding(
        severity=Severity.WARNING,
        topic=TOPIC,
        where=walk,
        cause=cause,
        found=found,
        cure=cure,
        weight=weight,
        code=Code.UNEXPLAINED_RESIDUAL,
    )
