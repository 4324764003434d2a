"""Pages of the documentation as a reader would follow them: each in an empty folder, from first block to last."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from documentation.blocks import Block, blocks_of, run  # noqa: E402

DOCS = ROOT / "docs"
PROGRAM = """#!/bin/sh
[ "$1" = example ] && exec "{python}" -m tests.docs.local_example "$@"
exec "{python}" -m gaitcal.cli "$@"
"""
SETUP = """gaitcal synthesize --out person --noise
gaitcal calibrate person/study.toml --out result
"""
"""The block with which how-to pages begin that need a result: run once, and copied."""


def environment(folder: Path) -> dict[str, str]:
    """With `gaitcal` on the path, as an installation has it."""
    program = folder / "bin" / "gaitcal"
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text(PROGRAM.format(python=sys.executable), encoding="utf-8")
    program.chmod(0o755)
    paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PATH": f"{program.parent}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": paths}


def needs_recordings(page: Path) -> bool:
    """Whether a page fetches public recordings."""
    return any("gaitcal example " in block.text for block in blocks_of(page) if block.runs)


def prepared(block: Block, folder: Path, made: Path) -> bool:
    """Put the result there that another page made with the same block."""
    if block.text != SETUP or not (made / "result").is_dir():
        return False
    shutil.copytree(made, folder, dirs_exist_ok=True)
    return True


def follow(page: Path, folder: Path, bin_folder: Path, made: Path) -> str:
    """Run every block of a page in `folder`, which becomes the current one; returns what commands printed."""
    names: dict[str, Any] = {}
    told = []
    for block in blocks_of(page):
        if prepared(block, folder, made):
            continue
        text = run(block, folder, names, environment(bin_folder))
        if text.startswith("FAILED"):
            pytest.fail(text, pytrace=False)
        told.append(text)
        if block.text == SETUP:
            shutil.copytree(folder, made, dirs_exist_ok=True)
    return "\n".join(told)
