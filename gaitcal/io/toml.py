"""TOML files a user writes: read with one-line errors, written back. Also the one check that a named file is there.

What is installed: where the data folder `models/` lies, and versions of packages.

The data folder is inside the installed package, or at the top of a source checkout.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

from gaitcal.codes import Code
from gaitcal.errors import GaitcalError, InputError, nearest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_BYTES = 100_000
"""No TOML file that a person writes comes near this size: a study of 300 trials has 40 kB."""
MAX_DOTS = 30
"""Parts of a dotted key or table name; the parser's time grows with the square of their number."""


_DOTTED = re.compile(rf"(?:[\w\"'-]{{1,200}}[ \t]*\.[ \t]*){{{MAX_DOTS},}}")
"""More parts of a key than any table has; a number or a sentence has no such row of dots."""


def require_file(path: Path, *, source: object = None, field: str | None = None) -> Path:
    """Return `path` if a regular file lies there.

    Raises
    ------
    InputError
        Names the path and what lies beside it: the nearest name, or the first few names of the folder.
    """
    # os.path answers False where pathlib raises: over-long names, embedded null characters.
    if os.path.isfile(path):  # noqa: PTH113
        return path
    shown = repr(str(path))[1:-1]
    if len(shown) > 300:
        shown = f"{shown[:140]}...{shown[-140:]}"
    if os.path.isdir(path):  # noqa: PTH112
        raise InputError(f"'{shown}' is a folder, a file is needed", source=source, field=field, code=Code.NO_FILE)
    if os.path.exists(path):  # noqa: PTH110
        raise InputError(f"'{shown}' is no regular file", source=source, field=field, code=Code.NO_FILE)
    raise InputError(f"no such file: '{shown}'{_beside(path)}", source=source, field=field, code=Code.NO_FILE)


def _beside(path: Path) -> str:
    try:
        names = sorted(entry.name for entry in os.scandir(path.parent) if entry.is_file())
    except (OSError, ValueError):
        return f"; the folder '{path.parent.name}' does not exist"
    hint = nearest(path.name, names)
    if hint or not names:
        return hint or "; the folder is empty of files"
    return "; the folder holds " + ", ".join(f"'{name}'" for name in names[:4]) + (", ..." if len(names) > 4 else "")


def read_toml(path: Path, parse_float: Callable[[str], Any] = float, most_bytes: int = MAX_BYTES) -> dict[str, Any]:
    """Read the TOML file at `path` (UTF-8, a byte order mark is allowed), numbers with a point by `parse_float`.

    Raises
    ------
    InputError
        Missing or unreadable, over `most_bytes`, nested absurdly, not UTF-8, or not TOML (with the line).
    """
    require_file(path)
    try:
        with path.open("rb") as stream:
            raw = stream.read(most_bytes + 1)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=path, code=Code.UNREADABLE) from None
    if len(raw) > most_bytes:
        raise InputError(
            f"over {most_bytes // 1000} kB: no TOML file of this kind is that long", source=path, code=Code.TOML
        )
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError("found UTF-16 text; save the file as UTF-8", source=path, code=Code.NOT_TEXT)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"line {line} is not UTF-8 text; save the file as UTF-8", source=path, code=Code.NOT_TEXT
        ) from None
    if deep := _DOTTED.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise InputError(
            f"line {line} nests tables over {MAX_DOTS} deep; no file of this kind does", source=path, code=Code.TOML
        )
    try:
        return tomllib.loads(text, parse_float=parse_float)
    except RecursionError:
        raise InputError("not valid TOML: brackets nested too deeply", source=path, code=Code.TOML) from None
    except ValueError as error:  # TOMLDecodeError, and numbers too long to be read
        message = str(error).replace("at end of document", f"at the end, line {text.count(chr(10)) + 1}")
        hint = "; a table that repeats is written [[name]], with two brackets" if "Cannot declare" in message else ""
        hint += "; in double quotes a backslash starts an escape: use single quotes or '/'" if "\\" in message else ""
        raise InputError(f"not valid TOML: {message}{hint}", source=path, code=Code.TOML) from None


def toml_value(value: object) -> str:
    """`value` as TOML: text, number, truth value, path, list, or a mapping as an inline table."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Path):
        return toml_value(value.as_posix())
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{toml_value(str(k))} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    raise TypeError(f"{type(value).__name__} has no TOML form")


def toml_table(header: str, content: Mapping[str, object]) -> str:
    """A table as text: `header` (`[subject]`, `[[trial]]`) and one line a key. Keys must be bare TOML keys."""
    return "\n".join([header, *(f"{key} = {toml_value(value)}" for key, value in content.items())]) + "\n"


def models_path() -> Path:
    """The folder `models/`: linkage, marker sets, anthropometric tables, the nominal subject.

    A wheel carries it as `gaitcal/models`; a source checkout, also one installed in editable mode, has it beside the
    package.

    Raises
    ------
    GaitcalError
        The installation is incomplete: neither place holds the folder.
    """
    package = Path(str(files("gaitcal")))
    for folder in (package / "models", package.parent / "models"):
        if (folder / "nominal_subject.json").is_file():
            return folder
    raise GaitcalError(f"{package}: the data folder 'models' is missing; install gaitcal again")


def package_version(name: str) -> str:
    """Version of an installed package, or `unknown`."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
