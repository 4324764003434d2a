"""Static trials to make models from: the published subject standing at zero coordinates, and the real recordings."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaitcal.dynamics.ground_reactions import leg_of
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording
from gaitcal.model.chain import Chain, forward, segment_poses
from gaitcal.model.marker_set import MarkerSet, load_marker_set
from gaitcal.model.nominal import published_model
from gaitcal.model.subject_model import Subject, SubjectModel


@dataclass(frozen=True)
class Person:
    """A real subject; where a data set does not tell height, mass or sex, a plausible value stands in."""

    file: str
    marker_set: str
    subject: Subject

    def static(self, data: Path) -> Recording:
        return read_recording(data / self.file)

    @property
    def markers(self) -> MarkerSet:
        return load_marker_set(self.marker_set)


PEOPLE = {
    "subject01": Person("subject01/subject01_static.trc", "gait2354", Subject("subject01", 72.6, 1.803, "male")),
    "uf3": Person("uf3/static.trc", "rcnl", Subject("uf3", 68.17, 1.70, "male")),
    "functional": Person("functional_c3d/static.c3d", "conventional73", Subject("functional", 65.0, 1.68, "female")),
    "plug-in-gait": Person("pig_c3d/static.c3d", "plug-in-gait", Subject("plug-in-gait", 66.5, 1.79, "male")),
}
ARMS_HANG = ("uf3", "functional")


def frozen_above(model: SubjectModel) -> set[str]:
    """Frozen coordinates of trunk and arms; a segment of the legs that may go without markers is another matter."""
    return {name for name in model.frozen if not leg_of(name)}


def standing(model: SubjectModel, q: np.ndarray | None = None, frames: int = 60) -> Recording:
    """The markers of a model that holds coordinates q (nq,), zero if not given."""
    chain = Chain()
    constants = chain.constants(model.parameters.joint, model.parameters.zero_angles)
    pose = np.zeros((1, len(chain.coordinates))) if q is None else q[None]
    axes, origins = segment_poses(chain, constants, forward(chain, constants, pose))
    m = model.markers
    at = [chain.segments.index(segment) for segment in m.segments]
    points = np.einsum("mj,mji->mi", m.local, axes[at, :, :, 0]) + origins[at, :, 0]
    markers = np.broadcast_to(points, (frames, *points.shape)).copy()
    return Recording(source="made up", time=np.arange(frames) / 100.0, labels=m.labels, markers=markers)


def published_static() -> Recording:
    """The published subject at zero coordinates with all markers of the static trial."""
    return standing(published_model(static_only=True))


def moved(recording: Recording, heading: float, shift: np.ndarray) -> Recording:
    """The whole recording turned about the vertical and shifted."""
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return replace(recording, markers=recording.markers @ turn.T + shift)


def mirrored(recording: Recording) -> Recording:
    """Seen in a mirror: z reversed, and every marker of one side named as that of the other."""
    known = set(recording.labels)
    swap = {"R": "L", "L": "R"}

    def other(label: str) -> str:
        candidate = swap.get(label[0], label[0]) + label[1:]
        return candidate if candidate in known else label

    return replace(
        recording,
        labels=tuple(other(label) for label in recording.labels),
        markers=recording.markers * [1.0, 1.0, -1.0],
    )


def without(recording: Recording, *labels: str) -> Recording:
    """The recording without some markers."""
    kept = [i for i, label in enumerate(recording.labels) if label not in labels]
    return replace(recording, labels=tuple(recording.labels[i] for i in kept), markers=recording.markers[:, kept])
