"""Read and write a person's model as a TOML file, in mm, deg, kg and kg*mm^2.

A number x in SI units is written as a decimal d in file units with float(d * factor) == x. The
product has PRECISION decimal digits. d has 15 digits if they are enough, else as many as needed (17
distinguish neighbouring doubles). Reading keeps the text as a decimal, so no bit is lost.
"""

from decimal import Context, Decimal, InvalidOperation
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.io.atomic import write_atomically
from gaitcal.io.toml import (
    Table,
    format_toml_table,
    format_toml_value,
    format_value,
    read_validated,
    require_known,
)
from gaitcal.model.linkage import COORDINATES, SEGMENTS, ZERO_ANGLES
from gaitcal.model.parameters import IP_NAMES, IP_UNITS, JOINT_PARAMETERS, JP_NAMES, Parameters
from gaitcal.model.subject_model import (
    MarkerPlacement,
    PatientRecord,
    PointNoise,
    Subject,
    SubjectModel,
)

FORMAT = 1
# decimal digits of products and quotients: far more than a double has
PRECISION = 60
# digits of a written number: 17 distinguish doubles, units cost a few
MOST_DIGITS = 21
# Largest decimal exponent: within the range of doubles in every unit
LARGEST_EXPONENT = 300
_EXACT = Context(prec=PRECISION, Emin=-(10**6), Emax=10**6)
_PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494")
_TO_SI = {
    "mm": Decimal("1e-3"),
    "deg": _EXACT.divide(_PI, Decimal(180)),
    "kg": Decimal(1),
    "kg*mm^2": Decimal("1e-6"),
    "m": Decimal(1),
}
_ZERO_WORDS = (
    "deg; constants that make zero ankle coordinates the foot at right angles to the shank"
)
_TABLES = {
    "joint_parameters": (JP_NAMES, tuple(p.kind.unit for p in JOINT_PARAMETERS), "mm, deg"),
    "zero_angles": (ZERO_ANGLES, ("deg",) * len(ZERO_ANGLES), _ZERO_WORDS),
    "inertial_parameters": (IP_NAMES, IP_UNITS, "kg, mm, kg*mm^2; moments about the mass centre"),
}
"""Table of the file -> names and units of its entries, and its comment."""
_ARRAYS = {
    "joint_parameters": "joint",
    "zero_angles": "zero_angles",
    "inertial_parameters": "inertial",
}
"""Table of the file -> field of `Parameters`."""
_MEASURED = {"age": ("age_years", "kg"), "asis_distance": ("asis_distance_mm", "mm")}
_MEASURED |= {"marker_diameter": ("marker_diameter_mm", "mm")}
"""Field of a subject that may be unknown -> its name in the file, and its unit there (years: as
they are).
"""
_HEADER = """\
# A person's linkage model. Frames: x anterior, y superior, z to the right, on both sides; ant sup lat = x y z,
# front trans sag = turns about x y z. `value` is in use, `nominal` what calibration started from. All digits count.
"""  # noqa: E501


def _check_decimal(value: object) -> object:
    if isinstance(value, int) and not isinstance(value, bool):
        value = Decimal(value)
    if (
        isinstance(value, Decimal)
        and value.is_finite()
        and value
        and value.adjusted() > LARGEST_EXPONENT
    ):
        raise ValueError(
            f"found {format_value(str(value))}; allowed: a number that a person can have"
        )
    return value


def _convert_to_floats(value: object) -> object:
    if not isinstance(value, dict):
        return value
    return {name: float(x) if isinstance(x, Decimal) else x for name, x in value.items()}


_Number = Annotated[Decimal, BeforeValidator(_check_decimal)]
_Point = Annotated[list[_Number], Field(min_length=3, max_length=3)]


class _Subject(Table):
    name: str
    mass_kg: Annotated[_Number, Field(gt=0)]
    height_m: Annotated[_Number, Field(gt=0)]
    sex: str
    height_error_m: Annotated[_Number, Field(ge=0)] = Decimal(0)
    age_years: Annotated[_Number, Field(ge=0)] | None = None
    knee_width_mm: dict[str, _Number] = Field(default={})
    ankle_width_mm: dict[str, _Number] = Field(default={})
    leg_length_mm: dict[str, _Number] = Field(default={})
    asis_distance_mm: _Number | None = None
    marker_diameter_mm: _Number | None = None
    session: str = ""
    record: dict[str, str] = Field(default={})


class _Value(Table):
    value: _Number
    nominal: _Number


class _Marker(Table):
    label: str
    segment: str
    position_mm: _Point
    weight: Annotated[_Number, Field(ge=0)]


class _Landmark(Table):
    segment: str
    position_mm: _Point


class _File(Table):
    format: int
    notes: list[str] = Field(default=[])
    frozen: list[str] = Field(default=[])
    posture_deg: dict[str, Decimal] = Field(default={})
    subject: _Subject
    joint_parameters: dict[str, _Value]
    inertial_parameters: dict[str, _Value]
    zero_angles: dict[str, _Value]
    marker: list[_Marker]
    landmarks: dict[str, _Landmark]
    noise: Annotated[PointNoise | None, BeforeValidator(_convert_to_floats)] = None


def save_model(model: SubjectModel, path: Path | str) -> None:
    """Write a model file; `load_model` reads back the same numbers, bit for bit.

    Parameters
    ----------
    model : SubjectModel
        The model.
    path : Path or str
        File to write, usually `model.toml`.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    with write_atomically(path) as sibling:
        sibling.write_text(format_model(model), encoding="utf-8")


def format_model(model: SubjectModel) -> str:
    """Format a model as the text of a model file.

    `model`: the model, SI units. Returns: TOML in mm, deg, kg and kg*mm^2.
    """
    s = model.subject
    measured = {name: (getattr(s, field), unit) for field, (name, unit) in _MEASURED.items()}
    lines = [
        _HEADER,
        f"format = {FORMAT}",
        f"frozen = {format_toml_value(model.frozen)} # coordinates that no marker shows",
        "notes = [",
        *(f"  {format_toml_value(note)}," for note in model.notes),
        "]",
        "",
        "[posture_deg] # coordinates of the static posture",
        *(f"{name} = {_format_number(angle, 'deg')}" for name, angle in model.posture.items()),
        "",
        "[subject]",
        f"name = {format_toml_value(s.name)}",
        f"mass_kg = {_format_number(s.mass, 'kg')}",
        f"height_m = {_format_number(s.height, 'm')}",
        f"sex = {format_toml_value(s.sex)}",
        *([f"height_error_m = {_format_number(s.height_error, 'm')}"] if s.height_error else []),
        *(
            f"{name} = {_format_number(value, unit)}"
            for name, (value, unit) in measured.items()
            if value is not None
        ),
    ]
    for field in ("knee_width", "ankle_width", "leg_length"):
        inner = ", ".join(
            f"{side} = {_format_number(length, 'mm')}" for side, length in getattr(s, field).items()
        )
        lines += [f"{field}_mm = {{ {inner} }}"] if inner else []
    lines += [f"session = {format_toml_value(s.session)}"] if s.session else []
    lines += [f"record = {format_toml_value(s.record.known)}"] if s.record.known else []
    for table, (names, units, comment) in _TABLES.items():
        lines += ["", f"[{table}] # {comment}"]
        width = max(map(len, names)) + 2
        values, nominal = (getattr(p, _ARRAYS[table]) for p in (model.parameters, model.nominal))
        for name, unit, v, n in zip(names, units, values, nominal, strict=True):
            both = (
                f"value = {_format_number(float(v), unit)}, "
                f"nominal = {_format_number(float(n), unit)}"
            )
            lines.append(f"{format_toml_value(name):{width}} = {{ {both} }}")
    lines += ["", "[landmarks]"]
    for name, (segment, position) in model.landmarks.items():
        place = f"segment = {format_toml_value(segment)}, position_mm = {_format_point(position)}"
        lines.append(f"{format_toml_value(name)} = {{ {place} }}")
    if model.noise is not None:
        lines.append(format_toml_table("[noise]", model.noise.model_dump()))
    m = model.markers
    for label, segment, local, weight in zip(m.labels, m.segments, m.local, m.weight, strict=True):
        lines += [
            "",
            "[[marker]]",
            f"label = {format_toml_value(label)}",
            f"segment = {format_toml_value(segment)}",
            f"position_mm = {_format_point(local)}",
            f"weight = {_format_number(float(weight), 'kg')}",
        ]
    if not m.labels:
        lines.insert(1, "marker = []")
    return "\n".join(lines) + "\n"


def _format_point(position: Array) -> str:
    """Format a position (3,) m in mm."""
    return "[" + ", ".join(_format_number(float(x), "mm") for x in position) + "]"


def _format_number(x: float, unit: str) -> str:
    """Format a number in SI units as the shortest decimal that is read back exactly."""
    if not np.isfinite(x):
        raise ValueError(f"found {x}; only finite numbers are allowed in a model file")
    if x == 0.0:
        return repr(x)
    wanted = _EXACT.divide(Decimal(x), _TO_SI[unit])
    for digits in range(15, MOST_DIGITS):
        rounded = Context(prec=digits).plus(wanted)
        if _convert_to_si(rounded, unit) == x:
            break
    plain = -8 <= rounded.adjusted() < 16
    text = format(rounded.normalize(_EXACT), "f" if plain else "e")
    return text if "." in text or "e" in text else f"{text}.0"


def _convert_to_si(value: Decimal, unit: str) -> float:
    return float(_EXACT.multiply(value, _TO_SI[unit]))


def _fault(source: Path, text: str, field: str | None = None) -> InputError:
    """Make the error of a model file."""
    return InputError(text, source=source, field=field, code=Code.DAMAGED_RESULT)


def _check_entries(file: _File, source: Path) -> None:
    """Check sex, record, coordinates, segments and labels of a model file."""
    s = file.subject
    if s.sex not in ("male", "female", ""):
        raise _fault(
            source,
            f"found {format_value(s.sex)}; allowed: 'male', 'female', '' if it is not given",
            "subject.sex",
        )
    require_known(
        s.record, vars(PatientRecord()), "field of a record", source=source, field="subject.record"
    )
    for coordinates, field in ((file.frozen, "frozen"), (file.posture_deg, "posture_deg")):
        require_known(coordinates, COORDINATES, "coordinate", source=source, field=field)
    for places, field in ((file.marker, "marker"), (file.landmarks.values(), "landmarks")):
        require_known(
            (place.segment for place in places), SEGMENTS, "segment", source=source, field=field
        )
    labels = tuple(m.label for m in file.marker)
    for label in labels:
        if labels.count(label) > 1:
            raise _fault(source, f"marker '{label}' is there {labels.count(label)} times", "marker")


def load_model(path: Path | str) -> SubjectModel:
    """Read a model that `save_model` wrote, or that was edited by hand.

    Parameters
    ----------
    path : Path or str
        The model file.

    Returns
    -------
    SubjectModel
        The model, SI units.

    Raises
    ------
    InputError
        One line: file, entry, what was found, what is allowed.
    """
    source = Path(path)

    try:
        file = read_validated(_File, source, parse_float=Decimal)
    except InvalidOperation:
        raise _fault(source, "a number has more digits than can be read") from None
    if file.format != FORMAT:
        raise _fault(source, f"found {file.format}; allowed: {FORMAT}", "format")
    values: dict[str, Array] = {}
    nominal: dict[str, Array] = {}
    for table in ("joint_parameters", "inertial_parameters", "zero_angles"):
        names, units, _ = _TABLES[table]
        found: dict[str, _Value] = getattr(file, table)
        require_known(found, names, "parameter", source=source, field=table)
        missing = [name for name in names if name not in found]
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise _fault(source, f"'{missing[0]}'{more} missing", table)
        in_units = [(found[name], unit) for name, unit in zip(names, units, strict=True)]
        values[_ARRAYS[table]] = np.array([_convert_to_si(e.value, unit) for e, unit in in_units])
        nominal[_ARRAYS[table]] = np.array(
            [_convert_to_si(e.nominal, unit) for e, unit in in_units]
        )
    _check_entries(file, source)
    labels, s = tuple(m.label for m in file.marker), file.subject
    measured = {f: (getattr(s, name), unit) for f, (name, unit) in _MEASURED.items()}
    return SubjectModel(
        subject=Subject(
            s.name,
            _convert_to_si(s.mass_kg, "kg"),
            _convert_to_si(s.height_m, "m"),
            s.sex,
            height_error=_convert_to_si(s.height_error_m, "m"),
            knee_width={
                side: _convert_to_si(width, "mm") for side, width in s.knee_width_mm.items()
            },
            ankle_width={
                side: _convert_to_si(width, "mm") for side, width in s.ankle_width_mm.items()
            },
            leg_length={
                side: _convert_to_si(length, "mm") for side, length in s.leg_length_mm.items()
            },
            session=s.session,
            record=PatientRecord(**s.record),
            **{
                f: None if value is None else _convert_to_si(value, unit)
                for f, (value, unit) in measured.items()
            },
        ),
        parameters=Parameters(**values),
        nominal=Parameters(**nominal),
        markers=MarkerPlacement(
            labels,
            tuple(m.segment for m in file.marker),
            np.array([_convert_position(m.position_mm) for m in file.marker]).reshape(-1, 3),
            np.array([_convert_to_si(m.weight, "kg") for m in file.marker]),
        ),
        frozen=tuple(file.frozen),
        posture={name: _convert_to_si(angle, "deg") for name, angle in file.posture_deg.items()},
        landmarks={
            name: (place.segment, np.array(_convert_position(place.position_mm)))
            for name, place in file.landmarks.items()
        },
        noise=file.noise,
        notes=tuple(file.notes),
    )


def _convert_position(values: list[Decimal]) -> list[float]:
    return [_convert_to_si(v, "mm") for v in values]
