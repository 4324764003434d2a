"""Strides of a result and their use: `strides.csv`.

A stride is valid if the moments of its leg are valid throughout. A frame of a leg is not valid if
its foot is on the ground without a plate, or on a plate that does not carry all of it
(`dynamics/ground_reactions.py`). The reason of an invalid stride is that of most of its frames.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from gaitcal.analysis.result import TrialResult
from gaitcal.errors import Code, InputError
from gaitcal.gait import cycles
from gaitcal.gait.moments import SIDE_WORDS, format_list
from gaitcal.gait.strides import is_turning, list_strides
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import Subject
from gaitcal.results.table_files import Column, read_rows

STRIDES: Final = "strides.csv"
STRIDE_COLUMNS: Final = (
    *("person", "session", "trial", "activity", "side", "stride", "start", "stop", "toe_off"),
    *("plate", "turns", "reason", "repetition"),
)
STRIDES_HEADER: Final = (
    "complete strides of each foot and repetitions of other activities, numbered as in cycles.csv",
    "start, stop: s, strike of that foot and its next one; toe_off: s, end of stance, empty if "
    "unknown",
    "plate: force plates that carry the foot; turns: 1 for a stride that turns and is in no mean",
    "reason: why moments of the leg are not valid throughout; empty where they are",
    "repetition: 1 for a repetition of the pelvis motion, 0 for a stride",
)
"""Comment lines above the header."""
TIME_DIGITS: Final = 6
REFUSED = "the verdict refuses this leg"
NO_PLATES = "no force plates"
BESIDE = "foot beside the plate"
PART = "part of the stance beside the plate"
SEATED = "on a seat"
NOT_WHOLLY = "foot not wholly on plates that carry no other foot"
ENDS = "at the end of the recording"
UNSEEN = "the leg lacks visible markers"
# s: frames this near to an end of a trial are lost with the ends of its splines and filters
NEAR_END = 0.3


@dataclass(frozen=True, kw_only=True)
class StrideUse:
    """One complete stride, or one repetition of another activity."""

    trial: str
    activity: str  # As in `cycles.csv`
    side: str
    number: int
    cycle: cycles.GaitCycle  # s of the recording
    plate: str  # Names of the plates that carry the foot in it; empty: none
    turns: bool  # Whether it turns and is therefore not in means
    reason: str  # Why moments of the leg are not valid throughout; empty where they are
    repeats: bool = False  # It is no stride, but a repetition of another activity

    @property
    def whole(self) -> bool:
        """Whether moments of the leg are valid throughout."""
        return not self.reason


def collect_stride_uses(trial: TrialResult) -> tuple[StrideUse, ...]:
    """Collect every complete stride, right ones first; none of a functional trial."""
    if trial.joint is not None:
        return ()
    turning_strides = {(s.side, s.number) for s in trial.strides if is_turning(s.turn)}
    out = []
    for foot, side in enumerate(SIDES):
        for count, cycle in enumerate(list_strides(trial.events)[side], start=1):
            plate, reason = _check_stride(trial, foot, side, cycle)
            turning = (side, count) in turning_strides
            out.append(
                StrideUse(
                    trial=trial.name,
                    activity=trial.activity,
                    side=side,
                    number=count,
                    cycle=cycle,
                    plate=plate,
                    turns=turning,
                    reason=reason,
                    repeats=bool(trial.events.repeats),
                )
            )
    return tuple(out)


def summarise_usable_strides(uses: Iterable[StrideUse]) -> str:
    """Summarise the strides with valid moments.

    `Usable for moments: 1 of 4 right, 2 of 4 left strides; others: foot beside the plate.`
    """
    if not (uses := tuple(uses)):
        return "No complete stride."
    counts = []
    for side in SIDES:
        is_usable = [use.whole for use in uses if use.side == side]
        counts.append(f"{sum(is_usable)} of {len(is_usable)} {SIDE_WORDS[side]}")
    kinds = {use.repeats for use in uses}
    nouns = [
        noun for repeats, noun in ((False, "strides"), (True, "repetitions")) if repeats in kinds
    ]
    reasons = list_reasons(uses)
    others = f"; others: {reasons}" if reasons else ""
    return f"Usable for moments: {', '.join(counts)} {' and '.join(nouns)}{others}."


def list_reasons(uses: Iterable[StrideUse]) -> str:
    """List the reasons of invalid strides, the most frequent first."""
    reasons = Counter(use.reason for use in uses if not use.whole)
    return format_list([reason for reason, _ in reasons.most_common()])


def _check_stride(
    trial: TrialResult, foot: int, side: str, cycle: cycles.GaitCycle
) -> tuple[str, str]:
    """Return the plates of one stride, and the reason if it is not valid."""
    if trial.loads is None:
        return "", NO_PLATES
    time, found = trial.body.time, trial.loads.reactions
    inside = (time >= cycle.start) & (time <= cycle.stop)
    stance = inside & (time < (cycle.toe_off or cycle.stop))
    # Only plates that carry this foot in its stance, each once.
    plates = dict.fromkeys(
        name for name, carried, frames in found.steps if carried == foot and stance[frames].any()
    )
    plate_names = ", ".join(plates)
    lost = inside & ~found.valid_legs[:, foot]
    if side in trial.refused_legs:
        return plate_names, REFUSED
    if not lost.any():
        return plate_names, ""
    loaded, resting = found.loaded[:, foot], found.resting[:, foot]
    # Splines have no valid accelerations at the ends of a trial.
    near_end = (time < time[0] + NEAR_END) | (time > time[-1] - NEAR_END)
    if trial.events.repeats and not (lost & ~near_end).any():
        return plate_names, ENDS
    beside_plate = PART if (loaded & stance).any() else BESIDE
    seated = lost & (np.False_ if found.seated is None else found.seated)
    kinds = {
        SEATED: seated,
        beside_plate: lost & resting & ~loaded & ~seated,
        NOT_WHOLLY: lost & loaded & ~seated,
    }
    remaining = lost & ~loaded & ~resting & ~seated
    kinds |= {ENDS: remaining & near_end, UNSEEN: remaining & ~near_end}
    return plate_names, max(kinds, key=lambda kind: int(np.count_nonzero(kinds[kind])))


def average_toe_offs(uses: Iterable[StrideUse]) -> dict[str, float]:
    """Average the end of stance over straight strides.

    Parameters
    ----------
    uses
        Strides of one activity.

    Returns
    -------
    dict
        Side -> % of the stride; without a side of which no stride has a known end of stance.
    """
    found: dict[str, list[float]] = {side: [] for side in SIDES}
    for use in uses:
        if not use.turns and use.cycle.stance is not None:
            found[use.side].append(use.cycle.stance)
    return {side: float(np.mean(percents)) for side, percents in found.items() if percents}


def build_use_columns(subject: Subject, uses: Iterable[StrideUse]) -> dict[str, Column]:
    """Build the columns of `strides.csv`.

    Returns: `STRIDE_COLUMNS` by name.
    """
    rows = [
        (
            *(subject.name, subject.session, use.trial, use.activity, use.side, use.number),
            *(use.cycle.start, use.cycle.stop, use.cycle.toe_off),
            *(use.plate, int(use.turns), use.reason, int(use.repeats)),
        )
        for use in uses
    ]
    columns: dict[str, Column] = {
        name: [row[k] for row in rows] for k, name in enumerate(STRIDE_COLUMNS)
    }
    for name in ("start", "stop", "toe_off"):
        columns[name] = np.round(np.array(columns[name], dtype=np.float64), TIME_DIGITS)
    return columns


def parse_uses(rows: Iterable[Mapping[str, str]]) -> tuple[StrideUse, ...]:
    """Parse the rows of `strides.csv`, column -> text; raise ValueError for a wrong number."""
    return tuple(
        StrideUse(
            trial=row["trial"],
            activity=row["activity"],
            side=row["side"],
            number=int(row["stride"]),
            cycle=cycles.GaitCycle(
                float(row["start"]),
                float(row["stop"]),
                float(row["toe_off"]) if row["toe_off"] else None,
            ),
            plate=row["plate"],
            turns=row["turns"] == "1",
            reason=row["reason"],
            repeats=row["repetition"] == "1",
        )
        for row in rows
    )


def read_uses(folder: Path) -> tuple[StrideUse, ...]:
    """Read `strides.csv` of a result, or of its folder of further trials.

    Parameters
    ----------
    folder
        Contains the file.

    Returns
    -------
    tuple of StrideUse
        All complete strides and repetitions.

    Raises
    ------
    InputError
        The file is damaged, or missing, as in results of earlier versions.
    """
    if not (folder / STRIDES).exists():
        message = f"has no {STRIDES}, as in earlier versions; calibrate, or run dynamics, again"
        raise InputError(message, source=folder, code=Code.NO_RESULT)
    return read_rows(folder / STRIDES, STRIDE_COLUMNS, parse_uses)
