"""BLAS has one thread while something is computed, and as many as before afterwards: the same bits for everybody."""

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
from gaitcal.runtime import one_blas_thread, with_one_blas_thread
from tests.synthetic_studies import write_synthetic_study

ROOT = Path(__file__).parents[1]
NOT_NUMERICAL = {
    "parameter_table", "read_cycles", "cycles_to_xarray", "read_normal_bands", "power_of", "component_of",
    "load_model", "save_model", "load_marker_set",
}  # fmt: skip
"""Functions that find, read or write numbers, and compute none."""
NEEDS = {"Haswell": "avx2", "SkylakeX": "avx512f"}
"""OpenBLAS's kernels, and what a processor must have for each."""


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


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


def test_every_numerical_function_asks_for_it() -> None:
    functions = {name: f for name in gc.__all__ if inspect.isfunction(f := getattr(gc, name))}
    asking = {name for name, f in functions.items() if inspect.unwrap(f) is not f}
    assert asking == functions.keys() - NOT_NUMERICAL
    assert inspect.unwrap(gc.calibrate).__globals__["with_one_blas_thread"] is with_one_blas_thread


def test_a_command_called_by_a_program_asks_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[set[int]] = []
    monkeypatch.setattr("gaitcal.cli.view.view_result", lambda *_, **__: seen.append(threads()))
    with threadpool_limits(limits=2, user_api="blas"):
        CliRunner().invoke(app, ["view", "."], catch_exceptions=False)
    assert seen == [{1}]


@pytest.mark.slow
@pytest.mark.parametrize("core", NEEDS)
def test_the_number_of_threads_changes_no_bit(core: str, tmp_path: Path) -> None:
    """Nor does the process: workers and this process draw the same, a part of a study and a draw alone, too."""
    flags = Path("/proc/cpuinfo")
    if not flags.exists() or NEEDS[core] not in flags.read_text().split():
        pytest.skip(f"no processor with {NEEDS[core]}")
    study = write_synthetic_study(tmp_path)
    told = {}
    for count in (1, 2, 4):
        command = [sys.executable, "-m", "tests.threads_work", str(count), str(study)]
        environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")} | {
            "OPENBLAS_CORETYPE": core
        }
        done = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        told[count] = json.loads(done.stdout)
    different = [name for name in told[1] if len({told[count][name] for count in told}) > 1]
    assert different == []
    for what in ("monte_carlo", "a draw"):
        one, other = (bits for name, bits in told[2].items() if name.startswith(f"{what}: "))
        assert one == other
