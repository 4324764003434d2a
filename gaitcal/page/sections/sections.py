"""The sections of a result and of each of its trials: preset of the page -> its blocks.

What belongs to one trial stands with the trial: further trials of a calibrated person have the same, without the rest.
"""

from __future__ import annotations

from collections.abc import Mapping

from gaitcal.gait.normal_bands import Bands
from gaitcal.model.subject_model import SubjectModel
from gaitcal.page.sections.blocks import Sections
from gaitcal.page.sections.fit import fit_blocks, trial_fit_blocks
from gaitcal.page.sections.joints import joint_blocks
from gaitcal.page.sections.provenance import Line, provenance_blocks, top_lines
from gaitcal.page.sections.summary import GaitNumbers, answers, clinician_blocks, gait_numbers, trial_clinician_blocks
from gaitcal.page.sections.trust import fit_of, trial_fits, trial_trust_blocks, trust_blocks
from gaitcal.session.result import Calibration, TrialResult


def result_sections(
    calibration: Calibration, normal: Bands | None = None, manifest: Mapping[str, object] | None = None
) -> Sections:
    """Of the whole result.

    Parameters
    ----------
    normal : bands of healthy people that the page draws.
    manifest : versions, settings and hashes of the inputs; as far as the calibration knows them where not given.
    """
    found = answers(calibration, walks_of(calibration))
    sections = {
        "clinician": clinician_blocks(calibration, normal),
        "fit": fit_blocks(found, trial_fits(calibration)),
        "joints": joint_blocks(calibration),
        "trust": trust_blocks(calibration),
        "provenance": provenance_blocks(calibration, manifest),
    }
    return {preset: blocks for preset, blocks in sections.items() if blocks}


def trial_sections(model: SubjectModel, trial: TrialResult) -> Sections:
    """Of one trial, calibrated or further; presets to which it has nothing to say are left out."""
    walk = gait_numbers(model, trial)
    sections = {"fit": trial_fit_blocks(fit_of(trial))}
    if walk is not None:
        sections |= {"clinician": trial_clinician_blocks(walk), "trust": trial_trust_blocks(model, walk)}
    return {preset: blocks for preset, blocks in sections.items() if blocks}


def result_lines(calibration: Calibration) -> tuple[Line, ...]:
    """The three lines at the top of the page."""
    return top_lines(calibration, walks_of(calibration))


def walks_of(calibration: Calibration) -> tuple[GaitNumbers, ...]:
    """The numbers of every walk."""
    found = (gait_numbers(calibration.model, trial) for trial in calibration.trials)
    return tuple(walk for walk in found if walk is not None)
