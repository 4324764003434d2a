"""Compare two sessions of one subject: curves at every percent, peaks, ranges and stride measures.

A peak is that of a phase (`gait/peaks.py`), found in every stride and averaged. The peak of a mean
curve would be lower than those of its strides. The error that strides share is taken at the peak of
each stride. Strikes have an error of about a frame, heels of some millimetres. Strides therefore
vary by at least `LEAST_SD`, even if a few of them agree better.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.display import Displayed, shorten
from gaitcal.gait import moments, spatiotemporal, strides
from gaitcal.gait.cycles import POINTS, get_curve_kind, get_unit
from gaitcal.gait.peaks import PEAKS, find_stride_peaks
from gaitcal.model.subject_model import Subject
from gaitcal.results import session_difference
from gaitcal.results import stride_sets as measured


@dataclass(frozen=True, kw_only=True, repr=False)
class SessionComparison(Displayed):
    """Differences between two sessions."""

    names: tuple[str, str]  # Of A and B
    subjects: tuple[Subject, Subject]
    common: measured.Common
    warnings: tuple[
        str, ...
    ]  # Warnings before any figure: refused or doubtful results, signs of another person
    found: tuple[
        session_difference.Difference, ...
    ]  # Those above the detectable difference first, the largest of them before others
    curves: pd.DataFrame  # `curve_differences.csv`: every percent of every curve

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        beyond = [d for d in self.found if d.exceeds]
        count = f"{len(beyond)} of {len(self.found)} beyond the minimal detectable change (95 %)"
        largest = [session_difference.name_figure(d) for d in beyond]
        rows = [("in common", self.common.description), ("differences", count)]
        rows += [("largest", shorten(largest))] if largest else []
        return f"{self.subjects[1].name}: {self.names[1]} against {self.names[0]}", rows

    @property
    def differences(self) -> pd.DataFrame:
        """`differences.csv`: one row for each figure."""
        return session_difference.build_difference_table(self.found)

    @property
    def lines(self) -> tuple[str, ...]:
        """The comparison in sentences, warnings first."""
        return (*(f"warning: {text}" for text in self.warnings), *self.sentences)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The same without warnings."""
        return session_difference.describe_differences(self.names, self.common, self.found)


def compare_sessions(a: measured.RecordedSession, b: measured.RecordedSession) -> SessionComparison:
    """Compare two sessions of one subject.

    Parameters
    ----------
    a, b
        Sessions A and B.

    Returns
    -------
    SessionComparison
        Differences b - a with their standard errors.

    Raises
    ------
    InputError
        The lengths of thighs or shanks differ by more than two results of one subject can.
    """
    person = measured.check_identity(a, b)
    # Body dimensions decide, as names are often codes.
    if person.denied:
        message = f"these are not two results of one person: {'; '.join(person.denied)}"
        raise measured.NotComparableError(message, source=f"{a.name}, {b.name}")
    common = measured.find_common(a, b)
    curves = measured.collect_stride_sets(a), measured.collect_stride_sets(b)
    found = (
        *compare_curve_figures(*curves, common),
        *compare_measures(a, b),
        *session_difference.compare_parameters(a, b, common),
    )
    return SessionComparison(
        names=(a.name, b.name),
        subjects=(a.model.subject, b.model.subject),
        common=common,
        warnings=(
            *_warn_of_verdicts(a, b),
            *(f"of one person? {doubt}" for doubt in person.doubts),
            *_warn_of_mismatches(a, b, curves),
        ),
        found=session_difference.rank_differences(found),
        curves=build_curve_table(*curves, common),
    )


def _warn_of_verdicts(*sessions: measured.RecordedSession) -> tuple[str, ...]:
    """Describe refused and doubtful sessions, the worst first."""
    order = {"refused": 0, "doubtful": 1}
    sessions_in_doubt = sorted(
        (s for s in sessions if s.verdict in order), key=lambda s: order[s.verdict]
    )
    return tuple(
        f"{s.name} is {s.verdict}: {'; '.join(s.reasons) or 'see its report'}"
        for s in sessions_in_doubt
    )


def _warn_of_mismatches(
    a: measured.RecordedSession,
    b: measured.RecordedSession,
    curves: Sequence[Mapping[measured.Key, measured.StrideSet]],
) -> tuple[str, ...]:
    """Describe angles of different meaning, common recordings, and sessions without strides."""
    out = [f"{s.name}: {remark}" for s in (a, b) for remark in s.remarks]
    if twice := len(a.recordings & b.recordings):
        out.append(
            f"{moments.format_count(twice, 'recording')} in both: differences are smaller than "
            "those of two sessions"
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
    """A figure of n strides, and the errors at its instant in each stride."""

    values: Array  # (n,); NaN where not known
    shared: Array  # (n,)
    frames: Array  # (n,)


def build_curve_table(
    a: Mapping[measured.Key, measured.StrideSet],
    b: Mapping[measured.Key, measured.StrideSet],
    common: measured.Common,
) -> pd.DataFrame:
    """Build `curve_differences.csv` with `CURVE_COLUMNS`: all percents of all common variables."""
    parts = []
    values = [_get_values(a), _get_values(b)]
    for key in (key for key in a if key in b):
        both = a[key], b[key]
        # At each percent: strides may be valid in stance only.
        n_a, n_b = (np.isfinite(s.values).sum(axis=0) for s in both)
        mean_a, mean_b = (measured.average_known(s.values) for s in both)
        spread = session_difference.estimate_spread(
            [s.values for s in both], _get_other_leg(key, values)
        )
        # errors of the strides and errors that they share are independent
        by_strides = session_difference.compute_stride_variance(spread, n_a, n_b)
        shared = _compute_shared(common, *both)
        se = np.sqrt(np.nan_to_num(by_strides) + np.nan_to_num(shared))
        difference = mean_b - mean_a
        is_known = np.isfinite(by_strides) & np.isfinite(difference)
        part = {
            "kind": get_curve_kind(key[1]).label,
            "side": key[0],
            "variable": key[1],
            "percent": np.arange(POINTS),
            "unit": get_unit(key[1]),
            "a": mean_a,
            "b": mean_b,
            "difference": difference,
            "se": np.where(np.isfinite(difference), se, np.nan),
            "mdc95": np.where(np.isfinite(difference), session_difference.MDC * se, np.nan),
            "exceeds": (is_known & (np.abs(difference) > session_difference.MDC * se)).astype(int),
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


def compare_curve_figures(
    a: Mapping[measured.Key, measured.StrideSet],
    b: Mapping[measured.Key, measured.StrideSet],
    common: measured.Common,
) -> Iterator[session_difference.Difference]:
    """Compare peaks, ranges and means of every common variable."""
    figures = [_compute_all_figures(a), _compute_all_figures(b)]
    for key in (key for key in a if key in b):
        for measure in figures[0][key]:
            both = figures[0][key][measure], figures[1][key][measure]
            if not all(np.isfinite(f.values).any() for f in both):
                continue
            by_key = [
                {
                    k: figures_of[measure].values
                    for k, figures_of in sets.items()
                    if measure in figures_of
                }
                for sets in figures
            ]
            values, shared = [f.values for f in both], _compute_shared(common, *both)
            yield _build_difference(
                get_curve_kind(key[1]).label,
                key,
                measure,
                get_unit(key[1]),
                values,
                by_key,
                shared=shared,
            )


def _compute_shared(
    common: measured.Common,
    a: measured.StrideSet | ComparedFigure,
    b: measured.StrideSet | ComparedFigure,
) -> Array:
    """Compute c^2 of the means over valid strides."""
    return session_difference.compute_shared_variance(
        common,
        (_average_errors(a, a.shared), _average_errors(b, b.shared)),
        (_average_errors(a, a.frames), _average_errors(b, b.frames)),
    )


def _get_other_leg(
    key: measured.Key, sessions: Sequence[Mapping[measured.Key, Array]]
) -> list[Array]:
    """Get the values of the other leg, in the sessions that have them."""
    other = ("l" if key[0] == "r" else "r", key[1])
    return [values[other] for values in sessions if other in values]


def _build_difference(
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
    """Build the difference of figures of strides (n,) in A and B.

    `shared`: variance of errors that all strides share; `least`: least standard deviation of
    strides.
    """
    spread = session_difference.estimate_spread(
        [values[:, None] for values in both],
        [values[:, None] for values in _get_other_leg(key, sessions)],
    )
    # A spread below the resolution of the measure would make every difference significant.
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
            np.sqrt(
                session_difference.compute_stride_variance(spread, np.array([n_a]), np.array([n_b]))
            )[0]
        ),
        se_shared=float(np.sqrt(np.nan_to_num(shared))),
        strides_a=n_a,
        strides_b=n_b,
    )


def _average_errors(found: measured.StrideSet | ComparedFigure, errors: Array) -> Array:
    """Average errors over strides with a value: (m,) for curves, () for figures."""
    wide = np.where(np.isfinite(found.values), errors, np.nan)
    return (
        measured.average_known(wide)
        if wide.ndim == 2
        else np.asarray(measured.average_known(wide[:, None])[0])
    )


def _get_values(sets: Mapping[measured.Key, measured.StrideSet]) -> dict[measured.Key, Array]:
    return {key: strides_of_key.values for key, strides_of_key in sets.items()}


def _compute_all_figures(
    sets: Mapping[measured.Key, measured.StrideSet],
) -> dict[measured.Key, dict[str, ComparedFigure]]:
    return {key: _compute_figures(key[1], found) for key, found in sets.items()}


def _compute_figures(variable: str, found: measured.StrideSet) -> dict[str, ComparedFigure]:
    """Compute the figures of every stride: `highest in swing`, `at initial contact`."""
    zeros, out = np.zeros(POINTS), {}
    # the peaks of every stride, with the shared error and with its part due to segment axes
    with_shared, with_frames = [], []
    for value, shared, frames, off in zip(
        found.values, found.shared, found.frames, found.stance, strict=True
    ):
        toe_off = None if np.isnan(off) else float(off)
        with_shared.append(find_stride_peaks({variable: (value, shared, zeros)}, toe_off))
        with_frames.append(find_stride_peaks({variable: (value, frames, zeros)}, toe_off))
    for peak in (peak for peak in PEAKS.values() if peak.variable == variable):
        values, shared = np.array([p.get(peak.name, UNKNOWN)[:2] for p in with_shared]).T
        _, frames = np.array([p.get(peak.name, UNKNOWN)[:2] for p in with_frames]).T
        # errors common to both ends of a range cancel: a part may exceed the remaining whole
        out[peak.measure] = ComparedFigure(values, shared, np.minimum(frames, shared))
    return out


UNKNOWN = (np.nan,) * 4  # Peak of a stride that has none


def compare_measures(
    a: measured.RecordedSession, b: measured.RecordedSession
) -> Iterator[session_difference.Difference]:
    """Compare every spatiotemporal measure of each leg that both sessions have."""
    sets = [_collect_values(session.measures) for session in (a, b)]
    for key in (key for key in sets[0] if key in sets[1]):
        unit = spatiotemporal.MEASURES[key[1]]
        both = [values[key] for values in sets]
        yield _build_difference(
            "spatiotemporal", key, "mean", unit, both, sets, least=spatiotemporal.LEAST_SD[unit]
        )


def _collect_values(table: pd.DataFrame) -> dict[measured.Key, Array]:
    """Collect the values of valid strides for each side and measure."""
    counting = (
        (table["valid"] == 1.0) & table["value"].notna() & ~(table["turn"].abs() > strides.TURNING)
    )
    rows = table[counting & table["variable"].isin(list(spatiotemporal.MEASURES))]
    grouped = rows.groupby(["side", "variable"], sort=False)["value"]
    return {
        (str(side), str(name)): values.to_numpy(dtype=np.float64)
        for (side, name), values in grouped
    }
