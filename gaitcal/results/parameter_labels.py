"""Describe the parameters of a subject: fitted values, changes, errors, unidentifiable ones."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.analysis.parameter_table import list_parameter_rows
from gaitcal.analysis.result import Calibration
from gaitcal.calibration.identifiability import NEEDED_RANGE
from gaitcal.gait import moments
from gaitcal.model.coordinates import JOINT_TABLE, split_side
from gaitcal.model.linkage import JOINTS, Source
from gaitcal.study.settings import Protocol

ENOUGH_MOTION_DEG = float(np.degrees(NEEDED_RANGE))
GROUPS = tuple(JOINT_TABLE)
EQUAL = 1e-9
SHORTER_UNITS = {"kg*mm^2": ("kg·cm²", 0.01)}
"""Units of the page where those of the files would make the numbers too long to read."""


@dataclass(frozen=True, kw_only=True)
class LabelledParameter:
    """One parameter."""

    name: str  # As in `parameters.csv`
    title: str  # Position and direction in one
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
        """Number of meaningful decimals."""
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
    right: tuple[LabelledParameter, ...]  # Or the only rows, where there are no sides
    left: tuple[LabelledParameter, ...]
    kept: int  # Parameters of this joint that no trial was to fit


def group_joint_parameters(calibration: Calibration) -> tuple[ParameterGroup, ...]:
    """Group the joint parameters that were to be fitted by joint.

    Parameters
    ----------
    calibration
        A finished calibration.

    Returns
    -------
    tuple of ParameterGroup
        Joints without such parameters are omitted.
    """
    rows = _label_parameters(calibration, joints=True)
    groups = []
    for joint in GROUPS:
        of_joint = [row for row in rows if row.part == joint]
        # Joints that no trial was to fit are not listed.
        shown = [row for row in of_joint if row.status != "fixed"]
        if shown:
            groups.append(
                ParameterGroup(
                    moments.describe_joint(joint), *_split_sides(shown), len(of_joint) - len(shown)
                )
            )
    return tuple(groups)


def group_inertial_parameters(calibration: Calibration) -> tuple[ParameterGroup, ...]:
    """Group the fitted inertial parameters by segment.

    Parameters
    ----------
    calibration
        A finished calibration.

    Returns
    -------
    tuple of ParameterGroup
        One set of rows per segment if left equals right.
    """
    rows = [row for row in _label_parameters(calibration, joints=False) if row.status != "fixed"]
    groups = []
    for segment in dict.fromkeys(row.part for row in rows):
        right, left = _split_sides([row for row in rows if row.part == segment])
        title = moments.capitalise(moments.describe_segment(segment))
        if left and _are_mirrored(right, left):
            title, left = f"{title} (right and left alike)", ()
        groups.append(ParameterGroup(title, right, left, 0))
    return tuple(groups)


def _split_sides(
    rows: list[LabelledParameter],
) -> tuple[tuple[LabelledParameter, ...], tuple[LabelledParameter, ...]]:
    """Split rows into those of the right side (or no side) and those of the left."""
    return tuple(row for row in rows if row.side != "l"), tuple(
        row for row in rows if row.side == "l"
    )


def list_fixed_joints(calibration: Calibration) -> str:
    """List the joints that kept all nominal parameters.

    Parameters
    ----------
    calibration
        A finished calibration.

    Returns
    -------
    str
        A list for a sentence; empty if there are none.
    """
    moved = {
        row.part for row in _label_parameters(calibration, joints=True) if row.status != "fixed"
    }
    titles = [moments.describe_joint(joint) for joint in GROUPS if joint not in moved]
    return moments.format_list([title[0].lower() + title[1:] for title in titles])


def describe_unidentifiable(calibration: Calibration) -> tuple[str, ...]:
    """Describe, joint by joint, the parameters that the trials do not determine.

    Parameters
    ----------
    calibration
        A finished calibration.

    Returns
    -------
    tuple of str
        One sentence for each joint.
    """
    joints: dict[str, list[str]] = {}
    for name in calibration.unidentifiable:
        joints.setdefault(name.split(".")[0], []).append(name)
    out = []
    for joint, names in joints.items():
        # Inertial parameters have a segment instead of a joint, and no range of motion.
        if joint not in {j.name for j in JOINTS}:
            parameters = moments.format_list([moments.describe_parameter(n) for n in names])
            out.append(f"{moments.describe_segment(joint).capitalize()}: {parameters}.")
            continue
        # The usual reason is that the joint hardly moved.
        moved = compute_range_of_motion(calibration, joint)
        parameters = moments.format_list([moments.describe_parameter(n) for n in names])
        text = (
            f"{moments.describe_joint(joint).capitalize()}: {parameters}; "
            f"{_describe_kept(calibration, names)}."
        )
        if moved is not None:
            text += f" The joint moved {moved:.0f}° at most"
            text += (
                f"; about {ENOUGH_MOTION_DEG:.0f}° are needed. Add a functional (single-joint) "
                "trial of this joint."
                if moved < ENOUGH_MOTION_DEG
                else ", but its parameters are not observable from these movements."
            )
        out.append(text)
    return tuple(out)


def _describe_kept(calibration: Calibration, names: Sequence[str]) -> str:
    """Describe the value that undetermined joint parameters keep."""
    several, study, prior = len(names) > 1, calibration.study, calibration.joint_prior
    near = prior.describe_fallback(names) if prior else ""
    if near:
        return f"{'they stay' if several else 'it stays'} near {near}"
    if study.settings.decided_by is Protocol.EVIDENCE:
        return (
            "they stay near their nominal values" if several else "it stays near its nominal value"
        )
    return "they keep their nominal values" if several else "it keeps its nominal value"


def compute_range_of_motion(calibration: Calibration, joint: str) -> float | None:
    """Compute the largest range of a joint's coordinates over all trials.

    Parameters
    ----------
    calibration
        A finished calibration.
    joint
        Name with side: `knee_r`.

    Returns
    -------
    float or None
        Degrees, in the trial that moves the joint most; None if no trial has its coordinates.
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


def count_fitted(calibration: Calibration) -> tuple[int, int]:
    """Count the fitted joint parameters and the independent fitted inertial parameters."""
    joint = sum(
        r.status in ("fitted", "at bound") for r in _label_parameters(calibration, joints=True)
    )
    return joint, len(
        calibration.inertial.names
    ) if calibration.inertial and calibration.inertial.moved else 0


def summarise_fitted(calibration: Calibration) -> str:
    """Summarise in sentences how many parameters were fitted.

    Parameters
    ----------
    calibration
        A finished calibration.

    Returns
    -------
    str
        One or two sentences for the page.
    """
    joint, inertial = count_fitted(calibration)
    parts = []
    if joint:
        parts.append(f"{moments.format_count(joint, 'joint parameter')} (joint positions and axes)")
    if inertial:
        # One variable for both sides: fewer variables than fitted parameters.
        is_symmetric = inertial < sum(
            r.status == "fitted" for r in _label_parameters(calibration, joints=False)
        )
        description = "masses, mass centres, moments of inertia" + (
            ", alike for right and left" if is_symmetric else ""
        )
        parts.append(f"{moments.format_count(inertial, 'inertial parameter')} ({description})")
    kept = "All others keep their nominal values."
    prior = calibration.joint_prior
    if calibration.unidentifiable and prior is not None:
        near = prior.describe_fallback(calibration.unidentifiable)
        kept = f"What these trials do not determine stays near {near or 'nominal values'}. {kept}"
    elif not parts:
        return "Nothing was fitted: all parameters keep their nominal values."
    return f"Fitted: {moments.format_list(parts) or 'nothing'}. {kept}"


def _label_parameters(calibration: Calibration, *, joints: bool) -> list[LabelledParameter]:
    bound = set(calibration.joint.at_bound if calibration.joint else ())
    rows = []
    for entry in list_parameter_rows(calibration):
        if str(entry["kind"]).startswith("joint ") is not joints:
            continue
        name, status, error = str(entry["name"]), str(entry["status"]), entry["standard_error"]
        # kg·cm² instead of kg·mm², so that numbers stay short.
        unit, scale = SHORTER_UNITS.get(str(entry["unit"]), (str(entry["unit"]), 1.0))
        rows.append(
            LabelledParameter(
                name=name,
                title=moments.describe_parameter(name),
                unit=unit,
                nominal=scale * float(entry["nominal"]),
                fitted=scale * float(entry["fitted"]),
                error=scale * float(error) if error is not None and math.isfinite(error) else None,
                status="at bound" if status == "fitted" and name in bound else status,
            )
        )
    return rows


def _are_mirrored(
    right: tuple[LabelledParameter, ...], left: tuple[LabelledParameter, ...]
) -> bool:
    def index_values(rows: tuple[LabelledParameter, ...]) -> dict[str, tuple[float, float]]:
        return {r.title: (abs(r.nominal), abs(r.fitted)) for r in rows}

    a, b = index_values(right), index_values(left)
    return a.keys() == b.keys() and all(np.allclose(a[k], b[k], rtol=EQUAL, atol=0.0) for k in a)
