"""Where the floor of the joints of tracked bones is: what an oracle reaches.

    bones --floor [--folder DIR] [--only NAME,...]

The nominal joint is refined by markers whose soft tissue is uncertain, so an error comes from one
of four places: the nominal joint, the prior of soft tissue, what the markers move against the bone,
or the joint itself, which is no hinge. One is taken away at a time:

nominal          the joint where the static trial has it
calibrated       as `bones`, with the prior of soft tissue of the other people
all people       the prior of all people, the person of the recording among them
the person       the prior learnt from the recordings of this very person alone
mean given       each marker moved back by its true slope against the angles of the joint
squares given    by its true slopes against the angles and their squares
bones            markers that never move against the bone

The last three are fitted without soft tissue, as there is none to fit, or none that the joint's
angles explain. The error is that of the axis or centre in the segment above: forward and up, and to
the right of hips (mm). `kept` is how much of a displacement of the nominal joint by `SHIFT_M` along
all these axes is left in the calibrated one: 1 where markers show nothing, 0 where landmarks do not
matter.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.calibration.soft_tissue_table import SkinTable
from gaitcal.model.parameters import JP_INDEX
from gaitcal.model.segment_frames import find_nearest_rotation
from scripts.validation.bones.fits import (
    DEFINED_M,
    NominalJoint,
    fit_recording,
    nominal_joint,
    parameters_of_axis,
    problem_of,
)
from scripts.validation.bones.learn import learn_table, person_of
from scripts.validation.bones.recordings import (
    BoneRecording,
    BoneSegment,
    find_true_hip,
    fit_hinge,
    hinge_errors,
)
from scripts.validation.harness import rms, side_by_side

SHIFT_M = 5e-3
"""By which the nominal joint is displaced: palpated epicondyles scatter by 4 mm."""
ORACLES = (
    "nominal",
    "calibrated",
    "all people",
    "the person",
    "mean given",
    "squares given",
    "bones",
)


@dataclass(frozen=True, kw_only=True)
class Floor:
    """What oracles reach in one recording."""

    name: str
    joint: str
    error_mm: Mapping[str, tuple[float, ...]]
    """Oracle -> error in the segment above: forward, up, and right of hips."""
    kept: tuple[float, ...]
    """Part of a displacement of the nominal joint that the calibrated one keeps, by axis."""


def compute_floor(
    recording: BoneRecording, others: SkinTable | None, person: SkinTable | None
) -> Floor | None:
    """Calibrate a recording with every oracle; None where its bones define no joint.

    Parameters
    ----------
    recording : BoneRecording
        Skin markers and bones.
    others, person : SkinTable or None
        Prior learnt from other people, and from this one; not for hips, which have none.
    """
    nominal = nominal_joint(recording)
    truth = find_true_place(recording, nominal)
    if not truth:
        return None
    names, true = list(truth), np.array(list(truth.values()))

    def place(joint: Array) -> Array:
        return np.array([joint[JP_INDEX[name]] for name in names])

    def calibrate(start: NominalJoint, table: SkinTable | None) -> Array:
        problem = problem_of(recording, start)
        fit = fit_recording(recording, start, problem, tissue=True, table=table)
        return place(fit.phase.estimate.parameters.joint)

    def calibrate_moved(moved: BoneRecording) -> Array:
        fit = fit_recording(moved, nominal, problem_of(moved, nominal), tissue=False)
        return place(fit.phase.estimate.parameters.joint)

    found = {
        "nominal": place(nominal.model.nominal.joint),
        "calibrated": calibrate(nominal, others),
        "mean given": calibrate_moved(move_back(recording, nominal, squares=False)),
        "squares given": calibrate_moved(move_back(recording, nominal, squares=True)),
        "bones": calibrate_moved(move_back(recording, nominal, still=True)),
    }
    if person:
        found |= {"all people": calibrate(nominal, None), "the person": calibrate(nominal, person)}
    displacement = np.where(np.arange(3) < len(names), SHIFT_M, 0.0)
    displaced = calibrate(displace_nominal(recording, nominal, displacement), others)
    kept = (displaced - found["calibrated"]) / SHIFT_M
    return Floor(
        name=recording.name,
        joint=nominal.joint,
        error_mm={
            oracle: tuple((1e3 * (found[oracle] - true)).tolist())
            for oracle in ORACLES
            if oracle in found
        },
        kept=tuple(kept.tolist()),
    )


def compute_floors(
    recordings: Sequence[BoneRecording], people: Sequence[BoneRecording], jobs: int
) -> list[Floor | None]:
    """Calibrate recordings with every oracle; `people`: all recordings of tracked bones."""
    others, alone = dict[str, SkinTable](), dict[str, SkinTable]()
    for recording in recordings:
        person = person_of(recording)
        if person in others or recording.has("pelvis", "thigh"):
            continue
        others[person] = learn_table(people, without=person)
        alone[person] = learn_table([r for r in people if person_of(r) == person])
    tasks = [
        partial(compute_floor, r, others.get(person_of(r)), alone.get(person_of(r)))
        for r in recordings
    ]
    return list(side_by_side(tasks, jobs))


def find_true_place(recording: BoneRecording, nominal: NominalJoint) -> dict[str, float]:
    """The joint's place in the segment above, by parameter (m); none where bones define none."""
    if nominal.joint == "hip_r":
        centre = nominal.frames["pelvis"].local(find_true_hip(recording)[0])
        names = [f"hip_r.pelvis.{d}" for d in ("ant", "sup", "lat")]
        return dict(zip(names, centre.tolist(), strict=True))
    thigh, shank = recording.segments["thigh"], recording.segments["shank"]
    if hinge_errors(thigh, shank)[0] > DEFINED_M:
        return {}
    axis = parameters_of_axis(nominal, fit_hinge(thigh, shank))
    return {name: axis[name] for name in ("knee_r.thigh.ant", "knee_r.thigh.sup")}


def move_back(
    recording: BoneRecording, nominal: NominalJoint, *, squares: bool = False, still: bool = False
) -> BoneRecording:
    """The recording with markers moved back by what the angles of the joint explain.

    Parameters
    ----------
    recording : BoneRecording
        Markers in the axes of their bones.
    nominal : NominalJoint
        Its joint.
    squares : bool
        Whether the products of the angles explain motion, too.
    still : bool
        Whether all motion is taken away.
    """
    above, below = nominal.above, nominal.below
    standing = recording.standing(above, below)
    if nominal.joint == "hip_r":
        turn = Rotation.from_matrix(recording.relative(above, below))
        psi = (turn[standing].mean().inv() * turn).as_rotvec()
    else:
        flexion = recording.knee_flexion
        psi = (flexion - flexion[standing].mean())[:, None]
    if squares:
        first, second = np.triu_indices(psi.shape[1])
        psi = np.hstack([psi, psi[:, first] * psi[:, second]])
    segments = dict[str, BoneSegment]()
    for name, bone in recording.segments.items():
        moved = bone.markers - bone.markers[standing].mean(axis=0)
        flat = moved.reshape(len(moved), -1)
        explained = moved
        if not still:
            slopes = np.linalg.lstsq(psi, flat, rcond=1e-9)[0]
            explained = (psi @ slopes).reshape(moved.shape)
        segments[name] = replace(bone, markers=bone.markers - explained)
    return replace(recording, segments=segments)


def displace_nominal(
    recording: BoneRecording, nominal: NominalJoint, displacement: Array
) -> NominalJoint:
    """The nominal joint displaced by (3,) m in the segment above, and with it in that below."""
    above, below = nominal.frames[nominal.above], nominal.frames[nominal.below]
    standing = recording.standing(nominal.above, nominal.below)
    turn = find_nearest_rotation(
        recording.relative(nominal.above, nominal.below)[standing].mean(axis=0)
    )
    lower = below.rotation.T @ turn.T @ above.rotation @ displacement
    values = dict[str, float]()
    for name, moved in ((nominal.segments[0], displacement), (nominal.segments[1], lower)):
        for direction, step in zip(("ant", "sup", "lat"), moved, strict=True):
            key = f"{nominal.joint}.{name.partition('_')[0]}.{direction}"
            if key in JP_INDEX:
                values[key] = float(nominal.model.nominal.joint[JP_INDEX[key]] + step)
    parameters = nominal.model.nominal.with_joint(tuple(values), np.array(list(values.values())))
    return replace(nominal, model=replace(nominal.model, parameters=parameters, nominal=parameters))


def floor_lines(floors: Sequence[Floor | None]) -> Iterator[str]:
    """Table of errors in mm, then RMS of the distances."""
    for joint, axes in (("knee_r", "forward, up"), ("hip_r", "forward, up, right")):
        of_joint = [floor for floor in floors if floor is not None and floor.joint == joint]
        if not of_joint:
            continue
        heads = "".join(f"{oracle:>20}" for oracle in ORACLES)
        yield f"{joint[:-2] + ', mm: ' + axes:26}{heads}   kept"
        for floor in of_joint:
            cells = "".join(f"{_cell(floor, oracle):>20}" for oracle in ORACLES)
            yield f"{floor.name:26}{cells}   {' '.join(f'{part:.2f}' for part in floor.kept)}"
        distances = []
        for oracle in ORACLES:
            known = [f.error_mm[oracle] for f in of_joint if oracle in f.error_mm]
            distances.append(f"{rms([np.linalg.norm(e) for e in known]):.1f}" if known else "")
        yield f"{'RMS of distances':26}" + "".join(f"{cell:>20}" for cell in distances)


def _cell(floor: Floor, oracle: str) -> str:
    return " ".join(f"{x:5.1f}" for x in floor.error_mm.get(oracle, ()))
