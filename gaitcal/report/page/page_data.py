"""Everything that the page tells beside the body in motion, as plain data: `page.json` of the
folder of a result.

person, program     who, made when and with what
verdict, lines      how far it can be believed; the three lines at the top of the page
measures            what steps are called
bands               healthy people, where they are given
trials              curves, events, strides of each (`trial_data`), with sections of their own
sections            preset of the page -> blocks: headings, sentences, tables, pictures of intervals

The page is made from it again at any time; trials of several runs of one person are joined here.
"""

import datetime
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.errors import Code, InputError
from gaitcal.explanations import Bullets, Paragraph, explanation_of, parts_of
from gaitcal.gait import moments, peaks, profile_score, spatiotemporal
from gaitcal.gait.conventions import GROUND_FORCES, Acting, Convention, Signs
from gaitcal.gait.cycles import CurveKind, GaitCycle, coordinate_of, kind_of
from gaitcal.gait.normal_bands import FREE_WORDS, Norm
from gaitcal.io.toml import get_package_version
from gaitcal.model import anthropometry, coordinates, linkage
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

PAGE_DATA: Final = "page.json"
FORMAT: Final = 3
MOST_LETTERS: Final = (
    7_000_000  # Packed curves of all trials of a page together, of the 25 MB that it may have
)
SHOWN_MEASURES: Final = {
    "speed": ("Walking speed", 2),
    "cadence": ("Cadence", 1),
    "stride_length": ("Stride length", 3),
    "stride_time": ("Stride time", 3),
    "step_length": ("Step length", 3),
    "step_width": ("Step width", 3),
    "step_time": ("Step time", 3),
    "stance_percent": ("Stance", 1),
    "swing_percent": ("Swing", 1),
    "double_support_percent": ("Double support", 1),
    "single_support_percent": ("Single support", 1),
}
"""Measure -> its words and decimals in the table of steps and phases; `spatiotemporal.csv` has all
of them.
"""
UNITS: Final = {
    "Nm": (("°", 1, 1.0, ""), ("N·m", 1, 1.0, ""), ("W", 0, 1.0, ""), ("N", 0, 1.0, "")),
    "Nm/kg": (
        ("°", 1, 1.0, ""),
        ("N·m/kg", 2, 1.0, "mass"),
        ("W/kg", 2, 1.0, "mass"),
        ("N/kg", 2, 1.0, "mass"),
    ),
    "%BWH": (
        ("°", 1, 1.0, ""),
        ("%BW·H", 2, 100.0, "bwh"),
        ("W/kg", 2, 1.0, "mass"),
        ("%BW", 1, 100.0, "weight"),
    ),
}
"""Unit of moments on the page -> of each `Kind` words, digits, a factor, and by what of the person
it is divided.
"""
_NO_BACKTICKS: Final = str.maketrans("", "", "`")


def calibration_page_data(
    calibration: Calibration,
    norm: Norm | None = None,
    manifest: Mapping[str, object] | None = None,
    scores: Sequence[profile_score.Score] = (),
) -> dict[str, Any]:
    """Of a calibration.

    `norm`: healthy people, to be drawn behind angles, moments and powers. `manifest`: versions,
    settings and hashes of the inputs. `scores`: how far it is from the norm.
    """
    truth = calibration.truth
    trials = [
        trial_data.trial_page_data(
            calibration.model,
            trial,
            verdict=calibration.verdict.trials.get(trial.name),
            relative_to=calibration.relative_to,
            truth=None if truth is None else truth.of(trial.name),
        )
        for trial in calibration.trials
    ]
    return {
        **person_page_data(calibration.model.subject, calibration.verdict, norm, scores),
        "lines": key_figures.top_lines(calibration, page_peaks(trials)),
        "trials": trials,
        "sections": result_sections(calibration, norm, manifest, scores),
    }


def result_sections(
    calibration: Calibration,
    norm: Norm | None = None,
    manifest: Mapping[str, object] | None = None,
    scores: Sequence[profile_score.Score] = (),
) -> plain_data.Sections:
    """Of the whole result; what belongs to one trial stands with the trial."""
    sections = {
        "clinician": key_figures.clinician_blocks(calibration, norm or Norm(), scores),
        "fit": trust_sections.fit_blocks(calibration),
        "joints": joint_sections.joint_blocks(calibration),
        "trust": trust_sections.trust_blocks(calibration),
        "provenance": provenance.provenance_blocks(calibration, manifest or {}),
    }
    return {preset: blocks for preset, blocks in sections.items() if blocks}


def further_page_data(
    model: SubjectModel,
    trials: Sequence[TrialResult],
    verdict: Verdict,
    relative_to: Mapping[str, float] | None = None,
    origin: provenance.Origin | None = None,
) -> dict[str, Any]:
    """Of further trials of a calibrated person.

    `relative_to`: as of `curves_of`.
    `origin`: the calibration; None where nothing is known of it.
    """
    of_trials = []
    for trial in trials:
        data = trial_data.trial_page_data(
            model, trial, verdict=verdict.trials.get(trial.name), relative_to=relative_to
        )
        of_trials.append(
            {
                **data,
                "sections": {**data["sections"], "provenance": provenance.recorded_blocks(trial)},
            }
        )
    person = person_page_data(model.subject, verdict)
    return {
        **person,
        "lines": [
            verdict_line(person["verdict"]),
            *key_figures.further_lines(model, trials, page_peaks(of_trials)),
        ],
        "trials": of_trials,
        "sections": {} if origin is None else provenance.further_sections(origin),
    }


def person_page_data(
    subject: Subject,
    verdict: Verdict,
    norm: Norm | None = None,
    scores: Sequence[profile_score.Score] = (),
) -> dict[str, Any]:
    """What does not belong to one trial; bands in the units and with the signs of curves."""
    bands, norm = [], norm or Norm()
    for name, band in norm.bands.items():
        sides = {
            s: [
                [plain_data.rounded(value) for value in part]
                for part in band.for_person(subject, s)
            ]
            for s in linkage.SIDES
        }
        bands.append(
            {
                "base": coordinate_of(name),
                "kind": kind_of(name).words,
                "source": band.source,
                **sides,
            }
        )
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
            "facts": [list(fact) for fact in person_facts(subject)],
        },
        "verdict": verdict_page_data(verdict),
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
            "words": norm.words,
            "remark": norm.remark,
            "steps": FREE_WORDS if norm.steps else "",
        },
        "profile": [
            {
                "side": s.side,
                "base": s.variable,
                "title": profile_score.score_title(s),
                "score": rounded_score(s.score),
                "se": rounded_score(s.error),
                "norm": rounded_score(s.norm),
            }
            for s in scores
        ],
    }


def rounded_score(value: float) -> float | None:
    """Deg to a hundredth; None where it is not known."""
    return round(value, 2) if math.isfinite(value) else None


def person_facts(subject: Subject) -> tuple[tuple[str, str], ...]:
    """Label and value of what is known of person and session, as page and report head with it.

    Of whom no age is known, it says so; and by which table the masses start, where that is one of
    adults.
    """
    record = subject.record
    age = "not told" if subject.age is None else f"{subject.age:.1f} years"
    adults = anthropometry.looks_like_child(subject)
    facts = (
        ("Name or code", subject.name),
        (
            "Session",
            ", ".join(filter(None, dict.fromkeys((record.session_date, subject.session))))
            or "date not told",
        ),
        ("Sex", subject.sex or "not told"),
        ("Age", f"{age}, born {record.birth_date}" if record.birth_date else age),
        ("Diagnosis", record.diagnosis),
        ("Affected side", record.affected_side),
        ("Aids", record.aids),
        ("Body mass", f"{subject.mass:.1f} kg"),
        (
            "Height",
            f"{subject.height:.3f} m"
            + (f" ± {subject.height_error:.2f} m" if subject.height_error else ""),
        ),
        ("Segment masses", "adults' table: no age told" if adults else ""),
        ("Laboratory", record.laboratory),
    )
    return tuple((label, value) for label, value in facts if value)


def verdict_page_data(verdict: Verdict) -> dict[str, Any]:
    """Judgement and reasons, the worst first."""
    return {
        "judgement": verdict.judgement.value,
        "sentence": verdict.sentence,
        "forced": verdict.forced,
        "reasons": [
            {
                **explained_code(reason.code),
                "severity": reason.severity.value,
                "cause": moments.explained(reason.cause),
                "evidence": moments.explained(reason.evidence),
                "action": moments.explained(reason.action),
                "trials": list(reason.trials),
                "leg": reason.leg,
            }
            for reason in verdict.reasons
        ],
    }


def verdict_line(verdict: Mapping[str, Any]) -> dict[str, str]:
    """The line at the top of the page that tells the verdict, and its worst reason."""
    judgement = Judgement(verdict["judgement"])
    words = f"{judgement.value.capitalize()}. {verdict['sentence']}"
    if verdict["reasons"]:
        worst, *rest = verdict["reasons"]
        where = (
            f" ({', '.join(plain_data.visible(name) for name in worst['trials'])})"
            if worst["trials"]
            else ""
        )
        words += f" {'Worst' if rest else 'Because'}: {worst['cause']}{where}."
    return {"tone": key_figures.TONES[judgement], "text": plain_data.visible(words)}


def explained_code(code: Code) -> dict[str, Any]:
    """`code`, `title` and `page` of a reason: what `gaitcal explain` says, as blocks, to be there
    without a network.
    """
    explanation = explanation_of(code)
    blocks: list[plain_data.Block] = []
    for part, pieces in parts_of(explanation.text):
        blocks.append(plain_data.heading(part, 3))
        for piece in pieces:
            if isinstance(piece, Paragraph):
                blocks.append(plain_data.text(piece.text.translate(_NO_BACKTICKS)))
            elif isinstance(piece, Bullets):
                blocks.append(
                    plain_data.bullets(item.translate(_NO_BACKTICKS) for item in piece.items)
                )
            else:
                blocks.append(plain_data.text(" ".join(piece.lines), "soft"))
    return {"code": code.value, "title": explanation.title, "page": blocks}


def coordinate_rows() -> list[dict[str, Any]]:
    """Small multiples: joints with their coordinates, and the power over all axes."""
    rows = (*coordinates.COORDINATE_TABLE.values(), *coordinates.SEGMENT_ANGLES.values())
    return [
        {
            "joint": key,
            "title": group.title,
            "power": group.power or None,
            "rows": [row.name for row in rows if row.group == key],
        }
        for key, group in coordinates.GROUPS.items()
    ]


def conventions_data() -> dict[str, Any]:
    """The joints of curves, and every convention that a reader may choose, as `gait/conventions.py`
    has it.

    `signs`: signs -> whose moment -> `hip_flexion/moment` -> its title, and of each side of a
    stride (empty: over time) the factor of a value in the files, and what a positive one means.
    `units`: unit of moments -> kind -> its words and digits, and by what of the person values are
    divided.
    """
    body, one = Subject(name="", mass=1.0, height=1.0, sex="male"), np.ones(1)
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

    def told(convention: Convention, name: str, kind: CurveKind) -> dict[str, Any]:
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

    return {
        "joints": coordinate_rows(),
        "signs": {
            signs.value: {
                acting.key: {
                    f"{name}/{kind.words}": told(Convention(signs=signs, acting=acting), name, kind)
                    for name, kind in every
                }
                for acting in Acting
            }
            for signs in Signs
        },
        "units": {
            unit: {
                kind.words: dict(zip(("words", "digits", "times", "per"), of, strict=True))
                for kind, of in zip(CurveKind, kinds, strict=True)
            }
            for unit, kinds in UNITS.items()
        },
    }


def page_peaks(trials: Sequence[Mapping[str, Any]]) -> tuple[peaks.PeakMean, ...]:
    """Over the straight strides, or repetitions, of trials of a page."""
    return peaks.peak_means(
        (
            trial["activity"],
            trial["name"],
            s["side"],
            {name: np.array(of, dtype=np.float64) for name, of in s["peaks"].items()},
        )
        for trial in trials
        for s in trial["strides"]
        if not s["turns"]
    )


def page_toe_offs(trials: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Side -> % of the stride at which stance ends, the mean over straight strides of trials of a
    page.
    """
    found: dict[str, list[float]] = {side: [] for side in linkage.SIDES}
    for s in (s for trial in trials for s in trial["strides"] if not s["turns"]):
        if (stance := GaitCycle(s["start"], s["stop"], s["off"]).stance) is not None:
            found[s["side"]].append(stance)
    return {side: float(np.mean(percents)) for side, percents in found.items() if percents}


def peak_page_rows(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of the table of peaks of each activity, over its straight strides, each with what the
    legs have of it.
    """
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for mean in page_peaks(data["trials"]):
        peak = mean.peak
        row = {
            "activity": mean.activity,
            "base": coordinate_of(peak.variable),
            "kind": kind_of(peak.variable).words,
            "title": peak.title(),
            "external": peak.title(external=True),
            "window": peak.words,
            "apart": peak.figure is peaks.PeakKind.RANGE,
        }
        figures = {"mean": mean.mean, "sd": mean.sd, "se": mean.se, "percent": mean.percent}
        leg = {name: plain_data.rounded(value) for name, value in figures.items()}
        rows.setdefault((mean.activity, peak.name), row)[mean.side] = {
            **leg,
            "n": mean.n,
            "strides": mean.strides,
        }
    return list(rows.values())


def thinned(data: Mapping[str, Any], most: int = MOST_LETTERS) -> Mapping[str, Any]:
    """Page data with at most so many letters of packed curves, of every second, third, ... frame;
    as it is where it has no more.
    """
    every = max(1, -(-sum(map(plain_data.curve_letters, data["trials"])) // most))
    return (
        data
        if every == 1
        else {
            **data,
            "trials": [plain_data.thinned_trial(trial, every) for trial in data["trials"]],
        }
    )


def curves_left_out(data: Mapping[str, Any]) -> tuple[str, ...]:
    """A sentence for every trial whose curves hold some frames only."""
    return tuple(
        f"{trial['name']}: its curves hold one frame in {trial['every']} of {trial['frames']}; a "
        "short peak may be "
        "lower in the page than in the tables"
        for trial in data["trials"]
        if trial["every"] > 1
    )


def write_page_data(data: Mapping[str, Any], path: Path) -> None:
    """Write page data; the page reads the same text."""
    path.write_text(plain_data.script_json(data), encoding="utf-8")


def read_page_data(path: Path) -> dict[str, Any]:
    """Read back what `write_page_data` wrote.

    Raises InputError: The file is not there, or is no page data of this version.
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
