"""Where calibration puts the joints of real people, against their nominal places; isolated trials against gait.

Nobody knows where these joints are. But a population scatters about what anatomy and imaging say, and two recordings
of one person tell one place. Lateral is outward on both sides.

Hips of ten people from CT (`imaging/hip_landmarks_ct.csv`): what a regression misses, which hips nobody has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import HipCentre, hip_centre, pelvis_frame
from scripts.validation.people.fits import LEG, Fit, fitted, wide_hips
from scripts.validation.recordings import CHILDREN, changed, only, study_of_person

HIP = [LEG.index(f"hip.pelvis.{d}") for d in ("ant", "sup", "lat")]
BOTH = HIP + [LEG.index(f"hip.thigh.{d}") for d in ("ant", "sup", "lat")]
UNIT = np.array([1e3 if name.rsplit(".", 1)[1] in ("ant", "sup", "lat") else 180 / np.pi for name in LEG])
"""(27,) mm per m, deg per rad."""
WIDE_MM = 100.0
"""Standard deviation of a hip's coordinate that leaves the hip to the recordings."""


def hip_lines(fits: Sequence[Fit]) -> Iterator[str]:
    yield (
        f"{'hip in pelvis, mm':12}"
        + "".join(f"{f'{s}: ant, sup, outward (SE)':>42}" for s in SIDES)
        + (f"{'apart':>8}{'fitted':>8}{'SE':>6}{'ASIS':>7}{'ratio':>7}")
    )
    for fit in fits:
        cells = ""
        for side in SIDES:
            move, error = 1e3 * fit.moved(side)[HIP], 1e3 * fit.leg_errors(side)[HIP]
            cells += f"{'':6}" + "".join(f"{m:6.1f} ({e:3.1f})" for m, e in zip(move, error, strict=True))
        nominal, apart, error = (1e3 * x for x in fit.hips_apart())
        asis = 1e3 * fit.asis_m
        yield f"{fit.name:12}{cells}{nominal:8.0f}{apart:8.0f}{error:6.1f}{asis:7.0f}{apart / asis:7.2f}"


def groups(fits: Sequence[Fit]) -> dict[str, list[Fit]]:
    children = [f for f in fits if f.name in CHILDREN]
    adults = [f for f in fits if f.name not in CHILDREN]
    return {name: of for name, of in (("all", list(fits)), ("children", children), ("adults", adults)) if of}


def moves(fits: Sequence[Fit]) -> Array:
    """(legs, 27) mm, deg, of every leg with a fitted hip or more."""
    every = np.array([UNIT * fit.moved(side) for fit in fits for side in SIDES])
    return np.asarray(every[np.isfinite(every).any(axis=1)])


def population_lines(fits: Sequence[Fit]) -> Iterator[str]:
    """Mean, SD and RMS of each parameter's movement, over all legs; and of hips the RMS distance."""
    errors = np.array([UNIT * fit.leg_errors(side) for fit in fits for side in SIDES])
    yield f"{'movement, mm or deg':24}" + "".join(f"{g:>10}: mean   SD  RMS" for g in groups(fits)) + f"{'SE':>7}"
    tables = [moves(of) for of in groups(fits).values()]
    for k, name in enumerate(LEG):
        cells = ""
        for column in (t[:, k][np.isfinite(t[:, k])] for t in tables):
            spread = column.std(ddof=1) if len(column) > 1 else np.nan
            told = f"{column.mean():.1f}{spread:6.1f}{np.sqrt(np.mean(column**2)):6.1f}" if len(column) else ""
            cells += f"{told:>25}"
        yield f"{name:24}{cells}{np.nanmedian(errors[:, k]):7.1f}"
    cells = ", ".join(f"{name} {x:.1f}" for name, x in hip_figures(fits).items() if "RMS" in name)
    yield f"hips in pelvis, mm: {cells}"


def hip_figures(fits: Sequence[Fit]) -> dict[str, float]:
    """Mean movement of hips by axis and RMS distance, mm, of all, children and adults."""
    out = {}
    for name, of in groups(fits).items():
        hips = moves(of)[:, HIP]
        hips = hips[np.isfinite(hips).all(axis=1)]
        for axis, mean in zip(("ant", "sup", "outward"), hips.mean(axis=0), strict=True):
            out[f"{name}: mean {axis}"] = float(mean)
        out[f"{name}: RMS 3-D"] = float(np.sqrt((hips**2).sum(axis=1).mean()))
    return out


def halves(name: str, settings: Mapping[str, object]) -> dict[str, tuple[Fit, Fit]]:
    """Isolated trials alone and gait alone, as told and with hips that no prior holds; empty without both."""
    study = changed(study_of_person(name), settings)
    parts = [only(study, role) for role in ("joint", "gait")]
    if not all(part.moving for part in parts):
        return {}
    cases = {"as told": parts, "no hip prior": [wide_hips(part, WIDE_MM) for part in parts]}
    return {words: (fitted(name, of[0]), fitted(name, of[1])) for words, of in cases.items()}


def gap_scores(one: Fit, other: Fit) -> tuple[Array, Array]:
    """(4, 3) mm: second less first of right and left hip in pelvis and thigh; (4, 3) in standard errors."""
    gaps, errors = [], []
    for side in SIDES:
        gaps.append(1e3 * (other.moved(side) - one.moved(side))[BOTH])
        errors.append(1e3 * np.hypot(one.leg_errors(side), other.leg_errors(side))[BOTH])
    gap = np.array(gaps).reshape(-1, 3)
    return gap, gap / np.array(errors).reshape(-1, 3)


def largest(one: Fit, other: Fit) -> tuple[float, float]:
    """Of all coordinates of the hips that both tell the largest score, and the largest distance of hips, mm."""
    gaps, scores = gap_scores(one, other)
    return float(np.nanmax(np.abs(scores))), float(np.nanmax(np.linalg.norm(gaps, axis=1)))


def half_lines(name: str, found: Mapping[str, tuple[Fit, Fit]]) -> Iterator[str]:
    """How far gait's hips lie from those of isolated trials."""
    for words, (one, other) in found.items():
        gaps, scores = gap_scores(one, other)
        yield f"{name}, gait less isolated trials, {words}: mm (standard errors)"
        places = [f"hip_{side} in {segment}" for side in SIDES for segment in ("pelvis", "thigh")]
        for place, gap, score in zip(places, gaps, scores, strict=True):
            told = "".join(f"{g:8.1f} ({z:+.1f})" for g, z in zip(gap, score, strict=True))
            yield f"  {place:18}{np.linalg.norm(gap):7.1f}  {told}"
        yield f"  largest z {np.nanmax(np.abs(scores)):.2f}, RMS {np.sqrt(np.nanmean(scores**2)):.2f}"


SKIN_MM = np.array([10.0, 8.0, 6.0])
"""SD of what palpation and flesh over the spines add to a regression's error (ant, sup, lateral): with that of the 20
hips it makes the 12, 10 and 9 mm by which regressions miss hips in gait laboratories."""
WITHIN_95 = 2.795
"""Mahalanobis distance within which 95 % of a normal population in space lies."""


@dataclass(frozen=True)
class Imaged:
    errors: Array
    """(20, 3) mm: true hip less Harrington's, ant, sup, outward."""
    ratios: Array
    """(10,) distance of the hips over that of the spines."""


@lru_cache(maxsize=1)
def imaged(file: Path) -> Imaged:
    """Read the landmarks, and hold hips against the regression in each person's own pelvis frame."""
    table = pd.read_csv(file)
    errors, ratios = [], []
    for _, rows in table[table["bone"] == "pelvis"].groupby("person"):
        points = rows.set_index("landmark")[["x_mm", "y_mm", "z_mm"]]
        at = {str(name): 1e-3 * point.to_numpy(float) for name, point in points.iterrows()}
        back = 0.5 * (at["PSIS_R"] + at["PSIS_L"])
        width, frame = (
            float(np.linalg.norm(at["ASIS_R"] - at["ASIS_L"])),
            pelvis_frame(at["ASIS_R"], at["ASIS_L"], back),
        )
        for side, mirror in zip(SIDES, (1.0, -1.0), strict=True):
            told = hip_centre(HipCentre.HARRINGTON, width, float(np.linalg.norm(frame.origin - back)), side)
            errors.append(1e3 * (frame.local(at[f"HJC_{side.upper()}"]) - told) * [1.0, 1.0, mirror])
        ratios.append(float(np.linalg.norm(at["HJC_R"] - at["HJC_L"])) / width)
    return Imaged(np.array(errors), np.array(ratios))


def lines(fits: Sequence[Fit], images: Imaged) -> Iterator[str]:
    sd, ratios = images.errors.std(axis=0, ddof=1), images.ratios
    told = ", ".join(f"{m:+.1f} ({s:.1f})" for m, s in zip(images.errors.mean(axis=0), sd, strict=True))
    yield f"{len(images.errors)} hips of CT less Harrington's, mm: mean (SD) ant, sup, outward {told}"
    yield f"distance of hips over ASIS: {ratios.min():.2f} to {ratios.max():.2f}, mean {ratios.mean():.2f}"
    yield f"Mahalanobis distance of fitted hips from there by the images' scatter, and with {SKIN_MM} mm of skin"
    for fit in fits:
        far = [f"{side} {alone:4.1f} {skin:4.1f}" for side, alone, skin in distances(fit, images)]
        ratio = fit.hips_apart()[1] / fit.asis_m
        outside = [] if ratios.min() <= ratio <= ratios.max() else [f"ratio {ratio:.2f}"]
        outside += [f"hip_{side}" for side, _, skin in distances(fit, images) if skin > WITHIN_95]
        yield f"  {fit.name:12}{'   '.join(far):32}{'outside: ' + ', '.join(outside) if outside else ''}"


def distances(fit: Fit, images: Imaged) -> list[tuple[str, float, float]]:
    """Side, distance by the images alone, and with skin; of fitted hips."""
    out = []
    covariance = np.cov(images.errors.T)
    for side in SIDES:
        gap = 1e3 * fit.moved(side)[HIP] - images.errors.mean(axis=0)
        if np.isfinite(gap).all():
            both = (covariance, covariance + np.diag(SKIN_MM**2))
            out.append((side, *(float(np.sqrt(gap @ np.linalg.solve(c, gap))) for c in both)))
    return out


def outside(fits: Sequence[Fit], images: Imaged) -> dict[str, float]:
    """How many hips and how many pairs of hips lie outside."""
    hips = [skin > WITHIN_95 for fit in fits for _, _, skin in distances(fit, images)]
    ratios = np.array([fit.hips_apart()[1] / fit.asis_m for fit in fits])
    beyond = (ratios < images.ratios.min()) | (ratios > images.ratios.max())
    return {"hips": float(len(hips)), "hips outside": float(sum(hips)), "pairs outside": float(beyond.sum())}
