"""Everything that the program has, against the page that explains it, and the pages that mention it
besides.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import gaitcal
from gaitcal.cohort.one_person import COLUMNS
from gaitcal.explanations import load_all_explanations
from gaitcal.io.toml import tomllib
from gaitcal.model.marker_set import list_built_in_sets
from scripts.tools.documentation import tables
from scripts.tools.documentation.tables import FILES, SUMMARY, TABLES

_READ = tomllib.loads(Path(__file__).with_name("python_names.toml").read_text(encoding="utf-8"))
GROUPS: Final[dict[str, list[str]]] = _READ["groups"]


def ungrouped() -> set[str]:
    """Public names in no group, or in a group and not public."""
    return set(gaitcal.__all__) ^ {name for names in GROUPS.values() for name in names}


def undocumented() -> list[str]:
    """Public functions and classes, and their public members and fields, that nothing is said
    about.

    Needs griffe, which the extra `docs` brings; empty without it.
    """
    if find_spec("griffe") is None:
        return []
    griffe = import_module("griffe")
    package = griffe.load(
        "gaitcal", search_paths=[Path(gaitcal.__file__).parents[1]], resolve_aliases=True
    )
    out = []
    for name in gaitcal.__all__:
        found = package[name].final_target
        members = found.members.values() if found.is_class else ()
        said = [
            (name, found),
            *((f"{name}.{m.name}", m) for m in members if not m.name.startswith("_")),
        ]
        out += [
            full for full, object_ in said if object_.docstring is None and not object_.is_alias
        ]
    return out


def names_markdown(group: str) -> str:
    """Directives for the public names of a group, or for the modules (`inside`)."""
    names = _READ["inside"] if group == "inside" else [f"gaitcal.{name}" for name in GROUPS[group]]
    return "\n\n".join(f"::: {name}" for name in names)


DOCS: Final = Path(__file__).resolve().parents[3] / "docs"
PLACE: Final = re.compile(r"^\{\{ ([a-z-]+(?:: [\w-]+)?) \}\}$", re.M)
TOLD: Final = ("tutorials", "how-to", "explanation")
"""Folders of pages that people wrote."""


@dataclass(frozen=True)
class Item:
    kind: str
    name: str
    place: str
    """Of the reference, as `command: check`."""
    text: str
    """What the reference says of it; empty where it says nothing."""
    words: tuple[str, ...] = ()
    """Patterns that a page with a mention has, all of them; none where it is a word like any other.
    """


def _word(text: str) -> str:
    return rf"(?<![\w-]){re.escape(text)}(?![\w-])"


def items() -> Iterator[Item]:
    for command in tables.commands():
        place, called = f"command: {command.name}", rf"gaitcal {command.name}\b"
        yield Item("command", command.name, place, command.text, (called,))
        for option in tables.options_of(command):
            name = option.names[0]
            words = (called, _word(name)) if name.startswith("-") else ()
            yield Item("option", f"{command.name} {name}", place, option.text, words)
    for table in tables.SCHEMAS:
        for f in tables.fields(table):
            words = (rf"`{re.escape(f.name)}`|^{re.escape(f.name)} = ",)
            yield Item("field", f"{table}.{f.name}", f"table: {table}", f.text, words)
    yield from (
        Item("marker set", name, "marker-sets", name, (_word(name),))
        for name in list_built_in_sets()
    )
    for kind, files in FILES.items():
        for file in files:
            last = file.pattern.replace("*", "")
            words = (re.escape(last),) if len(last) > 5 else ()
            yield Item("file", f"{kind}: {file.pattern}", f"files: {kind}", file.text, words)
    columns = {"summary": list(SUMMARY.items()), "people": [(c.name, c.meaning) for c in COLUMNS]}
    columns |= {
        table: [(c.name, c.text or c.unit or c.name) for c in of] for table, of in TABLES.items()
    }
    for table, told in columns.items():
        yield from (
            Item("column", f"{table}: {name}", f"columns: {table}", text) for name, text in told
        )
    yield from (Item("finding", e.code.value, "findings", e.text) for e in load_all_explanations())
    for name in gaitcal.__all__:
        group = next((group for group, names in GROUPS.items() if name in names), "none")
        said = "data" if name == "COORDINATES" else (getattr(gaitcal, name).__doc__ or "")
        yield Item("Python", name, f"python: {group}", said, (_word(f"gc.{name}"),))


@cache
def places() -> dict[str, str]:
    """Place of the reference -> page that holds it."""
    out = {}
    for path in sorted(DOCS.rglob("*.md")):
        for place in PLACE.findall(path.read_text(encoding="utf-8")):
            out[place] = path.relative_to(DOCS).as_posix()
    return out


@cache
def told_pages() -> dict[str, str]:
    """Page that people wrote -> its text."""
    paths = [path for folder in TOLD for path in sorted((DOCS / folder).glob("*.md"))]
    return {path.relative_to(DOCS).as_posix(): path.read_text(encoding="utf-8") for path in paths}


def mentions(item: Item) -> tuple[str, ...]:
    """Pages besides the reference that speak of it."""
    if not item.words:
        return ()
    return tuple(
        p
        for p, text in told_pages().items()
        if all(re.search(word, text, re.M) for word in item.words)
    )


def faults() -> list[str]:
    out = []
    for item in items():
        if item.place not in places():
            out.append(f"{item.kind} {item.name}: no page has {{{{ {item.place} }}}}")
        elif not item.text.strip():
            out.append(f"{item.kind} {item.name}: nothing is said of it")
        elif item.kind == "command" and not mentions(item):
            out.append(f"command {item.name}: in no tutorial, how-to or explanation")
    out += [f"Python gaitcal.{name}: has no docstring" for name in undocumented()]
    return out + [f"Python {name}: in no group, or not public" for name in sorted(ungrouped())]


def _anchor(item: Item) -> str:
    page = places()[item.place].removeprefix("reference/")
    name = item.name.split(" ")[0].split(".")[0].split(":")[0]
    if item.kind in ("command", "option"):
        return f"{page}#{name}"
    if item.kind == "finding":
        return f"findings/{item.name}.md"
    return page


def markdown() -> str:
    """The table; columns of one table count as one line."""
    rows = {}
    for item in items():
        name = item.name.split(":")[0] if item.kind == "column" else item.name
        if (item.kind, name) not in rows:
            pages = [f"[{Path(page).stem}](../{page})" for page in mentions(item)[:4]]
            label = f"columns of `{name}`" if item.kind == "column" else f"{item.kind} `{name}`"
            target = _anchor(item)
            rows[item.kind, name] = (
                label,
                f"[{Path(target.split('#')[0]).stem}]({target})",
                ", ".join(pages),
            )
    return tables.table_of(("", "is explained in", "and used in"), rows.values())
