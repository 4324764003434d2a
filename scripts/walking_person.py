"""Does the built-in person walk like a person? True moments beside the normal bands, centres of pressure in the soles.

    python scripts/walking_person.py [--out walking_person.png]

Drawn and printed is the truth of `gaitcal demo` and `gaitcal synthesize`, not a fit: internal moments per kg of body
mass over each leg's stride, ground reactions, the pelvis residual, and from above where the ground reactions act in the
soles (`gaitcal/dynamics/sole.py`). The bands are of `models/normal_walking.csv`, which tells its source, people and
licence: mean and 2 standard deviations; moments without a band there are drawn without one.

Exit code 0 where every centre of pressure is in its sole and every peak within 2 standard deviations, else 1.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.ground_reactions import foot_points
from gaitcal.dynamics.inverse_dynamics import Dynamics, pelvis_residual
from gaitcal.dynamics.sole import HEEL_M, SHAPE
from gaitcal.figures.chart import new_figure
from gaitcal.figures.style import FAINT, FONT, NORMAL, SIDE_COLOURS, SIDE_DASHES, TITLE, dress, line_style
from gaitcal.files.package_data import models_path
from gaitcal.gait.words import SIDE_WORDS
from gaitcal.model.linkage import COORDINATES, REACTIONS, SIDES
from gaitcal.model.nominal import published_model
from gaitcal.motion.motion import Motion
from gaitcal.recording.force_plate import point_and_torque
from gaitcal.synthetic.measurements import residual_free_wrench
from gaitcal.synthetic.motion import GAIT_CYCLE, gait_motion

LOADED_N = 20.0
"""Vertical force above which a foot counts as loaded: of less, rounding makes the centre of pressure."""
WITHIN = 2.0
"""Standard deviations: what 95 in 100 people keep to."""
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
FORCES = ("forward", "up", "to the right")


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


def true_walk() -> Walk:
    """The walk of the built-in person, with all that it asks of the ground."""
    model, motion = published_model(), gait_motion()
    phase, wrench = motion.basis.time / GAIT_CYCLE, residual_free_wrench(model.parameters, motion)
    q, v, a = (motion.basis.evaluate(motion.nodes, k) for k in range(3))
    forces = Dynamics(model.parameters).forces(q, v, a, wrench)
    names = [*COORDINATES, *REACTIONS]
    moments = {f"{stem}_{side}": forces[:, names.index(f"{stem}_{side}")] for stem in MOMENTS for side in SIDES}
    centre = np.stack([point_and_torque(wrench[:, foot])[0] for foot in range(2)], axis=1)
    centre[wrench[:, :, 1] <= LOADED_N] = np.nan
    return Walk(
        phase=phase,
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


def deviations(walk: Walk, band: pd.DataFrame, stem: str, foot: int) -> Array:
    """(nf,) how far a moment is from the mean of its band at that percent, in standard deviations."""
    at = walk.percent(foot)
    mean, sd = (np.interp(at, band["percent"], band[column]) for column in ("mean", "sd"))
    out: Array = (walk.moments[f"{stem}_{SIDES[foot]}"] - mean) / sd
    return out


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
    """Of every moment that has a band, both ends and both legs."""
    out = []
    for stem, band in bands.items():
        for side in SIDES:
            values = walk.moments[f"{stem}_{side}"]
            for name, end in zip(MOMENTS[stem][1:], (np.argmin, np.argmax), strict=True):
                row = band.iloc[int(end(band["mean"]))]
                where = f"{stem.split('_')[0]} {name}"
                out.append(Peak(where, side, float(values[int(end(values))]), float(row["mean"]), float(row["sd"])))
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


def lines(walk: Walk) -> Iterator[str]:
    """The report."""
    bands = normal_bands()
    yield "peaks of true moments, N·m/kg    right   (SD off)     left   (SD off)    band: mean, SD"
    found = peaks(walk, bands)
    for right, left in zip(found[::4] + found[1::4], found[2::4] + found[3::4], strict=True):
        row = "".join(f"{p.value:9.2f} {p.off:+9.1f}   " for p in (right, left))
        yield f"{right.name:30}{row}{right.normal:9.2f} {right.sd:6.2f}"
    yield f"share of frames within {WITHIN:g} SD of the band, %"
    for stem in bands:
        shares = [100.0 * np.mean(np.abs(deviations(walk, bands[stem], stem, foot)) < WITHIN) for foot in range(2)]
        yield f"{MOMENTS[stem][0]:30}{shares[0]:9.0f}{'':13}{shares[1]:9.0f}"
    for stem in MOMENTS.keys() - bands.keys():
        ends = [f"{walk.moments[f'{stem}_{s}'].min():.2f} to {walk.moments[f'{stem}_{s}'].max():.2f}" for s in SIDES]
        yield f"{MOMENTS[stem][0]} (no band): right {ends[0]}, left {ends[1]} N·m/kg"
    for foot, side in enumerate(SIDES):
        away = outside_sole(walk, foot)[walk.loaded[:, foot]]
        counts = f"{int((away <= 0).sum())} of {len(away)} loaded frames"
        farthest = 1000 * max(0.0, float(away.max()))
        yield f"centre of pressure in the {SIDE_WORDS[side]} sole: {counts}, farthest {farthest:.0f} mm outside"
    yield f"least vertical force {walk.force[:, :, 1].min():.3f}, most {walk.force[:, :, 1].max():.2f} body weights"
    yield f"true pelvis residual at most {walk.residual:.1e} N, N·m"


def passes(walk: Walk) -> bool:
    """Whether all is as it should be."""
    inside = all((outside_sole(walk, foot)[walk.loaded[:, foot]] <= 0).all() for foot in range(2))
    return inside and all(abs(p.off) <= WITHIN for p in peaks(walk, normal_bands()))


def draw(walk: Walk) -> Figure:
    """All of it in one figure."""
    bands = normal_bands()
    figure = new_figure(9.0, 9.6, dpi=150)
    cells = figure.add_gridspec(
        4, 3, height_ratios=(1, 1, 1, 0.95), left=0.07, right=0.985, top=0.945, bottom=0.075, hspace=0.42, wspace=0.24
    )
    for k, stem in enumerate(MOMENTS):
        axes = figure.add_subplot(cells[divmod(k, 3)])
        title, low, high = MOMENTS[stem]
        dress(axes, title=title, ylabel=f"{low}  ·  {high}" if k % 3 else f"N·m/kg   {low}  ·  {high}")
        if stem in bands:
            _band(axes, bands[stem])
        for foot, side in enumerate(SIDES):
            _curve(axes, walk.percent(foot), walk.moments[f"{stem}_{side}"], side)
        axes.set_xlim(0, 100)
    for k, directions in enumerate(((1,), (0, 2))):
        axes = figure.add_subplot(cells[2, 1 + k])
        dress(axes, title=("Vertical ground reaction", "Horizontal ground reaction")[k], ylabel="body weights")
        for direction in directions:
            for foot, side in enumerate(SIDES):
                inward = -1.0 if direction == 2 and side == "r" else 1.0  # both sides alike: towards the other foot
                values = inward * walk.force[:, foot, direction]
                _curve(axes, walk.percent(foot), values, side, width=0.8 if direction == 2 else 1.6)
        axes.set_xlim(0, 100)
    _soles(figure.add_subplot(cells[3, :]), walk)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=SIDE_COLOURS[s], ls=line_style(SIDE_DASHES[s]), label=SIDE_WORDS[s]) for s in SIDES
    ]
    handles += [
        Patch(color=FAINT, alpha=alpha, label=f"normal, mean ± {n} SD", lw=0) for n, alpha in ((1, 0.34), (2, 0.16))
    ]
    figure.legend(handles=handles, loc="upper right", ncols=4, frameon=False, prop={"family": FONT, "size": NORMAL})
    figure.text(0.012, 0.978, "The built-in person's walk", family=FONT, fontsize=TITLE + 2, fontweight="bold")
    figure.text(
        0.012,
        0.012,
        f"Internal moments over each leg's stride (%). Bands: {_source()}",
        family=FONT,
        fontsize=NORMAL - 1,
    )
    return figure


def _source() -> str:
    text = (models_path() / BANDS).read_text(encoding="utf-8")
    return "Schwartz et al. 2008, free speed (children and adolescents)" if "Schwartz" in text else BANDS


def _band(axes: Axes, band: pd.DataFrame) -> None:
    for width, alpha in ((2.0, 0.16), (1.0, 0.2)):
        low, high = (band["mean"] + sign * width * band["sd"] for sign in (-1.0, 1.0))
        axes.fill_between(band["percent"], low, high, color=FAINT, alpha=alpha, linewidth=0)


def _curve(axes: Axes, percent: Array, values: Array, side: str, width: float = 1.6) -> None:
    """A curve over the stride, one line for each: they begin where the percent falls."""
    for stride in np.split(np.arange(len(percent)), np.flatnonzero(np.diff(percent) < 0) + 1):
        axes.plot(percent[stride], values[stride], color=SIDE_COLOURS[side], ls=line_style(SIDE_DASHES[side]), lw=width)


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


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="a picture, .png or .svg")
    chosen = parser.parse_args(arguments)
    walk = true_walk()
    print("\n".join(lines(walk)))
    if chosen.out is not None:
        draw(walk).savefig(chosen.out)
        print(chosen.out)
    return 0 if passes(walk) else 1


if __name__ == "__main__":
    sys.exit(main())
