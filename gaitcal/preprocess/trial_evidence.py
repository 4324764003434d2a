"""The evidence of one trial: its clean recording, its references, and the comparison.

Properties of a `TrialEvidence` are computed when they are first used, and kept.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partialmethod

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Code, Finding, InputError, Severity
from gaitcal.io.axes import LEAST_PROGRESSION_M, measure_progression
from gaitcal.io.recording import Recording, average_visible, find_still_window, find_visible
from gaitcal.model.linkage import list_joint_segments
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.preprocess.clean_trial import CleanTrial, Outlier
from gaitcal.preprocess.displaced_markers import DisplacedInterval, find_displaced_intervals
from gaitcal.preprocess.joint_links import JointLink, compute_joint_links
from gaitcal.preprocess.marker_clusters import MarkerCluster, Stance, fit_clusters
from gaitcal.preprocess.plate_contacts import Feet, PlateContact, find_plate_contacts
from gaitcal.preprocess.rebuilt_markers import MarkerReconstruction
from gaitcal.preprocess.static_disagreement import Contradiction, find_contradictions
from gaitcal.preprocess.swapped_labels import SwappedLabels, find_swapped_labels, restore_labels
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import Role
from gaitcal.tracking.rigid import RigidFit, fit_segment

NEGLIGIBLE_WEIGHT = 0.1
"""Weight up to which a marker is not counted: for example those of the arms, whose skin does not
follow the rotation of the bone.
"""
BODY_SIZE = (0.05, 4.0)
"""Size of the cloud of markers, in body heights, outside which the unit of length must be wrong.
One shank with its foot measures 0.3."""


@dataclass(frozen=True, kw_only=True)
class TrialEvidence:
    """One trial, and the references for its checks."""

    trial: CleanTrial
    marker_set: MarkerSet
    subject: Subject
    settings: CalibrationSettings
    model: SubjectModel | None = None
    """Nominal; None if the static trial gives none."""
    stance: Stance | None = None
    """The static posture of pelvis and legs; None without a model."""
    restored_swaps: tuple[SwappedLabels, ...] = ()
    """Of a moving trial: labels that were swapped for a part of it, and were put back."""
    rebuilding: MarkerReconstruction | None = None
    """Of the static trial that makes the model: markers that it lost, and their reconstruction."""

    def with_recording(self, recording: Recording) -> "TrialEvidence":
        """Return the same trial with another recording."""
        return replace(self, trial=replace(self.trial, recording=recording))

    def with_markers(self, markers: Array) -> "TrialEvidence":
        """Return the same trial with other positions (nf, nm, 3) m."""
        return self.with_recording(replace(self.recording, markers=markers))

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.trial.name

    @property
    def recording(self) -> Recording:
        """Markers and plates, y up, in the directions of the file."""
        return self.trial.recording

    @property
    def outliers(self) -> tuple[Outlier, ...]:
        """Markers that were removed in frames in which they are metres away from the body."""
        return self.trial.outliers

    @property
    def source(self) -> str:
        """The file of the markers."""
        return self.recording.source

    def make_finding(
        self,
        severity: Severity,
        topic: str,
        found: str,
        cure: str = "",
        *,
        code: Code,
        cause: str = "",
        leg: str = "",
        weight: float = 1.0,
    ) -> Finding:
        """Make a finding in this trial.

        Parameters
        ----------
        severity
            A note names no file, an error or warning the file of the markers as its source.
        topic
            Heading of the check.
        found
            Evidence, with numbers.
        cure
            Remedy.
        code
            Of the finding.
        cause
            Its consequence.
        leg
            `r` or `l`, if one leg is concerned.
        weight
            Of the finding in the verdict.

        Returns
        -------
        Finding
        """
        return Finding(
            code=code,
            severity=severity,
            topic=topic,
            where=self.name,
            found=found,
            cure=cure,
            source="" if severity is Severity.INFO else self.source,
            cause=cause,
            leg=leg,
            weight=weight,
        )

    error = partialmethod(make_finding, Severity.ERROR)
    warning = partialmethod(make_finding, Severity.WARNING)
    info = partialmethod(make_finding, Severity.INFO)

    @property
    def is_static(self) -> bool:
        """Whether this is the trial in which the person stands."""
        return self.trial.role is Role.STATIC

    @property
    def is_gait(self) -> bool:
        """Whether the person walks."""
        return self.trial.role is Role.GAIT

    @property
    def is_whole_body(self) -> bool:
        """Whether the whole body is fitted: a walk or any other activity."""
        return self.trial.role in (Role.GAIT, Role.MOTION)

    @property
    def is_isolated(self) -> bool:
        """Whether this is a functional trial, in which one joint moves."""
        return self.trial.role is Role.JOINT

    @cached_property
    def as_fitted(self) -> "TrialEvidence":
        """The trial with the fitted markers alone: of a functional trial those of its joint."""
        if self.trial.joint is None:
            return self
        segments, segment_of = list_joint_segments(self.trial.joint), self.marker_set.segment_of
        kept = [
            i for i, label in enumerate(self.recording.labels) if segment_of.get(label) in segments
        ]
        labels = tuple(self.recording.labels[i] for i in kept)
        return self.with_recording(
            replace(self.recording, labels=labels, markers=self.recording.markers[:, kept])
        )

    @property
    def makes_model(self) -> bool:
        """Whether this is the static trial from which the model is made."""
        return self.rebuilding is not None

    @cached_property
    def column(self) -> dict[str, int]:
        """Label -> column of the recording."""
        return {label: i for i, label in enumerate(self.recording.labels)}

    @cached_property
    def visible(self) -> BoolArray:
        """Whether (nf, nm) each marker is visible."""
        return find_visible(self.recording.markers)

    @cached_property
    def expected(self) -> tuple[str, ...]:
        """Markers with weight that this trial should have: the tracked, in a static trial all.

        Markers that it lost are reported elsewhere (`markers.rebuilt`, `markers.not_rebuilt`).
        """
        groups = list(self.marker_set.tracking.values())
        if self.is_static:
            groups += list(self.marker_set.static_only.values())
        lost = {one.label for one in self.outliers if one.frames == one.visible_frames}
        if self.rebuilding is not None:
            lost |= {*self.rebuilding.labels, *self.rebuilding.not_reconstructed}
        labels = (label for group in groups for label in group)
        return tuple(label for label in labels if self.weight(label) > 0 and label not in lost)

    @cached_property
    def present(self) -> tuple[str, ...]:
        """Those of the expected markers that the file contains."""
        return tuple(label for label in self.expected if label in self.column)

    def weight(self, label: str) -> float:
        """Return the weight of a marker in this study; 0: not fitted."""
        return self.marker_set.weight(label)

    def path(self, label: str) -> Array:
        """Return the path (nf, 3) m of a marker of the file; NaN in gaps."""
        return self.recording.markers[:, self.column[label]]

    def is_ever_visible(self, label: str) -> bool:
        """Return whether a marker of the file is visible in any frame."""
        return bool(self.visible[:, self.column[label]].any())

    def landmark(self, name: str) -> Array | None:
        """Return the path of a landmark: the mean of its markers.

        Parameters
        ----------
        name
            Landmark of the marker set.

        Returns
        -------
        Array or None
            (nf, 3) m, NaN in gaps; None if the trial lacks one of its markers.
        """
        labels = self.marker_set.landmarks.get(name, ())
        if not labels or any(label not in self.column for label in labels):
            return None
        out: Array = self.recording.markers[:, [self.column[label] for label in labels]].mean(
            axis=1
        )
        return out if np.isfinite(out).any() else None

    @cached_property
    def still_frames(self) -> slice | None:
        """Frames of the still window; None without one."""
        try:
            return find_still_window(self.recording, self.marker_set.labels).frames
        except InputError:
            return None

    @cached_property
    def posture(self) -> dict[str, Array] | None:
        """Landmark -> (3,) m, mean of the still window of a static trial; None without one."""
        if not self.is_static:
            return None
        # with the reconstructed markers, if there are any
        if self.rebuilding is not None and self.rebuilding.markers:
            return replace(self.with_recording(self.rebuilding.static), rebuilding=None).posture
        if self.still_frames is None:
            return None
        paths = {name: self.landmark(name) for name in self.marker_set.landmarks}
        return average_visible(
            {name: path[self.still_frames] for name, path in paths.items() if path is not None}
        )

    @cached_property
    def still_positions(self) -> dict[str, Array]:
        """Label of the set -> (3,) m, mean of the still window; empty without one."""
        if self.still_frames is None:
            return {}
        labels = [label for label in self.marker_set.labels if label in self.column]
        return average_visible({label: self.path(label)[self.still_frames] for label in labels})

    @cached_property
    def templates(self) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Segment -> labels in this trial, and their positions (nm, 3) m in the static posture."""
        if self.model is None:
            return {}
        markers = self.model.markers
        rows = {segment: markers.find_markers(segment, self.column) for segment in markers.segments}
        out: dict[str, tuple[tuple[str, ...], Array]] = {}
        for segment, indices in rows.items():
            out[segment] = tuple(markers.labels[i] for i in indices), markers.local[indices]
        return out

    def list_weighted_markers(self, segment: str) -> list[str]:
        """List the visible markers with weight on a segment of the model.

        Parameters
        ----------
        segment
            Of the model.

        Returns
        -------
        list of str
        """
        labels, _ = self.templates.get(segment, ((), np.empty((0, 3))))
        return [m for m in labels if self.weight(m) > 0 and self.is_ever_visible(m)]

    @cached_property
    def clusters(self) -> dict[str, MarkerCluster]:
        """Segment of pelvis and legs -> its cluster; empty in a static trial."""
        if self.stance is None or self.is_static:
            return {}
        landmarks = self.marker_set.landmarks
        return fit_clusters(
            self.recording, self.stance, landmarks, lambda m: self.weight(m) > NEGLIGIBLE_WEIGHT
        )

    @cached_property
    def links(self) -> dict[str, JointLink]:
        """Joint of a leg -> relative pose of its two segments near the static posture."""
        return (
            {} if self.stance is None else compute_joint_links(self.clusters, self.stance.centres)
        )

    @cached_property
    def extent(self) -> float | None:
        """Diagonal (m) of the box around the set's markers, median over frames.

        None if no frame shows three markers.
        """
        columns = [self.column[m] for m in self.marker_set.labels if m in self.column]
        frames = np.flatnonzero(self.visible[:, columns].sum(axis=1) >= 3)
        if not len(frames):
            return None
        spread = frames[:: max(1, len(frames) // 200)]
        x = self.recording.markers[spread][:, columns]
        box = np.nanmax(x, axis=1) - np.nanmin(x, axis=1)
        return float(np.median(np.linalg.norm(box, axis=1)))

    @property
    def has_body_size(self) -> bool:
        """Whether the cloud of markers may be a person; also if too few markers are visible."""
        least, most = (size * self.subject.height for size in BODY_SIZE)
        return self.extent is None or least < self.extent < most

    @cached_property
    def swapped_labels(self) -> tuple[SwappedLabels, ...]:
        """Pairs of labels that are swapped in some frames, each once."""
        fitted = self.as_fitted
        return find_swapped_labels(fitted.recording, fitted.templates, self.marker_set.noise)

    @cached_property
    def with_labels_restored(self) -> "TrialEvidence":
        """The trial with all swaps undone, so that other faults show; itself without swaps."""
        if not self.swapped_labels:
            return self
        return self.with_recording(restore_labels(self.recording, self.swapped_labels))

    @cached_property
    def contradictions(self) -> tuple[Contradiction, ...]:
        """Contradictions of a moving trial to the static one, in its fitted segments."""
        found, joint = find_contradictions(self.clusters, self.links), self.trial.joint
        if joint is None:
            return found
        return tuple(c for c in found if c.segment in (joint, *list_joint_segments(joint)))

    @cached_property
    def displaced(self) -> dict[str, list[DisplacedInterval]]:
        """Marker -> intervals in which it is displaced in its segment."""
        fitted = self.as_fitted
        return find_displaced_intervals(fitted.recording, fitted.clusters)

    @cached_property
    def pelvis(self) -> RigidFit | None:
        """Rigid fit of the pelvis markers; None with fewer than three, or with a free rotation."""
        return (
            None
            if self.model is None
            else fit_segment(self.model.markers, "pelvis", self.recording)
        )

    @cached_property
    def progression(self) -> Array:
        """Displacement (2,) m, x and z, of the body over the trial."""
        return measure_progression(self.recording)[[0, 2]]

    @property
    def on_the_spot(self) -> bool:
        """Whether the body stays in one position, as on a treadmill."""
        return float(np.linalg.norm(self.progression)) < LEAST_PROGRESSION_M

    @cached_property
    def facing(self) -> Array | None:
        """Mean direction (2,), x and z, of the pelvis; None if it is not visible."""
        if self.pelvis is None:
            return None
        out: Array = self.pelvis.rotation[self.pelvis.determined][:, [0, 2], 0].mean(axis=0)
        return out

    @cached_property
    def feet(self) -> Feet | None:
        """The feet of a gait trial; None in other trials, or if no foot is visible."""
        if not self.is_gait or len(self.recording.time) < 3:
            return None
        feet = Feet(self.recording.time, self.landmark)
        return feet if feet.visible.any() else None

    @cached_property
    def walked(self) -> Array:
        """Displacement (2,) m, x and z, of the walking person over the floor or over the belts.

        Without any: a unit vector in the direction of the pelvis, or zero if it is not visible.
        """
        walked, feet = self.progression, self.feet if self.on_the_spot else None
        if feet is not None:
            belt = feet.belt_velocities.mean(axis=0)[[0, 2]]
            walked = walked - np.ptp(self.recording.time) * belt
        if np.linalg.norm(walked) >= LEAST_PROGRESSION_M or self.facing is None:
            return np.asarray(walked)
        return np.asarray(self.facing / max(float(np.linalg.norm(self.facing)), 1e-12))

    @cached_property
    def plate_contacts(self) -> tuple[PlateContact, ...]:
        """Loadings of all plates that last longer than a knock; none if no foot is visible."""
        if self.feet is None:
            return ()
        return find_plate_contacts(self.feet, self.recording.plates, self.subject.height)


def get_side(name: str) -> str:
    """Return the side of a segment or joint: `r`, `l` or empty."""
    return name[-1] if name.endswith(("_r", "_l")) else ""
