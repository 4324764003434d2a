"""What force plates err by, as torques of wrenches so changed, and what a plate that is taken away
leaves valid.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal import Study
from gaitcal.analysis.prepared_trials import compute_trial_reactions, prepare_trial
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.dynamics.measurement_errors import (
    ErrorSource,
    PlateErrors,
    TorqueErrors,
    compute_wrench_errors,
    compute_wrench_rates,
)
from gaitcal.errors import Severity
from gaitcal.io.force_plate import LOADED_N, compute_centre_on_ground, resample_wrench
from gaitcal.io.recording import Recording
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.quality import plate_checks
from gaitcal.quality.study_checks import check_study
from gaitcal.study.settings import PlateErrorTable
from gaitcal.study.study_trial import Role
from gaitcal.synthetic.synthetic_motion import compute_residual_free_wrench, simulate_gait
from gaitcal.tracking.motion import track_motion
from tests.derivatives import Array, perturbed_parameters

LINEAR = 1e-9
"""Forces are linear in wrenches: rounding."""
SECOND_ORDER = 0.02
"""Of the largest variance: what turns and clocks leave beyond what is linear in them."""


def walk() -> tuple[Dynamics, tuple[Array, Array, Array], Array, Array]:
    parameters, motion = perturbed_parameters(np.random.default_rng(61)), simulate_gait()
    state = tuple(motion.basis.evaluate(motion.coefficients, k) for k in range(3))
    return (
        Dynamics(parameters),
        state,
        compute_residual_free_wrench(parameters, motion),
        motion.basis.time,
    )  # type: ignore[return-value]


def turned(wrench: Array, angle: float) -> Array:
    """(nf, 6) a plate turned about the vertical through each centre of pressure, where
    one stands.
    """
    out = wrench.copy()
    on = wrench[:, 1] > LOADED_N
    point, rotation = compute_centre_on_ground(wrench[on]), Rotation.from_rotvec([0.0, angle, 0.0])
    free = wrench[on, 3:] - np.cross(point, wrench[on, :3])
    out[on, :3] = rotation.apply(wrench[on, :3])
    out[on, 3:] = np.cross(point, out[on, :3]) + rotation.apply(free)
    return out


def test_the_ground_s_part_is_what_forces_with_and_without_it_differ_by() -> None:
    dynamics, (q, v, a), wrench, _ = walk()
    with_it, without = (
        dynamics.compute_forces(q, v, a, w) for w in (wrench, np.zeros_like(wrench))
    )
    part = dynamics.compute_ground_forces(dynamics.place(q), wrench[..., None])[..., 0]
    np.testing.assert_allclose(part, with_it - without, rtol=0, atol=LINEAR * np.abs(part).max())
    assert np.abs(part).max() > 10.0


@pytest.mark.parametrize("which", ["position", "gain", "rotation", "time_offset"])
def test_each_part_is_what_plates_that_err_so_make_of_torques(which: str) -> None:
    """Wrenches changed as a laboratory would: moved, louder, turned, a little late; squares summed
    over both feet.
    """
    dynamics, (q, v, a), wrench, time = walk()
    size = {"position": 0.004, "gain": 0.02, "rotation": 0.002, "time_offset": 0.0005}[which]
    errors = PlateErrors(**{"position": 0.0, "gain": 0.0, "time_offset": 0.0, which: size})
    found = (
        dynamics.compute_ground_forces(
            dynamics.place(q),
            compute_wrench_errors(wrench, compute_wrench_rates(time, wrench), errors),
        )
        ** 2
    ).sum(axis=2)
    true, squares = dynamics.compute_forces(q, v, a, wrench), np.zeros((len(time), len(FORCES)))
    for other in changed(which, size, wrench, time):
        squares += (dynamics.compute_forces(q, v, a, other) - true) ** 2
    inner = slice(2, -2)  # at the ends of a trial a clock reaches beyond it
    np.testing.assert_allclose(
        found[inner], squares[inner], rtol=0, atol=SECOND_ORDER * squares.max()
    )


def changed(which: str, size: float, wrench: Array, time: Array) -> Iterator[Array]:
    if which == "time_offset":
        columns = wrench.reshape(len(time), -1).T
        late = [np.interp(time + size, time, c) - np.interp(time - size, time, c) for c in columns]
        yield wrench + 0.5 * np.column_stack(late).reshape(wrench.shape)
        return
    for foot in range(2):
        for axis in np.eye(3) if which == "position" else np.eye(1):
            other = wrench.copy()
            if which == "gain":
                other[:, foot] *= 1.0 + size
            elif which == "position":
                other[:, foot, 3:] += np.cross(size * axis, wrench[:, foot, :3])
            else:
                other[:, foot] = turned(wrench[:, foot], size)
            yield other


def test_sizes_are_those_of_the_study_in_SI() -> None:
    errors = PlateErrors.from_table(
        PlateErrorTable(place_mm=3.0, turn_deg=2.0, gain_percent=2.0, clock_ms=5.0)
    )
    assert (errors.position, errors.gain, errors.time_offset) == pytest.approx((0.003, 0.02, 0.005))
    assert errors.rotation == pytest.approx(np.deg2rad(2.0))
    assert errors.nonzero
    assert not PlateErrors.from_table(
        PlateErrorTable(place_mm=0.0, turn_deg=0.0, gain_percent=0.0, clock_ms=0.0)
    ).nonzero


def test_shares_are_parts_of_the_variance_over_valid_frames() -> None:
    rng = np.random.default_rng(63)
    by_source = {
        s: rng.uniform(0.0, 2.0, (30, len(FORCES)))
        for s in (ErrorSource.MOTION, ErrorSource.INERTIA, ErrorSource.PLATES)
    }
    by_source[ErrorSource.SKIN] = np.zeros((30, len(FORCES)))
    errors, valid = TorqueErrors.from_sources(by_source), rng.uniform(size=30) > 0.3
    np.testing.assert_allclose(errors.all_forces**2, sum(by_source.values()), rtol=1e-12)
    shares = errors.compute_shares(len(FORCES) - 1, valid)
    assert sum(shares.values()) == pytest.approx(1.0, abs=1e-12)
    assert ErrorSource.SKIN not in shares, "absent, never 0"
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    total = (errors.knee_adduction[valid, 1] ** 2).sum()
    assert shares[ErrorSource.PLATES] == pytest.approx(
        by_source[ErrorSource.PLATES][valid, -1].sum() / total
    )
    assert errors.compute_shares(3, np.zeros(30, dtype=bool)) == {}


MATTERS = 0.05
"""Of body weight. A strike or off of the file may miss the first or last frame in which a plate
reads.
"""
ASTRIDE = ("multi", "multi walk06")
"""A heel, and toes, that hang over from the next plate."""


@pytest.fixture
def study_of(data_dir: Path) -> Callable[[str], Study]:
    loaded: Callable[[str], Study] = import_module("scripts.validation.recordings").loaded
    return loaded


def without(recording: Recording, name: str) -> Recording:
    return replace(
        recording, plates=tuple(plate for plate in recording.plates if plate.name != name)
    )


@pytest.mark.parametrize(
    "name", [*ASTRIDE, *(pytest.param(n, marks=pytest.mark.slow) for n in ("child", "kad", "pig"))]
)
def test_what_a_missing_plate_bore_is_not_valid(
    study_of: Callable[[str], Study], name: str
) -> None:
    study = study_of(name)
    model = build_nominal_model(study)
    prepared = prepare_trial(
        next(t for t in study.trials if t.role is Role.GAIT), model, study.settings
    )
    motion = track_motion(prepared.whole_body_problem, model.parameters)
    recording = prepared.recording

    def reactions(of: Recording) -> GroundReactions:
        return compute_trial_reactions(
            replace(prepared, recording=of), model, model.parameters, motion, study.settings
        )

    asked = False
    for plate in recording.plates:
        bore = (
            np.nan_to_num(resample_wrench(plate, motion.time))[:, 1]
            > MATTERS * model.subject.weight
        )
        bore[1:-1] &= bore[:-2] & bore[2:]
        own = reactions(replace(recording, plates=(plate,))).loaded & bore[:, None]
        if own.any(axis=0).all():
            continue  # two feet on it, one after the other: which bore how much is not known
        asked |= bool(own.any())
        assert not (own & reactions(without(recording, plate.name)).valid_legs).any()
    assert asked


def test_a_missing_plate_accuses_no_mass(study_of: Callable[[str], Study]) -> None:
    """The heel of a foot stands on it while the rest of the foot is on the next one."""
    study = study_of("multi")
    spoilt = tuple(
        replace(t, recording=without(t.recording, "2")) if t.role is Role.GAIT else t
        for t in study.trials
    )
    study = replace(study, trials=spoilt)
    found = check_study(study)
    assert not [f for f in found if f.topic == "body mass" and f.severity is not Severity.INFO]


def test_a_body_is_not_weighed_while_a_heel_stands_beside_the_plate_that_it_is_about_to_load(
    study_of: Callable[[str], Study],
) -> None:
    """A heel bears 315 N of 525 on the plate that is missing, 40 ms before the next plate reads."""
    study = study_of("multi")
    spoilt = tuple(
        replace(t, recording=without(t.recording, "2")) for t in study.trials if t.role is Role.GAIT
    )
    missed, whole = (
        preprocess_study(replace(study, trials=(study.static, *t))).trials[-1]
        for t in (spoilt, study.trials[1:])
    )
    early = (missed.recording.time > 2.325) & (missed.recording.time < 2.365)
    for trial, weighed in ((missed, False), (whole, True)):
        feet = trial.feet
        assert (
            feet is not None
            and plate_checks._mark_fully_on_plates(trial, feet)[early].any() == weighed
        )
