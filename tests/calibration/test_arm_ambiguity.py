"""An arm that a fit turned about itself keeps its nominal joints, and is told; an arm that swings far is not one."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import gaitcal as gc
from gaitcal.calibration.identifiability import LARGEST_ARM_TURN, ambiguous_arm_findings, arm_ambiguity, without_arms
from gaitcal.model.parameters import JP_NAMES
from gaitcal.motion.start import starting_nodes
from gaitcal.session.draft import study_of
from gaitcal.session.drafting import draft_of
from gaitcal.session.folder import read_folder
from gaitcal.session.person_facts import Options
from tests.derivatives import perturbed_parameters, random_trial

PARAMETERS = perturbed_parameters(np.random.default_rng(3), 0.0, 0.0)


@pytest.mark.parametrize(("side", "turn", "found"), [("r", 1.1, True), ("l", 1.1, True), ("r", 0.9, False)])
@pytest.mark.parametrize("coordinate", ["arm_flex", "arm_add", "elbow_flex"])
@pytest.mark.parametrize("whole", [0.0, 2.0 * np.pi])
def test_an_arm_far_from_where_its_markers_begin(
    side: str, turn: float, found: bool, coordinate: str, whole: float
) -> None:
    """Whole turns are none; most of the time counts, not a moment."""
    body, _ = random_trial(np.random.default_rng(4), PARAMETERS, frames=60, nodes=10)
    start = starting_nodes(body.chain, body.constants(PARAMETERS), body.data, body.basis)
    nodes = start.copy()
    nodes[:, body.chain.coordinates.index(f"{coordinate}_{side}")] += turn * LARGEST_ARM_TURN + whole
    turned = arm_ambiguity([body, body], [start, nodes], PARAMETERS)
    assert list(turned) == ([side] if found else [])
    if found:
        assert turned[side] == pytest.approx(turn * LARGEST_ARM_TURN)
        assert f"{np.rad2deg(turn * LARGEST_ARM_TURN):.0f} degrees" in ambiguous_arm_findings(turned)[0].found


def test_only_joints_of_that_arm_stay() -> None:
    left = without_arms(JP_NAMES, {"r": 3.0})
    assert {name.split(".")[0] for name in set(JP_NAMES) - set(left)} == {"shoulder_r", "elbow_r"}


@pytest.mark.slow
def test_a_child_whose_elbow_bends_outwards(tmp_path: Path) -> None:
    """One walk: without walls the fit turned the right arm by 168 degrees and met its markers worse than before."""
    folder = Path(os.environ.get("GAITCAL_DATA", "none")) / "children" / "HC002D"
    if not folder.is_dir():
        pytest.skip("GAITCAL_DATA")
    for name in ("static.c3d", "straight.c3d"):
        (tmp_path / name).symlink_to(folder / name)
    calibration = gc.calibrate(study_of(draft_of(read_folder(tmp_path), Options(sex="female"))))
    nominal, fitted, _ = calibration.trial("straight").rms_mm()
    assert nominal is not None
    assert fitted is not None
    assert fitted < 0.9 * nominal
