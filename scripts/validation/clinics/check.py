"""Does the first command reach torques on any laboratory's folder? Bare folders, and what other laboratories do.

    clinics [--jobs 2] [--only REGEX] [--list] [--keep DIR]

Each case is a folder of recordings without a study file: as the laboratory left it, or changed as another one would
have written it (`clinics/variants.py`). `gaitcal calibrate FOLDER` runs on it in a process of its own. It ends as one
of

torques     exit code 0 or a verdict that says no, and a leg with valid torques wherever forces were recorded; the same
            as of the folder as it was, within their error bars (RMS over frames of |difference| /
            max(1.96 standard errors, floor), median over the legs' coordinates, at most 1)
asked       a clear line, no torques, where more cannot be said
refused     a clear line, no torques, though there is enough to say more
wrong       other torques than of the folder as it was, and nothing said that is not said there
named       other torques, and a message that the folder as it was does not have
crash       a traceback, or an exit code that no fault of the input explains

Exit code 1 where fewer than nine in ten reach torques (or rightly ask), or anything is wrong or crashes.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from scripts.validation.clinics.variants import VARIANTS, cases
from scripts.validation.harness import gaitcal, option, said
from scripts.validation.recordings import CLINICS

SHARED = ("--jobs", "--only", "--list", "--json")
OWN = {"--keep": option(Path, "where the folders and results stay", dest="room")}
FLOOR_BWH = 0.2
"""% of body weight times height: smaller differences are none."""
SECONDS = 900.0


class Ending(Enum):
    TORQUES = "torques"
    ASKED = "asked"
    REFUSED = "refused"
    WRONG = "wrong"
    NAMED = "named"
    CRASH = "crash"


BAD = (Ending.WRONG, Ending.CRASH)


@dataclass(frozen=True)
class Outcome:
    title: str
    ending: Ending
    seconds: float
    words: str
    result: Path
    ratio: float | None = None
    """Difference to the folder as it was, in error bars."""

    @property
    def line(self) -> str:
        ratio = "" if self.ratio is None else f" {self.ratio:.2f} bars"
        return f"{self.ending.value:8s}{self.title:45s}{self.seconds:6.1f} s{ratio}  {self.words[:240]}"


def run_case(variant_name: str, clinic_name: str, room: Path, clean: Outcome | None) -> Outcome:
    variant = next(v for v in VARIANTS if v.name == variant_name)
    clinic = CLINICS[clinic_name]
    place = room / f"{clinic_name} {variant_name}".replace(" ", "_")
    folder, result = place / "folder", place / "result"
    folder.mkdir(parents=True)
    clinic.copy(folder)
    options = variant.make(folder, clinic)
    begin = time.perf_counter()
    title = f"{clinic_name}: {variant_name}"
    try:
        done = gaitcal("calibrate", folder, "--out", result, *options, seconds=SECONDS)
    except subprocess.TimeoutExpired:
        return Outcome(title, Ending.CRASH, SECONDS, "no end", result)
    seconds = time.perf_counter() - begin
    (place / "said.txt").write_text(done.stdout + "\n" + done.stderr, encoding="utf-8")
    last = (done.stderr.strip() or done.stdout.strip() or "nothing said").splitlines()[-1]
    if "Traceback" in done.stderr or "internal error" in done.stderr or done.returncode not in (0, 1):
        return Outcome(title, Ending.CRASH, seconds, f"exit {done.returncode}: {last}", result)
    if not (result / "summary.json").exists():
        ending = Ending.ASKED if variant.may_refuse else Ending.REFUSED
        return Outcome(title, ending, seconds, last, result)
    summary = json.loads((result / "summary.json").read_text(encoding="utf-8"))
    words = f"{summary.get('verdict')}; {_legs(result)}"
    if (result / "moments").exists() and not any(_valid(t, s).any() for t in moments(result).values() for s in "rl"):
        return Outcome(title, Ending.REFUSED, seconds, f"{words}; {last}", result)
    if clean is None or not variant.same or not (clean.result / "summary.json").exists():
        return Outcome(title, Ending.TORQUES, seconds, words, result)
    ratio = difference(clean.result, result)
    if ratio is None or ratio <= 1.0:
        return Outcome(title, Ending.TORQUES, seconds, words, result, ratio)
    new = messages(result) - messages(clean.result)
    return Outcome(title, Ending.NAMED if new else Ending.WRONG, seconds, f"{words}; {sorted(new)[:2]}", result, ratio)


def messages(result: Path) -> set[str]:
    summary = json.loads((result / "summary.json").read_text(encoding="utf-8"))
    return {reason["cause"] for reason in summary.get("reasons", ())}


def moments(result: Path) -> dict[str, pd.DataFrame]:
    """Tables of torques; keyed by the number of frames and the first time, as names of trials may differ."""
    tables = [pd.read_csv(path, comment="#") for path in sorted((result / "moments").glob("*.csv"))]
    return {f"{len(t)} {t['time'].iloc[0]:.3f}": t for t in tables}


def _valid(table: pd.DataFrame, side: str) -> np.ndarray:
    column = f"valid_{side}" if f"valid_{side}" in table else "valid"
    return np.asarray(table[column], dtype=bool)


def _legs(result: Path) -> str:
    counts = {s: sum(_valid(t, s).sum() for t in moments(result).values()) for s in "rl"}
    return f"valid r {counts['r']} l {counts['l']}" if (result / "moments").exists() else "no forces"


def difference(before: Path, after: Path) -> float | None:
    """Median over leg coordinates of the RMS difference in error bars of `before`; None without common frames."""
    ratios, theirs = [], moments(after)
    for key, mine in moments(before).items():
        if key not in theirs:
            continue
        other = theirs[key]
        for side in "rl":
            both = _valid(mine, side) & _valid(other, side)
            for name in (c for c in mine if c.endswith(f"_{side}") and f"{c}_se" in mine and both.any()):
                value, se = mine[name][both], mine[f"{name}_se"][both]
                scale = (mine[f"{name}_bwh"][both] / value).abs().median()  # % of body weight times height per N·m
                bar = np.maximum(1.96 * se.fillna(0.0), FLOOR_BWH / scale)
                ratios.append(float(np.sqrt(np.mean(((other[name][both] - value) / bar) ** 2))))
    return float(np.median(ratios)) if ratios else None


LEAST_SHARE = 0.9
"""Of all cases, that reach torques or rightly ask."""
AS_IT_IS = "as it is"


def run(chosen: argparse.Namespace) -> list[Outcome]:
    wanted = [(v, c) for v, c in cases() if re.search(chosen.only, f"{c}: {v.name}", re.IGNORECASE)]
    if chosen.list:
        print("\n".join(f"{clinic}: {variant.name}" for variant, clinic in wanted))
        return []
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.room or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        bases = sorted({clinic for _, clinic in wanted})
        first = [partial(run_case, AS_IT_IS, clinic, folder, None) for clinic in bases]
        clean = dict(zip(bases, said(first, chosen.jobs), strict=True))
        rest = [partial(run_case, v.name, c, folder, clean[c]) for v, c in wanted if v.name != AS_IT_IS]
        outcomes = [clean[c] for v, c in wanted if v.name == AS_IT_IS] + said(rest, chosen.jobs)
    counts = Counter(outcome.ending for outcome in outcomes)
    print(", ".join(f"{ending.value} {counts[ending]}" for ending in Ending), f"of {len(outcomes)}")
    return outcomes


def passed(outcomes: list[Outcome]) -> bool:
    reached = sum(o.ending in (Ending.TORQUES, Ending.ASKED, Ending.NAMED) for o in outcomes)
    return reached >= LEAST_SHARE * len(outcomes) and not any(o.ending in BAD for o in outcomes)
