"""Does the first command reach torques on any laboratory's folder? Bare folders, and what other
laboratories do.

    clinics [--parts folders,labels] [--jobs 2] [--only REGEX] [--list] [--keep DIR]

Each case is a folder of recordings without a study file: as the laboratory left it, or changed as
another one would have written it (`clinics/variants.py`). `gaitcal calibrate FOLDER` runs on it in
a process of its own. It ends as one of

torques     exit code 0 or a verdict that says no, and a leg with valid torques wherever forces were
            recorded; the same as of the folder as it was, within their error bars (RMS over frames
            of |difference| / max(1.96 standard errors, floor), median over the legs' coordinates,
            at most 1)
asked       a clear line, no torques, where more cannot be said
refused     a clear line, no torques, though there is enough to say more
wrong       other torques than of the folder as it was, and nothing said that is not said there
named       other torques, and a message that the folder as it was does not have
crash       a traceback, or an exit code that no fault of the input explains

Exit code 1 where fewer than nine in ten reach torques (or rightly ask), or anything is wrong or
crashes.

Part `labels`: are torques the same with labels that say nothing as with the laboratory's own? Every
folder of recordings twice: as it is, and with its markers renamed M001, M002, ... in no order. Of
the latter `gaitcal init` proposes what each marker is; the proposal is answered as a person would
who sees the markers: which are the landmarks of pelvis, knees, ankles and feet. All else stays as
proposed. Both are calibrated, told the same mass, height and sex. A line for each: how many markers
(those that a moving trial shows, or that are landmarks) were put on the right segment, which it
asked, what was wrong; and the difference of the torques (of joint parameters, where no forces were
recorded) in error bars. Exit code 1 where a difference is more than one, fewer than 95 % are right,
or a marker is put on the other leg.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.errors import GaitcalError
from gaitcal.intake.draft_file import STUDY, format_draft
from gaitcal.intake.drafting import draft_folder
from gaitcal.intake.recordings_folder import read_folder
from gaitcal.intake.subject_metadata import Options
from gaitcal.io.formats import read_recording
from gaitcal.model.linkage import SIDES
from gaitcal.model.marker_set import SEGMENT_OF, MarkerSet, load_marker_set
from scripts.validation.clinics.variants import VARIANTS, Trial, cases
from scripts.validation.harness import gaitcal, matching, option, said
from scripts.validation.recordings import CLINICS, EVERYBODY, HERE, data

LEAST_RIGHT = 0.95
NAMED = tuple(
    f"{name}_{side}"
    for name in ("asis", "knee_lat", "knee_med", "ankle_lat", "ankle_med")
    for side in SIDES
)
NAMED += tuple(f"{name}_{side}" for name in ("heel", "toe") for side in SIDES)
"""Landmarks of one marker that a person is asked for; and what is on the sacrum."""


@dataclass(frozen=True, kw_only=True)
class Proposed:
    name: str
    markers: int
    """That the person's own set knows."""
    wrong: Mapping[str, str]
    """Label as it was -> the segment it is on, and the one it was put on."""
    answers: Mapping[str, str]
    """Label as it was -> landmark that was proposed, and the right one."""
    asked: tuple[str, ...]
    """What it was proposed as only in a question."""

    @property
    def line(self) -> str:
        right = 100 * (1 - len(self.wrong) / self.markers)
        told = "; ".join(f"{m}: {w}" for m, w in (*self.wrong.items(), *self.answers.items()))
        asked = f"asked {', '.join(self.asked) or 'nothing'}"
        return (
            f"{self.name:12s}{right:6.1f} % of {self.markers:3d} markers; {asked}; "
            f"{told or 'all right'}"
        )


def recordings_in(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.iterdir()) if path.suffix in (".c3d", ".trc")]


def relabel(folder: Path, change: Callable[[str], str]) -> None:
    """Other names for all markers and points of the recordings in a folder."""
    for path in recordings_in(folder):
        if path.suffix == ".c3d":
            trial = Trial(path)
            trial.relabel(change)
            trial.write()
        else:
            lines = path.read_text(encoding="latin-1").split("\n")
            head, *cells = lines[3].split("\t")
            lines[3] = "\t".join(
                [head, *(c if c.strip() in ("", "Time") else change(c.strip()) for c in cells)]
            )
            path.write_text("\n".join(lines), encoding="latin-1")


def names_of(folder: Path, seed: int = 0) -> dict[str, str]:
    """Label of any recording in a folder -> M001, M002, ... in no order."""
    labels = sorted({m for path in recordings_in(folder) for m in read_recording(path).labels})
    order = np.random.default_rng(seed).permutation(len(labels))
    return {m: f"M{k + 1:03d}" for m, k in zip(labels, order, strict=True)}


def own_set(name: str) -> MarkerSet:
    return load_marker_set(
        EVERYBODY[name].markers.replace("{data}", str(data())).replace("{here}", str(HERE))
    )


def truth(name: str, labels: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """New label -> segment, and new label -> landmark, as the person's own set has them."""
    own = own_set(name)
    spelt = dict(zip(own._spell_labels(labels), labels.values(), strict=True))
    of = {m: SEGMENT_OF[n] for n in own.landmarks for group in own.options(n) for m in group}
    of |= {m: of[knee] for knee, parts in own.knee_device.items() for m in parts} | own.segment_of
    landmarks = {
        group[0]: n
        for n in NAMED
        if n in own.landmarks
        for group in own.options(n)[:1]
        if len(group) == 1
    }
    for group in own.options("sacrum"):
        landmarks |= {m: "sacrum" if len(group) == 1 else f"psis_{m[0].lower()}" for m in group}
    return (
        {new: of[old] for old, new in spelt.items() if old in of},
        {new: landmarks[old] for old, new in spelt.items() if old in landmarks},
    )


def propose(name: str, folder: Path) -> Proposed:
    """Take the labels of a person's recordings in a folder away, have a study drafted, and answer
    what it asks: which marker each landmark of pelvis, knees, ankles and feet is. Points that the
    person's own set does not know are left out of C3D files, as programs computed most of them.
    """
    person, own = EVERYBODY[name], own_set(name)
    person.copy(folder)
    labels = names_of(folder)
    labels = {
        m: new
        for (m, new), s in zip(labels.items(), own._spell_labels(labels), strict=True)
        if s in own.labels
    }
    for path in folder.glob("*.c3d"):
        trial = Trial(path)
        trial.keep(labels.__contains__)
        trial.write()
    relabel(folder, lambda label: labels.get(label, label))
    segments, landmarks = truth(name, labels)
    moving = {
        m
        for path in recordings_in(folder)
        if "static" not in path.stem
        for m in read_recording(path).labels
    }
    segments = {m: s for m, s in segments.items() if m in moving or m in landmarks}
    draft = draft_folder(
        read_folder(folder), Options(mass=person.mass, height=person.height, sex=person.sex)
    )
    if draft.choice is None or draft.choice.proposal is None:
        raise GaitcalError(f"{name}: {draft.fault or 'a marker set knows the labels'}")
    old, found = {new: m for m, new in labels.items()}, draft.choice.proposal
    of = {m: segment_named(n) for m, n in found.rename.items()}
    of |= {m: segment for segment, group in found.tracking.items() for m in group}
    right = {
        m: n
        for m, n in found.rename.items()
        if m not in found.asked and n not in landmarks.values()
    } | landmarks
    groups = {s: [m for m in group if m not in right] for s, group in found.tracking.items()}
    for m in found.rename.keys() - right.keys() - found.asked:
        groups.setdefault(of[m], []).append(m)
    kept = {*right.values(), *(m for group in groups.values() for m in group)}
    answered = replace(
        found,
        rename=right,
        tracking={s: tuple(group) for s, group in groups.items() if group},
        weights={m: w for m, w in found.weights.items() if m in kept},
        evidence={**dict.fromkeys(landmarks, "a person's word"), **found.evidence},
        asked=frozenset(),
    )
    text = format_draft(replace(draft, choice=replace(draft.choice, proposal=answered)), folder)
    (folder / STUDY).write_text(
        text.replace("confirmed = false", "confirmed = true"), encoding="utf-8"
    )
    other = {m: n for m, n in landmarks.items() if found.rename.get(m) != n}
    return Proposed(
        name=name,
        markers=len(segments),
        wrong={
            old[m]: f"{s} -> {of.get(m, 'nowhere')}" for m, s in segments.items() if of.get(m) != s
        },
        answers={old[m]: f"{found.rename.get(m, 'none')} -> {n}" for m, n in other.items()},
        asked=tuple(f"{old.get(m, m)} = {found.rename[m]}" for m in found.asked),
    )


def segment_named(name: str) -> str:
    """Of a marker that the set "landmarks" names."""
    own = load_marker_set("landmarks")
    of = own.segment_of | {
        m: own.segment_of[knee] for knee, parts in own.knee_device.items() for m in parts
    }
    return of[name]


def run_person(name: str, room: Path) -> Outcome:
    place, begin = room / name, time.perf_counter()
    for part in ("named", "nameless"):
        (place / part).mkdir(parents=True)
    EVERYBODY[name].copy(place / "named")
    words = (*EVERYBODY[name].options, *EVERYBODY[name].facts)
    before = calibrated(place / "named", place / "before", *words)
    proposed = propose(name, place / "nameless")
    after = calibrated(place / "nameless" / STUDY, place / "after")
    ratio = None
    if not (before or after):
        ratio = (
            difference(place / "before", place / "after")
            if (place / "before" / "moments").exists()
            else None
        )
        ratio = parameter_difference(place / "before", place / "after") if ratio is None else ratio
    share = 1 - len(proposed.wrong) / proposed.markers
    exchanged = [
        w for w in proposed.wrong.values() if w.split(" -> ")[0][:-1] == w.split(" -> ")[1][:-1]
    ]
    same = ratio is not None and ratio <= 1.0 and share >= LEAST_RIGHT and not exchanged
    ending = Ending.TORQUES if same else Ending.REFUSED if ratio is None else Ending.WRONG
    said = "; ".join(filter(None, (proposed.line, before, after)))
    return Outcome(name, ending, time.perf_counter() - begin, said, place / "after", ratio)


def calibrated(source: Path, result: Path, *options: str) -> str:
    """Run the command; what it says where no result comes of it."""
    done = gaitcal("calibrate", source, "--out", result, *options)
    return (
        ""
        if (result / "summary.json").exists()
        else (done.stderr.strip() or done.stdout.strip()).splitlines()[-1]
    )


def parameter_difference(before: Path, after: Path) -> float:
    """Median over the joint parameters that both fit of their difference in error bars."""
    one, other = (
        pd.read_csv(result / "parameters.csv", comment="#").set_index("name")
        for result in (before, after)
    )
    both = one.join(other, rsuffix="_other", how="inner").query(
        "status == 'fitted' and status_other == 'fitted'"
    )
    return float(
        ((both["fitted"] - both["fitted_other"]).abs() / (1.96 * both["standard_error"])).median()
    )


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
        return (
            f"{self.ending.value:8s}{self.title:45s}{self.seconds:6.1f} s{ratio}  "
            f"{self.words[:240]}"
        )


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
    if (
        "Traceback" in done.stderr
        or "internal error" in done.stderr
        or done.returncode not in (0, 1)
    ):
        return Outcome(title, Ending.CRASH, seconds, f"exit {done.returncode}: {last}", result)
    if not (result / "summary.json").exists():
        ending = Ending.ASKED if variant.may_refuse else Ending.REFUSED
        return Outcome(title, ending, seconds, last, result)
    summary = json.loads((result / "summary.json").read_text(encoding="utf-8"))
    words = f"{summary.get('verdict')}; {_legs(result)}"
    if (result / "moments").exists() and not any(
        _valid(t, s).any() for t in moments(result).values() for s in "rl"
    ):
        return Outcome(title, Ending.REFUSED, seconds, f"{words}; {last}", result)
    if clean is None or not variant.same or not (clean.result / "summary.json").exists():
        return Outcome(title, Ending.TORQUES, seconds, words, result)
    ratio = difference(clean.result, result)
    if ratio is None or ratio <= 1.0:
        return Outcome(title, Ending.TORQUES, seconds, words, result, ratio)
    new = messages(result) - messages(clean.result)
    return Outcome(
        title,
        Ending.NAMED if new else Ending.WRONG,
        seconds,
        f"{words}; {sorted(new)[:2]}",
        result,
        ratio,
    )


def messages(result: Path) -> set[str]:
    summary = json.loads((result / "summary.json").read_text(encoding="utf-8"))
    return {reason["cause"] for reason in summary.get("reasons", ())}


def moments(result: Path) -> dict[str, pd.DataFrame]:
    """Tables of torques; keyed by the number of frames and the first time, as names of trials may
    differ.
    """
    tables = [pd.read_csv(path, comment="#") for path in sorted((result / "moments").glob("*.csv"))]
    return {f"{len(t)} {t['time'].iloc[0]:.3f}": t for t in tables}


def _valid(table: pd.DataFrame, side: str) -> np.ndarray:
    column = f"valid_{side}" if f"valid_{side}" in table else "valid"
    return np.asarray(table[column], dtype=bool)


def _legs(result: Path) -> str:
    counts = {s: sum(_valid(t, s).sum() for t in moments(result).values()) for s in "rl"}
    return (
        f"valid r {counts['r']} l {counts['l']}" if (result / "moments").exists() else "no forces"
    )


def difference(before: Path, after: Path) -> float | None:
    """Median over leg coordinates of the RMS difference in error bars of `before`; None without
    common frames.
    """
    ratios, theirs = [], moments(after)
    for key, mine in moments(before).items():
        if key not in theirs:
            continue
        other = theirs[key]
        for side in "rl":
            both = _valid(mine, side) & _valid(other, side)
            for name in (
                c for c in mine if c.endswith(f"_{side}") and f"{c}_se" in mine and both.any()
            ):
                value, se = mine[name][both], mine[f"{name}_se"][both]
                scale = (
                    (mine[f"{name}_bwh"][both] / value).abs().median()
                )  # % of body weight times height per N·m
                bar = np.maximum(1.96 * se.fillna(0.0), FLOOR_BWH / scale)
                ratios.append(float(np.sqrt(np.mean(((other[name][both] - value) / bar) ** 2))))
    return float(np.median(ratios)) if ratios else None


LEAST_SHARE = 0.9
"""Of all cases, that reach torques or rightly ask."""
AS_IT_IS = "as it is"


def folders(chosen: argparse.Namespace) -> list[Outcome]:
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
        rest = [
            partial(run_case, v.name, c, folder, clean[c]) for v, c in wanted if v.name != AS_IT_IS
        ]
        outcomes = [clean[c] for v, c in wanted if v.name == AS_IT_IS] + said(rest, chosen.jobs)
    counts = Counter(outcome.ending for outcome in outcomes)
    print(", ".join(f"{ending.value} {counts[ending]}" for ending in Ending), f"of {len(outcomes)}")
    return outcomes


def labels(chosen: argparse.Namespace) -> list[Outcome]:
    """Everybody with labels and without."""
    names = matching(chosen.only, (name for name in EVERYBODY if name != "multi2"))
    if chosen.list:
        print("\n".join(names))
        return []
    with tempfile.TemporaryDirectory() as temporary:
        return said(
            [partial(run_person, name, chosen.room or Path(temporary)) for name in names],
            chosen.jobs,
        )


PARTS = {"folders": folders, "labels": labels}
USUAL_PARTS = ("folders",)


def passed(found: Mapping[str, list[Outcome]]) -> bool:
    cases = found.get("folders", [])
    reached = sum(o.ending in (Ending.TORQUES, Ending.ASKED, Ending.NAMED) for o in cases)
    same = all(outcome.ending is Ending.TORQUES for outcome in found.get("labels", []))
    return same and reached >= LEAST_SHARE * len(cases) and not any(o.ending in BAD for o in cases)
