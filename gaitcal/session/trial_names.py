"""Names of trials, and what the names of files say of them: weak evidence, told where it contradicts."""

from __future__ import annotations

import re
from collections.abc import Sequence

_JOINT_WORD = re.compile(r"(hip|knee|ankle)(?![a-z]*cent)", re.IGNORECASE)


def name_contradicts(stem: str, role: tuple[str, str]) -> str:
    """What a file's name says against its role; empty where it says nothing."""
    word = _JOINT_WORD.search(stem)
    if word is None:
        return ""
    name = word.group(1).lower()
    if role[0] == "joint" and role[1].startswith(name):
        return ""
    return f"though its name says {name}"


def trial_names(stems: Sequence[str]) -> list[str]:
    """Names of trials from those of files: safe as file names, and each once whatever the case."""
    out: list[str] = []
    for stem in stems:
        plain = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_")[:60] or "trial"
        if re.fullmatch(r"(con|prn|aux|nul|com\d|lpt\d)", plain, re.IGNORECASE):
            plain += "_"
        name, count = plain, 1
        while name.lower() in {other.lower() for other in out}:
            count += 1
            name = f"{plain}_{count}"
        out.append(name)
    return out
