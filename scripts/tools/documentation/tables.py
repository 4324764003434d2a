"""Tables of Markdown; and those of the TOML files that users write, as their schemas tell them."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from typer.models import ArgumentInfo, OptionInfo

from gaitcal.cli.application import COMMANDS, HELP, build_command_function
from gaitcal.cohort.cohort_people import CohortFile, ListedPerson
from gaitcal.cohort.one_person import COLUMNS
from gaitcal.io.examples import load_examples
from gaitcal.io.toml import tomllib
from gaitcal.model import marker_set
from gaitcal.study.settings import CalibrationSettings, ParameterPriorTable, PlateErrorTable
from gaitcal.study.study_file import Markers, StudyFile, SubjectTable, TrialTable, TruthTable

EVERYWHERE: Final = ("--quiet", "--verbose", "--help")
"""Options that every command has, told once."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    names: tuple[str, ...]
    """As they are typed: `--jobs`; of an argument its word in the usage, `DIR`."""
    takes: str
    """Words for its value; empty for a switch."""
    default: str
    required: bool
    argument: bool
    text: str


@dataclass(frozen=True)
class Command:
    name: str
    text: str
    example: str
    parameters: tuple[Parameter, ...]

    @property
    def usage(self) -> str:
        """`gaitcal check STUDY [options]`."""
        words = [p.names[0] for p in self.parameters if p.argument]
        needed = [
            f"{p.names[0]} {p.takes}" for p in self.parameters if p.required and not p.argument
        ]
        return " ".join(("gaitcal", self.name, *words, *needed, "[options]"))


def _value(kind: object, info: OptionInfo) -> str:
    """What an option takes: its own word, or one of its type, with its range."""
    names = {int: "N", float: "NUMBER", Path: "PATH", str: "TEXT"}
    members = set(get_args(kind)) or {kind}
    word = info.metavar or next(
        (word for of, word in names.items() if of in members or list[of] in members), "TEXT"
    )
    if info.min is None and info.max is None:
        return word
    return (
        f"{word} ({info.min:g} to {info.max:g})"
        if info.max is not None
        else f"{word} (≥ {info.min:g})"
    )


def _parameter(name: str, annotation: Any, default: object) -> Parameter:
    kind, info = get_args(annotation)[:2]
    argument = isinstance(info, ArgumentInfo)
    flag = kind is bool
    needed = default is inspect.Parameter.empty
    dashed = "--" + name.replace("_", "-")
    declared = tuple(
        d for d in (info.default, *(info.param_decls or ())) if isinstance(d, str)
    )  # typer, in Annotated
    names = (info.metavar or name.upper(),) if argument else declared or (dashed,)
    if flag and not argument and default is True:
        names = (dashed, dashed.replace("--", "--no-", 1))
    shown = not needed and default is not None and not (flag and default is False)
    return Parameter(
        names=tuple(names),
        takes="" if argument or flag else _value(kind, info),
        default=(f"{names[0]}" if flag else str(default)) if shown else "",
        required=needed,
        argument=argument,
        text=info.help or "",
    )


def commands() -> tuple[Command, ...]:
    out = []
    for name, (_, example) in COMMANDS.items():
        given = inspect.signature(build_command_function(name)).parameters.values()
        parameters = tuple(_parameter(p.name, p.annotation, p.default) for p in given)
        out.append(Command(name, HELP[name], example, parameters))
    return tuple(out)


def options_of(command: Command) -> tuple[Parameter, ...]:
    return tuple(p for p in command.parameters if not set(p.names) & set(EVERYWHERE))


def _names(parameter: Parameter) -> str:
    first = [f"`{name}`" for name in parameter.names]
    if parameter.takes:
        first[0] = f"`{parameter.names[0]} {parameter.takes.split(' ')[0]}`"
    return ", ".join(first)


def command_markdown(name: str) -> str:
    """Usage, what it does, its example, and a table of its arguments and options."""
    command = next(c for c in commands() if c.name == name)
    lines = [f'```text title="usage"\n{command.usage}\n```', "", command.text, ""]
    if command.example:
        lines += [f'```text title="example"\n{command.example}\n```', ""]
    if own := options_of(command):
        lines.append(table_of(("argument or option", "unless given", "meaning"), map(_row, own)))
    return "\n".join(lines)


def _row(p: Parameter) -> tuple[str, str, str]:
    default = "needed" if p.required else (f"`{p.default}`" if p.default else "")
    return _names(p), default, f"{p.text} {p.takes.partition(' ')[2]}".strip()


class ResultFile(NamedTuple):
    """A file, or those of one name in each trial (`motion/*.csv`); `table`: key of `TABLES`, empty
    for what is none.
    """

    pattern: str
    text: str
    table: str = ""


class Described(NamedTuple):
    """One column, or those of one pattern."""

    name: str
    unit: str
    text: str


_READ = tomllib.loads(Path(__file__).with_name("result_files.toml").read_text(encoding="utf-8"))
FILES: Final = {
    kind: tuple(ResultFile(*row) for row in rows) for kind, rows in _READ["files"].items()
}
"""Kind of folder -> its files."""
SUMMARY: Final[dict[str, str]] = _READ["summary"]
"""Keys of `summary.json`."""
TABLES: Final = {
    table: tuple(Described(*row) for row in rows) for table, rows in _READ["tables"].items()
}
"""Key of a table -> its columns, in order."""


def file_of(kind: str, name: str) -> ResultFile | None:
    """What is said of a file (`motion/walk.csv`) of a kind of folder; None where nothing is."""
    return next((file for file in FILES[kind] if fnmatchcase(name, file.pattern)), None)


def column_of(table: str, name: str) -> Described | None:
    """What is said of a column; None where nothing is."""
    return next((column for column in TABLES[table] if fnmatchcase(name, column.name)), None)


def files_markdown(kind: str) -> str:
    """A table of the files of a kind of folder; tables among them lead to their columns."""

    def row(file: ResultFile) -> tuple[str, str]:
        name = f"`{file.pattern.replace('*', 'NAME')}`"
        where = (
            "result-files.md#summaryjson" if file.table == "summary" else f"columns.md#{file.table}"
        )
        return f"[{name}]({where})" if file.table else name, file.text

    return table_of(("file", "holds"), map(row, FILES[kind]))


def columns_markdown(table: str) -> str:
    """A table of columns: of one table, of `summary.json`, or of `people` with all its measures."""
    if table == "summary":
        return table_of(
            ("key", "", "meaning"), ((f"`{name}`", "", text) for name, text in SUMMARY.items())
        )
    if table == "people":
        rows = [(f"`{c.name}`", c.unit, c.meaning) for c in COLUMNS]
    else:
        rows = [(f"`{c.name.replace('*', 'NAME')}`", c.unit, c.text) for c in TABLES[table]]
    return table_of(("column", "unit", "meaning"), rows)


SCHEMAS: Final[dict[str, type[BaseModel]]] = {
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
_PLAIN: Final = {
    float: "number",
    int: "whole number",
    str: "text",
    bool: "true or false",
    type(None): "",
}


def table_of(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Rows of cells; a bar within one is escaped."""
    cells = (
        " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) for row in rows
    )
    return "\n".join(
        [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *(f"| {row} |" for row in cells)]
    )


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
        inner = (
            f"{name} = {number:g}"
            for name, number in value.model_dump().items()
            if isinstance(number, float)
        )
        return f"`{{ {', '.join(inner)} }}`" if isinstance(value, PlateErrorTable) else ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value:g}`"


def fields(table: str) -> tuple[Field, ...]:
    out = []
    for name, field in SCHEMAS[table].model_fields.items():
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
    rows = (
        (f"`{f.name}`", f.takes, "needed" if f.required else f.default, f.text)
        for f in fields(table)
    )
    return table_of(("key", "takes", "unless given", "meaning"), rows)


def marker_sets() -> str:
    names = marker_set.list_built_in_sets()
    return table_of(
        ("set", "worn as"), ((f"`{n}`", marker_set.load_marker_set(n).description) for n in names)
    )


def public_examples() -> str:
    rows = ((f"`{one.name}`", one.title, one.publisher, one.licence) for one in load_examples())
    return table_of(("example", "recordings", "published by", "licence"), rows)
