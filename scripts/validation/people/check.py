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
drawn     the same people with a prior of which they are a draw (`people/drawn.py`): all joint parameters of the legs

`GAITCAL_DATA` names the folder of recordings; `--study` adds a person by a study file. Settings are gaitcal's defaults
but for `--set`, as `[calibration]` has them. All parts fit the joints alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import gaitcal
from gaitcal.arrays import Array
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import JP_INDEX
from scripts.validation.error_bars import Bars, bars, rms
from scripts.validation.harness import commas, matching, say
from scripts.validation.people import drawn, hips, knees, pairs
from scripts.validation.people.fits import fitted
from scripts.validation.recordings import PEOPLE, SIMULATED, changed, data, only, study_of_person
from scripts.validation.truth.people import hip_parameters, isolated_person, made, static_frames
from scripts.validation.truth.report import TO_UNIT
from scripts.validation.truth.skin import TABLE_MM, Kind, disturbed

SHARED = ("--only", "--set", "--cache", "--json")
Figures = dict[str, float]


TRIALS = {"gait": ("gait",), "isolated": ("joint",), "gait and isolated": ("gait", "joint")}
"""Words -> roles of the trials that are calibrated."""
WAVES_MM = 10.0
"""Of the published waves; other kinds have the size of their table."""


@dataclass(frozen=True, kw_only=True)
class Hips:
    """Both hips of one fit, in pelvis and thigh."""

    kind: Kind
    trials: str
    error: Array
    """(4, 3) mm: fitted less true."""
    nominal: Array
    """(4, 3) mm: nominal less true, which is the prior's error."""
    se: Array
    """(4, 3) mm."""


def hips_of(person: str, kind: Kind, seed: int, settings: Mapping[str, object], data: Path, cache: Path) -> list[Hips]:
    """Hips of a simulated person: disturb the markers, and fit each choice of trials."""
    made = isolated_person(person, data, cache, with_gait=True)
    size = WAVES_MM if kind is Kind.SINUSOIDS else TABLE_MM
    study = changed(disturbed(made.study, kind, size, seed), settings)
    out = []
    for words, roles in TRIALS.items():
        fit = fitted(person, only(study, *roles))
        frames = static_frames(fit.nominal, study.static.recording)
        truth = {n: v for s in SIDES for n, v in hip_parameters(frames, s, made.centres[f"hip_{s}"]).items()}
        at, true = [JP_INDEX[name] for name in truth], np.array(list(truth.values()))
        values = (fit.parameters.joint[at] - true, fit.nominal.parameters.joint[at] - true, fit.errors[at])
        error, nominal, se = (v.reshape(-1, 3) / TO_UNIT["mm"] for v in values)
        out.append(Hips(kind=kind, trials=words, error=error, nominal=nominal, se=se))
    return out


def skin_lines(found: Sequence[Hips], out: dict[str, float]) -> Iterator[str]:
    """RMS distance and coverage of each kind and choice of trials; figures into `out`."""
    yield f"{'hips, mm: RMS distance':32}{'fits':>6}{'nominal':>9}{'fitted':>9}{'SE':>7}{'in 68 %':>9}{'in 95 %':>9}"
    for kind, trials in dict.fromkeys((h.kind, h.trials) for h in found):
        of = [h for h in found if (h.kind, h.trials) == (kind, trials)]
        nominal, error = (rms([np.linalg.norm(getattr(h, w), axis=1) for h in of]) for w in ("nominal", "error"))
        held = sum((bars(h.error, h.se) for h in of), Bars())
        name = f"{kind.value}, {trials}"
        yield (
            f"{name:32}{len(of):6}{nominal:9.1f}{error:9.2f}{np.sqrt(3) * held.rms:7.1f}"
            f"{held.shares[0]:9.0f}{held.shares[1]:9.0f}"
        )
        out |= {f"{name}: nominal": nominal, f"{name}: RMS": error, f"{name}: in 95 %": held.shares[1]}


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
        for line in hips.half_lines(name, found):
            say(line)
        for case, pair in found.items():
            out[f"{name}, {case}: largest z"], out[f"{name}, {case}: farthest, mm"] = hips.largest(*pair)
    return out


def pairs_part(chosen: argparse.Namespace) -> Figures:
    """Recordings of one person against each other."""
    found = pairs.every_score(chosen.only, chosen.settings)
    say(*pairs.lines(found))
    return pairs.figures(found)


def knees_part(chosen: argparse.Namespace) -> Figures:
    """The knee's marker against the shank's."""
    found = [knee for name in chosen.only for knee in knees.knees_of(name, chosen.settings)]
    say(*knees.lines(found))
    return {f"{k.name} {k.side}: centre up": float(k.centre[1]) for k in found}


def skin_part(chosen: argparse.Namespace) -> Figures:
    """Simulated people with people's skin."""
    out: Figures = {}
    folder = data() / "opensim_truth"
    for kind in chosen.kinds:
        found = []
        for person in SIMULATED:
            made(person, folder, chosen.cache)
            for seed in range(1 if kind is Kind.NONE else chosen.seeds):
                found += hips_of(person, kind, seed, chosen.settings, folder, chosen.cache)
        say(*skin_lines(found, out))
    return out


def drawn_part(chosen: argparse.Namespace) -> Figures:
    """Simulated people who are what the prior says."""
    out: Figures = {}
    folder, rows = data() / "opensim_truth", drawn.Rows()
    for kind in chosen.kinds:
        for seed in range(chosen.seeds):
            for person in SIMULATED:
                drawn.add_fits(rows, person, kind, seed, TRIALS, chosen.settings, folder, chosen.cache)
        say(kind.value, *drawn.lines(rows, out))
    return out


PARTS = {
    "hips": hips_part,
    "halves": halves_part,
    "pairs": pairs_part,
    "knees": knees_part,
    "skin": skin_part,
    "drawn": drawn_part,
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Parts and people."""
    kinds = [kind.value for kind in Kind]
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
