"""The sheet of a result: everything that its page tells beside the body in motion, as plain data.

person, program     who, made when and with what
verdict, lines      how far it can be believed; the three lines at the top of the page
rows, measures      what curves and steps are called, and what their signs mean
bands               healthy people, where they are given
trials              curves, events, strides of each (`trial_sheet`), with sections of their own
sections            preset of the page -> blocks: headings, sentences, tables, pictures of intervals
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from typing import Any, Final

from gaitcal.faults.verdict import Verdict
from gaitcal.gait.normal_bands import Bands
from gaitcal.gait.spatiotemporal import MEASURES
from gaitcal.gait.variables import coordinate_of, kind_of
from gaitcal.gait.words import explained
from gaitcal.io.package_data import package_version
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.page.sections.further import Origin, further_lines, further_sections, recorded_blocks
from gaitcal.page.sections.sections import result_lines, result_sections
from gaitcal.page.sheet.explained import explained_code
from gaitcal.page.sheet.merging import verdict_line
from gaitcal.page.sheet.rows import sheet_rows
from gaitcal.page.sheet.trial_sheet import trial_sheet
from gaitcal.page.steps import SHOWN
from gaitcal.session.result import Calibration, TrialResult

FORMAT: Final = 1


def further_sheet(
    model: SubjectModel,
    trials: Sequence[TrialResult],
    verdict: Verdict,
    relative_to: Mapping[str, float] | None = None,
    origin: Origin | None = None,
) -> dict[str, Any]:
    """The sheet of further trials of a calibrated person.

    Parameters
    ----------
    relative_to : as of `curves_of`.
    origin : the calibration; None where nothing is known of it.
    """
    told = []
    for trial in trials:
        sheet = trial_sheet(model, trial, verdict=verdict.trials.get(trial.name), relative_to=relative_to)
        told.append({**sheet, "sections": {**sheet["sections"], "provenance": recorded_blocks(trial)}})
    person = person_sheet(model.subject, verdict)
    return {
        **person,
        "lines": [verdict_line(person["verdict"]), *(line.as_data() for line in further_lines(model, trials))],
        "trials": told,
        "sections": {} if origin is None else further_sections(origin),
    }


def calibration_sheet(
    calibration: Calibration, normal: Bands | None = None, manifest: Mapping[str, object] | None = None
) -> dict[str, Any]:
    """The sheet of a calibration.

    `normal`: bands of healthy people, to be drawn behind angles, moments and powers. `manifest`: versions, settings
    and hashes of the inputs.
    """
    truth = calibration.truth
    return {
        **person_sheet(calibration.model.subject, calibration.verdict, normal),
        "lines": [line.as_data() for line in result_lines(calibration)],
        "trials": [
            trial_sheet(
                calibration.model,
                trial,
                verdict=calibration.verdict.trials.get(trial.name),
                relative_to=calibration.relative_to,
                truth=None if truth is None else truth.of(trial.name),
            )
            for trial in calibration.trials
        ],
        "sections": result_sections(calibration, normal, manifest),
    }


def person_sheet(subject: Subject, verdict: Verdict, normal: Bands | None = None) -> dict[str, Any]:
    """What does not belong to one trial."""
    return {
        "format": FORMAT,
        "program": f"gaitcal {package_version('gaitcal')}",
        "made": datetime.datetime.now().astimezone().strftime("%d %B %Y, %H:%M").lstrip("0"),
        "person": {
            "name": subject.name,
            "session": subject.session,
            "mass": subject.mass,
            "height": subject.height,
            "sex": subject.sex,
            "weight": subject.weight,
            "bwh": subject.bwh,
        },
        "verdict": verdict_sheet(verdict),
        "lines": [],
        "rows": sheet_rows(),
        "measures": [
            {"name": name, "title": title, "digits": digits, "unit": MEASURES[name]}
            for name, (title, digits) in SHOWN.items()
        ],
        "bands": _bands(normal or {}, subject),
    }


def verdict_sheet(verdict: Verdict) -> dict[str, Any]:
    """Judgement, reasons (the worst first), and each walk."""
    return {
        "judgement": verdict.judgement.value,
        "sentence": verdict.sentence,
        "forced": verdict.forced,
        "reasons": [
            {
                **explained_code(reason.code),
                "severity": reason.severity.value,
                "cause": explained(reason.cause),
                "evidence": explained(reason.evidence),
                "action": explained(reason.action),
                "trials": list(reason.trials),
                "leg": reason.leg,
            }
            for reason in verdict.reasons
        ],
    }


def _bands(normal: Bands, subject: Subject) -> list[dict[str, Any]]:
    """In the units and with the signs of curves: deg, internal N·m with OpenSim's signs, W, N."""
    out = []
    for name, band in normal.items():
        sides = {side: [_rounded(values) for values in band.for_person(subject, side)] for side in "rl"}
        out.append({"base": coordinate_of(name), "kind": kind_of(name).words, "source": band.source, **sides})
    return out


def _rounded(values: Any) -> list[float | None]:
    return [None if value != value else round(float(value), 4) for value in values]
