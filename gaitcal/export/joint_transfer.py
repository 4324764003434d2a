"""A person's calibrated hips, knees and ankles put into an OpenSim model of the user's own.

Bodies stay where they are, with all that is fixed to them: meshes, muscle points, wraps, markers. What moves is where
the joints sit in them. With G_b the pose of body b in the laboratory while the person stands, by our calibrated linkage
and the registration of b to our segment (`osim_registration.py`), P and C the joint's frames in parent p and child c,
M(q) its motion, and q0 its coordinates as the person stands,

    ball     P' = D P,    C' = (G_p^-1 G_c)^-1 P' M(q0),

D the shift that takes its centre to ours: the bones stand as they stood with the very coordinates q0 that they had. q0
are those of the model as it was that turn its bones, one against the other, as ours are turned.

A hinge of theirs is A Rz(theta) B^-1, or nearly so (`osim_correspondence.py`). With D and E the smallest rigid motions,
across the axis and turning it, that take A's line to our axis in p and B's to our axis in c,

    hinge    P' = D P,    C' = E B Tz(-d) Rz(-phi) B^-1 C,

d and phi being what our standing bones are slid and turned in that hinge, D A and E B, beside theirs at q0. M is moved
as a whole: a knee that rolls keeps its functions, and rolls about our axis; the standing bones then differ by what
rolling is at q0, which is told.

Between shank and foot lies the talus, which no marker shows: it goes with the joint above it. Of the joints that move
between two registered bodies all but the last keep their place in their child, and the last closes the chain.

A joint whose parameters the recordings say little of stays as it is: where their standard errors are more than `LITTLE`
of what they were before any trial was looked at.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import prior_of
from gaitcal.export.osim_correspondence import Hinge, LegJoint, leg_joints
from gaitcal.export.osim_reader import OsimDocument, Place, peer_of, read_document
from gaitcal.export.osim_registration import Registration, axis_of_ours, registrations
from gaitcal.export.peer_model import Axis, PeerJoint, PeerModel
from gaitcal.model.chain import Chain, ChainConstants, axis_rotation, forward, segment_poses
from gaitcal.model.linkage import JOINTS, LEG_JOINTS, LOWER_BODY, SIDES
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind, Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.joint_prior import JointPrior

LITTLE = 0.9
"""Of the standard error before; nine tenths are a fifth of the variance."""
UNMOVED_M, UNMOVED_RAD = 1e-7, 1e-7
"""Below these a joint stays in the very bytes of its file: the solvers' rounding."""
_LINKAGE = {joint.name: joint for joint in JOINTS}
_HOLD = 1e-6
"""m per rad: what holds a coordinate of the standing posture that no marker shows."""


class Verdict(Enum):
    """What became of a joint."""

    MOVED = "moved"
    UNDETERMINED = "left: the recordings say little of it"
    ABSENT = "left: the model has no such joint"


@dataclass(frozen=True, kw_only=True)
class JointEnd:
    """Where a joint sits in one of its bodies, and how far that is from where it was."""

    body: str
    place: pin.SE3
    """Of the joint's frame in the body."""
    shift: Array
    """(3,) m, in the body's axes: of the centre, of a hinge across its axis."""
    turn: float
    """rad, of a hinge's axis; of a ball joint's frame."""
    errors: tuple[float, float]
    """m and rad, standard errors of the centre (of a hinge across its axis) and of the direction of a hinge's axis: the
    root of the sum of squares in all directions, of the joint parameters and of the registration. NaN where unknown."""
    changed: bool
    """Whether the file is changed here."""

    @property
    def moved(self) -> float:
        """Length of the shift, m."""
        return float(np.linalg.norm(self.shift))


@dataclass(frozen=True, kw_only=True)
class JointMove:
    """What became of one joint."""

    joint: str
    """Ours: `hip_r`, ..."""
    theirs: str
    """Name in the model; empty where it has none."""
    verdict: Verdict
    known: float
    """Standard error of its parameters over that before any trial, the larger of positions and directions."""
    standing: Mapping[str, float]
    """Coordinate of theirs -> rad (m) as the person stands, before and after."""
    rolls: tuple[float, float] = (0.0, 0.0)
    """m and rad, by which the standing bones are then off: what the joint rolls, or cannot do."""
    parent: JointEnd | None = None
    child: JointEnd | None = None


@dataclass(frozen=True, kw_only=True)
class CalibratedOsim:
    """The user's model with this person's joints."""

    content: bytes
    """Of the file."""
    joints: tuple[JointMove, ...]
    legs: tuple[LegJoint, ...]
    """Which joints of the model are meant, and how they were found."""
    registrations: tuple[Registration, ...]
    notes: tuple[str, ...]
    """What the user should know, one sentence each."""


@with_one_blas_thread
def into_osim(
    model: SubjectModel,
    osim: Path | str,
    *,
    errors: ErrorSources | None = None,
    prior: JointPrior | None = None,
    names: Path | None = None,
    recorded: Mapping[str, Array] | None = None,
) -> CalibratedOsim:
    """Put the joints of the legs of `model` into the OpenSim model in the file `osim` (3.x or 4.x).

    Parameters
    ----------
    errors : of the joint parameters (`Uncertainty.joint`); None: they count as exact, and every joint as determined.
    prior : what was known of joints before; anatomy unless given.
    names : a TOML file that says which joints are meant (`read_names`).
    recorded : our coordinate -> (n,) rad in the recordings, over which a knee that rolls is taken; unless given, over a
        stride of the built-in person.

    Returns
    -------
    The file's content, the same but for where joints sit, and what was done. Nothing is written.

    Raises
    ------
    InputError
        The file is no model, or has no legs that can be told, or its markers do not fit this person.
    """
    return Transfer.prepared(model, osim, errors=errors, prior=prior, names=names, recorded=recorded).result()


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """All that is read once; every draw of joint parameters makes another file of it."""

    model: SubjectModel
    document: OsimDocument
    peer: PeerModel
    legs: tuple[LegJoint, ...]
    bodies: Mapping[str, Registration]
    """By our segment."""
    errors: ErrorSources | None
    known: Mapping[str, float]
    """Joint of ours -> how much of its standard error is left."""

    @classmethod
    def prepared(
        cls,
        model: SubjectModel,
        osim: Path | str,
        *,
        errors: ErrorSources | None = None,
        prior: JointPrior | None = None,
        names: Path | None = None,
        recorded: Mapping[str, Array] | None = None,
    ) -> Transfer:
        """Read the model, find its legs and lay its bodies on our segments; arguments as of `into_osim`."""
        document = read_document(osim)
        peer = peer_of(document)
        legs = leg_joints(peer, names, recorded)
        return cls(
            model=model,
            document=document,
            peer=peer,
            legs=legs,
            bodies=registrations(model, peer, legs),
            errors=errors,
            known={leg.ours: left_of_prior(leg.ours, errors, prior) for leg in legs},
        )

    def result(self) -> CalibratedOsim:
        """With the calibrated parameters."""
        moves = self.moves(self.model.parameters, {s: r.pose for s, r in self.bodies.items()})
        return CalibratedOsim(
            content=self.content(moves),
            joints=moves,
            legs=self.legs,
            registrations=tuple(self.bodies.values()),
            notes=tuple(self._notes(moves)),
        )

    def drawn(self, rng: np.random.Generator) -> bytes:
        """A file with joints drawn from their errors, and bodies registered with theirs."""
        parameters = self.model.parameters
        if self.errors is not None:
            own = self.errors.of([name for name in self.errors.free if name in JP_INDEX])  # soft tissue is no joint
            at = [JP_INDEX[name] for name in own.free]
            moved = own.parameters @ rng.normal(size=own.parameters.shape[1])
            parameters = parameters.with_joint(own.free, parameters.joint[at] + moved)
        poses = {s: r.drawn(rng) for s, r in self.bodies.items()}
        return self.content(replace(self, errors=None).moves(parameters, poses))

    def content(self, moves: Sequence[JointMove]) -> bytes:
        """The file with these joints."""
        places: dict[tuple[str, str], Place] = {}
        for move in moves:
            joint = next((leg.theirs for leg in self.legs if leg.ours == move.joint), None)
            for name, end in (("parent", move.parent), ("child", move.child)):
                if joint is None or end is None or not end.changed:
                    continue
                was = joint.in_parent if name == "parent" else joint.in_child
                places[joint.name, name] = Place(
                    end.place.translation if _shift(was, end.place) > UNMOVED_M else None,
                    end.place.rotation if _turn(was, end.place) > UNMOVED_RAD else None,
                )
        return self.document.placed(places)

    def moves(self, parameters: Parameters, poses: Mapping[str, pin.SE3]) -> tuple[JointMove, ...]:
        """What becomes of every joint, with these joint parameters and poses of their bodies in our segments."""
        segments = standing_segments(self.model, parameters)
        stand = {r.body: segments[s] * poses[s] for s, r in self.bodies.items()}
        found: dict[str, JointMove] = {}
        for side in SIDES:
            legs = [leg for leg in self.legs if leg.ours.endswith(f"_{side}")]
            ends = ["pelvis", f"thigh_{side}", f"shank_{side}", f"foot_{side}"]
            for above, below in pairwise(ends):
                if above in self.bodies and below in self.bodies:
                    pair = self.bodies[above].body, self.bodies[below].body
                    for move in self._between(*pair, legs, parameters, segments, stand):
                        found[move.joint] = move
        absent = (f"{joint}_{side}" for side in SIDES for joint in LEG_JOINTS)
        return tuple(
            found.get(name) or JointMove(joint=name, theirs="", verdict=Verdict.ABSENT, known=float("nan"), standing={})
            for name in absent
        )

    def _between(
        self,
        top: str,
        bottom: str,
        legs: Sequence[LegJoint],
        parameters: Parameters,
        segments: Mapping[str, pin.SE3],
        stand: Mapping[str, pin.SE3],
    ) -> Iterator[JointMove]:
        """The joints between two registered bodies, the upper one first."""
        row = self.peer.joints_between(top, bottom)
        ours = {leg.theirs.name: leg for leg in legs}
        q0 = _standing_coordinates(self.peer, row, stand[top].actInv(stand[bottom]), ours)
        moving = [j for j in row if j.name in ours and self.known[ours[j.name].ours] <= LITTLE]
        pose = stand[top]  # of the joint's parent
        for joint in row:
            leg, was = ours.get(joint.name), self.peer.joint_pose(joint, q0)
            if leg is None or joint not in moving:
                if leg is not None:
                    yield self._left(leg, q0)
                pose = pose * was
                continue
            standing = None
            if joint is moving[-1]:
                standing = pose.actInv(stand[bottom] * self.peer.body_pose(bottom, joint.child, q0).inverse())
            target = axis_of_ours(leg.ours, parameters, _in_parent(leg.ours))
            target = target.moved(pose.actInv(segments[_segment(leg.ours)]))
            put = (_put_ball if leg.hinge is None else _put_hinge)(leg, was, target, standing)
            now = put.in_parent * joint.in_parent.actInv(was * joint.in_child) * put.in_child.inverse()
            centre = pose.act(put.centre)
            ends = [
                JointEnd(
                    body=joint.parent if of_parent else joint.child,
                    place=place,
                    shift=put.shifts[not of_parent],
                    turn=put.turns[not of_parent],
                    errors=self._errors(leg.ours, of_parent, parameters, centre, segments),
                    changed=_shift(before, place) > UNMOVED_M or _turn(before, place) > UNMOVED_RAD,
                )
                for of_parent, before, place in (
                    (True, joint.in_parent, put.in_parent),
                    (False, joint.in_child, put.in_child),
                )
            ]
            yield JointMove(
                joint=leg.ours,
                theirs=joint.name,
                verdict=Verdict.MOVED,
                known=self.known[leg.ours],
                standing={c.name: q0[c.name] for c in joint.coordinates if c.name in q0},
                rolls=(0.0, 0.0) if standing is None else (_shift(standing, now), _turn(standing, now)),
                parent=ends[0],
                child=ends[1],
            )
            pose = pose * now

    def _left(self, leg: LegJoint, q0: Mapping[str, float]) -> JointMove:
        return JointMove(
            joint=leg.ours,
            theirs=leg.theirs.name,
            verdict=Verdict.UNDETERMINED,
            known=self.known[leg.ours],
            standing={c.name: q0[c.name] for c in leg.theirs.coordinates if c.name in q0},
        )

    def _errors(
        self, joint: str, of_parent: bool, parameters: Parameters, point: Array, segments: Mapping[str, pin.SE3]
    ) -> tuple[float, float]:
        """Standard errors, m and rad, of the place of a joint in one of its bodies; `point`: (3,) m, laboratory."""
        ours = _LINKAGE[joint]
        segment = ours.parent if of_parent else ours.child
        registration = self.bodies.get(segment)
        if registration is None:
            return float("nan"), float("nan")
        at = segments[segment].actInv(point)
        axis = axis_of_ours(joint, parameters, of_parent)
        across = np.eye(3) if joint.startswith("hip") else np.eye(3) - np.outer(axis.direction, axis.direction)
        shift, turn = registration.point_covariance(at), registration.turn_covariance
        names = [p.name for p in JOINT_PARAMETERS if p.joint == joint and p.segment == segment]
        if self.errors is not None and (told := [name for name in names if name in self.errors.free]):
            moves = np.zeros((6, len(told)))
            for k, name in enumerate(told):
                value = parameters.joint[JP_INDEX[name]]
                more, less = (
                    axis_of_ours(joint, parameters.with_joint((name,), np.array([value + d])), of_parent)
                    for d in (_STEP, -_STEP)
                )
                ends = [np.concatenate([_near(x, at, joint), x.direction]) for x in (more, less)]
                moves[:, k] = (ends[0] - ends[1]) / (2 * _STEP)
            covariance = moves @ self.errors.of(told).covariance @ moves.T
            shift, turn = shift + covariance[:3, :3], across @ turn @ across + covariance[3:, 3:]
        size = float(np.sqrt(np.trace(across @ shift @ across)))
        return size, float("nan") if joint.startswith("hip") else float(np.sqrt(np.trace(across @ turn @ across)))

    def _notes(self, moves: Sequence[JointMove]) -> Iterator[str]:
        for move in moves:
            if move.verdict is Verdict.MOVED and (names := self.document.hangs_on(move.theirs)):
                yield f"{', '.join(names)}: fixed to a frame of joint {move.theirs}, and moved with it"
        for r in self.bodies.values():
            if r.common < FEWEST_MARKERS:
                yield (
                    f"{r.body} shares {r.common} markers with {r.segment}: laid on it by the axes of the joints, "
                    "which tells less"
                )


_STEP = 1e-6
"""m, rad, of central differences."""


def _near(axis: Axis, point: Array, joint: str) -> Array:
    return axis.point if joint.startswith("hip") else axis.nearest(point)


def left_of_prior(joint: str, errors: ErrorSources | None, prior: JointPrior | None = None) -> float:
    """Standard error of a joint's parameters over that before any trial, of positions or of directions, whichever is
    larger; 0 where errors are not known.
    """
    if errors is None:
        return 0.0
    now, found = errors.standard_errors, []
    for kind in Kind:
        names = [p.name for p in JOINT_PARAMETERS if p.joint == joint and p.kind is kind]
        if names:
            before = np.sqrt(np.diag(prior_of(names, prior)[1]))
            after = np.array([now.get(name, size) for name, size in zip(names, before, strict=True)])
            found.append(float(np.linalg.norm(after) / np.linalg.norm(before)))
    return max(found)


def _in_parent(joint: str) -> bool:
    """Whether the axis of one of our joints is taken from its parent: the subtalar joint's has no markers."""
    return not joint.startswith("subtalar")


def _segment(joint: str) -> str:
    return _LINKAGE[joint].parent if _in_parent(joint) else _LINKAGE[joint].child


def standing_segments(model: SubjectModel, parameters: Parameters) -> dict[str, pin.SE3]:
    """Segment of pelvis and legs -> pose in the laboratory of the static trial.

    The linkage with these parameters, fitted to the markers where the nominal one in the static posture has them.
    """
    chain = Chain("pelvis", LOWER_BODY)
    start = np.array([model.posture.get(name, 0.0) for name in chain.coordinates])
    at = [k for k, s in enumerate(model.markers.segments) if s in LOWER_BODY]
    of = [chain.segments.index(model.markers.segments[k]) for k in at]
    local = model.markers.local[at]

    def poses(constants: ChainConstants, q: Array) -> tuple[Array, Array]:
        axes, origins = segment_poses(chain, constants, forward(chain, constants, q[None]))
        return axes[..., 0], origins[..., 0]

    def places(constants: ChainConstants, q: Array) -> Array:
        axes, origins = poses(constants, q)
        out: Array = np.einsum("mji,mj->mi", axes[of], local) + origins[of]
        return out

    nominal, now = (chain.constants(p.joint, p.zero_angles) for p in (model.nominal, parameters))
    measured = places(nominal, start)

    def residual(q: Array) -> Array:
        return np.concatenate([(places(now, q) - measured).ravel(), _HOLD * (q - start)])

    q = least_squares(residual, start, method="lm", xtol=1e-12, ftol=1e-12, gtol=1e-12).x
    axes, origins = poses(now, q)
    return {s: pin.SE3(axes[k].T, origins[k]) for k, s in enumerate(chain.segments)}


def _standing_coordinates(
    peer: PeerModel, row: Sequence[PeerJoint], target: pin.SE3, legs: Mapping[str, LegJoint]
) -> dict[str, float]:
    """Coordinates of the model as it was with which its bodies are turned against each other as `target` is (one
    hinge: by its angle); locked ones keep their value.
    """
    used = [{a.coordinate for a in j.axes or () if a.coordinate is not None} for j in row]
    free = [c for j, names in zip(row, used, strict=True) for c in j.coordinates if c.name in names]
    held = {c.name: c.default for c in free if c.locked}
    free = [c for c in free if not c.locked]

    def values(q: Array) -> dict[str, float]:
        return held | {c.name: float(x) for c, x in zip(free, q, strict=True)}

    single = legs[row[0].name].hinge if len(row) == 1 and row[0].name in legs and len(free) == 1 else None

    def residual(q: Array) -> Array:
        if single is not None:
            return np.array([single.angle(peer.joint_pose(row[0], values(q))) - single.angle(target)])
        turned = np.eye(3)
        for joint in row:
            turned = turned @ peer.joint_pose(joint, values(q)).rotation
        return np.concatenate([pin.log3(turned.T @ target.rotation), 1e-9 * q])

    if not free:
        return held
    start = np.zeros(len(free))
    return values(least_squares(residual, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x)


@dataclass(frozen=True, kw_only=True)
class _Put:
    """A joint's frames, parent's before child's, and how far centre and axis have gone in either body."""

    in_parent: pin.SE3
    in_child: pin.SE3
    centre: Array
    """(3,) m, in the parent, now."""
    shifts: tuple[Array, Array]
    turns: tuple[float, float]


def _put_ball(leg: LegJoint, was: pin.SE3, target: Axis, standing: pin.SE3 | None) -> _Put:
    """The centre of a joint taken to the point of `target`.

    `was`: pose of the child in the parent at q0; `standing`: the same of the standing bones, None where the joint keeps
    its place in the child.
    """
    joint = leg.theirs
    at = (was * joint.in_child).translation
    shift = target.point - at
    in_parent = pin.SE3(np.eye(3), shift) * joint.in_parent
    in_child = joint.in_child
    if standing is not None:
        in_child = standing.actInv(in_parent * joint.in_parent.actInv(was * joint.in_child))
    shifts = shift, in_child.translation - joint.in_child.translation
    return _Put(
        in_parent=in_parent,
        in_child=in_child,
        centre=target.point,
        shifts=shifts,
        turns=(0.0, _turn(joint.in_child, in_child)),
    )


def _put_hinge(leg: LegJoint, was: pin.SE3, target: Axis, standing: pin.SE3 | None) -> _Put:
    """The axis of a joint taken to `target`; arguments as of `_put_ball`."""
    joint, hinge = leg.theirs, leg.hinge
    if hinge is None:
        raise ValueError(f"{leg.ours} is no hinge")
    step, shift, to = _smallest_motion(hinge.in_parent, target, (was * joint.in_child).translation)
    in_child, shift_child, turn_child = joint.in_child, np.zeros(3), 0.0
    if standing is not None:
        other, shift_child, _ = _smallest_motion(
            hinge.in_child, target.moved(standing.inverse()), joint.in_child.translation
        )
        new = Hinge(step * hinge.in_parent, other * hinge.in_child)
        turn = new.angle(standing) - hinge.angle(was)
        back = pin.SE3(axis_rotation(2, -turn), np.array([0.0, 0.0, -new.slide(standing)]))
        in_child = new.in_child * back * hinge.in_child.actInv(joint.in_child)
        turn_child = _angle(hinge.in_child.rotation[:, 2], new.in_child.rotation[:, 2])
    return _Put(
        in_parent=step * joint.in_parent,
        in_child=in_child,
        centre=to,
        shifts=(shift, shift_child),
        turns=(_turn(pin.SE3.Identity(), step), turn_child),
    )


def _smallest_motion(hinge: pin.SE3, target: Axis, centre: Array) -> tuple[pin.SE3, Array, Array]:
    """The rigid motion that takes a hinge's axis (z of its frame) to a line, how far that shifts the point of the axis
    next to `centre`, and where that point is then.
    """
    axis = _line(hinge)
    direction = target.direction * (1.0 if target.direction @ axis.direction >= 0 else -1.0)
    at = axis.nearest(centre)
    to = target.nearest(at)
    turn = pin.Quaternion.FromTwoVectors(axis.direction, direction).toRotationMatrix()
    return pin.SE3(np.eye(3), to) * pin.SE3(turn, np.zeros(3)) * pin.SE3(np.eye(3), -at), to - at, to


def _line(hinge: pin.SE3) -> Axis:
    return Axis(hinge.translation, hinge.rotation[:, 2])


def _angle(a: Array, b: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _turn(a: pin.SE3, b: pin.SE3) -> float:
    return float(np.linalg.norm(pin.log3(a.rotation.T @ b.rotation)))


def _shift(a: pin.SE3, b: pin.SE3) -> float:
    return float(np.linalg.norm(a.translation - b.translation))


JOINTS_HEADER = (
    "joint,theirs,verdict,standard_error_left,in,body,shift_x_mm,shift_y_mm,shift_z_mm,moved_mm,moved_se_mm,turned_deg,"
    "turned_se_deg,standing_mm,standing_deg"
)


def joints_csv(done: CalibratedOsim) -> str:
    """A row for either end of every joint; a figure that does not exist is left out."""
    lines = [JOINTS_HEADER]
    for move in done.joints:
        known = f"{move.known:.3f}" if np.isfinite(move.known) else ""
        start = f'{move.joint},"{move.theirs}",{move.verdict.name.lower()},{known}'
        for name, end in (("parent", move.parent), ("child", move.child)):
            if end is None:
                continue
            numbers = [*(1e3 * end.shift), 1e3 * end.moved, 1e3 * end.errors[0]]
            numbers += [np.degrees(end.turn), np.degrees(end.errors[1]), 1e3 * move.rolls[0], np.degrees(move.rolls[1])]
            words = ",".join(f"{x:.4f}" if np.isfinite(x) else "" for x in numbers)
            lines.append(f'{start},{name},"{end.body}",{words}')
        if move.parent is None:
            lines.append(start + "," * (JOINTS_HEADER.count(",") - start.count(",")))
    return "\n".join(lines) + "\n"
