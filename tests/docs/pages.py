"""Pages of the documentation as a reader would follow them: each in an empty folder, from first
block to last.

A block is fenced: ```` ```sh ```` runs in the page's own folder, ```` ```python ```` too, each
page's Python blocks with the names of those before. A block that cannot run here says why in its
fence, visible to readers as its title:
```` ```sh title="not run here: needs a cluster" ````; it is still checked by `bash -n` or the
Python compiler. A file that a page writes is ```` ```toml title="study.toml" ````: it is put into
the folder where it stands.
"""

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pytest

FENCE: Final = re.compile(r"^( *)```([a-z]*)(?: +title=\"([^\"]*)\")?\n(.*?)^\1```$", re.M | re.S)
NOT_RUN: Final = "not run here: "
WRITTEN: Final = ("toml", "csv")
"""Languages whose titled blocks are files."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """A fenced block."""

    page: str
    line: int
    language: str
    title: str
    text: str

    @property
    def runs(self) -> bool:
        """Whether it is to be run."""
        return self.language in ("sh", "python") and not self.title.startswith(NOT_RUN)

    @property
    def is_file(self) -> bool:
        """Whether it is a file that the reader writes."""
        return self.language in WRITTEN and bool(self.title)


def blocks_of(path: Path) -> tuple[Block, ...]:
    """Every fenced block of a page."""
    text = path.read_text(encoding="utf-8")
    out = []
    for found in FENCE.finditer(text):
        indent, language, title, inside = found.groups()
        out.append(
            Block(
                page=path.name,
                line=text.count("\n", 0, found.start()) + 1,
                language=language,
                title=title or "",
                text=re.sub(rf"^{indent}", "", inside, flags=re.M),
            )
        )
    return tuple(out)


def lint(block: Block) -> str:
    """What is wrong with the form of a block; empty where nothing is."""
    if block.language == "sh":
        done = subprocess.run(
            ["bash", "-n"], input=block.text, capture_output=True, text=True, check=False
        )
        return done.stderr.strip()
    if block.language == "python":
        try:
            compile(block.text, block.page, "exec")
        except SyntaxError as error:
            return str(error)
    return ""


def run(block: Block, folder: Path, names: dict[str, Any], environment: Mapping[str, str]) -> str:
    """Run a block, or put its file there; returns what a command printed, or what went wrong after
    `FAILED`.
    """
    if block.is_file:
        target = folder / block.title
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(block.text, encoding="utf-8")
    elif block.runs and block.language == "python":
        exec(compile(block.text, f"{block.page}:{block.line}", "exec"), names)
    elif block.runs:
        command = ["bash", "-e", "-c", block.text]
        done = subprocess.run(
            command,
            cwd=folder,
            env=dict(environment),
            capture_output=True,
            text=True,
            check=False,
            timeout=900,
        )
        if done.returncode:
            return (
                f"FAILED {block.page}:{block.line}: exit code "
                f"{done.returncode}\n{done.stdout}{done.stderr}"
            )
        return done.stdout + done.stderr
    return ""


ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PROGRAM = """#!/bin/sh
[ "$1" = example ] && exec "{python}" -m tests.docs.local_example "$@"
case "$1 $2" in
    synthesize*|calibrate*.toml) exec "{python}" -m tests.docs.kept_commands "$@" ;;
    montecarlo*) set -- $(echo "$@" | sed "s/--draws 20/--draws 2/") ;;
esac
exec "{python}" -m gaitcal.cli "$@"
"""
"""`gaitcal` with the recordings that are here, with what pages share made once, and with studies of
fewer draws.
"""


def environment(folder: Path, kept: Path) -> dict[str, str]:
    """With `gaitcal` on the path, as an installation has it, and what pages share in `kept`."""
    program = folder / "bin" / "gaitcal"
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text(PROGRAM.format(python=sys.executable), encoding="utf-8")
    program.chmod(0o755)
    paths = {
        "PATH": os.pathsep.join([str(program.parent), os.environ["PATH"]]),
        "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]),
        "GAITCAL_TESTS_KEPT": str(kept),
    }
    return {**os.environ, **paths}


def needs_recordings(page: Path) -> bool:
    """Whether a page fetches public recordings."""
    return any("gaitcal example " in block.text for block in blocks_of(page) if block.runs)


def follow(page: Path, folder: Path, bin_folder: Path, kept: Path) -> str:
    """Run every block of a page in `folder`, which becomes the current one; returns what commands
    printed.
    """
    names: dict[str, Any] = {}
    told = []
    setting = environment(bin_folder, kept)

    for block in blocks_of(page):
        text = run(block, folder, names, setting)
        if text.startswith("FAILED"):
            pytest.fail(text, pytrace=False)
        told.append(text)
    return "\n".join(told)
