"""The paper's figure: how near the true hip centres, and how many 95 % intervals hold them.

python -m scripts.validation truth --parts gait,isolated --seeds 2 --json truth.json
python docs/paper/figures.py truth.json      # reduces it to docs/paper/truth.csv,
                                             # and draws docs/paper/truth.png
python docs/paper/figures.py                 # draws truth.csv as it is
"""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

HERE = Path(__file__).resolve().parent
FIGURES = ("hip in pelvis, mm", "hip in thigh, mm")
"""A hip centre has a place in either segment."""
NAMES = {
    "none": "no noise",
    "sinusoids": "waves up to 10 mm",
    "linear": "skin, with the angles",
    "quadratic": "skin, with their squares",
    "random": "skin, at random in time",
    "bursts": "skin, bursts of 5 to 10 Hz",
    "mixture": "waves and skin at once",
}
PARTS = {"gait": "gait alone", "isolated": "six isolated trials"}
BEFORE, AFTER, INK = "#7f7f7f", "#0072B2", "#222222"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One part and kind of error, over people and seeds."""

    part: str
    kind: str
    fits: int
    nominal_mm: float | None
    """RMS distance of the nominal hip centres; None where the table does not tell it."""
    calibrated_mm: float
    within_95: float
    """% of the coordinates whose 95 % interval holds the truth."""


def reduced(files: list[Path]) -> list[Row]:
    """The rows of files that `truth --json` wrote."""
    found: dict[tuple[str, str], list[dict[str, object]]] = {}
    for file in files:
        for fit in json.loads(file.read_text(encoding="utf-8")):
            kind = next((kind for kind in NAMES if fit["case"].startswith(kind)), None)
            if fit["part"] in PARTS and kind:
                found.setdefault((fit["part"], kind), []).extend(
                    fit["figures"][name] for name in FIGURES
                )
    rows = []
    for part in PARTS:
        for kind in NAMES:
            figures = found.get((part, kind), [])
            if figures:
                rows.append(_row(part, kind, figures))
    return rows


def _row(part: str, kind: str, figures: list[dict]) -> Row:  # type: ignore[type-arg]
    held, count = (
        sum(f["bars"]["within"][1] for f in figures),
        sum(f["bars"]["count"] for f in figures),
    )
    return Row(
        part=part,
        kind=kind,
        fits=len(figures) // len(FIGURES),
        nominal_mm=_rms([f["before"] for f in figures]),
        calibrated_mm=_rms([f["error"] for f in figures]),
        within_95=100.0 * held / count,
    )


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def write(rows: list[Row], file: Path) -> None:
    """As CSV, four digits that matter."""
    names = [field.name for field in fields(Row)]
    with file.open("w", encoding="utf-8", newline="") as stream:
        out = csv.writer(stream, lineterminator="\n")
        out.writerow(names)
        for row in rows:
            values = (getattr(row, name) for name in names)
            out.writerow(
                [f"{value:.4g}" if isinstance(value, float) else value for value in values]
            )  # None: empty


def read(file: Path) -> list[Row]:
    """What `write` wrote."""
    with file.open(encoding="utf-8", newline="") as stream:
        return [
            Row(
                part=line["part"],
                kind=line["kind"],
                fits=int(line["fits"]),
                nominal_mm=float(line["nominal_mm"]) if line["nominal_mm"] else None,
                calibrated_mm=float(line["calibrated_mm"]),
                within_95=float(line["within_95"]),
            )
            for line in csv.DictReader(stream)
        ]


def draw(rows: list[Row], file: Path) -> None:
    """Distances to the left, on a logarithmic axis; intervals to the right."""
    figure = Figure(figsize=(6.7, 3.4), dpi=220, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 1.4))
    places = _places(rows)
    told = [
        (place, r.nominal_mm, r.calibrated_mm)
        for place, r in zip(places, rows, strict=True)
        if r.nominal_mm
    ]
    left.hlines(
        [p for p, *_ in told],
        [c for *_, c in told],
        [n for _, n, _ in told],
        color="#cccccc",
        lw=1.2,
    )
    left.plot(
        [n for _, n, _ in told],
        [p for p, *_ in told],
        "o",
        mfc="white",
        mec=BEFORE,
        label="nominal",
    )
    left.plot([r.calibrated_mm for r in rows], places, "o", color=AFTER, label="calibrated")
    left.set(xscale="log", xlabel="hip centre, distance from the truth, RMS, mm")
    left.set_yticks(places, [NAMES[r.kind] for r in rows], fontsize=8)
    for part in PARTS:
        first = next((p for p, r in zip(places, rows, strict=True) if r.part == part), None)
        if first is not None:
            left.annotate(
                PARTS[part], (0, first - 0.75), (4, 0), xycoords=("axes fraction", "data"),
                textcoords="offset points",
                fontsize=8, fontweight="bold", color=INK, va="center",
            )  # fmt: skip
    left.legend(loc="lower left", fontsize=8, frameon=False)
    right.axvline(95, color=INK, lw=0.8, ls=":")
    right.plot([r.within_95 for r in rows], places, "s", color=AFTER, ms=4.5)
    right.set(xlim=(0, 104), xlabel="in 95 % intervals, %")
    for axes in (left, right):
        _plain(axes)
    left.set_ylim(max(places) + 0.7, -1.3)
    figure.savefig(file)


def _places(rows: list[Row]) -> list[float]:
    """Heights, with a gap for the heading of the second part."""
    parts = list(PARTS)
    return [number + 1.2 * parts.index(row.part) for number, row in enumerate(rows)]


def _plain(axes: Axes) -> None:
    axes.grid(axis="x", color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, length=2)
    axes.xaxis.label.set_size(8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def main(arguments: list[str] | None = None) -> None:
    """Reduce what is named, and draw."""
    files = [Path(name) for name in (sys.argv[1:] if arguments is None else arguments)]
    table = HERE / "truth.csv"
    if files:
        write(reduced(files), table)
    draw(read(table), HERE / "truth.png")


if __name__ == "__main__":
    main()
