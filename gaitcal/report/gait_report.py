"""Read the content of a printed gait report from a result, in the clinical convention.

Curves are means over straight strides of all walks with the standard error of `ensemble.csv`, in
clinical signs (`gait/conventions.py`). Comments come from a file of the clinic.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError, suggest_name
from gaitcal.gait import conventions, peaks
from gaitcal.gait.cycles import (
    GROUND_REACTION,
    POINTS,
    WALKING,
    CurveKind,
    get_curve_kind,
    list_variables,
)
from gaitcal.gait.ensemble import ensemble
from gaitcal.gait.moments import SIDE_WORDS, describe_joint, describe_parameter, format_count
from gaitcal.gait.normal_bands import FREE_LABEL, Bands, make_user_norm
from gaitcal.gait.profile_score import compute_profile_scores
from gaitcal.gait.strides import TURNING
from gaitcal.io.toml import read_toml
from gaitcal.model import coordinates, linkage
from gaitcal.model.subject_model import Subject
from gaitcal.quality.verdict import SENTENCES, Judgement
from gaitcal.report.figures.curve_panel import LEAST, CurvePanel
from gaitcal.report.figures.document import COMMENT_SECTIONS, ReportContent
from gaitcal.report.figures.report_sheets import Sheet
from gaitcal.report.page.key_figures import WIDE_LIMITS
from gaitcal.results import cycles_export
from gaitcal.results.normal_curves import NormalCurve, NormTables, build_norm_tables
from gaitcal.results.result_tables import ResultTables, read_result_tables
from gaitcal.results.saved_result import MODEL
from gaitcal.results.shown_labels import PAPER_UNITS, SHOWN_MEASURES, list_person_facts
from gaitcal.results.stride_tables import StrideTables
from gaitcal.results.stride_uses import (
    StrideUse,
    average_toe_offs,
    list_reasons,
    summarise_usable_strides,
)
from gaitcal.results.summary import get_entries, get_table

CLINICAL: Final = conventions.Convention(
    signs=conventions.Signs.CLINICAL, unit=conventions.MomentUnit.NM_PER_KG
)
HINGE: Final = "{} is not available: the knee is a hinge in this model."
KINEMATICS: Final = (
    *(
        "pelvis_tilt",
        "pelvis_list",
        "pelvis_rotation",
        "hip_flexion",
        "hip_adduction",
        "hip_rotation",
    ),
    *("knee_angle", HINGE.format("Knee varus"), HINGE.format("Knee rotation")),
    *("ankle_angle", coordinates.FOOT_PROGRESSION, "subtalar_angle"),
)
"""Variables of `cycles.csv` in the order of the sheet; a sentence where there is none."""
KINETICS: Final = (
    *("hip_flexion_moment", "hip_adduction_moment", "hip_rotation_moment"),
    *(
        "knee_angle_moment",
        "knee_adduction_moment",
        "ankle_angle_moment",
        "hip_power",
        "knee_power",
        "ankle_power",
    ),
    *("subtalar_angle_moment", "lumbar_extension_moment", GROUND_REACTION),
)
LEGS: Final = (
    *(
        "hip_flexion",
        "knee_angle",
        "ankle_angle",
        "hip_flexion_moment",
        "knee_angle_moment",
        "ankle_angle_moment",
    ),
    *(
        "hip_power",
        "knee_power",
        "ankle_power",
        "hip_adduction",
        "knee_adduction_moment",
        GROUND_REACTION,
    ),
)
"""Of each activity after the first, on one page."""
MOST_REASONS = 6
RELATIVE: Final = "No Gait Profile Score: joint angles are relative to the static posture."


def read_report_content(
    folder: Path, named: tuple[Bands, str] | None, comments: Mapping[str, str]
) -> ReportContent:
    """Read the content of the report of a result.

    Parameters
    ----------
    folder
        A result of `gaitcal calibrate`.
    named
        Normative data and their name; None: those of the result.
    comments
        Section -> text (`read_comments`).

    Returns
    -------
    ReportContent
        Text, tables and curves.

    Raises
    ------
    InputError
        The folder is not a result, or is damaged.
    """
    tables = read_result_tables(folder)
    if not (folder / MODEL).exists():
        message = f"no such file: '{MODEL}'; allowed: a result of 'gaitcal calibrate'"
        raise InputError(message, source=folder, code=Code.NO_FILE)
    return build_report_content(tables, named, comments, folder.resolve().name)


def build_report_content(
    tables: ResultTables, named: tuple[Bands, str] | None, comments: Mapping[str, str], folder: str
) -> ReportContent:
    """Build the content of the report from the tables of a result.

    Parameters
    ----------
    tables
        Built from a calibration, or read from its folder.
    named
        Normative data and their name; None: those of the result.
    comments
        Section -> text (`read_comments`).
    folder
        Name of the folder with all numbers.

    Returns
    -------
    ReportContent
        Text, tables and curves.
    """
    subject, summary, manifest = tables.model.subject, tables.summary, tables.manifest
    cycles = pd.DataFrame(tables.strides.cycles)
    strides = cycles_export.convert_strides(cycles, CLINICAL, tables.model)
    parameters = pd.DataFrame(tables.parameters)
    relative = get_table(manifest, "settings").get("angles") == "relative"
    norm, scores = tables.norm, () if relative else tables.scores
    if named is not None:
        norm = build_norm_tables(make_user_norm(*named, subject), subject)
        scores = (
            () if relative else compute_profile_scores(tables.strides.cycles, named[0], subject)
        )
    remark = " ".join(filter(None, (norm.remark, RELATIVE if relative and norm.curves else "")))
    activities = tuple(_group_activities(tables))
    return ReportContent(
        person=(*list_person_facts(subject), ("Marker set", str(manifest.get("marker_set", "")))),
        verdict=str(summary.get("verdict", "")),
        sentence="Reasons, the most severe first:"
        if get_entries(summary, "reasons")
        else SENTENCES[Judgement.TRUSTWORTHY],
        reasons=_format_reasons(summary),
        fit=tuple(_format_fit(summary)),
        walked=any(a.walks for a in activities),
        walks=tuple(_build_walk_rows(summary, tables.strides)),
        steps=tuple(_build_step_rows(summary, norm.steps)),
        steps_norm=f"norm: {FREE_LABEL}, mean ± SD" if norm.steps else "",
        sheets=tuple(_build_sheets(strides, norm, subject, activities, remark)),
        peaks=tuple(
            (
                f"Peaks of {a.name}, mean ± standard error over {a.one}s",
                tuple(_build_peak_rows(tables.strides.peaks, a.name, subject)),
            )
            for a in activities
            if not a.walks
        ),
        norm=norm.label,
        norm_remark=remark,
        profile=scores,
        joints=tuple(_build_joint_rows(parameters)),
        undetermined=_list_undetermined(parameters),
        comments=comments,
        footer=f"gaitcal {manifest.get('gaitcal', '')}: every number and its error bar in {folder}",
    )


def read_comments(path: Path) -> dict[str, str]:
    """Read a comments file: one line of TOML for each of `COMMENT_SECTIONS`.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    dict
        Section -> text.

    Raises
    ------
    InputError
        The file is missing, is not TOML, or has an unknown section.
    """
    found = read_toml(path)
    for name, text in found.items():
        if name not in COMMENT_SECTIONS:
            message = (
                "unknown section; allowed: "
                f"{', '.join(COMMENT_SECTIONS)}{suggest_name(name, COMMENT_SECTIONS)}"
            )
            raise InputError(message, source=path, field=name, code=Code.COMMENTS)
        if not isinstance(text, str):
            message = f"found {type(text).__name__}; allowed: text in quotation marks"
            raise InputError(message, source=path, field=name, code=Code.COMMENTS)
    return {name: str(text) for name, text in found.items()}


def _format_reasons(summary: Mapping[str, object]) -> tuple[tuple[str, str], ...]:
    out = []
    for r in get_entries(summary, "reasons"):
        where = ", ".join(r.get("trials") or ["study"])
        out.append(
            (
                f"{where}: {r.get('cause')} ({r.get('evidence')}) [{r.get('code')}]",
                str(r.get("action")),
            )
        )
    if (more := len(out) - MOST_REASONS) > 0:
        out[MOST_REASONS:] = [
            (
                f"and {format_count(more, 'more reason')}",
                "summary.json and the page list all of them",
            )
        ]
    return tuple(out)


def _format_fit(summary: Mapping[str, object]) -> Iterator[str]:
    for name, trial in get_table(summary, "trials").items():
        legs = get_table(trial, "pelvis_and_legs_mm")
        rms = legs or get_table(trial, "rms_mm")
        best = rms.get("joint_floor") or rms.get("rigid_floor")
        clauses = []
        if rms.get("calibrated"):
            fitted = "pelvis and legs" if legs else "the joint's segments"
            clauses.append(f"marker fit of {fitted} {rms['calibrated']:.1f} mm")
            clauses[-1] += f" (best possible {best:.1f})" if best else ""
        residual = next(reversed(get_table(trial, "pelvis_residual").values()), None)
        limit = get_table(trial, "pelvis_residual_limit")
        if residual:
            units = (
                ("force_N", "force at the pelvis {:.0f} N RMS", ".0f"),
                ("torque_Nm", "moment {:.1f} N·m", ".1f"),
            )
            parts = (
                w.format(residual[n]) + (f" (limit {limit[n]:{d}})" if limit else "")
                for n, w, d in units
            )
            high = limit and any(residual[name] > limit[name] for name, _, _ in units)
            wide = "" if trial.get("trunk_measured", True) else WIDE_LIMITS
            clauses.append(f"residual {', '.join(parts)}{': too high' if high else ''}{wide}")
        if clauses:
            yield f"{name}: {'; '.join(clauses)}"


@dataclass(frozen=True)
class _Activity:
    """Walking, or the trial of another activity."""

    name: str
    trials: tuple[str, ...]
    repeats: bool
    uses: tuple[StrideUse, ...]  # Its strides or repetitions

    @property
    def walks(self) -> bool:
        """Whether it is walking."""
        return self.name == WALKING

    @property
    def one(self) -> str:
        """Name of a single one."""
        return "repetition" if self.repeats else "stride"


def _group_activities(tables: ResultTables) -> Iterator[_Activity]:
    """Group the whole-body trials by activity, walking first."""
    by_name: dict[str, dict[str, Any]] = {}
    for name, trial in get_table(tables.summary, "trials").items():
        if "activity" in trial:
            by_name.setdefault(trial["activity"], {})[name] = trial
    for activity in sorted(by_name, key=lambda name: name != WALKING):
        trials = by_name[activity]
        yield _Activity(
            activity,
            tuple(trials),
            any("repetitions" in trial for trial in trials.values()),
            tuple(use for name in trials for use in tables.strides.get_uses(name)),
        )


def _build_sheets(
    strides: pd.DataFrame,
    norm: NormTables,
    subject: Subject,
    activities: Sequence[_Activity],
    remark: str,
) -> Iterator[Sheet]:
    """Build kinematics and kinetics of the first activity, and the legs of each other one."""
    kinetics = (
        "Internal moments: net moments of muscles and ligaments. Powers: generated above zero. "
        "Both only while "
        "the foot is entirely on a plate."
    )
    for k, a in enumerate(activities or (_Activity(WALKING, (), repeats=False, uses=()),)):
        averaged_over = "straight strides of all walks" if a.walks else f"strides of {a.name}"
        note = (
            f"Joint angles over the stride, mean over {averaged_over}. Pelvis angles are relative "
            "to the line of progression of each stride."
        )
        if a.repeats:
            note = "Joint angles from rest to rest of the pelvis, mean over repetitions."
        full_sheets = (("Kinematics", KINEMATICS, note), ("Kinetics", KINETICS, kinetics))
        for title, variables, text in (
            full_sheets if k == 0 else (("Legs", LEGS, f"{note} {kinetics}"),)
        ):
            yield Sheet(
                title=title if a.walks else f"{title}, {a.name}",
                panels=tuple(
                    _build_panels(
                        strides[strides["activity"] == a.name],
                        variables,
                        norm.curves if a.walks else {},
                        subject,
                        average_toe_offs(a.uses),
                    )
                ),
                note=f"{text} {remark}" if a.walks and remark else text,
                without=_explain_missing_curves(a.trials, a.uses, of_moments=variables is KINETICS),
                comment=title.lower() if k == 0 else "",
                thin="thin: repetitions" if a.repeats else "thin: strides, vertical: toe-off",
            )


def _build_peak_rows(
    means: Iterable[peaks.PeakMean], activity: str, subject: Subject
) -> Iterator[tuple[str, ...]]:
    """Build the rows of peaks by phase of one activity, in clinical signs and by body mass."""
    found = [mean for mean in means if mean.activity == activity]
    present = {mean.peak.phase for mean in found}
    phases = [phase for phase in peaks.PHASES if phase in present]
    yield ("peak", "unit", "leg", *phases)
    rows: dict[tuple[str, str, str], dict[str, str]] = {}
    for m in found:
        phase, kind = m.peak.phase, get_curve_kind(m.peak.variable)
        pair = np.array([m.mean, m.se]) / (subject.mass if kind is CurveKind.FORCE else 1.0)
        value, error = CLINICAL.values(m.peak.variable, pair, m.side, subject)
        digits = 1 if kind is CurveKind.ANGLE else 2
        bar = f" ± {abs(error):.{digits}f}" if np.isfinite(error) else ""
        title = m.peak.make_title().removesuffix(f", {phase}").removesuffix(f" in {phase}")
        rows.setdefault((title, PAPER_UNITS[kind], SIDE_WORDS[m.side]), {})[phase] = (
            f"{value:.{digits}f}{bar}"
        )
    order = list(dict.fromkeys(title for title, _, _ in rows))
    # rows of both legs of a peak follow each other
    for head, cells in sorted(rows.items(), key=lambda row: order.index(row[0][0])):
        yield (*head, *(cells.get(phase, "–") for phase in phases))


def _build_walk_rows(
    summary: Mapping[str, object], strides: StrideTables
) -> Iterator[tuple[str, ...]]:
    yield (
        "trial",
        "leg",
        "verdict",
        "on plate",
        "strides or repetitions usable for moments",
        "why others are not",
    )
    for name, trial in get_table(summary, "trials").items():
        if "activity" not in trial:
            continue
        for side in linkage.SIDES:
            of_leg = [use for use in strides.get_uses(name) if use.side == side]
            turning = sum(use.turns for use in of_leg)
            turning_text = (
                f"{format_count(turning, 'stride')} turning: not in means" if turning else ""
            )
            yield (
                name,
                SIDE_WORDS[side],
                str(trial.get(f"verdict_{side}", "")),
                ", ".join(dict.fromkeys(use.plate for use in of_leg if use.plate)),
                f"{sum(use.whole for use in of_leg)} of {len(of_leg)}",
                "; ".join(filter(None, (list_reasons(of_leg), turning_text)))
                if of_leg
                else "no complete stride or repetition",
            )


def _explain_missing_curves(
    trials: Sequence[str], uses: Sequence[StrideUse], *, of_moments: bool = False
) -> str:
    """Explain why a sheet of some trials has no curves."""
    if not trials:
        return "No curves: the study has functional (single-joint) trials only; see result.html."
    if not uses:
        return "No curves: there is no complete stride or repetition."
    if all(use.turns for use in uses):
        return "No curves: every stride turns, and means include straight strides only."
    return (
        f"No curves. {summarise_usable_strides(uses)}"
        if of_moments
        else "No curves: no angle of a straight stride is known."
    )


def _build_step_rows(
    summary: Mapping[str, object], norms: Mapping[str, tuple[float, float]]
) -> Iterator[tuple[str, ...]]:
    yield (
        "measure",
        "unit",
        "right, mean ± SD",
        "left, mean ± SD",
        "asymmetry, % ± SE",
        *(["norm"] if norms else []),
    )
    found = get_table(summary, "spatiotemporal")
    for name, (title, digits) in SHOWN_MEASURES.items():
        measure = get_table(found, name)
        if measure:
            cells = (_format_average(get_table(measure, side), digits) for side in linkage.SIDES)
            asymmetry, error = (
                measure.get(f"symmetry_{name}") for name in ("percent", "se_percent")
            )
            asymmetry_text = (
                ""
                if asymmetry is None
                else f"{asymmetry:.1f}" + ("" if error is None else f" ± {error:.1f}")
            )
            norm = (
                [" ± ".join(f"{part:.{digits}f}" for part in norms.get(name, ()))] if norms else []
            )
            yield (title, str(measure.get("unit", "")), *cells, asymmetry_text, *norm)


def _format_average(of_side: Mapping[str, object], digits: int) -> str:
    mean, sd = of_side.get("mean"), of_side.get("sd")
    if not isinstance(mean, int | float):
        return "–"
    spread = f" ± {sd:.{digits}f}" if isinstance(sd, int | float) else ""
    return f"{mean:.{digits}f}{spread} (n = {of_side.get('strides')})"


def _build_panels(
    strides: pd.DataFrame,
    variables: Sequence[str],
    normal: Mapping[str, NormalCurve],
    subject: Subject,
    toe_off: Mapping[str, float],
) -> Iterator[CurvePanel | str]:
    straight = strides[~(strides["turn"].abs() > TURNING)]
    means = ensemble(strides[strides["variable"].isin(variables)]) if len(strides) else strides
    for variable in variables:
        if variable not in list_variables():
            yield variable
            continue
        rows = straight[straight["variable"] == variable]
        kind = get_curve_kind(variable)
        factor = 1.0 / subject.mass if kind is CurveKind.FORCE else 1.0
        curves: dict[str, tuple[Array, ...]] = {}
        mean: dict[str, Array] = {}
        error: dict[str, Array] = {}
        for side in linkage.SIDES:
            of_side = rows[rows["side"] == side]
            values = np.where(
                of_side["valid"].to_numpy() == 1,
                factor * of_side["value"].to_numpy(dtype=float),
                np.nan,
            )
            curves[side] = tuple(values.reshape(-1, POINTS))
            of_mean = (
                means[(means["variable"] == variable) & (means["side"] == side)]
                if len(means)
                else means
            )
            known = len(of_mean) == POINTS
            for out, column in ((mean, "mean"), (error, "se")):
                out[side] = (
                    factor * of_mean[column].to_numpy(dtype=float)
                    if known
                    else np.full(POINTS, np.nan)
                )
        norms = {}
        if variable in normal:
            average, sd = (
                CLINICAL.values(variable, part, "r", subject)
                for part in normal[variable].sides["r"]
            )
            norms["r"] = factor * average, factor * np.abs(sd)
        yield CurvePanel(
            title=CLINICAL.title(variable),
            unit=PAPER_UNITS[kind],
            senses=CLINICAL.senses(variable, "r"),
            strides=curves,
            mean=mean,
            error=error,
            norms=norms,
            toe_off=toe_off,
            least=LEAST[kind],
        )


def _build_joint_rows(table: pd.DataFrame) -> Iterator[tuple[str, ...]]:
    """Build rows of joint changes with the largest standard error of fitted parameters."""
    yield ("joint", "moved, mm", "standard error, mm", "rotated, deg", "standard error, deg")
    fitted = table[table["kind"].str.startswith("joint ") & (table["status"] != "fixed")]
    for joint, rows in fitted.groupby("joint", sort=False):
        cells: list[str] = []
        for kind in ("joint position", "joint orientation"):
            of_kind = rows[rows["kind"] == kind]
            # A joint has a position in each of its two segments: the larger movement counts.
            changes = (of_kind["fitted"] - of_kind["nominal"]) ** 2
            change = float(np.sqrt(changes.groupby(of_kind["segment"]).sum().max()))
            error = of_kind["standard_error"].astype(float).max()
            cells += (
                [f"{change:.1f}", f"{error:.1f}" if np.isfinite(error) else "–"]
                if len(of_kind)
                else ["–", "–"]
            )
        yield (describe_joint(str(joint)).capitalize(), *cells)


def _list_undetermined(table: pd.DataFrame) -> tuple[str, ...]:
    rows = table[(table["status"] == "unidentifiable") & (table["joint"].fillna("") != "")]
    lines = []
    for joint, rows_of_joint in rows.groupby("joint", sort=False):
        names = "; ".join(map(describe_parameter, rows_of_joint["name"]))
        lines.append(f"{describe_joint(str(joint)).capitalize()}: {names}")
    return tuple(lines)
