"""What all checks look at: one trial, what it is measured against, and how it says what was found.

What only follows from a cause that is told already is not told beside it: one fault, one finding.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.ground_reactions import CONTRADICTED
from gaitcal.errors import InputError
from gaitcal.faults.bounds import DISAGREE
from gaitcal.faults.bounds import TOPIC as BOUNDS
from gaitcal.faults.cluster import Cluster, clusters_of
from gaitcal.faults.force_diagnosis import TOPIC as FORCES
from gaitcal.faults.joint_places import TOPIC as PLACES
from gaitcal.faults.marker_structure import TOPIC as MARKERS_AFTER
from gaitcal.faults.stance import Stance
from gaitcal.faults.trial_body import JointLink, links_of
from gaitcal.faults.verdict import touches_model
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.gait.moments import joint_words
from gaitcal.io.recording import Recording, seen_mask
from gaitcal.io.still import still_window
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.outliers import Outlier
from gaitcal.model.rebuilt_markers import Rebuilding
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.motion.rigid import RigidFit, rigid_fit
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import Role, StudyTrial, cleaned_trial

LIGHT = 0.1
"""Weight up to which a marker decides nothing: arms, whose skin stays behind when the bone turns, among others."""


@dataclass(frozen=True, kw_only=True)
class TrialEvidence:
    """One trial, and what it is measured against."""

    trial: StudyTrial
    marker_set: MarkerSet
    subject: Subject
    settings: CalibrationSettings
    model: SubjectModel | None
    """Nominal; None where the static trial gives none."""
    stance: Stance | None = None
    """The static posture of pelvis and legs; None where there is no model."""
    strays: tuple[Outlier, ...] = ()
    """Markers that the recording lacks where they were metres away from the body."""
    rebuilding: Rebuilding | None = None
    """Of the static trial that makes the model: markers that it lost, and what other trials gave back."""

    @classmethod
    def of(
        cls,
        trial: StudyTrial,
        marker_set: MarkerSet,
        subject: Subject,
        settings: CalibrationSettings,
        model: SubjectModel | None,
        stance: Stance | None = None,
    ) -> TrialEvidence:
        """The evidence of a trial without markers that are metres away from the body, as it will be fitted."""
        trial = cleaned_trial(trial, marker_set.segment_of)
        return cls(
            trial=trial,
            marker_set=marker_set,
            subject=subject,
            settings=settings,
            model=model,
            stance=stance,
            strays=trial.strays or (),
        )

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
        cure: str,
        *,
        code: Code,
        cause: str = "",
        leg: str = "",
        weight: float = 1.0,
    ) -> Finding:
        """Something found in this trial; it puts blame on the file of its markers, unless it is a note."""
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

    def error(
        self, topic: str, found: str, cure: str, *, code: Code, cause: str = "", leg: str = "", weight: float = 1.0
    ) -> Finding:
        """A finding that stops a calibration."""
        return self.finding(Severity.ERROR, topic, found, cure, code=code, cause=cause, leg=leg, weight=weight)

    def warning(
        self, topic: str, found: str, cure: str, *, code: Code, cause: str = "", leg: str = "", weight: float = 1.0
    ) -> Finding:
        """A finding to look at."""
        return self.finding(Severity.WARNING, topic, found, cure, code=code, cause=cause, leg=leg, weight=weight)

    def info(self, topic: str, found: str, cure: str = "", *, code: Code, cause: str = "") -> Finding:
        """A finding that is good to know; it puts no blame on the file."""
        return self.finding(Severity.INFO, topic, found, cure, code=code, cause=cause)

    @property
    def is_static(self) -> bool:
        """Whether this is the trial in which the person stands."""
        return self.trial.role is Role.STATIC

    @property
    def is_gait(self) -> bool:
        """Whether the person walks."""
        return self.trial.role is Role.GAIT

    @property
    def is_isolated(self) -> bool:
        """Whether one joint moves in isolation."""
        return self.trial.role is Role.JOINT

    @cached_property
    def place(self) -> dict[str, int]:
        """Label -> column of the recording."""
        return {label: i for i, label in enumerate(self.recording.labels)}

    @cached_property
    def seen(self) -> BoolArray:
        """(nf, nm)."""
        return seen_mask(self.recording.markers)

    @cached_property
    def expected(self) -> tuple[str, ...]:
        """Markers with weight that this trial should have: those that are tracked, and in the static trial all.

        What it lost is told by itself (`checks/lost_markers.py`).
        """
        groups = list(self.marker_set.tracking.items())
        if self.is_static:
            groups += list(self.marker_set.static_only.items())
        lost = {stray.label for stray in self.strays if stray.frames == stray.of}
        lost |= set() if self.rebuilding is None else {*self.rebuilding.labels, *self.rebuilding.left}
        return tuple(m for _, labels in groups for m in labels if self.weight(m) > 0 and m not in lost)

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
    def posture(self) -> dict[str, Array] | None:
        """Landmark -> (3,) m, mean of the still window of a static trial; None where nobody stands still in it."""
        if not self.is_static:
            return None
        if self.rebuilding is not None and self.rebuilding.markers:  # the others are judged beside what was rebuilt
            whole = replace(self.trial, recording=self.rebuilding.static)
            return replace(self, trial=whole, rebuilding=None).posture
        try:
            still = still_window(self.recording, self.marker_set.labels).frames
        except InputError:
            return None
        out: dict[str, Array] = {}
        for name in self.marker_set.landmarks:
            path = self.landmark(name)
            seen = None if path is None else path[still][np.isfinite(path[still]).all(axis=1)]
            if seen is not None and len(seen):
                out[name] = seen.mean(axis=0)
        return out

    @cached_property
    def templates(self) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Segment -> labels that are in this trial, and their positions (nm, 3) m in the static posture."""
        if self.model is None:
            return {}
        out: dict[str, tuple[tuple[str, ...], Array]] = {}
        markers = self.model.markers
        for segment in dict.fromkeys(markers.segments):
            rows = [
                i
                for i, (label, s) in enumerate(zip(markers.labels, markers.segments, strict=True))
                if s == segment and label in self.place
            ]
            out[segment] = (tuple(markers.labels[i] for i in rows), markers.local[rows])
        return out

    @cached_property
    def clusters(self) -> dict[str, Cluster]:
        """Segment -> its markers against the static posture, of pelvis and legs; empty in the static trial."""
        if self.stance is None or self.is_static:
            return {}
        return clusters_of(self.recording, self.stance, self.marker_set.landmarks, lambda m: self.weight(m) > LIGHT)

    @cached_property
    def links(self) -> dict[str, JointLink]:
        """Joint of a leg -> how its two segments lie near the static posture."""
        if self.stance is None:
            return {}
        return links_of(self.clusters, self.stance.centres, self.stance.knee_axes)

    @cached_property
    def pelvis(self) -> RigidFit | None:
        """Rigid fit of the pelvis markers; None with fewer than three."""
        labels, local = self.templates.get("pelvis", ((), np.empty((0, 3))))
        if len(labels) < 3:
            return None
        columns = [self.place[label] for label in labels]
        measured = self.recording.markers[:, columns].transpose(1, 2, 0)
        seen = self.seen[:, columns].T
        fit = rigid_fit(local, np.where(seen[:, None], measured, 0.0), seen.astype(float))
        return fit if fit.determined.any() else None


_LABEL = re.compile(r"'([^']+)'")
_UNEXPLAINED = (Code.UNEXPLAINED_RESIDUAL, Code.FORCES_CONTRADICT)


def without_consequences(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The findings without vertical forces and residuals that a named fault of the forces explains, and without markers
    that are off after the fit and were named before it, nor what no body can do where markers do not tell how a leg
    moves. Joints of another body lie elsewhere, and one that lies where nobody has it is beyond its bounds, too.
    """
    said = [f for f in findings if f.severity is not Severity.INFO]
    at_fault = {f.where for f in said if f.topic == FORCES and f.cause != CONTRADICTED}
    explained = {f.where for f in said if f.cause == DISAGREE or (f.topic == FORCES and f.code not in _UNEXPLAINED)}
    errors = [f for f in said if f.leg and f.severity is Severity.ERROR]
    spoilt = {(f.where, f.leg) for f in errors if touches_model(f.topic) and f.topic not in (BOUNDS, MARKERS_AFTER)}
    astray = {where for where, _ in spoilt}
    named = {(f.where, label) for f in said if f.topic != MARKERS_AFTER for label in _LABEL.findall(f.cause)}

    another_body = any(f.code is Code.OTHER_BODY for f in said)
    odd_places = [f.cause for f in said if f.topic == PLACES]

    def follows(f: Finding) -> bool:
        if f.topic == PLACES:
            return another_body
        if f.code is Code.JOINT_AT_BOUND:
            return any(f" {joint_words(f.cause.split()[0])} " in cause for cause in odd_places)
        if f.cause == CONTRADICTED:
            return bool({f.where, STUDY} & at_fault) or f.where in astray
        if f.code is Code.UNEXPLAINED_RESIDUAL:
            return bool({f.where, STUDY} & explained) or f.where in astray
        if f.topic == BOUNDS:
            return (f.where, f.leg) in spoilt or (f.cause == DISAGREE and f.where in astray)
        if f.topic == MARKERS_AFTER:
            return any((f.where, label) in named for label in _LABEL.findall(f.cause))
        return False

    return tuple(f for f in findings if not follows(f))
