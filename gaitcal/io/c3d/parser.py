"""One C3D file through ezc3d, in a process of its own.

A damaged file can make a parser of binary data crash, hang, or ask for all memory. Here that ends the process, and the
caller learns of it. One process parses all files, one after the other; a new one follows when it has died. This file is
what it runs: it imports nothing of gaitcal.

The parameters of a C3D file, record by record, so that a copy of the file can be given further ones.

Why not through the parser: ezc3d 1.7 writes parameters anew, and on the way drops groups without a name, changes types,
loses the camera masks of integer files, and refuses files whose labels are fewer than their points (measured on
`c3d_formats`). Here every record that is not asked to change goes out byte for byte.

Layout (C3D user guide, www.c3d.org): four bytes (the third: number of 512-byte blocks; the fourth: processor), then
records: length of the name (negative: locked), number of the group (negative: this record is the group itself), the
name, a 16-bit offset to the next record, counted from itself, and the content. Of a group: length and text of its
description. Of a parameter: type (-1 text, 1 byte, 2 integer, 4 float), number of dimensions, dimensions, data (first
dimension fastest), description. A record with a name of length 0 ends the section.
"""

from __future__ import annotations

import atexit
import os
import pickle
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.c3d.layout import BLOCK, DEC

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


MOST_BLOCKS = 255
LONGEST_LIST = 255
"""Dimensions are bytes: a longer list of text goes on in NAME2, NAME3, ..."""
LONGEST_RECORD = 32767
TEXT, INTEGER, FLOAT = -1, 2, 4
_KINDS = {1: "<i1", INTEGER: "<i2", FLOAT: "<f4"}


@dataclass(frozen=True)
class Record:
    """A group, or a parameter of one."""

    group: int
    """Number of the group, positive."""
    name: str
    content: bytes
    """What follows the offset."""
    is_group: bool = False
    locked: bool = False


@dataclass(frozen=True)
class ParameterSection:
    """All records of a file, in their order."""

    records: tuple[Record, ...]
    processor: int
    """84 Intel, 85 DEC: how the file writes floats."""

    def names(self, group: str) -> tuple[str, ...]:
        """Names of the parameters of a group; none where there is no such group."""
        number = self._number(group)
        return tuple(r.name for r in self.records if r.group == number and not r.is_group)

    def texts(self, group: str, name: str) -> list[str] | None:
        """The entries of one parameter, trailing blanks taken off; None where there is none, or it is no text."""
        kind, dims, data = self._parts(group, name)
        if kind != TEXT:
            return None
        width = dims[0] if dims else 1
        count = int(np.prod(dims[1:])) if len(dims) > 1 else 1
        return [data[i * width : (i + 1) * width].decode("latin-1").rstrip(" \0") for i in range(count)]

    def list_of(self, group: str, name: str) -> list[str]:
        """The entries of a list of text with its continuations NAME2, NAME3, ..."""
        entries: list[str] = []
        for number in range(1, 100):
            part = self.texts(group, name if number == 1 else f"{name}{number}")
            if part is None:
                break
            entries += part
        return entries

    def numbers(self, group: str, name: str) -> Array | None:
        """The numbers of one parameter, in its dimensions; None where there is none, or it is text."""
        kind, dims, data = self._parts(group, name)
        if kind not in _KINDS:
            return None
        decoded = decode_floats(data, self.processor) if kind == FLOAT else np.frombuffer(data, dtype=_KINDS[kind])
        values = decoded.astype(np.float64)
        return values.reshape(dims, order="F") if dims else values

    def with_list(self, group: str, name: str, entries: Sequence[str], rows: int = 1) -> ParameterSection:
        """A list of text instead of the one that is there, continued in NAME2, ... where it is longer than 255.

        `rows` is the second of three dimensions, of lists of pairs such as TYPE_GROUPS.
        """
        section, most = self, LONGEST_LIST * rows
        parts = [list(entries[i : i + most]) for i in range(0, len(entries), most)] or [[]]
        while self.texts(group, f"{name}{len(parts) + 1}") is not None:
            parts.append([])  # a continuation that is needed no more
        for number, part in enumerate(parts, start=1):
            words = [entry.encode("latin-1", "replace") for entry in part]
            width = min(255, max([1, *map(len, words)]))
            data = b"".join(word[:width].ljust(width) for word in words)
            dims = (width, len(words)) if rows == 1 else (width, rows, len(words) // rows)
            section = section._with(group, name if number == 1 else f"{name}{number}", TEXT, dims, data)
        return section

    def with_numbers(self, group: str, name: str, values: Array, kind: int = FLOAT) -> ParameterSection:
        """Numbers (dimensions as those of `values`) instead of those that are there."""
        flat = np.asarray(values).ravel(order="F")
        data = encode_floats(flat, self.processor) if kind == FLOAT else flat.astype(_KINDS[kind]).tobytes()
        return self._with(group, name, kind, np.asarray(values).shape, data)

    def with_group(self, group: str, description: str = "") -> ParameterSection:
        """The section with a group of that name, which may be there already."""
        if self._number(group) is not None:
            return self
        taken = {r.group for r in self.records}
        number = next(n for n in range(1, 128) if n not in taken)
        text = description.encode("latin-1", "replace")[:255]
        return self._of((*self.records, Record(number, group, bytes([len(text)]) + text, is_group=True)))

    def to_bytes(self) -> bytes:
        """The section as whole blocks; ValueError where it is too long for the format."""
        out = bytearray(4)
        for record in self.records:
            name = record.name.encode("latin-1")
            if len(record.content) + 2 > LONGEST_RECORD:
                raise ValueError(f"the parameter {record.name} is longer than {LONGEST_RECORD} bytes")
            out += struct.pack("<bb", -len(name) if record.locked else len(name), self._signed(record))
            out += name + struct.pack("<h", len(record.content) + 2) + record.content
        out += bytes(2)
        blocks = -(-len(out) // BLOCK)
        if blocks > MOST_BLOCKS:
            raise ValueError(f"its parameters need {blocks} blocks; {MOST_BLOCKS} are allowed")
        out[:4] = bytes([1, 0x50, blocks, self.processor])
        return bytes(out.ljust(blocks * BLOCK, b"\0"))

    def _of(self, records: Sequence[Record]) -> ParameterSection:
        return replace(self, records=tuple(records))

    @staticmethod
    def _signed(record: Record) -> int:
        return -record.group if record.is_group else record.group

    def _number(self, group: str) -> int | None:
        return next((r.group for r in self.records if r.is_group and r.name.upper() == group.upper()), None)

    def _parts(self, group: str, name: str) -> tuple[int | None, tuple[int, ...], bytes]:
        """Type, dimensions and data of a parameter; type None where there is none, or it is damaged."""
        number = self._number(group)
        for record in self.records:
            if record.group == number and not record.is_group and record.name.upper() == name.upper():
                kind, count = struct.unpack("<bB", record.content[:2])
                dims = tuple(record.content[2 : 2 + count])
                size = abs(kind) * int(np.prod(dims))
                data = record.content[2 + count : 2 + count + size]
                return (kind, dims, data) if len(data) == size else (None, (), b"")
        return None, (), b""

    def _with(self, group: str, name: str, kind: int, dims: Sequence[int], data: bytes) -> ParameterSection:
        """A parameter in the place of the one of that name, whose description it keeps, or as the last of its group."""
        number = self._number(group)
        if number is None:
            raise ValueError(f"no group {group}")
        start = struct.pack("<bB", kind, len(dims)) + bytes(dims) + data
        records = list(self.records)
        for i, record in enumerate(records):
            if record.group == number and not record.is_group and record.name.upper() == name.upper():
                records[i] = replace(record, content=start + _description(record.content))
                return self._of(records)
        return self._of((*records, Record(number, name, start + b"\0")))


def parse_section(section: bytes) -> ParameterSection:
    """The records of a parameter section, which begins with its four bytes; ValueError where it is damaged."""
    records: list[Record] = []
    at = 4
    while at + 1 < len(section) and section[at] != 0:
        length, group = struct.unpack("<bb", section[at : at + 2])
        name = section[at + 2 : at + 2 + abs(length)].decode("latin-1")
        at += 2 + abs(length)
        if at + 2 > len(section):
            raise ValueError("its parameters are cut short")
        (offset,) = struct.unpack("<H", section[at : at + 2])
        end = at + offset if offset else _end(section, at + 2, is_group=group < 0)
        if end > len(section) or end < at + 3:
            raise ValueError(f"the parameter {name} is damaged")
        records.append(Record(abs(group), name, section[at + 2 : end], is_group=group < 0, locked=length < 0))
        if offset == 0:
            break
        at = end
    return ParameterSection(tuple(records), section[3])


def decode_floats(data: bytes, processor: int) -> Array:
    """(n,) float32 of an Intel or a DEC file: DEC's have their halves exchanged, and an exponent greater by two."""
    if processor != DEC:
        return np.frombuffer(data, dtype="<f4")
    swapped = np.frombuffer(data, dtype="<u2").reshape(-1, 2)[:, ::-1]
    return np.frombuffer(swapped.tobytes(), dtype="<f4") * np.float32(0.25)


def encode_floats(values: Array, processor: int) -> bytes:
    """Float32 numbers as an Intel or a DEC file holds them."""
    single = np.ascontiguousarray(values, dtype="<f4")
    if processor != DEC:
        return single.tobytes()
    halves = np.frombuffer((single * np.float32(4.0)).tobytes(), dtype="<u2").reshape(-1, 2)
    return halves[:, ::-1].tobytes()


def _end(section: bytes, at: int, *, is_group: bool) -> int:
    """Where the content of the last record ends: some programs write its offset as 0."""
    if not is_group:
        kind, count = struct.unpack("<bB", section[at : at + 2])
        at += 2 + count + abs(kind) * int(np.prod(tuple(section[at + 2 : at + 2 + count])))
    return at + 1 + section[at]


def _description(content: bytes) -> bytes:
    """Length and text of a parameter's description; an empty one where it is missing."""
    kind, count = struct.unpack("<bB", content[:2])
    rest = content[2 + count + abs(kind) * int(np.prod(tuple(content[2 : 2 + count]))) :]
    return rest or b"\0"
