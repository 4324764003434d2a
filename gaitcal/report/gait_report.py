"""Read the content of a printed gait report from a result, in the clinical convention.

Curves are means over straight strides of all walks with the standard error of `ensemble.csv`, in
clinical signs (`gait/conventions.py`). Comments come from a file of the clinic.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError, nearest
from gaitcal.gait import conventions, peaks, profile_score
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
from gaitcal.gait.normal_bands import (
    BAND_SIGNS,
    FREE_LABEL,
    Bands,
    Norm,
    NormalBand,
    make_user_norm,
    select_norm,
)
from gaitcal.gait.strides import TURNING
from gaitcal.io.result_folder import MANIFEST, read_json_object
from gaitcal.io.toml import read_toml
from gaitcal.model import coordinates, linkage
from gaitcal.model.subject_model import Subject
from gaitcal.quality.verdict import SENTENCES, Judgement
from gaitcal.report.figures.document import COMMENT_SECTIONS, ReportContent
from gaitcal.report.figures.report_sheets import LEAST, UNITS, CurvePanel, Sheet
from gaitcal.report.page.key_figures import (
    WIDE_LIMITS,
    StrideUse,
    list_reasons,
    summarise_usable_strides,
)
from gaitcal.report.page.page_data import (
    PAGE_DATA,
    SHOWN_MEASURES,
    average_page_peaks,
    average_toe_offs,
    list_person_facts,
    read_page_data,
)
from gaitcal.results import cycle_tables, cycles_export, saved_result, stride_files
from gaitcal.results.summary import SUMMARY, get_entries, get_table

CLINICAL: Final = conventions.Convention(
    signs=conventions.Signs.CLINICAL, unit=conventions.MomentUnit.NM_PER_KG
)
HINGE: Final = "{} is not available: the knee is a hinge in this model."
CLINICAL_SIGNS: Final = BAND_SIGNS["clinical"]
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
        Normative data and their name; None: those of the result, else the built-in ones.
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
    page = read_page_data(folder / PAGE_DATA)
    model, _, _ = saved_result.load_result_model(folder)
    summary, manifest = read_json_object(folder / SUMMARY), read_json_object(folder / MANIFEST)
    cycles = cycle_tables.read_cycles(folder)
    strides = cycles_export.convert_strides(cycles, CLINICAL, model)
    parameters = pd.read_csv(folder / "parameters.csv", comment="#")
    norm = _choose_norm(page, named, model.subject, summary, manifest)
    relative = get_table(manifest, "settings").get("angles") == "relative"
    remark = " ".join(filter(None, (norm.remark, RELATIVE if relative and norm.bands else "")))
    uses = _collect_stride_uses(page)
    activities = tuple(_group_activities(summary, page))
    return ReportContent(
        person=(
            *list_person_facts(model.subject),
            ("Marker set", str(manifest.get("marker_set", ""))),
        ),
        verdict=str(summary.get("verdict", "")),
        sentence="Reasons, the most severe first:"
        if get_entries(summary, "reasons")
        else SENTENCES[Judgement.TRUSTWORTHY],
        reasons=_format_reasons(summary),
        fit=tuple(_format_fit(summary)),
        walked=any(a.walks for a in activities),
        walks=tuple(_build_walk_rows(summary, uses)),
        steps=tuple(_build_step_rows(summary, norm.steps)),
        steps_norm=f"norm: {FREE_LABEL}, mean ± SD" if norm.steps else "",
        sheets=tuple(_build_sheets(strides, norm, model.subject, activities, uses, remark)),
        peaks=tuple(
            (
                f"Peaks of {a.name}, mean ± standard error over {a.one}s",
                tuple(_build_peak_rows(page, a.name, model.subject)),
            )
            for a in activities
            if not a.walks
        ),
        norm=norm.label,
        norm_remark=remark,
        profile=profile_score.compute_profile_scores(
            {n: cycles[n].to_numpy() for n in cycles}, norm.bands, model.subject
        )
        if norm.bands and not relative
        else (),
        joints=tuple(_build_joint_rows(parameters)),
        undetermined=_list_undetermined(parameters),
        comments=comments,
        footer=f"gaitcal {manifest.get('gaitcal', '')}: every number and its error bar in "
        f"{folder.resolve().name}",
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
                f"{', '.join(COMMENT_SECTIONS)}{nearest(name, COMMENT_SECTIONS)}"
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
            clauses.append(f"unexplained {', '.join(parts)}{': too high' if high else ''}{wide}")
        if clauses:
            yield f"{name}: {'; '.join(clauses)}"


@dataclass(frozen=True)
class _Activity:
    """Walking, or the trial of another activity."""

    name: str
    trials: tuple[str, ...]
    repeats: bool
    toe_off: Mapping[str, float]  # Side -> %, mean over straight strides

    @property
    def walks(self) -> bool:
        """Whether it is walking."""
        return self.name == WALKING

    @property
    def one(self) -> str:
        """Name of a single one."""
        return "repetition" if self.repeats else "stride"


def _group_activities(
    summary: Mapping[str, object], page: Mapping[str, Any]
) -> Iterator[_Activity]:
    """Group the whole-body trials by activity, walking first."""
    by_name: dict[str, list[Any]] = {}
    for trial in sorted(page["trials"], key=lambda trial: trial["activity"] != WALKING):
        if get_table(get_table(summary, "trials"), trial["name"]).get("role") != "joint":
            by_name.setdefault(trial["activity"], []).append(trial)
    for name, trials in by_name.items():
        yield _Activity(
            name,
            tuple(t["name"] for t in trials),
            any(t["repeats"] for t in trials),
            average_toe_offs(trials),
        )


def _build_sheets(
    strides: pd.DataFrame,
    norm: Norm,
    subject: Subject,
    activities: Sequence[_Activity],
    uses: Mapping[str, Sequence[StrideUse]],
    remark: str,
) -> Iterator[Sheet]:
    """Build kinematics and kinetics of the first activity, and the legs of each other one."""
    kinetics = (
        "Internal moments: net moments of muscles and ligaments. Powers: generated above zero. "
        "Both only while "
        "the foot is entirely on a plate."
    )
    for k, a in enumerate(activities or (_Activity(WALKING, (), repeats=False, toe_off={}),)):
        whose = "straight strides of all walks" if a.walks else f"strides of {a.name}"
        note = (
            f"Joint angles over the stride, mean over {whose}. Pelvis angles are relative to the "
            "line of progression of each stride."
        )
        if a.repeats:
            note = "Joint angles from rest to rest of the pelvis, mean over repetitions."
        uses_of_trials = {name: uses[name] for name in a.trials}
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
                        norm.bands if a.walks else {},
                        subject,
                    )
                ),
                note=f"{text} {remark}" if a.walks and remark else text,
                without=_explain_missing_curves(uses_of_trials, of_moments=variables is KINETICS),
                comment=title.lower() if k == 0 else "",
                thin="thin: repetitions" if a.repeats else "thin: strides, vertical: toe-off",
                toe_off=a.toe_off,
            )


def _build_peak_rows(
    page: Mapping[str, Any], activity: str, subject: Subject
) -> Iterator[tuple[str, ...]]:
    """Build the rows of peaks by phase of one activity, in clinical signs and by body mass."""
    found = [mean for mean in average_page_peaks(page["trials"]) if mean.activity == activity]
    present = {mean.peak.phase for mean in found}
    phases = [phase for phase in peaks.PHASES if phase in present]
    yield ("peak", "unit", "leg", *phases)
    rows: dict[tuple[str, str, str], dict[str, str]] = {}
    for m in found:
        phase, kind = m.peak.phase, get_curve_kind(m.peak.variable)
        pair = np.array([m.mean, m.se]) / (subject.mass if kind is CurveKind.FORCE else 1.0)
        value, error = CLINICAL.convert_values(m.peak.variable, pair, m.side, subject)
        digits = 1 if kind is CurveKind.ANGLE else 2
        bar = f" ± {abs(error):.{digits}f}" if np.isfinite(error) else ""
        title = m.peak.make_title().removesuffix(f", {phase}").removesuffix(f" in {phase}")
        rows.setdefault((title, UNITS[kind], SIDE_WORDS[m.side]), {})[phase] = (
            f"{value:.{digits}f}{bar}"
        )
    order = list(dict.fromkeys(title for title, _, _ in rows))
    # rows of both legs of a peak follow each other
    for head, cells in sorted(rows.items(), key=lambda row: order.index(row[0][0])):
        yield (*head, *(cells.get(phase, "–") for phase in phases))


def _collect_stride_uses(page: Mapping[str, Any]) -> dict[str, list[StrideUse]]:
    """Collect the complete strides or repetitions of each whole-body trial."""
    uses: dict[str, list[StrideUse]] = {}
    for trial in page["trials"]:
        uses[trial["name"]] = [
            StrideUse(
                side=stride["side"],
                number=stride["number"],
                plate=stride["plate"],
                whole=not stride["reason"],
                turns=stride["turns"],
                reason=stride["reason"],
                repeats=trial["repeats"],
            )
            for stride in trial["strides"]
        ]
    return uses


def _build_walk_rows(
    summary: Mapping[str, object], uses: Mapping[str, Sequence[StrideUse]]
) -> Iterator[tuple[str, ...]]:
    yield (
        "trial",
        "leg",
        "verdict",
        "on plate",
        "strides or repetitions usable for moments",
        "why others are not",
    )
    for name, of_walk in uses.items():
        if get_table(get_table(summary, "trials"), name).get("role") == "joint":
            continue
        for side in linkage.SIDES:
            of_leg = [use for use in of_walk if use.side == side]
            turning = sum(use.turns for use in of_leg)
            turning_text = (
                f"{format_count(turning, 'stride')} turning: not in means" if turning else ""
            )
            yield (
                name,
                SIDE_WORDS[side],
                str(get_table(get_table(summary, "trials"), name).get(f"verdict_{side}", "")),
                ", ".join(dict.fromkeys(use.plate for use in of_leg if use.plate)),
                f"{sum(use.whole for use in of_leg)} of {len(of_leg)}",
                "; ".join(filter(None, (list_reasons(of_leg), turning_text)))
                if of_leg
                else "no complete stride or repetition",
            )


def _explain_missing_curves(
    uses: Mapping[str, Sequence[StrideUse]], *, of_moments: bool = False
) -> str:
    """Explain why a sheet has no curves."""
    every = [use for of_walk in uses.values() for use in of_walk]
    if not uses:
        return "No curves: the study has functional (single-joint) trials only; see result.html."
    if not every:
        return "No curves: there is no complete stride or repetition."
    if all(use.turns for use in every):
        return "No curves: every stride turns, and means include straight strides only."
    return (
        f"No curves. {summarise_usable_strides(every)}"
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
    strides: pd.DataFrame, variables: Sequence[str], bands: Bands, subject: Subject
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
        band = bands.get(variable)
        norm = None
        if band is not None:
            average, sd = (
                CLINICAL.convert_values(variable, part, "r", subject)
                for part in band.scale_to_person(subject)
            )
            norm = factor * average, factor * np.abs(sd)
        yield CurvePanel(
            title=CLINICAL.make_title(variable),
            unit=UNITS[kind],
            senses=CLINICAL.describe_senses(variable, "r"),
            strides=curves,
            mean=mean,
            error=error,
            norm=norm,
            least=LEAST[kind],
        )


def _choose_norm(
    page: Mapping[str, Any],
    named: tuple[Bands, str] | None,
    subject: Subject,
    summary: Mapping[str, object],
    manifest: Mapping[str, object],
) -> Norm:
    """Choose normative data: of the user, else of the result, else built-in."""
    if named is not None:
        return make_user_norm(*named, subject)
    made_with, stored = (
        str(get_table(manifest, "settings").get("normal", "")),
        get_table(summary, "norm"),
    )
    if stored and not stored.get("words"):
        return Norm(remark=str(stored.get("remark", "")))
    if not made_with:
        return select_norm(
            subject, stride_files.compute_mean_speed(get_table(summary, "spatiotemporal"))
        )
    bands = {}
    for band in page["bands"]:
        kind = next(kind for kind in CurveKind if kind.label == band["kind"])
        name = band["base"] + kind.ending
        average, sd = (np.array(part, dtype=np.float64) for part in band["r"])
        known = np.isfinite(average)
        average = CLINICAL_SIGNS.convert_values(name, average, "r", subject)
        bands[name] = NormalBand(
            variable=name,
            unit=kind.unit,
            signs=CLINICAL_SIGNS,
            percent=np.flatnonzero(known).astype(np.float64),
            mean=average[known],
            sd=sd[known],
            source=band["source"],
        )
    return make_user_norm(bands, made_with, subject)


def _build_joint_rows(table: pd.DataFrame) -> Iterator[tuple[str, ...]]:
    """Build rows of joint changes with the largest standard error of fitted parameters."""
    yield ("joint", "moved, mm", "standard error, mm", "rotated, deg", "standard error, deg")
    fitted = table[table["kind"].str.startswith("joint ") & (table["status"] != "fixed")]
    for joint, rows in fitted.groupby("joint", sort=False):
        cells: list[str] = []
        for kind in ("joint position", "joint orientation"):
            of_kind = rows[rows["kind"] == kind]
            change = np.linalg.norm(of_kind["fitted"] - of_kind["nominal"])
            error = of_kind["standard_error"].max()
            cells += (
                [f"{change:.1f}", f"{error:.1f}" if np.isfinite(error) else "–"]
                if len(of_kind)
                else ["–", "–"]
            )
        yield (describe_joint(str(joint)).capitalize(), *cells)


def _list_undetermined(table: pd.DataFrame) -> tuple[str, ...]:
    rows = table[(table["status"] == "unidentifiable") & table["joint"].notna()]
    lines = []
    for joint, rows_of_joint in rows.groupby("joint", sort=False):
        names = "; ".join(map(describe_parameter, rows_of_joint["name"]))
        lines.append(f"{describe_joint(str(joint)).capitalize()}: {names}")
    return tuple(lines)
