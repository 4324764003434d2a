"""Exchanged labels: found by lengths, by jumps and by sides; exchanged back; told.

By lengths: d0(a, c) is the distance of markers a and c of one segment in the static posture. A
trajectory y under the
label a costs  E_a(y) = mean_c | |y - x_c| - d0(a, c) |  over the others c of its segment. Labels a and b are exchanged
where E_a(x_b) + E_b(x_a) is far below E_a(x_a) + E_b(x_b), and neither term is more than skin
makes; a has taken the place of a marker b that is not seen where E_b(x_a) is far below E_a(x_a). By
jumps: from one frame to the next a goes where b was, and b where a was. By sides: right markers lie
to the left of their left namesakes, seen along the pelvis.

Lengths are no evidence in arms: the humerus and the radius turn under the skin by up to a right
angle, so that the two epicondyles, or the two sides of the wrist, come to where the other should
be. They are judged by jumps alone.

Exchanges that the shape of a whole trial shows are one of the causes of `contradiction.py`, those
of the static trial one of `static_landmarks.py`, those that only a fit shows one of `after_fit.py`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, zip_longest

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Code, Finding, Severity, listed
from gaitcal.io.recording import Recording, find_runs, format_spans, measure_duration
from gaitcal.model import linkage, rebuilt_markers
from gaitcal.preprocess.trial_evidence import NEGLIGIBLE_WEIGHT, TrialEvidence
from gaitcal.runtime import remembered

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
# Longer than a filter bridges: angles of the segment are wrong by tens of degrees for so long
LONG_S = 0.05
SHORTEST = 3  # Frames of a stretch in which lengths say that labels are exchanged
WRONG_SIDE_M = 0.02  # How far a right marker may lie to the left of its left one, as feet may cross
# The same in most frames of an isolated trial, in which one leg may be held across the other
CROSSED_M = 0.06
LEGS = ("thigh", "shank", "foot")
MOST_OF_A_PART = 0.5  # Share of the frames: of more, the labels are exchanged in the file


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


def exchanged(trial: TrialEvidence) -> Iterator[Finding]:
    """Labels exchanged for a part of the trial, or for all of it."""
    read = trial if trial.as_read is None else trial.with_recording(trial.as_read)
    back = [] if read is trial else _restored(read)[1]
    for k, found in enumerate((*back, *exchanges(trial))):
        count = int(found.frames.sum())
        what = (
            "carry each other's label"
            if found.mutual
            else "are confused: the first is where the second should be"
        )
        message = f"'{found.label}' and '{found.other}' {what} in {count} frames, "
        message += format_spans(trial.recording.time, find_runs(found.frames))
        severity, cure = (
            Severity.ERROR,
            "label that part again, or leave it out with time = [start, end]",
        )
        if k < len(back):
            severity, cure = (
                Severity.INFO,
                "exchanged back; label that part again, so that other programs have it right",
            )
        elif max(trial.weight(found.label), trial.weight(found.other)) <= NEGLIGIBLE_WEIGHT:
            severity = Severity.INFO
            cure = (
                "no harm done, as both have little weight or none; label that part again to use "
                "them"
            )
        elif count / max(int(trial.seen[:, trial.place[found.label]].sum()), 1) > MOST_OF_A_PART:
            cure = "exchange the two labels in the file"
        elif not _harmful(trial, found):
            severity = Severity.WARNING
        code = Code.EXCHANGED_BACK if k < len(back) else Code.EXCHANGED_LABELS
        weight = 1.0 if severity is Severity.INFO else float(count)
        yield trial.finding(severity, "exchanged", message, cure, weight=weight, code=code)


def _of_a_part(trial: TrialEvidence, found: SwappedLabels) -> bool:
    """Whether both labels are right for most of the time, so that their exchange for a part can be
    undone.
    """
    seen = max(int(trial.seen[:, trial.place[found.label]].sum()), 1)
    return found.mutual and found.sure and int(found.frames.sum()) <= MOST_OF_A_PART * seen


def _harmful(trial: TrialEvidence, found: SwappedLabels) -> bool:
    """Whether a part of the trial turns a segment of the pelvis or legs by it: two full markers,
    for some time.
    """
    if min(map(trial.weight, (found.label, found.other))) <= NEGLIGIBLE_WEIGHT:
        return False
    of_legs = {
        label for s in linkage.LOWER_BODY if s in trial.templates for label in trial.templates[s][0]
    }
    longest = max(measure_duration(trial.recording.time, run) for run in find_runs(found.frames))
    return {found.label, found.other} <= of_legs and longest >= LONG_S


@remembered
def exchanges(trial: TrialEvidence) -> tuple[SwappedLabels, ...]:
    """Pairs of labels that are exchanged somewhere, each once."""
    found: dict[frozenset[str], SwappedLabels] = {}
    for exchange in by_lengths(trial) if _keeps_lengths(trial) else ():
        pair = frozenset((exchange.label, exchange.other))
        known = found.get(pair)
        if known is None or (exchange.mutual and not known.mutual):
            found[pair] = exchange
        if known is not None:
            found[pair] = replace(found[pair], frames=known.frames | exchange.frames)
    found |= {
        frozenset((exchange.label, exchange.other)): exchange for exchange in by_jumps(trial)
    }  # frame by frame
    return tuple(found.values())


def _keeps_lengths(trial: TrialEvidence) -> bool:
    """Whether lengths within segments can show swapped labels: those of key points change by
    centimetres.
    """
    return trial.marker_set.noise is None


def undone(trial: TrialEvidence) -> TrialEvidence:
    """The trial with all exchanges undone, so that only what else is wrong with it is seen; itself
    where there are none.
    """
    return _without(trial, exchanges(trial))


def put_back(trial: TrialEvidence) -> TrialEvidence:
    """The moving trial as it is fitted: labels that carry each other's marker for a part of it
    exchanged back.

    Three markers of a segment of which two are exchanged are a mirror image, and least squares
    turns the segment round; no weight can repair that.
    """
    mended, found = (trial, []) if trial.is_static else _restored(trial)
    return replace(mended, as_read=trial.recording) if found else trial


def _restored(trial: TrialEvidence) -> tuple[TrialEvidence, list[SwappedLabels]]:
    """The trial with exchanges of a part undone until none is left, and these; itself where that
    cannot be done.
    """
    mended, done = trial, list[SwappedLabels]()
    while found := exchanges(mended):
        if len(done) > len(trial.place) or not all(_of_a_part(mended, one) for one in found):
            return trial, []
        mended, done = _without(mended, found), [*done, *found]
    return mended, done


def _without(trial: TrialEvidence, found: Sequence[SwappedLabels]) -> TrialEvidence:
    before = trial.recording.markers
    markers = before.copy()
    for one in found:
        a, b = trial.place[one.label], trial.place[one.other]
        markers[one.frames, b] = before[one.frames, a]
        markers[one.frames, a] = before[one.frames, b] if one.mutual else np.nan
    return trial.with_markers(markers) if found else trial


class _Lengths:
    """E of trajectories in the segments of some templates."""

    def __init__(self, trial: TrialEvidence, without: tuple[str, ...] = ()) -> None:
        self._trial = trial
        self.segment_of = {
            label: segment
            for segment, (labels, _) in trial.templates.items()
            for label in labels
            if not without or not segment.startswith(without)
        }

    def cost(self, label: str, trajectory: str, without: tuple[str, ...], fewest: int = 1) -> Array:
        """(nf,) m, E_label(trajectory) over the others of the segment, `without` some; NaN where
        fewer are seen than `fewest`.
        """
        labels, local = self._trial.templates[self.segment_of[label]]
        here, place = labels.index(label), self._trial.place
        others = [k for k, other in enumerate(labels) if k != here and other not in without]
        x = self._trial.recording.markers
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

    def present(self, a: str, b: str) -> Array:
        """(2, nf) m, of both labels as they are."""
        return np.stack([self.cost(a, a, (b,)), self.cost(b, b, (a,))])

    def exchanged(self, a: str, b: str) -> Array:
        """(2, nf) m, of both labels exchanged."""
        return np.stack([self.cost(a, b, (b,)), self.cost(b, a, (a,))])


def by_lengths(trial: TrialEvidence) -> Iterator[SwappedLabels]:
    """Exchanges that the lengths within segments show."""
    trial = trial.as_fitted
    lengths = _Lengths(trial, ARMS)
    strange = {m: np.nan_to_num(lengths.cost(m, m, ())) > STRANGE_M for m in lengths.segment_of}
    doubted = [m for m, frames in strange.items() if frames.sum() >= SHORTEST]
    for a, b in combinations(doubted, 2):
        both = strange[a] & strange[b]
        if both.sum() >= SHORTEST:
            present, other = (
                lengths.present(a, b),
                lengths.exchanged(a, b),
            )  # comparisons with NaN are false
            marked = _long_enough(both & (other.sum(axis=0) < FAR_BELOW * present.sum(axis=0)))
            # a third marker that is elsewhere makes a wrong exchange cheaper, and no exchange right
            if marked.any() and np.median(other.max(axis=0)[marked]) < STRANGE_M:
                yield SwappedLabels(a, b, marked, True)
    for a in doubted:
        for b in lengths.segment_of:
            unseen = ~trial.seen[:, trial.place[b]] & strange[a]
            if b == a or unseen.sum() < SHORTEST:
                continue
            other = lengths.cost(b, a, (a,), FEWEST_OTHERS)
            most = np.minimum(FAR_BELOW * np.nan_to_num(lengths.cost(a, a, (b,))), STRANGE_M)
            marked = _long_enough(unseen & (np.nan_to_num(other, nan=np.inf) < most))
            if marked.any():
                yield SwappedLabels(a, b, marked, False)


def _long_enough(marked: BoolArray) -> BoolArray:
    """(nf,) the marked frames without stretches shorter than SHORTEST."""
    out = np.zeros_like(marked)
    for run in find_runs(marked, SHORTEST):
        out[run] = True
    return out


def by_jumps(trial: TrialEvidence) -> Iterator[SwappedLabels]:
    """Exchanges that happen from one frame to the next, or within a short gap; lengths tell which
    side is right.

    Where lengths do not tell (the two are alike in their distances to the others), the shorter side
    is the wrong one.
    """
    trial = trial.as_fitted
    lengths = _Lengths(trial)
    for (a, b), times in _crossings(trial).items():
        frames = np.zeros(len(trial.seen), dtype=bool)
        for start, stop in zip_longest(times[::2], times[1::2], fillvalue=len(frames)):
            frames[start:stop] = True
        first, second = trial.recording.labels[a], trial.recording.labels[b]
        present = other = np.full(len(frames), np.nan)
        if first in lengths.segment_of and second in lengths.segment_of:
            present, other = (
                cost(first, second).sum(axis=0) for cost in (lengths.present, lengths.exchanged)
            )
        excess = present - other
        gain = float(np.nansum(np.where(frames, excess, -excess))) / max(
            int(np.isfinite(excess).sum()), 1
        )
        if gain < -DECISIVE_M or (gain < DECISIVE_M and frames.mean() > 0.5):
            frames = ~frames
        # of many jumps one that is missed puts all after it on the wrong side, which lengths show
        # frame by frame; not between two segments, whose other markers may be exchanged as well
        if _keeps_lengths(trial) and lengths.segment_of.get(first, "") == lengths.segment_of.get(
            second
        ):
            frames |= (present > 2.0 * STRANGE_M) & (other < FAR_BELOW * present)
            frames &= ~((other > 2.0 * STRANGE_M) & (present < FAR_BELOW * other))
        if frames.any():
            with np.errstate(invalid="ignore"):
                sure = bool(np.nansum(other[frames]) < FAR_BELOW * np.nansum(present[frames]))
            yield SwappedLabels(first, second, frames, True, sure or not _keeps_lengths(trial))


def _crossings(trial: TrialEvidence) -> dict[tuple[int, int], list[int]]:
    """Pairs of columns -> frames at which one comes to where the other was, and the other way
    round.
    """
    x = trial.recording.markers
    out: dict[tuple[int, int], list[int]] = {}
    if len(x) < 3:
        return out
    before = _last_seen(x, max(1, round(BRIDGED_S * trial.recording.rate)))[:-1]
    length = np.linalg.norm(x[1:] - before, axis=2)
    jumping = np.nan_to_num(length) > max(
        rebuilt_markers.jump_limit(trial.recording, trial.marker_set.noise), JUMP_M
    )
    for t in np.flatnonzero(jumping.sum(axis=1) >= 2):
        for a, b in combinations(np.flatnonzero(jumping[t]).tolist(), 2):
            crossed = np.linalg.norm(x[t + 1, a] - before[t, b]) + np.linalg.norm(
                x[t + 1, b] - before[t, a]
            )
            if crossed < FAR_BELOW * (length[t, a] + length[t, b]):
                out.setdefault((a, b), []).append(int(t) + 1)
    return out


def _last_seen(x: Array, most: int) -> Array:
    """(nf, nm, 3) positions, gaps filled with the last one for at most `most` frames."""
    frame = np.arange(len(x))[:, None]
    last = np.maximum.accumulate(np.where(np.isfinite(x).all(axis=2), frame, -1), axis=0)
    filled = np.take_along_axis(x, np.maximum(last, 0)[:, :, None], axis=0)
    return np.where(((last >= 0) & (frame - last <= most))[:, :, None], filled, np.nan)


def sides(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether right markers lie to the right of their left ones, seen along the pelvis."""
    if trial.pelvis is None:
        return
    wrong: list[str] = []
    when: list[slice] = []
    farthest = 0.0
    for name, other in _namesakes(trial):
        lateral = np.einsum(
            "fi,fi->f", trial.path(name) - trial.path(other), trial.pelvis.rotation[:, :, 2]
        )
        known = np.isfinite(lateral) & trial.pelvis.determined
        bad = known & (lateral < -WRONG_SIDE_M)
        if known.sum() >= 3 and bad.sum() > 0.5 * known.sum():
            away = -float(np.median(lateral[bad]))
            wrong.append(f"'{name}' and '{other}' by {1e3 * away:.0f} mm")
            farthest = max(farthest, away)
            when = find_runs(bad)
    if wrong:
        crossed = trial.is_isolated and farthest < CROSSED_M
        yield trial.finding(
            Severity.WARNING if crossed else Severity.ERROR,
            "sides",
            f"right markers lie to the left of their left ones: {listed(wrong)} "
            f"({format_spans(trial.recording.time, when)})",
            "exchange the labels of right and left in the file",
            cause="" if crossed else "right and left are exchanged in the labels",
            weight=10.0,
            code=Code.SIDES_EXCHANGED,
        )


def _namesakes(trial: TrialEvidence) -> Iterator[tuple[str, str]]:
    """Markers of the right side of pelvis and legs that have a namesake on the left, in this trial."""
    tracking = trial.marker_set.tracking
    pairs = [*permutations(tracking.get("pelvis", ()), 2)]
    for segment in LEGS:
        # A built-in pattern with {S} or {s} gives both sides in one order; a user's own lists may
        # differ.
        pairs += zip(
            tracking.get(f"{segment}_r", ()), tracking.get(f"{segment}_l", ()), strict=False
        )
    yield from (
        (a, b) for a, b in pairs if a in trial.place and b in trial.place and is_right_of(a, b)
    )


def is_right_of(a: str, b: str) -> bool:
    """Whether two labels differ only by R and L at one place."""
    different = [(x, y) for x, y in zip(a.lower(), b.lower(), strict=False) if x != y]
    return len(a) == len(b) and different == [("r", "l")]


def sides_exchanged(recording: Recording) -> Recording:
    """The recording with every label that names a side given to its namesake."""
    labels = recording.labels
    other = {a: b for a in labels for b in labels if is_right_of(a, b) or is_right_of(b, a)}
    return replace(recording, labels=tuple(other.get(label, label) for label in labels))
