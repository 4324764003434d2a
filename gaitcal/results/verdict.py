"""The verdict in `summary.json`: written with a result, read back for what stands on its model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.faults.verdict import Judgement, Verdict, touches_model
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.io.result_folder import read_object
from gaitcal.results.table_file import Json

SUMMARY = "summary.json"


def table_of(content: Mapping[str, object], key: str) -> dict[str, Any]:
    """The object of that name in a JSON file of a result; empty where there is none."""
    found = content.get(key)
    return found if isinstance(found, dict) else {}


def entries_of(content: Mapping[str, object], key: str) -> list[dict[str, Any]]:
    """The objects of a list of that name in a JSON file of a result; none where there is no list."""
    found = content.get(key)
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def verdict_summary(verdict: Verdict) -> dict[str, Json]:
    """Entries `verdict`, `reasons` and, where the user went past errors, `forced`."""
    out: dict[str, Json] = {"verdict": verdict.judgement.value}
    if verdict.forced:
        out["forced"] = True
    out["reasons"] = [
        {
            "code": reason.code.value,
            "cause": reason.cause,
            "evidence": reason.evidence,
            "action": reason.action,
            "trial": ", ".join(reason.trials),
            "trials": list(reason.trials),
            "leg": reason.leg,
            "topic": reason.topic,
            "severity": reason.severity.value,
        }
        for reason in verdict.reasons
    ]
    return out


def walk_summary(verdict: Verdict, walk: str) -> dict[str, Json]:
    """Entries `verdict`, `verdict_r` and `verdict_l` of one walk; none for a trial that is not judged by itself."""
    trial = verdict.trials.get(walk)
    if trial is None:
        return {}
    legs: dict[str, Json] = {f"verdict_{side}": judgement.value for side, judgement in trial.legs.items()}
    return {"verdict": trial.judgement.value} | legs


def require_not_refused(folder: Path) -> None:
    """InputError where the calibration in a result folder is refused, with the first reason."""
    summary = read_object(folder / SUMMARY)
    if summary.get("verdict") != Judgement.REFUSED.value:
        return
    first = next(iter(entries_of(summary, "reasons")), {})
    said = f"the calibration is refused: {first.get('cause')}; {first.get('action')}"
    raise InputError(said, code=Code.MODEL_IN_DOUBT, source=folder)


def of_the_model(summary: Mapping[str, object]) -> tuple[Finding, ...]:
    """What a saved calibration's own verdict says of every further trial: one finding, or none.

    Faults of the forces of its walks do not touch its model; those of their markers do.
    """
    walks = {name for name, entry in table_of(summary, "trials").items() if entry.get("role") == "gait"}
    shared = [
        r
        for r in entries_of(summary, "reasons")
        if touches_model(str(r.get("topic"))) or not _names(r) or _names(r) - walks
    ]
    if not shared:
        return ()
    first = min(shared, key=lambda r: (r.get("severity") != Severity.ERROR.value, bool(r.get("leg"))))
    refused = first.get("severity") == Severity.ERROR.value
    word = Judgement.REFUSED.value if refused else Judgement.DOUBTFUL.value
    return (
        Finding(
            severity=Severity.ERROR if refused else Severity.WARNING,
            topic="calibration",
            where=STUDY,
            cause=f"the calibration of this person is {word}",
            found=f"{first.get('cause')}: {first.get('evidence')}",
            cure=str(first.get("action") or "look at its report"),
            leg=str(first.get("leg") or ""),
            code=Code.MODEL_IN_DOUBT,
        ),
    )


def _names(reason: Mapping[str, object]) -> set[str]:
    names = reason.get("trials")
    return {str(name) for name in names} if isinstance(names, list) else set()
