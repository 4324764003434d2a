"""Preset Joints: nominal, fitted and (synthetic subjects) true joint and inertial parameters."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gaitcal.analysis import result, truth_comparison
from gaitcal.analysis.truth_errors import CurveTruth, TruthErrors
from gaitcal.model import coordinates, linkage
from gaitcal.report.page.plain_data import (
    MISSING,
    Block,
    Cell,
    fold_blocks,
    format_name,
    format_number,
    make_cell,
    make_heading,
    make_list,
    make_picture,
    make_table,
    make_text,
    pair_blocks,
    round_number,
)
from gaitcal.results import parameter_labels

MOVED = (
    "Fitted minus nominal value, with ±1 standard error where there is one. Positions are in the "
    "axes of the named "
    "segment: forward, up, to the right."
)
TRUE = " A ring around a dot: calibration found the truth; around zero: the nominal value was true."
COHORT = (
    "Parameters that the trials do not determine follow {people} people of a cohort ({file}), "
    "whose mean may differ "
    "from the nominal values. Parts of the body with cohort data: preset Provenance."
)
NOT_CALIBRATED = (
    "Joint parameters were not calibrated: all joint positions come from the static trial and the "
    "regressions."
)
INERTIAL_FILE = (
    "All values, by the names that the other files use: parameters.csv (moments of inertia there "
    "in kg·mm², 100 "
    "times the numbers here)."
)
FEATURES = (
    "Distance (mm) or angle (deg) from the true centre or axis; the place of an axis is where it "
    "crosses the "
    "segment from side to side. Within: number of its parameters with the truth within ±1.96 "
    "standard "
    "errors. “Farther”: calibration led away from the truth."
)
SIDE_TITLES = {"r": "Right", "l": "Left", "": "Parameter"}


def build_joint_blocks(calibration: result.Calibration) -> list[Block]:
    """Build the preset: fitted parameters, changes, standard errors, differences from the truth."""
    errors = (
        ""
        if calibration.standard_errors or not calibration.trials
        else "; none were computed for this result"
    )
    out = [
        make_heading("What was calibrated"),
        make_text(
            f"{parameter_labels.summarise_fitted(calibration)} Positions are in the axes of the "
            "named segment: forward, "
            "up, and to the right, on both sides of the body (so a left hip centre lies at a "
            "negative “to the right”). "
            "A standard error is the scatter of a value if the same trials were "
            f"recorded again{errors}."
        ),
    ]
    # Before any number: parameters that these trials cannot show.
    if blind := parameter_labels.describe_unidentifiable(calibration):
        out += [make_heading("Not determined by these trials", 4), make_list(blind, "warning")]
    known = calibration.truth.parameters if calibration.truth else ()
    truth = {
        p.name: p.truth * parameter_labels.SHORTER_UNITS.get(p.unit, ("", 1.0))[1] for p in known
    }
    near = [] if calibration.truth is None else _build_truth(calibration, calibration.truth)
    return [*out, *_build_joints(calibration, truth), *_build_inertias(calibration, truth), *near]


def _build_joints(calibration: result.Calibration, truth: Mapping[str, float]) -> list[Block]:
    groups = parameter_labels.group_joint_parameters(calibration)
    if not groups:
        return [make_text(NOT_CALIBRATED)]
    # The legs are the purpose of most recordings: trunk and arms are folded away.
    legs = [group for group in groups if (group.right or group.left)[0].part in linkage.LEG_JOINTS]
    others = [group for group in groups if group not in legs]
    out = [
        make_heading("Joint parameters: positions and axes of the joints"),
        make_text(MOVED + (TRUE if truth else ""), "soft"),
    ]
    if (prior := calibration.study.joint_prior) is not None:
        out.append(make_text(COHORT.format(people=prior.people, file=prior.file)))
    out += _build_joint_values(calibration, legs, truth)
    if others:
        other_blocks = _build_joint_values(calibration, others, truth)
        out += [fold_blocks("Joints of trunk and arms", other_blocks)] if legs else other_blocks
    # Joints that the settings keep, or that no trial of this study moves.
    if fixed := parameter_labels.list_fixed_joints(calibration):
        out.append(
            make_text(f"Kept at nominal values, as no trial here determines them: {fixed}.", "soft")
        )
    return out


def _build_joint_values(
    calibration: result.Calibration,
    groups: Sequence[parameter_labels.ParameterGroup],
    truth: Mapping[str, float],
) -> list[Block]:
    """Build pictures of changes of positions and orientations, and tables of all values."""
    settings = calibration.study.settings
    rows = [
        r
        for group in groups
        for r in (*group.right, *group.left)
        if r.status in ("fitted", "at bound")
    ]
    pictures = []
    for unit, title, bound in (
        ("mm", "Positions of joints: change in mm", settings.position_bound_mm),
        ("deg", "Orientations of joints: change in deg", settings.orientation_bound_deg),
    ):
        if found := [_build_interval(row, truth, bound) for row in rows if row.unit == unit]:
            pictures.append([make_heading(title, 4), make_picture("intervals", unit, found)])
    out = pair_blocks(pictures)
    for group in groups:
        out += [make_heading(group.title, 4), *_build_tables(group, truth)]
    return out


def _build_interval(
    row: parameter_labels.LabelledParameter, truth: Mapping[str, float], bound: float
) -> dict[str, Any]:
    return {
        "label": row.title.replace(" in the ", ", "),
        "side": row.side,
        "nominal": round_number(row.nominal),
        "fitted": round_number(row.fitted),
        "se": round_number(row.error),
        "truth": round_number(truth.get(row.name)),
        "bounds": [round_number(row.nominal - bound), round_number(row.nominal + bound)],
    }


def _build_tables(
    group: parameter_labels.ParameterGroup, truth: Mapping[str, float], percent: bool = False
) -> list[Block]:
    """Build tables of both sides side by side; `percent`: changes also in percent."""
    sided = bool(group.left) or not percent
    out = []
    for rows in (group.right, group.left):
        if rows:
            side = rows[0].side if sided else ""
            change = "Change ± SE" if any(row.error is not None for row in rows) else "Change"
            known = any(row.name in truth for row in rows)
            head: list[Cell] = [
                make_cell(SIDE_TITLES[side], side=side),
                "Nominal",
                "Fitted",
                change,
            ]
            head += ["Truth"] if known else []
            out.append([make_table(head, [_build_row(row, truth, percent, known) for row in rows])])
    return pair_blocks(out)


def _build_row(
    row: parameter_labels.LabelledParameter, truth: Mapping[str, float], percent: bool, known: bool
) -> list[Cell]:
    digits = row.digits
    nominal, fitted = format_number(row.nominal, digits), format_number(row.fitted, digits)
    true: list[Cell] = [format_number(truth.get(row.name), digits)] if known else []
    undetermined, at_bound = row.status == "unidentifiable", row.status == "at bound"
    # A value that no trial changed is not shown as if it were fitted.
    if undetermined and fitted == nominal:
        return [
            make_cell(row.title, unit=row.unit),
            nominal,
            make_cell("kept, not determined", tone="look"),
            MISSING,
            *true,
        ]
    change = format_number(row.change, digits, True)
    if row.error is not None:
        change += f" ± {format_number(row.error, digits)}"
    share = (
        f"({format_number(100.0 * row.change / abs(row.nominal), 0, True)} %)"
        if percent and row.nominal
        else ""
    )
    return [
        make_cell(f"{row.title}, not determined" if undetermined else row.title, unit=row.unit),
        nominal,
        make_cell(
            f"{fitted}, at its bound" if at_bound else fitted,
            tone="look" if at_bound or undetermined else "",
        ),
        make_cell(change, unit=share),
        *true,
    ]


def _build_inertias(calibration: result.Calibration, truth: Mapping[str, float]) -> list[Block]:
    groups = parameter_labels.group_inertial_parameters(calibration)
    if not groups:
        # Masses need ground reactions.
        measured = any(
            t.loads is not None and t.loads.reactions.valid.any() for t in calibration.trials
        )
        why = "" if measured else ": that needs a walking trial with force plates"
        explanation = (
            f"Inertial parameters were not calibrated{why}. They come from the anthropometric "
            "table."
        )
        return [make_text(explanation), make_text(INERTIAL_FILE, "soft")]
    out: list[Block] = [
        make_heading("Inertial parameters: masses, mass centres, moments of inertia")
    ]
    for group in groups:
        out += [make_heading(group.title, 4), *_build_tables(group, truth, percent=True)]
    return [*out, make_text(INERTIAL_FILE, "soft")]


Errors = tuple[float, float, str]
"""RMS error, distance or angle: nominal, fitted; number of its parts with the truth within
1.96 standard errors, `2 of 3` or `98 %`, a dash without standard errors."""


def _build_truth(calibration: result.Calibration, truth: TruthErrors) -> list[Block]:
    out = [
        make_heading("How near the truth"),
        make_text(
            "This subject is synthetic, so that the true values are known: the study file declares "
            "them. Pictures, "
            "tables and curves call them truth; the calibration did not use them. "
            f"{truth_comparison.describe_settings(calibration)} "
            f"{truth_comparison.describe_error_bars(truth)}"
        ),
        make_table(
            ["RMS error", "Over", "Nominal", "Calibrated", "Truth within ±1.96 SE"],
            [
                [
                    make_cell(row.label, unit=row.unit),
                    row.count_label,
                    format_number(row.nominal, 2),
                    _format_fitted_error(row.fitted, row.is_worse, 2),
                    MISSING if row.share is None else f"{format_number(100.0 * row.share, 0)} %",
                ]
                for row in truth_comparison.summarise_errors(calibration, truth)
            ],
        ),
    ]
    if turning_text := truth_comparison.describe_two_marker_segments(calibration):
        out.append(make_text(turning_text, "soft"))
    if not_compared := truth_comparison.describe_not_compared(truth):
        out.append(make_text(not_compared))
    if truth.features:
        features = []
        for f in truth.features:
            within = f"{sum(f.within)} of {len(f.within)}" if f.within else MISSING
            features.append((f"{f.label}, {f.unit}", f.side, (f.nominal, f.fitted, within)))
        out.append(make_heading("Joint centres and axes of the legs", 4))
        out += [make_text(FEATURES, "soft"), _build_two_sided_table("Centre or axis", features)]
    trials = {
        name: truth_comparison.list_curve_rows(calibration, truth, name)
        for name in truth_comparison.list_compared_trials(calibration, truth)
    }
    for kind, unit in (("angle", "deg"), ("moment", "N·m")):
        for name, rows in trials.items():
            if found := _collect_curve_errors(getattr(row, kind) for row in rows):
                frames = _count_frames(rows) if kind == "angle" else "the valid frames"
                explanation = (
                    f"RMS error over {frames}, {unit}, and the share of them with the truth "
                    "within ±1.96 "
                )
                explanation += "standard errors."
                title = f"Joint {kind}s of the legs, trial {format_name(name)}"
                out.append(
                    fold_blocks(
                        title,
                        [
                            make_text(explanation, "soft"),
                            _build_two_sided_table(f"{kind.capitalize()}, {unit}", found),
                        ],
                    )
                )
    return [
        *out,
        make_text(
            "Every parameter and curve: folder truth of the result; “truth” in summary.json.",
            "soft",
        ),
    ]


def _count_frames(rows: Iterable[truth_comparison.CurveRow]) -> str:
    """Count the compared frames in words: `all 415 frames`, or those of the truth."""
    some, every = min(
        (int(r.angle.compared.sum()), len(r.angle.compared)) for r in rows if r.angle is not None
    )
    return (
        f"all {every} frames"
        if some == every
        else f"{some} of {every} frames, those of the true curves"
    )


def _collect_curve_errors(curves: Iterable[CurveTruth | None]) -> list[tuple[str, str, Errors]]:
    """Collect title, side and errors of each compared curve."""
    out = []
    for curve in curves:
        if curve is not None and curve.rms is not None and curve.nominal_rms is not None:
            within = MISSING if curve.share_within is None else f"{100 * curve.share_within:.0f} %"
            base, side = coordinates.split_side(curve.name)
            out.append(
                (
                    coordinates.describe_coordinate(base).title,
                    side,
                    (curve.nominal_rms, curve.rms, within),
                )
            )
    return out


def _format_fitted_error(value: float, farther: bool, digits: int = 1) -> Cell:
    """Format an error after calibration, marked if calibration increased it visibly."""
    return (
        make_cell(f"farther: {format_number(value, digits)}", tone="look")
        if farther
        else format_number(value, digits)
    )


def _build_two_sided_table(title: str, found: Iterable[tuple[str, str, Errors]]) -> Block:
    """Build a table with one row for both sides of the body."""
    rows: dict[str, dict[str, list[Cell]]] = {}
    for title_of_row, side, (nominal, fitted, within) in found:
        # Compared as printed, so that equal numbers are not marked as worse.
        farther = round(fitted, 1) > round(nominal, 1)
        rows.setdefault(title_of_row, {})[side] = [
            format_number(nominal),
            _format_fitted_error(fitted, farther),
            within,
        ]
    head: list[Cell] = [title]
    for side in "rl":
        head.append(make_cell(f"{SIDE_TITLES[side]}: nominal", side=side))
        head += [make_cell("calibrated", side=side), make_cell("within", side=side)]
    none: list[Cell] = [MISSING] * 3
    return make_table(
        head,
        [
            [make_cell(title_of_row), *cells.get("r", none), *cells.get("l", none)]
            for title_of_row, cells in rows.items()
        ],
    )
