"""One person's model: who, which parameters, which markers where.

`PointNoise`: how points err that are no markers on skin, the corners of segment poses and the key
points of markerless programs. A marker's error is skin that moves with the joints
(`calibration/soft_tissue_artefact.py`), and cameras that err by tenths of a millimetre: the
residuals tell both. What a program sees in pictures errs otherwise. Most of it is constant: the
joint centre of thousands of annotated pictures is not this person's, which no residual shows, and
which joints and axes are widened by (`joints`). The rest changes as slowly as what the cameras see,
so that frames near to each other say the same (`memory_s`); and where the program has fitted a body
of its own, its residuals are smaller than its errors (`size_mm` is the least that is believed of
them).
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from pydantic import Field

from gaitcal.arrays import Array
from gaitcal.display import Displayed, shorten
from gaitcal.io.toml import Table
from gaitcal.model.parameters import Parameters

GRAVITY = 9.81  # m/s^2, downwards along -y


@dataclass(frozen=True, kw_only=True)
class PatientRecord:
    """What a clinic writes down of a person and a session, as reports and tables show it; empty:
    nobody says it.

    Nothing is computed from it but the age (`study/study.py`). Dates are `2016-03-09`.
    """

    birth_date: str = ""
    """Only where the study has it, never from a recording."""
    session_date: str = ""
    """Of the recordings: from the study, else from the files themselves; never that of the
    computation.
    """
    diagnosis: str = ""
    affected_side: str = ""
    """`right`, `left`, `both` or `none`."""
    aids: str = ""
    """Orthoses, shoes, crutches, walkers."""
    laboratory: str = ""

    @property
    def known(self) -> dict[str, str]:
        """Field -> text of those that somebody says."""
        return {name: text for name, text in vars(self).items() if text}


@dataclass(frozen=True)
class Subject:
    """The person."""

    name: str
    """Stands in every output; need not be the person's own."""
    mass: float
    """kg."""
    height: float
    """m."""
    sex: str
    """`male` or `female`: the column of the anthropometric table; empty where nobody says: the mean
    of both.
    """
    age: float | None = None
    """Years; None where not known."""
    height_error: float = 0.0
    """m, standard deviation of a height that is estimated; 0 of a measured one."""
    knee_width: Mapping[str, float] = field(default_factory=dict)
    """Side -> m across the femoral epicondyles, where measured."""
    ankle_width: Mapping[str, float] = field(default_factory=dict)
    """Side -> m across the malleoli, where measured."""
    leg_length: Mapping[str, float] = field(default_factory=dict)
    """Side -> m from the anterior superior iliac spine to the medial malleolus, where measured."""
    asis_distance: float | None = None
    """m between the two anterior superior iliac spines, where measured by hand."""
    marker_diameter: float | None = None
    """m; None where not known."""
    session: str = ""
    """A date or a label of the day of these recordings; empty where nobody says."""
    record: PatientRecord = field(default_factory=PatientRecord)
    """What a clinic writes down beside it."""

    @property
    def weight(self) -> float:
        """Body weight, N."""
        return self.mass * GRAVITY

    @property
    def bwh(self) -> float:
        """Body weight times height, N·m: torques in %BW*H are 100 torque / bwh."""
        return self.weight * self.height


@dataclass(frozen=True)
class MarkerPlacement:
    """Tracking markers, fixed in their segments."""

    labels: tuple[str, ...]
    segments: tuple[str, ...]  # name of the segment of each marker
    local: Array  # (nm, 3) m, in the segment frame
    weight: Array  # (nm,) >= 0; a marker with weight 0 is reported but does not pull

    def on(self, segment: str, labels: Collection[str]) -> list[int]:
        """Numbers of the markers on a segment that are among `labels`."""
        both = enumerate(zip(self.labels, self.segments, strict=True))
        return [i for i, (label, of) in both if of == segment and label in labels]


@dataclass(frozen=True, kw_only=True, repr=False)
class SubjectModel(Displayed):
    """A person's linkage model: nominal (from the static trial) or calibrated."""

    subject: Subject
    """The person."""
    parameters: Parameters
    """The values in use."""
    nominal: Parameters
    """The values before calibration, for comparison and as the centre of priors and bounds."""
    markers: MarkerPlacement
    """Where the tracking markers sit in their segments."""
    frozen: tuple[str, ...] = ()
    """Coordinates that no marker of the static trial moves with (no arms, no head): arms hang along
    the trunk, and the trunk stays upright (`tracking/coordinate_prior.py`)."""
    posture: Mapping[str, float] = field(default_factory=dict)
    """Coordinate -> rad in the static posture, the pelvis as if it faced along x; what is not there
    is zero.
    """
    landmarks: dict[str, tuple[str, Array]] = field(default_factory=dict)
    """Named points: segment and position (3,) m in its frame (`asis_r`, `hjc_r`, `knee_lat_r`,
    ...).
    """
    noise: "PointNoise | None" = None
    """How its markers err where they are none on skin, but segment poses or key points."""
    notes: tuple[str, ...] = ()
    """What was assumed in making it; shown in every output."""

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        subject, count = self.subject, len(set(self.markers.segments))
        rows = [
            (
                "subject",
                f"{subject.sex or 'sex not given'}, {subject.mass:.1f} kg, {subject.height:.2f} m",
            ),
            ("joint parameters", _changes(self.nominal.joint, self.parameters.joint)),
            ("inertial parameters", _changes(self.nominal.inertial, self.parameters.inertial)),
            ("markers", f"{len(self.markers.labels)} on {count} segments"),
        ]
        if self.frozen:
            rows.append(("not visible", shorten(self.frozen)))
        return f"Model of {subject.name}", rows

    @property
    def locked(self) -> tuple[str, ...]:
        """Those of `frozen` that are zero in every trial: a trunk that no marker shows turns
        against the pelvis.
        """
        return tuple(name for name in self.frozen if not name.startswith("lumbar"))

    def with_parameters(self, parameters: Parameters) -> "SubjectModel":
        """The same person and markers with other parameters."""
        return replace(self, parameters=parameters)


def _changes(nominal: Array, present: Array) -> str:
    changed = int((nominal != present).sum())
    return (
        f"{len(nominal)}, {changed} of them changed by calibration"
        if changed
        else f"{len(nominal)}, nominal"
    )


class PointNoise(Table):
    """The table `[noise]` of a marker set and of a model."""

    size_mm: float = Field(
        gt=0, description="how far a coordinate of a point errs, constants left out, in mm"
    )
    memory_s: float = Field(gt=0, description="how long such an error lasts, in s")
    joints: float = Field(
        ge=1, description="times as far as by palpated markers joints and segments' axes may be off"
    )
    hinges: float = Field(
        ge=1, description="times as far as by palpated markers the axes of hinges may be off"
    )
    reason: str = Field(min_length=1, description="what these figures rest on")

    @property
    def words(self) -> str:
        """For notes."""
        return (
            f"each coordinate is taken to err by {self.size_mm:g} mm for {self.memory_s:g} s at a "
            "time, joints "
            f"and axes of segments by {self.joints:g} times, hinges by {self.hinges:g} times what "
            "palpated markers "
            f"have; {self.reason}"
        )

    def least(self, rate: float) -> float:
        """m, noise of a frame below which none is believed, at a rate (Hz), that counts every frame
        as independent.
        """
        return 1e-3 * self.size_mm * max(self.memory_s * rate, 1.0) ** 0.5
