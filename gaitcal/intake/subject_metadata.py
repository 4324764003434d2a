"""Collect subject metadata (mass, height, sex, age, ...) from options, files and force plates.

Options come first, then the file of the static trial, then the others; the reason names files that
contradict. The subject's name is that of the folder: the name in a file may be the patient's. The
mass is compared with the plates under the standing person, and with the height: in pounds it is
2.2 times, as a weight in newtons 9.81 times the mass in kg.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.intake.trial_movement import StandingPosture
from gaitcal.io.force_plate import BODY_N
from gaitcal.io.labels import GREATEST_AGE, Facts, compute_age
from gaitcal.io.recording import ForcePlate, Recording, find_runs, measure_duration
from gaitcal.model import linkage, subject_model
from gaitcal.model.marker_set import MarkerSet

MASS_KG = (10.0, 250.0)
"""Range of a person on plates; with less, a foot is beside them."""
CONTRADICTS = 0.02
"""Relative difference of the figures of two files from which it is reported."""
WEIGHS_OTHERWISE = 0.05
"""Relative difference between given and weighed mass from which it is reported."""
STEADY = 0.03
"""Largest standard deviation of the force under a standing person, as a share of it."""


@dataclass(frozen=True, kw_only=True)
class KnownField:
    """One field of the subject, and where it is from."""

    value: object
    reason: str
    certain: bool = True


@dataclass(frozen=True, kw_only=True)
class Options:
    """Subject data from the user; None: not given."""

    mass: float | None = None
    """kg."""
    height: float | None = None
    """m."""
    sex: str | None = None
    age: float | None = None
    """Years."""
    name: str | None = None
    session: str | None = None
    """Day of the recordings: a date or a label."""


NO_OPTIONS = Options()


def collect_subject(
    folder: str,
    options: Options,
    files: Sequence[tuple[str, Facts]],
    plates: tuple[str, float] | None,
    markers: tuple[float, float] | None = None,
    walks: tuple[str, float] | None = None,
) -> dict[str, KnownField]:
    """Collect the fields of the table `[subject]`.

    Parameters
    ----------
    folder
        Its name.
    options
        Given by the user.
    files
        Name and facts of every file of the person, the static trial's first.
    plates
        Name of the static trial that stands wholly on plates, and the mass (kg) by them.
    markers
        Height (m) by the standing markers, and its standard deviation.
    walks
        Names of walks with whole strides on plates, and the mass (kg) by them.

    Returns
    -------
    dict
        Field -> value, reason and certainty; fields that are not given anywhere are not listed.
    """
    out = {
        "name": KnownField(
            value=options.name or folder, reason="option" if options.name else "name of the folder"
        )
    }
    if options.session:
        out["session"] = KnownField(value=options.session, reason="option")
    mass = _collect_mass(options, files, plates, walks)
    if mass is not None:
        out["mass_kg"] = mass
    out |= _collect_height(options, files, markers)
    if options.sex:
        out["sex"] = KnownField(value=options.sex, reason="option")
    out |= _collect_dates(options, files)
    for field, get in (
        ("knee_width", lambda f: f.knee_width),
        ("ankle_width", lambda f: f.ankle_width),
        ("leg_length", lambda f: f.leg_length),
    ):
        width = _choose_widths(files, get) or _convert_doubtful_sides(files, field)
        if width is not None:
            out[f"{field}_mm"] = width
    for field, length in (
        ("asis_distance_mm", lambda f: f.asis_distance),
        ("marker_diameter_mm", lambda f: f.marker_diameter),
    ):
        known = _choose_number(None, files, length, "m", 6)
        if known is not None:
            out[field] = replace(known, value=round(1e3 * float(str(known.value)), 2))
    return out


def _collect_mass(
    options: Options,
    files: Sequence[tuple[str, Facts]],
    plates: tuple[str, float] | None,
    walks: tuple[str, float] | None,
) -> KnownField | None:
    """Return the mass (kg): given, weighed in the static trial, in another unit, or in walks."""
    given = _choose_number(options.mass, files, lambda f: f.mass, "kg", 2)
    if given is not None:
        if plates is None or abs(plates[1] / float(str(given.value)) - 1) <= WEIGHS_OTHERWISE:
            return given
        reason = f"{given.reason}; but {plates[1]:.1f} kg by the plates in {plates[0]}"
        return KnownField(value=given.value, reason=reason, certain=False)
    if plates is not None:
        doubts = "".join(
            f"; {name}: {f.doubtful['mass'][0]}" for name, f in files if "mass" in f.doubtful
        )
        missing = "not given in kg in any file" if doubts else "not given in any file"
        reason = f"{missing}; weighed by the plates in {plates[0]}{doubts}"
        return KnownField(value=round(plates[1], 1), reason=reason, certain=False)
    converted = _convert_doubtful(files, "mass", 2)
    if converted is not None or walks is None:
        return converted
    reason = (
        "not given in any file; weighed by the plates over whole strides of "
        f"{walks[0]}, to about 3 %"
    )
    return KnownField(value=round(walks[1], 1), reason=reason, certain=False)


def _collect_height(
    options: Options, files: Sequence[tuple[str, Facts]], markers: tuple[float, float] | None
) -> dict[str, KnownField]:
    """Return the height (m): given, in another unit, or estimated, then with its error."""
    height = _choose_number(options.height, files, lambda f: f.height, "m", 4)
    height = height or _convert_doubtful(files, "height", 4)
    if height is not None:
        return {"height_m": height}
    if markers is None:
        return {}
    estimate, error = markers
    reason = (
        "not given in any file; estimated from the length of the legs, standard deviation "
        f"{100 * error:.0f} cm"
    )
    return {
        "height_m": KnownField(value=round(estimate, 2), reason=reason, certain=False),
        "height_error_m": KnownField(
            value=round(error, 3), reason="one standard deviation; included in the errors"
        ),
    }


def _collect_dates(options: Options, files: Sequence[tuple[str, Facts]]) -> dict[str, KnownField]:
    """Return age and session date."""
    out = {}
    age = _compute_age_by_dates(files)
    if options.age is not None:
        out["age_years"] = KnownField(value=options.age, reason="option")
    elif age is not None:
        out["age_years"] = age
    dates = [(name, facts.session_date) for name, facts in files if facts.session_date]
    if dates:
        first, day = dates[0]
        others = [f"{name} {other}" for name, other in dates if other != day]
        reason = f"from {first}" + (f", but {others[0]}" if others else "")
        out["session_date"] = KnownField(value=day, reason=reason, certain=not others)
    return out


def _compute_age_by_dates(files: Sequence[tuple[str, Facts]]) -> KnownField | None:
    """Compute the age (years, one decimal) by the first plausible dates of birth and session."""
    ages = [(name, compute_age(facts.birth_date, facts.session_date)) for name, facts in files]
    plausible = []
    for name, age in ages:
        if age is not None and 0.0 <= age <= GREATEST_AGE:
            plausible.append((name, round(age, 1)))
    if not plausible:
        return None
    first, value = plausible[0]
    others = [f"of {name} {age:g}" for name, age in plausible if age != value]
    contradiction = f", but by those {others[0]}" if others else ""
    reason = f"by the dates of birth and session of {first}{contradiction}"
    return KnownField(value=value, reason=reason, certain=not others)


def _choose_number(
    option: float | None,
    files: Sequence[tuple[str, Facts]],
    get: Callable[[Facts], float | None],
    unit: str,
    digits: int,
) -> KnownField | None:
    """Choose a number from the option or the first file that has it; name files that contradict."""
    values = [(name, get(facts)) for name, facts in files]
    found = [(name, value) for name, value in values if value is not None]
    if option is None and not found:
        return None
    chosen = found[0][1] if option is None else option
    others = [f"{name} {v:.4g} {unit}" for name, v in found if abs(v / chosen - 1) > CONTRADICTS]
    if option is not None:
        return KnownField(value=option, reason="option" + (f"; but {others[0]}" if others else ""))
    reason = f"from {found[0][0]}"
    if others:
        return KnownField(
            value=round(chosen, digits),
            reason=f"{reason}, but {', '.join(others[:3])}",
            certain=False,
        )
    return KnownField(
        value=round(chosen, digits),
        reason=reason + (f", and {len(found) - 1} more" if found[1:] else ""),
    )


def _choose_widths(
    files: Sequence[tuple[str, Facts]], get: Callable[[Facts], Mapping[str, float]]
) -> KnownField | None:
    """Return widths (mm) from the first file that has them."""
    for name, facts in files:
        widths = get(facts)
        if widths:
            value = {side: round(1e3 * widths[side], 1) for side in linkage.SIDES if side in widths}
            return KnownField(value=value, reason=f"from {name}")
    return None


def list_doubtful_figures(files: Sequence[tuple[str, Facts]]) -> tuple[str, ...]:
    """List figures of files for mass, height and widths that are in no plausible unit, each once.

    `files`: name and facts of every file of the person.
    """
    # of a figure in several files the first file is named
    first = {}
    for name, facts in reversed(files):
        for figure, _ in facts.doubtful.values():
            first[figure] = name
    return tuple(f"{name}: {figure}" for figure, name in sorted(first.items()))


def _convert_doubtful(
    files: Sequence[tuple[str, Facts]], fact: str, digits: int
) -> KnownField | None:
    """Convert a figure in another unit, if only one unit is plausible."""
    for name, facts in files:
        figure, value = facts.doubtful.get(fact, ("", None))
        if value is not None:
            reason = f"{name}: {figure}"
            return KnownField(value=round(value, digits), reason=reason, certain=False)
    return None


def _convert_doubtful_sides(files: Sequence[tuple[str, Facts]], fact: str) -> KnownField | None:
    """Convert widths in another unit to mm."""
    widths = {side: _convert_doubtful(files, f"{fact}_{side}", 4) for side in linkage.SIDES}
    found = {side: width for side, width in widths.items() if width is not None}
    if not found:
        return None
    value = {side: round(1e3 * float(str(width.value)), 1) for side, width in found.items()}
    return KnownField(value=value, reason=next(iter(found.values())).reason, certain=False)


def weigh_standing(
    recording: Recording, marker_set: MarkerSet, posture: StandingPosture
) -> float | None:
    """Weigh a person who stands still and wholly on plates.

    Parameters
    ----------
    recording
        Static trial, y up.
    marker_set
        Its marker set.
    posture
        Its standing posture.

    Returns
    -------
    float or None
        kg; None if plate corners are not known, the force is not steady, or a foot is not on a
        plate.
    """
    total, still = 0.0, 0.0
    loaded: list[Array] = []
    for plate in recording.plates:
        force = plate.force[:, 1]
        force = force[
            (plate.time >= posture.start) & (plate.time <= posture.stop) & np.isfinite(force)
        ]
        if not len(force):
            return None
        # loaded plates, with corners that are known
        mean = float(np.mean(force))
        if mean > 0.1 * subject_model.GRAVITY * MASS_KG[0]:
            if plate.corners is None:
                return None
            loaded.append(plate.corners[:, [0, 2]])
            still = max(still, float(np.std(force)))
            total += mean
    # the force is steady, and that of a person
    mass = total / subject_model.GRAVITY
    if not loaded or not MASS_KG[0] <= mass <= MASS_KG[1] or still > STEADY * total:
        return None
    # every foot marker is above a loaded plate
    inside = (recording.time >= posture.start) & (recording.time <= posture.stop)
    feet = [
        i
        for i, m in enumerate(recording.labels)
        if marker_set.segment_of.get(m, "").startswith("foot")
    ]
    paths = (
        path[np.isfinite(path).all(axis=1)]
        for path in recording.markers[inside][:, feet].transpose(1, 0, 2)
    )
    positions = [path.mean(axis=0)[[0, 2]] for path in paths if len(path)]
    if len(positions) < 4:
        return None
    for position in positions:
        if not any(_is_inside(position, corners) for corners in loaded):
            return None
    return mass


def weigh_walking(plates: Sequence[ForcePlate]) -> float | None:
    """Weigh a walking person: the mean vertical force over a stride is body weight.

    Three overlapping steps in a row, the third after the end of the first, are a stride from the
    beginning of the first to that of the third. The impulses of the first and second step carry the
    body for that time. They are complete if both impulses are similar, and the third begins at its
    strike if both double supports last equally long.

    Returns: kg, median over the strides; None without a stride.
    """
    # whole loadings of every plate: beginning, end and impulse
    steps = []
    for plate in plates:
        up = np.nan_to_num(plate.force[:, 1])
        for run in find_runs(up > BODY_N):
            if run.start > 0 and run.stop < len(up) and measure_duration(plate.time, run) > STEP_S:
                pushed = float(np.trapezoid(up[run], plate.time[run]))
                steps.append(
                    (float(plate.time[run.start]), float(plate.time[run.stop - 1]), pushed)
                )
    masses = []
    for (begin, end, one), (second, off, other), (third, _, _) in zip(
        *(sorted(steps)[k:] for k in range(3)), strict=False
    ):
        # double supports of equal length, steps with similar impulses
        even = abs((off - third) - (end - second)) < EVEN * (third - begin)
        if begin < second < end < third < off and even and abs(one - other) < ALIKE * one:
            masses.append((one + other) / (subject_model.GRAVITY * (third - begin)))
    mass = float(np.median(masses)) if masses else 0.0
    return mass if MASS_KG[0] <= mass <= MASS_KG[1] else None


def _is_inside(point: Array, corners: Array) -> bool:
    """Return whether a point (2,) is in the quadrangle of corners (4, 2)."""
    edges = np.roll(corners, -1, axis=0) - corners
    away = point - corners
    sides = edges[:, 0] * away[:, 1] - edges[:, 1] * away[:, 0]
    return bool((sides >= 0).all() or (sides <= 0).all())


WEIGHS_ANOTHER = 0.2
"""Relative difference from the plates from which no torque is valid."""
BODY_MASS_INDEX = (8.0, 70.0)
"""kg/m^2, range of walking people."""
FACTORS = {"lb": 2.2046, "N": subject_model.GRAVITY}
"""Unit -> its number per kilogram."""
ALIKE = 0.1
"""Largest relative difference from such a factor, and between the impulses of two whole steps."""
STEP_S = 0.3
"""s, shortest step of walking."""
EVEN = 0.03
"""Share of a stride by which two double supports may differ; beyond it a plate was not loaded at
foot strike.
"""


def check_mass(
    person: Mapping[str, KnownField], options: Options, plates: tuple[str, float] | None
) -> str:
    """Check the mass of a file against plates and height.

    Parameters
    ----------
    person
        Fields of the subject.
    options
        Given by the user: a mass that the user gives is not checked.
    plates
        Static trial, and the mass (kg) by the plates in it.

    Returns
    -------
    str
        Why it cannot be the mass of the person; empty if it can.
    """
    known = person.get("mass_kg")
    if known is None or options.mass is not None:
        return ""
    mass = float(str(known.value))
    found = f"subject.mass_kg: found {mass:g} ({known.reason.partition(';')[0]})"
    remedy = "give --mass KG"
    if plates is not None and abs(mass / plates[1] - 1) > WEIGHS_ANOTHER:
        ratio = mass / plates[1]
        # a unit that explains the ratio
        units = [unit for unit, factor in FACTORS.items() if abs(ratio / factor - 1) < ALIKE]
        hint = f": {mass / FACTORS[units[0]]:.1f} kg if it is in {units[0]}" if units else ""
        return (
            f"{found}, {ratio:.2f} times the {plates[1]:.1f} kg by the plates in "
            f"{plates[0]}{hint}; {remedy}"
        )
    height = person.get("height_m")
    if height is None:
        return ""
    square = float(str(height.value)) ** 2
    low, high = (limit * square for limit in BODY_MASS_INDEX)
    if low <= mass <= high:
        return ""
    converted = {unit: mass / factor for unit, factor in FACTORS.items()}
    hints = [f"{kg:.1f} kg if it is in {u}" for u, kg in converted.items() if low <= kg <= high]
    allowed = f"{found}; allowed: {low:.0f} to {high:.0f} kg at a height of {height.value} m"
    return f"{allowed}{': ' if hints else ''}{' or '.join(hints)}; {remedy}, or --height M"
