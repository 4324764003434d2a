"""Hips of simulated people, whose truth is known, by their walk alone, their isolated trials alone, and by both."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import JP_INDEX
from scripts.validation.error_bars import Bars, bars, rms
from scripts.validation.people.real import fitted
from scripts.validation.recordings import changed, only
from scripts.validation.truth.gathered import TO_UNIT
from scripts.validation.truth.people import isolated_person
from scripts.validation.truth.skin import TABLE_MM, Kind, disturbed
from scripts.validation.truth.true_joints import hip_parameters, static_frames

TRIALS = {"gait": ("gait",), "isolated": ("joint",), "gait and isolated": ("gait", "joint")}
"""Words -> roles of the trials that are calibrated."""
WAVES_MM = 10.0
"""Of the published waves; other kinds have the size of their table."""


@dataclass(frozen=True, kw_only=True)
class Hips:
    """Both hips of one fit, in pelvis and thigh."""

    kind: Kind
    trials: str
    error: Array
    """(4, 3) mm: fitted less true."""
    nominal: Array
    """(4, 3) mm: nominal less true, which is the prior's error."""
    se: Array
    """(4, 3) mm."""


def hips_of(person: str, kind: Kind, seed: int, settings: Mapping[str, object], data: Path, cache: Path) -> list[Hips]:
    """Disturb a person's markers, and fit each choice of trials."""
    made = isolated_person(person, data, cache, with_gait=True)
    size = WAVES_MM if kind is Kind.SINUSOIDS else TABLE_MM
    study = changed(disturbed(made.study, kind, size, seed), settings)
    out = []
    for words, roles in TRIALS.items():
        fit = fitted(person, only(study, *roles))
        frames = static_frames(fit.nominal, study.static.recording)
        truth = {n: v for s in SIDES for n, v in hip_parameters(frames, s, made.centres[f"hip_{s}"]).items()}
        at, true = [JP_INDEX[name] for name in truth], np.array(list(truth.values()))
        values = (fit.parameters.joint[at] - true, fit.nominal.parameters.joint[at] - true, fit.errors[at])
        error, nominal, se = (v.reshape(-1, 3) / TO_UNIT["mm"] for v in values)
        out.append(Hips(kind=kind, trials=words, error=error, nominal=nominal, se=se))
    return out


def lines(found: Sequence[Hips], out: dict[str, float]) -> Iterator[str]:
    """RMS distance and coverage of each kind and choice of trials; figures into `out`."""
    yield f"{'hips, mm: RMS distance':32}{'fits':>6}{'nominal':>9}{'fitted':>9}{'SE':>7}{'in 68 %':>9}{'in 95 %':>9}"
    for kind, trials in dict.fromkeys((h.kind, h.trials) for h in found):
        of = [h for h in found if (h.kind, h.trials) == (kind, trials)]
        nominal, error = (rms([np.linalg.norm(getattr(h, w), axis=1) for h in of]) for w in ("nominal", "error"))
        held = sum((bars(h.error, h.se) for h in of), Bars())
        name = f"{kind.value}, {trials}"
        yield (
            f"{name:32}{len(of):6}{nominal:9.1f}{error:9.2f}{np.sqrt(3) * held.rms:7.1f}"
            f"{held.shares[0]:9.0f}{held.shares[1]:9.0f}"
        )
        out |= {f"{name}: nominal": nominal, f"{name}: RMS": error, f"{name}: in 95 %": held.shares[1]}
