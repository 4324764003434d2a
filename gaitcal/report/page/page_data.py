"""Page data: everything on the page except the body in motion, as `page.json` of a result.

person, program     subject; date and version
verdict, lines      the verdict; the three lines on top of the page
measures            titles of spatiotemporal measures
bands               normative data, if there are any
trials              curves, events, strides and sections of each trial (`trial_data`)
sections            preset of the page -> blocks: headings, text, tables, pictures of intervals

The page can be made from it again at any time.
"""

import datetime
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.errors import Code, InputError
from gaitcal.explanations import Bullets, Paragraph, load_explanation, split_parts
from gaitcal.gait import moments, peaks, profile_score, spatiotemporal
from gaitcal.gait.conventions import GROUND_FORCES, Acting, Convention, Signs
from gaitcal.gait.cycles import CurveKind, get_coordinate, get_curve_kind
from gaitcal.gait.normal_bands import FREE_LABEL
from gaitcal.io.toml import get_package_version
from gaitcal.model import coordinates, linkage
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.quality.verdict import Judgement, Verdict
from gaitcal.report.page import (
    joint_sections,
    key_figures,
    plain_data,
    provenance,
    trial_data,
    trust_sections,
)
from gaitcal.results.normal_curves import NO_NORM, NormTables
from gaitcal.results.result_tables import ResultTables, build_result_tables
from gaitcal.results.shown_labels import PAGE_UNITS, SHOWN_MEASURES, list_person_facts
from gaitcal.results.stride_tables import StrideTables

PAGE_DATA: Final = "page.json"
FORMAT: Final = 3
MOST_LETTERS: Final = (
    7_000_000  # Packed curves of all trials of a page together, of the 25 MB that it may have
)
_NO_BACKTICKS: Final = str.maketrans("", "", "`")


def build_calibration_page_data(
    calibration: Calibration, tables: ResultTables | None = None
) -> dict[str, Any]:
    """Build the page data of a calibration.

    Parameters
    ----------
    calibration
        A finished calibration.
    tables
        Its tables; None: built here, without normative data.

    Returns
    -------
    dict
        The content of `page.json`.
    """
    tables = tables or build_result_tables(calibration)
    truth, norm, scores = calibration.truth, tables.norm, tables.scores
    trials = [
        trial_data.build_trial_page_data(
            calibration.model,
            trial,
            tables.strides,
            verdict=calibration.verdict.trials.get(trial.name),
            relative=calibration.relative_to is not None,
            truth=None if truth is None else truth.get_curves(trial.name),
        )
        for trial in calibration.trials
    ]
    return {
        **_build_person_page_data(calibration.model.subject, calibration.verdict, norm, scores),
        "lines": key_figures.build_top_lines(calibration, tables.strides),
        "trials": trials,
        "sections": build_result_sections(calibration, norm, tables.manifest, scores),
    }


def build_result_sections(
    calibration: Calibration,
    norm: NormTables = NO_NORM,
    manifest: Mapping[str, object] | None = None,
    scores: Sequence[profile_score.Score] = (),
) -> plain_data.Sections:
    """Build the sections of the whole result; those of one trial are stored with the trial."""
    sections = {
        "clinician": key_figures.build_clinician_blocks(calibration, norm, scores),
        "fit": trust_sections.build_fit_blocks(calibration),
        "joints": joint_sections.build_joint_blocks(calibration),
        "trust": trust_sections.build_trust_blocks(calibration),
        "provenance": provenance.build_provenance_blocks(calibration, manifest or {}),
    }
    return {preset: blocks for preset, blocks in sections.items() if blocks}


def build_further_page_data(
    model: SubjectModel,
    trials: Sequence[TrialResult],
    tables: StrideTables,
    verdict: Verdict,
    norm: NormTables = NO_NORM,
    origin: provenance.Origin | None = None,
) -> dict[str, Any]:
    """Build the page data of further trials of a calibrated subject.

    Parameters
    ----------
    model
        The calibrated subject.
    trials
        The further trials.
    tables
        Their curves and strides.
    verdict
        On these trials.
    norm
        Normative data of the calibration, whose curves are drawn.
    origin
        The calibration; None if unknown.

    Returns
    -------
    dict
        The content of `page.json`.
    """
    of_trials = []
    for trial in trials:
        data = trial_data.build_trial_page_data(
            model,
            trial,
            tables,
            verdict=verdict.trials.get(trial.name),
            relative=bool(tables.relative_lines),
        )
        of_trials.append(
            {
                **data,
                "sections": {
                    **data["sections"],
                    "provenance": provenance.build_recording_blocks(trial),
                },
            }
        )
    person = _build_person_page_data(model.subject, verdict, NormTables(curves=norm.curves))
    return {
        **person,
        "lines": [
            format_verdict_line(person["verdict"]),
            *key_figures.build_further_lines(model, trials, tables),
        ],
        "trials": of_trials,
        "sections": {} if origin is None else provenance.build_further_sections(origin),
    }


def _build_person_page_data(
    subject: Subject,
    verdict: Verdict,
    norm: NormTables = NO_NORM,
    scores: Sequence[profile_score.Score] = (),
) -> dict[str, Any]:
    """Build the page data that belong to no single trial; bands in the units of the curves."""
    bands = []
    for name, curve in norm.curves.items():
        entry: dict[str, Any] = {
            "base": get_coordinate(name),
            "kind": get_curve_kind(name).label,
            "source": curve.source,
        }
        # Mean and standard deviation over the stride, in the unit of the curves.
        for side, parts in curve.sides.items():
            entry[side] = [list(map(plain_data.round_number, part)) for part in parts]
        bands.append(entry)
    return {
        "format": FORMAT,
        "program": f"gaitcal {get_package_version('gaitcal')}",
        "made": datetime.datetime.now().astimezone().strftime("%d %B %Y, %H:%M").lstrip("0"),
        "person": {
            "name": subject.name,
            "session": subject.session,
            "mass": subject.mass,
            "height": subject.height,
            "sex": subject.sex,
            "weight": subject.weight,
            "bwh": subject.bwh,
            "facts": [list(fact) for fact in list_person_facts(subject)],
        },
        "verdict": build_verdict_page_data(verdict),
        "lines": [],
        "measures": [
            {
                "name": name,
                "title": title,
                "digits": digits,
                "unit": spatiotemporal.MEASURES[name],
                "least": spatiotemporal.LEAST_SD[spatiotemporal.MEASURES[name]],
                "compared": name not in spatiotemporal.OF_BOTH_LEGS,
                "norm": list(norm.steps.get(name, ())),
            }
            for name, (title, digits) in SHOWN_MEASURES.items()
        ],
        "bands": bands,
        "norm": {
            "words": norm.label,
            "remark": norm.remark,
            "steps": FREE_LABEL if norm.steps else "",
        },
        "profile": [
            {
                "side": s.side,
                "base": s.variable,
                "title": profile_score.make_score_title(s),
                "score": _round_score(s.score),
                "se": _round_score(s.error),
                "norm": _round_score(s.norm),
            }
            for s in scores
        ],
    }


def _round_score(value: float) -> float | None:
    """Round a score to a hundredth of a degree; None if unknown."""
    return round(value, 2) if math.isfinite(value) else None


def build_verdict_page_data(verdict: Verdict) -> dict[str, Any]:
    """Build verdict and reasons, the most severe first."""
    return {
        "judgement": verdict.judgement.value,
        "sentence": verdict.sentence,
        "forced": verdict.forced,
        "reasons": [
            {
                **explain_code(reason.code),
                "severity": reason.severity.value,
                "cause": moments.explain_parameters(reason.cause),
                "evidence": moments.explain_parameters(reason.evidence),
                "action": moments.explain_parameters(reason.action),
                "trials": list(reason.trials),
                "leg": reason.leg,
            }
            for reason in verdict.reasons
        ],
    }


def format_verdict_line(verdict: Mapping[str, Any]) -> dict[str, str]:
    """Format the line on top of the page: the verdict with its most severe reason."""
    judgement = Judgement(verdict["judgement"])
    text = f"{judgement.value.capitalize()}. {verdict['sentence']}"
    if verdict["reasons"]:
        worst, *others = verdict["reasons"]
        where = ""
        if worst["trials"]:
            trials = [plain_data.replace_control_characters(name) for name in worst["trials"]]
            where = f" ({', '.join(trials)})"
        text += f" {'Worst' if others else 'Because'}: {worst['cause']}{where}."
    return {
        "tone": key_figures.TONES[judgement],
        "text": plain_data.replace_control_characters(text),
    }


def explain_code(code: Code) -> dict[str, Any]:
    """Return `code`, `title` and `page` of a reason: the text of `gaitcal explain` as blocks."""
    explanation = load_explanation(code)
    blocks: list[plain_data.Block] = []
    for part, pieces in split_parts(explanation.text):
        blocks.append(plain_data.make_heading(part, 3))
        for piece in pieces:
            if isinstance(piece, Paragraph):
                blocks.append(plain_data.make_text(piece.text.translate(_NO_BACKTICKS)))
            elif isinstance(piece, Bullets):
                blocks.append(
                    plain_data.make_list(item.translate(_NO_BACKTICKS) for item in piece.items)
                )
            else:
                blocks.append(plain_data.make_text(" ".join(piece.lines), "soft"))
    return {"code": code.value, "title": explanation.title, "page": blocks}


def list_coordinate_rows() -> list[dict[str, Any]]:
    """List joints with their coordinates and joint power, one row of small plots each."""
    rows = (*coordinates.COORDINATE_TABLE.values(), *coordinates.SEGMENT_ANGLES.values())
    out = []
    for key, group in coordinates.GROUPS.items():
        names = [row.name for row in rows if row.group == key]
        entry = {"joint": key, "title": group.title, "power": group.power or None, "rows": names}
        out.append(entry)
    return out


def build_conventions() -> dict[str, Any]:
    """Build the joints of curves and all conventions of the page (`gait/conventions.py`).

    `signs`: signs -> acting body -> `hip_flexion/moment` -> title and, for each side of a stride
    (empty: over time), the factor of a value in the files and the meaning of positive values.
    `units`: unit of moments -> kind -> title, digits, factor and divisor of values.
    """
    body, one = Subject(name="", mass=1.0, height=1.0, sex="male"), np.ones(1)
    # A power is that of a joint, over all of its axes.
    powers = {group.power: " over all axes" for group in coordinates.GROUPS.values() if group.power}
    moved = [
        (name, kind)
        for name in coordinates.COORDINATE_TABLE
        for kind in (CurveKind.ANGLE, CurveKind.MOMENT, CurveKind.POWER)
    ]
    moved += [(name, CurveKind.ANGLE) for name in coordinates.SEGMENT_ANGLES]
    every = (
        *moved,
        *((name, CurveKind.POWER) for name in powers),
        *((name, CurveKind.FORCE) for name in GROUND_FORCES),
    )

    def describe(convention: Convention, name: str, kind: CurveKind) -> dict[str, Any]:
        variable = name if kind is CurveKind.FORCE else f"{name}{kind.ending}"
        sides = {
            side: [
                float(convention.values(variable, one, side, body)[0]),
                convention.senses(variable, side)[0]
                + (powers.get(name, "") if kind is CurveKind.POWER else ""),
            ]
            for side in (*linkage.SIDES, "")
        }
        return {"title": convention.title(variable), **sides}

    by_signs: dict[str, dict[str, Any]] = {}
    for signs, acting in itertools.product(Signs, Acting):
        # The browser switches conventions without knowing any rule: every sign and word is in the
        # page.
        convention = Convention(signs=signs, acting=acting)
        by_signs.setdefault(signs.value, {})[acting.key] = {
            f"{name}/{kind.label}": describe(convention, name, kind) for name, kind in every
        }
    units: dict[str, dict[str, Any]] = {}
    for unit, kinds in PAGE_UNITS.items():
        units[unit] = {}
        for kind, values in kinds.items():
            keys = ("words", "digits", "times", "per")
            units[unit][kind.label] = dict(zip(keys, values, strict=True))
    return {"joints": list_coordinate_rows(), "signs": by_signs, "units": units}


def build_peak_rows(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Build the rows of the table of peaks of each activity, over its straight strides."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    means = peaks.average_peaks(
        (
            trial["activity"],
            trial["name"],
            s["side"],
            {name: np.array(values, dtype=np.float64) for name, values in s["peaks"].items()},
        )
        for trial in data["trials"]
        for s in trial["strides"]
        if not s["turns"]
    )
    for mean in means:
        peak = mean.peak
        row = {
            "activity": mean.activity,
            "base": get_coordinate(peak.variable),
            "kind": get_curve_kind(peak.variable).label,
            "title": peak.make_title(),
            "external": peak.make_title(external=True),
            "window": peak.window_label,
            "apart": peak.figure is peaks.PeakKind.RANGE,
        }
        figures = {"mean": mean.mean, "sd": mean.sd, "se": mean.se, "percent": mean.percent}
        leg = {name: plain_data.round_number(value) for name, value in figures.items()}
        rows.setdefault((mean.activity, peak.name), row)[mean.side] = {
            **leg,
            "n": mean.n,
            "strides": mean.strides,
        }
    return list(rows.values())


def thin_page_data(data: Mapping[str, Any], most: int = MOST_LETTERS) -> Mapping[str, Any]:
    """Thin the curves to at most `most` characters: every second, third, ... frame stays."""
    every = max(1, -(-sum(map(plain_data.count_curve_letters, data["trials"])) // most))
    return (
        data
        if every == 1
        else {**data, "trials": [plain_data.thin_trial(trial, every) for trial in data["trials"]]}
    )


def report_thinned_curves(data: Mapping[str, Any]) -> tuple[str, ...]:
    """Report every trial whose curves contain only some of its frames."""
    return tuple(
        f"{trial['name']}: its curves show one frame in {trial['every']} of {trial['frames']}; a "
        "short peak may be "
        "lower in the page than in the tables"
        for trial in data["trials"]
        if trial["every"] > 1
    )


def write_page_data(data: Mapping[str, Any], path: Path) -> None:
    """Write page data; the page contains the same text."""
    path.write_text(plain_data.dump_script_json(data), encoding="utf-8")


def read_page_data(path: Path) -> dict[str, Any]:
    """Read page data.

    Parameters
    ----------
    path
        `page.json`.

    Returns
    -------
    dict
        As `write_page_data` wrote it.

    Raises
    ------
    InputError
        The file is missing, or has another format version.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        message = f"is no result of 'gaitcal calibrate': found no {path.name} in it"
        raise InputError(message, source=path.parent, code=Code.NO_RESULT) from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot be read: {error}", source=path, code=Code.DAMAGED_RESULT
        ) from None
    if (
        not isinstance(data, dict)
        or data.get("format") != FORMAT
        or not isinstance(data.get("trials"), list)
    ):
        raise InputError(
            "is no page of this version; calibrate again", source=path, code=Code.NO_RESULT
        )
    return data
