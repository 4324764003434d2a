"""Read, check and write TOML files of users; find the data folder `models/` and package versions.

Every error in a file is one line with file, field, the value found and the allowed ones.
"""

import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from gaitcal.errors import Code, GaitcalError, InputError, suggest_name

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# No TOML file that a person writes comes near this size: a study of 300 trials has 40 kB
MAX_BYTES = 100_000
# Parts of a dotted key or table name; the parser's time grows with the square of their number
MAX_DOTS = 30


_DOTTED = re.compile(rf"(?:[\w\"'-]{{1,200}}[ \t]*\.[ \t]*){{{MAX_DOTS},}}")
"""More parts of a key than any table has; numbers and sentences have no such row of dots."""


def require_file(path: Path, *, source: object = None, field: str | None = None) -> Path:
    """Require that a regular file exists.

    Parameters
    ----------
    path
        The file.
    source, field
        Where the file is named, for the message.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        There is no such file; the message has the nearest name in the folder, or the first names.
    """
    # os.path answers False where pathlib raises: over-long names, embedded null characters.
    if os.path.isfile(path):  # noqa: PTH113
        return path
    name = repr(str(path))[1:-1]
    if len(name) > 300:
        name = f"{name[:140]}...{name[-140:]}"
    if os.path.isdir(path):  # noqa: PTH112
        message = f"'{name}' is a folder, a file is needed"
    elif os.path.exists(path):  # noqa: PTH110
        message = f"'{name}' is no regular file"
    else:
        message = f"no such file: '{name}'{_describe_neighbours(path)}"
    raise InputError(message, source=source, field=field, code=Code.NO_FILE)


def _describe_neighbours(path: Path) -> str:
    try:
        names = sorted(entry.name for entry in os.scandir(path.parent) if entry.is_file())
    except (OSError, ValueError):
        return f"; the folder '{path.parent.name}' does not exist"
    hint = suggest_name(path.name, names)
    if hint or not names:
        return hint or "; the folder has no files"
    return (
        "; the folder contains "
        + ", ".join(f"'{name}'" for name in names[:4])
        + (", ..." if len(names) > 4 else "")
    )


def read_toml(
    path: Path, parse_float: Callable[[str], Any] = float, most_bytes: int = MAX_BYTES
) -> dict[str, Any]:
    """Read a TOML file (UTF-8, with or without byte order mark).

    Parameters
    ----------
    path
        The file.
    parse_float
        Conversion of numbers with a point.
    most_bytes
        Largest size, bytes.

    Returns
    -------
    dict
        Content of the file.

    Raises
    ------
    InputError
        The file is missing, unreadable, too long, nested too deeply, not UTF-8 or not TOML.
    """
    require_file(path)

    def fault(message: str, code: Code = Code.TOML) -> InputError:
        return InputError(message, source=path, code=code)

    try:
        with path.open("rb") as stream:
            raw = stream.read(most_bytes + 1)
    except OSError as error:
        raise fault(f"cannot be read: {error.strerror}", Code.UNREADABLE) from None
    if len(raw) > most_bytes:
        raise fault(f"over {most_bytes // 1000} kB: no TOML file of this kind is that long")
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise fault("found UTF-16 text; save the file as UTF-8", Code.NOT_TEXT)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise fault(
            f"line {line} is not UTF-8 text; save the file as UTF-8", Code.NOT_TEXT
        ) from None
    if deep := _DOTTED.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise fault(f"line {line} nests tables over {MAX_DOTS} deep; no file of this kind does")
    try:
        return tomllib.loads(text, parse_float=parse_float)
    except RecursionError:
        raise fault("not valid TOML: brackets nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError, and numbers too long to be read
        message = str(error).replace(
            "at end of document", f"at the end, line {text.count(chr(10)) + 1}"
        )
        hint = (
            "; a table that repeats is written [[name]], with two brackets"
            if "Cannot declare" in message
            else ""
        )
        hint += (
            "; in double quotes a backslash starts an escape: use single quotes or '/'"
            if "\\" in message
            else ""
        )
        raise fault(f"not valid TOML: {message}{hint}") from None


def format_toml_value(value: object) -> str:
    """Format text, number, truth value, path, list or mapping (inline table) as TOML.

    Raises
    ------
    TypeError
        The value has no TOML form.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Path):
        return format_toml_value(value.as_posix())
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, Mapping):
        return (
            "{ "
            + ", ".join(
                f"{format_toml_value(str(k))} = {format_toml_value(v)}" for k, v in value.items()
            )
            + " }"
        )
    if isinstance(value, Sequence):
        return "[" + ", ".join(format_toml_value(v) for v in value) + "]"
    raise TypeError(f"{type(value).__name__} has no TOML form")


def format_toml_table(header: str, content: Mapping[str, object]) -> str:
    """Format a table: `header` (`[subject]`, `[[trial]]`), and one line per key; keys are bare."""
    return (
        "\n".join(
            [header, *(f"{key} = {format_toml_value(value)}" for key, value in content.items())]
        )
        + "\n"
    )


# ----------------------------------------------------------------------- tables checked by pydantic

# pydantic's name of an error -> what is allowed instead; the names in braces are entries of the
# error's context
_ALLOWED = {
    "string_type": "text in quotes",
    "path_type": "a file name in quotes",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "dict_type": "a table, {{ name = value, ... }}",
    "list_type": "a list, [a, b]",
    "tuple_type": "a list, [a, b]",
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number at least {ge:g}",
    "less_than": "a number less than {lt:g}",
    "less_than_equal": "a number at most {le:g}",
    "is_instance_of": "an instance of {class}",
    "string_too_short": "String should have at least {min_length} character{s}",
    "too_short": "{field_type} should have at least {min_length} item{s} after validation, not "
    "{actual_length}",
    "too_long": "{field_type} should have at most {max_length} item{s} after validation, not "
    "{actual_length}",
}


def format_value(value: object) -> str:
    """Format a value for a message: text quoted, in one line, cut if long.

    Parameters
    ----------
    value
        Any value of a TOML file.

    Returns
    -------
    str
        At most 60 characters.
    """
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        # An integer of thousands of digits, or a table nested as deeply
        text = f"a {type(value).__name__} too large to show"
    return text if len(text) <= 60 else f"{text[:57]}..."


class Table(BaseModel):
    """Table of a file: no unknown keys, no conversion between types, immutable."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


_T = TypeVar("_T", bound=Table)


def read_validated(
    table: type[_T],
    path: Path,
    parse_float: Callable[[str], Any] = float,
    most_bytes: int = MAX_BYTES,
) -> _T:
    """Read a TOML file as a table.

    Parameters
    ----------
    table
        Class of the table.
    path
        The file.
    parse_float
        Conversion of numbers with a point.
    most_bytes
        Largest size, bytes.

    Returns
    -------
    Table
        The checked content.

    Raises
    ------
    InputError
        The file cannot be read, or its content is not allowed.
    """
    return validate_table(table, read_toml(path, parse_float, most_bytes), path)


def validate_table(table: type[_T], content: Mapping[str, object], source: object) -> _T:
    """Check the content of a file as a table.

    Parameters
    ----------
    table
        Class of the table.
    content
        Keys and values.
    source
        The file, for the message.

    Returns
    -------
    Table
        The checked content.

    Raises
    ------
    InputError
        The first value that is not allowed.
    """
    try:
        return table.model_validate(content)
    except ValidationError as error:
        raise _convert_error(error, table, source) from None


def require_known(
    names: Iterable[str],
    allowed: Iterable[str],
    kind: str,
    *,
    source: Path,
    field: str,
    listed: bool = False,
) -> None:
    """Require that all names are allowed.

    Parameters
    ----------
    names
        Names to check.
    allowed
        Allowed names.
    kind
        Noun for a name, such as "marker".
    source, field
        File and place for the message.
    listed
        Whether the message lists all allowed names if none is near.

    Raises
    ------
    InputError
        The first name that is not allowed.
    """
    known = list(allowed)
    for name in names:
        if name not in known:
            hint = suggest_name(name, known) or (f"; allowed: {', '.join(known)}" if listed else "")
            message = f"found {format_value(name)}, which is no {kind}{hint}"
            raise InputError(message, source=source, field=field, code=Code.UNKNOWN_FIELD)


def _convert_error(error: ValidationError, model: type[BaseModel], source: object) -> InputError:
    """Convert the first error to an `InputError`; a misspelt key precedes keys missing because of
    it.
    """
    details = error.errors(include_url=False)
    first = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
    location, kind, found = first["loc"], first["type"], first["input"]
    context: dict[str, Any] = first.get("ctx", {})
    if kind == "extra_forbidden":
        allowed = _list_keys(_find_table_and_field(model, location[:-1])[0])
        close = suggest_name(str(location[-1]), allowed)
        message = (
            f"unknown key {format_value(location[-1])}{close or '; allowed: ' + ', '.join(allowed)}"
        )
        return InputError(
            message, source=source, field=_format_location(location[:-1]), code=Code.UNKNOWN_FIELD
        )
    table, field = _find_table_and_field(model, location)
    if kind == "missing":
        message = f"missing: {field.description}" if field and field.description else "missing"
    elif kind == "value_error":
        message = str(context["error"])
    elif kind == "literal_error" and field is not None:
        choices = _list_choices(field.annotation)
        close = suggest_name(found, choices) if isinstance(found, str) else ""
        *others, last = map(repr, choices)
        message = f"found {format_value(found)}; allowed: {', '.join(others)} or {last}{close}"
    elif kind in {"model_type", "model_attributes_type"}:
        message = (
            f"found {format_value(found)}; allowed: a table with {', '.join(_list_keys(table))}"
        )
    else:
        message = f"found {format_value(found)}; allowed: {_describe_allowed(kind, context, field)}"
    code = Code.MISSING_FIELD if kind == "missing" else Code.BAD_VALUE
    return InputError(message, source=source, field=_format_location(location), code=code)


def _describe_allowed(kind: str, context: Mapping[str, Any], field: FieldInfo | None) -> str:
    """Describe allowed values by the kind of error; else by the description of the field."""
    if kind not in _ALLOWED:
        return field.description or "another value" if field else "another value"
    length = context.get("min_length", context.get("max_length"))
    return _ALLOWED[kind].format_map({**context, "s": "" if length == 1 else "s"})


def _format_location(location: Sequence[str | int]) -> str | None:
    """Format a location in the file as users write it: `trial[2].file`; None for the whole file."""
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        else:
            name = part if re.fullmatch(r"[\w-]{1,60}", part) else format_value(part)
            text += f".{name}" if text else name
    return text or None


def _find_table_and_field(
    model: type[BaseModel], location: Sequence[str | int]
) -> tuple[type[BaseModel], FieldInfo | None]:
    """Find the table of a location, and the last field on the way to it.

    Indices of lists and free keys of a dict are no fields; then the field is the list or dict.
    """
    last = None
    for part in location:
        for name, field in model.model_fields.items():
            if part in (name, field.alias):
                model, last = _find_model(field.annotation) or model, field
                break
    return model, last


def _find_model(annotation: Any) -> type[BaseModel] | None:
    """Find the model in an annotation such as `tuple[Trial, ...]`; None if there is none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(
        (found for argument in get_args(annotation) if (found := _find_model(argument))), None
    )


def _list_choices(annotation: Any) -> list[str]:
    """List the literals in an annotation such as `dict[str, Literal["r", "l"]] | None`."""
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [word for argument in get_args(annotation) for word in _list_choices(argument)]


def _list_keys(table: type[BaseModel]) -> list[str]:
    return [field.alias or name for name, field in table.model_fields.items()]


# -------------------------------------------------------------------------------- what is installed


def find_models_folder() -> Path:
    """Find the folder `models/`: linkage, marker sets, anthropometric tables, nominal subject.

    A wheel has it as `gaitcal/models`; a source checkout has it beside the package.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    GaitcalError
        The installation is incomplete.
    """
    package = Path(str(files("gaitcal")))
    for folder in (package / "models", package.parent / "models"):
        if (folder / "nominal_subject.json").is_file():
            return folder
    raise GaitcalError(f"{package}: the data folder 'models' is missing; install gaitcal again")


def get_package_version(name: str) -> str:
    """Return the version of an installed package, or `unknown`."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
