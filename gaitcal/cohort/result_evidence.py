"""What a result folder says of a person's joint parameters, for the priors of a cohort."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

from gaitcal.calibration.joint_prior import prior_of_study
from gaitcal.cohort.cohort_priors import Rules
from gaitcal.cohort.person_evidence import PartEvidence, PersonEvidence, parts_of
from gaitcal.io.lock import MANIFEST, read_object
from gaitcal.model.parameters import JP_NAMES
from gaitcal.results.cycles_export import trial_files
from gaitcal.results.saved import SavedResult, load_result
from gaitcal.results.summary import JOINT_PRIOR
from gaitcal.results.verdict import SUMMARY
from gaitcal.study.joint_prior import Person
from gaitcal.study.settings import Protocol

TRUSTED = "trustworthy"


@dataclass(frozen=True)
class Found:
    """One session of one person, and by which rules it was calibrated."""

    evidence: PersonEvidence
    rules: Rules


class NotUsedError(Exception):
    """Why a result teaches nothing, in words."""


def evidence_of(folder: Path, name: str) -> Found:
    """What a result folder of `gaitcal calibrate` says.

    Raises
    ------
    NotUsedError
        Its verdict is not "trustworthy", it leans on a cohort itself, or its joint parameters were not calibrated by
        the evidence.
    InputError
        It is damaged.
    """
    summary = read_object(folder / SUMMARY)
    verdict = summary.get("verdict")
    if verdict != TRUSTED:
        raise NotUsedError(f"its verdict is {verdict}")
    if JOINT_PRIOR in summary:
        raise NotUsedError("it was calibrated with priors of a cohort itself")
    saved = load_result(folder)
    parts = _parts(saved)
    subject = saved.model.subject
    evidence = PersonEvidence(
        name=name,
        person=Person(height=subject.height, sex=subject.sex),
        recordings=frozenset(_recordings(folder)),
        parts=parts,
    )
    marker_set = str(read_object(folder / MANIFEST).get("marker_set") or "")
    rules = Rules(marker_set=marker_set, hip_centre=saved.settings.hip_rule, ankle_zero=saved.settings.ankle_rule)
    return Found(evidence, rules)


def _parts(saved: SavedResult) -> dict[str, PartEvidence]:
    influence = saved.uncertainty.joint
    parts = None
    if influence is not None and saved.settings.decided_by is Protocol.EVIDENCE and saved.settings.jp:
        deviation = saved.model.parameters.joint - saved.model.nominal.joint
        parts = parts_of(influence, deviation, JP_NAMES, prior_of_study(saved.settings.joint_prior))
    if parts is None:
        raise NotUsedError("its joint parameters were not calibrated by the evidence of all trials")
    return parts


def _recordings(folder: Path) -> Iterable[str]:
    hashes = read_object(folder / MANIFEST).get("inputs_sha256")
    files = (files.get("file", "") for files in trial_files(folder).values())
    return (str(hashes[file]) for file in files if isinstance(hashes, dict) and file in hashes)


def one_each(found: Sequence[Found]) -> tuple[list[PersonEvidence], Rules | None, list[str]]:
    """Each person once, from the session that tells most; the rules that most have; and who has others.

    Recordings of all sessions of a person are kept, by which they are recognised.
    """
    by_rules: dict[Rules, list[PersonEvidence]] = {}
    for one in found:
        by_rules.setdefault(one.rules, []).append(one.evidence)
    if not by_rules:
        return [], None, []
    rules = max(by_rules, key=lambda r: (len({p.name for p in by_rules[r]}), astuple(r)))
    used = {p.name for p in by_rules[rules]}
    others = sorted({one.evidence.name for one in found if one.evidence.name not in used})
    people = []
    for name in sorted(used):
        best = max((p for p in by_rules[rules] if p.name == name), key=lambda p: p.seen)
        every = frozenset().union(*(one.evidence.recordings for one in found if one.evidence.name == name))
        people.append(replace(best, recordings=every))
    told = [f"{name}: other markers, nominal hips or ankle zeros than most" for name in others]
    return people, rules, told
