"""Names, signs and usual ranges of coordinates and joints, one table row each.

The linkage (`linkage.py`) defines how coordinates move and their order. Signs are OpenSim's
(Rajagopal et al. 2016). They mean the same on both sides, so a row has no side:

    angle       meaning of a positive angle; moment: effect of a positive internal moment; senses:
                both directions
    clinical    signs of gait laboratories where they differ, by the side of the stride (pelvis and
                trunk)

Numbers are degrees (pelvis translations: m). Their sources are given where the field is defined.
"""

from dataclasses import dataclass
from typing import Final

from gaitcal.model.linkage import COORDINATES, REACTIONS, SIDES, is_translation


@dataclass(frozen=True, kw_only=True)
class ClinicalSense:
    """Sign convention of gait laboratories for a coordinate, by the side of the stride."""

    right: float  # 1 or -1: factor of the value in strides of the right foot
    left: float
    positive: str  # meaning of a positive one: `this side up`
    opposite: str  # and a negative one

    def sign(self, side: str) -> float:
        """Return the factor (1 or -1) of the value in strides of one side (`r`, `l`)."""
        return self.right if side == "r" else self.left


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits that no walking or running person exceeds (`quality/after_fit.py`).

    Angles: the largest passive ranges of adults (American Academy of Orthopaedic Surgeons, Joint
    Motion, 1965; Boone and Azen, J Bone Joint Surg 61-A:756-759, 1979), widened by 20 deg because
    zero angles differ between models. Speeds: above those of kicking and sprinting; no clean walk
    or functional trial exceeds 600 deg/s. Torques: beyond those of sprinters at 9 m/s (Schache et
    al., Med Sci Sports Exerc 43:1260-1271, 2011); clean walks reach 10 %BW*H.
    """

    angle: tuple[float, float] | None = None  # deg, smallest and largest
    speed: float | None = None  # deg/s
    torque: float  # percent of body weight times height


@dataclass(frozen=True, kw_only=True)
class Coordinate:
    """A coordinate of the linkage, or the reaction of a locked joint, without its side."""

    name: str  # without the side: `hip_flexion`
    group: str  # key of `GROUPS`
    title: str  # `Hip flexion`
    angle: str  # meaning of a positive angle: `flexion`
    moment: str  # effect of a positive internal moment: `flexor`
    # meaning of positive and negative values, of angles and of moments
    senses: tuple[str, str] | None = None
    # with clinical signs, where they are others
    clinical: ClinicalSense | None = None
    # first word of the Plug-in Gait point that holds it: `Hip` of `RHipAngles`; empty: none does
    point: str = ""
    # deg: living people stay within, for sliders of other programs; contains Rajagopal's
    usual: tuple[float, float]
    wall: tuple[float, float] | None = None
    """deg from the static posture, how far the joint may turn in tracking. Passive ranges of
    adults: hip adduction 30 and abduction 45, rotation 45 each way, dorsiflexion 20, plantarflexion
    50, inversion 35, eversion 15 (American Academy of Orthopaedic Surgeons 1965); about as much
    again for what axes that are off make of them."""
    spread: float | None = None
    """deg, standard deviation about the expected angle where markers do not determine it. Thorax in
    the laboratory: it turns through 4 deg (tilt), 5 (list) and 8 (rotation) in a stride of normal
    gait, an RMS of 1.5 to 3 deg, and leans by 2 to 4 deg otherwise than in standing (Krebs et al.
    1992; Leardini et al. 2011). Shoulder: 25 to 40 deg of swing, an RMS of 9 to 14, and as much of
    posture; elbow bent by 10 to 40 deg (Murray, Sepic and Barnard 1967). Legs: RMS of a stride of
    normal gait, and 5 deg of posture."""
    limits: Limits | None = None


@dataclass(frozen=True)
class CoordinateGroup:
    """A joint, with the coordinates that are shown together."""

    title: str
    # its power over all axes, as in `powers/TRIAL.csv`; empty: it has none
    power: str


GROUPS: Final = {
    "hip": CoordinateGroup("Hip", "hip"),
    "knee": CoordinateGroup("Knee", "knee"),
    "ankle": CoordinateGroup("Ankle and foot", "ankle"),
    "pelvis": CoordinateGroup("Pelvis", ""),
    "trunk": CoordinateGroup("Trunk", "lumbar"),
    "arm": CoordinateGroup("Arm", ""),
}
"""In the order of pages."""
LEG_GROUPS: Final = ("hip", "knee", "ankle")

_FORWARD = ClinicalSense(
    right=1.0, left=-1.0, positive="this side forward", opposite="this side backward"
)

# fmt: off
_ROWS: Final = (
    Coordinate(name="pelvis_tilt", group="pelvis", title="Pelvic tilt", angle="posterior",
        moment="posterior", senses=("posterior tilt", "anterior tilt"),
        clinical=ClinicalSense(right=-1.0, left=-1.0, positive="anterior tilt",
            opposite="posterior tilt"),
        point="Pelvis", usual=(-90.0, 90.0)),
    Coordinate(name="pelvis_list", group="pelvis", title="Pelvic obliquity",
        angle="right side down", moment="right side down",
        senses=("right side down", "left side down"),
        clinical=ClinicalSense(right=-1.0, left=1.0, positive="this side up",
            opposite="this side down"),
        point="Pelvis", usual=(-90.0, 90.0)),
    Coordinate(name="pelvis_rotation", group="pelvis", title="Pelvic rotation", angle="turned left",
        moment="to the left", senses=("rotation to the left", "rotation to the right"),
        clinical=_FORWARD, point="Pelvis", usual=(-180.0, 180.0)),
    Coordinate(name="hip_flexion", group="hip", title="Hip flexion", angle="flexion",
        moment="flexor", senses=("flexion", "extension"), point="Hip", usual=(-40.0, 130.0),
        limits=Limits(angle=(-50.0, 145.0), speed=1500.0, torque=50.0)),
    Coordinate(name="hip_adduction", group="hip", title="Hip adduction", angle="adduction",
        moment="adductor", senses=("adduction", "abduction"), point="Hip", usual=(-60.0, 40.0),
        wall=(-40.0, 40.0), limits=Limits(angle=(-65.0, 50.0), speed=1000.0, torque=40.0)),
    Coordinate(name="hip_rotation", group="hip", title="Hip rotation", angle="internal",
        moment="internal rotator", senses=("internal rotation", "external rotation"), point="Hip",
        usual=(-50.0, 50.0), wall=(-50.0, 50.0), spread=10.0,
        limits=Limits(angle=(-65.0, 65.0), speed=1500.0, torque=20.0)),
    Coordinate(name="knee_angle", group="knee", title="Knee flexion", angle="flexion",
        moment="flexor", senses=("flexion", "extension"), point="Knee", usual=(-15.0, 150.0),
        limits=Limits(angle=(-30.0, 160.0), speed=2200.0, torque=45.0)),
    Coordinate(name="knee_adduction", group="knee", title="Knee adduction", angle="adduction",
        moment="adductor", senses=("adduction", "abduction"), point="Knee", usual=(0.0, 0.0),
        limits=Limits(torque=30.0)),
    Coordinate(name="ankle_angle", group="ankle", title="Ankle dorsiflexion", angle="dorsiflexion",
        moment="dorsiflexor", senses=("dorsiflexion", "plantarflexion"), point="Ankle",
        usual=(-60.0, 40.0), wall=(-70.0, 50.0), spread=15.0,
        limits=Limits(angle=(-75.0, 55.0), speed=2000.0, torque=40.0)),
    Coordinate(name="subtalar_angle", group="ankle", title="Hindfoot inversion", angle="inversion",
        moment="invertor", senses=("inversion", "eversion"), point="Subtalar", usual=(-40.0, 40.0),
        wall=(-50.0, 50.0), spread=10.0,
        limits=Limits(angle=(-60.0, 60.0), speed=2000.0, torque=20.0)),
    Coordinate(name="lumbar_extension", group="trunk", title="Lumbar extension", angle="extension",
        moment="extensor", senses=("extension", "flexion"), usual=(-90.0, 90.0), spread=5.0,
        clinical=ClinicalSense(right=-1.0, left=-1.0, positive="flexion", opposite="extension")),
    Coordinate(name="lumbar_bending", group="trunk", title="Lumbar bending", angle="to the right",
        moment="to the right", senses=("bending to the right", "bending to the left"),
        usual=(-90.0, 90.0), spread=5.0,
        clinical=ClinicalSense(right=1.0, left=-1.0, positive="to this side",
            opposite="to the other side")),
    Coordinate(name="lumbar_rotation", group="trunk", title="Lumbar rotation", angle="to the left",
        moment="to the left", senses=("rotation to the left", "rotation to the right"),
        usual=(-90.0, 90.0), spread=5.0, clinical=_FORWARD),
    Coordinate(name="arm_flex", group="arm", title="Shoulder flexion", angle="flexion",
        moment="flexor", senses=("flexion", "extension"), usual=(-90.0, 180.0), spread=20.0),
    Coordinate(name="arm_add", group="arm", title="Shoulder adduction", angle="adduction",
        moment="adductor", senses=("adduction", "abduction"), usual=(-150.0, 90.0), spread=10.0),
    Coordinate(name="elbow_flex", group="arm", title="Elbow flexion", angle="flexion",
        moment="flexor", senses=("flexion", "extension"), usual=(-15.0, 160.0), spread=20.0),
)
# fmt: on
COORDINATE_TABLE: Final[dict[str, Coordinate]] = {row.name: row for row in _ROWS}
"""Name without its side -> its description: every angle in the order of the linkage, a reaction
after its joint's angle.
"""
FOOT_PROGRESSION: Final = "foot_progression"
# fmt: off
_SEGMENT_ROWS: Final = (
    Coordinate(name=FOOT_PROGRESSION, group="ankle", title="Foot progression", angle="internal",
        moment="", senses=("internal, toes in", "external, toes out"), usual=(-90.0, 90.0)),
)
# fmt: on
SEGMENT_ANGLES: Final[dict[str, Coordinate]] = {row.name: row for row in _SEGMENT_ROWS}
"""Angles of legs that are no coordinate, against each stride's line of progression: no torque
belongs to them.
"""
TRANSLATION_RANGES: Final = {
    "pelvis_tx": (-20.0, 20.0),
    "pelvis_ty": (-1.0, 3.0),
    "pelvis_tz": (-20.0, 20.0),
}
"""m, as `usual`."""

COMPONENT_SENSES: Final = {
    "knee_rotation": ("internal rotation", "external rotation"),
    "ankle_inversion": ("inversion", "eversion"),
    "ankle_rotation": ("internal rotation", "external rotation"),
}
"""Moments of legs along axes that have no coordinate (`dynamics/joint_kinetics.py`) -> their
senses.
"""


def split_side(name: str) -> tuple[str, str]:
    """`hip_flexion_r` -> (`hip_flexion`, `r`); `lumbar_bending` -> (`lumbar_bending`, ``)."""
    return (
        (name[:-2], name[-1]) if name.endswith(tuple(f"_{side}" for side in SIDES)) else (name, "")
    )


def group_of(name: str) -> str:
    """Key of `GROUPS` of a coordinate or reaction, with or without its side; translations belong to
    the pelvis.
    """
    return "pelvis" if is_translation(name) else COORDINATE_TABLE[split_side(name)[0]].group


LEG_COORDINATES: Final[tuple[str, ...]] = tuple(
    row.name for row in _ROWS if row.group in LEG_GROUPS
)
"""Torques of one leg from hip to foot, without the side: its coordinates, each locked joint's
reaction among them.
"""
LOCKED: Final[tuple[str, ...]] = tuple(dict.fromkeys(name[:-2] for name in REACTIONS))
"""Reactions, without the side: they have moments and no angle."""


def with_side(name: str, side: str) -> str:
    """Add the side to a name: `hip_flexion` -> `hip_flexion_r`; `pelvis_tilt` stays."""
    return name if name in COORDINATES else f"{name}_{side}"


def describe_coordinate(name: str) -> Coordinate:
    """Get the table row of a coordinate or reaction.

    Parameters
    ----------
    name : str
        Name with or without its side.

    Returns
    -------
    Coordinate
        A row with the name alone if `name` is a joint or a component.
    """
    base = split_side(name)[0]
    return (
        COORDINATE_TABLE.get(base)
        or SEGMENT_ANGLES.get(base)
        or Coordinate(
            name=base,
            group="",
            title=base.replace("_", " "),
            angle="positive",
            moment="positive",
            usual=(0.0, 0.0),
        )
    )


def get_senses(name: str) -> tuple[str, str] | None:
    """Get the meaning of positive and negative values of a coordinate, reaction or component."""
    return COMPONENT_SENSES.get(split_side(name)[0]) or describe_coordinate(name).senses


@dataclass(frozen=True, kw_only=True)
class JointNames:
    """Names of a joint of the linkage."""

    title: str  # `Ankle (talocrural)`
    feature: str  # the feature that its parameters locate: `knee axis`
    centre: str = ""  # landmark that is its centre, without the side: `hjc`; empty: it has none
    power: str  # joint whose power includes its power: `ankle` of `subtalar`
    landmarks: str = "the landmarks"  # landmarks that define its position
    # what to check where it is elsewhere
    markers: str = "the markers of the segments beside it"


# fmt: off
JOINT_TABLE: Final[dict[str, JointNames]] = {
    "hip": JointNames(title="Hip", feature="hip centre", centre="hjc", power="hip",
        landmarks="the pelvis's landmarks", markers="the ASIS and PSIS markers"),
    "knee": JointNames(title="Knee", feature="knee axis", centre="kjc", power="knee",
        landmarks="the epicondyles", markers="the knee markers"),
    "talocrural": JointNames(title="Ankle (talocrural)", feature="ankle axis", centre="ajc",
        power="ankle", landmarks="the malleoli and anatomy",
        markers="the markers of malleoli and foot"),
    "subtalar": JointNames(title="Subtalar", feature="subtalar axis", power="ankle",
        landmarks="the malleoli and anatomy", markers="the markers of malleoli and foot"),
    "back": JointNames(title="Lumbar joint", feature="lumbar joint centre", centre="lumbar",
        power="lumbar"),
    "shoulder": JointNames(title="Shoulder", feature="shoulder joint", centre="sjc",
        power="shoulder"),
    "elbow": JointNames(title="Elbow", feature="elbow axis", centre="ejc", power="elbow"),
}
# fmt: on
"""Joint of the linkage, without its side -> its names."""
