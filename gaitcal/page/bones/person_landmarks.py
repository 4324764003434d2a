"""Where a person's bones must lie: landmarks of the static trial and joint centres, in the segment frames.

Nothing here is taken from a fitted axis. The knee is the middle between the epicondyles and the line through them, as
palpated; so a bone that stands on these landmarks shows whether the fitted knee axis passes through its condyles. Had
the bone been laid on the fitted axis, it would pass through them whatever the fit is. Hip centres, which nobody can
palpate, are the fitted ones: there the bones follow the fit and say nothing about it.

A marker's centre lies its radius off the skin; epicondyles, malleoli and spines are taken that much nearer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.chain import Chain
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.kinematics import forward, segment_poses
from gaitcal.model.knee_and_ankle import JointWidths
from gaitcal.model.linkage import COORDINATES, SEGMENTS, SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.page.body_fit import vertex_above_lumbar, wrist


class KneeEvidence(Enum):
    """What tells where the femur's epicondyles are."""

    BOTH = "both epicondyles"
    """Markers on both."""
    DEVICE = "lateral epicondyle and knee alignment device"
    """A marker on the lateral one, and a rod along the axis that a person chose."""
    LATERAL = "lateral epicondyle"
    """One marker: the bone's turn about its length is the pelvis's in the static trial."""
    NOMINAL = "nominal joint"
    """No marker: the bone stands on the nominal knee."""


@dataclass(frozen=True)
class PersonLandmarks:
    """Targets of the bones' landmarks."""

    points: Mapping[str, Array]
    """`segment/landmark` -> (3,) m in the segment frame; `talus_r/foot` -> (3, 4), the foot's frame in the talus."""
    knees: Mapping[str, KneeEvidence]
    """Side -> where its epicondyles are from."""

    def point(self, segment: str, landmark: str) -> Array:
        """(3,) m."""
        return self.points[f"{segment}/{landmark}"]

    @property
    def complete(self) -> bool:
        """Whether all is there that bones need, of the right size and finite."""
        return set(self.knees) == set(SIDES) and all(
            name in self.points and self.points[name].shape == shape and bool(np.isfinite(self.points[name]).all())
            for name, shape in _shapes().items()
        )


def _shapes() -> dict[str, tuple[int, ...]]:
    """Every target that must be there, and its shape; the PSIS alone may be unknown."""
    sided = {
        "thigh": ("hip", "knee", "epicondyle_lat", "epicondyle_med"),
        "shank": ("knee", "ankle", "malleolus_lat", "malleolus_med"),
        "foot": ("ankle", "up", "heel_to_toe"),
        "upper_arm": ("shoulder", "elbow"),
        "forearm_hand": ("elbow", "wrist"),
    }
    single = [f"{part}_{side}/{name}" for part, names in sided.items() for name in names for side in SIDES]
    single += ["pelvis/asis", "head_trunk/lumbar", "head_trunk/vertex"]
    single += [f"{place}_{side}" for place in ("pelvis/hip", "head_trunk/shoulder") for side in SIDES]
    return dict.fromkeys(single, (3,)) | {f"talus_{side}/foot": (3, 4) for side in SIDES}


def person_landmarks(model: SubjectModel) -> PersonLandmarks:
    """The targets of a person's bones."""
    fitted = dict(zip(JP_INDEX, model.parameters.joint, strict=True))
    radius = JointWidths.of(model.subject).marker_radius
    points = _pelvis(model, fitted, radius) | _trunk(model, fitted)
    knees = {}
    for side in SIDES:
        thigh, knees[side] = _thigh(model, fitted, side)
        points |= thigh | _shank(model, side) | _foot(model, side) | _arm(model, fitted, side)
    return PersonLandmarks(points, knees)


def _joint(jp: Mapping[str, float], place: str) -> Array:
    """(3,) m of a joint centre in one of its segments; what is no parameter is zero by definition of the frames."""
    return np.array([jp.get(f"{place}.{axis}", 0.0) for axis in ("ant", "sup", "lat")])


def _nominal(model: SubjectModel, place: str) -> Array:
    return _joint(dict(zip(JP_INDEX, model.nominal.joint, strict=True)), place)


def _known(model: SubjectModel, landmark: str, segment: str) -> Array | None:
    found = model.landmarks.get(landmark)
    return found[1] if found is not None and found[0] == segment else None


def _pelvis(model: SubjectModel, jp: Mapping[str, float], radius: float) -> dict[str, Array]:
    """Mid-ASIS is the origin of the pelvis, x forward; without markers there the nominal subject's depth."""
    hips = {f"pelvis/hip_{side}": _joint(jp, f"hip_{side}.pelvis") for side in SIDES}
    out = {**hips, "pelvis/asis": np.array([-radius, 0.0, 0.0])}
    sacrum = _known(model, "sacrum", "pelvis")
    if sacrum is not None:
        out["pelvis/psis"] = sacrum + [radius, 0.0, 0.0]
    return out


def _thigh(model: SubjectModel, jp: Mapping[str, float], side: str) -> tuple[dict[str, Array], KneeEvidence]:
    segment = f"thigh_{side}"
    hip = _joint(jp, f"hip_{side}.thigh")
    lateral = _known(model, f"knee_lat_{side}", segment)
    medial = _known(model, f"knee_med_{side}", segment)
    middle = _known(model, f"kjc_{side}", segment)
    outwards = np.array([0.0, 0.0, 1.0 if side == "r" else -1.0])
    widths = JointWidths.of(model.subject)
    half = widths.inwards("knee", side) - widths.marker_radius
    if lateral is not None and medial is not None:
        evidence, middle = KneeEvidence.BOTH, 0.5 * (lateral + medial)
        outwards = lateral - medial
        if not widths.is_measured("knee", side):
            half = 0.5 * float(np.linalg.norm(outwards)) - widths.marker_radius
    elif lateral is not None and middle is not None:
        device = f"knee_axis_{side}" in model.landmarks
        evidence, outwards = KneeEvidence.DEVICE if device else KneeEvidence.LATERAL, lateral - middle
    else:
        evidence, middle = KneeEvidence.NOMINAL, _nominal(model, f"knee_{side}.thigh")
    outwards = outwards / np.linalg.norm(outwards)
    points = {"hip": hip, "knee": middle, "epicondyle_lat": middle + half * outwards}
    points["epicondyle_med"] = middle - half * outwards
    return {f"{segment}/{name}": point for name, point in points.items()}, evidence


def _shank(model: SubjectModel, side: str) -> dict[str, Array]:
    """Its origin is the middle of the knee in the static trial."""
    segment = f"shank_{side}"
    widths = JointWidths.of(model.subject)
    lateral = _known(model, f"ankle_lat_{side}", segment)
    medial = _known(model, f"ankle_med_{side}", segment)
    half = widths.inwards("ankle", side) - widths.marker_radius
    middle = _known(model, f"ajc_{side}", segment)
    outwards = np.array([0.0, 0.0, 1.0 if side == "r" else -1.0])
    if lateral is not None and medial is not None:
        middle, outwards = 0.5 * (lateral + medial), lateral - medial
        if not widths.is_measured("ankle", side):
            half = 0.5 * float(np.linalg.norm(outwards)) - widths.marker_radius
    elif lateral is not None and middle is not None:
        outwards = lateral - middle
    if middle is None:
        middle = _nominal(model, f"talocrural_{side}.shank")
    outwards = outwards / np.linalg.norm(outwards)
    return {
        f"{segment}/knee": np.zeros(3),
        f"{segment}/ankle": middle,
        f"{segment}/malleolus_lat": middle + half * outwards,
        f"{segment}/malleolus_med": middle - half * outwards,
    }


def _foot(model: SubjectModel, side: str) -> dict[str, Array]:
    """Ankle centre, upward direction and the line of heel and toe (x) at zero nominal coordinates."""
    foot, talus = f"foot_{side}", f"talus_{side}"
    axes, origins = _upright(model.nominal)
    into_foot, in_talus = axes[foot], axes[talus]
    ankle = into_foot @ (origins[talus] - origins[foot])
    rotation = in_talus @ into_foot.T
    toe, heel = (_known(model, f"{name}_{side}", foot) for name in ("toe", "heel"))
    length = np.zeros(3) if toe is None or heel is None else toe - heel
    return {
        f"{foot}/ankle": ankle,
        f"{foot}/up": into_foot[:, 1].copy(),
        f"{foot}/heel_to_toe": length,
        f"{talus}/foot": np.column_stack([rotation, in_talus @ (origins[foot] - origins[talus])]),
    }


def _upright(parameters: Parameters) -> tuple[dict[str, Array], dict[str, Array]]:
    """Segment -> (3, 3) rotation from laboratory to segment, (3,) m origin; all coordinates zero."""
    chain = Chain("pelvis", SEGMENTS)
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, np.zeros((1, len(COORDINATES)))))
    index = {segment: i for i, segment in enumerate(chain.segments)}
    return {s: axes[i, :, :, 0] for s, i in index.items()}, {s: origins[i, :, 0] for s, i in index.items()}


def _trunk(model: SubjectModel, jp: dict[str, float]) -> dict[str, Array]:
    lumbar = _joint(jp, "back.trunk")
    out = {f"head_trunk/shoulder_{side}": _joint(jp, f"shoulder_{side}.trunk") for side in SIDES}
    rise = np.array([0.0, vertex_above_lumbar(jp, model.subject.height), 0.0])
    return {**out, "head_trunk/lumbar": lumbar, "head_trunk/vertex": lumbar + rise}


def _arm(model: SubjectModel, jp: dict[str, float], side: str) -> dict[str, Array]:
    upper, fore = f"upper_arm_{side}", f"forearm_hand_{side}"
    return {
        f"{upper}/shoulder": _joint(jp, f"shoulder_{side}.upperarm"),
        f"{upper}/elbow": _joint(jp, f"elbow_{side}.upperarm"),
        f"{fore}/elbow": _joint(jp, f"elbow_{side}.forearm"),
        f"{fore}/wrist": wrist(model, jp, side),
    }
