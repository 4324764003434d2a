"""A cluster that was knocked between the static trial and the moving ones, put where the rest of
the leg has it.

A cluster that slid or turned on its segment (`static_disagreement.py`) says nothing of the bone by its
static place; its place while the person moves is told by what it did not take along. Points p_k
that the bone has in the static posture (the joint centres, the axis of the knee, markers of the
segment on landmarks) are seen in every frame at x_k, joints as the neighbouring segments carry
them. With R_f, o_f the rigid motion of the p_k nearest to the x_k, marker i at y_i is

    l_i = median_f R_f^T (y_i,f - o_f)

in the static posture, the mean over the trials that tell of it. The neighbours may borrow no
points, and all moving trials must agree with the static posture then: else nothing is placed.

How far R_f, o_f and the cluster wander about each other, RMS over the frames, and how far joints of
people who move lie from where they stand (the limits of `joint_links.py` over SPREAD) is how far the
place of the cluster is uncertain: by so much the joint parameters in that segment may lie elsewhere
than its neighbours say.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import STUDY, Code, Finding, Severity, listed
from gaitcal.model import linkage, parameters, segment_frames
from gaitcal.preprocess import joint_links, static_disagreement, trial_evidence
from gaitcal.preprocess.marker_clusters import align_points
from gaitcal.study.study import Study

KNEE_HALF_M = 0.05  # Half the length of the knee's axis, as the epicondyles mark it
FEWEST_FRAMES = 20


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Where the moving trials have a cluster."""

    segment: str
    labels: tuple[str, ...]
    before: Array  # (n, 3) m, in the static posture
    after: Array  # (n, 3) m, as the moving trials have it
    shift_spread: float  # m
    rotation_spread: float  # rad
    trials: tuple[str, ...]

    @property
    def description(self) -> str:
        """How far off it was, by which trials it was placed, and how well."""
        turn, shift = (
            joint_links.compute_rotation_angle(align_points(self.before, self.after)[0]),
            (self.after - self.before).mean(axis=0),
        )
        found = (
            f"{listed([repr(m) for m in self.labels])} of {self.segment} sit "
            f"{1e3 * np.linalg.norm(shift):.0f} mm "
        )
        found += (
            f"and {np.rad2deg(turn):.0f} deg from where the static trial has them; they are placed "
            "by the rest of "
        )
        found += f"the leg in {listed(list(self.trials))}, to {1e3 * self.shift_spread:.0f} mm and "
        return f"{found}{np.rad2deg(self.rotation_spread):.0f} deg, which the error bars count"

    @property
    def finding(self) -> Finding:
        """The same as a note."""
        cure, topic = (
            "another static trial, recorded with the markers as they sit in the others, is better",
            "one body",
        )
        code, note = Code.CLUSTER_SLID, Severity.INFO
        return Finding(
            code=code, severity=note, topic=topic, where=STUDY, found=self.description, cure=cure
        )


def find_placement(trials: Sequence[trial_evidence.TrialEvidence]) -> Placement | None:
    """The cluster that most moving trials have elsewhere than the static one, where the rest of the
    leg tells where.
    """
    told: dict[tuple[str, tuple[str, ...]], list[tuple[float, trial_evidence.TrialEvidence]]] = {}
    for trial in trials:
        for cause in trial.contradictions:
            if cause.fault is static_disagreement.Fault.CLUSTER:
                told.setdefault((cause.segment, cause.labels), []).append((cause.excess, trial))
    for (segment, labels), of in sorted(
        told.items(), key=lambda pair: -sum(excess for excess, _ in pair[1])
    ):
        if (placed := _fit_placement(segment, labels, [trial for _, trial in of])) is not None:
            return placed
    return None


def _fit_placement(
    segment: str, labels: tuple[str, ...], trials: Sequence[trial_evidence.TrialEvidence]
) -> Placement | None:
    """By those of these trials that tell; None where none does."""
    places = [local for t in trials if (local := _locate_cluster(t, segment, labels)) is not None]
    if not places:
        return None
    cluster = trials[0].clusters[segment]
    before = cluster.static[[cluster.labels.index(m) for m in labels]]
    place = np.mean([np.median(local, axis=0) for local in places], axis=0)
    middle, wander = place.mean(axis=0), np.concatenate(places)
    turn, _ = segment_frames.fit_rigid_motions(place, wander)
    away = wander.mean(axis=1) - middle
    links = [
        link for t in trials for link in t.links.values() if segment in (link.above, link.below)
    ]
    limits = (
        np.max([(k.gap_base, k.rotation_base.max()) for k in links], axis=0)
        / static_disagreement.SPREAD
    )
    return Placement(
        segment=segment,
        labels=labels,
        before=before,
        after=place,
        shift_spread=float(np.hypot(limits[0], np.sqrt(np.mean((away**2).sum(axis=1)) / 3.0))),
        rotation_spread=float(
            np.hypot(
                limits[1], np.sqrt(np.mean(joint_links.compute_rotation_angle(turn) ** 2) / 3.0)
            )
        ),
        trials=tuple(t.name for t in trials),
    )


def _locate_cluster(
    trial: trial_evidence.TrialEvidence, segment: str, labels: Sequence[str]
) -> Array | None:
    """(nf, n, 3) m, the cluster's markers in the static posture of the bone, by frame; None where
    nothing tells.
    """
    stance, (part, _, side) = trial.stance, segment.partition("_")
    cluster = trial.clusters[segment]
    if stance is None or part not in ("thigh", "shank"):
        return None
    joints = [(f"{name}_{side}", pair) for name, pair in joint_links.CHAIN.items() if part in pair]
    axis = np.array([0.0, 0.0, KNEE_HALF_M])
    points, paths = list[Array](), list[Array]()
    for joint, pair in joints:
        other = pair[1 - pair.index(part)]
        neighbour = trial.clusters.get(linkage.add_side(other, side))
        if neighbour is None or neighbour.borrowed:
            return None
        ends = (axis, -axis) if joint.startswith("knee") else (0.0 * axis,)
        for end in ends:
            points.append(stance.centres[joint] + end)
            paths.append(neighbour.transform_point(points[-1]))
    for label in cluster.labels[: cluster.marker_count]:
        if label not in labels:
            points.append(stance.points[segment][label])
            paths.append(trial.path(label))
    together = np.stack([*paths, *(trial.path(m) for m in labels)], axis=1)
    together = together[np.isfinite(together).all(axis=(1, 2))]
    if len(together) < FEWEST_FRAMES:
        return None
    turn, origin = segment_frames.fit_rigid_motions(np.array(points), together[:, : len(points)])
    return np.einsum("fji,fnj->fni", turn, together[:, len(points) :] - origin[:, None])


def apply_placement(study: Study, static: trial_evidence.TrialEvidence, one: Placement) -> Study:
    """The study with a cluster of its static trial where the moving trials have it, and its joints
    less known.
    """
    recording = study.static.recording
    axes, _ = align_points(one.before, np.array([static.still_positions[m] for m in one.labels]))
    markers = recording.markers.copy()
    markers[:, [recording.labels.index(m) for m in one.labels]] += (one.after - one.before) @ axes.T
    less = {
        p.name: one.shift_spread
        if p.kind is parameters.ParameterKind.POSITION
        else one.rotation_spread
        for p in parameters.JOINT_PARAMETERS
        if p.segment == one.segment
    }
    placed = replace(
        study.static, recording=replace(recording, markers=markers).with_notes(one.description)
    )
    trials = tuple(placed if t is study.static else t for t in study.trials)
    return replace(study, trials=trials, loosened={**study.loosened, **less})
