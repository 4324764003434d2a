"""Render pages without scripts: one HTML file of text, tables and SVG that opens offline.

The main one compares two sessions: subject and session, differences in sentences, mean curves with
the band of the minimal detectable change, scores and steps, and the table of figures. The printed
version has the same order. Moments and powers are divided by the body mass of each session, as
people grow between two visits.
"""

import base64
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.gait.conventions import Convention
from gaitcal.gait.cycles import POINTS, CurveKind, get_curve_kind, list_variables
from gaitcal.gait.moments import SIDE_WORDS
from gaitcal.model.linkage import SIDES
from gaitcal.report.figures import report_sheets
from gaitcal.report.figures.chart import (
    FAINT,
    FONT,
    INK,
    SALT,
    SIDE_COLOURS,
    SIDE_DASHES,
    compute_limits,
    create_figure,
    format_axes,
    make_line_style,
)
from gaitcal.results.session_comparison import SessionComparison
from gaitcal.results.session_difference import Difference, format_numbers, name_figure
from gaitcal.results.shown_labels import PAPER_UNITS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN: Final = 40  # Rows of the table of figures; `differences.csv` has all
COLUMNS: Final = 4
PANEL: Final = (2.75, 1.75)  # inches


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
                f"{sheet}: means of {names[0]} (grey) and {names[1]} (right blue, left red, "
                "dashed) over the stride "
                "of each foot. Grey band: within it a difference could have been missed (95 %); "
                "black bars: beyond it."
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
    import matplotlib as mpl

    curves = comparison.curves
    drawn = [
        (v, s)
        for v in variables
        for s in SIDES
        if ((curves["variable"] == v) & (curves["side"] == s)).any()
    ]
    if not drawn:
        return ""
    rows = -(-len(drawn) // COLUMNS)
    figure = create_figure(COLUMNS * PANEL[0], rows * PANEL[1])
    for k, (variable, side) in enumerate(drawn, start=1):
        of_leg = curves[(curves["variable"] == variable) & (curves["side"] == side)]
        _draw_panel(figure.add_subplot(rows, COLUMNS, k), comparison, convention, of_leg)
    figure.tight_layout(h_pad=0.8, w_pad=0.6)
    text = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": SALT, "svg.fonttype": "none"}):
        figure.savefig(
            text,
            format="svg",
            metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
        )
    description = (
        f"Mean curves of {' and '.join(comparison.names)}: "
        f"{', '.join(dict.fromkeys(v for v, _ in drawn))}"
    )
    data = base64.b64encode(text.getvalue().encode()).decode("ascii")
    return f'<img alt="{escape(description)}" src="data:image/svg+xml;base64,{data}">'


def _draw_panel(
    axes: "Axes", comparison: SessionComparison, convention: Convention, curve: pd.DataFrame
) -> None:
    variable, side, percent = (
        curve["variable"].iloc[0],
        curve["side"].iloc[0],
        curve["percent"].to_numpy(),
    )
    kind = get_curve_kind(variable)
    before, after, band = convert_curves(comparison, convention, curve)
    positive, title = convention.senses(variable, side)[0], convention.title(variable)
    format_axes(axes, ylabel=f"{PAPER_UNITS[kind]}\n{positive} +")
    axes.set_title(f"{title}, {SIDE_WORDS[side]}", fontsize=7.6, family=FONT, loc="left", pad=3)
    axes.axhline(0.0, color=FAINT, linewidth=0.5)
    axes.fill_between(
        percent, before - band, before + band, color="#000000", alpha=0.12, linewidth=0
    )
    axes.plot(percent, before, color="#555555", linewidth=1.3)
    axes.plot(
        percent,
        after,
        color=SIDE_COLOURS[side],
        linestyle=make_line_style(SIDE_DASHES[side]),
        linewidth=1.5,
    )
    low, high = compute_limits(
        [before, after, before - band, before + band], report_sheets.LEAST[kind]
    )
    beyond = np.where(curve["exceeds"].to_numpy() == 1, low, np.nan)
    axes.plot(percent, beyond, color=INK, linewidth=5.0, solid_capstyle="butt")
    axes.set_xlim(0.0, 100.0)
    axes.set_ylim(low, high)


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
) -> Iterator[report_sheets.CurvePanel | str]:
    """Build the panels of a printed sheet: A thin, B thick with the minimal detectable change."""
    curves, none = comparison.curves, np.full(POINTS, np.nan)
    for variable in variables:
        if variable not in list_variables():
            yield variable
            continue
        by_side = {
            side: curves[(curves["variable"] == variable) & (curves["side"] == side)]
            for side in SIDES
        }
        converted = {
            side: convert_curves(comparison, convention, rows) if len(rows) else (none, none, none)
            for side, rows in by_side.items()
        }
        kind = get_curve_kind(variable)
        yield report_sheets.CurvePanel(
            title=convention.title(variable),
            unit=PAPER_UNITS[kind],
            senses=convention.senses(variable, "r"),
            strides={side: (before,) for side, (before, _, _) in converted.items()},
            mean={side: after for side, (_, after, _) in converted.items()},
            error={side: band for side, (_, _, band) in converted.items()},
            norm=None,
            least=report_sheets.LEAST[kind],
            thin=(0.7, 0.9),
        )


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
