"""Recordings of a synthetic subject: C3D files, a study file, and the true values.

The subject is the nominal one of the published study, or one with joint and inertial parameters
drawn within the published bounds (10 mm, 10 degrees, 10 %). The static trial has no noise; the
nominal values that a calibration takes from it are wrong by the drawn amounts. True values are
given in the segment frames of the static trial's landmarks, as in a calibration.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import UsageError
from gaitcal.io import force_plate, result_folder
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.linkage import COORDINATE_INDEX, ISOLATED_JOINTS
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    ParameterKind,
    Parameters,
    is_physical,
    make_symmetric_set,
)
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings, PlateErrorTable
from gaitcal.study.study_file import Markers, StudyFile, SubjectTable, TrialTable
from gaitcal.synthetic import synthetic_motion as motions
from gaitcal.synthetic.movements import Activity, Contact, SyntheticMovement, simulate_movement
from gaitcal.synthetic.synthetic_truth import TRUTH, write_truth
from gaitcal.synthetic.walk import CLEARANCE

POSITION_BOUND = 0.010
ORIENTATION_BOUND = np.deg2rad(10.0)
INERTIAL_BOUND = 0.10
"""Bounds of drawn parameters: m, rad, share of the nominal value."""
PLATE_X, PLATE_Z = (-0.8, 2.8), 0.6
"""Ends and width (m) of two long plates side by side; that of the right foot is at z > 0."""
BELT_X = (-0.5, 5.0)
"""Ends (m) of the plate under all steps of a run."""
FOOTHOLD_X = 0.2
"""Half the length (m) of the plate under a foothold."""
EXACT_PLATES = PlateErrorTable(place_mm=0.0, turn_deg=0.0, gain_percent=0.0, clock_ms=0.0)
"""Plates without errors: synthetic ground reactions are exact."""


def make_synthetic_model(rng: np.random.Generator, *, perturb: bool) -> SubjectModel:
    """Make the nominal subject with its static-only markers, or one drawn within the bounds.

    `perturb`: whether to draw the parameters.
    """
    nominal = published_model(static_only=True)
    parameters = _perturb(nominal.parameters, rng) if perturb else nominal.parameters
    subject = Subject("synthetic", parameters.mass, nominal.subject.height, nominal.subject.sex)
    return replace(nominal, subject=subject, parameters=parameters)


def _perturb(nominal: Parameters, rng: np.random.Generator) -> Parameters:
    """Draw parameters within the bounds; inertial ones until all bodies are possible."""
    bounds = np.array(
        [
            POSITION_BOUND if p.kind is ParameterKind.POSITION else ORIENTATION_BOUND
            for p in JOINT_PARAMETERS
        ]
    )
    joint = nominal.joint + rng.uniform(-1.0, 1.0, len(bounds)) * bounds
    which = make_symmetric_set().selection
    while True:
        change = which @ rng.uniform(-INERTIAL_BOUND, INERTIAL_BOUND, which.shape[1])
        inertial = nominal.inertial * (1.0 + change)
        if is_physical(inertial).all():
            return Parameters(joint, inertial, nominal.zero_angles)


@with_one_blas_thread
def synthesize(
    out: Path | str,
    *,
    seed: int = 0,
    noise: bool = False,
    perturb: bool = False,
    also: Sequence[str] = (),
) -> Path:
    """Write a synthetic subject as a study folder: C3D files, `study.toml`, and true values.

    Parameters
    ----------
    out
        The folder, replaced if an earlier one is there.
    seed
        The same seed gives the same files.
    noise
        Add the paper's marker noise, up to 10 mm (`synthetic/synthetic_motion.py`); the static
        trial has none.
    perturb
        Draw the true parameters within 10 mm, 10 degrees and 10 %; else they are the published
        ones.
    also
        Further trials: squat, sit-to-stand, jump, run, stairs.

    Returns
    -------
    Path
        The study file.

    Raises
    ------
    InputError
        The folder cannot be written, or has files of another program.
    UsageError
        `also` has an unknown movement.
    """
    activities = [_parse_activity(name) for name in also]
    folder = Path(out)
    person, noise_waves = _make_generators(seed)
    model, tracking = (
        make_synthetic_model(person, perturb=perturb),
        published_model().markers.labels,
    )
    pose = motions.make_standing_pose(model.parameters)
    trials = {
        "static": motions.simulate_static_trial(standing=pose),
        **{j: motions.simulate_isolated_trial(j, pose) for j in ISOLATED_JOINTS},
    }
    trials["gait"] = motions.simulate_two_strides(model.parameters)
    movements = {
        activity.value: simulate_movement(activity, model.parameters) for activity in activities
    }
    trials |= {name: found.motion for name, found in movements.items()}
    with result_folder.write_result_folder(folder, result_folder.ResultKind.SYNTHETIC) as target:
        entries = []
        curves: dict[str, tuple[motions.TrueMotion, Array | None]] = {}
        for name, motion in trials.items():
            labels = model.markers.labels if name == "static" else tracking
            placed = place_on_floor(model, motion)
            ground = (
                None
                if placed.ground is None
                else motions.compute_ground_on_feet(model.parameters, placed)
            )
            plates = (
                ()
                if ground is None
                else place_foothold_plates(
                    movements.get(name, SyntheticMovement(motion=placed)), ground.wrench
                )
            )
            recording = record_motion(name, placed, model, labels, plates)
            if name != "static":
                curves[name] = placed, None if ground is None else ground.wrench
            if noise and name != "static":
                moved = recording.markers + motions.draw_marker_noise(
                    recording.time, len(labels), noise_waves
                )
                recording = replace(recording, markers=moved)
            write_c3d(target / f"{name}.c3d", recording)
            entries.append(_make_trial_entry(name))
        study = _make_study_file(model.subject, tuple(entries))
        (target / "study.toml").write_text(study.to_toml(), encoding="utf-8")
        write_truth(target, model, curves)
        made = {"gaitcal": "synthetic subject", "seed": seed, "noise": noise, "perturb": perturb}
        made |= {"movements": [*movements]} if movements else {}
        (target / result_folder.MANIFEST).write_text(
            json.dumps(made, indent=1) + "\n", encoding="utf-8"
        )
    return folder / "study.toml"


def _parse_activity(name: str) -> Activity:
    """Parse the name of a movement."""
    try:
        return Activity(name.replace("-", "_"))
    except ValueError:
        allowed = ", ".join(activity.value.replace("_", "-") for activity in Activity)
        raise UsageError(f"found '{name}'; allowed: {allowed}", field="--movement") from None


def make_true_gait(seed: int) -> tuple[Parameters, motions.TrueMotion]:
    """Make parameters and gait of the subject that `synthesize` writes with this seed, perturbed.

    Returns
    -------
    tuple of Parameters and TrueMotion
    """
    model = make_synthetic_model(_make_generators(seed)[0], perturb=True)
    return model.parameters, motions.simulate_two_strides(model.parameters)


def _make_generators(seed: int) -> list[np.random.Generator]:
    """Make the generators of the subject's parameters and of marker noise."""
    return [np.random.default_rng(stream) for stream in np.random.SeedSequence(seed).spawn(2)]


def place_on_floor(model: SubjectModel, motion: motions.TrueMotion) -> motions.TrueMotion:
    """Move a motion vertically so that the lowest foot marker is at its height in gait.

    `model`: subject with markers. `motion`: motion; one with known ground stays as it is.
    """
    if motion.ground is not None:
        return motion
    heights = motions.compute_synthetic_markers(model.parameters, model.markers, motion.q)[:, :, 1]
    feet = [s.startswith("foot") for s in model.markers.segments]
    coefficients = motion.coefficients.copy()
    coefficients[:, COORDINATE_INDEX["pelvis_ty"]] -= heights[:, feet].min() - CLEARANCE
    return motions.TrueMotion(motion.basis, coefficients)


def record_motion(
    name: str,
    motion: motions.TrueMotion,
    model: SubjectModel,
    labels: tuple[str, ...],
    plates: tuple[ForcePlate, ...] = (),
) -> Recording:
    """Record a motion.

    `name`: name of the recording. `model`: subject with markers. `labels`: markers to record.
    `plates`: plates with their forces. Returns: markers without noise, m.
    """
    positions = motions.compute_synthetic_markers(model.parameters, model.markers, motion.q)
    chosen = positions[:, [model.markers.labels.index(label) for label in labels]]
    return Recording(
        source=name, time=motion.basis.time, labels=labels, markers=chosen, plates=plates
    )


def place_long_plates(motion: motions.TrueMotion, wrench: Array) -> tuple[ForcePlate, ...]:
    """Place one long plate under each foot.

    `wrench`: (nf, 2, 6) N, N·m on right and left foot about the laboratory origin.
    """
    halves = ((0.0, PLATE_Z), (-PLATE_Z, 0.0))
    return tuple(
        _make_plate(k, motion.basis.time, wrench[:, k], PLATE_X, z, 0.0)
        for k, z in enumerate(halves)
    )


def place_foothold_plates(movement: SyntheticMovement, wrench: Array) -> tuple[ForcePlate, ...]:
    """Place plates: two long ones under a walk, one under a run, else one under each foothold.

    `wrench`: (nf, 2, 6) N, N·m on right and left foot about the laboratory origin.
    """
    time = movement.motion.basis.time
    if not movement.contacts:
        return place_long_plates(movement.motion, wrench)
    if movement.belt:
        return (_make_plate(0, time, wrench.sum(axis=1), BELT_X, (-PLATE_Z, PLATE_Z), 0.0),)
    by_foothold: dict[tuple[int, tuple[float, float, float]], list[Contact]] = {}
    for contact in movement.contacts:
        by_foothold.setdefault((contact.foot, contact.foothold), []).append(contact)
    plates = []
    for k, ((foot, (forward, height, right)), contacts) in enumerate(by_foothold.items()):
        loaded = np.any([(time >= c.start) & (time <= c.stop) for c in contacts], axis=0)
        sides = (0.0, PLATE_Z) if right > 0 else (-PLATE_Z, 0.0)
        ends = (forward - FOOTHOLD_X, forward + FOOTHOLD_X)
        load = np.where(loaded[:, None], wrench[:, foot], 0.0)
        plates.append(_make_plate(k, time, load, ends, sides, height))
    return tuple(plates)


def _make_plate(
    k: int,
    time: Array,
    wrench: Array,
    x: tuple[float, float],
    z: tuple[float, float],
    height: float,
) -> ForcePlate:
    """Make a plate between x and z (m) at a height (m) from its wrench (nf, 6) about the origin."""
    raised = wrench.copy()
    raised[:, 3:] -= np.cross([0.0, height, 0.0], wrench[:, :3])
    point, torque = force_plate.split_wrench(raised)
    corners = np.array(
        [[x[0], height, z[0]], [x[1], height, z[0]], [x[1], height, z[1]], [x[0], height, z[1]]]
    )
    lifted = point + [0.0, height, 0.0]
    return ForcePlate(
        name=str(k + 1),
        time=time,
        force=wrench[:, :3],
        point=lifted,
        moment=torque,
        corners=corners,
    )


def _make_trial_entry(name: str) -> TrialTable:
    """Make the entry of a trial in the study file."""
    file = Path(f"{name}.c3d")
    if name == "static":
        return TrialTable(name=name, role="static", file=file)
    if name == "gait":
        return TrialTable(name=name, role="gait", file=file, plates={"1": "r", "2": "l"})
    if name in ISOLATED_JOINTS:
        return TrialTable(name=name, role="joint", joint=name, file=file)  # type: ignore[arg-type]
    return TrialTable(name=name, role="motion", file=file)


def _make_study_file(subject: Subject, trials: tuple[TrialTable, ...]) -> StudyFile:
    """Make the study file: exact plates and segment axes, no force filter."""
    return StudyFile(
        subject=SubjectTable(
            name=subject.name,
            mass_kg=subject.mass,
            height_m=subject.height,
            sex=subject.sex,  # type: ignore[arg-type]
        ),
        markers=Markers(set="published"),
        trial=trials,
        calibration=CalibrationSettings(
            force_filter_hz="none", plate_error=EXACT_PLATES, segment_axes="exact"
        ),
        truth=TRUTH,
    )
