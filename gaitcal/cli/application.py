"""The program that commands register themselves with, and what each of them is handed besides its own options."""

import atexit
import gc
import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from inspect import Signature, signature

import typer

from gaitcal.cli.examples import epilog
from gaitcal.cli.options import Quiet, Verbose

app = typer.Typer(
    name="gaitcal",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Fits a full-body linkage model to one person's motion capture: joint axes, masses, joint torques, "
    "and how far each can be trusted.",
)


RARELY = (200_000, 20, 20)
"""Allocations before a search for cycles of garbage: more than libraries make while they load, which are no garbage."""


def set_up() -> None:
    """Prepare the process, before any library is loaded."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = "1"  # whatever the user set, as the numbers depend on it: see gaitcal/runtime.py
    gc.set_threshold(*RARELY)
    # as it ends, Python else looks twice through all that libraries made, a fifth of a second
    atexit.register(gc.freeze)


def _one_blas_thread() -> AbstractContextManager[None]:
    """For a program that calls the command line and has NumPy loaded, so that `set_up` came too late."""
    if "numpy" not in sys.modules:
        return nullcontext()
    from gaitcal.runtime import one_blas_thread

    return one_blas_thread()


def command(function: Callable[..., None]) -> Callable[..., None]:
    """Register a command. Its first parameter, `console`, stands for the two options that end every command's list."""

    def run(*, quiet: Quiet = False, verbose: Verbose = False, **arguments: object) -> None:
        from gaitcal.cli.console import Console

        with _one_blas_thread():
            function(Console(quiet=quiet, verbose=verbose), **arguments)

    _, *of_command = signature(function).parameters.values()
    *of_all, _ = signature(run).parameters.values()
    run.__signature__ = Signature([*of_command, *of_all])  # type: ignore[attr-defined]  # typer reads it
    app.command(function.__name__, help=function.__doc__, epilog=epilog(function.__name__))(run)
    return function
