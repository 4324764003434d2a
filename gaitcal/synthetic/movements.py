"""Movements besides walking that obey Newton's law: squat, sit-to-stand, jump, run, stairs.

A movement is defined by postures and contacts. Postures are angles of one leg, trunk and arms at
some instants (`_LEGS`, `_BODY`): typical values of textbooks (run: Novacheck, Gait Posture 7:77-95,
1998; stairs: Riener, Rabuffetti & Frigo, Gait Posture 15:32-44, 2002). A contact is a foot on the
ground from strike to off. The pelvis is where the standing feet require it, and on a ballistic path
in flight. The least squares of `walk.py` then change angles and pelvis until the ground can give
the total force: no moment about the loaded point, no force in flight, resting feet. A seat bears
part of the weight of a sitting person, below the pelvis.
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
    """Movements of the built-in person."""

    SQUAT = "squat"
    SIT_TO_STAND = "sit_to_stand"
    JUMP = "jump"
    RUN = "run"
    STAIRS = "stairs"


RATE_HZ = 100.0
FAST, FAST_SPAN, SLOW_SPAN = (Activity.RUN, Activity.JUMP), 4, 10
"""Fast movements, and frames between the knots of fast and of slow ones."""
FLIGHT_FORCE = 0.005
"""Standard deviation of the total force in flight, body weights."""
POSTURE_SPREAD = 4.0
"""Standard deviations of coordinates and accelerations here, as a multiple of those of a walk."""
STANDING_PART, BALL_PART = 0.45, 0.75
"""Share of the way from heel to tip at which the load is: of a standing foot, with heel raised."""
SEAT_SHARE, SEAT_OFFSET_M = 0.8, np.array([-0.05, -0.10, 0.0])
"""Share of body weight on a seat, and the position of its force from the pelvis, m."""
END_SPANS = 4
"""Spans of the spline that are cut off at each end."""
SWAY = (("pelvis_tz", 0.008, 0.4), ("pelvis_rotation", 0.03, 0.55), ("lumbar_bending", 0.02, 0.3))
"""Coordinate, amplitude (m or rad) and frequency (Hz) of postural sway."""
SWAY_S = 0.2
"""Time (s) in whose middle the next foothold of a foot replaces the last one."""
REST_PHASES = {True: ((0.03, 0.5), (0.12, 0.86)), False: ((0.1, 0.9), (-0.08, 1.08))}
"""Whether strides -> shares of a contact between which heel and ball do not move."""
REST_RAMP = 0.08
"""Share of a contact in which a point comes to rest, and in which it starts to move."""


@dataclass(frozen=True)
class Contact:
    """A foot on the ground."""

    foot: int
    """0: right, 1: left."""
    start: float
    stop: float
    """s."""
    foothold: tuple[float, float, float]
    """m: forward, height of the ground, to the right."""
    shared: bool = False
    """Whether the load passes to the other foot while both stand."""


@dataclass(frozen=True, kw_only=True)
class SyntheticMovement:
    """A movement of the built-in person."""

    motion: TrueMotion
    contacts: tuple[Contact, ...] = ()
    """One plate is under each foothold; empty: a walk."""
    belt: bool = False
    """Whether one plate is under all contacts."""


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
"""Time (s, or strides after a strike); hip flexion, knee flexion, dorsiflexion (deg)."""
_BODY: Mapping[Activity, str] = {
    Activity.SQUAT: "0 0 0 0 | 0.6 0 0 0 | 1.4 -34 -8 70 | 1.5 -34 -8 70 | 2.3 0 0 0 | 2.6 0 0 0",
    Activity.SIT_TO_STAND: "0 -8 0 20 | 0.6 -8 0 20 | 1.3 -42 -6 35 | 2.4 0 0 0 | 2.9 0 0 0 | 4.0 "
    "-42 -6 35 "
    "| 4.7 -8 0 20 | 5.2 -8 0 20",
    Activity.JUMP: "0 0 0 0 | 0.4 0 0 0 | 1.0 -36 -8 -30 | 1.33 0 0 60",
    Activity.RUN: "0 -12 -4 0 | 1 -12 -4 0",
    Activity.STAIRS: "0 -12 -4 0 | 1 -12 -4 0",
}
"""The same times; pelvis tilt, lumbar extension, shoulder flexion (deg)."""
STRIDE_S = {Activity.RUN: 0.72, Activity.STAIRS: 1.4}
STANCE_SHARES = {Activity.RUN: 0.34, Activity.STAIRS: 0.62}
"""Share of a stride in which a foot stands."""
STEP_M = {Activity.RUN: (1.05, 0.0, 0.05), Activity.STAIRS: (0.29, 0.17, 0.09)}
"""Length and rise of a step, and its distance from the middle line, m."""
STANCE_WIDTH = 0.12
"""Distance of a standing foot from the middle line, m."""
STRIDES = (0.15, 2.7)
"""First and last phase of a run or a climb, strides since a right strike."""
REPEATS = {Activity.SQUAT: 2, Activity.SIT_TO_STAND: 1}
KNOWN_WEIGHT = 0.3
"""Sum of the weights of resting points above which they determine the pelvis position."""
PELVIS_SPAN_S = 0.1
"""Time (s) for each control point of the pelvis position."""
TAKE_OFF_S, FLIGHT_S = 1.18, 0.34
"""Of the jump, s; its landing is the push-off reversed in time."""


def _parse_table(text: str) -> tuple[Array, Array]:
    """Parse a table of postures to times (n,) and values (n, 3)."""
    rows = np.array([np.array(row.split(), dtype=float) for row in text.split("|")])
    return rows[:, 0], rows[:, 1:]


def _build_postures(activity: Activity, time: Array, phase: Array | None) -> Array:
    """Build (nf, nq) coordinates from postures; `phase`: (nf,) strides, None if there are none."""
    q = np.tile(make_standing_pose(), (len(time), 1))
    instants, body = _parse_table(_BODY[activity])
    leg_instants, legs = _parse_table(_LEGS[activity])
    if phase is None:
        # Ramps from posture to posture, at rest in each
        at = time if activity is Activity.JUMP else np.mod(time, instants[-1])

        def interpolate(values: Array, shift: float) -> Array:
            out = np.tile(values[0], (len(at), 1))
            for k in range(len(instants) - 1):
                part = (at - instants[k]) / (instants[k + 1] - instants[k])
                out += walk.compute_ramp(part)[:, None] * (values[k + 1] - values[k])
            return out
    else:
        # Periodic splines over the stride
        def interpolate(values: Array, shift: float) -> Array:
            knots = leg_instants if len(values) == len(legs) else instants
            values = np.vstack([values[:-1], values[:1]])
            spline = CubicSpline(knots, values, bc_type="periodic")
            out: Array = spline(np.mod(phase - shift, 1.0))
            return out

    trunk = np.deg2rad(interpolate(body, 0.0))
    q[:, COORDINATE_INDEX["pelvis_tilt"]] += trunk[:, 0]
    q[:, COORDINATE_INDEX["lumbar_extension"]] += trunk[:, 1]
    for side, shift in zip(SIDES, (0.0, 0.5), strict=True):
        leg = np.deg2rad(interpolate(legs, shift))
        for name, values in zip(("hip_flexion", "knee_angle", "ankle_angle"), leg.T, strict=True):
            q[:, COORDINATE_INDEX[f"{name}_{side}"]] += values
        swing = trunk[:, 2] if phase is None else -0.5 * (leg[:, 0] - leg[:, 0].mean())
        q[:, COORDINATE_INDEX[f"arm_flex_{side}"]] += swing
        if activity is Activity.RUN:
            q[:, COORDINATE_INDEX[f"elbow_flex_{side}"]] += np.deg2rad(75.0)
    return q


def _build_contacts(activity: Activity, ends: tuple[float, float]) -> tuple[Contact, ...]:
    """Build the contacts of both feet between the ends (s) of a movement."""
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


@with_one_blas_thread
def simulate_movement(activity: Activity, parameters: Parameters) -> SyntheticMovement:
    """Simulate a movement of a person; `compute_ground_on_feet` gives its ground reactions."""
    if activity in STRIDE_S:
        duration = (STRIDES[1] - STRIDES[0]) * STRIDE_S[activity]
    elif activity is Activity.JUMP:
        duration = 2 * TAKE_OFF_S + FLIGHT_S
    else:
        duration = REPEATS[activity] * _parse_table(_LEGS[activity])[0][-1]
    per_span = FAST_SPAN if activity in FAST else SLOW_SPAN
    spans = round(duration * RATE_HZ / per_span)
    time = np.arange(spans * per_span + 1) / RATE_HZ
    phase = STRIDES[0] + time / STRIDE_S[activity] if activity in STRIDE_S else None
    mirrored = (
        np.minimum(time, 2 * TAKE_OFF_S + FLIGHT_S - time) if activity is Activity.JUMP else time
    )
    contacts = _build_contacts(activity, (0.0, float(time[-1])))
    q = _build_postures(activity, mirrored, phase)
    feet = _Feet(contacts, time, strides=phase is not None)
    q[:, :3] = feet.place_pelvis(q)
    for name, size, hz in SWAY:
        q[:, COORDINATE_INDEX[name]] += size * np.sin(2 * np.pi * hz * time + 1.0)
    basis = build_spline_basis(time, spans + DEGREE)
    if not is_nominal(parameters):
        q = basis.evaluate(fit_to_nominal_markers(parameters, basis, q))
    ground = feet.build_ground(q, _compute_seat_share(activity, time))
    fitted = basis.fit(q)
    target = walk.TargetMotion(
        basis.evaluate(fitted), basis.evaluate(fitted, 2), spread=POSTURE_SPREAD
    )
    moved = convert_to_bspline(basis, walk.fit_carried_motion(parameters, basis, ground, target))
    # Accelerations are poorly determined at the ends of a spline.
    cut = END_SPANS * per_span
    inner = slice(cut, len(time) - cut)
    kept = build_spline_basis(time[inner], basis.control_points - 2 * END_SPANS)
    ground = walk.Ground(**{f.name: getattr(ground, f.name)[inner] for f in fields(walk.Ground)})
    motion = TrueMotion(kept, kept.fit(moved(time[inner])), ground=ground)
    return SyntheticMovement(motion=motion, contacts=contacts, belt=activity is Activity.RUN)


def _compute_seat_share(activity: Activity, time: Array) -> Array:
    """Compute (nf,) the share of body weight on a seat."""
    if activity is not Activity.SIT_TO_STAND:
        return np.zeros(len(time))
    at = np.mod(time, 5.2)
    return SEAT_SHARE * (
        1.0 - walk.compute_ramp((at - 0.8) / 0.5) + walk.compute_ramp((at - 4.0) / 0.5)
    )


def _make_flat_feet() -> Array:
    """Make (2, 4, 3) m, points of two feet flat on the floor, each above the origin."""
    standing = make_standing_pose()[None]
    points = walk.compute_feet(published_model().parameters, standing).points[0]
    height = points[..., 1].min() - walk.CLEARANCE
    horizontal = points.mean(axis=1, keepdims=True) * [1.0, 0.0, 1.0]
    out: Array = points - [0.0, height, 0.0] - horizontal
    return out


class _Feet:
    """Positions, rest and load of both feet, from their contacts.

    Parameters
    ----------
    contacts
        Contacts of both feet.
    time
        (nf,) s.
    strides
        Whether the load of a contact rolls from heel to toe, as in strides.
    """

    def __init__(self, contacts: tuple[Contact, ...], time: Array, *, strides: bool) -> None:
        nf = len(time)
        self.time = time
        self.footsteps = np.zeros((nf, 2, len(walk.POINTS), 3))
        self.rest = np.zeros((nf, 2, len(walk.POINTS)))
        self.load, self.level = np.zeros((nf, 2)), np.zeros((nf, 2))
        self.part = np.full((nf, 2), STANDING_PART)
        flat = _make_flat_feet()
        for contact in contacts:
            self._add_contact(contact, flat[contact.foot], strides=strides)
        total = self.load.sum(axis=1)
        self.flight = total < np.finfo(float).eps
        self.load /= np.where(self.flight, 1.0, total)[:, None]

    def _add_contact(self, c: Contact, flat: Array, *, strides: bool) -> None:
        """Add a contact of a foot whose points (4, 3) are `flat` when it stands at the origin."""
        time, foot = self.time, c.foot
        part = (time - c.start) / (c.stop - c.start)
        inside = (part >= 0.0) & (part <= 1.0)
        # Feet that stand from the first or to the last frame neither come nor leave.
        comes, leaves = c.start > time[0], c.stop < time[-1]

        # The target position holds until the middle of the sway to the next foothold.
        near = np.abs(time - 0.5 * (c.start + c.stop)) < 0.5 * (c.stop - c.start + SWAY_S)
        self.footsteps[near, foot] = flat + np.array(c.foothold)
        self.level[near, foot] = c.foothold[1]

        if strides:
            self.part[inside, foot] = PchipInterpolator(*walk.ROLL)(part[inside])
        else:
            # The load is at the ball while the heel is raised, at landing and before take-off.
            raised = leaves * walk.compute_ramp((part - 0.8) / 0.15)
            raised = raised + comes * walk.compute_ramp((0.2 - part) / 0.15)
            self.part[inside, foot] += (BALL_PART - STANDING_PART) * raised[inside]

        # Point 0 is the heel, points 2 and 3 are at the ball.
        for points, (begin, end) in zip(([0], [2, 3]), REST_PHASES[strides], strict=True):
            rests = walk.compute_ramp((part - begin) / REST_RAMP) if comes else 1.0
            stays = walk.compute_ramp((end - part) / REST_RAMP) if leaves else 1.0
            self.rest[:, foot, points] += (inside * rests * stays)[:, None]

        # The load passes to the other foot in ramps while both stand.
        handover: Array | float = 1.0
        if c.shared:
            overlap = walk.DOUBLE_SUPPORT / walk.STANCE * (c.stop - c.start)
            rise = walk.compute_ramp((time - c.start) / overlap)
            handover = rise * walk.compute_ramp((c.stop - time) / overlap)
        self.load[:, foot] += inside * handover

    def place_pelvis(self, q: Array) -> Array:
        """Compute (nf, 3) m, the pelvis position: that of resting feet, interpolated in flight."""
        at_origin = q.copy()
        at_origin[:, :3] = 0.0
        points = walk.compute_feet(published_model().parameters, at_origin).points
        weight = (self.rest * self.load[:, :, None])[..., None]
        total = weight.sum(axis=(1, 2))
        target = ((self.footsteps - points) * weight).sum(axis=(1, 2)) / np.maximum(total, 1e-9)
        known = weight.sum(axis=(1, 2, 3)) > KNOWN_WEIGHT
        out = np.empty((len(q), 3))
        for i in (0, 2):
            out[:, i] = np.interp(self.time, self.time[known], target[known, i])
        # The height in flight is smooth; horizontally the pelvis moves uniformly.
        out[:, 1] = CubicSpline(self.time[known], target[known, 1])(self.time)
        spans = max(8, round(float(np.ptp(self.time)) / PELVIS_SPAN_S))
        smooth = build_spline_basis(self.time, spans)
        return smooth.evaluate(smooth.fit(out))

    def build_ground(self, q: Array, seat: Array) -> walk.Ground:
        """Build the ground of a motion; `seat`: (nf,) share of body weight on a seat."""
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
