"""Does the built-in person walk like a person? True moments beside the normal bands, centres of pressure in the soles.

    python -m scripts.tools.walking_person [--seed N] [--out walking_person.png]

Drawn and printed is the truth of the built-in person, or of the one that `gaitcal synthesize --perturb --seed N` writes
(`gaitcal demo`: 2009), not a fit: internal moments per kg of body mass over each leg's stride, ground reactions, the
pelvis residual, and from above where the ground reactions act in the soles (`dynamics/foot_contact.py`). The bands are
those of `models/norms/schwartz2008_free.csv`, which tells source, people and licence, and the peak of the hip
abductors that is published for adults; other moments are drawn without a band.

Perturbed people walk the same walk with axes up to 10 mm and 10 degrees elsewhere: about these, the moment that adducts
a knee is up to 6 standard deviations from people's (16 seeds), other peaks up to 3.

Exit code 0 where every centre of pressure is in its sole and every peak within 2 standard deviations, else 1.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import HEEL_M, SHAPE, FootPoints
from gaitcal.dynamics.ground_reactions import foot_points
from gaitcal.dynamics.inverse_dynamics import Dynamics, pelvis_residual
from gaitcal.figures.chart import (
    FAINT,
    FONT,
    NORMAL,
    SIDE_COLOURS,
    SIDE_DASHES,
    TITLE,
    dress,
    line_style,
    new_figure,
    write,
)
from gaitcal.gait.moments import SIDE_WORDS
from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.io.force_plate import point_and_torque
from gaitcal.model.linkage import COORDINATES, REACTIONS, SIDES
from gaitcal.model.nominal import published_model
from gaitcal.motion.motion import Motion
from gaitcal.synthetic.motion import residual_free_wrench, two_strides
from gaitcal.synthetic.subject import true_gait

LOADED_N = 20.0
"""Vertical force above which a foot counts as loaded: of less, rounding makes the centre of pressure."""
RESIDUAL = 1e-9
"""N, N·m: rounding of some hundred N at lever arms of a metre."""
WITHIN = 2.0
"""Standard deviations: what 95 in 100 people keep to."""
NO_MATTER = 0.05
"""N·m/kg: in swing the bands of the ankle are narrower than any laboratory measures."""
BANDS = "schwartz2008-free"
OF_ADULTS = ("hip_flexion", "knee_angle", "knee_adduction", "ankle_angle")
"""Children's moments that adults have, too: abductors of their hips make 0.5 N·m/kg, those of adults 1.1."""

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
    parameters, motion = (model.parameters, two_strides(model.parameters)) if seed is None else true_gait(seed)
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
    """Variable without its ending -> percent, mean, sd (N·m/kg), internal, positive in the coordinate's direction."""
    bands = read_normal_bands(BANDS)
    found = {name: bands[f"{name}_moment"] for name in OF_ADULTS}
    return {n: pd.DataFrame({"percent": b.percent, "mean": -b.mean, "sd": b.sd}) for n, b in found.items()}


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


SINGLE_SUPPORT = (12, 50)
"""% of the stride."""
SOURCES = "Bands: Schwartz et al. 2008, children 4 to 17 years, free speed; models/norms/ tells more."


def draw(walk: Walk) -> Figure:
    """All of it in one figure."""
    bands = normal_bands()
    figure = new_figure(9.0, 8.8, dpi=150)
    ratios, edges = (1, 1, 1, 0.62), {"left": 0.07, "right": 0.985, "top": 0.935, "bottom": 0.085}
    cells = figure.add_gridspec(4, 3, height_ratios=ratios, **edges, hspace=0.4, wspace=0.24)

    def curves(axes: Axes, values: Callable[[int, str], Array], width: float = 1.6) -> None:
        """Both legs' over the stride, one line for each stride: they begin where the percent falls."""
        for foot, side in enumerate(SIDES):
            percent, curve, style = walk.percent(foot), values(foot, side), line_style(SIDE_DASHES[side])
            for s in np.split(np.arange(len(percent)), np.flatnonzero(np.diff(percent) < 0) + 1):
                axes.plot(percent[s], curve[s], color=SIDE_COLOURS[side], ls=style, lw=width)
        axes.set_xlim(0, 100)

    for k, (stem, (title, low, high)) in enumerate(MOMENTS.items()):
        axes = figure.add_subplot(cells[divmod(k, 3)])
        dress(axes, title=title, ylabel=f"{low}  ·  {high}" if k % 3 else f"N·m/kg   {low}  ·  {high}")
        if stem in bands:
            _band(axes, *(bands[stem][column] for column in ("percent", "mean", "sd")))
        for mean, sd in (ADULT_PEAKS[stem, name] for name in (low, high) if (stem, name) in ADULT_PEAKS):
            _band(axes, SINGLE_SUPPORT, mean, sd)  # a peak whose time is not published is in single support
            write(axes, 52, mean, "peak of adults", va="center")
        curves(axes, lambda _, side, stem=stem: walk.moments[f"{stem}_{side}"])
    for k, (title, directions) in enumerate({"Vertical": (1,), "Horizontal": (0, 2)}.items()):
        axes = figure.add_subplot(cells[2, 1 + k])
        dress(axes, title=f"{title} ground reaction", ylabel="body weights")
        for axis in directions:  # both sides alike: sideways is towards the other foot
            inward = {"r": -1.0 if axis == 2 else 1.0, "l": 1.0}
            curves(
                axes, lambda foot, side, a=axis, i=inward: i[side] * walk.force[:, foot, a], 0.8 if axis == 2 else 1.6
            )
        if len(directions) > 1:
            write(axes, 99, axes.get_ylim()[1] * 0.95, "thick: forward\nthin: inward", ha="right", va="top")
    _soles(figure.add_subplot(cells[3, :]), walk)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=SIDE_COLOURS[s], ls=line_style(SIDE_DASHES[s]), label=SIDE_WORDS[s]) for s in SIDES
    ]
    shades = ((1, 0.34), (2, 0.16))
    handles += [Patch(color=FAINT, alpha=alpha, label=f"normal, mean ± {n} SD", lw=0) for n, alpha in shades]
    figure.legend(handles=handles, loc="upper right", ncols=4, frameon=False, prop={"family": FONT, "size": NORMAL})
    figure.text(0.012, 0.978, "The built-in person's walk", family=FONT, fontsize=TITLE + 2, fontweight="bold")
    said = f"Over each leg's stride (%). Moments are internal. {SOURCES}"
    figure.text(0.012, 0.012, said, family=FONT, fontsize=NORMAL - 1)
    return figure


def _band(axes: Axes, percent: ArrayLike, mean: ArrayLike, sd: ArrayLike) -> None:
    mean, sd = np.asarray(mean), np.asarray(sd)
    for width, alpha in ((2.0, 0.16), (1.0, 0.2)):
        axes.fill_between(percent, mean - width * sd, mean + width * sd, color=FAINT, alpha=alpha, linewidth=0)


def _soles(axes: Axes, walk: Walk) -> None:
    """From above: the sole of every step in the middle of its stance, and the way of the centre of pressure."""
    dress(axes, title="Centres of pressure in the soles, from above", xlabel="forward (m)", ylabel="right (m)")
    for foot, side in enumerate(SIDES):
        frames = np.flatnonzero(walk.loaded[:, foot])
        for step in np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1):
            outline = _outline(walk.feet, foot, int(step[np.argmin(walk.feet.toe_speed[step, foot])]))
            axes.fill(*outline.T, facecolor=SIDE_COLOURS[side], alpha=0.12, linewidth=0)
            axes.plot(*outline.T, color=SIDE_COLOURS[side], linewidth=0.8)
            x, z = walk.centre[step, foot][:, [0, 2]].T
            away = outside_sole(walk, foot)[step] > 0
            axes.plot(x, z, color=SIDE_COLOURS[side], linewidth=0.7)
            axes.scatter(x[~away], z[~away], s=5, color=SIDE_COLOURS[side], linewidth=0)
            axes.scatter(x[away], z[away], s=9, marker="x", color="#c00000", linewidth=0.7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()


def _outline(feet: FootPoints, foot: int, frame: int) -> Array:
    """(n, 2) m, forward and right: the edge of a sole."""
    heel, tip = (p[frame, foot][[0, 2]] for p in (feet.heel, feet.tip))
    forward = (tip - heel) / np.linalg.norm(tip - heel)
    aside = np.array([-forward[1], forward[0]])
    part = np.linspace(0.0, 1.0, 40)
    middle = heel + np.outer(HEEL_M + part * (np.linalg.norm(tip - heel) - HEEL_M), forward)
    half = np.outer(feet.width * np.interp(part, *SHAPE) / 2, aside)
    return np.vstack([middle + half, (middle - half)[::-1], middle[:1] + half[:1]])


def lines(walk: Walk) -> Iterator[str]:
    """The report."""
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
        ends = [f"{walk.moments[f'{stem}_{s}'].min():.2f} to {walk.moments[f'{stem}_{s}'].max():.2f}" for s in SIDES]
        yield f"{MOMENTS[stem][0]} (no band): right {ends[0]}, left {ends[1]} N·m/kg"
    for foot, side in enumerate(SIDES):
        away = outside_sole(walk, foot)[walk.loaded[:, foot]]
        counts = f"{int((away <= 0).sum())} of {len(away)} loaded frames"
        farthest = 1000 * max(0.0, float(away.max()))
        yield f"centre of pressure in the {SIDE_WORDS[side]} sole: {counts}, farthest {farthest:.0f} mm outside"
    yield f"least vertical force {walk.force[:, :, 1].min():.3f}, most {walk.force[:, :, 1].max():.2f} body weights"
    yield f"true pelvis residual at most {walk.residual:.1e} N, N·m"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="a picture, .png or .svg")
    parser.add_argument("--seed", type=int, help="of a perturbed person; else the nominal one")
    chosen = parser.parse_args(arguments)
    walk = true_walk(chosen.seed)
    print("\n".join(lines(walk)))
    if chosen.out is not None:
        draw(walk).savefig(chosen.out)
        print(chosen.out)
    return 0 if passes(walk) else 1


if __name__ == "__main__":
    sys.exit(main())
