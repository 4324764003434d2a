"""Is calibration right on people? Real ones, whose joints nobody knows, and simulated ones with
people's skin.

    people [--parts hips,halves,...] [--only NAME,...] [--study FILE ...] [--set key=value ...]

hips      how far calibration moves the joints of real people from their nominal places, and the
          population's mean and scatter; fitted hips beside those of 29 people in CT. A population
          may scatter, but not move to one side
halves    hips by isolated trials alone against gait alone, as told and with a wide prior on hips
          (others may agree for they share their prior); of people with both
pairs     straight against turn, first walks and strides against last, walk against walk, each
          calibrated by itself: how many differences of joint parameters are inside bars of 68 and
          95 %
knees     where the marker on the knee turns about in the shank, and how far calibration moves the
          knee's axis
skin      hips of people simulated by OpenSim (`opensim_truth`), whose skin moves as `--kinds` says
          (`truth/skin.py`), by gait, by six isolated trials, and by both; needs the extra `peers`
          once, to make the trials in `--cache`
drawn     the same people with a prior of which they are a draw (`people/simulated.py`): all joints
          of the legs

`GAITCAL_DATA` names the folder of recordings; `--study` adds a person by a study file. Settings are
gaitcal's defaults but for `--set`, as `[calibration]` has them. All parts fit the joints alone.

Nobody knows where these joints are. But a population scatters about what anatomy and imaging say
(hips of 29 people from CT, `imaging/*.csv`), and two recordings of one person tell one place; they
share the static trial, and the errors that come with it. Lateral is outward on both sides.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd

import gaitcal
from gaitcal import Study
from gaitcal.arrays import Array
from gaitcal.model.linkage import LEG_JOINTS, SIDES
from gaitcal.model.parameters import JP_INDEX
from gaitcal.model.segment_frames import HipCentre, build_pelvis_frame, compute_hip_centre
from gaitcal.results.session_difference import compute_difference_variance, list_observed_parameters
from gaitcal.results.stride_sets import Common
from gaitcal.study.study_trial import Role, Trial
from scripts.validation.harness import coverage, each_part, matching, option, say, shares, words_of
from scripts.validation.people import knees, simulated
from scripts.validation.people.fits import LEG, Fit, fitted, wide_hips
from scripts.validation.recordings import (
    CHILDREN,
    PEOPLE,
    SIMULATED,
    changed,
    data,
    only,
    study_of_person,
)
from scripts.validation.truth.people import made
from scripts.validation.truth.skin import Kind

LONG_S = 3.0
"""A walk that lasts longer is cut in two, of a stride or more each."""
SESSION = 4
"""Walks from which a session is cut in two."""


@dataclass(frozen=True, kw_only=True)
class Pair:
    kind: str
    person: str
    first: Study
    last: Study


def pairs_of(person: str, study: Study) -> Iterator[Pair]:
    walks, half = study.walks, len(study.walks) // 2
    if person in CHILDREN:
        chosen = [("straight against turn", ("straight",), ("turn",))]
    else:
        chosen = [("walk against walk", (one,), (other,)) for one, other in combinations(walks, 2)]
    if len(walks) >= SESSION:
        chosen.append(("first walks against last", walks[:half], walks[half:]))
    for kind, first, last in chosen:
        yield Pair(kind=kind, person=person, first=only(study, *first), last=only(study, *last))
    for walk in walks:
        alone = only(study, walk)
        (time,) = (t.recording.time for t in alone.moving)
        if time[-1] - time[0] >= LONG_S:
            middle = 0.5 * (time[0] + time[-1])
            begun, ended = (
                _between(alone, *span) for span in ((time[0], middle), (middle, time[-1]))
            )
            yield Pair(kind="first strides against last", person=person, first=begun, last=ended)


def _between(study: Study, begin: float, end: float) -> Study:
    """The same with moving trials cut, without force plates."""

    def cut(trial: Trial) -> Trial:
        if trial.role is Role.STATIC:
            return trial
        inside = (trial.recording.time >= begin) & (trial.recording.time <= end)
        return replace(trial, recording=replace(trial.recording.frames(inside), plates=()))

    return replace(study, trials=tuple(cut(trial) for trial in study.trials))


def scores(one: Fit, other: Fit) -> Array:
    """Differences of the legs' joint parameters that both fitted, in standard errors of the
    difference.
    """
    both = set(list_observed_parameters(other.influence))
    names = [
        n for n in list_observed_parameters(one.influence) if n in both and n.startswith(LEG_JOINTS)
    ]
    gap = (other.parameters.joint - one.parameters.joint)[[JP_INDEX[n] for n in names]]
    variance = compute_difference_variance((one.influence, other.influence), names, Common.STATIC)
    return np.asarray((gap / np.sqrt(variance))[variance > 0.0])


def every_score(
    people: Sequence[str], settings: Mapping[str, object]
) -> dict[tuple[str, str], Array]:
    """(kind, person) -> differences in standard errors."""
    out: dict[tuple[str, str], list[Array]] = {}
    for person in people:
        fits: dict[tuple[object, ...], Fit] = {}
        for pair in pairs_of(person, changed(study_of_person(person), settings)):
            keys = [
                tuple(id(t.recording) for t in study.moving) for study in (pair.first, pair.last)
            ]
            for key, study in zip(keys, (pair.first, pair.last), strict=True):
                fits[key] = fits.get(key) or fitted(person, study)
            out.setdefault((pair.kind, person), []).append(scores(fits[keys[0]], fits[keys[1]]))
    return {key: np.concatenate(found) for key, found in out.items()}


def pair_lines(found: Mapping[tuple[str, str], Array]) -> Iterator[str]:
    for kind in dict.fromkeys(kind for kind, _ in found):
        yield f"{kind}: joint parameters of the legs"
        of = {person: z for (k, person), z in found.items() if k == kind}
        yield from (f"  {person:12}{coverage(z)}" for person, z in of.items())
        yield f"  {'all':12}{coverage(np.concatenate(list(of.values())))}"


def pair_figures(found: Mapping[tuple[str, str], Array]) -> dict[str, float]:
    """% of the differences of each kind inside bars of 68 and 95 %."""
    out = {}
    for kind in dict.fromkeys(kind for kind, _ in found):
        within = shares(np.concatenate([z for (k, _), z in found.items() if k == kind]))
        out |= {f"{kind}, {p} %": share for p, share in zip((68, 95), within, strict=True)}
    return out


HIP = [LEG.index(f"hip.pelvis.{d}") for d in ("ant", "sup", "lat")]
BOTH = HIP + [LEG.index(f"hip.thigh.{d}") for d in ("ant", "sup", "lat")]
UNIT = np.array(
    [1e3 if name.rsplit(".", 1)[1] in ("ant", "sup", "lat") else 180 / np.pi for name in LEG]
)
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
            cells += f"{'':6}" + "".join(
                f"{m:6.1f} ({e:3.1f})" for m, e in zip(move, error, strict=True)
            )
        nominal, apart, error = (1e3 * x for x in fit.hips_apart())
        asis = 1e3 * fit.asis_m
        yield (
            f"{fit.name:12}{cells}{nominal:8.0f}{apart:8.0f}"
            f"{error:6.1f}{asis:7.0f}{apart / asis:7.2f}"
        )


def groups(fits: Sequence[Fit]) -> dict[str, list[Fit]]:
    children = [f for f in fits if f.name in CHILDREN]
    adults = [f for f in fits if f.name not in CHILDREN]
    return {
        name: of
        for name, of in (("all", list(fits)), ("children", children), ("adults", adults))
        if of
    }


def moves(fits: Sequence[Fit]) -> Array:
    """(legs, 27) mm, deg, of every leg with a fitted hip or more."""
    every = np.array([UNIT * fit.moved(side) for fit in fits for side in SIDES])
    return np.asarray(every[np.isfinite(every).any(axis=1)])


def population_lines(fits: Sequence[Fit]) -> Iterator[str]:
    """Mean, SD and RMS of each parameter's movement, over all legs; and of hips the RMS
    distance.
    """
    errors = np.array([UNIT * fit.leg_errors(side) for fit in fits for side in SIDES])
    yield (
        f"{'movement, mm or deg':24}"
        + "".join(f"{g:>10}: mean   SD  RMS" for g in groups(fits))
        + f"{'SE':>7}"
    )
    tables = [moves(of) for of in groups(fits).values()]
    for k, name in enumerate(LEG):
        cells = ""
        for column in (t[:, k][np.isfinite(t[:, k])] for t in tables):
            spread = column.std(ddof=1) if len(column) > 1 else np.nan
            told = (
                f"{column.mean():.1f}{spread:6.1f}{np.sqrt(np.mean(column**2)):6.1f}"
                if len(column)
                else ""
            )
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
    """Isolated trials alone and gait alone, as told and with hips that no prior holds; empty
    without both.
    """
    study = changed(study_of_person(name), settings)
    parts = [only(study, role) for role in ("joint", "gait")]
    if not all(part.moving for part in parts):
        return {}
    cases = {"as told": parts, "no hip prior": [wide_hips(part, WIDE_MM) for part in parts]}
    return {words: (fitted(name, of[0]), fitted(name, of[1])) for words, of in cases.items()}


def gap_scores(one: Fit, other: Fit) -> tuple[Array, Array]:
    """(4, 3) mm: second less first of right and left hip in pelvis and thigh; (4, 3) in standard
    errors.
    """
    gaps, errors = [], []
    for side in SIDES:
        gaps.append(1e3 * (other.moved(side) - one.moved(side))[BOTH])
        errors.append(1e3 * np.hypot(one.leg_errors(side), other.leg_errors(side))[BOTH])
    gap = np.array(gaps).reshape(-1, 3)
    return gap, gap / np.array(errors).reshape(-1, 3)


def largest(one: Fit, other: Fit) -> tuple[float, float]:
    """Of all coordinates of the hips that both tell the largest score, and the largest distance of
    hips, mm.
    """
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
        yield (
            f"  largest z {np.nanmax(np.abs(scores)):.2f}, RMS {np.sqrt(np.nanmean(scores**2)):.2f}"
        )


SKIN_MM = np.array([10.0, 8.0, 6.0])
"""SD of what palpation and flesh over the spines add to a regression's error (ant, sup, lateral):
with that of the 39 hips it makes the 12, 10 and 9 mm by which regressions miss hips in gait
laboratories."""
WITHIN_95 = 2.795
"""Mahalanobis distance within which 95 % of a normal population in space lies."""


@dataclass(frozen=True)
class Imaged:
    errors: Array
    """(39, 3) mm: true hip less Harrington's, ant, sup, outward."""
    ratios: Array
    """(10,) distance of the hips over that of the spines, of people with both hips."""


@lru_cache(maxsize=1)
def imaged(folder: Path) -> Imaged:
    """Read the landmarks of 29 people, and hold hips against the regression in each person's own
    pelvis frame.
    """
    both, one = (
        pd.read_csv(folder / name) for name in ("hip_landmarks_ct.csv", "landmarks_ct_raters.csv")
    )
    words = {
        "RASI": "ASIS_R",
        "LASI": "ASIS_L",
        "RPSI": "PSIS_R",
        "LPSI": "PSIS_L",
        "HJC_r": "HJC_R",
        "HJC_l": "HJC_L",
    }
    renamed = one.replace({"landmark": words})
    errors, ratios = [], []
    for table in (both[both["bone"] == "pelvis"], renamed):
        for _, rows in table.groupby("person"):
            points = rows.set_index("landmark")[["x_mm", "y_mm", "z_mm"]]
            at = {str(name): 1e-3 * point.to_numpy(float) for name, point in points.iterrows()}
            back = 0.5 * (at["PSIS_R"] + at["PSIS_L"])
            frame = build_pelvis_frame(at["ASIS_R"], at["ASIS_L"], back)
            width, depth = (
                float(np.linalg.norm(at["ASIS_R"] - at["ASIS_L"])),
                float(np.linalg.norm(frame.origin - back)),
            )
            hips = {
                side: at[f"HJC_{side.upper()}"] for side in SIDES if f"HJC_{side.upper()}" in at
            }
            for side, hip in hips.items():
                regression = compute_hip_centre(HipCentre.HARRINGTON, width, depth, side)
                outward = np.array([1.0, 1.0, 1.0 if side == "r" else -1.0])
                errors.append(1e3 * (frame.local(hip) - regression) * outward)
            if len(hips) == len(SIDES):
                ratios.append(float(np.linalg.norm(hips["r"] - hips["l"])) / width)
    return Imaged(np.array(errors), np.array(ratios))


def image_lines(fits: Sequence[Fit], images: Imaged) -> Iterator[str]:
    sd, ratios = images.errors.std(axis=0, ddof=1), images.ratios
    told = ", ".join(
        f"{m:+.1f} ({s:.1f})" for m, s in zip(images.errors.mean(axis=0), sd, strict=True)
    )
    yield (
        f"{len(images.errors)} hips of CT less Harrington's, mm: mean (SD) ant, sup, outward {told}"
    )
    yield (
        f"distance of hips over ASIS: {ratios.min():.2f} to {ratios.max():.2f}, mean "
        f"{ratios.mean():.2f}"
    )
    yield (
        "Mahalanobis distance of fitted hips from there by the images' scatter, and with "
        f"{SKIN_MM} mm of skin"
    )
    for fit in fits:
        far = [f"{side} {alone:4.1f} {skin:4.1f}" for side, alone, skin in distances(fit, images)]
        ratio = fit.hips_apart()[1] / fit.asis_m
        outside = [] if ratios.min() <= ratio <= ratios.max() else [f"ratio {ratio:.2f}"]
        outside += [f"hip_{side}" for side, _, skin in distances(fit, images) if skin > WITHIN_95]
        yield (
            "  "
            f"{fit.name:12}{'   '.join(far):32}"
            f"{'outside: ' + ', '.join(outside) if outside else ''}"
        )


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
    return {
        "hips": float(len(hips)),
        "hips outside": float(sum(hips)),
        "pairs outside": float(beyond.sum()),
    }


SHARED = ("--only", "--set", "--cache", "--json")
OWN = {
    "--study": option([], "one person more; may be repeated", metavar="FILE"),
    "--kinds": words_of(Kind, [Kind.PEOPLE]),
    "--seeds": option(5, "of each kind of movement and person"),
}
Figures = dict[str, float]


def hips_part(chosen: argparse.Namespace) -> Figures:
    fits = [fitted(name, changed(study_of_person(name), chosen.settings)) for name in chosen.only]
    say(*hip_lines(fits), "", *population_lines(fits), "")
    images = imaged(data() / "imaging")
    say(*image_lines(fits, images))
    return hip_figures(fits) | outside(fits, images)


def halves_part(chosen: argparse.Namespace) -> Figures:
    out = {}
    for name in chosen.only:
        found = halves(name, chosen.settings)
        say(*half_lines(name, found))
        for case, pair in found.items():
            out[f"{name}, {case}: largest z"], out[f"{name}, {case}: farthest, mm"] = largest(*pair)
    return out


def pairs_part(chosen: argparse.Namespace) -> Figures:
    found = every_score(chosen.only, chosen.settings)
    say(*pair_lines(found))
    return pair_figures(found)


def knees_part(chosen: argparse.Namespace) -> Figures:
    found = [knee for name in chosen.only for knee in knees.knees_of(name, chosen.settings)]
    say(*knees.lines(found))
    return {f"{k.name} {k.side}: centre up": float(k.centre[1]) for k in found}


def simulated_part(drawn: bool, chosen: argparse.Namespace) -> Figures:
    """Simulated people with people's skin, as they are (hips alone), or as the prior says."""
    out: Figures = {}
    for person in SIMULATED:
        made(person, data() / "opensim_truth", chosen.cache)
    for kind in chosen.kinds:
        rows: simulated.Rows = {}
        for seed in range(1 if kind is Kind.NONE else chosen.seeds):
            for person in SIMULATED:
                simulated.add_fits(
                    rows, person, kind, seed, chosen.settings, chosen.cache, drawn=drawn
                )
        say(
            *simulated.lines(
                rows if drawn else simulated.hips_in_space(rows), out, f"{kind.value}, "
            )
        )
    return out


PARTS = {
    "hips": hips_part,
    "halves": halves_part,
    "pairs": pairs_part,
    "knees": knees_part,
    "skin": partial(simulated_part, False),
    "drawn": partial(simulated_part, True),
}


def run(chosen: argparse.Namespace) -> dict[str, Figures]:
    named = matching(chosen.only, PEOPLE) if chosen.only or not chosen.study else []
    chosen.only = [*named, *chosen.study]
    say(
        f"gaitcal of {Path(gaitcal.__file__).parent}"
        + (f", {', '.join(chosen.set)}" if chosen.set else "")
    )
    return each_part(PARTS, chosen)
