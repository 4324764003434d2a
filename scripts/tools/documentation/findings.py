"""A page for each code of a finding or an error, as `gaitcal explain` prints it."""

from __future__ import annotations

from gaitcal.explanations.explanation import Explanation, all_explanations


def explanations() -> tuple[Explanation, ...]:
    """All of them, in the order of their numbers."""
    return all_explanations()


def index() -> str:
    """A table of the codes."""
    lines = ["| code | is about | can be |", "|---|---|---|"]
    for e in explanations():
        lines.append(f"| [{e.code.value}](findings/{e.code.value}.md) | {e.title} | {e.severity.lower()} |")
    return "\n".join(lines)


def pages() -> dict[str, str]:
    """Code -> its page in Markdown."""
    return {e.code.value: e.markdown for e in explanations()}
