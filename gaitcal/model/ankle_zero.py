"""Zero of the ankle angle from the dorsiflexion of the static posture.

Zero ankle angle is the foot at right angles to the shank. With y the shank's axis, h and t the heel
and the toe marker and c the ankle centre, the static dorsiflexion is asin(u . y). The direction u
of the foot is one of

    sole       u = unit of the horizontal part of t - h; the sole of a flat foot is parallel to the
               floor
    markers    u = unit(t - h); heel and toe marker have the same distance from the sole
    file       u = unit(t - c), rotated upwards by the file's static plantarflexion angle

The last is `StaticPlantFlex` of Vicon's Plug-in Gait: the angle between the line from ankle centre
to toe marker and the foot's long axis. A heel marker may be 15 mm lower than the toe marker, which
is 5 degrees in a child's foot. Only the zero of the angle is chosen here. The foot's frame, its
markers and all torques do not depend on it.

With `AnkleZero.AUTO` a foot is taken as flat unless one of these holds:

- the slope of its line from heel to toe marker differs from the other foot's by `UNEVEN_SLOPE`;
- its heel marker is higher than its toe marker by `HIGH_HEEL_SLOPE` of their distance.

Of two uneven feet, the one with the higher heel or toes is off the floor, whichever differs more.
The markers of the other foot then show how markers are placed relative to the sole. Markers do not
show that both heels are raised alike, as in a child that stands on its forefeet. The file's angle
is used where it differs from a level sole by more than `FILE_DISAGREEMENT`. Without that angle,
heel markers steeper than `STEEP_SLOPE` above the toe markers give a doubt.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import OTHER_SIDE, SIDE_WORDS, SIDES
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.model.segment_frames import LowerBody, normalise

UNEVEN_SLOPE = 0.10
"""Sine (6 deg): a larger difference between the slopes of both feet means that one is off the
floor. Both feet are marked alike; the largest difference of ten people is 0.03."""
HIGH_HEEL_SLOPE = 0.22
"""Sine (13 deg): a heel marker higher than this above the toe marker means that the heel is off the
floor. The largest slope of ten people is 0.10."""
FILE_DISAGREEMENT = np.deg2rad(8.0)
"""rad: largest difference of the file's angle from a level sole in a foot that stands flat. Twelve
such feet have 0 to 5.7 degrees."""
STEEP_SLOPE = np.deg2rad(8.0)
"""rad: slope from toe up to heel marker above which the posture is doubted. In 32 feet with shoes
it is at most 5.7 degrees."""


class AnkleZero(Enum):
    """Reference direction of the foot that is at right angles to the shank at zero ankle angle."""

    AUTO = "auto"
    """The sole; the file's angle or the markers if a foot does not stand flat."""
    SOLE = "sole"
    MARKERS = "markers"
    FILE = "file"


@dataclass(frozen=True)
class StandingAnkles:
    """Ankle angles of the static posture, with notes and doubts about them."""

    dorsiflexion: Mapping[str, float]  # side -> rad
    notes: tuple[str, ...]
    doubts: Mapping[str, str] = field(default_factory=dict)
    """Side -> why the angle may be another one, if the rule is `AUTO`."""


def measure_standing_ankles(
    posture: StaticPosture, legs: LowerBody, plantarflexion: Mapping[str, float], rule: AnkleZero
) -> StandingAnkles:
    """Measure the dorsiflexion of both ankles in the static posture.

    Parameters
    ----------
    posture : StaticPosture
        Landmarks of the static posture (m, laboratory).
    legs : LowerBody
        Segment frames and joint centres in the same posture.
    plantarflexion : mapping of str to float
        Side -> static plantarflexion angle of the file (rad); empty if it has none.
    rule : AnkleZero
        Direction of the foot that the angle is measured from.

    Returns
    -------
    StandingAnkles
        Dorsiflexion of each side (rad), notes, and doubts where the rule is `AUTO`.

    Raises
    ------
    InputError
        The rule is `FILE` and the file has no angle of a side.
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
    feet = {
        side: _Foot.from_posture(posture, legs, side, plantarflexion.get(side)) for side in SIDES
    }
    angles, sentences = {}, []
    for side, foot in feet.items():
        if rule is AnkleZero.AUTO:
            angle, why = _choose_dorsiflexion(foot, feet[OTHER_SIDE[side]])
        elif rule is AnkleZero.SOLE:
            angle, why = foot.by_sole, "the sole is taken as level"
        elif rule is AnkleZero.FILE and foot.by_file is not None:
            angle, why = foot.by_file, "the file's static plantarflexion angle says so"
        else:
            angle, why = (
                foot.by_markers,
                "the sole is assumed parallel to the line from heel to toe marker",
            )
        angles[side], slope = angle, np.rad2deg(foot.slope)
        sentences.append(
            f"{SIDE_WORDS[side]} {np.rad2deg(angle):.1f} deg ({why}; heel to toe marker slopes "
            f"{slope:+.1f} deg)"
        )
    doubts = {
        s: why
        for s in SIDES
        if rule is AnkleZero.AUTO and (why := _describe_doubt(feet[s], feet[OTHER_SIDE[s]]))
    }
    return StandingAnkles(
        angles, (f"dorsiflexion in the static trial: {', '.join(sentences)}",), doubts
    )


@dataclass(frozen=True)
class _Foot:
    """Dorsiflexion (rad) of one foot in the static posture, by each rule."""

    by_sole: float
    by_markers: float
    by_file: float | None
    # rad, of the line from heel to toe marker; positive: the toe marker is higher
    slope: float
    heel: float  # m, height of the heel marker
    toe: float  # m, height of the toe marker

    @property
    def disagrees(self) -> bool:
        """Whether the file's angle is impossible for a foot whose sole is on the floor."""
        return self.by_file is not None and abs(self.by_file - self.by_sole) > FILE_DISAGREEMENT

    @classmethod
    def from_posture(
        cls, posture: StaticPosture, legs: LowerBody, side: str, plantarflexion: float | None
    ) -> "_Foot":
        """Measure one foot; `plantarflexion` is the file's angle (rad) or None."""
        heel, toe = posture.landmarks[f"heel_{side}"], posture.landmarks[f"toe_{side}"]
        shank = legs.frames[f"shank_{side}"].rotation[:, 1]
        line = normalise(toe - heel)
        level = normalise(line * np.array([1.0, 0.0, 1.0]))
        by_file = None
        if plantarflexion is not None:
            foot = legs.frames[f"foot_{side}"].rotation
            turned = (
                foot
                @ make_axis_rotation(2, plantarflexion)
                @ foot.T
                @ normalise(toe - legs.centres[f"ajc_{side}"])
            )
            by_file = _compute_dorsiflexion(turned, shank)
        return cls(
            by_sole=_compute_dorsiflexion(level, shank),
            by_markers=_compute_dorsiflexion(line, shank),
            by_file=by_file,
            slope=float(np.arcsin(line[1])),
            heel=float(heel[1]),
            toe=float(toe[1]),
        )


def _compute_dorsiflexion(direction: Array, shank: Array) -> float:
    """Compute the dorsiflexion (rad) of unit directions of foot and shank, both (3,)."""
    return float(np.arcsin(np.clip(direction @ shank, -1.0, 1.0)))


def _find_raised_end(foot: _Foot, other: _Foot) -> str:
    """Find the raised end of a foot if the other foot is flat: `heel`, `toes` or nothing."""
    steeper = np.sin(foot.slope) - np.sin(other.slope)
    heels, toes = foot.heel - other.heel, foot.toe - other.toe
    if steeper < -UNEVEN_SLOPE and heels >= -toes:
        return "heel"
    return "toes" if steeper > UNEVEN_SLOPE and toes > -heels else ""


def _choose_dorsiflexion(foot: _Foot, other: _Foot) -> tuple[float, str]:
    """Choose the dorsiflexion (rad) of a foot for `AUTO`, and give the reason."""
    lifted = _find_raised_end(foot, other)
    if not lifted and np.sin(foot.slope) >= -HIGH_HEEL_SLOPE:
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
        return foot.by_file, f"{why}; the file's static plantarflexion angle gives the amount"
    if lifted and np.sin(other.slope) >= -HIGH_HEEL_SLOPE:
        return (
            foot.by_markers - other.slope,
            f"{why}; its markers are assumed at the same height above the sole as the other foot's",
        )
    return (
        foot.by_markers,
        f"{why}; the sole is assumed parallel to the line from heel to toe marker",
    )


def _describe_doubt(foot: _Foot, other: _Foot) -> str:
    """Describe why a foot's posture may be another one; empty if there is no reason."""
    lifted = _find_raised_end(foot, other)
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
    shown_by_other_foot = lifted and np.sin(other.slope) >= -HIGH_HEEL_SLOPE
    if foot.slope >= -STEEP_SLOPE or shown_by_other_foot:
        return ""
    taken = (
        "the sole is assumed on the floor"
        if np.sin(foot.slope) >= -HIGH_HEEL_SLOPE
        else "the sole is assumed along"
    )
    line = f"its heel marker is {-np.rad2deg(foot.slope):.0f} deg above its toe marker"
    return f"{line}, and {taken}" + ("" if taken.endswith("floor") else " that line")
