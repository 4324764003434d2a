"""What is drawn of a trial, the numbers of its moments, and the pelvis against their line."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import ezc3d
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gaitcal.analysis.prepared_trials import prepare_trial
from gaitcal.analysis.trial_result import _estimate_foot_axes
from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.dynamics.measurement_errors import TorqueErrors
from gaitcal.gait.cycles import GaitCycle
from gaitcal.gait.moments import MomentSummary, summarise_moments
from gaitcal.gait.spatiotemporal import Stride, assign_stride_lines
from gaitcal.gait.strides import (
    AXES,
    TURNING,
    FootAxes,
    Layout,
    compute_facing,
    compute_foot_axes,
    express_along_line,
    is_turning,
    measure_out_of_plane,
    measure_turn,
)
from gaitcal.io.labels import FootMoment
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.model.subject_model import Subject
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.tracking.motion import Motion, track_motion
from scripts.validation.recordings import study_of_person
from tests.report.page.people import subject_model

TIME = np.arange(0.0, 3.001, 0.01)
CYCLES = {
    "r": (GaitCycle(0.0, 1.0, 0.62), GaitCycle(1.0, 2.0, 1.6), GaitCycle(2.0, 3.0, None)),
    "l": (GaitCycle(0.5, 1.5, 1.1),),
}
MASS, HEIGHT = 80.0, 1.75
KNEE = COORDINATE_INDEX["knee_angle_r"]


def layout(by_cycle: bool = True) -> Layout:
    """The second right stride is the one with valid frames; nothing is valid before 0.9 s and after
    2.1 s.
    """
    valid = (TIME > 0.9) & (TIME < 2.1)
    return Layout(TIME, valid, np.stack([valid] * 2, axis=1), CYCLES if by_cycle else {})


def test_each_leg_has_a_main_stride() -> None:
    """The right leg is valid in its third stride alone, the left nowhere, the whole body in the
    second right stride.
    """
    legs = np.stack([TIME > 1.995, np.zeros_like(TIME, dtype=bool)], axis=1)
    drawn = replace(layout(), valid_legs=legs)
    assert (
        drawn.select_main_cycle("r") == CYCLES["r"][2] == drawn.select_main_cycle("")
        and drawn.select_main_cycle("l") == CYCLES["l"][0]
    )
    assert (
        layout().select_drawn_frames("r").sum() == 101
        and layout(by_cycle=False).select_drawn_frames("r").all()
    )


def numbers(by_cycle: bool) -> MomentSummary:
    """Of the right knee: 80 sin(2 pi t) N·m with the final model, 8 N·m less with the
    nominal one.
    """
    tau, none = np.zeros((len(TIME), len(COORDINATES))), np.zeros((len(TIME), 2))
    tau[:, KNEE] = MASS * np.sin(2 * np.pi * TIME)
    before = tau - 0.1 * MASS * (np.arange(len(COORDINATES)) == KNEE)
    model = replace(subject_model(), subject=Subject("S", MASS, HEIGHT, "female"))
    final, nominal = (
        Moments(
            coordinates=COORDINATES, time=TIME, tau=moments, knee_adduction=none,
            residual_force=none,
            residual_moment=none, bwh=model.subject.bwh,
        )
        for moments in (tau, before)
    )  # fmt: skip
    errors = TorqueErrors(np.full_like(tau, 4.0), none)
    of_all = summarise_moments(model, layout(by_cycle), final, nominal, errors)
    return next(n for n in of_all if n.name == "knee_angle_r")


def test_peak_and_change_of_a_moment_over_the_drawn_stride() -> None:
    knee = numbers(by_cycle=True)
    assert (knee.highest.value, knee.highest.at) == pytest.approx((1.0, 25.0))
    assert knee.highest.error == pytest.approx(4.0 / MASS)
    assert knee.highest.bwh == pytest.approx(100.0 / (9.81 * HEIGHT), rel=1e-3)
    assert numbers(by_cycle=False).highest.at == pytest.approx(1.25)
    assert (knee.change, knee.peak, knee.change_of_peak) == pytest.approx((0.1, 1.0, 10.0))
    assert knee.change_bwh == pytest.approx(10.0 / (9.81 * HEIGHT), rel=1e-3)


WALK_TIME = np.arange(0.0, 2.0, 0.01)
WAVE = np.sin(2 * np.pi * WALK_TIME)
ANGLES = np.radians(
    np.stack([-12.0 + 2.0 * WAVE, 5.0 * WAVE, 8.0 * np.cos(2 * np.pi * WALK_TIME)], axis=1)
)
"""Of a pelvis that walks along x: tilted forward by 12 deg."""
EXACT = 1e-9


def turned(angles: np.ndarray, by: np.ndarray | float) -> np.ndarray:
    """The same pelvis in a room that is turned to the left."""
    out: np.ndarray = (
        Rotation.from_euler("y", np.reshape(by, (-1, 1))) * Rotation.from_euler(AXES, angles)
    ).as_euler(AXES)
    return out


@given(st.floats(-np.pi, np.pi))
def test_angles_along_the_line_do_not_depend_on_the_direction_in_the_room(by: float) -> None:
    inside = np.ones(len(WALK_TIME), dtype=bool)
    np.testing.assert_allclose(
        express_along_line(turned(ANGLES, by), by, inside), ANGLES, atol=EXACT
    )
    # walking backwards: the feet go the other way, the pelvis is the same
    np.testing.assert_allclose(
        express_along_line(turned(ANGLES, by), by + np.pi, inside), ANGLES, atol=EXACT
    )


def test_a_line_across_the_room_makes_a_tilt_a_list() -> None:
    """What was wrong with angles against the room: 12 deg of forward tilt are list of who walks to
    the left.
    """
    against_room = np.degrees(turned(ANGLES, np.pi / 2))
    assert abs(against_room[:, 1]).mean() > 10.0
    assert np.degrees(turned(ANGLES, 0.0))[:, 1].mean() == pytest.approx(0.0, abs=0.1)


def test_gait_itself_is_no_turn_and_a_turn_is_one_whichever_way() -> None:
    straight = compute_facing(ANGLES)
    assert measure_turn(WALK_TIME, straight, 0.3, 1.3) == pytest.approx(0.0, abs=0.01)
    for sign in (-1.0, 1.0):
        faced = compute_facing(turned(ANGLES, sign * np.radians(200.0) * WALK_TIME))
        assert measure_turn(WALK_TIME, faced, 0.3, 1.3) == pytest.approx(sign * 200.0, abs=0.5)
        assert is_turning(measure_turn(WALK_TIME, faced, 0.3, 1.3))
    assert not is_turning(None) and not is_turning(TURNING) and is_turning(-TURNING - 0.1)


def test_progression_follows_coordinates_as_finite_differences_do() -> None:
    """Feet of every posture, steep ones too, against another line for each frame and foot."""
    model, random = published_model(), np.random.default_rng(3)
    q, lines = (
        0.3 * random.standard_normal((4, len(COORDINATES))),
        random.uniform(-np.pi, np.pi, (4, 2)),
    )

    def progression(at: Array) -> tuple[Array, Array]:
        motion = cast(Motion, SimpleNamespace(q=at, coordinates=COORDINATES))
        axes, moved = compute_foot_axes(motion, model.parameters, lines)
        return measure_out_of_plane(axes, lines)[0], moved

    _, moved = progression(q)
    for k, name in enumerate(COORDINATES):
        step = np.zeros(len(COORDINATES))
        step[k] = 1e-6
        expected = (progression(q + step)[0] - progression(q - step)[0]) / 2e-6
        np.testing.assert_allclose(moved[:, :, k], expected, atol=1e-8, err_msg=name)
    assert not moved[:, 0, [k for k, name in enumerate(COORDINATES) if name.endswith("_l")]].any()


def axis_to(heading: float, up: float = 0.0) -> Array:
    """Unit vector of that heading (rad to the left of x), raised by `up` (rad)."""
    flat = np.cos(up)
    return np.array([flat * np.cos(heading), np.sin(up), -flat * np.sin(heading)])


def test_toes_in_is_positive_on_both_sides_whatever_the_direction() -> None:
    """Both feet point 10 deg inwards of a walk to 120 deg: right to the left, left to the right;
    backwards, too.
    """
    for line in np.radians([0.0, 120.0, 179.0, -60.0]):
        inwards = np.stack([axis_to(line + np.radians(10.0)), axis_to(line - np.radians(10.0))])
        feet = FootAxes(np.tile(inwards, (5, 1, 1)))
        for along in (line, line + np.pi):
            for side in "rl":
                np.testing.assert_allclose(
                    np.degrees(feet.compute_progression(side, along)), 10.0, atol=1e-9
                )


def test_a_raised_heel_does_not_blow_progression_up_nor_its_error() -> None:
    """Toes 60 deg down, 5 deg out of the plane: 5 deg, of which the heading makes 10; a turn moves
    it by itself.
    """
    heading = np.arcsin(np.sin(np.radians(5.0)) / np.cos(np.radians(60.0)))
    u = axis_to(heading, -np.radians(60.0))
    off, about = measure_out_of_plane(u, 0.0)
    assert np.degrees(heading) > 10.0 and np.degrees(off) == pytest.approx(5.0)
    assert np.linalg.norm(about) == pytest.approx(1.0) and abs(about @ u) < EXACT


def test_axes_of_the_foot_err_about_what_moves_progression() -> None:
    """A flat foot: 3 deg about the vertical beside 4 by markers are 5; about the foot itself they
    are none.
    """
    flat, lines = np.tile(axis_to(0.0), (1, 2, 1)), np.zeros((1, 2))
    turned = {"foot_r": np.radians([[[0.0, 3.0, 0.0]]]), "foot_l": np.radians([[[3.0, 0.0, 0.0]]])}
    feet = _estimate_foot_axes(flat, lines, (np.full((1, 2), np.radians(4.0) ** 2),) * 2, turned)
    np.testing.assert_allclose(np.degrees(feet.error), [[5.0, 4.0]])
    np.testing.assert_allclose(np.degrees(feet.marker_error), 4.0)


def test_who_walks_forth_and_back_points_ahead_in_both_strides() -> None:
    """Three frames forth, two back, toes 10 deg in: the frames of a stride give its direction."""
    forth, back = axis_to(np.radians(10.0)), axis_to(np.pi + np.radians(10.0))
    feet = FootAxes(np.stack([[forth, forth]] * 3 + [[back, back]] * 2))
    returning = np.arange(5) >= 3
    np.testing.assert_allclose(
        np.degrees(feet.compute_progression("r", np.pi, returning))[returning], 10.0
    )


def test_each_frame_of_a_foot_has_the_line_of_its_stride() -> None:
    """Right strides of 0 to 1 s and 1 to 2 s; the left foot has none."""
    strides = [
        Stride(side="r", number=n, start=n, stop=n + 1.0, sources=(), measures={}, line=0.5 * n)
        for n in (0, 1)
    ]
    lines = assign_stride_lines(strides, np.array([-1.0, 0.9, 1.1, 5.0]))
    np.testing.assert_array_equal(lines, np.array([[0.0, 0.0, 0.5, 0.5]] * 2).T)
    assert not assign_stride_lines([], WALK_TIME).any()


FROM_VENDOR_DEG = 4.0
"""RMS over whole strides of four children is 1.7 to 3.3 (by the heading from above 2.1 to 11.5):
the room's axis counts there, and the centre of the ankle."""


@pytest.mark.slow
@pytest.mark.parametrize("person", ["HC002D", "HC032A"])
def test_foot_progression_is_the_vendors_over_the_whole_stride(person: str, data_dir: Path) -> None:
    study = study_of_person(person)
    model = build_nominal_model(study)
    trial = next(t for t in study.trials if t.name == "straight")
    prepared = prepare_trial(trial, model, study.settings)
    motion = track_motion(prepared.whole_body_problem, model.parameters)
    feet = FootAxes(compute_foot_axes(motion, model.parameters, np.zeros((len(motion.time), 2)))[0])
    points = dict(vendor_points(data_dir / "children" / person / "straight.c3d"))
    for side in "rl":
        ours, theirs = (
            np.degrees(feet.compute_progression(side, 0.0)),
            points[f"{side.upper()}FootProgressAngles"][:, 2],
        )
        strikes = [
            e.time
            for e in prepared.recording.events
            if e.side == side and e.moment is FootMoment.STRIKE
        ]
        whole = (motion.time >= strikes[0]) & (motion.time <= strikes[-1])
        assert np.sqrt(np.mean((ours - theirs)[whole] ** 2)) < FROM_VENDOR_DEG
        assert ours[whole].mean() < 2.0, "these children's toes point outwards or ahead"


def vendor_points(path: Path) -> Iterator[tuple[str, Array]]:
    """Label -> (nf, 3) of what the file has computed."""
    file = ezc3d.c3d(str(path))
    group = file["parameters"]["POINT"]
    labels = [
        label
        for name in ("LABELS", "LABELS2", "LABELS3")
        if name in group
        for label in group[name]["value"]
    ]
    for k, label in enumerate(labels):
        yield label.split(":")[-1].strip(), file["data"]["points"][:3, k].T
