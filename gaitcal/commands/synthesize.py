"""`gaitcal synthesize`."""

from __future__ import annotations

from pathlib import Path

from gaitcal.commands.console import Talk, tell_kept
from gaitcal.files.atomic import require_room
from gaitcal.files.ownership import ResultKind
from gaitcal.synthetic.subject import synthesize


def run(out: Path, *, seed: int, noise: bool, perturb: bool, quiet: bool, verbose: bool) -> None:
    """Write a synthetic subject as a study folder."""
    talk = Talk(quiet=quiet, verbose=verbose)
    kept = require_room(out, ResultKind.SYNTHETIC)
    with talk.working() as step:
        step("writing C3D files of the synthetic subject")
        study = synthesize(out, seed=seed, noise=noise, perturb=perturb)
    tell_kept(talk, kept)
    talk.line(f"study: {study}")
    talk.line(f"truth: {study.parent / 'truth.csv'}")
    talk.line(f"next:  gaitcal calibrate {study} --out {out}-result")
