"""Post-fit checks: swapped, displaced and interpolated markers; physiological limits.

Markers. The fit joins all segments. It therefore also checks markers that cannot be checked within
their segment: arms, trunk, segments with one or two markers. With r_f the distance between measured
and model marker in frame f, and u its median over the trial, a marker is

    displaced for a while  r_f > u + limit in an interval that starts or ends with a jump of r of
                           half the excess or more (soft tissue moves a marker as far, but never
                           within one frame),
    interpolated           in all such intervals its path is a straight line,
    swapped                in such an interval it is nearer to another model marker, and the other
                           measured marker is nearer to its model marker,
    displaced throughout   u exceeds a limit and the median of the other markers of its segment.

Bodies. Nobody who walks or runs exceeds the limits, whatever the data. Angles, speeds and torques:
`Limits` of `model/coordinates.py`. Pelvis residual: clean recordings have 2 to 13 % of the body
weight, RMS; beyond the limits no torque is meaningful. Speeds are means over the time that the
splines of a trial resolve, away from its ends.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.errors import Code, Finding, Severity, join_names
from gaitcal.gait.moments import get_moment
from gaitcal.io.recording import find_runs, format_spans
from gaitcal.model import coordinates, linkage
from gaitcal.preprocess.displaced_markers import STRAIGHT_M, measure_bend
from gaitcal.quality.verdict import BOUNDS, MARKERS_AFTER_FIT
from gaitcal.tracking.motion import MarkerErrors, Motion
from gaitcal.tracking.spline import DEGREE, ORDER

RESIDUAL_LIMIT_M = 0.02
"""Residuals of clean recordings exceed their median by up to 29 mm, but never begin or end that
within a frame.
"""
# The same for markers of trunk and arms, whose joints are modelled coarsely
LIGHT_RESIDUAL_LIMIT_M = 0.03
# Part of its excess by which the residual changes within a frame at an end of an interval
JUMP_SHARE = 0.5
SHORTEST_FRAMES = 3
DISPLACED_M, LIGHT_DISPLACED_M = 0.05, 0.20
"""Median residual of a marker that is displaced throughout; clean ones reach 35 mm on legs and
136 mm on arms.
"""
# A marker displaced throughout exceeds the median of its segment's other markers by this factor
TIMES_SEGMENT_MEDIAN = 3.0
# Two markers count as swapped if swapping reduces their distances to this part or less
SWAPPED_SHARE = 0.5
# An interval so far off is an error for a marker of full weight on pelvis or legs
REFUSED_M = 0.05
FULL_WEIGHT = 0.5  # Weight from which the fit must follow a marker
_COORDINATE_LIMITS = {
    name: row.limits for name, row in coordinates.COORDINATE_TABLE.items() if row.limits
}
ANGLES_DEG: Mapping[str, tuple[float, float]] = {
    name: x.angle for name, x in _COORDINATE_LIMITS.items() if x.angle
}
"""Coordinate of a leg -> smallest and largest angle."""
SPEEDS_DEG_S: Mapping[str, float] = {
    name: x.speed for name, x in _COORDINATE_LIMITS.items() if x.speed
}
"""Coordinate of a leg -> largest speed."""
TORQUES_PERCENT_BWH: Mapping[str, float] = {
    name: x.torque for name, x in _COORDINATE_LIMITS.items()
}
"""Coordinate of a leg -> largest torque in percent of body weight times height."""
RESIDUAL_SHARE, RESIDUAL_MOMENT_SHARE = 0.5, 0.2
"""Largest RMS magnitude of the residual force in body weights, and of the moment in body weights
times height.
"""
FARTHEST_M = 0.10
"""Largest RMS distance of a leg's or the pelvis' marker with weight; skin moves by 40 mm at most
(Leardini et al., Gait Posture 21:212-225, 2005)."""
LARGEST_END = 0.25  # Part of a trial left out at each end, at most: half of it is always checked
CHANGED_DEG, CHANGED_MUCH_DEG = 10.0, 45.0
"""Mean change of an angle by the calibration: from the first on a note, from the second a warning.
Nominal ankle axes are population means: their offsets change by up to 36 deg on clean recordings.
"""


@dataclass(frozen=True, kw_only=True)
class TrackedMarkers:
    """Markers of a tracked trial: measured, and as the model has them."""

    name: str  # Name of the trial
    time: Array  # (nf,) s
    labels: tuple[str, ...]
    segments: tuple[str, ...]  # Of each marker
    weight: Array  # (nm,)
    measured: Array  # (nf, nm, 3) m; NaN where not visible
    model: Array  # (nf, nm, 3) m

    @property
    def distance(self) -> Array:
        """Distance between measured and model markers, (nf, nm) m; NaN where not visible."""
        out: Array = np.linalg.norm(self.measured - self.model, axis=2)
        return out

    def has_full_weight(self, k: int) -> bool:
        """Return whether marker `k` is on pelvis or legs and has full weight."""
        return bool(self.segments[k] in linkage.LOWER_BODY and self.weight[k] >= FULL_WEIGHT)


def check_tracked_markers(tracked: TrackedMarkers) -> tuple[Finding, ...]:
    """Find markers whose residuals show that they were swapped, displaced or interpolated.

    Parameters
    ----------
    tracked
        Markers of one trial after the fit.

    Returns
    -------
    tuple of Finding
        At most one finding a marker; intervals first, then markers displaced throughout. A finding
        on two swapped markers counts for both.
    """
    distance = tracked.distance
    baseline = np.array([np.nanmedian(d) if np.isfinite(d).any() else np.nan for d in distance.T])
    chosen = np.flatnonzero((tracked.weight > 0) & np.isfinite(baseline)).tolist()
    found: list[Finding] = []
    named: set[str] = set()
    for k in sorted(chosen, key=lambda k: -float(np.nanmax(distance[:, k]) - baseline[k])):
        if tracked.labels[k] in named:
            continue
        stretches = list(
            _find_displaced_intervals(distance[:, k], float(baseline[k]), _limit(tracked, k))
        )
        if stretches:
            finding, others = _describe_displaced_marker(
                tracked, k, stretches, distance, float(baseline[k])
            )
            found.append(finding)
            named |= others
    for k in chosen:
        if tracked.labels[k] not in named:
            found += _check_lasting_offset(tracked, k, baseline)
    return tuple(found)


def _limit(tracked: TrackedMarkers, k: int) -> float:
    """Return the excess (m) over its median residual above which marker `k` is displaced."""
    return RESIDUAL_LIMIT_M if tracked.segments[k] in linkage.LOWER_BODY else LIGHT_RESIDUAL_LIMIT_M


def _find_displaced_intervals(distance: Array, baseline: float, limit: float) -> Iterator[slice]:
    """Yield the frames of one marker, residuals (nf,) m, in which it is displaced."""
    excess = np.nan_to_num(distance - baseline)
    for run in find_runs(excess > limit, SHORTEST_FRAMES):
        peak = float(excess[run].max())
        # without a jump at a visible end it may be soft tissue that moved gradually
        ends = [
            abs(excess[e] - excess[e - 1]) for e in (run.start, run.stop) if 0 < e < len(excess)
        ]
        known_ends = [
            np.isfinite(distance[e - 1 : e + 1]).all()
            for e in (run.start, run.stop)
            if 0 < e < len(excess)
        ]
        if any(
            jump > JUMP_SHARE * peak and known for jump, known in zip(ends, known_ends, strict=True)
        ):
            yield run


def _describe_displaced_marker(
    tracked: TrackedMarkers, k: int, stretches: list[slice], distance: Array, baseline: float
) -> tuple[Finding, set[str]]:
    """Build the finding on marker `k` in some intervals; return it with the labels concerned."""
    label, frames = tracked.labels[k], np.zeros(len(distance), dtype=bool)
    for stretch in stretches:
        frames[stretch] = True
    worst = float(np.nanmax(distance[frames, k]))
    other, code = _find_swapped_marker(tracked, k, frames), Code.MARKER_AWAY
    if other is not None:
        code = Code.EXCHANGED_LABELS
        cause = (
            f"the labels of markers '{label}' and '{tracked.labels[other]}' are swapped for a while"
        )
        cure = "relabel this interval, or leave it out with time = [start, end]"
    elif all(_is_straight(tracked.measured[s, k]) for s in stretches):
        cause = f"a gap of marker '{label}' was filled with a constant or a straight line"
        cure = (
            "export the trial without gap filling, or set weights = "
            f'{{ "{label}" = 0 }} under [markers]'
        )
    else:
        cause = f"marker '{label}' is displaced for a while"
        cure = (
            "relabel this interval, leave it out with time = [start, end], or set weights = "
            f'{{ "{label}" = 0 }} under [markers]'
        )
    error = tracked.has_full_weight(k) and worst - baseline > REFUSED_M
    found = f"up to {1e3 * worst:.0f} mm from the model marker, median {1e3 * baseline:.0f} mm "
    found += f"({format_spans(tracked.time, stretches)})"
    weight = (worst - baseline) / _limit(tracked, k)
    finding = _build_marker_finding(tracked, k, code, cause, found, cure, weight, error=error)
    return finding, {label} if other is None else {label, tracked.labels[other]}


def _build_marker_finding(
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
    """Build the finding on marker `k`: an error or a warning."""
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


def _find_swapped_marker(tracked: TrackedMarkers, k: int, frames: BoolArray) -> int | None:
    """Return the marker that is swapped with marker `k` in these frames (nf,), or None."""
    measured, model = tracked.measured[frames], tracked.model[frames]
    present = np.linalg.norm(measured - model, axis=2)
    there = np.linalg.norm(measured[:, [k]] - model, axis=2)
    here = np.linalg.norm(measured - model[:, [k]], axis=2)
    with np.errstate(invalid="ignore"):
        ratio = np.nanmedian(there + here, axis=0) / np.nanmedian(present[:, [k]] + present, axis=0)
    # a marker is not swapped with itself
    ratio[k] = np.inf
    best = int(np.argmin(np.nan_to_num(ratio, nan=np.inf)))
    return best if ratio[best] < SWAPPED_SHARE else None


def _is_straight(path: Array) -> bool:
    """Return whether a path (n, 3) is uniform motion along a line, or no motion."""
    return bool(
        len(path) > SHORTEST_FRAMES and np.isfinite(path).all() and measure_bend(path) < STRAIGHT_M
    )


def _check_lasting_offset(tracked: TrackedMarkers, k: int, baseline: Array) -> Iterator[Finding]:
    """Report marker `k` if it alone of its segment is far from the model marker throughout."""
    limit = DISPLACED_M if tracked.has_full_weight(k) else LIGHT_DISPLACED_M
    # typical residuals of the other markers of the segment
    mates = [
        baseline[i]
        for i, segment in enumerate(tracked.segments)
        if i != k
        and segment == tracked.segments[k]
        and tracked.weight[i] > 0
        and np.isfinite(baseline[i])
    ]
    if baseline[k] < limit or (
        mates and baseline[k] < TIMES_SEGMENT_MEDIAN * float(np.median(mates))
    ):
        return
    label, mm = tracked.labels[k], 1e3 * baseline[k]
    cause = (
        f"the position of marker '{label}' on {tracked.segments[k]} differs from the static trial"
    )
    found = (
        f"{mm:.0f} mm from the model marker (median), throughout "
        f"{tracked.time[0]:.2f}-{tracked.time[-1]:.2f} s"
    )
    cure = (
        f'set weights = {{ "{label}" = 0 }} under [markers], correct its label, or use another '
        "static trial"
    )
    weight, error = float(baseline[k]) / limit, tracked.has_full_weight(k)
    yield _build_marker_finding(
        tracked, k, Code.MARKER_OFF_STATIC, cause, found, cure, weight, error=error
    )


@dataclass(frozen=True)
class _Excess:
    """A quantity beyond its limit."""

    description: str
    ratio: float  # Value over limit
    frames: BoolArray


def check_physical_limits(
    motion: Motion,
    weight: float,
    moments: Moments | None = None,
    valid: BoolArray | None = None,
    legs: BoolArray | None = None,
) -> tuple[Finding, ...]:
    """Find angles, speeds, torques and residuals that no body can produce.

    Parameters
    ----------
    motion
        Of the whole body or a part of it; all leg coordinates that it has are checked.
    weight
        Body weight, N.
    moments
        Final generalised forces; None without force plates.
    valid
        (nf,) frames with valid torques.
    legs
        (nf, 2) frames with valid torques of the right and the left leg; None: `valid` for both.

    Returns
    -------
    tuple of Finding
        At most one finding a leg, and one on the pelvis residual; all are errors.
    """
    found = []
    for k, (side, word) in enumerate(linkage.SIDE_WORDS.items()):
        excesses = [*_check_angles(motion, side), *_check_markers(motion.errors, side)]
        of_leg = valid if legs is None else np.asarray(legs[:, k])
        if moments is not None and of_leg is not None and of_leg.any():
            excesses += _check_torques(moments, of_leg, side)
        if excesses:
            cause = f"motion or load of the {word} leg exceeds physiological limits"
            found.append(_build_limit_finding(motion, Code.IMPOSSIBLE_LEG, cause, side, excesses))
    if moments is not None and valid is not None and valid.any():
        excesses = list(_check_residual(moments, valid, weight))
        if excesses:
            cause = "forces and motion do not match"
            found.append(_build_limit_finding(motion, Code.FORCES_OF_ANOTHER, cause, "", excesses))
    return tuple(found)


def _build_limit_finding(
    motion: Motion, code: Code, cause: str, leg: str, excesses: list[_Excess]
) -> Finding:
    """Build the error on quantities beyond their limits."""
    excesses = sorted(excesses, key=lambda b: -b.ratio)
    marked: BoolArray = np.any([b.frames for b in excesses], axis=0)
    when = format_spans(motion.time, find_runs(marked))
    return Finding(
        severity=Severity.ERROR,
        topic=BOUNDS,
        where=motion.name,
        cause=cause,
        found=f"{join_names([b.description for b in excesses], 4)} ({when})",
        cure="check labels, gaps and interpolated markers in this interval, and the units of the "
        "forces",
        leg=leg,
        weight=10.0 * excesses[0].ratio,
        code=code,
    )


def _check_angles(motion: Motion, side: str) -> Iterator[_Excess]:
    """Yield angles (deg) and angular speeds (deg/s) of a leg beyond their limits."""
    q = motion.q
    for name, (low, high) in ANGLES_DEG.items():
        coordinate = f"{name}_{side}"
        if coordinate not in motion.coordinates:
            continue
        at = motion.coordinates.index(coordinate)
        angle, speed = np.rad2deg(q[:, at]), _compute_resolved_speed(motion, at)
        beyond = (angle < low) | (angle > high)
        if beyond.any():
            worst = float(angle[np.argmax(np.maximum(low - angle, angle - high))])
            ratio = worst / (high if worst > high else low)
            yield _Excess(
                f"{coordinate} {worst:.0f} deg (allowed: {low:.0f} to {high:.0f} deg)",
                ratio,
                beyond,
            )
        limit = SPEEDS_DEG_S[name]
        if (speed > limit).any():
            message = (
                f"{coordinate} changes by {speed.max():.0f} deg/s (allowed: {limit:.0f} deg/s)"
            )
            yield _Excess(message, float(speed.max()) / limit, speed > limit)


def _compute_resolved_speed(motion: Motion, at: int) -> Array:
    """Compute the angular speed (nf,) deg/s that the splines resolve; zero near the ends.

    A spline does not resolve changes shorter than its knot spacing, so the speed is the mean over
    that time. Near the ends of a trial fewer frames determine it: half the support of a spline is
    left out there.
    """
    time, basis = motion.time, motion.basis
    # knot spacing of the splines
    spacing = float(time[-1] - time[0]) / max(basis.control_points - DEGREE, 1)
    end = min(0.5 * ORDER * spacing, LARGEST_END * float(time[-1] - time[0]))
    angle = np.rad2deg(motion.q[:, at])
    before, after = (np.interp(time + by * spacing, time, angle) for by in (-0.5, 0.5))
    inside = (time >= time[0] + max(end, 0.5 * spacing)) & (
        time <= time[-1] - max(end, 0.5 * spacing)
    )
    return np.asarray(np.where(inside, np.abs(after - before) / spacing, 0.0), float)


def _check_torques(moments: Moments, valid: BoolArray, side: str) -> Iterator[_Excess]:
    """Yield torques of a leg (percent of body weight times height) beyond their limits."""
    for name, limit in TORQUES_PERCENT_BWH.items():
        share = np.where(
            valid, 100.0 * np.abs(get_moment(moments, f"{name}_{side}")) / moments.bwh, 0.0
        )
        if (share > limit).any():
            message = (
                f"torque of {name}_{side} {share.max():.0f} %BW*H (allowed: {limit:.0f} %BW*H)"
            )
            yield _Excess(message, float(share.max()) / limit, share > limit)


def _check_markers(errors: MarkerErrors, side: str) -> Iterator[_Excess]:
    """Yield markers of full weight whose RMS distance from the model exceeds `FARTHEST_M`."""
    by_marker = errors.compute_rms_by_marker()
    for k in np.flatnonzero(errors.select_observed() & (errors.weight >= FULL_WEIGHT)).tolist():
        segment = errors.segments[k]
        if not (segment.endswith(f"_{side}") and segment in linkage.LOWER_BODY):
            continue
        distance, rms = errors.distance[:, k], float(by_marker[k])
        if rms > FARTHEST_M:
            message = (
                f"marker '{errors.labels[k]}' {1e3 * rms:.0f} mm RMS from the model marker "
                f"(allowed: {1e3 * FARTHEST_M:.0f} mm)"
            )
            yield _Excess(message, rms / FARTHEST_M, np.nan_to_num(distance) > FARTHEST_M)


def _check_residual(moments: Moments, valid: BoolArray, weight: float) -> Iterator[_Excess]:
    """Yield the residual force and moment at the pelvis beyond their limits."""
    force, moment = (
        float(np.sqrt(np.mean((r[valid] ** 2).sum(axis=1))))
        for r in (moments.residual_force, moments.residual_moment)
    )
    of_force, of_moment = force / weight, moment / moments.bwh
    for message, share, limit in (
        (
            f"residual force at the pelvis {100 * of_force:.0f} % of body weight RMS",
            of_force,
            RESIDUAL_SHARE,
        ),
        (f"residual moment {100 * of_moment:.0f} %BW*H RMS", of_moment, RESIDUAL_MOMENT_SHARE),
    ):
        if share > limit:
            yield _Excess(f"{message} (allowed: {100 * limit:.0f} %)", share / limit, valid)


def check_angle_changes(
    before: Motion, after: Motion, valid: BoolArray | None = None
) -> Iterator[Finding]:
    """Report leg angles that the calibration changed much, mean over frames.

    Parameters
    ----------
    before, after
        Motion with the nominal and with the calibrated model.
    valid
        (nf,) frames of the mean; all frames if None or empty.

    Yields
    ------
    Finding
        At most one: a note from `CHANGED_DEG` on, a warning from `CHANGED_MUCH_DEG` on.
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
        cause="the calibration changed angles much against the nominal model",
        found="mean change: "
        f"{join_names([f'{name} {change:+.0f} deg' for change, name in changed])}",
        cure="check the landmarks of these joints in the static trial, and the functional trials"
        if much
        else "",
        weight=abs(changed[0][0]) / CHANGED_MUCH_DEG,
        code=Code.ANGLES_MOVED,
    )
