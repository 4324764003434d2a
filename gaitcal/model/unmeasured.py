"""How much of the body's mass follows no marker.

A segment without the markers it needs is carried along by the one before it (`SubjectModel.frozen`). What its mass does
beyond that appears at the pelvis as force and moment that nothing explains: so long as the trunk is such a segment, the
pelvis residual says how it moves, and nothing of masses. Torques of the legs are summed from the feet upwards and do
not depend on it.
"""

from __future__ import annotations

from gaitcal.model.inertial_parameters import MASSIVE_SEGMENTS, table
from gaitcal.model.linkage import JOINT_OF_CHILD, Source
from gaitcal.model.subject_model import SubjectModel

TRUNK = "head_trunk"
_WORDS = {TRUNK: "head and trunk", "upper_arm": "upper arms", "forearm_hand": "forearms and hands"}


def unmeasured_segments(model: SubjectModel) -> tuple[str, ...]:
    """Segments none of whose coordinates any marker shows."""
    frozen = set(model.frozen)
    out = []
    for segment in MASSIVE_SEGMENTS:
        joint = JOINT_OF_CHILD.get(segment)
        names = [e.name for e in joint.elements if e.source is Source.COORDINATE] if joint else []
        if names and frozen.issuperset(names):
            out.append(segment)
    return tuple(out)


def unmeasured_share(model: SubjectModel) -> float:
    """Their share of the body's mass, 0 to 1."""
    mass = dict(zip(MASSIVE_SEGMENTS, table(model.nominal.inertial)[:, 0], strict=True))
    return float(sum(mass[segment] for segment in unmeasured_segments(model)) / sum(mass.values()))


def unmeasured_words(model: SubjectModel) -> str:
    """The same in words ("head and trunk, upper arms: 44 % of the body's mass"); nothing where none is."""
    segments = unmeasured_segments(model)
    parts = dict.fromkeys(_WORDS.get(s, _WORDS.get(s[:-2], s)) for s in segments)
    return f"{', '.join(parts)}: {100 * unmeasured_share(model):.0f} % of the body's mass" if segments else ""


def is_trunk_unmeasured(model: SubjectModel) -> bool:
    """Whether no marker shows the trunk."""
    return TRUNK in unmeasured_segments(model)
