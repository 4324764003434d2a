"""Runs that are killed, at any moment, and taken up again: the same table to the last bit."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.draw_study import Store, monte_carlo
from gaitcal.montecarlo.workers import Workers
from tests.montecarlo.small_study import CHUNK, PLAN

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


def start(folder: Path) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "tests.montecarlo.small_study", str(folder)]
    return subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def wait_for_chunks(folder: Path, count: int, process: subprocess.Popen[bytes]) -> None:
    for _ in range(6000):  # a busy machine needs minutes
        if len(list(folder.glob("draws/*.parquet"))) >= count or process.poll() is not None:
            return
        time.sleep(0.05)
    process.kill()
    process.wait()
    pytest.fail(f"no {count} chunks within five minutes")


@pytest.mark.slow
def test_killed_and_interrupted_and_taken_up_again(case: MonteCarloCase, tmp_path: Path) -> None:
    """By SIGKILL, after which no worker is left, and by Ctrl-C: whole chunks stay, and the end is
    that of one run.
    """
    folder = tmp_path / "killed"
    process = start(folder)
    wait_for_chunks(folder, 1, process)
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
    killed = len(Store(folder).read())
    process = start(folder)
    wait_for_chunks(folder, killed // CHUNK + 1, process)
    process.send_signal(signal.SIGINT)
    assert process.wait(300) != 0
    interrupted = len(Store(folder).read())
    assert 0 < killed < interrupted < PLAN.total  # otherwise it was not stopped at work
    assert killed % CHUNK == interrupted % CHUNK == 0
    resumed = monte_carlo(case, folder, plan=PLAN, workers=Workers(), chunk_draws=CHUNK)
    whole = monte_carlo(case, tmp_path / "whole", plan=PLAN, workers=Workers(), chunk_draws=CHUNK)
    assert resumed.computed == PLAN.total - interrupted
    pd.testing.assert_frame_equal(resumed.draws, whole.draws, check_exact=True)
    assert (folder / "montecarlo.csv").read_bytes() == (
        tmp_path / "whole/montecarlo.csv"
    ).read_bytes()


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
