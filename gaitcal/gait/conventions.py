"""Conventions of signs, frames and units in which angles, moments and powers are reported.

Inside gaitcal, and in the files of a result, everything follows OpenSim: internal moments in N·m,
positive in the sense of their coordinate (flexion, adduction, internal rotation, dorsiflexion,
inversion). `Convention` converts them:

    signs       opensim     positive: hip and knee flexion, adduction, internal rotation,
                            dorsiflexion, inversion; trunk extension; pelvis posterior tilt,
                            right side down, rotation to the left
                clinical    angles: as before for the legs; pelvis anterior tilt, this side up,
                            this side forward; trunk flexion, to this side, this side forward.
                            Internal moments: positive in the opposite sense (extension,
                            abduction, external rotation, plantarflexion, eversion). External
                            moments: positive in the sense of the angle; the same numbers
    acting      internal    moments of muscles, ligaments and bones
                external    moments that these balance: the opposite
    frame       coordinates, proximal, distal, jcs      (`dynamics/joint_kinetics.py`)
    unit        N·m; N·m/kg; %BW*H, percent of body weight times height

Clinical signs are those of Plug-in Gait (`export/plug_in_gait.py`): graphs of the right and the
left side have the same shape, and the knee adduction moment is positive in stance, internal
(abduction positive) or external. Powers are positive where generated. They are in W where moments
are in N·m, else in W/kg.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from gaitcal.arrays import Array
from gaitcal.dynamics.joint_kinetics import MomentFrame
from gaitcal.gait.cycles import GROUND_REACTION, CurveKind, get_coordinate, get_curve_kind
from gaitcal.model.coordinates import ClinicalSense, describe_coordinate, get_senses
from gaitcal.model.subject_model import Subject


class Signs(Enum):
    """Sense in which angles and moments are positive."""

    OPENSIM = "opensim"
    """Flexion, adduction, internal rotation, dorsiflexion, inversion."""
    CLINICAL = "clinical"
    """Those of Plug-in Gait: internal moments are positive in extension, abduction, external
    rotation, plantarflexion, eversion.
    """


class Acting(Enum):
    """Structures whose moment is reported: `key` in manifests, `label` in heads of files."""

    INTERNAL = (
        "internal",
        "internal: of the structures that cross the joint, net, on the distal segment",
    )
    """Action of muscles, ligaments and bones."""
    EXTERNAL = (
        "external",
        "external: of the load that the structures crossing the joint balance, on the distal "
        "segment",
    )
    """Load that they balance."""

    def __init__(self, key: str, label: str) -> None:
        self.key, self.label = key, label


class MomentUnit(Enum):
    """Unit of moments (`key` in options, `label` in files), and the unit of powers with it."""

    NM = ("Nm", "N m", "W")
    """N·m, powers in W."""
    NM_PER_KG = ("Nm/kg", "N m/kg", "W/kg")
    """N·m/kg, powers in W/kg."""
    PERCENT_BWH = ("%BW*H", "% body weight x height", "W/kg")
    """Percent of body weight times height, powers in W/kg."""

    def __init__(self, key: str, label: str, power: str) -> None:
        self.key, self.label, self.power = key, label, power


@dataclass(frozen=True, kw_only=True)
class Convention:
    """Convention of angles, moments and powers; by default that of the files of a result."""

    signs: Signs = Signs.OPENSIM
    """Which sense is positive."""
    acting: Acting = Acting.INTERNAL
    """Structures that cause the moment."""
    frame: MomentFrame = MomentFrame.COORDINATES
    """Along which axes."""
    unit: MomentUnit = MomentUnit.NM
    """Of moments; powers go with it."""

    def moment(self, name: str, values: Array, subject: Subject, side: str = "r") -> Array:
        """Convert moments, or their standard errors, to the unit and sign of this convention.

        Parameters
        ----------
        name : str
            Coordinate or component, with the side of its leg (`hip_flexion_r`).
        values : Array
            N·m, any shape: internal, with OpenSim's sign, already in the frame of this convention.
        subject : Subject
            Mass (kg) and height (m) for normalised units.
        side : {"r", "l"}
            Side of the stride; it matters for pelvis and trunk.

        Returns
        -------
        Array
            Same shape, in `unit`. Standard errors take the sign as well: use `abs`.
        """
        factors = {
            MomentUnit.NM: 1.0,
            MomentUnit.NM_PER_KG: 1.0 / subject.mass,
            MomentUnit.PERCENT_BWH: 100.0 / subject.bwh,
        }
        return factors[self.unit] * self._sign(name, CurveKind.MOMENT, side) * values

    def power(self, values: Array, subject: Subject) -> Array:
        """Convert powers (W, any shape) or their standard errors to the unit of this convention."""
        return values if self.unit is MomentUnit.NM else values / subject.mass

    def angle(self, name: str, values: Array, side: str) -> Array:
        """Convert angles of a stride of one side (`r`, `l`) to the sign of this convention."""
        return self._sign(name, CurveKind.ANGLE, side) * values

    def values(self, variable: str, values: Array, side: str, subject: Subject) -> Array:
        """Convert values of a variable of `cycles.csv` to this convention.

        Parameters
        ----------
        variable : str
            Variable of `cycles.csv` (`hip_flexion_moment`).
        values : Array
            Any shape, in the unit of `cycles.csv`.
        side : {"r", "l", ""}
            Side of the strides. Where it is not known (empty), variables whose clinical sign
            depends on the side keep OpenSim's sign.
        subject : Subject
            Mass (kg) and height (m) for normalised units.

        Returns
        -------
        Array
            Same shape. Standard errors take the sign as well: use `abs`.
        """
        name, kind = get_coordinate(variable), get_curve_kind(variable)
        match kind:
            case CurveKind.MOMENT:
                return self.moment(name, values, subject, side)
            case CurveKind.POWER:
                return self.power(values, subject)
            case _:
                return self._sign(name, kind, side) * values

    def senses(self, variable: str, side: str) -> tuple[str, str]:
        """Describe positive and negative values of a variable in strides of one side.

        Parameters
        ----------
        variable : str
            Variable of `cycles.csv`.
        side : {"r", "l", ""}
            Side of the strides; empty where it is not known.

        Returns
        -------
        tuple of str
            Words for positive and for negative values: `("flexion", "extension")`.
        """
        name, kind = get_coordinate(variable), get_curve_kind(variable)
        if kind is CurveKind.POWER:
            return "generated", "absorbed"
        clinical = self._get_clinical_sense(name, side)
        angle = (clinical.positive, clinical.opposite) if clinical else _get_senses(name)
        # Clinical internal moments are positive in the sense opposite to that of the angle.
        opposed = (
            kind is CurveKind.MOMENT
            and self.signs is Signs.CLINICAL
            and self.acting is Acting.INTERNAL
        )
        return (angle[1], angle[0]) if opposed else angle

    def title(self, variable: str) -> str:
        """Make the title of a variable from its positive sense.

        Parameters
        ----------
        variable : str
            Variable of `cycles.csv`.

        Returns
        -------
        str
            `Hip flexion`, `Hip extension moment`, `Hip power`.
        """
        name, kind = get_coordinate(variable), get_curve_kind(variable)
        if kind is CurveKind.FORCE:
            return GROUND_FORCES[name].title
        if kind is CurveKind.POWER:
            return f"{describe_coordinate(name).title.capitalize()} power"
        title = describe_coordinate(name).title
        positive, sense = self.senses(variable, "r")[0], _get_senses(name)[0]
        rotation = kind is CurveKind.MOMENT and sense.endswith(" rotation")
        # `Hip flexion` becomes `Hip extension` where extension is positive.
        if title.endswith(f" {sense}") or rotation:
            title = f"{title.split()[0]} {positive}"
        return title if kind is CurveKind.ANGLE else f"{title} moment"

    @property
    def lines(self) -> tuple[str, ...]:
        """Description of the convention for the head of a file, a string a line."""
        signs = {
            Signs.OPENSIM: "signs: of the coordinates (OpenSim): flexion, adduction, internal "
            "rotation, dorsiflexion "
            "positive; pelvis: posterior tilt, right side down, rotation to the left",
            Signs.CLINICAL: "signs: clinical (Plug-in Gait): angles of flexion, adduction, "
            "internal rotation, "
            "dorsiflexion positive; pelvis: anterior tilt, this side up and forward; trunk: "
            "flexion, to this side, "
            "this side forward; internal moments positive in the opposite sense, external ones in "
            "the same",
        }[self.signs]
        return (
            f"moments are {self.acting.label}",
            f"frame of moments: {self.frame.label}",
            f"{signs}; column 'positive' gives it for each variable",
            f"units: angles deg, moments {self.unit.label}, powers {self.unit.power} (positive: "
            "generated)",
        )

    @property
    def keys(self) -> dict[str, str]:
        """Description of the convention for a manifest: key -> value."""
        return {
            "signs": self.signs.value,
            "moments": self.acting.key,
            "frame": self.frame.key,
            "moment_unit": self.unit.key,
            "power_unit": self.unit.power,
        }

    def _sign(self, name: str, kind: CurveKind, side: str) -> float:
        """Get the factor +1 or -1 from OpenSim's sign to that of this convention."""
        external = -1.0 if kind is CurveKind.MOMENT and self.acting is Acting.EXTERNAL else 1.0
        if self.signs is Signs.OPENSIM:
            return external
        clinical = self._get_clinical_sense(name, side)
        angle = clinical.sign(side) if clinical else 1.0
        return -angle if kind is CurveKind.MOMENT else angle

    def _get_clinical_sense(self, name: str, side: str) -> ClinicalSense | None:
        """Get the clinical sense of a coordinate; None with OpenSim's signs or an unknown side."""
        row = GROUND_FORCES.get(name) or describe_coordinate(name)
        found = row.clinical if self.signs is Signs.CLINICAL else None
        return None if found and not side and found.right != found.left else found


class GroundForce(NamedTuple):
    """Component of the ground reaction on a foot, with the senses of OpenSim's axes."""

    title: str
    senses: tuple[str, str]
    clinical: ClinicalSense | None = None


GROUND_FORCES: Final[Mapping[str, GroundForce]] = {
    GROUND_REACTION: GroundForce("Ground reaction, vertical", ("upward", "downward")),
    "ground_reaction_forward": GroundForce("Ground reaction, forward", ("forward", "backward")),
    "ground_reaction_sideways": GroundForce(
        "Ground reaction, sideways",
        ("to the right", "to the left"),
        ClinicalSense(right=-1.0, left=1.0, positive="medial", opposite="lateral"),
    ),
}


def _get_senses(name: str) -> tuple[str, str]:
    """Get the words for positive and negative values with OpenSim's signs."""
    senses = GROUND_FORCES[name].senses if name in GROUND_FORCES else get_senses(name)
    if senses is None:
        raise KeyError(name)
    return senses
