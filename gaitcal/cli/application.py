"""The program that commands register with: two common options, the example that ends their help, and how
one ends that does not succeed: a line on standard error, and the exit code.
"""

import atexit
import gc
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from importlib import import_module
from inspect import Signature, signature
from typing import Annotated, Final

import typer

from gaitcal.cli.options import Quiet, Verbose
from gaitcal.codes import Code
from gaitcal.errors import GaitcalError
from gaitcal.io.atomic import InterruptedWork, Stopped, ended_by_signals

EXAMPLES: Final[Mapping[str, str]] = {
    "demo": "gaitcal demo",
    "example": "gaitcal example subject01 --out subject01",
    "init": "gaitcal init recordings --mass 72.6 --height 1.80 --sex male",
    "check": "gaitcal check study.toml",
    "calibrate": "gaitcal calibrate study.toml --out result",
    "cohort": "gaitcal cohort people --out results --jobs 4",
    "dynamics": "gaitcal dynamics result walk2.c3d walk3.c3d",
    "convert": "gaitcal convert walk.c3d walk.csv",
    "synthesize": "gaitcal synthesize --out person --seed 1 --noise",
    "montecarlo": "gaitcal montecarlo result --vary jp,ip --levels 50,100 --draws 1000",
    "reproduce": "gaitcal reproduce --out published",
    "export": "gaitcal export result --format osim,urdf",
    "figures": "gaitcal figures result --only knee_adduction --width 85mm",
    "view": "gaitcal view result",
    "report": "gaitcal report result --pdf report.pdf",
    "compare": "gaitcal compare before after --out difference",
    "explain": "gaitcal explain GC-020",
}
"""Command -> a whole line that can be typed."""


def epilog(name: str) -> str | None:
    """What ends the help of a command; None for one without an example."""
    return f"Example: {EXAMPLES[name]}" if name in EXAMPLES else None


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


def _tell_version(asked: bool) -> None:
    if asked:
        from gaitcal.io.toml import package_version

        sys.stdout.write(f"gaitcal {package_version('gaitcal')}\n")
        raise typer.Exit


_Version = Annotated[bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Show the version.")]


@app.callback()
def _without_a_command(*, version: _Version = False) -> None:
    """Options that need no command."""


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


def command(target: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a command: the function says its options and its help, with two options more for every command.

    `target`: `module:function` in this package, imported when the command runs, which takes a `Console` and all that
    the command takes, by name (`tests/test_cli.py`).
    """

    def register(declared: Callable[..., None]) -> Callable[..., None]:
        def run(*, quiet: Quiet = False, verbose: Verbose = False, **arguments: object) -> None:
            from gaitcal.cli.console import Console

            with _one_blas_thread():
                module, _, name = target.partition(":")
                call = getattr(import_module(f"gaitcal.cli.{module}"), name)
                call(Console(quiet=quiet, verbose=verbose), **arguments)

        *of_all, _ = signature(run).parameters.values()
        own = signature(declared).parameters.values()
        run.__signature__ = Signature([*own, *of_all])  # type: ignore[attr-defined]  # typer reads it
        app.command(declared.__name__, help=declared.__doc__, epilog=epilog(declared.__name__))(run)
        TARGETS[declared.__name__] = target
        return declared

    return register


TARGETS: Final[dict[str, str]] = {}
"""Command -> where it is carried out."""
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
