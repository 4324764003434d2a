"""What the paper does not say and our figures depend on, shown beside the printed rows; nothing is chosen by it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gaitcal.published import absorbed_noise, pressure_centre, refit, trial_length
from gaitcal.published.absorbed_noise import Absorbed
from gaitcal.published.claims import Claim, Kind
from gaitcal.published.pressure_centre import PressureCentres
from gaitcal.published.refit import StoppedRefits
from gaitcal.published.tables import TableRow
from gaitcal.published.trial_length import LengthDraws
from gaitcal.runtime import Progress, silent


@dataclass(frozen=True, kw_only=True)
class SensitivityDraws:
    """How many draws each of them has."""

    noise: int = trial_length.DRAWS
    """Of phase 1, for each length of the isolated trials."""
    absorbed: int = absorbed_noise.DRAWS
    stopped: int = refit.DRAWS
    """Of the Monte Carlo study, each set and level, their re-fits stopped on the way."""
    centres: int = pressure_centre.DRAWS
    """Of the Monte Carlo study, for each division of the ground reactions."""


@dataclass(frozen=True, kw_only=True)
class Sensitivities:
    """All of them."""

    lengths: list[LengthDraws]
    absorbed: dict[str, Absorbed]
    stopped: StoppedRefits
    centres: PressureCentres


def sensitivities(
    seed: int, draws: SensitivityDraws | None = None, jobs: int = -1, progress: Progress = silent
) -> Sensitivities:
    """Compute all; the results do not depend on the number of processes (-1: one for every core)."""
    draws = draws or SensitivityDraws()
    progress("sensitivity to the length of isolated trials")
    lengths = trial_length.trial_lengths(seed, draws.noise, jobs)
    progress("noise that a motion can absorb")
    absorbed = absorbed_noise.absorbed_noise(seed, draws.absorbed, jobs)
    progress("sensitivity to the end of re-fits")
    stopped = refit.stopped_refits(seed, draws.stopped, jobs)
    progress("sensitivity to the centre of pressure")
    centres = pressure_centre.pressure_centres(seed, draws.centres, jobs)
    return Sensitivities(lengths=lengths, absorbed=absorbed, stopped=stopped, centres=centres)


def sensitivity_rows(found: Sensitivities) -> list[TableRow]:
    """Of `tables.csv`."""
    return [
        *trial_length.trial_length_rows(found.lengths),
        *absorbed_noise.absorbed_rows(found.absorbed),
        *refit.refit_rows(found.stopped),
        *pressure_centre.pressure_centre_rows(found.centres),
    ]


def sensitivity_claims(found: Sensitivities | None) -> list[Claim]:
    """Of `claims.csv`; without a run they are there as not run."""
    claims = [
        *trial_length.trial_length_claims(None if found is None else found.lengths),
        *absorbed_noise.absorbed_claims(None if found is None else found.absorbed),
        *refit.refit_claims(None if found is None else found.stopped),
        *pressure_centre.pressure_centre_claims(None if found is None else found.centres),
    ]
    return [replace(claim, kind=Kind.SENSITIVITY) for claim in claims]
