"""Movements that are no walk, carried by the ground as the walk is: squat, sit-to-stand, jump, run,
stairs.

A movement is postures in time and contacts. Postures are angles of one leg, of trunk and arms at a
few moments, `_LEGS` and `_BODY` below: typical figures of textbooks (run: Novacheck, Gait Posture
7:77-95, 1998; stairs: Riener, Rabuffetti & Frigo, Gait Posture 15:32-44, 2002), no person's. A
contact is a foot that stands somewhere from strike to off. The pelvis goes where the feet that
stand want it, and in flight as a thrown body does. Then the least squares of `walk.py` change
angles and pelvis as little as the ground asks for: no moment about where the load rolls, no force
in flight, feet that stand. A seat bears part of the weight of who sits on it, below the pelvis.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import Enum

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from gaitcal.arrays import Array
from gaitcal.model.linkage import COORDINATE_INDEX, SIDES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic import walk
from gaitcal.synthetic.synthetic_motion import (
    TrueMotion,
    fit_to_nominal_markers,
    is_nominal,
    make_standing_pose,
)
from gaitcal.tracking.spline import DEGREE, build_spline_basis, convert_to_bspline


class Activity(Enum):
    """What the built-in person does."""

    SQUAT = "squat"
    SIT_TO_STAND = "sit_to_stand"
    JUMP = "jump"
    RUN = "run"
    STAIRS = "stairs"


RATE_HZ = 100.0
FAST, FAST_SPAN, SLOW_SPAN = (Activity.RUN, Activity.JUMP), 4, 10
"""Frames between the knots of the spline of a movement."""
FLIGHT_FORCE = 0.005  # Body weights, that a flying body may be pushed by
POSTURE_SPREAD = (
    4.0  # How much further from its postures such a movement may be than a walk from its curves
)
STANDING_PART, BALL_PART = 0.45, 0.75
"""Part of the way from heel to tip under which a foot bears its load: that stands, and whose heel
is off the ground.
"""
SEAT_SHARE, SEAT_OFFSET_M = 0.8, np.array([-0.05, -0.10, 0.0])
"""Of body weight on a seat, and where it pushes, m from the pelvis."""
END_SPANS = 4  # Spans of the spline at either end that are left out
SWAY = (("pelvis_tz", 0.008, 0.4), ("pelvis_rotation", 0.03, 0.55), ("lumbar_bending", 0.02, 0.3))
"""Coordinate, m or rad, Hz: nobody stands like a drawing."""
SWAY_S = 0.2  # s, in whose middle a foot's next foothold takes the place of its last
REST_PHASES = {True: ((0.03, 0.5), (0.12, 0.86)), False: ((0.1, 0.9), (-0.08, 1.08))}
"""Part of a contact between which heel and ball do not move: of strides, and of a foot that stands.
"""
REST_RAMP = 0.08  # Part of a contact, to come to rest and to leave


@dataclass(frozen=True)
class Contact:
    """A foot that stands."""

    foot: int
    start: float
    stop: float  # s
    place: tuple[float, float, float]  # m: forward, height of the ground, to the right
    shared: bool = False  # The other foot takes the load over while both stand


@dataclass(frozen=True, kw_only=True)
class SyntheticMovement:
    """A movement of the built-in person."""

    motion: TrueMotion
    contacts: tuple[Contact, ...] = ()  # A plate is under each foothold; none: a walk
    belt: bool = False  # One plate is under all


_LEGS: Mapping[Activity, str] = {
    Activity.SQUAT: "0 0 0 0 | 0.6 0 0 0 | 1.4 100 92 26 | 1.5 100 92 26 | 2.3 0 0 0 | 2.6 0 0 0",
    Activity.SIT_TO_STAND: "0 88 92 12 | 0.6 88 92 12 | 1.3 118 94 18 | 2.4 0 0 0 | 2.9 0 0 0 | "
    "4.0 118 94 18 "
    "| 4.7 88 92 12 | 5.2 88 92 12",
    Activity.JUMP: "0 0 0 0 | 0.4 0 0 0 | 1.0 95 95 30 | 1.33 0 0 -25",
    Activity.RUN: "0 38 18 5 | .1 34 38 12 | .17 22 42 24 | .25 5 32 20 | .33 -7 18 -12 | .42 -4 "
    "45 -16 | .55 25 88 -5 "
    "| .68 48 98 0 | .8 55 65 4 | .9 48 25 5 | 1 38 18 5",
    Activity.STAIRS: "0 62 66 12 | .12 56 60 16 | .3 30 26 9 | .47 10 11 8 | .57 5 12 0 | .66 22 "
    "45 -8 | .78 55 90 4 "
    "| .9 68 88 12 | 1 62 66 12",
}
"""s, or strides from the strike on; degrees of hip flexion, knee flexion, dorsiflexion."""
_BODY: Mapping[Activity, str] = {
    Activity.SQUAT: "0 0 0 0 | 0.6 0 0 0 | 1.4 -34 -8 70 | 1.5 -34 -8 70 | 2.3 0 0 0 | 2.6 0 0 0",
    Activity.SIT_TO_STAND: "0 -8 0 20 | 0.6 -8 0 20 | 1.3 -42 -6 35 | 2.4 0 0 0 | 2.9 0 0 0 | 4.0 "
    "-42 -6 35 "
    "| 4.7 -8 0 20 | 5.2 -8 0 20",
    Activity.JUMP: "0 0 0 0 | 0.4 0 0 0 | 1.0 -36 -8 -30 | 1.33 0 0 60",
    Activity.RUN: "0 -12 -4 0 | 1 -12 -4 0",
    Activity.STAIRS: "0 -12 -4 0 | 1 -12 -4 0",
}
"""The same moments; degrees of pelvis tilt, lumbar extension, shoulder flexion."""
STRIDE_S = {Activity.RUN: 0.72, Activity.STAIRS: 1.4}
STANCE_SHARES = {
    Activity.RUN: 0.34,
    Activity.STAIRS: 0.62,
}  # Share of a stride in which a foot stands
STEP_M = {Activity.RUN: (1.05, 0.0, 0.05), Activity.STAIRS: (0.29, 0.17, 0.09)}
"""m: length, rise, and from the middle line."""
STANCE_WIDTH = 0.12  # m from the middle line to a foot that stands
STRIDES = (0.15, 2.7)  # Of a run or a climb, since a right strike
REPEATS = {Activity.SQUAT: 2, Activity.SIT_TO_STAND: 1}


def _parse_table(text: str) -> tuple[Array, Array]:
    rows = np.array([[float(x) for x in row.split()] for row in text.split("|")])
    return rows[:, 0], rows[:, 1:]


def _build_postures(activity: Activity, time: Array, phase: Array | None) -> Array:
    """(nf, nq) angles alone; `phase`: (nf,) strides, of movements that are strides."""
    q = np.tile(make_standing_pose(), (len(time), 1))
    moments, body = _parse_table(_BODY[activity])
    _, legs = _parse_table(_LEGS[activity])
    if phase is None:  # from posture to posture, at rest in each
        last = moments[-1]
        at = np.mod(time, last)
        if activity is Activity.JUMP:
            at = time

        def along(values: Array, shift: float) -> Array:
            out = np.tile(values[0], (len(at), 1))
            for k in range(len(moments) - 1):
                out += walk.compute_ramp((at - moments[k]) / (moments[k + 1] - moments[k]))[
                    :, None
                ] * (values[k + 1] - values[k])
            return out
    else:

        def along(values: Array, shift: float) -> Array:
            own = _parse_table(_LEGS[activity])[0] if len(values) == len(legs) else moments
            values = np.vstack([values[:-1], values[:1]])
            out: Array = CubicSpline(own, values, bc_type="periodic")(np.mod(phase - shift, 1.0))
            return out

    trunk = np.deg2rad(along(body, 0.0))
    q[:, COORDINATE_INDEX["pelvis_tilt"]] += trunk[:, 0]
    q[:, COORDINATE_INDEX["lumbar_extension"]] += trunk[:, 1]
    for side, shift in zip(SIDES, (0.0, 0.5), strict=True):
        leg = np.deg2rad(along(legs, shift))
        for name, values in zip(("hip_flexion", "knee_angle", "ankle_angle"), leg.T, strict=True):
            q[:, COORDINATE_INDEX[f"{name}_{side}"]] += values
        swing = trunk[:, 2] if phase is None else -0.5 * (leg[:, 0] - leg[:, 0].mean())
        q[:, COORDINATE_INDEX[f"arm_flex_{side}"]] += swing
        if activity is Activity.RUN:
            q[:, COORDINATE_INDEX[f"elbow_flex_{side}"]] += np.deg2rad(75.0)
    return q


def _build_contacts(activity: Activity, ends: tuple[float, float]) -> tuple[Contact, ...]:
    if activity in STRIDE_S:
        stride, (length, rise, aside) = STRIDE_S[activity], STEP_M[activity]
        steps = range(int(2 * STRIDES[0]) - 2, int(2 * STRIDES[1]) + 1)
        out = []
        for level, k in enumerate(steps):
            start = (0.5 * k - STRIDES[0]) * stride
            stop = start + STANCE_SHARES[activity] * stride
            if stop > ends[0] and start < ends[1]:
                z = aside if k % 2 == 0 else -aside
                out.append(
                    Contact(
                        k % 2,
                        start,
                        stop,
                        (length * k, rise * level, z),
                        shared=STANCE_SHARES[activity] > 0.5,
                    )
                )
        return tuple(out)
    stands = (
        [ends]
        if activity is not Activity.JUMP
        else [(ends[0], TAKE_OFF_S), (TAKE_OFF_S + FLIGHT_S, ends[1])]
    )
    places = ((0.0, 0.0, STANCE_WIDTH), (0.0, 0.0, -STANCE_WIDTH))
    return tuple(Contact(k, *stand, places[k]) for stand in stands for k in range(len(SIDES)))


TAKE_OFF_S, FLIGHT_S = 1.18, 0.34  # s, of the jump: its landing is the push-off backwards


@with_one_blas_thread
def simulate_movement(activity: Activity, parameters: Parameters) -> SyntheticMovement:
    """What a person with these parameters does; the ground's forces: `ground_on_feet`."""
    if activity in STRIDE_S:
        lasts = (STRIDES[1] - STRIDES[0]) * STRIDE_S[activity]
    elif activity is Activity.JUMP:
        lasts = 2 * TAKE_OFF_S + FLIGHT_S
    else:
        lasts = REPEATS[activity] * _parse_table(_LEGS[activity])[0][-1]
    per_span = FAST_SPAN if activity in FAST else SLOW_SPAN
    spans = round(lasts * RATE_HZ / per_span)
    time = np.arange(spans * per_span + 1) / RATE_HZ
    phase = STRIDES[0] + time / STRIDE_S[activity] if activity in STRIDE_S else None
    mirrored = (
        np.minimum(time, 2 * TAKE_OFF_S + FLIGHT_S - time) if activity is Activity.JUMP else time
    )
    contacts = _build_contacts(activity, (0.0, float(time[-1])))
    q = _build_postures(activity, mirrored, phase)
    on = _Feet(contacts, time, strides=phase is not None)
    q[:, :3] = on.carry(q)
    for name, size, hz in SWAY:
        q[:, COORDINATE_INDEX[name]] += size * np.sin(2 * np.pi * hz * time + 1.0)
    basis = build_spline_basis(time, spans + DEGREE)
    if not is_nominal(parameters):
        q = basis.evaluate(fit_to_nominal_markers(parameters, basis, q))
    ground = on.ground(q, _compute_seat_share(activity, time))
    fitted = basis.fit(q)
    meant = walk.TargetMotion(
        basis.evaluate(fitted), basis.evaluate(fitted, 2), spread=POSTURE_SPREAD
    )
    moved = convert_to_bspline(basis, walk.fit_carried_motion(parameters, basis, ground, meant))
    cut = END_SPANS * per_span  # at an end nothing holds accelerations
    inner = slice(cut, len(time) - cut)
    kept = build_spline_basis(time[inner], basis.nodes - 2 * END_SPANS)
    ground = walk.Ground(**{f.name: getattr(ground, f.name)[inner] for f in fields(walk.Ground)})
    motion = TrueMotion(kept, kept.fit(moved(time[inner])), ground=ground)
    return SyntheticMovement(motion=motion, contacts=contacts, belt=activity is Activity.RUN)


def _compute_seat_share(activity: Activity, time: Array) -> Array:
    """(nf,) of the weight on a seat."""
    if activity is not Activity.SIT_TO_STAND:
        return np.zeros(len(time))
    at = np.mod(time, 5.2)
    return SEAT_SHARE * (
        1.0 - walk.compute_ramp((at - 0.8) / 0.5) + walk.compute_ramp((at - 4.0) / 0.5)
    )


class _Feet:
    """Both feet over their contacts."""

    def __init__(self, contacts: tuple[Contact, ...], time: Array, *, strides: bool) -> None:
        nf = len(time)
        flat = walk.compute_feet(published_model().parameters, make_standing_pose()[None]).points[0]
        flat = (
            flat
            - [0.0, flat[..., 1].min() - walk.CLEARANCE, 0.0]
            - flat.mean(axis=1, keepdims=True) * [1.0, 0.0, 1.0]
        )
        self.time = time
        self.footsteps, self.rest = (
            np.zeros((nf, 2, len(walk.POINTS), 3)),
            np.zeros((nf, 2, len(walk.POINTS))),
        )
        self.load, self.part, self.level = (
            np.zeros((nf, 2)),
            np.full((nf, 2), STANDING_PART),
            np.zeros((nf, 2)),
        )
        for c in contacts:
            foot, own = c.foot, (time - c.start) / (c.stop - c.start)
            inside = (own >= 0.0) & (own <= 1.0)
            near = np.abs(time - 0.5 * (c.start + c.stop)) < 0.5 * (c.stop - c.start + SWAY_S)
            self.footsteps[near, foot] = flat[foot] + np.array(c.place)
            self.level[near, foot] = c.place[1]
            if strides:
                self.part[inside, foot] = PchipInterpolator(*walk.ROLL)(own[inside])
            else:
                off = (c.stop < time[-1]) * walk.compute_ramp((own - 0.8) / 0.15) + (
                    c.start > time[0]
                ) * walk.compute_ramp((0.2 - own) / 0.15)
                self.part[inside, foot] += (BALL_PART - STANDING_PART) * off[inside]
            for points, (begin, end) in zip(([0], [2, 3]), REST_PHASES[strides], strict=True):
                comes = walk.compute_ramp((own - begin) / REST_RAMP) if c.start > time[0] else 1.0
                goes = walk.compute_ramp((end - own) / REST_RAMP) if c.stop < time[-1] else 1.0
                self.rest[:, foot, points] += (inside * comes * goes)[:, None]
            overlap = walk.DOUBLE_SUPPORT / walk.STANCE * (c.stop - c.start) if c.shared else 0.0
            self.load[:, foot] += (
                inside
                * (
                    walk.compute_ramp((time - c.start) / overlap)
                    * walk.compute_ramp((c.stop - time) / overlap)
                )
                if overlap
                else inside
            )
        total = self.load.sum(axis=1)
        self.flight = total < np.finfo(float).eps
        self.load /= np.where(self.flight, 1.0, total)[:, None]

    def carry(self, q: Array) -> Array:
        """(nf, 3) m, the pelvis where resting feet want it, thrown in between."""
        away = q.copy()
        away[:, :3] = 0.0
        points = walk.compute_feet(published_model().parameters, away).points
        weight = (self.rest * self.load[:, :, None])[..., None]
        wanted = ((self.footsteps - points) * weight).sum(axis=(1, 2)) / np.maximum(
            weight.sum(axis=(1, 2)), 1e-9
        )
        known = weight.sum(axis=(1, 2, 3)) > 0.3
        out = np.empty((len(q), 3))
        for i in range(3):
            out[:, i] = (
                CubicSpline(self.time[known], wanted[known, i])(self.time)
                if i == 1
                else np.interp(self.time, self.time[known], wanted[known, i])
            )
        smooth = build_spline_basis(self.time, max(8, round(float(np.ptp(self.time)) / 0.1)))
        return smooth.evaluate(smooth.fit(out))

    def ground(self, q: Array, seat: Array) -> walk.Ground:
        """What the ground does."""
        force, spread = np.zeros((len(q), 3)), np.full((len(q), 3), np.inf)
        spread[self.flight] = FLIGHT_FORCE
        return walk.Ground(
            footsteps=self.footsteps,
            held=self.rest,
            resting=self.rest,
            share=self.load * (1.0 - seat)[:, None],
            part=self.part,
            level=self.level,
            seat=q[:, :3] + SEAT_OFFSET_M,
            force=force,
            spread=spread,
        )
