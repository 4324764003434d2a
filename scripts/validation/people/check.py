"""Is calibration right on people? Real ones, whose joints nobody knows, and simulated ones with people's skin.

    people [--parts hips,halves,...] [--only NAME,...] [--study FILE ...] [--set key=value ...]

hips      how far calibration moves the joints of real people from their nominal places, and the population's mean and
          scatter; fitted hips beside those of ten people in CT. A population may scatter, but not move to one side
halves    hips by isolated trials alone against gait alone, as told and with a wide prior on hips (others may agree for
          they share their prior); of people with both
pairs     straight against turn, first walks and strides against last, walk against walk, each calibrated by itself: how
          many differences of joint parameters are inside bars of 68 and 95 %
markers   how far hips move when each thigh, or each shank, lacks its third marker
fit       markers of each trial over the floor of rigid segments, and the pelvis residual
moments   moments beside those of the hospital's own program, with the nominal model, our hips, and our masses too
skin      hips of people simulated by OpenSim (`opensim_truth`), whose skin moves as `--kinds` says (`truth/skin.py`),
          by gait, by six isolated trials, and by both; needs the extra `peers` once, to make the trials in `--cache`

`GAITCAL_DATA` names the folder of recordings; `--study` adds a person by a study file. Settings are gaitcal's defaults
but for `--set`, as `[calibration]` has them. All parts but `fit`
and `moments` fit the joints alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import gaitcal
from scripts.validation.harness import commas, matching, say
from scripts.validation.people import calibrated, hips, pairs
from scripts.validation.people.calibrated import fitted
from scripts.validation.recordings import PEOPLE, SIMULATED, changed, data, study_of_person
from scripts.validation.truth.people import made
from scripts.validation.truth.skin import Kind

SHARED = ("--only", "--set", "--cache", "--json")
Figures = dict[str, float]


def hips_part(chosen: argparse.Namespace) -> Figures:
    """Movement of joints of real people."""
    fits = [fitted(name, changed(study_of_person(name), chosen.settings)) for name in chosen.only]
    say(*hips.hip_lines(fits), "", *hips.population_lines(fits), "")
    images = hips.imaged(data() / "imaging" / "hip_landmarks_ct.csv")
    say(*hips.lines(fits, images))
    return hips.hip_figures(fits) | hips.outside(fits, images)


def halves_part(chosen: argparse.Namespace) -> Figures:
    """Isolated trials against gait."""
    out = {}
    for name in chosen.only:
        found = hips.halves(name, chosen.settings)
        say(*hips.half_lines(name, found))
        for case, pair in found.items():
            out[f"{name}, {case}: largest z"] = hips.largest_score(*pair)
            out[f"{name}, {case}: farthest, mm"] = hips.farthest(*pair)
    return out


def pairs_part(chosen: argparse.Namespace) -> Figures:
    """Recordings of one person against each other."""
    found = pairs.every_score(chosen.only, chosen.settings)
    say(*pairs.lines(found))
    return pairs.figures(found)


def _told(lines: Callable[..., object]) -> Callable[[argparse.Namespace], Figures]:
    """A part that prints line by line."""

    def part(chosen: argparse.Namespace) -> Figures:
        out: Figures = {}
        settings = tuple(chosen.settings.items()) if lines is not pairs.marker_lines else chosen.settings
        for line in lines(chosen.only, settings, out):
            say(line)
        return out

    return part


def skin_part(chosen: argparse.Namespace) -> Figures:
    """Simulated people with people's skin."""
    out: Figures = {}
    folder = data() / "opensim_truth"
    for kind in chosen.kinds:
        found = []
        for person in SIMULATED:
            made(person, folder, chosen.cache)
            for seed in range(1 if kind is Kind.NONE else chosen.seeds):
                found += calibrated.hips_of(person, kind, seed, chosen.settings, folder, chosen.cache)
        say(*calibrated.lines(found, out))
    return out


PARTS = {
    "hips": hips_part,
    "halves": halves_part,
    "pairs": pairs_part,
    "markers": _told(pairs.marker_lines),
    "fit": _told(calibrated.fit_lines),
    "moments": _told(calibrated.moment_lines),
    "skin": skin_part,
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Parts and people."""
    kinds = [kind.value for kind in Kind]
    parser.add_argument("--parts", type=commas(PARTS), default=list(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--study", action="append", default=[], metavar="FILE", help="one person more; may be repeated")
    parser.add_argument("--kinds", type=commas(kinds), default=[Kind.PEOPLE.value], help="how skin moves in part skin")
    parser.add_argument("--seeds", type=int, default=5, help="of each kind of movement and person (default 5)")


def run(chosen: argparse.Namespace) -> dict[str, Figures]:
    """Print the parts that are asked for."""
    named = matching(chosen.only, PEOPLE) if chosen.only or not chosen.study else []
    chosen.only = [*named, *chosen.study]
    chosen.kinds = [Kind(kind) for kind in chosen.kinds]
    say(f"gaitcal of {Path(gaitcal.__file__).parent}" + (f", {', '.join(chosen.set)}" if chosen.set else ""))
    out = {}
    for part in chosen.parts:
        start = time.perf_counter()
        say("", f"== {part}")
        out[part] = PARTS[part](chosen)
        say(f"({part}: {time.perf_counter() - start:.0f} s)")
        chosen.keep(out)
    return out
