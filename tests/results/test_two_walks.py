"""Two walks of one person, each a result of its own: no change that is not there; and one model for both."""

from pathlib import Path

import numpy as np
import pytest

from gaitcal.compare.stride_sets import Common
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.parameters import JP_NAMES
from gaitcal.results.calibration import write_results
from gaitcal.results.sessions import compare_results
from gaitcal.results.shared_model import compare_with_shared_model
from gaitcal.session.calibrate import calibrate
from gaitcal.study.study import Study

WALKS = ("walk03", "walk04")
EXPECTED = 0.95
"""Part of the differences of joint parameters inside bars of 95 %; measured over ten pairs of walks: all of them."""


@pytest.mark.slow
def test_walk_against_walk(data_dir: Path, tmp_path: Path) -> None:
    studies, results = [], []
    for name in WALKS:
        trials = [
            f'[[trial]]\nname = "{trial}"\nrole = "{role}"\n'
            f'file = "{(data_dir / "labs_c3d/multi" / trial).as_posix()}.c3d"\n'
            for trial, role in (("static", "static"), (name, "gait"))
        ]
        person = '[subject]\nname = "S4"\nmass_kg = 53.5\nheight_m = 1.634\nsex = "female"\n'
        studies.append(tmp_path / f"{name}.toml")
        studies[-1].write_text(person + '[markers]\nset = "plug-in-gait"\n' + "".join(trials), encoding="utf-8")
        results.append(write_results(calibrate(Study.load(studies[-1])), tmp_path / name))
    found = compare_results(*results)
    assert found.common is Common.STATIC and found.names == WALKS
    joints = [d for d in found.found if d.kind.startswith("joint") and not d.beyond_legs]
    assert len(joints) == sum(name.startswith(LEG_JOINTS) for name in JP_NAMES)
    assert np.mean([not d.exceeds for d in joints]) >= EXPECTED
    assert any(d.difference != 0.0 for d in joints)
    comparison, parameters = compare_with_shared_model(*results, studies)
    assert (parameters["a_shared"] == parameters["b_shared"]).all()
    ratio = parameters[["a_shared_se", "b_shared_se"]].to_numpy() / parameters[["a_alone_se", "b_alone_se"]].to_numpy()
    assert np.median(ratio) < 1.0
    assert comparison.common is Common.SHARED_FRAMES
    assert not [d for d in comparison.found if d.kind.startswith("joint")]
