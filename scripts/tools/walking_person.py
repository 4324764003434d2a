"""Does the built-in person walk like a person? True moments beside the normal bands, centres of
pressure in the soles.

    python -m scripts.tools.walking_person [--seed N]

Printed is the truth of the built-in person, or of the one that `gaitcal synthesize --perturb --seed
N` writes (`gaitcal demo`: 2009), not a fit: internal moments per kg of body mass over each leg's
stride, ground reactions, the pelvis residual, and whether the ground reactions act in the soles
(`dynamics/foot_contact.py`). The bands are those of `models/norms/schwartz2008_free.csv`, which
tells source, people and licence, and the peak of the hip abductors that is published for adults; of
other moments the range is told.

Perturbed people walk the same walk with axes up to 10 mm and 10 degrees elsewhere: about these, the
moment that adducts a knee is up to 6 standard deviations from people's (16 seeds), other peaks up
to 3.

Exit code 0 where every centre of pressure is in its sole and every peak within 2 standard
deviations, else 1.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.ground_reactions import compute_foot_points
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics, compute_pelvis_residual
from gaitcal.dynamics.off_sole import compute_distance_outside_hull, compute_sole_edge
from gaitcal.gait.moments import SIDE_WORDS
from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.io.force_plate import split_wrench
from gaitcal.model.linkage import SIDES
from gaitcal.model.nominal import published_model
from gaitcal.synthetic.subject import make_true_gait
from gaitcal.synthetic.synthetic_motion import compute_residual_free_wrench, simulate_two_strides
from gaitcal.tracking.motion import Motion

LOADED_N = 20.0
"""Vertical force above which a foot counts as loaded: of less, rounding makes the centre of
pressure.
"""
RESIDUAL = 1e-9
"""N, N·m: rounding of some hundred N at lever arms of a metre."""
WITHIN = 2.0
"""Standard deviations: what 95 in 100 people keep to."""
NO_MATTER = 0.05
"""N·m/kg: in swing the bands of the ankle are narrower than any laboratory measures."""
BANDS = "schwartz2008-free"
OF_ADULTS = ("hip_flexion", "knee_angle", "knee_adduction", "ankle_angle")
"""Children's moments that adults have, too: abductors of their hips make 0.5 N·m/kg, those of
adults 1.1.
"""

MOMENTS = {
    "hip_flexion": ("Hip flexion", "extensor", "flexor"),
    "hip_adduction": ("Hip adduction", "abductor", "adductor"),
    "hip_rotation": ("Hip rotation", "external", "internal"),
    "knee_angle": ("Knee flexion", "extensor", "flexor"),
    "knee_adduction": ("Knee adduction", "abduction", "adduction"),
    "ankle_angle": ("Ankle dorsiflexion", "plantarflexor", "dorsiflexor"),
    "subtalar_angle": ("Hindfoot inversion", "evertor", "invertor"),
}
"""Variable -> title, and what its smallest and its largest value are called."""
ADULT_PEAKS = {("hip_adduction", "abductor"): (-1.1, 0.2)}
"""N·m/kg, mean and SD of a peak: 14 adults, "The relationship between maximal hip abductor strength
and resultant loading at the knee during walking", Proc Inst Mech Eng H (abstract)."""


@dataclass(frozen=True)
class Walk:
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
        return np.asarray(100.0 * ((self.phase - 0.5 * foot) % 1.0))

    @property
    def loaded(self) -> BoolArray:
        """(nf, 2)."""
        return np.isfinite(self.centre[:, :, 0])


def true_walk(seed: int | None = None) -> Walk:
    """The walk of the built-in person, or of the perturbed one of a seed, with all that it asks of
    the ground.
    """
    model = published_model()
    parameters, motion = (
        (model.parameters, simulate_two_strides(model.parameters))
        if seed is None
        else make_true_gait(seed)
    )
    model = replace(model, parameters=parameters)
    wrench = compute_residual_free_wrench(model.parameters, motion)
    q, v, a = (motion.basis.evaluate(motion.coefficients, k) for k in range(3))
    forces = Dynamics(model.parameters).compute_forces(q, v, a, wrench)
    moments = {
        f"{stem}_{side}": forces[:, FORCES.index(f"{stem}_{side}")]
        for stem in MOMENTS
        for side in SIDES
    }
    centre = np.stack([split_wrench(wrench[:, foot])[0] for foot in range(2)], axis=1)
    centre[wrench[:, :, 1] <= LOADED_N] = np.nan
    return Walk(
        phase=np.asarray(motion.phase),
        moments={name: values / model.parameters.mass for name, values in moments.items()},
        force=wrench[:, :, :3] / model.subject.weight,
        centre=centre,
        feet=compute_foot_points(
            model, cast(Motion, SimpleNamespace(q=q, time=motion.basis.time)), model.parameters
        ),
        residual=float(np.abs(compute_pelvis_residual(q, forces)).max()),
    )


def normal_bands() -> dict[str, pd.DataFrame]:
    """Variable without its ending -> percent, mean, sd (N·m/kg), internal, positive in the
    coordinate's direction.
    """
    bands = read_normal_bands(BANDS)
    found = {name: bands[f"{name}_moment"] for name in OF_ADULTS}
    return {
        n: pd.DataFrame({"percent": b.percent, "mean": -b.mean, "sd": b.sd})
        for n, b in found.items()
    }


def within(walk: Walk, band: pd.DataFrame, stem: str, foot: int) -> BoolArray:
    """(nf,) the moment of a leg is as far from the mean of its band at that percent as other
    people's.
    """
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
                out.append(
                    Peak(
                        f"{stem.split('_')[0]} {name}",
                        side,
                        float(values[int(end(values))]),
                        normal,
                        sd,
                    )
                )
    return out


def outside_sole(walk: Walk, foot: int) -> Array:
    """(nf,) m by which the centre of pressure is outside the sole; negative inside, -inf where a
    foot is not loaded.
    """
    return compute_distance_outside_hull(
        walk.centre[:, foot][:, [0, 2]], compute_sole_edge(walk.feet, foot, slice(None))
    )[0]


def passes(walk: Walk) -> bool:
    inside = all((outside_sole(walk, foot)[walk.loaded[:, foot]] <= 0).all() for foot in range(2))
    pushes = bool((walk.force[:, :, 1] >= 0).all()) and walk.residual < RESIDUAL
    return inside and pushes and all(abs(p.off) <= WITHIN for p in peaks(walk, normal_bands()))


def lines(walk: Walk) -> Iterator[str]:
    bands = normal_bands()
    yield "peaks of true moments, N·m/kg    right   (SD off)     left   (SD off)    band: mean, SD"
    found = peaks(walk, bands)
    for right, left in zip(found[::2], found[1::2], strict=True):
        row = "".join(f"{p.value:9.2f} {p.off:+9.1f}   " for p in (right, left))
        yield f"{right.name:30}{row}{right.normal:9.2f} {right.sd:6.2f}"
    yield f"share of frames within {WITHIN:g} SD of the band, or {NO_MATTER:g} N·m/kg, %"
    for stem in bands:
        shares = [100.0 * within(walk, bands[stem], stem, foot).mean() for foot in range(2)]
        yield f"{MOMENTS[stem][0]:30}{shares[0]:9.0f}{'':13}{shares[1]:9.0f}"
    for stem in (stem for stem in MOMENTS if stem not in bands):
        ends = [
            f"{walk.moments[f'{stem}_{s}'].min():.2f} to {walk.moments[f'{stem}_{s}'].max():.2f}"
            for s in SIDES
        ]
        yield f"{MOMENTS[stem][0]} (no band): right {ends[0]}, left {ends[1]} N·m/kg"
    for foot, side in enumerate(SIDES):
        away = outside_sole(walk, foot)[walk.loaded[:, foot]]
        counts = f"{int((away <= 0).sum())} of {len(away)} loaded frames"
        farthest = 1000 * max(0.0, float(away.max()))
        yield (
            f"centre of pressure in the {SIDE_WORDS[side]} sole: {counts}, farthest {farthest:.0f} "
            "mm outside"
        )
    yield (
        f"least vertical force {walk.force[:, :, 1].min():.3f}, most "
        f"{walk.force[:, :, 1].max():.2f} body weights"
    )
    yield f"true pelvis residual at most {walk.residual:.1e} N, N·m"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, help="of a perturbed person; else the nominal one")
    chosen = parser.parse_args(arguments)
    walk = true_walk(chosen.seed)
    print("\n".join(lines(walk)))
    return 0 if passes(walk) else 1


if __name__ == "__main__":
    sys.exit(main())
