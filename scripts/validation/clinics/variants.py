"""What other laboratories do differently, each made of the files of a folder.

A variant that changes nothing about the person must give the same torques. One that takes something away may give
wider bars, or end with a clear line where nothing else can be said; never other torques in silence.

C3D files changed in place, as another laboratory would have written them.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np

from gaitcal.io.labels import computed_points
from scripts.validation.recordings import CLINICS, Person, data

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


TRUNK = ("C7", "T2", "T6", "T8", "T10", "T12", "CLAV", "STRN", "RBAK", "RSHO", "LSHO")
ARMS = ("UPA", "ELB", "FRM", "WRA", "WRB", "FIN", "WRI")
HEAD = ("RFHD", "LFHD", "RBHD", "LBHD")


@dataclass(frozen=True)
class Variant:
    """One thing that another laboratory does."""

    name: str
    make: Callable[[Path, Person], tuple[str, ...]]
    """Changes a copy of a folder; returns the options of the command."""
    clinics: tuple[str, ...]
    may_refuse: bool = False
    """Whether a clear line instead of torques is right."""
    same: bool = True
    """Whether the torques must be those of the folder as it was."""


def _plain(change: Callable[[Path], None]) -> Callable[[Path, Person], tuple[str, ...]]:
    def make(folder: Path, clinic: Person) -> tuple[str, ...]:
        change(folder)
        return clinic.options

    return make


def _trials(change: Callable[[Trial], None]) -> Callable[[Path, Person], tuple[str, ...]]:
    def every(folder: Path) -> None:
        for trial in each(folder):
            change(trial)
            trial.write()

    return _plain(every)


def _static(change: Callable[[Trial], None]) -> Callable[[Path, Person], tuple[str, ...]]:
    def one(folder: Path) -> None:
        trial = Trial(folder / "static.c3d")
        change(trial)
        trial.write()

    return _plain(one)


def _moving(change: Callable[[Trial], None]) -> Callable[[Path, Person], tuple[str, ...]]:
    def others(folder: Path) -> None:
        for trial in each(folder):
            if trial.path.name != "static.c3d":
                change(trial)
                trial.write()

    return _plain(others)


def _as_it_is(folder: Path, clinic: Person) -> tuple[str, ...]:
    return clinic.options


def _numbered(folder: Path) -> None:
    """Names that say nothing, the static trial's last of all."""
    for k, path in enumerate(sorted(folder.iterdir(), key=lambda p: (p.stem.endswith("static"), p.name[::-1]))):
        if path.suffix in (".c3d", ".trc"):
            path.rename(path.with_name(f"{k + 1:08d}{path.suffix}"))


def _prefixed(trial: Trial) -> None:
    trial.relabel(lambda name: name if name.startswith("*") else f"Doe_J:{name}")


def _lower(trial: Trial) -> None:
    computed = trial.computed
    trial.relabel(lambda name: name if name in computed else name.lower())


def _no_metadata(folder: Path, clinic: Person) -> tuple[str, ...]:
    for trial in each(folder):
        trial.forget("PROCESSING", "SUBJECTS", "EVENT", "ANALYSIS")
        trial.write()
    return (*clinic.options, *clinic.facts)


def _markers_only(trial: Trial) -> None:
    """Nothing of the vendor's model but the modelled knees of a knee alignment device."""
    computed = trial.computed - {"RKNE", "LKNE"}
    trial.keep(lambda name: name not in computed)


def _no_trunk(trial: Trial) -> None:
    gone = {*TRUNK, *HEAD, *(side + name for side in "RL" for name in ARMS)}
    trial.keep(lambda name: name not in gone)


def _no_arms(trial: Trial) -> None:
    gone = {side + name for side in "RL" for name in ARMS}
    trial.keep(lambda name: name not in gone)


def _no_acromia(trial: Trial) -> None:
    trial.keep(lambda name: name not in ("RSHO", "LSHO", "RBAK"))


def _one_sacral(trial: Trial) -> None:
    if "SACR" in trial.labels:
        return
    trial.add("SACR", trial.points(("RPSI", "LPSI"))[:3].mean(axis=1))
    trial.keep(lambda name: name not in ("RPSI", "LPSI"))


def _extra_markers(trial: Trial) -> None:
    """Electrodes on a thigh, and a wand on the floor, which no set knows."""
    side = trial.points(("RASI", "RKNE" if "RKNE" in trial.labels else "RANK"))[:3]
    trial.add("EMG1", 0.4 * side[:, 0] + 0.6 * side[:, 1])
    trial.add("WAND1", np.zeros_like(side[:, 0]) + np.array([[100.0], [200.0], [50.0]]))


def _hidden(label: str) -> Callable[[Trial], None]:
    return lambda trial: trial.hide(label)


def _gap(trial: Trial) -> None:
    frames = trial.file["data"]["points"].shape[2]
    trial.hide("RTHI" if "RTHI" in trial.labels else "RTHI1", slice(frames // 3, frames // 3 + 12))


def _metres(trial: Trial) -> None:
    trial.scale_lengths(1e-3, "m")


def _few_frames(trial: Trial) -> None:
    trial.cut(0, 5)


def _pictures(folder: Path) -> None:
    (folder / "foot.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (folder / "notes.docx").write_bytes(b"PK\x03\x04")
    (folder / "Thumbs.db").write_bytes(b"\0" * 64)
    (folder / "session.enf").write_text("[Node]\n", encoding="utf-8")
    (folder / "broken.c3d").write_bytes(b"\0" * 700)
    (folder / "subject.mp").write_text("$Bodymass = 66\n", encoding="utf-8")


def _squat(folder: Path) -> None:
    """The static trial again as a trial of something else: the whole body goes up and down."""
    trial = Trial(folder / "static.c3d")
    points = trial.file["data"]["points"]
    wave = np.sin(np.linspace(0, 6 * np.pi, points.shape[2]))
    ankles = [i for i, name in enumerate(trial.labels) if name[1:] in ("ANK", "HEE", "TOE", "MED")]
    moved = np.setdiff1d(np.arange(points.shape[1]), ankles)
    points[2, moved] += 60.0 * wave
    trial.path = folder / "squat.c3d"
    trial.write()


def _without_static(folder: Path) -> None:
    (folder / "static.c3d").unlink()


def _two_people(folder: Path, clinic: Person) -> tuple[str, ...]:
    other = CLINICS["HC031A" if clinic.name != "HC031A" else "HC002D"]
    for file in other.files:
        target = folder / f"other_{Path(file).name}"
        target.write_bytes((data() / file).read_bytes())
    return clinic.options


def _half_stance(trial: Trial) -> None:
    """The walk ends in the middle of the file."""
    trial.cut(0, trial.file["data"]["points"].shape[2] * 2 // 3)


def _toe_lost(trial: Trial) -> None:
    trial.keep(lambda name: name not in ("RTOE", "LTOE"))


def _turned(trial: Trial) -> None:
    """A laboratory whose walkway runs along its y."""
    points = trial.file["data"]["points"]
    x, y = points[0].copy(), points[1].copy()
    points[0], points[1] = -y, x
    plates = trial.file["parameters"].get("FORCE_PLATFORM", {})
    if "CORNERS" in plates and np.size(plates["CORNERS"]["value"]):
        corners = np.asarray(plates["CORNERS"]["value"], dtype=float)
        a, b = corners[0].copy(), corners[1].copy()
        corners[0], corners[1] = -b, a
        plates["CORNERS"]["value"] = corners


VICON = ("pig", "kad", "multi2", "HC002D", "HC030A")

VARIANTS = (
    Variant(
        "as it is",
        _as_it_is,
        ("pig", "kad", "multi", "HC002D", "HC030A", "HC031A", "HC032A", "functional", "subject01", "uf3"),
    ),
    Variant("names say nothing", _plain(_numbered), (*VICON, "uf3", "functional")),
    Variant("prefix on every label", _trials(_prefixed), VICON),
    Variant("labels in lower case", _trials(_lower), VICON),
    Variant("no metadata", _no_metadata, VICON),
    Variant("metres", _trials(_metres), ("pig", "kad")),
    Variant("walkway along y", _trials(_turned), ("pig", "multi2", "HC002D")),
    Variant("markers only", _trials(_markers_only), ("pig", "kad", "HC002D")),
    Variant("no trunk, no arms", _trials(_no_trunk), ("pig", "HC002D")),
    Variant("no arms", _trials(_no_arms), ("pig", "HC030A")),
    Variant("no acromia", _trials(_no_acromia), ("pig", "HC002D")),
    Variant("one sacral marker", _trials(_one_sacral), ("pig", "kad", "multi2"), same=False),
    Variant("markers that no set knows", _trials(_extra_markers), VICON),
    Variant("PSIS lost while standing", _static(_hidden("RPSI")), ("pig", "kad", "multi2"), may_refuse=True),
    Variant("thigh marker lost while standing", _static(_hidden("LTHI")), ("pig", "kad"), may_refuse=True),
    Variant("heel lost while standing", _static(_hidden("RHEE")), ("pig", "HC002D"), may_refuse=True),
    Variant("gap while walking", _moving(_gap), ("pig", "HC002D")),
    Variant("static of five frames", _static(_few_frames), ("pig", "kad", "HC030A")),
    Variant("pictures and broken files beside", _plain(_pictures), ("pig", "multi2")),
    Variant("a squat beside", _plain(_squat), ("pig", "kad", "HC002D")),
    Variant("no static trial", _plain(_without_static), ("pig", "HC002D"), may_refuse=True),
    Variant("two people", _two_people, ("pig", "HC030A"), may_refuse=True),
    Variant("walk cut short", _moving(_half_stance), ("pig", "kad", "HC031A"), may_refuse=True),
    Variant("no toe markers", _trials(_toe_lost), ("pig", "HC002D"), may_refuse=True, same=False),
)


def cases() -> list[tuple[Variant, str]]:
    """Every variant with every folder that it is meant for."""
    return list(itertools.chain.from_iterable(((v, c) for c in v.clinics) for v in VARIANTS))
