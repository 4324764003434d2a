"""Tables of Markdown; and those of the TOML files that users write, as their schemas tell them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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


def table_of(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Rows of cells; a bar within one is escaped."""
    cells = (" | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) for row in rows)
    return "\n".join([f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *(f"| {row} |" for row in cells)])


@dataclass(frozen=True, kw_only=True)
class Field:
    name: str
    takes: str
    default: str
    required: bool
    text: str


def _words(annotation: Any) -> list[str]:
    origin = get_origin(annotation)
    if origin is Literal:
        return [f'`"{word}"`' for word in get_args(annotation)]
    if annotation in _PLAIN:
        return [_PLAIN[annotation]]
    if origin in (dict, tuple, list):
        return ["table" if origin is dict else "list"]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return ["table"]
    found = [word for part in get_args(annotation) for word in _words(part)]
    return found or (["path"] if getattr(annotation, "__name__", "") == "Path" else [])


def _limits(field: FieldInfo) -> str:
    signs = {"gt": ">", "ge": "≥", "le": "≤"}
    found = {k: v for m in field.metadata for k in signs if (v := getattr(m, k, None)) is not None}
    return " and ".join(f"{signs[k]} {found[k]:g}" for k in signs if k in found)


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
    rows = ((f"`{f.name}`", f.takes, "needed" if f.required else f.default, f.text) for f in fields(table))
    return table_of(("key", "takes", "unless given", "meaning"), rows)


def marker_sets() -> str:
    names = marker_set.built_in_sets()
    return table_of(("set", "worn as"), ((f"`{n}`", marker_set.load_marker_set(n).description) for n in names))


def public_examples() -> str:
    rows = ((f"`{one.name}`", one.title, one.of, one.licence) for one in examples())
    return table_of(("example", "recordings", "published by", "licence"), rows)
