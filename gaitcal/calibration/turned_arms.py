"""Arms that a fit turned about themselves: one marker on an upper arm does not tell how it is turned about its length.

The model's upper arm does not turn so. Where a real one does, a fit of its joints may find an elbow that bends the
other way, with the whole arm half a turn about. Such a motion is far from the one that the markers begin with, and
tracking with the same joints does not find it again. The joints of that arm are then better left where they were.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.model.knee_and_ankle import SIDE_WORDS
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import TrialProblem

FAR = np.deg2rad(90.0)
"""From where a coordinate begins, the median over a trial: no noise and no bound of joint parameters turns so far."""
ARM = ("arm_flex", "arm_add", "elbow_flex")
JOINTS = ("shoulder", "elbow")


def turned_arms(
    problems: Sequence[TrialProblem], nodes: Sequence[Array], parameters: Parameters
) -> Mapping[str, float]:
    """Side -> rad by which its arm is turned from where rigid fits with `parameters` begin, where that is too far."""
    out: dict[str, float] = {}
    for problem, own in zip(problems, nodes, strict=True):
        start = starting_nodes(problem.chain, problem.constants(parameters), problem.data, problem.basis)
        apart = np.abs(np.angle(np.exp(1j * problem.basis.evaluate(own - start))))
        median = dict(zip(problem.chain.coordinates, np.median(apart, axis=0).tolist(), strict=True))
        for side in SIDES:
            most = max((median[name] for name in (f"{arm}_{side}" for arm in ARM) if name in median), default=0.0)
            if most > max(FAR, out.get(side, 0.0)):
                out[side] = most
    return out


def without_arms(free: Sequence[str], sides: Mapping[str, float]) -> tuple[str, ...]:
    """The joint parameters that are none of these arms."""
    joints = {f"{joint}_{side}" for joint in JOINTS for side in sides}
    return tuple(name for name in free if name.split(".")[0] not in joints)


def told(sides: Mapping[str, float]) -> tuple[Finding, ...]:
    """A note an arm."""
    return tuple(
        Finding(
            severity=Severity.INFO,
            topic="joint parameters",
            where=STUDY,
            cause=f"shoulder and elbow of the {SIDE_WORDS[side]} arm stay nominal",
            found=f"their fit turned the arm by {np.rad2deg(turn):.0f} degrees, which no arm does: its markers do not "
            "tell how the upper arm is turned about its length",
            cure="nothing, where only legs matter; a second marker on the upper arm tells it",
            code=Code.UNDETERMINED,
        )
        for side, turn in sides.items()
    )
