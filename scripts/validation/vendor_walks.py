"""Angles, moments and powers that a C3D file holds beside its markers, as Plug-in Gait names them; unit and sign.

`RKneeAngles` and `RKneeMoment` hold three curves each: sagittal, frontal, transverse. Files call the unit of their
moments `Nmm` and mean N·mm/kg, mostly; external moments have the other sign. Neither is believed: the unit is the one
that comes nearest to our own moments in size, the sign that of their correlation. Powers (`W`) are those of W/kg.

A recorded walk through the nominal model of its static trial, beside the vendor's curves and the file's events.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import ezc3d
import numpy as np

from gaitcal import Study
from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Moments, moments_of
from gaitcal.dynamics.joint_kinetics import JointKinetics, MomentFrame, component_of, kinetics_of, power_of
from gaitcal.gait.moments import moment_of
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.model.linkage import SIDES
from gaitcal.motion.motion import Motion, tracked_motion
from gaitcal.session.result import Calibration, Stage
from gaitcal.session.session import measured_reactions, prepare_trial
from gaitcal.study.study import nominal_of
from gaitcal.study.study_trial import Trial
from scripts.validation.recordings import CHILDREN, study_of_person

UNITS: dict[str, Callable[[float], float]] = {
    "N·mm/kg": lambda mass: 1e-3,
    "N·m/kg": lambda mass: 1.0,
    "N·mm": lambda mass: 1e-3 / mass,
}
"""Name -> factor to N·m/kg, of a body of this mass (kg)."""


@dataclass(frozen=True)
class Quantity:
    """One of our curves, and the vendor's of the same."""

    ours: str
    """Without its side: `hip_flexion`."""
    theirs: str
    """Without its side: `HipAngles`."""
    axis: int
    """0 sagittal, 1 frontal, 2 transverse; a power has one curve, the last."""

    @property
    def words(self) -> str:
        """As the table shows it."""
        return f"{self.ours} {'power' if self.is_power else 'moment' if self.is_moment else 'angle'}"

    @property
    def is_moment(self) -> bool:
        """Whether it is a moment."""
        return self.theirs.endswith("Moment")

    @property
    def is_power(self) -> bool:
        """Whether it is a power; neither: an angle."""
        return self.theirs.endswith("Power")


QUANTITIES = (
    Quantity("hip_flexion", "HipAngles", 0),
    Quantity("hip_adduction", "HipAngles", 1),
    Quantity("hip_rotation", "HipAngles", 2),
    Quantity("knee_angle", "KneeAngles", 0),
    Quantity("ankle_angle", "AnkleAngles", 0),
    Quantity("hip_flexion", "HipMoment", 0),
    Quantity("hip_adduction", "HipMoment", 1),
    Quantity("knee_angle", "KneeMoment", 0),
    Quantity("knee_adduction", "KneeMoment", 1),
    Quantity("ankle_angle", "AnkleMoment", 0),
    Quantity("hip", "HipPower", 2),
    Quantity("knee", "KneePower", 2),
    Quantity("ankle", "AnklePower", 2),
)
IN_FRAMES = (
    *(q for q in QUANTITIES if q.is_moment),
    Quantity("hip_rotation", "HipMoment", 2),
    Quantity("knee_rotation", "KneeMoment", 2),
    Quantity("ankle_inversion", "AnkleMoment", 1),
    Quantity("ankle_rotation", "AnkleMoment", 2),
)
"""Moments that are told in the frames of segments, too."""


def vendor_curves(path: str) -> dict[str, Array]:
    """Name (`RHipAngles`) -> (nf, 3) as the file has it, NaN where it says nothing (zeros, or no number)."""
    file = ezc3d.c3d(path)
    group = file["parameters"]["POINT"]
    labels = [label for name in ("LABELS", "LABELS2", "LABELS3") if name in group for label in group[name]["value"]]
    names = {side + q.theirs for side in "RL" for q in (*QUANTITIES, *IN_FRAMES)}
    out = {}
    for k, label in enumerate(labels):
        plain = str(label).split(":")[-1].strip()
        if plain in names:
            curve = np.moveaxis(file["data"]["points"][:3, k], 0, -1).astype(float)
            known = np.isfinite(curve).all(axis=1) & (curve != 0.0).any(axis=1)
            out[plain] = np.where(known[:, None], curve, np.nan)
    return out


def unit_of(ours: Sequence[Array], theirs: Sequence[Array], mass: float) -> str:
    """The unit in which the vendor's moments are as large as ours (N·m/kg); frames where either is NaN do not count."""
    one, other = np.concatenate(ours), np.concatenate(theirs)
    both = np.isfinite(one) & np.isfinite(other)
    if not both.any():
        return next(iter(UNITS))
    ratio = np.sqrt(np.mean(one[both] ** 2) / np.mean(other[both] ** 2))
    return min(UNITS, key=lambda name: abs(float(np.log(ratio / UNITS[name](mass)))))


def sign_of(ours: Array, theirs: Array) -> float:
    """1 or -1, that of the correlation of two curves; frames where either is NaN do not count."""
    both = np.isfinite(ours) & np.isfinite(theirs)
    if both.sum() < 2:
        return 1.0
    covariance = np.mean((ours[both] - ours[both].mean()) * (theirs[both] - theirs[both].mean()))
    return -1.0 if covariance < 0 else 1.0


LABS = {"kad": ("kad",), "multi": ("multi",), "children": CHILDREN, "pig": ("pig",)}
"""Laboratory -> its people."""


@dataclass(frozen=True, kw_only=True)
class Walk:
    """One walk, ours and theirs."""

    name: str
    mass: float
    """kg."""
    motion: Motion
    moments: Moments
    kinetics: JointKinetics
    reactions: GroundReactions
    theirs: dict[str, Array]
    """(nf, 3) each, as the file has them."""
    events: tuple[FootEvent, ...]

    def pair(self, quantity: Quantity, side: str, frame: MomentFrame = MomentFrame.COORDINATES) -> tuple[Array, Array]:
        """(nf,) ours, deg, N·m/kg or W/kg, and (nf,) theirs as the file has it; NaN where the file says nothing."""
        name = f"{quantity.ours}_{side}"
        if quantity.is_power:
            ours = power_of(self.kinetics, name) / self.mass
        elif frame is not MomentFrame.COORDINATES:
            ours = component_of(self.kinetics, name, frame) / self.mass
        elif quantity.is_moment:
            ours = moment_of(self.moments, name) / self.mass
        else:
            ours = np.degrees(self.motion.q[:, self.motion.coordinates.index(name)])
        curve = self.theirs.get(f"{side.upper()}{quantity.theirs}")
        return ours, np.full(len(ours), np.nan) if curve is None else curve[:, quantity.axis]

    def strides(self) -> Iterator[tuple[str, BoolArray]]:
        """Side and (nf,) frames of every stride, from strike to strike of the file."""
        for side in SIDES:
            strikes = [e.time for e in self.events if e.side == side and e.moment is FootMoment.STRIKE]
            for begin, end in pairwise(strikes):
                yield side, self._between(begin, end)

    def stances(self) -> Iterator[tuple[str, BoolArray]]:
        """Side and (nf,) frames of every stance, from strike to off of the file."""
        for side in SIDES:
            told = [e for e in self.events if e.side == side]
            for one, other in pairwise(told):
                if (one.moment, other.moment) == (FootMoment.STRIKE, FootMoment.OFF):
                    yield side, self._between(one.time, other.time)

    def _between(self, begin: float, end: float) -> BoolArray:
        time = self.motion.time
        return np.asarray((time >= begin) & (time <= end))


def walk_of(study: Study, name: str, trial: str) -> Walk:
    """A gait trial of a study through its nominal model."""
    model = nominal_of(study)
    chosen = next(t for t in study.trials if t.name == trial)
    prepared = prepare_trial(chosen, model, study.settings)
    motion = tracked_motion(prepared.body, model.parameters)
    reactions = measured_reactions(prepared, model, model.parameters, motion, study.settings)
    return Walk(
        name=name,
        mass=model.subject.mass,
        motion=motion,
        moments=moments_of(model.parameters, motion, reactions.wrench, model.subject.bwh),
        kinetics=kinetics_of(model.parameters, motion, reactions.wrench),
        reactions=reactions,
        theirs=_theirs(chosen, len(motion.time)),
        events=prepared.recording.events,
    )


def calibrated_walk(calibration: Calibration, trial: str, stage: Stage) -> Walk | None:
    """A trial of a calibration, its moments with the model of that stage; None without forces, or without moments."""
    found = calibration.trial(trial)
    if found.loads is None or found.loads.kinetics is None or stage not in found.loads.moments:
        return None
    recorded = next(t for t in calibration.study.trials if t.name == trial)
    return Walk(
        name=f"{calibration.study.subject.name} {trial}",
        mass=calibration.model.subject.mass,
        motion=found.body,
        moments=found.loads.moments[stage],
        kinetics=found.loads.kinetics,
        reactions=found.loads.reactions,
        theirs=_theirs(recorded, len(found.body.time)),
        events=found.recording.events,
    )


def _theirs(trial: Trial, frames: int) -> dict[str, Array]:
    curves = vendor_curves(trial.recording.source)
    return {key: curve for key, curve in curves.items() if len(curve) == frames}


def walks_of(lab: str) -> tuple[Walk, ...]:
    """The walks of a laboratory."""
    studies = {person: study_of_person(person) for person in LABS[lab]}
    return tuple(walk_of(study, f"{person} {walk}", walk) for person, study in studies.items() for walk in study.walks)
