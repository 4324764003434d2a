"""Numbers and text as they stand in the XML of exported models."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

from gaitcal.files.atomic import atomic_text

INDENT = "  "


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
