"""Evidence of all trials: whose every error is, what each phase was fitted to, and what is said of
soft tissue.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gaitcal.calibration.error_sources import classify_source
from gaitcal.calibration.joint_estimate import BY_EVIDENCE
from gaitcal.calibration.joint_phases import (
    LEG_PARAMETERS,
    JointCalibration,
    JointProblem,
    calibrate_by_evidence,
)
from gaitcal.calibration.soft_tissue_artefact import (
    GAIT,
    SQUARES,
    compute_task_regressors,
    list_adjacent_coordinates,
)
from gaitcal.dynamics.measurement_errors import ErrorSource
from gaitcal.model.linkage import list_joint_segments
from gaitcal.model.parameters import JP_NAMES, Parameters
from gaitcal.tracking.trial_problem import MotionProblem
from tests.derivatives import perturbed_parameters, random_trial
from tests.soft_tissue import marker_covariance

WHITE = 0.001
"""m: noise of every marker."""


def soft_walk(seed: int, name: str, softness: float, bent: float = 0.0) -> MotionProblem:
    """A whole body that moves at random, on markers of `softness` times the soft tissue that people
    have, and of `bent` times it with the squares of angles.
    """
    rng = np.random.default_rng(seed)
    parameters = perturbed_parameters(rng, 0.0, 0.0)
    body, coefficients = random_trial(rng, parameters, frames=120, nodes=10)
    angles = dict(zip(body.chain.coordinates, body.basis.evaluate(coefficients).T, strict=True))
    (psi,) = compute_task_regressors([angles], squares=True)
    shift = np.zeros(body.data.measured.shape)
    for s, markers in body.data.placed.groups:
        for angle in list_adjacent_coordinates(segment := body.chain.segments[s]):
            for name_of_psi, size in ((angle, softness), (angle + SQUARES, bent)):
                covariance = size**2 * marker_covariance(segment, body.data.local[markers])
                moved = rng.multivariate_normal(np.zeros(len(covariance)), covariance)
                shift[markers] += moved.reshape(-1, 3, 1) * psi[name_of_psi]
    seen = body.shift_markers(shift).compute_positions(coefficients, body.build_body(parameters))
    return replace(body.with_measured(seen + rng.normal(0, WHITE, seen.shape)), name=name)


@cache
def calibrated(softness: float, bent: float = 0.0) -> JointCalibration:
    """A walk whose name is a word of our own, from nominal joints that are a little wrong."""
    walk = soft_walk(11, "nominal", softness, bent)
    return calibrate_by_evidence(
        [JointProblem(walk, walk, None)], nominal(), BY_EVIDENCE, ("r", "l")
    )


def nominal() -> Parameters:
    return perturbed_parameters(np.random.default_rng(12), 0.005, 0.03)


def test_every_column_of_influence_is_of_the_source_that_made_it() -> None:
    found = calibrated(1.0)
    by_source: dict[ErrorSource, set[str]] = {}
    for name in found.errors.sources:
        by_source.setdefault(classify_source(name), set()).add(name)
    assert len(set(found.errors.sources)) == len(found.errors.sources)
    # every joint parameter has its prior, of legs, trunk and arms alike
    assert by_source[ErrorSource.JOINT_NOMINAL] == {f"nominal/{name}" for name in JP_NAMES}
    assert {name.split("/")[0] for name in by_source[ErrorSource.SKIN]} == {"skin"}
    markers = {"/".join(name.split("/")[:2]) for name in by_source[ErrorSource.JOINT_MARKERS]}
    assert {"markers/nominal", "markers/nominal, trunk and arms"} <= markers
    assert all(name.startswith("markers/") for name in by_source[ErrorSource.JOINT_MARKERS])
    assert set(by_source) == {
        ErrorSource.JOINT_NOMINAL,
        ErrorSource.SKIN,
        ErrorSource.JOINT_MARKERS,
    }


def test_phases_name_the_recordings_and_tell_their_noise() -> None:
    legs, upper = calibrated(0.0).phases
    assert legs.trials == upper.trials == ("nominal",)
    assert set(legs.noise) == set(upper.noise) == {"nominal"}
    # white noise, whose tail of correlation at 100 Hz is floored at 0.25 s of the cameras' own
    assert upper.noise["nominal"] == pytest.approx(WHITE, rel=0.5)


def test_motions_have_the_soft_tissue_of_their_kind_with_markers_where_it_was_found() -> None:
    """Every kind of task with columns of its own; an isolated trial's on the segments of its joint
    alone.
    """
    walk, knee = soft_walk(11, "walk", 1.0), soft_walk(11, "bends", 0.2)
    segments = list_joint_segments("knee_r")
    trials = [
        JointProblem(knee, knee.extract_part(segments[0], segments), "knee_r"),
        JointProblem(walk, walk, None),
    ]
    found = calibrate_by_evidence(trials, nominal(), BY_EVIDENCE, ("r", "l"))
    assert set(found.tissue) == {"walk", "bends"}
    assert {group.carrier for group in found.tissue["bends"].groups} == set(segments)
    assert {key.split("/")[0] for key in found.tissue["walk"].keys} == {GAIT}
    assert {key.split("/")[0] for key in found.tissue["bends"].keys} == {"knee_r"}
    errors = found.errors
    knees = found.tissue["walk"].secondary
    assert knees is not None and found.tissue["bends"].secondary is None
    of_skin = {*found.tissue["walk"].keys, *found.tissue["bends"].keys}
    assert {*of_skin, *knees.keys} == set(errors.names) - set(JP_NAMES)
    tracked = set(found.artefact.values)
    assert tracked == {key for key in of_skin if key.split("/")[1].startswith("knee_angle")}
    column = errors.effects[:, errors.sources.index("skin/found")]
    others = {key for key, value in zip(errors.names, column, strict=True) if value}
    assert others and others <= {*of_skin, *knees.keys} - tracked, (
        "motions are tracked without these"
    )
    assert found.artefact.softness["knee_r"] < 0.5 * found.artefact.softness[GAIT] < 0.8
    body = replace(walk, tissue=found.tissue["walk"])
    z = np.array([found.artefact.values.get(key, 0.0) for key in body.tissue.keys])
    shift = found.artefact.displace_markers(body).data.shift
    np.testing.assert_array_equal(shift, body.tissue.compute_shift(z, len(body.labels)))
    assert (
        5e-4 < np.sqrt(np.mean(shift**2)) < 0.02 and found.artefact.displace_markers(walk) is walk
    )
    assert found.phases[0].parameters == len(LEG_PARAMETERS) + len(errors.names) - len(JP_NAMES)


def test_soft_markers_are_said_to_be_soft_and_stiff_ones_stiff() -> None:
    stiff, soft = (
        float(calibrated(s).notes[-1].split(f"{GAIT} ")[1].split()[0].strip(";,"))
        for s in (0.0, 1.0)
    )
    assert stiff < 0.2 < 0.5 < soft < 2.0


@pytest.mark.parametrize("bent", [0.0, 0.3])
def test_squares_of_angles_have_columns_where_markers_show_them(bent: float) -> None:
    found = calibrated(0.3, bent)
    squares = [key for key in found.tissue["nominal"].keys if SQUARES in key]
    assert bool(squares) is ("squares of angles" in found.notes[-1]) is bool(bent)
