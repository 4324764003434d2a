"""Where files are written: the real path of a target, and what the system says of it in one line."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gaitcal.codes import Code
from gaitcal.errors import InputError

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""No room is left, on the disk or for this user."""


def real_path(target: Path | str) -> Path:
    """Absolute, links followed: a link keeps pointing where it does, and what it points to is replaced."""
    try:
        return Path(os.path.realpath(target))
    except (OSError, ValueError) as error:
        raise InputError(f"no usable path: {error}", source=repr(str(target)), code=Code.NOT_WRITABLE) from None


@contextmanager
def disk_errors(target: Path, only: frozenset[int] | None = None) -> Iterator[None]:
    """Tell errors of the system as an InputError on `target`; `only` those of these numbers."""
    try:
        yield
    except OSError as error:
        if only is not None and error.errno not in only:
            raise
        raise InputError(f"cannot be written: {error.strerror}", source=target, code=Code.NOT_WRITABLE) from error
