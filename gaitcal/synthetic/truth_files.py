"""The truth of a synthetic person as the files that a study names: parameters, and the curves of every moving trial."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from gaitcal.arrays import Array
from gaitcal.model.ankle_zero import AnkleZero
from gaitcal.model.segment_frames import HipCentre
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.study_file import TruthTable
from gaitcal.study.truth import MOMENTS, MOTION, landmarks_text, moments_text, motion_text
from gaitcal.synthetic.motion import TrueMotion
from gaitcal.synthetic.told_motion import Teller
from gaitcal.synthetic.truth import static_frames, truth_table

PARAMETERS, CURVES = Path("truth.csv"), Path("truth")
LANDMARKS = CURVES / "static_landmarks.csv"
TRUTH: Final = TruthTable(
    parameters=PARAMETERS,
    folder=CURVES,
    landmarks=LANDMARKS,
    markers="published",
    hip_centre=HipCentre.HARRINGTON.value,
    ankle_zero=AnkleZero.AUTO.value,
)
"""`[truth]` of the study: where the files lie, and the rules of the frames that `truth.py` makes: those of a
calibration that is told nothing."""


def write_truth(folder: Path, model: SubjectModel, trials: Mapping[str, tuple[TrueMotion, Array | None]]) -> None:
    """Write `truth.csv`, `truth/static_landmarks.csv`, and `truth/TRIAL_motion.csv` and `TRIAL_moments.csv` of each
    trial; velocities and accelerations, on which forces depend, where there are forces.

    Parameters
    ----------
    folder : of the study.
    model : with the true parameters.
    trials : name -> the true motion, and the wrenches (nf, 2, 6) on right and left foot about the laboratory origin
        that it was given; None without plates.
    """
    frames = static_frames(model, HipCentre(TRUTH.hip_centre))
    (folder / PARAMETERS).write_text(truth_table(frames.parameters), encoding="utf-8")
    (folder / CURVES).mkdir()
    (folder / LANDMARKS).write_text(landmarks_text(frames.posture.landmarks), encoding="utf-8")
    teller = Teller(model, frames, AnkleZero(TRUTH.ankle_zero))
    for name, (motion, wrench) in trials.items():
        told = teller.tell(motion, wrench)
        derivatives = () if wrench is None else (told.velocity, told.acceleration)
        text = motion_text(told.time, told.q, *derivatives)
        (folder / CURVES / (name + MOTION)).write_text(text, encoding="utf-8")
        if told.forces is not None:
            text = moments_text(told.time, told.forces, model.subject.bwh)
            (folder / CURVES / (name + MOMENTS)).write_text(text, encoding="utf-8")
