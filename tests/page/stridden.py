"""Sheets of made-up curves: several strides of each leg, some that turn, stretches that are not valid."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from gaitcal.gait.cycles import GaitCycle, normalise, usable
from gaitcal.model.subject_model import Subject
from gaitcal.page.page_data import FORMAT, coordinate_rows
from gaitcal.page.plain_data import base64_of, floats
from gaitcal.page.scene import Scene
from gaitcal.page.trial_data import Curve, masks_of, packed_curves
from tests.page.people import walking_scene

SUBJECT = Subject("Built-in subject", 69.4, 1.70, "male")
UNITS = {"angle": "deg", "moment": "N m", "power": "W", "force": "N"}
SIZE = {"angle": 20.0, "moment": 40.0, "power": 80.0, "force": 300.0}
CURVES = (
    *((base, kind, True) for base in ("hip_flexion", "knee_angle", "knee_adduction") for kind in ("angle", "moment")),
    ("hip", "power", True), ("ankle_angle", "angle", True), ("ground_reaction_vertical", "force", True),
    ("pelvis_tilt", "angle", False), ("pelvis_list", "angle", False), ("lumbar_bending", "moment", False),
)  # fmt: skip
"""Base, kind, and whether each leg has one."""
VARIABLE = {"angle": "", "moment": "_moment", "power": "_power", "force": ""}
"""What `cycles.csv` adds to a base."""


def long_walks(trials: int = 3, repeat: int = 1) -> Scene:
    """The built-in person's walk several times, each of so many times as many frames."""
    scene = walking_scene()
    walk = scene.trials[0]

    def more(array: np.ndarray) -> np.ndarray:
        return np.concatenate([array] * repeat)

    step = float(np.diff(walk.time).mean())
    frames = ("origins", "turns", "measured", "forces", "pressure_centres", "valid", "valid_legs")
    longer = {name: more(getattr(walk, name)) for name in frames} | {"time": step * np.arange(repeat * len(walk.time))}
    walks = (replace(walk, name=f"walk{k}", recorded=repeat * walk.recorded, **longer) for k in range(trials))
    return replace(scene, trials=tuple(walks))


def stridden(
    scene: Scene, strides: dict[int, dict[str, list[float]]], seed: int = 4
) -> tuple[dict[str, Any], pd.DataFrame]:
    """A sheet of a scene, and the same strides as a table like `cycles.csv`.

    Parameters
    ----------
    strides : trial -> side -> strikes (s), so that each two are a stride; the second stride of a leg turns.
    """
    rng = np.random.default_rng(seed)
    rows, trials = [], []
    for t, trial in enumerate(scene.trials):
        time = trial.time - trial.time[0]
        curves = tuple(_curve(rng, time, *of, side) for of in CURVES for side in ("rl" if of[2] else [""]))
        made = [
            {"side": side, "number": n + 1, "start": a, "stop": b, "off": a + 0.6 * (b - a), "turns": n == 1}
            for side, strikes in strides.get(t, {}).items()
            for n, (a, b) in enumerate(itertools.pairwise(strikes))
        ]
        for stride in made:
            cycle = GaitCycle(stride["start"], stride["stop"], stride["off"])
            stride["valid"] = [base64_of(usable(time, mask, cycle).astype("<u1")) for mask in masks_of(curves)]
            for curve in curves:
                if curve.side in (stride["side"], ""):
                    rows.append(_rows(trial.name, stride, curve, time))
        trials.append(_trial(trial.name, time, curves, made))
    person = {key: getattr(SUBJECT, key) for key in ("name", "session", "mass", "height", "sex", "weight", "bwh")}
    verdict = {"judgement": "trustworthy", "sentence": "", "reasons": []}
    sheet = {
        "format": FORMAT, "program": "gaitcal", "made": "", "person": person, "verdict": verdict, "lines": [],
        "rows": coordinate_rows(), "measures": [], "bands": [], "sections": {}, "trials": trials,
    }  # fmt: skip
    return sheet, pd.concat(rows, ignore_index=True) if rows else pd.DataFrame()


def _curve(rng: np.random.Generator, time: np.ndarray, base: str, kind: str, sided: bool, side: str) -> Curve:
    waves = rng.standard_normal((4, 2))
    phases = 2 * np.pi * np.outer(np.arange(1, 5), time) / 0.5
    value = SIZE[kind] * (waves[:, :1] * np.sin(phases) + waves[:, 1:] * np.cos(phases)).sum(axis=0)
    value = value + 0.2 * SIZE[kind] * rng.standard_normal() * time
    error = SIZE[kind] * (0.1 + 0.05 * np.sin(7 * time))
    hole = rng.uniform(0.0, time[-1])
    valid = (np.abs(time - hole) > 0.06) if kind == "moment" else np.ones(len(time), dtype=bool)
    return Curve(
        base=base, side=side, kind=kind, unit=UNITS[kind], value=value, valid=valid, error=error, own=0.6 * error,
        nominal=value + 0.1 * SIZE[kind],
    )  # fmt: skip


def _rows(name: str, stride: dict[str, Any], curve: Curve, time: np.ndarray) -> pd.DataFrame:
    cycle = GaitCycle(stride["start"], stride["stop"], stride["off"])
    laid = [normalise(time, values, cycle) for values in (curve.value, curve.error, curve.own)]
    usable = normalise(time, np.where(curve.valid, 1.0, np.nan), cycle)
    columns = {"person": SUBJECT.name, "session": "", "trial": name, "side": stride["side"], "stride": stride["number"]}
    columns |= {"percent": np.arange(101), "variable": f"{curve.base}{VARIABLE[curve.kind]}"}
    columns |= dict(zip(("value", "se", "se_stride"), laid, strict=True)) | {"valid": np.isfinite(usable).astype(int)}
    return pd.DataFrame(columns | {"turn": 40.0 if stride["turns"] else 0.0})


def _trial(name: str, time: np.ndarray, curves: tuple[Curve, ...], strides: list[dict[str, Any]]) -> dict[str, Any]:
    events = [
        {"side": s["side"], "kind": kind, "time": when, "source": "motion"}
        for s in strides
        for kind, when in (("foot strike", s["start"]), ("foot off", s["off"]))
    ]
    return {
        "name": name, "role": "walking", "joint": None, "refused": [], "verdict": None, "start": 0.0,
        "duration": float(time[-1]), "frames": len(time), "every": 1, "time": floats(time), **packed_curves(curves, 1),
        "events": sorted(events, key=lambda event: event["time"]), "strides": strides, "measures": [], "line": 0.0,
        "relative": False, "sections": {},
    }  # fmt: skip
