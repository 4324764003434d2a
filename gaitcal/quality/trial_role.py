"""Does a trial show what its role says: a body upright, standing still on both legs, walking,
moving one joint alone?

Which joint of which side moves in an isolated trial: the one that turns most about its own mean
posture. Arms play no part.

With the joint centres of the nominal model (hips by Bell) and the body axes of `body_plan.py`: the
knee bends by the angle between thigh and shank in the thigh's sagittal plane, and the thigh leans
by its angle to the vertical.

Several static trials of one person: each segment's markers, and lengths across joints, must be
those of the first. The markers of a segment that both trials show are laid on each other (rotation
R and shift t, least squares); what is left of marker k, e_k = R x_k + t - x0_k, is its
disagreement. Of three markers a displaced one shares its disagreement with the others; of four or
more the one without which the rest agrees best is named. Where fewer than three are common, the
distance between them is compared.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.ground_reactions import SITTING_DEG
from gaitcal.errors import Code, Finding, InputError, Severity, listed
from gaitcal.io.axes import LEAST_PROGRESSION_M
from gaitcal.io.recording import LAG_S, RESTLESS_M_S, STILL_M_S, find_still_window
from gaitcal.model.ankle_zero import AnkleZero, measure_standing_ankles
from gaitcal.model.body_plan import compute_body_axes
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import ISOLATED_JOINTS, SIDE_WORDS, SIDES
from gaitcal.model.marker_set import REQUIRED
from gaitcal.model.segment_frames import HipCentre, JointWidths, measure_lower_body
from gaitcal.preprocess.trial_evidence import NEGLIGIBLE_WEIGHT, TrialEvidence
from gaitcal.quality import plate_checks
from gaitcal.tracking.rigid import fit_rigid

FEWEST_FRAMES, SHORTEST_S = 3, LAG_S  # Of a static trial: speed is told over that time
RESTLESS = 0.5
"""Share of the speed of a still window above which the stillest one is doubted: 1 to 7 mm/s in
clean static trials.
"""
ALONG_DEG = 50.0  # Angle between facing and going above which the person does not walk forwards
LEAD = 1.25
"""How many times the declared joint another one must turn. In 38 isolated trials (20 real, 18
synthetic) the declared one led the next by 1.7 times at least."""
TRAVEL_M, STAYS_M = (
    0.8,
    0.3,
)  # How far the pelvis goes in a walk, and how far in isolated trials at most
STEPS_RAD = np.deg2rad(12.0)
"""RMS turn of hip and knee of the other leg, both, from which it walks: 17 and 22 deg in walks; in
isolated trials of a hip, the knee of the leg that stands turns by 7 and 11 deg at most."""
MOVES_RAD = np.deg2rad(
    4.0
)  # RMS turn below which no joint is said to move: the smallest isolated trial reaches 14 deg
TILT_DEG = 60.0  # Largest tilt of the pelvis in standing and walking
LYING_DEG = (
    120.0  # The same for an isolated trial, in which the person may lie on a bench, face up or down
)
HEAD_DOWN = 0.2
"""Share of body height by which knees, ankles and heels may be above the pelvis, as when a leg is
raised lying.
"""
LEGS = ("thigh", "shank", "foot")
BENT_DEG = 30.0
"""Of a knee: in clean static trials of grown people and children it bends by -7 to 11 degrees; 20
more is a posture.
"""
UNEVEN_DEG, UNEVEN_M = 18.0, 0.045
"""Difference between the knees, and between the heights of the heels, from which somebody stands on
one leg; up to 7 degrees and 5 mm in clean trials."""
DISAGREE_M = 0.008
"""Largest disagreement of a marker between two times that one person stands: within a session
markers of a segment keep their shape to 5 mm (p99 over pelvis, thigh, shank and foot, standing
against moving)."""
GROSS_M = 0.020  # From here it moves a joint by more than nominal joints are uncertain: an error


def check_upright(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body is the right way up in the y-up axes that were made of the file's, in every
    kind of trial.

    A pelvis whose right and left are exchanged, by labels or by a mirrored axis, looks the same as
    itself turned about its forward axis: upside down. Where the feet are above it, the vertical is.
    """
    if trial.pelvis is None:
        return
    tilt = np.rad2deg(
        np.arccos(np.clip(trial.pelvis.rotation[trial.pelvis.determined][:, 1, 1], -1, 1))
    )
    allowed = LYING_DEG if trial.is_isolated else TILT_DEG
    middle, above = float(np.median(tilt)), _measure_feet_above_pelvis(trial)
    found = (
        f"the pelvis is tilted by {middle:.0f} deg against the vertical found; allowed: "
        f"{allowed:.0f} deg"
    )
    cause, cure = "the body does not stand upright", "write the file with one of its axes vertical"
    if above is not None and above > HEAD_DOWN * trial.subject.height:
        cause, cure = (
            "the vertical axis points down",
            "write the file with its vertical axis upwards",
        )
        found = f"the legs are {above:.2f} m above the pelvis"
    elif middle <= allowed:
        return
    elif middle > LYING_DEG:
        cause = (
            "right and left are exchanged: the labels (of the pelvis, or of all markers), or an "
            "axis is mirrored"
        )
        cure = (
            "exchange the labels of right and left in the file, or change the sign of the axis "
            "that was mirrored"
        )
    yield trial.error("axes", found, cure, cause=cause, weight=10.0, code=Code.NOT_UPRIGHT)


def _measure_feet_above_pelvis(trial: TrialEvidence) -> float | None:
    """m, median height of knees, ankles or heels, or else of all markers of the legs, over the
    ASIS.
    """
    hips = [path[:, 1] for side in SIDES if (path := trial.landmark(f"asis_{side}")) is not None]
    ends = [f"{name}_{side}" for name in ("ankle_lat", "heel", "knee_lat") for side in SIDES]
    feet = [path[:, 1] for name in ends if (path := trial.landmark(name)) is not None]
    if not feet:
        legs = [
            m for s, labels in trial.marker_set.tracking.items() if s[:-2] in LEGS for m in labels
        ]
        feet = list(
            trial.recording.markers[:, [trial.column[m] for m in legs if m in trial.column], 1].T
        )
    if not hips or not np.isfinite(feet).any():
        return None
    return float(np.nanmedian(np.array(feet)) - np.nanmedian(np.array(hips)))


def check_static_length(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the static trial is long enough to tell that anybody stands still; one that is not is
    taken as it is.
    """
    time = trial.recording.time
    if not trial.is_static or (len(time) >= FEWEST_FRAMES and time[-1] - time[0] >= SHORTEST_S):
        return
    if len(time) == 1:  # landmarks of one moment: however the person moves, nothing blurs them
        found = (
            "one frame is the whole static trial: noise of the cameras is not averaged, some "
            "tenths of a "
        )
        found += (
            "millimetre beside the 5 to 10 mm of palpation; whether the person stood still cannot "
            "be told"
        )
        yield trial.info("still window", found, code=Code.SHORT_STATIC)
        return
    yield trial.warning(
        "still window",
        f"found {len(time)} frames over {time[-1] - time[0]:.3g} s, all of them used; at least "
        f"{FEWEST_FRAMES} frames "
        f"over {SHORTEST_S:g} s tell standing still from moving",
        "make sure that the person stands still there, or give a longer part of the recording",
        cause="the static trial is too short to tell whether the person stands still",
        code=Code.SHORT_STATIC,
    )


def check_stillness(trial: TrialEvidence) -> Iterator[Finding]:
    """How still the person stood."""
    if not trial.is_static or trial.model is None or any(check_static_length(trial)):
        return
    try:
        window = find_still_window(trial.recording, trial.marker_set.labels)
    except InputError:
        return  # told as what keeps the nominal model from being made
    text = (
        f"stillest window {window.start:.2f}-{window.stop:.2f} s, markers move at "
        f"{1e3 * window.speed:.0f} mm/s RMS"
    )
    text += f" and stray by {1e3 * window.scatter:.1f} mm RMS from their means"
    if window.speed <= RESTLESS * STILL_M_S:
        yield trial.info("still window", text, code=Code.STILLNESS)
        return
    found = (
        f"{text}; most people stand within 10 mm/s, more than {1e3 * RESTLESS_M_S:.0f} are refused"
    )
    cure = "let the person stand still for some seconds; segment frames come from this posture"
    yield trial.warning(
        "still window", found, cure, weight=window.speed / STILL_M_S, code=Code.STILLNESS
    )


def check_heading(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the person goes where the pelvis faces, over the floor or a belt, and is not carried
    along sideways.
    """
    if trial.facing is None or not trial.is_gait:
        return
    way, over = trial.walked, ""
    if trial.on_the_spot:
        found = (
            f"the body moves {np.linalg.norm(trial.progression):.2f} m (treadmill?): x is where the pelvis "
            "faces"
        )
        yield trial.info("heading", found, code=Code.ON_THE_SPOT)
        over = " over the belt"
    if (length := float(np.linalg.norm(way))) < LEAST_PROGRESSION_M:
        return
    cosine = float(trial.facing @ way) / max(float(np.linalg.norm(trial.facing)) * length, 1e-12)
    angle = float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    if angle > ALONG_DEG:
        found = (
            f"the pelvis faces {angle:.0f} deg away from the {length:.2f} m that the body "
            f"moves{over}"
        )
        cure = (
            "if the person did not walk backwards or turn, the pelvis markers are exchanged (front "
            "and back, or "
        )
        cure += "sides), or time runs backwards"
        feet, drifts = trial.feet, plate_checks.compute_drifts(trial)
        ahead = (
            np.zeros(2)
            if feet is None
            else np.nanmean((feet.toe - feet.heel)[..., [0, 2]], axis=(0, 1))
        )
        backwards = (
            angle > 180.0 - ALONG_DEG and ahead @ trial.facing > 0 and min(drifts, default=-1.0) > 0
        )
        if backwards:
            cure = (
                "the feet point where it faces, and forces brake before they drive: the person "
                "walks backwards"
            )
        yield trial.make_finding(
            Severity.INFO if backwards else Severity.WARNING,
            "heading",
            found,
            cure,
            code=Code.HEADING,
        )


def check_single_joint(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body stays where it is, and the other leg still, while one joint moves."""
    declared = trial.trial.joint
    if not trial.is_isolated or declared is None:
        return
    signs = []
    if trial.pelvis is not None:
        places = trial.pelvis.origin[trial.pelvis.determined][:, [0, 2]]
        travel = float(np.linalg.norm(places[-1] - places[0]))
        if travel > TRAVEL_M:
            signs.append(
                f"the pelvis goes {travel:.2f} m (in trials of one joint up to {STAYS_M:.1f} m)"
            )
    other = "l" if declared.endswith("r") else "r"
    turns = [
        trial.links[f"{joint}_{other}"].rms
        for joint in ("hip", "knee")
        if f"{joint}_{other}" in trial.links
    ]
    if len(turns) == 2 and min(turns) > STEPS_RAD:
        hip, knee = np.rad2deg(turns)
        signs.append(f"hip and knee of the other leg turn by {hip:.0f} and {knee:.0f} deg RMS")
    if signs:
        found = " and ".join(signs)
        cure = 'write role = "gait", or name the file of the isolated trial'
        cause = f"the trial is declared for {declared} alone, but this looks like a walk"
        yield trial.warning("role", found, cure, cause=cause, weight=5.0, code=Code.LOOKS_LIKE_WALK)


def check_declared_joint(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the joint that moves is the one for which the trial is declared."""
    declared = trial.trial.joint
    turns = {joint: link.rms for joint, link in trial.links.items()} if trial.is_isolated else {}
    if len(turns) < 2 or declared is None:
        return
    joint = max(turns, key=turns.__getitem__)
    most, turn = turns[joint], turns.get(declared)
    if joint == declared or most < MOVES_RAD or (turn is not None and most < LEAD * turn):
        return
    turned = "is not seen" if turn is None else f"turns by {np.rad2deg(turn):.0f} deg RMS"
    others = [j for j in ISOLATED_JOINTS if j in turns and j not in (joint, declared)]
    rest = max((np.rad2deg(turns[j]) for j in others), default=0.0)
    yield trial.error(
        "joint",
        f"it turns by {np.rad2deg(most):.0f} deg RMS about its mean posture, {declared} {turned}, "
        "the others by at "
        f"most {rest:.0f} deg",
        f'write joint = "{joint}", name the file of {declared}, or exchange the labels of right '
        "and left",
        cause=f"the trial is declared for {declared}, but this looks like {joint}",
        weight=most / max(turn or 0.0, MOVES_RAD),
        code=Code.OTHER_JOINT,
    )


@dataclass(frozen=True, kw_only=True)
class StandingLegs:
    """How the legs of a standing person are bent."""

    knees: tuple[float, float]  # Degrees of flexion, right and left
    thighs: tuple[float, float]  # Degrees by which the thighs lean from the vertical
    heels: float  # m, height of the right heel above the left one

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


def measure_standing_legs(p: Mapping[str, Array], height: float) -> StandingLegs | None:
    """The stance that landmarks p ((3,) m each, y up) of a person of this height (m) show; None
    where some lack.
    """
    axes = compute_body_axes(p)
    if axes is None or any(name not in p for name in REQUIRED):
        return None
    body = measure_lower_body(StaticPosture("", {}, p, {}), height, HipCentre.BELL)
    knees, thighs = [], []
    for side in SIDES:
        thigh, shank = body.frames[f"thigh_{side}"].rotation, body.frames[f"shank_{side}"].rotation
        up = thigh.T @ shank[:, 1]
        knees.append(float(np.rad2deg(np.arctan2(up[0], up[1]))))
        thighs.append(float(np.rad2deg(np.arccos(np.clip(thigh[1, 1], -1.0, 1.0)))))
    heels = float(p["heel_r"][1] - p["heel_l"][1])
    return StandingLegs(knees=(knees[0], knees[1]), thighs=(thighs[0], thighs[1]), heels=heels)


def check_flat_feet(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the feet of a static trial stand as the zero of the ankle angles was taken from them."""
    p, rule = trial.posture, AnkleZero(trial.settings.ankle_rule)
    if (
        p is None
        or not trial.makes_model
        or rule is not AnkleZero.AUTO
        or any(name not in p for name in REQUIRED)
    ):
        return
    posture = StaticPosture(trial.source, {}, p, {})
    legs = measure_lower_body(
        posture,
        trial.subject.height,
        HipCentre.HARRINGTON,
        widths=JointWidths.from_subject(trial.subject),
    )
    doubts = measure_standing_ankles(
        posture, legs, trial.recording.facts.static_plantarflexion, rule
    ).doubts
    if doubts:
        yield trial.make_finding(
            Severity.WARNING,
            "posture",
            "; ".join(f"{SIDE_WORDS[side]} foot: {why}" for side, why in doubts.items()),
            "look at the feet in that trial and say it under [calibration]: ankle_zero = 'sole' if "
            "they stand flat, "
            "'file' or 'markers' if the heels are off the floor",
            cause="the feet may not stand flat in the static trial, from which ankle angles are "
            "counted",
            leg="" if len(doubts) == 2 else next(iter(doubts)),
            code=Code.FEET_NOT_FLAT,
        )


def check_straight_legs(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the person of a static trial stands on both straight legs."""
    if trial.posture is None:
        return
    found = measure_standing_legs(trial.posture, trial.subject.height)
    if found is None:
        return
    knees = f"knees bent by {found.knees[0]:.0f} deg (right) and {found.knees[1]:.0f} deg (left)"
    message = f"{knees}, thighs leaning by {found.thighs[0]:.0f} and {found.thighs[1]:.0f} deg"
    if found.sitting:
        yield trial.error(
            "posture",
            f"{message}; standing people lean by less than {SITTING_DEG:.0f}",
            "name the recording in which the person stands",
            cause="the person sits in the static trial",
            weight=5.0,
            code=Code.SITTING,
        )
    elif found.uneven:
        yield trial.warning(
            "posture",
            f"{knees}, right heel {1e3 * found.heels:+.0f} mm above the left one",
            "choose the part in which both feet stand with time = [start, end], or record standing "
            "again; nothing to "
            "do if the person cannot stand otherwise",
            cause="the person stands unevenly in the static trial",
            code=Code.UNEVEN_STANCE,
        )
    elif found.bent:
        yield trial.warning(
            "posture",
            f"{message}; most people stand within 10 deg",
            "record it again if the person can stand straighter; nothing to do if not: only the "
            "skin lies a little "
            "otherwise than over straight legs",
            cause="the person stands with bent knees in the static trial",
            code=Code.BENT_KNEES,
        )


def check_statics_agree(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Whether further static trials show the body of the first."""
    standing = [trial for trial in trials if trial.is_static]
    if not standing:
        return
    first, *others = standing
    reference = first.still_positions
    for other in others:
        positions = other.still_positions
        disagreeing = [
            (away, label, segment)
            for segment, labels in _list_segments(first).items()
            if (
                found := _find_disagreement(
                    [m for m in labels if m in reference and m in positions], reference, positions
                )
            )
            for away, label in [found]
            if away > DISAGREE_M
        ]
        if not disagreeing:
            if positions and reference:
                yield other.info(
                    "static trial",
                    f"agrees with '{first.name}', which the model is made of",
                    code=Code.STATICS_DISAGREE,
                )
            continue
        disagreeing.sort(reverse=True)
        labels_off = listed(
            [f"'{label}' {1e3 * away:.0f} mm ({segment})" for away, label, segment in disagreeing]
        )
        yield other.make_finding(
            Severity.ERROR if disagreeing[0][0] > GROSS_M else Severity.WARNING,
            "static trial",
            f"against the other markers of its segment: {labels_off}; allowed: "
            f"{1e3 * DISAGREE_M:.0f} mm",
            "leave out the static trial whose markers moved or whose labels are wrong; "
            f"'{first.name}', the first, "
            "gives the model",
            cause=f"static trials '{first.name}' and '{other.name}' do not show the same body",
            weight=disagreeing[0][0] / DISAGREE_M,
            code=Code.STATICS_DISAGREE,
        )


def _list_segments(trial: TrialEvidence) -> dict[str, list[str]]:
    """Segment -> its markers that decide anything, those of the static trial alone and landmarks
    included.
    """
    marker_set = trial.marker_set
    out: dict[str, list[str]] = {}
    for group in (marker_set.tracking, marker_set.static_only):
        for segment, labels in group.items():
            out.setdefault(segment, []).extend(
                m for m in labels if not 0 < marker_set.weight(m) <= NEGLIGIBLE_WEIGHT
            )
    loose = ("head_trunk", "upper_arm", "forearm")
    return {segment: labels for segment, labels in out.items() if not segment.startswith(loose)}


def _find_disagreement(
    labels: list[str], reference: dict[str, Array], positions: dict[str, Array]
) -> tuple[float, str] | None:
    """The largest disagreement (m) and the marker that is named for it."""
    if len(labels) < 2:
        return None
    a, b = (np.array([where[m] for m in labels]) for where in (reference, positions))
    if len(labels) == 2:
        away = abs(float(np.linalg.norm(a[1] - a[0]) - np.linalg.norm(b[1] - b[0])))
        return away, labels[0] + "' or '" + labels[1]
    left = _compute_rigid_residuals(a, b)
    if len(labels) == 3:
        return float(left.max()), labels[int(left.argmax())]
    without = [
        _compute_rigid_residuals(np.delete(a, k, axis=0), np.delete(b, k, axis=0))
        for k in range(len(labels))
    ]
    culprit = int(np.argmin([float(np.sum(rest**2)) for rest in without]))
    kept = [k for k in range(len(labels)) if k != culprit]
    return float(_compute_rigid_residuals(a, b, kept)[culprit]), labels[culprit]


def _compute_rigid_residuals(a: Array, b: Array, fitted: list[int] | None = None) -> Array:
    """(nm,) m, distances of b (nm, 3) from a (nm, 3) after the rigid motion that fits the markers
    `fitted` best.
    """
    weight = np.zeros((len(a), 1))
    weight[slice(None) if fitted is None else fitted] = 1.0
    fit = fit_rigid(a, b[:, :, None], weight)
    out: Array = np.linalg.norm(b - (fit.origin[0] + a @ fit.rotation[0].T), axis=1)
    return out
