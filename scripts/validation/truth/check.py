"""How near the truth, and do the error bars hold? One table over people, kinds of error and seeds.

    truth [--parts gait,isolated,functional,synthetic] [--only p01,p18] [--seeds 6] [--jobs 2] [--kinds none,linear,...]
        [--set key=value ...]

gait        people of `opensim_truth`, walk and static trial: joint centres, torques against OpenSim's own
isolated    the same people's six isolated trials, made by OpenSim once (extra `peers`): joint centres and axes, beside
            SCoRE and SARA
functional  the same people's walk alone, and with a trial of each hip that is isolated, or is any motion: hip centres
synthetic   people of our own linkage through C3D files, as `gaitcal synthesize --noise --perturb` writes them
recovery    the same, every joint and inertial parameter by itself (`truth/made_up.py`); `--know` says what is known
published   the published subject with the published noise, `--seeds` draws of it (`truth/made_up.py`): how many
            intervals of joint parameters, coordinates, torques, powers and moment vectors hold the truth

Markers are moved as `truth/skin.py` tells: not at all (`none`; one fit a person), by the published waves, by skin that
follows the joints or its own time. `before` is the nominal model, `peer` SCoRE or SARA (RMS), `SE` the RMS of the
standard errors, then how many intervals of 68 and 95 % held the truth (a fixed parameter has none, which holds nothing)
of how many. Settings are gaitcal's defaults but for `--set`, as `[calibration]` has them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from scripts.validation.harness import matching, option, say, side_by_side, words_of
from scripts.validation.recordings import SIMULATED, data
from scripts.validation.truth import made_up, report, simulated
from scripts.validation.truth.people import made
from scripts.validation.truth.report import Outcome
from scripts.validation.truth.skin import FIVE, OF_PEOPLE, Kind

SHARED = ("--jobs", "--only", "--seed", "--set", "--cache", "--json")
PARTS = ("gait", "isolated", "synthetic", "functional", "recovery", "published")
USUAL_PARTS = PARTS[:3]
"""The last two have tables of their own; the one before them takes ten minutes."""
OWN = {
    "--kinds": words_of(Kind),
    "--seeds": option(6, "of each kind of movement and person"),
    "--synthetic-people": option(9, "of our own linkage", metavar="N"),
    "--know": option("default", "part recovery", choices=[setting.value for setting in made_up.Settings]),
    "--size": option(float, "of the movement, instead of each part's own; of the published noise", metavar="MM"),
    "--with-gait": option(False, "part isolated: the walk, without plates, as well"),
}
KINDS = {
    "gait": (Kind.NONE, Kind.SINUSOIDS, Kind.MIXTURE, Kind.PEOPLE),
    "isolated": (Kind.NONE, *FIVE, Kind.MIXTURE, Kind.PEOPLE),
    "functional": (Kind.PEOPLE,),
}
"""What is tried unless `--kinds` says otherwise."""
WAVES_MM, GAIT_SKIN_MM, SKIN_MM = 10.0, 10.0, 15.0
"""Sizes of the published waves, and of skin movement in the parts `gait` and `isolated`."""


def tasks(chosen: argparse.Namespace, synthetic: range) -> list[Callable[[], Outcome]]:
    """Every fit of the parts with a common table, as a function that makes it."""
    out: list[Callable[[], Outcome]] = []
    folder = data() / "opensim_truth" if set(chosen.parts) & set(KINDS) else None
    for part in (part for part in chosen.parts if part in KINDS):
        for person in matching(chosen.only, SIMULATED):
            if part != "gait":
                made(person, folder, chosen.cache)
            for kind in chosen.kinds or KINDS[part]:
                skin = SKIN_MM if part != "gait" or kind in OF_PEOPLE else GAIT_SKIN_MM
                size = chosen.size or (WAVES_MM if kind is Kind.SINUSOIDS else skin)
                for seed in range(chosen.seed, chosen.seed + (1 if kind is Kind.NONE else chosen.seeds)):
                    common = (person, kind, seed, size, chosen.settings, folder)
                    if part == "gait":
                        out.append(partial(simulated.gait, *common))
                    elif part == "functional":
                        out += [partial(simulated.functional, *common, chosen.cache, of) for of in simulated.HipTrials]
                    else:
                        out.append(partial(simulated.isolated, *common, chosen.cache, chosen.with_gait))
    if "synthetic" in chosen.parts:
        out += [partial(made_up.outcome, seed, chosen.settings) for seed in synthetic]
    return out


def run(chosen: argparse.Namespace) -> list[Outcome]:
    synthetic = range(chosen.seed, chosen.seed + chosen.synthetic_people)
    if "recovery" in chosen.parts:
        settings = made_up.Settings(chosen.know)
        people = [partial(made_up.synthetic_person, seed, settings, chosen.settings) for seed in synthetic]
        say(*made_up.lines(list(side_by_side(people, chosen.jobs))))
    if "published" in chosen.parts:
        say(
            *made_up.published_lines(
                made_up.draws(chosen.seeds, 1e-3 * (chosen.size or WAVES_MM), chosen.seed, chosen.jobs)
            )
        )
    outcomes = list(side_by_side(tasks(chosen, synthetic), chosen.jobs))
    if outcomes:
        if chosen.set:
            say(f"settings: {', '.join(chosen.set)}")
        say(*report.lines(outcomes))
    return outcomes
