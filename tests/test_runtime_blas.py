"""BLAS has one thread while something is fitted, and as many as before afterwards."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import gaitcal as gc
from gaitcal.motion import motion
from gaitcal.runtime import one_blas_thread, with_one_blas_thread


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


class _SeenError(Exception):
    """Enough was seen."""


def look(seen: list[set[int]]) -> None:
    seen.append(threads())
    raise _SeenError


def test_tracking_asks_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[set[int]] = []
    monkeypatch.setattr(motion, "trial_problem", lambda *_, **__: look(seen))
    recording = gc.Recording(source="nobody", time=np.arange(3.0), labels=(), markers=np.empty((3, 0, 3)))
    with threadpool_limits(limits=2, user_api="blas"), pytest.raises(_SeenError):
        gc.track(gc.published_model(), recording)
    assert seen == [{1}]


def test_calibration_asks_for_it() -> None:
    seen: list[set[int]] = []
    study = SimpleNamespace(settings=None)
    with threadpool_limits(limits=2, user_api="blas"), pytest.raises(_SeenError):
        gc.calibrate(study, lambda _: look(seen))  # type: ignore[arg-type]
    assert seen == [{1}]
