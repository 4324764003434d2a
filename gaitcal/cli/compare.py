"""`gaitcal compare`: two sessions of one person, or an OpenSim model beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.text import Text

from gaitcal.cli.console import Console, frameless_table
from gaitcal.compare.comparison import compare
from gaitcal.compare.difference import numbers_of, subject
from gaitcal.compare.opensim_motion import compare_motion
from gaitcal.compare.osim_words import osim_words
from gaitcal.compare.sessions import SessionComparison
from gaitcal.errors import UsageError
from gaitcal.findings import note_of
from gaitcal.io.result_folder import MANIFEST, ResultKind, require_room
from gaitcal.results.saved import load_result_model, our_trials
from gaitcal.results.sessions import compare_results, write_comparison
from gaitcal.results.shared_model import compare_with_shared_model

SHOWN = 30
"""Rows of the table on the screen; the file has all."""
WIDTH = 40
"""Characters of a figure's name, at least."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of the command line, as they were written."""

    osim: Path | None = None
    out: Path | None = None
    shared_model: bool = False
    motion: bool = False
    studies: Sequence[Path] = ()


def compare_sessions_or_models(result: Path, other: Path | None, options: Options, console: Console) -> None:
    """Compare two results, or one with an OpenSim model."""
    _require_usable(other, options)
    if options.osim is not None:
        compare_models(result, options.osim, console)
        if options.motion:
            compare_motions(result, options.osim, console)
        return
    if other is None:
        raise UsageError("found one result; allowed: two results, or one and --osim FILE", field="compare")
    if options.out is not None:
        require_room(options.out, ResultKind.COMPARISON, [folder / MANIFEST for folder in (result, other)])
    shared = None
    if options.shared_model:
        with console.working() as step:
            shared = compare_with_shared_model(result, other, options.studies, step)
    comparison = compare_results(result, other) if shared is None else shared.comparison
    tell(comparison, console)
    if options.out is not None:
        write_comparison(comparison, options.out, (result, other), None if shared is None else shared.parameters)
        console.line(f"wrote {options.out}")


def _require_usable(other: Path | None, options: Options) -> None:
    if options.osim is not None and (other is not None or options.out is not None or options.shared_model):
        message = "found a second result, --out or --shared-model beside it; allowed: one result and --osim FILE"
        raise UsageError(message, field="--osim")
    if options.motion and options.osim is None:
        raise UsageError("found without --osim, whose model it is for", field="--motion")
    if options.studies and not options.shared_model:
        raise UsageError("found without --shared-model, which alone needs them", field="--study")


def tell(comparison: SessionComparison, console: Console) -> None:
    """Warnings and words first, then the table of what differs most."""
    for line in comparison.lines:
        console.line(line)
    if not comparison.found:
        return
    table = frameless_table(("figure", "unit"), (*comparison.names, "difference", "missed below", "times"))
    table.columns[0].min_width = WIDTH
    for d in comparison.found[:SHOWN]:
        table.add_row(Text(subject(d)), d.unit, *numbers_of(d))
    console.line()
    console.out.print(table)
    if (rest := len(comparison.found) - SHOWN) > 0:
        console.line(f"and {rest} more: --out FOLDER writes all")


def compare_models(result: Path, osim: Path, console: Console) -> None:
    """Say in words what an OpenSim model differs in, then print its joint axes, masses and lengths beside ours."""
    table = frameless_table(("quantity", "unit"), ("ours", "theirs", "difference"))
    model, read, doubts = load_result_model(result)
    for text in (*read.remarks, *map(note_of, doubts)):
        console.line(f"warning: {text}")
    rows = compare(model, osim)
    for line in osim_words(rows):
        console.line(line)
    for row in rows:
        numbers = (f"{v:.2f}" for v in (row.ours, row.theirs, row.difference))
        table.add_row(Text(row.quantity), Text(row.unit), *numbers)
    console.line()
    console.out.print(table)


def compare_motions(result: Path, osim: Path, console: Console) -> None:
    """Coordinates and moments of an OpenSim model in the recordings of a result, by OpenSim, beside ours."""
    with console.working() as step:
        step("inverse kinematics and dynamics in OpenSim")
        trials = our_trials(result)
        found = compare_motion(load_result_model(result)[0], osim, trials)
    table = frameless_table(("coordinate", "unit"), ("ours, range", "offset", "rest, RMS", "correlation"))
    for curve in found.curves:
        numbers = (float(np.ptp(curve.ours)), curve.offset, curve.rest)
        r = "" if np.isnan(curve.correlation) else f"{curve.correlation:.3f}"
        table.add_row(Text(curve.coordinate), curve.unit, *(f"{v:.1f}" for v in numbers), r)
    console.line()
    console.line(f"in {', '.join(t.name for t in trials)}, by OpenSim; theirs - ours = offset + rest:")
    console.out.print(table)
    ours, theirs = (f"{1e3 * missed:.1f}" for missed in found.missed)
    console.line(f"markers are missed by {ours} mm RMS in our model, by {theirs} in theirs")
    for note in found.notes:
        console.line(f"note: {note}")
