"""What other laboratories do differently, each made of the files of a folder.

A variant that changes nothing about the person must give the same torques. One that takes something
away may give wider bars, or end with a clear line where nothing else can be said; never other
torques in silence. C3D files are changed in place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import ezc3d
import numpy as np

from gaitcal.io.labels import find_computed_points
from scripts.validation.recordings import CLINICS, Person, data

LISTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "MODELED_MARKERS", "REACTIONS")
MOST = 255
"""Names in one list of a C3D file; LABELS2 goes on."""


class Trial:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.file: Any = ezc3d.c3d(str(path))

    @property
    def labels(self) -> list[str]:
        point = self.file["parameters"]["POINT"]
        names = list(point["LABELS"]["value"])
        return [*names, *(point["LABELS2"]["value"] if "LABELS2" in point else ())]

    @property
    def computed(self) -> set[str]:
        point = self.file["parameters"]["POINT"]
        listed = {name for group in LISTS if group in point for name in point[group]["value"]}
        return listed | find_computed_points(self.labels)

    def relabel(self, change: Callable[[str], str]) -> None:
        """Other names for all points, in every list that names them."""
        point = self.file["parameters"]["POINT"]
        for group in ("LABELS", "LABELS2", *LISTS):
            if group in point:
                point[group]["value"] = [change(name) for name in point[group]["value"]]

    def keep(self, wanted: Callable[[str], bool]) -> None:
        labels = self.labels
        places = [i for i, label in enumerate(labels) if wanted(label)]
        data, point = self.file["data"], self.file["parameters"]["POINT"]
        data["points"] = data["points"][:, places]
        for name in ("residuals", "camera_masks"):
            data["meta_points"][name] = data["meta_points"][name][:, places]
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
        meta = data["meta_points"]
        meta["residuals"] = np.concatenate([meta["residuals"], seen], axis=1)
        none = np.zeros_like(meta["camera_masks"][:, :1])
        meta["camera_masks"] = np.concatenate([meta["camera_masks"], none], axis=1)
        name = "LABELS2" if "LABELS2" in point else "LABELS"
        point[name]["value"] = [*point[name]["value"], label]
        other = name.replace("LABELS", "DESCRIPTIONS")
        point[other]["value"] = [*point[other]["value"], ""]

    def hide(self, label: str, frames: slice = slice(None)) -> None:
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

    def scale_lengths(self, factor: float, unit: str) -> None:
        """The points in another unit of length (forces, corners and moments of a C3D file stay in
        theirs: also mm).
        """
        self.file["data"]["points"][:3] *= factor
        self.file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
        plates = self.file["parameters"].get("FORCE_PLATFORM", {})
        for name in ("CORNERS", "ORIGIN"):
            if name in plates and np.size(plates[name]["value"]):
                plates[name]["value"] = np.asarray(plates[name]["value"], dtype=float) * factor

    def write(self) -> None:
        self.file.write(str(self.path))


TRUNK = ("C7", "T2", "T6", "T8", "T10", "T12", "CLAV", "STRN", "RBAK", "RSHO", "LSHO")
ARMS = tuple(
    side + name for side in "RL" for name in ("UPA", "ELB", "FRM", "WRA", "WRB", "FIN", "WRI")
)
HEAD = ("RFHD", "LFHD", "RBHD", "LBHD")
VICON = ("pig", "kad", "multi2", "HC002D", "HC030A")
EVERY = (
    "pig",
    "kad",
    "multi",
    "HC002D",
    "HC030A",
    "HC031A",
    "HC032A",
    "functional",
    "subject01",
    "uf3",
)
METADATA = ("PROCESSING", "SUBJECTS", "EVENT", "ANALYSIS")
Change: TypeAlias = Callable[[Any], None]


@dataclass(frozen=True)
class Variant:
    name: str
    files: str
    """`static.c3d`, `*.c3d`, or those of `moving` trials, one by one; or the `folder`."""
    change: Change
    """Of a `Trial` in memory, or of a folder."""
    clinics: tuple[str, ...]
    may_refuse: bool
    """Whether a clear line instead of torques is right."""
    same: bool
    """Whether the torques must be those of the folder as it was."""
    told: bool
    """Whether the command is told all that the files held, too."""

    def make(self, folder: Path, clinic: Person) -> tuple[str, ...]:
        """Change a copy of a folder; returns the options of the command."""
        if self.files == "folder":
            self.change(folder)
        else:
            for path in sorted(folder.glob("*.c3d" if self.files == "moving" else self.files)):
                if self.files != "moving" or path.name != "static.c3d":
                    trial = Trial(path)
                    self.change(trial)
                    trial.write()
        return (*clinic.options, *clinic.facts) if self.told else clinic.options


VARIANTS: list[Variant] = []


def variant(
    name: str,
    clinics: tuple[str, ...],
    files: str = "*.c3d",
    *,
    may_refuse: bool = False,
    same: bool = True,
    told: bool = False,
) -> Callable[[Change], Change]:
    """Adds one to the list: the function changes the trials, or the folder."""

    def listed(change: Change) -> Change:
        VARIANTS.append(Variant(name, files, change, clinics, may_refuse, same, told))
        return change

    return listed


def without(trial: Trial, *gone: str) -> None:
    trial.keep(lambda name: name not in gone)


variant("as it is", EVERY, "folder")(lambda folder: None)  # nothing is changed


@variant("names say nothing", (*VICON, "uf3", "functional"), "folder")
def _numbered(folder: Path) -> None:
    """The static trial's last of all."""
    for k, path in enumerate(
        sorted(folder.iterdir(), key=lambda p: (p.stem.endswith("static"), p.name[::-1]))
    ):
        if path.suffix in (".c3d", ".trc"):
            path.rename(path.with_name(f"{k + 1:08d}{path.suffix}"))


variant("prefix on every label", VICON)(
    lambda trial: trial.relabel(lambda name: name if name.startswith("*") else f"Doe_J:{name}")
)


@variant("labels in lower case", VICON)
def _lower(trial: Trial) -> None:
    computed = trial.computed
    trial.relabel(lambda name: name if name in computed else name.lower())


@variant("no metadata", VICON, told=True)
def _no_metadata(trial: Trial) -> None:
    for group in METADATA:
        if group in trial.file["parameters"]:
            del trial.file["parameters"][group]


variant("metres", ("pig", "kad"))(lambda trial: trial.scale_lengths(1e-3, "m"))


@variant("walkway along y", ("pig", "multi2", "HC002D"))
def _turned(trial: Trial) -> None:
    points = trial.file["data"]["points"]
    points[:2] = np.array([-points[1], points[0]])
    plates = trial.file["parameters"].get("FORCE_PLATFORM", {})
    if "CORNERS" in plates and np.size(plates["CORNERS"]["value"]):
        corners = np.asarray(plates["CORNERS"]["value"], dtype=float)
        corners[:2] = np.array([-corners[1], corners[0]])
        plates["CORNERS"]["value"] = corners


variant("markers only", ("pig", "kad", "HC002D"))(
    lambda trial: without(trial, *(trial.computed - {"RKNE", "LKNE"}))
)  # nothing of the vendor's model but the modelled knees of a knee alignment device
variant("no trunk, no arms", ("pig", "HC002D"))(lambda trial: without(trial, *TRUNK, *HEAD, *ARMS))
variant("no arms", ("pig", "HC030A"))(lambda trial: without(trial, *ARMS))
variant("no acromia", ("pig", "HC002D"))(lambda trial: without(trial, "RSHO", "LSHO", "RBAK"))


@variant("one sacral marker", ("pig", "kad", "multi2"), same=False)
def _one_sacral(trial: Trial) -> None:
    if "SACR" not in trial.labels:
        trial.add("SACR", trial.points(("RPSI", "LPSI"))[:3].mean(axis=1))
        without(trial, "RPSI", "LPSI")


@variant("markers that no set knows", VICON)
def _extra_markers(trial: Trial) -> None:
    """Electrodes on a thigh, and a wand on the floor."""
    side = trial.points(("RASI", "RKNE" if "RKNE" in trial.labels else "RANK"))[:3]
    trial.add("EMG1", 0.4 * side[:, 0] + 0.6 * side[:, 1])
    trial.add("WAND1", np.zeros_like(side[:, 0]) + np.array([[100.0], [200.0], [50.0]]))


variant("PSIS lost while standing", ("pig", "kad", "multi2"), "static.c3d", may_refuse=True)(
    lambda trial: trial.hide("RPSI")
)
variant("thigh marker lost while standing", ("pig", "kad"), "static.c3d", may_refuse=True)(
    lambda trial: trial.hide("LTHI")
)
variant("heel lost while standing", ("pig", "HC002D"), "static.c3d", may_refuse=True)(
    lambda trial: trial.hide("RHEE")
)


@variant("gap while walking", ("pig", "HC002D"), "moving")
def _gap(trial: Trial) -> None:
    third = trial.file["data"]["points"].shape[2] // 3
    trial.hide("RTHI" if "RTHI" in trial.labels else "RTHI1", slice(third, third + 12))


variant("static of five frames", ("pig", "kad", "HC030A"), "static.c3d")(
    lambda trial: trial.cut(0, 5)
)


@variant("pictures and broken files beside", ("pig", "multi2"), "folder")
def _pictures(folder: Path) -> None:
    contents = {
        "foot.png": b"\x89PNG\r\n\x1a\n",
        "notes.docx": b"PK\x03\x04",
        "Thumbs.db": b"\0" * 64,
    }
    contents |= {
        "session.enf": b"[Node]\n",
        "broken.c3d": b"\0" * 700,
        "subject.mp": b"$Bodymass = 66\n",
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)


@variant("a squat beside", ("pig", "kad", "HC002D"), "folder")
def _squat(folder: Path) -> None:
    """The static trial again as a trial of something else: the whole body goes up and down."""
    trial = Trial(folder / "static.c3d")
    points = trial.file["data"]["points"]
    moved = [
        i for i, name in enumerate(trial.labels) if name[1:] not in ("ANK", "HEE", "TOE", "MED")
    ]
    points[2, moved] += 60.0 * np.sin(np.linspace(0, 6 * np.pi, points.shape[2]))
    trial.path = folder / "squat.c3d"
    trial.write()


variant("no static trial", ("pig", "HC002D"), "folder", may_refuse=True)(
    lambda folder: (folder / "static.c3d").unlink()
)


@variant("two people", ("pig", "HC030A"), "folder", may_refuse=True)
def _two_people(folder: Path) -> None:
    for file in CLINICS["HC031A"].files:
        (folder / f"other_{Path(file).name}").write_bytes((data() / file).read_bytes())


variant("walk cut short", ("pig", "kad", "HC031A"), "moving", may_refuse=True)(
    lambda trial: trial.cut(0, trial.file["data"]["points"].shape[2] * 2 // 3)
)  # the walk ends in the middle of the file
variant("no toe markers", ("pig", "HC002D"), may_refuse=True, same=False)(
    lambda trial: without(trial, "RTOE", "LTOE")
)


def cases() -> list[tuple[Variant, str]]:
    return [(v, clinic) for v in VARIANTS for clinic in v.clinics]
