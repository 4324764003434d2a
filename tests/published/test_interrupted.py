"""Runs that are killed, at any moment, and taken up again: the same table to the last bit."""

from __future__ import annotations

import hashlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from gaitcal.published.case import MonteCarloCase
from gaitcal.published.study import Store, monte_carlo
from gaitcal.published.workers import Workers
from tests.published.small_study import CHUNK, PLAN

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


def start(folder: Path) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "tests.published.small_study", str(folder)]
    return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def wait_for_chunks(folder: Path, count: int, process: subprocess.Popen[bytes]) -> None:
    for _ in range(1200):
        if len(list(folder.glob("draws/*.parquet"))) >= count or process.poll() is not None:
            return
        time.sleep(0.05)
    pytest.fail(f"no {count} chunks within a minute")


def content(folder: Path) -> str:
    return hashlib.sha256((folder / "montecarlo.csv").read_bytes()).hexdigest()


@pytest.mark.slow
def test_killed_again_and_again(case: MonteCarloCase, tmp_path: Path) -> None:
    whole = monte_carlo(case, tmp_path / "whole", plan=PLAN, workers=Workers())
    killed, moments = tmp_path / "killed", random.Random(11)
    for _ in range(3):
        process = start(killed)
        wait_for_chunks(killed, len(list(killed.glob("draws/*.parquet"))) + 1, process)
        time.sleep(moments.uniform(0.0, 0.2))
        process.send_signal(signal.SIGKILL)
        process.wait()
    held = len(Store(killed).read(PLAN))
    assert 0 < held < PLAN.total  # otherwise it was not killed at work
    assert start(killed).wait(120) == 0
    pd.testing.assert_frame_equal(Store(killed).read(PLAN), whole.draws, check_exact=True)
    assert content(killed) == content(tmp_path / "whole")


@pytest.mark.slow
def test_workers_end_with_their_parent_and_chunks_are_whole(tmp_path: Path) -> None:
    process = start(tmp_path)
    wait_for_chunks(tmp_path, 1, process)
    workers = children(process.pid)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert workers or sys.platform != "linux"
    for _ in range(100):
        if not any(Path(f"/proc/{pid}").exists() for pid in workers):
            break
        time.sleep(0.1)
    else:
        pytest.fail("worker processes outlive their parent by ten seconds")
    kept = Store(tmp_path).read()
    assert len(kept) % CHUNK == 0


def children(parent: int) -> list[int]:
    """Worker processes of a process, on Linux."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
            words = (path.parent / "cmdline").read_text()
        except OSError:
            continue
        if int(fields[1]) == parent and "LokyProcess" in words:
            found.append(int(path.parent.name))
    return found


@pytest.mark.slow
def test_control_c_leaves_whole_chunks(tmp_path: Path) -> None:
    process = start(tmp_path)
    wait_for_chunks(tmp_path, 2, process)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) != 0
    found = Store(tmp_path).read()
    assert len(found) >= 2 * CHUNK
    assert len(found) % CHUNK == 0
