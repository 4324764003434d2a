"""The sheet of a result: everything that its page tells beside the body in motion, as plain data.

person, program     who, made when and with what
verdict, lines      how far it can be believed; the three lines at the top of the page
rows, measures      what curves and steps are called, and what their signs mean
bands               healthy people, where they are given
trials              curves, events, strides of each (`trial_sheet`), with sections of their own
sections            preset of the page -> blocks: headings, sentences, tables, pictures of intervals

Curves of every second, third, ... frame only, where all trials together would be more than a page may hold.

Sheets of one person joined: the trials of several runs, with what was said of each.

`page.json` of a result folder: the sheet, from which its page is made again at any time.
"""

from __future__ import annotations

import base64
import datetime
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.faults.verdict import Judgement, TrialVerdict, Verdict
from gaitcal.gait.cycles import coordinate_of, kind_of
from gaitcal.gait.moments import explained
from gaitcal.gait.normal_bands import Bands
from gaitcal.gait.spatiotemporal import MEASURES
from gaitcal.io.toml import package_version
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.page.packing import base64_of
from gaitcal.page.sections.blocks import visible
from gaitcal.page.sections.fit import Origin, further_lines, further_sections, recorded_blocks
from gaitcal.page.sections.provenance import TONES
from gaitcal.page.sections.sections import result_lines, result_sections
from gaitcal.page.sheet.rows import explained_code, sheet_rows
from gaitcal.page.sheet.trial_sheet import trial_sheet
from gaitcal.page.steps import SHOWN
from gaitcal.session.result import Calibration, TrialResult


def merged(earlier: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """A sheet of further trials, after those of an earlier one that it does not hold itself."""
    names = {trial["name"] for trial in new["trials"]}
    kept = only(earlier, [trial["name"] for trial in earlier["trials"] if trial["name"] not in names])
    verdict, rest = _joined(kept, new), list(new["lines"][1:])
    if kept["trials"]:
        last = ", ".join(visible(name) for name in sorted(names))
        rest[-1:] = [{**line, "text": f"{last}: {line['text']}"} for line in rest[-1:]]
    lines = [verdict_line(verdict), *rest]
    return {**new, "trials": [*kept["trials"], *new["trials"]], "verdict": verdict, "lines": lines}


def followed_by(sheet: Mapping[str, Any], further: Mapping[str, Any]) -> dict[str, Any]:
    """The sheet of a calibration with further trials after its own; none of them may have the name of its own."""
    verdict, lines = _joined(sheet, further), list(sheet["lines"])
    if verdict["sentence"] != sheet["verdict"]["sentence"]:
        lines[:1] = [verdict_line(verdict)]
    return {
        **sheet,
        "lines": lines,
        "trials": [*sheet["trials"], *further["trials"]],
        "verdict": verdict,
        "bands": sheet["bands"] or further["bands"],
    }


def verdict_line(verdict: Mapping[str, Any]) -> dict[str, str]:
    """The line at the top of the page that tells the verdict, and its worst reason."""
    judgement = Judgement(verdict["judgement"])
    words = f"{judgement.value.capitalize()}. {verdict['sentence']}"
    if verdict["reasons"]:
        worst, *rest = verdict["reasons"]
        where = f" ({', '.join(visible(name) for name in worst['trials'])})" if worst["trials"] else ""
        words += f" {'Worst' if rest else 'Because'}: {worst['cause']}{where}."
    return {"tone": TONES[judgement], "text": visible(words)}


def only(sheet: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """A sheet of further trials with some of them alone, and the reasons about these."""
    trials = [trial for trial in sheet["trials"] if trial["name"] in names]
    about = [reason for reason in sheet["verdict"]["reasons"] if set(reason["trials"]) & set(names)]
    judgement = _of_all(trial["verdict"]["judgement"] for trial in trials if trial["verdict"] is not None)
    if about and judgement is Judgement.TRUSTWORTHY:
        judgement = Judgement.DOUBTFUL
    return {**sheet, "trials": trials, "verdict": {**sheet["verdict"], "judgement": judgement.value, "reasons": about}}


def doubted(sheet: Mapping[str, Any], doubts: Iterable[tuple[str, str, str]]) -> dict[str, Any]:
    """A sheet with a warning more for each (trial, what is wrong with it, what to do), unless it is there already."""
    verdict = sheet["verdict"]
    known = {(reason["cause"], *reason["trials"]) for reason in verdict["reasons"]}
    new = [
        {
            **explained_code(Code.RESULT_EDITED),
            "severity": "warning",
            "cause": cause,
            "evidence": "",
            "action": action,
            "trials": [name],
            "leg": "",
        }
        for name, cause, action in doubts
        if (cause, name) not in known
    ]
    if not new:
        return dict(sheet)
    good = verdict["judgement"] == Judgement.TRUSTWORTHY.value
    word = {"judgement": Judgement.DOUBTFUL.value} if good else {}
    return {**sheet, "verdict": {**verdict, **word, "reasons": [*verdict["reasons"], *new]}}


def renamed(sheet: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """A sheet whose trials have other names: old -> new."""
    reasons = [
        {**reason, "trials": [names.get(name, name) for name in reason["trials"]]}
        for reason in sheet["verdict"]["reasons"]
    ]
    trials = [{**trial, "name": names.get(trial["name"], trial["name"])} for trial in sheet["trials"]]
    return {**sheet, "trials": trials, "verdict": {**sheet["verdict"], "reasons": reasons}}


def _joined(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """The verdict on both: refused or trustworthy where everything is, and doubtful otherwise."""
    trials = [*one["trials"], *other["trials"]]
    parts = [sheet["verdict"] for sheet in (one, other) if sheet["trials"]]
    whole = _of_all(part["judgement"] for part in parts)
    reasons = [reason for part in parts for reason in part["reasons"]]
    judged = Verdict(
        judgement=whole,
        reasons=(),
        trials={trial["name"]: _read(trial["verdict"]) for trial in trials if trial["verdict"] is not None},
        forced=any(part.get("forced", False) for part in parts),
    )
    severe = sorted(reasons, key=lambda reason: reason["severity"] != "error")
    return {"judgement": whole.value, "sentence": judged.sentence, "reasons": severe, "forced": judged.forced}


def _of_all(judgements: Iterable[str]) -> Judgement:
    """What all are; doubtful where they differ, trustworthy where there are none."""
    found = {Judgement(name) for name in judgements} or {Judgement.TRUSTWORTHY}
    return found.pop() if len(found) == 1 else Judgement.DOUBTFUL


def _read(verdict: Mapping[str, str]) -> TrialVerdict:
    legs = {side: Judgement(verdict[side]) for side in "rl" if side in verdict}
    return TrialVerdict(judgement=Judgement(verdict["judgement"]), legs=legs)


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


MOST_LETTERS: Final = 7_000_000
"""Packed curves of all trials of a page together, of the 25 MB that it may have."""
_PARTS: Final = ("value", "se", "own", "nominal", "truth")


def thinned(sheet: Mapping[str, Any], most: int = MOST_LETTERS) -> Mapping[str, Any]:
    """The sheet with at most so many letters of packed curves; as it is where it has no more."""
    letters = sum(_letters(trial) for trial in sheet["trials"])
    every = max(1, -(-letters // most))
    return sheet if every == 1 else {**sheet, "trials": [_thinned(trial, every) for trial in sheet["trials"]]}


def curves_left_out(sheet: Mapping[str, Any]) -> tuple[str, ...]:
    """A sentence for every trial whose curves hold some frames only."""
    return tuple(
        f"{trial['name']}: its curves hold one frame in {trial['every']} of {trial['frames']}; a short peak may be "
        "lower in the page than in the tables"
        for trial in sheet["trials"]
        if trial["every"] > 1
    )


def _letters(trial: Mapping[str, Any]) -> int:
    return sum(len(part["data"]) for curve in trial["curves"] for name in _PARTS if (part := curve[name]) is not None)


def _thinned(trial: Mapping[str, Any], every: int) -> dict[str, Any]:
    def part(packed: Mapping[str, Any] | None) -> dict[str, Any] | None:
        return None if packed is None else {**packed, "data": _kept(packed["data"], "<i2", every)}

    return {
        **trial,
        "every": trial["every"] * every,
        "time": _kept(trial["time"], "<f4", every),
        "masks": [_kept(mask, "<u1", every) for mask in trial["masks"]],
        "curves": [{**curve, **{name: part(curve[name]) for name in _PARTS}} for curve in trial["curves"]],
    }


def _kept(data: str, numbers: str, every: int) -> str:
    return base64_of(np.frombuffer(base64.b64decode(data), dtype=numbers)[::every])


SHEET: Final = "page.json"


def sheet_text(sheet: Mapping[str, Any] | None) -> str:
    """JSON that is all ASCII and may stand inside a `<script>` element whatever the names are: it holds no `<`."""
    return json.dumps(sheet, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def write_sheet(sheet: Mapping[str, Any], path: Path) -> None:
    """Write a sheet; the page reads the same text."""
    path.write_text(sheet_text(sheet), encoding="utf-8")


def read_sheet(path: Path) -> dict[str, Any]:
    """Read back what `write_sheet` wrote.

    Raises
    ------
    InputError
        The file is not there, or is no sheet of this version.
    """
    try:
        sheet = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", source=path, code=Code.DAMAGED_RESULT) from None
    if not isinstance(sheet, dict) or sheet.get("format") != FORMAT or not isinstance(sheet.get("trials"), list):
        raise InputError("is no page of this version; calibrate again", source=path, code=Code.NO_RESULT)
    return sheet
