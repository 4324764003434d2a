"""Labels: markers that are missing, unknown, named twice, or named but never seen."""

from __future__ import annotations

import difflib
from collections.abc import Iterator

import numpy as np

from gaitcal.checks.evidence import TrialEvidence
from gaitcal.checks.finding import Finding, error, info, listed, warning
from gaitcal.model.linkage import LEG_SEGMENTS
from gaitcal.study.study import Role

LIGHT = 0.1
"""Weight up to which a marker decides nothing."""
SAME_M = 1e-4
"""Two markers always nearer than this are one trajectory under two names."""


def missing(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers of the set that the trial lacks, with the label that may be meant; and segments that lose too many."""
    absent = [label for label in trial.expected if label not in trial.place]
    if not absent:
        return
    strangers = _unknown(trial)
    told = []
    for label in absent:
        close = difflib.get_close_matches(label, strangers, n=1, cutoff=0.6)
        told.append(f"'{label}' (is it '{close[0]}'?)" if close else f"'{label}'")
    cure = 'name them in the file, or with rename = { "label in file" = "label in set" } under [markers]'
    found = f"{len(absent)} markers of the set are not in the file: {listed(told, 8)}"
    if trial.trial.role is Role.JOINT or all(trial.weight(label) <= LIGHT for label in absent):
        yield info("labels", trial.name, found, cure, trial.source)
    else:
        yield warning("labels", trial.name, found, cure, trial.source)


def too_few(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the first segment of the part that is fitted has three markers."""
    if trial.is_static or trial.model is None:
        return
    labels, _ = trial.templates.get("pelvis", ((), np.empty((0, 3))))
    seen = [m for m in labels if trial.weight(m) > 0 and trial.seen[:, trial.place[m]].any()]
    if len(seen) >= 3:
        return
    have = ", ".join(seen) or "none"
    yield error(
        "labels",
        trial.name,
        f"found {len(seen)} markers of the pelvis with weight ({have}); allowed: at least 3",
        "label them in this trial, or name others of the pelvis in the marker set",
        trial.source,
    )


def never_seen(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers with weight whose label is in the file without a single position."""
    empty = [m for m in trial.expected if m in trial.place and not trial.seen[:, trial.place[m]].any()]
    if empty:
        names = listed([f"'{m}'" for m in empty])
        yield error(
            "labels",
            trial.name,
            f"{names} named in the file, but never seen: found 0 of {len(trial.seen)} frames; allowed: at least 1",
            f'take the empty columns out of the file, or give the marker no weight: weights = {{ "{empty[0]}" = 0 }} '
            "under [markers]",
            trial.source,
        )


def unknown(trial: TrialEvidence) -> Iterator[Finding]:
    """Labels that the marker set does not know: they are not used."""
    strangers = _unknown(trial)
    if strangers:
        cure = "nothing, if they are meant to be left out"
        yield info("labels", trial.name, f"{len(strangers)} labels unknown to the set: {listed(strangers)}", cure)


def _unknown(trial: TrialEvidence) -> list[str]:
    known = set(trial.marker_set.labels)
    return [label for label in trial.recording.labels if label not in known]


def doubled(trial: TrialEvidence) -> Iterator[Finding]:
    """Labels that occur twice, and trajectories that have two names."""
    twice = [label for label in trial.recording.labels if "#" in label and label.rpartition("#")[0] in trial.place]
    if twice:
        yield warning(
            "labels",
            trial.name,
            f"labels that occur twice: {listed([label.rpartition('#')[0] for label in twice])}; the first was taken",
            "give every marker a label of its own",
            trial.source,
        )
    same = list(_same(trial))
    if same:
        yield error(
            "labels",
            trial.name,
            f"one trajectory under two labels: {listed(same)}",
            "one of the two is wrong: label the trial again, or give it no weight",
            trial.source,
        )


def bare_segments(trial: TrialEvidence) -> Iterator[Finding]:
    """Segments of the legs, and others that the model tracks, that show no marker with weight in a gait trial."""
    if trial.trial.role is not Role.GAIT or trial.model is None:
        return
    seen = {m for m in trial.place if trial.seen[:, trial.place[m]].any() and trial.weight(m) > 0}
    markers = trial.model.markers
    wanted: dict[str, list[str]] = {segment: [] for segment in LEG_SEGMENTS}
    for label, segment, weight in zip(markers.labels, markers.segments, markers.weight, strict=True):
        if weight > 0:
            wanted.setdefault(segment, []).append(label)
    bare = [segment for segment, labels in wanted.items() if seen.isdisjoint(labels)]
    if bare:
        torques = "; no torque is valid" if not set(LEG_SEGMENTS).isdisjoint(bare) else ""
        yield warning(
            "labels",
            trial.name,
            f"no marker with weight of {listed(bare)}: nothing tells how it moves{torques}",
            "label them in this trial, or see [markers] rename and weights of the study",
            trial.source,
        )


def _same(trial: TrialEvidence) -> Iterator[str]:
    own = [label for label in trial.marker_set.labels if label in trial.place and trial.weight(label) > 0]
    at = [trial.place[label] for label in own]
    some = slice(None, None, max(1, len(trial.seen) // 20))
    x, seen = trial.recording.markers[some][:, at], trial.seen[some][:, at]
    for i in range(len(own)):
        for j in range(i):
            both = seen[:, i] & seen[:, j]
            if both.sum() >= 3 and float(np.abs(x[both, i] - x[both, j]).max()) < SAME_M:
                yield f"'{own[j]}' and '{own[i]}'"
