"""The public names of the package by what they are for, as `python_names.toml` has them, and what they take."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import gaitcal
from gaitcal.io.toml import tomllib

_READ = tomllib.loads(Path(__file__).with_name("python_names.toml").read_text(encoding="utf-8"))
GROUPS: Final[dict[str, list[str]]] = _READ["groups"]


def ungrouped() -> set[str]:
    """Public names in no group, or in a group and not public."""
    return set(gaitcal.__all__) ^ {name for names in GROUPS.values() for name in names}


def undocumented() -> list[str]:
    """Public functions and classes, and their public members and fields, that nothing is said about.

    Needs griffe, which the extra `docs` brings; empty without it.
    """
    if find_spec("griffe") is None:
        return []
    griffe = import_module("griffe")
    package = griffe.load("gaitcal", search_paths=[Path(gaitcal.__file__).parents[1]], resolve_aliases=True)
    out = []
    for name in gaitcal.__all__:
        found = package[name].final_target
        members = found.members.values() if found.is_class else ()
        said = [(name, found), *((f"{name}.{m.name}", m) for m in members if not m.name.startswith("_"))]
        out += [full for full, object_ in said if object_.docstring is None and not object_.is_alias]
    return out


def markdown(group: str) -> str:
    """Directives for the public names of a group, or for the modules (`inside`)."""
    names = _READ["inside"] if group == "inside" else [f"gaitcal.{name}" for name in GROUPS[group]]
    return "\n\n".join(f"::: {name}" for name in names)
