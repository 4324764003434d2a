"""A sensitivity: in double support each foot has its own centre of pressure, or both have the same.

Where the total wrench of a motion is merely divided between the feet, both feet push along the same line, and in double
support that line stands between them: a force carried along with a foot then turns about a point far from its own. The
built-in person's ground reactions once were so. The comparison tells what that did to the torque errors of disturbed
joint parameters, with reactions fixed in the laboratory and with reactions carried with the foot: the same draws, the
same re-fits, once with the person's forces, once with their sum divided in the ratio of the vertical forces.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from gaitcal.arrays import Array
from gaitcal.montecarlo.case import MonteCarloCase, nominal_case
from gaitcal.montecarlo.conclusions import PUBLISHED
from gaitcal.montecarlo.leg_torques import TORQUE_WORDS, TORQUES
from gaitcal.montecarlo.settings import MonteCarloSettings, ReactionFrame, Varied
from gaitcal.montecarlo.statistics import statistics
from gaitcal.montecarlo.store import Chunk
from gaitcal.montecarlo.study import run_chunk
from gaitcal.reproduction.claims import Claim, Verdict, tested
from gaitcal.reproduction.disturbance_claims import FRAMES, mean_rms
from gaitcal.reproduction.tables import Cell, TableRow
from gaitcal.reproduction.trial_length import SENSITIVITY

DRAWS = 200
LEVEL = 100
VERTICAL = 1
"""Of a force in the laboratory."""
OWN, SHARED = "each foot's own", "one for both feet"
_FIGURES = tuple(figure for figure in PUBLISHED if figure.varied is Varied.JP)
_PUBLISHED = ", ".join(f"{TORQUE_WORDS[figure.torque]} {figure.value}" for figure in _FIGURES) + " %BW*H"


def with_shared_centre(case: MonteCarloCase) -> MonteCarloCase:
    """The case with its total wrench divided between the feet in the ratio of their vertical forces."""
    total = case.wrench.sum(axis=1)
    loaded = total[:, VERTICAL] > 0.0
    share = np.where(loaded[:, None], case.wrench[:, :, VERTICAL], 0.5)
    share = share / share.sum(axis=1, keepdims=True)
    return replace(case, wrench=share[:, :, None] * total[:, None, :])


@dataclass(frozen=True)
class PressureCentres:
    """Mean RMS torque errors at all of the joint parameters' bounds."""

    errors: Mapping[str, Mapping[ReactionFrame, Array]]
    """`OWN` or `SHARED`, then the frame: (7,) %BW*H, left leg, in the order of `TORQUES`."""
    draws: int


def pressure_centres(seed: int, draws: int = DRAWS, jobs: int = -1) -> PressureCentres:
    """Draws 0 to `draws` - 1 of the set JP of the Monte Carlo study under `seed`, with either ground reaction."""
    own = nominal_case()
    cases = {OWN: own, SHARED: with_shared_centre(own)}
    settings = MonteCarloSettings(seed=seed)
    tables = Parallel(n_jobs=jobs)(delayed(_table)(case, settings, draws) for case in cases.values())
    errors = {
        centre: {frame: mean_rms(table, Varied.JP, frame) for frame in ReactionFrame}
        for centre, table in zip(cases, tables, strict=True)
    }
    return PressureCentres(errors, draws)


def _table(case: MonteCarloCase, settings: MonteCarloSettings, draws: int) -> pd.DataFrame:
    _, records = run_chunk(case, settings, Chunk(Varied.JP, LEVEL, 0, draws))
    return statistics(records.to_pandas())


def pressure_centre_rows(centres: PressureCentres) -> list[TableRow]:
    """All seven torques of the left leg, both frames, both centres of pressure."""
    printed = {figure.torque: figure.value for figure in _FIGURES}
    rows: list[TableRow] = []
    for centre, of_frame in centres.errors.items():
        for frame, errors in of_frame.items():
            for torque, error in zip(TORQUES, errors, strict=True):
                words = f"Monte Carlo, JP {LEVEL} %, centre of pressure {centre}: {FRAMES[frame]}"
                cell = Cell(SENSITIVITY, words, TORQUE_WORDS[torque], "%BW*H")
                rows.append(cell.filled(printed.get(torque), float(error), f"mean of {centres.draws} draws"))
    return rows


def pressure_centre_claims(centres: PressureCentres | None) -> list[Claim]:
    """Whether separate centres of pressure bring the three printed errors nearer, for either frame."""
    claims = []
    for frame, words in FRAMES.items():
        claim = (
            "sensitivity: with a centre of pressure for each foot, not one for both, JP torque errors are nearer to "
            f"the printed ones ({words})"
        )
        if centres is None:
            claims.append(Claim(claim, _PUBLISHED, "", Verdict.NOT_RUN))
            continue
        apart = {centre: of_frame[frame] for centre, of_frame in centres.errors.items()}
        figures = [
            f"{TORQUE_WORDS[figure.torque]} {apart[OWN][k]:.2f} ({apart[SHARED][k]:.2f} with {SHARED})"
            for figure in _FIGURES
            for k in (TORQUES.index(figure.torque),)
        ]
        far = {centre: _distance(errors) for centre, errors in apart.items()}
        most = int(np.abs(np.log(apart[OWN] / apart[SHARED])).argmax())
        ours = (
            f"{', '.join(figures)} %BW*H; on average a factor of {far[OWN]:.2f} off ({far[SHARED]:.2f}). Of the seven "
            f"torques {TORQUE_WORDS[TORQUES[most]]} changes most: {apart[OWN][most]:.2f} ({apart[SHARED][most]:.2f})"
        )
        claims.append(tested(claim, _PUBLISHED, ours, far[OWN] < far[SHARED]))
    return claims


def _distance(errors: Array) -> float:
    """Geometric mean of the factors by which the three printed errors are missed, in either direction."""
    factors = [abs(np.log(errors[TORQUES.index(figure.torque)] / figure.value)) for figure in _FIGURES]
    return float(np.exp(np.mean(factors)))
