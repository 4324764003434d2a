"""Transfer a person's calibrated hips, knees and ankles into an OpenSim model of the user.

Bodies stay where they are, with all that is fixed to them: meshes, muscle points, wraps, markers.
Only the frames of joints in these bodies move. Let G_b be the pose of body b in the laboratory
while the person stands, by our calibrated linkage and the registration of b to our segment
(`osim_registration.py`), P and C the joint's frames in parent p and child c, M(q) its motion, and
q0 its coordinates as the person stands. For a ball joint

    P' = D P,    C' = (G_p^-1 G_c)^-1 P' M(q0),

with D the translation of its centre to ours. The bones then stand as before, with the same
coordinates q0. q0 are the coordinates of the original model that rotate its bones relative to each
other as ours are rotated.

A hinge of the model is A Rz(theta) B^-1, exactly or nearly (`osim_correspondence.py`). Let D and E
be the smallest rigid motions, translations across the axis and rotations of it, that move A's line
to our axis in p and B's to our axis in c. For a hinge

    P' = D P,    C' = E B Tz(-d) Rz(-phi) B^-1 C,

with d and phi the translation and rotation of our standing bones in the new hinge, D A and E B,
relative to those of the model at q0. M is moved as a whole: a knee that rolls keeps its functions
and rolls about our axis. The standing bones then differ by the rolling at q0, which is reported.

The talus is between shank and foot and carries no marker: it moves with the joint above it. Of the
joints between two registered bodies, all but the last keep their frame in the child, and the last
one closes the chain.

A joint that the recordings hardly determine stays as it is: where the standard errors of its
parameters are more than `UNDETERMINED_SHARE` of those before any trial. In draws it varies about
its position by these errors: in either body by the motion from our calibrated axis to the drawn
one.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources, compute_posterior_ratio
from gaitcal.export.opensim import joint_moves, osim_registration
from gaitcal.export.opensim.osim_correspondence import (
    LegJoint,
    MovedJoint,
    compute_smallest_motion,
    find_leg_joints,
    measure_distance,
    measure_rotation,
    move_ball_joint,
    move_hinge,
    solve_standing_coordinates,
)
from gaitcal.export.opensim.osim_reader import (
    BodyMass,
    FramePlacement,
    OsimDocument,
    build_peer_model,
    read_document,
)
from gaitcal.export.opensim.peer_model import PeerModel
from gaitcal.model.linkage import NEEDED_JOINTS, SIDES
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Parameters, view_as_table
from gaitcal.model.subject_model import SubjectModel
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.normal_prior import JointPrior

UNDETERMINED_SHARE = 0.9
"""Of the standard error before any trial: nine tenths are a fifth less variance."""
MISFIT_M = 0.010
"""m RMS: markers of a model that was scaled to the person, and moved to the static trial, agree to
some millimetres.
"""
FAR_M = 0.020
"""m: twice the error of the best regressions of the hip, in three directions together
(`calibration/joint_prior.py`).
"""
ROLLING_M = 1e-4
"""m RMS from a hinge, above which a joint rolls."""


@dataclass(frozen=True, kw_only=True)
class CalibratedOsim:
    """Model of the user with the joints of this person."""

    content: bytes
    """Content of the file."""
    joints: tuple[joint_moves.JointMove, ...]
    legs: tuple[LegJoint, ...]
    """Joints of the model, and how they were found."""
    registrations: tuple[osim_registration.Registration, ...]
    masses: tuple[osim_registration.SegmentMass, ...]
    """Segments whose bodies got the masses of ours; empty unless requested."""
    moved_points: tuple[joint_moves.MovedPoints, ...]
    """Points of each muscle that moved with a bone; empty unless requested."""
    notes: tuple[str, ...]
    """What the user should know, a sentence each."""
    transfer: "Transfer"
    """Everything that was read, from which draws are made."""

    @property
    def unchanged(self) -> tuple[str, ...]:
        """Joints (our names) that stay because the recordings hardly determine them."""
        return tuple(
            move.joint
            for move in self.joints
            if move.outcome is joint_moves.MoveOutcome.UNDETERMINED
        )

    def draw(self, rng: np.random.Generator) -> bytes:
        """Draw a file: joint parameters and registrations from their errors.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        bytes
            Content of the file.
        """
        return self.transfer.draw(rng)


@with_one_blas_thread
def transfer_joints(
    model: SubjectModel,
    osim: Path | str,
    *,
    errors: ErrorSources | None = None,
    prior: JointPrior | None = None,
    names: Path | None = None,
    recorded: Mapping[str, Array] | None = None,
    marker_set: MarkerSet | None = None,
    masses: bool = False,
    inertial: Array | None = None,
    follow: bool = False,
) -> CalibratedOsim:
    """Transfer the leg joints of a calibrated model into an OpenSim model (3.x or 4.x).

    Parameters
    ----------
    model : SubjectModel
        Calibrated model.
    osim : Path or str
        OpenSim model file of the user; it is not changed.
    errors : ErrorSources, optional
        Errors of the joint parameters (`Uncertainty.joint`). Without them parameters are taken as
        exact, and every joint as determined.
    prior : JointPrior, optional
        Knowledge of the joints before any trial; by default anatomy.
    names : Path, optional
        TOML file with the names of joints (`read_names`).
    recorded : mapping, optional
        Our coordinate -> (n,) rad in the recordings: the range over which a hinge represents a knee
        that rolls. Default: a stride of the built-in person.
    marker_set : MarkerSet, optional
        Its landmarks that are markers of the static trial are used to register bodies as well.
    masses : bool
        Give the bodies the masses of our segments (`compute_body_masses`).
    inertial : (84, n) Array, optional
        R with covariance R R^T of the inertial parameters (`Uncertainty.inertial`). Without it all
        draws have the same masses.
    follow : bool
        Move muscle points, wraps and meshes with the joints at both ends of their bone
        (`joint_moves.py`).

    Returns
    -------
    CalibratedOsim
        Content of the new file, and what was changed. Nothing is written.

    Raises
    ------
    InputError
        The file is no model, its legs cannot be identified, or its markers do not fit this person.
    """
    model = model if marker_set is None else osim_registration.add_landmarks(model, marker_set)
    document = read_document(osim)
    peer = build_peer_model(document)
    legs = find_leg_joints(peer, names, recorded)
    return Transfer(
        model=model,
        document=document,
        peer=peer,
        legs=legs,
        bodies=osim_registration.register_bodies(model, peer, legs),
        errors=errors,
        error_ratios={leg.ours: compute_posterior_ratio(leg.ours, errors, prior) for leg in legs},
        masses=masses,
        inertial=inertial,
        follow=follow,
    ).apply()


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """Everything that is read once; each draw of joint parameters makes another file of it."""

    model: SubjectModel
    document: OsimDocument
    peer: PeerModel
    legs: tuple[LegJoint, ...]
    bodies: Mapping[str, osim_registration.Registration]
    """Our segment -> registration."""
    errors: ErrorSources | None
    error_ratios: Mapping[str, float]
    """Our joint -> standard error of its parameters relative to that before any trial."""
    masses: bool
    """Whether bodies get the masses of our segments."""
    inertial: Array | None
    """(84, n) R with covariance R R^T of the inertial parameters."""
    follow: bool
    """Whether what is fixed to a bone moves with its joints."""

    def apply(self) -> CalibratedOsim:
        """Apply the calibrated parameters.

        Returns
        -------
        CalibratedOsim
        """
        moves, (weights, masses) = self.compute_moves(), self._compute_masses()
        bones = self._find_bones(moves)
        return CalibratedOsim(
            content=self._write_content(moves, weights, self.legs),
            masses=masses,
            moved_points=joint_moves.summarise_muscle_points(self.document, bones),
            joints=moves,
            legs=self.legs,
            registrations=tuple(self.bodies.values()),
            notes=tuple(self._list_notes(moves)),
            transfer=self,
        )

    def draw(self, rng: np.random.Generator) -> bytes:
        """Draw a file: joints, masses if they are transferred, and registrations from their errors.

        Joints that stay vary about their position.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        bytes
            Content of the file.
        """
        calibrated = self.model.parameters
        parameters = self._draw_parameters(rng)
        bodies = {s: replace(r, pose=r.draw_pose(rng)) for s, r in self.bodies.items()}
        unchanged = {
            leg.ours: osim_registration.perturb_joint(
                leg, self.peer, self.bodies, calibrated, parameters
            )
            for leg in self.legs
            if self._is_undetermined(leg.ours)
        }
        other = replace(
            self,
            model=replace(self.model, parameters=parameters),
            legs=tuple(unchanged.get(leg.ours, leg) for leg in self.legs),
            peer=self.peer.replace_joints(leg.theirs for leg in unchanged.values()),
            bodies=bodies,
            errors=None,
        )
        return other._write_content(other.compute_moves(), other._compute_masses()[0], self.legs)

    def _draw_parameters(self, rng: np.random.Generator) -> Parameters:
        """Draw joint parameters and, if masses are transferred, inertial ones from their errors."""
        parameters = self.model.parameters
        if self.errors is not None:
            # Of all free parameters only those of joints: soft tissue is left out.
            joint = self.errors.select([name for name in self.errors.names if name in JP_INDEX])
            indices = [JP_INDEX[name] for name in joint.names]
            change = joint.effects @ rng.normal(size=joint.effects.shape[1])
            parameters = parameters.with_joint(joint.names, parameters.joint[indices] + change)
        if self.masses and self.inertial is not None:
            # Draw again until all masses are positive.
            inertial = np.full_like(parameters.inertial, -1.0)
            while (view_as_table(inertial)[:, 0] <= 0.0).any():
                change = self.inertial @ rng.normal(size=self.inertial.shape[1])
                inertial = parameters.inertial + change
            parameters = parameters.with_inertial(inertial)
        return parameters

    def _is_undetermined(self, joint: str) -> bool:
        """Check whether the recordings hardly determine a joint."""
        return self.error_ratios[joint] > UNDETERMINED_SHARE

    def _compute_masses(
        self,
    ) -> tuple[dict[str, BodyMass], tuple[osim_registration.SegmentMass, ...]]:
        """Compute masses of bodies and segments, where they are transferred."""
        if not self.masses:
            return {}, ()
        return osim_registration.compute_body_masses(
            self.model.parameters, self.document, self.peer, self.bodies
        )

    def _write_content(
        self,
        moves: Sequence[joint_moves.JointMove],
        weights: Mapping[str, BodyMass],
        legs: Sequence[LegJoint],
    ) -> bytes:
        """Write the file with moved joints and new masses; `legs`: joints as they were read."""
        places: dict[tuple[str, str], FramePlacement] = {}
        # Frames of a joint in both of its bodies, as read and as moved.
        ends = {move.joint: (move.parent, move.child) for move in moves}
        for was, now in zip(legs, self.legs, strict=True):
            for name, end in zip(("parent", "child"), ends[was.ours], strict=True):
                before, after = (getattr(joint.theirs, f"in_{name}") for joint in (was, now))
                after = after if end is None else end.frame
                translated = measure_distance(before, after) > joint_moves.UNMOVED_M
                rotated = measure_rotation(before, after) > joint_moves.UNMOVED_RAD
                # Numbers that do not change keep their very bytes.
                if translated or rotated:
                    places[was.theirs.name, name] = FramePlacement(
                        after.translation if translated else None,
                        after.rotation if rotated else None,
                    )
        bones, names = self._find_bones(moves), {leg.theirs.name for leg in legs}
        # Other joints in a bone (patella, back) follow it.
        for joint in self.peer.joints.values():
            if joint.parent in bones and joint.name not in names:
                point = bones[joint.parent].map_point(joint.in_parent.translation)
                places[joint.name, "parent"] = FramePlacement(point, None)
        meshes = {body: bone.rigid for body, bone in bones.items()}
        attachments = joint_moves.move_attachments(self.document, bones)
        return self.document.apply_changes(places, weights, attachments, meshes)

    def _find_bones(self, moves: Sequence[joint_moves.JointMove]) -> dict[str, joint_moves.Bone]:
        """Find the bones that take along what is fixed to them."""
        return joint_moves.find_moved_bones(moves, self.peer, self.legs) if self.follow else {}

    def compute_moves(self) -> tuple[joint_moves.JointMove, ...]:
        """Compute the new frames of every joint of both legs, and whether it moves.

        Returns
        -------
        tuple of JointMove
            Right leg, then left, from hip to subtalar joint; joints that the model lacks as well.
        """
        segments = osim_registration.fit_standing_segments(self.model, self.model.parameters)
        stand = {r.body: segments[s] * r.pose for s, r in self.bodies.items()}
        found: dict[str, joint_moves.JointMove] = {}
        for side in SIDES:
            legs = [leg for leg in self.legs if leg.ours.endswith(f"_{side}")]
            ends = ["pelvis", f"thigh_{side}", f"shank_{side}", f"foot_{side}"]
            for above, below in pairwise(ends):
                if above in self.bodies and below in self.bodies:
                    pair = self.bodies[above].body, self.bodies[below].body
                    for move in self._move_joints_between(*pair, legs, segments, stand):
                        found[move.joint] = move
        absent = partial(
            joint_moves.JointMove,
            theirs="",
            outcome=joint_moves.MoveOutcome.ABSENT,
            error_ratio=float("nan"),
            standing={},
        )
        names = [f"{joint}_{side}" for side in SIDES for joint in NEEDED_JOINTS]
        return tuple(found.get(name) or absent(joint=name) for name in names)

    def _move_joints_between(
        self,
        top: str,
        bottom: str,
        legs: Sequence[LegJoint],
        segments: Mapping[str, pin.SE3],
        stand: Mapping[str, pin.SE3],
    ) -> Iterator[joint_moves.JointMove]:
        """Move the joints between two registered bodies, from top to bottom."""
        row = self.peer.list_joints_between(top, bottom)
        ours = {leg.theirs.name: leg for leg in legs}
        # Their joints in our standing posture: segment by segment, our static trial on their bones.
        q0 = solve_standing_coordinates(self.peer, row, stand[top].actInv(stand[bottom]), ours)
        moving = [j for j in row if j.name in ours and not self._is_undetermined(ours[j.name].ours)]
        # Pose of the joint's parent in the laboratory, body by body downwards.
        pose = stand[top]
        for joint in row:
            leg, was = ours.get(joint.name), self.peer.compute_joint_pose(joint, q0)
            if leg is None:
                pose = pose * was
                continue
            move = partial(
                joint_moves.JointMove,
                joint=leg.ours,
                theirs=joint.name,
                error_ratio=self.error_ratios[leg.ours],
                standing={c.name: q0[c.name] for c in joint.coordinates if c.name in q0},
            )
            if joint not in moving:
                yield move(outcome=joint_moves.MoveOutcome.UNDETERMINED)
                pose = pose * was
                continue
            # The last moving joint closes the chain to the standing bones below.
            standing = None
            if joint is moving[-1]:
                below = self.peer.compute_body_pose(bottom, joint.child, q0)
                standing = pose.actInv(stand[bottom] * below.inverse())
            # The parent of a subtalar joint, the talus, has no markers: its axis is that in the
            # foot.
            in_parent = not leg.ours.startswith("subtalar")
            our_joint = osim_registration.JOINT_OF[leg.ours]
            segment = our_joint.parent if in_parent else our_joint.child
            # Our axis in our segment, then in the laboratory, then in their body.
            axis = osim_registration.compute_joint_axis(leg.ours, self.model.parameters, in_parent)
            target = axis.transform(pose.actInv(segments[segment]))
            move_joint = move_ball_joint if leg.hinge is None else move_hinge
            moved = move_joint(leg, was, target, standing)
            motion = joint.in_parent.actInv(was * joint.in_child)
            now = moved.in_parent * motion * moved.in_child.inverse()
            rolling = (0.0, 0.0)
            if standing is not None:
                rolling = (measure_distance(standing, now), measure_rotation(standing, now))
            ends = self._make_ends(leg, was, moved, pose.act(moved.centre), segments)
            yield move(
                outcome=joint_moves.MoveOutcome.MOVED,
                rolling=rolling,
                parent=ends[0],
                child=ends[1],
            )
            pose = pose * now

    def _make_ends(
        self,
        leg: LegJoint,
        was: pin.SE3,
        moved: MovedJoint,
        centre: Array,
        segments: Mapping[str, pin.SE3],
    ) -> list[joint_moves.JointEnd]:
        """Make parent's and child's end of a moved joint; `centre`: (3,) m, laboratory."""
        joint = leg.theirs
        ends = []
        for in_parent, body, start, before, after in (
            (True, joint.parent, was * joint.in_child, joint.in_parent, moved.in_parent),
            (False, joint.child, joint.in_child, joint.in_child, moved.in_child),
        ):
            translated = measure_distance(before, after) > joint_moves.UNMOVED_M
            rotated = measure_rotation(before, after) > joint_moves.UNMOVED_RAD
            end = joint_moves.JointEnd(
                body=body,
                centre=start.translation,
                frame=after,
                displacement=moved.displacements[not in_parent],
                rotation=moved.rotations[not in_parent],
                errors=self._estimate_errors(leg.ours, in_parent, centre, segments),
                changed=translated or rotated,
                landmarks=self._measure_landmark_distance(leg, in_parent),
            )
            ends.append(end)
        return ends

    def _measure_landmark_distance(self, leg: LegJoint, in_parent: bool) -> float:
        """Measure the distance (m) of a joint, as read, from that of the nominal model in one body.

        NaN in a body that is not registered.
        """
        ours, joint = osim_registration.JOINT_OF[leg.ours], leg.theirs
        segment, body, frame = ours.child, joint.child, joint.in_child
        if in_parent:
            segment, body, frame = ours.parent, joint.parent, joint.in_parent
        registration = self.bodies.get(segment)
        if registration is None or registration.body != body:
            return float("nan")
        axis = osim_registration.compute_joint_axis(leg.ours, self.model.nominal, in_parent)
        target = axis.transform(registration.pose.inverse())
        if leg.hinge is None:
            return float(np.linalg.norm(target.point - frame.translation))
        line = leg.hinge.in_parent if in_parent else leg.hinge.in_child
        return float(np.linalg.norm(compute_smallest_motion(line, target, frame.translation)[1]))

    def _estimate_errors(
        self, joint: str, in_parent: bool, point: Array, segments: Mapping[str, pin.SE3]
    ) -> tuple[float, float]:
        """Estimate standard errors (m, rad) of a joint in one body; `point`: (3,) m, laboratory."""
        ours, parameters = osim_registration.JOINT_OF[joint], self.model.parameters
        segment = ours.parent if in_parent else ours.child
        registration = self.bodies.get(segment)
        if registration is None:
            return float("nan"), float("nan")
        is_hip = joint.startswith("hip")
        local = segments[segment].actInv(point)
        axis = osim_registration.compute_joint_axis(joint, parameters, in_parent)
        # Along the axis of a hinge nothing is counted.
        across = np.eye(3) if is_hip else np.eye(3) - np.outer(axis.direction, axis.direction)
        # Two independent errors: of the registration of the bodies, and of our joint.
        translation = registration.compute_point_covariance(local)
        rotation = registration.rotation_covariance
        names = [p.name for p in JOINT_PARAMETERS if p.joint == joint and p.segment == segment]
        free = [] if self.errors is None else [n for n in names if n in self.errors.names]
        if self.errors is not None and free:
            jacobian = self._differentiate_axis(joint, in_parent, local, free)
            covariance = jacobian @ self.errors.select(free).covariance @ jacobian.T
            translation = translation + covariance[:3, :3]
            rotation = across @ rotation @ across + covariance[3:, 3:]
        size = float(np.sqrt(np.trace(across @ translation @ across)))
        if is_hip:
            return size, float("nan")
        return size, float(np.sqrt(np.trace(across @ rotation @ across)))

    def _differentiate_axis(
        self, joint: str, in_parent: bool, local: Array, names: Sequence[str]
    ) -> Array:
        """Differentiate point and direction (6, n) of a joint's axis with respect to parameters.

        Central differences. The point is that nearest to `local` (3,) m, of a hip its centre.
        """
        parameters = self.model.parameters
        jacobian = np.zeros((6, len(names)))
        for k, name in enumerate(names):
            value = parameters.joint[JP_INDEX[name]]
            sides = []
            for step in (_DIFFERENCE_STEP, -_DIFFERENCE_STEP):
                changed = parameters.with_joint((name,), np.array([value + step]))
                axis = osim_registration.compute_joint_axis(joint, changed, in_parent)
                point = axis.point if joint.startswith("hip") else axis.find_nearest(local)
                sides.append(np.concatenate([point, axis.direction]))
            jacobian[:, k] = (sides[0] - sides[1]) / (2 * _DIFFERENCE_STEP)
        return jacobian

    def _list_notes(self, moves: Sequence[joint_moves.JointMove]) -> Iterator[str]:
        """List what a user should know, a sentence each."""
        if self.follow:
            yield from self._list_bodies_that_stay(moves)
        for move in moves:
            yield from self._list_joint_notes(move)
        by_axes = [r for r in self.bodies.values() if r.by_axes]
        if by_axes:
            yield (
                f"{', '.join(r.body for r in by_axes)}: registered by the axes of joints, up to "
                f"{1e3 * max(r.rms for r in by_axes):.0f} mm from this person's, because too few "
                "markers are common; nothing shows that the model has this person's size: "
                f"{osim_registration.NAME_OR_SCALE}"
            )
        for r in self.bodies.values():
            if r.rms > MISFIT_M and not r.by_axes:
                yield (
                    f"{r.body}: its markers are {1e3 * r.rms:.0f} mm from this person's; it may "
                    "have another size: scale the model to this person first, with these markers, "
                    "and export again"
                )

    def _list_bodies_that_stay(self, moves: Sequence[joint_moves.JointMove]) -> Iterator[str]:
        """List bodies with a moved joint whose attachments cannot follow; feet excepted."""
        ends = [end for move in moves for end in (move.parent, move.child) if end is not None]
        moved = {end.body for end in ends if end.moved > joint_moves.UNMOVED_M}
        feet = set()
        for leg in self.legs:
            if leg.ours.startswith(("talocrural", "subtalar")):
                feet.add(leg.theirs.child)
            if leg.ours.startswith("subtalar"):
                feet.add(leg.theirs.parent)
        stay = sorted(moved - feet - self._find_bones(moves).keys())
        if stay:
            yield (
                f"{', '.join(stay)}: no bone between two joints (hips, or hip and knee, or knee "
                "and ankle), so that muscle points, wraps and meshes there do not follow"
            )

    def _list_joint_notes(self, move: joint_moves.JointMove) -> Iterator[str]:
        """List notes on one joint: rolling, attached elements, large displacements."""
        deviations = {leg.ours: leg.hinge.deviation for leg in self.legs if leg.hinge is not None}
        # m, of a knee that rolls and glides, from the nearest hinge.
        deviation = deviations.get(move.joint, 0.0)
        if move.outcome is joint_moves.MoveOutcome.MOVED and deviation > ROLLING_M:
            yield (
                f"{move.theirs} is no hinge: over the postures of the recordings "
                f"{1e3 * deviation:.1f} mm RMS from the nearest one, which its standard errors and "
                "draws do not contain"
            )
        ends = [end for end in (move.parent, move.child) if end is not None]
        if any(end.changed for end in ends):
            names = self.document.list_attached_elements(move.theirs)
            if names:
                attached = ", ".join(names)
                yield f"{attached}: fixed to a frame of joint {move.theirs}, and moved with it"
        far = [end for end in ends if end.moved > FAR_M]
        if far:
            distances = ", ".join(f"{1e3 * end.moved:.0f}" for end in far)
            by_landmarks = ", ".join(
                "?" if np.isnan(end.landmarks) else f"{1e3 * end.landmarks:.0f}" for end in far
            )
            attachments = ": muscle points near it stay on their bones and may no longer fit"
            yield (
                f"{move.theirs} moves by more than {1e3 * FAR_M:.0f} mm in "
                f"{', '.join(end.body for end in far)} ({distances} mm; by the landmarks of the "
                f"static trial alone {by_landmarks}){'' if self.follow else attachments}"
            )


_DIFFERENCE_STEP = 1e-6
"""m, rad, of central differences."""
