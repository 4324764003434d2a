"""Settings of `[calibration]` from the command line."""

from __future__ import annotations

import sys

from gaitcal import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def changed_settings(pairs: list[str]) -> dict[str, object]:
    """`key=value` as a study file has it; a word needs no quotes.

    Raises
    ------
    InputError
        There is no `=`.
    """
    out: dict[str, object] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise InputError(f"found '{pair}'; allowed: key=value", field="--set")
        try:
            out[key.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            out[key.strip()] = value.strip()
    return out
