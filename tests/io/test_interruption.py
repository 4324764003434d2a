"""SIGTERM and SIGHUP end a run as Ctrl-C does: cleaned up, once, and not in the middle of what must
not be broken.
"""

import os
import signal
import sys
import time
from pathlib import Path

import pytest

from gaitcal import cli
from gaitcal.io.atomic import InterruptedWork, Stopped, defer_signals, raise_on_signals
from gaitcal.io.result_folder import ResultKind, write_result_folder
from tests.messages import check_text

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
KINDS = {signal.SIGTERM: Stopped, signal.SIGHUP: Stopped, signal.SIGINT: KeyboardInterrupt}


@pytest.mark.parametrize("number", KINDS)
def test_a_signal_cleans_up_and_later_ones_do_not_disturb_that(number: int, tmp_path: Path) -> None:
    cleaned = []
    before = signal.getsignal(number)

    def work() -> None:
        with write_result_folder(tmp_path / "out", ResultKind.CALIBRATION) as folder:
            (folder / "half").touch()
            try:
                os.kill(os.getpid(), number)
                time.sleep(5.0)
            finally:
                os.kill(os.getpid(), signal.SIGTERM)
                cleaned.append(number)

    with pytest.raises(KINDS[signal.Signals(number)]), raise_on_signals():
        work()
    assert cleaned == [number]
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(number) == before


def test_what_must_not_be_broken_is_finished_first() -> None:
    done = []
    with pytest.raises(Stopped) as ending, raise_on_signals():
        with defer_signals():
            with defer_signals():
                os.kill(os.getpid(), signal.SIGTERM)
                done.append("inner")
            done.append("outer")
        done.append("never")
    assert done == ["inner", "outer"]
    assert (ending.value.name, ending.value.exit_code) == ("SIGTERM", 143)


@pytest.mark.parametrize("number", KINDS)
def test_a_signal_that_a_loading_library_makes_an_error_of_is_still_that_signal(
    number: int,
) -> None:
    def load() -> None:
        try:
            os.kill(os.getpid(), number)
            time.sleep(5.0)
        except BaseException as error:
            raise ImportError("initialization failed") from error

    with pytest.raises(KINDS[signal.Signals(number)]), raise_on_signals():
        load()
    with pytest.raises(ImportError, match="no such"), raise_on_signals():
        raise ImportError("no such module")


def test_nohup_is_respected() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with raise_on_signals():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(
    ("ending", "code", "told"),
    [
        (
            Stopped(signal.SIGTERM),
            143,
            "ended by SIGTERM; the output is as it was before this command",
        ),
        (Stopped(signal.SIGHUP), 129, "ended by SIGHUP; the output"),
        (
            InterruptedWork(Stopped(signal.SIGTERM), "draws are kept"),
            143,
            "ended by SIGTERM; draws are kept",
        ),
        (
            InterruptedWork(KeyboardInterrupt(), "draws are kept"),
            130,
            "interrupted; draws are kept",
        ),
    ],
)
def test_exit_codes_and_the_one_line(
    ending: BaseException,
    code: int,
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def end(console: object, result: str) -> None:
        raise ending

    monkeypatch.setattr("gaitcal.cli.view_command.view_result", end)
    monkeypatch.setattr(sys, "argv", ["gaitcal", "view", "."])
    with pytest.raises(SystemExit) as exit_:
        cli.main()
    assert exit_.value.code == code
    (line,) = capsys.readouterr().err.splitlines()
    check_text(line, told)
