"""A page without a script: one HTML file of words, tables and pictures that opens offline and requests nothing."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Final

STYLE: Final = """
body{font:15px/1.45 system-ui,sans-serif;color:#1a1a1a;background:#fff;margin:0 auto;max-width:1160px;padding:20px}
h1{font-size:24px;margin:0 0 4px}h2{font-size:18px;margin:26px 0 6px}
table{border-collapse:collapse;width:100%}th,td{padding:4px 8px;border-bottom:1px solid #ccc;text-align:right}
th:first-child,td:first-child,.text{text-align:left}thead th{border-bottom:2px solid #333}
.who{max-width:760px}.who td,.who th{text-align:left}.beyond td,.beyond th{font-weight:650}tbody th{font-weight:400}
.warning{background:#fff3cd;border-left:4px solid #8a6100;padding:6px 10px;margin:6px 0}.scroll{overflow-x:auto}
img{width:100%;height:auto}figure{margin:0}figcaption,.soft{color:#484848;font-size:13.5px}
@media print{body{max-width:none;padding:0;font-size:11px}@page{size:A4;margin:14mm}h2{break-after:avoid}
tr,figure,.warning{break-inside:avoid}.scroll{overflow:visible}th,td{padding:2px 5px}figure img{max-height:245mm}}
"""
POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"

Row = Sequence[str]


def plain_page(title: str, parts: Iterable[str]) -> str:
    """The whole page; `parts`: HTML below its title."""
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f"<style>{STYLE}</style></head><body><main><h1>{escape(title)}</h1>{''.join(parts)}</main></body></html>\n"
    )


def plain_table(
    label: str, head: Row, rows: Iterable[Row], name: str = "", beyond: Sequence[bool] = (), words: int = 1
) -> str:
    """A table that scrolls sideways where it is too wide.

    `label`: what it holds.
    `name`: class of the table; `who`: all of its columns are words.
    `beyond`: of the first rows, whether they stand out.
    `words`: columns of words, to the left of those of numbers.
    """

    def cells(row: Row, tag: str, further: str = "") -> str:
        left = (' class="text"' if k < words else "" for k in range(1, len(row) + 1))
        return "".join(f"<{tag}{further}{of}>{escape(cell)}</{tag}>" for of, cell in zip(left, row, strict=True))

    top = (f'<th scope="col">{escape(head[0])}</th>' if head[0] else "<td></td>") + cells(
        head[1:], "th", ' scope="col"'
    )
    body = ""
    for k, (first, *rest) in enumerate(rows):
        marked = ' class="beyond"' if k < len(beyond) and beyond[k] else ""
        body += f'<tr{marked}><th scope="row">{escape(first)}</th>{cells(rest, "td")}</tr>'
    table = f'<table class="{name}"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>'
    return f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(label)}">{table}</div>'


def warning(text: str) -> str:
    """A sentence in a box of its own."""
    return f'<p class="warning" role="note">{escape(text)}</p>'


def listed(lines: Iterable[str]) -> str:
    """A list of sentences."""
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"
