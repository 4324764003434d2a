"""Does the built-in person walk like a person? True moments beside the normal bands, centres of pressure in the soles.

    python -m scripts.tools.walking [--seed N] [--out walking_person.png]

Drawn and printed is the truth of the built-in person, or of the one that `gaitcal synthesize --perturb --seed N` writes
(`gaitcal demo`: 2009), not a fit: internal moments per kg of body mass over each leg's stride, ground reactions, the
pelvis residual, and from above where the ground reactions act in the soles (`gaitcal/dynamics/sole.py`). The bands are
those of `models/normal_walking.csv`, which tells source, people and licence, and the peak of the hip abductors that is
published for adults; other moments are drawn without a band.

Perturbed people walk the same walk with axes up to 10 mm and 10 degrees elsewhere: about these, the moment that adducts
a knee is up to 6 standard deviations from people's (16 seeds), other peaks up to 3.

Exit code 0 where every centre of pressure is in its sole and every peak within 2 standard deviations, else 1.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from gaitcal.gait.words import SIDE_WORDS
from gaitcal.model.linkage import SIDES
from scripts.tools.walking.drawing import draw
from scripts.tools.walking.true_walk import (
    MOMENTS,
    NO_MATTER,
    WITHIN,
    Walk,
    normal_bands,
    outside_sole,
    passes,
    peaks,
    true_walk,
    within,
)


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
