"""The API reference: HTML pages from the docstrings of the public names and of the types they take and return.

    python scripts/api_reference.py OUT        (default docs/api; then open OUT/index.html)

Needs the extra: pip install 'gaitcal[docs]'; `sh scripts/docs.sh` does both. Ends with an error where nothing is said
about a public name, and where a type of ours stands in a signature without a page of its own.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import pdoc
import pdoc.doc
import pdoc.render

import gaitcal

MODULES = (
    "gaitcal",
    "gaitcal.codes",
    "gaitcal.findings",
    "gaitcal.verdict.verdict",
    "gaitcal.files.snapshot",
    "gaitcal.study.study",
    "gaitcal.study.study_trial",
    "gaitcal.study.joint_prior",
    "gaitcal.study.truth",
    "gaitcal.person.result",
    "gaitcal.person.truth_errors",
    "gaitcal.person.hold_out",
    "gaitcal.study.settings",
    "gaitcal.recording",
    "gaitcal.recording.metadata",
    "gaitcal.model.marker_coverage",
    "gaitcal.model.subject_model",
    "gaitcal.model.linkage",
    "gaitcal.model.joint_parameters",
    "gaitcal.model.inertial_parameters",
    "gaitcal.model.segment_frames",
    "gaitcal.motion.motion",
    "gaitcal.motion.spline",
    "gaitcal.motion.track",
    "gaitcal.motion.trial_problem",
    "gaitcal.calibration.joint_phases",
    "gaitcal.calibration.inertial_calibration",
    "gaitcal.dynamics.inverse_dynamics",
    "gaitcal.dynamics.ground_contact",
    "gaitcal.dynamics.residual_limits",
    "gaitcal.montecarlo.case",
    "gaitcal.montecarlo.settings",
    "gaitcal.montecarlo.study",
    "gaitcal.montecarlo.statistics",
    "gaitcal.montecarlo.workers",
    "gaitcal.export",
    "gaitcal.compare",
    "gaitcal.page",
)
"""What a user's own program meets; the rest is inside."""

_TAGS = r"(?:<[^>]+>|\s)*"
"""Highlighting between the words of a type; a match begins and ends inside one of its spans."""
_WORDS = (
    r"numpy \. ndarray \[ tuple \[ typing \. Any , \.\.\. \] , numpy \. dtype \[ numpy \. (?:float64|intp|bool) \] \]"
)
SHORTER = {
    re.compile(_WORDS.replace(" ", _TAGS)): "Array",
    re.compile(_TAGS.join(("pinocchio", r"\.", "pinocchio_pywrap_default", r"\.", "Model"))): "pinocchio.Model",
}
SECTION = re.compile(r"^(Parameters|Returns|Raises)\n-+\n((?:.*\n?)*?)(?=^\w[^\n]*\n-+\n|\Z)", re.M)
UNLINKED = re.compile(r"(?<![\w./\">#])gaitcal(?:\.\w+)+\.[A-Z]\w+")


def lists(docstring: str) -> str:
    """Sections of a docstring (`name : text`, or a name with its text indented below) as lists in Markdown."""

    def as_list(found: re.Match[str]) -> str:
        title, body = found.groups()
        entries = re.sub(r"\n +", " ", body.strip()).splitlines()
        if title == "Parameters":
            entries = [re.sub(r"^([\w, *]+?) : ", lambda m: f"`{m[1]}`: ", entry) for entry in entries]
        elif title == "Raises":
            entries = [re.sub(r"^(\w+) ", r"`\1`: ", entry) for entry in entries]
        return f"**{title}**\n\n" + "\n".join(f"- {entry}" for entry in entries) + "\n\n"

    return SECTION.sub(as_list, docstring)


def undocumented() -> list[str]:
    """Public functions and classes, and their public members and fields, that nothing is said about."""
    page = pdoc.doc.Module(gaitcal)
    inside = [member for of in page.classes for member in of.members.values()]
    public = [m for m in inside if not m.name.startswith("_") and m.name != "args"]  # `args` of exceptions: Python's
    return [m.fullname for m in (*page.classes, *page.functions, *public) if not m.docstring.strip()]


def build(out: Path) -> list[str]:
    """Write the pages; returns what is wrong with them."""
    for name in gaitcal.__all__:  # loaded on first use; pdoc wants them there
        getattr(gaitcal, name)
    pdoc.render.configure(docformat="markdown", show_source=False, footer_text=f"gaitcal {gaitcal_version()}")
    to_html = pdoc.render.env.filters["to_markdown"]

    def with_lists(context: object, docstring: str) -> str:
        return str(to_html(context, lists(docstring)))

    with_lists.jinja_pass_arg = to_html.jinja_pass_arg  # type: ignore[attr-defined]
    pdoc.render.env.filters["to_markdown"] = with_lists
    try:
        pdoc.pdoc(*MODULES, output_directory=out)
    finally:
        pdoc.render.env.filters["to_markdown"] = to_html
    faults = [f"{name} has no docstring" for name in undocumented()]
    for page in sorted(out.rglob("*.html")):
        text = page.read_text(encoding="utf-8")
        for long, short in SHORTER.items():
            text = long.sub(short, text)
        page.write_text(text, encoding="utf-8")
        if page.name == "gaitcal.html":
            plain = re.sub(r"<a [^>]*>.*?</a>", "", text)
            faults += [f"{page.name}: {name} has no page" for name in sorted(set(UNLINKED.findall(plain)))]
    return faults


def gaitcal_version() -> str:
    """Of the installed package, or nothing in a bare checkout."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("gaitcal")
    except PackageNotFoundError:
        return ""


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", default=Path("docs/api"))
    chosen = parser.parse_args(arguments)
    faults = build(chosen.out)
    for fault in faults:
        print(fault, file=sys.stderr)
    if faults:
        raise SystemExit(1)
    print(f"API reference: {chosen.out / 'index.html'}")


if __name__ == "__main__":
    main()
