"""`python -m scripts.validation folders`: a few of each attack; the script itself does hundreds."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="forks")
def test_a_few_attacks(tmp_path: Path) -> None:
    few = ("--pairs", "0", "--kills", "2", "--chunks", "6", "--files", "10", "--keep", str(tmp_path))
    command = [sys.executable, "-m", "scripts.validation", "folders", *few]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 faults" in done.stdout
    assert "chunks: 6 damaged" in done.stdout
