"""Ways to spoil a study: what it says of its recordings and of the person, and recordings that are
not its own. They are functions of the study and the words of the table; those that spoil a file in
place, of its path and the words.
"""

from __future__ import annotations

import re
import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import ezc3d
import numpy as np

from gaitcal import Recording, Study, load_marker_set, synthesize
from scripts.validation.attacks.spoil_markers import labels_of
from scripts.validation.attacks.spoil_plates import at_times, first_contact, middle_of
from scripts.validation.recordings import WALK, loaded


def written(path: Path, text: str, encoding: str = "utf-8") -> None:
    """Other text into a file, its ends of lines as they are."""
    path.write_bytes(text.encode(encoding))


def _text(path: Path) -> str:
    return path.read_bytes().decode("utf-8", errors="replace")


def utf16(path: Path) -> None:
    """Another encoding."""
    written(path, _text(path), "utf-16")


def halved(path: Path) -> None:
    """Cut off in the middle."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def emptied(path: Path) -> None:
    """No byte is left."""
    path.write_bytes(b"")


def deleted(path: Path) -> None:
    """There is no such file."""
    path.unlink()


def flipped(path: Path, first: int, last: int) -> None:
    """Some bytes with every bit turned."""
    content = path.read_bytes()
    path.write_bytes(content[:first] + bytes(255 - x for x in content[first:last]) + content[last:])


def changed(path: Path, found: str, into: str, count: int = 0) -> None:
    """A pattern replaced, everywhere or so many times."""
    text, changes = re.subn(found, into, _text(path), count=count)
    if not changes:
        raise ValueError(f"the file has no '{found}'")
    written(path, text)


def labels_moved(path: Path) -> None:
    """A TRC whose marker names stand one column group too far left."""
    lines = _text(path).splitlines()
    cells = lines[3].split("\t")
    names = [c for c in cells[2:] if c.strip()]
    moved = iter([*names[1:], names[0]])
    lines[3] = "\t".join([*cells[:2], *(next(moved) if c.strip() else c for c in cells[2:])])
    written(path, "\n".join(lines) + "\n")


def column(path: Path, name: str, factor: float, add: float = 0.0) -> None:
    """Columns of a force table, by a pattern for their names, times a factor and so much more."""
    lines = _text(path).splitlines()
    at = next(i for i, line in enumerate(lines) if line.lower().startswith("time"))
    wanted = [k for k, label in enumerate(lines[at].split()) if re.search(name, label)]
    if not wanted:
        raise ValueError(f"no column like '{name}'")
    for i in range(at + 1, len(lines)):
        cells = lines[i].split()
        for k in (k for k in wanted if k < len(cells)):
            cells[k] = f"{factor * float(cells[k]) + add:.8g}"
        lines[i] = "\t".join(cells)
    written(path, "\n".join(lines) + "\n")


def rate(path: Path, factor: float) -> None:
    """A C3D whose header and groups tell another rate."""
    file = ezc3d.c3d(str(path))
    for group in ("POINT", "ANALOG"):
        value = file["parameters"][group]["RATE"]
        value["value"] = np.array(value["value"]) * factor
    for part in ("points", "analogs"):
        file["header"][part]["frame_rate"] *= factor
    file.write(str(path))


def point_units(path: Path, word: str) -> None:
    """A C3D whose lengths are said to be of another unit."""
    file = ezc3d.c3d(str(path))
    file["parameters"]["POINT"]["UNITS"]["value"] = [word]
    file.write(str(path))


def channels(path: Path, factor: float) -> None:
    """Analog channels times a factor."""
    file = ezc3d.c3d(str(path))
    file["data"]["analogs"] = file["data"]["analogs"] * factor
    file.write(str(path))


def corners(path: Path, what: str, size: float = 1.0) -> None:
    """Corners of the plates: of the plates `exchanged`, `rolled` one on or more, `scaled`, or
    `shifted` by mm in x.
    """
    file = ezc3d.c3d(str(path))
    value = file["parameters"]["FORCE_PLATFORM"]["CORNERS"]
    c = np.array(value["value"], dtype=float)
    value["value"] = {
        "exchanged": c[:, :, ::-1],
        "rolled": np.roll(c, int(size), axis=1),
        "scaled": size * c,
        "shifted": c + np.array([size, 0, 0])[:, None, None],
    }[what]
    file.write(str(path))


OTHER_SEED = 2
"""Of the other synthetic person."""


def recording_of(study: Study, name: str) -> Recording:
    """The recording of a trial."""
    return next(trial.recording for trial in study.trials if trial.name == name)


def with_trial(study: Study, name: str, **changes: object) -> Study:
    """The study with one trial changed: another `recording`, `plates`, `joint`."""
    trials = tuple(replace(t, **changes) if t.name == name else t for t in study.trials)  # type: ignore[arg-type]
    return replace(study, trials=trials)


def of_base(study: Study, name: str, base: str) -> Study:
    """The trial of another person who wears the same marker set, forces and all."""
    return with_trial(study, name, recording=recording_of(loaded(base), name))


@lru_cache(maxsize=1)
def _other_person() -> Study:
    with tempfile.TemporaryDirectory() as folder:
        return Study.load(
            synthesize(Path(folder) / "study", seed=OTHER_SEED, noise=True, perturb=True)
        )


def of_another_person(study: Study, name: str) -> Study:
    """The trial of another synthetic person."""
    return with_trial(study, name, recording=recording_of(_other_person(), name))


def same_file(study: Study, name: str, source: str) -> Study:
    """A trial with the file of another."""
    return with_trial(study, name, recording=recording_of(study, source))


def files_exchanged(study: Study, a: str, b: str) -> Study:
    """Two trials with each other's file."""
    return with_trial(same_file(study, a, b), b, recording=recording_of(study, a))


def given_as(study: Study, name: str, source: str) -> Study:
    """The recording of trial `source` under the name of another, its last frame left out: a file of
    its own.
    """
    other = recording_of(study, source)
    shorter = replace(other, time=other.time[:-1], markers=other.markers[:-1], plates=())
    return with_trial(study, name, recording=shorter)


def declared(study: Study, *joints: str) -> Study:
    """`hip_r=knee_r`: the trial is said to move that joint."""
    for words in joints:
        name, _, joint = words.partition("=")
        study = with_trial(study, name, joint=joint)
    return study


def assigned(study: Study, *feet: str) -> Study:
    """`1=r`: the study says which foot is on which plate."""
    return with_trial(study, WALK, plates=dict(words.split("=") for words in feet))


def labelled_as(study: Study, markers: str) -> Study:
    """The marker set of another protocol."""
    return replace(study, marker_set=load_marker_set(markers))


def weighing(study: Study, *weights: str) -> Study:
    """`thigh_r=0`: weights (by key) that the study gives."""
    pairs = [words.split("=") for words in weights]
    return replace(
        study, weights={n: float(w) for key, w in pairs for n in labels_of(study.marker_set, key)}
    )


def mass(study: Study, factor: float) -> Study:
    """Body mass times a factor."""
    return replace(study, subject=replace(study.subject, mass=factor * study.subject.mass))


def height(study: Study, factor: float) -> Study:
    """Height times a factor."""
    return replace(study, subject=replace(study.subject, height=factor * study.subject.height))


def other_sex(study: Study) -> Study:
    """The other anthropometric table."""
    return replace(
        study,
        subject=replace(study.subject, sex="female" if study.subject.sex == "male" else "male"),
    )


def cables_exchanged(study: Study) -> Study:
    """The signals of the first plate come from where the second stands, and the other way round."""
    walk = recording_of(study, WALK)
    one, two, *rest = walk.plates
    way = middle_of(one) - middle_of(two)
    first = replace(two, name=one.name, corners=one.corners, point=two.point + way)
    second = replace(one, name=two.name, corners=two.corners, point=one.point - way)
    return with_trial(study, WALK, recording=replace(walk, plates=(first, second, *rest)))


def points_exchanged(study: Study) -> Study:
    """Each force at the centre of pressure of the other plate."""
    walk = recording_of(study, WALK)
    one, two, *rest = walk.plates
    swapped = (replace(one, point=two.point), replace(two, point=one.point), *rest)
    return with_trial(study, WALK, recording=replace(walk, plates=swapped))


def without_plate(study: Study, number: int) -> Study:
    """The walk without one of its plates."""
    walk = recording_of(study, WALK)
    kept = tuple(p for k, p in enumerate(walk.plates, start=1) if k != number)
    return with_trial(study, WALK, recording=replace(walk, plates=kept))


def forces_of(study: Study, base: str) -> Study:
    """The force file of another walk, its first contact at the same moment."""
    walk, other = recording_of(study, WALK), recording_of(loaded(base), WALK)
    own, theirs = (
        min(t for p in r.plates if (t := first_contact(p)) is not None) for r in (walk, other)
    )
    time = walk.plates[0].time
    told = [
        replace(at_times(p, time - own + theirs), time=time, corners=None) for p in other.plates
    ]
    plates = tuple(replace(p, name=mine.name) for mine, p in zip(walk.plates, told, strict=False))
    return with_trial(study, WALK, recording=replace(walk, plates=plates))
