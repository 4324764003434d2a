"""All numbers of one person's linkage: joint parameters, inertial parameters, and the ankles' zero angles."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.package_data import models_path
from gaitcal.model.inertial_parameters import MASSIVE_SEGMENTS, table
from gaitcal.model.joint_parameters import JP_INDEX, JP_NAMES, JP_TO_SI
from gaitcal.model.linkage import ZERO_ANGLES, Element, Source, segment_kind


@dataclass(frozen=True)
class Parameters:
    """Parameters in SI units (m, rad, kg, kg m^2). Arrays are not to be changed in place."""

    joint: Array
    """(np,) m, rad: joint parameters in the order of `gaitcal.model.joint_parameters.JP_NAMES`."""
    inertial: Array
    """(ni,) kg, m, kg m^2: inertial parameters in the order of `gaitcal.model.inertial_parameters.IP_NAMES`."""
    zero_angles: Array
    """(nz,) rad: constants that make zero ankle coordinates the posture with the foot at right angles to the shank, in
    the order of `gaitcal.model.linkage.ZERO_ANGLES`."""

    def with_joint(self, names: tuple[str, ...], values: Array) -> Parameters:
        """A copy with some joint parameters (m, rad) replaced."""
        joint = self.joint.copy()
        joint[[JP_INDEX[name] for name in names]] = values
        return replace(self, joint=joint)

    def with_inertial(self, inertial: Array) -> Parameters:
        """A copy with other inertial parameters (ni,)."""
        return replace(self, inertial=np.array(inertial, dtype=float))

    def amount(self, element: Element) -> float:
        """By how much (m or rad, with its sign) an element moves that is no coordinate."""
        if element.source is Source.JOINT_PARAMETER:
            return element.sign * float(self.joint[JP_INDEX[element.name]])
        return element.sign * float(self.zero_angles[ZERO_ANGLES.index(element.name)])

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return float(table(self.inertial)[:, 0].sum())


def published_subject() -> Parameters:
    """The built-in nominal subject of the reproduction (`models/nominal_subject.json`; male, 69.4 kg, 1.70 m)."""
    data = json.loads((models_path() / "nominal_subject.json").read_text(encoding="utf-8"))
    listed = data["joint_parameters"]
    joint = np.empty(len(JP_NAMES))
    for i, name in enumerate(JP_NAMES):
        joint_name, _, place = name.partition(".")
        kind, _, side = joint_name.partition("_")
        joint[i] = listed[side or "back"][f"{kind}.{place}"]
    inertial = np.empty((len(MASSIVE_SEGMENTS), 7))
    for i, segment in enumerate(MASSIVE_SEGMENTS):
        entry = data["inertial_parameters"][segment_kind(segment).name.replace("_", "")]
        com = np.array(entry["com_mm"])
        com[2] *= 1.0 if not segment.endswith("_l") else -1.0
        inertial[i] = [entry["mass_kg"], *(1e-3 * com), *(1e-6 * np.array(entry["moi_kg_mm2_xyz"]))]
    zero = data["fixed_zero_offsets_deg"]
    angles = [zero["theta_tc0"], zero["theta_st0_right"], zero["theta_tc0"], zero["theta_st0_left"]]
    return Parameters(joint * JP_TO_SI, inertial.ravel(), np.deg2rad(angles))
