"""Check that a trial shows its role: upright, standing still on both legs, walking, a single joint.

The joint of a functional trial is the one that rotates most about its mean posture. Arms are not
used.

With the joint centres of the nominal model (hips by Bell) and the body axes of `body_plan.py`, knee
flexion is the angle between thigh and shank in the thigh's sagittal plane, and the inclination of
the thigh its angle to the vertical.

Several static trials of one person must agree with the first: the markers of each segment, and
lengths across joints. The common markers of a segment are aligned (rotation R and translation t,
least squares); the residual of marker k, e_k = R x_k + t - x0_k, is its disagreement. Of three
markers a displaced one shares its disagreement with the others; of four or more the one without
which the others agree best is named. With fewer than three common markers the distance between them
is compared.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.ground_reactions import SITTING_DEG
from gaitcal.errors import Code, Finding, InputError, Severity, join_names
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

FEWEST_STATIC_FRAMES, SHORTEST_S = (
    3,
    LAG_S,
)  # Of a static trial: its speed is measured over that time
RESTLESS = 0.5
"""Share of the allowed speed of a still window from which the stillest one is reported: 1 to 7 mm/s
in clean static trials."""
# Angle between facing and walking direction above which the person does not walk forward
ALONG_DEG = 50.0
LEAD = 1.25
"""Ratio of rotations from which another joint than the declared one moves. In 38 functional trials
(20 real, 18 synthetic) the declared one rotated at least 1.7 times as much as the next."""
TRAVEL_M = 0.8  # Least distance of the pelvis in a walk
STAYS_M = 0.3  # Largest distance of the pelvis in functional trials
STEPS_RAD = np.deg2rad(12.0)
"""RMS rotation of both hip and knee of the other leg from which it walks: 17 and 22 deg in walks;
in functional trials of a hip, the knee of the standing leg rotates by 7 and 11 deg at most."""
# RMS rotation below which no joint moves: the smallest functional trial reaches 14 deg
MOVES_RAD = np.deg2rad(4.0)
TILT_DEG = 60.0  # Largest tilt of the pelvis in standing and walking
LYING_DEG = 120.0  # The same for a functional trial, in which the person may lie prone or supine
HEAD_DOWN = 0.2
"""Share of body height by which knees, ankles and heels may be above the pelvis, as in a leg raised
in lying."""
LEGS = ("thigh", "shank", "foot")
BENT_DEG = 30.0
"""Knee flexion of a bent knee: in clean static trials of adults and children it is -7 to 11 deg; 20
more is a posture."""
UNEVEN_DEG, UNEVEN_M = 18.0, 0.045
"""Difference between the knees, and between the heights of the heels, of a person who stands on one
leg; up to 7 deg and 5 mm in clean trials."""
DISAGREE_M = 0.008
"""Largest disagreement of a marker between two static trials: within a session markers of a segment
keep their shape to 5 mm (p99 over pelvis, thigh, shank and foot, standing against moving)."""
GROSS_M = 0.020  # Larger disagreement displaces a joint by more than its prior allows: an error


def check_upright(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the body is upright in the y-up axes derived from those of the file.

    A pelvis whose right and left are swapped, by labels or by a mirrored axis, is the same as one
    rotated by 180 deg about its forward axis: upside down. If the feet are above it, the vertical
    axis is reversed.

    Yields one error, or nothing.
    """
    if trial.pelvis is None:
        return
    tilt = np.rad2deg(
        np.arccos(np.clip(trial.pelvis.rotation[trial.pelvis.determined][:, 1, 1], -1, 1))
    )
    allowed = LYING_DEG if trial.is_isolated else TILT_DEG
    # feet above the pelvis mean a reversed vertical axis, a tilted pelvis swapped sides
    middle, above = float(np.median(tilt)), _measure_feet_above_pelvis(trial)
    found = (
        f"the pelvis is tilted by {middle:.0f} deg relative to the vertical axis found; allowed: "
        f"{allowed:.0f} deg"
    )
    cause, cure = "the body is not upright", "export the file with one of its axes vertical"
    if above is not None and above > HEAD_DOWN * trial.subject.height:
        cause = "the vertical axis points down"
        cure = "export the file with its vertical axis upwards"
        found = f"the legs are {above:.2f} m above the pelvis"
    elif middle <= allowed:
        return
    elif middle > LYING_DEG:
        cause = (
            "right and left are swapped in the labels (of the pelvis, or of all markers), or an "
            "axis is mirrored"
        )
        cure = (
            "swap the labels of right and left in the file, or change the sign of the mirrored axis"
        )
    yield trial.error("axes", found, cure, cause=cause, weight=10.0, code=Code.NOT_UPRIGHT)


def _measure_feet_above_pelvis(trial: TrialEvidence) -> float | None:
    """Measure the median height (m) of the distal leg landmarks, or leg markers, above the ASIS."""
    hips = _list_heights(trial, [f"asis_{side}" for side in SIDES])
    ends = [f"{name}_{side}" for name in ("ankle_lat", "heel", "knee_lat") for side in SIDES]
    feet = _list_heights(trial, ends)
    if not feet:
        legs: list[str] = []
        for s, labels in trial.marker_set.tracking.items():
            if s[:-2] in LEGS:
                legs.extend(labels)
        feet = list(
            trial.recording.markers[:, [trial.column[m] for m in legs if m in trial.column], 1].T
        )
    if not hips or not np.isfinite(feet).any():
        return None
    return float(np.nanmedian(np.array(feet)) - np.nanmedian(np.array(hips)))


def _list_heights(trial: TrialEvidence, landmarks: Sequence[str]) -> list[Array]:
    """List the heights (nf,) m of those landmarks that the trial shows."""
    paths = [trial.landmark(name) for name in landmarks]
    return [path[:, 1] for path in paths if path is not None]


def check_static_length(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the static trial is long enough to detect motion; a shorter one is used as it is.

    Parameters
    ----------
    trial
        The trial; moving ones are not checked.

    Yields
    ------
    Finding
        A warning, or a note for a single frame.
    """
    time = trial.recording.time
    if not trial.is_static or (
        len(time) >= FEWEST_STATIC_FRAMES and time[-1] - time[0] >= SHORTEST_S
    ):
        return
    if len(time) == 1:  # landmarks of one frame are not blurred by motion
        found = (
            "the static trial has one frame: camera noise is not averaged, some tenths of a mm in "
            "addition to the 5 to 10 mm of palpation; standing still cannot be checked"
        )
        yield trial.info("still window", found, code=Code.SHORT_STATIC)
        return
    yield trial.warning(
        "still window",
        f"found {len(time)} frames over {time[-1] - time[0]:.3g} s, all of them used; needed: at "
        f"least {FEWEST_STATIC_FRAMES} frames over {SHORTEST_S:g} s",
        "make sure that the person stands still there, or use a longer part of the recording",
        cause="the static trial is too short to check that the person stands still",
        code=Code.SHORT_STATIC,
    )


def check_stillness(trial: TrialEvidence) -> Iterator[Finding]:
    """Report how still the person stood.

    Parameters
    ----------
    trial
        The trial; moving ones are not checked.

    Yields
    ------
    Finding
        A note, or a warning if the person moved.
    """
    if not trial.is_static or trial.model is None or any(check_static_length(trial)):
        return
    try:
        window = find_still_window(trial.recording, trial.marker_set.labels)
    except InputError:
        return  # reported already, as the nominal model cannot be built
    text = (
        f"stillest window {window.start:.2f}-{window.stop:.2f} s, markers move at "
        f"{1e3 * window.speed:.0f} mm/s RMS"
    )
    text += f" and scatter by {1e3 * window.scatter:.1f} mm RMS about their means"
    if window.speed <= RESTLESS * STILL_M_S:
        yield trial.info("still window", text, code=Code.STILLNESS)
        return
    found = f"{text}; usual: within 10 mm/s; not accepted: more than {1e3 * RESTLESS_M_S:.0f} mm/s"
    cure = "record the person standing still for some seconds; it defines the segment frames"
    yield trial.warning(
        "still window", found, cure, weight=window.speed / STILL_M_S, code=Code.STILLNESS
    )


def check_heading(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the person walks where the pelvis faces, over the floor or a belt.

    Parameters
    ----------
    trial
        A gait trial; others are not checked.

    Yields
    ------
    Finding
        A warning, or notes on treadmills and backward walking.
    """
    if trial.facing is None or not trial.is_gait:
        return
    walked, over = trial.walked, ""
    if trial.on_the_spot:
        found = (
            f"the body moves {np.linalg.norm(trial.progression):.2f} m only (treadmill?): x is the "
            "direction in which the pelvis faces"
        )
        yield trial.info("heading", found, code=Code.ON_THE_SPOT)
        over = " over the belt"
    length = float(np.linalg.norm(walked))
    if length < LEAST_PROGRESSION_M:
        return
    cosine = float(trial.facing @ walked) / max(float(np.linalg.norm(trial.facing)) * length, 1e-12)
    angle = float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    if angle > ALONG_DEG:
        found = (
            f"the pelvis faces {angle:.0f} deg away from the direction in which the body moves "
            f"{length:.2f} m{over}"
        )
        cure = (
            "if the person did not walk backwards or turn, check the pelvis markers (front and "
            "back, right and left) and the direction of time"
        )
        feet, drifts = trial.feet, plate_checks.compute_drifts(trial)
        # backward walking: feet and pelvis point the same way, and forces brake before they drive
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
                "no action: the person walks backwards, as the feet point in the same direction "
                "and forces brake before they drive"
            )
        yield trial.make_finding(
            Severity.INFO if backwards else Severity.WARNING,
            "heading",
            found,
            cure,
            code=Code.HEADING,
        )


def check_single_joint(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the pelvis stays in place and the other leg is still in a functional trial.

    Parameters
    ----------
    trial
        A functional (single-joint) trial; others are not checked.

    Yields
    ------
    Finding
        One warning, or nothing.
    """
    declared = trial.trial.joint
    if not trial.is_isolated or declared is None:
        return
    signs = []
    if trial.pelvis is not None:
        positions = trial.pelvis.origin[trial.pelvis.determined][:, [0, 2]]
        travel = float(np.linalg.norm(positions[-1] - positions[0]))
        if travel > TRAVEL_M:
            signs.append(
                f"the pelvis moves {travel:.2f} m (usual in functional trials: up to "
                f"{STAYS_M:.1f} m)"
            )
    other = "l" if declared.endswith("r") else "r"
    rotations = [
        trial.links[f"{joint}_{other}"].rms
        for joint in ("hip", "knee")
        if f"{joint}_{other}" in trial.links
    ]
    if len(rotations) == 2 and min(rotations) > STEPS_RAD:
        hip, knee = np.rad2deg(rotations)
        signs.append(f"hip and knee of the other leg rotate by {hip:.0f} and {knee:.0f} deg RMS")
    if signs:
        found = " and ".join(signs)
        cure = 'set role = "gait", or correct the file of the functional trial'
        cause = f"the trial is declared as a functional trial of {declared}, but shows a walk"
        yield trial.warning("role", found, cure, cause=cause, weight=5.0, code=Code.LOOKS_LIKE_WALK)


def check_declared_joint(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the joint that moves most is the declared one.

    Parameters
    ----------
    trial
        A functional (single-joint) trial; others are not checked.

    Yields
    ------
    Finding
        One error, or nothing.
    """
    declared = trial.trial.joint
    rotations = {j: link.rms for j, link in trial.links.items()} if trial.is_isolated else {}
    if len(rotations) < 2 or declared is None:
        return
    joint = max(rotations, key=rotations.__getitem__)
    most, own = rotations[joint], rotations.get(declared)
    if joint == declared or most < MOVES_RAD or (own is not None and most < LEAD * own):
        return
    of_declared = "is not visible" if own is None else f"by {np.rad2deg(own):.0f} deg"
    others = [j for j in ISOLATED_JOINTS if j in rotations and j not in (joint, declared)]
    largest = max((np.rad2deg(rotations[j]) for j in others), default=0.0)
    yield trial.error(
        "joint",
        f"{joint} rotates by {np.rad2deg(most):.0f} deg RMS about its mean posture, {declared} "
        f"{of_declared}, others by at most {largest:.0f} deg",
        f'set joint = "{joint}", correct the file of {declared}, or swap the labels of right and '
        "left",
        cause=f"the trial is declared for {declared}, but {joint} moves",
        weight=most / max(own or 0.0, MOVES_RAD),
        code=Code.OTHER_JOINT,
    )


@dataclass(frozen=True, kw_only=True)
class StandingLegs:
    """Posture of the legs of a standing person."""

    knees: tuple[float, float]  # Flexion, deg, right and left
    thighs: tuple[float, float]  # Inclination from the vertical, deg, right and left
    heels: float  # m, height of the right heel above the left one

    @property
    def bent(self) -> bool:
        """Whether a knee is bent further than in usual standing."""
        return max(self.knees) > BENT_DEG

    @property
    def uneven(self) -> bool:
        """Whether the legs are in different postures."""
        return abs(self.knees[0] - self.knees[1]) > UNEVEN_DEG or abs(self.heels) > UNEVEN_M

    @property
    def sitting(self) -> bool:
        """Whether both thighs are horizontal, as in sitting."""
        return min(self.thighs) > SITTING_DEG


def measure_standing_legs(p: Mapping[str, Array], height: float) -> StandingLegs | None:
    """Measure the posture of the legs from landmarks.

    Parameters
    ----------
    p
        Landmarks of the static trial, (3,) m each, y up.
    height
        Body height, m.

    Returns
    -------
    StandingLegs or None
        None if a required landmark is missing.
    """
    axes = compute_body_axes(p)
    if axes is None or any(name not in p for name in REQUIRED):
        return None
    body = measure_lower_body(StaticPosture("", {}, p, {}), height, HipCentre.BELL)
    knees, thighs = [], []
    for side in SIDES:
        thigh, shank = body.frames[f"thigh_{side}"].rotation, body.frames[f"shank_{side}"].rotation
        # the shank's long axis in the thigh frame
        up = thigh.T @ shank[:, 1]
        knees.append(float(np.rad2deg(np.arctan2(up[0], up[1]))))
        thighs.append(float(np.rad2deg(np.arccos(np.clip(thigh[1, 1], -1.0, 1.0)))))
    heels = float(p["heel_r"][1] - p["heel_l"][1])
    return StandingLegs(knees=(knees[0], knees[1]), thighs=(thighs[0], thighs[1]), heels=heels)


def check_flat_feet(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the feet of a static trial are as the zero of the ankle angles assumes.

    Parameters
    ----------
    trial
        The static trial that makes the model; others are not checked.

    Yields
    ------
    Finding
        One warning, or nothing.
    """
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
            "check the feet in that trial and set ankle_zero under [calibration]: 'sole' if they "
            "are flat, 'file' or 'markers' if the heels are off the floor",
            cause="the feet may not be flat in the static trial, which defines the zero of the "
            "ankle angles",
            leg="" if len(doubts) == 2 else next(iter(doubts)),
            code=Code.FEET_NOT_FLAT,
        )


def check_straight_legs(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the person stands on both straight legs in the static trial.

    Parameters
    ----------
    trial
        The trial; moving ones are not checked.

    Yields
    ------
    Finding
        An error for sitting, a warning for other postures.
    """
    if trial.posture is None:
        return
    found = measure_standing_legs(trial.posture, trial.subject.height)
    if found is None:
        return
    knees = f"knees bent by {found.knees[0]:.0f} deg (right) and {found.knees[1]:.0f} deg (left)"
    message = f"{knees}, thighs inclined by {found.thighs[0]:.0f} and {found.thighs[1]:.0f} deg"
    if found.sitting:
        yield trial.error(
            "posture",
            f"{message}; in standing: less than {SITTING_DEG:.0f} deg",
            "use a recording in which the person stands",
            cause="the person sits in the static trial",
            weight=5.0,
            code=Code.SITTING,
        )
    elif found.uneven:
        yield trial.warning(
            "posture",
            f"{knees}, right heel {1e3 * found.heels:+.0f} mm above the left one",
            "choose the part in which both feet stand with time = [start, end], or record the "
            "static trial again; no action if the person cannot stand otherwise",
            cause="the person stands unevenly in the static trial",
            code=Code.UNEVEN_STANCE,
        )
    elif found.bent:
        yield trial.warning(
            "posture",
            f"{message}; usual: within 10 deg",
            "record it again if the person can stand straighter; no action if not: only the soft "
            "tissue is slightly displaced",
            cause="the person stands with bent knees in the static trial",
            code=Code.BENT_KNEES,
        )


def check_statics_agree(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Check that further static trials show the same body as the first.

    Yields one for each further static trial: a note if it agrees.
    """
    standing = [trial for trial in trials if trial.is_static]
    if not standing:
        return
    first, *others = standing
    reference = first.still_positions
    for other in others:
        positions = other.still_positions
        disagreeing: list[tuple[float, str, str]] = []
        for segment, labels in _list_segments(first).items():
            common = [m for m in labels if m in reference and m in positions]
            found = _find_disagreement(common, reference, positions)
            if found is not None and found[0] > DISAGREE_M:
                disagreeing.append((*found, segment))
        if not disagreeing:
            if positions and reference:
                yield other.info(
                    "static trial",
                    f"agrees with '{first.name}', from which the model is built",
                    code=Code.STATICS_DISAGREE,
                )
            continue
        disagreeing.sort(reverse=True)
        labels_off = join_names(
            [f"'{label}' {1e3 * away:.0f} mm ({segment})" for away, label, segment in disagreeing]
        )
        yield other.make_finding(
            Severity.ERROR if disagreeing[0][0] > GROSS_M else Severity.WARNING,
            "static trial",
            f"relative to the other markers of the segment: {labels_off}; allowed: "
            f"{1e3 * DISAGREE_M:.0f} mm",
            "leave out the static trial whose markers moved or whose labels are wrong; the model "
            f"is built from the first, '{first.name}'",
            cause=f"static trials '{first.name}' and '{other.name}' do not show the same body",
            weight=disagreeing[0][0] / DISAGREE_M,
            code=Code.STATICS_DISAGREE,
        )


def _list_segments(trial: TrialEvidence) -> dict[str, list[str]]:
    """List the markers of each segment, including those of the static trial only.

    Markers of negligible weight, of trunk and of arms are left out.
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
    """Find the largest disagreement (m) and the marker named for it; None with too few markers."""
    if len(labels) < 2:
        return None
    a, b = np.array([reference[m] for m in labels]), np.array([positions[m] for m in labels])
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
    culprit = int(np.argmin([float(np.sum(others**2)) for others in without]))
    kept = [k for k in range(len(labels)) if k != culprit]
    return float(_compute_rigid_residuals(a, b, kept)[culprit]), labels[culprit]


def _compute_rigid_residuals(a: Array, b: Array, fitted: list[int] | None = None) -> Array:
    """Compute distances (nm,) m of b (nm, 3) from a (nm, 3), aligned by the markers `fitted`."""
    weight = np.zeros((len(a), 1))
    weight[slice(None) if fitted is None else fitted] = 1.0
    fit = fit_rigid(a, b[:, :, None], weight)
    out: Array = np.linalg.norm(b - (fit.origin[0] + a @ fit.rotation[0].T), axis=1)
    return out
