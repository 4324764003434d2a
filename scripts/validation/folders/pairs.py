"""Two commands at once on one folder: each does its work or says in one line why not, and nothing is lost."""

from __future__ import annotations

import random
import shutil
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from scripts.validation.folders.commands import DRAWS, TRIALS, Bench, Process, start
from scripts.validation.folders.truth import References, hidden, trials_of

REFUSALS = ("changed while this ran; nothing was written, run again", "is being written by process", "made with other")
"""Lines that a command may end with (exit code 1) because of the other."""
Words = tuple[object, ...]


def pairs(bench: Bench, result: Path) -> dict[str, tuple[Words, Words]]:
    """The pairs: commands on a result of the first study."""
    two, three = (("dynamics", result, *bench.trial(name), "-q") for name in TRIALS)
    same = ("calibrate", bench.study("first"), "--out", result, "-q")
    other = ("calibrate", bench.study("second"), "--out", result, "--force", "-q")
    export, view = ("export", result, "-q"), ("view", result, "--html", result / "view.html", "-q")
    draws = ("montecarlo", result, *DRAWS, "-q")
    return {
        "dynamics + dynamics": (two, three),
        "dynamics + the same dynamics": (two, two),
        "dynamics + calibrate": (two, same),
        "dynamics + calibrate another model": (two, other),
        "montecarlo + montecarlo": (draws, draws),
        "montecarlo + calibrate another model": (draws, other),
        "montecarlo + dynamics": (draws, two),
        "export + calibrate another model": (export, other),
        "calibrate + calibrate another model": (same, other),
        "view --html + montecarlo": (view, draws),
    }


def faults(bench: Bench, folder: Path, repeats: int, rng: random.Random, seen: list[str]) -> Iterator[str]:
    """Run every pair `repeats` times, such that they end at about one time; everything that went wrong."""
    references = References(bench)
    for name in pairs(bench, folder / "result"):
        for _ in range(repeats):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            result = folder / "result"
            shutil.copytree(bench.result("first"), result)
            for part in ("dynamics", "montecarlo"):
                shutil.rmtree(result / part)
            one, other = pairs(bench, result)[name]
            seconds = [bench.seconds[str(words[0])] for words in (one, other)]
            if seconds[0] < seconds[1]:
                one, other = other, one
            first = start(one, folder / "one.txt")
            time.sleep(max(0.0, abs(seconds[0] - seconds[1]) + rng.uniform(-1.0, 1.0)))  # they end together
            second = start(other, folder / "other.txt")
            endings = (first.wait(), second.wait())
            said = " | ".join(" ".join(p.text().split()) for p in (first, second) if p.code)
            seen.append(f"{name}: exit codes {endings}{', ' if said else ''}{said}")
            for fault in _after(result, (first, second), references):
                yield f"{name} {endings}: {fault}"


def _after(result: Path, processes: Sequence[Process], references: References) -> Iterator[str]:
    for process in processes:
        text = process.text().strip()
        if process.code not in (0, 1):
            yield f"{process.words[0]} ended with {process.code}: {text}"
        elif process.code == 1 and (text.count("gaitcal: ") != 1 or not any(line in text for line in REFUSALS)):
            yield f"{process.words[0]} said {text}"
    if processes[0].code and processes[1].code:
        yield "neither did its work"
    yield from references.faults(result)
    if left := hidden(result):
        yield f"left behind: {sorted(left)}"
    wanted = {Path(p.words[2]).stem for p in processes if p.words[0] == "dynamics" and p.code == 0}
    if lost := wanted - trials_of(result):
        yield f"lost: {sorted(lost)}"
    finished = any(p.words[0] == "montecarlo" and p.code == 0 for p in processes)
    if finished and not (result / "montecarlo" / "montecarlo.csv").exists():
        yield "lost: montecarlo"
