"""A real scheduler and two workers on the loopback interface; one worker is killed at work."""

import os
import re
import runpy
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pandas as pd
import pytest

from gaitcal.errors import GaitcalError
from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.draw_study import monte_carlo
from gaitcal.montecarlo.protocol import Plan
from gaitcal.montecarlo.workers import DaskCluster, Workers
from tests.refusal import refusal

pytest.importorskip("distributed", reason="no dask here; it comes with the extra `cluster`")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")

ROOT = Path(__file__).parents[2]
Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts `dask ...` programs and ends them after the test."""
    with ExitStack() as stack:

        def program(*words: str) -> subprocess.Popen[str]:
            environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
            pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
            process = subprocess.Popen(
                [sys.executable, "-m", *words], cwd=ROOT, env=environment, **pipes
            )
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        yield program


def scheduler(start: Start) -> str:
    process = start(
        "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"
    )
    if process.stderr is None:
        pytest.fail("no log")
    for line in process.stderr:
        if told := re.search(r"tcp://127\.0\.0\.1:\d+", line):
            return told[0]
    return pytest.fail("the scheduler did not start")


def worker(start: Start, address: str) -> subprocess.Popen[str]:
    return start(
        "distributed.cli.dask_worker", address, "--no-nanny", "--nthreads", "1", "--no-dashboard"
    )


@pytest.mark.slow
def test_same_table_with_a_worker_killed_at_work(
    case: MonteCarloCase, tmp_path: Path, start: Start
) -> None:
    plan = Plan(levels=(100,), draws=15)
    address = scheduler(start)
    workers = [worker(start, address) for _ in range(2)]
    killed: list[int] = []

    def kill_one(done: int, todo: int) -> None:
        if done and not killed:
            workers[0].send_signal(signal.SIGKILL)
            killed.append(done)

    found = monte_carlo(
        case, tmp_path, plan=plan, workers=DaskCluster(address), chunk_draws=5, progress=kill_one
    )
    assert killed and killed[0] < plan.total
    assert workers[0].wait(10) == -signal.SIGKILL
    reference = monte_carlo(case, plan=plan, workers=Workers())
    pd.testing.assert_frame_equal(found.draws, reference.draws, check_exact=True)


def fails(task: int) -> int:
    raise ValueError(f"task {task} is bad")


@pytest.mark.slow
def test_faults_of_the_cluster_are_told(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gaitcal.montecarlo.workers.WAIT_S", 1)

    def refused(address: str) -> str:
        return refusal(lambda: list(DaskCluster(address).run(str, [1])))

    for nobody in ("tcp://127.0.0.1:9", "nonsense://x"):
        assert f"--cluster: found '{nobody}'" in refused(nobody)
    address = scheduler(start)
    assert "has no workers" in refused(address)
    worker(start, address)
    monkeypatch.setattr("gaitcal.montecarlo.workers.WAIT_S", 30)
    assert sorted(DaskCluster(address).run(str, range(20))) == sorted(str(k) for k in range(20))
    with pytest.raises(GaitcalError, match="task 0 is bad"):
        list(DaskCluster(address).run(fails, [0]))


@pytest.mark.slow
def test_example_script(tmp_path: Path, start: Start, capsys: pytest.CaptureFixture[str]) -> None:
    address = scheduler(start)
    worker(start, address)
    script = runpy.run_path(str(ROOT / "scripts" / "examples" / "03_monte_carlo_cluster.py"))
    script["main"]([str(tmp_path / "out"), address, "--draws", "5"])
    assert "hip_flexion_l" in capsys.readouterr().out
    assert (tmp_path / "out" / "montecarlo.csv").exists()
