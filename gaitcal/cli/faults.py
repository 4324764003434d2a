"""How a command ends that does not succeed: one line on standard error, and the exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from gaitcal.codes import Code
from gaitcal.errors import GaitcalError
from gaitcal.io.atomic import InterruptedWork, Stopped, ended_by_signals

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


def told_in_a_line(run: Callable[[], object], *, verbose: bool) -> None:
    """Call `run`; end the program with a line and an exit code where it fails. `verbose`: show where a bug is."""
    try:
        with ended_by_signals():
            run()
    except GaitcalError as error:
        _say_error(f"{error} [{error.code.value}]")
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
        said = f"internal error, please report it (-v shows where): {type(error).__name__}: {error}"
        _say_error(f"{said} [{Code.INTERNAL.value}]")
        sys.exit(1)


def _say_error(text: str) -> None:
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    sys.stderr.write(f"gaitcal: {line}\n")
