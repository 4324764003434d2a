"""Page data of several runs of one person, joined: further trials after those of a calibration, and some alone."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from gaitcal.errors import Code
from gaitcal.faults.verdict import Judgement, Verdict, WalkVerdict
from gaitcal.model.linkage import SIDES
from gaitcal.page.page_data import explained_code, verdict_line
from gaitcal.page.plain_data import visible


def merged(earlier: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """Page data of further trials, after those of an earlier run that it does not hold itself."""
    names = {trial["name"] for trial in new["trials"]}
    kept = only(earlier, [trial["name"] for trial in earlier["trials"] if trial["name"] not in names])
    verdict, rest = _joined_verdict(kept, new), list(new["lines"][1:])
    if kept["trials"]:
        last = ", ".join(visible(name) for name in sorted(names))
        rest[-1:] = [{**line, "text": f"{last}: {line['text']}"} for line in rest[-1:]]
    trials = [*kept["trials"], *new["trials"]]
    return {**new, "trials": trials, "verdict": verdict, "lines": [verdict_line(verdict), *rest]}


def followed_by(data: Mapping[str, Any], further: Mapping[str, Any]) -> dict[str, Any]:
    """Page data of a calibration with further trials after its own; none of them may have the name of its own."""
    verdict, lines = _joined_verdict(data, further), list(data["lines"])
    if verdict["sentence"] != data["verdict"]["sentence"]:
        lines[:1] = [verdict_line(verdict)]
    return {
        **data,
        "lines": lines,
        "trials": [*data["trials"], *further["trials"]],
        "verdict": verdict,
        "bands": data["bands"] or further["bands"],
    }


def only(data: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """Page data of further trials with some of them alone, and the reasons about these."""
    trials = [trial for trial in data["trials"] if trial["name"] in names]
    about = [reason for reason in data["verdict"]["reasons"] if set(reason["trials"]) & set(names)]
    judgement = _common(trial["verdict"]["judgement"] for trial in trials if trial["verdict"] is not None)
    if about and judgement is Judgement.TRUSTWORTHY:
        judgement = Judgement.DOUBTFUL
    return {**data, "trials": trials, "verdict": {**data["verdict"], "judgement": judgement.value, "reasons": about}}


def doubted(data: Mapping[str, Any], doubts: Iterable[tuple[str, str, str]]) -> dict[str, Any]:
    """Page data with a warning more for each (trial, what is wrong with it, what to do), unless it is there already."""
    verdict = data["verdict"]
    known = {(reason["cause"], *reason["trials"]) for reason in verdict["reasons"]}
    code = explained_code(Code.RESULT_EDITED)
    new = [
        {**code, "severity": "warning", "cause": cause, "evidence": "", "action": action, "trials": [name], "leg": ""}
        for name, cause, action in doubts
        if (cause, name) not in known
    ]
    if not new:
        return dict(data)
    judgement = verdict["judgement"]
    if judgement == Judgement.TRUSTWORTHY.value:
        judgement = Judgement.DOUBTFUL.value
    return {**data, "verdict": {**verdict, "judgement": judgement, "reasons": [*verdict["reasons"], *new]}}


def renamed(data: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Page data whose trials have other names: old -> new."""
    reasons = [
        {**reason, "trials": [names.get(name, name) for name in reason["trials"]]}
        for reason in data["verdict"]["reasons"]
    ]
    trials = [{**trial, "name": names.get(trial["name"], trial["name"])} for trial in data["trials"]]
    return {**data, "trials": trials, "verdict": {**data["verdict"], "reasons": reasons}}


def _joined_verdict(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """The verdict on both: refused or trustworthy where everything is, and doubtful otherwise."""
    parts = [data["verdict"] for data in (one, other) if data["trials"]]
    trials = {}
    for trial in (*one["trials"], *other["trials"]):
        if (verdict := trial["verdict"]) is not None:
            legs = {side: Judgement(verdict[side]) for side in SIDES if side in verdict}
            trials[trial["name"]] = WalkVerdict(judgement=Judgement(verdict["judgement"]), legs=legs)
    judged = Verdict(
        judgement=_common(part["judgement"] for part in parts),
        reasons=(),
        trials=trials,
        forced=any(part.get("forced", False) for part in parts),
    )
    reasons = sorted((r for part in parts for r in part["reasons"]), key=lambda reason: reason["severity"] != "error")
    return {
        "judgement": judged.judgement.value,
        "sentence": judged.sentence,
        "reasons": reasons,
        "forced": judged.forced,
    }


def _common(judgements: Iterable[str]) -> Judgement:
    """What all are; doubtful where they differ, trustworthy where there are none."""
    found = {Judgement(name) for name in judgements} or {Judgement.TRUSTWORTHY}
    return found.pop() if len(found) == 1 else Judgement.DOUBTFUL
