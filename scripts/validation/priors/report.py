"""Errors of joint parameters of people left out, and how often error bars cover them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.joint_phases import LEG_PARAMETERS
from gaitcal.calibration.joint_prior import prior_root
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_TO_SI, Kind
from scripts.validation.priors.people import Fit

WIDTH = 1.96
LEGS = np.array([JP_INDEX[name] for name in LEG_PARAMETERS])
JOINTS = ("hip", "knee", "talocrural", "subtalar")
SEEN = (0.3, 3.0)
"""Information in units of the default prior's: directions with less are hardly seen in a walk, with more well."""
BANDS = ("hardly seen in the walk", "half seen", "well seen")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One person left out."""

    truth: Array
    """(98,) m, rad."""
    nominal: Array
    fits: Mapping[str, Fit]
    """By prior, the default one first."""
    information: Array
    """(54, 54) of the legs, what the walk says."""


def report(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Lines."""
    for kind in Kind:
        yield _line(outcomes, f"legs, {kind.value}s, {kind.unit}", _chosen(kind, ""))
    for joint in JOINTS:
        for kind in Kind:
            chosen = _chosen(kind, joint)
            if chosen.any():
                yield _line(outcomes, f"{joint}, {kind.value}s, {kind.unit}", chosen)
    for band, name in enumerate(BANDS):
        yield _band(outcomes, band, name)
    yield "bars of 95 % cover: " + ", ".join(f"{name} {_covered(outcomes, name):.0%}" for name in outcomes[0].fits)


def gain(outcomes: Sequence[Outcome], prior: str, kind: Kind) -> float:
    """Part of the RMS error of the legs with the default prior that another prior takes away."""
    default = next(iter(outcomes[0].fits))
    chosen = _chosen(kind, "")
    return 1.0 - _rms(_errors(outcomes, prior)[:, chosen]) / _rms(_errors(outcomes, default)[:, chosen])


def _chosen(kind: Kind, joint: str) -> Array:
    """(54,) which parameters."""
    listed = [JOINT_PARAMETERS[k] for k in LEGS]
    return np.array([p.kind is kind and p.joint.startswith(joint) for p in listed])


def _errors(outcomes: Sequence[Outcome], prior: str) -> Array:
    """(N, 54) m, rad; of the nominal joints for an empty `prior`."""
    return np.array([((o.fits[prior].fitted if prior else o.nominal) - o.truth)[LEGS] for o in outcomes])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _line(outcomes: Sequence[Outcome], name: str, chosen: Array) -> str:
    unit = JP_TO_SI[LEGS]
    default = _rms((_errors(outcomes, next(iter(outcomes[0].fits))) / unit)[:, chosen])
    nominal = _rms((_errors(outcomes, "") / unit)[:, chosen])
    told = []
    for prior in outcomes[0].fits:
        error = _rms((_errors(outcomes, prior) / unit)[:, chosen])
        change = "" if error == default else f" ({100.0 * (error / default - 1.0):+.0f} %)"
        told.append(f"{prior} {error:.2f}{change}")
    return f"{name}: nominal {nominal:.2f}, {', '.join(told)}"


def _band(outcomes: Sequence[Outcome], band: int, name: str) -> str:
    """Errors along the directions that a walk shows so well, in standard deviations of the default prior."""
    told, unit = [], prior_root(LEG_PARAMETERS, None)
    edges = (-np.inf, *SEEN, np.inf)
    count = 0
    for prior in ("", *outcomes[0].fits):
        found = []
        for outcome, error in zip(outcomes, _errors(outcomes, prior), strict=True):
            values, vectors = np.linalg.eigh(outcome.information)
            there = (values >= edges[band]) & (values < edges[band + 1])
            found.append(vectors[:, there].T @ np.linalg.solve(unit, error))
        count = sum(map(len, found))
        told.append(f"{prior or 'nominal'} {_rms(np.concatenate(found)):.2f}" if count else "none")
    return f"directions {name} ({count / len(outcomes):.0f} of 54), default standard deviations: {', '.join(told)}"


def _covered(outcomes: Sequence[Outcome], prior: str) -> float:
    errors = np.array([o.fits[prior].errors[LEGS] for o in outcomes])
    return float(np.mean(np.abs(_errors(outcomes, prior) / errors) < WIDTH))
