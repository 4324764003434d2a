"""The verdict in `summary.json`: written with a result, read back for what stands on its model."""

from __future__ import annotations

from collections.abc import Mapping

from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.results.json_types import Json
from gaitcal.verdict.verdict import Judgement, Verdict


def verdict_summary(verdict: Verdict) -> dict[str, Json]:
    """Entries `verdict`, `reasons` and, where the user went past errors, `forced`."""
    out: dict[str, Json] = {"verdict": verdict.judgement.value}
    if verdict.forced:
        out["forced"] = True
    out["reasons"] = [
        {
            "cause": reason.cause,
            "evidence": reason.evidence,
            "action": reason.action,
            "trial": ", ".join(reason.trials),
            "leg": reason.leg,
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


def of_the_model(summary: Mapping[str, object]) -> tuple[Finding, ...]:
    """What a saved calibration's own verdict says of every further trial: one finding, or none.

    Its walks' own faults (a force plate, say) do not touch its model, but where all of it was refused.
    """
    told = summary.get("verdict")
    walks = summary.get("trials")
    names = set(walks) if isinstance(walks, dict) else set()
    reasons = summary.get("reasons")
    shared = [
        r
        for r in (reasons if isinstance(reasons, list) else [])
        if isinstance(r, dict) and not (r.get("trial") in names and _is_walk(walks, str(r.get("trial"))))
    ]
    first = shared[0] if shared else {}
    severity = {Judgement.REFUSED.value: Severity.ERROR, Judgement.DOUBTFUL.value: Severity.WARNING}.get(str(told))
    if severity is None or not shared:
        return ()
    if not any(r.get("severity") == Severity.ERROR.value for r in shared):
        severity = Severity.WARNING
    return (
        Finding(
            severity=severity,
            topic="calibration",
            where=STUDY,
            cause=f"the calibration of this person is {told}",
            found=f"{first.get('cause')}: {first.get('evidence')}",
            cure=str(first.get("action") or "look at its report"),
        ),
    )


def _is_walk(trials: object, name: str) -> bool:
    entry = trials.get(name) if isinstance(trials, dict) else None
    return isinstance(entry, dict) and entry.get("role") == "gait"
