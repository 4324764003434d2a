"""Docstrings of this project as Markdown: its sections `name : what it is`, which numpy's form takes for a type. And
its dataclasses as such, with what makes one of them.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

SECTION = re.compile(r"^(Parameters|Returns|Raises)\n-+\n((?:.*\n?)*?)(?=^\w[^\n]*\n-+\n|\Z)", re.M)


def lists(docstring: str) -> str:
    """Sections of a docstring (`name : text`, or a name with its text indented below) as lists in Markdown."""

    def as_list(found: re.Match[str]) -> str:
        title, body = found.groups()
        entries = re.sub(r"\n +", " ", body.strip()).splitlines()
        if title == "Parameters":
            entries = [re.sub(r"^([\w, *]+?) : ", lambda m: f"`{m[1]}`: ", entry) for entry in entries]
        elif title == "Raises":
            entries = [re.sub(r"^(\w+) ", r"`\1`: ", entry) for entry in entries]
        return f"**{title}**\n\n" + "\n".join(f"- {entry}" for entry in entries) + "\n\n"

    return SECTION.sub(as_list, docstring)


class Lists(griffe.Extension):
    def on_instance(self, *, obj: Any, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = lists(obj.docstring.value)
