"""Tables of the TOML files that users write, as their schemas tell them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from gaitcal.cohort.people import CohortFile, ListedPerson
from gaitcal.io.examples import examples
from gaitcal.model import marker_set
from gaitcal.study.settings import CalibrationSettings, ParameterPriorTable, PlateErrorTable
from gaitcal.study.study_file import Markers, StudyFile, SubjectTable, TrialTable, TruthTable

TABLES: Final[dict[str, type[BaseModel]]] = {
    "study": StudyFile,
    "subject": SubjectTable,
    "markers": Markers,
    "trial": TrialTable,
    "calibration": CalibrationSettings,
    "plate_error": PlateErrorTable,
    "joint_prior": ParameterPriorTable,
    "truth": TruthTable,
    "cohort": CohortFile,
    "person": ListedPerson,
    "marker_set": marker_set._File,
}
"""Word in a page -> the table it stands for."""
OF_STUDY: Final = ("subject", "markers", "trial", "calibration", "plate_error", "joint_prior", "truth")
_PLAIN: Final = {float: "number", int: "whole number", str: "text", bool: "true or false", type(None): ""}


@dataclass(frozen=True, kw_only=True)
class Field:
    """One key of a table."""

    name: str
    takes: str
    default: str
    required: bool
    text: str


def _words(annotation: Any) -> list[str]:
    """What a key takes, in words."""
    origin = get_origin(annotation)
    if origin is Literal:
        return [f'`"{word}"`' for word in get_args(annotation)]
    if annotation in _PLAIN:
        return [_PLAIN[annotation]]
    if origin is dict:
        return ["table"]
    if origin is tuple:
        return ["list"]
    if origin is list:
        return ["list"]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return ["table"]
    found = [word for part in get_args(annotation) for word in _words(part)]
    return found or (["path"] if getattr(annotation, "__name__", "") == "Path" else [])


def _limits(field: FieldInfo) -> str:
    low = next((f"> {m.gt:g}" for m in field.metadata if getattr(m, "gt", None) is not None), "") or next(
        (f"≥ {m.ge:g}" for m in field.metadata if getattr(m, "ge", None) is not None), ""
    )
    high = next((f"≤ {m.le:g}" for m in field.metadata if getattr(m, "le", None) is not None), "")
    return " and ".join(filter(None, (low, high)))


def _default(field: FieldInfo) -> str:
    value = field.default
    if value is PydanticUndefined or value is None or value == {} or value == () or value == "":
        return ""
    if isinstance(value, BaseModel):
        inner = (f"{name} = {number:g}" for name, number in value.model_dump().items() if isinstance(number, float))
        return f"`{{ {', '.join(inner)} }}`" if isinstance(value, PlateErrorTable) else ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value:g}`"


def fields(table: str) -> tuple[Field, ...]:
    """The keys of a table, in order."""
    out = []
    for name, field in TABLES[table].model_fields.items():
        words = [word for word in dict.fromkeys(_words(field.annotation)) if word]
        limits = _limits(field)
        out.append(
            Field(
                name=field.alias or name,
                takes=" or ".join(words) + (f", {limits}" if limits else ""),
                default=_default(field),
                required=field.is_required(),
                text=field.description or "",
            )
        )
    return tuple(out)


def markdown(table: str) -> str:
    """A table of the keys: what each takes, what holds unless it is given, what it means."""
    lines = ["| key | takes | unless given | meaning |", "|---|---|---|---|"]
    for f in fields(table):
        default = "needed" if f.required else f.default
        lines.append(f"| `{f.name}` | {f.takes} | {default} | {f.text.replace('|', chr(92) + '|')} |")
    return "\n".join(lines)


def marker_sets() -> str:
    """The built-in marker sets, each with its own description."""
    lines = ["| set | worn as |", "|---|---|"]
    lines += [f"| `{name}` | {marker_set.load_marker_set(name).description} |" for name in marker_set.built_in_sets()]
    return "\n".join(lines)


def public_examples() -> str:
    """The public recordings that `gaitcal example` fetches."""
    lines = ["| example | recordings | published by | licence |", "|---|---|---|---|"]
    lines += [f"| `{one.name}` | {one.title} | {one.of} | {one.licence} |" for one in examples()]
    return "\n".join(lines)
