"""What a printed gait report says of a result folder: read from its files, in the clinical
convention.

Curves are means over straight strides of all walks with the standard error of `ensemble.csv`'s
kind, from `cycles.csv` in clinical signs (`gait/conventions.py`); comments come from a file that
the clinic writes.
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
    kind_of,
    known_variables,
)
from gaitcal.gait.ensemble import ensemble
from gaitcal.gait.moments import SIDE_WORDS, counted, joint_words, parameter_words
from gaitcal.gait.normal_bands import (
    BAND_SIGNS,
    FREE_WORDS,
    Bands,
    Norm,
    NormalBand,
    norm_for,
    own_norm,
)
from gaitcal.gait.strides import TURNING
from gaitcal.io.result_folder import MANIFEST, read_json_object
from gaitcal.io.toml import read_toml
from gaitcal.model import coordinates, linkage
from gaitcal.model.subject_model import Subject
from gaitcal.report.figures.document import COMMENT_SECTIONS, ReportContent
from gaitcal.report.figures.report_sheets import LEAST, UNITS, CurvePanel, Sheet
from gaitcal.report.page.key_figures import WIDE_LIMITS, StrideUse, reason_words, usable_words
from gaitcal.report.page.page_data import (
    PAGE_DATA,
    SHOWN_MEASURES,
    page_peaks,
    page_toe_offs,
    person_facts,
    read_page_data,
)
from gaitcal.results import cycle_tables, cycles_export, saved_result, stride_files
from gaitcal.results.summary import SUMMARY, entries_of, table_of

CLINICAL: Final = conventions.Convention(
    signs=conventions.Signs.CLINICAL, unit=conventions.MomentUnit.NM_PER_KG
)
HINGE: Final = "{} is not told: the knee is a hinge in this model."
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
NOTHING: Final = "Nothing speaks against this result beyond its error bars."
RELATIVE: Final = "No Gait Profile Score: joint angles are counted from the static posture."


def report_content(
    folder: Path, named: tuple[Bands, str] | None, comments: Mapping[str, str]
) -> ReportContent:
    """What the report of the result in `folder` says.

    Parameters
    ----------
    named
        Bands of healthy people, and their name; None: those of the result, else what gaitcal
        brings.
    comments
        Section -> text (`read_comments`).

    Raises InputError: It is no result of `gaitcal calibrate`, or is damaged.
    """
    page = read_page_data(folder / PAGE_DATA)
    model, _, _ = saved_result.load_result_model(folder)
    summary, manifest = read_json_object(folder / SUMMARY), read_json_object(folder / MANIFEST)
    of = cycle_tables.read_cycles(folder)
    strides = cycles_export.strides_in_convention(of, CLINICAL, model)
    parameters = pd.read_csv(folder / "parameters.csv", comment="#")
    norm = _norm(page, named, model.subject, summary, manifest)
    relative = table_of(manifest, "settings").get("angles") == "relative"
    remark = " ".join(filter(None, (norm.remark, RELATIVE if relative and norm.bands else "")))
    uses = _uses(page)
    activities = tuple(_activities(summary, page))
    return ReportContent(
        person=(*person_facts(model.subject), ("Marker set", str(manifest.get("marker_set", "")))),
        verdict=str(summary.get("verdict", "")),
        sentence="What speaks against it, the worst first:"
        if entries_of(summary, "reasons")
        else NOTHING,
        reasons=_reasons(summary),
        fit=tuple(_fit(summary)),
        walked=any(a.walks for a in activities),
        walks=tuple(_walks(summary, uses)),
        steps=tuple(_steps(summary, norm.steps)),
        steps_norm=f"norm: {FREE_WORDS}, mean ± SD" if norm.steps else "",
        sheets=tuple(_sheets(strides, norm, model.subject, activities, uses, remark)),
        peaks=tuple(
            (
                f"Peaks of {a.name}, mean ± standard error over {a.one}s",
                tuple(_peaks(page, a.name, model.subject)),
            )
            for a in activities
            if not a.walks
        ),
        norm=norm.words,
        norm_remark=remark,
        profile=profile_score.profile_scores(
            {n: of[n].to_numpy() for n in of}, norm.bands, model.subject
        )
        if norm.bands and not relative
        else (),
        joints=tuple(_joints(parameters)),
        undetermined=_undetermined(parameters),
        comments=comments,
        footer=f"gaitcal {manifest.get('gaitcal', '')}: every number and its error bar in "
        f"{folder.resolve().name}",
    )


def read_comments(path: Path) -> dict[str, str]:
    """Section -> text of a comments file: one line of TOML for each of `COMMENT_SECTIONS`.

    Raises InputError: It is not there, is no TOML, or has another section.
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


def _reasons(summary: Mapping[str, object]) -> tuple[tuple[str, str], ...]:
    out = []
    for r in entries_of(summary, "reasons"):
        where = ", ".join(r.get("trials") or ["study"])
        out.append(
            (
                f"{where}: {r.get('cause')} ({r.get('evidence')}) [{r.get('code')}]",
                str(r.get("action")),
            )
        )
    if (more := len(out) - MOST_REASONS) > 0:
        out[MOST_REASONS:] = [
            (f"and {counted(more, 'more reason')}", "summary.json and the page have them all")
        ]
    return tuple(out)


def _fit(summary: Mapping[str, object]) -> Iterator[str]:
    for name, trial in table_of(summary, "trials").items():
        legs = table_of(trial, "pelvis_and_legs_mm")
        rms = legs or table_of(trial, "rms_mm")
        best = rms.get("joint_floor") or rms.get("rigid_floor")
        clauses = []
        if rms.get("calibrated"):
            of = "pelvis and legs" if legs else "the joint's segments"
            clauses.append(f"marker fit of {of} {rms['calibrated']:.1f} mm")
            clauses[-1] += f" (best possible {best:.1f})" if best else ""
        residual = next(reversed(table_of(trial, "pelvis_residual").values()), None)
        limit = table_of(trial, "pelvis_residual_limit")
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
        """What one of them is called."""
        return "repetition" if self.repeats else "stride"


def _activities(summary: Mapping[str, object], page: Mapping[str, Any]) -> Iterator[_Activity]:
    """Walking first; nothing of isolated trials."""
    of: dict[str, list[Any]] = {}
    for trial in sorted(page["trials"], key=lambda trial: trial["activity"] != WALKING):
        if table_of(table_of(summary, "trials"), trial["name"]).get("role") != "joint":
            of.setdefault(trial["activity"], []).append(trial)
    for name, trials in of.items():
        yield _Activity(
            name,
            tuple(t["name"] for t in trials),
            any(t["repeats"] for t in trials),
            page_toe_offs(trials),
        )


def _sheets(
    strides: pd.DataFrame,
    norm: Norm,
    subject: Subject,
    activities: Sequence[_Activity],
    uses: Mapping[str, Sequence[StrideUse]],
    remark: str,
) -> Iterator[Sheet]:
    """Kinematics and kinetics of the first activity, with the comments, and the legs of each
    further one.
    """
    kinetics = (
        "Internal moments: what muscles and ligaments do, net. Powers: generated above zero. Only "
        "where the foot "
        "stands wholly on a plate."
    )
    for k, a in enumerate(activities or (_Activity(WALKING, (), repeats=False, toe_off={}),)):
        whose = "straight strides of all walks" if a.walks else f"strides of {a.name}"
        note = (
            f"Joint angles over the stride, mean over {whose}. Pelvis against the line of "
            "progression of each stride."
        )
        if a.repeats:
            note = "Joint angles from rest to rest of the pelvis, mean over repetitions."
        of = {name: uses[name] for name in a.trials}
        whole = (("Kinematics", KINEMATICS, note), ("Kinetics", KINETICS, kinetics))
        for title, variables, words in whole if k == 0 else (("Legs", LEGS, f"{note} {kinetics}"),):
            yield Sheet(
                title=title if a.walks else f"{title}, {a.name}",
                panels=tuple(
                    _panels(
                        strides[strides["activity"] == a.name],
                        variables,
                        norm.bands if a.walks else {},
                        subject,
                    )
                ),
                note=f"{words} {remark}" if a.walks and remark else words,
                without=_no_curves(of, of_moments=variables is KINETICS),
                comment=title.lower() if k == 0 else "",
                thin="thin: repetitions" if a.repeats else "thin: strides, vertical: toe-off",
                toe_off=a.toe_off,
            )


def _peaks(page: Mapping[str, Any], activity: str, subject: Subject) -> Iterator[tuple[str, ...]]:
    """Peaks by phase of one activity, in clinical signs and by body mass."""
    found = [mean for mean in page_peaks(page["trials"]) if mean.activity == activity]
    phases = [phase for phase in peaks.PHASES if any(m.peak.phase == phase for m in found)]
    yield ("peak", "unit", "leg", *phases)
    rows: dict[tuple[str, str, str], dict[str, str]] = {}
    for m in found:
        phase, kind = m.peak.phase, kind_of(m.peak.variable)
        pair = np.array([m.mean, m.se]) / (subject.mass if kind is CurveKind.FORCE else 1.0)
        value, error = CLINICAL.values(m.peak.variable, pair, m.side, subject)
        digits = 1 if kind is CurveKind.ANGLE else 2
        bar = f" ± {abs(error):.{digits}f}" if np.isfinite(error) else ""
        title = m.peak.title().removesuffix(f", {phase}").removesuffix(f" in {phase}")
        rows.setdefault((title, UNITS[kind], SIDE_WORDS[m.side]), {})[phase] = (
            f"{value:.{digits}f}{bar}"
        )
    order = list(dict.fromkeys(title for title, _, _ in rows))
    for head, cells in sorted(
        rows.items(), key=lambda row: order.index(row[0][0])
    ):  # both legs of a peak together
        yield (*head, *(cells.get(phase, "–") for phase in phases))


def _uses(page: Mapping[str, Any]) -> dict[str, list[StrideUse]]:
    """Whole-body trial -> its complete strides or repetitions, as the page counts them."""
    kept = ("side", "number", "plate", "turns", "reason")
    return {
        trial["name"]: [
            StrideUse(**{k: s[k] for k in kept}, whole=not s["reason"], repeats=trial["repeats"])
            for s in trial["strides"]
        ]
        for trial in page["trials"]
    }


def _walks(
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
        if table_of(table_of(summary, "trials"), name).get("role") == "joint":
            continue
        for side in linkage.SIDES:
            of_leg = [use for use in of_walk if use.side == side]
            turning = sum(use.turns for use in of_leg)
            bent = f"{counted(turning, 'stride')} turning: not in means" if turning else ""
            yield (
                name,
                SIDE_WORDS[side],
                str(table_of(table_of(summary, "trials"), name).get(f"verdict_{side}", "")),
                ", ".join(dict.fromkeys(use.plate for use in of_leg if use.plate)),
                f"{sum(use.whole for use in of_leg)} of {len(of_leg)}",
                "; ".join(filter(None, (reason_words(of_leg), bent)))
                if of_leg
                else "no complete stride or repetition",
            )


def _no_curves(uses: Mapping[str, Sequence[StrideUse]], *, of_moments: bool = False) -> str:
    """Why a sheet has no curves, where it has none."""
    every = [use for of_walk in uses.values() for use in of_walk]
    if not uses:
        return "No curves: the study has isolated trials alone; result.html has what was recorded."
    if not every:
        return "No curves: there is no complete stride or repetition."
    if all(use.turns for use in every):
        return "No curves: every stride turns, and takes no part in means."
    return (
        f"No curves. {usable_words(every)}"
        if of_moments
        else "No curves: no angle of a straight stride is known."
    )


def _steps(
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
    found = table_of(summary, "spatiotemporal")
    for name, (title, digits) in SHOWN_MEASURES.items():
        measure = table_of(found, name)
        if measure:
            cells = (_average(table_of(measure, side), digits) for side in linkage.SIDES)
            asymmetry, error = (
                measure.get(f"symmetry_{name}") for name in ("percent", "se_percent")
            )
            apart = (
                ""
                if asymmetry is None
                else f"{asymmetry:.1f}" + ("" if error is None else f" ± {error:.1f}")
            )
            norm = (
                [" ± ".join(f"{part:.{digits}f}" for part in norms.get(name, ()))] if norms else []
            )
            yield (title, str(measure.get("unit", "")), *cells, apart, *norm)


def _average(of_side: Mapping[str, object], digits: int) -> str:
    mean, sd = of_side.get("mean"), of_side.get("sd")
    if not isinstance(mean, int | float):
        return "–"
    spread = f" ± {sd:.{digits}f}" if isinstance(sd, int | float) else ""
    return f"{mean:.{digits}f}{spread} (n = {of_side.get('strides')})"


def _panels(
    strides: pd.DataFrame, variables: Sequence[str], bands: Bands, subject: Subject
) -> Iterator[CurvePanel | str]:
    straight = strides[~(strides["turn"].abs() > TURNING)]
    means = ensemble(strides[strides["variable"].isin(variables)]) if len(strides) else strides
    for variable in variables:
        if variable not in known_variables():
            yield variable
            continue
        rows = straight[straight["variable"] == variable]
        kind = kind_of(variable)
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
                CLINICAL.values(variable, part, "r", subject) for part in band.for_person(subject)
            )
            norm = factor * average, factor * np.abs(sd)
        yield CurvePanel(
            title=CLINICAL.title(variable),
            unit=UNITS[kind],
            senses=CLINICAL.senses(variable, "r"),
            strides=curves,
            mean=mean,
            error=error,
            norm=norm,
            least=LEAST[kind],
        )


def _norm(
    page: Mapping[str, Any],
    named: tuple[Bands, str] | None,
    subject: Subject,
    summary: Mapping[str, object],
    manifest: Mapping[str, object],
) -> Norm:
    """That of the user; else of the bands that the result was made with; else what gaitcal brings."""
    if named is not None:
        return own_norm(*named, subject)
    made_with, stored = (
        str(table_of(manifest, "settings").get("normal", "")),
        table_of(summary, "norm"),
    )
    if stored and not stored.get("words"):
        return Norm(remark=str(stored.get("remark", "")))
    if not made_with:
        return norm_for(subject, stride_files.mean_speed(table_of(summary, "spatiotemporal")))
    bands = {}
    for band in page["bands"]:
        kind = next(kind for kind in CurveKind if kind.words == band["kind"])
        name = band["base"] + kind.ending
        average, sd = (np.array(part, dtype=np.float64) for part in band["r"])
        known = np.isfinite(average)
        average = CLINICAL_SIGNS.values(name, average, "r", subject)
        bands[name] = NormalBand(
            variable=name,
            unit=kind.unit,
            signs=CLINICAL_SIGNS,
            percent=np.flatnonzero(known).astype(np.float64),
            mean=average[known],
            sd=sd[known],
            source=band["source"],
        )
    return own_norm(bands, made_with, subject)


def _joints(table: pd.DataFrame) -> Iterator[tuple[str, ...]]:
    """How far each joint was moved, with the largest standard error of its fitted parameters."""
    yield ("joint", "moved, mm", "standard error, mm", "turned, deg", "standard error, deg")
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
        yield (joint_words(str(joint)).capitalize(), *cells)


def _undetermined(table: pd.DataFrame) -> tuple[str, ...]:
    rows = table[(table["status"] == "unidentifiable") & table["joint"].notna()]
    return tuple(
        f"{joint_words(str(joint)).capitalize()}: "
        f"{'; '.join(parameter_words(name) for name in of_joint['name'])}"
        for joint, of_joint in rows.groupby("joint", sort=False)
    )
