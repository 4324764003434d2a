"""What `gaitcal cohort` must show, measured on this machine with made-up people (`many_people.py`).

    cohorts --parts kills [--kills 30] [--people 8]     SIGKILL of parent or worker, anywhere: the same tables
    cohorts --parts cluster [--people 6]                two dask workers against this machine: the same tables
    cohorts --parts memory [--people 20 60]             people a minute, largest memory of the parent
    cohorts --parts page [--people 100 1000]            size of cohort.html, time until it can be used; these people are
                                                        copies of three, with noise

Exit code 1 where a limit is not met: the same bytes (kills, cluster), 10 % more memory (memory), a page of 6 MB that is
ready after 3 s, written with 10 % more memory (page).
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from gaitcal.cohort.page import PAGE
from scripts.validation.harness import judged, option, say
from scripts.validation.many_people import copy_people, look_at, write_people

TABLES = (
    *("people.csv", "people.parquet", "cycles.parquet", "failures.csv", "columns.csv", "cohort.html"),
    "manifest.json",
)
"""What must be the same; times.csv tells what is not."""
MOST_GROWTH = 1.10
COPIED = 3
"""People who are calibrated for a page of many copies."""
LEAST_S = 0.3
"""A command is killed this long after its start at the earliest."""
SHARED = ("--seed",)
OWN = {
    "--people": option(int, "in each cohort of a part", nargs="+"),
    "--kills": option(30, "of parent or worker"),
    "--folder": option(Path, "where to work; a new one, removed afterwards, unless given"),
}


def start(source: Path, out: Path, *words: object) -> subprocess.Popen[bytes]:
    code = "from gaitcal.cli import main; main()"
    told = map(str, ("cohort", source, "--out", out, "-q", *words))
    return subprocess.Popen([sys.executable, "-c", code, *told])


def whole(source: Path, out: Path, *words: object) -> float:
    """Run a cohort to its end; seconds."""
    began = time.monotonic()
    if start(source, out, *words).wait() not in (0, 1):
        raise SystemExit("the cohort did not end")
    return time.monotonic() - began


def people_with_a_fault(source: Path, people: int) -> None:
    """Write people, the last of whom has a static trial that cannot be read."""
    write_people(source, range(people), bodies=4)
    (source / f"P{people - 1:04d}" / "static.c3d").write_bytes(b"no recording")


def same(what: str, one: Path, other: Path) -> bool:
    """Whether the tables of two cohorts are the same, told table by table."""
    differ = [name for name in TABLES if (one / name).read_bytes() != (other / name).read_bytes()]
    said = f"NOT MET: {what}: {', '.join(differ)} differ" if differ else ""
    say(said or f"met: {what}: all tables are the same, bit for bit")
    return not differ


def _told(process: int | str, name: str) -> str:
    """What the system says of a process; empty where it has ended."""
    try:
        return Path(f"/proc/{process}/{name}").read_text()
    except OSError:
        return ""


def workers_of(parent: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        parents = _told(stat.parent.name, "stat").rpartition(")")[2].split()[1:2]
        if parents == [str(parent)] and "spawn_main" in _told(stat.parent.name, "cmdline"):
            found.append(int(stat.parent.name))
    return found


def forget_some(out: Path, chance: random.Random) -> None:
    """Take away what is kept of some people, as if they had not been run."""
    kept = sorted((out / "state").rglob("*.json")) if (out / "state").is_dir() else []
    for path in chance.sample(kept, k=(len(kept) + 1) // 2):
        path.unlink()


def kills(folder: Path, people: Sequence[int], chosen: argparse.Namespace) -> bool:
    """Kill parent or worker at random moments; the tables of the run that ends are those of one left alone."""
    chance, source = random.Random(chosen.seed), folder / "people"
    people_with_a_fault(source, people[0])
    took = whole(source, folder / "alone", "--jobs", 2)
    victim, of_parent, of_worker = folder / "killed", 0, 0
    while of_parent + of_worker < chosen.kills:
        running = start(source, victim, "--jobs", 2)
        time.sleep(LEAST_S + chance.random() * took / 2)
        below = workers_of(running.pid)
        if running.poll() is not None:
            forget_some(victim, chance)
        elif below and chance.random() < 0.5:
            os.kill(chance.choice(below), signal.SIGKILL)
            of_worker += 1
            if chance.random() < 0.5:
                running.wait()
                forget_some(victim, chance)
        if running.returncode is None:
            running.kill()
            of_parent += 1
        running.wait()
    whole(source, victim, "--jobs", 2)
    print(f"{of_parent} times the parent, {of_worker} times a worker was killed")
    return same("killed", folder / "alone", victim)


def cluster(folder: Path, people: Sequence[int], _: argparse.Namespace) -> bool:
    """The tables of two dask workers are those of this machine alone."""
    source, address = folder / "people", "tcp://127.0.0.1:38786"
    people_with_a_fault(source, people[0])
    words = ["dask", "scheduler", "--host", "127.0.0.1", "--port", "38786", "--no-dashboard"]
    servers = [subprocess.Popen([sys.executable, "-m", *words], stderr=subprocess.DEVNULL)]
    for _ in range(2):
        worker = ["dask", "worker", address, "--nthreads", "1", "--nworkers", "1", "--no-dashboard"]
        place = ["--local-directory", str(folder)]
        servers.append(subprocess.Popen([sys.executable, "-m", *worker, *place], stderr=subprocess.DEVNULL))
    try:
        whole(source, folder / "cluster", "--cluster", address)
        whole(source, folder / "alone", "--jobs", 1)
    finally:
        for server in reversed(servers):
            server.terminate()
            server.wait()
    return same("two dask workers", folder / "alone", folder / "cluster")


def memory(folder: Path, sizes: Sequence[int], _: argparse.Namespace) -> bool:
    peaks = []
    for people in sizes:
        source, out = folder / f"people{people}", folder / f"out{people}"
        write_people(source, range(people))
        began, running, peak = time.monotonic(), start(source, out), 0.0
        while running.poll() is None:
            peak = max(peak, _peak(running.pid))
            time.sleep(0.2)
        minutes = (time.monotonic() - began) / 60
        print(f"{people} people: {people / minutes:.1f} a minute, parent {peak:.0f} MiB at most", flush=True)
        peaks.append(peak)
    return _growth("memory of the parent", peaks)


def _peak(process: int) -> float:
    lines = _told(process, "status").splitlines()
    return next((float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), 0.0)


def page(folder: Path, sizes: Sequence[int], _: argparse.Namespace) -> bool:
    """The page of many people is small, soon ready, and written in little memory."""
    source, few = folder / "people", folder / "few"
    if not (few / "manifest.json").is_file():
        write_people(source, range(COPIED), bodies=COPIED)
        whole(source, few, "--jobs", 1)
    peaks, met = [], True
    for people in sizes:
        out = folder / f"copies{people}"
        copy_people(few, people, out)
        words = [sys.executable, "-m", "scripts.validation.many_people", str(out), str(people)]
        told = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
        peaks.append(told["mebibytes"])
        print(f"{people} people: tables and page written in {told['seconds']} s, {told['mebibytes']:.0f} MiB at most")
        met &= look_at(out / PAGE)
    return _growth("memory", peaks) and met


def _growth(what: str, peaks: Sequence[float]) -> bool:
    growth = peaks[-1] / peaks[0]
    return judged(what, f"grows {growth:.3f} times", f"{MOST_GROWTH}", growth <= MOST_GROWTH)


Measure = Callable[[Path, Sequence[int], argparse.Namespace], bool]


def _in_folder(measure: Measure, people: Sequence[int], chosen: argparse.Namespace) -> bool:
    with tempfile.TemporaryDirectory(prefix="cohort-", ignore_cleanup_errors=True) as temporary:
        return measure(chosen.folder or Path(temporary), chosen.people or people, chosen)


PARTS = {
    "kills": partial(_in_folder, kills, [8]),
    "cluster": partial(_in_folder, cluster, [6]),
    "memory": partial(_in_folder, memory, [20, 60]),
    "page": partial(_in_folder, page, [100, 1000]),
}
"""With so many people unless told otherwise."""


def passed(found: dict[str, bool]) -> bool:
    return all(found.values())
