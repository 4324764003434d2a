"""Sheets of one person joined: the trials of several runs, with what was said of each."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from gaitcal.codes import Code
from gaitcal.faults.verdict import Judgement, TrialVerdict, Verdict
from gaitcal.page.sections.blocks import visible
from gaitcal.page.sections.lines import TONES
from gaitcal.page.sheet.explained import explained_code


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
