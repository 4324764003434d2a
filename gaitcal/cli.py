"""The command line. Thin: every command is a call of the public API and a few lines of text.

Exit codes: 0 done, 1 the input is at fault, 2 usage, 3 did not converge. Libraries are imported by the command that
needs them, so that `gaitcal --help` is there at once.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from gaitcal.errors import GaitcalError

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

Out = Annotated[Path, typer.Option("--out", help="Folder for the results; written whole or not at all.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print every step, and everything that was assumed.")]
Result = Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of 'gaitcal calibrate'.")]
StudyPath = Annotated[Path, typer.Argument(metavar="STUDY.toml", help="Study file: subject, marker set, trials.")]


@app.command()
def demo(out: Out = Path("gaitcal-demo"), quiet: Quiet = False, verbose: Verbose = False) -> None:
    """The embedded example, end to end: a synthetic subject is written as C3D files, read back and calibrated."""
    from gaitcal.commands.demo import run

    run(out, quiet=quiet, verbose=verbose)


@app.command()
def check(study: StudyPath, quiet: Quiet = False, verbose: Verbose = False) -> None:
    """Reads everything, solves nothing: what is wrong with a study's recordings, and what to do. Exit code 0 or 1."""
    from gaitcal.commands.check import run

    run(study, quiet=quiet, verbose=verbose)


@app.command()
def calibrate(
    study: StudyPath,
    out: Out,
    force: Annotated[bool, typer.Option("--force", help="Go on past errors that the checks find.")] = False,
    hold_out: Annotated[
        bool, typer.Option("--hold-out", help="Report the marker error on blocks of time left out of the fit too.")
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """The main job: joint and inertial parameters, motions and joint torques of one person."""
    from gaitcal.commands.calibrate import run

    run(study, out, force=force, hold_out=hold_out, quiet=quiet, verbose=verbose)


@app.command()
def dynamics(
    result: Result,
    trials: Annotated[list[Path], typer.Argument(metavar="TRIAL...", help="Further recordings: .c3d, .trc or .csv.")],
    forces: Annotated[Path | None, typer.Option(help="Ground reactions (.mot, .sto, .csv) of a single TRIAL.")] = None,
    plates: Annotated[
        str | None, typer.Option(help="Feet on the plates of a single TRIAL, 1=r,2=l or none; else found.")
    ] = None,
    time: Annotated[str | None, typer.Option(help="Part of a single TRIAL to use, start,end in seconds.")] = None,
    filter_hz: Annotated[
        str | None, typer.Option(help="Cut-off of the force filter in Hz, or none; else as in the calibration.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results; DIR/dynamics unless given.")] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Further trials through a calibrated model: angles, and torques with error bars."""
    from gaitcal.commands.dynamics import Options, run

    run(result, trials, Options(forces, plates, time, filter_hz), out, quiet=quiet, verbose=verbose)


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A .c3d, .trc, .mot, .sto or .csv file.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="A .csv, .trc or .mot file.")],
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Recordings to CSV tables and back: C3D, TRC and MOT to CSV, CSV to TRC."""
    from gaitcal.commands.convert import run

    run(source, target, quiet=quiet, verbose=verbose)


@app.command()
def synthesize(
    out: Out,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise and perturbation.")] = 0,
    noise: Annotated[bool, typer.Option("--noise", help="Add the published marker noise (up to 10 mm).")] = False,
    perturb: Annotated[
        bool, typer.Option("--perturb", help="Draw the true parameters at random within the published bounds.")
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """A synthetic subject with known parameters as a study folder: C3D files, study.toml, truth.csv."""
    from gaitcal.commands.synthesize import run

    run(out, seed=seed, noise=noise, perturb=perturb, quiet=quiet, verbose=verbose)


@app.command()
def montecarlo(
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
    until_converged: Annotated[
        bool, typer.Option("--until-converged", help="More draws until mean and CV stay within 2 %.")
    ] = False,
    expect: Annotated[
        float | None, typer.Option(min=0, help="Marker RMS (mm): print the torque errors to expect from it.")
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """What uncertain joint axes, masses and markers do to joint torques; goes on where an earlier run stopped."""
    from gaitcal.commands.montecarlo import Options, run

    bounds = (position_bound, orientation_bound, ip_bound, noise_bound)
    options = Options(vary, levels, draws, jobs, cluster, seed, grf, parameters, bounds, trial, until_converged)
    run(folder, options, expected_mm=expect, quiet=quiet, verbose=verbose)


@app.command()
def reproduce(
    out: Out,
    draws: Annotated[int, typer.Option(min=0, help="Monte Carlo draws (published: 5000); 0: the tables only.")] = 0,
    noise_seeds: Annotated[int, typer.Option(min=2, help="Draws of the marker noise behind medians and ranges.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise, inertial seeds and Monte Carlo draws.")] = 0,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """The published study, table by table: our figures beside the printed ones, and its claims put to the test."""
    from gaitcal.commands.reproduce import run

    run(out, draws=draws, noise_seeds=noise_seeds, seed=seed, quiet=quiet, verbose=verbose)


@app.command()
def export(
    result: Result,
    formats: Annotated[str, typer.Option("--format", help="Comma-separated: osim, urdf, mjcf.")] = "osim,urdf,mjcf",
    out: Annotated[Path | None, typer.Option(help="Folder for the files; DIR/export unless given.")] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """The fitted model for OpenSim, ROS and Pinocchio, or MuJoCo."""
    from gaitcal.commands.export import run

    run(result, formats, out, quiet=quiet, verbose=verbose)


@app.command()
def view(
    result: Result,
    html: Annotated[Path | None, typer.Option(help="Write one self-contained page instead of a live view.")] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Browser view of a result: live on this machine only, or one self-contained file."""
    from gaitcal.commands.view import run

    run(result, html, quiet=quiet, verbose=verbose)


@app.command()
def compare(
    result: Result,
    osim: Annotated[Path, typer.Option(help="An OpenSim model of the same person.")],
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Hip centres, joint axes, masses and lengths of an OpenSim model beside ours, in our segment frames."""
    from gaitcal.commands.compare import run

    run(result, osim, quiet=quiet, verbose=verbose)


def main() -> None:
    """Entry point: one clear line for every fault, and its exit code."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # small matrices: threads would only wait for each other
    verbose = any(a in ("-v", "--verbose") for a in sys.argv[1:])
    try:
        app(standalone_mode=True)
    except GaitcalError as error:
        _say_error(str(error))
        sys.exit(error.exit_code)
    except SystemExit as ending:
        if ending.code == INTERRUPTED:  # typer has turned Ctrl-C into this, without a word
            _say_error("interrupted; nothing was written")
        raise
    except KeyboardInterrupt:
        _say_error("interrupted; nothing was written")
        sys.exit(INTERRUPTED)
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
