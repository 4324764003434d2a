"""Static trials to make models from: the published subject standing at zero coordinates, and the
real recordings.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.dynamics.ground_reactions import get_leg
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording, find_still_window
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.marker_set import MarkerSet, load_marker_set
from gaitcal.model.nominal import PUBLISHED, nominal_model, published_model
from gaitcal.model.parameters import Parameters
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.model.subject_model import Subject, SubjectModel
from tests.synthetic_studies import only


@dataclass(frozen=True)
class Person:
    """A real subject; where a data set does not tell height, mass or sex, a plausible value stands
    in.
    """

    file: str
    marker_set: str
    subject: Subject

    def static(self, data: Path) -> Recording:
        return read_recording(data / self.file)

    def stands(self, data: Path) -> tuple[Recording, slice]:
        """The static trial with the labels of the set, and the frames in which the person stands
        still.
        """
        static = self.markers.renamed(self.static(data))
        return static, find_still_window(static, self.markers.labels).frames

    def model(self, static: Recording, **options: Any) -> SubjectModel:
        return nominal_model(static, self.markers, self.subject, **options)

    @property
    def markers(self) -> MarkerSet:
        return load_marker_set(self.marker_set)


PEOPLE = {
    "subject01": Person(
        "subject01/subject01_static.trc", "gait2354", Subject("subject01", 72.6, 1.803, "male")
    ),
    "uf3": Person("uf3/static.trc", "rcnl", Subject("uf3", 68.17, 1.70, "male")),
    "functional": Person(
        "functional_c3d/static.c3d", "conventional73", Subject("functional", 65.0, 1.68, "female")
    ),
    "plug-in-gait": Person(
        "pig_c3d/static.c3d", "plug-in-gait", Subject("plug-in-gait", 66.5, 1.79, "male")
    ),
}
ARMS_HANG = ("uf3", "functional")


def frozen_above(model: SubjectModel) -> set[str]:
    """Frozen coordinates of trunk and arms; a segment of the legs that may go without markers is
    another matter.
    """
    return {name for name in model.frozen if not get_leg(name)}


def posed(
    chain: Chain, parameters: Parameters, q: np.ndarray | None = None
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Of each segment the rotation (3, 3) from it to the ground and its origin (3,) m, at
    coordinates (nq,) or zero.
    """
    body = chain.body(parameters)
    pose = np.zeros(len(chain.coordinates)) if q is None else q
    placed = Kinematics(body, pose[None], columns=False)
    axes, origins = placed.axes, placed.origins
    return (
        {name: axes[i, :, :, 0].T for i, name in enumerate(chain.segments)},
        {name: origins[i, :, 0] for i, name in enumerate(chain.segments)},
    )


def standing(model: SubjectModel, q: np.ndarray | None = None, frames: int = 60) -> Recording:
    """The markers of a model that holds coordinates q (nq,), zero if not given."""
    rotation, origin = posed(Chain(), model.parameters, q)
    m = model.markers
    points = [rotation[s] @ at + origin[s] for s, at in zip(m.segments, m.local, strict=True)]
    markers = np.tile(points, (frames, 1, 1))
    return Recording(
        source="made up", time=np.arange(frames) / 100.0, labels=m.labels, markers=markers
    )


def at_angles(angles: dict[str, float]) -> np.ndarray:
    """(nq,) rad, zero but for these."""
    return np.array([angles.get(name, 0.0) for name in COORDINATES])


def from_published(
    static: Recording | None = None, subject: Subject = PUBLISHED, **options: Any
) -> SubjectModel:
    """The model that is made of the published subject's markers, or of others in their place."""
    return nominal_model(
        static or published_static(), load_marker_set("published"), subject, **options
    )


def published_static() -> Recording:
    """The published subject at zero coordinates with all markers of the static trial."""
    return standing(published_model(static_only=True))


def moved(recording: Recording, heading: float, shift: np.ndarray) -> Recording:
    """The whole recording turned about the vertical and shifted."""
    return replace(recording, markers=recording.markers @ make_axis_rotation(1, heading).T + shift)


def mirrored(recording: Recording) -> Recording:
    """Seen in a mirror: z reversed, and every marker of one side named as that of the other."""

    def other(label: str) -> str:
        candidate = {"R": "L", "L": "R"}.get(label[0], label[0]) + label[1:]
        return candidate if candidate in recording.labels else label

    labels = tuple(other(label) for label in recording.labels)
    return replace(recording, labels=labels, markers=recording.markers * [1.0, 1.0, -1.0])


def without(recording: Recording, *labels: str) -> Recording:
    return only(recording, lambda label: label not in labels)
