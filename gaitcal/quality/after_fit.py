"""What a finished fit says of single markers and of the body: stuck, exchanged, elsewhere; more
than any body can do.

Markers: the fit joins all segments, so that it judges those that their own segment cannot: arms,
trunk, segments with one or two markers. With r_f the distance of a marker from the model's in frame
f and u its median over the trial, it is

    elsewhere for a while   r_f > u + limit in a stretch that begins or ends with a jump of r by half of that (skin and
                            shoulder girdles move a marker as far, but never within a frame),
    made up                 in such a stretch its path is a straight line,
    exchanged               in such a stretch it is nearer to where the model has another marker, and that one to it,
    displaced               u alone is far more than that of its segment and of what markers of its kind have.

Bodies: limits that nobody who walks or runs exceeds, whatever the data. Angles, speeds and torques:
`Limits` of `model/coordinates.py`. Pelvis residual: clean recordings have 2 to 13 % of the body
weight, RMS; with more than these limits no torque means anything. Speeds are means over the time
that a trial's splines resolve, away from their ends.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.errors import Code, Finding, Severity, listed
from gaitcal.gait.moments import get_moment
from gaitcal.io.recording import find_runs, format_spans
from gaitcal.model import coordinates, linkage
from gaitcal.preprocess.displaced_markers import STRAIGHT_M, bend
from gaitcal.quality.verdict import BOUNDS, MARKERS_AFTER_FIT
from gaitcal.tracking.motion import MarkerErrors, Motion
from gaitcal.tracking.spline import DEGREE, ORDER

LIMIT_M = 0.02
"""Residuals of clean recordings exceed their median by up to 29 mm, but never begin or end that
within a frame.
"""
LIGHT_LIMIT_M = 0.03  # The same for markers of trunk and arms, whose joints are crude
JUMP = (
    0.5  # Share of its excess by which the residual changes within a frame at an end of a stretch
)
SHORTEST_FRAMES = 3
DISPLACED_M, LIGHT_DISPLACED_M = 0.05, 0.20
"""Median residual of a marker that is elsewhere throughout; clean ones reach 35 mm on legs, 136 mm
on arms.
"""
WORSE = 3.0  # Times the median of its segment's other markers
NEARER = 0.5  # Of the present distances, from which two markers are taken as exchanged
REFUSED_M = 0.05  # A stretch so far off is an error for a marker of full weight on pelvis and legs
FULL_WEIGHT = 0.5  # Weight from which a marker is meant to be met
_LIMITS = {name: row.limits for name, row in coordinates.COORDINATE_TABLE.items() if row.limits}
ANGLES_DEG: Mapping[str, tuple[float, float]] = {
    name: x.angle for name, x in _LIMITS.items() if x.angle
}
"""Coordinate of a leg -> smallest and largest angle."""
SPEEDS_DEG_S: Mapping[str, float] = {name: x.speed for name, x in _LIMITS.items() if x.speed}
"""Coordinate of a leg -> largest speed."""
TORQUES_PERCENT_BWH: Mapping[str, float] = {name: x.torque for name, x in _LIMITS.items()}
"""Coordinate of a leg -> largest torque in percent of body weight times height."""
RESIDUAL_SHARE, RESIDUAL_MOMENT_SHARE = 0.5, 0.2
"""Largest RMS magnitude of the residual force in body weights, and of the moment in body weights
times height.
"""
FARTHEST_M = 0.10
"""Largest RMS distance of a leg's or the pelvis' marker with weight; skin moves by 40 mm at most
(Leardini et al., Gait Posture 21:212-225, 2005)."""
LARGEST_END = 0.25  # Of a trial, at each end: half of it is always looked at
CHANGED_DEG, CHANGED_MUCH_DEG = 10.0, 45.0
"""Mean change of an angle by the calibration that is a note, and that puts the result in doubt.
Nominal ankle axes are another person's: their offsets change by up to 36 deg on clean recordings.
"""


@dataclass(frozen=True, kw_only=True)
class TrackedMarkers:
    """Markers of a tracked trial."""

    name: str  # Of the trial
    time: Array  # (nf,) s
    labels: tuple[str, ...]
    segments: tuple[str, ...]  # Of each marker
    weight: Array  # (nm,)
    measured: Array  # (nf, nm, 3) m; NaN where not seen
    model: Array  # (nf, nm, 3) m

    @property
    def distance(self) -> Array:
        """(nf, nm) m; NaN where not seen."""
        out: Array = np.linalg.norm(self.measured - self.model, axis=2)
        return out

    def heavy(self, k: int) -> bool:
        """Whether a marker of pelvis or legs has full weight."""
        return bool(self.segments[k] in linkage.LOWER_BODY and self.weight[k] >= FULL_WEIGHT)


def marker_findings(tracked: TrackedMarkers) -> tuple[Finding, ...]:
    """Markers whose residuals have structure."""
    distance = tracked.distance
    baseline = np.array([np.nanmedian(d) if np.isfinite(d).any() else np.nan for d in distance.T])
    chosen = np.flatnonzero((tracked.weight > 0) & np.isfinite(baseline)).tolist()
    found: list[Finding] = []
    named: set[str] = set()
    for k in sorted(chosen, key=lambda k: -float(np.nanmax(distance[:, k]) - baseline[k])):
        if tracked.labels[k] in named:
            continue
        stretches = list(_stretches(distance[:, k], float(baseline[k]), _limit(tracked, k)))
        if stretches:
            finding, others = _elsewhere(tracked, k, stretches, distance, float(baseline[k]))
            found.append(finding)
            named |= others
    for k in chosen:
        if tracked.labels[k] not in named:
            found += _displaced(tracked, k, baseline)
    return tuple(found)


def _limit(tracked: TrackedMarkers, k: int) -> float:
    return LIMIT_M if tracked.segments[k] in linkage.LOWER_BODY else LIGHT_LIMIT_M


def _stretches(distance: Array, baseline: float, limit: float) -> Iterator[slice]:
    """Frames of one marker (nf,) in which it is elsewhere."""
    excess = np.nan_to_num(distance - baseline)
    for run in find_runs(excess > limit, SHORTEST_FRAMES):
        peak = float(excess[run].max())
        ends = [
            abs(excess[e] - excess[e - 1]) for e in (run.start, run.stop) if 0 < e < len(excess)
        ]
        known_ends = [
            np.isfinite(distance[e - 1 : e + 1]).all()
            for e in (run.start, run.stop)
            if 0 < e < len(excess)
        ]
        if any(jump > JUMP * peak and known for jump, known in zip(ends, known_ends, strict=True)):
            yield run


def _elsewhere(
    tracked: TrackedMarkers, k: int, stretches: list[slice], distance: Array, baseline: float
) -> tuple[Finding, set[str]]:
    """What became of marker k in some stretches, and the markers that are named with it."""
    label, frames = tracked.labels[k], np.zeros(len(distance), dtype=bool)
    for stretch in stretches:
        frames[stretch] = True
    worst = float(np.nanmax(distance[frames, k]))
    other, code = _exchanged_with(tracked, k, frames), Code.MARKER_AWAY
    if other is not None:
        code = Code.EXCHANGED_LABELS
        cause = (
            f"markers '{label}' and '{tracked.labels[other]}' carry each other's label for a while"
        )
        cure = "label that part again, or leave it out with time = [start, end]"
    elif all(_straight(tracked.measured[s, k]) for s in stretches):
        cause = f"the path of marker '{label}' was held or drawn as a straight line over a gap"
        cure = f'export gaps as gaps, or weights = {{ "{label}" = 0 }} under [markers]'
    else:
        cause = f"marker '{label}' is elsewhere for a while"
        cure = (
            f"label that part again, leave it out with time = [start, end], or weights = {{ "
            f'"{label}" = 0 }}'
        )
    error = tracked.heavy(k) and worst - baseline > REFUSED_M
    found = f"up to {1e3 * worst:.0f} mm from the model's marker, usually {1e3 * baseline:.0f} mm "
    found += f"({format_spans(tracked.time, stretches)})"
    weight = (worst - baseline) / _limit(tracked, k)
    finding = _of_marker(tracked, k, code, cause, found, cure, weight, error=error)
    return finding, {label} if other is None else {label, tracked.labels[other]}


def _of_marker(
    tracked: TrackedMarkers,
    k: int,
    code: Code,
    cause: str,
    found: str,
    cure: str,
    weight: float,
    *,
    error: bool,
) -> Finding:
    segment = tracked.segments[k]
    return Finding(
        severity=Severity.ERROR if error else Severity.WARNING,
        topic=MARKERS_AFTER_FIT,
        where=tracked.name,
        cause=cause,
        found=found,
        cure=cure,
        leg=segment[-1] if segment.startswith(("thigh", "shank", "foot")) else "",
        weight=weight,
        code=code,
    )


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
    return bool(len(path) > SHORTEST_FRAMES and np.isfinite(path).all() and bend(path) < STRAIGHT_M)


def _displaced(tracked: TrackedMarkers, k: int, baseline: Array) -> Iterator[Finding]:
    """Marker k, if it is far from the model's all the time and others of its segment are not."""
    limit = DISPLACED_M if tracked.heavy(k) else LIGHT_DISPLACED_M
    mates = [
        baseline[i]
        for i, segment in enumerate(tracked.segments)
        if i != k
        and segment == tracked.segments[k]
        and tracked.weight[i] > 0
        and np.isfinite(baseline[i])
    ]
    if baseline[k] < limit or (mates and baseline[k] < WORSE * float(np.median(mates))):
        return
    label, mm = tracked.labels[k], 1e3 * baseline[k]
    cause = f"marker '{label}' is not where the static trial has it on {tracked.segments[k]}"
    found = (
        f"{mm:.0f} mm from the model's marker (median), throughout "
        f"{tracked.time[0]:.2f}-{tracked.time[-1]:.2f} s"
    )
    cure = f'weights = {{ "{label}" = 0 }} under [markers], another label, or another static trial'
    weight, error = float(baseline[k]) / limit, tracked.heavy(k)
    yield _of_marker(tracked, k, Code.MARKER_OFF_STATIC, cause, found, cure, weight, error=error)


@dataclass(frozen=True)
class _Broken:
    """A quantity beyond its limit."""

    words: str
    times: float  # In units of the limit
    frames: BoolArray


def impossible(
    motion: Motion,
    weight: float,
    moments: Moments | None = None,
    valid: BoolArray | None = None,
    legs: BoolArray | None = None,
) -> tuple[Finding, ...]:
    """What in a trial no body can do, one finding a leg, and one of the pelvis residual.

    `motion`: of the whole body or a part; every coordinate of a leg in it is judged.
    `weight`: of the body, N.
    `moments`: final generalised forces, where there are force plates.
    `valid`: (nf,) frames in which they mean something.
    `legs`: (nf, 2) frames in which those of the right and the left leg do; None: `valid`.
    """
    found = []
    for k, (side, word) in enumerate(linkage.SIDE_WORDS.items()):
        broken = [*_angles(motion, side), *_markers(motion.errors, side)]
        of_leg = valid if legs is None else np.asarray(legs[:, k])
        if moments is not None and of_leg is not None and of_leg.any():
            broken += _torques(moments, of_leg, side)
        if broken:
            cause = f"the {word} leg moves or is loaded as no leg can be"
            found.append(_finding(motion, Code.IMPOSSIBLE_LEG, cause, side, broken))
    if moments is not None and valid is not None and valid.any():
        broken = list(_residual(moments, valid, weight))
        if broken:
            cause = "motion and forces do not belong together"
            found.append(_finding(motion, Code.FORCES_OF_ANOTHER, cause, "", broken))
    return tuple(found)


def _finding(motion: Motion, code: Code, cause: str, leg: str, broken: list[_Broken]) -> Finding:
    broken = sorted(broken, key=lambda b: -b.times)
    marked: BoolArray = np.any([b.frames for b in broken], axis=0)
    when = format_spans(motion.time, find_runs(marked))
    return Finding(
        severity=Severity.ERROR,
        topic=BOUNDS,
        where=motion.name,
        cause=cause,
        found=f"{listed([b.words for b in broken], 4)} ({when})",
        cure="look at labels, gaps and interpolated markers in that time, and at the units of the "
        "forces",
        leg=leg,
        weight=10.0 * broken[0].times,
        code=code,
    )


def _angles(motion: Motion, side: str) -> Iterator[_Broken]:
    q = motion.q
    for name, (low, high) in ANGLES_DEG.items():
        coordinate = f"{name}_{side}"
        if coordinate not in motion.coordinates:
            continue
        at = motion.coordinates.index(coordinate)
        angle, speed = np.rad2deg(q[:, at]), _resolved_speed(motion, at)
        beyond = (angle < low) | (angle > high)
        if beyond.any():
            worst = float(angle[np.argmax(np.maximum(low - angle, angle - high))])
            times = worst / (high if worst > high else low)
            yield _Broken(
                f"{coordinate} {worst:.0f} deg (allowed: {low:.0f} to {high:.0f})", times, beyond
            )
        limit = SPEEDS_DEG_S[name]
        if (speed > limit).any():
            message = f"{coordinate} changes by {speed.max():.0f} deg/s (allowed: {limit:.0f})"
            yield _Broken(message, float(speed.max()) / limit, speed > limit)


def _resolved_speed(motion: Motion, at: int) -> Array:
    """(nf,) deg/s of one coordinate, as the trial's splines resolve it; zero near the ends.

    A spline does not resolve changes shorter than the distance of its knots, so the speed is the
    mean over that time. Near the ends of a trial fewer frames determine it: half of the reach of a
    spline is left out there.
    """
    time, basis = motion.time, motion.basis
    spacing = float(time[-1] - time[0]) / max(basis.nodes - DEGREE, 1)
    end = min(0.5 * ORDER * spacing, LARGEST_END * float(time[-1] - time[0]))
    angle = np.rad2deg(motion.q[:, at])
    before, after = (np.interp(time + by * spacing, time, angle) for by in (-0.5, 0.5))
    inside = (time >= time[0] + max(end, 0.5 * spacing)) & (
        time <= time[-1] - max(end, 0.5 * spacing)
    )
    return np.asarray(np.where(inside, np.abs(after - before) / spacing, 0.0), float)


def _torques(moments: Moments, valid: BoolArray, side: str) -> Iterator[_Broken]:
    for name, limit in TORQUES_PERCENT_BWH.items():
        share = np.where(
            valid, 100.0 * np.abs(get_moment(moments, f"{name}_{side}")) / moments.bwh, 0.0
        )
        if (share > limit).any():
            words = f"torque of {name}_{side} {share.max():.0f} %BW*H (allowed: {limit:.0f})"
            yield _Broken(words, float(share.max()) / limit, share > limit)


def _markers(errors: MarkerErrors, side: str) -> Iterator[_Broken]:
    for k in np.flatnonzero(errors.select_observed() & (errors.weight >= FULL_WEIGHT)).tolist():
        segment = errors.segments[k]
        if not (segment.endswith(f"_{side}") and segment in linkage.LOWER_BODY):
            continue
        distance = errors.distance[:, k]
        rms = float(np.sqrt(np.nanmean(distance**2)))
        if rms > FARTHEST_M:
            words = (
                f"marker '{errors.labels[k]}' {1e3 * rms:.0f} mm RMS from the model's (allowed: "
                f"{1e3 * FARTHEST_M:.0f})"
            )
            yield _Broken(words, rms / FARTHEST_M, np.nan_to_num(distance) > FARTHEST_M)


def _residual(moments: Moments, valid: BoolArray, weight: float) -> Iterator[_Broken]:
    force, moment = (
        float(np.sqrt(np.mean((r[valid] ** 2).sum(axis=1))))
        for r in (moments.residual_force, moments.residual_moment)
    )
    of_force, of_moment = force / weight, moment / moments.bwh
    for words, share, limit in (
        (
            f"residual force at the pelvis {100 * of_force:.0f} % of body weight RMS",
            of_force,
            RESIDUAL_SHARE,
        ),
        (f"residual moment {100 * of_moment:.0f} %BW*H RMS", of_moment, RESIDUAL_MOMENT_SHARE),
    ):
        if share > limit:
            yield _Broken(f"{words} (allowed: {100 * limit:.0f})", share / limit, valid)


def large_changes(
    before: Motion, after: Motion, valid: BoolArray | None = None
) -> Iterator[Finding]:
    """Angles of the legs that the calibration moved much, mean over frames; `before` with the
    nominal model.
    """
    frames = np.ones(len(after.time), dtype=bool) if valid is None or not valid.any() else valid
    changed: list[tuple[float, str]] = []
    for name in after.coordinates:
        if name[:-2] not in ANGLES_DEG or name not in before.coordinates:
            continue
        a, b = (m.q[frames, m.coordinates.index(name)] for m in (after, before))
        change = float(np.rad2deg(np.mean(a - b)))
        if abs(change) > CHANGED_DEG:
            changed.append((change, name))
    if not changed:
        return
    changed.sort(key=lambda pair: -abs(pair[0]))
    much = abs(changed[0][0]) > CHANGED_MUCH_DEG
    yield Finding(
        severity=Severity.WARNING if much else Severity.INFO,
        topic="angles",
        where=after.name,
        cause="the calibration moved angles far from those of the nominal model",
        found=f"mean change: {listed([f'{name} {change:+.0f} deg' for change, name in changed])}",
        cure="look at the landmarks of these joints in the static trial, and at the isolated trials"
        if much
        else "",
        weight=abs(changed[0][0]) / CHANGED_MUCH_DEG,
        code=Code.ANGLES_MOVED,
    )
