"""Thousands of damaged files through every reader: each must end in a result or in one clear error.

    readers [--files 10000] [--seed N] [--jobs 2]

Sound files are made (C3D, TRC, MOT, CSV of markers and of forces, study, marker-set and model TOML;
with GAITCAL_DATA also real C3D, TRC and MOT files), damaged at random, and read. Counted are
results, clear errors (`GaitcalError` with one line that names the file), and, as failures: other
exceptions, recordings that are not sound, hangs over 10 s. A reader that takes its process along
ends the run. Exit code 1 if there is any failure.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path

import numpy as np

from gaitcal.errors import GaitcalError, InputError
from gaitcal.export.other_formats import write_external_loads
from gaitcal.io.c3d.writer import (
    AddedPoint,
    PointKind,
    open_c3d_original,
    supplement_c3d,
    write_c3d,
)
from gaitcal.io.csv_recordings import (
    add_corners,
    write_forces_csv,
    write_markers_csv,
    write_plates_csv,
)
from gaitcal.io.force_plate import build_plate_from_moment
from gaitcal.io.force_tables import Forces
from gaitcal.io.formats import read_forces, read_recording
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.io.opensim_files import write_forces_mot, write_trc
from gaitcal.io.recording import Recording
from gaitcal.io.toml import find_models_folder
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.model_file import load_model, save_model
from gaitcal.model.nominal import published_model
from gaitcal.quality.study_checks import check_file
from gaitcal.study.study_file import load_study_file
from gaitcal.synthetic.synthetic_motion import (
    compute_residual_free_wrench,
    compute_synthetic_markers,
    simulate_gait,
    simulate_static_trial,
)
from scripts.validation.harness import option, side_by_side

SHARED = ("--jobs", "--seed")
OWN = {"--files": option(10_000, "of all kinds together")}
STUDY = """[subject]
name = "x"
mass_kg = 69.4
height_m = 1.7
sex = "male"
[markers]
set = "published"
[[trial]]
name = "static"
role = "static"
file = "{static}"
[[trial]]
name = "walk"
role = "gait"
file = "{walk}"
"""
MORE = """forces = "forces.mot"
plates = { 1 = "r" }
time = [0.0, 1.0]
[calibration]
mode = "simultaneous"
nodes = 8
robust = "huber"
force_filter_hz = 12.5
"""
SECONDS = 10.0
FRAMES = 12
TOKENS = [
    *(
        b"\t",
        b",",
        b"\n",
        b"nan",
        b"-1e400",
        b"1e308",
        b"\xff\xfe",
        b"\0",
        b"0",
        b"-",
        b"time",
        b"_x",
        b'"',
    ),
    *(
        b"\xe2\x80\xa8",
        b"[",
        b"]]",
        b"[[trial]]",
        b"'''",
        b"= {",
        b"../../",
        b"9" * 400,
        b"#",
        b"\\",
        b"true",
    ),
    *(b"1979-05-27", b"\x7f"),
]


@dataclass(frozen=True)
class Kind:
    """One reader, and a sound file for it."""

    name: str
    content: bytes
    suffix: str
    read: Callable[[Path], object]
    head: int
    """Bytes at the beginning where the structure lies: half of the damage is done there."""


@dataclass
class Count:
    results: int = 0
    errors: int = 0
    failures: list[str] = field(default_factory=list)
    slowest: float = 0.0

    def __add__(self, other: Count) -> Count:
        return Count(
            self.results + other.results, self.errors + other.errors, self.failures + other.failures
        )

    @property
    def cells(self) -> str:
        bad = len(self.failures)
        return f"{self.results + self.errors + bad:6} {self.results:8} {self.errors:7} {bad:9}"


def mutated(content: bytes, rng: np.random.Generator, head: int) -> bytes:
    """One to six changes: bits, bytes, digits, cuts, insertions, copies; now and then a
    torn end.
    """
    out = bytearray(content)
    for _ in range(int(rng.choice([1, 1, 2, 3, 6]))):
        if not out:
            break
        reach = min(head, len(out)) if rng.random() < 0.5 else len(out)
        place, length = int(rng.integers(reach)), int(rng.integers(1, 20))
        kind = int(rng.integers(6)) if rng.random() < 0.95 else 6
        if kind == 0:
            out[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            out[place : place + length] = rng.bytes(length)
        elif kind == 2:
            del out[place : place + length]
        elif kind == 3:
            out[place:place] = TOKENS[int(rng.integers(len(TOKENS)))]
        elif kind == 4:
            other = int(rng.integers(len(out)))
            out[place : place + length] = out[other : other + length]
        elif kind == 5:
            digits = [i for i in range(place, min(place + 200, len(out))) if 48 <= out[i] <= 57]
            if digits:
                out[digits[int(rng.integers(len(digits)))]] = 48 + int(rng.integers(10))
        else:
            del out[int(rng.integers(place, len(out))) :]
    return bytes(out)


def made_kinds(folder: Path) -> Iterator[Kind]:
    """A sound file of every kind that this project writes."""
    recording = small_recording()
    writers = {".c3d": write_c3d, ".trc": write_trc, ".csv": write_markers_csv}
    for suffix, write in writers.items():
        path = folder / f"made{suffix}"
        write(path, recording)
        yield Kind(
            f"markers {suffix}",
            path.read_bytes(),
            suffix,
            read_sound,
            4000 if suffix == ".c3d" else 800,
        )
    for suffix, write_forces in {".mot": write_forces_mot, ".csv": write_forces_csv}.items():
        path = folder / f"forces{suffix}"
        write_forces(path, recording.plates)
        yield Kind(f"forces {suffix}", path.read_bytes(), suffix, read_forces, 500)
    wrench = np.stack([plate.wrench() for plate in recording.plates], axis=1)
    _, loads = write_external_loads(folder, recording.time, wrench, stem="loads")
    yield Kind("loads .xml", loads.read_bytes(), ".xml", read_forces, 3000)
    yield Kind("C3D to supplement", (folder / "made.c3d").read_bytes(), ".c3d", supplement, 4000)
    write_plates_csv(folder / "corners_plates.csv", recording.plates)
    corners = (folder / "corners_plates.csv").read_bytes()
    yield Kind("corners .csv", corners, ".csv", read_damaged_corners, 300)
    study = (STUDY.format(static="made.csv", walk="made.trc") + MORE).encode()
    yield Kind("study .toml", study, ".toml", load_study_file, 600)
    yield Kind("checked study .toml", study, ".toml", check_file, 600)
    standing = published_model(static_only=True)
    markers = compute_synthetic_markers(
        standing.parameters, standing.markers, simulate_static_trial(30).q
    )
    still = Recording(
        source="made up",
        time=np.arange(30) / 100.0,
        labels=standing.markers.labels,
        markers=markers,
    )
    write_markers_csv(folder / "static.csv", still)
    yield Kind(
        "checks, static .csv",
        (folder / "static.csv").read_bytes(),
        ".csv",
        check_damaged_static,
        100_000,
    )
    sets = sorted((find_models_folder() / "markersets").glob("*.toml"))
    yield Kind("marker set .toml", sets[0].read_bytes(), ".toml", load_marker_set, 3000)
    save_model(published_model(), folder / "model.toml")
    yield Kind("model .toml", (folder / "model.toml").read_bytes(), ".toml", load_model, 4000)


def read_sound(path: Path) -> Recording:
    recording = read_recording(path)
    sound = (
        len(set(recording.labels)) == len(recording.labels)
        and recording.markers.shape == (len(recording.time), len(recording.labels), 3)
        and np.all(np.diff(recording.time) > 0)
        and not np.isinf(recording.markers).any()
        and all(
            p.force.shape == p.point.shape == p.moment.shape == (len(p.time), 3)
            for p in recording.plates
        )
    )
    if not sound:
        raise ValueError("a recording that is not sound")
    return recording


def supplement(path: Path) -> Recording:
    """The recording after one point more was written into a copy of its file."""
    frames = len(read_recording(path).time)
    point = AddedPoint(name="LHipAngles", kind=PointKind.ANGLE, values=np.zeros((frames, 3)))
    target = path.with_name("supplemented.c3d")
    try:
        supplement_c3d(
            open_c3d_original(path, frames),
            target,
            [point],
            [FootEvent(FootMoment.STRIKE, "r", 0.5)],
        )
        return read_recording(target)
    except InputError as error:
        raise InputError(str(error), source=path) from None


def read_damaged_corners(path: Path) -> object:
    """Plates with the damaged table beside their forces."""
    path.with_name("torn_plates.csv").write_bytes(path.read_bytes())
    forces = Forces(source="torn_forces.csv", plates=small_recording().plates)
    return add_corners(forces, path.with_name("torn_forces.csv"))


def check_damaged_static(path: Path) -> object:
    """All checks of a study whose static trial is the damaged file."""
    study = path.with_name("of_damaged.toml")
    study.write_text(STUDY.format(static=path.name, walk="static.csv"), encoding="utf-8")
    findings = check_file(study)
    if any(f.topic in ("reading", "study file") for f in findings):
        raise InputError("could not be read", source=path)
    return findings


def real_kinds() -> Iterator[Kind]:
    """Small real files, where GAITCAL_DATA names their folder."""
    named = os.environ.get("GAITCAL_DATA")
    if not named:
        return
    for path in sorted((Path(named) / "c3d_formats").glob("*")):
        yield Kind(f"real {path.name}", path.read_bytes(), ".c3d", read_sound, 6000)
    for name, read in (
        ("uf3/knee_l.trc", read_sound),
        ("subject01/subject01_walk1_grf.mot", read_forces),
    ):
        path = Path(named) / name
        if path.is_file():
            yield Kind(
                f"real {path.name}",
                path.read_bytes()[:60_000].rpartition(b"\n")[0],
                path.suffix,
                read,
                1500,
            )


@cache
def small_recording() -> Recording:
    """Some frames of the published subject's walk, with two plates."""
    model, motion = published_model(), simulate_gait()
    wrench = compute_residual_free_wrench(model.parameters, motion)[:FRAMES]
    time_ = motion.basis.time[:FRAMES]
    up, origin = np.array([0.0, 1.0, 0.0]), np.zeros(3)
    corners = np.array([[0.6, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.6, 0.0, 0.5]])
    plates = tuple(
        build_plate_from_moment(
            str(k + 1), time_, wrench[:, k, :3], wrench[:, k, 3:], origin, up, corners
        )
        for k in range(2)
    )
    markers = compute_synthetic_markers(model.parameters, model.markers, motion.q[:FRAMES])
    return Recording(
        source="made up",
        time=time_,
        labels=model.markers.labels[:8],
        markers=markers[:, :8],
        plates=plates,
    )


def fuzz(kind: Kind, folder: Path, files: int, seed: int) -> Count:
    """Damage and read `files` files of one kind, in this process."""
    rng = np.random.default_rng([seed, *kind.name.encode()])
    count = Count()
    path = folder / f"damaged{kind.suffix}"
    for number in range(files):
        path.write_bytes(mutated(kind.content, rng, kind.head))
        began = time.monotonic()
        try:
            kind.read(path)
        except GaitcalError as error:
            count.errors += 1
            if "\n" in str(error) or str(folder) not in str(error):
                count.failures.append(
                    f"{kind.name}, file {number}: not one line with the file: {str(error)[:200]!r}"
                )
        except Exception:  # noqa: BLE001  what is counted here
            count.failures.append(f"{kind.name}, file {number}: {traceback.format_exc(limit=-3)}")
        else:
            count.results += 1
        took = time.monotonic() - began
        count.slowest = max(count.slowest, took)
        if took > SECONDS:
            count.failures.append(f"{kind.name}, file {number}: took {took:.1f} s")
    return count


def fuzz_alone(kind: Kind, files: int, seed: int) -> Count:
    """The same in a folder of its own, with the files that a study names."""
    with tempfile.TemporaryDirectory() as name:
        list(made_kinds(Path(name)))
        return fuzz(kind, Path(name), files, seed)


def run(chosen: argparse.Namespace) -> dict[str, Count]:
    with tempfile.TemporaryDirectory() as folder:
        kinds = [*made_kinds(Path(folder)), *real_kinds()]
    share = -(-chosen.files // len(kinds))
    found = side_by_side(
        [partial(fuzz_alone, kind, share, chosen.seed) for kind in kinds], chosen.jobs
    )
    counts = {kind.name: count for kind, count in zip(kinds, found, strict=True)}
    print(
        f"{'reader':28} {'files':>6} {'results':>8} {'errors':>7} {'failures':>9} {'slowest s':>10}"
    )
    for name, c in counts.items():
        print(f"{name:28} {c.cells} {c.slowest:10.2f}")
    print(f"{'all':28} {sum(counts.values(), Count()).cells}")
    for c in counts.values():
        for failure in c.failures[:5]:
            print(failure, file=sys.stderr)
    return counts


def passed(counts: dict[str, Count]) -> bool:
    return not any(count.failures for count in counts.values())
