"""Page data made up: a plain one, one with several strides of each leg, and one with blocks of
every kind.
"""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gaitcal.errors import Code
from gaitcal.gait.cycles import GaitCycle, find_valid_percents, normalise
from gaitcal.gait.peaks import find_stride_peaks
from gaitcal.gait.spatiotemporal import (
    LEAST_SD,
    MEASURES,
    OF_BOTH_LEGS,
    Stride,
    select_straight_strides,
)
from gaitcal.model.linkage import PELVIS_ANGLES
from gaitcal.model.subject_model import Subject
from gaitcal.report.page.bone_files import BoneMeshes
from gaitcal.report.page.page_data import FORMAT, explain_code
from gaitcal.report.page.page_html import PageContent, render_page
from gaitcal.report.page.plain_data import encode_base64, pack_floats, round_number
from gaitcal.report.page.scene import MotionScene, Scene
from gaitcal.report.page.trial_data import list_masks, pack_curves
from gaitcal.results.shown_labels import SHOWN_MEASURES
from gaitcal.results.trial_curves import Curve
from tests.report.page.people import walking_scene

SUBJECT = Subject("Built-in subject", 69.4, 1.70, "male")
PRESETS = ("clinician", "fit", "joints", "trust", "provenance")
HOSTILE = '<img src=x onerror="document.title=1">'


def page_data(scene: Scene, trials: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    """Of a scene; `more` in place of what is the same for all."""
    person = {key: getattr(SUBJECT, key) for key in ("session", "sex", "weight", "bwh")}
    person["facts"] = [["Name or code", scene.subject], ["Diagnosis", "<b>none</b>"]]
    return {
        "format": FORMAT, "program": "gaitcal", "made": "22 November 2026",
        "person": {"name": scene.subject, "mass": scene.mass, "height": scene.height, **person},
        "verdict": {"judgement": "trustworthy", "sentence": "Nothing speaks against it.",
            "reasons": []}, "lines": [],
        "measures": [], "bands": [], "sections": {}, "trials": trials,
    } | more  # fmt: skip


def trial_data(
    trial: MotionScene, curves: tuple[Curve, ...], strides: list[dict[str, Any]], **more: Any
) -> dict[str, Any]:
    """Of a trial, with the curves packed."""
    time = trial.time - trial.time[0]
    return {
        "name": trial.name, "role": "walking", "joint": None, "activity": "gait", "repeats": False,
        "verdict": None,
        "start": 0.0, "duration": float(time[-1]), "frames": len(time), "every": 1,
        "time": pack_floats(time),
        **pack_curves(curves, 1), "events": [], "strides": strides, "measures": [], "line": 0.0,
        "relative": False,
        "sections": {},
    } | more  # fmt: skip


# -------------------------------------------------------------------------------------------- plain

EVENTS = {
    "r": [("foot strike", 0.05), ("foot off", 0.65), ("foot strike", 1.0)],
    "l": [("foot off", 0.1), ("foot strike", 0.5)],
}
"""s from the begin of the walk."""


def written_page(
    folder: Path, scene: Scene, sheet: dict[str, Any] | None = None, bones: BoneMeshes | None = None
) -> Path:
    """The page of a scene as a file; `bones` unless those of the extra are to be used."""
    folder.mkdir(exist_ok=True)
    path = folder / "result.html"
    path.write_text(render_page(PageContent(scene, sheet), bones), encoding="utf-8")
    return path


def plain_data(scene: Scene) -> dict[str, Any]:
    """Right and left hip flexion of every trial; events and a stride in the first."""
    events = [
        {"side": s, "kind": k, "time": t, "source": "motion"} for s in EVENTS for k, t in EVENTS[s]
    ]
    stride = {
        "side": "r",
        "number": 1,
        "start": 0.05,
        "stop": 1.0,
        "off": 0.65,
        "turns": False,
        "peaks": {},
    }
    trials = []
    for k, trial in enumerate(scene.trials):
        wave, valid = (
            np.sin(6.0 * (trial.time - trial.time[0])),
            np.ones(len(trial.time), dtype=bool),
        )
        curves = tuple(
            Curve(
                "hip_flexion",
                s,
                kind,
                unit,
                30.0 * wave + (s == "l"),
                valid,
                error=valid * 1.0,
                nominal=29.0 * wave,
            )
            for kind, unit in (("angle", "deg"), ("moment", "N m"))
            for s in "rl"
        )
        first = [{**stride, "valid": [encode_base64(np.ones(101, dtype="<u1"))]}] if k == 0 else []
        trials.append(trial_data(trial, curves, first, events=[] if k else events))
    return page_data(scene, trials)


# ------------------------------------------------------------------------------------------ strides

UNITS = {"angle": "deg", "moment": "N m", "power": "W", "force": "N"}
SIZE = {"angle": 20.0, "moment": 40.0, "power": 80.0, "force": 300.0}
CURVES = (
    *((base, kind, True) for base in ("hip_flexion", "knee_angle", "knee_adduction")
        for kind in ("angle", "moment")),
    ("hip", "power", True), ("ankle_angle", "angle", True),
    ("ground_reaction_vertical", "force", True),
    ("pelvis_tilt", "angle", False), ("pelvis_list", "angle", False),
    ("lumbar_bending", "moment", False),
)  # fmt: skip
"""Base, kind, and whether each leg has one."""
VARIABLE = {"angle": "", "moment": "_moment", "power": "_power", "force": ""}
"""What `cycles.csv` adds to a base."""


def long_walks(trials: int = 3, repeat: int = 1) -> Scene:
    """The built-in person's walk several times, each of so many times as many frames."""
    scene = walking_scene()
    walk = scene.trials[0]
    step = float(np.diff(walk.time).mean())
    frames = ("origins", "turns", "measured", "forces", "pressure_centres", "valid", "valid_legs")
    longer = {name: np.concatenate([getattr(walk, name)] * repeat) for name in frames}
    longer["time"] = step * np.arange(repeat * len(walk.time))
    walks = (
        replace(walk, name=f"walk{k}", recorded=repeat * walk.recorded, **longer)
        for k in range(trials)
    )
    return replace(scene, trials=tuple(walks))


def stridden(
    scene: Scene, strides: dict[int, dict[str, list[float]]], seed: int = 4
) -> tuple[dict[str, Any], pd.DataFrame]:
    """Page data of a scene with stretches that are not valid, and the same strides as a table like
    `cycles.csv`.

    Parameters
    ----------
    strides : trial -> side -> strikes (s), so that each two are a stride; the second stride of a
    leg turns.
    """
    rng = np.random.default_rng(seed)
    rows, trials = [], []
    for t, trial in enumerate(scene.trials):
        time = trial.time - trial.time[0]
        curves = tuple(
            _wavy(rng, time, *of, side) for of in CURVES for side in ("rl" if of[2] else [""])
        )
        made = [
            {
                "side": side,
                "number": n + 1,
                "start": a,
                "stop": b,
                "off": a + 0.6 * (b - a),
                "turns": n == 1,
            }
            for side, strikes in strides.get(t, {}).items()
            for n, (a, b) in enumerate(itertools.pairwise(strikes))
        ]
        for stride in made:
            cycle = GaitCycle(stride["start"], stride["stop"], stride["off"])
            stride["valid"] = [
                encode_base64(find_valid_percents(time, mask, cycle).astype("<u1"))
                for mask in list_masks(curves)
            ]
            own = [c for c in curves if c.side in (stride["side"], "")]
            stride["peaks"] = _find_peaks(time, cycle, own)
            rows += [_rows(trial.name, stride, c, time) for c in own]
        events = [
            {"side": s["side"], "kind": kind, "time": when, "source": "motion"}
            for s in made
            for kind, when in (("foot strike", s["start"]), ("foot off", s["off"]))
        ]
        trials.append(
            trial_data(trial, curves, made, events=sorted(events, key=lambda event: event["time"]))
        )
    return page_data(scene, trials), pd.concat(rows, ignore_index=True) if rows else pd.DataFrame()


def _find_peaks(
    time: np.ndarray, cycle: GaitCycle, curves: list[Curve]
) -> dict[str, list[float | None]]:
    """Find the peaks of a stride, with pelvis angles of 0 along its line."""
    normalised = {}
    for c in curves:
        value, error, own = (normalise(time, v, cycle) for v in (c.value, c.error, c.stride_error))
        value = np.zeros(101) if c.base in PELVIS_ANGLES else value
        value = np.where(find_valid_percents(time, c.valid, cycle), value, np.nan)
        normalised[c.variable] = value, error, own
    found = find_stride_peaks(normalised, cycle.stance)
    return {name: list(map(round_number, values)) for name, values in found.items()}


def _wavy(
    rng: np.random.Generator, time: np.ndarray, base: str, kind: str, sided: bool, side: str
) -> Curve:
    waves = rng.standard_normal((4, 2))
    phases = 2 * np.pi * np.outer(np.arange(1, 5), time) / 0.5
    value = SIZE[kind] * (waves[:, :1] * np.sin(phases) + waves[:, 1:] * np.cos(phases)).sum(axis=0)
    value = value + 0.2 * SIZE[kind] * rng.standard_normal() * time
    error = SIZE[kind] * (0.1 + 0.05 * np.sin(7 * time))
    hole = rng.uniform(0.0, time[-1])
    valid = (np.abs(time - hole) > 0.06) if kind == "moment" else np.ones(len(time), dtype=bool)
    return Curve(
        base, side, kind, UNITS[kind], value, valid, error, 0.6 * error, value + 0.1 * SIZE[kind]
    )


def _rows(name: str, stride: dict[str, Any], curve: Curve, time: np.ndarray) -> pd.DataFrame:
    cycle = GaitCycle(stride["start"], stride["stop"], stride["off"])
    laid = [
        normalise(time, values, cycle) for values in (curve.value, curve.error, curve.stride_error)
    ]
    valid = np.isfinite(normalise(time, np.where(curve.valid, 1.0, np.nan), cycle)).astype(int)
    columns = {
        "person": SUBJECT.name,
        "session": "",
        "trial": name,
        "side": stride["side"],
        "stride": stride["number"],
    }
    columns |= {
        "percent": np.arange(101),
        "variable": f"{curve.base}{VARIABLE[curve.kind]}",
        "valid": valid,
    }
    columns |= dict(zip(("value", "se", "se_stride"), laid, strict=True))
    return pd.DataFrame(columns | {"turn": 40.0 if stride["turns"] else 0.0})


# --------------------------------------------------------------------------------------- everything

REFUSED: dict[str, tuple[str, ...]] = {"walk 1": (), "walk 2": ("l",), HOSTILE: ()}
"""Trial -> legs that the verdict refuses."""
STRAIGHT = 2.0
"""deg."""


def everything_page(**changes: Any) -> str:
    """The built-in person's walk under three names, every preset with every block; `changes` of the
    page data.
    """
    scene = walking_scene()
    scene = replace(scene, trials=tuple(replace(scene.trials[0], name=name) for name in REFUSED))
    strides = measured_strides()
    reasons = [
        {**explain_code(Code.PRESSURE_LEAVES_FOOT), "severity": "error",
         "cause": "plates and feet do not agree", "evidence": f"by 80 N {HOSTILE}",
         "action": "look at the plates", "trials": ["walk 2"], "leg": "l"},
        {"severity": "warning", "cause": "few markers", "evidence": "", "action": "", "trials": [],
            "leg": ""},
    ]  # fmt: skip
    measures = [
        {
            "name": n,
            "title": t,
            "digits": d,
            "unit": MEASURES[n],
            "least": LEAST_SD[MEASURES[n]],
            "compared": n not in OF_BOTH_LEGS,
        }
        for n, (t, d) in SHOWN_MEASURES.items()
    ]
    data = page_data(
        scene,
        [_everything_of(trial, strides[trial.name]) for trial in scene.trials],
        verdict={
            "judgement": "refused",
            "sentence": "Do not use the left leg.",
            "reasons": reasons,
        },
        lines=[
            {"tone": tone, "text": f"A line of tone {tone}."} for tone in ("poor", "look", "plain")
        ],
        measures=measures,
        sections={preset: every_block() for preset in PRESETS},
    )
    return render_page(PageContent(scene, data | changes))


def measured_strides(seed: int = 8) -> dict[str, tuple[Stride, ...]]:
    """Trial -> strides: whole ones and parts, some of which turn, some without all measures."""
    rng = np.random.default_rng(seed)

    def stride(side: str, number: int | None) -> Stride:
        names = [
            name
            for name in MEASURES
            if number is not None or (name.startswith("step") and rng.random() < 0.7)
        ]
        return Stride(
            side=side, number=number, start=0.0, stop=1.0, sources=(),
            turn=float(rng.choice([STRAIGHT, 40.0], p=[0.8, 0.2])),
            measures={name: float(rng.normal(1.0, 0.1)) for name in names},
        )  # fmt: skip

    return {
        name: tuple(stride(side, n) for side in "rl" for n in (1, 2, 3, None)) for name in REFUSED
    }


_USE: dict[str, Any] = {"plate": "1", "reason": "", "peaks": {}}


def _everything_of(trial: MotionScene, strides: tuple[Stride, ...]) -> dict[str, Any]:
    """Residuals with a peak of 60 N in frames that do not count, marker errors with a gap, angles
    and moments.
    """
    time, refused = trial.time - trial.time[0], REFUSED[trial.name]
    valid = time < 0.7 * time[-1]
    force = 20.0 + 40.0 * (time / time[-1]) ** 2
    error = np.where((time > 0.2) & (time < 0.3), np.nan, 4.0 + np.sin(9.0 * time))
    kinds = (
        ("residual_force", "N", force),
        ("residual_moment", "N m", 0.1 * force),
        ("marker_error", "mm", error),
    )
    joint = [
        Curve(
            base,
            side,
            kind,
            unit,
            20.0 * np.sin(6.0 * time + k),
            valid,
            error=np.full(len(time), 2.0),
        )
        for base in ("hip_flexion", "knee_angle", "knee_adduction", "ankle_angle")
        for kind, unit in (("angle", "deg"), ("moment", "N m"))
        for k, side in enumerate("rl")
    ]
    legs = {side: "refused" if side in refused else "trustworthy" for side in "rl"}
    curves = (*(Curve(k, "", k, u, v, valid, nominal=1.2 * v) for k, u, v in kinds), *joint)
    counted = [
        encode_base64(find_valid_percents(time, mask, GaitCycle(0.1, 0.9, 0.6)).astype("<u1"))
        for mask in list_masks(curves)
    ]
    stride = {
        "number": 1,
        "start": 0.1,
        "stop": 0.9,
        "off": 0.6,
        "turns": False,
        "peaks": {},
        "valid": counted,
    }
    return trial_data(
        trial,
        curves,
        [{**_USE, "side": s, **stride} for s in "rl"],
        verdict={"judgement": "refused" if refused else "trustworthy", **legs},
        measures=[
            {"side": s.side, "number": s.number, "values": dict(s.measures)}
            for s in select_straight_strides(strides, refused)
        ],
        sections={preset: every_block() for preset in PRESETS},
    )


def _table(**more: Any) -> dict[str, Any]:
    """Texts, numbers, tones and sides."""
    head = [
        "Segment, RMS in mm",
        {"t": "Right", "side": "r"},
        {"t": "Left", "side": "l"},
        {"t": "What", "align": "text"},
    ]
    rows = [
        ["pelvis", "8.1", {"t": "1.25", "tone": "good"}, "followed by its own markers"],
        [
            {"t": "thigh", "unit": "2 markers"},
            {"t": "12.4", "tone": "look"},
            "–",
            {"t": "above", "tone": "poor"},
        ],
        ["all", "9.9", "10.2", {"t": "not judged", "tone": "soft"}],
    ]
    return {"kind": "table", "head": head, "rows": rows, "total": [2], **more}


def _intervals() -> dict[str, Any]:
    """Both sides, a standard error that is not known, truth and bounds."""
    hip, knee = (
        {"label": "hip centre, forward", "nominal": 70.0},
        {"label": "knee axis, up", "nominal": 400.0},
    )
    rows = [
        {**hip, "side": "r", "fitted": 66.2, "se": 1.1, "truth": 65.0},
        {**hip, "side": "l", "fitted": 75.4, "se": 1.4, "truth": 77.0},
        {**knee, "side": "r", "fitted": 404.0, "se": None, "truth": None, "bounds": [396.0, 404.0]},
        {"label": "back, forward", "nominal": 0.0, "fitted": -3.0, "se": 2.0, "truth": 0.0},
    ]
    return {"kind": "intervals", "unit": "mm", "rows": rows}


def _heading(text: str, level: int = 3) -> dict[str, Any]:
    return {"kind": "heading", "text": text, "level": level}


def every_block() -> list[dict[str, Any]]:
    """One block of every kind, with names that would be markup if they were not data, in no order
    of sense.
    """
    wide = {
        "head": ["Marker", *(f"Column number {k}" for k in range(14))],
        "rows": [[f"{HOSTILE} {r}", *(f"{r}.{k}" for k in range(14))] for r in range(40)],
    }
    return [
        {"kind": "text", "text": "What is told first.", "tone": "soft"},
        _heading(f"Tables {HOSTILE}"),
        _table(),
        {"kind": "table", "caption": "Every marker", **wide},
        _table(caption="Folded away", fold="All of them"),
        _heading("Deeper", 4),
        {"kind": "text", "text": "Not converged: do not use these numbers.", "tone": "bad"},
        {"kind": "text", "text": "Look at the trials.", "tone": "warning"},
        {"kind": "list", "items": ["an assumption", HOSTILE], "tone": "soft"},
        _heading("Joint parameters"),
        _intervals(),
        {"kind": "fold", "title": "Monte Carlo", "blocks": [_heading("Spread", 4), _intervals()]},
        _heading("Pair"),
        {"kind": "pair", **{side: [{"kind": "text", "text": side}, _table()]
            for side in ("left", "right")}},
        {"kind": "curves", "kinds": ["residual_force", "residual_moment", "marker_error"]},
        {"kind": "of a later version"},
    ]  # fmt: skip
