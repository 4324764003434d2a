"""Is calibration right on people? Real ones, whose joints nobody knows, and simulated ones with people's skin.

    people [--parts hips,halves,...] [--only NAME,...] [--study FILE ...] [--set key=value ...]

hips      how far calibration moves the joints of real people from their nominal places, and the population's mean and
          scatter; fitted hips beside those of ten people in CT. A population may scatter, but not move to one side
halves    hips by isolated trials alone against gait alone, as told and with a wide prior on hips (others may agree for
          they share their prior); of people with both
pairs     straight against turn, first walks and strides against last, walk against walk, each calibrated by itself: how
          many differences of joint parameters are inside bars of 68 and 95 %
knees     where the marker on the knee turns about in the shank, and how far calibration moves the knee's axis
skin      hips of people simulated by OpenSim (`opensim_truth`), whose skin moves as `--kinds` says (`truth/skin.py`),
          by gait, by six isolated trials, and by both; needs the extra `peers` once, to make the trials in `--cache`
drawn     the same people with a prior of which they are a draw (`people/simulated.py`): all joints of the legs

`GAITCAL_DATA` names the folder of recordings; `--study` adds a person by a study file. Settings are gaitcal's defaults
but for `--set`, as `[calibration]` has them. All parts fit the joints alone.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import gaitcal
from scripts.validation.harness import each_part, matching, option, say, words_of
from scripts.validation.people import hips, knees, pairs, simulated
from scripts.validation.people.fits import fitted
from scripts.validation.recordings import PEOPLE, SIMULATED, changed, data, study_of_person
from scripts.validation.truth.people import made
from scripts.validation.truth.skin import Kind

SHARED = ("--only", "--set", "--cache", "--json")
OWN = {
    "--study": option([], "one person more; may be repeated", metavar="FILE"),
    "--kinds": words_of(Kind, [Kind.PEOPLE]),
    "--seeds": option(5, "of each kind of movement and person"),
}
Figures = dict[str, float]


def hips_part(chosen: argparse.Namespace) -> Figures:
    fits = [fitted(name, changed(study_of_person(name), chosen.settings)) for name in chosen.only]
    say(*hips.hip_lines(fits), "", *hips.population_lines(fits), "")
    images = hips.imaged(data() / "imaging" / "hip_landmarks_ct.csv")
    say(*hips.lines(fits, images))
    return hips.hip_figures(fits) | hips.outside(fits, images)


def halves_part(chosen: argparse.Namespace) -> Figures:
    out = {}
    for name in chosen.only:
        found = hips.halves(name, chosen.settings)
        say(*hips.half_lines(name, found))
        for case, pair in found.items():
            out[f"{name}, {case}: largest z"], out[f"{name}, {case}: farthest, mm"] = hips.largest(*pair)
    return out


def pairs_part(chosen: argparse.Namespace) -> Figures:
    found = pairs.every_score(chosen.only, chosen.settings)
    say(*pairs.lines(found))
    return pairs.figures(found)


def knees_part(chosen: argparse.Namespace) -> Figures:
    found = [knee for name in chosen.only for knee in knees.knees_of(name, chosen.settings)]
    say(*knees.lines(found))
    return {f"{k.name} {k.side}: centre up": float(k.centre[1]) for k in found}


def simulated_part(drawn: bool, chosen: argparse.Namespace) -> Figures:
    """Simulated people with people's skin, as they are (hips alone), or as the prior says."""
    out: Figures = {}
    for person in SIMULATED:
        made(person, data() / "opensim_truth", chosen.cache)
    for kind in chosen.kinds:
        rows: simulated.Rows = {}
        for seed in range(1 if kind is Kind.NONE else chosen.seeds):
            for person in SIMULATED:
                simulated.add_fits(rows, person, kind, seed, chosen.settings, chosen.cache, drawn=drawn)
        say(*simulated.lines(rows if drawn else simulated.hips_in_space(rows), out, f"{kind.value}, "))
    return out


PARTS = {
    "hips": hips_part,
    "halves": halves_part,
    "pairs": pairs_part,
    "knees": knees_part,
    "skin": partial(simulated_part, False),
    "drawn": partial(simulated_part, True),
}


def run(chosen: argparse.Namespace) -> dict[str, Figures]:
    named = matching(chosen.only, PEOPLE) if chosen.only or not chosen.study else []
    chosen.only = [*named, *chosen.study]
    say(f"gaitcal of {Path(gaitcal.__file__).parent}" + (f", {', '.join(chosen.set)}" if chosen.set else ""))
    return each_part(PARTS, chosen)
