"""Does anything wrong go unnoticed? Clean studies are spoilt in many ways; each must end so that one can live with it.

    attacks [--all] [--jobs 2] [--only REGEX] [--base NAME ...] [--part K/N] [--list]
    attacks --quick        # a dozen, in less than a minute
    attacks --clean        # every finding on the clean recordings, more of them

Each attack changes one thing in one short study (static trial, walk, isolated trials: `attacks/attack.py`), which is
then checked and calibrated as `gaitcal calibrate` would. Without options each is made on one study, the studies
taking turns; with `--all`, `--only` or `--base` on every study that it is meant for. It ends as one of

refused     an error stops the run
named       a new message names the cause: it holds the words that the attack lists, marker, trial or plate among them
harmless    no new message, and every leg torque, leg angle and hip, knee and ankle centre lies within the error bar
            of its own run around the clean run: the RMS over frames of |difference| / max(1.96 standard errors, floor)
            is at most 1; floors: 0.2 % of body weight times height, 1 deg, 5 mm (`attacks/curves.py`)
alarmed     something new is said, but not the cause
silent      nothing new is said, and a result moved by more than its own error bar
crash       an exception that is no error of gaitcal's

New is a message (warnings and errors of checks and of the calibration; notes do not count) whose words, numbers left
out, the clean run does not say. Real recordings are read from the folder that GAITCAL_DATA names; without it only the
synthetic person is attacked. Exit code 1 where more than 2 % end silent, more than 10 % alarmed, or anything crashes.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from functools import partial

from scripts.validation.attacks.attack import EVERY, SYNTHETIC, Attack, Result
from scripts.validation.attacks.corpus import corpus, once_each
from scripts.validation.attacks.run import Clean, line, lines, passed, run_clean, run_title  # noqa: F401
from scripts.validation.harness import side_by_side

SHARED = ("--jobs", "--only", "--list", "--json")


def chosen_attacks(arguments: argparse.Namespace) -> list[Attack]:
    """Those that the command line asks for and whose recordings are there."""
    first, step = arguments.part
    there, every = os.environ.get("GAITCAL_DATA"), corpus()
    wide = arguments.all or arguments.quick or arguments.base or arguments.only
    found = [
        attack
        for attack in (every if wide else once_each(every))
        if (not arguments.only or re.search(arguments.only, attack.title, re.IGNORECASE))
        and (not arguments.base or attack.base in arguments.base)
        and (not arguments.quick or attack.quick)
        and (there or attack.base == SYNTHETIC)
    ]
    return found[first - 1 :: step]


def part(text: str) -> tuple[int, int]:
    """`2/3`: the second of three parts."""
    found = re.fullmatch(r"([1-9]\d*)/([1-9]\d*)", text)
    if not found or int(found[1]) > int(found[2]):
        raise argparse.ArgumentTypeError(f"found '{text}'; allowed: K/N, the Kth of N parts")
    return int(found[1]), int(found[2])


def print_clean(clean: list[Clean]) -> None:
    """What is said of the clean recordings, and how long they take."""
    for one in clean:
        print(f"{one.base}: {len(one.messages)} messages, {one.seconds:.1f} s{' REFUSED' if one.refused else ''}")
        for message in dict.fromkeys((*one.refused, *one.messages)):
            print(f"    {message}")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which attacks."""
    parser.add_argument("--all", action="store_true", help="every attack on every base that it is meant for")
    parser.add_argument("--base", action="append", default=[], choices=list(EVERY), help="clean study; may be repeated")
    parser.add_argument("--part", type=part, default=(1, 1), metavar="K/N", help="the Kth of N parts, kinds mixed")
    parser.add_argument("--quick", action="store_true", help="the few that run as a test")
    parser.add_argument("--clean", action="store_true", help="what is said of the clean recordings, no attack")


def run(chosen: argparse.Namespace) -> list[Result]:
    """Make the attacks and print the table."""
    attacks = chosen_attacks(chosen)
    if chosen.list:
        print("\n".join(attack.title for attack in attacks))
        print(f"{len(attacks)} attacks")
        return []
    bases = chosen.base or list(EVERY) if chosen.clean else list(dict.fromkeys(attack.base for attack in attacks))
    clean = list(side_by_side([partial(run_clean, base) for base in bases], chosen.jobs))
    if chosen.clean:
        print_clean(clean)
        return []
    of_base = {one.base: one for one in clean if not one.refused}
    if refused := [one for one in clean if one.refused]:
        print("clean studies that are refused, whose attacks are left out:")
        print_clean(refused)
        attacks = [attack for attack in attacks if attack.base in of_base]
    results: list[Result] = []
    tasks = [partial(run_title, attack.title, of_base[attack.base]) for attack in attacks]
    for result in side_by_side(tasks, chosen.jobs):
        results.append(result)
        print(f"{len(results):4d} of {len(attacks)}{line(result)}", file=sys.stderr, flush=True)
    print("\n".join(lines(results)))
    if refused:
        raise SystemExit(1)
    return results
