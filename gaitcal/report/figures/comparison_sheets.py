"""Render pages without scripts: one HTML file of text, tables and SVG that opens offline.

The main one compares two sessions: subject and session, differences in sentences, mean curves with
the band of the minimal detectable change, scores and steps, and the table of figures. The printed
version has the same order. Moments and powers are divided by the body mass of each session, as
people grow between two visits.
"""

import base64
import io
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import Final

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.gait.conventions import Convention
from gaitcal.gait.cycles import POINTS, CurveKind, get_curve_kind, list_variables
from gaitcal.gait.moments import SIDE_WORDS
from gaitcal.model.linkage import SIDES
from gaitcal.report.figures.chart import FAINT, Chart, Key, Size, Sizes, clean_name, save_chart
from gaitcal.report.figures.curve_panel import LEAST, CurvePanel, make_side_key
from gaitcal.results.session_comparison import SessionComparison
from gaitcal.results.session_difference import Difference, format_numbers, name_figure
from gaitcal.results.shown_labels import PAPER_UNITS

SHOWN: Final = 40  # Rows of the table of figures; `differences.csv` has all
COLUMNS: Final = 4
PANEL: Final = Size(width=2.75, height=1.85, left=0.45, bottom=0.4, top=0.4, label=0.13)
LETTERS: Final = Sizes(small=6.6, normal=7.2, title=7.6)
THIN: Final = (0.7, 0.9)  # Width (pt) and opacity of the curves of the first session


def render_comparison_page(
    comparison: SessionComparison,
    convention: Convention,
    sheets: Mapping[str, Sequence[str]],
    people: Sequence[Sequence[tuple[str, str]]],
    scores: "Sequence[Row]" = (),
    norms: "Row" = ("", ""),
) -> str:
    """Render the page of a comparison.

    Parameters
    ----------
    comparison
        Two sessions.
    convention
        Of angles, moments and powers; moments by body mass.
    sheets
        Title -> variables of `cycles.csv`, in the order of drawing.
    people
        Of each session, label and value of what is known of subject and session.
    scores
        Angle or score, A, B and their difference, as text.
    norms
        Normative data of each session.

    Returns
    -------
    str
        HTML.
    """
    names = comparison.names
    title = f"{comparison.subjects[1].name}: {names[1]} against {names[0]}"
    facts = [dict(known) for known in people]
    labels = dict.fromkeys(label for known in facts for label in known)
    parts = [
        render_plain_table(
            "Person and session",
            ("", *names),
            [(label, *(known.get(label, "–") for known in facts)) for label in labels],
            name="who",
        ),
        *map(render_warning, comparison.warnings),
        "<h2>What differs</h2>",
        render_list(comparison.sentences),
    ]
    for sheet, variables in sheets.items():
        if picture := _draw_sheet(comparison, convention, variables):
            caption = (
                f"{sheet}: means over the stride of each foot, {names[0]} thin, {names[1]} thick. "
                "Band: within it a difference could have been missed (95 %); bars at the foot: "
                "beyond it."
            )
            parts += [
                f"<h2>{escape(sheet)}</h2>",
                f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>",
            ]
    if scores:
        against = (
            f"{name}, against {norm}" if norm else name
            for name, norm in zip(names, norms, strict=True)
        )
        head = ("deg, ± standard error", *against, "difference")
        parts += [
            "<h2>Gait Profile Score and Movement Analysis Profile</h2>",
            render_plain_table("Scores", head, scores),
        ]
    steps = [d for d in comparison.found if d.kind == "spatiotemporal"]
    others = [d for d in comparison.found if d.kind != "spatiotemporal"]
    parts += [
        *_render_figures("Steps and phases", names, steps, len(steps)),
        *_render_figures("All other figures", names, others, SHOWN),
    ]
    return render_plain_page(title, parts)


def _render_figures(
    title: str, names: tuple[str, str], found: Sequence[Difference], most: int
) -> Iterator[str]:
    if not found:
        return
    yield f"<h2>{title}</h2>"
    rows = build_figure_rows(found[:most])
    head = ("figure", "unit", *names, "difference", "missed below", "times")
    yield render_plain_table(title, head, rows, beyond=[d.exceeds for d in found[:most]])
    if len(found) > most:
        yield f'<p class="soft">and {len(found) - most} more in differences.csv</p>'
    yield (
        '<p class="soft">Missed below: minimal detectable change (95 %). Times: difference over '
        "it; bold: beyond.</p>"
    )


def _draw_sheet(
    comparison: SessionComparison, convention: Convention, variables: Sequence[str]
) -> str:
    """Draw an `<img>` with a panel for each variable and leg; empty without curves."""
    panels = []
    for variable, side in itertools.product(variables, SIDES):
        rows = _select_curve(comparison, variable, side)
        if len(rows):
            panel = _build_panel(comparison, convention, variable, (side,))
            panel = replace(panel, title=f"{panel.title}, {SIDE_WORDS[side]}")
            panels.append(panel.make_panel(PANEL, LETTERS, panel.title))
    if not panels:
        return ""
    before, after = map(clean_name, comparison.names)
    keys = [Key(label=f"{before}", colour=FAINT, width=THIN[0])]
    keys += [make_side_key(side, f"{after}, {SIDE_WORDS[side]}") for side in SIDES]
    text = io.StringIO()
    titles = ", ".join(panel.label for panel in panels)
    drawn = Chart(name="", title=titles, panels=tuple(panels), keys=tuple(keys), columns=COLUMNS)
    save_chart(drawn, {"svg": text})
    data = base64.b64encode(text.getvalue().encode()).decode("ascii")
    description = f"Mean curves of {' and '.join(comparison.names)}: {titles}"
    return f'<img alt="{escape(description)}" src="data:image/svg+xml;base64,{data}">'


def _select_curve(comparison: SessionComparison, variable: str, side: str) -> pd.DataFrame:
    curves = comparison.curves
    return curves[(curves["variable"] == variable) & (curves["side"] == side)]


def _build_panel(
    comparison: SessionComparison, convention: Convention, variable: str, sides: Sequence[str]
) -> CurvePanel:
    """Build a panel: A thin, B thick with the band of the minimal detectable change."""
    before, after, band, marked = {}, {}, {}, {}
    for side in sides:
        rows = _select_curve(comparison, variable, side)
        after[side] = band[side] = np.full(POINTS, np.nan)
        if len(rows):
            before[side], after[side], band[side] = convert_curves(comparison, convention, rows)
            marked[side] = rows["exceeds"].to_numpy() == 1
    kind = get_curve_kind(variable)
    return CurvePanel(
        title=convention.title(variable),
        unit=PAPER_UNITS[kind],
        senses=convention.senses(variable, sides[0]),
        strides={side: (curve,) for side, curve in before.items()},
        mean=after,
        error=band,
        marked=marked,
        least=LEAST[kind],
        thin=THIN,
    )


def convert_curves(
    comparison: SessionComparison, convention: Convention, curve: pd.DataFrame
) -> tuple[Array, ...]:
    """Convert the (101,) means A and B and half the minimal detectable change to the convention.

    `curve`: the rows of one variable and side of `curve_differences.csv`.
    """
    variable, side = curve["variable"].iloc[0], curve["side"].iloc[0]

    def convert(name: str, session: int) -> Array:
        person = comparison.subjects[session]
        by_mass = 1.0 / person.mass if get_curve_kind(variable) is CurveKind.FORCE else 1.0
        return by_mass * convention.values(
            variable, curve[name].to_numpy(dtype=float), side, person
        )

    return (
        convert("a", 0),
        convert("b", 1),
        0.5 * (np.abs(convert("mdc95", 0)) + np.abs(convert("mdc95", 1))),
    )


def build_paper_panels(
    comparison: SessionComparison, convention: Convention, variables: Sequence[str]
) -> Iterator[CurvePanel | str]:
    """Build the panels of a printed sheet, each with both legs."""
    for variable in variables:
        if variable in list_variables():
            yield _build_panel(comparison, convention, variable, SIDES)
        else:
            yield variable


def build_figure_rows(found: Sequence[Difference]) -> list[tuple[str, ...]]:
    """Build rows: figure, unit, A, B, difference, minimal detectable change, ratio of the two."""
    return [(name_figure(d), d.unit, *format_numbers(d)) for d in found]


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
"""  # noqa: E501
POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"

Row = Sequence[str]


def render_plain_page(title: str, parts: Iterable[str]) -> str:
    """Render a page.

    Parameters
    ----------
    title
        Text.
    parts
        HTML below the title.

    Returns
    -------
    str
        HTML.
    """
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f"<style>{STYLE}</style></head><body><main><h1>{escape(title)}</h1>{''.join(parts)}</main></body></html>\n"
    )


def render_plain_table(
    label: str,
    head: Row,
    rows: Iterable[Row],
    name: str = "",
    beyond: Sequence[bool] = (),
    words: int = 1,
) -> str:
    """Render a table that scrolls sideways if it is too wide.

    Parameters
    ----------
    label
        What the table contains, for screen readers.
    head
        Titles of the columns.
    rows
        Cells as text.
    name
        Class of the table; `who`: all columns are text.
    beyond
        Of the first rows, whether they are emphasised.
    words
        Number of text columns, to the left of those of numbers.

    Returns
    -------
    str
        HTML.
    """

    def cells(row: Row, tag: str, further: str = "") -> str:
        left = (' class="text"' if k < words else "" for k in range(1, len(row) + 1))
        return "".join(
            f"<{tag}{further}{class_text}>{escape(cell)}</{tag}>"
            for class_text, cell in zip(left, row, strict=True)
        )

    top = (f'<th scope="col">{escape(head[0])}</th>' if head[0] else "<td></td>") + cells(
        head[1:], "th", ' scope="col"'
    )
    body = ""
    for k, (first, *rest) in enumerate(rows):
        marked = ' class="beyond"' if k < len(beyond) and beyond[k] else ""
        body += f'<tr{marked}><th scope="row">{escape(first)}</th>{cells(rest, "td")}</tr>'
    table = f'<table class="{name}"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>'
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(label)}">{table}</div>'
    )


def render_warning(text: str) -> str:
    """Render a sentence in a box.

    Parameters
    ----------
    text
        The sentence.

    Returns
    -------
    str
        HTML.
    """
    return f'<p class="warning" role="note">{escape(text)}</p>'


def render_list(lines: Iterable[str]) -> str:
    """Render a list of sentences.

    Parameters
    ----------
    lines
        The sentences.

    Returns
    -------
    str
        HTML.
    """
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"
