"""What the command line says of a fault, in one line, and its exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from gaitcal.errors import GaitcalError
from gaitcal.files.interruption import InterruptedWork, Stopped

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


@contextmanager
def faults_told(*, verbose: bool) -> Iterator[None]:
    """End the process with one clear line and its exit code for every fault inside.

    `verbose`: where gaitcal itself is at fault, show where.
    """
    try:
        yield
    except GaitcalError as error:
        _say_error(str(error))
        sys.exit(error.exit_code)
    except InterruptedWork as ending:
        _say_error(str(ending))
        sys.exit(ending.exit_code)
    except SystemExit as ending:
        if ending.code == INTERRUPTED:  # typer has turned Ctrl-C into this, without a word
            _say_error("interrupted; nothing was written")
        raise
    except KeyboardInterrupt:
        _say_error("interrupted; nothing was written")
        sys.exit(INTERRUPTED)
    except Stopped as ending:
        _say_error(f"ended by {ending.name}; what was being written is as it was before")
        sys.exit(ending.exit_code)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        if verbose:
            raise
        _say_error(f"internal error, please report it (-v shows where): {type(error).__name__}: {error}")
        sys.exit(1)


def _say_error(text: str) -> None:
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    sys.stderr.write(f"gaitcal: {line}\n")
