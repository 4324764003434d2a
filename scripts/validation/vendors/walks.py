"""A recorded walk through the nominal model of its static trial, beside the vendor's curves and the file's events."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gaitcal import Study
from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Moments, moments_of
from gaitcal.dynamics.joint_kinetics import JointKinetics, component_of, kinetics_of, power_of
from gaitcal.dynamics.joint_moments import MomentFrame
from gaitcal.gait.moments import moment_of
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.model.linkage import SIDES
from gaitcal.motion.motion import Motion, tracked_motion
from gaitcal.session.result import Calibration, Stage
from gaitcal.session.session import measured_reactions, prepare_trial
from gaitcal.study.study import nominal_of
from gaitcal.study.study_trial import StudyTrial
from scripts.validation.recordings import CHILDREN, study_of_person
from scripts.validation.vendors.curves import Quantity, vendor_curves

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


def _theirs(trial: StudyTrial, frames: int) -> dict[str, Array]:
    curves = vendor_curves(trial.recording.source)
    return {key: curve for key, curve in curves.items() if len(curve) == frames}


def walks_of(lab: str) -> tuple[Walk, ...]:
    """The walks of a laboratory."""
    studies = {person: study_of_person(person) for person in LABS[lab]}
    return tuple(walk_of(study, f"{person} {walk}", walk) for person, study in studies.items() for walk in study.walks)
