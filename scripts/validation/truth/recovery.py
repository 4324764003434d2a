"""Part `recovery`: how near the truth the main job comes, joint by joint, and whether its error bars hold.

People of part `synthetic` with gaitcal's defaults, every one (`default`), these with the gait trial alone
(`gait-only`): what a user has; or, as in that part, told that plates and axes are exact (`exact`), which no user knows.

Printed: RMS error of joint parameters before (nominal) and after, median over people, of all that a trial may move.
Those that the result declares undetermined stay nominal, and count: how many is told, and the error without them.
And how often 68 % and 95 % intervals cover the truth: joint parameters by joint (those with an interval), inertial
parameters by kind, joint torques, powers and moment vectors in valid frames. A person takes half a minute, with
`gait-only` less.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from gaitcal.dynamics.joint_kinetics import COMPONENTS, POWER_JOINTS, POWERS, VECTOR_FRAMES
from scripts.validation.error_bars import HALF_WIDTHS
from scripts.validation.truth.synthetic import (
    INERTIAL_KINDS,
    JOINT_KINDS,
    JOINTS,
    TORQUES,
    UNDETERMINED,
    SyntheticPerson,
)

LEVELS = dict(zip(("68 %", "95 %"), HALF_WIDTHS, strict=True))


def coverage(z: np.ndarray) -> str:
    """Share of errors within each interval, %."""
    return "  ".join(f"{100.0 * np.mean(np.abs(z) < width):5.1f} in {name}" for name, width in LEVELS.items())


def median_errors(rows: list[pd.DataFrame]) -> tuple[float, float]:
    """RMS error of the nominal and of the fitted values of each person, and its median over them."""
    rms = np.array([[np.sqrt((r[when] ** 2).mean()) for when in ("before", "after")] for r in rows])
    before, after = np.median(rms, axis=0)
    return float(before), float(after)


def undetermined(rows: list[pd.DataFrame]) -> str:
    """How many of these parameters are declared undetermined, and the errors without them."""
    count = sum(int((r["status"] == UNDETERMINED).sum()) for r in rows)
    others = [r for r in (r[r["status"] != UNDETERMINED] for r in rows) if len(r)]
    if not count or not others:
        return f", {count} undetermined" if count else ""
    before, after = median_errors(others)
    return f", and {count} undetermined; without them {before:.2f} -> {after:.2f}"


def lines(people: list[SyntheticPerson]) -> Iterator[str]:
    """The report."""
    yield "joint parameters: RMS error, nominal -> calibrated (median over people), and coverage"
    for joint in JOINTS:
        for kind, unit in JOINT_KINDS.items():
            rows = [p.parameters[(p.parameters["kind"] == kind) & (p.parameters["joint"] == joint)] for p in people]
            rows = [r for r in rows if len(r)]
            if not rows:
                continue
            before, after = median_errors(rows)
            z = pd.concat([r["z"] for r in rows]).dropna().to_numpy()
            told = f"({len(z)} values{undetermined(rows)})"
            yield f"{joint:11}{kind.split()[1]:13}{before:6.2f} ->{after:6.2f} {unit:4}{coverage(z)}  {told}"
    yield "inertial parameters: coverage"
    for kind in INERTIAL_KINDS:
        z = pd.concat([p.parameters[p.parameters["kind"] == kind]["z"] for p in people]).to_numpy()
        yield f"{kind:39}{coverage(z)}  ({len(z)} values)"
    yield "joint torques of valid frames: coverage"
    z = np.concatenate([p.torques for p in people])
    yield f"{'all':39}{coverage(z)}"
    for name, column in zip(TORQUES, z.T, strict=True):
        yield f"{name:39}{coverage(column)}"
    yield "joint powers of valid frames: RMS error, W, and coverage"
    gaps, errors = (np.concatenate([p.powers[k] for p in people]) for k in range(2))
    for joint in dict.fromkeys(name.removesuffix("_r").removesuffix("_l") for name in POWER_JOINTS):
        own = [k for k, name in enumerate(POWERS) if name in (joint, f"{joint}_r", f"{joint}_l")]
        yield f"{joint:31}{np.sqrt(np.mean(gaps[:, own] ** 2)):6.2f}  {coverage(gaps[:, own] / errors[:, own])}"
    yield "moments as vectors, legs and back: RMS error, N·m, and coverage"
    gaps, errors = (np.concatenate([p.vectors[k] for p in people]) for k in range(2))
    for k, frame in enumerate(VECTOR_FRAMES):
        own = list(range(k * len(COMPONENTS), (k + 1) * len(COMPONENTS)))
        yield f"{frame.key:31}{np.sqrt(np.mean(gaps[:, own] ** 2)):6.2f}  {coverage(gaps[:, own] / errors[:, own])}"
