"""What MkDocs calls while it builds: places in pages where a line `{{ name: word }}` stands for
what the program tells.

    {{ command: calibrate }}    usage and options
    {{ table: subject }}        keys of a TOML table
    {{ files: calibration }}    files of a kind of folder
    {{ columns: people }}       columns of a table
    {{ marker-sets }}           the built-in sets
    {{ findings }}              codes and their titles
    {{ examples }}              recordings to fetch
    {{ everything }}            what is explained where
    {{ python: study }}         public names of a group

A page for every code of a finding is made as well (`reference/findings/GC-001.md`).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import griffe
from mkdocs.structure.files import File, Files, InclusionLevel

from gaitcal.explanations import load_all_explanations
from scripts.tools.documentation import coverage, tables

SECTION = re.compile(r"^(Parameters|Returns|Raises)\n-+\n((?:.*\n?)*?)(?=^\w[^\n]*\n-+\n|\Z)", re.M)


def lists(docstring: str) -> str:
    """Sections of a docstring (`name : text`, or a name with its text indented below) as lists in
    Markdown.
    """

    def as_list(found: re.Match[str]) -> str:
        title, body = found.groups()
        entries = re.sub(r"\n +", " ", body.strip()).splitlines()
        if title == "Parameters":
            entries = [
                re.sub(r"^([\w, *]+?) : ", lambda m: f"`{m[1]}`: ", entry) for entry in entries
            ]
        elif title == "Raises":
            entries = [re.sub(r"^(\w+) ", r"`\1`: ", entry) for entry in entries]
        return f"**{title}**\n\n" + "\n".join(f"- {entry}" for entry in entries) + "\n\n"

    return SECTION.sub(as_list, docstring)


class Lists(griffe.Extension):
    def on_instance(self, *, obj: Any, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = lists(obj.docstring.value)


ROOT = Path(__file__).resolve().parents[3]

PLACE = re.compile(r"^\{\{ ([a-z-]+)(?:: ([\w-]+))? \}\}$", re.M)


def findings() -> str:
    rows = (
        (f"[{e.code.value}](findings/{e.code.value}.md)", e.title, e.severity.lower())
        for e in load_all_explanations()
    )
    return tables.table_of(("code", "is about", "can be"), rows)


MAKERS: Final[dict[str, Callable[..., str]]] = {
    "command": tables.command_markdown,
    "table": tables.markdown,
    "marker-sets": tables.marker_sets,
    "examples": tables.public_examples,
    "files": tables.files_markdown,
    "columns": tables.columns_markdown,
    "findings": findings,
    "everything": coverage.markdown,
    "python": coverage.names_markdown,
}


def filled(markdown: str) -> str:
    def made(place: re.Match[str]) -> str:
        name, word = place.groups()
        return MAKERS[name](word) if word else MAKERS[name]()

    return PLACE.sub(made, markdown)


def on_config(config: Any) -> Any:
    """MkDocs has read its settings: every page says which version it is about."""
    package = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (version,) = re.findall(r'^version = "(.+)"$', package, re.M)
    config.site_name = f"gaitcal {version}"
    return config


def on_page_markdown(markdown: str, **_: Any) -> str:
    return filled(markdown)


def on_post_page(output: str, **_: Any) -> str:
    """A page that is opened as a file asks for no list of versions, which a browser would not give
    it.
    """
    alone = (
        "if(location.protocol==='file:'){const "
        "c=document.getElementById('__config'),o=JSON.parse(c.textContent);"
    )
    alone += "delete o.version;c.textContent=JSON.stringify(o)}"
    return re.sub(
        r'(<script id="__config".*?</script>)',
        rf"\1<script>{alone}</script>",
        output,
        flags=re.DOTALL,
    )


def on_files(files: Files, config: Any) -> Files:
    for e in load_all_explanations():
        page = File.generated(config, f"reference/findings/{e.code.value}.md", content=e.markdown)
        page.inclusion = InclusionLevel.NOT_IN_NAV
        files.append(page)
    return files
