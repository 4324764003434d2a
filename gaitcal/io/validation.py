"""Tables of the TOML files that users write, and what is wrong with one in one line: field, found, allowed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from gaitcal.codes import Code
from gaitcal.errors import InputError, nearest
from gaitcal.io.toml import MAX_BYTES, read_toml

# pydantic's name of an error -> what is allowed instead; the names in braces are entries of the error's context
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
    "too_short": "{field_type} should have at least {min_length} item{s} after validation, not {actual_length}",
    "too_long": "{field_type} should have at most {max_length} item{s} after validation, not {actual_length}",
}


def shown(value: object) -> str:
    """`value` as a message shows it: quoted if text, in one line, cut off where long."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, a table nested as deeply
        text = f"a {type(value).__name__} too large to show"
    return text if len(text) <= 60 else f"{text[:57]}..."


class Table(BaseModel):
    """A table of the file: no unknown keys, no conversion between types, never changed."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


_T = TypeVar("_T", bound=Table)


def read_validated(
    table: type[_T], path: Path, parse_float: Callable[[str], Any] = float, most_bytes: int = MAX_BYTES
) -> _T:
    """The TOML file at `path` as a table; InputError, in one line, where it is none."""
    return validated(table, read_toml(path, parse_float, most_bytes), path)


def validated(table: type[_T], content: Mapping[str, object], source: object) -> _T:
    """What a file says as a table; InputError, in one line, where it is none. `source`: the file, for the message."""
    try:
        return table.model_validate(content)
    except ValidationError as error:
        raise _input_error(error, table, source) from None


def require_known(
    names: Iterable[str], allowed: Iterable[str], kind: str, *, source: Path, field: str, listed: bool = False
) -> None:
    """InputError for the first name that is not allowed, with the nearest that is, or else (`listed`) with all."""
    known = list(allowed)
    for name in names:
        if name not in known:
            hint = nearest(name, known) or (f"; allowed: {', '.join(known)}" if listed else "")
            raise InputError(
                f"found {shown(name)}, which is no {kind}{hint}", source=source, field=field, code=Code.UNKNOWN_FIELD
            )


def _input_error(error: ValidationError, model: type[BaseModel], source: object) -> InputError:
    """The first mistake in `error` as an `InputError`; a misspelt key comes before what is missing because of it."""
    details = error.errors(include_url=False)
    first = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
    location, kind, found = first["loc"], first["type"], first["input"]
    context: dict[str, Any] = first.get("ctx", {})
    if kind == "extra_forbidden":
        allowed = _keys(_table_and_field(model, location[:-1])[0])
        close = nearest(str(location[-1]), allowed)
        message = f"unknown key {shown(location[-1])}{close or '; allowed: ' + ', '.join(allowed)}"
        return InputError(message, source=source, field=_field_name(location[:-1]), code=Code.UNKNOWN_FIELD)
    table, field = _table_and_field(model, location)
    if kind == "missing":
        message = f"missing: {field.description}" if field and field.description else "missing"
    elif kind == "value_error":
        message = str(context["error"])
    elif kind == "literal_error" and field is not None:
        choices = _choices(field.annotation)
        close = nearest(found, choices) if isinstance(found, str) else ""
        *others, last = map(repr, choices)
        message = f"found {shown(found)}; allowed: {', '.join(others)} or {last}{close}"
    elif kind in {"model_type", "model_attributes_type"}:
        message = f"found {shown(found)}; allowed: a table with {', '.join(_keys(table))}"
    else:
        message = f"found {shown(found)}; allowed: {_allowed(kind, context, field)}"
    code = Code.MISSING_FIELD if kind == "missing" else Code.BAD_VALUE
    return InputError(message, source=source, field=_field_name(location), code=code)


def _allowed(kind: str, context: Mapping[str, Any], field: FieldInfo | None) -> str:
    """What is allowed instead, by the kind of error; of a kind that is not in the list, what the field is about."""
    if kind not in _ALLOWED:
        return field.description or "another value" if field else "another value"
    length = context.get("min_length", context.get("max_length"))
    return _ALLOWED[kind].format_map({**context, "s": "" if length == 1 else "s"})


def _field_name(location: Sequence[str | int]) -> str | None:
    """A place in the file as people write it: `trial[2].file`; None for the file as a whole."""
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        else:
            name = part if re.fullmatch(r"[\w-]{1,60}", part) else shown(part)
            text += f".{name}" if text else name
    return text or None


def _table_and_field(model: type[BaseModel], location: Sequence[str | int]) -> tuple[type[BaseModel], FieldInfo | None]:
    """The table that `location` leads to or ends in, and the last field on the way there, if any.

    Numbers in lists and the free keys of a dict are no fields: there the field is the one that holds the list or dict.
    """
    last = None
    for part in location:
        for name, field in model.model_fields.items():
            if part in (name, field.alias):
                model, last = _model_in(field.annotation) or model, field
                break
    return model, last


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The model that an annotation like `tuple[Trial, ...]` is about; None where it is about none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for argument in get_args(annotation) if (found := _model_in(argument))), None)


def _choices(annotation: Any) -> list[str]:
    """All words that the literals in an annotation like `dict[str, Literal["r", "l"]] | None` allow."""
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [word for argument in get_args(annotation) for word in _choices(argument)]


def _keys(table: type[BaseModel]) -> list[str]:
    return [field.alias or name for name, field in table.model_fields.items()]
