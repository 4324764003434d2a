"""The true walk of the built-in person, and how far it is from that of people."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.ground_reactions import foot_points
from gaitcal.dynamics.inverse_dynamics import Dynamics, pelvis_residual
from gaitcal.dynamics.sole import HEEL_M, SHAPE
from gaitcal.files.package_data import models_path
from gaitcal.model.linkage import COORDINATES, REACTIONS, SIDES
from gaitcal.model.nominal import published_model
from gaitcal.motion.motion import Motion
from gaitcal.recording.force_plate import point_and_torque
from gaitcal.synthetic.ground import residual_free_wrench
from gaitcal.synthetic.motion import two_strides
from gaitcal.synthetic.subject import true_gait

LOADED_N = 20.0
"""Vertical force above which a foot counts as loaded: of less, rounding makes the centre of pressure."""
RESIDUAL = 1e-9
"""N, N·m: rounding of some hundred N at lever arms of a metre."""
WITHIN = 2.0
"""Standard deviations: what 95 in 100 people keep to."""
NO_MATTER = 0.05
"""N·m/kg: in swing the bands of the ankle are narrower than any laboratory measures."""
BANDS = "normal_walking.csv"

MOMENTS = {
    "hip_flexion": ("Hip flexion", "extensor", "flexor"),
    "hip_adduction": ("Hip adduction", "abductor", "adductor"),
    "hip_rotation": ("Hip rotation", "external", "internal"),
    "knee_angle": ("Knee flexion", "extensor", "flexor"),
    "knee_adduction": ("Knee adduction", "abduction", "adduction"),
    "ankle_angle": ("Ankle dorsiflexion", "plantarflexor", "dorsiflexor"),
    "subtalar_angle": ("Subtalar inversion", "evertor", "invertor"),
}
"""Variable -> title, and what its smallest and its largest value are called."""
ADULT_PEAKS = {("hip_adduction", "abductor"): (-1.1, 0.2)}
"""N·m/kg, mean and SD of a peak: 14 adults, "The relationship between maximal hip abductor strength and resultant
loading at the knee during walking", Proc Inst Mech Eng H (abstract)."""


@dataclass(frozen=True)
class Walk:
    """The truth of one walk."""

    phase: Array
    """(nf,) strides since a right foot strike."""
    moments: dict[str, Array]
    """`hip_flexion_r` -> (nf,) N·m/kg, internal, positive in the direction of the coordinate."""
    force: Array
    """(nf, 2, 3) body weights on the right and the left foot."""
    centre: Array
    """(nf, 2, 3) m, centre of pressure; NaN where the foot is not loaded."""
    feet: FootPoints
    residual: float
    """N, N·m: the largest of the true pelvis residual."""

    def percent(self, foot: int) -> Array:
        """(nf,) % of the stride of a foot (0 right, 1 left)."""
        out: Array = 100.0 * ((self.phase - 0.5 * foot) % 1.0)
        return out

    @property
    def loaded(self) -> BoolArray:
        """(nf, 2)."""
        return np.isfinite(self.centre[:, :, 0])


def true_walk(seed: int | None = None) -> Walk:
    """The walk of the built-in person, or of the perturbed one of a seed, with all that it asks of the ground."""
    model = published_model()
    if seed is None:
        motion = two_strides(model.parameters)
    else:
        parameters, motion = true_gait(seed)
        model = replace(model, parameters=parameters)
    wrench = residual_free_wrench(model.parameters, motion)
    q, v, a = (motion.basis.evaluate(motion.nodes, k) for k in range(3))
    forces = Dynamics(model.parameters).forces(q, v, a, wrench)
    names = [*COORDINATES, *REACTIONS]
    moments = {f"{stem}_{side}": forces[:, names.index(f"{stem}_{side}")] for stem in MOMENTS for side in SIDES}
    centre = np.stack([point_and_torque(wrench[:, foot])[0] for foot in range(2)], axis=1)
    centre[wrench[:, :, 1] <= LOADED_N] = np.nan
    return Walk(
        phase=np.asarray(motion.phase),
        moments={name: values / model.parameters.mass for name, values in moments.items()},
        force=wrench[:, :, :3] / model.subject.weight,
        centre=centre,
        feet=foot_points(model, cast(Motion, SimpleNamespace(q=q, time=motion.basis.time)), model.parameters),
        residual=float(np.abs(pelvis_residual(q, forces)).max()),
    )


def normal_bands() -> dict[str, pd.DataFrame]:
    """Variable without its ending -> percent, mean, sd (N·m/kg)."""
    table = pd.read_csv(models_path() / BANDS, comment="#")
    return {str(name).removesuffix("_moment"): rows for name, rows in table.groupby("variable", sort=False)}


def within(walk: Walk, band: pd.DataFrame, stem: str, foot: int) -> BoolArray:
    """(nf,) the moment of a leg is as far from the mean of its band at that percent as other people's."""
    at = walk.percent(foot)
    mean, sd = (np.interp(at, band["percent"], band[column]) for column in ("mean", "sd"))
    away = np.abs(walk.moments[f"{stem}_{SIDES[foot]}"] - mean)
    return np.asarray(away < np.maximum(WITHIN * sd, NO_MATTER))


@dataclass(frozen=True)
class Peak:
    """The largest or smallest moment of one leg beside that of the band's mean."""

    name: str
    side: str
    value: float
    normal: float
    sd: float
    """N·m/kg, all three."""

    @property
    def off(self) -> float:
        """Standard deviations."""
        return (self.value - self.normal) / self.sd


def peaks(walk: Walk, bands: dict[str, pd.DataFrame]) -> list[Peak]:
    """Of every moment with a band, or with a published peak, the right leg's and the left leg's."""
    out = []
    for stem, (_, *names) in MOMENTS.items():
        for name, end in zip(names, (np.argmin, np.argmax), strict=True):
            if (stem, name) in ADULT_PEAKS:
                normal, sd = ADULT_PEAKS[stem, name]
            elif stem in bands:
                row = bands[stem].iloc[int(end(bands[stem]["mean"]))]
                normal, sd = float(row["mean"]), float(row["sd"])
            else:
                continue
            for side in SIDES:
                values = walk.moments[f"{stem}_{side}"]
                out.append(Peak(f"{stem.split('_')[0]} {name}", side, float(values[int(end(values))]), normal, sd))
    return out


def outside_sole(walk: Walk, foot: int) -> Array:
    """(nf,) m by which the centre of pressure is outside the sole; negative inside, NaN where a foot is not loaded."""
    feet = walk.feet
    heel, tip = feet.heel[:, foot][:, [0, 2]], feet.tip[:, foot][:, [0, 2]]
    length = np.linalg.norm(tip - heel, axis=1)
    forward = (tip - heel) / length[:, None]
    away = walk.centre[:, foot][:, [0, 2]] - heel
    along = np.einsum("fi,fi->f", away, forward)
    across = np.abs(away[:, 0] * forward[:, 1] - away[:, 1] * forward[:, 0])
    part = (along - HEEL_M) / (length - HEEL_M)
    out: Array = np.max([HEEL_M - along, along - length, across - feet.width * np.interp(part, *SHAPE) / 2], axis=0)
    return out


def passes(walk: Walk) -> bool:
    """Whether all is as it should be."""
    inside = all((outside_sole(walk, foot)[walk.loaded[:, foot]] <= 0).all() for foot in range(2))
    pushes = bool((walk.force[:, :, 1] >= 0).all()) and walk.residual < RESIDUAL
    return inside and pushes and all(abs(p.off) <= WITHIN for p in peaks(walk, normal_bands()))
