"""Are our angles, moments and powers those of the laboratory's own program, and are frames valid
where they should be?

    vendors [--only kad,multi,children,pig] [--calibrated]

Recordings of four laboratories hold Plug-in Gait's angles, moments and powers beside the markers
(`GAITCAL_DATA` names their folder). Every walk goes through the nominal model of its static trial,
or with `--calibrated` through joints fitted to all of them, tracked with the soft tissue artefact
that was found; the RMS of the mean differences of angles over walks and legs come last. The table
says of each joint, over all walks of a laboratory: RMS difference of the angles in degrees (raw,
and without the mean difference of each walk and leg), their correlation; RMS difference of the
moments in N·m/kg in stance, over frames that are valid for the whole body, for the leg, and for the
leg alone ("new": a leg's frames that the whole body's rule leaves out); that of the powers in W/kg.
The vendor is no truth: it takes a force that a plate measures only in part for the whole. But
frames that are new may not be worse than others. Then the moments again, ours along the axes of our
coordinates, of either segment and of the joint coordinate system: Plug-in Gait tells them in the
distal segment unless it is told otherwise. Then, by the file's own foot strikes and offs: how many
strides are valid throughout, by either rule, and how much of the stances in which a plate carries
the foot.

`RKneeAngles` and `RKneeMoment` hold three curves each: sagittal, frontal, transverse. Files call
the unit of their moments `Nmm` and mean N·mm/kg, mostly; external moments have the other sign.
Neither is believed: the unit is the one that comes nearest to our own moments in size, the sign
that of their correlation. Powers (`W`) are those of W/kg.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import ezc3d
import numpy as np

from gaitcal import Study
from gaitcal.analysis.fit_joints import fit_joints
from gaitcal.analysis.prepared_trials import (
    MovingTrial,
    compute_trial_reactions,
    prepare_calibration,
    prepare_trial,
)
from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Moments, compute_moments
from gaitcal.dynamics.joint_kinetics import (
    VECTOR_FRAMES,
    JointKinetics,
    MomentFrame,
    component_of,
    compute_kinetics,
    power_of,
)
from gaitcal.gait.moments import get_moment
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.tracking.motion import Motion, track_motion
from scripts.validation.harness import matching, option, rms, say
from scripts.validation.recordings import CHILDREN, study_of_person

SHARED = ("--only",)
OWN = {"--calibrated": option(False, "with fitted joints and the artefact that was found")}
LABS = {"kad": ("kad",), "multi": ("multi",), "children": CHILDREN, "pig": ("pig",)}
"""Laboratory -> its people."""
UNITS: dict[str, Callable[[float], float]] = {
    "N·mm/kg": lambda mass: 1e-3,
    "N·m/kg": lambda mass: 1.0,
    "N·mm": lambda mass: 1e-3 / mass,
}
"""Name -> factor to N·m/kg, of a body of this mass (kg)."""


@dataclass(frozen=True)
class Quantity:
    """One of our curves, and the vendor's of the same."""

    ours: str
    """Without its side: `hip_flexion`."""
    theirs: str
    """Without its side: `HipAngles`."""
    axis: int
    """0 sagittal, 1 frontal, 2 transverse; a power has one curve, the last."""

    @property
    def kind(self) -> str:
        return next(kind for kind in ("angle", "moment", "power") if kind in self.theirs.lower())

    @property
    def words(self) -> str:
        return f"{self.ours} {self.kind}"


ANKLE_MOMENT = Quantity("ankle_angle", "AnkleMoment", 0)
QUANTITIES = (
    Quantity("hip_flexion", "HipAngles", 0),
    Quantity("hip_adduction", "HipAngles", 1),
    Quantity("hip_rotation", "HipAngles", 2),
    Quantity("knee_angle", "KneeAngles", 0),
    Quantity("ankle_angle", "AnkleAngles", 0),
    Quantity("hip_flexion", "HipMoment", 0),
    Quantity("hip_adduction", "HipMoment", 1),
    Quantity("knee_angle", "KneeMoment", 0),
    Quantity("knee_adduction", "KneeMoment", 1),
    ANKLE_MOMENT,
    Quantity("hip", "HipPower", 2),
    Quantity("knee", "KneePower", 2),
    Quantity("ankle", "AnklePower", 2),
)
IN_FRAMES = (
    *(q for q in QUANTITIES if q.kind == "moment"),
    Quantity("hip_rotation", "HipMoment", 2),
    Quantity("knee_rotation", "KneeMoment", 2),
    Quantity("ankle_inversion", "AnkleMoment", 1),
    Quantity("ankle_rotation", "AnkleMoment", 2),
)
"""Moments that are told in the frames of segments, too."""


def vendor_curves(path: str) -> dict[str, Array]:
    """Name (`RHipAngles`) -> (nf, 3) as the file has it, NaN where it says nothing (zeros, or no
    number).
    """
    file = ezc3d.c3d(path)
    group = file["parameters"]["POINT"]
    labels = [
        label
        for name in ("LABELS", "LABELS2", "LABELS3")
        if name in group
        for label in group[name]["value"]
    ]
    names = {side + q.theirs for side in "RL" for q in (*QUANTITIES, *IN_FRAMES)}
    out = {}
    for k, label in enumerate(labels):
        plain = str(label).split(":")[-1].strip()
        if plain in names:
            curve = np.moveaxis(file["data"]["points"][:3, k], 0, -1).astype(float)
            known = np.isfinite(curve).all(axis=1) & (curve != 0.0).any(axis=1)
            out[plain] = np.where(known[:, None], curve, np.nan)
    return out


def unit_of(ours: Sequence[Array], theirs: Sequence[Array], mass: float) -> str:
    """The unit in which the vendor's moments are as large as ours (N·m/kg); frames where either is
    NaN do not count.
    """
    one, other = np.concatenate(ours), np.concatenate(theirs)
    both = np.isfinite(one) & np.isfinite(other)
    if not both.any():
        return next(iter(UNITS))
    ratio = np.sqrt(np.mean(one[both] ** 2) / np.mean(other[both] ** 2))
    return min(UNITS, key=lambda name: abs(float(np.log(ratio / UNITS[name](mass)))))


def sign_of(ours: Array, theirs: Array) -> float:
    """1 or -1, that of the correlation of two curves; frames where either is NaN do not count."""
    both = np.isfinite(ours) & np.isfinite(theirs)
    if both.sum() < 2:
        return 1.0
    covariance = np.mean((ours[both] - ours[both].mean()) * (theirs[both] - theirs[both].mean()))
    return -1.0 if covariance < 0 else 1.0


@dataclass(frozen=True, kw_only=True)
class Walk:
    name: str
    mass: float
    """kg."""
    motion: Motion
    moments: Moments
    kinetics: JointKinetics
    reactions: GroundReactions
    theirs: dict[str, Array]
    """(nf, 3) each, as the file has them."""
    events: tuple[FootEvent, ...]

    def pair(
        self, quantity: Quantity, side: str, frame: MomentFrame = MomentFrame.COORDINATES
    ) -> tuple[Array, Array]:
        """(nf,) ours, deg, N·m/kg or W/kg, and (nf,) theirs as the file has it; NaN where the file
        says nothing.
        """
        name = f"{quantity.ours}_{side}"
        if quantity.kind == "power":
            ours = power_of(self.kinetics, name) / self.mass
        elif frame is not MomentFrame.COORDINATES:
            ours = component_of(self.kinetics, name, frame) / self.mass
        elif quantity.kind == "moment":
            ours = get_moment(self.moments, name) / self.mass
        else:
            ours = np.degrees(self.motion.q[:, self.motion.coordinates.index(name)])
        curve = self.theirs.get(f"{side.upper()}{quantity.theirs}")
        return ours, np.full(len(ours), np.nan) if curve is None else curve[:, quantity.axis]

    def strides(self) -> Iterator[tuple[str, BoolArray]]:
        """Side and (nf,) frames of every stride, from strike to strike of the file."""
        for side in SIDES:
            strikes = [
                e.time for e in self.events if e.side == side and e.moment is FootMoment.STRIKE
            ]
            yield from ((side, self._between(*times)) for times in pairwise(strikes))

    def stances(self) -> Iterator[tuple[str, BoolArray]]:
        """Side and (nf,) frames of every stance, from strike to off of the file."""
        for side in SIDES:
            for one, other in pairwise(e for e in self.events if e.side == side):
                if (one.moment, other.moment) == (FootMoment.STRIKE, FootMoment.OFF):
                    yield side, self._between(one.time, other.time)

    def _between(self, begin: float, end: float) -> BoolArray:
        time = self.motion.time
        return np.asarray((time >= begin) & (time <= end))


def walk_of(study: Study, name: str, trial: str) -> Walk:
    """A gait trial of a study through its nominal model."""
    model = build_nominal_model(study)
    chosen = next(t for t in study.trials if t.name == trial)
    return _walk(name, prepare_trial(chosen, model, study.settings), model, model.parameters, study)


def calibrated_walks(study: Study, person: str) -> Iterator[Walk]:
    """The gait trials of a study by joints that are fitted to all of its trials."""
    session = fit_joints(prepare_calibration(preprocess_study(study)))
    for trial in session.trials:
        if trial.name in study.walks:
            yield _walk(f"{person} {trial.name}", trial, session.model, session.parameters, study)


def _walk(
    name: str, trial: MovingTrial, model: SubjectModel, parameters: Parameters, study: Study
) -> Walk:
    motion = track_motion(trial.whole_body_problem, parameters)
    reactions = compute_trial_reactions(trial, model, parameters, motion, study.settings)
    return Walk(
        name=name,
        mass=model.subject.mass,
        motion=motion,
        moments=compute_moments(parameters, motion, reactions.wrench, model.subject.bwh),
        kinetics=compute_kinetics(parameters, motion, reactions.wrench),
        reactions=reactions,
        theirs={
            k: c
            for k, c in vendor_curves(trial.recording.source).items()
            if len(c) == len(motion.time)
        },
        events=trial.recording.events,
    )


@dataclass(frozen=True, kw_only=True)
class Agreement:
    quantity: Quantity
    sign: float
    """The vendor's is multiplied by it."""
    correlation: float
    rms: dict[str, float]
    """`raw` and `even` (without offset) of an angle; `whole`, `leg`, `new` of a moment or power."""
    frames: dict[str, int]
    """Of each."""


def agreement(
    quantity: Quantity,
    walks: Sequence[Walk],
    unit: str,
    frame: MomentFrame = MomentFrame.COORDINATES,
) -> Agreement:
    """How near ours are to theirs over the walks of a laboratory, whose moments are in `unit`; ours
    in a frame.
    """
    pairs = {(w.name, side): w.pair(quantity, side, frame) for w in walks for side in SIDES}
    sign = sign_of(*(np.concatenate(values) for values in zip(*pairs.values(), strict=True)))
    parts: dict[str, list[Array]] = {}
    both: list[tuple[Array, Array]] = []
    for walk in walks:
        factor = sign * (UNITS[unit](walk.mass) if quantity.kind == "moment" else 1.0)
        for foot, side in enumerate(SIDES):
            ours, theirs = pairs[walk.name, side]
            theirs = factor * theirs
            known = np.isfinite(theirs)
            for name, frames in _frames(quantity, walk.reactions, foot).items():
                chosen = (ours - theirs)[known & frames]
                even = chosen - chosen.mean() if name == "even" and len(chosen) else chosen
                parts.setdefault(name, []).append(even)
                if name in ("raw", "leg"):
                    both.append((ours[known & frames], theirs[known & frames]))
    one, other = (np.concatenate(values) for values in zip(*both, strict=True))
    rows = {name: np.concatenate(values) for name, values in parts.items()}
    return Agreement(
        quantity=quantity,
        sign=sign,
        correlation=float(np.corrcoef(one, other)[0, 1]) if len(one) > 1 else float("nan"),
        rms={
            name: float(np.sqrt(np.mean(v**2))) if len(v) else float("nan")
            for name, v in rows.items()
        },
        frames={name: len(values) for name, values in rows.items()},
    )


def unit_of_walks(walks: Sequence[Walk]) -> str:
    """The unit of a laboratory's moments, by the ankle's."""
    ours, theirs = zip(
        *(walk.pair(ANKLE_MOMENT, side) for walk in walks for side in SIDES), strict=True
    )
    return unit_of(ours, theirs, walks[0].mass)


def _frames(quantity: Quantity, reactions: GroundReactions, foot: int) -> dict[str, BoolArray]:
    if quantity.kind == "angle":
        every = np.ones(len(reactions.valid), dtype=bool)
        return {"raw": every, "even": every}
    every = reactions.valid_legs[:, foot]
    leg = every & reactions.loaded[:, foot]
    return {"whole": leg & reactions.valid, "leg": leg, "new": leg & ~reactions.valid}


def counted(walks: Sequence[Walk]) -> Counter[str]:
    """`strides` by the file's events, of these `stepped` (a plate carries the stance), `whole` and
    `leg` (valid throughout, for the body or the leg); and of stances that a plate carries the
    frames (`stance`, ...).
    """
    out: Counter[str] = Counter()
    for walk in walks:
        whole = walk.reactions.valid
        leg, loaded = (
            dict(zip(SIDES, of.T, strict=True))
            for of in (walk.reactions.valid_legs, walk.reactions.loaded)
        )
        for side, f in walk.strides():
            out.update(
                strides=1, stepped=any(loaded[side][f]), whole=all(whole[f]), leg=all(leg[side][f])
            )
        for side, f in walk.stances():
            if loaded[side][f].any():
                out.update(
                    {
                        "stance": f.sum(),
                        "stance whole": whole[f].sum(),
                        "stance leg": leg[side][f].sum(),
                    }
                )
    return out


def report(lab: str, walks: Sequence[Walk]) -> Iterator[str]:
    unit = unit_of_walks(walks)
    found = [agreement(quantity, walks, unit) for quantity in QUANTITIES]
    (ankle,) = (a for a in found if a.quantity is ANKLE_MOMENT)
    signs = "external" if ankle.sign > 0 else "internal, extension positive"
    yield f"{lab}: {len(walks)} walks; moments in {unit}, {signs}"
    for kind, told in {"angle": "", "moment": ", N·m/kg", "power": ", W/kg"}.items():
        columns = ("raw", "even") if kind == "angle" else ("whole", "leg", "new")
        heads = "".join(f"{name + ' deg' if kind == 'angle' else name:>10}" for name in columns)
        yield (
            f"  {kind + told:24}{'sign':>5}{heads}{'r':>8}{'' if kind == 'angle' else '   frames'}"
        )
        for a in (a for a in found if a.quantity.kind == kind):
            values = "".join(f"{a.rms[name]:10.{1 if kind == 'angle' else 3}f}" for name in columns)
            frames = (
                ""
                if kind == "angle"
                else "   " + ", ".join(str(a.frames[name]) for name in columns)
            )
            yield f"  {a.quantity.words:24}{a.sign:5.0f}{values}{a.correlation:8.3f}{frames}"
    yield from in_frames(walks, unit)
    c = counted(walks)
    by = "valid {} by the whole body's rule, {} by the leg's"
    strides, stances = (
        by.format(c["whole"], c["leg"]),
        by.format(c["stance whole"], c["stance leg"]),
    )
    yield (
        f"  strides by events: {c['strides']}, {c['stepped']} with a stance on a plate; throughout "
        f"{strides}"
    )
    yield f"  frames of stances on a plate: {c['stance']}; {stances}"


def in_frames(walks: Sequence[Walk], unit: str) -> Iterator[str]:
    """Moments of the leg's valid frames, ours along the axes of every frame: RMS difference
    (N·m/kg), correlation.
    """
    frames = (MomentFrame.COORDINATES, *VECTOR_FRAMES)
    yield f"  {'frame: RMS N·m/kg, r':24}" + "".join(f"{frame.key:>18}" for frame in frames)
    for quantity in IN_FRAMES:
        cells = ""
        for frame in frames:
            if frame is MomentFrame.COORDINATES and quantity not in QUANTITIES:
                cells += f"{'':18}"
            else:
                a = agreement(quantity, walks, unit, frame)
                cells += f"{a.rms['leg']:10.3f}{a.correlation:8.3f}"
        yield f"  {quantity.words.removesuffix(' moment'):24}{cells}"


def offset_lines(walks: Sequence[Walk]) -> Iterator[str]:
    """RMS over walks and legs of the mean difference of each angle, deg."""
    every = list[float]()
    for quantity in (q for q in QUANTITIES if q.kind == "angle"):
        pairs = [walk.pair(quantity, side) for walk in walks for side in SIDES]
        sign = sign_of(*(np.concatenate(values) for values in zip(*pairs, strict=True)))
        gaps = [ours - sign * theirs for ours, theirs in pairs]
        means = [float(np.nanmean(gap)) for gap in gaps if np.isfinite(gap).any()]
        every += means
        yield f"  mean {quantity.words:24}{rms(means):6.2f} deg"
    yield f"  mean angles, all{'':13}{rms(every):6.2f} deg"


def run(chosen: argparse.Namespace) -> None:
    for lab in matching(chosen.only, LABS):
        studies = {person: study_of_person(person) for person in LABS[lab]}
        if chosen.calibrated:
            walks = [walk for person, s in studies.items() for walk in calibrated_walks(s, person)]
        else:
            walks = [
                walk_of(s, f"{person} {walk}", walk)
                for person, s in studies.items()
                for walk in s.walks
            ]
        say(*report(lab, walks), *offset_lines(walks))
