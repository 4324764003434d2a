"""Curves and steps of two sessions: how far apart they are at every percent, in peaks and ranges, and in means of
steps.

A peak is found in every stride by itself and averaged: the peak of a mean curve is flatter than those of its strides.
The error that strides share is taken where each has its peak; a range has that of both its ends, as if independent.
Strikes are known to a frame or so, heels to some millimetres: strides vary by at least `LEAST_SD`, however alike a few
of them happen to be.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from gaitcal.arrays import Array, BoolArray
from gaitcal.compare.difference import DIGITS, MDC, Difference, Spread, shared_variance, spread_of, stride_part
from gaitcal.compare.stride_sets import Common, Key, Session, StrideSet, mean_over
from gaitcal.gait.cycles import POINTS, Kind, kind_of, unit_of
from gaitcal.gait.spatiotemporal import LEAST_SD, LEAST_VALID, MEASURES
from gaitcal.gait.strides import TURNING

PHASES = {
    Kind.ANGLE: ("stance", "swing"),
    Kind.MOMENT: ("stance",),
    Kind.POWER: ("stance", "swing"),
    Kind.FORCE: ("stance",),
}
"""Where peaks are looked for: a leg in swing has moments of its own weight alone."""
CURVE_COLUMNS = (
    *("kind", "side", "variable", "percent", "unit", "a", "b", "difference", "se", "mdc95", "exceeds"),
    *("strides_a", "strides_b"),
)
CURVE_HEADER = (
    "mean curves of two sessions over the stride of each foot, b - a; variables and units as in cycles.csv",
    "se, mdc95 and exceeds: as in differences.csv, at every percent by itself",
)
"""Comment lines of `curve_differences.csv`."""


@dataclass(frozen=True)
class Figure:
    """A figure of n strides, and the errors at the place where each stride has it."""

    values: Array
    """(n,); NaN where not known."""
    shared: Array
    """(n,)."""
    frames: Array
    """(n,)."""


def curve_table(a: Mapping[Key, StrideSet], b: Mapping[Key, StrideSet], common: Common) -> pd.DataFrame:
    """`curve_differences.csv`: every percent of every variable that both sessions have, with `CURVE_COLUMNS`."""
    parts = []
    for key in (key for key in a if key in b):
        one, other = a[key], b[key]
        n_a, n_b = (np.isfinite(s.values).sum(axis=0) for s in (one, other))
        mean_a, mean_b = mean_over(one.values), mean_over(other.values)
        by_strides = stride_part(_spread(key, a, b), n_a, n_b)
        shared = shared_variance(
            common,
            (_mean(one, one.shared), _mean(other, other.shared)),
            (_mean(one, one.frames), _mean(other, other.frames)),
        )
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
            "mdc95": np.where(np.isfinite(apart), MDC * se, np.nan),
            "exceeds": (known & (np.abs(apart) > MDC * se)).astype(int),
            "strides_a": n_a,
            "strides_b": n_b,
        }
        parts.append(pd.DataFrame(part))
    table = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=list(CURVE_COLUMNS))
    return table.round(dict.fromkeys(("a", "b", "difference", "se", "mdc95"), DIGITS))


def curve_figures(a: Mapping[Key, StrideSet], b: Mapping[Key, StrideSet], common: Common) -> Iterator[Difference]:
    """Peaks, ranges and means of every variable that both sessions have."""
    figures = [{key: _figures(key[1], found) for key, found in sets.items()} for sets in (a, b)]
    for key in (key for key in a if key in b):
        other_leg = ("l" if key[0] == "r" else "r", key[1])
        for measure, of_a in figures[0][key].items():
            of_b = figures[1][key][measure]
            n_a, n_b = (int(np.isfinite(f.values).sum()) for f in (of_a, of_b))
            if not n_a or not n_b:
                continue
            beside = [f[other_leg][measure].values[:, None] for f in figures if other_leg in f]
            spread = spread_of([of_a.values[:, None], of_b.values[:, None]], beside)
            shared = shared_variance(
                common,
                (_known(of_a, of_a.shared), _known(of_b, of_b.shared)),
                (_known(of_a, of_a.frames), _known(of_b, of_b.frames)),
            )
            yield Difference(
                kind=kind_of(key[1]).words,
                side=key[0],
                name=key[1],
                measure=measure,
                unit=unit_of(key[1]),
                a=float(np.nanmean(of_a.values)),
                b=float(np.nanmean(of_b.values)),
                se_strides=float(np.sqrt(stride_part(spread, np.array([n_a]), np.array([n_b])))[0]),
                se_shared=float(np.sqrt(np.nan_to_num(shared))),
                strides_a=n_a,
                strides_b=n_b,
            )


def _spread(key: Key, a: Mapping[Key, StrideSet], b: Mapping[Key, StrideSet]) -> Spread:
    other_leg = ("l" if key[0] == "r" else "r", key[1])
    beside = [sets[other_leg].values for sets in (a, b) if other_leg in sets]
    return spread_of([a[key].values, b[key].values], beside)


def _mean(found: StrideSet, errors: Array) -> Array:
    """(101,) mean over strides that count."""
    return mean_over(np.where(np.isfinite(found.values), errors, np.nan))


def _known(figure: Figure, errors: Array) -> Array:
    """Mean over strides that have the figure."""
    out: Array = mean_over(np.where(np.isfinite(figure.values), errors, np.nan)[:, None])[0]
    return out


def _figures(variable: str, found: StrideSet) -> dict[str, Figure]:
    """Measure -> the figure of every stride."""
    kind, percent = kind_of(variable), np.arange(POINTS)
    out: dict[str, Figure] = {}
    for phase in PHASES[kind]:
        inside = percent[None] <= found.stance[:, None] if phase == "stance" else percent[None] >= found.stance[:, None]
        top, place = _extreme(found.values, inside, largest=True)
        bottom, low = _extreme(found.values, inside, largest=False)
        out[f"largest in {phase}"] = _at(found, top, place)
        if kind is not Kind.FORCE:
            out[f"smallest in {phase}"] = _at(found, bottom, low)
    if kind is Kind.ANGLE:
        whole = np.ones_like(found.values, dtype=bool)
        top, place = _extreme(found.values, whole, largest=True)
        bottom, low = _extreme(found.values, whole, largest=False)
        ends = _at(found, top, place), _at(found, bottom, low)
        out["range"] = Figure(
            top - bottom, np.hypot(ends[0].shared, ends[1].shared), np.hypot(ends[0].frames, ends[1].frames)
        )
        seen = np.isfinite(found.values).mean(axis=1) >= LEAST_VALID
        mean = np.where(seen, mean_over(found.values.T), np.nan)
        out["mean"] = Figure(mean, mean_over(found.shared.T), mean_over(found.frames.T))
    return out


def _extreme(values: Array, inside: BoolArray, *, largest: bool) -> tuple[Array, Array]:
    """(n,) the largest or smallest value of a phase, NaN where too little of it is known; and its percent."""
    known = np.isfinite(values) & inside
    enough = (known.sum(axis=1) > 0) & (known.sum(axis=1) >= LEAST_VALID * inside.sum(axis=1))
    signed = np.where(known, values if largest else -values, -np.inf)
    place = signed.argmax(axis=1)
    found = values[np.arange(len(values)), place]
    return np.where(enough, found, np.nan), place


def _at(found: StrideSet, values: Array, place: Array) -> Figure:
    rows = np.arange(len(values))
    return Figure(values, found.shared[rows, place], found.frames[rows, place])


def measure_differences(a: Session, b: Session) -> Iterator[Difference]:
    """Every measure of each leg that both sessions have."""
    sets = [_values(session.measures) for session in (a, b)]
    for (side, name), of_a in sets[0].items():
        of_b = sets[1].get((side, name))
        if of_b is None:
            continue
        unit, other_leg = MEASURES[name], ("l" if side == "r" else "r", name)
        beside = [values[other_leg][:, None] for values in sets if other_leg in values]
        spread = spread_of([of_a[:, None], of_b[:, None]], beside)
        floored = Spread(variance=np.maximum(spread.variance, LEAST_SD[unit] ** 2), freedom=spread.freedom)
        yield Difference(
            kind="spatiotemporal",
            side=side,
            name=name,
            measure="mean",
            unit=unit,
            a=float(of_a.mean()),
            b=float(of_b.mean()),
            se_strides=float(np.sqrt(stride_part(floored, np.array([len(of_a)]), np.array([len(of_b)])))[0]),
            se_shared=0.0,
            strides_a=len(of_a),
            strides_b=len(of_b),
        )


def _values(table: pd.DataFrame) -> dict[tuple[str, str], Array]:
    """Side and measure -> the values of its strides that count."""
    counting = (table["valid"] == 1.0) & table["value"].notna() & ~(table["turn"].abs() > TURNING)
    rows = table[counting & table["variable"].isin(list(MEASURES))]
    grouped = rows.groupby(["side", "variable"], sort=False)["value"]
    return {(str(side), str(name)): values.to_numpy(dtype=np.float64) for (side, name), values in grouped}
