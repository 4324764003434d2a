"""What putting joints into a model did, in tables and sentences: for the screen, and for a page beside the model."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.export.joint_moves import Verdict
from gaitcal.export.joint_transfer import CalibratedOsim
from gaitcal.export.muscle_paths import MuscleChange, MusclePath, arm_deviations

ROLLS = 0.1  # mm, deg: standing bones that are off by more are told


@dataclass(frozen=True, kw_only=True)
class AccountTable:
    """Columns of words to the left of columns of numbers."""

    title: str
    says: str  # What its figures are, in a sentence
    words: tuple[str, ...]
    numbers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]  # Those that matter most first, where not every one is of interest
    of_muscles: bool = False  # Long, and the whole of it in a file


def joint_tables(done: CalibratedOsim) -> Iterator[AccountTable]:
    """Bodies and segments, joints, masses, and what went with bones."""
    yield AccountTable(
        title="Which body is which segment",
        says="Markers of the segment, those that the model has, too, and how far these disagree, RMS.",
        words=("segment", "body"),
        numbers=("markers", "shared", "apart mm"),
        rows=tuple(
            (r.segment, r.body, str(r.markers), str(r.common), f"{1e3 * r.rms:.1f}") for r in done.registrations
        ),
    )
    yield AccountTable(
        title="Every joint, in both of its bodies",
        says="How far its centre (of a hinge, its axis) has moved and turned, with standard errors; left: as it was.",
        words=("joint", "theirs", "verdict", "in body"),
        numbers=("moved mm", "+-", "deg", "+-"),
        rows=tuple(_joint_rows(done)),
    )
    if done.masses:
        yield AccountTable(
            title="Masses",
            says="Of the bodies of a segment together, before and now.",
            words=("segment", "bodies"),
            numbers=("kg", "now"),
            rows=tuple((m.segment, ", ".join(m.bodies), f"{m.theirs:.2f}", f"{m.ours:.2f}") for m in done.masses),
        )
    if done.carried:
        yield AccountTable(
            title="Muscles whose points went with their bones",
            says="How many points, and how far the farthest.",
            words=("muscle",),
            numbers=("points carried", "farthest mm"),
            rows=tuple((m.muscle, str(m.points), f"{1e3 * m.farthest:.1f}") for m in done.carried),
            of_muscles=True,
        )


def _joint_rows(done: CalibratedOsim) -> Iterator[tuple[str, ...]]:
    legs = {leg.ours: leg for leg in done.legs}
    for move in done.joints:
        found_by = legs[move.joint].found_by if move.joint in legs else ""
        theirs = move.theirs if found_by in ("", "name") else f"{move.theirs} (by {found_by})"
        ends = [end for end in (move.parent, move.child) if end is not None]
        if not ends:
            yield move.joint, theirs, "left" if theirs else "none", *[""] * 5
        verdict = "moved" if any(end.changed for end in ends) else "in place"
        for end in ends:
            numbers = (1e3 * end.moved, 1e3 * end.errors[0], np.degrees(end.turn), np.degrees(end.errors[1]))
            words = (f"{x:.1f}" if np.isfinite(x) else "" for x in numbers)
            yield move.joint, theirs, verdict, end.body, *words


def sentences(done: CalibratedOsim) -> Iterator[str]:
    """Joints that stay, joints that are no hinges, and what else the user should know."""
    for verdict in (Verdict.UNDETERMINED, Verdict.ABSENT):
        if which := [move.joint for move in done.joints if move.verdict is verdict]:
            yield f"{', '.join(which)}: {verdict.value}"
    for move in done.joints:
        if max(1e3 * move.rolls[0], np.degrees(move.rolls[1])) > ROLLS:
            yield (
                f"{move.theirs} rolls, or cannot turn as the bones are turned: "
                f"as the person stands, it and our hinge differ by {1e3 * move.rolls[0]:.1f} mm, "
                f"{np.degrees(move.rolls[1]):.1f} deg"
            )
    yield from (f"note: {note}" for note in done.notes)


def muscle_table(
    changes: Sequence[MuscleChange], draws: Sequence[Mapping[tuple[str, str], MusclePath]] = ()
) -> AccountTable:
    """Every muscle about every coordinate, where in the range its moment arm changes most."""
    rows = []
    for change in changes:
        k, spread = change.worst, arm_deviations(change, draws)
        arms = (f"{1e3 * path.arm[k]:.1f}" for path in (change.before, change.after))
        error = "" if spread is None else f"{1e3 * spread[k]:.1f}"
        at = f"{np.degrees(change.before.values[k]):.0f}"
        longer = f"{1e3 * change.lengthened:+.1f}"
        jumps = ", ".join(f"{np.degrees(v):.0f}" for v in change.new_jumps)
        rows.append((change.before.muscle, change.before.coordinate, *arms, error, at, longer, jumps))
    return AccountTable(
        title="Muscles",
        says="Moment arm before and after where in the range it changes most, with its standard deviation over "
        "draws; the largest change of length; where the muscle jumps over a wrapping surface that it did not before.",
        words=("muscle", "coordinate"),
        numbers=("arm mm", "after", "+-", "at deg", "longer mm", "new jumps"),
        rows=tuple(rows),
        of_muscles=True,
    )
