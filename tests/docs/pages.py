"""Pages of the documentation as a reader would follow them: each in an empty folder, from first
block to last.

A block is fenced: ```` ```sh ```` runs in the page's own folder, ```` ```python ```` too, each
page's Python blocks with the names of those before. A block that cannot run here says why in its
fence, visible to readers as its title:
```` ```sh title="not run here: needs a cluster" ````; it is still checked by `bash -n` or the
Python compiler. A file that a page writes is ```` ```toml title="study.toml" ````: it is put into
the folder where it stands.
"""

import re
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pytest

from tests.commands import Done
from tests.docs.kept_commands import run_command

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


def run(block: Block, folder: Path, names: dict[str, Any], kept: Path) -> None:
    """Run a block, or write its file; `folder` is the current one.

    Lines of commands of `gaitcal` run in the process of the tests, all others by bash.
    """
    if block.is_file:
        target = folder / block.title
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(block.text, encoding="utf-8")
    elif block.runs and block.language == "python":
        exec(compile(block.text, f"{block.page}:{block.line}", "exec"), names)
    elif block.runs:
        for line in block.text.splitlines():
            run_line(line, f"{block.page}:{block.line}", kept)


def run_line(line: str, where: str, kept: Path) -> None:
    """Run a line of a shell block; the test fails if the line does."""
    command, may_fail, _ = line.partition(" || true")
    words = shlex.split(command)
    if words[:1] == ["gaitcal"]:
        done = run_command(words[1:], kept)
    else:
        found = subprocess.run(
            ["bash", "-e", "-c", command], capture_output=True, text=True, check=False, timeout=60
        )
        done = Done(found.returncode, found.stdout, found.stderr)
    if done.returncode and not may_fail:
        said = f"exit code {done.returncode}\n{done.stdout}{done.stderr}"
        pytest.fail(f"{where}: {line}: {said}", pytrace=False)


ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def needs_recordings(page: Path) -> bool:
    """Whether a page fetches public recordings."""
    return any("gaitcal example " in block.text for block in blocks_of(page) if block.runs)


def follow(page: Path, folder: Path, kept: Path) -> None:
    """Run every block of a page in `folder`, the current one."""
    names: dict[str, Any] = {}
    for block in blocks_of(page):
        run(block, folder, names, kept)
