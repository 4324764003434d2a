"""`result.html`: body, curves and tables of one or two results in one file that opens offline.

MeshCat's own JavaScript viewer, uPlot, our scripts, and the results as data stand inline. A Content-Security-Policy in
the file lets exactly these scripts run, known by their SHA-256, and forbids every request: whatever a marker or a
subject is called, it is text.

Scenes of one person joined: the trials of several runs around one body.

What a page of ours may do: run the scripts that stand in it, and nothing else.

`cohort.html`: the people of a cohort in one file that opens offline, written piece by piece, as they may be many.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from gaitcal.errors import GaitcalError
from gaitcal.gait.spatiotemporal import LEAST_VALID
from gaitcal.io.atomic import atomic_text
from gaitcal.page.body_meshes import PACKAGE, body_meshes
from gaitcal.page.bones.bone_files import BoneMeshes, installed_bones
from gaitcal.page.bones.placement import landmarked
from gaitcal.page.scene import Scene, TrialScene, scene_of
from gaitcal.page.scene_file import MOST_BYTES, left_out, scene_json
from gaitcal.page.sheet.sheet import MOST_LETTERS, curves_left_out, sheet_text, thinned

if TYPE_CHECKING:
    from gaitcal.session.result import Calibration


def policy(*scripts: str) -> str:
    """A Content-Security-Policy under which only these inline scripts run and nothing is requested."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(s.encode()).digest()).decode()}'" for s in scripts)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def inline(script: str) -> str:
    """A script that may stand between `<script>` and `</script>`, and that a browser hashes as we do."""
    text = script.replace("\r\n", "\n").replace("\r", "\n")
    return text.replace("<!--", "<\\!--").replace("</script", "<\\/script").replace("</SCRIPT", "<\\/SCRIPT")


SCRIPTS = (
    "unpack.js", "body.js", "bones.js", "markers.js", "joints.js", "figure.js", "layers.js", "camera.js", "stage.js",
    "state.js", "address.js", "clock.js", "timeline.js", "controls.js", "keys.js", "presets.js", "switches.js",
    "sheet.js", "convention.js", "strides.js", "traces.js", "pen.js", "panel.js", "legend.js", "peaks.js", "papers.js",
    "groups.js", "curves.js", "blocks.js", "pictures.js", "trial_curves.js", "steps.js", "verdict.js", "sections.js",
    "print.js", "page.js",
)  # fmt: skip
"""In the order in which they run: the body in 3-D; what is shown when; curves; tables; all together."""
STYLES = ("page.css", "stage.css", "curves.css", "sections.css", "print.css")
PLOTS = "uPlot"
"""The library that draws curves, in `libraries/`."""


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
    """The page of a scene alone, without curves and tables; `bones` as in `write_view`."""
    return page_html([Shown(scene)], bones)


@dataclass(frozen=True)
class Shown:
    """One result as the page takes it."""

    scene: Scene
    sheet: Mapping[str, Any] | None = None
    """Curves and tables (`gaitcal.page.sheet`); None: the body alone."""
    name: str = ""
    """What it is called beside another one."""


@dataclass(frozen=True)
class BodyText:
    """The body in motion as it stands in a page."""

    scene: str
    """JSON of `scene_json`."""
    bones_licence: str
    """Whose bones are in it, and their licence; empty where none are, or they have none."""


def page_html(results: Sequence[Shown], bones: BoneMeshes | None = None) -> str:
    """The page of one result, or of two side by side; `bones` as in `write_view`."""
    bodies = body_texts([shown.scene for shown in results], bones)
    return joined_page(
        [(shown.name, body, told_text(shown.sheet, len(results))) for shown, body in zip(results, bodies, strict=True)]
    )


def body_texts(scenes: Sequence[Scene], bones: BoneMeshes | None = None) -> list[BodyText]:
    """The scenes of all results of a page; `bones` as in `write_view`."""
    bones = bones or installed_bones()
    shapes, placed = body_meshes(), None if bones is None else landmarked(bones)
    licence = f"Bones of {bones.source}\n\n{bones.licence}" if bones and bones.licence else ""
    return [BodyText(scene_json(scene, shapes, placed, MOST_BYTES // len(scenes)), licence) for scene in scenes]


def told_text(sheet: Mapping[str, Any] | None, results: int = 1) -> str:
    """The sheet as JSON for a page of so many `results`."""
    return sheet_text(sheet and thinned(sheet, MOST_LETTERS // results))


def joined_page(results: Sequence[tuple[str, BodyText, str]]) -> str:
    """The page of results, each with its name, its body in motion and its sheet (`told_text`)."""
    folder = files("gaitcal.page")

    def part(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    def result(name: str, body: BodyText, sheet: str) -> str:
        return f'{{"name":{_text(name)},"leastValid":{LEAST_VALID},"scene":{body.scene},"sheet":{sheet}}}'

    viewer, licences = _meshcat()
    meshcat, plots = inline(viewer), inline(part(f"libraries/{PLOTS}.iife.min.js"))
    page = inline("\n".join(part(f"scripts/{name}") for name in SCRIPTS))
    licences += f"\n\nuPlot\n\n{part(f'libraries/{PLOTS}.LICENSE.txt')}"
    bones = dict.fromkeys(body.bones_licence for _, body, _ in results if body.bones_licence)
    content = {
        "POLICY": policy(meshcat, plots, page),
        "STYLE": "\n".join([part(f"libraries/{PLOTS}.min.css"), *(part(f"styles/{name}") for name in STYLES)]),
        "RESULTS": f"[{','.join(result(*one) for one in results)}]",
        "LICENCES": "\n\n".join([licences, *bones]).replace("<", "‹"),
        "MESHCAT": meshcat,
        "PLOTS": plots,
        "PAGE": page,
    }
    # One pass over the template: what a name holds is never looked at again.
    return re.sub(r"@@([A-Z]+)@@", lambda found: content[found.group(1)], part("templates/page.html"))


def sentences(results: Sequence[Shown]) -> tuple[str, ...]:
    """What the page of these results leaves out, for every trial of which it holds some frames only."""
    told: list[str] = []
    for shown in results:
        told += left_out(shown.scene, MOST_BYTES // len(results))
        if shown.sheet is not None:
            told += curves_left_out(thinned(shown.sheet, MOST_LETTERS // len(results)))
    return tuple(told)


def _text(text: str) -> str:
    return json.dumps(text).replace("<", "\\u003c")


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


def _mesh_licence() -> list[str]:
    try:
        text = distribution(PACKAGE).read_text("licenses/LICENSE")
    except PackageNotFoundError:
        return []
    return [f"Body meshes of {PACKAGE}\n\n{text}"] if text else []


def with_trials(scene: Scene, further: Scene, names: Mapping[str, str] | None = None) -> Scene | None:
    """The scene with the trials of another one after its own; None where they have other segments.

    Parameters
    ----------
    names : other names for trials of `further`: old -> new.
    """
    if further.segments != scene.segments:
        return None
    told = names or {}
    trials = (
        replace(_with_markers(trial, further.labels, scene.labels), name=told.get(trial.name, trial.name))
        for trial in further.trials
    )
    return replace(scene, trials=(*scene.trials, *trials))


def after_trials(scene: Scene, earlier: Scene) -> Scene | None:
    """The scene with those trials of an earlier one before its own whose names it does not have; None as above."""
    names = {trial.name for trial in scene.trials}
    kept = tuple(trial for trial in earlier.trials if trial.name not in names)
    joined = with_trials(replace(scene, trials=()), replace(earlier, trials=kept))
    return None if joined is None else replace(joined, trials=(*joined.trials, *scene.trials))


def _with_markers(trial: TrialScene, labels: tuple[str, ...], wanted: tuple[str, ...]) -> TrialScene:
    """The trial with the measured markers in the order of another model; NaN for one that it did not have."""
    if labels == wanted:
        return trial
    measured = np.full((len(trial.time), len(wanted), 3), np.nan, dtype=np.float32)
    for k, label in enumerate(wanted):
        if label in labels:
            measured[:, k] = trial.measured[:, labels.index(label)]
    return replace(trial, measured=measured)


COHORT_SCRIPTS: Final = (
    *("unpack.js", "blocks.js", "convention.js", "pictures.js", "verdict.js", "pen.js"),
    *("cohort/people.js", "cohort/measures.js", "cohort/choices.js", "cohort/filters.js", "cohort/triage.js"),
    *("cohort/chooser.js", "cohort/table.js", "cohort/distributions.js", "cohort/groups.js", "cohort/mean_panel.js"),
    *("cohort/mean_curves.js", "cohort/failures.js", "cohort/cohort.js"),
)
"""In the order in which they run: what `result.html` has too; people and what is chosen; each part; all together."""
COHORT_STYLES: Final = ("page.css", "sections.css", "cohort.css")
DATA: Final = ("CURVES", "COHORT")
"""What a page is of: packed mean curves, and everything else as JSON, in the order of the file."""


def write_cohort_page(path: Path, data: Mapping[str, Iterable[str]]) -> None:
    """Write the page; `data`: the pieces of each of `DATA`, asked for when they are due."""
    folder = files("gaitcal.page")

    def part(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    plots = inline(part(f"libraries/{PLOTS}.iife.min.js"))
    page = inline("\n".join(part(f"scripts/{name}") for name in COHORT_SCRIPTS))
    fixed = {
        "POLICY": policy(plots, page),
        "STYLE": "\n".join([part(f"libraries/{PLOTS}.min.css"), *(part(f"styles/{name}") for name in COHORT_STYLES)]),
        "LICENCES": f"uPlot\n\n{part(f'libraries/{PLOTS}.LICENSE.txt')}".replace("<", "‹"),
        "PLOTS": plots,
        "PAGE": page,
    }
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        for number, piece in enumerate(re.split(r"@@([A-Z]+)@@", part("templates/cohort.html"))):
            if number % 2 == 0:
                stream.write(piece)
            elif piece in DATA:
                stream.writelines(data[piece])
            else:
                stream.write(fixed[piece])
