"""Commands killed at any moment: the folder is as before or as after, and the next run leaves what one alone leaves.

Half of the moments are anywhere in the run, half in the time in which it writes (from its first hidden file on). After
SIGTERM nothing of the run is left behind and the exit code is 143; what SIGKILL leaves is removed by the next run.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from scripts.validation.folders.commands import DRAWS, TRIALS, Bench, Process, start
from scripts.validation.folders.truth import References, content, hidden


@dataclass(frozen=True)
class Victim:
    """A command, the folder it finds, and the files of that folder it may change."""

    name: str
    words: tuple[object, ...]
    before: Path


def victims(bench: Bench, result: Path, folder: Path) -> tuple[Victim, ...]:
    """Dynamics adds a trial to one, export takes the place of another model's, montecarlo begins."""
    out = []
    for name, change in (("dynamics", _one_trial), ("export", _older_export), ("montecarlo", _no_draws)):
        before = folder / f"before-{name}"
        shutil.copytree(bench.result("first"), before)
        change(bench, before, folder)
        words = {
            "dynamics": ("dynamics", result, *bench.trial(TRIALS[1]), "-q"),
            "export": ("export", result, "-q"),
            "montecarlo": ("montecarlo", result, *DRAWS, "-q"),
        }
        out.append(Victim(name, words[name], before))
    return tuple(out)


def _one_trial(bench: Bench, before: Path, folder: Path) -> None:
    shutil.rmtree(before / "dynamics")
    start(("dynamics", before, *bench.trial(TRIALS[0]), "-q"), folder / "said.txt").wait()


def _older_export(bench: Bench, before: Path, folder: Path) -> None:
    shutil.rmtree(before / "export")
    shutil.copytree(bench.result("second") / "export", before / "export")


def _no_draws(bench: Bench, before: Path, folder: Path) -> None:
    shutil.rmtree(before / "montecarlo")


def faults(bench: Bench, folder: Path, kills: int, rng: random.Random, seen: list[str]) -> Iterator[str]:
    """Kill each command that often; everything that went wrong."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    result, said = folder / "place" / "result", folder / "said.txt"
    references = References(bench)
    for victim in victims(bench, result, folder):
        _restore(victim, result)
        whole, writing = _times(victim, result, said)
        after, before = content(result), content(victim.before)
        _restore(victim, result)
        counts = {"finished": 0, "before": 0, "after": 0, "between": 0, "left by SIGKILL": 0}
        for k in range(kills):
            number = signal.SIGTERM if k % 2 else signal.SIGKILL
            litter, half_written = hidden(result), _written(result)
            process = start(victim.words, said)
            _wait(process, result, half_written, rng, (k // 2) % 2 == 0, whole, writing)
            process.send(number)
            code = process.wait()
            counts["finished"] += code == 0
            left = hidden(result) - litter
            counts["left by SIGKILL"] += bool(left)
            for fault in (*_ending_faults(process, code, number, left), *references.faults(result)):
                yield f"{victim.name} killed by {signal.Signals(number).name}, run {k}: {fault}"
            state = content(result)
            counts["before" if state == before else "after" if state == after else "between"] += 1
            if state not in (before, after) and victim.name == "dynamics":
                yield f"dynamics killed, run {k}: neither as before nor as after"
            if state == after or code == 0:
                _restore(victim, result, keep_hidden=True)
        seen.append(f"{victim.name}: {kills} kills, {counts}")
        if start(victim.words, said).wait() != 0:
            yield f"{victim.name} after all kills: {said.read_text(encoding='utf-8')}"
        if content(result) != after or hidden(result):
            yield f"{victim.name} after all kills: not as one run alone, or left behind {sorted(hidden(result))}"


def _restore(victim: Victim, result: Path, keep_hidden: bool = False) -> None:
    """The folder as the command found it; what kills left beside it stays."""
    if not keep_hidden:
        shutil.rmtree(result.parent, ignore_errors=True)
    shutil.rmtree(result, ignore_errors=True)
    shutil.copytree(victim.before, result)


def _times(victim: Victim, result: Path, said: Path) -> tuple[float, float]:
    """Seconds of a run alone, and from its first hidden name to its end."""
    began = time.monotonic()
    process, first = start(victim.words, said), 0.0
    while not process.ended():
        if not first and _written(result):
            first = time.monotonic()
        time.sleep(0.001)
    if process.code != 0:
        raise RuntimeError(process.text())
    end = time.monotonic()
    return end - began, end - (first or began)


def _written(result: Path) -> set[Path]:
    """Hidden folders with something in them: a command is writing, or was when it was killed."""
    out = set()
    for folder, folders, files in os.walk(result.parent):  # pays no heed to what vanishes meanwhile
        if Path(folder).name.startswith(".gaitcal-tmp-") and (folders or files):
            out.add(Path(folder))
    return out


def _wait(
    process: Process, result: Path, before: set[Path], rng: random.Random, anywhere: bool, whole: float, writing: float
) -> None:
    if anywhere:
        time.sleep(rng.uniform(0.0, 0.9 * whole))
        return
    while not process.ended() and not _written(result) - before:
        time.sleep(0.0005)
    time.sleep(rng.choice((rng.uniform(0.0, 0.02), rng.uniform(0.0, writing))))


def _ending_faults(process: Process, code: int, number: int, left: set[str]) -> Iterator[str]:
    text = process.text()
    if "Traceback" in text or "internal error" in text:
        yield f"said {text}"
    if number == signal.SIGTERM:
        if left:
            yield f"left behind {sorted(left)}"
        if code not in (0, 143, -signal.SIGTERM):
            yield f"exit code {code}: {text}"
        if code == 143 and "SIGTERM" not in text:
            yield f"said {text!r}"
    elif code not in (0, -signal.SIGKILL):
        yield f"exit code {code}: {text}"
    if Path("/proc").is_dir() and _children(process.number):
        yield "its workers live on"


def _children(parent: int) -> bool:
    """Whether processes live whose parent this was, two seconds after its end."""
    for _ in range(20):
        if not any(_parent_of(p) == parent for p in Path("/proc").glob("[0-9]*/stat")):
            return False
        time.sleep(0.1)
    return True


def _parent_of(stat: Path) -> int | None:
    try:
        return int(stat.read_text().rpartition(")")[2].split()[1])
    except (OSError, ValueError, IndexError):
        return None
