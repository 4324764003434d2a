"""From a recording and a person's model to a least-squares problem: here a marker becomes a residual."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.allocator import keep_freed_memory
from gaitcal.errors import InputError
from gaitcal.model.chain import chain_of
from gaitcal.model.linkage import SEGMENTS
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.marker_residual import MarkerData
from gaitcal.motion.spline import MINIMUM_NODES, spline_basis
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.recording.recording import Recording

Array = NDArray[np.float64]

NODES_PER_SECOND = 20.0
"""Knot spans per second: a quintic spline with spans h passes frequencies up to about 0.48 / h (see `cutoff`).

Frames left out of four people's trials are predicted as well or better at 20 than at 15 in 21 of 22 cases, and hardly
better beyond (`scripts/check_nodes.py`).
"""
FRAMES_PER_SPAN = 3.0
"""Least number of frames for one span; slow cameras get longer spans."""
FEWEST_FRAMES = 12


@dataclass(frozen=True)
class NodeRule:
    """How many spline nodes a trial gets."""

    per_second: float = NODES_PER_SECOND
    fixed: int | None = None
    """A fixed number of nodes a coordinate (20 in the published protocol), whatever the length."""

    def nodes(self, time: Array) -> int:
        """Number of nodes for frames at `time` (s)."""
        if self.fixed is not None:
            return self.fixed
        spans = min(float(time[-1] - time[0]) * self.per_second, len(time) / FRAMES_PER_SPAN)
        return max(round(spans), 1) + MINIMUM_NODES - 1


def cutoff(time: Array, nodes: int) -> float:
    """Hz at which a least-squares quintic spline passes 71 % (-3 dB) of an oscillation.

    For spans h the amplitude kept at frequency f is 1 / (1 + sum_k (f h / (f h + k))^12), k = -1, 1, -2, ...
    (Unser, Aldroubi and Eden 1993): 0.4816 / h.
    """
    return 0.4816 * (nodes - MINIMUM_NODES + 1) / float(time[-1] - time[0])


def trial_problem(
    name: str,
    model: SubjectModel,
    recording: Recording,
    rule: NodeRule,
    *,
    root: str = "pelvis",
    segments: tuple[str, ...] = SEGMENTS,
) -> TrialProblem:
    """The markers of `segments` in a recording as a least-squares problem in the coordinates of that part.

    Markers that the recording lacks are left out; NaN positions get weight zero in their frames. Raises `InputError`
    where the part's root has no three markers, or the recording is too short for a spline.
    """
    keep_freed_memory()
    if len(recording.time) < FEWEST_FRAMES:
        raise InputError(
            f"found {len(recording.time)} frames; allowed: at least {FEWEST_FRAMES}", source=recording.source
        )
    at = {label: i for i, label in enumerate(recording.labels)}
    chosen = [
        i
        for i, (label, segment) in enumerate(zip(model.markers.labels, model.markers.segments, strict=True))
        if segment in segments and label in at
    ]
    chain = chain_of(root, segments)
    index = np.array([chain.segments.index(model.markers.segments[i]) for i in chosen], dtype=np.intp)
    order = np.argsort(index, kind="stable")
    chosen = [chosen[k] for k in order]
    labels = tuple(model.markers.labels[i] for i in chosen)
    measured = recording.markers[:, [at[label] for label in labels]].transpose(1, 2, 0)
    seen = np.asarray(np.isfinite(measured).all(axis=1))
    weight = np.where(seen, model.markers.weight[chosen][:, None], 0.0)
    on_root = (index[order] == 0) & (weight > 0).any(axis=1)
    if on_root.sum() < 3:
        found = ", ".join(np.array(labels)[on_root]) or "none"
        raise InputError(
            f"found {found} on {root}; allowed: at least 3 markers of {root} that are seen and have weight",
            source=recording.source,
            field="markers",
        )
    basis = spline_basis(recording.time, rule.nodes(recording.time))
    data = MarkerData(
        index[order], model.markers.local[chosen], np.ascontiguousarray(np.where(seen[:, None], measured, 0.0)), weight
    )
    return TrialProblem(name, chain, basis, data, labels)
