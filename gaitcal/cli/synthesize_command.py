"""`gaitcal synthesize`: a synthetic subject as a study folder; and `demo`, which calibrates one."""

from pathlib import Path

from gaitcal.analysis.calibrate import calibrate
from gaitcal.cli import options
from gaitcal.cli.calibrate_command import print_calibration, tell_kept
from gaitcal.cli.console import Console
from gaitcal.io.result_folder import ResultKind, check_output_folder
from gaitcal.pipeline.write_results import write_results
from gaitcal.report.page.page_folder import PAGE
from gaitcal.study.study import Study
from gaitcal.synthetic import subject, synthetic_truth

SEED = 2009
"""Of the demonstration's noise and of its subject's true parameters: the first from 2007 on (the
year of the method) whose true moments have their peaks within 2 standard deviations of people's
(`scripts/tools/walking_person.py`)."""


def write_subject(
    console: Console,
    out: options.Out,
    seed: options.Seed = 0,
    noise: options.Noise = False,
    perturb: options.Perturb = False,
    movement: options.Movements = None,
) -> None:
    """Write a synthetic subject as a study folder."""
    kept = check_output_folder(out, ResultKind.SYNTHETIC)
    with console.working() as step:
        step("writing C3D files of the synthetic subject")
        study = subject.synthesize(
            out, seed=seed, noise=noise, perturb=perturb, also=movement or ()
        )
    tell_kept(console, kept)
    console.line(f"study: {study}")
    console.line(
        f"truth: {study.parent / synthetic_truth.PARAMETERS}, "
        f"{study.parent / synthetic_truth.CURVES}"
    )
    console.line(f"next:  gaitcal calibrate {study} --out {out}-result")


def demonstrate(console: Console, out: options.Out = Path("gaitcal-demo")) -> None:
    """Write a noisy synthetic subject as C3D, and calibrate it: the truth that its study names is
    in the result.
    """
    folder, result = out / "subject", out / "result"
    check_output_folder(folder, ResultKind.SYNTHETIC)
    kept = check_output_folder(result, ResultKind.CALIBRATION)
    with console.working() as step:
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
    console.line(
        "A synthetic subject (markers with up to 10 mm of noise, two force plates), calibrated "
        "from its C3D files:"
    )
    print_calibration(console, calibration)
    tell_kept(console, kept)
    console.line(f"page:   {result / PAGE}")
