"""Limits that nobody who walks or runs exceeds, whatever the data: behind every other check stands the body itself.

Angles, speeds and torques: `Limits` of `model/coordinates.py`. Pelvis residual: clean recordings have 2 to 13 % of
the body weight, RMS; with more than these limits no torque means anything.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.findings import Finding, Severity, listed
from gaitcal.gait.moments import moment_of
from gaitcal.io.intervals import runs, spans
from gaitcal.model.coordinates import COORDINATE_TABLE
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.motion.motion import MarkerErrors, Motion

TOPIC, DISAGREE = "physical bounds", "motion and forces do not belong together"
_LIMITS = {name: row.limits for name, row in COORDINATE_TABLE.items() if row.limits}
ANGLES_DEG: Mapping[str, tuple[float, float]] = {name: x.angle for name, x in _LIMITS.items() if x.angle}
"""Coordinate of a leg -> smallest and largest angle."""
SPEEDS_DEG_S: Mapping[str, float] = {name: x.speed for name, x in _LIMITS.items() if x.speed}
"""Coordinate of a leg -> largest speed."""
TORQUES_PERCENT_BWH: Mapping[str, float] = {name: x.torque for name, x in _LIMITS.items()}
"""Coordinate of a leg -> largest torque in percent of body weight times height."""
RESIDUAL_SHARE, RESIDUAL_MOMENT_SHARE = 0.5, 0.2
"""Largest RMS magnitude of the residual force in body weights, and of the moment in body weights times height."""
MARKER_M = 0.10
"""Largest RMS distance of a leg's or the pelvis' marker with weight; skin moves by 40 mm at most (Leardini et al., Gait
Posture 21:212-225, 2005)."""
FULL_WEIGHT = 0.5
"""Weight from which a marker is meant to be met."""
CHANGED_DEG, CHANGED_MUCH_DEG = 10.0, 45.0
"""Mean change of an angle by the calibration that is a note, and that puts the result in doubt. Nominal ankle axes are
another person's: their offsets change by up to 36 deg on clean recordings."""
SIDES = {"r": "right", "l": "left"}


@dataclass(frozen=True)
class _Broken:
    """A quantity beyond its limit."""

    words: str
    times: float
    """In units of the limit."""
    frames: BoolArray


def impossible(
    motion: Motion,
    weight: float,
    moments: Moments | None = None,
    valid: BoolArray | None = None,
    legs: BoolArray | None = None,
) -> tuple[Finding, ...]:
    """What in a trial no body can do, one finding a leg, and one of the pelvis residual.

    Parameters
    ----------
    motion : of the whole body or a part; every coordinate of a leg in it is judged.
    weight : of the body, N.
    moments : final generalised forces, where there are force plates.
    valid : (nf,) frames in which they mean something.
    legs : (nf, 2) frames in which those of the right and the left leg do; None: `valid`.
    """
    found = []
    for k, (side, word) in enumerate(SIDES.items()):
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
            found.append(_finding(motion, Code.FORCES_OF_ANOTHER, DISAGREE, "", broken))
    return tuple(found)


def _finding(motion: Motion, code: Code, cause: str, leg: str, broken: list[_Broken]) -> Finding:
    broken = sorted(broken, key=lambda b: -b.times)
    marked: BoolArray = np.any([b.frames for b in broken], axis=0)
    when = spans(motion.time, runs(marked))
    return Finding(
        severity=Severity.ERROR,
        topic=TOPIC,
        where=motion.name,
        cause=cause,
        found=f"{listed([b.words for b in broken], 4)} ({when})",
        cure="look at labels, gaps and interpolated markers in that time, and at the units of the forces",
        leg=leg,
        weight=10.0 * broken[0].times,
        code=code,
    )


def _angles(motion: Motion, side: str) -> Iterator[_Broken]:
    q, v = motion.q, motion.velocity
    for name, (low, high) in ANGLES_DEG.items():
        coordinate = f"{name}_{side}"
        if coordinate not in motion.coordinates:
            continue
        at = motion.coordinates.index(coordinate)
        angle, speed = np.rad2deg(q[:, at]), np.abs(np.rad2deg(v[:, at]))
        beyond = (angle < low) | (angle > high)
        if beyond.any():
            worst = float(angle[np.argmax(np.maximum(low - angle, angle - high))])
            times = worst / (high if worst > high else low)
            yield _Broken(f"{coordinate} {worst:.0f} deg (allowed: {low:.0f} to {high:.0f})", times, beyond)
        limit = SPEEDS_DEG_S[name]
        if (speed > limit).any():
            words = f"{coordinate} changes by {speed.max():.0f} deg/s (allowed: {limit:.0f})"
            yield _Broken(words, float(speed.max()) / limit, speed > limit)


def _torques(moments: Moments, valid: BoolArray, side: str) -> Iterator[_Broken]:
    for name, limit in TORQUES_PERCENT_BWH.items():
        share = np.where(valid, 100.0 * np.abs(moment_of(moments, f"{name}_{side}")) / moments.bwh, 0.0)
        if (share > limit).any():
            words = f"torque of {name}_{side} {share.max():.0f} %BW*H (allowed: {limit:.0f})"
            yield _Broken(words, float(share.max()) / limit, share > limit)


def _markers(errors: MarkerErrors, side: str) -> Iterator[_Broken]:
    for k in np.flatnonzero(errors.kept() & (errors.weight >= FULL_WEIGHT)).tolist():
        segment = errors.segments[k]
        if not (segment.endswith(f"_{side}") and segment in LOWER_BODY):
            continue
        distance = errors.distance[:, k]
        rms = float(np.sqrt(np.nanmean(distance**2)))
        if rms > MARKER_M:
            words = (
                f"marker '{errors.labels[k]}' {1e3 * rms:.0f} mm RMS from the model's (allowed: {1e3 * MARKER_M:.0f})"
            )
            yield _Broken(words, rms / MARKER_M, np.nan_to_num(distance) > MARKER_M)


def _residual(moments: Moments, valid: BoolArray, weight: float) -> Iterator[_Broken]:
    force, moment = (_rms(r[valid]) for r in (moments.residual_force, moments.residual_moment))
    limits = (
        (
            f"residual force at the pelvis {100 * force / weight:.0f} % of body weight RMS",
            force / weight,
            RESIDUAL_SHARE,
        ),
        (f"residual moment {100 * moment / moments.bwh:.0f} %BW*H RMS", moment / moments.bwh, RESIDUAL_MOMENT_SHARE),
    )
    for words, share, limit in limits:
        if share > limit:
            yield _Broken(f"{words} (allowed: {100 * limit:.0f})", share / limit, valid)


def _rms(vectors: Array) -> float:
    """RMS magnitude of (n, 3)."""
    return float(np.sqrt(np.mean((vectors**2).sum(axis=1))))


def large_changes(before: Motion, after: Motion, valid: BoolArray | None = None) -> Iterator[Finding]:
    """Angles of the legs that the calibration moved much, mean over frames; `before` with the nominal model."""
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
        cure="look at the landmarks of these joints in the static trial, and at the isolated trials" if much else "",
        weight=abs(changed[0][0]) / CHANGED_MUCH_DEG,
        code=Code.ANGLES_MOVED,
    )
