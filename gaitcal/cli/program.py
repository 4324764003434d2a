"""The command line. Thin: every command is a call of the public API and a few lines of text.

Exit codes: 0 done, 1 the input is at fault, 2 usage, 3 did not converge; 130 after Ctrl-C, 143 after SIGTERM, 129 after
SIGHUP. Libraries are imported by the command that needs them, so that `gaitcal --help` is there at once.
"""

import sys
from pathlib import Path
from typing import Annotated

import typer

from gaitcal.cli import options as told
from gaitcal.cli.application import app, command, set_up, told_in_a_line
from gaitcal.cli.options import Age, Height, Mass, Normal, Out, Result, Sex, StudyPath


@command("calibrate:demonstrate")
def demo(out: Out = Path("gaitcal-demo")) -> None:
    """The embedded example, end to end: a synthetic subject is written as C3D files, read back and calibrated."""


@command("explain:fetch_or_list")
def example(name: told.ExampleName = None, out: told.ExampleOut = None, mirror: told.Mirror = None) -> None:
    """Public recordings to try: fetched by name, with checksum and licence. No other command asks the internet."""


@command("folder:draft_study_file")
def init(
    folder: told.Recordings,
    out: told.StudyOut = None,
    mass: Mass = None,
    height: Height = None,
    sex: Sex = None,
    age: Age = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a study file that is there.")] = False,
) -> None:
    """Drafts the study file of a folder of recordings: marker set, static trial, roles, forces, person, and why."""


@command("folder:check_recordings")
def check(study: StudyPath, mass: Mass = None, height: Height = None, sex: Sex = None, age: Age = None) -> None:
    """Reads everything, solves nothing: what is wrong with a study's recordings, and what to do. Exit code 0 or 1."""


@command("calibrate:calibrate_study")
def calibrate(
    study: StudyPath,
    out: Out,
    mass: Mass = None,
    height: Height = None,
    sex: Sex = None,
    age: Age = None,
    force: Annotated[bool, typer.Option("--force", help="Go on past errors that the checks find.")] = False,
    hold_out: told.HoldOut = False,
    normal: Normal = None,
    priors: told.Priors = None,
) -> None:
    """The main job: joint and inertial parameters, motions and joint torques of one person."""


@command("cohort:run_people")
def cohort(
    source: told.People,
    out: told.CohortOut,
    jobs: told.Jobs = -1,
    cluster: told.Scheduler = None,
    retry: told.Retry = False,
    mass: Mass = None,
    height: Height = None,
    sex: Sex = None,
    age: Age = None,
    normal: Normal = None,
    priors: told.Priors = None,
    learn_priors: told.LearnPriors = False,
) -> None:
    """Many people at once: each sub-folder's recordings calibrated, one table of all; goes on where it stopped."""


@command("calibrate:analyse_further")
def dynamics(
    result: Result,
    trials: Annotated[list[Path], typer.Argument(metavar="TRIAL...", help="Further recordings: .c3d, .trc or .csv.")],
    forces: told.Forces = None,
    plates: told.Plates = None,
    time: told.Part = None,
    filter_hz: told.FilterHz = None,
    role: told.TrialRole = "gait",
    out: told.DynamicsOut = None,
) -> None:
    """Further trials through a calibrated model: angles, and torques with error bars."""


@command("other_programs:convert_recording")
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A .c3d, .trc, .mot, .sto or .csv file.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="A .csv, .trc or .mot file.")],
) -> None:
    """Recordings to CSV tables and back: C3D, TRC and MOT to CSV, CSV to TRC."""


@command("calibrate:write_subject")
def synthesize(
    out: Out,
    seed: told.Seed = 0,
    noise: told.Noise = False,
    perturb: told.Perturb = False,
    movement: told.Movements = None,
) -> None:
    """A synthetic subject with known parameters as a study folder: C3D files, study.toml, the truth."""


@command("montecarlo:run_monte_carlo")
def montecarlo(
    folder: told.ResultOrStudy,
    vary: Annotated[str, typer.Option(help="Comma-separated: jp, ip, both, noise.")] = "jp,ip,both,noise",
    levels: Annotated[str, typer.Option(help="Comma-separated per cents of the bounds.")] = "25,50,75,100",
    draws: Annotated[int, typer.Option(min=1, help="Draws of each set at each level.")] = 5000,
    jobs: told.Jobs = -1,
    cluster: told.Scheduler = None,
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


@command("montecarlo:run_reproduction")
def reproduce(
    out: Out,
    draws: Annotated[int, typer.Option(min=0, help="Monte Carlo draws (published: 5000); 0: the tables only.")] = 0,
    noise_seeds: Annotated[int, typer.Option(min=2, help="Draws of the marker noise behind medians and ranges.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise, inertial seeds and Monte Carlo draws.")] = 0,
    sensitivities: told.Sensitivities = True,
) -> None:
    """The published study, table by table: our figures beside the printed ones, and its claims put to the test."""


@command("other_programs:export")
def export(
    result: Result,
    formats: told.Formats = told.MODELS,
    out: told.ExportFolder = None,
    inputs: told.Inputs = None,
    replace: told.Replace = False,
    convention: told.Signs = None,
    moments: told.Moments = None,
    external: told.External = False,
    units: told.Units = None,
    into: told.Into = None,
    names: told.Names = None,
    parameters: told.Transferred = "joints",
    attachments: told.Attachments = "stay",
    muscles: told.Muscles = False,
    draws: told.ModelDraws = 0,
    seed: told.ModelSeed = 0,
) -> None:
    """The fitted model for OpenSim, ROS, MuJoCo; its joints in your own OpenSim model; recordings as C3D; strides."""


@command("figures:draw_figures")
def figures(
    result: told.AnyResult,
    out: told.FiguresFolder = None,
    purpose: told.Purpose = "paper",
    only: told.Only = None,
    width: told.Width = None,
    formats: told.Pictures = None,
    normal: told.FigureBands = None,
    convention: told.FigureSigns = None,
    external: told.FigureExternal = False,
    units: told.FigureUnits = None,
) -> None:
    """Figures of a result for a paper: gaitcal figures DIR --only knee_adduction --width 85mm --convention clinical"""


@command("view:view_result")
def view(result: Result, other: told.Other = None, html: told.Html = None, geometry: told.Geometry = None) -> None:
    """Page of a result, or of the comparison of two: live on this machine only, or one self-contained file."""


@command("view:print_report")
def report(
    result: Result,
    other: told.Other = None,
    pdf: told.Pdf = None,
    comments: told.Comments = None,
    normal: Normal = None,
) -> None:
    """A report on paper, of a result or two sessions: verdict, steps, sheets of curves, what not to trust; A4, PDF."""


@command("view:compare_sessions_or_models")
def compare(
    result: Result,
    other: told.OtherResult = None,
    osim: Annotated[Path | None, typer.Option(help="An OpenSim model of the same person, instead of OTHER.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the tables; nothing is written unless given.")] = None,
    shared_model: told.SharedModel = False,
    motion: Annotated[
        bool, typer.Option(help="With --osim: its coordinates and moments in the recordings, by OpenSim, too.")
    ] = False,
    study: told.Studies = None,
) -> None:
    """Two sessions of one person: what differs, and whether it could be chance. Or an OpenSim model beside ours."""


@command("explain:explain_code")
def explain(code: told.CodeName = None) -> None:
    """What the code of a finding or of an error means, and what to do; without a code, a list of all."""


def main() -> None:
    """Entry point: one clear line for every fault, and its exit code."""
    set_up()
    told_in_a_line(lambda: app(standalone_mode=True), verbose=any(a in ("-v", "--verbose") for a in sys.argv[1:]))


if __name__ == "__main__":
    main()
