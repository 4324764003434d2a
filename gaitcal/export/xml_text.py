r"""Names, numbers and text as they stand in the exported files.

Names of markers and subjects are data, and are made fit for every program that reads the files, reversibly: OpenSim
refuses white space and `\ / * +` in names; XML cannot hold control characters at all. Such characters, and those that
mean something in XML or here (`< > & " ' %`), are written as `%XX`, one per byte of their UTF-8 form. Everything else
is kept, so that an ordinary label such as `R.ASIS` or `Hüfte` is the same in the model and in the marker file. No name
is ever used as a path.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

from gaitcal.io.atomic import atomic_text

INDENT = "  "
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


def numbers(values: Iterable[float]) -> str:
    """Numbers separated by blanks, each with as many digits as bring it back exactly; no negative zeros."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def plain_text(text: str) -> str:
    """`text` without the characters that XML cannot hold: they become U+FFFD. Markup is escaped on writing."""
    return "".join(c if c.isprintable() or c in "\n\t" else "\N{REPLACEMENT CHARACTER}" for c in text)


def child(parent: ET.Element, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    """A new child element of `parent`."""
    element = ET.SubElement(parent, tag, attributes)
    element.text = text
    return element


def write_xml(root: ET.Element, path: Path | str) -> None:
    """Write an indented UTF-8 document, whole or not at all."""
    ET.indent(root, INDENT)
    text = ET.tostring(root, encoding="unicode")
    atomic_text(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')
