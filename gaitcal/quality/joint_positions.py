"""Checks of joint positions against anatomy: fitted joints of the legs, and hip centres of a file.

Each segment adjacent to a joint locates it by some parameters theta: the pelvis a hip centre, the
thigh a knee axis by two positions and two rotations. theta_0 is the expected value: the nominal
value plus the prior mean. With d = theta - theta_0, of n parameters,

    z^2 = d^T (P + E)^-1 d,
    doubtful if chi^2 of n degrees of freedom exceeds it in `RARE` of cases,

P is the covariance of people about theta_0, including that of palpation and regressions
(`joint_prior.py`), and E the covariance of theta by noise and soft tissue of the markers. A fit
with a prior has theta = theta_0 + K (true - theta_0 + e), K at most 1, and E = K cov(e) K^T, so
that cov(d) = K P K^T + E is at most P + E: the test is the same without a prior. The distance
between the hips is tested in the same way. A warning is some four standard deviations off; from
`UNUSUAL` on, some three, it is a note. A note is also given for a parameter more than `FARTHEST`
standard deviations of people away, however uncertain it is.

A study file or a cohort prior changes the mean in theta_0; P remains that of anatomy.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import COVARIANCE
from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.gait.moments import describe_joint
from gaitcal.model import coordinates, linkage
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    JP_INDEX,
    JP_NAMES,
    JP_TO_SI,
    ParameterKind,
    Parameters,
)
from gaitcal.model.segment_frames import (
    DOUBTED_GIVEN,
    UNEVEN_GIVEN,
    HipCentre,
    PelvicWidth,
    compute_hip_centre,
)
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess import trial_evidence
from gaitcal.quality import verdict
from gaitcal.study.normal_prior import JointPrior
from gaitcal.tracking.rigid import FEWEST_MARKERS

# Share of people with such a joint, which is the rate of false warnings for each tested position
RARE = 1e-3
# The same for a note: the usual level of significance, which proves nothing by itself
UNUSUAL = 0.05
FARTHEST = 3.0  # Standard deviations of people, of one parameter
CT_RATIO = "0.65 to 0.82"
"""Distance of the hips over that of the ASIS of ten people in CT (landmarks of Fischer 2021); mean
0.71.
"""
# Offsets below this share of the largest one, in standard deviations, are not reported
LEAST_SHARE = 0.3
PRIOR_SOURCE = "nominal/"  # Prefix of the names of error sources that are the prior's error
_DIRECTIONS = {"ant": ("forward", "back"), "sup": ("up", "down"), "lat": ("outward", "inward")}
_VIEWED_FROM = {"front": "the front", "trans": "above", "sag": "the side"}


def check_joint_positions(
    model: SubjectModel,
    fitted: Parameters,
    errors: ErrorSources,
    prior: JointPrior,
    isolated: Collection[str] = (),
) -> Iterator[Finding]:
    """Report leg joints located where few people have them.

    Parameters
    ----------
    model
        Nominal model, with the landmarks of the static trial.
    fitted
        Fitted parameters.
    errors
        Error sources of the fitted joint parameters.
    prior
        Prior of this subject's joint parameters.
    isolated
        Joints (`knee_r`, ...) that have a functional trial.

    Yields
    ------
    Finding
        At most one a joint: a warning if fewer than `RARE` of all people have a joint there, a note
        if fewer than `UNUSUAL`; the same for the distance between the hips.
    """
    positions = _FittedPositions(model, fitted, errors, prior)
    hip_reported = False
    for side in linkage.SIDES:
        for joint in (f"{name}_{side}" for name in linkage.LEG_JOINTS):
            views = list(positions.list_views(joint))
            limit = RARE if min(view.probability for view in views) < RARE else UNUSUAL
            far = [v for v in views if v.probability < limit or v.farthest > FARTHEST]
            if far:
                yield _report_joint(joint, far, model, joint in isolated)
                hip_reported = hip_reported or joint.startswith("hip")
    # a note on the distance would repeat the finding on a hip
    distance = positions.measure_hip_distance()
    if distance.probability < (RARE if hip_reported else UNUSUAL):
        yield _report_hip_distance(distance, model, fitted)


@dataclass(frozen=True, kw_only=True)
class JointPosition:
    """Position of a joint in one segment, or the distance of two joints."""

    names: tuple[str, ...]  # n joint parameters
    offset: Array  # (n,) m, rad: d
    scatter: Array  # (n, n): P
    error: Array  # (n, n): E

    @property
    def square(self) -> float:
        """z^2."""
        return float(self.offset @ np.linalg.solve(self.scatter + self.error, self.offset))

    @property
    def probability(self) -> float:
        """Probability of a joint so far from its expected position, or further."""
        return float(chdtrc(len(self.offset), self.square))

    @property
    def farthest(self) -> float:
        """Largest offset of a parameter, in standard deviations of people alone."""
        return float((np.abs(self.offset) / np.sqrt(np.diag(self.scatter))).max())

    @property
    def description(self) -> str:
        """`in the pelvis 34 mm outward and 12 mm down (SD of people 9 and 10; error ± 3 and 4)`."""
        deviation, error = (np.sqrt(np.diag(c)) for c in (self.scatter, self.error))
        # components that are small relative to their scatter are left out
        ratio = np.abs(self.offset) / deviation
        large = [k for k in np.argsort(-ratio) if ratio[k] >= LEAST_SHARE * ratio.max()]
        offsets = " and ".join(_describe_offset(self.names[k], self.offset[k]) for k in large)
        people = " and ".join(_format_size(self.names[k], deviation[k]) for k in large)
        fit = " and ".join(_format_size(self.names[k], error[k]) for k in large)
        segment = self.names[0].split(".")[1]
        return f"in the {segment} {offsets} (SD of people {people}; error of the fit ± {fit})"


class _FittedPositions:
    """Joint positions of one fit relative to the expected ones."""

    def __init__(
        self, model: SubjectModel, fitted: Parameters, errors: ErrorSources, prior: JointPrior
    ) -> None:
        expected = model.nominal.joint.copy()
        expected[[JP_INDEX[name] for name in prior.names]] += prior.mean
        self._offset = fitted.joint - expected
        # errors by the prior itself are part of the scatter of people
        measured_clusters = [
            k for k, name in enumerate(errors.sources) if not name.startswith(PRIOR_SOURCE)
        ]
        self._sensitivity = np.zeros((len(JP_NAMES), len(measured_clusters)))
        known = [(JP_INDEX[name], row) for row, name in enumerate(errors.names) if name in JP_INDEX]
        for at, row in known:
            self._sensitivity[at] = errors.effects[row, measured_clusters]

    def list_views(self, joint: str) -> Iterator[JointPosition]:
        """Yield the position of a joint in each adjacent segment."""
        for segment in dict.fromkeys(
            name.split(".")[1] for name in JP_NAMES if name.startswith(f"{joint}.")
        ):
            names = tuple(name for name in JP_NAMES if name.startswith(f"{joint}.{segment}."))
            yield self._project(names, np.eye(len(names)))

    def measure_hip_distance(self) -> JointPosition:
        """Measure the lateral distance of the hips in the pelvis; positive if it is larger."""
        return self._project(("hip_r.pelvis.lat", "hip_l.pelvis.lat"), np.array([[1.0, -1.0]]))

    def _project(self, names: tuple[str, ...], directions: Array) -> JointPosition:
        """Project onto combinations (k, n) of joint parameters."""
        at = [JP_INDEX[name] for name in names]
        sensitivity = directions @ self._sensitivity[at]
        return JointPosition(
            names=names,
            offset=directions @ self._offset[at],
            scatter=directions @ COVARIANCE[np.ix_(at, at)] @ directions.T,
            error=sensitivity @ sensitivity.T,
        )


def _report_joint(
    joint: str, views: Sequence[JointPosition], model: SubjectModel, isolated: bool
) -> Finding:
    """Build the warning or note on a joint, from its unusual positions in the adjacent segments."""
    kind, side = joint.split("_")
    least = min(view.probability for view in views)
    few = round(1 / (RARE if least < RARE else UNUSUAL))
    cause = f"fewer than 1 in {few} people have the {describe_joint(joint)} joint at this position"
    if least >= UNUSUAL:
        cause = (
            f"the {describe_joint(joint)} joint is {FARTHEST:.0f} standard deviations of people "
            "from its expected position"
        )
    return Finding(
        severity=Severity.WARNING if least < RARE else Severity.INFO,
        topic=verdict.JOINT_POSITIONS,
        where=STUDY,
        leg=side,
        cause=cause,
        found=f"relative to {coordinates.JOINT_TABLE[kind].landmarks} it is "
        f"{'; '.join(view.description for view in views)}; {_describe_odds(least)} so "
        f"far{_describe_few_markers(model, joint)}",
        cure=_build_remedy(kind, isolated) if least < RARE else "",
        weight=_compute_weight(views),
        code=Code.KNEE_AXIS if kind == "knee" else Code.JOINT_PLACE,
    )


def _report_hip_distance(
    distance: JointPosition, model: SubjectModel, fitted: Parameters
) -> Finding:
    """Build the warning or note on an unusual distance between the hips."""
    gap, nominal = (_measure_hip_gap(parameters) for parameters in (fitted, model.nominal))
    deviation, error = (1e3 * float(np.sqrt(c[0, 0])) for c in (distance.scatter, distance.error))
    others = f"{'further apart' if distance.offset[0] > 0 else 'nearer together'} than"
    return Finding(
        severity=Severity.WARNING if distance.probability < RARE else Severity.INFO,
        topic=verdict.JOINT_POSITIONS,
        where=STUDY,
        cause=f"the hips are {others} those of "
        f"{'999 in 1000' if distance.probability < RARE else '19 in 20'} people",
        found=f"{gap:.0f} mm apart{_compare_with_spines(model, gap)}; "
        f"expected from {coordinates.JOINT_TABLE['hip'].landmarks}: {nominal:.0f} mm, SD of people "
        f"{deviation:.0f} mm, error of the fit ± {error:.0f} mm; "
        f"{_describe_odds(distance.probability)} so far",
        cure=_build_remedy("hip", isolated=False) if distance.probability < RARE else "",
        weight=_compute_weight([distance]),
        code=Code.JOINT_PLACE,
    )


def _measure_hip_gap(parameters: Parameters) -> float:
    """Measure the distance (mm) between the hip centres in the pelvis."""
    right, left = (parameters.centre(f"hip_{side}", "pelvis") for side in linkage.SIDES)
    return 1e3 * float(np.linalg.norm(right - left))


def _compare_with_spines(model: SubjectModel, gap_mm: float) -> str:
    """Describe the hip distance as a share of the ASIS distance, by hand or between markers."""
    ends = [model.landmarks[name][1] for name in ("asis_r", "asis_l") if name in model.landmarks]
    width = model.subject.asis_distance or (
        float(np.linalg.norm(ends[0] - ends[1])) if len(ends) == 2 else 0.0
    )
    if not width:
        return ""
    return (
        f", {1e-3 * gap_mm / width:.2f} of the {1e3 * width:.0f} mm between the ASIS (in CT "
        f"{CT_RATIO})"
    )


def _compute_weight(positions: Sequence[JointPosition]) -> float:
    """Compute how many times the limit of `RARE` the worst position is off."""
    return max(float(np.sqrt(p.square / chdtri(len(p.offset), RARE))) for p in positions)


def _describe_odds(probability: float) -> str:
    """Describe a probability: `1 person in 2000 is`."""
    if probability < 1e-6:
        return "fewer than 1 person in a million are"
    return f"1 person in {float(f'{1 / probability:.1g}'):.0f} is"


def _convert_to_mm_or_deg(name: str, value: float) -> float:
    """Convert a joint parameter from m or rad to mm or deg."""
    return float(value / JP_TO_SI[JP_INDEX[name]])


def _format_size(name: str, value: float) -> str:
    """Format a joint parameter in whole mm or deg."""
    return f"{_convert_to_mm_or_deg(name, value):.0f}"


def _describe_offset(name: str, value: float) -> str:
    """Describe the offset of a joint parameter: `34 mm outward`."""
    joint, _, direction = name.split(".")
    size = f"{abs(_convert_to_mm_or_deg(name, value)):.0f}"
    if JOINT_PARAMETERS[JP_INDEX[name]].kind is not ParameterKind.POSITION:
        return f"rotated by {size} deg (viewed from {_VIEWED_FROM[direction]})"
    if direction == "lat":
        word = "outward" if (value > 0) == joint.endswith("_r") else "inward"
    else:
        word = _DIRECTIONS[direction][bool(value < 0)]
    return f"{size} mm {word}"


def _describe_few_markers(model: SubjectModel, joint: str) -> str:
    """Name adjacent segments with too few markers to detect soft tissue by deformation."""
    adjacent = dict.fromkeys(p.segment for p in JOINT_PARAMETERS if p.joint == joint)
    pairs = zip(model.markers.segments, model.markers.weight, strict=True)
    counts = Counter(segment for segment, weight in pairs if weight > 0)
    parts = [part for part in adjacent if not part.startswith("talus")]
    few = [f"{counts[p]} on the {p.split('_')[0]}" for p in parts if counts[p] < FEWEST_MARKERS]
    return f"; too few markers to detect soft tissue motion: {' and '.join(few)}" if few else ""


def _build_remedy(kind: str, isolated: bool) -> str:
    """Build the remedy for a joint at an unusual position."""
    skin = (
        "soft tissue that slides in phase with the motion has this effect, which error bars do not "
        "fully cover"
    )
    trial = "compare with a slow functional trial of large range, non-weight-bearing"
    if not isolated:
        trial = 'record a functional trial of the joint (role "joint")'
    keep = (
        "if imaging confirms the position, set joint_prior under [calibration]; jp = false keeps "
        "the nominal joints"
    )
    return (
        f"check {coordinates.JOINT_TABLE[kind].markers} in the static trial; {skin}; {trial}; "
        f"{keep}"
    )


def check_given_hips(trial: trial_evidence.TrialEvidence) -> Iterator[Finding]:
    """Report hip centres of the file far from the regression, or asymmetric.

    Parameters
    ----------
    trial
        The static trial that makes the model; others are not checked.

    Yields
    ------
    Finding
        One warning, or nothing.
    """
    if (
        not trial.makes_model
        or trial.model is None
        or trial.settings.hip_rule != HipCentre.GIVEN.value
    ):
        return
    p = {name: at for name, (_, at) in trial.model.landmarks.items()}
    between = float(np.linalg.norm(p["asis_r"] - p["asis_l"]))
    width = PelvicWidth(between, trial.subject.asis_distance).get_width(HipCentre.HARRINGTON)
    depth = float(np.linalg.norm(0.5 * (p["asis_r"] + p["asis_l"]) - p["sacrum"]))
    gaps = {
        side: float(
            np.linalg.norm(
                p[f"hjc_{side}"] - compute_hip_centre(HipCentre.HARRINGTON, width, depth, side)
            )
        )
        for side in linkage.SIDES
    }
    # asymmetry: one hip centre relative to the mirror image of the other
    uneven = p["hjc_r"] - [1.0, 1.0, -1.0] * p["hjc_l"]  # z is mirrored
    asymmetry, off = float(np.linalg.norm(uneven)), max(gaps.values())
    too_far = max(off / (DOUBTED_GIVEN * between), asymmetry / (UNEVEN_GIVEN * between))
    if too_far <= 1.0:
        return
    ahead, up, outwards = 1e3 * uneven
    allowed = [1e3 * share * between for share in (DOUBTED_GIVEN, UNEVEN_GIVEN)]
    yield trial.warning(
        "hip centres",
        f"{1e3 * gaps['r']:.0f} mm (right) and {1e3 * gaps['l']:.0f} mm (left) from the regression "
        f"of Harrington 2007, usual: up to {allowed[0]:.0f} mm; the right one is {ahead:+.0f} mm "
        f"forward, {up:+.0f} mm up and {outwards:+.0f} mm outward of the left one's mirror image, "
        f"usual: up to {allowed[1]:.0f} mm",
        "check how the other program estimates them, or set hip_centre = 'harrington' under "
        "[calibration]",
        cause="the hip centres of the file are at unusual positions",
        weight=too_far,
        code=Code.GIVEN_HIPS,
    )
