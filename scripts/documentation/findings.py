"""A page for each code of a finding, as `gaitcal explain` prints it; none where there are no codes."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any


def explanations() -> tuple[Any, ...]:
    """All of them: code, title, severity, text."""
    if find_spec("gaitcal.explanations") is None:
        return ()
    return tuple(import_module("gaitcal.explanations").all())


def index() -> str:
    """A table of the codes."""
    lines = ["| code | is about |", "|---|---|"]
    lines += [f"| [{e.code}](findings/{e.code}.md) | {e.title} |" for e in explanations()]
    return "\n".join(lines)


def pages() -> dict[str, str]:
    """Code -> its page in Markdown."""
    return {e.code: e.text if e.text.startswith("# ") else f"# {e.code}: {e.title}\n\n{e.text}" for e in explanations()}
