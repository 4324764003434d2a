"""The command line: table of commands, help texts, exit codes.

Each command is a function of a module of this package, which is imported when the command runs, so
that `gaitcal --help` is quick. The function calls the public API and prints some lines.

A command that fails prints one line on standard error. Exit codes: 1 invalid input, 2 wrong usage,
3 a fit did not converge, 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP.
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
    "demo": ("synthesize_command:run_demonstration", "gaitcal demo"),
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
"""Command -> `module:function` of this package, and an example that can be typed as it is."""
HELP: Final = {
    "demo": "Calibrate an embedded example, end to end. A synthetic subject is written as C3D "
    "files, read back and calibrated.",
    "example": "Fetch public recordings to try gaitcal with. Files are verified by checksum; the "
    "licence is printed. No other command uses the internet.",
    "init": "Draft the study file of a folder of recordings. It lists the marker set, static "
    "trial, trial roles, forces and subject, each with its evidence.",
    "check": "Check the recordings of a study; compute nothing. Prints each finding with its "
    "remedy. Exit code 1 if there is an error.",
    "calibrate": "Calibrate one person's model from recordings. Fits joint and inertial "
    "parameters, and computes motions and joint torques with standard errors.",
    "cohort": "Calibrate many people, one sub-folder each. Writes one table of all; continues "
    "after an interruption.",
    "dynamics": "Analyse further trials with a calibrated model. Writes angles, and torques with "
    "standard errors.",
    "convert": "Convert recordings to CSV tables and back. C3D, TRC and MOT to CSV; CSV to TRC.",
    "synthesize": "Write a synthetic subject with known parameters. The folder has C3D files, "
    "study.toml and the true values.",
    "montecarlo": "Vary joints, masses and markers at random. Shows the effect on joint torques; "
    "continues after an interruption.",
    "reproduce": "Repeat the published study of 2007, table by table. Compares our numbers with "
    "the printed ones, and tests its claims.",
    "export": "Export a model, recordings or strides. The model for OpenSim, ROS and MuJoCo, or "
    "its joints in your OpenSim model; recordings as C3D; strides as CSV.",
    "figures": "Draw figures of a result for a paper. One file for each variable, in the width, "
    "signs and units of your choice.",
    "view": "Show the page of a result or of a comparison. In the browser of this machine, or "
    "written to one self-contained file.",
    "report": "Write a PDF report of one result or two. It has the verdict, spatiotemporal "
    "parameters, curves and the limits of the result, on A4.",
    "compare": "Compare two sessions of one person. Reports which differences exceed chance. Or "
    "compares the model with an OpenSim model.",
    "explain": "Explain the code of a finding or an error. Without a code, list all codes.",
}
"""Command -> help text: here, so that `gaitcal --help` imports no command.

`gaitcal --help` prints the first sentence only: at most 62 characters.
"""


class _Commands(TyperGroup):
    """Group that imports a command only when it is called."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Replace the placeholder of the help list by the command with its options."""
        name, placeholder, remaining = super().resolve_command(ctx, args)
        return name, placeholder and load_command(str(name)), remaining


HELP_OPTIONS: Final = {"help_option_names": ["-h", "--help"]}
app = typer.Typer(
    name="gaitcal",
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=HELP_OPTIONS,
    help="Fit a full-body linkage model to the motion capture of one person. Results are joint "
    "axes, masses and joint torques, each with a standard error.",
)


def _print_version(requested: bool) -> None:
    """Print the version and exit, if requested."""
    if requested:
        from gaitcal.io.toml import get_package_version

        sys.stdout.write(f"gaitcal {get_package_version('gaitcal')}\n")
        raise typer.Exit


_Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
]


@app.callback()
def _accept_global_options(*, version: _Version = False) -> None:
    """Accept options without a command."""


GARBAGE_THRESHOLDS: Final = (200_000, 20, 20)
"""Thresholds of `gc.set_threshold`: allocations, and collections of the two younger generations.

Above the number of objects that libraries allocate on import, which are never garbage.
"""


def _set_up_process() -> None:
    """Set thread counts and garbage collection; call it before any library is imported."""
    # Results depend on the number of BLAS threads (gaitcal/runtime.py), so the user's value is
    # replaced.
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = "1"
    gc.set_threshold(*GARBAGE_THRESHOLDS)
    # Without this, Python collects all objects of the libraries twice on exit (0.2 s).
    atexit.register(gc.freeze)


def _limit_blas_threads() -> AbstractContextManager[None]:
    """Limit BLAS to one thread if NumPy was imported before `_set_up_process` could do so.

    This is the case if a Python program calls the command line.
    """
    if "numpy" not in sys.modules:
        return nullcontext()
    from gaitcal.runtime import one_blas_thread

    return one_blas_thread()


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print every step and every assumption.")
]


def build_command_function(name: str) -> Callable[..., None]:
    """Import a command and add the options that every command has.

    `name`: command, a key of `COMMANDS`. Returns: function with the signature that typer reads: the
    options of the command, `--quiet` and `--verbose`.
    """
    module, _, function_name = COMMANDS[name][0].partition(":")
    function: Callable[..., None] = getattr(import_module(f"gaitcal.cli.{module}"), function_name)

    def run(*, quiet: Quiet = False, verbose: Verbose = False, **arguments: object) -> None:
        from gaitcal.cli.console import Console

        with _limit_blas_threads():
            function(Console(quiet=quiet, verbose=verbose), **arguments)

    *common_options, _ = signature(run).parameters.values()
    _, *options = signature(function, eval_str=True).parameters.values()
    options = [option.replace(kind=option.KEYWORD_ONLY) for option in options]
    run.__signature__ = Signature([*options, *common_options])  # type: ignore[attr-defined]  # typer reads it
    return run


def load_command(name: str) -> TyperCommand:
    """Build a command with its options, help text and example.

    `name`: command, a key of `COMMANDS`.
    """
    single = typer.Typer(
        add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False
    )
    register = single.command(
        name, context_settings=HELP_OPTIONS, help=HELP[name], epilog=f"Example: {COMMANDS[name][1]}"
    )
    register(build_command_function(name))
    command: TyperCommand = typer.main.get_command(single)  # type: ignore[assignment]  # one command
    return command


for _name, _help in HELP.items():
    app.command(_name, help=_help)(lambda: None)
INTERRUPTED: Final = 130
"""Exit code after Ctrl-C, as in shells."""


def _run_and_report_errors(run: Callable[[], object], *, verbose: bool) -> None:
    """Call `run`; if it fails, print one line and exit with the code of the failure.

    `run`: the command line. `verbose`: raise unexpected errors with their traceback.
    """
    try:
        with raise_on_signals():
            run()
    except GaitcalError as error:
        _print_error(f"{error} [{error.code.value}]")
        sys.exit(error.exit_code)
    except InterruptedWork as ending:
        _print_error(str(ending))
        sys.exit(ending.exit_code)
    except SystemExit as ending:
        # Typer converts Ctrl-C to this exit code and prints nothing.
        if ending.code == INTERRUPTED:
            _print_error("interrupted; nothing was written")
        raise
    except KeyboardInterrupt:
        _print_error("interrupted; nothing was written")
        sys.exit(INTERRUPTED)
    except Stopped as ending:
        _print_error(f"ended by {ending.name}; the output is as it was before this command")
        sys.exit(ending.exit_code)
    except BrokenPipeError:
        # `gaitcal ... | head`: the reader has ended, and closing the output would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        if verbose:
            raise
        message = f"{type(error).__name__}: {error} [{Code.INTERNAL.value}]"
        _print_error(f"internal error, please report it (-v shows where): {message}")
        sys.exit(1)


def _print_error(text: str) -> None:
    """Print an error as one line, without control characters."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    sys.stderr.write(f"gaitcal: {line}\n")


def main() -> None:
    """Run the command line: entry point of `gaitcal`."""
    _set_up_process()
    _run_and_report_errors(
        lambda: app(standalone_mode=True),
        verbose=any(a in ("-v", "--verbose") for a in sys.argv[1:]),
    )
