"""Presets Trust and Fit: causes of error bars, pelvis residuals, and marker errors.

Verdict and reasons are data of the page itself. Variances of independent sources add, at the frame
of a peak and over all valid frames. The largest comes first, as better input data of its kind would
reduce the error most.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.analysis import result, trial_result
from gaitcal.dynamics import (
    expected_residual,
    ground_reactions,
    inverse_dynamics,
    measurement_errors,
)
from gaitcal.gait.moments import (
    capitalise,
    describe_coordinate_side,
    describe_joint,
    describe_role,
    describe_segment,
    format_list,
    get_moment,
)
from gaitcal.model import coordinates, linkage
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.page.key_figures import KNEE_ADDUCTION, GaitNumbers
from gaitcal.report.page.plain_data import (
    MISSING,
    Block,
    Cell,
    fold_blocks,
    format_name,
    format_number,
    make_cell,
    make_curves,
    make_heading,
    make_table,
    make_text,
    make_text_column,
    pair_blocks,
)
from gaitcal.results import parameter_labels
from gaitcal.tracking.motion import MarkerErrors

FLOORS = (
    "A marker error is the distance between where a marker was measured and where the model puts "
    "it. The rigid-segment "
    "floor is the error that is left when every segment follows its markers independently, without "
    "joints: soft tissue "
    "and loose markers cause it, and no linkage of rigid segments can come below it. The joint "
    "floor is the error that is "
    "left when every joint follows the markers of its two segments only, with its best position "
    "for this trial: no joint "
    "position removes the difference between the two floors; another joint position, or other "
    "markers, may remove an error "
    "above the joint floor. A marker of several joints counts with their mean."
)
FIT_HEAD: tuple[Cell, ...] = (
    "Nominal",
    "Calibrated",
    "Rigid floor",
    "Ratio",
    "Joint floor",
    "Ratio",
)

ELSEWHERE = (
    "Fit of each segment and marker: below, of the chosen trial. Every marker at each instant: "
    "marker_errors/ "
    "in the folder of the result."
)
ISOLATED = (
    "Fitted with the segments of that joint only, without influence of other joints. “Calibrated” "
    "is the state "
    "after these trials; the final model may differ if walking has moved the joint again."
)
LITTLE_WEIGHT = 0.5  # Part of the largest weight
SHOWN_CHANGE_M = 5e-5  # Half of what the page shows
MARKERS_SHOWN = 6  # With the largest errors; the rest is folded away


def build_fit_blocks(calibration: result.Calibration) -> list[Block]:
    """Build the blocks of the whole result: floors, and all trials in one table."""
    rows = []
    for trial in calibration.trials:
        largest = trial.calibrated.errors.find_largest()
        rows.append(
            [
                make_cell(format_name(trial.name), unit=describe_role(trial.role, trial.joint)),
                *_build_fit_cells(trial_result.summarise_trial_fit(trial)),
                format_number(1e3 * largest[0] if largest else None),
                make_cell(format_name(largest[1] if largest else ""), align="text"),
            ]
        )
    if not rows:
        return [make_text("This study has no moving trial: nothing was fitted.")]
    head: list[Cell] = ["Trial", *FIT_HEAD, "Largest", make_text_column("at marker")]
    caption = (
        "RMS marker error in mm, over all markers; ratios of calibrated to either floor, and the "
        "largest single error."
    )
    return [
        make_heading("How well the model follows the markers"),
        make_text(FLOORS),
        make_table(head, rows, caption=caption),
        *(
            make_text(f"Trial {format_name(name)} is not used: {error}.")
            for name, error in calibration.left_out.items()
        ),
        make_text(ELSEWHERE, "soft"),
    ]


def _build_fit_cells(fit: trial_result.RmsErrors) -> list[Cell]:
    """Build nominal, calibrated, both floors, and the ratios to them."""
    return [
        format_number(fit.nominal),
        format_number(fit.calibrated),
        format_number(fit.floor),
        format_number(fit.ratio, 2),
        format_number(fit.joint_floor),
        format_number(fit.joint_ratio, 2),
    ]


def build_trial_fit_blocks(trial: result.TrialResult) -> list[Block]:
    """Build the blocks of one trial: segments, markers, and the error over time."""
    segments, whole_fit = (
        trial_result.summarise_segment_fits(trial),
        trial_result.summarise_trial_fit(trial),
    )
    rows = [[make_cell(segment.label), *_build_fit_cells(segment)] for segment in segments]
    sums = [[make_cell("all markers"), *_build_fit_cells(whole_fit)]]
    if trial.joint is None:
        sums.insert(
            0,
            [
                make_cell("pelvis and legs"),
                *_build_fit_cells(trial_result.summarise_leg_fit(trial)),
            ],
        )
    calibrated, final = trial.calibrated.errors.rms(), trial.final.errors.rms()
    if calibrated is not None and final is not None and abs(final - calibrated) >= SHOWN_CHANGE_M:
        sums.append(
            [
                make_cell("with the final model"),
                *_build_fit_cells(replace(whole_fit, calibrated=1e3 * final)),
            ]
        )
    total = range(len(rows), len(rows) + len(sums))
    left: list[Block] = [make_table(["Segment, RMS in mm", *FIT_HEAD], [*rows, *sums], total=total)]
    if few := format_list([fit.label for fit in segments if not fit.rigid]):
        explanation = (
            f"No ratio for {few}: a segment can follow fewer than three markers nearly exactly, so "
            "that its floor is not meaningful."
        )
        left.append(make_text(explanation, "soft"))
    markers = collect_marker_fits(trial)
    right = [_build_marker_table(markers[:MARKERS_SHOWN])]
    if len(markers) > MARKERS_SHOWN:
        note = f"The {MARKERS_SHOWN} markers with the largest error, of {len(markers)}"
        right.append(make_text(f"{note}; those with little weight come last.", "soft"))
    out: list[Block] = [
        make_heading(
            f"Trial {format_name(trial.name)}, {describe_role(trial.role, trial.joint)}: marker "
            "errors"
        )
    ]
    if trial.joint is not None:
        out.append(make_text(ISOLATED, "soft"))
    out.append(make_curves(["marker_error"]))
    out += pair_blocks([left, right])
    if len(markers) > MARKERS_SHOWN:
        out.append(_build_marker_table(markers, f"All {len(markers)} markers of this trial"))
    return out


@dataclass(frozen=True, kw_only=True)
class MarkerFit:
    """Errors of one marker, mm; None if it was not visible."""

    label: str
    segment: str
    weight: float
    nominal: float | None  # RMS
    calibrated: float | None  # RMS
    floor: float | None
    largest: float | None  # Largest distance with the calibrated model


def collect_marker_fits(trial: result.TrialResult) -> list[MarkerFit]:
    """Collect marker errors, the largest first, markers with little weight last."""
    errors = trial.calibrated.errors
    nominal, calibrated, floor = map(
        _compute_rms_by_label, (trial.nominal.errors, errors, trial.floor)
    )
    # Markers that hardly count may be far off without harm.
    heaviest = float(errors.weight.max(initial=0.0))
    rows = [
        MarkerFit(
            label=label,
            segment=describe_segment(errors.segments[k]),
            weight=float(errors.weight[k]),
            nominal=nominal.get(label),
            calibrated=calibrated.get(label),
            floor=floor.get(label),
            largest=1e3 * float(np.nanmax(errors.distance[:, k])) if label in calibrated else None,
        )
        for k, label in enumerate(errors.labels)
    ]
    return sorted(
        rows, key=lambda m: (m.weight <= LITTLE_WEIGHT * heaviest, -(m.calibrated or 0.0))
    )


def _compute_rms_by_label(errors: MarkerErrors) -> dict[str, float]:
    """Compute marker -> mm, of the visible markers."""
    rms = 1e3 * errors.compute_rms_by_marker()
    labelled = zip(errors.labels, rms.tolist(), strict=True)
    return {label: mm for label, mm in labelled if np.isfinite(mm)}


def _build_marker_table(markers: Sequence[MarkerFit], folded: str = "") -> Block:
    def describe_marker(marker: MarkerFit) -> str:
        if marker.weight <= 0.0:
            return f"{marker.segment}, no weight"
        return (
            marker.segment
            if marker.weight >= 0.995
            else f"{marker.segment}, weight {format_number(marker.weight, 2)}"
        )

    rows = [
        [
            make_cell(format_name(m.label), unit=describe_marker(m)),
            *map(format_number, (m.nominal, m.calibrated, m.floor, m.largest)),
        ]
        for m in markers
    ]
    return make_table(
        ["Marker, RMS in mm", "Nominal", "Calibrated", "Floor", "Largest"], rows, fold=folded
    )


NOT_CONVERGED = (
    "Not converged: at least one phase of the calibration stopped before it reached its tolerance; "
    "see the table of "
    "phases in the preset Provenance. Do not use these numbers before that is settled."
)
JUDGEMENTS = (
    "Trustworthy: no check found an error larger than the error bars. Doubtful: the numbers may be "
    "wrong by more than "
    "their error bars, for the reasons given. Refused: do not use; refused torques are not valid "
    "and have no error bars. "
    "A finding on one leg concerns that leg only; a finding on the static trial or on a functional "
    "(single-joint) trial "
    "concerns every walk."
)
RESIDUALS = (
    "The measured ground forces should explain the whole motion. The pelvis residuals are the "
    "force and moment that the "
    "model needs in addition at its pelvis to follow the measured motion. They contain the errors "
    "of motion, masses and "
    "force plates. The limit of their RMS follows from these errors, from the plate signals above "
    "the bandwidth of the "
    "motion, and from the residuals of faultless walks: 1 of 1000 such walks exceeds it. A walk "
    "above the limit is "
    "doubtful. Hicks et al. (2015) require of simulations, whose motion is adapted, peaks below 5 "
    "% of the peak net "
    "external force, and below 1 % of the height of the mass centre times that force. Few measured "
    "walks meet that, and "
    "no verdict depends on it. RMS are over valid frames and the three components, peaks are those "
    "of the magnitude."
)
CHANGES = (
    "RMS difference over the valid frames between the moments of the nominal and of the calibrated "
    "model. "
    "If it is small compared with the effect you study, calibration did not matter for that effect."
)
SMALL_SHARE = 0.005  # Of the variance: sources below it share one row
EXTERNAL_PEAKS = {KNEE_ADDUCTION: "external adduction"}
"""Moments reported as external peaks (the opposite of internal ones) -> their name."""


def build_trust_blocks(calibration: result.Calibration) -> list[Block]:
    """Build the blocks of the whole result: convergence, and determination of each joint."""
    out = []
    if calibration.phases:
        out.append(
            make_text("Every phase converged.")
            if calibration.converged
            else make_text(NOT_CONVERGED, "bad")
        )
    out += [
        fold_blocks("What the judgements mean", [make_text(JUDGEMENTS)]),
        make_heading("What these trials determine"),
    ]
    groups = parameter_labels.group_joint_parameters(calibration)
    if not groups:
        return [
            *out,
            make_text("Joint parameters were not calibrated. What was assumed: preset Provenance."),
        ]
    rows = [
        _build_joint_row(calibration, rows)
        for group in groups
        for rows in (group.right, group.left)
        if rows
    ]
    head: list[Cell] = [
        "Joint",
        "Moved",
        "Fitted",
        "Not determined",
        "At a bound",
        "Largest SE, mm",
        "deg",
    ]
    caption = (
        "Parameters of each joint, how far it moved in the trial that moves it most, and the "
        "largest standard error of "
        f"those that were fitted. About {format_number(parameter_labels.ENOUGH_MOTION_DEG, 0)} deg "
        "of motion are needed."
    )
    where = (
        "Which they are, and every value with its error: preset Joints. What was assumed: preset "
        "Provenance."
    )
    return [*out, make_table(head, rows, caption=caption), make_text(where, "soft")]


def _build_joint_row(
    calibration: result.Calibration, rows: Sequence[parameter_labels.LabelledParameter]
) -> list[Cell]:
    joint = rows[0].name.split(".")[0]
    undetermined = sum(row.status == "unidentifiable" for row in rows)
    at_bound = sum(row.status == "at bound" for row in rows)
    moved = parameter_labels.compute_range_of_motion(calibration, joint)
    # A joint that hardly moved explains why its parameters are not determined.
    little = moved is not None and moved < parameter_labels.ENOUGH_MOTION_DEG
    errors = {"mm": list[float](), "deg": list[float]()}
    for row in rows:
        if row.error is not None:
            errors[row.unit].append(row.error)
    return [
        make_cell(capitalise(describe_joint(joint)), side=rows[0].side),
        MISSING
        if moved is None
        else make_cell(f"{format_number(moved, 0)}°", tone="look" if little else ""),
        str(len(rows) - undetermined),
        make_cell(undetermined, tone="look") if undetermined else "0",
        make_cell(at_bound, tone="look") if at_bound else "0",
        *(format_number(max(of_unit, default=None)) for of_unit in errors.values()),
    ]


def build_trial_trust_blocks(model: SubjectModel, walk: GaitNumbers) -> list[Block]:
    """Build the blocks of one walk: error sources, pelvis residuals, effect of calibration."""
    return [
        *_build_error_bars(walk, model.subject.mass),
        *_build_residuals(walk),
        *_build_changes(walk),
    ]


@dataclass(frozen=True, kw_only=True)
class PeakError:
    """The error of one moment at its peak."""

    name: str  # `knee_adduction_r`
    value: float  # N·m/kg, internal
    time: float  # s from the begin of the trial
    error: float  # N·m/kg, standard error
    shares: Mapping[
        measurement_errors.ErrorSource, float
    ]  # Source -> its part (0 to 1) of the variance, largest first

    @property
    def base(self) -> str:
        """`knee_adduction`."""
        return coordinates.split_side(self.name)[0]

    def compute_part(self, share: float) -> float:
        """Compute the N·m/kg error due to one source."""
        return float(self.error * np.sqrt(share))

    @property
    def description(self) -> str:
        """`Peak 0.412 ± 0.031 N·m/kg (external adduction)`."""
        sense, value = (
            f"internal, {coordinates.describe_coordinate(self.base).moment} positive",
            self.value,
        )
        if self.base in EXTERNAL_PEAKS:
            sense, value = EXTERNAL_PEAKS[self.base], -value
        return f"Peak {format_number(value, 3)} ± {format_number(self.error, 3)} N·m/kg ({sense})"


def find_peak_error(walk: GaitNumbers, name: str, mass: float) -> PeakError | None:
    """Find the error of one moment at its largest valid magnitude; None if unknown.

    The knee adduction moment is taken at its external peak. `mass`: of the body, kg.
    """
    loads = walk.trial.loads
    if loads is None or loads.errors is None:
        return None
    error = get_moment(loads.errors, name)
    frames = np.flatnonzero(
        walk.layout.get_valid_frames(ground_reactions.get_leg(name)) & np.isfinite(error)
    )
    if not len(frames):
        return None
    moment = get_moment(loads.final, name)
    # External peaks, such as knee adduction, are negative internal moments.
    frame = frames[
        (-moment if coordinates.split_side(name)[0] in EXTERNAL_PEAKS else np.abs(moment))[
            frames
        ].argmax()
    ]
    at_peak = np.arange(len(moment)) == frame
    return PeakError(
        name=name,
        value=float(moment[frame]) / mass,
        time=float(walk.layout.time[frame] - walk.layout.time[0]),
        error=float(error[frame]) / mass,
        shares=loads.errors.compute_shares(inverse_dynamics.FORCES.index(name), at_peak),
    )


def _build_error_bars(walk: GaitNumbers, mass: float) -> list[Block]:
    """Build the error sources of all peaks; empty if they are unknown."""
    names = [f"{base}_{side}" for base in coordinates.LEG_COORDINATES for side in linkage.SIDES]
    peaks: dict[str, list[PeakError]] = {}
    for name in names:
        if (peak := find_peak_error(walk, name, mass)) and peak.shares:
            peaks.setdefault(peak.base, []).append(peak)
    out = []
    if first := peaks.get(KNEE_ADDUCTION):
        title = (
            "Expected error of the peak knee adduction moment, trial "
            f"{format_name(walk.trial.name)}"
        )
        out += [make_heading(title), *pair_blocks([[_build_peak_table(peak)] for peak in first])]
    others: list[Block] = []
    for base, found in peaks.items():
        if base != KNEE_ADDUCTION:
            others += [
                make_heading(describe_coordinate_side(base), 4),
                *pair_blocks([[_build_peak_table(peak)] for peak in found]),
            ]
    return (
        [*out, fold_blocks("Expected error of every other peak, source by source", others)]
        if peaks
        else []
    )


def _build_peak_table(peak: PeakError) -> Block:
    def make_row(source: str, share: float, percent: str) -> list[Cell]:
        return [make_cell(source), f"± {format_number(peak.compute_part(share), 3)}", percent]

    rows = [
        make_row(s.label, share, format_number(100.0 * share, 0))
        for s, share in peak.shares.items()
        if share >= SMALL_SHARE
    ]
    # Small sources are joined, so that shares add up to 100 %.
    if (remaining := sum(share for share in peak.shares.values() if share < SMALL_SHARE)) > 0.0:
        rows.append(make_row("all others", remaining, format_number(100.0 * remaining, 0)))
    rows.append(["all together", f"± {format_number(peak.error, 3)}", "100"])
    side = coordinates.split_side(peak.name)[1]
    head: list[Cell] = [
        make_cell(describe_coordinate_side(peak.name), side=side),
        "error alone, N·m/kg",
        "% of the variance",
    ]
    return make_table(
        head,
        rows,
        caption=f"{peak.description}, at {format_number(peak.time, 2)} s",
        total=[len(rows) - 1],
    )


def _build_residuals(walk: GaitNumbers) -> list[Block]:
    held = walk.expected
    if (limits := walk.limits) is None:
        return []
    rows: list[list[Cell]] = [
        [
            make_cell(stage.name),
            _format_residual(
                stage.rms_force, held.force if held and stage is walk.stages[-1] else None
            ),
            format_number(stage.peak_force, 0),
            _format_residual(
                stage.rms_moment, held.moment if held and stage is walk.stages[-1] else None
            ),
            format_number(stage.peak_moment),
        ]
        for stage in walk.stages
    ]
    # References below the line: what errors explain, and what simulations require (Hicks et al.
    # 2015).
    below: list[list[Cell]] = []
    if held is not None:
        below.append(
            [
                "expected from its errors",
                format_number(held.force.expected),
                "",
                format_number(held.moment.expected),
                "",
            ]
        )
        below.append(
            ["limit", format_number(held.force.limit), "", format_number(held.moment.limit), ""]
        )
    below.append(
        [
            "required of simulations",
            "",
            format_number(limits.force, 0),
            "",
            format_number(limits.moment),
        ]
    )
    head: list[Cell] = ["Model", "Force, N: RMS", "peak", "Moment, N·m: RMS", "peak"]
    return [
        make_heading(f"Do motion and ground forces agree? Trial {format_name(walk.trial.name)}"),
        make_text(RESIDUALS),
        make_curves(["residual_force", "residual_moment"]),
        make_table(head, [*rows, *below], total=range(len(rows), len(rows) + len(below))),
    ]


def _format_residual(value: float, held: expected_residual.ComparedResidual | None) -> Cell:
    """Format a residual, and whether it is within its limit."""
    if held is None:
        return format_number(value)
    return make_cell(
        f"{'within' if held.within else 'above'}: {format_number(value)}",
        tone="good" if held.within else "look",
    )


def _build_changes(walk: GaitNumbers) -> list[Block]:
    if not walk.numbers:
        return []
    rows = [
        [
            make_cell(describe_coordinate_side(n.name)),
            format_number(n.change_bwh, 2),
            format_number(n.change, 3),
            format_number(n.change_of_peak, 0),
        ]
        for n in walk.numbers
    ]
    return [
        make_heading(f"What calibration changed, trial {format_name(walk.trial.name)}"),
        make_text(CHANGES, "soft"),
        make_table(["RMS change", "%BW·H", "N·m/kg", "% of peak"], rows),
    ]
