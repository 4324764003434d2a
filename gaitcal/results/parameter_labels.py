"""A person's parameters in words: which were fitted, how far they moved, how sure they are, which
could not be seen.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.analysis.parameter_table import parameter_rows
from gaitcal.analysis.result import Calibration
from gaitcal.calibration.identifiability import NEEDED_TURN
from gaitcal.calibration.joint_prior import prior_of_study
from gaitcal.gait import moments
from gaitcal.model.coordinates import JOINT_TABLE, split_side
from gaitcal.model.linkage import JOINTS, Source
from gaitcal.study.settings import Protocol

ENOUGH_MOTION_DEG = float(np.degrees(NEEDED_TURN))
GROUPS = tuple(JOINT_TABLE)
EQUAL = 1e-9
SHORTER_UNITS = {"kg*mm^2": ("kg·cm²", 0.01)}
"""Units of the page where those of the files would make the numbers too long to read."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One parameter."""

    name: str  # As in `parameters.csv`
    words: str  # Place and direction in one
    place: str  # What the value is of; rows of one place stand together. Nothing for a mass.
    direction: str
    unit: str
    nominal: float
    fitted: float
    error: float | None
    status: str  # `fitted`, `at bound`, `unidentifiable` or `fixed`

    @property
    def part(self) -> str:
        """The joint or segment, without its side: `hip`."""
        return split_side(self.name.split(".")[0])[0]

    @property
    def side(self) -> str:
        """`r`, `l`, or nothing where there are no sides."""
        return split_side(self.name.split(".")[0])[1]

    @property
    def digits(self) -> int:
        """Decimals that make sense."""
        if self.unit == "kg":
            return 2
        return 0 if self.unit == "kg·cm²" and abs(self.nominal) >= 100.0 else 1

    @property
    def change(self) -> float:
        """Fitted minus nominal."""
        return self.fitted - self.nominal


@dataclass(frozen=True)
class ParameterGroup:
    """The parameters of one joint or one segment."""

    title: str
    right: tuple[Row, ...]  # Or the only rows, where there are no sides
    left: tuple[Row, ...]
    kept: int  # Parameters of this joint that no trial was to fit


def joint_groups(calibration: Calibration) -> tuple[ParameterGroup, ...]:
    """Joint parameters that were to be fitted, joint by joint; joints without any are left out."""
    rows = _rows(calibration, joints=True)
    groups = []
    for joint in GROUPS:
        of_joint = [row for row in rows if row.part == joint]
        shown = [row for row in of_joint if row.status != "fixed"]
        if shown:
            groups.append(
                ParameterGroup(
                    moments.joint_words(joint), *_sides(shown), len(of_joint) - len(shown)
                )
            )
    return tuple(groups)


def inertial_groups(calibration: Calibration) -> tuple[ParameterGroup, ...]:
    """Inertial parameters that were fitted, segment by segment; one set where left equals right."""
    rows = [row for row in _rows(calibration, joints=False) if row.status != "fixed"]
    groups = []
    for segment in dict.fromkeys(row.part for row in rows):
        right, left = _sides([row for row in rows if row.part == segment])
        title = moments.capitalised(moments.segment_words(segment))
        if left and _mirrored(right, left):
            title, left = f"{title} (right and left alike)", ()
        groups.append(ParameterGroup(title, right, left, 0))
    return tuple(groups)


def _sides(rows: list[Row]) -> tuple[tuple[Row, ...], tuple[Row, ...]]:
    """Those of the right side, or without a side, and those of the left."""
    return tuple(row for row in rows if row.side != "l"), tuple(
        row for row in rows if row.side == "l"
    )


def fixed_joints(calibration: Calibration) -> str:
    """Which joints kept all their nominal parameters, in words; empty for none."""
    moved = {row.part for row in _rows(calibration, joints=True) if row.status != "fixed"}
    titles = [moments.joint_words(joint) for joint in GROUPS if joint not in moved]
    return moments.listed([title[0].lower() + title[1:] for title in titles])


def blind_spots(calibration: Calibration) -> tuple[str, ...]:
    """One sentence for each joint with parameters that the trials cannot see."""
    joints: dict[str, list[str]] = {}
    for name in calibration.unidentifiable:
        joints.setdefault(name.split(".")[0], []).append(name)
    out = []
    for joint, names in joints.items():
        if joint not in {j.name for j in JOINTS}:
            words = moments.listed([moments.parameter_words(n) for n in names])
            out.append(f"{moments.segment_words(joint).capitalize()}: {words}.")
            continue
        moved = range_of_motion(calibration, joint)
        words = moments.listed([moments.parameter_words(n) for n in names])
        text = f"{moments.joint_words(joint).capitalize()}: {words}; {_kept(calibration, names)}."
        if moved is not None:
            text += f" The joint moved {moved:.0f}° at most"
            text += (
                f"; about {ENOUGH_MOTION_DEG:.0f}° are needed. Add an isolated trial of this joint."
                if moved < ENOUGH_MOTION_DEG
                else ", but these trials do not move it in the way that shows them."
            )
        out.append(text)
    return tuple(out)


def _kept(calibration: Calibration, names: Sequence[str]) -> str:
    """What becomes of joint parameters that the trials cannot see."""
    several, study = len(names) > 1, calibration.study
    if near := prior_of_study(study.settings.joint_prior, study.joint_prior).describe_fallback(
        names
    ):
        return f"{'they stay' if several else 'it stays'} near {near}"
    if study.settings.decided_by is Protocol.EVIDENCE:
        return (
            "they stay near their nominal values" if several else "it stays near its nominal value"
        )
    return "they keep their nominal values" if several else "it keeps its nominal value"


def range_of_motion(calibration: Calibration, joint: str) -> float | None:
    """Degrees that the joint's most mobile coordinate moves, in the trial that moves it most; None
    if in no trial.
    """
    names = [
        e.name
        for j in JOINTS
        if j.name == joint
        for e in j.elements
        if e.source is Source.COORDINATE
    ]
    best = None
    for trial in calibration.trials:
        motion = trial.calibrated
        if names and set(names) <= set(motion.coordinates):
            q = motion.q[:, [motion.coordinates.index(n) for n in names]]
            moved = float(np.degrees(np.ptp(q, axis=0)).max())
            best = moved if best is None else max(best, moved)
    return best


def counts(calibration: Calibration) -> tuple[int, int]:
    """How many joint parameters and how many independent inertial ones were fitted."""
    joint = sum(r.status in ("fitted", "at bound") for r in _rows(calibration, joints=True))
    return joint, len(
        calibration.inertial.names
    ) if calibration.inertial and calibration.inertial.moved else 0


def counts_sentence(calibration: Calibration) -> str:
    """How many parameters were fitted, in words."""
    joint, inertial = counts(calibration)
    parts = []
    if joint:
        parts.append(f"{moments.counted(joint, 'joint parameter')} (where the joints lie)")
    if inertial:
        alike = inertial < sum(r.status == "fitted" for r in _rows(calibration, joints=False))
        what = "masses, mass centres, moments of inertia" + (
            ", alike for right and left" if alike else ""
        )
        parts.append(f"{moments.counted(inertial, 'inertial parameter')} ({what})")
    kept = "All others keep their nominal values."
    study = calibration.study
    if calibration.unidentifiable and study.settings.decided_by is Protocol.EVIDENCE:
        near = prior_of_study(study.settings.joint_prior, study.joint_prior).describe_fallback(
            calibration.unidentifiable
        )
        kept = f"What these trials do not determine stays near {near or 'nominal values'}. {kept}"
    elif not parts:
        return "Nothing was fitted: all parameters keep their nominal values."
    return f"Fitted: {moments.listed(parts) or 'nothing'}. {kept}"


def _rows(calibration: Calibration, *, joints: bool) -> list[Row]:
    bound = set(calibration.joint.at_bound if calibration.joint else ())
    rows = []
    for entry in parameter_rows(calibration):
        if str(entry["kind"]).startswith("joint ") is not joints:
            continue
        name, status, error = str(entry["name"]), str(entry["status"]), entry["standard_error"]
        unit, scale = SHORTER_UNITS.get(str(entry["unit"]), (str(entry["unit"]), 1.0))
        rows.append(
            Row(
                name=name,
                words=moments.parameter_words(name),
                place=moments.parameter_place(name),
                direction=moments.parameter_direction(name),
                unit=unit,
                nominal=scale * float(entry["nominal"]),
                fitted=scale * float(entry["fitted"]),
                error=scale * float(error) if error is not None and math.isfinite(error) else None,
                status="at bound" if status == "fitted" and name in bound else status,
            )
        )
    return rows


def _mirrored(right: tuple[Row, ...], left: tuple[Row, ...]) -> bool:
    def key(rows: tuple[Row, ...]) -> dict[str, tuple[float, float]]:
        return {r.words: (abs(r.nominal), abs(r.fitted)) for r in rows}

    a, b = key(right), key(left)
    return a.keys() == b.keys() and all(np.allclose(a[k], b[k], rtol=EQUAL, atol=0.0) for k in a)
