"""Part `isolated`: six isolated trials of a person made by OpenSim, with markers that move as skin does."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gaitcal import Calibration, Study
from gaitcal.arrays import Array
from scripts.validation.truth.outcome import Figure, Fitted, Gathered, Outcome, fitted_parameters, timed_fit
from scripts.validation.truth.people import (
    DIRECTIONS,
    IsolatedPerson,
    SegmentPose,
    isolated_person,
    leg_parameters,
    static_frames,
    with_settings,
    x_axis,
    z_axis,
)
from scripts.validation.truth.rigid import Line, rigid_motion, sara, score
from scripts.validation.truth.skin import Kind, disturbed

AXES = {
    "knee axis in thigh": ("knee_{s}.thigh", "thigh_{s}", "proximal", "knee_{s}"),
    "knee axis in shank": ("knee_{s}.shank", "shank_{s}", "distal", "knee_{s}"),
    "talocrural axis": ("talocrural_{s}.shank", "shank_{s}", "proximal", "ankle_{s}"),
    "subtalar axis": ("subtalar_{s}.foot", "foot_{s}", "distal", "subtalar_{s}"),
}
"""Figure -> parameters, segment, and the true axis, `{s}` being the side."""


def run(
    name: str, kind: Kind, seed: int, size_mm: float, changes: Mapping[str, object], data: Path, cache: Path, gait: bool
) -> Outcome:
    """Disturb, calibrate and compare one person."""
    person = isolated_person(name, data, cache, gait)
    study = disturbed(with_settings(person.study, changes), kind, size_mm, seed)
    fit = timed_fit(study)
    return fit.outcome("isolated", kind.value, name, seed, compare(fit.calibration, person, study))


def compare(calibration: Calibration, person: IsolatedPerson, study: Study) -> dict[str, Figure]:
    """Figure -> RMS of both legs."""
    frames = static_frames(calibration.nominal, study.static.recording)
    gathered = Gathered()
    for side in "rl":
        fitted = fitted_parameters(calibration, leg_parameters(person, frames, side))
        gathered.hip(fitted, side)
        _hip_peer(gathered, person, study, side)
        for figure in AXES:
            _axis(gathered, figure, fitted, person, frames, study, side)
        for unit, parameter in (("mm", "sup"), ("deg", "trans")):
            gathered.single(f"subtalar in talus, {unit}", f"subtalar_{side}.talus.{parameter}", fitted, unit)
    return gathered.figures()


def _hip_peer(gathered: Gathered, person: IsolatedPerson, study: Study, side: str) -> None:
    for end, peer in zip(("pelvis", "thigh"), score(*poses(study, f"hip_{side}")), strict=True):
        gathered.put(f"hip in {end}, mm", peer=1e3 * float(np.linalg.norm(peer - person.centres[f"hip_{side}"])))


def _axis(
    gathered: Gathered,
    figure: str,
    fitted: Fitted,
    person: IsolatedPerson,
    frames: Mapping[str, SegmentPose],
    study: Study,
    side: str,
) -> None:
    prefix, segment, end, joint = (word.format(s=side) for word in AXES[figure])
    lab: Line = {"proximal": person.proximal, "distal": person.distal}[end][joint]
    true = frames[segment].line(lab)
    for when, values in fitted.times:
        found = line_of(prefix, values)
        gathered.put(f"{figure}, deg", **{when: true.angle(found.direction)})
        gathered.put(f"{figure}, mm", **{when: 1e3 * true.distance(found.point)})
    if joint.startswith("knee"):
        peer = sara(*poses(study, joint))[0 if end == "proximal" else 1]
        gathered.put(f"{figure}, deg", peer=lab.angle(peer.direction))
        gathered.put(f"{figure}, mm", peer=1e3 * peer_distance(lab, peer, frames[segment]))
    own = [n for n in fitted.truth if n.startswith(f"{prefix}.")]
    for unit, words in (("deg", ("front", "trans", "sag")), ("mm", DIRECTIONS)):
        gathered.add_bars(f"{figure}, {unit}", fitted.bars([n for n in own if n.endswith(words)], unit))


def peer_distance(true: Line, found: Line, frame: SegmentPose) -> float:
    """Distance (m) of two lines where the found one meets the segment's plane of lateral position zero, as ours is."""
    lateral = frame.rotation[:, 2]
    slide = (frame.origin - found.point) @ lateral / (found.direction @ lateral)
    return true.distance(found.point + slide * found.direction)


def line_of(prefix: str, values: Mapping[str, float]) -> Line:
    """The axis that joint parameters (m, rad) tell in their segment."""
    point = np.array([values.get(f"{prefix}.{d}", 0.0) for d in DIRECTIONS])
    if f"{prefix}.sag" in values:
        return Line(point, x_axis(values[f"{prefix}.trans"], values[f"{prefix}.sag"]))
    return Line(point, z_axis(values[f"{prefix}.front"], values[f"{prefix}.trans"]))


def poses(study: Study, joint: str) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Poses of the clusters above and below a joint along its isolated trial, from their places in the static trial."""
    name, side = joint.split("_")
    above, below = {"hip": ("pelvis", f"thigh_{side}"), "knee": (f"thigh_{side}", f"shank_{side}")}[name]
    static = study.static.recording
    recording = next(t.recording for t in study.moving if t.joint == joint)
    rest = dict(zip(static.labels, static.markers.mean(axis=0), strict=True))

    def pose(segment: str) -> tuple[Array, Array]:
        labels = study.marker_set.tracking[segment]
        columns = [recording.labels.index(label) for label in labels]
        return rigid_motion(np.array([rest[label] for label in labels]), recording.markers[:, columns])

    return pose(above), pose(below)
