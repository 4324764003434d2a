"""Pages of the documentation as a reader would follow them: each in an empty folder, from first block to last."""

import os
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.docs.blocks import blocks_of, run

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
"""`gaitcal` with the recordings that are here, with what pages share made once, and with studies of fewer draws."""


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

    for block in blocks_of(page):
        text = run(block, folder, names, setting)
        if text.startswith("FAILED"):
            pytest.fail(text, pytrace=False)
        told.append(text)
    return "\n".join(told)
