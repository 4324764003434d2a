"""Define the table `[calibration]` of a study file: every choice of a calibration, with its
default.
"""

from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from gaitcal.errors import Code, InputError
from gaitcal.io.toml import Table, format_value

AUTOMATIC: Final = "auto"


def allow_frequency(*choices: str) -> BeforeValidator:
    """Allow a cut-off frequency in Hz, or one of some words.

    `choices`: allowed words. Returns: validator of a field.
    """

    def check(value: object) -> float | str:
        if isinstance(value, str) and value in choices:
            return value
        if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 1e6:
            return float(value)
        raise ValueError(
            f"found {format_value(value)}; allowed: a frequency in Hz, or "
            + " or ".join(f"'{w}'" for w in choices)
        )

    return BeforeValidator(check)


class Protocol(Enum):
    """How the joint parameters that may change are selected."""

    EVIDENCE = "evidence"
    PUBLISHED = "published"


class PlateErrorTable(Table):
    """Table `plate_error` in `[calibration]`: standard deviations of force plate measurements.

    Sources are in `dynamics/measurement_errors.py`.
    """

    place_mm: float = Field(
        default=8.0,
        ge=0,
        le=1000,
        description="place of a plate, and of its centres of pressure, along each axis; spot "
        "checks find 8 of plates "
        "that were not calibrated as they stand",
    )
    turn_deg: float = Field(
        default=1.0, ge=0, le=180, description="turn of a plate about the vertical"
    )
    gain_percent: float = Field(default=1.0, ge=0, le=100, description="gain of a plate")
    clock_ms: float = Field(
        default=2.0, ge=0, le=1000, description="clock of the plates against that of the cameras"
    )


class ParameterPriorTable(Table):
    """Entry of `joint_prior` in `[calibration]`: prior of a joint parameter before any trial."""

    mean: float | None = Field(
        default=None,
        ge=-1000,
        le=1000,
        description="expected deviation from the nominal value, mm or deg; without a side it is "
        "that of the right, and "
        "the left has its mirror image; unless given, that of anatomy "
        "(`calibration/joint_prior.py`)",
    )
    deviation: float | None = Field(
        default=None,
        ge=0.01,
        le=1000,
        description="standard deviation about it, mm or deg; correlations stay. A joint's centre "
        "is defined in both its "
        "segments: name both, or they are as far apart as the two deviations then make them",
    )


class CalibrationSettings(Table):
    """Table `[calibration]`: how to calibrate. Every field has a default."""

    protocol: Literal["evidence", "published"] | None = Field(
        default=None,
        description="evidence (unless mode, prior or gait_parameters imply the other): every joint "
        "parameter that a "
        "trial can move is free, and priors, noise and skin movement decide how far; published: "
        "the lists and phases "
        "of Reinbolt et al. 2007, with mode, prior and gait_parameters",
    )
    mode: Literal["sequential", "simultaneous"] = Field(
        default="sequential",
        description="published protocol: each joint from its isolated trials and then gait, or all "
        "joints over all "
        "trials at once",
    )
    jp: bool = Field(
        default=True, description="calibrate joint parameters; false keeps the nominal ones"
    )
    prior: Literal["none", "weak"] = Field(
        default="weak",
        description="published protocol: weak: before the first phase, 20 mm and 10 deg about "
        "nominal values are a "
        "standard deviation, against the noise that the trials show (skin movement repeats itself: "
        "few of their "
        "samples are independent); the posterior of a phase is the prior of the next; none: "
        "nothing is expected, every "
        "phase is by itself, as published, and what its trials do not show stays",
    )
    gait_parameters: Literal["published", "leg"] = Field(
        default="published",
        description="published protocol: what gait trials may move in each leg: the published 17 "
        "joint parameters, or "
        "all 27",
    )
    priors: Path | None = Field(
        default=None,
        strict=False,
        description="priors.json of a cohort (`gaitcal cohort --learn-priors`): joint parameters "
        "lean on its people "
        "instead of on the literature; only where evidence decides",
    )
    joint_prior: dict[str, ParameterPriorTable] = Field(
        default={},
        description="joint parameter, with or without its side (`hip_r.pelvis.ant`, "
        "`hip.pelvis.ant`, in quotes) -> "
        "`{ mean = -7, deviation = 12 }`, mm or deg: what is expected instead of what the "
        "literature says; what a "
        "cohort has learnt comes before it; only where evidence decides",
    )
    position_bound_mm: float = Field(
        default=50.0,
        gt=0,
        description="how far a joint position may move from its nominal value, mm",
    )
    orientation_bound_deg: float = Field(
        default=30.0,
        gt=0,
        le=90,
        description="how far a joint axis may turn from its nominal direction, deg",
    )
    legs: Literal["both", "left", "right"] = Field(
        default="both", description="the legs whose joints are calibrated"
    )
    hip_centre: Literal["auto", "bell", "orthotrak", "harrington", "given"] = Field(
        default=AUTOMATIC,
        description="the nominal hip centre: regressions of Bell 1990, OrthoTrak or Harrington "
        "2007, or points of the "
        "static trial (landmarks hjc_r, hjc_l, or RHJC, R_HJC and the like, measured or computed); "
        "auto: Harrington, "
        "which has the smallest error against images; Bell in the published protocol",
    )
    ankle_zero: Literal["auto", "sole", "markers", "file"] = Field(
        default=AUTOMATIC,
        description="line at right angles to the shank at zero ankle angle: the sole, which is on "
        "the "
        "floor in the static trial; the line from heel to toe marker; or the sole by the file's "
        "static plantarflexion angles; auto: the sole, by the file or the markers where a foot "
        "does not stand flat; "
        "markers in the published protocol",
    )
    angles: Literal["anatomical", "relative"] = Field(
        default="anatomical",
        description="joint angles of motion/TRIAL.csv and cycles.csv from the anatomical zero, or "
        "from the posture of "
        "the static trial; the fit, torques, pages, the .mot for model.osim and exported C3D files "
        "always have the "
        "anatomical one",
    )
    ip: Literal["consistent", "published", "none"] = Field(
        default="consistent",
        description="inertial parameters: possible bodies of unchanged total mass, moved only "
        "where the pelvis "
        "residual contradicts those of the table; the published cost; or those of the table",
    )
    ip_set: Literal["symmetric", "all"] = Field(
        default="symmetric",
        description="the 36 inertial parameters shared by left and right, or all 84",
    )
    torque_scale: Literal["bwh", "pelvis_width", "1mm"] = Field(
        default="bwh",
        description="pelvis torque residuals are divided by body weight times height, pelvic width "
        "or 1 mm",
    )
    joint_step: bool = Field(
        default=False,
        description="a third step: joint and inertial parameters together, after each alone",
    )
    joint_step_load_share: float = Field(
        default=0.005,
        gt=0,
        le=1,
        description="third step: pelvis residual that measurement alone explains, as a share of "
        "body weight (force) "
        "and of body weight times height (torque); smaller trusts the force plates more",
    )
    bandwidth_hz: Annotated[float | Literal["auto"], allow_frequency(AUTOMATIC)] = Field(
        default=AUTOMATIC,
        description="how fast a motion may change: half of an oscillation at so many Hz is kept; "
        "'auto': the markers "
        "of each trial determine it; in a walk over force plates, the best agreement of motion and "
        "forces",
    )
    nodes_per_second: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        description="spline nodes per second and coordinate, which alone then limit how fast the "
        "motion may change",
    )
    nodes: int | None = Field(
        default=None,
        ge=6,
        le=100_000,
        description="a fixed number of spline nodes per coordinate and trial instead (20 in the "
        "published protocol)",
    )
    robust: Literal["none", "huber", "cauchy"] = Field(
        default="none",
        description="loss of marker residuals: least squares, or one that outliers move less",
    )
    force_filter_hz: Annotated[
        float | Literal["matched", "none"], allow_frequency("matched", "none")
    ] = Field(
        default=50.0,
        description="low-pass cut-off of ground reactions in Hz (plates sampled at 100 Hz or "
        "less are not filtered at "
        "50); 'matched': that of the motion, which on truths makes leg torques 2.1 instead of "
        "1.5 N·m wrong without "
        "impacts, 4 to 10 instead of 2 to 4 with them; 'none': not filtered",
    )

    plate_error: PlateErrorTable = Field(
        default=PlateErrorTable(),
        description="standard deviations of place (mm, along each axis), turn (deg), gain (%) and "
        "clock (ms) of "
        "plates: part of the error bars of torques, and of what inertial parameters are weighed "
        "against; 0 switches a "
        "part off",
    )

    segment_axes: Literal["palpated", "exact"] = Field(
        default="palpated",
        description="where the segments' axes point: as landmarks on the skin show, whose scatter "
        "(1 to 6 deg) is part "
        "of the error bars of angles and torques; or exactly as the static trial has them, by "
        "definition",
    )

    @field_validator("nodes_per_second", "nodes")
    @classmethod
    def _require_one_bandwidth(cls, count: float | None, info: ValidationInfo) -> float | None:
        given = info.data.get("bandwidth_hz", AUTOMATIC)
        if count is not None and given != AUTOMATIC:
            raise ValueError(
                f"found {format_value(count)}; allowed only without bandwidth_hz, which is "
                f"{format_value(given)}"
            )
        return count

    @field_validator("mode", "prior", "gait_parameters")
    @classmethod
    def _require_published_protocol(cls, value: str, info: ValidationInfo) -> str:
        if (
            info.data.get("protocol") == "evidence"
            and value != cls.model_fields[info.field_name or ""].default
        ):
            raise ValueError(
                f"found '{value}'; it belongs to protocol = 'published', where evidence decides "
                "nothing"
            )
        return value

    @property
    def decided_by(self) -> Protocol:
        """Protocol that selects the free joint parameters: as given, or implied by its settings."""
        if self.protocol is not None:
            return Protocol(self.protocol)
        plain = (self.mode, self.prior, self.gait_parameters) == ("sequential", "weak", "published")
        return Protocol.EVIDENCE if plain else Protocol.PUBLISHED

    @property
    def takes_priors(self) -> bool:
        """Whether joint parameters are fitted in a way that can use the priors of a cohort."""
        return self.jp and self.decided_by is Protocol.EVIDENCE

    def resolve_paths(self, at: Callable[[Path], Path], source: Path) -> "CalibrationSettings":
        """Resolve the path of `priors`, if any.

        Parameters
        ----------
        at
            Function that resolves a path.
        source
            The study file, for the message.

        Returns
        -------
        CalibrationSettings
            The settings with that path.

        Raises
        ------
        InputError
            `priors` is given, and the protocol uses none.
        """
        if self.priors is None:
            return self
        if not self.takes_priors:
            message = (
                f"found {format_value(str(self.priors))}; allowed only with protocol = 'evidence' "
                "and jp = true"
            )
            raise InputError(message, source=source, field="calibration.priors", code=Code.PRIORS)
        return self.model_copy(update={"priors": at(self.priors)})

    @property
    def hip_rule(self) -> str:
        """Value of `HipCentre` after `auto` is resolved."""
        if self.hip_centre != AUTOMATIC:
            return self.hip_centre
        return "bell" if self.decided_by is Protocol.PUBLISHED else "harrington"

    @property
    def ankle_rule(self) -> str:
        """Value of `AnkleZero` after `auto` is resolved, as far as the settings decide."""
        published = self.ankle_zero == AUTOMATIC and self.decided_by is Protocol.PUBLISHED
        return "markers" if published else self.ankle_zero

    @property
    def keeps_ankle_zero(self) -> bool:
        """Whether a fit keeps the ankle angles of the static posture.

        The published protocol does not; its zero angles are those of the nominal model.
        """
        return self.ankle_zero != AUTOMATIC or self.decided_by is Protocol.EVIDENCE

    @field_validator("joint_step")
    @classmethod
    def _require_both_for_joint_step(cls, joint_step: bool, info: ValidationInfo) -> bool:
        if joint_step and (info.data.get("jp") is False or info.data.get("ip") == "none"):
            raise ValueError("found true; allowed only with jp = true and ip other than 'none'")
        return joint_step
