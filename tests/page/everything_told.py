"""A page that has everything to tell: blocks of every kind, a verdict with reasons, steps of strides that turn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gaitcal.codes import Code
from gaitcal.gait.spatiotemporal import MEASURES, Stride
from gaitcal.page.page_data import FORMAT, SHOWN_MEASURES, coordinate_rows, explained_code
from gaitcal.page.plain_data import floats
from gaitcal.page.scene import Scene
from gaitcal.page.trial_data import Curve, packed_curves
from gaitcal.page.view import Shown, page_html
from tests.page.blocks_made import HOSTILE, every_block
from tests.page.people import walking_scene

REFUSED: dict[str, tuple[str, ...]] = {"walk 1": (), "walk 2": ("l",), HOSTILE: ()}
"""Trial -> legs that the verdict refuses."""
STRAIGHT = 2.0
"""deg."""
PRESETS = ("clinician", "fit", "joints", "trust", "provenance")


def told_scene() -> Scene:
    """The built-in person's walk under three names."""
    scene = walking_scene()
    return replace(scene, trials=tuple(replace(scene.trials[0], name=name) for name in REFUSED))


def told_page(**changes: Any) -> str:
    """The page; `changes` replace parts of its sheet."""
    scene = told_scene()
    return page_html([Shown(scene, told_sheet(scene) | changes, "before")])


def made_strides(seed: int = 8) -> dict[str, tuple[Stride, ...]]:
    """Trial -> strides: whole ones and parts, some of which turn, some without all measures."""
    rng = np.random.default_rng(seed)

    def stride(side: str, number: int | None) -> Stride:
        names = [name for name in MEASURES if number is not None or (name.startswith("step") and rng.random() < 0.7)]
        return Stride(
            side=side, number=number, start=0.0, stop=1.0, sources=(),
            turn=float(rng.choice([STRAIGHT, 40.0], p=[0.8, 0.2])),
            measures={name: float(rng.normal(1.0, 0.1)) for name in names},
        )  # fmt: skip

    return {name: tuple(stride(side, n) for side in "rl" for n in (1, 2, 3, None)) for name in REFUSED}


def told_sheet(scene: Scene) -> dict[str, Any]:
    """Every preset of person and trial holds every block."""
    strides = made_strides()
    person = {
        "name": scene.subject,
        "session": "June",
        "mass": 69.4,
        "height": 1.7,
        "sex": "male",
        "weight": 680.8,
        "bwh": 1157.4,
    }
    reasons = [
        {**explained_code(Code.PRESSURE_LEAVES_FOOT), "severity": "error",
         "cause": "plates and feet do not agree", "evidence": f"by 80 N {HOSTILE}",
         "action": "look at the plates", "trials": ["walk 2"], "leg": "l"},
        {"severity": "warning", "cause": "few markers", "evidence": "", "action": "", "trials": [], "leg": ""},
    ]  # fmt: skip
    return {
        "format": FORMAT, "program": "gaitcal", "made": "22 November 2026", "person": person,
        "verdict": {"judgement": "refused", "sentence": "Do not use the left leg.", "reasons": reasons},
        "lines": [{"tone": tone, "text": f"A line of tone {tone}."} for tone in ("poor", "look", "plain")],
        "rows": coordinate_rows(), "bands": [],
        "measures": [{"name": n, "title": t, "digits": d, "unit": MEASURES[n]} for n, (t, d) in SHOWN_MEASURES.items()],
        "sections": {preset: every_block() for preset in PRESETS},
        "trials": [_trial(scene, k, strides[trial.name]) for k, trial in enumerate(scene.trials)],
    }  # fmt: skip


def _trial(scene: Scene, index: int, strides: tuple[Stride, ...]) -> dict[str, Any]:
    trial = scene.trials[index]
    refused = REFUSED[trial.name]
    time = trial.time - trial.time[0]
    legs = {side: "refused" if side in refused else "trustworthy" for side in "rl"}
    return {
        "name": trial.name, "role": "walking", "joint": None, "refused": list(refused),
        "verdict": {"judgement": "refused" if refused else "trustworthy", **legs},
        "start": 0.0, "duration": float(time[-1]), "frames": len(time), "every": 1, "time": floats(time),
        **packed_curves(curves(time), 1),
        "events": [], "line": 0.0, "relative": False,
        "strides": [{"side": s, "number": 1, "start": 0.1, "stop": 0.9, "off": 0.6, "turns": False} for s in "rl"],
        "measures": [
            {"side": s.side, "number": s.number, "turns": s.turn != STRAIGHT, "values": dict(s.measures)}
            for s in strides
        ],
        "sections": {preset: every_block() for preset in PRESETS},
    }  # fmt: skip


def curves(time: np.ndarray) -> tuple[Curve, ...]:
    """Residuals with a peak of 60 N in frames that do not count, marker errors with a gap, angles and moments."""
    valid = time < 0.7 * time[-1]
    force = 20.0 + 40.0 * (time / time[-1]) ** 2
    error = np.where((time > 0.2) & (time < 0.3), np.nan, 4.0 + np.sin(9.0 * time))
    kinds = (("residual_force", "N", force), ("residual_moment", "N m", 0.1 * force), ("marker_error", "mm", error))
    own = [Curve(base=k, side="", kind=k, unit=u, value=v, valid=valid, nominal=1.2 * v) for k, u, v in kinds]
    two = np.full(len(time), 2.0)
    joint = [
        Curve(base=b, side=side, kind=kind, unit=unit, value=20.0 * np.sin(6.0 * time + k), valid=valid, error=two)
        for b in ("hip_flexion", "knee_angle", "knee_adduction", "ankle_angle")
        for kind, unit in (("angle", "deg"), ("moment", "N m"))
        for k, side in enumerate("rl")
    ]
    return (*own, *joint)
