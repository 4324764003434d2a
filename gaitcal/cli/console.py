"""What a command prints: steps while it works, a table at the end. Nothing on standard output but results."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import rich.console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gaitcal.errors import Severity
from gaitcal.faults.verdict import Verdict
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.runtime import Progress, silent

if TYPE_CHECKING:
    from gaitcal.session.result import Calibration, Loads, TrialResult

LABELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.INFO: "note"}  # How a reason begins


class Console:
    """Prints as much as the user asked for: quiet, normal or verbose."""

    def __init__(self, *, quiet: bool, verbose: bool) -> None:
        self.quiet, self.verbose = quiet, verbose
        logging.getLogger("gaitcal").setLevel(logging.ERROR if quiet else logging.WARNING)  # waiting for a lock
        self.out = rich.console.Console(quiet=quiet, highlight=False, soft_wrap=True)
        self.err = rich.console.Console(stderr=True, quiet=quiet, highlight=False)

    def line(self, text: str = "") -> None:
        """A line of the result."""
        self.out.print(Text(text))

    @contextmanager
    def working(self) -> Iterator[Progress]:
        """While working: a spinner with the present step on a terminal, plain lines with -v, else nothing."""
        if self.err.is_terminal and not self.quiet:
            with self.err.status("starting") as status:
                yield lambda text: status.update(escape(text))
        elif self.verbose:
            yield lambda text: self.err.print(Text(text))
        else:
            yield silent


def frameless_table(words: Iterable[str], numbers: Iterable[str] = ()) -> Table:
    """An empty table without a frame: columns of words to the left, then columns of numbers to the right."""
    table = Table(show_edge=False, pad_edge=False)
    for head in words:
        table.add_column(head)
    for head in numbers:
        table.add_column(head, justify="right")
    return table


def print_calibration(console: Console, calibration: Calibration) -> None:
    """The summary of a calibration: fit of every trial, pelvis residuals, verdict."""
    from gaitcal.session.drafting import faulty_notes
    from gaitcal.session.truth_comparison import sums  # with it comes all of a calibration, which `check` does not need

    print_trials(console, calibration.trials)
    for total in sums(calibration, calibration.truth) if calibration.truth else ():
        console.line(total.sentence)
    print_verdict(console, calibration.verdict)
    for note in faulty_notes(calibration.left_out):
        console.line(note)
    print_remarks(console, (), calibration.notes)


def print_verdict(console: Console, verdict: Verdict) -> None:
    """How far the result can be believed, and why."""
    console.line(f"verdict: {verdict.judgement.value}. {verdict.sentence}")
    for reason in verdict.reasons:
        console.line(f"{LABELS[reason.severity]}: {reason.line} [{reason.code.value}]")
    if verdict.reasons:
        console.line(f"what a code means and what to do: gaitcal explain {verdict.reasons[0].code.value}")


def tell_kept(console: Console, kept: Sequence[str]) -> None:
    """Which folders of an earlier result are still there."""
    if kept:
        console.line(f"kept from the earlier result, made with its model: {', '.join(kept)}")


def tell_changed(console: Console, inputs: Sequence[str]) -> None:
    """Which inputs are no longer those that were read: the result is of what they held before."""
    if inputs:
        console.line(f"warning: changed while this ran, the result is of what was read: {', '.join(inputs)}; run again")


def print_remarks(console: Console, warnings: Sequence[str], notes: Sequence[str]) -> None:
    """Warnings, and with -v what was assumed."""
    for warning in warnings:
        console.line(f"warning: {warning}")
    if console.verbose:
        for note in notes:
            console.line(f"note: {note}")


def print_trials(console: Console, trials: Sequence[TrialResult]) -> None:
    """Fit of every trial beside its floors, its ratio to that of the joints, and pelvis residuals."""
    table = frameless_table(())
    table.add_column("trial", no_wrap=True)
    for name in ("frames", "markers", "nominal mm", "calibrated mm", "rigid floor mm", "joint floor mm", "ratio"):
        table.add_column(name, justify="right", min_width=max(map(len, name.split())))  # no word of it is cut
    for trial in trials:
        rows = {trial.name: ()} if trial.joint else {trial.name: (), "  pelvis and legs": LOWER_BODY}
        for name, segments in rows.items():
            table.add_row(Text(name), str(len(trial.calibrated.time)), *_fit(trial, segments))
    console.out.print(table)
    for trial in trials:
        if held := trial.held_out:
            parts = {"": (held.nominal, held.calibrated)} | ({", pelvis and legs": held.legs} if held.legs else {})
            for part, (nominal, calibrated) in parts.items():
                console.line(
                    f"{trial.name}{part}: on time blocks left out of the fit ({held.folds} folds), nominal "
                    f"{1e3 * nominal:.2f} mm, calibrated {1e3 * calibrated:.2f} mm"
                )
    for trial in trials:
        if trial.loads is not None:
            console.line(_valid(trial.name, trial.loads))
            if trial.loads.reactions.valid.any():
                console.line(_residuals(trial.name, trial.loads))


def _fit(trial: TrialResult, segments: tuple[str, ...]) -> list[str]:
    _, calibrated, _ = values = trial.rms_mm(*segments)
    floor = trial.joint_floor_mm(*segments)
    shown = ["-" if v is None else f"{v:.2f}" for v in (*values, floor)]
    ratio = f"{calibrated / floor:.2f}" if calibrated is not None and floor else "-"
    return [str(int(trial.calibrated.errors.kept(*segments).sum())), *shown, ratio]


def _valid(name: str, loads: Loads) -> str:
    reactions = loads.reactions
    right, left, both = (int(v.sum()) for v in (reactions.valid_r, reactions.valid_l, reactions.valid))
    return f"{name}: torques are valid in {right} frames of the right leg, {left} of the left, {both} of the whole body"


def _residuals(name: str, loads: Loads) -> str:
    parts = []
    for stage, moments in loads.moments.items():
        force, torque = moments.residual_rms(loads.reactions.valid)
        parts.append(f"{stage.short} {force:.1f} N, {torque:.1f} N·m")
    frames = int(loads.reactions.valid.sum())
    return f"{name}: pelvis residual RMS over {frames} valid frames: " + "; ".join(parts)
