"""One C3D file through ezc3d, in a process of its own.

A damaged file can make a parser of binary data crash, hang, or ask for all memory. Here that ends the process, and the
caller learns of it. One process parses all files, one after the other; a new one follows when it has died. This file is
what it runs: it imports nothing of gaitcal.
"""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

GROUPS = ("POINT", "ANALOG", "FORCE_PLATFORM", "TRIAL", "EVENT", "PROCESSING", "SUBJECTS")
START_SECONDS = 30.0
"""A process that loads its libraries on a busy machine is no fault of the file."""
BASE_SECONDS = 6.0
"""An honest file takes 0.1 s; a user should not wait 10 s to learn that one is damaged."""
SECONDS_PER_BYTE = 1e-6
BASE_MEMORY = 2**30
MEMORY_PER_BYTE = 100
"""Bytes the process may take for each byte of the file: 16-bit samples become doubles, held some times over."""

FAULTS = (RuntimeError, ValueError, IndexError, KeyError, TypeError, OverflowError, MemoryError, OSError, SystemError)
"""What ezc3d and its wrapper raise on files that they cannot read."""

RUN_AS_SCRIPT = (
    "import sys; sys.path[:] = [folder for folder in sys.path if folder];"  # nothing from the working folder
    "import runpy; runpy.run_path(sys.argv[1], run_name='__main__')"
)


class ParserDiedError(Exception):
    """The process ended, or was ended, without an answer; the text says how."""


def parse_c3d(path: Path, size: int) -> dict[str, Any]:
    """Raw content: `points` (3, np, nf) with NaN for missing, `analogs` (na, ns), `parameters`, rates, first frame.

    ValueError with the parser's words where it refuses the file; ParserDiedError where it does not survive it.
    """
    kind, content = _PARSER.answer(str(path.absolute()), size, BASE_SECONDS + SECONDS_PER_BYTE * size)
    if kind == "fault":
        raise ValueError(content)
    return dict(content)


class _Parser:
    """The process, for one thread at a time."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._one_at_a_time = threading.Lock()
        atexit.register(self.end)

    def answer(self, path: str, size: int, seconds: float) -> tuple[str, Any]:
        """`content` and a file's content, or `fault` and why there is none."""
        with self._one_at_a_time:
            try:
                if self._process is None:
                    command = [sys.executable, "-c", RUN_AS_SCRIPT, __file__]
                    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
                    self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=nowhere)
                    self._told(None, START_SECONDS)
                kind, content = self._told((path, size), seconds)
            except BaseException:  # also Ctrl-C: what it still says is no answer to the next question
                self.end()
                raise
            if kind == "fault":
                self.end()  # a parser that met a damaged file reads no other
            return kind, content

    def _told(self, question: tuple[str, int] | None, seconds: float) -> Any:
        """What the process answers; without a question, that it is ready."""
        process = self._process
        if process is None or process.stdin is None or process.stdout is None:
            raise ParserDiedError("it did not begin")
        began = time.monotonic()
        clock = threading.Timer(seconds, process.kill)
        clock.start()
        try:
            if question is not None:
                pickle.dump(question, process.stdin)
                process.stdin.flush()
            return pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            code = process.wait()
            if time.monotonic() - began >= seconds:
                raise ParserDiedError(f"it took longer than {seconds:.0f} s") from None
            how = f"it ended by signal {-code}" if code < 0 else f"it ended with code {code}"
            raise ParserDiedError(how) from None
        finally:
            clock.cancel()

    def end(self) -> None:
        """End the process, if there is one."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()


_PARSER = _Parser()
if hasattr(os, "register_at_fork"):  # a copy of this process asks a parser of its own
    os.register_at_fork(after_in_child=_PARSER.__init__)  # type: ignore[misc]

# ------------------------------------------------------------------------------------------- what the process runs


def _serve() -> None:
    """Parse one file after the other, until the caller has gone; what the library prints goes nowhere."""
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        import ezc3d  # noqa: F401  before the first file's time begins

        pickle.dump("ready", out)
        while True:
            out.flush()
            try:
                path, size = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            _limit_memory(BASE_MEMORY + MEMORY_PER_BYTE * size)
            try:
                answer: tuple[str, Any] = ("content", _content(path))
            except FAULTS as error:
                answer = ("fault", str(error) or type(error).__name__)
            pickle.dump(answer, out, protocol=5)


def _limit_memory(more: int) -> None:
    if sys.platform != "linux":
        return
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + more
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard == resource.RLIM_INFINITY or limit < hard:
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _content(path: str) -> dict[str, Any]:
    import ezc3d

    file = ezc3d.c3d(path)
    points = file["data"]["points"][:3]
    residuals = np.asarray(file["data"]["meta_points"]["residuals"])[0]
    points[:, residuals < 0] = np.nan
    parameters: dict[str, dict[str, Any]] = {}
    for group in GROUPS:
        content = file["parameters"].get(group, {})
        parameters[group] = {name: entry["value"] for name, entry in content.items() if name != "__METADATA__"}
    header = file["header"]
    return {
        "points": np.ascontiguousarray(points),
        "analogs": np.ascontiguousarray(file["data"]["analogs"][0]),
        "parameters": parameters,
        "first_frame": int(header["points"]["first_frame"]),
        "rate": float(header["points"]["frame_rate"]),
    }


if __name__ == "__main__":
    _serve()
