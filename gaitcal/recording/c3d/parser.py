"""One C3D file through ezc3d, in a process of its own.

A damaged file can make a parser of binary data crash, hang, or ask for all memory. Here that ends the child, and the
caller learns of it. This file is also run as a script where there is no safe `fork`: it imports nothing of gaitcal.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import pickle
import select
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import IO, Any

import numpy as np

GROUPS = ("POINT", "ANALOG", "FORCE_PLATFORM", "TRIAL", "EVENT", "PROCESSING", "SUBJECTS")
BASE_SECONDS = 6.0
"""An honest file takes 0.1 s; a user should not wait 10 s to learn that one is damaged."""
SECONDS_PER_BYTE = 1e-6
BASE_MEMORY = 2**30
MEMORY_PER_BYTE = 100
"""Bytes a child may take for each byte of the file: 16-bit samples become doubles, held some times over."""

FAULTS = (RuntimeError, ValueError, IndexError, KeyError, TypeError, OverflowError, MemoryError, OSError, SystemError)
"""What ezc3d and its wrapper raise on files that they cannot read."""

END_WITH_PARENT = 1
"""Number of Linux's `prctl`: a signal to this process when its parent ends."""

RUN_AS_SCRIPT = (
    "import sys; sys.path[:] = [folder for folder in sys.path if folder];"  # nothing from the working folder
    "import runpy; runpy.run_path(sys.argv[1], run_name='__main__')"
)


class ParserDiedError(Exception):
    """The child ended, or was ended, without an answer; the text says how."""


def parse_c3d(path: Path, size: int, *, fork: bool = sys.platform == "linux") -> dict[str, Any]:
    """Raw content: `points` (3, np, nf) with NaN for missing, `analogs` (na, ns), `parameters`, rates, first frame.

    ValueError with the parser's words where it refuses the file; ParserDiedError where it does not survive it.
    """
    seconds = BASE_SECONDS + SECONDS_PER_BYTE * size
    answer = _in_fork(path, size, seconds) if fork else _in_subprocess(path, size, seconds)
    kind, content = pickle.loads(answer)
    if kind == "fault":
        raise ValueError(content)
    return dict(content)


def _in_fork(path: Path, size: int, seconds: float) -> bytes:
    import ezc3d  # noqa: F401  loaded before the fork, so that the child need not

    reader, writer = os.pipe()
    with warnings.catch_warnings():
        # The child runs the parser and ends by _exit; it takes no lock that another thread may hold.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        try:
            os.close(reader)
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            if sys.platform == "linux":  # who waits for it may be ended by a signal that nobody can hear
                ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)
            faulthandler.disable()
            with os.fdopen(writer, "wb") as pipe:
                _serve(str(path), size, pipe)
            os._exit(0)
        finally:
            os._exit(1)
    os.close(writer)
    answer = bytearray()
    deadline = time.monotonic() + seconds
    status = None
    try:
        while True:
            ready, _, _ = select.select([reader], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                raise ParserDiedError(f"it took longer than {seconds:.0f} s")
            block = os.read(reader, 1 << 20)
            if not block:
                break
            answer += block
        _, status = os.waitpid(child, 0)
    finally:
        os.close(reader)
        if status is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code != 0:
        raise ParserDiedError(_ending(code))
    return bytes(answer)


def _in_subprocess(path: Path, size: int, seconds: float) -> bytes:
    command = [sys.executable, "-c", RUN_AS_SCRIPT, __file__, str(path), str(size)]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        raise ParserDiedError(f"it took longer than {seconds:.0f} s") from None
    if done.returncode != 0:
        raise ParserDiedError(_ending(done.returncode))
    return done.stdout


def _ending(code: int) -> str:
    return f"it ended by signal {-code}" if code < 0 else f"it ended with code {code}"


def _serve(path: str, size: int, pipe: IO[bytes]) -> None:
    """In the child: parse, and write the pickled answer; what the library prints goes nowhere."""
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    _limit_memory(BASE_MEMORY + MEMORY_PER_BYTE * size)
    try:
        answer: tuple[str, Any] = ("content", _content(path))
    except FAULTS as error:
        answer = ("fault", str(error) or type(error).__name__)
    pickle.dump(answer, pipe, protocol=5)


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
    # runpy leaves sys.argv as ["-c", this file, path, size].
    with os.fdopen(os.dup(1), "wb") as out:
        _serve(sys.argv[2], int(sys.argv[3]), out)
