"""One folder through the first command, and how it ends."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
import pandas as pd

from scripts.validation.clinics.variants import VARIANTS
from scripts.validation.recordings import CLINICS

FLOOR_BWH = 0.2
"""% of body weight times height: smaller differences are none."""
SECONDS = 900.0


class Ending(Enum):
    """How a case ended."""

    TORQUES = "torques"
    ASKED = "asked"
    REFUSED = "refused"
    WRONG = "wrong"
    NAMED = "named"
    CRASH = "crash"


BAD = (Ending.WRONG, Ending.CRASH)


@dataclass(frozen=True)
class Outcome:
    """One case."""

    title: str
    ending: Ending
    seconds: float
    words: str
    result: Path
    ratio: float | None = None
    """Difference to the folder as it was, in error bars."""

    @property
    def line(self) -> str:
        """One line of the table."""
        ratio = "" if self.ratio is None else f" {self.ratio:.2f} bars"
        return f"{self.ending.value:8s}{self.title:45s}{self.seconds:6.1f} s{ratio}  {self.words[:240]}"


def run_case(variant_name: str, clinic_name: str, room: Path, clean: Outcome | None) -> Outcome:
    """Make the folder, run `gaitcal calibrate FOLDER`, and judge."""
    variant = next(v for v in VARIANTS if v.name == variant_name)
    clinic = CLINICS[clinic_name]
    place = room / f"{clinic_name} {variant_name}".replace(" ", "_")
    folder, result = place / "folder", place / "result"
    folder.mkdir(parents=True)
    clinic.copy(folder)
    options = variant.make(folder, clinic)
    begin = time.perf_counter()
    command = [sys.executable, "-m", "gaitcal.cli", "calibrate", str(folder), "--out", str(result), *options]
    title = f"{clinic_name}: {variant_name}"
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, stdin=subprocess.DEVNULL)
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
    if (result / "moments").exists() and not _any_valid(result):
        return Outcome(title, Ending.REFUSED, seconds, f"{words}; {last}", result)
    if clean is None or not variant.same or not (clean.result / "summary.json").exists():
        return Outcome(title, Ending.TORQUES, seconds, words, result)
    ratio = difference(clean.result, result)
    if ratio is None or ratio <= 1.0:
        return Outcome(title, Ending.TORQUES, seconds, words, result, ratio)
    new = messages(result) - messages(clean.result)
    return Outcome(title, Ending.NAMED if new else Ending.WRONG, seconds, f"{words}; {sorted(new)[:2]}", result, ratio)


def messages(result: Path) -> set[str]:
    """Causes that a result gives."""
    summary = json.loads((result / "summary.json").read_text(encoding="utf-8"))
    return {reason["cause"] for reason in summary.get("reasons", ())}


def moments(result: Path) -> dict[str, pd.DataFrame]:
    """Tables of torques; keyed by the number of frames and the first time, as names of trials may differ."""
    tables = [pd.read_csv(path, comment="#") for path in sorted((result / "moments").glob("*.csv"))]
    return {f"{len(t)} {t['time'].iloc[0]:.3f}": t for t in tables}


def _valid(table: pd.DataFrame, side: str) -> np.ndarray:
    column = f"valid_{side}" if f"valid_{side}" in table else "valid"
    return np.asarray(table[column], dtype=bool)


def _any_valid(result: Path) -> bool:
    return any(_valid(t, side).any() for t in moments(result).values() for side in "rl")


def _legs(result: Path) -> str:
    if not (result / "moments").exists():
        return "no forces"
    tables = moments(result).values()
    return f"valid r {sum(_valid(t, 'r').sum() for t in tables)} l {sum(_valid(t, 'l').sum() for t in tables)}"


def difference(before: Path, after: Path) -> float | None:
    """Median over leg coordinates of the RMS difference in error bars of `before`; None without common frames."""
    if not (before / "moments").exists() or not (after / "moments").exists():
        return None
    ratios = []
    theirs = moments(after)
    for key, mine in moments(before).items():
        other = theirs.get(key)
        if other is None:
            continue
        for side in "rl":
            both = _valid(mine, side) & _valid(other, side)
            for name in (c for c in mine if c.endswith(f"_{side}") and f"{c}_se" in mine and both.any()):
                value, se = mine[name][both], mine[f"{name}_se"][both]
                scale = (mine[f"{name}_bwh"][both] / value).abs().median()  # % of body weight times height per N·m
                bar = np.maximum(1.96 * se.fillna(0.0), FLOOR_BWH / scale)
                ratios.append(float(np.sqrt(np.mean(((other[name][both] - value) / bar) ** 2))))
    return float(np.median(ratios)) if ratios else None
