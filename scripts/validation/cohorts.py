"""What `gaitcal cohort` must show, measured on this machine with made-up people.

    cohorts --parts kills [--kills 30] [--people 8]     SIGKILL of parent or worker, anywhere: the
                                                        same tables
    cohorts --parts cluster [--people 6]                two dask workers against this machine: the
                                                        same tables
    cohorts --parts memory [--people 20 60]             people a minute, largest memory of the
                                                        parent
    cohorts --parts page [--people 100 1000]            size of cohort.html, time until it can be
                                                        used; these people are copies of three, with
                                                        noise

Exit code 1 where a limit is not met: the same bytes (kills, cluster), 10 % more memory (memory), a
page of 6 MB that is ready after 3 s, written with 10 % more memory (page).

Each person is a small study: somebody stands for a moment and walks two strides at 100 Hz. Person k
has the joint and inertial parameters of body k modulo `bodies`, drawn within the published bounds,
and marker noise of its own; people.csv says the groups. The same numbers give the same files. 100
people take some 40 MB. In part `page`, what is kept of a person is copied, not calibrated.
"""

from __future__ import annotations

import argparse
import base64
import csv
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from gaitcal.cohort.cohort_page import PAGE
from gaitcal.cohort.cohort_people import CohortPerson
from gaitcal.cohort.one_person import COLUMNS, GAP, CommonSettings
from gaitcal.cohort.outcome import Outcome, Outcomes, get_state_path, read_outcome, write_outcome
from gaitcal.cohort.run_cohort import write_tables
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.settings import CalibrationSettings
from gaitcal.synthetic.subject import (
    EXACT_PLATES,
    make_synthetic_model,
    place_long_plates,
    place_on_floor,
    record_motion,
)
from gaitcal.synthetic.synthetic_motion import (
    compute_residual_free_wrench,
    draw_marker_noise,
    make_standing_pose,
    simulate_static_trial,
    simulate_two_strides,
)
from scripts.validation.harness import judged, option, say
from scripts.validation.recordings import write_folder

STANDING = 60
"""Frames."""
EVERY = 2
"""Frame of the walk, at 200 Hz, that is recorded."""
NOISE_M = 0.004
"""Largest amplitude of the noise of a marker: skin moves by more, and more of it would only take
longer.
"""
GROUPS = ("walkers", "others")
SESSION = 1
"""Of the seed of the noise."""


@cache
def body(number: int) -> tuple[SubjectModel, Recording, Recording]:
    model = make_synthetic_model(np.random.default_rng(number), perturb=True)
    standing = place_on_floor(
        model, simulate_static_trial(STANDING, make_standing_pose(model.parameters))
    )
    motion = simulate_two_strides(model.parameters)
    plates = place_long_plates(motion, compute_residual_free_wrench(model.parameters, motion))
    walk = record_motion("gait", motion, model, published_model().markers.labels, plates)
    return model, record_motion("static", standing, model, model.markers.labels), _thinned(walk)


def _thinned(walk: Recording) -> Recording:
    plates = tuple(
        replace(
            plate,
            **{
                name: getattr(plate, name)[::EVERY] for name in ("time", "force", "point", "moment")
            },
        )
        for plate in walk.plates
    )
    return replace(walk, time=walk.time[::EVERY], markers=walk.markers[::EVERY], plates=plates)


def write_person(folder: Path, number: int, bodies: int) -> None:
    model, standing, walk = body(number % bodies)
    rng = np.random.default_rng([number, SESSION])
    noisy = walk.markers + draw_marker_noise(walk.time, len(walk.labels), rng, NOISE_M)
    who = (f"P{number:04d}", round(model.subject.mass, 3), model.subject.height, model.subject.sex)
    settings = CalibrationSettings(force_filter_hz="none", plate_error=EXACT_PLATES)
    walked = replace(walk, markers=noisy)
    write_folder(folder, {"static": standing, "gait": walked}, who, settings, {"1": "r", "2": "l"})


def write_people(out: Path, numbers: Sequence[int], bodies: int = 20) -> None:
    """Write people of these numbers, and what `people.csv` says of them."""
    out.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        write_person(out / f"P{number:04d}", number, bodies)
    with (out / "people.csv").open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(("person", "group"))
        table.writerows((f"P{number:04d}", GROUPS[number % len(GROUPS)]) for number in numbers)


MOST_MB, MOST_READY_S = 6.0, 3.0
NOISE, CURVE_NOISE = 0.05, 300.0
"""Of numbers, a part of them; of curves, in their packed steps."""
TREATMENT_GROUPS = ("walkers", "before surgery", "after surgery")
FAILED = 40
"""One person in so many has no result."""
REASONS = (
    ("warning", "the fitted knee axis passes far from the epicondyles", "look at the static trial"),
    ("warning", "markers do not fit the segments", "look which markers are meant"),
    ("error", "the forces do not fit the motion", "look at plates and their assignment"),
)
_NUMBERS = [c.name for c in COLUMNS if c.kind is float]


def person_of(number: int) -> CohortPerson:
    name = f"P{number:04d}"
    return CohortPerson(
        folder=Path(name), name=name, group=TREATMENT_GROUPS[number % len(TREATMENT_GROUPS)]
    )


def copied(source: Outcome, number: int) -> Outcome:
    rng, person = np.random.default_rng(number), person_of(number)
    if number % FAILED == FAILED - 1:
        cause = "2 files, but no readable recording (.c3d, .trc or .csv)"
        return Outcome(
            name=person.name,
            session="",
            place=person.subfolder,
            fingerprint="",
            cause=cause,
            action="look",
        )
    row = dict(source.row)
    for name in _NUMBERS:
        value = row.get(name)
        if isinstance(value, float):
            row[name] = round(value * (1 + NOISE * rng.standard_normal()), 6)
    wrong = REASONS[: rng.integers(1, 4)] if number % 3 == 0 else ()
    verdict = "refused" if len(wrong) == len(REASONS) else "doubtful" if wrong else "trustworthy"
    row |= {
        "person": person.name,
        "session": "",
        "folder": person.subfolder,
        "page": f"{person.subfolder}/result.html",
    }
    row |= {"verdict": verdict, "verdict_r": verdict, "verdict_l": verdict}
    row |= {
        "first_cause": wrong[-1][1] if wrong else "",
        "first_action": wrong[-1][2] if wrong else "",
    }
    whole = np.frombuffer(base64.b64decode(source.curves), dtype="<i2").astype(float)
    moved = whole + CURVE_NOISE * rng.standard_normal()
    curves = np.where(whole == GAP, GAP, np.clip(moved, GAP + 1, -GAP - 1)).astype("<i2")
    said = tuple(
        dict(zip(("severity", "cause", "action"), words, strict=True)) for words in wrong[::-1]
    )
    packed = base64.b64encode(curves.tobytes()).decode("ascii")
    return replace(
        source,
        name=person.name,
        session="",
        place=person.subfolder,
        row=row,
        reasons=said,
        curves=packed,
    )


def copy_people(source: Path, people: int, out: Path) -> None:
    """Keep so many people in a cohort's folder, whose strides are those of the people of another
    cohort.
    """
    found = [
        path
        for path in sorted((source / "state").rglob("*.json"))
        if json.loads(path.read_text())["curves"]
    ]
    known = [read_outcome(source, CohortPerson(folder=path, name=path.stem)) for path in found]
    for number in range(people):
        k = number % len(found)
        outcome = copied(known[k], number)
        write_outcome(out, outcome)
        if not outcome.failed:
            os.link(
                found[k].with_suffix(".parquet"), get_state_path(out, outcome.place, ".parquet")
            )


def write_many(out: Path, people: int) -> None:
    """Write tables and page of people who are kept, and print what it took."""
    began = time.monotonic()
    write_tables(
        [person_of(number) for number in range(people)], out, Outcomes(out), CommonSettings()
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"seconds": round(time.monotonic() - began, 2), "mebibytes": round(peak, 1)}))


def ready(page: Path) -> float:
    """Seconds from opening the page in a headless browser until it has been drawn; the slowest of
    three.
    """
    from tests.report.page.browser import browser, chromium

    binary = chromium()
    if binary is None:
        raise SystemExit("no Chromium on this machine (its path may stand in CHROMIUM)")
    times = []
    for _ in range(3):
        with tempfile.TemporaryDirectory() as profile, browser(Path(profile), binary) as tab:
            tab.open(page.as_uri(), 1280, 800)
            while not (told := tab.run("window.gaitcal?.ready ?? null")):
                time.sleep(0.05)
            times.append(float(told) / 1000)
            if tab.console:
                raise SystemExit(f"the page says {tab.console[0]}")
    return max(times)


def look_at(page: Path) -> bool:
    """Say size and time of a page; whether both are within their limits."""
    size, seconds = page.stat().st_size / 1e6, ready(page)
    met = size <= MOST_MB and seconds <= MOST_READY_S
    print(f"{'met' if met else 'NOT MET'}: {page.name}: {size:.1f} MB, limit {MOST_MB:g}; "
          f"ready after {seconds:.2f} s, limit {MOST_READY_S:g}", flush=True)  # fmt: skip
    return met


TABLES = (
    *(
        "people.csv",
        "people.parquet",
        "cycles.parquet",
        "failures.csv",
        "columns.csv",
        "cohort.html",
    ),
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
    """Kill parent or worker at random moments; the tables of the run that ends are those of one
    left alone.
    """
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
        servers.append(
            subprocess.Popen([sys.executable, "-m", *worker, *place], stderr=subprocess.DEVNULL)
        )
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
        print(
            f"{people} people: {people / minutes:.1f} a minute, parent {peak:.0f} MiB at most",
            flush=True,
        )
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
        words = [sys.executable, "-m", "scripts.validation.cohorts", str(out), str(people)]
        told = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
        peaks.append(told["mebibytes"])
        print(
            f"{people} people: tables and page written in {told['seconds']} s, "
            f"{told['mebibytes']:.0f} MiB at most"
        )
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


if __name__ == "__main__":
    write_many(Path(sys.argv[1]), int(sys.argv[2]))
