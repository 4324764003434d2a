"""Who the person is: what the files say, what the plates weigh, what the user says; and what nobody
says.

The user's word comes first, then the static trial's file, then the others; the reason names files
that contradict. The subject's name is that of the folder: a file's may be the patient's. A mass is
held against the plates under the standing person, and the height: in pounds it is 2.2 times, as a
weight in newtons 9.81 times the mass in kg.
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

MASS_KG = (10.0, 250.0)  # Of a person on plates: less is a foot that stands beside them
CONTRADICTS = 0.02  # Relative difference of two files' figures from which it is told
WEIGHS_OTHERWISE = 0.05
STEADY = 0.03  # Standard deviation of the force under a standing person as a share of it


@dataclass(frozen=True, kw_only=True)
class KnownField:
    """One field of the person."""

    value: object
    reason: str
    certain: bool = True


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the user says of the person; None: nothing."""

    mass: float | None = None  # kg
    height: float | None = None  # m
    sex: str | None = None
    age: float | None = None  # Years
    name: str | None = None
    session: str | None = None  # The day of the recordings, a date or a label


NO_OPTIONS = Options()


def collect_subject(
    folder: str,
    options: Options,
    files: Sequence[tuple[str, Facts]],
    plates: tuple[str, float] | None,
    markers: tuple[float, float] | None = None,
    walks: tuple[str, float] | None = None,
) -> dict[str, KnownField]:
    """Field of `[subject]` -> what is known of it; fields that nobody tells are not in it.

    `files`: name and facts of every file of the person, the static trial's first. `plates`: name of
    the static trial that stands wholly on plates, and the mass (kg) that these weigh. `markers`:
    height (m) that the standing markers tell, and its standard deviation. `walks`: names of walks
    with whole strides on plates, and the mass (kg) that these weigh.
    """
    out = {
        "name": KnownField(
            value=options.name or folder, reason="option" if options.name else "name of the folder"
        )
    }
    if options.session:
        out["session"] = KnownField(value=options.session, reason="option")
    if (mass := _choose_number(options.mass, files, lambda f: f.mass, "kg", 2)) is not None:
        if plates is not None and abs(plates[1] / float(str(mass.value)) - 1) > WEIGHS_OTHERWISE:
            words = f"{mass.reason}; but the plates weigh {plates[1]:.1f} kg in {plates[0]}"
            mass = KnownField(value=mass.value, reason=words, certain=False)
        out["mass_kg"] = mass
    elif plates is not None:
        doubts = "".join(
            f"; {name} says {f.doubtful['mass'][0]}" for name, f in files if "mass" in f.doubtful
        )
        reason = (
            f"weighed by the plates under {plates[0]}, where no file says "
            f"it{' in kg' if doubts else ''}{doubts}"
        )
        out["mass_kg"] = KnownField(value=round(plates[1], 1), reason=reason, certain=False)
    elif (mass := _convert_doubtful(files, "mass", 2)) is not None:
        out["mass_kg"] = mass
    elif walks is not None:
        reason = (
            f"weighed by the plates over whole strides of {walks[0]}, to some 3 %, where no file "
            "says it"
        )
        out["mass_kg"] = KnownField(value=round(walks[1], 1), reason=reason, certain=False)
    height = _choose_number(options.height, files, lambda f: f.height, "m", 4) or _convert_doubtful(
        files, "height", 4
    )
    if height is not None:
        out["height_m"] = height
    elif markers is not None:
        reason = (
            f"no file says it; people of this height, give or take {100 * markers[1]:.0f} cm, have "
            "legs as long"
        )
        out["height_m"] = KnownField(value=round(markers[0], 2), reason=reason, certain=False)
        out["height_error_m"] = KnownField(
            value=round(markers[1], 3), reason="one standard deviation; counts in the errors"
        )
    if options.sex:
        out["sex"] = KnownField(value=options.sex, reason="option")
    if options.age is not None:
        out["age_years"] = KnownField(value=options.age, reason="option")
    elif (age := _compute_age_by_dates(files)) is not None:
        out["age_years"] = age
    if told := [(name, facts.session_date) for name, facts in files if facts.session_date]:
        others = [f"{name} {day}" for name, day in told if day != told[0][1]]
        words = f"{told[0][0]} says so" + (f", but {others[0]}" if others else "")
        out["session_date"] = KnownField(value=told[0][1], reason=words, certain=not others)
    for field, get in (
        ("knee_width", lambda f: f.knee_width),
        ("ankle_width", lambda f: f.ankle_width),
        ("leg_length", lambda f: f.leg_length),
    ):
        if (
            width := _choose_widths(files, get) or _convert_doubtful_sides(files, field)
        ) is not None:
            out[f"{field}_mm"] = width
    for field, length in (
        ("asis_distance_mm", lambda f: f.asis_distance),
        ("marker_diameter_mm", lambda f: f.marker_diameter),
    ):
        if (known := _choose_number(None, files, length, "m", 6)) is not None:
            out[field] = replace(known, value=round(1e3 * float(str(known.value)), 2))
    return out


def _compute_age_by_dates(files: Sequence[tuple[str, Facts]]) -> KnownField | None:
    """Years in tenths by the first dates that somebody can have; the date of birth itself is not
    told.
    """
    ages = [(name, compute_age(facts.birth_date, facts.session_date)) for name, facts in files]
    told = [
        (name, round(age, 1))
        for name, age in ages
        if age is not None and 0.0 <= age <= GREATEST_AGE
    ]
    if not told:
        return None
    others = [f"of {name} {age:g}" for name, age in told if age != told[0][1]]
    words = f"by the dates of birth and session of {told[0][0]}" + (
        f", but by those {others[0]}" if others else ""
    )
    return KnownField(value=told[0][1], reason=words, certain=not others)


def _choose_number(
    said: float | None,
    files: Sequence[tuple[str, Facts]],
    get: Callable[[Facts], float | None],
    unit: str,
    digits: int,
) -> KnownField | None:
    """A number from the user or from the first file that has it, and the files that have another."""
    found = [(name, value) for name, facts in files if (value := get(facts)) is not None]
    if said is None and not found:
        return None
    chosen = found[0][1] if said is None else said
    others = [f"{name} {v:.4g} {unit}" for name, v in found if abs(v / chosen - 1) > CONTRADICTS]
    if said is not None:
        return KnownField(value=said, reason="option" + (f"; but {others[0]}" if others else ""))
    reason = f"{found[0][0]} says so"
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
    """Widths in mm from the first file that has them."""
    for name, facts in files:
        if widths := get(facts):
            value = {side: round(1e3 * widths[side], 1) for side in linkage.SIDES if side in widths}
            return KnownField(value=value, reason=f"{name} says so")
    return None


def list_doubtful_figures(files: Sequence[tuple[str, Facts]]) -> tuple[str, ...]:
    """What files say of mass, height and widths that can be in no unit they should be in, each
    figure once.
    """
    told = {words: name for name, facts in reversed(files) for words, _ in facts.doubtful.values()}
    return tuple(f"{name} says {words}" for words, name in sorted(told.items()))


def _convert_doubtful(
    files: Sequence[tuple[str, Facts]], fact: str, digits: int
) -> KnownField | None:
    """A figure in another unit than its own, where only one unit makes sense of it."""
    for name, facts in files:
        words, value = facts.doubtful.get(fact, ("", None))
        if value is not None:
            return KnownField(
                value=round(value, digits), reason=f"{name} says {words}", certain=False
            )
    return None


def _convert_doubtful_sides(files: Sequence[tuple[str, Facts]], fact: str) -> KnownField | None:
    """Widths (mm) in another unit."""
    found = {
        side: width
        for side in linkage.SIDES
        if (width := _convert_doubtful(files, f"{fact}_{side}", 4)) is not None
    }
    if not found:
        return None
    value = {side: round(1e3 * float(str(width.value)), 1) for side, width in found.items()}
    return KnownField(value=value, reason=next(iter(found.values())).reason, certain=False)


def weigh_standing(
    recording: Recording, marker_set: MarkerSet, posture: StandingPosture
) -> float | None:
    """Mass (kg) by plates on which the person stands wholly and still; None where that cannot be
    said.
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
        mean = float(np.mean(force))
        if mean > 0.1 * subject_model.GRAVITY * MASS_KG[0]:
            if plate.corners is None:
                return None
            loaded.append(plate.corners[:, [0, 2]])
            still = max(still, float(np.std(force)))
            total += mean
    mass = total / subject_model.GRAVITY
    if not loaded or not MASS_KG[0] <= mass <= MASS_KG[1] or still > STEADY * total:
        return None
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
    places = [path.mean(axis=0)[[0, 2]] for path in paths if len(path)]
    if len(places) < 4 or not all(
        any(_is_inside(p, corners) for corners in loaded) for p in places
    ):
        return None
    return mass


def weigh_walking(plates: Sequence[ForcePlate]) -> float | None:
    """Mass (kg) by the plates of a walk: over a whole stride the mean vertical force of both feet
    is body weight.

    Three steps in a row that overlap, the third after the first has ended, are a stride from the
    first's beginning to the third's: what the first and the second push in all, wherever in time,
    carries the body for so long. They are taken for whole where they push alike, and the third's
    beginning for its strike where both double supports last as long; None where no stride is.
    """
    steps = []
    for plate in plates:
        up = np.nan_to_num(plate.force[:, 1])
        for run in find_runs(up > BODY_N):
            if run.start > 0 and run.stop < len(up) and measure_duration(plate.time, run) > STEP_S:
                pushed = float(np.trapezoid(up[run], plate.time[run]))
                steps.append(
                    (float(plate.time[run.start]), float(plate.time[run.stop - 1]), pushed)
                )
    told = []
    for (begin, end, one), (second, off, other), (third, _, _) in zip(
        *(sorted(steps)[k:] for k in range(3)), strict=False
    ):
        even = abs((off - third) - (end - second)) < EVEN * (third - begin)
        if begin < second < end < third < off and even and abs(one - other) < ALIKE * one:
            told.append((one + other) / (subject_model.GRAVITY * (third - begin)))
    mass = float(np.median(told)) if told else 0.0
    return mass if MASS_KG[0] <= mass <= MASS_KG[1] else None


def _is_inside(point: Array, corners: Array) -> bool:
    """Whether a point (2,) lies in the quadrangle of corners (4, 2)."""
    edges = np.roll(corners, -1, axis=0) - corners
    away = point - corners
    sides = edges[:, 0] * away[:, 1] - edges[:, 1] * away[:, 0]
    return bool((sides >= 0).all() or (sides <= 0).all())


WEIGHS_ANOTHER = 0.2  # Relative difference from the plates with which no torque is worth anything
BODY_MASS_INDEX = (8.0, 70.0)  # kg/m^2, outside of which nobody is recorded walking
FACTORS = {"lb": 2.2046, "N": subject_model.GRAVITY}  # Unit -> how many of it are a kilogram
# Relative difference from such a factor up to which it is named; and of what two whole steps push
ALIKE = 0.1
STEP_S = 0.3  # Shorter loadings are no step of walking
EVEN = 0.03
"""Of a stride, by which two double supports may differ: a plate loaded later or earlier than that
is no strike.
"""


def check_mass(
    person: Mapping[str, KnownField], options: Options, plates: tuple[str, float] | None
) -> str:
    """Why the mass of a file cannot be that of the person; empty where it can, or where the user
    says it.

    `plates`: static trial, and the mass (kg) that the plates weigh in it.
    """
    known = person.get("mass_kg")
    if known is None or options.mass is not None:
        return ""
    mass = float(str(known.value))
    said = f"subject.mass_kg: found {mass:g} ({known.reason.partition(';')[0]})"
    cure = "give --mass KG"
    if plates is not None and abs(mass / plates[1] - 1) > WEIGHS_ANOTHER:
        ratio = mass / plates[1]
        unit = next(
            (
                f": {mass / by:.1f} kg if it is in {u}"
                for u, by in FACTORS.items()
                if abs(ratio / by - 1) < ALIKE
            ),
            "",
        )
        return (
            f"{said}, {ratio:.2f} times the {plates[1]:.1f} kg that the plates weigh in "
            f"{plates[0]}{unit}; {cure}"
        )
    if (height := person.get("height_m")) is not None:
        tall = float(str(height.value)) ** 2
        low, high = (limit * tall for limit in BODY_MASS_INDEX)
        if not low <= mass <= high:
            meant = {unit: mass / by for unit, by in FACTORS.items() if low <= mass / by <= high}
            units = " or ".join(f"{kg:.1f} kg if it is in {unit}" for unit, kg in meant.items())
            words = f"{said}; allowed: {low:.0f} to {high:.0f} kg at a height of {height.value} m"
            return f"{words}{': ' if units else ''}{units}; {cure}, or --height M"
    return ""
