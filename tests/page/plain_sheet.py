"""A sheet to go with the walking scene of `people.py`: what the page asks of one, with numbers made up."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from gaitcal.page.bone_files import BoneMeshes
from gaitcal.page.plain_data import base64_of, floats, lengths
from gaitcal.page.scene import Scene, TrialScene
from gaitcal.page.view import Shown, page_html

EVENTS = {
    "r": [("foot strike", 0.05), ("foot off", 0.65), ("foot strike", 1.0)],
    "l": [("foot off", 0.1), ("foot strike", 0.5)],
}
"""s from the begin of the walk."""
_ROW = {
    "base": "hip_flexion",
    "title": "Hip flexion",
    "angle": ["flexion", "extension"],
    "moment": ["flexion", "extension"],
    "actor": "flexor",
    "flips": True,
    "pelvis": {},
}


def page_of(scene: Scene, *more: Shown, bones: BoneMeshes | None = None) -> str:
    """The page of a scene with its sheet, and of further results; `bones` unless those of the extra are to be used."""
    return page_html([Shown(scene, sheet_of(scene), "before"), *more], bones)


def sheet_of(scene: Scene) -> dict[str, Any]:
    """Right and left hip flexion of every trial; events and a stride in the first."""
    trials = [_trial(trial, events=k == 0) for k, trial in enumerate(scene.trials)]
    return {
        "format": 1,
        "program": "gaitcal",
        "made": "2026-01-01",
        "person": {
            "name": scene.subject,
            "session": "",
            "mass": scene.mass,
            "height": scene.height,
            "sex": "male",
            "weight": 9.81 * scene.mass,
            "bwh": 9.81 * scene.mass * scene.height,
        },
        "verdict": {"judgement": "trustworthy", "sentence": "Nothing speaks against it.", "reasons": []},
        "lines": [],
        "rows": [{"joint": "hip", "title": "Hip", "power": "hip", "rows": [copy.deepcopy(_ROW)]}],
        "measures": [],
        "bands": [],
        "sections": {},
        "trials": trials,
    }


def _trial(trial: TrialScene, *, events: bool) -> dict[str, Any]:
    time = trial.time - trial.time[0]
    valid = np.ones(len(time), dtype="<u1")
    wave = np.sin(6.0 * time)

    def curve(side: str, kind: str, unit: str) -> dict[str, Any]:
        return {
            "base": "hip_flexion",
            "side": side,
            "joint": "hip",
            "kind": kind,
            "unit": unit,
            "valid": 0,
            "value": lengths(30.0 * wave + (side == "l")),
            "se": lengths(1.0 + 0.0 * wave),
            "own": None,
            "nominal": lengths(29.0 * wave),
            "truth": None,
        }

    found = [{"side": s, "kind": k, "time": t, "source": "motion"} for s in EVENTS for k, t in EVENTS[s]]
    stride = {"side": "r", "number": 1, "start": 0.05, "stop": 1.0, "off": 0.65, "turns": False}
    return {
        "name": trial.name,
        "role": "walking",
        "joint": None,
        "refused": [],
        "verdict": None,
        "start": float(trial.time[0]),
        "duration": float(time[-1]),
        "frames": len(time),
        "every": 1,
        "time": floats(time),
        "masks": [base64_of(valid)],
        "curves": [curve(s, kind, unit) for kind, unit in (("angle", "deg"), ("moment", "N m")) for s in ("r", "l")],
        "events": found if events else [],
        "strides": [stride] if events else [],
        "measures": [],
        "line": 0.0,
        "relative": False,
        "sections": {},
    }
