"""One block of every kind that a sheet may hold, with names that would be markup if they were not data."""

from __future__ import annotations

from typing import Any

HOSTILE = '<img src=x onerror="document.title=1">'


def table(**more: Any) -> dict[str, Any]:
    """Texts, numbers, tones and sides."""
    return {
        "kind": "table",
        "head": [
            "Segment, RMS in mm",
            {"t": "Right", "side": "r"},
            {"t": "Left", "side": "l"},
            {"t": "What", "align": "text"},
        ],
        "rows": [
            ["pelvis", "8.1", {"t": "1.25", "tone": "good"}, "followed by its own markers"],
            [{"t": "thigh", "unit": "2 markers"}, {"t": "12.4", "tone": "look"}, "–", {"t": "above", "tone": "poor"}],
            ["all", "9.9", "10.2", {"t": "not judged", "tone": "soft"}],
        ],
        "total": [2],
        **more,
    }


def wide_table() -> dict[str, Any]:
    """Wider than a phone, and longer than a screen."""
    return {
        "kind": "table",
        "caption": "Every marker",
        "head": ["Marker", *(f"Column number {k}" for k in range(14))],
        "rows": [[f"{HOSTILE} {r}", *(f"{r}.{k}" for k in range(14))] for r in range(40)],
    }


def intervals() -> dict[str, Any]:
    """Both sides, a standard error that is not known, truth and bounds."""
    return {
        "kind": "intervals",
        "unit": "mm",
        "rows": [
            {"label": "hip centre, forward", "side": "r", "nominal": 70.0, "fitted": 66.2, "se": 1.1, "truth": 65.0},
            {"label": "hip centre, forward", "side": "l", "nominal": 70.0, "fitted": 75.4, "se": 1.4, "truth": 77.0},
            {"label": "knee axis, up", "side": "r", "nominal": 400.0, "fitted": 404.0, "se": None, "truth": None,
             "bounds": [396.0, 404.0]},
            {"label": "back, forward", "nominal": 0.0, "fitted": -3.0, "se": 2.0, "truth": 0.0},
        ],
    }  # fmt: skip


def bars() -> dict[str, Any]:
    """Error sources."""
    names = ("motion", "markers of joints", "nominal", "skin", "bandwidth", "inertia", "plates", "frames")
    rows = [("Knee adduction", "r", 0.042), ("Knee adduction", "l", 0.021), ("Hip flexion", "r", 0.034)]
    return {
        "kind": "bars",
        "unit": "N·m/kg",
        "rows": [
            {"label": label, "side": side, "total": total,
             "parts": [{"name": name, "value": float(1 + (k * 5 + len(label)) % 7)} for k, name in enumerate(names)]}
            for label, side, total in rows
        ],
    }  # fmt: skip


def boxes() -> dict[str, Any]:
    """Two groups."""
    box = {"low": -2.0, "q1": -0.6, "median": 0.1, "q3": 0.9, "high": 2.4}
    groups = [
        {"label": label, "boxes": [{"label": "peak moment", "side": side, **box} for side in "rl"]}
        for label in ("Hip flexion", "Knee adduction")
    ]
    return {"kind": "boxes", "unit": "N·m/kg", "title": "Deviation of peaks", "groups": groups}


def cards() -> dict[str, Any]:
    """With a judgement and without."""
    fit = {"question": "Does the model follow the markers?", "value": "9.1 mm", "verdict": "good", "tone": "good"}
    what = {"question": "What was calibrated?", "value": "61 parameters", "verdict": "", "tone": "plain"}
    return {"kind": "cards", "cards": [{**fit, "text": "RMS."}, {**what, "text": HOSTILE}]}


def heading(text: str, level: int = 3) -> dict[str, Any]:
    """Of what follows."""
    return {"kind": "heading", "text": text, "level": level}


def every_block() -> list[dict[str, Any]]:
    """In no order of sense."""
    halves = {side: [{"kind": "text", "text": side}, table()] for side in ("left", "right")}
    return [
        {"kind": "text", "text": "What is told first.", "tone": "soft"},
        heading(f"Tables {HOSTILE}"),
        table(),
        wide_table(),
        table(caption="Folded away", fold="All of them"),
        heading("Deeper", 4),
        {"kind": "text", "text": "Not converged: do not use these numbers.", "tone": "bad"},
        {"kind": "text", "text": "Look at the trials.", "tone": "warning"},
        {"kind": "list", "items": ["an assumption", HOSTILE], "tone": "soft"},
        cards(),
        heading("Joint parameters"),
        intervals(),
        heading("Error sources"),
        bars(),
        {"kind": "fold", "title": "Monte Carlo", "blocks": [heading("Spread", 4), boxes()]},
        heading("Pair"),
        {"kind": "pair", **halves},
        {"kind": "curves", "kinds": ["residual_force", "residual_moment", "marker_error"],
         "limits": {"residual_force": 40.0, "residual_moment": 9.0}},
        {"kind": "of a later version"},
    ]  # fmt: skip
