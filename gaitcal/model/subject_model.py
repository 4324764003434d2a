"""Model of one person: subject, parameters, positions of the markers.

`PointNoise` describes points that are no markers on skin: corners of segment poses and key points
of markerless programs. A marker's error is skin that moves with the joints
(`calibration/soft_tissue_artefact.py`), and a camera error of tenths of a millimetre. Residuals
show both. Points from pictures have other errors:

- Most of the error is constant: the joint centre of annotated pictures is not this person's. No
  residual shows it, so the errors of joints and axes are multiplied (`joints`, `hinges`).
- The rest changes slowly, so that neighbouring frames have the same error (`memory_s`).
- If the program has fitted a body model, its residuals are smaller than its errors. `size_mm` is
  the smallest error that is assumed.
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
    """Clinical facts of a person and a session, for reports; empty: not recorded.

    Only the age is computed from them (`study/study.py`). Dates are `2016-03-09`.
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
        """Field -> text of those that are recorded."""
        return {name: text for name, text in vars(self).items() if text}


@dataclass(frozen=True)
class Subject:
    """Facts of the person that the model depends on."""

    name: str
    """Shown in every output; may be a pseudonym."""
    mass: float
    """kg."""
    height: float
    """m."""
    sex: str
    """`male` or `female`: the column of the anthropometric table; empty if not given: the mean of
    both.
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
    """A date or a label of the day of these recordings; empty if not recorded."""
    record: PatientRecord = field(default_factory=PatientRecord)
    """Clinical facts."""

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
    """Positions of the tracking markers in their segments."""

    labels: tuple[str, ...]
    segments: tuple[str, ...]  # name of the segment of each marker
    local: Array  # (nm, 3) m, in the segment frame
    # (nm,) >= 0; a marker with weight 0 is reported but does not pull
    weight: Array

    def find_markers(self, segment: str, labels: Collection[str]) -> list[int]:
        """Find the markers on a segment.

        Parameters
        ----------
        segment : str
            Name of the segment.
        labels : collection of str
            Labels to choose from.

        Returns
        -------
        list of int
            Indices of markers.
        """
        both = enumerate(zip(self.labels, self.segments, strict=True))
        return [i for i, (label, on) in both if on == segment and label in labels]


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
    """Noise of markerless points (of segment poses or key points); None for skin markers."""
    notes: tuple[str, ...] = ()
    """Assumptions of the model; shown in every output."""

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        subject, count = self.subject, len(set(self.markers.segments))
        rows = [
            (
                "subject",
                f"{subject.sex or 'sex not given'}, {subject.mass:.1f} kg, {subject.height:.2f} m",
            ),
            ("joint parameters", _describe_changes(self.nominal.joint, self.parameters.joint)),
            (
                "inertial parameters",
                _describe_changes(self.nominal.inertial, self.parameters.inertial),
            ),
            ("markers", f"{len(self.markers.labels)} on {count} segments"),
        ]
        if self.frozen:
            rows.append(("not visible", shorten(self.frozen)))
        return f"Model of {subject.name}", rows

    @property
    def locked(self) -> tuple[str, ...]:
        """Coordinates of `frozen` that are zero in every trial.

        A trunk without markers rotates against the pelvis, so its coordinates are not among them.
        """
        return tuple(name for name in self.frozen if not name.startswith("lumbar"))

    def with_parameters(self, parameters: Parameters) -> "SubjectModel":
        """Return the same person and markers with other parameters."""
        return replace(self, parameters=parameters)


def _describe_changes(nominal: Array, present: Array) -> str:
    """Describe how many parameters calibration changed."""
    changed = int((nominal != present).sum())
    return (
        f"{changed} of {len(nominal)} changed by calibration"
        if changed
        else f"{len(nominal)}, nominal"
    )


class PointNoise(Table):
    """The table `[noise]` of a marker set and of a model."""

    size_mm: float = Field(
        gt=0,
        description="standard deviation of a coordinate of a point without its constant part, "
        "in mm",
    )
    memory_s: float = Field(gt=0, description="correlation time of such an error, in s")
    joints: float = Field(
        ge=1,
        description="factor on the standard deviations of joint centres and segment axes by "
        "palpated markers",
    )
    hinges: float = Field(
        ge=1, description="factor on the standard deviations of hinge axes by palpated markers"
    )
    reason: str = Field(min_length=1, description="what these figures rest on")

    @property
    def description(self) -> str:
        """Description for notes."""
        return (
            f"each coordinate is taken to err by {self.size_mm:g} mm for {self.memory_s:g} s at a "
            "time, joints "
            f"and axes of segments by {self.joints:g} times, hinges by {self.hinges:g} times what "
            "palpated markers "
            f"have; {self.reason}"
        )

    def compute_least_noise(self, rate: float) -> float:
        """Compute the smallest noise (m) of a frame that is assumed at a frame rate (Hz).

        It counts every frame as an independent sample.
        """
        return 1e-3 * self.size_mm * max(self.memory_s * rate, 1.0) ** 0.5
