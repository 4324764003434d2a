"""Where bones come from: the package `myo-sim` if it is installed, or OpenSim's `Geometry` folder.

Both hold the bones of the same musculoskeletal models (Rajagopal et al. 2016 and its forerunners), in metres, each in
the frame of its body. `myo-sim` is never imported, as that would load a physics engine: only its files are read.
Only right bones are read; left ones are their mirror images.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.page.body_meshes import Mesh, read_stl
from gaitcal.page.bones.bone_shape import with_fewer_triangles
from gaitcal.page.bones.vtp import read_vtp

PACKAGE = "myo-sim"
EXTRA = "bones"
_FOLDER = "myo_sim/models/meshes"
_READERS = {".stl": read_stl, ".vtp": read_vtp}
_ALLOWED_LENGTH = (0.2, 0.7)
"""m of a femur: anything else is in another unit, or no femur."""


@dataclass(frozen=True)
class _Bone:
    """What a bone's file may be called, and how many triangles of it are shown."""

    stems: tuple[str, ...]
    most: int = 1200


_BONES: dict[str, _Bone] = {
    "femur": _Bone(("r_femur", "femur_r", "femur_rv", "femur")),
    "tibia": _Bone(("r_tibia", "tibia_r", "tibia_rv", "tibia")),
    "fibula": _Bone(("r_fibula", "fibula_r", "fibula_rv", "fibula")),
    "pelvis": _Bone(("r_pelvis", "pelvis_rv")),
    "sacrum": _Bone(("sacrum",)),
    "talus": _Bone(("r_talus", "talus_rv", "talus")),
    "foot": _Bone(("r_foot", "foot")),
    "toes": _Bone(("r_bofoot", "bofoot"), 700),
    "humerus": _Bone(("humerus", "humerus_rv")),
    "ulna": _Bone(("ulna", "ulna_rv")),
    "radius": _Bone(("radius", "radius_rv")),
    "ribs": _Bone(("hat_ribs_scap",), 5000),
    "spine": _Bone(("hat_spine",), 3000),
    "thoracic spine": _Bone(("hat_thoracic",), 1800),
    "lumbar spine": _Bone(("hat_lumbar",), 1000),
    "neck": _Bone(("hat_cervical",), 800),
    "skull": _Bone(("hat_skull",), 2200),
    "jaw": _Bone(("hat_jaw",), 600),
}
BONES: tuple[str, ...] = tuple(_BONES)
"""All bones that can be shown, by the name they have in a page."""
_WHOLE_SPINE = {"thoracic spine", "lumbar spine", "neck"}
"""What `spine` is in one file."""
NEEDED: tuple[str, ...] = ("femur", "tibia", "fibula", "pelvis")
"""Without these, whose landmarks place all others, there are no bones."""


@dataclass(frozen=True)
class BoneMeshes:
    """Bones of the right side and the middle."""

    meshes: dict[str, Mesh]
    """As they are in the files, m: landmarks are found on these."""
    source: str
    """Where they are from, for the page."""
    licence: str
    """Text of their licence; empty where the source has none."""

    def shown(self, bone: str) -> Mesh:
        """The bone with as many triangles as the page shows of it."""
        return with_fewer_triangles(self.meshes[bone], _BONES[bone].most)


def installed_bones() -> BoneMeshes | None:
    """The bones of the installed `myo-sim`; None where it is not installed, or no longer has what is needed."""
    try:
        package = distribution(PACKAGE)
    except PackageNotFoundError:
        return None
    paths = (Path(str(f.locate())) for f in package.files or () if f.parent.as_posix() == _FOLDER)
    try:
        meshes = _read({path.name: path for path in paths})
        _check(meshes, Path(_FOLDER))
    except InputError:
        return None
    return BoneMeshes(meshes, f"{PACKAGE} {package.version} (Apache-2.0)", package.read_text("licenses/LICENSE") or "")


def bones_of_folder(folder: Path) -> BoneMeshes:
    """The bones of a folder of `.vtp` or `.stl` files with OpenSim's names.

    Raises
    ------
    InputError
        No such folder, a file that is no surface, a bone that is needed is missing, or the unit is not the metre.
    """
    if not folder.is_dir():
        raise InputError(
            "found no such folder; allowed: OpenSim's `Geometry`, or one like it", source=folder, code=Code.NO_FILE
        )
    meshes = _read({path.name: path for path in sorted(folder.iterdir()) if path.is_file()})
    _check(meshes, folder)
    return BoneMeshes(meshes, f"the folder {folder.name}", "")


def _read(files: dict[str, Path]) -> dict[str, Mesh]:
    meshes = {}
    for bone, about in _BONES.items():
        names = [stem + ending for stem in about.stems for ending in _READERS if stem + ending in files]
        if names:
            path = files[names[0]]
            try:
                meshes[bone] = _READERS[path.suffix](path.read_bytes())
            except (OSError, ValueError) as error:
                raise InputError(f"cannot be read as a surface: {error}", source=path, code=Code.BONES) from error
    if "spine" in meshes:
        meshes = {bone: mesh for bone, mesh in meshes.items() if bone not in _WHOLE_SPINE}
    return meshes


def _check(meshes: dict[str, Mesh], source: Path) -> None:
    missing = [bone for bone in NEEDED if bone not in meshes]
    if missing:
        names = "; ".join(f"{bone}: {' or '.join(_BONES[bone].stems)}" for bone in missing)
        raise InputError(
            f"found no {', '.join(missing)}; needed (.vtp or .stl): {names}", source=source, code=Code.BONES
        )
    length = float(np.ptp(meshes["femur"].vertices[:, 1]))
    low, high = _ALLOWED_LENGTH
    if not low <= length <= high:
        raise InputError(
            f"found a femur that is {length:.3g} high along y; allowed: {low:g} to {high:g} m (metres, y up)",
            source=source,
            code=Code.BONES,
        )
