"""Presets Trust and Fit: what verdict and numbers rest on, and what makes the error bar of each
moment; and how well the model follows the markers.

Verdict and reasons are data of the page itself. At the frame of a peak, and over all valid frames,
the variances of independent sources add; the largest comes first, as better input of its kind would
mend most.
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
    capitalised,
    coordinate_title,
    joint_words,
    listed,
    moment_of,
    role_words,
    segment_words,
)
from gaitcal.model import coordinates, linkage
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.page.key_figures import KNEE_ADDUCTION, GaitNumbers
from gaitcal.report.page.plain_data import (
    MISSING,
    Block,
    Cell,
    beside,
    cell,
    curves,
    fold,
    heading,
    named,
    number,
    table,
    text,
    words_column,
)
from gaitcal.results import parameter_labels
from gaitcal.tracking.motion import MarkerErrors

FLOORS = (
    "A marker error is the distance between where a marker was measured and where the model puts "
    "it. The rigid-segment "
    "floor is the error that is left when every segment follows its own markers alone, without any "
    "joints: skin and "
    "loose markers make it, and no linkage of rigid segments can come below it. The joint floor is "
    "what is left when "
    "every joint follows the markers of its own segments alone, placed as suits this one trial: "
    "what lies between the "
    "two floors no place of a joint can mend, what lies above the joint floor another place, or "
    "other markers, may. A "
    "marker of several joints counts with their mean."
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
    "Fitted with the segments of that joint only, so that no other joint has a say. “Calibrated” "
    "is right "
    "after these trials; the final model may differ where walking has moved the joint again."
)
LITTLE_WEIGHT = 0.5  # Part of the largest weight
SHOWN_CHANGE_M = 5e-5  # Half of what the page shows
MARKERS_SHOWN = 6  # With the largest errors; the rest is folded away


def fit_blocks(calibration: result.Calibration) -> list[Block]:
    """Of the whole result: the floors, and every trial in one table."""
    rows = []
    for trial in calibration.trials:
        largest = trial.calibrated.errors.find_largest()
        rows.append(
            [
                cell(named(trial.name), unit=role_words(trial.role, trial.joint)),
                *_fit_cells(trial_result.trial_fit(trial)),
                number(1e3 * largest[0] if largest else None),
                cell(named(largest[1] if largest else ""), align="text"),
            ]
        )
    if not rows:
        return [text("This study has no moving trial: nothing was fitted.")]
    head: list[Cell] = ["Trial", *FIT_HEAD, "Largest", words_column("at marker")]
    caption = (
        "RMS marker error in mm, over all markers; ratios of calibrated to either floor, and the "
        "largest single error."
    )
    return [
        heading("How well the model follows the markers"),
        text(FLOORS),
        table(head, rows, caption=caption),
        *(
            text(f"Trial {named(name)} is not used: {error}.")
            for name, error in calibration.left_out.items()
        ),
        text(ELSEWHERE, "soft"),
    ]


def _fit_cells(fit: trial_result.RmsErrors) -> list[Cell]:
    """Nominal, calibrated, both floors, and the ratios to them."""
    return [
        number(fit.nominal),
        number(fit.calibrated),
        number(fit.floor),
        number(fit.ratio, 2),
        number(fit.joint_floor),
        number(fit.joint_ratio, 2),
    ]


def trial_fit_blocks(trial: result.TrialResult) -> list[Block]:
    """Of one trial: segments, markers, and the error over time."""
    segments, whole = trial_result.segment_fits(trial), trial_result.trial_fit(trial)
    rows = [[cell(segment.label), *_fit_cells(segment)] for segment in segments]
    sums = [[cell("all markers"), *_fit_cells(whole)]]
    if trial.joint is None:
        sums.insert(0, [cell("pelvis and legs"), *_fit_cells(trial_result.leg_fit(trial))])
    calibrated, final = trial.calibrated.errors.rms(), trial.final.errors.rms()
    if calibrated is not None and final is not None and abs(final - calibrated) >= SHOWN_CHANGE_M:
        sums.append(
            [cell("with the final model"), *_fit_cells(replace(whole, calibrated=1e3 * final))]
        )
    total = range(len(rows), len(rows) + len(sums))
    left: list[Block] = [table(["Segment, RMS in mm", *FIT_HEAD], [*rows, *sums], total=total)]
    if few := listed([fit.label for fit in segments if not fit.rigid]):
        words = (
            f"No ratio for {few}: with fewer than three markers a segment can follow them nearly "
            "exactly, so that "
            "its floor says nothing."
        )
        left.append(text(words, "soft"))
    markers = marker_fits(trial)
    right = [_marker_table(markers[:MARKERS_SHOWN])]
    if len(markers) > MARKERS_SHOWN:
        note = f"The {MARKERS_SHOWN} markers with the largest error, of {len(markers)}"
        right.append(text(f"{note}; those with little weight come last.", "soft"))
    out: list[Block] = [
        heading(f"Trial {named(trial.name)}, {role_words(trial.role, trial.joint)}: marker errors")
    ]
    if trial.joint is not None:
        out.append(text(ISOLATED, "soft"))
    out.append(curves(["marker_error"]))
    out += beside([left, right])
    if len(markers) > MARKERS_SHOWN:
        out.append(_marker_table(markers, f"All {len(markers)} markers of this trial"))
    return out


@dataclass(frozen=True, kw_only=True)
class MarkerFit:
    """How one marker is met, mm; None where it was not seen."""

    label: str
    segment: str
    weight: float
    nominal: float | None  # RMS
    calibrated: float | None  # RMS
    floor: float | None
    largest: float | None  # Largest distance with the calibrated model


def marker_fits(trial: result.TrialResult) -> list[MarkerFit]:
    """Largest error first, those with little weight last."""
    errors = trial.calibrated.errors
    nominal, calibrated, floor = map(_rms_by_label, (trial.nominal.errors, errors, trial.floor))
    heaviest = float(errors.weight.max(initial=0.0))
    rows = [
        MarkerFit(
            label=label,
            segment=segment_words(errors.segments[k]),
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


def _rms_by_label(errors: MarkerErrors) -> dict[str, float]:
    return {
        label: 1e3 * float(np.sqrt(np.nanmean(column**2)))
        for label, column in zip(errors.labels, errors.distance.T, strict=True)
        if np.isfinite(column).any()
    }


def _marker_table(markers: Sequence[MarkerFit], folded: str = "") -> Block:
    def words(marker: MarkerFit) -> str:
        if marker.weight <= 0.0:
            return f"{marker.segment}, no weight"
        return (
            marker.segment
            if marker.weight >= 0.995
            else f"{marker.segment}, weight {number(marker.weight, 2)}"
        )

    rows = [
        [
            cell(named(m.label), unit=words(m)),
            *map(number, (m.nominal, m.calibrated, m.floor, m.largest)),
        ]
        for m in markers
    ]
    return table(
        ["Marker, RMS in mm", "Nominal", "Calibrated", "Floor", "Largest"], rows, fold=folded
    )


NOT_CONVERGED = (
    "Not converged: at least one phase of the calibration stopped before it reached its tolerance; "
    "see the table of "
    "phases in the preset Provenance. Do not use these numbers before that is settled."
)
JUDGEMENTS = (
    "Trustworthy: nothing speaks against the numbers beyond their error bars. Doubtful: they may "
    "be wrong by more than "
    "that, for the reasons given. Refused: not to be used; no torque of what is refused counts as "
    "valid, and no error "
    "bar is given. What is wrong with one leg concerns that leg alone, what is wrong with the "
    "static trial or an "
    "isolated one concerns every walk."
)
RESIDUALS = (
    "The measured ground forces should be all that moves the body. The force and moment that the "
    "model would still "
    "need at its pelvis to follow the measured motion are the pelvis residuals: they collect the "
    "errors of motion, "
    "masses and force plates. The limit of their RMS follows from these errors, from what the "
    "plates hold above the "
    "bandwidth of the motion, and from what walks without a fault leave: 1 of 1000 such walks is "
    "beyond it, and a walk "
    "that is, is doubtful. Hicks et al. (2015) ask of simulations, whose motion is changed until "
    "it agrees, for peaks "
    "below 5 % of the peak net external force, and 1 % of the height of the mass centre times that "
    "force; few walks as "
    "measured have that, and nothing is judged by it. RMS are over valid frames and the three "
    "components, peaks of the "
    "magnitude."
)
CHANGES = (
    "RMS difference over the valid frames between the moments of the nominal and of the calibrated "
    "model. "
    "Where it is small against the effect you study, calibration did not matter for it."
)
SMALL_SHARE = 0.005  # Of the variance: sources below it are told together
EXTERNAL_PEAKS = {KNEE_ADDUCTION: "external adduction"}
"""Moments of which the external peak is told, the opposite of the internal one -> what it is
called.
"""


def trust_blocks(calibration: result.Calibration) -> list[Block]:
    """Of the whole result: whether it converged, and how well the trials show each joint."""
    out = []
    if calibration.phases:
        out.append(
            text("Every phase converged.") if calibration.converged else text(NOT_CONVERGED, "bad")
        )
    out += [
        fold("What the judgements mean", [text(JUDGEMENTS)]),
        heading("What these trials determine"),
    ]
    groups = parameter_labels.joint_groups(calibration)
    if not groups:
        return [
            *out,
            text("Joint parameters were not calibrated. What was assumed: preset Provenance."),
        ]
    rows = [
        _joint(calibration, rows) for group in groups for rows in (group.right, group.left) if rows
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
        f"those that were fitted. About {number(parameter_labels.ENOUGH_MOTION_DEG, 0)} deg of "
        "motion are needed."
    )
    where = (
        "Which they are, and every value with its error: preset Joints. What was assumed: preset "
        "Provenance."
    )
    return [*out, table(head, rows, caption=caption), text(where, "soft")]


def _joint(calibration: result.Calibration, rows: Sequence[parameter_labels.Row]) -> list[Cell]:
    joint = rows[0].name.split(".")[0]
    unseen, at_bound = (
        sum(row.status == status for row in rows) for status in ("unidentifiable", "at bound")
    )
    moved = parameter_labels.range_of_motion(calibration, joint)
    little = moved is not None and moved < parameter_labels.ENOUGH_MOTION_DEG
    errors = [
        max((row.error for row in rows if row.unit == unit and row.error is not None), default=None)
        for unit in ("mm", "deg")
    ]
    return [
        cell(capitalised(joint_words(joint)), side=rows[0].side),
        MISSING if moved is None else cell(f"{number(moved, 0)}°", tone="look" if little else ""),
        str(len(rows) - unseen),
        cell(unseen, tone="look") if unseen else "0",
        cell(at_bound, tone="look") if at_bound else "0",
        *(number(error) for error in errors),
    ]


def trial_trust_blocks(model: SubjectModel, walk: GaitNumbers) -> list[Block]:
    """Of one walk: what makes the error bars, pelvis residuals, and what calibration changed."""
    return [*_error_bars(walk, model.subject.mass), *_residuals(walk), *_changes(walk)]


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

    def alone(self, share: float) -> float:
        """N·m/kg, the error of one source by itself."""
        return float(self.error * np.sqrt(share))

    @property
    def words(self) -> str:
        """`Peak 0.412 ± 0.031 N·m/kg (external adduction)`."""
        sense, value = (
            f"internal, {coordinates.coordinate_words(self.base).moment} positive",
            self.value,
        )
        if self.base in EXTERNAL_PEAKS:
            sense, value = EXTERNAL_PEAKS[self.base], -value
        return f"Peak {number(value, 3)} ± {number(self.error, 3)} N·m/kg ({sense})"


def peak_error(walk: GaitNumbers, name: str, mass: float) -> PeakError | None:
    """Of one moment at the largest magnitude in its valid frames, of the knee's adduction at the
    abductor's peak.

    None without valid frames or standard errors. `mass`: of the body, kg.
    """
    loads = walk.trial.loads
    if loads is None or loads.errors is None:
        return None
    error = moment_of(loads.errors, name)
    frames = np.flatnonzero(
        walk.layout.valid_for(ground_reactions.get_leg(name)) & np.isfinite(error)
    )
    if not len(frames):
        return None
    moment = moment_of(loads.final, name)
    frame = frames[
        (-moment if coordinates.split_side(name)[0] in EXTERNAL_PEAKS else np.abs(moment))[
            frames
        ].argmax()
    ]
    here = np.arange(len(moment)) == frame
    return PeakError(
        name=name,
        value=float(moment[frame]) / mass,
        time=float(walk.layout.time[frame] - walk.layout.time[0]),
        error=float(error[frame]) / mass,
        shares=loads.errors.compute_shares(inverse_dynamics.FORCES.index(name), here),
    )


def _error_bars(walk: GaitNumbers, mass: float) -> list[Block]:
    """Empty where it is not known what makes them."""
    names = [f"{base}_{side}" for base in coordinates.LEG_COORDINATES for side in linkage.SIDES]
    peaks: dict[str, list[PeakError]] = {}
    for name in names:
        if (peak := peak_error(walk, name, mass)) and peak.shares:
            peaks.setdefault(peak.base, []).append(peak)
    out = []
    if first := peaks.get(KNEE_ADDUCTION):
        title = f"Expected error of the peak knee adduction moment, trial {named(walk.trial.name)}"
        out += [heading(title), *beside([[_peak_table(peak)] for peak in first])]
    others: list[Block] = []
    for base, found in peaks.items():
        if base != KNEE_ADDUCTION:
            others += [
                heading(coordinate_title(base), 4),
                *beside([[_peak_table(peak)] for peak in found]),
            ]
    return (
        [*out, fold("Expected error of every other peak, source by source", others)]
        if peaks
        else []
    )


def _peak_table(peak: PeakError) -> Block:
    def row(words: str, share: float, percent: str) -> list[Cell]:
        return [cell(words), f"± {number(peak.alone(share), 3)}", percent]

    rows = [
        row(s.label, share, number(100.0 * share, 0))
        for s, share in peak.shares.items()
        if share >= SMALL_SHARE
    ]
    if (rest := sum(share for share in peak.shares.values() if share < SMALL_SHARE)) > 0.0:
        rows.append(row("all others", rest, number(100.0 * rest, 0)))
    rows.append(["all together", f"± {number(peak.error, 3)}", "100"])
    side = coordinates.split_side(peak.name)[1]
    head: list[Cell] = [
        cell(coordinate_title(peak.name), side=side),
        "error alone, N·m/kg",
        "% of the variance",
    ]
    return table(
        head, rows, caption=f"{peak.words}, at {number(peak.time, 2)} s", total=[len(rows) - 1]
    )


def _residuals(walk: GaitNumbers) -> list[Block]:
    held = walk.expected
    if (limits := walk.limits) is None:
        return []
    rows: list[list[Cell]] = [
        [
            cell(stage.name),
            _held(stage.rms_force, held.force if held and stage is walk.stages[-1] else None),
            number(stage.peak_force, 0),
            _held(stage.rms_moment, held.moment if held and stage is walk.stages[-1] else None),
            number(stage.peak_moment),
        ]
        for stage in walk.stages
    ]
    below: list[list[Cell]] = []
    if held is not None:
        below.append(
            [
                "expected of its errors",
                number(held.force.expected),
                "",
                number(held.moment.expected),
                "",
            ]
        )
        below.append(["limit", number(held.force.limit), "", number(held.moment.limit), ""])
    below.append(["asked of simulations", "", number(limits.force, 0), "", number(limits.moment)])
    head: list[Cell] = ["Model", "Force, N: RMS", "peak", "Moment, N·m: RMS", "peak"]
    return [
        heading(f"Do motion and ground forces agree? Trial {named(walk.trial.name)}"),
        text(RESIDUALS),
        curves(["residual_force", "residual_moment"]),
        table(head, [*rows, *below], total=range(len(rows), len(rows) + len(below))),
    ]


def _held(value: float, held: expected_residual.ComparedResidual | None) -> Cell:
    """A residual, and whether it is within its limit, in words as well."""
    if held is None:
        return number(value)
    return cell(
        f"{'within' if held.within else 'above'}: {number(value)}",
        tone="good" if held.within else "look",
    )


def _changes(walk: GaitNumbers) -> list[Block]:
    if not walk.numbers:
        return []
    rows = [
        [
            cell(coordinate_title(n.name)),
            number(n.change_bwh, 2),
            number(n.change, 3),
            number(n.change_of_peak, 0),
        ]
        for n in walk.numbers
    ]
    return [
        heading(f"What calibration changed, trial {named(walk.trial.name)}"),
        text(CHANGES, "soft"),
        table(["RMS change", "%BW·H", "N·m/kg", "% of peak"], rows),
    ]
