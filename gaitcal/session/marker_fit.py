"""How near model markers come to measured ones: before, after, and the floors of rigid segments and of joints."""

from __future__ import annotations

from dataclasses import dataclass

from gaitcal.gait.words import segment_words
from gaitcal.model.linkage import LOWER_BODY, SEGMENTS
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.session.result import TrialResult


@dataclass(frozen=True, kw_only=True)
class RmsErrors:
    """RMS distance (mm) between measured and model markers; None where there are no markers."""

    label: str
    nominal: float | None
    calibrated: float | None
    floor: float | None
    """Of rigid segments."""
    joint_floor: float | None = None
    """Of each joint by itself."""
    rigid: bool = True
    """False for one segment with fewer than three markers: whatever they do, it follows them nearly exactly."""

    @property
    def ratio(self) -> float | None:
        """Calibrated over floor; None where the floor says nothing of the person."""
        if self.calibrated is None or not self.floor or not self.rigid:
            return None
        return self.calibrated / self.floor

    @property
    def joint_ratio(self) -> float | None:
        """Calibrated over what each joint by itself reaches; None for segments in no joint, or of few markers."""
        if self.calibrated is None or not self.joint_floor or not self.rigid:
            return None
        return self.calibrated / self.joint_floor


def trial_fit(trial: TrialResult, *segments: str) -> RmsErrors:
    """Of one trial, over all its markers or those of some segments."""
    nominal, calibrated, floor = trial.rms_mm(*segments)
    rigid = len(segments) != 1 or int(trial.calibrated.errors.kept(*segments).sum()) >= FEWEST_MARKERS
    return RmsErrors(
        label=segment_words(segments[0]) if len(segments) == 1 else trial.name,
        nominal=nominal,
        calibrated=calibrated,
        floor=floor,
        joint_floor=trial.joint_floor_mm(*segments),
        rigid=rigid,
    )


def leg_fit(trial: TrialResult) -> RmsErrors:
    """Over the markers of pelvis and legs, whose joints the calibration moves."""
    return trial_fit(trial, *LOWER_BODY)


def segment_fits(trial: TrialResult, segments: tuple[str, ...] = SEGMENTS) -> list[RmsErrors]:
    """Of each of these segments that has markers in this trial."""
    return [trial_fit(trial, s) for s in segments if trial.calibrated.errors.kept(s).any()]
