"""Render `result.html` and `cohort.html`, files that open offline, and join pages of several runs.

MeshCat's viewer, uPlot, our scripts and the data are inline. A Content-Security-Policy admits these
scripts only, by their SHA-256, and forbids every request. Names of markers and subjects are text.
"""

import base64
import hashlib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.errors import Code, GaitcalError
from gaitcal.gait.cycles import EventSource, describe_sources
from gaitcal.model.linkage import SIDE_WORDS, SIDES
from gaitcal.quality.verdict import Judgement, Verdict, WalkVerdict
from gaitcal.report.page import bone_files, bone_placement, page_data, plain_data, scene_file
from gaitcal.report.page.body_meshes import PACKAGE, read_body_meshes
from gaitcal.report.page.scene import MotionScene, Scene
from gaitcal.results.shown_labels import TRIAL_CURVES, UNIT_WORDS
from gaitcal.results.summary import combine_judgements

SCRIPTS = (
    "dom.js", "unpack.js", "body.js", "bones.js", "markers.js", "joints.js", "figure.js",
    "layers.js", "camera.js", "stage.js", "chosen.js", "state.js", "timeline.js", "controls.js",
    "keys.js", "switches.js", "counting.js", "statistics.js", "sheet.js", "convention.js",
    "strides.js", "traces.js", "plot.js", "panel.js", "peaks.js", "curves.js", "blocks.js",
    "pictures.js", "trial_curves.js", "steps.js", "verdict.js", "sections.js", "events.js",
    "comments.js", "print.js", "page.js",
)  # fmt: skip
"""In the order in which they run: the body in 3-D; what is shown when; curves; tables; all
together.
"""
STYLES = ("page.css", "stage.css", "curves.css", "sections.css", "print.css")
COHORT_SCRIPTS: Final = (
    *(
        "dom.js",
        "unpack.js",
        "chosen.js",
        "statistics.js",
        "plot.js",
        "blocks.js",
        "pictures.js",
        "verdict.js",
    ),
    *(
        "cohort/people.js",
        "cohort/choices.js",
        "cohort/filters.js",
        "cohort/triage.js",
        "cohort/table.js",
    ),
    *("cohort/distributions.js", "cohort/means.js", "cohort/cohort.js"),
)
"""In the order in which they run: what `result.html` has too; people and what is chosen; each part;
all together.
"""
COHORT_STYLES: Final = ("page.css", "sections.css", "cohort.css")
COHORT_DATA: Final = ("CURVES", "COHORT")
"""What `cohort.html` is of: packed mean curves, and everything else as JSON, in the order of the
file.
"""
PLOTS = "libraries/uPlot"  # The library that draws curves


def _build_policy(*scripts: str) -> str:
    """Build a Content-Security-Policy that admits these inline scripts only, and no request."""
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(s.encode()).digest()).decode()}'"
        for s in scripts
    )
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _escape_script(script: str) -> str:
    """Escape a script for use inside `<script>`, with the line breaks that a browser hashes."""
    text = script.replace("\r\n", "\n").replace("\r", "\n")
    return (
        text.replace("<!--", "<\\!--")
        .replace("</script", "<\\/script")
        .replace("</SCRIPT", "<\\/SCRIPT")
    )


def _read_part(name: str) -> str:
    """Read a file of this folder."""
    return (files("gaitcal.report.page") / name).read_text(encoding="utf-8")


@dataclass(frozen=True)
class PageContent:
    """Scene and data of one page."""

    scene: Scene
    data: Mapping[str, Any] | None = (
        None  # Curves and tables (`gaitcal.report.page.page_data`); None: the body alone
    )


def render_page(shown: PageContent, bones: bone_files.BoneMeshes | None = None) -> str:
    """Render the page of a result.

    Parameters
    ----------
    shown
        Scene and data.
    bones
        None: those of the installed `myo-sim`; no bones if it is not installed.

    Returns
    -------
    str
        HTML.

    Raises
    ------
    GaitcalError
        MeshCat is not installed.
    """
    bones = bones or bone_files.find_installed_bones()
    scene = scene_file.dump_scene_json(
        shown.scene,
        read_body_meshes(),
        None if bones is None else bone_placement.find_landmarks(bones),
    )
    data = plain_data.dump_script_json(
        shown.data
        and {**page_data.thin_page_data(shown.data), "peaks": page_data.build_peak_rows(shown.data)}
    )
    viewer, licences = _read_meshcat()
    content = _collect_scripts_and_styles(SCRIPTS, STYLES, meshcat=viewer)
    content["CONVENTIONS"] = plain_data.dump_script_json(page_data.build_conventions())
    # Data in the page itself: it is opened without a server.
    content["RESULT"] = f'{{"scene":{scene},"sheet":{data}}}'
    of_bones = f"Bones of {bones.source}\n\n{bones.licence}" if bones and bones.licence else ""
    content["LICENCES"] = "\n\n".join(
        filter(None, [*licences, content["LICENCES"], of_bones])
    ).replace("<", "‹")
    # One pass over the template: what a name holds is never looked at again.
    return re.sub(
        r"@@([A-Z]+)@@", lambda found: content[found.group(1)], _read_part("templates/page.html")
    )


def write_cohort_page(path: Path, data: Mapping[str, Iterable[str]]) -> None:
    """Write the page of a cohort piece by piece, as cohorts may be large.

    Parameters
    ----------
    path
        The file.
    data
        The pieces of each of `COHORT_DATA`, generated when they are needed.
    """
    content = _collect_scripts_and_styles(COHORT_SCRIPTS, COHORT_STYLES)
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        for number, piece in enumerate(
            re.split(r"@@([A-Z]+)@@", _read_part("templates/cohort.html"))
        ):
            if number % 2 == 0:
                stream.write(piece)
            elif piece in COHORT_DATA:
                stream.writelines(data[piece])
            else:
                stream.write(content[piece])


def _collect_scripts_and_styles(
    scripts: Sequence[str], styles: Sequence[str], **first: str
) -> dict[str, str]:
    """Collect what a template needs; `first`: scripts that run before all others."""
    parts = [_read_part(f"scripts/{name}") for name in scripts]
    running = {
        **{name.upper(): _escape_script(script) for name, script in first.items()},
        "PLOTS": _escape_script(_read_part(f"{PLOTS}.iife.min.js")),
        "PAGE": _escape_script("\n".join([parts[0], _build_constants(), *parts[1:]])),
    }
    return {
        "POLICY": _build_policy(*running.values()),
        "STYLE": "\n".join(
            [_read_part(f"{PLOTS}.min.css"), *(_read_part(f"styles/{name}") for name in styles)]
        ),
        "LICENCES": f"uPlot\n\n{_read_part(f'{PLOTS}.LICENSE.txt')}".replace("<", "‹"),
        **running,
    }


def _build_constants() -> str:
    """Build the script with labels, units and numbers that Python and the scripts share."""
    constants = {
        "GAP": plain_data.GAP,
        "LARGEST": plain_data.LARGEST,
        "LEGS": SIDE_WORDS,
        "TRIAL_CURVES": TRIAL_CURVES,
        "UNITS": UNIT_WORDS,
        "BY_HAND": describe_sources([EventSource.PERSON]),
    }
    return f"Object.assign(Gaitcal, {plain_data.dump_script_json(constants)});"


def _read_meshcat() -> tuple[str, list[str]]:
    """Read MeshCat's viewer and the licences on the page, without importing MeshCat."""
    spec = find_spec("meshcat")
    places = list(spec.submodule_search_locations or ()) if spec else []
    if not places:
        raise GaitcalError("meshcat is not installed; install gaitcal again")
    folder = Path(places[0]) / "viewer"
    # The viewer is read from the installed package; importing it would start its server.
    viewer = folder / "dist" / "main.min.js"
    texts = [
        ("MeshCat", folder / "LICENSE"),
        ("three.js and others inside MeshCat", folder / "dist" / "main.min.js.LICENSE.txt"),
    ]
    try:
        script = viewer.read_text(encoding="utf-8")
        licences = [
            f"{name}\n\n{path.read_text(encoding='utf-8')}"
            for name, path in texts
            if path.is_file()
        ]
    except OSError as error:
        raise GaitcalError(
            f"{viewer}: cannot be read ({error.strerror}); install meshcat again"
        ) from error
    try:
        text = distribution(PACKAGE).read_text("licenses/LICENSE")
    except PackageNotFoundError:
        text = None
    return script, [*licences, *([f"Body meshes of {PACKAGE}\n\n{text}"] if text else [])]


def list_omissions(shown: PageContent) -> tuple[str, ...]:
    """List the trials of which the page shows only some frames.

    Parameters
    ----------
    shown
        Scene and data.

    Returns
    -------
    tuple of str
        One sentence for each.
    """
    curves = (
        ()
        if shown.data is None
        else page_data.report_thinned_curves(page_data.thin_page_data(shown.data))
    )
    return (*scene_file.report_thinned_frames(shown.scene), *curves)


def append_trials(
    scene: Scene, further: Scene, names: Mapping[str, str] | None = None
) -> Scene | None:
    """Append the trials of another scene; None if it has other segments.

    `names`: new names of trials of `further`: old -> new.
    """
    if further.segments != scene.segments:
        return None
    new = names or {}
    trials = (
        replace(
            _reorder_markers(trial, further.labels, scene.labels),
            name=new.get(trial.name, trial.name),
        )
        for trial in further.trials
    )
    return replace(scene, trials=(*scene.trials, *trials))


def prepend_trials(scene: Scene, earlier: Scene) -> Scene | None:
    """Prepend the trials of an earlier scene.

    Parameters
    ----------
    scene
        The new scene.
    earlier
        Its trials stay unless a new one has the same name.

    Returns
    -------
    Scene or None
        None if the scenes have different segments.
    """
    names = {trial.name for trial in scene.trials}
    kept = tuple(trial for trial in earlier.trials if trial.name not in names)
    joined = append_trials(replace(scene, trials=()), replace(earlier, trials=kept))
    return None if joined is None else replace(joined, trials=(*joined.trials, *scene.trials))


def _reorder_markers(
    trial: MotionScene, labels: tuple[str, ...], wanted: tuple[str, ...]
) -> MotionScene:
    """Reorder the measured markers of a trial for another model; NaN for missing markers."""
    if labels == wanted:
        return trial
    measured = np.full((len(trial.time), len(wanted), 3), np.nan, dtype=np.float32)
    for k, label in enumerate(wanted):
        if label in labels:
            measured[:, k] = trial.measured[:, labels.index(label)]
    return replace(trial, measured=measured)


def merge_page_data(earlier: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """Merge page data of further trials with those of an earlier run.

    Parameters
    ----------
    earlier
        Its trials stay unless a new one has the same name.
    new
        Page data of the new run.

    Returns
    -------
    dict
        Page data.
    """
    names = {trial["name"] for trial in new["trials"]}
    kept = select_trials(
        earlier, [trial["name"] for trial in earlier["trials"] if trial["name"] not in names]
    )
    verdict, other_lines = _combine_verdicts(kept, new), list(new["lines"][1:])
    if kept["trials"]:
        last = ", ".join(plain_data.replace_control_characters(name) for name in sorted(names))
        other_lines[-1:] = [
            {**line, "text": f"{last}: {line['text']}"} for line in other_lines[-1:]
        ]
    trials = [*kept["trials"], *new["trials"]]
    return {
        **new,
        "trials": trials,
        "verdict": verdict,
        "lines": [page_data.format_verdict_line(verdict), *other_lines],
    }


def append_page_data(data: Mapping[str, Any], further: Mapping[str, Any]) -> dict[str, Any]:
    """Append further trials to the page data of a calibration; their names must be new."""
    verdict, lines = _combine_verdicts(data, further), list(data["lines"])
    if verdict["sentence"] != data["verdict"]["sentence"]:
        lines[:1] = [page_data.format_verdict_line(verdict)]
    return {
        **data,
        "lines": lines,
        "trials": [*data["trials"], *further["trials"]],
        "verdict": verdict,
        "bands": data["bands"] or further["bands"],
    }


def select_trials(data: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """Select some trials from page data, with the reasons about them.

    Parameters
    ----------
    data
        Page data of further trials.
    names
        Trials to keep.

    Returns
    -------
    dict
        Page data.
    """
    trials = [trial for trial in data["trials"] if trial["name"] in names]
    about = [reason for reason in data["verdict"]["reasons"] if set(reason["trials"]) & set(names)]
    judgement = combine_judgements(
        trial["verdict"]["judgement"] for trial in trials if trial["verdict"] is not None
    )
    if about and judgement is Judgement.TRUSTWORTHY:
        judgement = Judgement.DOUBTFUL
    return {
        **data,
        "trials": trials,
        "verdict": {**data["verdict"], "judgement": judgement.value, "reasons": about},
    }


def add_doubts(data: Mapping[str, Any], doubts: Iterable[tuple[str, str, str]]) -> dict[str, Any]:
    """Add warnings to the verdict of page data, unless they are there already.

    Parameters
    ----------
    data
        Page data.
    doubts
        Trial, cause and action of each warning.

    Returns
    -------
    dict
        Page data; a trustworthy verdict becomes doubtful.
    """
    verdict = data["verdict"]
    known = {(reason["cause"], *reason["trials"]) for reason in verdict["reasons"]}
    code = page_data.explain_code(Code.RESULT_EDITED)
    new = [
        {
            **code,
            "severity": "warning",
            "cause": cause,
            "evidence": "",
            "action": action,
            "trials": [name],
            "leg": "",
        }
        for name, cause, action in doubts
        if (cause, name) not in known
    ]
    if not new:
        return dict(data)
    judgement = verdict["judgement"]
    if judgement == Judgement.TRUSTWORTHY.value:
        judgement = Judgement.DOUBTFUL.value
    return {
        **data,
        "verdict": {**verdict, "judgement": judgement, "reasons": [*verdict["reasons"], *new]},
    }


def rename_trials(data: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Rename trials in page data: old -> new."""
    reasons = [
        {**reason, "trials": [names.get(name, name) for name in reason["trials"]]}
        for reason in data["verdict"]["reasons"]
    ]
    trials = [
        {**trial, "name": names.get(trial["name"], trial["name"])} for trial in data["trials"]
    ]
    return {**data, "trials": trials, "verdict": {**data["verdict"], "reasons": reasons}}


def _combine_verdicts(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Combine two verdicts: refused or trustworthy if both are, else doubtful."""
    parts = [data["verdict"] for data in (one, other) if data["trials"]]
    trials = {}
    for trial in (*one["trials"], *other["trials"]):
        if (verdict := trial["verdict"]) is not None:
            legs = {side: Judgement(verdict[side]) for side in SIDES if side in verdict}
            trials[trial["name"]] = WalkVerdict(
                judgement=Judgement(verdict["judgement"]), legs=legs
            )
    judged = Verdict(
        judgement=combine_judgements(part["judgement"] for part in parts),
        reasons=(),
        trials=trials,
        forced=any(part.get("forced", False) for part in parts),
    )
    reasons = sorted(
        (r for part in parts for r in part["reasons"]),
        key=lambda reason: reason["severity"] != "error",
    )
    return {
        "judgement": judged.judgement.value,
        "sentence": judged.sentence,
        "reasons": reasons,
        "forced": judged.forced,
    }
