"""Findings on the forces of a session: the fault that explains a pelvis residual, or none.

A fault is an error if it changes a torque of a leg by more than its error bar covers
(`TORQUE_ERROR_BWH`, RMS); otherwise it is a warning. The change of the leg torques is

    d tau = -J_foot^T (w_foot - w'_foot),      w' the ground wrench without the fault

over the frames of the evidence, each plate on the foot that is in contact at that time.

Measured by `python -m scripts.validation force_faults --seed 7`, 378 faults in 18 walks of ten
people, 3 synthetic: right cause first 303, among the rivals 10, another plate 3, wrong 7, nothing
reported 55; sizes found over true ones 1.00 (10 to 90 %: 0.86 to 1.10), 125 of 144 within 20 %;
nothing reported of the clean walks. Found from, in 80 % of cases: time offset 17 ms; position
64 mm; tilt 2, of one plate 3, of markers 4 deg; yaw 6 deg; gain of all 11, vertical 6, horizontal
20 %, of one plate 18 to 60 %; offset 20 N; free moment 2.3 times, its sign rarely; signs, axes,
units, swapped plates nearly always. Not separated from each other: gain and vertical gain; one
plate and all; swapped axes, horizontal gain and yaw.
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
from gaitcal.quality.force_choice import (
    ForceFit,
    NamedFault,
    UnexplainedTrial,
    choose,
    get_reported_size,
)
from gaitcal.quality.force_evidence import ForceEvidence
from gaitcal.quality.verdict import FORCES as FORCES_TOPIC

LEGS = [k for k, name in enumerate(FORCES) if split_side(name)[0] in LEG_COORDINATES]
# Of body weight times height: error of leg torques that their 95 % error bars cover
TORQUE_ERROR_BWH = 0.01


@dataclass(frozen=True, kw_only=True)
class ForceDiagnosis:
    """Faults of the forces of a session.

    Attributes
    ----------
    findings
        The worst first.
    faulty
        Names of trials with faulty forces; they cannot be used to fit masses.
    possible
        Trial -> additional uncertainty of its plates.
    """

    findings: tuple[Finding, ...] = ()
    faulty: frozenset[str] = frozenset()
    possible: Mapping[str, PlateErrors] = field(default_factory=dict)


CauseAndRemedy: TypeAlias = tuple[str, str]
Describer: TypeAlias = Callable[[ForceFit, ForceEvidence], CauseAndRemedy]
"""Describes one cause; its directions are relative to the walk of a trial."""


def _name_plates(fit: ForceFit) -> str:
    """Name the plate of a cause, or all plates."""
    return f"plate {fit.cause.plates[0]}" if fit.cause.plates else "all plates"


def _name_plates_and_verb(fit: ForceFit) -> str:
    """Name the plate of a cause and `is`, or all plates and `are`."""
    return f"{_name_plates(fit)} {'is' if fit.cause.plates else 'are'}"


def _format_offset(vector: Array, directions: Sequence[tuple[str, str]], text: str) -> str:
    """Format an offset (m): `31 mm too far forward and 12 mm too far to the right`.

    Components below a quarter of the largest are left out.
    """
    most = 0.25e3 * np.abs(vector).max()
    return " and ".join(
        text.format(mm=abs(mm), direction=names[0] if mm > 0 else names[1])
        for mm, names in zip(1e3 * vector, directions, strict=True)
        if abs(mm) > most
    )


def _describe_time_offset(fit: ForceFit, trial: ForceEvidence) -> CauseAndRemedy:
    """Describe a time offset of the forces."""
    ms = 1e3 * float(fit.x[0])
    return (
        f"the forces are {abs(ms):.0f} ms {'late' if ms > 0 else 'early'}",
        f"{'subtract' if ms > 0 else 'add'} {abs(ms):.0f} ms {'from' if ms > 0 else 'to'} the "
        "times of the forces, and check the delay between cameras and plates",
    )


def _describe_position(fit: ForceFit, trial: ForceEvidence) -> CauseAndRemedy:
    """Describe a displacement of plates, along the walk of a trial."""
    along_walk = (trial.room[:, [0, 2]] @ fit.x)[[0, 2]]
    offset = _format_offset(
        along_walk,
        (("forward", "back"), ("to the right", "to the left")),
        "{mm:.0f} mm too far {direction}",
    )
    return (
        f"{_name_plates_and_verb(fit)} {offset} (in the direction of '{trial.name}')",
        "correct the corners of the plates (or the points of application), or the origin of the "
        "markers",
    )


def _describe_yaw(fit: ForceFit, trial: ForceEvidence) -> CauseAndRemedy:
    """Describe a rotation of plates about the vertical."""
    degrees = float(np.rad2deg((fit.x[0] + np.pi) % (2 * np.pi) - np.pi))
    return (
        f"{_name_plates_and_verb(fit)} rotated by {abs(degrees):.0f} deg about the vertical "
        f"({'anticlockwise' if degrees > 0 else 'clockwise'}, viewed from above)",
        "correct the corners of the plates and their order, or the axes of the forces",
    )


def _describe_tilt(fit: ForceFit, trial: ForceEvidence) -> CauseAndRemedy:
    """Describe a tilt of plates or markers."""
    degrees = np.rad2deg(np.linalg.norm(fit.x))
    level = "calibrate the cameras again with the wand level on the plates"
    if fit.cause.kind is ForceFault.MARKERS_TILTED:
        return (
            f"the markers are tilted by {degrees:.1f} deg relative to the vertical and the plates",
            level,
        )
    plates = _name_plates_and_verb(fit)
    message = f"{plates} tilted by {degrees:.1f} deg relative to the floor of the markers"
    return message, f"correct the corners of the plates, or {level}"


def _describe_factor(component: str) -> Describer:
    """Return a function that describes a wrong factor of a force component."""

    def describe(fit: ForceFit, trial: ForceEvidence) -> CauseAndRemedy:
        factor = float(get_reported_size(fit)[0])
        cure = "correct the gain (calibration matrix, amplifier) of the plate"
        percent = 100.0 * (factor - 1.0)
        size = f"{factor:.3g} times the correct value"
        if abs(percent) < 80.0:
            size = f"{abs(percent):.0f} % too {'large' if percent > 0 else 'small'}"
        cause = f"the {component} of {_name_plates(fit)} is {size}"
        # a common gain has the same effect as a wrong body mass
        if fit.cause.kind is ForceFault.GAIN and not fit.cause.plates:
            return (
                f"{cause} (or mass_kg is wrong by the same factor)",
                f"correct mass_kg, or {cure}",
            )
        return cause, cure

    return describe


def _describe_free_moment(fit: ForceFit, trial: ForceEvidence) -> CauseAndRemedy:
    """Describe a wrong free moment."""
    needed = 1.0 + float(fit.x[0])
    size = "has the wrong sign"
    if abs(needed) < 0.05:
        size = "is far too large, or belongs to another trial"
    elif needed >= -0.3:
        size = f"has {1.0 / needed:.2g} times the right size"
    cure = "check unit, sign and reference point of the moment about the vertical"
    return f"the free moment of {_name_plates(fit)} {size}", cure


def _describe_offset(fit: ForceFit, trial: ForceEvidence) -> CauseAndRemedy:
    """Describe a constant offset of the vertical force."""
    newtons = float(fit.x[0])
    many = _name_plates(fit) if fit.cause.plates else "each of all plates"
    size = f"{abs(newtons):.0f} N too {'large' if newtons > 0 else 'small'} throughout"
    return f"the vertical force of {many} is {size}", "subtract the reading of the empty plate"


def _describe_trunk(fit: ForceFit, trial: ForceEvidence) -> CauseAndRemedy:
    """Describe a displacement of the trunk's mass centre."""
    directions = (("forward of", "behind"), ("to the right of", "to the left of"))
    upright = (
        "markers on the trunk show it upright"
        if trial.trunk_observed
        else "markers do not determine its rotation"
    )
    offset = _format_offset(fit.x, directions, "{mm:.0f} mm {direction}")
    return (
        f"the trunk's mass centre is {offset} that of the model ({upright})",
        "record an upright static trial, and use markers on the trunk (C7, sternum) in all trials",
    )


def _describe_by_template(
    cause: str, cure: str = "change the sign of that column of the forces"
) -> Describer:
    """Return a function that fills a template.

    `{plates}`: plate or all plates; `{unit}`: unit of the file; `{one}` and `{other}`: two plates.
    """

    def describe(fit: ForceFit, trial: ForceEvidence) -> CauseAndRemedy:
        one, other = fit.cause.plates if len(fit.cause.plates) == 2 else ("", "")
        plates, unit = _name_plates(fit), fit.cause.unit
        return cause.format(plates=plates, unit=unit, one=one, other=other), cure

    return describe


DESCRIPTIONS: Mapping[ForceFault, tuple[Code, Describer]] = {
    ForceFault.CLOCK: (Code.CLOCKS_DIFFER, _describe_time_offset),
    ForceFault.PLACE: (Code.PLATES_ELSEWHERE, _describe_position),
    ForceFault.YAW: (Code.PLATE_AXES, _describe_yaw),
    ForceFault.TILT: (Code.TILTED, _describe_tilt),
    ForceFault.MARKERS_TILTED: (Code.TILTED, _describe_tilt),
    ForceFault.GAIN: (Code.FORCE_GAIN, _describe_factor("force")),
    ForceFault.VERTICAL_GAIN: (Code.FORCE_GAIN, _describe_factor("vertical force")),
    ForceFault.HORIZONTAL_GAIN: (Code.FORCE_GAIN, _describe_factor("horizontal force")),
    ForceFault.FORE_AFT_GAIN: (Code.FORCE_GAIN, _describe_factor("fore-aft force")),
    ForceFault.SIDEWAYS_GAIN: (Code.FORCE_GAIN, _describe_factor("sideways force")),
    ForceFault.FREE_MOMENT: (Code.FREE_MOMENT, _describe_free_moment),
    ForceFault.OFFSET: (Code.PLATE_OFFSET, _describe_offset),
    ForceFault.SIGN_FORE_AFT: (
        Code.FORCE_SIGN,
        _describe_by_template("the fore-aft force of {plates} has the wrong sign"),
    ),
    ForceFault.SIGN_SIDEWAYS: (
        Code.FORCE_SIGN,
        _describe_by_template("the sideways force of {plates} has the wrong sign"),
    ),
    ForceFault.SIGN_HORIZONTAL: (
        Code.FORCE_SIGN,
        _describe_by_template("both horizontal forces of {plates} have the wrong sign"),
    ),
    ForceFault.SIGN_VERTICAL: (
        Code.FORCE_SIGN,
        _describe_by_template("the vertical force of {plates} alone has the wrong sign"),
    ),
    ForceFault.AXES: (
        Code.PLATE_AXES,
        _describe_by_template(
            "the horizontal axes of {plates} are swapped",
            "swap the columns (channels) of the horizontal forces",
        ),
    ),
    ForceFault.FORCE_UNIT: (
        Code.FORCE_UNIT,
        _describe_by_template("the forces are in {unit}, not in N", "give forces in N"),
    ),
    ForceFault.MOMENT_UNIT: (
        Code.FORCE_UNIT,
        _describe_by_template(
            "the moments of the plates are in N·mm, not in N·m", "divide the moments by 1000"
        ),
    ),
    ForceFault.CENTRE_UNIT: (
        Code.FORCE_UNIT,
        _describe_by_template(
            "the centre of pressure is in {unit}, not in m", "give points of application in m"
        ),
    ),
    ForceFault.EXCHANGED: (
        Code.PLATES_EXCHANGED,
        _describe_by_template(
            "plates {one} and {other} are swapped",
            "swap their corners, or their channels (columns of forces)",
        ),
    ),
    ForceFault.TRUNK: (Code.TRUNK_WEIGHT, _describe_trunk),
}
"""Code of each cause, and the function that describes it."""


def compute_torque_change(trials: Sequence[ForceEvidence], fit: ForceFit) -> tuple[str, float]:
    """Compute which leg torque a fault changes most.

    `trials`: trials with the fault. Returns: coordinate of the torque; empty if none changes; RMS
    change as a share of body weight times height.
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


def find_force_faults(trials: Sequence[ForceEvidence]) -> ForceDiagnosis:
    """Find the faults that explain a disagreement of motion and forces.

    Parameters
    ----------
    trials
        Gait trials of one person over the same plates.

    Returns
    -------
    ForceDiagnosis
        Findings, trials with faulty forces, and the uncertainty of the plates.
    """
    named, unexplained, possible = choose(trials)
    findings = [_report_fault(one) for one in named]
    findings += [_report_unexplained(one) for one in unexplained]
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


def _report_fault(named: NamedFault) -> Finding:
    """Build the finding on a fault, with its rivals in its evidence."""
    trial, (best, *rivals) = named.trials[0], named.fits
    code, describe = DESCRIPTIONS[best.cause.kind]
    cause, cure = describe(best, trial)
    torque, change = compute_torque_change(named.trials, best)
    found = (
        f"correcting it removes {100 * best.explained:.0f} % of the disagreement between motion "
        "and forces"
    )
    if torque:
        found += (
            f"; it changes the torque of {torque} by {100 * change:.1f} % of body weight times "
            "height (RMS)"
        )
    if rivals:
        others = [
            f"{DESCRIPTIONS[fit.cause.kind][1](fit, trial)[0]} ({100 * fit.explained:.0f} %)"
            for fit in rivals
        ]
        found += f"; nearly as good explanations: {'; or '.join(others)}"
    several = len(named.trials) > 1
    if several:
        found = f"in all of the trials {', '.join(t.name for t in named.trials)}; {found}"
    weight = change / TORQUE_ERROR_BWH
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


def check_pelvis_residual(
    walk: str, residual: ExpectedResidual, trunk_observed: bool
) -> Iterator[Finding]:
    """Report a pelvis residual after the fit that is larger than its errors explain.

    Parameters
    ----------
    walk
        Name of the trial.
    residual
        Residual and its expected size.
    trunk_observed
        Whether markers determine the rotation of the trunk.

    Yields
    ------
    Finding
        One warning, or nothing.
    """
    if residual.within:
        return
    force, moment = residual.force, residual.moment
    found = (
        f"the pelvis residual is {force.rms:.0f} N and {moment.rms:.0f} N·m RMS; expected from the "
        f"error sources: {force.expected:.0f} N and {moment.expected:.0f} N·m, in 1 walk of 1000 "
        f"more than {force.limit:.0f} N or {moment.limit:.0f} N·m"
    )
    yield _report_disagreement(walk, trunk_observed, found, residual.share)


def _report_unexplained(one: UnexplainedTrial) -> Finding:
    """Build the warning on a trial whose disagreement no cause explains."""
    size = one.size**0.5
    found = f"the disagreement is {size:.1f} times the usual value"
    return _report_disagreement(one.trial.name, one.trial.trunk_observed, found, size / 2.0)


def _report_disagreement(walk: str, trunk_observed: bool, found: str, weight: float) -> Finding:
    """Build the warning on motion and forces that disagree without a known fault."""
    cause = (
        "motion and forces disagree at the pelvis, and no single fault of the forces explains it"
    )
    cure = (
        "check the markers of pelvis and trunk, whether each foot was wholly on a plate, and "
        "mass_kg"
    )
    if not trunk_observed:
        cause = (
            "motion and forces disagree at the pelvis, and markers do not determine the rotation "
            "of the trunk"
        )
        cure = "use markers on the trunk (C7, sternum), and check the plates and mass_kg"
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
