"""The results of a run that a user would believe, each with its error bar, and how far another run moved them.

For each torque and angle x of the legs, with its standard error s in every frame f of a walk, and for each centre of
hip, knee and ankle:

    bar_f  = max(1.96 s_f, floor)
    moved  = sqrt(mean_f (|x_f - x0_f| / bar_f)^2)            x0: the clean run

so that moved <= 1 is inside the error bar that the run itself prints. Floors: 0.2 % of body weight times height,
1 deg, 5 mm. Torques count where both runs call the frame valid. A hip's centre is compared as a point, knee and ankle
across their axes, along which a hinge tells nothing; s of a centre is that of its position in the segment above it.
Centres are compared in the laboratory, after the one rigid motion that brings all markers of one recording on those of
the other. An isolated trial has no error bars of its own angles: there the axis of its knee or ankle is compared, as an
angle, with that of its two orientations in the segment above; floor 2 deg.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gaitcal import COORDINATES, Calibration
from gaitcal.arrays import Array, BoolArray
from gaitcal.session.result import TrialResult
from scripts.validation.truth.rigid import across
from scripts.validation.truth.simulated import joint_tracks, whole_turn

ANGLES = tuple(
    f"{name}_{side}"
    for side in "rl"
    for name in ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle", "subtalar_angle")
)
PLACES = {
    "hip": ("hip_{s}.pelvis.ant", "hip_{s}.pelvis.sup", "hip_{s}.pelvis.lat"),
    "knee": ("knee_{s}.thigh.ant", "knee_{s}.thigh.sup"),
    "ankle": ("talocrural_{s}.shank.ant", "talocrural_{s}.shank.sup"),
}
"""Joint -> the parameters whose standard errors are that of its centre in the segment above."""
DIRECTIONS = {
    "knee": ("knee_{s}.thigh.front", "knee_{s}.thigh.trans"),
    "ankle": ("talocrural_{s}.shank.front", "talocrural_{s}.shank.trans"),
}
"""Joint -> the parameters whose standard errors are that of its axis in the segment above."""
WITHIN = 1.96
FLOOR_BWH, FLOOR_RAD, FLOOR_M, FLOOR_AXIS_RAD = 0.002, np.deg2rad(1.0), 0.005, np.deg2rad(2.0)


@dataclass(frozen=True, kw_only=True)
class Curves:
    time: Array
    """(nf,) s."""
    labels: tuple[str, ...]
    markers: Array
    """(nf, nm, 3) m, as tracked."""
    angles: Array
    """(nf, 12) rad."""
    angle_bars: Array | None
    """(nf, 12) rad; None for isolated trials, which have no error bars of their own."""
    torques: Array | None
    """(nf, 14) N·m: those of the angles and both knee adductions; None without force plates."""
    torque_bars: Array | None
    """(nf, 14) N·m."""
    valid: BoolArray
    """(nf,) where torques count."""
    centres: Mapping[str, tuple[Array, Array]]
    """`hip_r`, ... -> centre (nf, 3) m and axis of flexion (nf, 3)."""
    centre_bars: Mapping[str, float]
    """m."""
    axis_bars: Mapping[str, float] = field(default_factory=dict)
    """rad; of isolated trials."""


def curves(calibration: Calibration) -> dict[str, Curves]:
    """Trial -> what it came to; of an isolated trial the centres of its own leg."""
    return {trial.name: _curves(calibration, trial) for trial in calibration.trials}


def _curves(calibration: Calibration, trial: TrialResult) -> Curves:
    at = [COORDINATES.index(name) for name in ANGLES]
    loads, errors = trial.loads, calibration.uncertainty.standard_errors
    angle_bars = torques = torque_bars = None
    valid = np.zeros(len(trial.body.time), dtype=np.bool_)
    if trial.coordinate_errors is not None:
        angle_bars = np.maximum(WITHIN * trial.coordinate_errors[:, at], FLOOR_RAD)
    if loads is not None:
        valid = loads.reactions.valid
        torques = np.hstack([loads.final.tau[:, at], loads.final.knee_adduction])
        spread = np.zeros_like(torques) if loads.errors is None else loads.errors.every[:, [*at, 27, 28]]
        torque_bars = np.maximum(WITHIN * spread, FLOOR_BWH * calibration.model.subject.bwh)
    sides = "rl" if trial.joint is None else trial.joint[-1]
    tracks = joint_tracks(calibration.model.parameters, trial.body)

    def bar(names: tuple[str, ...], side: str, floor: float) -> float:
        return max(WITHIN * float(np.linalg.norm([errors.get(name.format(s=side), 0.0) for name in names])), floor)

    return Curves(
        time=trial.body.time,
        labels=trial.recording.labels,
        markers=trial.recording.markers,
        angles=trial.body.q[:, at],
        angle_bars=angle_bars,
        torques=torques,
        torque_bars=torque_bars,
        valid=valid,
        centres={f"{joint}_{s}": tracks[f"{joint}_{s}"] for joint in PLACES for s in sides},
        centre_bars={f"{joint}_{s}": bar(names, s, FLOOR_M) for joint, names in PLACES.items() for s in sides},
        axis_bars={
            f"{joint}_{s}": bar(names, s, FLOOR_AXIS_RAD)
            for joint, names in DIRECTIONS.items()
            for s in sides
            if trial.joint == f"{joint}_{s}"
        },
    )


@dataclass(frozen=True)
class Movement:
    bars: float
    """In its own error bars."""
    words: str
    """Which, and its RMS in its unit."""


def largest(found: Mapping[str, Curves], clean: Mapping[str, Curves]) -> Movement | None:
    """The largest movement of any result of the trials that both runs have; None where there is none."""
    both = [
        movement
        for name, curve in found.items()
        if name in clean
        for movement in _movements(name, curve, clean[name])
        if np.isfinite(movement.bars)
    ]
    return max(both, key=lambda m: m.bars, default=None)


def _movements(trial: str, found: Curves, clean: Curves) -> list[Movement]:
    here, there = _shared_frames(found.time, clean.time)
    if len(here) == 0:
        return []
    out = []
    if found.angle_bars is not None:
        gap = np.abs(found.angles[here] - clean.angles[there])
        out += _columns(trial, ANGLES, gap, found.angle_bars[here], np.rad2deg(1.0), "deg")
    if found.torques is not None and found.torque_bars is not None and clean.torques is not None:
        both = found.valid[here] & clean.valid[there]
        if both.any():
            gap = np.abs(found.torques[here] - clean.torques[there])[both]
            names = [f"moment of {name}" for name in (*ANGLES, "knee_adduction_r", "knee_adduction_l")]
            out += _columns(trial, names, gap, found.torque_bars[here][both], 1.0, "N·m")
    labels = [label for label in clean.labels if label in found.labels]
    before = clean.markers[there][:, [clean.labels.index(label) for label in labels]]
    after = found.markers[here][:, [found.labels.index(label) for label in labels]]
    rotation, origin = whole_turn(before, after)
    for joint, (centre, direction) in found.centres.items():
        if joint not in clean.centres:  # declared for another leg
            continue
        point, axis = (array[there] @ rotation.T for array in clean.centres[joint])
        if joint in found.axis_bars:
            turn = np.arccos(np.clip(np.abs((direction[here] * axis).sum(axis=1)), 0, 1))[:, None]
            bars = np.full_like(turn, found.axis_bars[joint])
            out += _columns(trial, [f"axis of {joint}"], turn, bars, np.rad2deg(1.0), "deg")
        gap = centre[here] - (point + origin)
        if not joint.startswith("hip"):
            gap = across(gap, axis)
        size = np.linalg.norm(gap, axis=1)[:, None]
        bars = np.full_like(size, found.centre_bars[joint])
        out += _columns(trial, [f"centre of {joint}"], size, bars, 1e3, "mm")
    return out


def _columns(trial: str, names: Sequence[str], gap: Array, bars: Array, unit: float, word: str) -> list[Movement]:
    moved = np.sqrt(np.mean((gap / bars) ** 2, axis=0))
    sizes = unit * np.sqrt(np.mean(gap**2, axis=0))
    return [
        Movement(float(m), f"{trial}: {name} {s:.3g} {word}") for name, m, s in zip(names, moved, sizes, strict=True)
    ]


def _shared_frames(a: Array, b: Array) -> tuple[Array, Array]:
    """Indices of the frames of a and b of the same time, within half a frame."""
    step = min(np.median(np.diff(a)), np.median(np.diff(b)))
    nearest = np.clip(np.searchsorted(b, a), 1, len(b) - 1)
    nearest -= (a - b[nearest - 1]) < (b[nearest] - a)
    same = np.abs(b[nearest] - a) < 0.5 * step
    return np.flatnonzero(same), nearest[same]
