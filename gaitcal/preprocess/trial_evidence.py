"""What all checks look at: one trial, what it is measured against, and how a finding in it is told."""

from dataclasses import dataclass, replace
from functools import cached_property, partialmethod

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Code, Finding, InputError, Severity
from gaitcal.io.axes import LEAST_PROGRESSION_M, measure_progression
from gaitcal.io.recording import Recording, average_visible, find_still_window, find_visible
from gaitcal.model.linkage import joint_segments
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.rebuilt_markers import Outlier, Rebuilding
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.preprocess.joint_links import JointLink, links_of
from gaitcal.preprocess.marker_clusters import MarkerCluster, Stance, clusters_of
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import Role, Trial, cleaned_trial
from gaitcal.tracking.rigid import RigidFit, segment_fit

NEGLIGIBLE_WEIGHT = 0.1
"""Weight up to which a marker decides nothing: arms, whose skin stays behind when the bone turns,
among others.
"""


@dataclass(frozen=True, kw_only=True)
class TrialEvidence:
    """One trial, and what it is measured against."""

    trial: Trial
    marker_set: MarkerSet
    subject: Subject
    settings: CalibrationSettings
    model: SubjectModel | None  # Nominal; None where the static trial gives none
    stance: Stance | None = (
        None  # The static posture of pelvis and legs; None where there is no model
    )
    outliers: tuple[
        Outlier, ...
    ] = ()  # Markers that the recording lacks where they were metres away from the body
    as_read: Recording | None = (
        None  # Of a moving trial whose exchanged labels were put back: with them exchanged
    )
    rebuilding: Rebuilding | None = None
    """Of the static trial that makes the model: markers that it lost, and what other trials gave
    back.
    """

    @classmethod
    def of(
        cls,
        trial: Trial,
        marker_set: MarkerSet,
        subject: Subject,
        settings: CalibrationSettings,
        model: SubjectModel | None,
        stance: Stance | None = None,
    ) -> "TrialEvidence":
        """The evidence of a trial without markers that are metres away from the body, as it will be
        fitted.
        """
        trial = cleaned_trial(trial, marker_set.segment_of, marker_set.noise)
        found = cls(
            trial=trial, marker_set=marker_set, subject=subject, settings=settings, model=model
        )
        return replace(found, stance=stance, outliers=trial.outliers or ())

    def with_recording(self, recording: Recording) -> "TrialEvidence":
        """The same trial as another recording has it."""
        return replace(self, trial=replace(self.trial, recording=recording))

    def with_markers(self, markers: Array) -> "TrialEvidence":
        """The same trial with other positions (nf, nm, 3) m."""
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
    def source(self) -> str:
        """The file of the markers."""
        return self.recording.source

    def finding(
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
        """Something found in this trial; it puts blame on the file of its markers, unless it is a
        note.
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

    error = partialmethod(finding, Severity.ERROR)
    warning = partialmethod(finding, Severity.WARNING)
    info = partialmethod(finding, Severity.INFO)

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
        """Whether the whole body is fitted: a walk, or any other activity."""
        return self.trial.role in (Role.GAIT, Role.MOTION)

    @property
    def is_isolated(self) -> bool:
        """Whether one joint moves in isolation."""
        return self.trial.role is Role.JOINT

    @cached_property
    def as_fitted(self) -> "TrialEvidence":
        """The trial with the markers that it is fitted by alone: of an isolated trial those of its
        joint's segments.
        """
        if self.trial.joint is None:
            return self
        segments, of = joint_segments(self.trial.joint), self.marker_set.segment_of
        kept = [i for i, label in enumerate(self.recording.labels) if of.get(label) in segments]
        labels = tuple(self.recording.labels[i] for i in kept)
        return self.with_recording(
            replace(self.recording, labels=labels, markers=self.recording.markers[:, kept])
        )

    @property
    def makes_model(self) -> bool:
        """Whether this static trial is the one of which the model is made."""
        return self.rebuilding is not None

    @cached_property
    def place(self) -> dict[str, int]:
        """Label -> column of the recording."""
        return {label: i for i, label in enumerate(self.recording.labels)}

    @cached_property
    def seen(self) -> BoolArray:
        """(nf, nm)."""
        return find_visible(self.recording.markers)

    @cached_property
    def expected(self) -> tuple[str, ...]:
        """Markers with weight that this trial should have: those that are tracked, and in the
        static trial all.

        What it lost is told by itself (`markers.rebuilt`, `markers.not_rebuilt`).
        """
        groups = list(self.marker_set.tracking.items())
        if self.is_static:
            groups += list(self.marker_set.static_only.items())
        lost = {outlier.label for outlier in self.outliers if outlier.frames == outlier.of}
        lost |= (
            set() if self.rebuilding is None else {*self.rebuilding.labels, *self.rebuilding.left}
        )
        return tuple(
            m for _, labels in groups for m in labels if self.weight(m) > 0 and m not in lost
        )

    @cached_property
    def present(self) -> tuple[str, ...]:
        """Those of the expected markers that the file names."""
        return tuple(label for label in self.expected if label in self.place)

    def weight(self, label: str) -> float:
        """Weight of a marker in this study."""
        return self.marker_set.weight(label)

    def path(self, label: str) -> Array:
        """(nf, 3) m, where a marker of the file was; NaN in gaps."""
        return self.recording.markers[:, self.place[label]]

    def ever_seen(self, label: str) -> bool:
        """Whether a marker of the file has a position in any frame."""
        return bool(self.seen[:, self.place[label]].any())

    def landmark(self, name: str) -> Array | None:
        """(nf, 3) m path of a landmark; NaN in gaps; None where the trial lacks one of its markers."""
        labels = self.marker_set.landmarks.get(name, ())
        if not labels or any(label not in self.place for label in labels):
            return None
        out: Array = self.recording.markers[:, [self.place[label] for label in labels]].mean(axis=1)
        return out if np.isfinite(out).any() else None

    @cached_property
    def still_frames(self) -> slice | None:
        """Frames in which the person stands still; None where nobody does."""
        try:
            return find_still_window(self.recording, self.marker_set.labels).frames
        except InputError:
            return None

    @cached_property
    def posture(self) -> dict[str, Array] | None:
        """Landmark -> (3,) m, mean of the still window of a static trial; None where nobody stands
        still in it.
        """
        if not self.is_static:
            return None
        if (
            self.rebuilding is not None and self.rebuilding.markers
        ):  # the others are judged beside what was rebuilt
            return replace(self.with_recording(self.rebuilding.static), rebuilding=None).posture
        if self.still_frames is None:
            return None
        paths = {name: self.landmark(name) for name in self.marker_set.landmarks}
        return average_visible(
            {name: path[self.still_frames] for name, path in paths.items() if path is not None}
        )

    @cached_property
    def still_positions(self) -> dict[str, Array]:
        """Label -> (3,) m, mean over the still window, of the set's markers; empty where nobody
        stands still.
        """
        if self.still_frames is None:
            return {}
        labels = [label for label in self.marker_set.labels if label in self.place]
        return average_visible({label: self.path(label)[self.still_frames] for label in labels})

    @cached_property
    def templates(self) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Segment -> labels that are in this trial, and their positions (nm, 3) m in the static
        posture.
        """
        if self.model is None:
            return {}
        markers = self.model.markers
        rows = {segment: markers.on(segment, self.place) for segment in markers.segments}
        return {
            s: (tuple(markers.labels[i] for i in own), markers.local[own])
            for s, own in rows.items()
        }

    def weighed(self, segment: str) -> list[str]:
        """Markers of a segment of the model that this trial shows and that have weight."""
        labels, _ = self.templates.get(segment, ((), np.empty((0, 3))))
        return [m for m in labels if self.weight(m) > 0 and self.ever_seen(m)]

    @cached_property
    def clusters(self) -> dict[str, MarkerCluster]:
        """Segment -> its markers against the static posture, of pelvis and legs; empty in the
        static trial.
        """
        if self.stance is None or self.is_static:
            return {}
        landmarks = self.marker_set.landmarks
        return clusters_of(
            self.recording, self.stance, landmarks, lambda m: self.weight(m) > NEGLIGIBLE_WEIGHT
        )

    @cached_property
    def links(self) -> dict[str, JointLink]:
        """Joint of a leg -> how its two segments lie near the static posture."""
        return {} if self.stance is None else links_of(self.clusters, self.stance.centres)

    @cached_property
    def pelvis(self) -> RigidFit | None:
        """Rigid fit of the pelvis markers; None with fewer than three, or where they never show its
        turn.
        """
        return (
            None
            if self.model is None
            else segment_fit(self.model.markers, "pelvis", self.recording)
        )

    @cached_property
    def way(self) -> Array:
        """(2,) m, x and z, by which the body gets on."""
        return measure_progression(self.recording)[[0, 2]]

    @property
    def on_the_spot(self) -> bool:
        """Whether the body does not get on, as on a treadmill."""
        return float(np.linalg.norm(self.way)) < LEAST_PROGRESSION_M

    @cached_property
    def facing(self) -> Array | None:
        """(2,) x and z, where the pelvis faces on the whole; None where it is not seen."""
        if self.pelvis is None:
            return None
        out: Array = self.pelvis.rotation[self.pelvis.determined][:, [0, 2], 0].mean(axis=0)
        return out


def side_of(name: str) -> str:
    """`r` or `l` of a segment or joint; empty for others."""
    return name[-1] if name.endswith(("_r", "_l")) else ""
