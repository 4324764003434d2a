"""Isolated trials in which only the segments of their joint carry markers."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gaitcal as gc
from gaitcal.errors import Code, Severity
from gaitcal.model.anthropometry import move_limb_inertia
from gaitcal.model.linkage import list_joint_segments
from gaitcal.model.parameters import JP_INDEX
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.quality.study_checks import check_study
from gaitcal.study.study import Study
from gaitcal.tracking.motion import track_motion
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import build_trial_problem
from tests.kept import kept_real
from tests.messages import check_finding, check_text
from tests.quality.spoilt import findings, recording_of, serious, with_trial
from tests.synthetic_studies import only

SAME_RAD, SAME_RMS = 2e-3, 1e-3
"""Two trackings of the same markers by the same joint; their splines are in the coordinates of two
roots.
"""
IN_ERRORS = 1.0
"""Standard errors by which a joint parameter may differ where the pelvis is not seen: at most 0.5.
"""


@pytest.fixture(scope="module")
def uf3(real_study: Callable[[str], Study]) -> Study:
    return real_study("uf3")


def bare(study: Study, *joints: str) -> Study:
    """The study with trials of these joints that show the segments of their joint alone."""
    segment_of = study.marker_set.segment_of
    for joint in joints:
        worn = list_joint_segments(joint)
        study = with_trial(
            study, joint, lambda r, worn=worn: only(r, lambda label: segment_of.get(label) in worn)
        )  # type: ignore[misc]
    return study


def unseen(study: Study, trial: str, labels: Sequence[str]) -> Study:
    """Columns of one trial without a position."""
    hidden = with_trial(
        study,
        trial,
        lambda r: replace(
            r, markers=np.where(np.isin(r.labels, labels)[:, None], np.nan, r.markers)
        ),
    )
    return hidden


def test_check_accepts_it_and_says_what_carries_the_body(uf3: Study) -> None:
    study = bare(uf3, "knee_r", "ankle_l")
    assert serious(study) == []
    carried = {f.where: f.found for f in check_study(study) if f.code is Code.PELVIS_CARRIED}
    assert set(carried) == {"knee_r", "ankle_l"}
    check_text(carried["knee_r"], "thigh_r")
    check_text(carried["ankle_l"], "shank_l")


def test_columns_that_a_template_left_empty_are_no_fault_either(uf3: Study) -> None:
    """The pelvis has its labels in the file of a knee trial, and not one position."""
    pelvis = uf3.marker_set.tracking["pelvis"]
    assert serious(unseen(uf3, "knee_r", pelvis)) == []
    assert findings(unseen(uf3, "hip_r", pelvis), severity=Severity.ERROR, code=Code.NEVER_SEEN)


def test_a_proximal_segment_of_two_markers_carries_nothing(uf3: Study) -> None:
    thigh = [m for m in uf3.marker_set.tracking["thigh_r"] if uf3.marker_set.weight(m) > 0]
    errors = findings(unseen(bare(uf3, "knee_r"), "knee_r", thigh[2:]), severity=Severity.ERROR)
    (found,) = [f for f in errors if f.code is Code.FEW_MARKERS]
    check_finding(found, Code.FEW_MARKERS, "thigh_r", "knee_r")


@pytest.mark.parametrize("joint", ["knee_r", "ankle_l"])
def test_the_body_moves_as_its_joint_alone_does(uf3: Study, joint: str) -> None:
    model = build_nominal_model(uf3)
    recording = recording_of(bare(uf3, joint), joint)
    root, *_ = segments = list_joint_segments(joint)
    body = build_trial_problem(
        joint, model, recording, ControlPointRule(), fallback_base_segment=root
    )
    alone = build_trial_problem(
        joint, model, recording, ControlPointRule(), root=root, segments=segments
    )
    assert body.held[0] == f"hip_flexion_{joint[-1]}"
    whole, part = track_motion(body, model.nominal), track_motion(alone, model.nominal)
    assert whole.errors.rms() == pytest.approx(part.errors.rms(), rel=SAME_RMS)
    for name in part.coordinates[6:]:
        away = whole.q[:, whole.coordinates.index(name)] - part.q[:, part.coordinates.index(name)]
        assert np.abs(away).max() < SAME_RAD, name
    for name in body.held:
        assert not whole.q[:, whole.coordinates.index(name)].any()


@pytest.mark.slow
def test_joint_parameters_are_those_of_the_trials_with_the_pelvis(
    kept: Path, data_dir: Path, uf3: Study
) -> None:
    whole, part = kept_real(kept, "uf3", data_dir), gc.calibrate(bare(uf3, "knee_r", "ankle_r"))
    assert part.verdict.judgement is whole.verdict.judgement
    names = [
        n for n in whole.standard_errors if n.startswith(("knee_r", "talocrural_r", "subtalar_r"))
    ]
    assert len(names) >= 15
    for name in names:
        k = JP_INDEX[name]
        away = part.model.parameters.joint[k] - whole.model.parameters.joint[k]
        assert abs(away) < IN_ERRORS * whole.standard_errors[name], name
    before, after = part.nominal.parameters, part.model.parameters
    # masses go with the joints where no force tells of them, too
    np.testing.assert_allclose(
        after.inertial, move_limb_inertia(before.inertial, before, after), rtol=1e-12
    )
    assert np.abs(after.inertial - before.inertial).max() > 1e-3
