"""`view.html`: the whole view in one file that opens offline.

MeshCat's own JavaScript viewer, our player, and the scene as data stand inline. A Content-Security-Policy in the file
lets exactly these two scripts run, known by their SHA-256, and forbids every request: whatever a marker or a subject
is called, it is text.
"""

from __future__ import annotations

import base64
import hashlib
import re
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from gaitcal.errors import GaitcalError
from gaitcal.files.atomic import atomic_text
from gaitcal.page.body_meshes import PACKAGE, body_meshes
from gaitcal.page.bones import BoneMeshes, installed_bones, landmarked
from gaitcal.page.playback import scene_json
from gaitcal.page.scene import Scene, scene_of

if TYPE_CHECKING:
    from gaitcal.person.result import Calibration

SCRIPTS = (
    "1_unpack.js", "2_body.js", "2_bones.js", "3_markers.js", "4_joints.js", "5_layers.js", "6_camera.js",
    "7_player.js",
)  # fmt: skip


def write_view(source: Calibration | Scene, path: Path | str, bones: BoneMeshes | None = None) -> None:
    """Write a scene, or the scene of a calibration, as one self-contained page.

    Parameters
    ----------
    bones : None: those of the installed `myo-sim`, and no bones where it is not installed.

    Raises
    ------
    InputError
        `path` cannot be written.
    GaitcalError
        MeshCat is not installed.
    """
    scene = source if isinstance(source, Scene) else scene_of(source)
    atomic_text(path, view_html(scene, bones))


def view_html(scene: Scene, bones: BoneMeshes | None = None) -> str:
    """The page of a scene; `bones` as in `write_view`."""
    bones = bones or installed_bones()
    folder = files("gaitcal.page") / "scripts"

    def part(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    viewer, licences = _meshcat()
    meshcat = _inline(viewer)
    page = _inline("\n".join(part(name) for name in SCRIPTS))
    content = {
        "POLICY": policy(meshcat, page),
        "STYLE": part("page.css"),
        "SCENE": scene_json(scene, body_meshes(), None if bones is None else landmarked(bones)),
        "LICENCES": _with_bones(licences, bones).replace("<", "‹"),
        "MESHCAT": meshcat,
        "PAGE": page,
    }
    # One pass over the template: what a name holds is never looked at again.
    return re.sub(r"@@([A-Z]+)@@", lambda found: content[found.group(1)], part("page.html"))


def policy(*scripts: str) -> str:
    """A Content-Security-Policy under which only these inline scripts run and nothing is requested."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(s.encode()).digest()).decode()}'" for s in scripts)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _inline(script: str) -> str:
    """A script that may stand between `<script>` and `</script>`, and that a browser hashes as we do."""
    text = script.replace("\r\n", "\n").replace("\r", "\n")
    return text.replace("<!--", "<\\!--").replace("</script", "<\\/script").replace("</SCRIPT", "<\\/SCRIPT")


def _meshcat() -> tuple[str, str]:
    """MeshCat's viewer and the licences of what stands in the page, without importing MeshCat's server."""
    spec = find_spec("meshcat")
    places = list(spec.submodule_search_locations or ()) if spec else []
    if not places:
        raise GaitcalError("meshcat is not installed; install gaitcal again")
    folder = Path(places[0]) / "viewer"
    viewer = folder / "dist" / "main.min.js"
    texts = [
        ("MeshCat", folder / "LICENSE"),
        ("three.js and others inside MeshCat", folder / "dist" / "main.min.js.LICENSE.txt"),
    ]
    try:
        script = viewer.read_text(encoding="utf-8")
        licences = [f"{name}\n\n{path.read_text(encoding='utf-8')}" for name, path in texts if path.is_file()]
    except OSError as error:
        raise GaitcalError(f"{viewer}: cannot be read ({error.strerror}); install meshcat again") from error
    return script, "\n\n".join([*licences, *_mesh_licence()])


def _with_bones(licences: str, bones: BoneMeshes | None) -> str:
    return f"{licences}\n\nBones of {bones.source}\n\n{bones.licence}" if bones and bones.licence else licences


def _mesh_licence() -> list[str]:
    try:
        text = distribution(PACKAGE).read_text("licenses/LICENSE")
    except PackageNotFoundError:
        return []
    return [f"Body meshes of {PACKAGE}\n\n{text}"] if text else []
