"""Recordings of skin markers beside the bones under them, and what a laboratory would have made of
them.

A file `NAME_task.npz` holds `rate_hz`, and for each segment (`thigh_r`, `shank_l`, `pelvis`):

    SEGMENT.rotation        (n, 3, 3)     of the bone in the laboratory
    SEGMENT.origin          (n, 3) m
    SEGMENT.markers         (n, m, 3) m   in the bone's axes: x forward, y up, z right
    SEGMENT.landmark.NAME   (3,) m        in the bone's axes: LE, ME, LM, MM, HJC, RASI, ...

`bones.csv` beside them names the person of each file. A left leg is read as the mirror image of
a right one. A laboratory knows the places of markers from a static trial: here, the posture in
which the joint is nearest to that of standing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.segment_frames import fit_rigid_motions

FEWEST_FRAMES = 12
"""Below which there is no spline."""
STANDING_SHARE = 1.0 / 30.0
"""Part of the frames that are the static posture, at least three."""
LEFT_TO_RIGHT = np.diag([1.0, 1.0, -1.0])


@dataclass(frozen=True, kw_only=True)
class BoneSegment:
    """One segment: its bone in the laboratory, and the skin markers in the axes of the bone."""

    rotation: Array
    """(nf, 3, 3), columns the axes of the bone."""
    origin: Array
    """(nf, 3) m."""
    markers: Array
    """(nf, nm, 3) m in the axes of the bone."""
    landmarks: Mapping[str, Array]
    """Name -> (3,) m in the axes of the bone."""

    @property
    def in_laboratory(self) -> Array:
        """(nf, nm, 3) m, skin markers."""
        return np.einsum("fij,fmj->fmi", self.rotation, self.markers) + self.origin[:, None]

    def in_frames(self, frames: BoolArray) -> BoneSegment:
        """The segment in some of the frames."""
        return BoneSegment(
            rotation=self.rotation[frames],
            origin=self.origin[frames],
            markers=self.markers[frames],
            landmarks=self.landmarks,
        )


@dataclass(frozen=True, kw_only=True)
class BoneRecording:
    """One recording, as of a right leg, in the frames that show everything."""

    name: str
    person: str
    task: str
    reference: str
    """How the bones were tracked."""
    sex: str
    height: float
    """m; NaN where not known."""
    mass: float
    """kg; NaN where not known."""
    rate: float
    """Hz."""
    segments: Mapping[str, BoneSegment]
    """`pelvis`, `thigh`, `shank` -> those whose bone was tracked."""

    def has(self, *names: str) -> bool:
        """Whether the bones of these segments were tracked."""
        return all(name in self.segments for name in names)

    def relative(self, above: str, below: str) -> Array:
        """(nf, 3, 3) orientation of one bone in another."""
        one, other = self.segments[above], self.segments[below]
        return np.asarray(one.rotation.swapaxes(1, 2) @ other.rotation)

    @property
    def knee_flexion(self) -> Array:
        """(nf,) rad, of the bones about the lateral axis of the thigh."""
        turn = self.relative("thigh", "shank")
        return np.asarray(-np.arctan2(turn[:, 1, 0], turn[:, 0, 0]))

    def standing(self, above: str, below: str) -> BoolArray:
        """(nf,) the frames in which the bone below is turned least against the one above."""
        turn = self.relative(above, below)
        if above == "thigh":
            away = np.abs(np.arctan2(turn[:, 1, 0], turn[:, 0, 0]))
        else:
            away = np.arccos(np.clip(0.5 * (np.trace(turn, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
        count = max(3, int(STANDING_SHARE * len(away)))
        return np.asarray(away <= np.sort(away)[count - 1])


def read_recordings(folder: Path) -> Iterator[BoneRecording]:
    """Yield the recordings of a folder that track two neighbouring bones.

    Parameters
    ----------
    folder : with `*.npz` and, where persons are known, `bones.csv`.
    """
    table = pd.DataFrame(columns=["file"])
    if (folder / "bones.csv").exists():
        table = pd.read_csv(folder / "bones.csv")
    rows = {str(row["file"]): row for _, row in table.iterrows()}
    for file in sorted(folder.glob("*.npz")):
        row = rows.get(file.name, pd.Series(dtype=object))
        recording = _read(file, row)
        if recording is not None:
            yield recording


def _read(file: Path, row: pd.Series) -> BoneRecording | None:
    """The recording of a file; None where it tracks no two neighbouring bones."""
    with np.load(file) as opened:
        data = {key: np.asarray(opened[key], float) for key in opened.files}
    side = "l" if any(key.startswith(("thigh_l", "shank_l")) for key in data) else "r"
    mirror = LEFT_TO_RIGHT if side == "l" else np.eye(3)
    segments = {}
    for kind, name in (
        ("pelvis", "pelvis"),
        ("thigh", f"thigh_{side}"),
        ("shank", f"shank_{side}"),
    ):
        if f"{name}.rotation" not in data:
            continue
        rotation = mirror @ data[f"{name}.rotation"] @ mirror
        markers = data.get(f"{name}.markers", np.zeros((len(rotation), 0, 3)))
        prefix = f"{name}.landmark."
        landmarks = {
            key.removeprefix(prefix): mirror @ value
            for key, value in data.items()
            if key.startswith(prefix)
        }
        segments[kind] = BoneSegment(
            rotation=rotation,
            origin=data[f"{name}.origin"] @ mirror,
            markers=markers @ mirror,
            landmarks=_sides_exchanged(landmarks)
            if side == "l" and kind == "pelvis"
            else landmarks,
        )
    if not {"thigh", "shank"} <= set(segments) and not {"pelvis", "thigh"} <= set(segments):
        return None
    shown = np.ones(len(segments["thigh"].origin), dtype=bool)
    for segment in segments.values():
        for values in (segment.rotation, segment.origin, segment.markers):
            shown &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    person, _, task = file.stem.partition("_")
    return BoneRecording(
        name=file.stem,
        person=str(row.get("person", person)),
        task=str(row.get("task", task)),
        reference=str(row.get("reference", "")),
        sex=str(row.get("sex", "")),
        height=float(row.get("height_m", np.nan)),
        mass=float(row.get("mass_kg", np.nan)),
        rate=float(data["rate_hz"]),
        segments={name: segment.in_frames(shown) for name, segment in segments.items()},
    )


def _sides_exchanged(landmarks: Mapping[str, Array]) -> dict[str, Array]:
    """Landmarks of a mirrored pelvis by the names that they have then."""
    other = {"L": "R", "R": "L"}
    return {other.get(name[0], name[0]) + name[1:]: point for name, point in landmarks.items()}


def fit_centre(above: BoneSegment, below: BoneSegment) -> tuple[Array, Array]:
    """The point that two bones carry alike (SCoRE), (3,) m in the axes of each."""
    matrix = np.concatenate([above.rotation, -below.rotation], axis=2).reshape(-1, 6)
    point = np.linalg.lstsq(matrix, (below.origin - above.origin).ravel(), rcond=1e-3)[0]
    return point[:3], point[3:]


def find_true_hip(recording: BoneRecording) -> tuple[Array, Array | None]:
    """The centre of the hip in the axes of pelvis and thigh, (3,) m: as measured, else SCoRE's."""
    known = recording.segments["pelvis"].landmarks
    if "RHJC" in known:
        return known["RHJC"], recording.segments["thigh"].landmarks.get("HJC")
    return fit_centre(recording.segments["pelvis"], recording.segments["thigh"])


def fit_hinge(above: BoneSegment, below: BoneSegment) -> tuple[Array, Array, Array, Array]:
    """The axis that two bones carry alike: direction and point in the bone above, then below.

    The direction is the mean common one; the point is SCoRE's, the nearest to the origins along it.
    """
    u, _, vt = np.linalg.svd(np.mean(above.rotation.swapaxes(1, 2) @ below.rotation, axis=0))
    first, second = fit_centre(above, below)
    sign = np.sign(u[2, 0])
    return sign * u[:, 0], first, sign * vt[0], second


def hinge_errors(above: BoneSegment, below: BoneSegment) -> tuple[float, float]:
    """How far the axis that `fit_hinge` finds may be off, m across it and rad.

    Knees are no hinges, and references err by a millimetre and a degree. What the hinge leaves of
    the motion of the bones, in step with flexion, is as far as another axis would serve them as
    well.
    """
    direction, point, direction_below, point_below = fit_hinge(above, below)
    gap = np.einsum("fij,j->fi", above.rotation, point) + above.origin
    gap -= np.einsum("fij,j->fi", below.rotation, point_below) + below.origin
    gap = np.einsum("fji,fj->fi", above.rotation, gap)
    turn = above.rotation.swapaxes(1, 2) @ below.rotation
    apart = turn @ direction_below - direction
    flexion = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    moved = float(flexion.std())
    return float(np.sqrt(np.mean(gap[:, :2] ** 2))) / moved, float(
        np.sqrt(np.mean(apart[:, :2] ** 2))
    ) / moved


def fit_clusters(
    recording: BoneRecording, above: str, below: str
) -> tuple[BoneSegment, BoneSegment]:
    """Both segments as a rigid fit of all skin markers to their static places has them; a pinned
    one as it is.
    """
    still = recording.standing(above, below)
    out = []
    for name in (above, below):
        bone = recording.segments[name]
        if not bone.markers.shape[1]:
            out.append(bone)
            continue
        rotation, origin = fit_rigid_motions(bone.markers[still].mean(axis=0), bone.in_laboratory)
        out.append(
            BoneSegment(
                rotation=rotation, origin=origin, markers=bone.markers, landmarks=bone.landmarks
            )
        )
    return out[0], out[1]
