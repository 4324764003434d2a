"""The command line. Thin: every command is a call of the public API and a few lines of text,
declared where it is carried out, with two options that all have and an example that ends its help.

One that does not succeed ends with a line on standard error, and an exit code: 1 the input is at
fault, 2 usage, 3 did not converge; 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP. Libraries
are imported by the command that needs them, so that `gaitcal --help` is there at once.
"""

import atexit
import gc
import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from importlib import import_module
from inspect import Signature, signature
from typing import Annotated, Any, Final

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup

from gaitcal.errors import Code, GaitcalError
from gaitcal.io.atomic import InterruptedWork, Stopped, raise_on_signals

COMMANDS: Final = {
    "demo": ("synthesize_command:demonstrate", "gaitcal demo"),
    "example": ("explain_command:fetch_or_list", "gaitcal example subject01 --out subject01"),
    "init": (
        "study_folder:draft_study_file",
        "gaitcal init recordings --mass 72.6 --height 1.80 --sex male",
    ),
    "check": ("study_folder:check_recordings", "gaitcal check study.toml"),
    "calibrate": ("calibrate_command:calibrate_study", "gaitcal calibrate study.toml --out result"),
    "cohort": ("cohort_command:run_people", "gaitcal cohort people --out results --jobs 4"),
    "dynamics": (
        "calibrate_command:analyse_further",
        "gaitcal dynamics result walk2.c3d walk3.c3d",
    ),
    "convert": ("export_commands:convert_recording", "gaitcal convert walk.c3d walk.csv"),
    "synthesize": (
        "synthesize_command:write_subject",
        "gaitcal synthesize --out person --seed 1 --noise",
    ),
    "montecarlo": (
        "montecarlo_command:run_monte_carlo",
        "gaitcal montecarlo result --vary jp,ip --levels 50,100 --draws 1000",
    ),
    "reproduce": ("montecarlo_command:run_reproduction", "gaitcal reproduce --out published"),
    "export": ("export_commands:export", "gaitcal export result --format osim,urdf"),
    "figures": (
        "figures_command:draw_figures",
        "gaitcal figures result --only knee_adduction --width 85mm",
    ),
    "view": ("view_command:view_result", "gaitcal view result"),
    "report": ("view_command:print_report", "gaitcal report result --pdf report.pdf"),
    "compare": (
        "view_command:compare_sessions_or_models",
        "gaitcal compare before after --out difference",
    ),
    "explain": ("explain_command:explain_code", "gaitcal explain GC-020"),
}
"""Command -> `module:function` in this package that declares it and carries it out; a whole line
that can be typed.
"""
HELP: Final[dict[str, str]] = dict(
    line.split(": ", 1)
    for line in """
demo: The embedded example, end to end: a synthetic subject is written as C3D files, read back and calibrated.
example: Public recordings to try: fetched by name, with checksum and licence. No other command asks the internet.
init: Drafts the study file of a folder of recordings: marker set, static trial, roles, forces, person, and why.
check: Reads everything, solves nothing: what is wrong with a study's recordings, and what to do. Exit code 0 or 1.
calibrate: The main job: joint and inertial parameters, motions and joint torques of one person.
cohort: Many people at once: each sub-folder's recordings calibrated, one table of all; goes on where it stopped.
dynamics: Further trials through a calibrated model: angles, and torques with error bars.
convert: Recordings to CSV tables and back: C3D, TRC and MOT to CSV, CSV to TRC.
synthesize: A synthetic subject with known parameters as a study folder: C3D files, study.toml, the truth.
montecarlo: What uncertain joint axes, masses and markers do to joint torques; goes on where an earlier run stopped.
reproduce: The published study, table by table: our figures beside the printed ones, and its claims put to the test.
export: The fitted model for OpenSim, ROS, MuJoCo; its joints in your own OpenSim model; recordings as C3D; strides.
figures: Figures of a result for a paper: gaitcal figures DIR --only knee_adduction --width 85mm --convention clinical
view: Page of a result, or of the comparison of two: live on this machine only, or one self-contained file.
report: A report on paper, of a result or two sessions: verdict, steps, sheets of curves, what not to trust; A4, PDF.
compare: Two sessions of one person: what differs, and whether it could be chance. Or an OpenSim model beside ours.
explain: What the code of a finding or of an error means, and what to do; without a code, a list of all.
""".strip().splitlines()
)
"""Command -> what it is for: here, so that `gaitcal --help` loads none of them."""


class _Commands(TyperGroup):
    """Loads the command that is called, and no other."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command itself in the place of its line in the help."""
        name, line, rest = super().resolve_command(ctx, args)
        return name, line and loaded(str(name)), rest


OPTIONS_OF_HELP: Final = {"help_option_names": ["-h", "--help"]}
app = typer.Typer(
    name="gaitcal",
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=OPTIONS_OF_HELP,
    help="Fits a full-body linkage model to one person's motion capture: joint axes, masses, joint "
    "torques, "
    "and how far each can be trusted.",
)


def _tell_version(asked: bool) -> None:
    if asked:
        from gaitcal.io.toml import get_package_version

        sys.stdout.write(f"gaitcal {get_package_version('gaitcal')}\n")
        raise typer.Exit


_Version = Annotated[
    bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Show the version.")
]


@app.callback()
def _without_a_command(*, version: _Version = False) -> None:
    """Options that need no command."""


RARELY = (200_000, 20, 20)
"""Allocations before a search for cycles of garbage: more than libraries make while they load,
which are no garbage.
"""


def set_up() -> None:
    """Prepare the process, before any library is loaded."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = (
            "1"  # whatever the user set, as the numbers depend on it: see gaitcal/runtime.py
        )
    gc.set_threshold(*RARELY)
    # as it ends, Python else looks twice through all that libraries made, a fifth of a second
    atexit.register(gc.freeze)


def _one_blas_thread() -> AbstractContextManager[None]:
    """For a program that calls the command line and has NumPy loaded, so that `set_up` came too
    late.
    """
    if "numpy" not in sys.modules:
        return nullcontext()
    from gaitcal.runtime import one_blas_thread

    return one_blas_thread()


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print every step, and everything that was assumed.")
]


def declared(name: str) -> Callable[..., None]:
    """The function that carries a command out, as typer takes it: with its options and two that
    every command has.
    """
    module, _, function = COMMANDS[name][0].partition(":")
    carried_out: Callable[..., None] = getattr(import_module(f"gaitcal.cli.{module}"), function)

    def run(*, quiet: Quiet = False, verbose: Verbose = False, **arguments: object) -> None:
        from gaitcal.cli.console import Console

        with _one_blas_thread():
            carried_out(Console(quiet=quiet, verbose=verbose), **arguments)

    *everywhere, _ = signature(run).parameters.values()
    _, *options = signature(carried_out, eval_str=True).parameters.values()
    options = [option.replace(kind=option.KEYWORD_ONLY) for option in options]
    run.__signature__ = Signature([*options, *everywhere])  # type: ignore[attr-defined]  # typer reads it
    return run


def loaded(name: str) -> TyperCommand:
    """A command with all of its options."""
    alone = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    register = alone.command(
        name,
        context_settings=OPTIONS_OF_HELP,
        help=HELP[name],
        epilog=f"Example: {COMMANDS[name][1]}",
    )
    register(declared(name))
    command: TyperCommand = typer.main.get_command(alone)  # type: ignore[assignment]  # there is one alone
    return command


for _name, _help in HELP.items():
    app.command(_name, help=_help)(lambda: None)
INTERRUPTED = 130  # Exit code after Ctrl-C, as shells have it


def _in_a_line(run: Callable[[], object], *, verbose: bool) -> None:
    """Call `run`; end the program with a line and an exit code where it fails. `verbose`: show
    where a bug is.
    """
    try:
        with raise_on_signals():
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


def main() -> None:
    """Entry point: one clear line for every fault, and its exit code."""
    set_up()
    _in_a_line(
        lambda: app(standalone_mode=True),
        verbose=any(a in ("-v", "--verbose") for a in sys.argv[1:]),
    )
