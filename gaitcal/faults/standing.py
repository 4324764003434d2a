"""How somebody stands in a static trial, and whether several static trials show one body. Arms play no part.

With the joint centres of the nominal model (hips by Bell) and the body axes of `body_plan.py`: the knee bends by the
angle between thigh and shank in the thigh's sagittal plane, and the thigh leans by its angle to the vertical.

Several static trials of one person: each segment's markers, and lengths across joints, must be those of the first. The
markers of a segment that both trials show are laid on each other (rotation R and shift t, least squares); what is left
of marker k, e_k = R x_k + t - x0_k, is its disagreement. Of three markers a displaced one shares its disagreement with
the others; of four or more the one without which the rest agrees best is named. Where fewer than three are common, the
distance between them is compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.faults.body_plan import body_axes
from gaitcal.faults.evidence import NEGLIGIBLE_WEIGHT, TrialEvidence
from gaitcal.findings import Finding, Severity, listed
from gaitcal.model.ankle_zero import AnkleZero, standing_ankles
from gaitcal.model.joint_centres import SIDE_WORDS, HipCentre, JointWidths
from gaitcal.model.landmark_names import REQUIRED
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import lower_body
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.rigid import rigid_fit
from gaitcal.study.study import Study, nominal_of

BENT_DEG = 30.0
"""Of a knee: in clean static trials of grown people and children it bends by -7 to 11 degrees; 20 more is a posture."""
UNEVEN_DEG, UNEVEN_M = 18.0, 0.045
"""Difference between the knees, and between the heights of the heels, from which somebody stands on one leg; up to 7
degrees and 5 mm in clean trials."""
SITTING_DEG = 60.0
"""Lean of the thighs from the vertical; standing: up to 10 degrees, crouching children up to 40."""
DISAGREE_M = 0.008
"""Largest disagreement of a marker between two times that one person stands: within a session markers of a segment keep
their shape to 5 mm (p99 over pelvis, thigh, shank and foot, standing against moving)."""
GROSS_M = 0.020
"""From here it moves a joint by more than nominal joints are uncertain: an error."""


def nominal_model_of(study: Study) -> tuple[SubjectModel | None, tuple[Finding, ...]]:
    """The nominal model, or what keeps the static trial from giving one."""
    try:
        return nominal_of(study), ()
    except InputError as fault:
        return None, (Finding.of_fault(fault, study.static.name, study.static.recording.source, "static trial"),)


@dataclass(frozen=True, kw_only=True)
class StandingLegs:
    """How the legs of a standing person are bent."""

    knees: tuple[float, float]
    """Degrees of flexion, right and left."""
    thighs: tuple[float, float]
    """Degrees by which the thighs lean from the vertical."""
    heels: float
    """m, height of the right heel above the left one."""

    @property
    def bent(self) -> bool:
        """Whether a knee bends further than people stand."""
        return max(self.knees) > BENT_DEG

    @property
    def uneven(self) -> bool:
        """Whether the legs do different things."""
        return abs(self.knees[0] - self.knees[1]) > UNEVEN_DEG or abs(self.heels) > UNEVEN_M

    @property
    def sitting(self) -> bool:
        """Whether both thighs lie."""
        return min(self.thighs) > SITTING_DEG


def standing_legs(p: Mapping[str, Array], height: float) -> StandingLegs | None:
    """The stance that landmarks p ((3,) m each, y up) of a person of this height (m) show; None where some lack."""
    axes = body_axes(p)
    if axes is None or any(name not in p for name in REQUIRED):
        return None
    body = lower_body(StaticPosture("", {}, p, {}), height, HipCentre.BELL)
    knees, thighs = [], []
    for side in SIDES:
        thigh, shank = body.frames[f"thigh_{side}"].rotation, body.frames[f"shank_{side}"].rotation
        up = thigh.T @ shank[:, 1]
        knees.append(float(np.rad2deg(np.arctan2(up[0], up[1]))))
        thighs.append(float(np.rad2deg(np.arccos(np.clip(thigh[1, 1], -1.0, 1.0)))))
    heels = float(p["heel_r"][1] - p["heel_l"][1])
    return StandingLegs(knees=(knees[0], knees[1]), thighs=(thighs[0], thighs[1]), heels=heels)


def standing_flat(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the feet of a static trial stand as the zero of the ankle angles was taken from them."""
    p, rule = trial.posture, AnkleZero(trial.settings.ankle_rule)
    if p is None or not trial.makes_model or rule is not AnkleZero.AUTO or any(name not in p for name in REQUIRED):
        return
    posture = StaticPosture(trial.source, {}, p, {})
    legs = lower_body(posture, trial.subject.height, HipCentre.HARRINGTON, widths=JointWidths.of(trial.subject))
    doubts = standing_ankles(posture, legs, trial.recording.facts.static_plantarflexion, rule).doubts
    if doubts:
        yield trial.finding(
            Severity.WARNING,
            "posture",
            "; ".join(f"{SIDE_WORDS[side]} foot: {why}" for side, why in doubts.items()),
            "look at the feet in that trial and say it under [calibration]: ankle_zero = 'sole' if they stand flat, "
            "'file' or 'markers' if the heels are off the floor",
            cause="the feet may not stand flat in the static trial, from which ankle angles are counted",
            leg="" if len(doubts) == 2 else next(iter(doubts)),
            code=Code.FEET_NOT_FLAT,
        )


def standing_straight(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the person of a static trial stands on both straight legs."""
    if trial.posture is None:
        return
    found = standing_legs(trial.posture, trial.subject.height)
    if found is None:
        return
    knees = f"knees bent by {found.knees[0]:.0f} deg (right) and {found.knees[1]:.0f} deg (left)"
    words = f"{knees}, thighs leaning by {found.thighs[0]:.0f} and {found.thighs[1]:.0f} deg"
    if found.sitting:
        yield trial.error(
            "posture",
            f"{words}; standing people lean by less than {SITTING_DEG:.0f}",
            "name the recording in which the person stands",
            cause="the person sits in the static trial",
            weight=5.0,
            code=Code.SITTING,
        )
    elif found.uneven:
        yield trial.warning(
            "posture",
            f"{knees}, right heel {1e3 * found.heels:+.0f} mm above the left one",
            "choose the part in which both feet stand with time = [start, end], or record standing again; nothing to "
            "do if the person cannot stand otherwise",
            cause="the person stands unevenly in the static trial",
            code=Code.UNEVEN_STANCE,
        )
    elif found.bent:
        yield trial.warning(
            "posture",
            f"{words}; most people stand within 10 deg",
            "record it again if the person can stand straighter; nothing to do if not: only the skin lies a little "
            "otherwise than over straight legs",
            cause="the person stands with bent knees in the static trial",
            code=Code.BENT_KNEES,
        )


def statics_agree(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Whether further static trials show the body of the first."""
    standing = [trial for trial in trials if trial.is_static]
    if not standing:
        return
    first, *others = standing
    reference = first.still_positions
    for other in others:
        positions = other.still_positions
        told = [
            (away, label, segment)
            for segment, labels in _segments(first).items()
            if (found := _disagreement([m for m in labels if m in reference and m in positions], reference, positions))
            for away, label in [found]
            if away > DISAGREE_M
        ]
        if not told:
            if positions and reference:
                yield other.info(
                    "static trial",
                    f"agrees with '{first.name}', which the model is made of",
                    code=Code.STATICS_DISAGREE,
                )
            continue
        told.sort(reverse=True)
        words = listed([f"'{label}' {1e3 * away:.0f} mm ({segment})" for away, label, segment in told])
        yield other.finding(
            Severity.ERROR if told[0][0] > GROSS_M else Severity.WARNING,
            "static trial",
            f"against the other markers of its segment: {words}; allowed: {1e3 * DISAGREE_M:.0f} mm",
            f"leave out the static trial whose markers moved or whose labels are wrong; '{first.name}', the first, "
            "gives the model",
            cause=f"static trials '{first.name}' and '{other.name}' do not show the same body",
            weight=told[0][0] / DISAGREE_M,
            code=Code.STATICS_DISAGREE,
        )


def _segments(trial: TrialEvidence) -> dict[str, list[str]]:
    """Segment -> its markers that decide anything, those of the static trial alone and landmarks included."""
    marker_set = trial.marker_set
    out: dict[str, list[str]] = {}
    for group in (marker_set.tracking, marker_set.static_only):
        for segment, labels in group.items():
            out.setdefault(segment, []).extend(m for m in labels if not 0 < marker_set.weight(m) <= NEGLIGIBLE_WEIGHT)
    loose = ("head_trunk", "upper_arm", "forearm")
    return {segment: labels for segment, labels in out.items() if not segment.startswith(loose)}


def _disagreement(
    labels: list[str], reference: dict[str, Array], positions: dict[str, Array]
) -> tuple[float, str] | None:
    """The largest disagreement (m) and the marker that is named for it."""
    if len(labels) < 2:
        return None
    a, b = (np.array([where[m] for m in labels]) for where in (reference, positions))
    if len(labels) == 2:
        away = abs(float(np.linalg.norm(a[1] - a[0]) - np.linalg.norm(b[1] - b[0])))
        return away, labels[0] + "' or '" + labels[1]
    left = _left(a, b)
    if len(labels) == 3:
        return float(left.max()), labels[int(left.argmax())]
    without = [_left(np.delete(a, k, axis=0), np.delete(b, k, axis=0)) for k in range(len(labels))]
    culprit = int(np.argmin([float(np.sum(rest**2)) for rest in without]))
    kept = [k for k in range(len(labels)) if k != culprit]
    return float(_left(a, b, kept)[culprit]), labels[culprit]


def _left(a: Array, b: Array, fitted: list[int] | None = None) -> Array:
    """(nm,) m, distances of b (nm, 3) from a (nm, 3) after the rigid motion that fits the markers `fitted` best."""
    weight = np.zeros((len(a), 1))
    weight[slice(None) if fitted is None else fitted] = 1.0
    fit = rigid_fit(a, b[:, :, None], weight)
    out: Array = np.linalg.norm(b - (fit.origin[0] + a @ fit.rotation[0].T), axis=1)
    return out
