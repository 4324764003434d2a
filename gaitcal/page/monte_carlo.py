"""The Monte Carlo study of a person as a section of the report that `gaitcal calibrate` has written.

The report is made before any draw. It leaves a place between two empty elements; whatever stands there is replaced, so
that a study that goes on brings its section up to date. Names in the page are escaped: none can forge the place.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from gaitcal.figures.monte_carlo import FRAME_WORDS, SET_WORDS
from gaitcal.files.atomic import atomic_text
from gaitcal.gait.words import SIDE_WORDS, capitalised
from gaitcal.montecarlo.leg_torques import TORQUE_WORDS
from gaitcal.montecarlo.settings import ReactionFrame
from gaitcal.montecarlo.statistics import CauseOfMarkerError, expect
from gaitcal.montecarlo.study import MonteCarloStudy
from gaitcal.page.report import environment

BEGIN, END = '<div id="montecarlo-begin" hidden></div>', '<div id="montecarlo-end" hidden></div>'


@dataclass(frozen=True)
class Reading:
    """What the marker error of this person means if one cause alone has made it."""

    cause: str
    level: str
    """Per cent of the bounds, in words."""
    rows: tuple[tuple[str, tuple[str, ...]], ...]
    """Moment; for each ground-reaction frame average and 10 to 90 % of its RMS error, %BW·H."""


def add_monte_carlo(
    page: Path | str, study: MonteCarloStudy, figures: Mapping[str, Path], marker_rms: float | None, side: str = "l"
) -> bool:
    """Put a Monte Carlo study into a report; False where the page has no place for it.

    Parameters
    ----------
    page : `report.html` of the result folder, replaced whole or not at all.
    figures : from `write_monte_carlo_figures`: name -> PNG, with the SVG beside it.
    marker_rms : mm, of pelvis and legs in the trial of the study, to be read in torque errors; None: no reading.
    side : the leg that figures and readings show.
    """
    path = Path(page)
    text = path.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        return False
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    atomic_text(path, before + BEGIN + _section(study, figures, marker_rms, side) + END + after)
    return True


def _section(study: MonteCarloStudy, figures: Mapping[str, Path], marker_rms: float | None, side: str) -> str:
    pictures = {name: _picture(path.with_suffix(".svg")) for name, path in figures.items()}
    causes = () if marker_rms is None else expect(study.statistics, marker_rms, side)
    return environment().get_template("monte_carlo.html").render(
        study=study,
        pictures=pictures,
        marker_rms=marker_rms,
        readings=[_reading(cause) for cause in causes],
        frames=[FRAME_WORDS[frame].removeprefix("ground reactions ") for frame in ReactionFrame],
        side=SIDE_WORDS[side],
    )  # fmt: skip


def _reading(cause: CauseOfMarkerError) -> Reading:
    rows = []
    for torque, of in cause.torques.groupby("torque", sort=False):
        cells: list[str] = []
        for frame in ReactionFrame:
            row = of[of["grf"] == frame.value].iloc[0]
            cells += [f"{row['average']:.2f}", f"{row['p10']:.2f} to {row['p90']:.2f}"]
        rows.append((TORQUE_WORDS[str(torque)[:-2]].capitalize(), tuple(cells)))
    level = f"more than {cause.level:.0f} %" if cause.beyond else f"{cause.level:.0f} %"
    return Reading(capitalised(SET_WORDS[cause.varied]), level, tuple(rows))


def _picture(path: Path) -> Markup:
    """An SVG file as the address of an image: its identifiers stay its own."""
    return Markup("data:image/svg+xml;base64,{}").format(base64.b64encode(path.read_bytes()).decode("ascii"))
