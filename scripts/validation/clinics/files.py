"""C3D files changed in place, as another laboratory would have written them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np

from gaitcal.io.labels import computed_points

LISTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "MODELED_MARKERS", "REACTIONS")
MOST = 255
"""Names in one list of a C3D file; LABELS2 goes on."""


class Trial:
    """One C3D file in memory."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.file: Any = ezc3d.c3d(str(path))

    @property
    def labels(self) -> list[str]:
        """Names of all points."""
        point = self.file["parameters"]["POINT"]
        names = list(point["LABELS"]["value"])
        return [*names, *(point["LABELS2"]["value"] if "LABELS2" in point else ())]

    @property
    def computed(self) -> set[str]:
        """Names of points that a model computed."""
        point = self.file["parameters"]["POINT"]
        listed = {name for group in LISTS if group in point for name in point[group]["value"]}
        return listed | computed_points(self.labels)

    def relabel(self, change: Callable[[str], str]) -> None:
        """Other names for all points, in every list that names them."""
        point = self.file["parameters"]["POINT"]
        for group in ("LABELS", "LABELS2", *LISTS):
            if group in point:
                point[group]["value"] = [change(name) for name in point[group]["value"]]

    def keep(self, wanted: Callable[[str], bool]) -> None:
        """Only the points that are wanted."""
        labels = self.labels
        places = [i for i, label in enumerate(labels) if wanted(label)]
        data, point = self.file["data"], self.file["parameters"]["POINT"]
        data["points"] = data["points"][:, places]
        data["meta_points"]["residuals"] = data["meta_points"]["residuals"][:, places]
        data["meta_points"]["camera_masks"] = data["meta_points"]["camera_masks"][:, places]
        kept = [labels[i] for i in places]
        for ending, part in (("", kept[:MOST]), ("2", kept[MOST:])):
            if part:
                point[f"LABELS{ending}"]["value"] = part
                point[f"DESCRIPTIONS{ending}"]["value"] = [""] * len(part)
            elif f"LABELS{ending}" in point:
                del point[f"LABELS{ending}"], point[f"DESCRIPTIONS{ending}"]
        for group in LISTS:
            if group in point:
                point[group]["value"] = [name for name in point[group]["value"] if name in kept]

    def points(self, labels: Iterable[str]) -> Any:
        """(4, n, nf) the named points."""
        known = self.labels
        return self.file["data"]["points"][:, [known.index(label) for label in labels]]

    def add(self, label: str, path: Any) -> None:
        """One more point, (3, nf) in the units of the file."""
        data, point = self.file["data"], self.file["parameters"]["POINT"]
        row = np.concatenate([path, np.ones((1, path.shape[1]))])[:, None]
        data["points"] = np.concatenate([data["points"], row], axis=1)
        seen = np.where(np.isfinite(path).all(axis=0), 0.0, -1.0)[None, None]
        data["meta_points"]["residuals"] = np.concatenate([data["meta_points"]["residuals"], seen], axis=1)
        masks = data["meta_points"]["camera_masks"]
        data["meta_points"]["camera_masks"] = np.concatenate(
            [masks, np.zeros((masks.shape[0], 1, masks.shape[2]), dtype=masks.dtype)], axis=1
        )
        name = "LABELS2" if "LABELS2" in point else "LABELS"
        point[name]["value"] = [*point[name]["value"], label]
        other = name.replace("LABELS", "DESCRIPTIONS")
        point[other]["value"] = [*point[other]["value"], ""]

    def hide(self, label: str, frames: slice = slice(None)) -> None:
        """A gap."""
        place = self.labels.index(label)
        self.file["data"]["points"][:3, place, frames] = np.nan
        self.file["data"]["meta_points"]["residuals"][0, place, frames] = -1.0

    def cut(self, first: int, last: int) -> None:
        """Only the frames from `first` up to, not with, `last`."""
        data, header = self.file["data"], self.file["header"]
        frames = data["points"].shape[2]
        ratio = max(1, data["analogs"].shape[2] // frames)
        data["points"] = data["points"][:, :, first:last]
        for name in ("residuals", "camera_masks"):
            data["meta_points"][name] = data["meta_points"][name][:, :, first:last]
        data["analogs"] = data["analogs"][:, :, first * ratio : last * ratio]
        header["points"]["first_frame"] = header["points"]["first_frame"] + first
        trial = self.file["parameters"].get("TRIAL", {})
        for name in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD"):
            if name in trial:
                del trial[name]

    def forget(self, *groups: str) -> None:
        """Without these groups of parameters."""
        for group in groups:
            if group in self.file["parameters"]:
                del self.file["parameters"][group]

    def scale_lengths(self, factor: float, unit: str) -> None:
        """The points in another unit of length (forces, corners and moments of a C3D file stay in theirs: also mm)."""
        self.file["data"]["points"][:3] *= factor
        self.file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
        plates = self.file["parameters"].get("FORCE_PLATFORM", {})
        for name in ("CORNERS", "ORIGIN"):
            if name in plates and np.size(plates[name]["value"]):
                plates[name]["value"] = np.asarray(plates[name]["value"], dtype=float) * factor

    def write(self) -> None:
        """Back to its file."""
        self.file.write(str(self.path))


def each(folder: Path) -> list[Trial]:
    """Every C3D file of a folder."""
    return [Trial(path) for path in sorted(folder.glob("*.c3d"))]
