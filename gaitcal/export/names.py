r"""Names that are data (markers, subjects) made fit for every program that reads the exported files, reversibly.

OpenSim refuses white space and `\ / * +` in names; XML cannot hold control characters at all. Such characters, and
those that mean something in XML or here (`< > & " ' %`), are written as `%XX`, one per byte of their UTF-8 form.
Everything else is kept, so that an ordinary label such as `R.ASIS` or `Hüfte` is the same in the model and in the
marker file. No name is ever used as a path.
"""

from __future__ import annotations

import re

_ESCAPED = frozenset("\\/*+%<>&\"'")
_EMPTY = "%"


def safe_name(name: str) -> str:
    """`name` with every troublesome character as `%XX`; never empty; different names stay different."""
    if not name:
        return _EMPTY
    return "".join(c if _is_plain(c) else _escape(c) for c in name)


def original_name(name: str) -> str:
    """The name that `safe_name` was given; a name that it cannot have written comes back as it is."""
    if name == _EMPTY:
        return ""
    return re.sub("(?:%[0-9A-F]{2})+", _unescape, name)


def _is_plain(character: str) -> bool:
    return character.isprintable() and not character.isspace() and character not in _ESCAPED


def _escape(character: str) -> str:
    return "".join(f"%{byte:02X}" for byte in character.encode("utf-8", errors="surrogatepass"))


def _unescape(match: re.Match[str]) -> str:
    try:
        return bytes.fromhex(match.group().replace("%", "")).decode("utf-8", errors="surrogatepass")
    except UnicodeDecodeError:
        return match.group()
