"""Skin that moves with the joints beside it: how large it may be, and which columns it gives a trial.

Markers on skin drift against the bone in proportion to the angles of the joints at both ends of their segment (Bonci et
al., J Biomech 47:2354-2361, 2014). Per 60 degrees of one angle, all markers of a segment shift together, turn together
about their middle, and move each by itself; standard deviations below, per component, from the ranges found with bone
pins and fluoroscopy (Leardini et al., Gait Posture 21:212-225, 2005; Peters et al., Gait Posture 31:1-8, 2010; Barre et
al., J Biomech 48:1965-1971, 2015). With e a unit vector, l a marker's place and c the middle of the markers,

    displacement of a marker = angle * ( shift + turn x (l - c) + own ),

so that the columns of `motion/soft_tissue.py` of one segment and one angle have the prior covariance

    size^2 ( B diag(shift^2, turn^2) B^T + own^2 I ),     B = [ 1, -(l - c) x ] marker by marker.

`size` is found for every segment and angle by itself (`skin_evidence.py`), at most `LARGEST`; on segments of fewer than
three markers, which do not show how they deform, it is `LARGEST`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.linkage import JOINTS, Source
from gaitcal.motion.soft_tissue import SegmentTissue, SoftTissue
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.records import dataclass

LARGEST = 0.5
"""Of the sizes below: with more, a joint hides behind skin that is not there (truth benches)."""


@dataclass(frozen=True)
class SkinSize:
    """Standard deviations of one component per rad."""

    shift: float
    """m."""
    turn: float
    """rad."""
    own: float
    """m, of every marker by itself."""


def _per_60_degrees(shift_mm: float, turn_deg: float, own_mm: float) -> SkinSize:
    per_rad = 3.0 / np.pi
    return SkinSize(1e-3 * shift_mm * per_rad, np.deg2rad(turn_deg) * per_rad, 1e-3 * own_mm * per_rad)


SIZES: Mapping[str, SkinSize] = {
    "pelvis": _per_60_degrees(2.5, 0.5, 1.5),
    "thigh": _per_60_degrees(8.0, 4.0, 4.0),
    "shank": _per_60_degrees(4.0, 2.0, 2.5),
    "foot": _per_60_degrees(2.0, 1.0, 1.5),
}
"""Segments whose skin is known, by the first word of their names."""


def beside(segment: str) -> tuple[str, ...]:
    """Coordinates of the joints of the legs at both ends of a segment; the talus carries no skin."""
    through = (segment, segment.replace("shank", "talus").replace("foot", "talus"))
    return tuple(
        e.name
        for joint in JOINTS
        if joint.name.startswith(("hip", "knee", "talocrural", "subtalar"))
        and (joint.parent in through or joint.child in through)
        and segment in _ends(joint.name, joint.parent, joint.child)
        for e in joint.elements
        if e.source is Source.COORDINATE
    )


def _ends(joint: str, parent: str, child: str) -> tuple[str, ...]:
    """The segments with markers that a joint's skin belongs to: shank and foot for both joints of the ankle."""
    side = joint[-1]
    if joint.startswith("talocrural"):
        return (parent, f"foot_{side}")
    return (f"foot_{side}",) if joint.startswith("subtalar") else (parent, child)


def skin_columns(problem: TrialProblem, angles: Mapping[str, Array]) -> SoftTissue | None:
    """Every column that the skin of a trial may have; None where there is none.

    `angles`: coordinate -> (nf,) rad from the static pose; those that no marker of the trial shows are left out.
    """
    groups = []
    for s, markers in problem.data.placed.groups:
        segment = problem.chain.segments[s]
        names = tuple(name for name in beside(segment) if name in angles)
        if segment.split("_")[0] in SIZES and names and (problem.data.weight[markers] > 0).any():
            groups.append(SegmentTissue(s, markers, names, np.array([angles[name] for name in names])))
    return SoftTissue(tuple(groups), problem.labels) if groups else None


def only(
    tissue: SoftTissue | None, segments: Sequence[str], wanted: Mapping[tuple[str, str], float]
) -> SoftTissue | None:
    """The columns of the (segment, coordinate) pairs that have a size; `segments`: names of the chain's."""
    groups = []
    for group in tissue.groups if tissue else ():
        kept = [k for k, name in enumerate(group.names) if (segments[group.segment], name) in wanted]
        if kept:
            names = tuple(group.names[k] for k in kept)
            groups.append(SegmentTissue(group.segment, group.markers, names, group.regressors[kept]))
    return SoftTissue(tuple(groups), tissue.labels) if tissue and groups else None


def unit_covariance(segment: str, local: Array) -> Array:
    """(3 nm, 3 nm) prior covariance of the columns of one angle, size 1, of markers at `local` (nm, 3) m."""
    size = SIZES[segment.split("_")[0]]
    arm = local - local.mean(axis=0)
    together = np.concatenate([shifts_and_turns(a) for a in arm])
    scale = np.repeat([size.shift, size.turn], 3)
    scaled = together * scale
    out: Array = scaled @ scaled.T + size.own**2 * np.eye(len(scaled))
    return out


def shifts_and_turns(arm: Array) -> Array:
    """(3, 6) displacement of a marker at `arm` (3,) by unit shifts along and turns about x, y, z."""
    return np.hstack([np.eye(3), np.cross(np.eye(3), arm).T])
