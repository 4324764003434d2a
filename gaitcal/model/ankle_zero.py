"""What ankle angles are counted from: the dorsiflexion that the static posture has.

Zero ankle angle is the foot at right angles to the shank. With y the shank's axis, h and t the heel
and the toe marker and c the ankle's centre, the static dorsiflexion is asin(u . y), u the direction
of the foot:

    sole       u = unit of the horizontal part of t - h: the sole of a foot that stands flat is the floor
    markers    u = unit(t - h): heel and toe marker are equally far from the sole
    file       u = unit(t - c), turned up by the file's static plantarflexion angle

The last is what Vicon's Plug-in Gait writes as `StaticPlantFlex`: the angle between the line from
ankle centre to toe marker and the foot's long axis, which it took as parallel to the floor or along
the line from heel to toe marker, as the laboratory told it. A heel marker may sit 15 mm lower than
the toe marker, which in a child's foot is 5 degrees. Only the zero of the angle is decided here:
the foot's frame, its markers and all torques stay.

A foot is taken as flat unless the slope of its line from heel to toe marker differs from the other
foot's by more than UNEVEN (both are marked alike; of ten people the most was 0.03), or its heel
marker lies by more than HIGH of its length above its toe marker (at most 0.10 there). Of two uneven
feet the one whose heel is higher, or whose toes are, is off the floor, whichever differs more; the
other stands flat, and tells how the markers lie to the sole. That both heels are off the floor
alike, as when a child stands on its forefeet, the markers do not tell: the file's angle does where
it is DISAGREE from a level sole, and is believed; where the file has none, heel markers STEEP above
toe markers are doubted.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import OTHER_SIDE, SIDE_WORDS, SIDES
from gaitcal.model.rotations import axis_rotation
from gaitcal.model.segment_frames import LowerBody, unit

UNEVEN, HIGH = (
    0.10,
    0.22,
)  # shares of the distance from heel to toe marker: 6 and 13 degrees of its slope
DISAGREE = STEEP = np.deg2rad(8.0)
"""rad. Of twelve feet that stand flat the file's angle is 0 to 5.7 degrees from a level sole; of 32
the heel marker is at most 5.7 degrees above the toe marker, in shoes."""


class AnkleZero(Enum):
    """What stands at right angles to the shank where the ankle angle is zero."""

    AUTO = "auto"
    """The sole; by the file or the markers where a foot does not stand flat."""
    SOLE = "sole"
    MARKERS = "markers"
    FILE = "file"


@dataclass(frozen=True)
class StandingAnkles:
    """The ankles of the static posture."""

    dorsiflexion: Mapping[str, float]  # side -> rad
    notes: tuple[str, ...]
    doubts: Mapping[str, str] = field(default_factory=dict)
    """Side -> why that may be another angle, where nobody has said what to count from."""


def standing_ankles(
    posture: StaticPosture, legs: LowerBody, plantarflexion: Mapping[str, float], rule: AnkleZero
) -> StandingAnkles:
    """The dorsiflexion of the static posture, and what the notes say of it.

    `plantarflexion`: side -> rad, static plantarflexion angles of the file; empty where it has
    none.

    Raises InputError: The file's angles are asked for, and it has none.
    """
    if rule is AnkleZero.FILE and (
        lacking := [side for side in SIDES if side not in plantarflexion]
    ):
        raise InputError(
            f"the static trial has no static plantarflexion angle, {SIDE_WORDS[lacking[0]]}; "
            "allowed: a C3D file "
            "whose PROCESSING group has LStaticPlantFlex and RStaticPlantFlex, or 'sole', "
            "'markers', 'auto'",
            source=posture.source,
            field="calibration.ankle_zero = 'file'",
            code=Code.GIVEN_BY_FILE,
        )
    feet = {side: _Foot.of(posture, legs, side, plantarflexion.get(side)) for side in SIDES}
    angles, sentences = {}, []
    for side, foot in feet.items():
        if rule is AnkleZero.AUTO:
            angle, why = _automatic(foot, feet[OTHER_SIDE[side]])
        elif rule is AnkleZero.SOLE:
            angle, why = foot.by_sole, "the sole is taken as level"
        elif rule is AnkleZero.FILE and foot.by_file is not None:
            angle, why = foot.by_file, "the file's static plantarflexion angle says so"
        else:
            angle, why = foot.by_markers, "the line from heel to toe marker is taken as the sole's"
        angles[side], slope = angle, np.rad2deg(foot.slope)
        sentences.append(
            f"{SIDE_WORDS[side]} {np.rad2deg(angle):.1f} deg ({why}; heel to toe marker slopes "
            f"{slope:+.1f} deg)"
        )
    doubts = {
        s: why
        for s in SIDES
        if rule is AnkleZero.AUTO and (why := _doubt(feet[s], feet[OTHER_SIDE[s]]))
    }
    return StandingAnkles(
        angles, (f"dorsiflexion in the static trial: {', '.join(sentences)}",), doubts
    )


@dataclass(frozen=True)
class _Foot:
    """One foot of the static posture; angles are its dorsiflexion, rad, by each rule."""

    by_sole: float
    by_markers: float
    by_file: float | None
    slope: float  # rad, of the line from heel to toe marker; positive: the toe marker is higher
    heel: float  # m, height of the heel marker
    toe: float  # m, height of the toe marker

    @property
    def disagrees(self) -> bool:
        """Whether the file's angle is that of no foot with its sole on the floor."""
        return self.by_file is not None and abs(self.by_file - self.by_sole) > DISAGREE

    @classmethod
    def of(
        cls, posture: StaticPosture, legs: LowerBody, side: str, plantarflexion: float | None
    ) -> "_Foot":
        heel, toe = posture.landmarks[f"heel_{side}"], posture.landmarks[f"toe_{side}"]
        shank = legs.frames[f"shank_{side}"].rotation[:, 1]
        line = unit(toe - heel)
        level = unit(line * np.array([1.0, 0.0, 1.0]))
        by_file = None
        if plantarflexion is not None:
            foot = legs.frames[f"foot_{side}"].rotation
            turned = (
                foot
                @ axis_rotation(2, plantarflexion)
                @ foot.T
                @ unit(toe - legs.centres[f"ajc_{side}"])
            )
            by_file = _dorsiflexion(turned, shank)
        return cls(
            by_sole=_dorsiflexion(level, shank),
            by_markers=_dorsiflexion(line, shank),
            by_file=by_file,
            slope=float(np.arcsin(line[1])),
            heel=float(heel[1]),
            toe=float(toe[1]),
        )


def _dorsiflexion(direction: Array, shank: Array) -> float:
    return float(np.arcsin(np.clip(direction @ shank, -1.0, 1.0)))


def _off_the_floor(foot: _Foot, other: _Foot) -> str:
    """What of a foot is off the floor, the other being flat: `heel`, `toes` or nothing."""
    steeper = np.sin(foot.slope) - np.sin(other.slope)
    heels, toes = foot.heel - other.heel, foot.toe - other.toe
    if steeper < -UNEVEN and heels >= -toes:
        return "heel"
    return "toes" if steeper > UNEVEN and toes > -heels else ""


def _automatic(foot: _Foot, other: _Foot) -> tuple[float, str]:
    """Dorsiflexion of a foot, and why."""
    lifted = _off_the_floor(foot, other)
    if not lifted and np.sin(foot.slope) >= -HIGH:
        if foot.by_file is not None and foot.disagrees:
            off = abs(np.rad2deg(foot.by_file - foot.by_sole))
            return (
                foot.by_file,
                f"by the file's static plantarflexion angle, {off:.0f} deg from a sole on the "
                "floor",
            )
        return foot.by_sole, "it stands flat on the floor"
    why = "its toes seem off the floor" if lifted == "toes" else "its heel seems off the floor"
    if foot.by_file is not None:
        return foot.by_file, f"{why}; the file's static plantarflexion angle says how far"
    if lifted and np.sin(other.slope) >= -HIGH:
        return (
            foot.by_markers - other.slope,
            f"{why}; its markers are taken to lie to the sole as the other foot's",
        )
    return foot.by_markers, f"{why}; the line from heel to toe marker is taken as the sole's"


def _doubt(foot: _Foot, other: _Foot) -> str:
    """Why a foot may stand otherwise than it was taken to stand; nothing where there is no reason."""
    lifted = _off_the_floor(foot, other)
    if foot.by_file is not None:
        off = np.rad2deg(foot.by_file - foot.by_sole)
        message = (
            f"the file's static plantarflexion angle has it {abs(off):.0f} deg more "
            f"{'dorsi' if off > 0 else 'plantar'}"
        )
        return (
            f"{message}flexed than a foot with its sole on the floor"
            if foot.disagrees and not lifted
            else ""
        )
    told_by_other = lifted and np.sin(other.slope) >= -HIGH
    if foot.slope >= -STEEP or told_by_other:
        return ""
    taken = (
        "the sole is taken to lie on the floor"
        if np.sin(foot.slope) >= -HIGH
        else "the sole is taken to lie along"
    )
    line = f"its heel marker lies {-np.rad2deg(foot.slope):.0f} deg above its toe marker"
    return f"{line}, and {taken}" + ("" if taken.endswith("floor") else " that line")
