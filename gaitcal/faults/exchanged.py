"""Markers that carry each other's label for a while, judged by lengths and by jumps.

By lengths: d0(a, c) is the distance of markers a and c of one segment in the static posture. A trajectory y under the
label a costs  E_a(y) = mean_c | |y - x_c| - d0(a, c) |  over the others c of its segment. Labels a and b are exchanged
where E_a(x_b) + E_b(x_a) is far below E_a(x_a) + E_b(x_b); a has taken the place of a marker b that is not seen where
E_b(x_a) is far below E_a(x_a). By jumps: from one frame to the next a goes where b was, and b where a was.

Lengths are no evidence in arms: the humerus and the radius turn under the skin by up to a right angle, so that the two
epicondyles, or the two sides of the wrist, come to where the other should be. They are judged by jumps alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, zip_longest

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.faults.evidence import LIGHT, TrialEvidence
from gaitcal.faults.jumps import jump_limit
from gaitcal.findings import Finding
from gaitcal.io.intervals import duration, runs, spans
from gaitcal.model.linkage import LOWER_BODY

STRANGE_M = 0.02
"""Cost E above which a label is doubted at all; skin movement stays below that in most frames."""
FAR_BELOW = 0.5
"""The other assignment must cost less than this share of the present one."""
DECISIVE_M = 0.003
"""Difference of cost, mean over frames, from which lengths decide which side of a jump carries the right labels."""
BRIDGED_S = 0.1
"""Gap within which two markers may change places."""
ARMS = ("upper_arm", "forearm_hand")
WITNESSES = 2
"""Others of the segment that must be seen in a frame to say that a marker is where another, unseen one should be: at
one distance from one marker there are many places."""
LONG_S = 0.05
"""Longer than a filter bridges: angles of the segment are wrong by tens of degrees for so long."""
SHORTEST = 3
"""Frames of a stretch in which lengths say that labels are exchanged."""


@dataclass(frozen=True)
class Exchange:
    """Two labels, and the frames in which the first carries the other's marker."""

    label: str
    other: str
    frames: BoolArray
    """(nf,)."""
    mutual: bool
    """False where the other marker was not seen meanwhile."""


def exchanged(trial: TrialEvidence) -> Iterator[Finding]:
    """Labels exchanged for a part of the trial, or for all of it."""
    for found in exchanges(trial):
        stretches = runs(found.frames)
        share = float(found.frames.sum() / max(int(trial.seen[:, trial.place[found.label]].sum()), 1))
        when = spans(trial.recording.time, stretches)
        what = "carry each other's label" if found.mutual else "are confused: the first is where the second should be"
        words = f"'{found.label}' and '{found.other}' {what} in {int(found.frames.sum())} frames, {when}"
        weight = float(found.frames.sum())
        if max(trial.weight(found.label), trial.weight(found.other)) <= LIGHT:
            cure = "no harm done, as both have little weight or none; label that part again to use them"
            yield trial.info("exchanged", words, cure, code=Code.EXCHANGED_LABELS)
        elif share > 0.5:
            yield trial.error(
                "exchanged", words, "exchange the two labels in the file", weight=weight, code=Code.EXCHANGED_LABELS
            )
        elif _harmful(trial, found):
            cure = "label that part again, or leave it out with time = [start, end]"
            yield trial.error("exchanged", words, cure, weight=weight, code=Code.EXCHANGED_LABELS)
        else:
            cure = 'label that part again, leave it out with time = [start, end], or set robust = "cauchy"'
            yield trial.warning("exchanged", words, cure, weight=weight, code=Code.EXCHANGED_LABELS)


def _harmful(trial: TrialEvidence, found: Exchange) -> bool:
    """Whether a part of the trial turns a segment of the pelvis or legs by it: two full markers, for some time."""
    if trial.settings.robust != "none" or min(trial.weight(found.label), trial.weight(found.other)) <= LIGHT:
        return False
    of_legs = {label for s in LOWER_BODY if s in trial.templates for label in trial.templates[s][0]}
    longest = max(duration(trial.recording.time, run) for run in runs(found.frames))
    return {found.label, found.other} <= of_legs and longest >= LONG_S


def exchanges(trial: TrialEvidence) -> Iterator[Exchange]:
    """Pairs of labels that are exchanged somewhere, each once."""
    found: dict[frozenset[str], Exchange] = {}
    for exchange in by_lengths(trial):
        pair = frozenset((exchange.label, exchange.other))
        known = found.get(pair)
        if known is None or (exchange.mutual and not known.mutual):
            found[pair] = exchange
        if known is not None:
            found[pair] = replace(found[pair], frames=known.frames | exchange.frames)
    for exchange in by_jumps(trial):
        found.setdefault(frozenset((exchange.label, exchange.other)), exchange)
    yield from found.values()


def undone(trial: TrialEvidence) -> TrialEvidence:
    """The trial with all exchanges undone, so that only what else is wrong with it is seen; itself where there are
    none.
    """
    markers = trial.recording.markers
    for found in exchanges(trial):
        a, b = trial.place[found.label], trial.place[found.other]
        if markers is trial.recording.markers:
            markers = markers.copy()
        taken = trial.recording.markers[found.frames]
        markers[found.frames, b] = taken[:, a]
        markers[found.frames, a] = taken[:, b] if found.mutual else np.nan
    if markers is trial.recording.markers:
        return trial
    return replace(trial, trial=replace(trial.trial, recording=replace(trial.recording, markers=markers)))


def by_lengths(trial: TrialEvidence) -> Iterator[Exchange]:
    """Exchanges that the lengths within segments show."""
    templates = {s: t for s, t in trial.templates.items() if not s.startswith(ARMS)}
    segment_of = {label: segment for segment, (labels, _) in templates.items() for label in labels}
    costs = {label: _cost(trial, segment_of, label, label, ()) for label in segment_of}
    doubted = {label: cost for label, cost in costs.items() if (np.nan_to_num(cost) > STRANGE_M).sum() >= SHORTEST}
    for a, b in combinations(doubted, 2):
        strange = (np.nan_to_num(costs[a]) > STRANGE_M) & (np.nan_to_num(costs[b]) > STRANGE_M)
        if strange.sum() < SHORTEST:
            continue
        present = _cost(trial, segment_of, a, a, (b,)) + _cost(trial, segment_of, b, b, (a,))
        other = _cost(trial, segment_of, a, b, (b,)) + _cost(trial, segment_of, b, a, (a,))
        marked = _long_enough(strange & (np.nan_to_num(other, nan=np.inf) < FAR_BELOW * np.nan_to_num(present)))
        if marked.any():
            yield Exchange(a, b, marked, True)
    for a in doubted:
        for b in segment_of:
            unseen = ~trial.seen[:, trial.place[b]] & (np.nan_to_num(costs[a]) > STRANGE_M)
            if b == a or unseen.sum() < SHORTEST:
                continue
            other = _cost(trial, segment_of, b, a, (a,), WITNESSES)
            present = _cost(trial, segment_of, a, a, (b,))
            fits = np.nan_to_num(other, nan=np.inf) < np.minimum(FAR_BELOW * np.nan_to_num(present), STRANGE_M)
            marked = _long_enough(unseen & fits)
            if marked.any():
                yield Exchange(a, b, marked, False)


def _long_enough(marked: BoolArray) -> BoolArray:
    """(nf,) the marked frames without stretches shorter than SHORTEST."""
    out = np.zeros_like(marked)
    for run in runs(marked, SHORTEST):
        out[run] = True
    return out


def _cost(
    trial: TrialEvidence,
    segment_of: dict[str, str],
    label: str,
    trajectory: str,
    without: tuple[str, ...],
    witnesses: int = 1,
) -> Array:
    """(nf,) m, E_label(trajectory) over the others of the segment, `without` some; NaN where fewer are seen than
    `witnesses`.
    """
    labels, local = trial.templates[segment_of[label]]
    here = labels.index(label)
    others = [k for k, other in enumerate(labels) if k != here and other not in without]
    x = trial.recording.markers
    if not others:
        return np.full(len(x), np.nan)
    apart = x[:, [trial.place[labels[k]] for k in others]] - x[:, [trial.place[trajectory]]]
    wrong = np.abs(np.linalg.norm(apart, axis=2) - np.linalg.norm(local[others] - local[here], axis=1))
    known = np.isfinite(wrong)
    count = known.sum(axis=1)
    total = np.where(known, wrong, 0.0).sum(axis=1)
    return np.where(count >= witnesses, total / np.maximum(count, 1), np.nan)


def by_jumps(trial: TrialEvidence) -> Iterator[Exchange]:
    """Exchanges that happen from one frame to the next, or within a short gap; lengths tell which side is right.

    Where lengths do not tell (the two are alike in their distances to the others), the shorter side is the wrong one.
    """
    for (a, b), times in _crossings(trial).items():
        frames = np.zeros(len(trial.seen), dtype=bool)
        for start, stop in zip_longest(times[::2], times[1::2], fillvalue=len(frames)):
            frames[start:stop] = True
        first, second = trial.recording.labels[a], trial.recording.labels[b]
        excess = _excess(trial, first, second)
        gain = float(np.nansum(np.where(frames, excess, -excess))) / max(int(np.isfinite(excess).sum()), 1)
        if gain < -DECISIVE_M or (gain < DECISIVE_M and frames.mean() > 0.5):
            frames = ~frames
        if frames.any():
            yield Exchange(first, second, frames, True)


def _crossings(trial: TrialEvidence) -> dict[tuple[int, int], list[int]]:
    """Pairs of columns -> frames at which one comes to where the other was, and the other way round."""
    x = trial.recording.markers
    out: dict[tuple[int, int], list[int]] = {}
    if len(x) < 3:
        return out
    before = _last_seen(x, max(1, round(BRIDGED_S * trial.recording.rate)))[:-1]
    length = np.linalg.norm(x[1:] - before, axis=2)
    jumping = np.nan_to_num(length) > max(jump_limit(trial), 0.03)
    for t in np.flatnonzero(jumping.sum(axis=1) >= 2):
        for a, b in combinations(np.flatnonzero(jumping[t]).tolist(), 2):
            crossed = np.linalg.norm(x[t + 1, a] - before[t, b]) + np.linalg.norm(x[t + 1, b] - before[t, a])
            if crossed < FAR_BELOW * (length[t, a] + length[t, b]):
                out.setdefault((a, b), []).append(int(t) + 1)
    return out


def _last_seen(x: Array, most: int) -> Array:
    """(nf, nm, 3) positions, gaps filled with the last one for at most `most` frames."""
    seen = np.isfinite(x).all(axis=2)
    frame = np.arange(len(x))[:, None]
    last = np.maximum.accumulate(np.where(seen, frame, -1), axis=0)
    filled = np.take_along_axis(x, np.maximum(last, 0)[:, :, None], axis=0)
    return np.where(((last >= 0) & (frame - last <= most))[:, :, None], filled, np.nan)


def _excess(trial: TrialEvidence, a: str, b: str) -> Array:
    """(nf,) m, what the present labels of two markers cost more than the exchanged ones; NaN where nothing tells."""
    segment_of = {label: segment for segment, (labels, _) in trial.templates.items() for label in labels}
    out = np.full(len(trial.seen), np.nan)
    if a in segment_of and b in segment_of:
        present = _cost(trial, segment_of, a, a, (b,)) + _cost(trial, segment_of, b, b, (a,))
        out = present - _cost(trial, segment_of, a, b, (b,)) - _cost(trial, segment_of, b, a, (a,))
    return out
