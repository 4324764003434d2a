"""Two sessions of one person side by side: what differs, and whether the recordings could have
missed it.

Curves and steps of two sessions: how far apart they are at every percent, in peaks and ranges, and
in means of steps.

A peak is that of a phase (`gait/peaks.py`), found in every stride by itself and averaged: the peak
of a mean curve is flatter than those of its strides. The error that strides share is taken where
each has its peak. Strikes are known to a frame or so, heels to some millimetres: strides vary by at
least `LEAST_SD`, however alike a few of them happen to be.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.gait import moments, spatiotemporal, strides
from gaitcal.gait.cycles import POINTS, kind_of, unit_of
from gaitcal.gait.peaks import PEAKS, stride_peaks
from gaitcal.model.subject_model import Subject
from gaitcal.results import session_difference
from gaitcal.results import stride_sets as measured


@dataclass(frozen=True, kw_only=True)
class SessionComparison:
    """What two sessions differ in."""

    names: tuple[str, str]  # Of A and B
    subjects: tuple[Subject, Subject]
    common: measured.Common
    warnings: tuple[
        str, ...
    ]  # What to know before any figure: refused or doubtful results, signs of another person
    found: tuple[
        session_difference.Difference, ...
    ]  # Those that exceed what could be missed first, the largest of them before others
    curves: pd.DataFrame  # `curve_differences.csv`: every percent of every curve

    @property
    def differences(self) -> pd.DataFrame:
        """`differences.csv`: one row a figure."""
        return session_difference.difference_table(self.found)

    @property
    def lines(self) -> tuple[str, ...]:
        """The comparison in words, warnings first."""
        return (*(f"warning: {text}" for text in self.warnings), *self.words)

    @property
    def words(self) -> tuple[str, ...]:
        """The same without warnings."""
        return session_difference.lines_of(self.names, self.common, self.found)


def compare_sessions(a: measured.RecordedSession, b: measured.RecordedSession) -> SessionComparison:
    """Set two sessions side by side.

    Raises InputError: Their thighs or shanks are of lengths that no two results of one person have.
    """
    person = measured.identity(a, b)
    if person.denied:
        message = f"these are not two results of one person: {'; '.join(person.denied)}"
        raise measured.NotComparableError(message, source=f"{a.name}, {b.name}")
    common = measured.common_to(a, b)
    curves = measured.stride_sets(a), measured.stride_sets(b)
    found = (
        *curve_figures(*curves, common),
        *measure_differences(a, b),
        *session_difference.parameter_differences(a, b, common),
    )
    return SessionComparison(
        names=(a.name, b.name),
        subjects=(a.model.subject, b.model.subject),
        common=common,
        warnings=(
            *_verdicts(a, b),
            *(f"of one person? {doubt}" for doubt in person.doubts),
            *_kinds(a, b, curves),
        ),
        found=session_difference.ranked(found),
        curves=curve_table(*curves, common),
    )


def _verdicts(*sessions: measured.RecordedSession) -> tuple[str, ...]:
    """Of sessions that are not trustworthy, the worst first."""
    order = {"refused": 0, "doubtful": 1}
    told = sorted((s for s in sessions if s.verdict in order), key=lambda s: order[s.verdict])
    return tuple(
        f"{s.name} is {s.verdict}: {'; '.join(s.reasons) or 'see its report'}" for s in told
    )


def _kinds(
    a: measured.RecordedSession,
    b: measured.RecordedSession,
    curves: Sequence[Mapping[measured.Key, measured.StrideSet]],
) -> tuple[str, ...]:
    """Where angles do not mean the same, and where there is nothing to compare."""
    out = [f"{s.name}: {remark}" for s in (a, b) for remark in s.remarks]
    if twice := len(a.recordings & b.recordings):
        out.append(
            f"{moments.counted(twice, 'recording')} in both: differences are smaller than those of "
            "two sessions"
        )
    if a.relative != b.relative:
        one = a if a.relative else b
        out.append(
            f"joint angles of {one.name} are counted from its static posture, the other's are not"
        )
    out += [
        f"{s.name} has no stride that is complete and straight"
        for s, found in zip((a, b), curves, strict=True)
        if not found
    ]
    return tuple(out)


CURVE_COLUMNS = (
    *(
        "kind",
        "side",
        "variable",
        "percent",
        "unit",
        "a",
        "b",
        "difference",
        "se",
        "mdc95",
        "exceeds",
    ),
    *("strides_a", "strides_b"),
)
CURVE_HEADER = (
    "mean curves of two sessions over the stride of each foot, b - a; variables and units as in "
    "cycles.csv",
    "se, mdc95 and exceeds: as in differences.csv, at every percent by itself",
)
"""Comment lines of `curve_differences.csv`."""


@dataclass(frozen=True)
class ComparedFigure:
    """A figure of n strides, and the errors at the place where each stride has it."""

    values: Array  # (n,); NaN where not known
    shared: Array  # (n,)
    frames: Array  # (n,)


def curve_table(
    a: Mapping[measured.Key, measured.StrideSet],
    b: Mapping[measured.Key, measured.StrideSet],
    common: measured.Common,
) -> pd.DataFrame:
    """`curve_differences.csv`: every percent of every variable that both sessions have, with
    `CURVE_COLUMNS`.
    """
    parts = []
    for key in (key for key in a if key in b):
        both = a[key], b[key]
        n_a, n_b = (np.isfinite(s.values).sum(axis=0) for s in both)
        mean_a, mean_b = (measured.mean_over(s.values) for s in both)
        spread = session_difference.spread_of(
            [s.values for s in both],
            _beside(key, [{k: s.values for k, s in c.items()} for c in (a, b)]),
        )
        by_strides = session_difference.stride_part(spread, n_a, n_b)
        shared = _shared(common, *both)
        se = np.sqrt(np.nan_to_num(by_strides) + np.nan_to_num(shared))
        apart = mean_b - mean_a
        known = np.isfinite(by_strides) & np.isfinite(apart)
        part = {
            "kind": kind_of(key[1]).words,
            "side": key[0],
            "variable": key[1],
            "percent": np.arange(POINTS),
            "unit": unit_of(key[1]),
            "a": mean_a,
            "b": mean_b,
            "difference": apart,
            "se": np.where(np.isfinite(apart), se, np.nan),
            "mdc95": np.where(np.isfinite(apart), session_difference.MDC * se, np.nan),
            "exceeds": (known & (np.abs(apart) > session_difference.MDC * se)).astype(int),
            "strides_a": n_a,
            "strides_b": n_b,
        }
        parts.append(pd.DataFrame(part))
    table = (
        pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=list(CURVE_COLUMNS))
    )
    return table.round(
        dict.fromkeys(("a", "b", "difference", "se", "mdc95"), session_difference.DIGITS)
    )


def curve_figures(
    a: Mapping[measured.Key, measured.StrideSet],
    b: Mapping[measured.Key, measured.StrideSet],
    common: measured.Common,
) -> Iterator[session_difference.Difference]:
    """Peaks, ranges and means of every variable that both sessions have."""
    figures = [{key: _figures(key[1], found) for key, found in sets.items()} for sets in (a, b)]
    for key in (key for key in a if key in b):
        for measure in figures[0][key]:
            both = figures[0][key][measure], figures[1][key][measure]
            if not all(np.isfinite(f.values).any() for f in both):
                continue
            beside = [
                {k: of[measure].values for k, of in sets.items() if measure in of}
                for sets in figures
            ]
            values, shared = [f.values for f in both], _shared(common, *both)
            yield _difference(
                kind_of(key[1]).words, key, measure, unit_of(key[1]), values, beside, shared=shared
            )


def _shared(
    common: measured.Common,
    a: measured.StrideSet | ComparedFigure,
    b: measured.StrideSet | ComparedFigure,
) -> Array:
    """c^2 of the means over strides that count."""
    return session_difference.shared_variance(
        common, (_mean(a, a.shared), _mean(b, b.shared)), (_mean(a, a.frames), _mean(b, b.frames))
    )


def _beside(key: measured.Key, sessions: Sequence[Mapping[measured.Key, Array]]) -> list[Array]:
    """The values of the other leg, in the sessions that have them."""
    other = ("l" if key[0] == "r" else "r", key[1])
    return [values[other] for values in sessions if other in values]


def _difference(
    kind: str,
    key: measured.Key,
    measure: str,
    unit: str,
    both: Sequence[Array],
    sessions: Sequence[Mapping[measured.Key, Array]],
    *,
    shared: Array | float = 0.0,
    least: float = 0.0,
) -> session_difference.Difference:
    """Of figures of strides (n,) in A and in B; `shared`: variance; `least`: standard deviation of
    strides at least.
    """
    spread = session_difference.spread_of(
        [values[:, None] for values in both], [values[:, None] for values in _beside(key, sessions)]
    )
    spread = session_difference.StrideSpread(
        variance=np.maximum(spread.variance, least**2), freedom=spread.freedom
    )
    n_a, n_b = (int(np.isfinite(values).sum()) for values in both)
    return session_difference.Difference(
        kind=kind,
        side=key[0],
        name=key[1],
        measure=measure,
        unit=unit,
        a=float(np.nanmean(both[0])),
        b=float(np.nanmean(both[1])),
        se_strides=float(
            np.sqrt(session_difference.stride_part(spread, np.array([n_a]), np.array([n_b])))[0]
        ),
        se_shared=float(np.sqrt(np.nan_to_num(shared))),
        strides_a=n_a,
        strides_b=n_b,
    )


def _mean(found: measured.StrideSet | ComparedFigure, errors: Array) -> Array:
    """(m,) of curves, () of figures: mean of errors over strides whose value counts."""
    wide = np.where(np.isfinite(found.values), errors, np.nan)
    return (
        measured.mean_over(wide)
        if wide.ndim == 2
        else np.asarray(measured.mean_over(wide[:, None])[0])
    )


def _figures(variable: str, found: measured.StrideSet) -> dict[str, ComparedFigure]:
    """Measure -> the figure of every stride: `highest in swing`, `at initial contact`."""
    own, out = np.zeros(POINTS), {}
    of_strides = [
        [
            stride_peaks({variable: (value, error, own)}, None if np.isnan(off) else float(off))
            for error in errors
        ]
        for value, *errors, off in zip(
            found.values, found.shared, found.frames, found.stance, strict=True
        )
    ]
    for peak in (peak for peak in PEAKS.values() if peak.variable == variable):
        rows = [[peaks.get(peak.name, UNKNOWN)[:2] for peaks in both] for both in of_strides]
        (values, shared), (_, frames) = np.array(rows).transpose(1, 2, 0)
        # errors of a range cancel by what both ends share, and may leave more of a part than of the
        # whole
        out[peak.measure] = ComparedFigure(values, shared, np.minimum(frames, shared))
    return out


UNKNOWN = (np.nan,) * 4  # Peak of a stride that has none


def measure_differences(
    a: measured.RecordedSession, b: measured.RecordedSession
) -> Iterator[session_difference.Difference]:
    """Every measure of each leg that both sessions have."""
    sets = [_values(session.measures) for session in (a, b)]
    for key in (key for key in sets[0] if key in sets[1]):
        unit = spatiotemporal.MEASURES[key[1]]
        both = [values[key] for values in sets]
        yield _difference(
            "spatiotemporal", key, "mean", unit, both, sets, least=spatiotemporal.LEAST_SD[unit]
        )


def _values(table: pd.DataFrame) -> dict[measured.Key, Array]:
    """Side and measure -> the values of its strides that count."""
    counting = (
        (table["valid"] == 1.0) & table["value"].notna() & ~(table["turn"].abs() > strides.TURNING)
    )
    rows = table[counting & table["variable"].isin(list(spatiotemporal.MEASURES))]
    grouped = rows.groupby(["side", "variable"], sort=False)["value"]
    return {
        (str(side), str(name)): values.to_numpy(dtype=np.float64)
        for (side, name), values in grouped
    }
