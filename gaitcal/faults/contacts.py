"""Feet on plates: which foot, whether wholly on it, and whether force and foot touch down at the same time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import (
    FOOT_BREADTH,
    RESTING,
    SHORTEST,
    UNDER_FOOT,
    FootPoints,
    Loading,
    distance_to_line,
    ground_velocity,
    sole_of,
)
from gaitcal.dynamics.off_sole import MOST_BESIDE, one_centre
from gaitcal.dynamics.plate_errors import foot_tip, outline_known
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding, Severity
from gaitcal.io.force_plate import BODY_N, LOADED_N, centre_on_ground, resample_wrench
from gaitcal.io.intervals import duration, runs, spans
from gaitcal.model.linkage import SIDES

FEET = ("right", "left")
FLOOR_M = (-0.03, 0.15)
"""Height of a resting heel or toe marker above the centre of pressure."""
LATE_S = 0.08
"""Difference between the clocks of markers and forces that is told."""


@dataclass(frozen=True, kw_only=True)
class Step(Loading):
    """A plate under load, given to the foot whose line from heel to toe is nearest to the centre of pressure."""

    distance: float
    """m, mean distance of the centre of pressure from that line, weighed by the load."""
    other: float
    """m, the same for the other foot."""


class Feet:
    """Heels and toes of a trial, from the markers alone."""

    def __init__(self, trial: TrialEvidence) -> None:
        self.time = trial.recording.time
        self.seen = np.zeros((len(self.time), 2), dtype=bool)
        self.heel = np.full((len(self.time), 2, 3), np.nan)
        self.toe = np.full((len(self.time), 2, 3), np.nan)
        for k, side in enumerate(SIDES):
            heel, toe = trial.landmark(f"heel_{side}"), trial.landmark(f"toe_{side}")
            if heel is not None and toe is not None:
                self.heel[:, k], self.toe[:, k] = heel, toe
                self.seen[:, k] = np.isfinite(heel).all(axis=1) & np.isfinite(toe).all(axis=1)

        self.heel_velocity = np.gradient(self.heel, self.time, axis=0)
        self.toe_velocity = np.gradient(self.toe, self.time, axis=0)
        self.ground = ground_velocity(
            np.concatenate([self.heel, self.toe], axis=1),
            np.concatenate([self.heel_velocity, self.toe_velocity], axis=1),
        )

    def slow(self, velocity: Array) -> BoolArray:
        """(nf,) where a point with velocity (nf, 3) moves with the ground."""
        out: BoolArray = np.nan_to_num(np.linalg.norm(velocity - self.ground, axis=1), nan=np.inf) < RESTING
        return out

    def resting(self, foot: int) -> BoolArray:
        """(nf,) the foot is down: its heel or its toe moves with the ground."""
        return self.slow(self.heel_velocity[:, foot]) | self.slow(self.toe_velocity[:, foot])

    def points(self, height: float) -> FootPoints:
        """Heels, toes and tips of the feet of a person of this height (m); NaN where they are not seen."""
        speeds = (np.linalg.norm(v - self.ground, axis=2) for v in (self.heel_velocity, self.toe_velocity))
        heel_speed, toe_speed = speeds
        return FootPoints(
            heel=self.heel,
            toe=self.toe,
            tip=foot_tip(self.heel, self.toe, height),
            heel_speed=heel_speed,
            toe_speed=toe_speed,
            width=FOOT_BREADTH * height,
        )

    def distance(self, foot: int, point: Array, frames: slice, load: Array) -> float:
        """m, mean distance of points (n, 3) from the line heel-toe, seen from above; infinite where it is not seen."""
        known = self.seen[frames, foot]
        if not known.any():
            return float("inf")
        a, b = self.heel[frames, foot][known][:, [0, 2]], self.toe[frames, foot][known][:, [0, 2]]
        return float(np.average(distance_to_line(point[known][:, [0, 2]], a, b), weights=load[known]))


def feet_of(trial: TrialEvidence) -> Feet | None:
    """The feet of a gait trial; None in another, or where no foot is seen."""
    if not trial.is_gait or len(trial.recording.time) < 3:
        return None
    feet = Feet(trial)
    return feet if feet.seen.any() else None


def steps(trial: TrialEvidence, feet: Feet) -> list[Step]:
    """All loadings of all plates that are longer than a knock."""
    loadings = []
    for plate in trial.recording.plates:
        wrench = np.nan_to_num(resample_wrench(plate, feet.time))
        for run in runs(wrench[:, 1] > LOADED_N, 2):
            if duration(feet.time, run) < SHORTEST or wrench[run, 1].max() < BODY_N:
                continue
            height = float(np.nanmedian(plate.point[:, 1])) if np.isfinite(plate.point[:, 1]).any() else 0.0
            point, load = centre_on_ground(wrench[run], height), wrench[run, 1]
            away = [feet.distance(k, point, run, load) for k in range(2)]
            foot = int(np.argmin(away))
            loadings.append(
                Step(
                    plate=plate,
                    frames=run,
                    foot=foot,
                    distance=away[foot],
                    other=away[1 - foot],
                    point=point,
                    load=load,
                )
            )
    return loadings


def contacts(trial: TrialEvidence) -> Iterator[Finding]:
    """Everything about feet on plates in a gait trial."""
    feet = feet_of(trial)
    if feet is None or not trial.recording.plates:
        return
    loadings = steps(trial, feet)
    if not loadings:
        most = max(float(np.nan_to_num(plate.force[:, 1]).max()) for plate in trial.recording.plates)
        cure = "no stance will have torques, only the swing; are these the forces of this trial?"
        yield trial.warning("plates", f"no plate is stepped on: at most {most:.0f} N", cure, code=Code.NO_STEP_ON_PLATE)
    on_feet = [step for step in loadings if np.isfinite(step.distance) and step.distance < UNDER_FOOT]
    for step in loadings:
        far = step.distance > UNDER_FOOT
        # a total force that was divided, told in outside_sole.py, may be far from both feet
        if not (far and any(one_centre(step, other, len(feet.time)).any() for other in loadings)):
            yield from _which_foot(trial, step)
    for step in on_feet:
        yield from _height(trial, feet, step)
    partly = [finding for step in on_feet for finding in overhang(trial, feet, step)]
    # where another step of the trial lies on its plate the plates are where the file has them: a fact of this step
    yield from partly if len(partly) == len(on_feet) else (replace(f, severity=Severity.INFO) for f in partly)
    yield from _clocks(trial, feet, on_feet)


def _which_foot(trial: TrialEvidence, step: Step) -> Iterator[Finding]:
    """Whether the foot that the study names stands on the plate; if it names none, whether any does, and which."""
    name = f"plate {step.plate.name}, {spans(trial.recording.time, [step.frames])}"
    side = trial.trial.plates.get(step.plate.name)
    if side == "none":
        return
    if side is not None:
        named = SIDES.index(side)
        away = step.distance if step.foot == named else step.other
        if away > UNDER_FOOT and step.foot != named and step.distance < UNDER_FOOT:
            yield trial.error(
                "plate to foot",
                f"{name}: the study gives it to the {FEET[named]} foot, {1e3 * away:.0f} mm off the centre of pressure "
                f"(the {FEET[step.foot]} foot: {1e3 * step.distance:.0f} mm)",
                f'write plates = {{ {step.plate.name} = "{SIDES[step.foot]}" }}, or leave it out to have it found',
                code=Code.WRONG_FOOT,
            )
            return
    if step.distance > UNDER_FOOT and np.isinf(step.other):
        unseen = FEET[1 - step.foot]
        found = f"{name}: the centre of pressure is {1e3 * step.distance:.0f} mm from the {FEET[step.foot]} foot; "
        yield trial.info(
            "plate to foot",
            f"{found}the {unseen} foot, whose step it may be, shows no heel and toe then",
            code=Code.UNDER_NO_FOOT,
        )
    elif step.distance > UNDER_FOOT:
        yield trial.warning(
            "plate to foot",
            f"{name}: the centre of pressure is {1e3 * step.distance:.0f} mm from the {FEET[step.foot]} and "
            f"{1e3 * step.other:.0f} mm from the other foot; allowed: {1e3 * UNDER_FOOT:.0f} mm",
            "check the position of the plate (corners), the axes of the forces, and that they belong to this trial",
            code=Code.UNDER_NO_FOOT,
        )
    else:
        found = f"{name}: {FEET[step.foot]} foot, whose line heel-toe passes the centre of pressure at "
        found += f"{1e3 * step.distance:.0f} mm"
        yield trial.info("plate to foot", found, code=Code.FOOT_OF_PLATE)


def _height(trial: TrialEvidence, feet: Feet, step: Step) -> Iterator[Finding]:
    """Whether the centre of pressure lies at the height of the resting foot's soles."""
    down = feet.resting(step.foot)[step.frames]
    if not down.any():
        return
    lowest = np.fmin(feet.heel[step.frames, step.foot, 1], feet.toe[step.frames, step.foot, 1])[down]
    above = float(np.nanmedian(lowest)) - float(np.median(step.point[:, 1]))
    if not FLOOR_M[0] <= above <= FLOOR_M[1]:
        yield trial.warning(
            "plates",
            f"plate {step.plate.name}: its surface lies {1e3 * above:.0f} mm below the lower of heel and toe marker; "
            f"allowed: {1e3 * FLOOR_M[0]:.0f} to {1e3 * FLOOR_M[1]:.0f} mm",
            "check the height of the plate's corners, or the origin of the markers",
            code=Code.PLATE_HEIGHT,
        )


def overhang(trial: TrialEvidence, feet: Feet, step: Step) -> Iterator[Finding]:
    """A step whose foot rests partly beside its plate, and beside every other: plates that touch are one surface."""
    if step.plate.corners is None:
        return
    surface = [plate for plate in trial.recording.plates if plate is step.plate or outline_known(plate, BODY_N)]
    sole = sole_of(feet.points(trial.subject.height), step.foot, step.frames)
    still = sole.resting.any(axis=1) & feet.seen[step.frames, step.foot]
    if still.sum() < 3:
        return
    beside = sole.beside(surface) & sole.resting
    if float(np.median(sole.share_of_halves(beside)[still].max(axis=1))) > MOST_BESIDE:
        share = float(sole.share_of(beside)[still].max())
        yield trial.warning(
            "plate to foot",
            f"plate {step.plate.name}, {spans(trial.recording.time, [step.frames])}: the {FEET[step.foot]} foot rests "
            f"partly beside it ({100 * share:.0f} % of the sole)",
            "the plate misses a part of the force, and no torque of this leg counts meanwhile; are its corners right?",
            leg=SIDES[step.foot],
            code=Code.FOOT_BESIDE_PLATE,
        )


def _clocks(trial: TrialEvidence, feet: Feet, loadings: list[Step]) -> Iterator[Finding]:
    """Touch-down and lift-off by force against those by motion."""
    late: list[float] = []
    for step in loadings:
        down = feet.resting(step.foot)
        best = max(runs(down), key=lambda r: _overlap(r, step.frames), default=None)
        if best is None or not _overlap(best, step.frames):
            continue
        if best.start > 0 and step.frames.start > 0:
            late.append(float(feet.time[step.frames.start] - feet.time[best.start]))
        if best.stop < len(down) and step.frames.stop < len(down):
            late.append(float(feet.time[step.frames.stop - 1] - feet.time[best.stop - 1]))
    if len(late) < 2:
        return
    shift = float(np.mean(late))
    if abs(shift) > LATE_S and all(value * shift > 0 for value in late):
        yield trial.warning(
            "time",
            f"feet touch down and lift off {abs(shift):.2f} s {'later' if shift > 0 else 'sooner'} by force than by "
            "motion",
            "the clocks of markers and forces differ: correct the time column of one of the files",
            code=Code.CLOCKS_DIFFER,
        )


def _overlap(one: slice, other: slice) -> int:
    """Frames that two stretches share."""
    return max(0, int(min(one.stop, other.stop)) - int(max(one.start, other.start)))


def covered(trial: TrialEvidence) -> Iterator[Finding]:
    """How the clocks of markers and forces overlap."""
    time = trial.recording.time
    for plate in trial.recording.plates:
        common = min(time[-1], plate.time[-1]) - max(time[0], plate.time[0])
        if trial.is_gait and common <= 0:
            found = f"plate {plate.name}: forces from {plate.time[0]:g} to {plate.time[-1]:g} s, "
            found += f"markers from {time[0]:g} to {time[-1]:g} s"
            yield trial.error("time", found, "give the forces of this very trial", code=Code.OTHER_TIMES)
            return
