"""Pages of the documentation as a reader would follow them: each in an empty folder, from first block to last."""

from __future__ import annotations

import os
import shutil
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.docs.blocks import Block, blocks_of, run
from tests.kept import kept_folder

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PROGRAM = """#!/bin/sh
[ "$1" = example ] && exec "{python}" -m tests.docs.local_example "$@"
[ "$1" = synthesize ] && exec "{python}" -m tests.docs.kept_person "$@"
exec "{python}" -m gaitcal.cli "$@"
"""
SETUP = """gaitcal synthesize --out person --noise
gaitcal calibrate person/study.toml --out result
"""
"""The block with which how-to pages begin that need a result: run once, and copied."""


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
    """Run every block of a page in `folder`, which becomes the current one; returns what commands printed."""
    names: dict[str, Any] = {}
    told = []
    setting = environment(bin_folder, kept)

    def ran(block: Block, place: Path) -> None:
        place.mkdir(exist_ok=True)
        text = run(block, place, names, setting)
        if text.startswith("FAILED"):
            pytest.fail(text, pytrace=False)
        told.append(text)

    for block in blocks_of(page):
        if block.text == SETUP:
            made = kept_folder(kept / "setup", partial(ran, block))
            shutil.copytree(made, folder, dirs_exist_ok=True)
        else:
            ran(block, folder)
    return "\n".join(told)
