"""Links of the built site: those within it must lead somewhere, those out of it are listed and nothing is fetched."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

OURS: Final = re.compile(r"gaitcal(\.\w+)+\.[A-Z]\w*[a-z]\w*")
"""A class in a signature; one that has a page is a link instead."""


@dataclass
class _Page(HTMLParser):
    """What a page links to, what it loads, and where it can be linked to."""

    links: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)
    unexplained: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value for name, value in attrs if value is not None}
        if tag == "span" and OURS.fullmatch(given.get("title", "")):
            self.unexplained.add(given["title"])
        if "id" in given:
            self.anchors.add(given["id"])
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag == "link" and given.get("rel") in ("canonical", "next", "prev"):
            return
        for name in ("src", "href") if tag != "a" else ():
            if name in given:
                self.loads.append(given[name])


@dataclass(frozen=True)
class Links:
    """What was found."""

    pages: int
    inside: int
    broken: list[str]
    outside: list[str]
    """Addresses that a reader may click."""
    unexplained: list[str]
    """Types of ours in signatures of `reference/python.html` that have no page."""
    fetched: list[str]
    """Addresses that a page would load from elsewhere by itself: there must be none."""


def check(site: Path) -> Links:
    """Every link of a built site."""
    pages = {path.resolve(): _Page() for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        page.feed(path.read_text(encoding="utf-8"))
    broken, outside, fetched, inside = [], set(), set(), 0
    for path, page in pages.items():
        if path.name == "404.html":
            continue
        for link in (*page.links, *page.loads):
            parts = urlsplit(link)
            if parts.scheme in ("http", "https") or parts.netloc:
                (fetched if link in page.loads else outside).add(link)
                continue
            if parts.scheme:
                continue
            inside += 1
            target = path if not parts.path else (path.parent / unquote(parts.path)).resolve()
            if target.is_dir():
                target = target / "index.html"
            anchor = unquote(parts.fragment)
            if not target.exists():
                broken.append(f"{path.relative_to(site.resolve())}: {link}")
            elif anchor and target in pages and anchor not in pages[target].anchors and anchor != "__top":
                broken.append(f"{path.relative_to(site.resolve())}: {link}: no such place in it")
    types = [page.unexplained for path, page in pages.items() if path.stem == "python"]
    unexplained = sorted(set().union(*types))
    return Links(len(pages), inside, broken, sorted(outside), unexplained, sorted(fetched))
