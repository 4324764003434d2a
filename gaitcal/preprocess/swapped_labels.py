"""Find labels that are exchanged for a while, by lengths and by jumps.

By lengths: d0(a, c) is the distance of markers a and c of one segment in the static posture. A
trajectory y under the
label a costs  E_a(y) = mean_c | |y - x_c| - d0(a, c) |  over the others c of its segment. Labels a and b are exchanged
where E_a(x_b) + E_b(x_a) is far below E_a(x_a) + E_b(x_b), and neither term is more than skin
makes; a has taken the place of a marker b that is not seen where E_b(x_a) is far below E_a(x_a). By
jumps: from one frame to the next a goes where b was, and b where a was.

Lengths are no evidence in arms: the humerus and the radius turn under the skin by up to a right
angle, so that the two epicondyles, or the two sides of the wrist, come to where the other should
be. They are judged by jumps alone.

Exchanges that the shape of a whole trial shows are one of the causes of `static_disagreement.py`;
`quality` tells of sides, of the static trial (`static_landmarks.py`), and of those that only a fit
shows (`after_fit.py`).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, zip_longest
from typing import TypeAlias

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.io.recording import Recording, find_runs, find_visible
from gaitcal.model.subject_model import PointNoise
from gaitcal.preprocess.clean_trial import compute_jump_limit

Templates: TypeAlias = Mapping[str, tuple[tuple[str, ...], Array]]
"""Segment -> labels that are in a trial, and their positions (nm, 3) m in the static posture."""

# Cost E above which a label is doubted at all; skin movement stays below that in most frames
STRANGE_M = 0.02
FAR_BELOW = 0.5  # The other assignment must cost less than this share of the present one
DECISIVE_M = 0.003
"""Difference of cost, mean over frames, from which lengths decide which side of a jump carries the
right labels.
"""
BRIDGED_S = 0.1  # Gap within which two markers may change places
JUMP_M = 0.03
ARMS = ("upper_arm", "forearm_hand")
FEWEST_OTHERS = 2
"""Others of the segment that must be seen in a frame to say that a marker is where another, unseen
one should be: at one distance from one marker there are many places."""
SHORTEST = 3  # Frames of a stretch in which lengths say that labels are exchanged


@dataclass(frozen=True)
class SwappedLabels:
    """Two labels, and the frames in which the first carries the other's marker."""

    label: str
    other: str
    frames: BoolArray  # (nf,)
    mutual: bool  # False where the other marker was not seen meanwhile
    sure: bool = (
        True  # Whether lengths within segments say so; jumps alone may miss where an exchange ends
    )


def find_swapped_labels(
    recording: Recording, templates: Templates, noise: PointNoise | None
) -> tuple[SwappedLabels, ...]:
    """Find pairs of labels that are exchanged somewhere, each once.

    Parameters
    ----------
    recording
        Markers of a trial.
    templates
        Segment -> labels of the recording on it, and their positions (nm, 3) m in the static
        posture.
    noise
        Of the marker set, where its points are no markers: lengths between those change by
        centimetres and tell nothing.
    """
    found: dict[frozenset[str], SwappedLabels] = {}
    for exchange in find_swaps_by_lengths(recording, templates) if noise is None else ():
        pair = frozenset((exchange.label, exchange.other))
        known = found.get(pair)
        if known is None or (exchange.mutual and not known.mutual):
            found[pair] = exchange
        if known is not None:
            found[pair] = replace(found[pair], frames=known.frames | exchange.frames)
    found |= {
        frozenset((exchange.label, exchange.other)): exchange
        for exchange in find_swaps_by_jumps(recording, templates, noise)
    }  # frame by frame
    return tuple(found.values())


def restore_labels(recording: Recording, found: Sequence[SwappedLabels]) -> Recording:
    """The recording with these exchanges undone; itself where there are none."""
    if not found:
        return recording
    before, place = recording.markers, {label: i for i, label in enumerate(recording.labels)}
    markers = before.copy()
    for one in found:
        a, b = place[one.label], place[one.other]
        markers[one.frames, b] = before[one.frames, a]
        markers[one.frames, a] = before[one.frames, b] if one.mutual else np.nan
    return replace(recording, markers=markers)


class _Lengths:
    """E of trajectories in the segments of some templates."""

    def __init__(
        self, recording: Recording, templates: Templates, without: tuple[str, ...] = ()
    ) -> None:
        self._markers, self._templates = recording.markers, templates
        self.place = {label: i for i, label in enumerate(recording.labels)}
        self.segment_of = {
            label: segment
            for segment, (labels, _) in templates.items()
            for label in labels
            if not without or not segment.startswith(without)
        }

    def compute_cost(
        self, label: str, trajectory: str, without: tuple[str, ...], fewest: int = 1
    ) -> Array:
        """(nf,) m, E_label(trajectory) over the others of the segment, `without` some; NaN where
        fewer are seen than `fewest`.
        """
        labels, local = self._templates[self.segment_of[label]]
        here, place = labels.index(label), self.place
        others = [k for k, other in enumerate(labels) if k != here and other not in without]
        x = self._markers
        if not others:
            return np.full(len(x), np.nan)
        apart = x[:, [place[labels[k]] for k in others]] - x[:, [place[trajectory]]]
        wrong = np.abs(
            np.linalg.norm(apart, axis=2) - np.linalg.norm(local[others] - local[here], axis=1)
        )
        known = np.isfinite(wrong)
        count = known.sum(axis=1)
        total = np.where(known, wrong, 0.0).sum(axis=1)
        return np.where(count >= fewest, total / np.maximum(count, 1), np.nan)

    def compute_present(self, a: str, b: str) -> Array:
        """(2, nf) m, of both labels as they are."""
        return np.stack([self.compute_cost(a, a, (b,)), self.compute_cost(b, b, (a,))])

    def compute_swapped(self, a: str, b: str) -> Array:
        """(2, nf) m, of both labels exchanged."""
        return np.stack([self.compute_cost(a, b, (b,)), self.compute_cost(b, a, (a,))])


def find_swaps_by_lengths(recording: Recording, templates: Templates) -> Iterator[SwappedLabels]:
    """Exchanges that the lengths within segments show."""
    lengths, seen = _Lengths(recording, templates, ARMS), find_visible(recording.markers)
    strange = {
        m: np.nan_to_num(lengths.compute_cost(m, m, ())) > STRANGE_M for m in lengths.segment_of
    }
    doubted = [m for m, frames in strange.items() if frames.sum() >= SHORTEST]
    for a, b in combinations(doubted, 2):
        both = strange[a] & strange[b]
        if both.sum() >= SHORTEST:
            present, other = (
                lengths.compute_present(a, b),
                lengths.compute_swapped(a, b),
            )  # comparisons with NaN are false
            marked = _drop_short_runs(both & (other.sum(axis=0) < FAR_BELOW * present.sum(axis=0)))
            # a third marker that is elsewhere makes a wrong exchange cheaper, and no exchange right
            if marked.any() and np.median(other.max(axis=0)[marked]) < STRANGE_M:
                yield SwappedLabels(a, b, marked, True)
    for a in doubted:
        for b in lengths.segment_of:
            unseen = ~seen[:, lengths.place[b]] & strange[a]
            if b == a or unseen.sum() < SHORTEST:
                continue
            other = lengths.compute_cost(b, a, (a,), FEWEST_OTHERS)
            most = np.minimum(
                FAR_BELOW * np.nan_to_num(lengths.compute_cost(a, a, (b,))), STRANGE_M
            )
            marked = _drop_short_runs(unseen & (np.nan_to_num(other, nan=np.inf) < most))
            if marked.any():
                yield SwappedLabels(a, b, marked, False)


def _drop_short_runs(marked: BoolArray) -> BoolArray:
    """(nf,) the marked frames without stretches shorter than SHORTEST."""
    out = np.zeros_like(marked)
    for run in find_runs(marked, SHORTEST):
        out[run] = True
    return out


def find_swaps_by_jumps(
    recording: Recording, templates: Templates, noise: PointNoise | None
) -> Iterator[SwappedLabels]:
    """Exchanges that happen from one frame to the next, or within a short gap; lengths tell which
    side is right.

    Where lengths do not tell (the two are alike in their distances to the others), the shorter side
    is the wrong one.
    """
    lengths, keeps_lengths = _Lengths(recording, templates), noise is None
    for (a, b), times in _find_crossings(recording, noise).items():
        frames = np.zeros(len(recording.time), dtype=bool)
        for start, stop in zip_longest(times[::2], times[1::2], fillvalue=len(frames)):
            frames[start:stop] = True
        first, second = recording.labels[a], recording.labels[b]
        present = other = np.full(len(frames), np.nan)
        if first in lengths.segment_of and second in lengths.segment_of:
            present, other = (
                cost(first, second).sum(axis=0)
                for cost in (lengths.compute_present, lengths.compute_swapped)
            )
        excess = present - other
        gain = float(np.nansum(np.where(frames, excess, -excess))) / max(
            int(np.isfinite(excess).sum()), 1
        )
        if gain < -DECISIVE_M or (gain < DECISIVE_M and frames.mean() > 0.5):
            frames = ~frames
        # of many jumps one that is missed puts all after it on the wrong side, which lengths show
        # frame by frame; not between two segments, whose other markers may be exchanged as well
        if keeps_lengths and lengths.segment_of.get(first, "") == lengths.segment_of.get(second):
            frames |= (present > 2.0 * STRANGE_M) & (other < FAR_BELOW * present)
            frames &= ~((other > 2.0 * STRANGE_M) & (present < FAR_BELOW * other))
        if frames.any():
            with np.errstate(invalid="ignore"):
                sure = bool(np.nansum(other[frames]) < FAR_BELOW * np.nansum(present[frames]))
            yield SwappedLabels(first, second, frames, True, sure or not keeps_lengths)


def _find_crossings(
    recording: Recording, noise: PointNoise | None
) -> dict[tuple[int, int], list[int]]:
    """Pairs of columns -> frames at which one comes to where the other was, and the other way
    round.
    """
    x = recording.markers
    out: dict[tuple[int, int], list[int]] = {}
    if len(x) < 3:
        return out
    before = _hold_last_position(x, max(1, round(BRIDGED_S * recording.rate)))[:-1]
    length = np.linalg.norm(x[1:] - before, axis=2)
    jumping = np.nan_to_num(length) > max(compute_jump_limit(recording, noise), JUMP_M)
    for t in np.flatnonzero(jumping.sum(axis=1) >= 2):
        for a, b in combinations(np.flatnonzero(jumping[t]).tolist(), 2):
            crossed = np.linalg.norm(x[t + 1, a] - before[t, b]) + np.linalg.norm(
                x[t + 1, b] - before[t, a]
            )
            if crossed < FAR_BELOW * (length[t, a] + length[t, b]):
                out.setdefault((a, b), []).append(int(t) + 1)
    return out


def _hold_last_position(x: Array, most: int) -> Array:
    """(nf, nm, 3) positions, gaps filled with the last one for at most `most` frames."""
    frame = np.arange(len(x))[:, None]
    last = np.maximum.accumulate(np.where(np.isfinite(x).all(axis=2), frame, -1), axis=0)
    filled = np.take_along_axis(x, np.maximum(last, 0)[:, :, None], axis=0)
    return np.where(((last >= 0) & (frame - last <= most))[:, :, None], filled, np.nan)
