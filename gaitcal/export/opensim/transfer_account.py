"""Report of a joint transfer in tables and sentences, for the screen and for a page.

Lengths and moment arms of muscles are OpenSim's, where it is installed. Each coordinate of the legs
goes through its range, with the others at their default. A moment arm r is minus the derivative of
a muscle's length with respect to the coordinate, with all constraints satisfied. Between two
neighbouring values the length must change by -(r_1 + r_2) / 2 times the step. Where it differs by
more than `JUMP`, the muscle has jumped over a wrapping surface.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim import joint_moves, joint_transfer, osim_correspondence

VALUES = 13
"""Values of a coordinate over its range."""
JUMP = 2e-3
"""m: steps of a tenth of a range are too coarse for smaller jumps."""
CROSSES = 1e-4
"""m, least change of a muscle's length with a coordinate that it crosses."""


@dataclass(frozen=True, kw_only=True)
class MusclePath:
    """One muscle over the range of one coordinate."""

    muscle: str
    coordinate: str
    values: Array  # (n,) rad
    length: Array  # (n,) m
    arm: Array  # (n,) m

    @property
    def jumps(self) -> tuple[float, ...]:
        """rad, middles of the steps in which the length jumps."""
        step = np.diff(self.values)
        smooth = -0.5 * (self.arm[1:] + self.arm[:-1]) * step
        found = np.abs(np.diff(self.length) - smooth) > JUMP
        return tuple(float(v) for v in (self.values[:-1] + 0.5 * step)[found])


@dataclass(frozen=True, kw_only=True)
class MuscleChange:
    """A muscle about a coordinate, before and after."""

    before: MusclePath
    after: MusclePath

    @property
    def worst(self) -> int:
        """Index in the range at which the moment arm changes most."""
        return int(np.argmax(np.abs(self.after.arm - self.before.arm)))

    @property
    def lengthened(self) -> float:
        """m, largest change of the length, with its sign."""
        change = self.after.length - self.before.length
        return float(change[np.argmax(np.abs(change))])

    @property
    def new_jumps(self) -> tuple[float, ...]:
        """rad, values at which the muscle jumps after the transfer only."""
        return tuple(v for v in self.after.jumps if v not in self.before.jumps)


def is_opensim_installed() -> bool:
    """Check whether OpenSim can compute muscles."""
    return find_spec("opensim") is not None


def list_leg_ranges(legs: Sequence[osim_correspondence.LegJoint]) -> dict[str, Array]:
    """List the coordinates of the legs, except locked ones, with values over their range.

    Parameters
    ----------
    legs : sequence of LegJoint
        Leg joints of the model.

    Returns
    -------
    dict
        Coordinate -> (n,) rad.
    """
    ranges = {}
    for leg in legs:
        rotating = {axis.coordinate for axis in leg.theirs.axes or () if axis.rotates}
        for c in leg.theirs.coordinates:
            if c.name in rotating and not c.locked and c.high > c.low:
                ranges[c.name] = np.linspace(c.low, c.high, VALUES)
    return ranges


def compute_muscle_paths(
    osim: Path, ranges: Mapping[str, Array]
) -> dict[tuple[str, str], MusclePath]:
    """Compute length and moment arms of every muscle that crosses a coordinate.

    Parameters
    ----------
    osim : Path
        Model file.
    ranges : mapping
        Coordinate -> (n,) rad.

    Returns
    -------
    dict
        (muscle, coordinate) -> path.

    Raises
    ------
    InputError
        OpenSim cannot load or assemble the model.
    """
    import opensim  # type: ignore[import-untyped,import-not-found,unused-ignore]

    # OpenSim would write opensim.log in the working directory.
    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Off")
    out = {}
    try:
        model = opensim.Model(str(osim))
        state = model.initSystem()
        found = model.getMuscles()
        muscles = [found.get(i) for i in range(found.getSize())]
        default = opensim.Vector(state.getQ())
        for name, values in ranges.items():
            coordinate = model.getCoordinateSet().get(name)
            lengths = np.empty((len(values), len(muscles)))
            postures = []
            for i, value in enumerate(values):
                coordinate.setValue(state, float(value), False)
                model.realizePosition(state)
                # Assembling takes longer than everything else, and only a patella needs it.
                violation = np.abs(state.getQErr().to_numpy()).max(initial=0.0)
                if violation > model.get_assembly_accuracy():
                    model.assemble(state)
                    model.realizePosition(state)
                postures.append(opensim.Vector(state.getQ()))
                lengths[i] = [m.getLength(state) for m in muscles]
            crossing = np.flatnonzero(np.ptp(lengths, axis=0) > CROSSES)
            arms = np.empty((len(values), len(crossing)))
            for i, posture in enumerate(postures):
                state.setQ(posture)
                model.realizePosition(state)
                arms[i] = [muscles[k].computeMomentArm(state, coordinate) for k in crossing]
            state.setQ(default)
            for k, arm in zip(crossing, arms.T, strict=True):
                muscle = muscles[k].getName()
                out[muscle, name] = MusclePath(
                    muscle=muscle, coordinate=name, values=values, length=lengths[:, k], arm=arm
                )
    except RuntimeError as error:
        message = f"OpenSim cannot use it: {' '.join(str(error).split())[:300]}"
        raise InputError(message, source=osim, code=Code.OTHER_MODEL) from None
    return out


def compare_muscles(
    before: Mapping[tuple[str, str], MusclePath], after: Mapping[tuple[str, str], MusclePath]
) -> list[MuscleChange]:
    """Compare muscles that cross a coordinate in both models, the largest change of an arm first.

    Parameters
    ----------
    before, after : mapping
        (muscle, coordinate) -> path.

    Returns
    -------
    list of MuscleChange
    """
    both = [
        MuscleChange(before=path, after=after[key]) for key, path in before.items() if key in after
    ]
    return sorted(both, key=lambda c: -float(np.abs(c.after.arm - c.before.arm).max()))


def _compute_arm_deviations(
    change: MuscleChange, draws: Sequence[Mapping[tuple[str, str], MusclePath]]
) -> Array | None:
    """Compute standard deviations of a moment arm over draws of the model.

    Returns: (n,) m, at the values of the coordinate; None with fewer than two draws.
    """
    key = change.before.muscle, change.before.coordinate
    arms = np.array([draw[key].arm for draw in draws if key in draw])  # (draws, n)
    return arms.std(axis=0, ddof=1) if len(arms) > 1 else None


MUSCLES_HEADER = (
    "muscle,coordinate,deg,length_before_mm,length_after_mm,arm_before_mm,arm_after_mm,arm_sd_mm"
)


def format_muscles_csv(
    changes: Sequence[MuscleChange], draws: Sequence[Mapping[tuple[str, str], MusclePath]] = ()
) -> str:
    """Format a CSV file with a row for each muscle, coordinate and value.

    Parameters
    ----------
    changes : sequence of MuscleChange
        Muscles before and after.
    draws : sequence of mapping
        Paths of draws of the model; `arm_sd_mm` is empty with fewer than two.

    Returns
    -------
    str
        Columns `MUSCLES_HEADER`.
    """
    lines = [MUSCLES_HEADER]
    for change in changes:
        before, after = change.before, change.after
        deviations = _compute_arm_deviations(change, draws)
        for k, value in enumerate(before.values):
            figures = (before.length[k], after.length[k], before.arm[k], after.arm[k])
            cells = [f'"{before.muscle}"', f'"{before.coordinate}"', f"{np.degrees(value):.3f}"]
            cells += [f"{1e3 * figure:.4f}" for figure in figures]
            cells.append("" if deviations is None else f"{1e3 * deviations[k]:.4f}")
            lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


# ----------------------------------------------------------------------------- tables and sentences

ROLLS = 0.1
"""mm, deg: larger errors of the standing bones are reported."""


@dataclass(frozen=True, kw_only=True)
class AccountTable:
    """Table with columns of text on the left of columns of numbers."""

    title: str
    description: str
    """Meaning of its figures, in a sentence."""
    text_columns: tuple[str, ...]
    number_columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    """Of a long table, the most important rows first."""
    of_muscles: bool = False
    """Whether it is long: a file contains the whole table."""


def make_joint_tables(done: joint_transfer.CalibratedOsim) -> Iterator[AccountTable]:
    """Make tables of registrations, joints, masses, and of what moved with bones.

    Parameters
    ----------
    done : CalibratedOsim
        Result of the transfer.

    Yields
    ------
    AccountTable
    """
    yield AccountTable(
        title="Bodies and segments",
        description="Markers of the segment, markers that the model has as well, and their RMS "
        "distance.",
        text_columns=("segment", "body"),
        number_columns=("markers", "shared", "RMS mm"),
        rows=tuple(
            (r.segment, r.body, str(r.markers), str(r.common), f"{1e3 * r.rms:.1f}")
            for r in done.registrations
        ),
    )
    yield AccountTable(
        title="Every joint, in both of its bodies",
        description="Displacement of its centre (of a hinge, its axis) and rotation, with standard "
        "errors; left: not moved.",
        text_columns=("joint", "theirs", "verdict", "in body"),
        number_columns=("moved mm", "+-", "deg", "+-"),
        rows=tuple(_make_joint_rows(done)),
    )
    if done.masses:
        yield AccountTable(
            title="Masses",
            description="Of all bodies of a segment, before and now.",
            text_columns=("segment", "bodies"),
            number_columns=("kg", "now"),
            rows=tuple(
                (m.segment, ", ".join(m.bodies), f"{m.theirs:.2f}", f"{m.ours:.2f}")
                for m in done.masses
            ),
        )
    if done.moved_points:
        yield AccountTable(
            title="Muscles with points that moved with their bones",
            description="Number of points, and displacement of the farthest.",
            text_columns=("muscle",),
            number_columns=("points moved", "farthest mm"),
            rows=tuple(
                (m.muscle, str(m.points), f"{1e3 * m.farthest:.1f}") for m in done.moved_points
            ),
            of_muscles=True,
        )


def _make_joint_rows(done: joint_transfer.CalibratedOsim) -> Iterator[tuple[str, ...]]:
    """Make a row for both bodies of each joint."""
    legs = {leg.ours: leg for leg in done.legs}
    for move in done.joints:
        found_by = legs[move.joint].found_by if move.joint in legs else ""
        theirs = move.theirs if found_by in ("", "name") else f"{move.theirs} (by {found_by})"
        ends = [end for end in (move.parent, move.child) if end is not None]
        if not ends:
            yield move.joint, theirs, "left" if theirs else "none", *[""] * 5
        verdict = "moved" if any(end.changed for end in ends) else "in place"
        for end in ends:
            numbers = (
                1e3 * end.moved,
                1e3 * end.errors[0],
                np.degrees(end.rotation),
                np.degrees(end.errors[1]),
            )
            cells = (f"{x:.1f}" if np.isfinite(x) else "" for x in numbers)
            yield move.joint, theirs, verdict, end.body, *cells


def describe_transfer(done: joint_transfer.CalibratedOsim) -> Iterator[str]:
    """Describe joints that stay, joints that are no hinges, and notes, a sentence each.

    Parameters
    ----------
    done : CalibratedOsim
        Result of the transfer.

    Yields
    ------
    str
    """
    for verdict in (joint_moves.MoveOutcome.UNDETERMINED, joint_moves.MoveOutcome.ABSENT):
        joints = [move.joint for move in done.joints if move.outcome is verdict]
        if joints:
            yield f"{', '.join(joints)}: {verdict.value}"
    for move in done.joints:
        if max(1e3 * move.rolling[0], np.degrees(move.rolling[1])) > ROLLS:
            yield (
                f"{move.theirs} rolls, or cannot rotate as the bones do: in the standing posture "
                f"it differs from our hinge by {1e3 * move.rolling[0]:.1f} mm, "
                f"{np.degrees(move.rolling[1]):.1f} deg"
            )
    yield from (f"note: {note}" for note in done.notes)


def make_muscle_table(
    changes: Sequence[MuscleChange], draws: Sequence[Mapping[tuple[str, str], MusclePath]] = ()
) -> AccountTable:
    """Make a table of every muscle and coordinate, where its moment arm changes most.

    Parameters
    ----------
    changes : sequence of MuscleChange
        Muscles before and after.
    draws : sequence of mapping
        Paths of draws of the model, for standard deviations.

    Returns
    -------
    AccountTable
    """
    rows = []
    for change in changes:
        k, deviations = change.worst, _compute_arm_deviations(change, draws)
        before = change.before
        arms = (f"{1e3 * path.arm[k]:.1f}" for path in (before, change.after))
        error = "" if deviations is None else f"{1e3 * deviations[k]:.1f}"
        angle = f"{np.degrees(before.values[k]):.0f}"
        longer = f"{1e3 * change.lengthened:+.1f}"
        jumps = ", ".join(f"{np.degrees(v):.0f}" for v in change.new_jumps)
        rows.append((before.muscle, before.coordinate, *arms, error, angle, longer, jumps))
    return AccountTable(
        title="Muscles",
        description="Moment arm before and after, at the value where it changes most, with its "
        "standard deviation over draws; largest change of length; values at which the muscle newly "
        "jumps over a wrapping surface.",
        text_columns=("muscle", "coordinate"),
        number_columns=("arm mm", "after", "+-", "at deg", "longer mm", "new jumps"),
        rows=tuple(rows),
        of_muscles=True,
    )
