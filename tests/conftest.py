"""Fixtures for every test."""

from __future__ import annotations

import json
import logging
import os
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits

from tests.kept import run_folder

pytest_plugins = ["tests.messages"]

if TYPE_CHECKING:
    from gaitcal import Calibration
    from gaitcal.study.study import Study

# A busy machine may take ten times as long for one example: time is judged by the benchmarks, not
# here.
settings.register_profile(
    "patient", deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("few", settings.get_profile("patient"), max_examples=10)
settings.load_profile("patient")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Processes of `-n` take files in the order below, not those of fewest tests last; children
    hear signals.
    """
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False
    _let_children_hear()


def _let_children_hear() -> None:
    """Programs that tests start have the usual dispositions of signals, however the tests
    themselves were started.

    `nohup`, cron, a CI system, and a shell for what it runs in the background let Ctrl-C or SIGHUP
    be ignored, which is inherited. A handler is not: here SIGHUP and SIGTERM stay without effect,
    in a new program they end it.
    """
    for name in ("SIGINT", "SIGHUP", "SIGTERM"):
        number = getattr(signal, name, None)  # not every system has SIGHUP
        if number is not None and signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(
                number, signal.default_int_handler if name == "SIGINT" else lambda *_: None
            )


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--skipped-in",
        metavar="CHECKOUT",
        help="only the tests that the last run in CHECKOUT skipped",
    )
    parser.addoption(
        "--cases",
        metavar="N",
        type=int,
        help="only the first N cases of a test, but of tests/io: there each is a kind of file",
    )


_skipped: set[str] = set()
"""Tests of this run that were, and files that could not be read for want of an extra."""


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note what was skipped."""
    if report.skipped and not hasattr(report, "wasxfail"):
        _skipped.add(report.nodeid)


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Note files that were skipped."""
    if report.skipped:
        _skipped.add(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep it for `--skipped-in`."""
    if (
        not hasattr(session.config, "workerinput")
        and getattr(session.config, "cache", None) is not None
    ):
        session.config.cache.set("gaitcal/skipped", sorted(_skipped))


def pytest_itemcollected(item: pytest.Item) -> None:
    """A test that asks for another program needs the extra `peers`: nobody has to remember to mark
    it.
    """
    if not {"osim", "mujoco"}.isdisjoint(getattr(item, "fixturenames", ())):
        item.add_marker(pytest.mark.peers)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Those that another run skipped, or the first cases of each test, where they are asked for.

    Among several processes, files with slow tests come first, so that none is left to one process
    at the end.

    Of the others, those with many tests come first.
    """
    if checkout := config.getoption("--skipped-in"):
        wanted = set(
            json.loads(
                (Path(checkout) / ".pytest_cache/v/gaitcal/skipped").read_text(encoding="utf-8")
            )
        )
        _leave_out(
            config, items, lambda item: not wanted & {item.nodeid, item.nodeid.partition("::")[0]}
        )
    if most := config.getoption("--cases"):
        cases = Counter[str]()

        def is_further_case(item: pytest.Item) -> bool:
            name = item.nodeid.partition("[")[0]
            cases[name] += 1
            return cases[name] > most and not name.startswith("tests/io/")

        _leave_out(config, items, is_further_case)
    if not hasattr(config, "workerinput"):
        return
    slow, count = Counter[Path](), Counter[Path]()
    for item in items:
        slow[item.path] += item.get_closest_marker("slow") is not None
        count[item.path] += 1
    items.sort(key=lambda item: (-slow[item.path], -count[item.path], item.path))


def _leave_out(
    config: pytest.Config, items: list[pytest.Item], unwanted: Callable[[pytest.Item], bool]
) -> None:
    """Deselect some tests."""
    left = {item for item in items if unwanted(item)}
    config.hook.pytest_deselected(items=list(left))
    items[:] = [item for item in items if item not in left]


@pytest.fixture(autouse=True, scope="session")
def _one_blas_thread() -> Iterator[None]:
    """What lies below the functions of `import gaitcal` is called here by itself, and runs as they
    run it.

    That they and programs ask for it themselves is shown in `test_runtime.py`, where the user
    allows more.
    """
    import scipy.linalg  # noqa: F401  # brings a BLAS of its own

    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(autouse=True)
def _nobody_is_quiet() -> None:
    """A command that was asked to be quiet in this process, in an earlier test or a fixture, quiets
    no test.
    """
    logging.getLogger("gaitcal").setLevel(logging.NOTSET)


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for what test files share in this run (`tests/kept.py`)."""
    return run_folder(tmp_path_factory)


@pytest.fixture(scope="session")
def whole() -> Calibration:
    """A whole calibration, made of plain numbers (`tests/fake_result.py`); nobody changes it."""
    from tests.fake_result import fake_calibration

    return fake_calibration()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real recordings that GAITCAL_DATA names. Without it tests skip; in CI they
    fail.
    """
    named = os.environ.get("GAITCAL_DATA")
    if named and Path(named).is_dir():
        return Path(named)
    reason = f"GAITCAL_DATA is {named!r}, no folder" if named else "GAITCAL_DATA is not set"
    if os.environ.get("CI"):
        pytest.fail(f"{reason}; with CI set the real recordings must be there", pytrace=False)
    pytest.skip(f"{reason}: no real recordings to test with")


@pytest.fixture(scope="session")
def real_study(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Study]:
    """The study of one of `tests.real_studies.REAL`; read once, as nobody changes it."""
    from tests.real_studies import load_study

    return cache(lambda name: load_study(name, data_dir.resolve(), tmp_path_factory.mktemp(name)))
