"""Do the joints of the legs lie where people have them: those that a fit found, and hip centres
that a file gives?

Each segment beside a joint places it by some parameters theta: the pelvis a hip's centre, the thigh
a knee's axis by two positions and two turns. Landmarks and what is known of people expect theta_0,
the nominal values and the mean of the prior. With d = theta - theta_0, of n parameters,

    z^2 = d^T (P + E)^-1 d,     doubted where chi^2 of n degrees of freedom is larger in `RARE` of all cases only,

P the scatter of people about theta_0, in which that of palpation and regressions is
(`joint_prior.py`), and E what noise and skin of the fit's own markers move theta by. A fit that
leans on a prior has theta = theta_0 + K (true - theta_0 + e), K at most 1, and E = K cov(e) K^T, so
that cov(d) = K P K^T + E is at most P + E: a fit without a prior is judged alike. The distance
between the hips is judged in the same way. A doubted joint is some four scatters off; from
`UNUSUAL` on, some three, it is named in a note. So is one with a parameter more than `FARTHEST`
standard deviations of people away, however uncertain it is.

A study file or a cohort that knows more of these people has its mean in theta_0; P stays anatomy's.
"""

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
from gaitcal.study.cohort_prior import JointPrior
from gaitcal.tracking.rigid import FEWEST_MARKERS

# Of all people: who has a joint there, or who is told so wrongly at most, for each place that is
# looked at
RARE = 1e-3
# As `RARE`, of a note: the usual level at which something is looked at that proves nothing by
# itself
UNUSUAL = 0.05
FARTHEST = 3.0  # Standard deviations of people, of one parameter
CT_RATIO = "0.65 to 0.82"
"""Distance of the hips over that of the ASIS of ten people in CT (landmarks of Fischer 2021), 0.71
in the mean.
"""
LEAST_SHARE = 0.3  # Of the largest offset in units of its scatter: what is smaller is not told
# Beginning of the names of error sources that are no markers but the prior's own error
NOMINAL = "nominal/"
_WAYS = {"ant": ("forward", "back"), "sup": ("up", "down"), "lat": ("outward", "inward")}
_SEEN_FROM = {"front": "the front", "trans": "above", "sag": "the side"}


def joint_place_findings(
    model: SubjectModel,
    fitted: Parameters,
    errors: ErrorSources,
    prior: JointPrior,
    isolated: Collection[str] = (),
) -> Iterator[Finding]:
    """Joints of the legs that lie where fewer than `RARE` of all people have them, each once; notes
    from `UNUSUAL` on.

    `model`: the nominal one, with the landmarks of the static trial.
    `errors`: of the fitted joint parameters.
    `prior`: what is expected of this person, of all joint parameters.
    `isolated`: joints (`knee_r`, ...) that have an isolated trial of their own.
    """
    places = _Places(model, fitted, errors, prior)
    hip_told = False
    for side in linkage.SIDES:
        for joint in (f"{name}_{side}" for name in linkage.LEG_JOINTS):
            views = list(places.of(joint))
            limit = RARE if min(place.probability for place in views) < RARE else UNUSUAL
            if far := [
                place for place in views if place.probability < limit or place.farthest > FARTHEST
            ]:
                yield _finding(joint, far, model, joint in isolated)
                hip_told = hip_told or joint.startswith("hip")
    apart = places.hips_apart()
    if apart.probability < (RARE if hip_told else UNUSUAL):
        yield _apart(apart, model, fitted)


@dataclass(frozen=True, kw_only=True)
class JointPosition:
    """A joint as one segment has it, or the distance of two."""

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
        """That a person has a joint so far from where it is expected, or further."""
        return float(chdtrc(len(self.offset), self.square))

    @property
    def farthest(self) -> float:
        """The largest offset of a parameter in standard deviations of people, without the fit's
        error.
        """
        return float((np.abs(self.offset) / np.sqrt(np.diag(self.scatter))).max())

    @property
    def words(self) -> str:
        """`in the pelvis 34 mm outward and 12 mm down (people scatter by 9 and 10; markers leave ±
        3 and 4)`.
        """
        deviation, error = (np.sqrt(np.diag(of)) for of in (self.scatter, self.error))
        times = np.abs(self.offset) / deviation
        large = [k for k in np.argsort(-times) if times[k] >= LEAST_SHARE * times.max()]
        ways = " and ".join(_way(self.names[k], float(self.offset[k])) for k in large)
        people, fit = (
            " and ".join(f"{_size(self.names[k], of[k]):.0f}" for k in large)
            for of in (deviation, error)
        )
        segment = self.names[0].split(".")[1]
        return (
            f"in the {segment} {ways} (people scatter by {people}; the fit's own markers leave ± "
            f"{fit})"
        )


class _Places:
    """Where the joints of one fit lie against what is expected."""

    def __init__(
        self, model: SubjectModel, fitted: Parameters, errors: ErrorSources, prior: JointPrior
    ) -> None:
        expected = model.nominal.joint.copy()
        expected[[JP_INDEX[name] for name in prior.names]] += prior.mean
        self._offset = fitted.joint - expected
        measured_clusters = [
            k for k, name in enumerate(errors.clusters) if not name.startswith(NOMINAL)
        ]
        self._moves = np.zeros((len(JP_NAMES), len(measured_clusters)))
        known = [(JP_INDEX[name], row) for row, name in enumerate(errors.free) if name in JP_INDEX]
        for at, row in known:
            self._moves[at] = errors.parameters[row, measured_clusters]

    def of(self, joint: str) -> Iterator[JointPosition]:
        """A joint as each segment beside it has it."""
        for segment in dict.fromkeys(
            name.split(".")[1] for name in JP_NAMES if name.startswith(f"{joint}.")
        ):
            names = tuple(name for name in JP_NAMES if name.startswith(f"{joint}.{segment}."))
            yield self._along(names, np.eye(len(names)))

    def hips_apart(self) -> JointPosition:
        """The distance between the hips in the pelvis, across it; positive where they lie further
        apart.
        """
        return self._along(("hip_r.pelvis.lat", "hip_l.pelvis.lat"), np.array([[1.0, -1.0]]))

    def _along(self, names: tuple[str, ...], directions: Array) -> JointPosition:
        """Of combinations (k, n) of joint parameters."""
        at = [JP_INDEX[name] for name in names]
        moves = directions @ self._moves[at]
        return JointPosition(
            names=names,
            offset=directions @ self._offset[at],
            scatter=directions @ COVARIANCE[np.ix_(at, at)] @ directions.T,
            error=moves @ moves.T,
        )


def _finding(
    joint: str, views: Sequence[JointPosition], model: SubjectModel, isolated: bool
) -> Finding:
    kind, side = joint.split("_")
    least = min(place.probability for place in views)
    few = round(1 / (RARE if least < RARE else UNUSUAL))
    cause = f"the {describe_joint(joint)} joint lies where fewer than 1 in {few} people have one"
    if least >= UNUSUAL:
        cause = (
            f"the {describe_joint(joint)} joint lies {FARTHEST:.0f} scatters of people from where it "
            "is expected"
        )
    return Finding(
        severity=Severity.WARNING if least < RARE else Severity.INFO,
        topic=verdict.PLACES,
        where=STUDY,
        leg=side,
        cause=cause,
        found=f"it lies, from where {coordinates.JOINT_TABLE[kind].landmarks} have it, "
        f"{'; '.join(place.words for place in views)}; {_odds(least)} so "
        f"far{_few_markers(model, joint)}",
        cure=_cure(kind, isolated) if least < RARE else "",
        weight=_weight(views),
        code=Code.KNEE_AXIS if kind == "knee" else Code.JOINT_PLACE,
    )


def _apart(place: JointPosition, model: SubjectModel, fitted: Parameters) -> Finding:
    hips = [
        [p.centre(f"hip_{side}", "pelvis") for side in linkage.SIDES]
        for p in (fitted, model.nominal)
    ]
    gap, nominal = (1e3 * float(np.linalg.norm(right - left)) for right, left in hips)
    deviation, error = (1e3 * float(np.sqrt(of[0, 0])) for of in (place.scatter, place.error))
    others = f"{'further apart' if place.offset[0] > 0 else 'nearer together'} than"
    return Finding(
        severity=Severity.WARNING if place.probability < RARE else Severity.INFO,
        topic=verdict.PLACES,
        where=STUDY,
        cause=f"the hips lie {others} {'999 in 1000' if place.probability < RARE else '19 in 20'} "
        "people's",
        found=f"{gap:.0f} mm apart{_over_spines(model, gap)}; "
        f"{coordinates.JOINT_TABLE['hip'].landmarks} have them "
        f"{nominal:.0f} mm apart, people scatter by {deviation:.0f} about that, and the fit's own "
        "markers leave "
        f"± {error:.0f} mm; {_odds(place.probability)} so far",
        cure=_cure("hip", isolated=False) if place.probability < RARE else "",
        weight=_weight([place]),
        code=Code.JOINT_PLACE,
    )


def _over_spines(model: SubjectModel, gap_mm: float) -> str:
    """The distance of the hips as a share of that of the ASIS: as measured by hand, else between
    their markers.
    """
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


def _weight(places: Sequence[JointPosition]) -> float:
    """How many times the limit."""
    return max(float(np.sqrt(place.square / chdtri(len(place.offset), RARE))) for place in places)


def _odds(probability: float) -> str:
    if probability < 1e-6:
        return "fewer than 1 person in a million lie"
    return f"1 person in {float(f'{1 / probability:.1g}'):.0f} lies"


def _size(name: str, value: float) -> float:
    """In mm or deg."""
    return float(value / JP_TO_SI[JP_INDEX[name]])


def _way(name: str, value: float) -> str:
    joint, _, direction = name.split(".")
    if JOINT_PARAMETERS[JP_INDEX[name]].kind is not ParameterKind.POSITION:
        return f"turned by {abs(_size(name, value)):.0f} deg seen from {_SEEN_FROM[direction]}"
    if direction == "lat":
        way = "outward" if (value > 0) == joint.endswith("_r") else "inward"
    else:
        way = _WAYS[direction][value < 0]
    return f"{abs(_size(name, value)):.0f} mm {way}"


def _few_markers(model: SubjectModel, joint: str) -> str:
    """Segments beside a joint on which skin that moves cannot show by deforming."""
    beside = dict.fromkeys(p.segment for p in JOINT_PARAMETERS if p.joint == joint)
    pairs = list(zip(model.markers.segments, model.markers.weight, strict=True))
    count = {
        part: sum(s == part and w > 0 for s, w in pairs)
        for part in beside
        if not part.startswith("talus")
    }
    few = [f"{n} on the {part.split('_')[0]}" for part, n in count.items() if n < FEWEST_MARKERS]
    return f"; too few markers show how skin moves: {' and '.join(few)}" if few else ""


def _cure(kind: str, isolated: bool) -> str:
    skin = "skin that slides in step with the motion does this, and no error bar shows all of it"
    trial = "compare with a slow isolated trial of large range, non-weight-bearing"
    if not isolated:
        trial = 'an isolated trial of the joint (role "joint") tells more'
    keep = (
        "where imaging shows it there, say so ([calibration] joint_prior); jp = false keeps the "
        "nominal joints"
    )
    return (
        f"look at {coordinates.JOINT_TABLE[kind].markers} in the static trial; {skin}; {trial}; "
        f"{keep}"
    )


def given_hips(trial: trial_evidence.TrialEvidence) -> Iterator[Finding]:
    """Given hip centres far from where the pelvis's markers tell, or of which one lies otherwise
    than the other.
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
    uneven = p["hjc_r"] - [1.0, 1.0, -1.0] * p["hjc_l"]  # in the mirror
    apart, off = float(np.linalg.norm(uneven)), max(gaps.values())
    too_far = max(off / (DOUBTED_GIVEN * between), apart / (UNEVEN_GIVEN * between))
    if too_far <= 1.0:
        return
    ahead, up, outwards = 1e3 * uneven
    allowed = [1e3 * share * between for share in (DOUBTED_GIVEN, UNEVEN_GIVEN)]
    yield trial.warning(
        "hip centres",
        f"{1e3 * gaps['r']:.0f} mm (right) and {1e3 * gaps['l']:.0f} mm (left) from where "
        "Harrington 2007 has them, "
        f"usual is up to {allowed[0]:.0f}; the right one lies {ahead:+.0f} mm forward, {up:+.0f} "
        "mm up and "
        f"{outwards:+.0f} mm outwards of the left one's mirror image, usual is up to "
        f"{allowed[1]:.0f}",
        "look where that program has them from, or take hip_centre = 'harrington' under "
        "[calibration]",
        cause="the hip centres of the file are not where hips usually are",
        weight=too_far,
        code=Code.GIVEN_HIPS,
    )
