"""One attack as the command `calibrate` would meet it: read, check, refuse or calibrate, and what is said of it.

Reported are the table of outcomes, and every attack that ended badly.
"""

from __future__ import annotations

import shutil
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from time import perf_counter

from gaitcal import GaitcalError, Study, calibrate
from gaitcal.faults.study import check_study
from gaitcal.study.study_file import load_study_file
from scripts.validation.attacks.attack import (
    BASES,
    EVERY,
    Attack,
    Ending,
    Kind,
    Result,
    errors_of,
    names_cause,
    new,
    refusal,
    warned,
)
from scripts.validation.attacks.corpus import corpus
from scripts.validation.attacks.curves import Curves, curves, largest
from scripts.validation.attacks.markers import pattern


class CorpusError(Exception):
    """An attack that cannot be made."""


@dataclass(frozen=True, kw_only=True)
class Clean:
    """A clean study's run."""

    base: str
    refused: tuple[str, ...]
    """Why it is refused, which it should not be; its attacks then tell nothing."""
    messages: tuple[str, ...] = ()
    curves: Mapping[str, Curves] = field(default_factory=dict)
    seconds: float = 0.0


def run_clean(base: str) -> Clean:
    """Check and calibrate a clean study."""
    start = perf_counter()
    study = EVERY[base].study
    findings = check_study(study)
    if errors := errors_of(findings):
        return Clean(base=base, refused=errors)
    calibration = calibrate(study, checked=findings)
    return Clean(
        base=base,
        refused=refusal(calibration),
        messages=warned(calibration),
        curves=curves(calibration),
        seconds=perf_counter() - start,
    )


def run(attack: Attack, clean: Clean) -> Result:
    """Spoil, check and calibrate."""
    start = perf_counter()
    patterns = [pattern(words, BASES[attack.base].study.marker_set) for words in attack.named]

    def result(ending: Ending, messages: tuple[str, ...], moved: float | None = None, where: str = "") -> Result:
        return Result(
            attack=attack.title,
            kind=attack.kind,
            ending=ending,
            messages=messages,
            moved=moved,
            where=where,
            seconds=perf_counter() - start,
            cause_told=any(names_cause(message, patterns) for message in messages),
        )

    try:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            study = spoilt(attack, Path(folder))()
            findings = check_study(study)
            if errors := errors_of(findings):
                return result(Ending.REFUSED, errors)
            calibration = calibrate(study, checked=findings)
            if reasons := refusal(calibration):
                return result(Ending.REFUSED, reasons)
    except GaitcalError as error:
        return result(Ending.REFUSED, (str(error),))
    except CorpusError:
        raise
    except Exception:  # noqa: BLE001 - whatever else comes is what is looked for
        return result(Ending.CRASH, (traceback.format_exc(limit=-3),))
    said = new(warned(calibration), clean.messages)
    comparable = {name: curve for name, curve in curves(calibration).items() if name not in attack.other_frames}
    movement = largest(comparable, clean.curves)
    moved, where = (None, "no result to compare") if movement is None else (movement.bars, movement.words)
    if any(names_cause(message, patterns) for message in said):
        return result(Ending.NAMED, said, moved, where)
    if said:
        return result(Ending.ALARMED, said, moved, where)
    return result(Ending.SILENT if moved is None or moved > 1.0 else Ending.HARMLESS, said, moved, where)


def spoilt(attack: Attack, folder: Path) -> Callable[[], Study]:
    """What reads the study after the attack; what the attack itself raises is a fault of the corpus."""
    try:
        if not attack.of_files:
            study = attack.change(BASES[attack.base].study)  # type: ignore[arg-type]
            if not isinstance(study, Study):
                raise TypeError("it returns no study")
            return lambda: study
        path = with_files(BASES[attack.base].make(folder))
        attack.change(path.parent)  # type: ignore[arg-type]
    except Exception as fault:
        raise CorpusError(f"{attack.title}: the attack itself failed") from fault
    return lambda: Study.load(path)


def with_files(study: Path) -> Path:
    """The study file with all its recordings copied beside it, each under the name of its trial."""
    file = load_study_file(study)
    folder = study.parent
    trials = []
    for trial in file.trials:
        update: dict[str, Path] = {}
        for key, stem in (("file", trial.name), ("forces", f"{trial.name}_forces")):
            source: Path | None = getattr(trial, key)
            if source is not None:
                target = folder / f"{stem}{source.suffix}"
                if source != target:
                    shutil.copyfile(source, target)
                update[key] = target
        trials.append(trial.model_copy(update=update))
    study.write_text(file.model_copy(update={"trials": tuple(trials)}).to_toml(folder), encoding="utf-8")
    return study


@lru_cache(maxsize=1)
def _by_title() -> Mapping[str, Attack]:
    return {attack.title: attack for attack in corpus()}


def run_title(title: str, clean: Clean) -> Result:
    """The attack of that title: its functions cannot be sent to another process, its title can."""
    return run(_by_title()[title], clean)


SILENT_SHARE, ALARMED_SHARE = 0.02, 0.10
"""Largest shares of all attacks that may end so."""
LONGEST = 320
"""Letters of a message that are shown."""


def lines(results: Sequence[Result]) -> Iterator[str]:
    """The table by outcome and kind, then those that ended badly, with what was said."""
    kinds = [kind for kind in Kind if any(r.kind is kind for r in results)]
    yield f"{'':22}" + "".join(f"{ending.value:>10}" for ending in Ending) + f"{'all':>8}"
    for kind in (*kinds, None):
        of_kind = [r for r in results if kind in (None, r.kind)]
        counts = [sum(r.ending is ending for r in of_kind) for ending in Ending]
        yield f"{kind.value if kind else 'all':22}" + "".join(f"{c:10d}" for c in counts) + f"{len(of_kind):8d}"
    total = max(len(results), 1)
    yield f"{'per cent':22}" + "".join(
        f"{100 * sum(r.ending is ending for r in results) / total:10.1f}" for ending in Ending
    )
    for ending in (Ending.CRASH, Ending.SILENT, Ending.ALARMED):
        found = [r for r in results if r.ending is ending]
        if found:
            yield f"\n{ending.value}: {len(found)}"
        for r in sorted(found, key=lambda r: -(r.moved or 0.0)):
            yield line(r)
            yield from (f"      {_shortened(message)}" for message in r.messages)
    astray = [r for r in results if r.ending is Ending.REFUSED and not r.cause_told]
    if astray:
        yield f"\nrefused, but with other words than expected: {len(astray)}"
        for r in astray:
            yield line(r)
            yield from (f"      {_shortened(message)}" for message in r.messages[:3])


def line(r: Result) -> str:
    """One result in one line."""
    moved = "" if r.moved is None else f" {r.moved:.1f} error bars"
    return f"  {r.ending.value:9}{r.attack}:{moved} ({r.where})" if r.where else f"  {r.ending.value:9}{r.attack}"


def _shortened(message: str) -> str:
    text = " ".join(message.split())
    return text if len(text) <= LONGEST else text[:LONGEST] + " ..."


def passed(results: Sequence[Result]) -> bool:
    """Whether the shares are within their limits and nothing crashed."""
    count = {ending: sum(r.ending is ending for r in results) for ending in Ending}
    return (
        count[Ending.CRASH] == 0
        and count[Ending.SILENT] <= SILENT_SHARE * len(results)
        and count[Ending.ALARMED] <= ALARMED_SHARE * len(results)
    )
