"""The command line. Thin: every command is a call of the public API and a few lines of text.

Exit codes: 0 done, 1 the input is at fault, 2 usage, 3 did not converge; 130 after Ctrl-C, 143 after SIGTERM, 129 after
SIGHUP. Libraries are imported by the command that needs them, so that `gaitcal --help` is there at once.
"""

import os
import sys
from collections.abc import Callable
from inspect import Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gaitcal.commands import options as told
from gaitcal.commands.options import Age, Height, Mass, Normal, Out, Quiet, Result, Sex, StudyPath, Verbose
from gaitcal.errors import GaitcalError
from gaitcal.files.interruption import InterruptedWork, Stopped, ended_by_signals

if TYPE_CHECKING:
    from gaitcal.commands.console import Talk

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

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


def command(function: Callable[..., None]) -> Callable[..., None]:
    """Register a command. Its first parameter, `talk`, stands for the two options that end every command's list."""

    def run(*, quiet: Quiet = False, verbose: Verbose = False, **arguments: object) -> None:
        from gaitcal.commands.console import Talk

        function(Talk(quiet=quiet, verbose=verbose), **arguments)

    _, *of_command = signature(function).parameters.values()
    *of_all, _ = signature(run).parameters.values()
    run.__signature__ = Signature([*of_command, *of_all])  # type: ignore[attr-defined]  # typer reads it
    app.command(function.__name__, help=function.__doc__)(run)
    return function


@command
def demo(talk: "Talk", out: Out = Path("gaitcal-demo")) -> None:
    """The embedded example, end to end: a synthetic subject is written as C3D files, read back and calibrated."""
    from gaitcal.commands.synthetic import demonstrate

    demonstrate(out, talk)


@command
def init(
    talk: "Talk",
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of one person's recordings.")],
    out: Annotated[Path | None, typer.Option(help="The study file; FOLDER/study.toml unless given.")] = None,
    mass: Mass = None,
    height: Height = None,
    sex: Sex = None,
    age: Age = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a study file that is there.")] = False,
) -> None:
    """Drafts the study file of a folder of recordings: marker set, static trial, roles, forces, person, and why."""
    from gaitcal.commands.init import options_of, run

    run(folder, out, talk, options_of(mass, height, sex, age), force=force)


@command
def check(
    talk: "Talk", study: StudyPath, mass: Mass = None, height: Height = None, sex: Sex = None, age: Age = None
) -> None:
    """Reads everything, solves nothing: what is wrong with a study's recordings, and what to do. Exit code 0 or 1."""
    from gaitcal.commands.check import run
    from gaitcal.commands.init import options_of

    run(study, talk, options_of(mass, height, sex, age))


@command
def calibrate(
    talk: "Talk",
    study: StudyPath,
    out: Out,
    mass: Mass = None,
    height: Height = None,
    sex: Sex = None,
    age: Age = None,
    force: Annotated[bool, typer.Option("--force", help="Go on past errors that the checks find.")] = False,
    hold_out: told.HoldOut = False,
    normal: Normal = None,
) -> None:
    """The main job: joint and inertial parameters, motions and joint torques of one person."""
    from gaitcal.commands.calibrate import run
    from gaitcal.commands.init import options_of

    run(study, out, talk, options_of(mass, height, sex, age), force=force, hold_out=hold_out, normal=normal)


@command
def dynamics(
    talk: "Talk",
    result: Result,
    trials: Annotated[list[Path], typer.Argument(metavar="TRIAL...", help="Further recordings: .c3d, .trc or .csv.")],
    forces: Annotated[Path | None, typer.Option(help="Ground reactions (.mot, .sto, .csv) of a single TRIAL.")] = None,
    plates: told.Plates = None,
    time: Annotated[str | None, typer.Option(help="Part of a single TRIAL to use, start,end in seconds.")] = None,
    filter_hz: told.FilterHz = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results; DIR/dynamics unless given.")] = None,
) -> None:
    """Further trials through a calibrated model: angles, and torques with error bars."""
    from gaitcal.commands.dynamics import Options, run

    run(result, trials, Options(forces, plates, time, filter_hz), out, talk)


@command
def convert(
    talk: "Talk",
    source: Annotated[Path, typer.Argument(metavar="IN", help="A .c3d, .trc, .mot, .sto or .csv file.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="A .csv, .trc or .mot file.")],
) -> None:
    """Recordings to CSV tables and back: C3D, TRC and MOT to CSV, CSV to TRC."""
    from gaitcal.commands.other_programs import convert_recording

    convert_recording(source, target, talk)


@command
def synthesize(
    talk: "Talk",
    out: Out,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise and perturbation.")] = 0,
    noise: Annotated[bool, typer.Option("--noise", help="Add the published marker noise (up to 10 mm).")] = False,
    perturb: told.Perturb = False,
) -> None:
    """A synthetic subject with known parameters as a study folder: C3D files, study.toml, the truth."""
    from gaitcal.commands.synthetic import write_subject

    write_subject(out, talk, seed=seed, noise=noise, perturb=perturb)


@command
def montecarlo(
    talk: "Talk",
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Result folder of 'gaitcal calibrate', or a study folder.")
    ],
    vary: Annotated[str, typer.Option(help="Comma-separated: jp, ip, both, noise.")] = "jp,ip,both,noise",
    levels: Annotated[str, typer.Option(help="Comma-separated per cents of the bounds.")] = "25,50,75,100",
    draws: Annotated[int, typer.Option(min=1, help="Draws of each set at each level.")] = 5000,
    jobs: Annotated[int, typer.Option(help="Processes; -1: one for every core.")] = -1,
    cluster: Annotated[str | None, typer.Option(help="A running dask scheduler, tcp://host:port, instead.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all draws.")] = 0,
    grf: Annotated[str, typer.Option(help="Ground reactions fixed in the laboratory (lab) or on the foot.")] = "lab",
    parameters: Annotated[str, typer.Option(help="Joint parameters: 27 or 17 of each leg, or all 98.")] = "27",
    position_bound: Annotated[float, typer.Option(min=0, help="Bound of joint positions, mm.")] = 10.0,
    orientation_bound: Annotated[float, typer.Option(min=0, max=45, help="Bound of joint orientations, deg.")] = 10.0,
    ip_bound: Annotated[float, typer.Option(min=0, max=90, help="Bound of inertial parameters, %.")] = 10.0,
    noise_bound: Annotated[float, typer.Option(min=0, help="Largest amplitude of marker noise, mm.")] = 10.0,
    trial: Annotated[str | None, typer.Option(help="Gait trial; the first with ground reactions unless given.")] = None,
    until_converged: told.UntilConverged = False,
    expect: told.Expect = None,
) -> None:
    """What uncertain joint axes, masses and markers do to joint torques; goes on where an earlier run stopped."""
    from gaitcal.commands.montecarlo import Options, run

    bounds = (position_bound, orientation_bound, ip_bound, noise_bound)
    options = Options(
        vary=vary,
        levels=levels,
        draws=draws,
        jobs=jobs,
        cluster=cluster,
        seed=seed,
        grf=grf,
        parameters=parameters,
        bounds=bounds,
        trial=trial,
        until_converged=until_converged,
    )
    run(folder, options, expect, talk)


@command
def reproduce(
    talk: "Talk",
    out: Out,
    draws: Annotated[int, typer.Option(min=0, help="Monte Carlo draws (published: 5000); 0: the tables only.")] = 0,
    noise_seeds: Annotated[int, typer.Option(min=2, help="Draws of the marker noise behind medians and ranges.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise, inertial seeds and Monte Carlo draws.")] = 0,
    sensitivities: Annotated[
        bool, typer.Option(help="What the paper does not say: trial length, end of re-fits, centre of pressure.")
    ] = True,
) -> None:
    """The published study, table by table: our figures beside the printed ones, and its claims put to the test."""
    from gaitcal.commands.reproduce import run

    run(out, talk, draws=draws, noise_seeds=noise_seeds, seed=seed, sensitivities=sensitivities)


@command
def export(
    talk: "Talk",
    result: Result,
    formats: told.Formats = "osim,urdf,mjcf",
    out: told.ExportFolder = None,
    inputs: told.Inputs = None,
    convention: told.Signs = None,
    moments: told.Moments = None,
    external: told.External = False,
    units: told.Units = None,
) -> None:
    """The fitted model for OpenSim, ROS, MuJoCo; recordings as C3D; strides in a convention of your choice."""
    from gaitcal.commands.other_programs import convention_of, export_model

    export_model(result, formats, out, inputs, talk, convention_of(convention, moments, units, external=external))


@command
def view(
    talk: "Talk",
    result: Result,
    html: Annotated[Path | None, typer.Option(help="Write one self-contained page instead of a live view.")] = None,
    geometry: told.Geometry = None,
) -> None:
    """Browser view of a result: live on this machine only, or one self-contained file."""
    from gaitcal.commands.view import run

    run(result, html, talk, geometry)


@command
def compare(
    talk: "Talk",
    result: Result,
    other: told.OtherResult = None,
    osim: Annotated[Path | None, typer.Option(help="An OpenSim model of the same person, instead of OTHER.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the tables; nothing is written unless given.")] = None,
    shared_model: told.SharedModel = False,
    study: told.Studies = None,
) -> None:
    """Two sessions of one person: what differs, and whether it could be chance. Or an OpenSim model beside ours."""
    from gaitcal.commands.compare import Options, run

    run(result, other, Options(osim=osim, out=out, shared_model=shared_model, studies=study or ()), talk)


def main() -> None:
    """Entry point: one clear line for every fault, and its exit code."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # small matrices: threads would only wait for each other
    verbose = any(a in ("-v", "--verbose") for a in sys.argv[1:])
    try:
        with ended_by_signals():
            app(standalone_mode=True)
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


if __name__ == "__main__":
    main()
