"""In which convention joint angles, moments and powers are told: signs, whose moment, along which axes, which unit.

Inside, and in the files of a result, everything is as OpenSim has it: internal moments, positive in the sense of their
coordinate (flexion, adduction, internal rotation, dorsiflexion, inversion), N·m. `Convention` brings them into others:

    signs       opensim     positive: hip and knee flexion, adduction, internal rotation, dorsiflexion, inversion; trunk
                            extension; pelvis posterior tilt, right side down, left turn
                clinical    moments positive: extension, abduction, external rotation, plantarflexion, eversion; angles
                            as before, but for the pelvis: anterior tilt, this side up, this side forward
    whose       internal    what muscles, ligaments and bones do; external: what they work against, the opposite
    frame       coordinates, proximal, distal, jcs      `dynamics/joint_moments.py`
    unit        N·m; N·m/kg; %BW*H, percent of body weight times height

Signs and whose are told apart: the literature's external moments (flexion, adduction, dorsiflexion positive; the knee
adduction moment above zero in stance) are opensim signs and external, its internal ones (extensor, abductor,
plantarflexor positive) clinical signs and internal: the same numbers. Powers have one sign in all conventions: positive
is generated. They are in W beside N·m, else in W/kg: percent of body weight times height has no power.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gaitcal.arrays import Array
from gaitcal.dynamics.joint_moments import MomentFrame
from gaitcal.model.coordinates import coordinate_words, is_of_leg, senses_of
from gaitcal.model.subject_model import Subject


class Signs(Enum):
    """Which sense is positive."""

    OPENSIM = "opensim"
    """Flexion, adduction, internal rotation, dorsiflexion, inversion."""
    CLINICAL = "clinical"
    """Of moments: extension, abduction, external rotation, plantarflexion, eversion."""


class Acting(Enum):
    """Whose moment it is. `words`: in files."""

    INTERNAL = ("internal", "internal: of the structures that cross the joint, net, on the distal segment")
    """What muscles, ligaments and bones do."""
    EXTERNAL = ("external", "external: what the structures that cross the joint work against, on the distal segment")
    """What they work against."""

    def __init__(self, key: str, words: str) -> None:
        self.key, self.words = key, words


class MomentUnit(Enum):
    """Unit of moments, with that of powers beside it."""

    NM = ("Nm", "N m", "W")
    """N·m, powers in W."""
    NM_PER_KG = ("Nm/kg", "N m/kg", "W/kg")
    """N·m/kg, powers in W/kg."""
    PERCENT_BWH = ("%BW*H", "% body weight x height", "W/kg")
    """Percent of body weight times height, powers in W/kg."""

    def __init__(self, key: str, words: str, power: str) -> None:
        self.key, self.words, self.power = key, words, power


@dataclass(frozen=True, kw_only=True)
class Convention:
    """How angles, moments and powers are told; as in the files of a result unless said otherwise."""

    signs: Signs = Signs.OPENSIM
    """Which sense is positive."""
    acting: Acting = Acting.INTERNAL
    """Whose moment it is."""
    frame: MomentFrame = MomentFrame.COORDINATES
    """Along which axes."""
    unit: MomentUnit = MomentUnit.NM
    """Of moments; powers go with it."""

    def moment(self, name: str, values: Array, subject: Subject) -> Array:
        """Moments or their standard errors in the unit and with the sign of this convention.

        `values`: N·m, internal and with OpenSim's sign, of a coordinate or component `name` (`hip_flexion_r`), in the
        frame of this convention already. Standard errors keep their sign: take `abs`.
        """
        factor = {MomentUnit.NM: 1.0, MomentUnit.NM_PER_KG: 1.0 / subject.mass}.get(self.unit, 100.0 / subject.bwh)
        return factor * self._sign(name) * values

    def power(self, values: Array, subject: Subject) -> Array:
        """Powers (W) or their standard errors in the unit of this convention."""
        return values if self.unit is MomentUnit.NM else values / subject.mass

    def angle(self, name: str, values: Array, side: str) -> Array:
        """Angles of a stride of one side (`r`, `l`) with the sign of this convention; their unit stays."""
        return self._of_pelvis(name, side)[0] * values

    def positive_moment(self, name: str) -> str:
        """What a positive moment means: `internal, abduction`."""
        senses = _senses(name)
        sign = self._sign(name) * (-1.0 if self.acting is Acting.EXTERNAL else 1.0)
        return f"{self.acting.key}, {senses[0] if sign > 0 else senses[1]}"

    def positive_angle(self, name: str, side: str) -> str:
        """What a positive angle means: `dorsiflexion`; of the pelvis in a stride of one side (`r`, `l`)."""
        sense = self._of_pelvis(name, side)[1]
        return sense or _senses(name)[0]

    @property
    def lines(self) -> tuple[str, ...]:
        """What it is in words, for the head of a file."""
        signs = {
            Signs.OPENSIM: "signs: of the coordinates (OpenSim): flexion, adduction, internal rotation, dorsiflexion "
            "positive; pelvis: posterior tilt, right side down, rotation to the left",
            Signs.CLINICAL: "signs: clinical: moments of extension, abduction, external rotation, plantarflexion, "
            "eversion positive; angles of flexion, adduction, dorsiflexion; pelvis: anterior tilt, this side up and "
            "forward; trunk as its coordinates",
        }[self.signs]
        return (
            f"moments are {self.acting.words}",
            f"moments are told {self.frame.words}",
            f"{signs}; column 'positive' says it of each variable",
            f"units: angles deg, moments {self.unit.words}, powers {self.unit.power} (positive: generated)",
        )

    @property
    def keys(self) -> dict[str, str]:
        """The same for a manifest."""
        return {
            "signs": self.signs.value,
            "moments": self.acting.key,
            "frame": self.frame.key,
            "moment_unit": self.unit.key,
            "power_unit": self.unit.power,
        }

    def _sign(self, name: str) -> float:
        clinical = self.signs is Signs.CLINICAL and is_of_leg(name)
        return (-1.0 if clinical else 1.0) * (-1.0 if self.acting is Acting.EXTERNAL else 1.0)

    def _of_pelvis(self, name: str, side: str) -> tuple[float, str]:
        clinical = coordinate_words(name).clinical if self.signs is Signs.CLINICAL else None
        return (1.0, "") if clinical is None else (clinical.sign(side), clinical.words)


def _senses(name: str) -> tuple[str, str]:
    senses = senses_of(name)
    if senses is None:
        raise KeyError(name)
    return senses
