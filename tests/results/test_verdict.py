"""A refused result says so wherever its numbers stand, and has none that count."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.analysis.result import Calibration, remove_refused_results
from gaitcal.cli.calibrate_command import calibrate_study as run_calibrate
from gaitcal.cli.console import Console
from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.quality.verdict import judge
from gaitcal.results.saved_result import load_result
from gaitcal.results.summary import find_model_doubts, require_not_refused, summarise_calibration
from gaitcal.results.table_files import REFUSED_HEADER
from gaitcal.results.trial_tables import build_moment_table
from tests.fake_result import fake_calibration
from tests.messages import check_finding, refuses
from tests.report.page.walked_blocks import page_words
from tests.synthetic_studies import write_synthetic_study


def with_finding(
    severity: Severity, where: str, leg: str = "", topic: str = "forces"
) -> Calibration:
    whole = fake_calibration()
    finding = Finding(
        code=Code.CLOCKS_DIFFER, severity=severity, topic=topic, where=where, leg=leg,
        cause="the forces come late", found="by 60 ms", cure="do",
    )  # fmt: skip
    walks = [t.name for t in whole.trials if t.joint is None]
    return remove_refused_results(
        replace(whole, findings=(finding,), verdict=judge([finding], walks))
    )


def test_what_is_refused_has_no_valid_torque_and_no_error_bar() -> None:
    for where in ("walk", STUDY):
        refused = with_finding(Severity.ERROR, where)
        trial = refused.trial("walk")
        assert trial.is_refused and trial.loads is not None and trial.coordinate_errors is None
        assert not trial.loads.reactions.valid.any() and trial.loads.errors is None
        assert refused.standard_errors == {}
    doubtful = with_finding(Severity.WARNING, "walk")
    trial = doubtful.trial("walk")
    assert not trial.is_refused and trial.loads is not None and trial.loads.reactions.valid.any()


@pytest.mark.parametrize(
    ("severity", "word"), [(Severity.ERROR, "refused"), (Severity.WARNING, "doubtful")]
)
def test_summary_and_report_tell_it_with_its_reason(severity: Severity, word: str) -> None:
    told = summarise_calibration(with_finding(severity, "walk"))
    assert told["verdict"] == word and told["trials"]["walk"]["verdict"] == word
    (reason,) = told["reasons"]
    assert reason == {
        "code": "GC-069", "cause": "the forces come late", "evidence": "by 60 ms", "action": "do",
        "trial": "walk",
        "trials": ["walk"], "leg": "", "topic": "forces", "severity": severity.value,
    }  # fmt: skip
    assert told["warnings"] == ["walk: the forces come late: by 60 ms; do"]
    page = page_words(with_finding(severity, "walk"))
    assert page.startswith(f"{word}\n") and "the forces come late" in page


@pytest.mark.parametrize("topic", ["forces", "clusters"])
@pytest.mark.parametrize("where", ["walk", "static", STUDY])
@pytest.mark.parametrize("severity", list(Severity))
def test_a_further_trial_inherits_what_is_wrong_with_the_model(
    severity: Severity, where: str, topic: str
) -> None:
    """What is wrong with the markers of a walk is in its joints; what is wrong with its forces is
    not.
    """
    told = find_model_doubts(summarise_calibration(with_finding(severity, where, topic=topic)))
    if severity is Severity.INFO or (where == "walk" and topic == "forces"):
        assert told == ()
    else:
        assert [f.severity for f in told] == [severity]


def test_one_refused_leg_leaves_the_other() -> None:
    """Neither its torques count nor those that need both legs; the other leg keeps its frames and
    error bars.
    """
    sound, result = fake_calibration().trial("walk"), with_finding(Severity.ERROR, "walk", "r")
    trial = result.trial("walk")
    assert trial.refused_legs == ("r",) and not trial.is_refused
    reactions = trial.loads.reactions
    assert not reactions.valid_r.any() and not reactions.valid.any()
    np.testing.assert_array_equal(reactions.valid_l, sound.loads.reactions.valid_l)
    table = build_moment_table(trial.loads)
    before = build_moment_table(sound.loads)
    for name in ("hip_flexion", "ankle_angle", "knee_adduction"):
        assert np.isnan(table[f"{name}_r_se"]).all()
        np.testing.assert_array_equal(table[f"{name}_l_se"], before[f"{name}_l_se"])
        assert np.isfinite(table[f"{name}_l_se"]).all()
    assert np.isnan(table["lumbar_extension_se"]).all()
    told = summarise_calibration(result)["trials"]["walk"]
    assert (told["verdict"], told["verdict_r"], told["verdict_l"]) == (
        "doubtful",
        "refused",
        "trustworthy",
    )
    assert told["valid_frames"] == told["valid_frames_r"] == 0 < told["valid_frames_l"]
    assert (
        "hip_flexion_r" not in told["torque_change_bwh"]
        and "hip_flexion_l" in told["torque_change_bwh"]
    )


@pytest.mark.slow
def test_a_refused_calibration_is_written_refused_and_ends_in_1(tmp_path: Path) -> None:
    """The vertical force of both plates in kgf: nothing that `check` refuses by itself."""
    path = write_synthetic_study(tmp_path / "study")
    forces = tmp_path / "study/walk_forces.csv"
    table = pd.read_csv(forces, comment="#")
    scaled = [c for c in table if "_f" in c or "_m" in c or c.endswith(("vx", "vy", "vz"))]
    assert scaled
    table[scaled] /= 9.80665
    table.to_csv(forces, index=False)
    result = tmp_path / "result"
    with refuses(Code.FORCES_OF_ANOTHER):
        run_calibrate(Console(quiet=True, verbose=False), path, result, force=False)
    run_calibrate(Console(quiet=True, verbose=False), path, result, force=True)
    told = json.loads((result / "summary.json").read_text(encoding="utf-8"))
    assert told["verdict"] == "refused"
    text = (result / "moments/walk.csv").read_text(encoding="utf-8")
    assert text.startswith(f"# {REFUSED_HEADER[0]}\n")
    assert (
        (result / "cycles.csv")
        .read_text(encoding="utf-8")
        .startswith(f"# walk: {REFUSED_HEADER[0]}\n")
    )
    moments = pd.read_csv(result / "moments/walk.csv", comment="#")
    assert not moments["valid"].any() and moments["hip_flexion_r_se"].isna().all()
    assert load_result(result).uncertainty.joint is None
    with refuses(Code.MODEL_IN_DOUBT, source="result"):
        require_not_refused(result)
    (result / "summary.json").write_text(
        json.dumps(told | {"verdict": "trustworthy"}), encoding="utf-8"
    )
    with refuses(Code.DAMAGED_RESULT, source="summary.json"):
        load_result(result)


def test_forces_that_leave_the_swing_alone_do_not_say_that_no_torque_is_valid() -> None:
    trial = fake_calibration().trial("walk")
    reactions = trial.loads.reactions
    everywhere, nowhere = np.ones_like(reactions.valid_legs), np.zeros_like(reactions.valid_legs)
    causes = set()
    for legs in (everywhere, nowhere):
        bare = replace(reactions, valid_legs=legs, loaded=np.zeros_like(reactions.loaded))
        found = replace(trial, loads=replace(trial.loads, reactions=bare)).findings
        (finding,) = (f for f in found if f.topic == "plates")
        check_finding(finding, Code.NO_STANCE)
        causes.add(finding.cause)
    assert len(causes) == 2
