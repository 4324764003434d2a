"""One example for each command, at the end of its `--help`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

EXAMPLES: Final[Mapping[str, str]] = {
    "demo": "gaitcal demo",
    "example": "gaitcal example subject01 --out subject01",
    "init": "gaitcal init recordings --mass 72.6 --height 1.80 --sex male",
    "check": "gaitcal check study.toml",
    "calibrate": "gaitcal calibrate study.toml --out result",
    "cohort": "gaitcal cohort people --out results --jobs 4",
    "dynamics": "gaitcal dynamics result walk2.c3d walk3.c3d",
    "convert": "gaitcal convert walk.c3d walk.csv",
    "synthesize": "gaitcal synthesize --out person --seed 1 --noise",
    "montecarlo": "gaitcal montecarlo result --vary jp,ip --levels 50,100 --draws 1000",
    "reproduce": "gaitcal reproduce --out published",
    "export": "gaitcal export result --format osim,urdf",
    "figures": "gaitcal figures result --only knee_adduction --width 85mm",
    "view": "gaitcal view result",
    "compare": "gaitcal compare before after --out difference",
    "explain": "gaitcal explain GC-020",
}
"""Command -> a whole line that can be typed."""


def epilog(name: str) -> str | None:
    """What ends the help of a command; None for one without an example."""
    return f"Example: {EXAMPLES[name]}" if name in EXAMPLES else None
