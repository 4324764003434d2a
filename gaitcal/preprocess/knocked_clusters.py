"""Place a cluster that was knocked after the static trial, by the other markers of the leg.

A cluster that slid or rotated on its segment (`static_disagreement.py`) no longer marks the bone by
its static position; its position during movement follows from markers that stayed. Points p_k
of the bone in the static posture (the joint centres, the axis of the knee, markers of the segment
on landmarks) are at x_k in every frame, the joints as the adjacent segments carry them. With R_f,
o_f the rigid motion of the p_k nearest to the x_k, marker i at y_i is at

    l_i = median_f R_f^T (y_i,f - o_f)

in the static posture, averaged over the trials that show it. The adjacent segments must not borrow
points, and all moving trials must then agree with the static posture; otherwise nothing is placed.

The placement is uncertain by the RMS motion of R_f, o_f and the cluster relative to each other, and
by how far joints of moving people lie from their static posture (the limits of `joint_links.py`
over SPREAD). The joint parameters in that segment are loosened by so much.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import STUDY, Code, Finding, Severity, join_names
from gaitcal.model import linkage, parameters, segment_frames
from gaitcal.preprocess import joint_links, static_disagreement, trial_evidence
from gaitcal.preprocess.marker_clusters import align_points
from gaitcal.study.study import Study

KNEE_HALF_M = 0.05
"""m, half the distance of the epicondyles along the knee axis."""
FEWEST_SHARED_FRAMES = 20
"""Frames in which all points and the cluster must be visible."""


@dataclass(frozen=True, kw_only=True)
class Placement:
    """A knocked cluster, and where the moving trials place it."""

    segment: str
    labels: tuple[str, ...]
    before: Array
    """(n, 3) m, positions in the static trial."""
    after: Array
    """(n, 3) m, positions in the static posture according to the moving trials."""
    shift_spread: float
    """m, standard deviation of the displacement."""
    rotation_spread: float
    """rad, standard deviation of the rotation."""
    trials: tuple[str, ...]
    """Names of the moving trials."""

    @property
    def description(self) -> str:
        """Labels, displacement, rotation, the trials that place them, and the uncertainty."""
        angle = joint_links.compute_rotation_angle(align_points(self.before, self.after)[0])
        shift = (self.after - self.before).mean(axis=0)
        return (
            f"{join_names([repr(m) for m in self.labels])} of {self.segment} are "
            f"{1e3 * np.linalg.norm(shift):.0f} mm and {np.rad2deg(angle):.0f} deg away from their "
            "position in the static trial; they are placed by the other markers of the leg in "
            f"{join_names(list(self.trials))}, with an uncertainty of "
            f"{1e3 * self.shift_spread:.0f} mm and {np.rad2deg(self.rotation_spread):.0f} deg, "
            "which the error bars include"
        )

    @property
    def finding(self) -> Finding:
        """The same as a note of the study."""
        return Finding(
            code=Code.CLUSTER_SLID,
            severity=Severity.INFO,
            topic="one body",
            where=STUDY,
            found=self.description,
            cure="record another static trial with the markers as they are in the moving trials",
        )


def find_placement(trials: Sequence[trial_evidence.TrialEvidence]) -> Placement | None:
    """Find the cluster that most moving trials contradict, and place it.

    Parameters
    ----------
    trials
        Moving trials of a study.

    Returns
    -------
    Placement or None
        Of the cluster with the largest total excess that the leg can place; None without any.
    """
    causes: dict[tuple[str, tuple[str, ...]], list[tuple[float, trial_evidence.TrialEvidence]]] = {}
    for trial in trials:
        for cause in trial.contradictions:
            if cause.fault is static_disagreement.Fault.CLUSTER:
                causes.setdefault((cause.segment, cause.labels), []).append((cause.excess, trial))
    # the cluster with the largest total excess first
    ranked = sorted(causes.items(), key=lambda item: -sum(excess for excess, _ in item[1]))
    for (segment, labels), affected in ranked:
        placed = _fit_placement(segment, labels, [trial for _, trial in affected])
        if placed is not None:
            return placed
    return None


def _fit_placement(
    segment: str, labels: tuple[str, ...], trials: Sequence[trial_evidence.TrialEvidence]
) -> Placement | None:
    """Place a cluster by those of these trials that can; None where none does."""
    located = (_locate_cluster(trial, segment, labels) for trial in trials)
    by_trial = [positions for positions in located if positions is not None]
    if not by_trial:
        return None
    cluster = trials[0].clusters[segment]
    before = cluster.static[[cluster.labels.index(m) for m in labels]]
    after = np.mean([np.median(positions, axis=0) for positions in by_trial], axis=0)
    # motion of the cluster relative to the bone over all frames
    in_frames = np.concatenate(by_trial)
    rotation, _ = segment_frames.fit_rigid_motions(after, in_frames)
    away = in_frames.mean(axis=1) - after.mean(axis=0)
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
        after=after,
        shift_spread=float(np.hypot(limits[0], np.sqrt(np.mean((away**2).sum(axis=1)) / 3.0))),
        rotation_spread=float(
            np.hypot(
                limits[1], np.sqrt(np.mean(joint_links.compute_rotation_angle(rotation) ** 2) / 3.0)
            )
        ),
        trials=tuple(t.name for t in trials),
    )


def _locate_cluster(
    trial: trial_evidence.TrialEvidence, segment: str, labels: Sequence[str]
) -> Array | None:
    """Locate (nf, n, 3) m, the cluster's markers in the static posture of the bone in each frame.

    None where the bone is not determined without the cluster.
    """
    stance, (part, _, side) = trial.stance, segment.partition("_")
    cluster = trial.clusters[segment]
    if stance is None or part not in ("thigh", "shank"):
        return None
    joints = [(f"{name}_{side}", pair) for name, pair in joint_links.CHAIN.items() if part in pair]
    axis = np.array([0.0, 0.0, KNEE_HALF_M])
    # the bone: joint centres and knee axis as the adjacent segments carry them
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
    # markers of the segment that were not knocked
    for label in cluster.labels[: cluster.marker_count]:
        if label not in labels:
            points.append(stance.points[segment][label])
            paths.append(trial.path(label))
    together = np.stack([*paths, *(trial.path(m) for m in labels)], axis=1)
    together = together[np.isfinite(together).all(axis=(1, 2))]
    if len(together) < FEWEST_SHARED_FRAMES:
        return None
    rotation, origin = segment_frames.fit_rigid_motions(
        np.array(points), together[:, : len(points)]
    )
    return np.einsum("fji,fnj->fni", rotation, together[:, len(points) :] - origin[:, None])


def apply_placement(
    study: Study, static: trial_evidence.TrialEvidence, placement: Placement
) -> Study:
    """Put a knocked cluster of the static trial where the moving trials place it.

    Parameters
    ----------
    study
        As it was read.
    static
        Evidence of its static trial.
    placement
        New positions of the cluster, and their uncertainty.

    Returns
    -------
    Study
        With new marker positions in the static trial, and the joint parameters of the segment
        loosened by the uncertainty of the placement (`Study.loosened`).
    """
    recording = study.static.recording
    axes, _ = align_points(
        placement.before, np.array([static.still_positions[m] for m in placement.labels])
    )
    markers = recording.markers.copy()
    markers[:, [recording.labels.index(m) for m in placement.labels]] += (
        placement.after - placement.before
    ) @ axes.T
    loosened = {}
    for parameter in parameters.JOINT_PARAMETERS:
        if parameter.segment == placement.segment:
            is_position = parameter.kind is parameters.ParameterKind.POSITION
            loosened[parameter.name] = (
                placement.shift_spread if is_position else placement.rotation_spread
            )
    placed = replace(
        study.static,
        recording=replace(recording, markers=markers).with_notes(placement.description),
    )
    trials = tuple(placed if t is study.static else t for t in study.trials)
    return replace(study, trials=trials, loosened={**study.loosened, **loosened})
