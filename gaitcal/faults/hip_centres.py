"""Hip centres that the study takes from its file: whether hips can lie there, against Harrington's and each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import DOUBTED_GIVEN, UNEVEN_GIVEN, HipCentre, PelvicWidth, hip_centre

_LEFT = np.array([1.0, 1.0, -1.0])
"""A point of the left half of the pelvis, mirrored."""


def given(trial: TrialEvidence) -> Iterator[Finding]:
    """Given hip centres far from where the pelvis's markers tell, or of which one lies otherwise than the other."""
    makes_model = trial.rebuilding is not None and trial.model is not None
    if not makes_model or trial.model is None or trial.settings.hip_rule != HipCentre.GIVEN.value:
        return
    p = {name: at for name, (_, at) in trial.model.landmarks.items()}
    between = float(np.linalg.norm(p["asis_r"] - p["asis_l"]))
    width = PelvicWidth(between, trial.subject.asis_distance).of(HipCentre.HARRINGTON)
    depth = float(np.linalg.norm(0.5 * (p["asis_r"] + p["asis_l"]) - p["sacrum"]))
    gaps = {
        side: float(np.linalg.norm(p[f"hjc_{side}"] - hip_centre(HipCentre.HARRINGTON, width, depth, side)))
        for side in SIDES
    }
    uneven = p["hjc_r"] - _LEFT * p["hjc_l"]
    apart, off = float(np.linalg.norm(uneven)), max(gaps.values())
    too_far = max(off / (DOUBTED_GIVEN * between), apart / (UNEVEN_GIVEN * between))
    if too_far <= 1.0:
        return
    ahead, up, outwards = 1e3 * uneven
    allowed = [1e3 * share * between for share in (DOUBTED_GIVEN, UNEVEN_GIVEN)]
    yield trial.warning(
        "hip centres",
        f"{1e3 * gaps['r']:.0f} mm (right) and {1e3 * gaps['l']:.0f} mm (left) from where Harrington 2007 has them, "
        f"usual is up to {allowed[0]:.0f}; the right one lies {ahead:+.0f} mm forward, {up:+.0f} mm up and "
        f"{outwards:+.0f} mm outwards of the left one's mirror image, usual is up to {allowed[1]:.0f}",
        "look where that program has them from, or take hip_centre = 'harrington' under [calibration]",
        cause="the hip centres of the file are not where hips usually are",
        weight=too_far,
        code=Code.GIVEN_HIPS,
    )
