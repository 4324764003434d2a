"""Opening what the user names: every way in which a file cannot be read ends in one clear InputError."""

from __future__ import annotations

from pathlib import Path

from gaitcal.errors import InputError


def require_file(path: Path) -> int:
    """Size in bytes of a readable, non-empty file; InputError for anything else."""
    try:
        if path.is_dir():
            raise InputError("found a folder; a file is needed", source=path)
        size = path.stat().st_size
    except FileNotFoundError:
        raise InputError("no such file", source=path) from None
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read ({error})", source=path) from None
    if size == 0:
        raise InputError("the file is empty", source=path)
    return size


def read_lines(path: Path) -> list[str]:
    """Lines of a text file, without their ends; UTF-8 (with or without mark), else Latin-1.

    Only CR and LF end a line: `str.splitlines` would also break at separators that may stand inside a marker name.
    """
    require_file(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error})", source=path) from None
    if b"\0" in content:
        raise InputError("found binary data; a text file is needed", source=path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise InputError("the file holds only blank lines", source=path)
    return lines
