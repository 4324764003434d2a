"""A sensitivity: in double support each foot has its own centre of pressure, or both have the same.

Where the total wrench of a motion is merely divided between the feet, both feet push along the same line, and in double
support that line stands between them: a force carried along with a foot then turns about a point far from its own. The
built-in person's ground reactions once were so. The comparison tells what that did to the torque errors of disturbed
joint parameters, with reactions fixed in the laboratory and with reactions carried with the foot: the same draws, the
same re-fits, once with the person's forces, once with their sum divided in the ratio of the vertical forces. Draws are
paired, so that the standard error of the difference is far smaller than that of either mean: of what is significant
there, little matters, and the claim is on the size of the difference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from gaitcal.arrays import Array
from gaitcal.published.case import MonteCarloCase, nominal_case
from gaitcal.published.claims import Claim, Verdict
from gaitcal.published.disturbance_claims import FRAMES, PUBLISHED
from gaitcal.published.draw import torque_column
from gaitcal.published.leg_torques import TORQUE_WORDS, TORQUES
from gaitcal.published.published import SIDE
from gaitcal.published.settings import MonteCarloSettings, ReactionFrame, Varied
from gaitcal.published.store import Chunk
from gaitcal.published.study import run_chunk
from gaitcal.published.tables import Cell, TableRow
from gaitcal.published.trial_length import SENSITIVITY
from gaitcal.runtime import with_one_blas_thread

DRAWS = 200
LEVEL = 100
VERTICAL = 1
"""Of a force in the laboratory."""
OWN, SHARED = "each foot's own", "one for both feet"
NO_DIFFERENCE = 0.05
"""Part of a torque error: a smaller change counts as none."""
SURE = 2.0
"""Standard errors that a change has to be away from that, or the answer is undecided."""
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
    """RMS torque errors at all of the joint parameters' bounds, draw by draw."""

    drawn: Mapping[str, Mapping[ReactionFrame, Array]]
    """`OWN` or `SHARED`, then the frame: (n, 7) %BW*H, left leg, in the order of `TORQUES`; the same draws."""

    @property
    def draws(self) -> int:
        """How many."""
        return len(self.drawn[OWN][ReactionFrame.LAB])

    def errors(self, centre: str, frame: ReactionFrame) -> Array:
        """(7,) means, %BW*H."""
        means: Array = self.drawn[centre][frame].mean(axis=0)
        return means

    def difference(self, frame: ReactionFrame) -> tuple[Array, Array]:
        """(7,) `OWN` - `SHARED` and its standard error over paired draws (NaN for one draw), %BW*H."""
        apart = self.drawn[OWN][frame] - self.drawn[SHARED][frame]
        if len(apart) < 2:
            return apart.mean(axis=0), np.full(apart.shape[1], np.nan)
        return apart.mean(axis=0), apart.std(axis=0, ddof=1) / np.sqrt(len(apart))


@with_one_blas_thread
def pressure_centres(seed: int, draws: int = DRAWS, jobs: int = -1) -> PressureCentres:
    """Draws 0 to `draws` - 1 of the set JP of the Monte Carlo study under `seed`, with either ground reaction."""
    own = nominal_case()
    cases = {OWN: own, SHARED: with_shared_centre(own)}
    settings = MonteCarloSettings(seed=seed)
    tables = Parallel(n_jobs=jobs)(delayed(_table)(case, settings, draws) for case in cases.values())
    good = np.all([table["failure"] == "" for table in tables], axis=0)
    return PressureCentres(
        {
            centre: {
                frame: table.loc[good, [torque_column(f"{t}_{SIDE}", frame, "rms") for t in TORQUES]].to_numpy()
                for frame in ReactionFrame
            }
            for centre, table in zip(cases, tables, strict=True)
        }
    )


def _table(case: MonteCarloCase, settings: MonteCarloSettings, draws: int) -> pd.DataFrame:
    _, records = run_chunk(case, settings, Chunk(Varied.JP, LEVEL, 0, draws))
    return records.to_pandas()


def pressure_centre_rows(centres: PressureCentres) -> list[TableRow]:
    """All seven torques of the left leg, both frames, both centres of pressure."""
    printed = {figure.torque: figure.value for figure in _FIGURES}
    rows: list[TableRow] = []
    for centre, of_frame in centres.drawn.items():
        for frame in of_frame:
            for torque, error in zip(TORQUES, centres.errors(centre, frame), strict=True):
                words = f"Monte Carlo, JP {LEVEL} %, centre of pressure {centre}: {FRAMES[frame]}"
                cell = Cell(SENSITIVITY, words, TORQUE_WORDS[torque], "%BW*H")
                rows.append(cell.filled(printed.get(torque), float(error), f"mean of {centres.draws} draws"))
    return rows


def pressure_centre_claims(centres: PressureCentres | None) -> list[Claim]:
    """Whether the three printed errors would be others with one centre of pressure, for either frame."""
    claims = []
    for frame, words in FRAMES.items():
        claim = (
            "it makes no difference to the three printed JP torque errors (less than "
            f"{100 * NO_DIFFERENCE:.0f} %) whether each foot has its own centre of pressure or both share one ({words})"
        )
        if centres is None:
            claims.append(Claim(claim, _PUBLISHED, "", Verdict.NOT_RUN))
            continue
        own, shared = (centres.errors(centre, frame) for centre in (OWN, SHARED))
        change, error = centres.difference(frame)
        three = [TORQUES.index(figure.torque) for figure in _FIGURES]
        figures = ", ".join(
            f"{TORQUE_WORDS[TORQUES[k]]} {own[k]:.2f}/{shared[k]:.2f} (difference {change[k]:+.4f} +- {error[k]:.4f})"
            for k in three
        )
        most = int(np.abs(change / shared).argmax())
        ours = (
            f"own centres against one shared: {figures} %BW*H, paired, {centres.draws} draws. Of the seven torques "
            f"{TORQUE_WORDS[TORQUES[most]]} changes most: {own[most]:.2f}/{shared[most]:.2f}, "
            f"{100 * change[most] / shared[most]:+.0f} %"
        )
        part, sure = np.abs(change / shared)[three], SURE * (error / shared)[three]
        claims.append(Claim(claim, _PUBLISHED, ours, _no_difference(part, sure)))
    return claims


def _no_difference(part: Array, sure: Array) -> Verdict:
    """From changes as parts of the errors, and how far they are known."""
    if np.isnan(sure).any():
        return Verdict.NOT_RUN
    if (part - sure > NO_DIFFERENCE).any():
        return Verdict.FAILS
    return Verdict.HOLDS if (part + sure < NO_DIFFERENCE).all() else Verdict.UNDECIDED
