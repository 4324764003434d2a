"""Whether skin moves with a joint: what the deformation of a segment's markers says, joint parameters left out.

What the rigid fit of a segment leaves of its markers, e (in the segment's axes), does not depend on joints at all. With
P the projector that takes shifts and turns of the markers together out, and phi_c the angles of the columns z,

    e = P sum_c z_c phi_c + noise,      information Q = sum_f phi phi^T (x) P / nu^2,   b = sum_f phi (x) P e / nu^2,

nu the noise that no angle explains, its frames counted as far as they are independent (`joint_noise.py`). With the
prior z ~ N(0, s^2 C) of each angle, the sizes s of a segment have the evidence (marginal likelihood, z integrated out)

    2 log L(s) = b^T (Q + C_s^-1)^-1 b - log det(1 + C_s Q).

An angle is taken in where skin that moves with it is likelier than skin that does not, the likeliest first: where 2
log L rises by more than `LIKELIER`. Asking for strong evidence (6) left skin out that slower noise half hid, and hips
then covered 73 instead of 92 % of 95. Markers that slide but do not deform stay unseen.

One marker or two, or three on a line or never seen together, show no deformation: there skin has the size that fits
believe at most (`LARGEST`). Taken to be still, two-marker thighs made intervals of 95 % for hips hold 86 % on two
people of OpenSim whose skin follows their joints, and 87 % of differences between straight walks and turns of four
children; so, 94 and 98 %, and 93 %. Their hips come a quarter nearer; those of clean people part by a tenth.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.joint_noise import LEAST_SAMPLES, frames_per_sample, least_noise
from gaitcal.calibration.skin_movement import LARGEST, shifts_and_turns, unit_covariance
from gaitcal.findings import listed
from gaitcal.motion.rigid import FEWEST_MARKERS, rigid_fit
from gaitcal.motion.soft_tissue import SegmentTissue
from gaitcal.motion.trial_problem import TrialProblem

LIKELIER = 0.5
"""Least rise of twice the log evidence."""
GRID = np.array([0.02, 0.05, 0.1, 0.2, 0.35, LARGEST])
"""Sizes looked at."""
LET_GO = 0.5
"""Part of its own weight below which a loss let a marker go, and of the frames below which one is seldom seen, and left
aside where three others are seen more often."""
SEEN_RANK = 1e-9
"""Part of the largest diagonal entry of a QR factor below which an angle adds nothing to those before it."""


@dataclass
class SegmentEvidence:
    """What all trials together say of one segment's skin."""

    names: list[str] = field(default_factory=list)
    """Coordinates, in the order of the blocks."""
    information: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(n, n) Q, coordinate by coordinate, of each marker by marker, of each x, y, z; 1/m^2 per unit of z."""
    right: Array = field(default_factory=lambda: np.zeros(0))
    """(n,) b."""

    def add(self, names: Sequence[str], information: Array, right: Array, width: int) -> None:
        """Add what one trial says; `width`: columns of one coordinate."""
        new = [name for name in names if name not in self.names]
        self.names += new
        grown, before = np.zeros((width * len(self.names),) * 2), len(self.right)
        grown[:before, :before] = self.information
        place = np.concatenate([width * self.names.index(name) + np.arange(width) for name in names])
        grown[np.ix_(place, place)] += information
        self.information = grown
        self.right = np.concatenate([self.right, np.zeros(width * len(new))])
        self.right[place] += right

    def sizes(self, covariance: Array) -> dict[str, float]:
        """Coordinate -> size of the skin's movement with it, of those that the evidence asks for; `covariance`: that of
        one angle's columns at size 1.
        """
        root = np.kron(np.eye(len(self.names)), np.linalg.cholesky(covariance))
        seen, right = root.T @ self.information @ root, root.T @ self.right
        chosen, reached = dict[str, float](), 0.0
        while True:
            best = max(((*self._best(seen, right, chosen, n), n) for n in self.names if n not in chosen), default=None)
            if best is None or best[0] < reached + LIKELIER:
                break
            reached, chosen[best[2]] = best[0], best[1]
        for name in chosen:  # each once more, given the others
            _, chosen[name] = self._best(seen, right, {n: size for n, size in chosen.items() if n != name}, name)
        return chosen

    def _best(self, seen: Array, right: Array, others: Mapping[str, float], name: str) -> tuple[float, float]:
        """2 log L against no skin at all, and the size of one coordinate that makes it largest, `others` having theirs;
        `seen` and `right`: Q and b by columns of unit variance.
        """
        width = len(right) // len(self.names)
        place = np.concatenate([width * self.names.index(n) + np.arange(width) for n in (*others, name)])
        scale = np.repeat([[*others.values(), size] for size in GRID], width, axis=1)
        within = scale[:, :, None] * seen[np.ix_(place, place)] * scale[:, None, :]
        factor = np.linalg.cholesky(np.eye(len(place)) + within)
        explained = np.linalg.solve(factor, (scale * right[place])[:, :, None])[:, :, 0]
        values = (explained**2).sum(axis=1) - 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        best = int(np.argmax(values))
        return float(values[best]), float(GRID[best])


@dataclass(frozen=True)
class SkinSizes:
    """How far skin moves with joints."""

    sizes: Mapping[tuple[str, str], float]
    """(segment, coordinate) -> size, of the spread that skin has (`skin_movement.py`)."""
    hidden: frozenset[str]
    """Segments that no trial shows the deformation of: there it was assumed."""


@dataclass(frozen=True)
class SkinFound:
    """Skin that moves with joints, as it was fitted to the legs' markers."""

    believed: SkinSizes
    keys: tuple[str, ...]
    values: Array
    """(nz,) m/rad."""


NO_SKIN_FOUND = SkinFound(SkinSizes({}, frozenset()), (), np.zeros(0))


def skin_sizes(trials: Sequence[TrialProblem]) -> SkinSizes:
    """Sizes of the skin's movement from the deformation of the markers of trials whose soft tissue holds every column
    that may be.
    """
    found: dict[tuple[str, tuple[str, ...]], tuple[SegmentEvidence, Array]] = {}
    may_move: dict[tuple[str, str], float] = {}
    shown = set()
    for problem in trials:
        for group in problem.tissue.groups if problem.tissue else ():
            segment, local = problem.chain.segments[group.segment], problem.data.local[group.markers]
            may_move |= {(segment, name): LARGEST for name in group.names}
            information, right = _deformation(problem, group)
            if not information.any():
                continue
            shown.add(segment)
            labels = problem.labels[group.markers]
            evidence, _ = found.setdefault((segment, labels), (SegmentEvidence(), unit_covariance(segment, local)))
            evidence.add(group.names, information, right, 3 * len(local))
    sizes = {(segment, name): size for (segment, name), size in may_move.items() if segment not in shown}
    hidden = frozenset(segment for segment, _ in sizes)
    for (segment, _), (evidence, covariance) in found.items():
        for name, size in evidence.sizes(covariance).items():
            sizes[segment, name] = max(size, sizes.get((segment, name), 0.0))
    return SkinSizes(sizes, hidden)


def skin_in_words(sizes: Mapping[tuple[str, str], float], hidden: Collection[str] = ()) -> tuple[str, ...]:
    """One sentence on the skin that was found to move, segment by segment, and one on the segments where it is
    `hidden` and was assumed; nothing where there is none.
    """
    by_segment: dict[str, list[float]] = {}
    for (segment, _), size in sizes.items():
        by_segment.setdefault(segment, []).append(100.0 * size)
    told = [
        f"{segment} by {min(percent):.0f}{f' to {max(percent):.0f}' if max(percent) > min(percent) else ''} %"
        for segment, percent in by_segment.items()
        if segment not in hidden
    ]
    out = []
    if told:
        out.append(
            f"markers show skin that moves with the joints beside it: {', '.join(told)} of the spread that bone pins "
            "and fluoroscopy found in people; the joint parameters were fitted together with it"
        )
    if assumed := [segment for segment in by_segment if segment in hidden]:
        out.append(
            f"markers of {listed(assumed)} are too few to show how skin moves with the joints beside them: "
            f"{100.0 * LARGEST:.0f} % of the spread found in people was assumed, and the joint parameters were fitted "
            "together with it"
        )
    return tuple(out)


def _deformation(problem: TrialProblem, group: SegmentTissue) -> tuple[Array, Array]:
    """Q and b of one segment in one trial, from the markers that have weight in it."""
    data, phi = problem.data, group.regressors
    width = 3 * (group.markers.stop - group.markers.start)
    nothing = np.zeros((len(phi) * width,) * 2), np.zeros(len(phi) * width)
    given = data.weight[group.markers]
    trusted = (given > 0) & (given > LET_GO * given.max(axis=1, keepdims=True))
    often = trusted.sum(axis=1)
    third = np.sort(often)[-FEWEST_MARKERS] if len(often) >= FEWEST_MARKERS else 0  # fewer than three show nothing
    used = group.markers.start + np.flatnonzero((often > 0) & (often >= min(third, LET_GO * often.max(initial=0))))
    local, weight = data.local[used], data.weight[used]
    fit = rigid_fit(local, data.measured[used], weight)
    whole = fit.determined & trusted[used - group.markers.start].all(axis=0)
    """Frames that show all of them and trust them: in others the projector is another."""
    phi = phi[:, whole]
    if whole.sum() <= len(phi):
        return nothing
    followed = np.einsum("fij,mj->mif", fit.rotation, local) + fit.origin.T
    left = np.einsum("fij,mif->mjf", fit.rotation, data.measured[used] - followed)
    errors = left.reshape(3 * len(used), -1).T[whole]  # (frames, 3 used)
    together = np.linalg.qr(np.concatenate([shifts_and_turns(a) for a in local - local.mean(axis=0)]))[0]
    noise = _noise(errors, phi, 3 * len(used) - together.shape[1], least_noise(problem.basis))
    columns = (3 * (used - group.markers.start)[:, None] + np.arange(3)).ravel()
    projector, seen = np.zeros((width, width)), np.zeros((len(errors), width))
    projector[np.ix_(columns, columns)] = np.eye(len(columns)) - together @ together.T
    seen[:, columns] = errors
    information, right = np.kron(phi @ phi.T, projector), (phi @ seen @ projector).ravel()
    return np.asarray(information / noise**2, float), np.asarray(right / noise**2, float)


def _noise(errors: Array, phi: Array, directions: int, least: float) -> float:
    """m, nu of errors (nf, 3 nm) that no combination of the angles (nr, nf) explains."""
    q, r = np.linalg.qr(phi.T)
    own = q[:, np.abs(np.diag(r)) > SEEN_RANK * np.abs(r).max(initial=0.0)]
    unexplained = errors - own @ (own.T @ errors)
    tau = frames_per_sample(unexplained)
    samples = len(errors) / tau
    spent = samples / max(samples - own.shape[1], LEAST_SAMPLES * samples)
    variance = spent * tau * float((unexplained**2).sum()) / (max(directions, 1) * len(errors))
    return max(float(np.sqrt(variance)), least)
