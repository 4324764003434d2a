"""`cohort.html`: the people of a cohort in one file that opens offline, written piece by piece, as they may be many."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Final

from gaitcal.page.policy import inline, policy
from gaitcal.page.view import PLOTS

SCRIPTS: Final = (
    *("unpack.js", "blocks.js", "convention.js", "pictures.js", "verdict.js", "pen.js"),
    *("cohort/people.js", "cohort/measures.js", "cohort/choices.js", "cohort/filters.js", "cohort/triage.js"),
    *("cohort/chooser.js", "cohort/table.js", "cohort/distributions.js", "cohort/groups.js", "cohort/mean_panel.js"),
    *("cohort/mean_curves.js", "cohort/failures.js", "cohort/cohort.js"),
)
"""In the order in which they run: what `result.html` has too; people and what is chosen; each part; all together."""
STYLES: Final = ("page.css", "sections.css", "cohort.css")
DATA: Final = ("CURVES", "COHORT")
"""What a page is of: packed mean curves, and everything else as JSON, in the order of the file."""


def write_cohort_page(path: Path, data: Mapping[str, Iterable[str]]) -> None:
    """Write the page; `data`: the pieces of each of `DATA`, asked for when they are due."""
    folder = files("gaitcal.page")

    def part(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    plots = inline(part(f"libraries/{PLOTS}.iife.min.js"))
    page = inline("\n".join(part(f"scripts/{name}") for name in SCRIPTS))
    fixed = {
        "POLICY": policy(plots, page),
        "STYLE": "\n".join([part(f"libraries/{PLOTS}.min.css"), *(part(f"styles/{name}") for name in STYLES)]),
        "LICENCES": f"uPlot\n\n{part(f'libraries/{PLOTS}.LICENSE.txt')}".replace("<", "‹"),
        "PLOTS": plots,
        "PAGE": page,
    }
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        for number, piece in enumerate(re.split(r"@@([A-Z]+)@@", part("templates/cohort.html"))):
            if number % 2 == 0:
                stream.write(piece)
            elif piece in DATA:
                stream.writelines(data[piece])
            else:
                stream.write(fixed[piece])
