"""What the residuals of a finished fit say of single markers: stuck, made up, exchanged, elsewhere.

The fit joins all segments, so that it judges markers that their own segment cannot: arms, trunk, segments with one or
two markers. With r_f the distance of a marker from the model's in frame f and u its median over the trial, a marker is

    elsewhere for a while   r_f > u + limit in a stretch that begins or ends with a jump of r by half of that (skin and
                            shoulder girdles move a marker as far, but never within a frame),
    made up                 in such a stretch, or with r_f > u + half the limit, its path is a straight line,
    exchanged               in such a stretch it is nearer to where the model has another marker, and that one to it,
    displaced               u alone is far more than that of its segment and of what markers of its kind have.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.findings import Finding, Severity
from gaitcal.io.intervals import runs, spans
from gaitcal.model.linkage import LOWER_BODY

TOPIC = "markers after the fit"
LIMIT_M = 0.02
"""Residuals of clean recordings exceed their median by up to 29 mm, but never begin or end that within a frame."""
LIGHT_LIMIT_M = 0.03
"""The same for markers of trunk and arms, whose joints are crude."""
JUMP = 0.5
"""Share of its excess by which the residual changes within a frame at an end of a stretch."""
SHORTEST_FRAMES = 3
DISPLACED_M, LIGHT_DISPLACED_M = 0.05, 0.20
"""Median residual of a marker that is elsewhere throughout; clean ones reach 35 mm on legs, 136 mm on arms."""
WORSE = 3.0
"""Times the median of its segment's other markers."""
STRAIGHT_M = 2e-4
NEARER = 0.5
"""Of the present distances, from which two markers are taken as exchanged."""
FAR_M = 0.05
"""A stretch so far off is an error for a marker of full weight on pelvis and legs."""
FULL_WEIGHT = 0.5


@dataclass(frozen=True, kw_only=True)
class TrackedMarkers:
    """Markers of a tracked trial."""

    name: str
    """Of the trial."""
    time: Array
    """(nf,) s."""
    labels: tuple[str, ...]
    segments: tuple[str, ...]
    """Of each marker."""
    weight: Array
    """(nm,)."""
    measured: Array
    """(nf, nm, 3) m; NaN where not seen."""
    model: Array
    """(nf, nm, 3) m."""

    @property
    def distance(self) -> Array:
        """(nf, nm) m; NaN where not seen."""
        out: Array = np.linalg.norm(self.measured - self.model, axis=2)
        return out

    def heavy(self, k: int) -> bool:
        """Whether a marker of pelvis or legs has full weight."""
        return bool(self.segments[k] in LOWER_BODY and self.weight[k] >= FULL_WEIGHT)


def marker_findings(tracked: TrackedMarkers, told: Collection[str] = ()) -> tuple[Finding, ...]:
    """Markers whose residuals have structure, but for those of which something was `told` before the fit."""
    distance = tracked.distance
    usual = np.array([np.nanmedian(d) if np.isfinite(d).any() else np.nan for d in distance.T])
    chosen = [
        k
        for k, label in enumerate(tracked.labels)
        if tracked.weight[k] > 0 and np.isfinite(usual[k]) and label not in told
    ]
    found: list[Finding] = []
    named: set[str] = set()
    for k in sorted(chosen, key=lambda k: -float(np.nanmax(distance[:, k]) - usual[k])):
        if tracked.labels[k] in named:
            continue
        stretches = list(_stretches(distance[:, k], float(usual[k]), _limit(tracked, k)))
        if stretches:
            finding, others = _elsewhere(tracked, k, stretches, distance, float(usual[k]))
            found.append(finding)
            named |= others
    for k in chosen:
        if tracked.labels[k] not in named:
            found += _displaced(tracked, k, usual)
    return tuple(found)


def _limit(tracked: TrackedMarkers, k: int) -> float:
    return LIMIT_M if tracked.segments[k] in LOWER_BODY else LIGHT_LIMIT_M


def _stretches(distance: Array, usual: float, limit: float) -> Iterator[slice]:
    """Frames of one marker (nf,) in which it is elsewhere."""
    excess = np.nan_to_num(distance - usual)
    for run in runs(excess > limit, SHORTEST_FRAMES):
        peak = float(excess[run].max())
        ends = [abs(excess[e] - excess[e - 1]) for e in (run.start, run.stop) if 0 < e < len(excess)]
        seen = [np.isfinite(distance[e - 1 : e + 1]).all() for e in (run.start, run.stop) if 0 < e < len(excess)]
        if any(jump > JUMP * peak and known for jump, known in zip(ends, seen, strict=True)):
            yield run


def _elsewhere(
    tracked: TrackedMarkers, k: int, stretches: list[slice], distance: Array, usual: float
) -> tuple[Finding, set[str]]:
    """What became of marker k in some stretches, and the markers that are named with it."""
    label, frames = tracked.labels[k], _mask(stretches, len(distance))
    worst = float(np.nanmax(distance[frames, k]))
    other, code = _exchanged_with(tracked, k, frames), Code.MARKER_AWAY
    if other is not None:
        code = Code.EXCHANGED_LABELS
        cause = f"markers '{label}' and '{tracked.labels[other]}' carry each other's label for a while"
        cure = "label that part again, or leave it out with time = [start, end]"
    elif all(_straight(tracked.measured[s, k]) for s in stretches):
        cause = f"the path of marker '{label}' was held or drawn as a straight line over a gap"
        cure = f'export gaps as gaps, or weights = {{ "{label}" = 0 }} under [markers]'
    else:
        cause = f"marker '{label}' is elsewhere for a while"
        cure = f'label that part again, leave it out with time = [start, end], or weights = {{ "{label}" = 0 }}'
    error = tracked.heavy(k) and worst - usual > FAR_M
    finding = Finding(
        severity=Severity.ERROR if error else Severity.WARNING,
        topic=TOPIC,
        where=tracked.name,
        cause=cause,
        found=f"up to {1e3 * worst:.0f} mm from the model's marker, usually {1e3 * usual:.0f} mm "
        f"({spans(tracked.time, stretches)})",
        cure=cure,
        leg=_leg(tracked.segments[k]),
        weight=(worst - usual) / _limit(tracked, k),
        code=code,
    )
    return finding, {label} if other is None else {label, tracked.labels[other]}


def _exchanged_with(tracked: TrackedMarkers, k: int, frames: BoolArray) -> int | None:
    """The marker that marker k has changed places with in these frames; None where there is none."""
    measured, model = tracked.measured[frames], tracked.model[frames]
    present = np.linalg.norm(measured - model, axis=2)
    there = np.linalg.norm(measured[:, [k]] - model, axis=2)
    here = np.linalg.norm(measured - model[:, [k]], axis=2)
    with np.errstate(invalid="ignore"):
        ratio = np.nanmedian(there + here, axis=0) / np.nanmedian(present[:, [k]] + present, axis=0)
    ratio[k] = np.inf
    best = int(np.argmin(np.nan_to_num(ratio, nan=np.inf)))
    return best if ratio[best] < NEARER else None


def _straight(path: Array) -> bool:
    """Whether a path (n, 3) is even motion along a line, or no motion."""
    if len(path) <= SHORTEST_FRAMES or not np.isfinite(path).all():
        return False
    line = path[0] + np.linspace(0.0, 1.0, len(path))[:, None] * (path[-1] - path[0])
    return float(np.linalg.norm(path - line, axis=1).max()) < STRAIGHT_M


def _displaced(tracked: TrackedMarkers, k: int, usual: Array) -> Iterator[Finding]:
    """Marker k, if it is far from the model's all the time and others of its segment are not."""
    limit = DISPLACED_M if tracked.heavy(k) else LIGHT_DISPLACED_M
    mates = [
        usual[i]
        for i, segment in enumerate(tracked.segments)
        if i != k and segment == tracked.segments[k] and tracked.weight[i] > 0 and np.isfinite(usual[i])
    ]
    if usual[k] < limit or (mates and usual[k] < WORSE * float(np.median(mates))):
        return
    label = tracked.labels[k]
    yield Finding(
        severity=Severity.ERROR if tracked.heavy(k) else Severity.WARNING,
        topic=TOPIC,
        where=tracked.name,
        cause=f"marker '{label}' is not where the static trial has it on {tracked.segments[k]}",
        found=f"{1e3 * usual[k]:.0f} mm from the model's marker (median), throughout "
        f"{tracked.time[0]:.2f}-{tracked.time[-1]:.2f} s",
        cure=f'weights = {{ "{label}" = 0 }} under [markers], another label, or another static trial',
        leg=_leg(tracked.segments[k]),
        weight=float(usual[k]) / limit,
        code=Code.MARKER_OFF_STATIC,
    )


def _mask(stretches: list[slice], n: int) -> BoolArray:
    out = np.zeros(n, dtype=bool)
    for stretch in stretches:
        out[stretch] = True
    return out


def _leg(segment: str) -> str:
    return segment[-1] if segment.startswith(("thigh", "shank", "foot")) else ""
