"""Soft tissue artefact as people have it: sized by the task, with one scale for each person and kind of task.

A marker of a segment lies, in the segment's axes, at

    l + sum_c z_c psi_c(t),        psi_c = (phi_c - mean phi_c) / max(sd phi_c, 2 deg),

phi_c the angles of the joints beside the segment that the task moves, mean and sd over all trials of one kind of task
(gait, an activity, or the isolated trials of one joint), tracked with nominal joints and markers in their places, and
with them psi_c^2 less its mean where there is evidence. Each kind has unknowns z of its own; in gait knees are no
hinges besides.
All markers of a segment shift together, turn together about their middle, and move each by itself:

    z_c ~ N(0, s^2 Sigma),     Sigma = B diag(shift^2, turn^2) B^T + own^2 I,     B = [1, -(l - c) x] marker by marker.

What the markers do each by themselves is part rigid, (B^T B)^-1 B^T z_c, and part deformation, independent of it, which
turns and shifts no segment. A fit therefore has six unknowns a regressor and segment (`motion/soft_tissue.py`), of
covariance s^2 (diag(shift^2, turn^2) + own^2 (B^T B)^-1), and leaves the deformation among its residuals.

So the artefact has the size that people show *in the task*, whichever angle it goes with, and not so many millimetres a
degree: in gait hip adduction spans a tenth of what flexion does, and its pelvis is as soft. The sizes are those of bone
pins, fluoroscopy and magnetic resonance in walking (Leardini et al., Gait Posture 21:212-225, 2005; Peters et al., Gait
Posture 31:1-8, 2010; Barre et al., J Biomech 48:1965-1971, 2015; Camomilla et al., J Biomech 62:5-13, 2017).

How soft this person is, s, in gait and another one in all isolated trials, is learnt from how the markers of all
segments deform *together*, joints left out. What the rigid fit of a segment leaves of its markers, e, is

    e = P sum_c z_c psi_c + noise,     Q = sum_t psi psi^T (x) P / nu^2,     b = sum_t psi (x) P e / nu^2,
    2 log L_j(s_j) = b^T (Q + Sigma^-1 / s_j^2)^-1 b - log det(1 + s_j^2 Sigma Q),
    p(s) ~ N(ln s; 0, 0.7^2)  prod_j  int L_j(s_j) N(ln s_j; ln s, 0.7^2) d ln s_j,        j: segments,

P the projector that takes shifts and turns of a segment's markers out, nu the noise that no angle explains, its frames
counted as far as they are independent (`joint_prior.py`). Pooling is the point: a cluster that slides as a whole shows
no deformation itself, so that how far it slides follows the person's s and not the segment's s_j, and z has the
variance E[s^2] Sigma. That segments differ by a factor of two keeps one soft thigh from softening the feet: with the
same s for all, hips of people with quadratic artefacts came to 15 mm from the truth, with segments that differ to 8.
An activity that is no walk may leave joints at rest, whose tracked angles follow the errors of others: their segments
do not deform, with even odds before anything is seen, and then say nothing of s.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from gaitcal.arrays import Array
from gaitcal.calibration.joint_prior import LEAST_SAMPLES, frames_per_sample, least_noise
from gaitcal.model.linkage import BENDS, ISOLATED_JOINTS, JOINT_OF_CHILD, JOINTS, LEG_JOINTS, Source, segment_kind
from gaitcal.model.parameters import Parameters
from gaitcal.motion import motion, soft_tissue
from gaitcal.motion.rigid import FEWEST_MARKERS, rigid_fit
from gaitcal.motion.trial_problem import MotionProblem


@dataclass(frozen=True)
class ArtefactSize:
    """Standard deviations over a task, of each component."""

    shift: float  # m, of all markers together
    turn: float  # rad, of all markers together
    own: float  # m, of every marker by itself


SIZES: Mapping[str, ArtefactSize] = {
    "pelvis": ArtefactSize(2.0e-3, np.deg2rad(1.0), 0.7e-3),
    "thigh": ArtefactSize(3.0e-3, np.deg2rad(1.5), 1.0e-3),
    "shank": ArtefactSize(2.0e-3, np.deg2rad(1.0), 0.7e-3),
    "foot": ArtefactSize(1.0e-3, np.deg2rad(0.7), 0.5e-3),
}
"""Segments by the first word of their names."""
SECONDARY_SIZES: Mapping[str, float] = {
    "ant": 1.5e-3,
    "sup": 1.0e-3,
    "front": np.deg2rad(0.5),
    "trans": np.deg2rad(1.0),
}
"""m, rad: what a knee does besides flexing, RMS over a task of what goes with the square of its angle. Bone pins in
walking people showed some 10 mm and 10 degrees from end to end, less along the shank and in the frontal plane
(Lafortune et al., J Biomech 25:347-357, 1992; fluoroscopy: Kozanek et al., J Biomech 42:1877-1884, 2009); knees of
cadavers that flex by 60 degrees turn by 0.8 (trans) and 0.4 degrees (front) RMS with the square of it (polynomials of
Walker et al., J Biomech 21:965-974, 1988)."""
CUBE_SHARE = 0.25
"""Part of these sizes that goes with the cube. The same polynomials have 0.04 and less; walking adds load."""
LOG_SPREAD = 0.7  # Standard deviation of ln s among people: their sizes are known to a factor of two
SEGMENT_SPREAD = 0.7  # The same of ln s_j about ln s among the segments of a person
SCALES = np.geomspace(0.005, 4.0, 41)  # Values of s looked at
SQUARES = "^2"  # Ends the name of a regressor psi^2
GAIT = "gait"
"""Kind of task of a walk; that of isolated trials has their joint's name, that of any other activity its own."""
LEAST_SQUARES = 0.01
"""E[s^2] below which columns of squares would move next to nothing: markers by a tenth of what people show."""
TRUSTED = 0.5
"""Part of its own weight below which a loss let a marker go, and of the frames below which one is seldom seen, and left
aside where three others are seen more often."""
SEEN_RANK = 1e-9
"""Part of the largest diagonal entry of a QR factor below which an angle adds nothing to those before it."""


def beside(segment: str) -> tuple[str, ...]:
    """Coordinates of the joints of the legs at both ends of a segment: up to the next one that carries skin, which the
    talus does not.
    """
    above = JOINT_OF_CHILD.get(segment)
    near = {j.child for j in JOINTS if j.parent == segment} | ({above.parent} if above else set())
    ends = {segment, *(other for other in near if not segment_kind(other).markers)}
    joints = [j for j in JOINTS if j.name.startswith(LEG_JOINTS) and not ends.isdisjoint((j.parent, j.child))]
    return tuple(e.name for joint in joints for e in joint.elements if e.source is Source.COORDINATE)


def task_regressors(angles: Sequence[Mapping[str, Array]], *, squares: bool = False) -> list[dict[str, Array]]:
    """Per trial of one kind of task, coordinate -> (nf,) psi, from coordinate -> (nf,) rad."""
    names = dict.fromkeys(name for of_trial in angles for name in of_trial)
    out: list[dict[str, Array]] = [{} for _ in angles]
    for name in names:
        every = np.concatenate([of_trial[name] for of_trial in angles if name in of_trial])
        mean, spread = float(every.mean()), max(float(every.std()), soft_tissue.LEAST_SPREAD)
        square = float(np.mean(((every - mean) / spread) ** 2))
        for of_trial, own in zip(angles, out, strict=True):
            if name in of_trial:
                own[name] = psi = (of_trial[name] - mean) / spread
                if squares:
                    own[name + SQUARES] = psi**2 - square
    return out


def tissue_of(
    problem: MotionProblem,
    kind: str,
    regressors: Mapping[str, Array],
    known: Collection[str] | None = None,
    secondary: soft_tissue.SecondaryColumns | None = None,
) -> soft_tissue.SoftTissue | None:
    """The columns of the artefact on the markers of a trial, or those `known` of them, beside secondary motions; None
    where there are none. No skin moves points that are no markers.
    """
    groups = []
    for s, markers in problem.data.placed.groups if problem.noise is None else ():
        segment = problem.chain.segments[s]
        if segment.split("_")[0] not in SIZES or not (problem.data.weight[markers] > 0).any():
            continue
        near, local = beside(segment), problem.data.local[markers]
        names = tuple(name for name in regressors if name.removesuffix(SQUARES) in near)
        pulling = (problem.data.weight[markers] > 0).any(axis=1)
        if names:
            groups.append(
                soft_tissue.SegmentTissue(
                    segment=s,
                    carrier=segment,
                    markers=markers,
                    pattern=soft_tissue.together(local - local[pulling].mean(axis=0)),
                    names=tuple(f"{kind}/{name}" for name in names),
                    regressors=np.array([regressors[name] for name in names]),
                )
            )
    if known is not None:
        groups = [group for group in groups if set(soft_tissue.SoftTissue((group,)).keys) <= set(known)]
    return soft_tissue.SoftTissue(tuple(groups), secondary) if groups or secondary else None


def marker_covariance(segment: str, local: Array) -> Array:
    """(3 nm, 3 nm) m^2, Sigma of one regressor for markers at `local` (nm, 3) m."""
    size = SIZES[segment.split("_")[0]]
    rigid = soft_tissue.together(local - local.mean(axis=0)).reshape(-1, soft_tissue.WIDTH) * np.repeat(
        [size.shift, size.turn], 3
    )
    return rigid @ rigid.T + size.own**2 * np.eye(len(rigid))


def rigid_covariance(segment: str, pattern: Array) -> Array:
    """(6, 6) m^2, m rad, rad^2, of what markers with `pattern` (nm, 3, 6) do together."""
    size, flat = SIZES[segment.split("_")[0]], pattern.reshape(-1, soft_tissue.WIDTH)
    out: Array = np.diag(np.repeat([size.shift, size.turn], 3) ** 2)
    out += size.own**2 * np.linalg.pinv(flat.T @ flat, rcond=1e-6, hermitian=True)
    return out


@dataclass(frozen=True)
class SoftTissueScale:
    """What the deformation of all segments says of one person in one kind of task, as E[s^2]."""

    linear: float
    squares: float = 0.0

    def variance(self, regressor: str) -> float:
        """E[s^2] of the columns of a regressor."""
        return self.squares if regressor.endswith(SQUARES) else self.linear


def soft_tissue_scale(trials: Sequence[MotionProblem], *, possibly_still: bool = False) -> SoftTissueScale:
    """The scale of a person in one kind of task from trials whose soft tissue holds every column that may be.

    `possibly_still`: whether the task may leave joints at rest, whose tracked angles follow errors of others.
    """
    seen: dict[tuple[str, tuple[str, ...]], list[tuple[Sequence[str], Array, Array]]] = {}
    """Segment and its markers -> in every trial, regressors, Q and b by columns of unit variance."""
    for problem in trials:
        for group in problem.tissue.groups if problem.tissue else ():
            information, right = _deformation(problem, group)
            if information.any():
                root = np.linalg.cholesky(marker_covariance(group.carrier, problem.data.local[group.markers]))
                every = np.kron(np.eye(len(group.names)), root)
                parts = seen.setdefault((group.carrier, problem.labels[group.markers]), [])
                parts.append((group.names, every.T @ information @ every, every.T @ right))
    plain, bent = [], []
    for parts in seen.values():
        names, information, right = _together(parts)
        bends = np.repeat([name.endswith(SQUARES) for name in names], len(right) // len(names))
        linear, mixed = information[np.ix_(~bends, ~bends)], information[np.ix_(bends, ~bends)]
        plain.append((linear, right[~bends]))
        # what is left for the squares once the linear columns are integrated out, however large they may be
        inner = linear + np.eye(len(linear)) / SCALES[-1] ** 2
        left = np.linalg.solve(inner, np.column_stack([mixed.T, right[~bends]]))
        bent.append((information[np.ix_(bends, bends)] - mixed @ left[:, :-1], right[bends] - mixed @ left[:, -1]))
    squares_seen = any(len(right) for _, right in bent)
    squares = _mean_square(bent, possibly_none=True, possibly_still=possibly_still) if squares_seen else 0.0
    return SoftTissueScale(_mean_square(plain, possibly_still=possibly_still), squares)


def _together(parts: Sequence[tuple[Sequence[str], Array, Array]]) -> tuple[list[str], Array, Array]:
    """Regressors, and the sums of Q and b over them, of one segment in all its trials."""
    names = list(dict.fromkeys(name for own, _, _ in parts for name in own))
    width = len(parts[0][2]) // len(parts[0][0])
    information, right = np.zeros((width * len(names),) * 2), np.zeros(width * len(names))
    for own, of_trial, score in parts:
        place = np.concatenate([width * names.index(name) + np.arange(width) for name in own])
        information[np.ix_(place, place)] += of_trial
        right[place] += score
    return names, information, right


def _mean_square(
    parts: Sequence[tuple[Array, Array]], *, possibly_none: bool = False, possibly_still: bool = False
) -> float:
    """E[s^2] from Q and b of every segment, by columns of unit variance; if `possibly_none`, s is 0 with odds of one to
    one before anything is seen, if `possibly_still`, each s_j by itself.
    """
    place = np.log(SCALES)
    apart = -0.5 * ((place[:, None] - place) / SEGMENT_SPREAD) ** 2
    apart -= np.log(np.exp(apart).sum(axis=1, keepdims=True))
    """(s, s_j) log of the probability that a segment has s_j in a person who has s."""
    before = -0.5 * (place / LOG_SPREAD) ** 2
    log = before.copy()
    for information, right in parts:
        values, vectors = np.linalg.eigh(information)
        values, along = np.maximum(values, 0.0), (vectors.T @ right) ** 2
        square = SCALES[:, None] ** 2
        alone = 0.5 * (square * along / (1.0 + square * values) - np.log1p(square * values)).sum(axis=1)
        moved = logsumexp(apart + alone, axis=1)
        log += np.logaddexp(moved, 0.0) if possibly_still else moved
    top = max(float(log.max()), 0.0)
    weight, none = np.exp(log - top), float(np.exp(before).sum() * np.exp(-top)) if possibly_none else 0.0
    return float(weight @ SCALES**2) / (float(weight.sum()) + none)


def _deformation(problem: MotionProblem, group: soft_tissue.SegmentTissue) -> tuple[Array, Array]:
    """Q (n, n) 1/m^2 and b (n,) of one segment in one trial, regressor by regressor, of each marker by marker, x, y, z;
    from the markers that have weight in it. Zero where fewer than three show how they deform.
    """
    data, psi = problem.data, group.regressors
    width = 3 * (group.markers.stop - group.markers.start)
    nothing = np.zeros((len(psi) * width,) * 2), np.zeros(len(psi) * width)
    given = data.weight[group.markers]
    trusted = (given > 0) & (given > TRUSTED * given.max(axis=1, keepdims=True))
    often = trusted.sum(axis=1)
    third = np.sort(often)[-FEWEST_MARKERS] if len(often) >= FEWEST_MARKERS else 0
    used = group.markers.start + np.flatnonzero((often > 0) & (often >= min(third, TRUSTED * often.max(initial=0))))
    local, weight = data.local[used], data.weight[used]
    fit = rigid_fit(local, data.measured[used], weight)
    whole = fit.determined & trusted[used - group.markers.start].all(axis=0)
    """Frames that show all of them and trust them: in others the projector is another."""
    psi = psi[:, whole]
    if whole.sum() <= len(psi):
        return nothing
    followed = np.einsum("fij,mj->mif", fit.rotation, local) + fit.origin.T
    left = np.einsum("fij,mif->mjf", fit.rotation, data.measured[used] - followed)
    errors = left.reshape(3 * len(used), -1).T[whole]  # (frames, 3 used)
    errors = errors - errors.mean(axis=0)  # where a marker lies is not how it moves
    psi = psi - psi.mean(axis=1, keepdims=True)
    rigid = np.linalg.qr(soft_tissue.together(local - local.mean(axis=0)).reshape(-1, soft_tissue.WIDTH))[0]
    noise = _noise(errors, psi, 3 * len(used) - rigid.shape[1], least_noise(problem.basis, problem.noise))
    columns = (3 * (used - group.markers.start)[:, None] + np.arange(3)).ravel()
    projector, errors_of_group = np.zeros((width, width)), np.zeros((len(errors), width))
    projector[np.ix_(columns, columns)] = np.eye(len(columns)) - rigid @ rigid.T
    errors_of_group[:, columns] = errors
    information, right = np.kron(psi @ psi.T, projector), (psi @ errors_of_group @ projector).ravel()
    return np.asarray(information / noise**2, float), np.asarray(right / noise**2, float)


def _noise(errors: Array, psi: Array, directions: int, least: float) -> float:
    """m, nu of errors (nf, 3 nm) that no combination of the regressors (nr, nf) explains."""
    q, r = np.linalg.qr(psi.T)
    explained = q[:, np.abs(np.diag(r)) > SEEN_RANK * np.abs(r).max(initial=0.0)]
    unexplained = errors - explained @ (explained.T @ errors)
    tau = frames_per_sample(unexplained)
    samples = len(errors) / tau
    spent = samples / max(samples - explained.shape[1], LEAST_SAMPLES * samples)
    variance = spent * tau * float((unexplained**2).sum()) / (max(directions, 1) * len(errors))
    return max(float(np.sqrt(variance)), least)


@dataclass(frozen=True)
class TissuePrior:
    """The columns of all kinds of task, and how large they may be."""

    keys: tuple[str, ...]  # `kind/regressor/segment/component`
    covariance: Array  # (nz, nz) m^2, m rad, rad^2
    mean: Array  # (nz,) m, rad


NO_TISSUE = TissuePrior((), np.zeros((0, 0)), np.zeros(0))


def tissue_prior(trials: Sequence[MotionProblem], scales: Mapping[str, SoftTissueScale]) -> TissuePrior:
    """The prior of the columns that trials have; `scales` by kind of task."""
    blocks = dict[tuple[str, str], Array]()
    """(name of a regressor, segment) -> (6, 6)."""
    for problem in trials:
        for group in problem.tissue.groups if problem.tissue else ():
            own = rigid_covariance(group.carrier, group.pattern)
            for name in group.names:
                kind, _, regressor = name.partition("/")
                blocks.setdefault((name, group.carrier), scales[kind].variance(regressor) * own)
    keys = tuple(f"{name}/{segment}/{component}" for name, segment in blocks for component in soft_tissue.COMPONENTS)
    secondary = secondary_prior(trials)
    every = (*secondary.keys, *keys)
    return TissuePrior(every, block_diag(secondary.covariance, *blocks.values()), np.zeros(len(every)))


def secondary_prior(trials: Sequence[MotionProblem]) -> TissuePrior:
    """The prior of the secondary motions that trials have."""
    keys = tuple(dict.fromkeys(key for problem in trials if problem.secondary for key in problem.secondary.keys))
    square = f"/{BENDS[0]}/"
    sizes = [SECONDARY_SIZES[key.rpartition(".")[2]] * (1.0 if square in key else CUBE_SHARE) for key in keys]
    return TissuePrior(keys, np.diag(np.square(sizes)), np.zeros(len(keys)))


@dataclass(frozen=True)
class TaskTissue:
    """What may move the markers of each trial against their bones, and how far."""

    kinds: Mapping[str, str]  # Trial -> kind of task
    regressors: Mapping[str, Mapping[str, Array]]  # Trial -> coordinate -> (nf,) psi of the joints that its task moves
    scales: Mapping[str, SoftTissueScale]  # Kind of task -> how soft the person is there
    secondary: Mapping[str, soft_tissue.SecondaryColumns]  # Trial of gait -> what knees do besides flexing

    def of(
        self, name: str, problem: MotionProblem, known: Collection[str] | None = None
    ) -> soft_tissue.SoftTissue | None:
        """The columns of a trial on the markers of some part of the body, or those `known` of them."""
        return tissue_of(problem, self.kinds[name], self.regressors[name], known, secondary=self.secondary.get(name))

    def of_bodies(
        self, bodies: Mapping[str, MotionProblem], known: Collection[str]
    ) -> dict[str, soft_tissue.SoftTissue]:
        """Trial -> the columns `known` on the markers of the whole body; without those that have none."""
        found = {name: self.of(name, body, known) for name, body in bodies.items()}
        return {name: columns for name, columns in found.items() if columns is not None}


def task_tissue(kinds: Mapping[str, str], parts: Mapping[str, MotionProblem], nominal: Parameters) -> TaskTissue:
    """The soft tissue of trials, name -> kind of task, each by the part of the body that is fitted to it."""
    angles = {name: _angles(nominal, parts[name]) for name in kinds}
    regressors, scales = dict[str, Mapping[str, Array]](), dict[str, SoftTissueScale]()
    for kind in dict.fromkeys(kinds.values()):
        names = [name for name in kinds if kinds[name] == kind]
        regressors |= dict(zip(names, task_regressors([angles[n] for n in names], squares=True), strict=True))
    gait = [name for name in kinds if kinds[name] == GAIT]
    secondary = dict(zip(gait, soft_tissue.secondary_columns(GAIT, [angles[n] for n in gait]), strict=True))
    isolated = [name for name in kinds if kinds[name] in ISOLATED_JOINTS]
    for alike in (gait, isolated, *([name] for name in kinds if name not in (*gait, *isolated))):
        soft = [replace(parts[n], tissue=tissue_of(parts[n], kinds[n], regressors[n])) for n in alike]
        scale = soft_tissue_scale(soft, possibly_still=alike not in (gait, isolated))
        scales |= {kinds[name]: scale for name in alike}
        if scale.squares < LEAST_SQUARES:
            for n in alike:
                regressors[n] = {c: psi for c, psi in regressors[n].items() if not c.endswith(SQUARES)}
    return TaskTissue(kinds, regressors, scales, secondary)


def _angles(nominal: Parameters, part: MotionProblem) -> dict[str, Array]:
    """Coordinate -> (nf,) rad, of those that a marker of the trial shows."""
    q = motion.tracked_motion(part, nominal).q
    return {name: values for name, values, on in zip(part.chain.coordinates, q.T, part.active, strict=True) if on}


def tissue_of_walk(walk: MotionProblem, nominal: Parameters, known: Collection[str]) -> soft_tissue.SoftTissue | None:
    """The soft tissue and secondary motions of a walk that took no part in a calibration: those `known` of its walks
    (`kind/regressor/...`, of an `ErrorSources`), with the angles of this one.
    """
    angles = _angles(nominal, walk)
    (every,) = task_regressors([angles], squares=True)
    regressors = {name: psi for name, psi in every.items() if any(key.startswith(f"{GAIT}/{name}/") for key in known)}
    knees = {name: phi for name, phi in angles.items() if any(key.startswith(f"{GAIT}/{name}/^") for key in known)}
    (secondary,) = soft_tissue.secondary_columns(GAIT, [knees])
    return tissue_of(walk, GAIT, regressors, known, secondary if secondary.names else None)
