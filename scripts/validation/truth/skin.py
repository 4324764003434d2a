"""Markers that do not stay where they are: five kinds of skin movement, all of them together, and
skin as people's is.

Marker m of a segment is displaced in the frame of its own bone, with size e (mm; tables for 15 mm),
by

    d_m(t) = sum_j e s_j (f_j(t) a_j + g_mj(t) b_mj) + e f_h(t) w x (r_m - r)

j the joints beside the segment; s_j mm of the table; a_j a unit vector shared by the cluster, b_mj
of the marker alone, half as long in the mean square; the thigh's cluster also turns about the
random vector w (5 deg a component) through its centroid r. All directions belong to the person
(seed): the same in every trial.

    linear     f = g = u, the joint's flexion from the static pose / 60 deg
    quadratic  f = g = u^2
    random     f, g independent smooth Gaussian processes (RMS frequency 1 Hz, SD 0.5: the RMS of u
               in the hip's trial), new in every trial, one of its own for each cluster and joint,
               and marker and joint
    bursts     f = g = decaying waves of 5 to 10 Hz (memory 0.15 s), begun about once a second, new
               in every trial
    sinusoids  no skin: as published, A sin(w t + p) for each coordinate of every marker and trial;
               A up to e, w up to 25 rad/s, p random
    mixture    half of each of the five

People's skin is sized by what it does in a *task* (walk, isolated trial of a joint), whichever
angle it goes with. With phi an angle of a joint beside the segment less its mean in the trial, over
its standard deviation there (or 2 deg),

    d_m(t) = sum_phi phi(t) (shift + turn x (r_m - r) + own_m),

normally distributed with the standard deviations of `TASK` a component, drawn for each person,
task, segment and angle: hips have three angles (the pelvis both hips'), the knee one, the ankle
two.

    people     only that, the same in every trial of a task
    restless   that, and as much as one angle's by random in time (1 Hz), new in every trial

The static trial is never touched, and displacements by joint angles are zero in its posture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal import Study
from gaitcal.arrays import Array
from gaitcal.io.recording import Recording
from gaitcal.model.segment_frames import fit_rigid_motions
from gaitcal.synthetic.synthetic_motion import draw_marker_noise

TABLE_MM = 15.0
SIZES = {
    "thigh": {"hip": 15.0, "knee": 10.0},
    "shank": {"knee": 6.0, "ankle": 3.0},
    "pelvis": {"hip": 4.0},
}
"""Segment -> joint -> mm per 60 deg, at a size of 15 mm."""
TURN = np.deg2rad(5.0)
"""SD of a component of the turn of a thigh's cluster per 60 deg of hip flexion, at 15 mm."""
JOINTS = ("hip", "knee", "ankle")
RANDOM_SD, RANDOM_HZ = 0.5, 1.0
BURST_HZ, BURST_MEMORY, BURST_EVERY = (5.0, 10.0), 0.15, (0.8, 1.2)
SHARE = 0.5
"""Of each kind in the mixture."""


class Kind(Enum):
    NONE = "none"
    LINEAR = "linear"
    QUADRATIC = "quadratic"
    RANDOM = "random"
    BURSTS = "bursts"
    SINUSOIDS = "sinusoids"
    MIXTURE = "mixture"
    PEOPLE = "people"
    RESTLESS = "restless"


FIVE = (Kind.LINEAR, Kind.QUADRATIC, Kind.RANDOM, Kind.BURSTS, Kind.SINUSOIDS)
OF_PEOPLE = (Kind.PEOPLE, Kind.RESTLESS)
TASK = {
    "pelvis": (2.0, 1.0, 0.7),
    "thigh": (3.0, 1.5, 1.0),
    "shank": (2.0, 1.0, 0.7),
    "foot": (1.0, 0.7, 0.5),
}
"""Segment -> RMS over a task for each angle beside it: shift mm, turn deg, every marker by itself
mm.
"""
LEAST_ANGLE = np.deg2rad(2.0)
"""rad: an angle that varies less moves the skin less."""


@dataclass(frozen=True, kw_only=True)
class Cluster:
    segment: str
    markers: tuple[int, ...]
    """Columns of the recording."""
    rest: Array
    """(n, 3) m in the static trial."""
    rotation: Array
    """(nf, 3, 3) from the static pose."""


@dataclass(frozen=True)
class Law:
    """How the markers of a segment answer to its joints; mm at the size of the table."""

    shared: Mapping[str, Array]
    """Joint -> (3,)."""
    own: Mapping[str, Array]
    """Joint -> (n, 3)."""
    turn: Array
    """(3,) rad per unit of the hip's function; zero but for thighs."""


def disturbed(study: Study, kind: Kind, size_mm: float, seed: int) -> Study:
    """The same person with markers that move so in every trial but the static one."""
    if kind is Kind.NONE or size_mm == 0:
        return study
    static = study.static.recording
    rest = dict(zip(static.labels, static.markers.mean(axis=0), strict=True))
    trials = []
    for number, trial in enumerate(study.trials):
        if trial is not study.static:
            marks, task = study.marker_set.tracking, trial.joint or "walk"
            move = displacement(trial.recording, rest, marks, kind, size_mm, (seed, number), task)
            recording = replace(trial.recording, markers=trial.recording.markers + move)
            trial = replace(trial, recording=recording)
        trials.append(trial)
    return replace(study, trials=tuple(trials))


def displacement(
    recording: Recording,
    rest: Mapping[str, Array],
    tracking: Mapping[str, tuple[str, ...]],
    kind: Kind,
    size_mm: float,
    seed: tuple[int, int],
    task: str = "walk",
) -> Array:
    """(nf, nm, 3) m of every marker; `rest`: label -> (3,) m, static trial; `seed`: of the person
    and of the trial.
    """
    if kind in OF_PEOPLE:
        return (
            size_mm
            / TABLE_MM
            * of_people(recording, clusters_of(recording, rest, tracking), kind, seed, task)
        )
    if kind is Kind.MIXTURE:
        parts = [
            displacement(recording, rest, tracking, part, SHARE * size_mm, seed) for part in FIVE
        ]
        return np.asarray(np.sum(parts, axis=0))
    own = np.random.default_rng([*seed, list(Kind).index(kind)])
    if kind is Kind.SINUSOIDS:
        waves = np.random.default_rng(seed)
        return draw_marker_noise(recording.time, recording.markers.shape[1], waves, 1e-3 * size_mm)
    out = np.zeros_like(recording.markers)
    person = np.random.default_rng([seed[0], 99])
    clusters = clusters_of(recording, rest, tracking)
    bursts = burst_times(recording.time, own)
    for side in "rl":
        angles = joint_angles(clusters, side)
        for part, sizes in SIZES.items():
            name = part if part == "pelvis" else f"{part}_{side}"
            cluster = clusters[name]
            law = draw_law(person, cluster, sizes)
            moved = np.zeros((len(recording.time), len(cluster.markers), 3))
            arms = cluster.rest - cluster.rest.mean(axis=0)
            for joint in sizes:
                shared, single = functions(
                    kind, angles[joint], recording.time, len(cluster.markers), bursts, own
                )
                moved += (
                    shared[:, None, None] * law.shared[joint] + single[:, :, None] * law.own[joint]
                )
                if joint == "hip":
                    moved += 1e3 * shared[:, None, None] * np.cross(law.turn, arms)
            lab = np.einsum("fij,fmj->fmi", cluster.rotation, moved)
            out[:, list(cluster.markers)] += 1e-3 * size_mm / TABLE_MM * lab
    return out


def of_people(
    recording: Recording,
    clusters: Mapping[str, Cluster],
    kind: Kind,
    seed: tuple[int, int],
    task: str,
) -> Array:
    """(nf, nm, 3) m: skin whose size is that of the task."""
    out = np.zeros_like(recording.markers)
    angles = task_angles(clusters)
    for number, (segment, cluster) in enumerate(clusters.items()):
        arms = cluster.rest - cluster.rest.mean(axis=0)
        phi = np.hstack([a for joint, a in angles.items() if segment in beside(joint)])
        phi = (phi - phi.mean(axis=0)) / np.maximum(phi.std(axis=0), LEAST_ANGLE)
        rng = np.random.default_rng([seed[0], 98, number, *task.encode()])
        moved = np.einsum(
            "fa,ami->fmi",
            phi,
            _rigid(rng.normal(size=(phi.shape[1], 6 + arms.size)), segment, arms),
        )
        if kind is Kind.RESTLESS:
            restless = smooth_noise(
                recording.time, 6 + arms.size, np.random.default_rng([*seed, 97, number])
            )
            moved += _rigid(restless, segment, arms)
        out[:, list(cluster.markers)] += np.einsum("fij,fmj->fmi", cluster.rotation, moved)
    return out


def _rigid(unit: Array, segment: str, arms: Array) -> Array:
    """(k, n, 3) m of a segment's markers by k sets of standard deviations: shift, turn, every
    marker by itself.
    """
    shift, turn, own = TASK[segment.split("_")[0]]
    turned = np.cross(np.deg2rad(turn) * unit[:, None, 3:6], arms)
    return np.asarray(
        1e-3 * shift * unit[:, None, :3]
        + turned
        + 1e-3 * own * unit[:, 6:].reshape(-1, *arms.shape)
    )


def beside(joint: str) -> tuple[str, ...]:
    """The segments that a joint (`hip_r`) moves against each other."""
    name, side = joint.split("_")
    return {
        "hip": ("pelvis", f"thigh_{side}"),
        "knee": (f"thigh_{side}", f"shank_{side}"),
        "ankle": (f"shank_{side}", f"foot_{side}"),
    }[name]


def task_angles(clusters: Mapping[str, Cluster]) -> dict[str, Array]:
    """`hip_r`, ... -> (nf, 3, 1 or 2) rad: turns from the static pose about the axes that the joint
    has.
    """
    axes = {"hip": [0, 1, 2], "knee": [2], "ankle": [0, 2]}
    out = {}
    for joint in (f"{name}_{side}" for name in axes for side in "rl"):
        above, below = beside(joint)
        turn = np.swapaxes(clusters[above].rotation, 1, 2) @ clusters[below].rotation
        out[joint] = Rotation.from_matrix(turn).as_rotvec()[:, axes[joint.split("_")[0]]]
    return out


def draw_law(rng: np.random.Generator, cluster: Cluster, sizes: Mapping[str, float]) -> Law:
    """The answer of a segment's markers, the same in every trial that draws it in the
    same order.
    """
    drawn = {joint: rng.normal(size=3) for joint in JOINTS}
    turn = rng.normal(size=3) * TURN
    single = np.array(
        [[rng.normal(size=3) / np.sqrt(3) / 2 for _ in JOINTS] for _ in cluster.markers]
    )
    shared = {
        joint: mm * drawn[joint] / np.linalg.norm(drawn[joint]) for joint, mm in sizes.items()
    }
    own = {joint: mm * single[:, JOINTS.index(joint)] for joint, mm in sizes.items()}
    return Law(shared, own, turn if cluster.segment.startswith("thigh") else np.zeros(3))


def functions(
    kind: Kind, angle: Array, time: Array, markers: int, bursts: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """F (nf,) and g (nf, markers) of one joint, whose `angle` (nf,) is in units of 60 deg."""
    if kind is Kind.RANDOM:
        both = RANDOM_SD * smooth_noise(time, 1 + markers, rng)
        return both[:, 0], both[:, 1:]
    f = {Kind.LINEAR: angle, Kind.QUADRATIC: angle**2}.get(kind)
    if f is None:
        f = burst_wave(time, bursts, rng)
    return f, np.repeat(f[:, None], markers, axis=1)


def smooth_noise(time: Array, count: int, rng: np.random.Generator) -> Array:
    """(nf, count) Gaussian processes of unit variance, cov = exp(-(2 pi f t)^2 / 2): sums of 200
    random waves.
    """
    waves = 200
    omega = 2 * np.pi * RANDOM_HZ * rng.normal(size=(waves, count))
    phase = rng.uniform(0, 2 * np.pi, (waves, count))
    out: Array = np.sqrt(2 / waves) * np.cos(time[:, None, None] * omega + phase).sum(axis=1)
    return out


def burst_times(time: Array, rng: np.random.Generator) -> Array:
    gaps = rng.uniform(*BURST_EVERY, int((time[-1] - time[0]) / BURST_EVERY[0]) + 2)
    starts: Array = time[0] - rng.uniform(0, BURST_EVERY[0]) + np.cumsum(gaps) - gaps[0]
    return starts


def burst_wave(time: Array, starts: Array, rng: np.random.Generator) -> Array:
    """(nf,) a decaying wave after each start."""
    out = np.zeros(len(time))
    frequency = rng.uniform(*BURST_HZ)
    for start in starts:
        since = np.maximum(time - start, 0.0)
        out += np.sin(2 * np.pi * frequency * since) * np.exp(-since / BURST_MEMORY)
    return out


def clusters_of(
    recording: Recording, rest: Mapping[str, Array], tracking: Mapping[str, tuple[str, ...]]
) -> dict[str, Cluster]:
    column = {label: i for i, label in enumerate(recording.labels)}
    out = {}
    for segment, labels in tracking.items():
        if segment.split("_")[0] in ("pelvis", "thigh", "shank", "foot"):
            markers, at = (
                tuple(column[label] for label in labels),
                np.array([rest[label] for label in labels]),
            )
            rotation, _ = fit_rigid_motions(at, recording.markers[:, list(markers)])
            out[segment] = Cluster(segment=segment, markers=markers, rest=at, rotation=rotation)
    return out


def joint_angles(clusters: Mapping[str, Cluster], side: str) -> dict[str, Array]:
    """Joint -> (nf,) flexion from the static pose in units of 60 deg; x forward, z right in the
    static trial.
    """
    chain = ("pelvis", f"thigh_{side}", f"shank_{side}", f"foot_{side}")
    out = {}
    for joint, above, below, sign in zip(
        JOINTS, chain[:-1], chain[1:], (1.0, -1.0, 1.0), strict=True
    ):
        turn = np.swapaxes(clusters[above].rotation, 1, 2) @ clusters[below].rotation
        out[joint] = sign * np.arctan2(turn[:, 1, 0], turn[:, 0, 0]) / np.deg2rad(60.0)
    return out
