"""Joint moments in numbers: their peaks, and how much calibration changed them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.ground_contact import leg_of
from gaitcal.dynamics.inverse_dynamics import FORCES, Moments
from gaitcal.dynamics.torque_sources import Source, TorqueErrors
from gaitcal.gait.strides import Layout
from gaitcal.model.coordinates import split_side
from gaitcal.model.linkage import COORDINATE_INDEX, JOINTS, REACTIONS, joint_elements
from gaitcal.model.subject_model import SubjectModel


def moment_names(model: SubjectModel) -> list[str]:
    """All joint moments that the model moves, the knees' adduction reaction after their flexion."""
    elements = [e for joint in JOINTS for e in joint_elements(joint, reactions=True)]
    return [e.name for e in elements if e.name in FORCES and e.name not in model.frozen]


def moment_of(forces: Moments | TorqueErrors, name: str) -> Array:
    """(nf,) N·m, one moment of generalised forces or of their standard errors."""
    if name in REACTIONS:
        reaction: Array = forces.knee_adduction[:, REACTIONS.index(name)]
        return reaction
    moment: Array = forces.tau[:, COORDINATE_INDEX[name]]
    return moment


def own_error_of(errors: TorqueErrors, name: str) -> Array | None:
    """(nf,) N·m, the part of the standard error of one moment that the trial's own markers make; None: not known."""
    variance = errors.by_source.get(Source.MOTION)
    if variance is None:
        return None
    own: Array = np.sqrt(variance[:, FORCES.index(name)])
    return own


@dataclass(frozen=True)
class Extreme:
    """The largest or smallest value of a moment."""

    value: float
    """N·m/kg."""
    error: float | None
    """N·m/kg, standard error."""
    bwh: float
    """The same in % of body weight times height."""
    at: float
    """% of the gait cycle, or s where the trial is drawn against time."""


@dataclass(frozen=True, kw_only=True)
class MomentNumbers:
    """One joint moment of one trial."""

    name: str
    """`hip_flexion_r`."""
    highest: Extreme | None
    """Over the valid frames of the stride that is drawn; None where there are none."""
    lowest: Extreme | None
    change: float
    """N·m/kg, RMS over all valid frames of the difference between calibrated and nominal model."""
    change_bwh: float
    """The same in % of body weight times height."""
    peak: float
    """N·m/kg, largest absolute value over all valid frames."""

    @property
    def side(self) -> str:
        """`r`, `l` or nothing."""
        return split_side(self.name)[1]

    @property
    def change_of_peak(self) -> float:
        """The change in percent of the peak."""
        return 100.0 * self.change / self.peak if self.peak else 0.0


def moment_numbers(
    model: SubjectModel, layout: Layout, final: Moments, nominal: Moments, errors: TorqueErrors | None = None
) -> tuple[MomentNumbers, ...]:
    """Of all joint moments with valid frames, right and left side by side; a leg's frames are valid by its own foot.

    `final` and `nominal`: with the calibrated and with the nominal model; `errors`: of `final`.
    """
    subject = model.subject
    to_bwh = 100.0 * subject.mass / subject.bwh
    names = moment_names(model)
    bases = list(dict.fromkeys(split_side(name)[0] for name in names))
    numbers = []
    for name in sorted(names, key=lambda n: (bases.index(split_side(n)[0]), split_side(n)[1] == "l")):
        valid = layout.valid_for(leg_of(name))
        if not valid.any():
            continue
        moment, before = (moment_of(f, name) / subject.mass for f in (final, nominal))
        error = moment_of(errors, name) / subject.mass if errors else None
        frames = np.flatnonzero(valid & layout.drawn(split_side(name)[1]))
        extremes: tuple[Extreme | None, ...] = (None, None)
        if len(frames):
            peaks = (frames[moment[frames].argmax()], frames[moment[frames].argmin()])
            extremes = tuple(_extreme(moment, error, int(frame), to_bwh, layout, name) for frame in peaks)
        change = float(np.sqrt(np.mean((moment - before)[valid] ** 2)))
        numbers.append(
            MomentNumbers(
                name=name,
                highest=extremes[0],
                lowest=extremes[1],
                change=change,
                change_bwh=to_bwh * change,
                peak=float(np.abs(moment[valid]).max()),
            )
        )
    return tuple(numbers)


def _extreme(moment: Array, error: Array | None, frame: int, to_bwh: float, layout: Layout, name: str) -> Extreme:
    value, time = float(moment[frame]), float(layout.time[frame])
    spread = None if error is None or not np.isfinite(error[frame]) else float(error[frame])
    at = float(layout.main(split_side(name)[1]).percent(time)) if layout.by_cycle else time
    return Extreme(value, spread, to_bwh * value, at)
