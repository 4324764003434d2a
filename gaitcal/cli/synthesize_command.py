"""Commands `synthesize` (write a synthetic subject) and `demo` (write and calibrate one)."""

from pathlib import Path

from gaitcal.analysis.calibrate import calibrate
from gaitcal.cli import options
from gaitcal.cli.calibrate_command import print_calibration, print_kept_folders
from gaitcal.cli.console import Console
from gaitcal.io.result_folder import ResultKind, check_output_folder
from gaitcal.pipeline.write_results import write_results
from gaitcal.report.page.page_folder import PAGE
from gaitcal.study.study import Study
from gaitcal.synthetic import subject, synthetic_truth

SEED = 2009
"""Seed of noise and true parameters of the demonstration.

The first seed from 2007 (the year of the method) whose true peak moments are within 2 standard
deviations of people's (`scripts/tools/walking_person.py`).
"""


def write_subject(
    console: Console,
    out: options.Out,
    seed: options.Seed = 0,
    noise: options.Noise = False,
    perturb: options.Perturb = False,
    movement: options.Movements = None,
) -> None:
    """Write a synthetic subject as a study folder: C3D files, study file and true values.

    Raises
    ------
    UsageError
        A movement is unknown.
    InputError
        The folder has other content.
    """
    kept = check_output_folder(out, ResultKind.SYNTHETIC)
    with console.show_progress() as step:
        step("writing C3D files of the synthetic subject")
        study = subject.synthesize(
            out, seed=seed, noise=noise, perturb=perturb, also=movement or ()
        )
    print_kept_folders(console, kept)
    console.print_line(f"study: {study}")
    console.print_line(
        f"truth: {study.parent / synthetic_truth.PARAMETERS}, "
        f"{study.parent / synthetic_truth.CURVES}"
    )
    console.print_line(f"next:  gaitcal calibrate {study} --out {out}-result")


def run_demonstration(console: Console, out: options.Out = Path("gaitcal-demo")) -> None:
    """Write a synthetic subject with noise as C3D files, and calibrate it.

    The study names the true values, so that the result has them beside the fitted ones.

    Raises InputError: the folder has other content.
    """
    folder, result = out / "subject", out / "result"
    check_output_folder(folder, ResultKind.SYNTHETIC)
    kept = check_output_folder(result, ResultKind.CALIBRATION)
    with console.show_progress() as step:
        step(
            "writing C3D files of a synthetic subject with marker noise and wrong nominal "
            "parameters"
        )
        path = subject.synthesize(folder, seed=SEED, noise=True, perturb=True)
        step("reading them back")
        study = Study.load(path)
        calibration = calibrate(study, step)
        step("writing the results")
        write_results(calibration, result)
    console.print_line(
        "A synthetic subject (markers with up to 10 mm of noise, two force plates), calibrated "
        "from its C3D files:"
    )
    print_calibration(console, calibration)
    print_kept_folders(console, kept)
    console.print_line(f"page:   {result / PAGE}")
