"""A cohort of made-up people, each a small study: somebody stands for a moment and walks two strides at 100 Hz.

Person k has the joint and inertial parameters of body k modulo `bodies`, drawn within the published bounds, and
marker noise of its own; people.csv says the groups. The same numbers give the same files. 100 people take some 40 MB.

`cohort.html` of many people, copies of few with noise: how large it is, how soon ready, what writing it takes.

What is kept of a person is copied, not calibrated: see `python -m scripts.validation cohorts page`.
"""

from __future__ import annotations

import base64
import csv
import json
import os
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from gaitcal.cohort.one_person import COLUMNS, GAP, CommonSettings
from gaitcal.cohort.outcome import Outcome, Outcomes, keep, kept, state_file
from gaitcal.cohort.people import CohortPerson
from gaitcal.cohort.run import write_tables
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.settings import CalibrationSettings
from gaitcal.synthetic.motion import marker_noise, residual_free_wrench, standing_pose, static_motion, two_strides
from gaitcal.synthetic.subject import EXACT_PLATES, on_the_floor, plates_under, recording_of, synthetic_model
from scripts.validation.study_folder import write_folder

STANDING = 60
"""Frames."""
EVERY = 2
"""Frame of the walk, at 200 Hz, that is recorded."""
NOISE_M = 0.004
"""Largest amplitude of the noise of a marker: skin moves by more, and more of it would only take longer."""
GROUPS = ("walkers", "others")
SESSION = 1
"""Of the seed of the noise."""


@cache
def body(number: int) -> tuple[SubjectModel, Recording, Recording]:
    model = synthetic_model(np.random.default_rng(number), perturb=True)
    standing = on_the_floor(model, static_motion(STANDING, standing_pose(model.parameters)))
    motion = two_strides(model.parameters)
    plates = plates_under(motion, residual_free_wrench(model.parameters, motion))
    walk = recording_of("gait", motion, model, published_model().markers.labels, plates)
    return model, recording_of("static", standing, model, model.markers.labels), _thinned(walk)


def _thinned(walk: Recording) -> Recording:
    plates = tuple(
        replace(plate, **{name: getattr(plate, name)[::EVERY] for name in ("time", "force", "point", "moment")})
        for plate in walk.plates
    )
    return replace(walk, time=walk.time[::EVERY], markers=walk.markers[::EVERY], plates=plates)


def write_person(folder: Path, number: int, bodies: int) -> None:
    model, standing, walk = body(number % bodies)
    rng = np.random.default_rng([number, SESSION])
    noisy = walk.markers + marker_noise(walk.time, len(walk.labels), rng, NOISE_M)
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
    return CohortPerson(folder=Path(name), name=name, group=TREATMENT_GROUPS[number % len(TREATMENT_GROUPS)])


def copied(source: Outcome, number: int) -> Outcome:
    rng, person = np.random.default_rng(number), person_of(number)
    if number % FAILED == FAILED - 1:
        cause = "holds 2 files, but no recording that can be read (.c3d, .trc or .csv)"
        return Outcome(name=person.name, session="", place=person.place, fingerprint="", cause=cause, action="look")
    row = dict(source.row)
    for name in _NUMBERS:
        value = row.get(name)
        if isinstance(value, float):
            row[name] = round(value * (1 + NOISE * rng.standard_normal()), 6)
    wrong = REASONS[: rng.integers(1, 4)] if number % 3 == 0 else ()
    verdict = "refused" if len(wrong) == len(REASONS) else "doubtful" if wrong else "trustworthy"
    row |= {"person": person.name, "session": "", "folder": person.place, "page": f"{person.place}/result.html"}
    row |= {"verdict": verdict, "verdict_r": verdict, "verdict_l": verdict}
    row |= {"first_cause": wrong[-1][1] if wrong else "", "first_action": wrong[-1][2] if wrong else ""}
    whole = np.frombuffer(base64.b64decode(source.curves), dtype="<i2").astype(float)
    moved = whole + CURVE_NOISE * rng.standard_normal()
    curves = np.where(whole == GAP, GAP, np.clip(moved, GAP + 1, -GAP - 1)).astype("<i2")
    said = tuple(dict(zip(("severity", "cause", "action"), words, strict=True)) for words in wrong[::-1])
    packed = base64.b64encode(curves.tobytes()).decode("ascii")
    return replace(source, name=person.name, session="", place=person.place, row=row, reasons=said, curves=packed)


def copy_people(source: Path, people: int, out: Path) -> None:
    """Keep so many people in a cohort's folder, whose strides are those of the people of another cohort."""
    found = [path for path in sorted((source / "state").rglob("*.json")) if json.loads(path.read_text())["curves"]]
    known = [kept(source, CohortPerson(folder=path, name=path.stem)) for path in found]
    for number in range(people):
        k = number % len(found)
        outcome = copied(known[k], number)
        keep(out, outcome)
        if not outcome.failed:
            os.link(found[k].with_suffix(".parquet"), state_file(out, outcome.place, ".parquet"))


def write_many(out: Path, people: int) -> None:
    """Write tables and page of people who are kept, and print what it took."""
    began = time.monotonic()
    write_tables([person_of(number) for number in range(people)], out, Outcomes(out), CommonSettings())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"seconds": round(time.monotonic() - began, 2), "mebibytes": round(peak, 1)}))


def ready(page: Path) -> float:
    """Seconds from opening the page in a headless browser until it has been drawn; the slowest of three."""
    from tests.page.browser import browser, chromium

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


if __name__ == "__main__":
    write_many(Path(sys.argv[1]), int(sys.argv[2]))
