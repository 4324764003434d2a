"""How often `gaitcal check` tells that a body is not one and the same, and how often it names the right thing.

    python -m scripts.validation one_body STUDY.toml... [--people 6] [--draws 10] [--seed 0]

Every study, and so many synthetic people with noise, gets one fault after the other in a random trial, segment and
direction: markers displaced, labels exchanged, clusters slid, turned, mirrored, paths made up, sides exchanged, another
size, another joint declared. Told: a finding that the sound study does not have. Named: it names the marker, segment,
joint or trial that was spoilt. Refused: it is an error. First of all the sound studies: there is nothing to tell.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaitcal import Study
from gaitcal.arrays import Array
from gaitcal.body.cluster import Cluster
from gaitcal.checks import check_study
from gaitcal.checks.evidence import TrialEvidence
from gaitcal.checks.one_body import axis_mirrored, sides_exchanged
from gaitcal.checks.standing import nominal_model_of
from gaitcal.checks.study import evidence_of
from gaitcal.findings import Finding, Severity
from gaitcal.model.linkage import ISOLATED_JOINTS
from gaitcal.recording import Recording
from gaitcal.study.study_trial import StudyTrial
from gaitcal.synthetic.subject import synthesize

TOPICS = ("one body", "body size", "left its place", "joint", "exchanged", "frozen", "sides", "axes")
SOME_M = 0.03
"""Error of a made-up path below which it does no harm worth telling."""


@dataclass(frozen=True)
class Spoilt:
    """A study with one fault, and what names it."""

    study: Study
    words: tuple[str, ...]
    """One of them must stand in the cause or evidence."""
    where: str = ""
    """Trial, if it must be named."""


class Person:
    """A sound study, ready to be spoilt."""

    def __init__(self, name: str, study: Study) -> None:
        self.name, self.study = name, study
        model, _ = nominal_model_of(study)
        if model is None:
            raise SystemExit(f"{name}: no nominal model")
        self.moving: list[TrialEvidence] = [t for t in evidence_of(study, model) if not t.is_static and t.clusters]
        self.sound = {_key(f) for f in told(study)}

    def any_cluster(self, rng: np.random.Generator, own: int = 1) -> tuple[TrialEvidence, Cluster] | None:
        """A random trial and cluster with so many markers of its own."""
        trial = self.moving[rng.integers(len(self.moving))]
        clusters = [c for c in trial.clusters.values() if c.own >= own]
        return (trial, clusters[rng.integers(len(clusters))]) if clusters else None


Fault = Callable[[Person, np.random.Generator], "Spoilt | None"]


def told(study: Study) -> list[Finding]:
    """Warnings and errors about the body."""
    return [f for f in check_study(study) if f.topic in TOPICS and f.severity is not Severity.INFO]


def _key(f: Finding) -> tuple[str, str, str]:
    return f.topic, f.where, f.cause or f.found


def with_recording(study: Study, name: str, change: Callable[[Recording], Recording]) -> Study:
    """The study with one trial's recording changed."""
    return with_trial(study, name, lambda t: replace(t, recording=change(t.recording)))


def with_trial(study: Study, name: str, change: Callable[[StudyTrial], StudyTrial]) -> Study:
    """The study with one trial changed."""
    return replace(study, trials=tuple(change(t) if t.name == name else t for t in study.trials))


def moved(trial: TrialEvidence, labels: Sequence[str], by: Array, frames: slice = slice(None)) -> Recording:
    """The recording with (nf, n, 3) m added to markers."""
    markers = trial.recording.markers.copy()
    columns = [trial.place[label] for label in labels]
    markers[frames, columns] += by[frames]
    return replace(trial.recording, markers=markers)


def direction(rng: np.random.Generator) -> Array:
    d = rng.normal(size=3)
    out: Array = d / np.linalg.norm(d)
    return out


def displaced(mm: float, own: int, from_middle: bool = False) -> Fault:
    """One marker sits elsewhere, all the time or from some moment on."""

    def spoil(person: Person, rng: np.random.Generator) -> Spoilt | None:
        chosen = person.any_cluster(rng)
        if chosen is None or (chosen[1].own > 3) != (own > 3):
            return None
        trial, cluster = chosen
        label = cluster.labels[rng.integers(cluster.own)]
        by = (1e-3 * mm * cluster.rotation @ direction(rng))[:, None]
        start = int(rng.uniform(0.25, 0.75) * len(by)) if from_middle else 0
        recording = moved(trial, [label], by, slice(start, None))
        return Spoilt(with_recording(person.study, trial.name, lambda _: recording), (f"'{label}'",))

    return spoil


def exchanged(seconds: float | None) -> Fault:
    """Two markers of a segment carry each other's label."""

    def spoil(person: Person, rng: np.random.Generator) -> Spoilt | None:
        chosen = person.any_cluster(rng, 2)
        if chosen is None:
            return None
        trial, cluster = chosen
        a, b = (cluster.labels[k] for k in rng.choice(cluster.own, 2, replace=False))
        i, k = trial.place[a], trial.place[b]
        x = trial.recording.markers
        frames = _stretch(trial, seconds, rng) if seconds else slice(None)
        if np.nanmedian(np.linalg.norm(x[:, i] - x[:, k], axis=1)) < SOME_M:
            return None
        markers = x.copy()
        markers[frames, i], markers[frames, k] = x[frames, k], x[frames, i]
        recording = replace(trial.recording, markers=markers)
        return Spoilt(with_recording(person.study, trial.name, lambda _: recording), (f"'{a}'", f"'{b}'"))

    return spoil


def _stretch(trial: TrialEvidence, seconds: float, rng: np.random.Generator) -> slice:
    frames = max(6, round(seconds * trial.recording.rate))
    start = int(rng.integers(2, max(3, len(trial.recording.time) - frames - 2)))
    return slice(start, start + frames)


def cluster_moved(mm: float, degrees: float) -> Fault:
    """A whole cluster slid, or turned about the upright line through its middle."""

    def spoil(person: Person, rng: np.random.Generator) -> Spoilt | None:
        chosen = person.any_cluster(rng, 2)
        if chosen is None or chosen[1].part == "pelvis":
            return None
        trial, cluster = chosen
        own = cluster.shape[: cluster.own]
        angle = np.deg2rad(degrees) * rng.choice([-1.0, 1.0])
        turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
        axis = own.mean(axis=0)
        by = (own - axis) @ (turn - np.eye(3)).T + 1e-3 * mm * direction(rng)
        recording = moved(trial, cluster.labels[: cluster.own], np.einsum("fij,mj->fmi", cluster.rotation, by))
        words = (*(f"'{m}'" for m in cluster.labels), _words(cluster.segment))
        return Spoilt(with_recording(person.study, trial.name, lambda _: recording), words)

    return spoil


def mirrored_cluster(person: Person, rng: np.random.Generator) -> Spoilt | None:
    """A cluster in a mirror."""
    chosen = person.any_cluster(rng, 3)
    if chosen is None:
        return None
    trial, cluster = chosen
    normal = direction(rng)
    own = cluster.shape[: cluster.own] - cluster.shape[: cluster.own].mean(axis=0)
    by = np.einsum("fij,mj->fmi", cluster.rotation, -2.0 * (own @ normal)[:, None] * normal)
    recording = moved(trial, cluster.labels[: cluster.own], by)
    words = (*(f"'{m}'" for m in cluster.labels), _words(cluster.segment))
    return Spoilt(with_recording(person.study, trial.name, lambda _: recording), words)


def _words(segment: str) -> str:
    return {"r": "right ", "l": "left "}.get(segment[-2:].removeprefix("_"), "") + segment.split("_")[0]


def made_up(seconds: float, straight: bool) -> Fault:
    """A marker held, or led along a straight line."""

    def spoil(person: Person, rng: np.random.Generator) -> Spoilt | None:
        chosen = person.any_cluster(rng)
        if chosen is None:
            return None
        trial, cluster = chosen
        label = cluster.labels[rng.integers(cluster.own)]
        frames = _stretch(trial, seconds, rng)
        x = trial.path(label)
        path = x[frames]
        if not np.isfinite(x[frames.start - 1 : frames.stop + 1]).all() or len(path) < 6:
            return None
        end = path[-1] if straight else path[0]
        line = path[0] + np.linspace(0.0, 1.0, len(path))[:, None] * (end - path[0])
        if np.linalg.norm(line - path, axis=1).max() < SOME_M:
            return None
        markers = trial.recording.markers.copy()
        markers[frames, trial.place[label]] = line
        recording = replace(trial.recording, markers=markers)
        return Spoilt(with_recording(person.study, trial.name, lambda _: recording), (label,), trial.name)

    return spoil


def whole_trial(change: Callable[[Recording], Recording], static: bool = False) -> Fault:
    """A whole trial changed."""

    def spoil(person: Person, rng: np.random.Generator) -> Spoilt | None:
        trial = person.moving[rng.integers(len(person.moving))]
        name = person.study.static.name if static else trial.name
        return Spoilt(with_recording(person.study, name, change), ("",), name)

    return spoil


def declared(person: Person, rng: np.random.Generator) -> Spoilt | None:
    """An isolated trial declared for another joint."""
    isolated = [t for t in person.moving if t.is_isolated]
    if not isolated:
        return None
    trial = isolated[rng.integers(len(isolated))]
    true = trial.trial.joint
    other = str(rng.choice([j for j in ISOLATED_JOINTS if j != true]))
    study = with_trial(person.study, trial.name, lambda t: replace(t, joint=other))
    return Spoilt(study, (f"looks like {true}",), trial.name)


def scaled(recording: Recording) -> Recording:
    """The recording of a body 3 % larger."""
    return replace(recording, markers=1.03 * recording.markers)


FAULTS: dict[str, Fault] = {
    **{f"marker {mm} mm off, cluster of 3": displaced(mm, 3) for mm in (10, 20, 30, 40)},
    **{f"marker {mm} mm off, 4 or more": displaced(mm, 4) for mm in (10, 20, 30, 40)},
    "marker 30 mm off from a moment on": displaced(30, 3, True),
    "labels exchanged throughout": exchanged(None),
    "labels exchanged for 0.3 s": exchanged(0.3),
    "cluster slid 15 mm": cluster_moved(15, 0),
    "cluster slid 30 mm": cluster_moved(30, 0),
    "cluster turned 10 deg": cluster_moved(0, 10),
    "cluster turned 20 deg": cluster_moved(0, 20),
    "cluster mirrored": mirrored_cluster,
    "held 0.2 s": made_up(0.2, False),
    "held 0.5 s": made_up(0.5, False),
    "straight line 0.2 s": made_up(0.2, True),
    "straight line 0.5 s": made_up(0.5, True),
    "sides exchanged": whole_trial(sides_exchanged),
    "trial mirrored": whole_trial(axis_mirrored),
    "trial 3 % larger": whole_trial(scaled),
    "static 3 % larger": whole_trial(scaled, True),
    "wrong joint declared": declared,
}


def people(files: Sequence[Path], count: int, seed: int) -> Iterator[Person]:
    """The studies of the command line, then synthetic ones."""
    for file in files:
        yield Person(file.parent.name, Study.load(file))
    for k in range(count):
        with tempfile.TemporaryDirectory() as folder:
            file = synthesize(Path(folder) / "study", seed=seed + k, noise=True, perturb=bool(k % 2))
            yield Person(f"synthetic {seed + k}", Study.load(file))


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("studies", type=Path, nargs="*")
    parser.add_argument("--people", type=int, default=6, help="synthetic people")
    parser.add_argument("--draws", type=int, default=5, help="of each fault and person")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="faults whose name has this in it")
    parser.add_argument("--missed", action="store_true", help="print what was said of those not named")
    chosen = parser.parse_args(arguments)
    counts = {name: np.zeros(4, dtype=int) for name in FAULTS if chosen.only in name}
    false_alarms = 0
    for person in people(chosen.studies, chosen.people, chosen.seed):
        false_alarms += len(person.sound)
        for key in sorted(person.sound):
            print(f"sound, {person.name}: {key}")
        rng = np.random.default_rng([chosen.seed, len(person.name), *person.name.encode()])
        for name, count in counts.items():
            for _ in range(chosen.draws):
                spoilt = FAULTS[name](person, rng)
                if spoilt is not None:
                    new = [f for f in told(spoilt.study) if _key(f) not in person.sound]
                    named = [f for f in new if any(word in f.evidence for word in spoilt.words)]
                    named = [f for f in named if not spoilt.where or spoilt.where in (f.where, f.evidence)]
                    count += [1, bool(new), bool(named), any(f.severity is Severity.ERROR for f in new)]
                    if chosen.missed and not named:
                        print(f"  {person.name}: {name}: {spoilt.words} {spoilt.where}: {[f.line for f in new]}")
    print(f"{'fault':38} {'cases':>6} {'told':>6} {'named':>6} {'refused':>8}   %")
    for name, (n, *rest) in counts.items():
        shares = [f"{100 * k / max(n, 1):.0f}" for k in rest]
        print(f"{name:38} {n:6d} {shares[0]:>6} {shares[1]:>6} {shares[2]:>8}")
    print(f"findings on sound studies: {false_alarms}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
