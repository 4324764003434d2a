"""Soft tissue artefact of people, with one scale for each person and kind of task.

Tracked bones give its mean and size for knee flexion; the task gives its size for other angles. The
position of a marker in the axes of its segment is

    l + sum_c z_c psi_c(t),        psi_c = (phi_c - phi_c of the static posture) / u_c,

phi_c the angles of the joints beside the segment that the task moves, tracked with nominal joints
and markers in their places. The places l are those of the static trial, so there the artefact is
zero by definition; a walk's mean knee angle is 20 to 30 degrees from standing, and an artefact of
mean zero over the walk leaves that part to the joints. With psi_c goes its square where there is
evidence. Each kind of task has separate unknowns z (gait, an activity, or the isolated trials of
one joint); in gait knees are no hinges besides.

Knee flexion moves thigh and shank. There u_c is one radian, and z_c is s times the artefact of
tracked bones (`soft_tissue_table.py`): a mean that depends on the position of the marker, and a
covariance about it.

For all other angles u_c is the RMS of phi_c - phi_c(static) in all trials of the kind (at least 2
deg), the mean is zero, all markers of a segment shift together, turn together about their middle,
and move each by itself:

    z_c ~ N(0, s^2 Sigma),   Sigma = B diag(shift^2, turn^2) B^T + per_marker^2 I,
    B = [1, -(l - c) x] for each marker,

z_c has a rigid part, (B^T B)^-1 B^T z_c, and a deformation, which neither rotates nor translates a
segment. Markers show the deformation independently of the joints, so z is conditioned on it first.
With Q and b as below, V the covariance of z at this person's s and m its mean,

    z | deformation ~ N(m + C (b - Q m), C),        C = (V^-1 + Q)^-1.

A fit displaces the markers by the deformation of that mean, in axes that rotate with the cluster.
It has six further unknowns for each regressor and segment (`tracking/soft_tissue.py`), with the
rigid part of that mean and covariance as their prior. A wrong deformation would strain the linkage:
it displaced hips of children by 8 mm.

The artefact of an angle has a size in the task, not in millimetres per degree. In gait, hip
adduction has a tenth of the range of flexion, and the pelvis is as soft with it. The sizes are from
bone pins, fluoroscopy and magnetic resonance in walking
(Leardini et al., Gait Posture 21:212-225, 2005; Peters et al., Gait Posture 31:1-8, 2010; Barre et
al., J Biomech 48:1965-1971, 2015; Camomilla et al., J Biomech 62:5-13, 2017).

The softness s of the person, one in gait and another one in all isolated trials, is estimated from
the deformation of all segments *together*, without joints. The residuals e of a rigid fit of a
segment are

    e = P sum_c z_c psi_c + noise,
    Q = sum_t psi psi^T (x) P / nu^2,     b = sum_t psi (x) P e / nu^2,
    2 log L_j(s) = c^T (Q + Sigma^-1 / s^2)^-1 c - log det(1 + s^2 Sigma Q)
                  + 2 s mu^T b - s^2 mu^T Q mu,
    c = b - s Q mu,     mu the mean of z at s = 1,
    p(s) ~ N(ln s; 0, 0.7^2)  prod_j  int L_j(s_j) N(ln s_j; ln s, 0.7^2) d ln s_j,
           j: segments,

P is the projector that removes translations and rotations of a segment's markers. nu is the noise
that no angle explains, with frames counted as far as they are independent (`trial_noise.py`). A
cluster that slides as a whole shows no deformation, so its sliding depends on the person's s, not
on the segment's s_j. With q = min(E[s], 1) and r = min(E[s^2], 1), z has the mean q mu and the
covariance E[s^2] Sigma + (r - q^2 + 0.7^2 r) mu mu^T. The limits of 1 are for markers that swing or
are loose: they deform more than people's and do not slide further. (Thighs of bones left out slide
1.0 times the mean, with a standard deviation of 0.5.) The second term is of the rigid part alone:
deformation does not show how far a cluster slides. Segments differ by a factor of two, so that one
soft thigh does not soften the feet. With the same s for all, hips of people with quadratic
artefacts were 15 mm from the truth; with different segments, 8 mm. An activity other than walking
may leave joints at rest, whose tracked angles follow the errors of others. Their segments do not
deform, with even prior odds, and then carry no information about s.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from gaitcal.arrays import Array
from gaitcal.calibration.soft_tissue_table import (
    THIGH_M,
    SkinField,
    SkinTable,
    evaluate_place_functions,
    load_people_table,
)
from gaitcal.calibration.trial_noise import (
    LEAST_SAMPLES,
    compute_least_noise,
    estimate_frames_per_sample,
)
from gaitcal.model.linkage import (
    BENDS,
    ISOLATED_JOINTS,
    JOINT_OF_CHILD,
    JOINTS,
    LEG_JOINTS,
    Source,
    get_segment,
)
from gaitcal.model.parameters import Parameters
from gaitcal.tracking import motion, soft_tissue
from gaitcal.tracking.rigid import FEWEST_MARKERS, fit_rigid
from gaitcal.tracking.trial_problem import MotionProblem


@dataclass(frozen=True)
class ArtefactSize:
    """Standard deviations over a task, of each component."""

    shift: float  # m, of all markers together
    turn: float  # rad, of all markers together
    per_marker: float  # m, of every marker by itself


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
"""m, rad: RMS over a task of the knee movement that is proportional to the square of its flexion.
Bone pins in walking people showed some 10 mm and 10 degrees from end to end, less along the shank
and in the frontal plane (Lafortune et al., J Biomech 25:347-357, 1992; fluoroscopy: Kozanek et al.,
J Biomech 42:1877-1884, 2009). Knees of cadavers that flex by 60 degrees rotate by 0.8 (trans) and
0.4 degrees (front) RMS with the square of it (polynomials of Walker et al., J Biomech 21:965-974,
1988)."""
CUBE_SHARE = 0.25
"""Part of these sizes that goes with the cube. The same polynomials have 0.04 and less; walking
adds load.
"""
# Standard deviation of ln s among people: their sizes are known to a factor of two
LOG_SPREAD = 0.7
# The same of ln s_j about ln s among the segments of a person
SEGMENT_SPREAD = 0.7
SCALES = np.geomspace(0.005, 4.0, 41)  # Grid of s for the integrals
SQUARES = "^2"  # Ends the name of a regressor psi^2
FROM_BONES = "knee_angle"
"""Begins the names of coordinates of which tracked bones show how they move the skin of thigh and
shank.
"""
GAIT, ACTIVITY = "gait", "activity "
"""Kinds of task: a walk; any other activity (prefix of its name).

Functional trials have the name of their joint.
"""
LEAST_SQUARES = 0.01
"""E[s^2] below which columns of squares are left out: they would move markers by less than a tenth
of people's movement.
"""
TRUSTED = 0.5
"""Share of its largest weight below which a robust loss has rejected a marker; and share of the
frames below which a marker is left out if three others are visible more often."""
# Mean square of an angle over its unit below which it does not move at all
TINY = 1e-12
PAIR = 2  # Markers of which nothing but their distance shows how they deform
OBSERVED_RANK = 1e-9
"""Part of the largest diagonal entry of a QR factor below which an angle adds nothing to those
before it.
"""


def list_adjacent_coordinates(segment: str) -> tuple[str, ...]:
    """List the coordinates of the leg joints at both ends of a segment.

    A talus carries no markers, so the joints beyond it are included.
    """
    above = JOINT_OF_CHILD.get(segment)
    near = {j.child for j in JOINTS if j.parent == segment} | ({above.parent} if above else set())
    ends = {segment, *(other for other in near if not get_segment(other).markers)}
    joints = [
        j
        for j in JOINTS
        if j.name.startswith(LEG_JOINTS) and not ends.isdisjoint((j.parent, j.child))
    ]
    return tuple(
        e.name for joint in joints for e in joint.elements if e.source is Source.COORDINATE
    )


@dataclass(frozen=True)
class AngleUnit:
    """Unit in which an angle moves soft tissue in a kind of task."""

    size: float  # rad, RMS from the static posture
    # Coefficient of angle / size in the least-squares fit of its square
    bend: float


def compute_angle_units(
    angles: Sequence[Mapping[str, Array]], posture: Mapping[str, float] | None = None
) -> dict[str, AngleUnit]:
    """Compute the units of all angles of the trials of one kind of task.

    Parameters
    ----------
    angles : sequence of mapping
        Of each trial, coordinate -> (nf,) rad.
    posture : mapping of str to float, optional
        Coordinate -> rad in the static posture.

    Returns
    -------
    dict of str to AngleUnit
        By coordinate.
    """
    out = dict[str, AngleUnit]()
    for name in dict.fromkeys(name for of_trial in angles for name in of_trial):
        still = (posture or {}).get(name, 0.0)
        every = np.concatenate([of_trial[name] for of_trial in angles if name in of_trial]) - still
        size = max(float(np.sqrt(np.mean(every**2))), soft_tissue.MIN_ANGLE_SPREAD_RAD)
        relative = every / size
        bend = float(np.mean(relative**3)) / max(float(np.mean(relative**2)), TINY)
        out[name] = AngleUnit(size, bend)
    return out


def compute_task_regressors(
    angles: Sequence[Mapping[str, Array]],
    posture: Mapping[str, float] | None = None,
    units: Mapping[str, AngleUnit] | None = None,
    *,
    squares: bool = False,
) -> list[dict[str, Array]]:
    """Compute the regressors of the trials of one kind of task, zero in the static posture.

    Parameters
    ----------
    angles : sequence of mapping
        Of each trial, coordinate -> (nf,) rad.
    posture : mapping of str to float, optional
        Coordinate -> rad in the static posture; zero if not given.
    units : mapping of str to AngleUnit, optional
        Units of other trials of the kind, so that columns mean the same; found from these if not
        given.
    squares : bool
        Whether to add the square of each angle, less its part that is linear by least squares.

    Returns
    -------
    list of dict
        Of each trial, coordinate -> (nf,) psi: rad for knee flexion, else over its RMS in the task.
    """
    units = {**compute_angle_units(angles, posture), **(units or {})}
    out: list[dict[str, Array]] = []
    for of_trial in angles:
        psi = dict[str, Array]()
        for name, angle in of_trial.items():
            unit = units[name]
            relative = (angle - (posture or {}).get(name, 0.0)) / unit.size
            psi[name] = (unit.size if name.startswith(FROM_BONES) else 1.0) * relative
            if squares:
                psi[name + SQUARES] = relative**2 - unit.bend * relative
        out.append(psi)
    return out


def make_tissue_columns(
    problem: MotionProblem,
    kind: str,
    regressors: Mapping[str, Array],
    nominal: Parameters,
    known: Collection[str] | None = None,
    secondary: soft_tissue.SecondaryColumns | None = None,
    *,
    table: SkinTable | None = None,
    softness: float = 1.0,
    pinned: Collection[str] = (),
) -> soft_tissue.SoftTissue | None:
    """Make the columns of the artefact on the markers of a trial.

    Parameters
    ----------
    problem : MotionProblem
        The trial. Points that are no markers have no artefact.
    kind : str
        Kind of task.
    regressors : mapping of str to (nf,) array
        By coordinate, from `compute_task_regressors`.
    nominal : Parameters
        Positions of the knees; positions on the skin are relative to them.
    known : collection of str, optional
        Columns to keep; all if not given.
    secondary : SecondaryColumns, optional
        Secondary motions of the knees.
    table : SkinTable, optional
        Artefact of people; the built-in one if not given.
    softness : float
        Factor of the mean; 0 if markers are taken to stay in their static positions.
    pinned : collection of str
        Segments with markers fixed to the bone.

    Returns
    -------
    SoftTissue or None
        None if there are no columns.
    """
    groups, skin = [], load_people_table() if table is None else table
    for s, markers in problem.data.placed.groups if problem.noise is None else ():
        segment = problem.chain.segments[s]
        if (
            segment in pinned
            or segment.split("_")[0] not in SIZES
            or not (problem.data.weight[markers] > 0).any()
        ):
            continue
        near, local = list_adjacent_coordinates(segment), problem.data.local[markers]
        names = tuple(name for name in regressors if name.removesuffix(SQUARES) in near)
        pulling = (problem.data.weight[markers] > 0).any(axis=1)
        if names:
            cluster = _Cluster(
                segment, local, local[pulling].mean(axis=0), nominal, skin, gait=kind == GAIT
            )
            groups.append(
                soft_tissue.SegmentTissue(
                    segment=s,
                    carrier=segment,
                    markers=markers,
                    pattern=cluster.pattern,
                    names=tuple(f"{kind}/{name}" for name in names),
                    regressors=np.array([regressors[name] for name in names]),
                    expected=np.array([cluster.compute_mean(name) for name in names]),
                    covariance=np.array([cluster.compute_rigid_covariance(name) for name in names]),
                    by_marker=np.array([cluster.compute_marker_covariance(name) for name in names]),
                    softness=softness,
                )
            )
    if known is not None:
        groups = [
            group for group in groups if set(soft_tissue.SoftTissue((group,)).keys) <= set(known)
        ]
    return soft_tissue.SoftTissue(tuple(groups), secondary) if groups or secondary else None


class _Cluster:
    """Markers of one segment, with people's artefact per unit of a regressor."""

    def __init__(
        self,
        segment: str,
        local: Array,
        middle: Array,
        nominal: Parameters,
        table: SkinTable,
        *,
        gait: bool,
    ) -> None:
        self.kind, _, side = segment.partition("_")
        self.pattern = soft_tissue.build_rigid_pattern(local - middle)
        self._flat = self.pattern.reshape(-1, soft_tissue.WIDTH)
        self._mirror = np.array([1.0, 1.0, -1.0 if side == "l" else 1.0])
        self._field = table.get(self.kind)
        self._size = SIZES[self.kind]
        if self._field is not None:
            knee = f"knee_{side}"
            length = float(np.linalg.norm(nominal.centre(knee, f"thigh_{side}")))
            self._larger = length / THIGH_M
            place = (local - nominal.centre(knee, segment)) * self._mirror / length
            self._functions = evaluate_place_functions(place, gait=gait)

    def _get_field(self, regressor: str) -> SkinField | None:
        return (
            self._field
            if regressor.startswith(FROM_BONES) and not regressor.endswith(SQUARES)
            else None
        )

    def compute_mean(self, regressor: str) -> Array:
        """Compute the mean (nm, 3) m; zero for squares."""
        field = self._get_field(regressor)
        if field is None:
            return np.zeros(self.pattern.shape[:2])
        return np.asarray(self._larger * self._mirror * field.compute_mean(self._functions))

    def compute_marker_covariance(self, regressor: str) -> Array:
        """Compute the covariance (3 nm, 3 nm) m^2 about the mean."""
        field = self._get_field(regressor)
        if field is None:
            size, more = self._size, np.zeros((len(self._flat),) * 2)
        else:
            size = ArtefactSize(
                self._larger * field.shift, field.turn, self._larger * field.per_marker
            )
            mirror = np.tile(self._mirror, len(self.pattern))
            more = (
                self._larger**2
                * np.outer(mirror, mirror)
                * field.compute_uncertainty(self._functions)
            )
        rigid = self._flat * np.repeat([size.shift, size.turn], 3)
        return np.asarray(rigid @ rigid.T + size.per_marker**2 * np.eye(len(rigid)) + more)

    def compute_rigid_covariance(self, regressor: str) -> Array:
        """Compute the covariance (6, 6) m^2, m rad, rad^2 of the rigid part about its mean."""
        field = self._get_field(regressor)
        size = self._size
        together = np.linalg.pinv(self._flat, rcond=soft_tissue.RANK_TOLERANCE)
        more = np.zeros((soft_tissue.WIDTH,) * 2)
        if field is not None:
            size = ArtefactSize(
                self._larger * field.shift, field.turn, self._larger * field.per_marker
            )
            mirrored = self._larger * together * np.tile(self._mirror, len(self.pattern))
            more = mirrored @ field.compute_uncertainty(self._functions) @ mirrored.T
        out = (
            np.diag(np.repeat([size.shift, size.turn], 3) ** 2)
            + size.per_marker**2 * together @ together.T
            + more
        )
        return np.asarray(0.5 * (out + out.T))


@dataclass(frozen=True)
class SoftTissueScale:
    """Estimate E[s^2] of a person in one kind of task from the deformation of all segments."""

    linear: float
    squares: float = 0.0
    mean: float = 0.0
    """min(E[s], 1), the factor of the prior mean of the linear columns.

    Markers that deform more than people's oscillate or are loose; they do not slide further.
    """
    mean_square: float = 0.0
    """min(E[s^2], 1)."""

    def compute_covariance(
        self, regressor: str, unit: Array, mean: Array, softness: float
    ) -> Array:
        """Compute the covariance of a regressor's columns about `softness` times their mean.

        `unit` and `mean` are both moments at s = 1.
        """
        if regressor.endswith(SQUARES):
            return self.get_variance(regressor) * unit
        of_scale = max(
            (1.0 + SEGMENT_SPREAD**2) * self.mean_square - 2.0 * softness * self.mean + softness**2,
            0.0,
        )
        return np.asarray(self.linear * unit + of_scale * np.outer(mean, mean))

    def get_variance(self, regressor: str) -> float:
        """Get E[s^2] of a regressor's columns."""
        return self.squares if regressor.endswith(SQUARES) else self.linear


def estimate_soft_tissue_scale(
    trials: Sequence[MotionProblem], *, possibly_still: bool = False
) -> SoftTissueScale:
    """Estimate the softness of a person in one kind of task.

    Parameters
    ----------
    trials : sequence of MotionProblem
        Trials of the kind, with all columns that soft tissue may have.
    possibly_still : bool
        Whether the task may leave joints at rest, whose tracked angles follow errors of others.

    Returns
    -------
    SoftTissueScale
        Moments of s.
    """
    plain, bent = list[_Deformation](), list[_Deformation]()
    for observed in collect_deformations(trials).values():
        # one distance cannot distinguish soft skin from a wand that swings
        if observed.markers < FEWEST_MARKERS:
            continue
        root, count = block_diag(*map(np.linalg.cholesky, observed.covariance)), len(observed.names)
        information, right = root.T @ observed.information @ root, root.T @ observed.right
        mean = np.linalg.solve(root, observed.expected.ravel())
        bends = np.repeat([name.endswith(SQUARES) for name in observed.names], len(right) // count)
        linear, mixed = information[np.ix_(~bends, ~bends)], information[np.ix_(bends, ~bends)]
        plain.append(_Deformation(linear, right[~bends], mean[~bends]))
        # Information about the squares after marginalising the linear columns of any size
        inner = linear + np.eye(len(linear)) / SCALES[-1] ** 2
        left = np.linalg.solve(inner, np.column_stack([mixed.T, right[~bends]]))
        of_squares = information[np.ix_(bends, bends)] - mixed @ left[:, :-1]
        bent.append(_Deformation(of_squares, right[bends] - mixed @ left[:, -1], mean[bends]))
    squares = 0.0
    if any(len(part.right) for part in bent):
        squares = _compute_scale_moments(
            bent, possibly_none=True, possibly_still=possibly_still
        ).linear
    return replace(_compute_scale_moments(plain, possibly_still=possibly_still), squares=squares)


Cluster = tuple[str, tuple[str, ...]]
"""A segment, and the labels of its markers."""


@dataclass(frozen=True, kw_only=True)
class ObservedDeformation:
    """Observed deformation of the markers of one segment in the trials of one kind of task.

    Unknowns are the displacements of each marker per unit of each regressor, regressor by
    regressor, marker by marker, x, y, z.
    """

    names: tuple[str, ...]  # (nr,) `kind/regressor`
    information: Array  # (3 nr nm, 3 nr nm) 1/m^2, Q
    right: Array  # (3 nr nm,) 1/m, b
    expected: Array  # (nr, 3 nm) m at s = 1
    covariance: Array  # (nr, 3 nm, 3 nm) m^2 about that, at s = 1
    # (nr, 6, 6) m^2, m rad, rad^2 of the rigid part of that
    rigid_covariance: Array
    pattern: Array  # (nm, 3, 6) B

    @property
    def markers(self) -> int:
        """Number of markers with information."""
        shown = np.diag(self.information).reshape(len(self.names), -1, 3) > 0
        return int(shown.any(axis=(0, 2)).sum())


def collect_deformations(trials: Sequence[MotionProblem]) -> dict[Cluster, ObservedDeformation]:
    """Collect the observed deformation of each cluster over all trials.

    Parameters
    ----------
    trials : sequence of MotionProblem
        Trials of one kind, with soft tissue.

    Returns
    -------
    dict
        Cluster -> ObservedDeformation; clusters without information are left out.
    """
    out: dict[Cluster, ObservedDeformation] = {}
    for problem in trials:
        for group in problem.tissue.groups if problem.tissue else ():
            information, right = _compute_deformation(problem, group)
            which = group.carrier, tuple(problem.labels[group.markers])
            of_trial = ObservedDeformation(
                names=group.names,
                information=information,
                right=right,
                expected=group.expected.reshape(len(group.names), -1),
                covariance=group.by_marker,
                rigid_covariance=group.covariance,
                pattern=group.pattern,
            )
            out[which] = _sum_deformations(out[which], of_trial) if which in out else of_trial
    # a trial that shows nothing has its regressors here, as others may show how the same markers
    # deform
    return {which: observed for which, observed in out.items() if observed.information.any()}


def _sum_deformations(one: ObservedDeformation, other: ObservedDeformation) -> ObservedDeformation:
    """Sum two observations: regressors of either, with the first's columns if both have one."""
    new = [r for r, name in enumerate(other.names) if name not in one.names]
    names = (*one.names, *(other.names[r] for r in new))
    width = one.expected.shape[1]
    information, right = np.zeros((width * len(names),) * 2), np.zeros(width * len(names))
    for part in (one, other):
        places = np.concatenate(
            [width * names.index(name) + np.arange(width) for name in part.names]
        )
        information[np.ix_(places, places)] += part.information
        right[places] += part.right
    return ObservedDeformation(
        names=names,
        information=information,
        right=right,
        expected=np.concatenate([one.expected, other.expected[new]]),
        covariance=np.concatenate([one.covariance, other.covariance[new]]),
        rigid_covariance=np.concatenate([one.rigid_covariance, other.rigid_covariance[new]]),
        pattern=one.pattern,
    )


@dataclass(frozen=True, kw_only=True)
class ClusterTissue:
    """Posterior of the artefact of one segment in one kind of task, given its deformation."""

    names: tuple[str, ...]  # (nr,) `kind/regressor`
    # (6 nr,) m, rad, of the rigid part about its prior mean
    mean: Array
    covariance: Array  # (6 nr, 6 nr) of the rigid part
    deformation: Array  # (nr, nm, 3) m


def compute_cluster_tissue(observed: ObservedDeformation, scale: SoftTissueScale) -> ClusterTissue:
    """Compute the posterior of a cluster from its deformation.

    Translations and rotations of a cluster do not deform it, so joints have no influence here. The
    rigid part depends on the deformation as far as one field of the skin causes both.

    Parameters
    ----------
    observed : ObservedDeformation
        Deformation in the trials of one kind of task.
    scale : SoftTissueScale
        Softness of the person in that kind.

    Returns
    -------
    ClusterTissue
        Means and covariance per unit of each regressor, in the axes of the segment.
    """
    count, width = observed.expected.shape
    flat = observed.pattern.reshape(-1, soft_tissue.WIDTH)
    to_rigid = np.linalg.pinv(flat, rcond=soft_tissue.RANK_TOLERANCE)
    before, roots, rigid = list[Array](), list[Array](), list[Array]()
    columns = zip(
        observed.names,
        observed.expected,
        observed.covariance,
        observed.rigid_covariance,
        strict=True,
    )
    for name, moves, by_marker, of_rigid in columns:
        softness = 0.0 if name.endswith(SQUARES) else scale.mean
        before.append(softness * moves)
        roots.append(np.linalg.cholesky(scale.get_variance(name) * by_marker))
        rigid.append(scale.compute_covariance(name, of_rigid, to_rigid @ moves, softness))
    root, mean = block_diag(*roots), np.concatenate(before)
    left = np.linalg.inv(np.eye(len(root)) + root.T @ observed.information @ root)
    change = root @ left @ root.T @ (observed.right - observed.information @ mean)
    after = (mean + change).reshape(count, width)
    deformation = after - after @ to_rigid.T @ flat.T
    to_all_rigid = np.kron(np.eye(count), to_rigid)
    along = to_all_rigid @ root
    covariance = block_diag(*rigid) - along @ (np.eye(len(root)) - left) @ along.T
    return ClusterTissue(
        names=observed.names,
        mean=to_all_rigid @ change,
        covariance=0.5 * (covariance + covariance.T),
        deformation=deformation.reshape(count, -1, 3),
    )


@dataclass(frozen=True)
class _Deformation:
    """Information of one segment, by columns of unit variance."""

    information: Array  # (n, n) Q
    right: Array  # (n,) b
    mean: Array  # (n,) mu


def _compute_scale_moments(
    parts: Sequence[_Deformation], *, possibly_none: bool = False, possibly_still: bool = False
) -> SoftTissueScale:
    """Compute the moments of s.

    If `possibly_none`, s is 0 with even prior odds. If `possibly_still`, each s_j separately is.
    """
    place = np.log(SCALES)
    log_odds = -0.5 * ((place[:, None] - place) / SEGMENT_SPREAD) ** 2
    log_odds -= np.log(np.exp(log_odds).sum(axis=1, keepdims=True))
    """(s, s_j) log of the probability that a segment has s_j in a person who has s."""
    before = -0.5 * (place / LOG_SPREAD) ** 2
    log = before.copy()
    for part in parts:
        values, vectors = np.linalg.eigh(part.information)
        values, along, mean = np.maximum(values, 0.0), vectors.T @ part.right, vectors.T @ part.mean
        s = SCALES[:, None]
        about = along - s * values * mean
        alone = 0.5 * (s**2 * about**2 / (1.0 + s**2 * values) - np.log1p(s**2 * values)).sum(
            axis=1
        )
        alone += (s * mean * along - 0.5 * s**2 * values * mean**2).sum(axis=1)
        moved = logsumexp(log_odds + alone, axis=1)
        log += np.logaddexp(moved, 0.0) if possibly_still else moved
    top = max(float(log.max()), 0.0)
    weight, none = (
        np.exp(log - top),
        float(np.exp(before).sum() * np.exp(-top)) if possibly_none else 0.0,
    )
    whole = float(weight.sum()) + none
    moments = [float(weight @ SCALES**power) / whole for power in (1, 2)]
    return SoftTissueScale(
        linear=moments[1], mean=min(moments[0], 1.0), mean_square=min(moments[1], 1.0)
    )


def _compute_deformation(
    problem: MotionProblem, group: soft_tissue.SegmentTissue
) -> tuple[Array, Array]:
    """Compute Q (n, n) 1/m^2 and b (n,) of one segment in one trial, from its weighted markers.

    Entries are regressor by regressor, marker by marker, x, y, z. The deformation of two markers is
    their distance.
    """
    data, psi = problem.data, group.regressors
    width = 3 * (group.markers.stop - group.markers.start)
    nothing = np.zeros((len(psi) * width,) * 2), np.zeros(len(psi) * width)
    given = data.weight[group.markers]
    trusted = (given > 0) & (given > TRUSTED * given.max(axis=1, keepdims=True))
    often = trusted.sum(axis=1)
    third = np.sort(often)[-FEWEST_MARKERS] if len(often) >= FEWEST_MARKERS else 0
    used = group.markers.start + np.flatnonzero(
        (often > 0) & (often >= min(third, TRUSTED * often.max(initial=0)))
    )
    local, weight = data.local[used], data.weight[used]
    fit = fit_rigid(local, data.measured[used], weight)
    # a pair has no turn about its line, and needs none: all that it can do by itself is along it
    determined = fit.determined | (len(used) == PAIR)
    whole = determined & trusted[used - group.markers.start].all(axis=0)
    """Frames that show all of them and trust them: in others the projector is another."""
    psi = psi[:, whole]
    if whole.sum() <= len(psi):
        return nothing
    if len(used) == PAIR:
        line = local[1] - local[0]
        length = float(np.linalg.norm(line))
        longer = np.linalg.norm(data.measured[used[1]] - data.measured[used[0]], axis=0) - length
        left = 0.5 * np.array([-1.0, 1.0])[:, None, None] * (line / length)[:, None] * longer
    else:
        followed = np.einsum("fij,mj->mif", fit.rotation, local) + fit.origin.T
        left = np.einsum("fij,mif->mjf", fit.rotation, data.measured[used] - followed)
    errors = left.reshape(3 * len(used), -1).T[whole]  # (frames, 3 used)
    # where a marker lies is not how it moves
    errors = errors - errors.mean(axis=0)
    psi = psi - psi.mean(axis=1, keepdims=True)
    rigid = _find_rigid_directions(
        soft_tissue.build_rigid_pattern(local - local.mean(axis=0)).reshape(-1, soft_tissue.WIDTH)
    )
    noise = _estimate_noise(
        errors,
        psi,
        3 * len(used) - rigid.shape[1],
        compute_least_noise(problem.basis, problem.noise),
    )
    columns = (3 * (used - group.markers.start)[:, None] + np.arange(3)).ravel()
    projector, errors_of_group = np.zeros((width, width)), np.zeros((len(errors), width))
    projector[np.ix_(columns, columns)] = np.eye(len(columns)) - rigid @ rigid.T
    errors_of_group[:, columns] = errors
    information, right = (
        np.kron(psi @ psi.T, projector),
        (psi @ errors_of_group @ projector).ravel(),
    )
    return np.asarray(information / noise**2, float), np.asarray(right / noise**2, float)


def _find_rigid_directions(flat: Array) -> Array:
    """Find orthonormal columns (3 nm, 6 or 5) that span those of B (3 nm, 6)."""
    columns, sizes, _ = np.linalg.svd(flat, full_matrices=False)
    return np.asarray(columns[:, sizes > soft_tissue.RANK_TOLERANCE * sizes[0]])


def _estimate_noise(errors: Array, psi: Array, directions: int, least: float) -> float:
    """Estimate nu (m) of errors (nf, 3 nm) that no combination of regressors (nr, nf) explains."""
    q, r = np.linalg.qr(psi.T)
    explained = q[:, np.abs(np.diag(r)) > OBSERVED_RANK * np.abs(r).max(initial=0.0)]
    unexplained = errors - explained @ (explained.T @ errors)
    tau = estimate_frames_per_sample(unexplained)
    samples = len(errors) / tau
    spent = samples / max(samples - explained.shape[1], LEAST_SAMPLES * samples)
    variance = spent * tau * float((unexplained**2).sum()) / (max(directions, 1) * len(errors))
    return max(float(np.sqrt(variance)), least)


@dataclass(frozen=True)
class TissuePrior:
    """Prior of the soft tissue columns of all kinds of task."""

    keys: tuple[str, ...]  # `kind/regressor/segment/component`
    covariance: Array  # (nz, nz) m^2, m rad, rad^2
    mean: Array  # (nz,) m, rad


NO_TISSUE = TissuePrior((), np.zeros((0, 0)), np.zeros(0))


def assemble_tissue_prior(
    trials: Sequence[MotionProblem],
    scales: Mapping[str, SoftTissueScale],
    clusters: Mapping[tuple[str, Cluster], ClusterTissue] | None = None,
) -> TissuePrior:
    """Assemble the prior of the columns that trials have.

    Parameters
    ----------
    trials : sequence of MotionProblem
        Trials with their soft tissue.
    scales : mapping of str to SoftTissueScale
        Kind of task -> softness of the person.
    clusters : mapping, optional
        (kind of task, cluster) -> posterior from its deformation; none was observed if not given.

    Returns
    -------
    TissuePrior
        m and rad.
    """
    names, means, blocks = list[tuple[str, str]](), list[Array](), list[Array]()
    """(name of a regressor, segment), in the order of the blocks."""
    for problem in trials:
        for group in problem.tissue.groups if problem.tissue else ():
            new = [r for r, name in enumerate(group.names) if (name, group.carrier) not in names]
            if not new:
                continue
            names += [(group.names[r], group.carrier) for r in new]
            kind = group.names[0].partition("/")[0]
            found = (clusters or {}).get(
                (kind, (group.carrier, tuple(problem.labels[group.markers])))
            )
            if found is not None and not group.softness:
                found = None
            if found is not None:
                starts = [soft_tissue.WIDTH * found.names.index(group.names[r]) for r in new]
                rows = np.concatenate([start + np.arange(soft_tissue.WIDTH) for start in starts])
                means.append(found.mean[rows])
                blocks.append(found.covariance[np.ix_(rows, rows)])
                continue
            for r in new:
                mean = group.fit_rigid_part(group.expected[r])
                means.append(np.zeros(soft_tissue.WIDTH))
                blocks.append(
                    scales[kind].compute_covariance(
                        group.names[r], group.covariance[r], mean, group.softness
                    )
                )
    keys = tuple(
        f"{name}/{segment}/{component}"
        for name, segment in names
        for component in soft_tissue.COMPONENTS
    )
    secondary = make_secondary_prior(trials)
    mean = np.concatenate([secondary.mean, *means])
    return TissuePrior((*secondary.keys, *keys), block_diag(secondary.covariance, *blocks), mean)


def make_secondary_prior(trials: Sequence[MotionProblem]) -> TissuePrior:
    """Make the prior of the secondary motions that trials have."""
    keys = tuple(
        dict.fromkeys(
            key for problem in trials if problem.secondary for key in problem.secondary.keys
        )
    )
    square = f"/{BENDS[0]}/"
    sizes = [
        SECONDARY_SIZES[key.rpartition(".")[2]] * (1.0 if square in key else CUBE_SHARE)
        for key in keys
    ]
    return TissuePrior(keys, np.diag(np.square(sizes)), np.zeros(len(keys)))


def is_from_bones(key: str) -> bool:
    """Return whether tracked bones show a column, `kind/regressor/segment/component`.

    These are columns of knee flexion and its square: in deep flexion the skin of thigh and shank
    does not move in proportion. Secondary motions of a knee, `kind/regressor/^2/motion`, are none.
    """
    return key.split("/")[1].startswith(FROM_BONES) and "/^" not in key


@dataclass(frozen=True)
class FoundTissue:
    """Artefact found by a calibration in columns of `is_from_bones`; motions are tracked with it.

    Other columns have no mean, and markers hardly determine them. What a fit found of them is an
    error of the motions.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    """Column -> m, rad, about its prior mean."""
    softness: Mapping[str, float] = field(default_factory=dict)
    """Kind of task -> factor of the prior mean."""
    units: Mapping[str, AngleUnit] = field(default_factory=dict)
    """`kind/coordinate` -> unit of the columns, which further trials share."""

    def select_units(self, kind: str) -> dict[str, AngleUnit]:
        """Select the units of a kind of task, by coordinate."""
        start = f"{kind}/"
        return {
            name.removeprefix(start): unit
            for name, unit in self.units.items()
            if name.startswith(start)
        }

    def displace_markers(self, problem: MotionProblem) -> MotionProblem:
        """Displace the markers of a trial by the artefact; knees stay hinges.

        Parameters
        ----------
        problem : MotionProblem
            The trial, with its soft tissue.

        Returns
        -------
        MotionProblem
            A column that was not found has its mean.
        """
        if problem.tissue is None or not problem.tissue.groups:
            return problem
        z = np.array([self.values.get(key, 0.0) for key in problem.tissue.keys])
        return problem.shift_markers(problem.tissue.compute_shift(z, len(problem.labels)))


NO_FOUND_TISSUE = FoundTissue()


def _apply_deformation(
    tissue: soft_tissue.SoftTissue,
    problem: MotionProblem,
    clusters: Mapping[Cluster, ClusterTissue],
) -> soft_tissue.SoftTissue:
    """Apply the observed deformation to the markers of a trial."""
    groups = list[soft_tissue.SegmentTissue]()
    for group in tissue.groups:
        found = clusters.get((group.carrier, tuple(problem.labels[group.markers])))
        if found is not None:
            rows = [found.names.index(name) for name in group.names]
            group = replace(group, deformation=found.deformation[rows])
        groups.append(group)
    return replace(tissue, groups=tuple(groups))


@dataclass(frozen=True)
class TaskTissue:
    """Soft tissue of the markers of each trial, with its prior."""

    kinds: Mapping[str, str]  # Trial -> kind of task
    # Trial -> coordinate -> (nf,) psi of the joints that its task moves
    regressors: Mapping[str, Mapping[str, Array]]
    # Kind of task -> how soft the person is there
    scales: Mapping[str, SoftTissueScale]
    # Trial of gait -> knee movement besides flexion
    secondary: Mapping[str, soft_tissue.SecondaryColumns]
    nominal: Parameters
    table: SkinTable
    units: Mapping[str, AngleUnit] = field(default_factory=dict)
    """`kind/coordinate` -> unit of the regressors."""
    clusters: Mapping[tuple[str, Cluster], ClusterTissue] = field(default_factory=dict)
    """Kind of task and cluster -> posterior given its deformation."""
    fitted: bool = True
    """Whether the artefact is fitted; else markers stay in their places, and all of it is a source
    of error.
    """
    pinned: Collection[str] = ()
    """Segments with markers fixed to the bone."""

    def assemble_prior(self, trials: Sequence[MotionProblem]) -> TissuePrior:
        """Assemble the prior of the columns that trials have."""
        return assemble_tissue_prior(trials, self.scales, self.clusters if self.fitted else None)

    def make_columns(
        self, name: str, problem: MotionProblem, known: Collection[str] | None = None
    ) -> soft_tissue.SoftTissue | None:
        """Make the columns of a trial on a part of the body; all or those `known`."""
        kind = self.kinds[name]
        tissue = make_tissue_columns(
            problem,
            kind,
            self.regressors[name],
            self.nominal,
            known,
            self.secondary.get(name),
            table=self.table,
            softness=self.scales[kind].mean if self.fitted else 0.0,
            pinned=self.pinned,
        )
        if tissue is None or not self.fitted:
            return tissue
        clusters = {
            cluster: found for (of_kind, cluster), found in self.clusters.items() if of_kind == kind
        }
        return _apply_deformation(tissue, problem, clusters)

    def make_body_columns(
        self, bodies: Mapping[str, MotionProblem], known: Collection[str]
    ) -> dict[str, soft_tissue.SoftTissue]:
        """Make the columns `known` on the markers of whole bodies.

        Parameters
        ----------
        bodies : mapping of str to MotionProblem
            Trials of the whole body.
        known : collection of str
            Columns to keep.

        Returns
        -------
        dict of str to SoftTissue
            Trials without columns are left out.
        """
        found = {name: self.make_columns(name, body, known) for name, body in bodies.items()}
        return {name: columns for name, columns in found.items() if columns is not None}

    def make_found_tissue(self, keys: Sequence[str], values: Array) -> FoundTissue:
        """Make the artefact that a fit of the columns `keys` found, values (nz,) m and rad."""
        softness = {kind: scale.mean for kind, scale in self.scales.items()}
        found = dict(zip(keys, values.tolist(), strict=True))
        from_bones = {key: value for key, value in found.items() if is_from_bones(key)}
        return FoundTissue(from_bones, softness, self.units)


def prepare_task_tissue(
    kinds: Mapping[str, str],
    parts: Mapping[str, MotionProblem],
    nominal: Parameters,
    table: SkinTable | None = None,
    *,
    fitted: bool = True,
    pinned: Collection[str] = (),
) -> TaskTissue:
    """Prepare the soft tissue of trials: regressors, softness and priors.

    Parameters
    ----------
    kinds : mapping of str to str
        Trial -> kind of task.
    parts : mapping of str to MotionProblem
        Trial -> part of the body that is fitted.
    nominal : Parameters
        Parameters that trials are tracked with.
    table : SkinTable, optional
        Artefact of people; the built-in one if not given.
    fitted : bool
        Whether the artefact will be fitted, or is a source of error alone.
    pinned : collection of str
        Segments with markers fixed to the bone, which do not show the person's soft tissue.

    Returns
    -------
    TaskTissue
        Soft tissue of all trials.
    """
    table = load_people_table() if table is None else table
    angles = {name: _track_angles(nominal, parts[name]) for name in kinds}
    regressors, scales = dict[str, Mapping[str, Array]](), dict[str, SoftTissueScale]()
    units = dict[str, AngleUnit]()
    for kind in dict.fromkeys(kinds.values()):
        names = [name for name in kinds if kinds[name] == kind]
        of_kind, posture = [angles[n] for n in names], parts[names[0]].posture
        found = compute_angle_units(of_kind, posture)
        units |= {f"{kind}/{name}": unit for name, unit in found.items()}
        regressors |= dict(
            zip(names, compute_task_regressors(of_kind, posture, found, squares=True), strict=True)
        )
    gait = [name for name in kinds if kinds[name] == GAIT]
    secondary = dict(
        zip(gait, soft_tissue.build_secondary_columns(GAIT, [angles[n] for n in gait]), strict=True)
    )
    isolated = [name for name in kinds if kinds[name] in ISOLATED_JOINTS]

    def with_columns(name: str) -> MotionProblem:
        tissue = make_tissue_columns(
            parts[name], kinds[name], regressors[name], nominal, table=table, pinned=pinned
        )
        return replace(parts[name], tissue=tissue)

    for alike in (gait, isolated, *([name] for name in kinds if name not in (*gait, *isolated))):
        soft = [with_columns(name) for name in alike]
        scale = estimate_soft_tissue_scale(soft, possibly_still=alike not in (gait, isolated))
        scales |= {kinds[name]: scale for name in alike}
        if scale.squares < LEAST_SQUARES:
            for n in alike:
                regressors[n] = {
                    c: psi for c, psi in regressors[n].items() if not c.endswith(SQUARES)
                }
    clusters = dict[tuple[str, Cluster], ClusterTissue]()
    for kind in dict.fromkeys(kinds.values()):
        soft = [with_columns(name) for name in kinds if kinds[name] == kind]
        for cluster, observed in collect_deformations(soft).items():
            clusters[kind, cluster] = compute_cluster_tissue(observed, scales[kind])
    return TaskTissue(
        kinds, regressors, scales, secondary, nominal, table, units, clusters, fitted, pinned
    )


def _track_angles(nominal: Parameters, part: MotionProblem) -> dict[str, Array]:
    """Track the coordinates that a marker of the trial shows: name -> (nf,) rad."""
    q = motion.track_motion(part, nominal).q
    return {
        name: values
        for name, values, on in zip(part.chain.coordinates, q.T, part.active, strict=True)
        if on
    }


def choose_kind_for_trial(found: FoundTissue, activity: str) -> str:
    """Choose the kind of task of a calibration whose soft tissue a further trial has.

    An activity has that of the activity of its name. If the calibration has none, it has that of
    walks, else of any other activity.

    Parameters
    ----------
    found : FoundTissue
        Artefact of the calibration.
    activity : str
        Name of the activity; empty for a walk.

    Returns
    -------
    str
        Kind of task.
    """
    wanted = [*([f"{ACTIVITY}{activity}"] if activity else []), GAIT]
    known = [kind for kind in found.softness if kind == GAIT or kind.startswith(ACTIVITY)]
    return next((kind for kind in (*wanted, *known) if kind in found.softness), GAIT)


def make_further_tissue(
    trial: MotionProblem,
    legs: MotionProblem,
    nominal: Parameters,
    known: Collection[str],
    found: FoundTissue,
    kind: str,
) -> soft_tissue.SoftTissue | None:
    """Make soft tissue and secondary motions of a trial that took no part in a calibration.

    They are those of the calibration's kind of task, with the angles of this trial in the units of
    that kind. The mean of whole clusters is multiplied by its softness. The deformation of their
    markers is observed in the trial itself.

    Parameters
    ----------
    trial, legs : MotionProblem
        The whole body, and the part of it that a calibration fits, by which angles are tracked.
    nominal : Parameters
        Parameters that the trial is tracked with.
    known : collection of str
        Columns of the calibration, `kind/regressor/...`, of an `ErrorSources`.
    found : FoundTissue
        Artefact of the calibration. If it took markers to stay in their positions, so does this
        trial.
    kind : str
        Kind of task, of `choose_kind_for_trial`.

    Returns
    -------
    SoftTissue or None
        None if there are no columns.
    """
    angles, softness = _track_angles(nominal, legs), found.softness.get(kind, 0.0)
    (every,) = compute_task_regressors(
        [angles], trial.posture, found.select_units(kind), squares=True
    )
    regressors = {
        name: psi
        for name, psi in every.items()
        if any(key.startswith(f"{kind}/{name}/") for key in known)
    }
    knees = {
        name: phi
        for name, phi in angles.items()
        if any(key.startswith(f"{kind}/{name}/^") for key in known)
    }
    (secondary,) = soft_tissue.build_secondary_columns(kind, [knees])
    secondary_or_none = secondary if secondary.names else None
    tissue = make_tissue_columns(
        trial, kind, regressors, nominal, known, secondary_or_none, softness=softness
    )
    if tissue is None or not softness:
        return tissue
    moved = replace(trial, tissue=tissue)
    scale = estimate_soft_tissue_scale([moved], possibly_still=kind != GAIT)
    scale = replace(scale, mean=softness, squares=max(scale.squares, LEAST_SQUARES))
    observed = collect_deformations([moved])
    return _apply_deformation(
        tissue,
        trial,
        {
            cluster: compute_cluster_tissue(deformation, scale)
            for cluster, deformation in observed.items()
        },
    )
