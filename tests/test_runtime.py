"""One BLAS thread and the same bits for everybody; the memory that is given back; signals of
programs in tests.
"""

import inspect
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits
from typer.testing import CliRunner

import gaitcal as gc
from gaitcal.cli.application import app
from gaitcal.runtime import map_in_pairs, one_blas_thread, with_one_blas_thread
from tests.synthetic_studies import write_synthetic_study

ROOT = Path(__file__).parents[1]
NOT_NUMERICAL = {
    "parameter_table", "read_cycles", "cycles_to_xarray", "read_normal_bands", "power_of",
    "component_of", "load_model", "save_model", "load_marker_set",
}  # fmt: skip
"""Functions that find, read or write numbers, and compute none."""
NEEDS = {"Haswell": ("avx2", "1,2"), "SkylakeX": ("avx512f", "1,4")}
"""OpenBLAS's kernels, what a processor must have for each, and how many threads are allowed."""


def threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


@with_one_blas_thread
def asked(fault: bool = False) -> set[int]:
    if fault:
        raise ValueError("a fault")
    return threads()


def test_one_inside_and_as_many_as_before_afterwards() -> None:
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        with one_blas_thread():
            assert threads() == {1}
        assert threads() == before
        assert asked() == {1}
        with pytest.raises(ValueError, match="a fault"):
            asked(fault=True)
        assert threads() == before
        assert 2 in before  # some library may have been built for one thread


def test_threads_and_calls_within_calls_restore_it_once() -> None:
    """The first of two threads ends while the second is still computing."""
    second_is_in, first_has_ended, seen = threading.Event(), threading.Event(), []

    def second() -> None:
        with one_blas_thread():
            second_is_in.set()
            first_has_ended.wait(10)
            seen.append(threads())

    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        other = threading.Thread(target=second)
        with one_blas_thread():
            with one_blas_thread():
                other.start()
                second_is_in.wait(10)
            assert threads() == {1}
        first_has_ended.set()
        other.join()
        assert seen == [{1}] and threads() == before


def test_pairs_keep_their_order_run_in_two_threads_and_ask_for_it() -> None:
    meeting = threading.Barrier(2, timeout=60.0)

    def found(number: int) -> tuple[int, set[int], str]:
        meeting.wait()
        return number, threads(), threading.current_thread().name

    out = map_in_pairs(found, range(4))
    assert [number for number, _, _ in out] == [0, 1, 2, 3]
    assert all(inside == {1} for _, inside, _ in out)
    assert len({name for _, _, name in out}) == 2
    assert map_in_pairs(lambda number: number + 1, [1]) == [2]
    with pytest.raises(ZeroDivisionError):
        map_in_pairs(lambda number: 1 / number, [1, 0])


def test_every_numerical_function_asks_for_it() -> None:
    functions = {name: f for name in gc.__all__ if inspect.isfunction(f := getattr(gc, name))}
    asking = {name for name, f in functions.items() if inspect.unwrap(f) is not f}
    assert asking == functions.keys() - NOT_NUMERICAL
    assert inspect.unwrap(gc.calibrate).__globals__["with_one_blas_thread"] is with_one_blas_thread


def test_a_command_called_by_a_program_asks_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[set[int]] = []
    monkeypatch.setattr(
        "gaitcal.cli.view_command.view_result", lambda console, result: seen.append(threads())
    )
    with threadpool_limits(limits=2, user_api="blas"):
        CliRunner().invoke(app, ["view", "."], catch_exceptions=False)
    assert seen == [{1}]


@pytest.mark.slow
@pytest.mark.parametrize("core", NEEDS)
def test_the_number_of_threads_changes_no_bit(core: str, tmp_path: Path) -> None:
    """Nor does the process: workers and this process draw the same, a part of a study and a draw
    alone, too.
    """
    flags, (needed, counts) = Path("/proc/cpuinfo"), NEEDS[core]
    if not flags.exists() or needed not in flags.read_text().split():
        pytest.skip(f"no processor with {needed}")
    command = [
        sys.executable,
        "-m",
        "tests.threads_work",
        counts,
        str(write_synthetic_study(tmp_path)),
    ]
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")} | {
        "OPENBLAS_CORETYPE": core
    }
    done = subprocess.run(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    one, more = json.loads(done.stdout).values()
    assert [name for name in one if one[name] != more[name]] == []
    for what in ("monte_carlo", "a draw"):
        here, elsewhere = (bits for name, bits in more.items() if name.startswith(f"{what}: "))
        assert here == elsewhere


PROGRAM = """
import resource, sys
import numpy as np
from gaitcal.runtime import keep_freed_memory
if sys.argv[1] == "keep":
    assert keep_freed_memory()
np.ones(100_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(200):
    np.ones(100_000)  # 800 kB, some 195 pages
print((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) // 200)
"""


def faults_per_array(how: str) -> int:
    """Pages of memory that the system hands out for each array in a process as dask starts it."""
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    command = [sys.executable, "-c", PROGRAM, how]
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return int(found.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's allocator")
def test_arrays_are_made_from_kept_memory() -> None:
    if faults_per_array("leave") < 50:
        pytest.skip("this system's allocator keeps its memory anyway")
    assert faults_per_array("keep") < 5


IGNORED = (
    "import os, signal, sys; [signal.signal(int(n), signal.SIG_IGN) for n in "
    "sys.argv[1].split(',')]; "
)
CHILD = "import signal; print([signal.getsignal(n) is signal.SIG_IGN for n in (1, 2, 15)])"


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_children_hear_what_the_tests_ignore() -> None:
    code = f"""{IGNORED}
from tests.conftest import _let_children_hear
import subprocess
ask = [sys.executable, "-c", "{CHILD}"]
subprocess.run(ask)
_let_children_hear()
os.kill(os.getpid(), signal.SIGHUP)
sys.stdout.flush()
subprocess.run(ask)
"""
    done = subprocess.run(
        [sys.executable, "-c", code, "1,2,15"],
        cwd=ROOT,
        env=dict(os.environ),
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines() == [str([True] * 3), str([False] * 3)]
