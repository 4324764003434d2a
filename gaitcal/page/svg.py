"""A matplotlib figure as SVG inside a page: small, inert, and without clashing with its neighbours.

Text is drawn as outlines, so that no name can become markup and every machine shows the same. What matplotlib adds
around the drawing (comments with the text, metadata with addresses, style sheets that would reach the whole page) is
left out; identifiers are numbered; the outlines of letters are kept once for the page.
"""

from __future__ import annotations

import io
import re
from xml.etree import ElementTree

from markupsafe import Markup, escape
from matplotlib.figure import Figure

_SVG, _XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_DECIMALS = re.compile(r"-?\d+\.\d{2,}")
_KEPT = {
    "svg", "g", "path", "defs", "clipPath", "rect", "use", "circle", "ellipse", "line", "polygon", "polyline",
}  # fmt: skip
_ATTRIBUTES = {
    "d", "x", "y", "width", "height", "transform", "style", "clip-path", "id", "href", "viewBox", "fill", "stroke",
}  # fmt: skip


class SvgPage:
    """Collects the figures of one page."""

    def __init__(self) -> None:
        self._glyphs: dict[str, str] = {}
        self._figures = 0

    def add(self, figure: Figure, label: str) -> Markup:
        """The figure as an `<svg>` element that reads `label` aloud."""
        stream = io.StringIO()
        figure.savefig(stream, format="svg")
        root = ElementTree.fromstring(stream.getvalue())
        self._figures += 1
        names = {old: f"f{self._figures}-{k}" for k, old in enumerate(_references(root))}
        body = "".join(self._element(child, names) for child in root)
        box = escape(root.get("viewBox", "0 0 1 1"))
        return Markup(f'<svg viewBox="{box}" role="img" aria-label="{escape(label)}">{body}</svg>')

    def sprite(self) -> Markup:
        """The letters that all figures of the page use: to stand once, anywhere in the page."""
        outlines = "".join(f'<path id="{name}" {outline}/>' for name, outline in sorted(self._glyphs.items()))
        return Markup(f'<svg class="letters" aria-hidden="true" width="0" height="0"><defs>{outlines}</defs></svg>')

    def _element(self, element: ElementTree.Element, names: dict[str, str]) -> str:
        tag = str(element.tag).removeprefix(_SVG)
        if tag not in _KEPT:
            return ""
        identifier = element.get("id", "")
        if tag == "path" and identifier.startswith("DejaVu"):
            name = "t-" + re.sub(r"\W", "-", identifier)
            scale = escape(element.get("transform", ""))
            self._glyphs[name] = f'd="{escape(_rounded(element.get("d", ""), 0))}" transform="{scale}"'
            return ""
        inner = "".join(self._element(child, names) for child in element)
        if tag in ("g", "defs") and not inner:
            return ""
        start = f"<{tag}{_attributes(element, names)}"
        return f"{start}>{inner}</{tag}>" if inner else f"{start}/>"


def _attributes(element: ElementTree.Element, names: dict[str, str]) -> str:
    out = []
    for key, value in element.attrib.items():
        name = key.removeprefix(_XLINK)
        if name not in _ATTRIBUTES or (name == "id" and value not in names):
            continue
        if name == "href":
            target = value.removeprefix("#")
            glyph = target.startswith("DejaVu")
            value = "#t-" + re.sub(r"\W", "-", target) if glyph else f"#{names[target]}"
        elif name == "id":
            value = names[value]
        elif name == "d":
            value = _rounded(value, 2)
        else:
            value = _REFERENCE.sub(lambda m: f"url(#{names[m[1]]})", value)
            value = _rounded(value, 3)
        out.append(f' {name}="{escape(value)}"')
    return "".join(out)


def _rounded(path: str, digits: int) -> str:
    def shorten(match: re.Match[str]) -> str:
        text = f"{float(match[0]):.{digits}f}"
        return text.rstrip("0").rstrip(".") if digits else text

    return " ".join(_DECIMALS.sub(shorten, path).split())


def _references(root: ElementTree.Element) -> list[str]:
    """Identifiers that something refers to, in order; matplotlib's own hold random parts."""
    names: list[str] = []
    for element in root.iter():
        for key, value in element.attrib.items():
            names += _REFERENCE.findall(value)
            if key.removeprefix(_XLINK) == "href":
                names.append(value.removeprefix("#"))
    return list(dict.fromkeys(names))
