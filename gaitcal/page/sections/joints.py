"""Preset Joints: where the joints lie and what the segments weigh, nominal and fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.page.sections.blocks import (
    Block,
    Cell,
    bullets,
    cell,
    fold,
    heading,
    intervals,
    number,
    number_rounded,
    pair,
    table,
    text,
)
from gaitcal.page.sections.near_truth import near_truth, near_truth_blocks
from gaitcal.session.parameter_words import (
    SHORTER_UNITS,
    Group,
    Row,
    blind_spots,
    counts_sentence,
    fixed_joints,
    inertial_groups,
    joint_groups,
)
from gaitcal.session.result import Calibration

MOVED = (
    "Fitted minus nominal value, with ±1 standard error where there is one. Positions are in the axes of the named "
    "segment: forward, up, to the right."
)
TRUE = " A ring around a dot: calibration found the truth; around zero: the nominal value was true."
LEANING = (
    "What the trials leave open, these joints take from {people} people of a cohort ({file}), whose mean may lie "
    "beside the nominal values; which parts of the body it teaches of: preset Provenance."
)
SIDES = {"r": "Right", "l": "Left", "": "Parameter"}
SEEN = ("fitted", "at bound")


def joint_blocks(calibration: Calibration) -> list[Block]:
    """All of the preset: what was fitted, how far it moved, how sure it is, and how near the truth."""
    errors = "" if calibration.standard_errors or not calibration.trials else "; none were computed for this result"
    out = [
        heading("What was calibrated"),
        text(
            f"{counts_sentence(calibration)} Positions are in the axes of the named segment: forward, up, and to the "
            "right, on both sides of the body (so a left hip centre lies at a negative “to the right”). A standard "
            f"error says by how much a value would scatter if the same trials were recorded again{errors}."
        ),
    ]
    if blind := blind_spots(calibration):
        out += [heading("Not determined by these trials", 4), bullets(blind, "warning")]
    truth = _truth(calibration)
    return [
        *out,
        *_joints(calibration, truth),
        *_inertias(calibration, truth),
        *near_truth_blocks(near_truth(calibration)),
    ]


def _truth(calibration: Calibration) -> Mapping[str, float]:
    """Parameter -> its true value, in the unit of the rows; empty where nothing is known."""
    known = calibration.truth.parameters if calibration.truth else ()
    return {p.name: p.truth * SHORTER_UNITS.get(p.unit, ("", 1.0))[1] for p in known}


def _joints(calibration: Calibration, truth: Mapping[str, float]) -> list[Block]:
    groups = joint_groups(calibration)
    if not groups:
        return [
            text(
                "Joint parameters were not calibrated: all joints lie where the static trial and the regressions put "
                "them."
            )
        ]
    bounds = _bounds(calibration)
    legs = [group for group in groups if _part(group) in LEG_JOINTS]
    others = [group for group in groups if group not in legs]
    out = [heading("Joint parameters: where the joints lie"), text(MOVED + (TRUE if truth else ""), "soft")]
    if (prior := calibration.study.joint_prior) is not None:
        out.append(text(LEANING.format(people=prior.people, file=prior.file)))
    out += [*_pictures(legs, truth, bounds), *_joint_tables(legs, truth)]
    if others:
        rest = [*_pictures(others, truth, bounds), *_joint_tables(others, truth)]
        out += [fold("Joints of trunk and arms", rest)] if legs else rest
    if fixed := fixed_joints(calibration):
        out.append(text(f"Kept at nominal values, as no trial here determines them: {fixed}.", "soft"))
    return out


def _part(group: Group) -> str:
    return (group.right or group.left)[0].part


def _bounds(calibration: Calibration) -> Mapping[str, float]:
    """Unit -> how far from its nominal value a parameter may move."""
    settings = calibration.study.settings
    return {"mm": settings.position_bound_mm, "deg": settings.orientation_bound_deg}


def _pictures(groups: Sequence[Group], truth: Mapping[str, float], bounds: Mapping[str, float]) -> list[Block]:
    """How far each parameter moved: positions, orientations."""
    rows = [row for group in groups for row in (*group.right, *group.left) if row.status in SEEN]
    shown = []
    for unit, title in (("mm", "Positions of joints: change in mm"), ("deg", "Orientations of joints: change in deg")):
        if found := [_interval(row, truth, bounds[unit]) for row in rows if row.unit == unit]:
            shown.append([heading(title, 4), intervals(unit, found)])
    return [pair(*shown)] if len(shown) == 2 else [block for blocks in shown for block in blocks]


def _interval(row: Row, truth: Mapping[str, float], bound: float) -> dict[str, Any]:
    return {
        "label": row.words.replace(" in the ", ", "),
        "side": row.side,
        "nominal": number_rounded(row.nominal),
        "fitted": number_rounded(row.fitted),
        "se": number_rounded(row.error),
        "truth": number_rounded(truth.get(row.name)),
        "bounds": [number_rounded(row.nominal - bound), number_rounded(row.nominal + bound)],
    }


def _joint_tables(groups: Sequence[Group], truth: Mapping[str, float]) -> list[Block]:
    return [block for group in groups for block in (heading(group.title, 4), *_tables(group, truth))]


def _tables(group: Group, truth: Mapping[str, float], percent: bool = False) -> list[Block]:
    """Right beside left; one table where there are no sides."""
    sided = bool(group.left) or not percent
    shown = [[_table(rows, truth, percent, sided)] for rows in (group.right, group.left) if rows]
    return [pair(*shown)] if len(shown) == 2 else [block for blocks in shown for block in blocks]


def _table(rows: Sequence[Row], truth: Mapping[str, float], percent: bool, sided: bool) -> Block:
    side = rows[0].side if sided else ""
    bars = any(row.error is not None for row in rows)
    known = any(row.name in truth for row in rows)
    head: list[Cell] = [cell(SIDES[side], side=side), "Nominal", "Fitted", "Change ± SE" if bars else "Change"]
    return table([*head, "Truth"] if known else head, [_row(row, truth, percent, known) for row in rows])


def _row(row: Row, truth: Mapping[str, float], percent: bool, known: bool) -> list[Cell]:
    digits = row.digits
    nominal, fitted = number(row.nominal, digits), number(row.fitted, digits)
    true = [number(truth.get(row.name), digits)] if known else []
    unseen, at_bound = row.status == "unidentifiable", row.status == "at bound"
    if unseen and fitted == nominal:
        return [cell(row.words, unit=row.unit), nominal, cell("kept, not determined", tone="look"), number(None), *true]
    change = number(row.change, digits, True)
    if row.error is not None:
        change += f" ± {number(row.error, digits)}"
    share = f"({number(100.0 * row.change / abs(row.nominal), 0, True)} %)" if percent and row.nominal else ""
    return [
        cell(f"{row.words}, not determined" if unseen else row.words, unit=row.unit),
        nominal,
        cell(f"{fitted}, at its bound" if at_bound else fitted, tone="look" if at_bound or unseen else ""),
        cell(change, unit=share),
        *true,
    ]


def _inertias(calibration: Calibration, truth: Mapping[str, float]) -> list[Block]:
    groups = inertial_groups(calibration)
    files = text(
        "All values, by the names that the other files use: parameters.csv (moments of inertia there in kg·mm², 100 "
        "times the numbers here).",
        "soft",
    )
    if not groups:
        measured = any(t.loads is not None and t.loads.reactions.valid.any() for t in calibration.trials)
        why = "" if measured else ": that needs a walking trial with force plates"
        words = f"Inertial parameters were not calibrated{why}. They come from the anthropometric table."
        return [text(words), files]
    out: list[Block] = [heading("Inertial parameters: masses, mass centres, moments of inertia")]
    for group in groups:
        out += [heading(group.title, 4), *_tables(group, truth, percent=True)]
    return [*out, files]
