"""Tables of the TOML files that users write, and what is wrong with one in one line: field, found, allowed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from gaitcal.errors import InputError, nearest

# pydantic's names of error types -> what to write instead
_ALLOWED = {
    "string_type": "text in quotes",
    "path_type": "a file name in quotes",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "dict_type": "a table, { name = value, ... }",
    "list_type": "a list, [a, b]",
    "tuple_type": "a list, [a, b]",
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


def frequency(*words: str) -> BeforeValidator:
    """A cut-off frequency in Hz, or one of `words`."""

    def check(value: object) -> float | str:
        if isinstance(value, str) and value in words:
            return value
        if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 1e6:
            return float(value)
        raise ValueError(
            f"found {shown(value)}; allowed: a frequency in Hz, or " + " or ".join(f"'{w}'" for w in words)
        )

    return BeforeValidator(check)


def input_error(error: ValidationError, model: type[BaseModel], source: object) -> InputError:
    """The first mistake in `error` as an `InputError`; a misspelt key comes before what is missing because of it."""
    details = error.errors(include_url=False)
    first = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
    location, kind, found = first["loc"], first["type"], first["input"]
    context: dict[str, Any] = first.get("ctx", {})
    if kind == "extra_forbidden":
        allowed = _keys_at(model, location[:-1])
        close = nearest(str(location[-1]), allowed)
        message = f"unknown key {shown(location[-1])}{close or '; allowed: ' + ', '.join(allowed)}"
        return InputError(message, source=source, field=_field(location[:-1]))
    if kind == "missing":
        message = f"missing{_description(model, location)}"
    elif kind == "value_error":
        message = str(context["error"])
    elif kind == "literal_error":
        allowed = re.findall(r"'([^']*)'", context["expected"])
        close = nearest(found, allowed) if isinstance(found, str) else ""
        message = f"found {shown(found)}; allowed: {context['expected']}{close}"
    elif kind in {"model_type", "model_attributes_type"}:
        message = f"found {shown(found)}; allowed: a table with {', '.join(_keys_at(model, location))}"
    else:
        limits = (("gt", "greater than"), ("ge", "at least"), ("lt", "less than"), ("le", "at most"))
        limit = next((f"a number {words} {context[key]:g}" for key, words in limits if key in context), None)
        allowed_text = _ALLOWED.get(kind) or limit or first["msg"].removeprefix("Input should be ")
        message = f"found {shown(found)}; allowed: {allowed_text}"
    return InputError(message, source=source, field=_field(location))


def _field(location: Sequence[str | int]) -> str | None:
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        else:
            name = part if re.fullmatch(r"[\w-]{1,60}", part) else shown(part)
            text += f".{name}" if text else name
    return text or None


def _model_at(model: type[BaseModel], location: Sequence[str | int]) -> type[BaseModel]:
    for part in location:
        for name, field in model.model_fields.items():
            if part in (name, field.alias):
                model = _model_in(field.annotation) or model
    return model


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for argument in get_args(annotation) if (found := _model_in(argument))), None)


def _keys_at(model: type[BaseModel], location: Sequence[str | int]) -> list[str]:
    return [field.alias or name for name, field in _model_at(model, location).model_fields.items()]


def _description(model: type[BaseModel], location: Sequence[str | int]) -> str:
    parent = _model_at(model, location[:-1])
    for name, field in parent.model_fields.items():
        if location[-1] in (name, field.alias) and field.description:
            return f": {field.description}"
    return ""
