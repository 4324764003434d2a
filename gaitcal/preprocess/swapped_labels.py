"""Find labels that are swapped for a while, by lengths within segments and by jumps.

*By lengths.* d0(a, c) is the distance of markers a and c of one segment in the static posture. A
trajectory y under the label a has the cost

    E_a(y) = mean_c | |y - x_c| - d0(a, c) |      over the other markers c of its segment.

Labels a and b are swapped if E_a(x_b) + E_b(x_a) is far below E_a(x_a) + E_b(x_b), and neither term
is larger than skin movement. Marker a is at the position of a marker b that is not visible if
E_b(x_a) is far below E_a(x_a). *By jumps.* From one frame to the next a goes where b was, and b
where a was.

Lengths are no evidence in arms: humerus and radius rotate under the skin by up to a right angle, so
that each epicondyle, or side of the wrist, comes to where the other one should be. Arms are judged
by jumps alone.

Swaps that the shape of a whole trial shows are one of the causes of `static_disagreement.py`. The
room `quality` reports swapped sides, swaps in the static trial (`static_landmarks.py`), and those
that only a fit shows (`after_fit.py`).
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

STRANGE_M = 0.02
"""m, cost E above which a label is doubted; skin movement stays below it in most frames."""
FAR_BELOW = 0.5
"""Largest cost of the swapped labels as a share of the present cost."""
DECISIVE_M = 0.003
"""m, mean difference of cost from which lengths decide which side of a jump is right."""
BRIDGED_S = 0.1
"""s, longest gap in which two markers may be swapped."""
JUMP_M = 0.03
"""m, smallest jump of a swapped marker."""
ARMS = ("upper_arm", "forearm_hand")
FEWEST_OTHERS = 2
"""Others of the segment that must be visible to find a marker at the position of one that is not
visible: many positions have the same distance from one marker."""
SHORTEST = 3
"""Fewest consecutive frames in which lengths show a swap."""


@dataclass(frozen=True)
class SwappedLabels:
    """Two labels, and the frames in which the first one carries the other's marker."""

    label: str
    other: str
    frames: BoolArray
    """(nf,)."""
    mutual: bool
    """False if the other marker is not visible meanwhile."""
    sure: bool = True
    """Whether lengths within segments confirm it: jumps alone may miss the end of a swap."""


def find_swapped_labels(
    recording: Recording, templates: Templates, noise: PointNoise | None
) -> tuple[SwappedLabels, ...]:
    """Find pairs of labels that are swapped in some frames.

    Parameters
    ----------
    recording
        Marker positions of a trial.
    templates
        Segment -> labels of the recording on it, and their positions (nm, 3) m in the static
        posture.
    noise
        Of the marker set, if its points are markerless: lengths between those change by centimetres
        and are no evidence.

    Returns
    -------
    tuple of SwappedLabels
        Each pair once.
    """
    found: dict[frozenset[str], SwappedLabels] = {}
    for swap in find_swaps_by_lengths(recording, templates) if noise is None else ():
        pair = frozenset((swap.label, swap.other))
        known = found.get(pair)
        if known is None or (swap.mutual and not known.mutual):
            found[pair] = swap
        if known is not None:
            found[pair] = replace(found[pair], frames=known.frames | swap.frames)
    # jumps are exact to the frame: they replace intervals by lengths
    for swap in find_swaps_by_jumps(recording, templates, noise):
        found[frozenset((swap.label, swap.other))] = swap
    return tuple(found.values())


def restore_labels(recording: Recording, found: Sequence[SwappedLabels]) -> Recording:
    """Undo swaps of labels.

    Parameters
    ----------
    recording
        Marker positions of a trial.
    found
        Swaps in it.

    Returns
    -------
    Recording
        With the markers under their labels; itself if there are no swaps.
    """
    if not found:
        return recording
    before, column = recording.markers, {label: i for i, label in enumerate(recording.labels)}
    markers = before.copy()
    for swap in found:
        a, b = column[swap.label], column[swap.other]
        markers[swap.frames, b] = before[swap.frames, a]
        markers[swap.frames, a] = before[swap.frames, b] if swap.mutual else np.nan
    return replace(recording, markers=markers)


class _Lengths:
    """Costs E of trajectories in the segments of templates, but those that begin with `without`."""

    def __init__(
        self, recording: Recording, templates: Templates, without: tuple[str, ...] = ()
    ) -> None:
        self._markers, self._templates = recording.markers, templates
        self.column = {label: i for i, label in enumerate(recording.labels)}
        self.segment_of = dict[str, str]()
        for segment, (labels, _) in templates.items():
            if not without or not segment.startswith(without):
                self.segment_of |= dict.fromkeys(labels, segment)

    def compute_cost(
        self, label: str, trajectory: str, without: tuple[str, ...], fewest: int = 1
    ) -> Array:
        """Compute (nf,) m, E_label(trajectory), `without` some; NaN with fewer than `fewest`."""
        labels, local = self._templates[self.segment_of[label]]
        row, column = labels.index(label), self.column
        others = [k for k, other in enumerate(labels) if k != row and other not in without]
        x = self._markers
        if not others:
            return np.full(len(x), np.nan)
        vectors = x[:, [column[labels[k]] for k in others]] - x[:, [column[trajectory]]]
        static = np.linalg.norm(local[others] - local[row], axis=1)
        errors = np.abs(np.linalg.norm(vectors, axis=2) - static)
        known = np.isfinite(errors)
        count = known.sum(axis=1)
        total = np.where(known, errors, 0.0).sum(axis=1)
        return np.where(count >= fewest, total / np.maximum(count, 1), np.nan)

    def compute_present(self, a: str, b: str) -> Array:
        """Compute (2, nf) m, the costs of both labels as they are."""
        return np.stack([self.compute_cost(a, a, (b,)), self.compute_cost(b, b, (a,))])

    def compute_swapped(self, a: str, b: str) -> Array:
        """Compute (2, nf) m, the costs of both labels swapped."""
        return np.stack([self.compute_cost(a, b, (b,)), self.compute_cost(b, a, (a,))])


def find_swaps_by_lengths(recording: Recording, templates: Templates) -> Iterator[SwappedLabels]:
    """Find swaps that the lengths within segments show.

    `templates`: segment -> labels of the recording on it, and their positions (nm, 3) m in the
    static posture.
    """
    lengths, visible = _Lengths(recording, templates, ARMS), find_visible(recording.markers)
    strange = {
        m: np.nan_to_num(lengths.compute_cost(m, m, ())) > STRANGE_M for m in lengths.segment_of
    }
    doubted = [m for m, frames in strange.items() if frames.sum() >= SHORTEST]
    for a, b in combinations(doubted, 2):
        both = strange[a] & strange[b]
        if both.sum() >= SHORTEST:
            # comparisons with NaN are false
            present, other = lengths.compute_present(a, b), lengths.compute_swapped(a, b)
            marked = _drop_short_runs(both & (other.sum(axis=0) < FAR_BELOW * present.sum(axis=0)))
            # a third, displaced marker makes a wrong swap cheaper, but not right
            if marked.any() and np.median(other.max(axis=0)[marked]) < STRANGE_M:
                yield SwappedLabels(a, b, marked, True)
    for a in doubted:
        for b in lengths.segment_of:
            # frames in which only a is visible
            alone = ~visible[:, lengths.column[b]] & strange[a]
            if b == a or alone.sum() < SHORTEST:
                continue
            other = lengths.compute_cost(b, a, (a,), FEWEST_OTHERS)
            most = np.minimum(
                FAR_BELOW * np.nan_to_num(lengths.compute_cost(a, a, (b,))), STRANGE_M
            )
            marked = _drop_short_runs(alone & (np.nan_to_num(other, nan=np.inf) < most))
            if marked.any():
                yield SwappedLabels(a, b, marked, False)


def _drop_short_runs(marked: BoolArray) -> BoolArray:
    """Return the marked frames (nf,) without runs shorter than SHORTEST."""
    out = np.zeros_like(marked)
    for run in find_runs(marked, SHORTEST):
        out[run] = True
    return out


def find_swaps_by_jumps(
    recording: Recording, templates: Templates, noise: PointNoise | None
) -> Iterator[SwappedLabels]:
    """Find swaps from one frame to the next, or within a short gap.

    Lengths decide which side of a jump is right. If they do not, as the two have similar distances
    from the others, the shorter side is the wrong one.

    `templates`: segment -> labels of the recording on it, and their positions (nm, 3) m in the
    static posture. `noise`: of the marker set, if its points are markerless.
    """
    lengths, keeps_lengths = _Lengths(recording, templates), noise is None
    for (a, b), times in _find_crossings(recording, noise).items():
        frames = np.zeros(len(recording.time), dtype=bool)
        for start, stop in zip_longest(times[::2], times[1::2], fillvalue=len(frames)):
            frames[start:stop] = True
        first, second = recording.labels[a], recording.labels[b]
        present = other = np.full(len(frames), np.nan)
        if first in lengths.segment_of and second in lengths.segment_of:
            present = lengths.compute_present(first, second).sum(axis=0)
            other = lengths.compute_swapped(first, second).sum(axis=0)
        excess = present - other
        gain = float(np.nansum(np.where(frames, excess, -excess))) / max(
            int(np.isfinite(excess).sum()), 1
        )
        if gain < -DECISIVE_M or (gain < DECISIVE_M and frames.mean() > 0.5):
            frames = ~frames
        # after a jump that was missed all frames are on the wrong side, which lengths show frame
        # by frame; not between two segments, whose other markers may be swapped as well
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
    """Find pairs of columns -> frames at which each one comes to where the other one was."""
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
    """Fill gaps of positions (nf, nm, 3) with the last one for at most `most` frames."""
    frame = np.arange(len(x))[:, None]
    last = np.maximum.accumulate(np.where(np.isfinite(x).all(axis=2), frame, -1), axis=0)
    filled = np.take_along_axis(x, np.maximum(last, 0)[:, :, None], axis=0)
    return np.where(((last >= 0) & (frame - last <= most))[:, :, None], filled, np.nan)
