"""The coordinates that a model shows for the static posture, and ankle angles that stay counted from it.

Ankle angles are counted from the static posture (`model/ankle_zero.py`). A fit turns the two axes of an ankle, and with
other axes the same posture has other coordinates: a walk would come out bent by as much, whose feet nobody moved. So
after every fit of joint parameters the zero angles z of the two joints are moved by

    dz = q(static, fitted model) - q(static, nominal model)

in the direction of their coordinate, and every motion's coordinate by -dz: positions, torques and markers are the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import JOINTS, ZERO_ANGLES, Joint, Source
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import tracked_motion
from gaitcal.session.prepare import standing_problem


def static_angles(model: SubjectModel, parameters: Parameters, static: Recording) -> dict[str, float]:
    """Coordinate -> its value (m, rad) with which the model meets the still window of the static trial."""
    motion = tracked_motion(standing_problem(model, static), parameters)
    return dict(zip(motion.coordinates, map(float, motion.q.mean(axis=0)), strict=True))


@dataclass(frozen=True)
class Counted:
    """Fitted parameters, and from where their ankle angles are counted."""

    parameters: Parameters
    moved: Mapping[str, float]
    """Coordinate -> dz, rad, by which motions of the parameters as they were given read too much."""
    static: Mapping[str, float]
    """`static_angles` of the parameters."""


def counted_from_static(model: SubjectModel, parameters: Parameters, static: Recording) -> Counted:
    """Fitted parameters whose ankles have the nominal model's angles in the static posture, by other zero angles."""
    after, before = (static_angles(model, p, static) for p in (parameters, model.nominal))
    zero, moved = parameters.zero_angles.copy(), {}
    for joint in JOINTS:
        for name, coordinate, sign in _zeroed(joint):
            moved[coordinate] = after[coordinate] - before[coordinate]
            zero[ZERO_ANGLES.index(name)] += sign * moved[coordinate]
    here = after | {name: before[name] for name in moved}
    return Counted(replace(parameters, zero_angles=zero), moved, here)


def as_fitted(model: SubjectModel, parameters: Parameters, static: Recording) -> Counted:
    """The same where the ankles keep the zero of the nominal model: nothing moves."""
    return Counted(parameters, {}, static_angles(model, parameters, static))


def shifted(nodes: Array, coordinates: tuple[str, ...], moved: Mapping[str, float]) -> Array:
    """The nodes (nn, nq) of a motion after `counted_from_static`: B-splines sum to one, so they move as the angle."""
    out: Array = nodes - np.array([moved.get(name, 0.0) for name in coordinates])
    return out


def _zeroed(joint: Joint) -> list[tuple[str, str, float]]:
    """Zero angle, coordinate about the same axis and the sign of one against the other, of a joint that has one."""
    zeros = [e for e in joint.elements if e.source is Source.ZERO_ANGLE]
    turns = [e for e in joint.elements if e.source is Source.COORDINATE]
    return [(z.name, q.name, z.sign * q.sign) for z in zeros for q in turns if z.axis == q.axis]
