"""A study is prepared once, in one order, and everything after it takes the same object."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.analysis import calibrate as stages
from gaitcal.calibration.joint_prior import ANATOMY
from gaitcal.errors import Code, Severity
from gaitcal.pipeline import run_study
from gaitcal.preprocess import preprocessed_study, trial_evidence
from gaitcal.preprocess.preprocessed_study import preprocess_study, preprocess_trial
from gaitcal.quality.study_checks import check_further, check_preprocessed, check_study
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from tests.messages import check_finding
from tests.quality.spoilt import findings, serious, sound_study, swapped, with_trial

COUNTED = {
    preprocessed_study: (
        "clean_trial",
        "rebuild_static",
        "build_nominal_from_clean",
        "restore_swapped_labels",
    ),
    trial_evidence: (
        "find_swapped_labels",
        "find_contradictions",
        "find_displaced_intervals",
        "find_plate_contacts",
        "Feet",
    ),
}


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """How often each step of the preparation is carried out."""
    count = Counter[str]()

    def counted(name: str, step: Callable[..., object]) -> Callable[..., object]:
        def carry_out(*args: object, **options: object) -> object:
            count[name] += 1
            return step(*args, **options)

        return carry_out

    for module, names in COUNTED.items():
        for name in names:
            monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
    return count


@pytest.fixture
def study() -> Study:
    """Standing and a walk over plates, with nominal joint parameters."""
    sound = sound_study()
    kept = tuple(t for t in sound.trials if t.name in ("static", "walk"))
    return replace(
        sound, trials=kept, settings=CalibrationSettings(jp=False, nodes_per_second=10.0)
    )


def test_a_calibration_carries_out_every_step_once(study: Study, calls: Counter[str]) -> None:
    """With its checks: each trial is cleaned, and what it shows found, one time."""
    stages.calibrate(study)
    assert calls == {
        "clean_trial": 2,
        "restore_swapped_labels": 2,
        "rebuild_static": 1,
        "build_nominal_from_clean": 1,
        "find_swapped_labels": 2,
        "find_contradictions": 1,
        "find_displaced_intervals": 2,
        "Feet": 1,
        "find_plate_contacts": 1,
    }


def test_a_run_prepares_its_study_once(
    study: Study, calls: Counter[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    taken = list[object]()
    monkeypatch.setattr(run_study.Study, "load", lambda _: study)
    monkeypatch.setattr(run_study, "load_study_file", lambda _: None)
    monkeypatch.setattr(run_study, "list_input_files", lambda *_: ())
    monkeypatch.setattr(
        run_study, "calibrate_preprocessed", lambda prepared, *_, **__: taken.append(prepared)
    )
    # What follows needs a calibration.
    with pytest.raises(AttributeError):
        run_study.run_found_study(tmp_path / "x.toml", tmp_path / "out", run_study.RunSettings())
    (prepared,) = taken
    assert calls["clean_trial"] == len(study.trials) and calls["build_nominal_from_clean"] == 1
    assert isinstance(prepared, preprocessed_study.PreprocessedStudy) and prepared.study is study


def test_checks_change_nothing_and_say_the_same_again(study: Study) -> None:
    prepared = preprocess_study(study)
    before = [t.recording.markers.copy() for t in prepared.trials]
    assert check_preprocessed(prepared) == check_preprocessed(prepared) == check_study(study)
    for trial, markers in zip(prepared.trials, before, strict=True):
        np.testing.assert_array_equal(trial.recording.markers, markers)


def test_labels_exchanged_for_a_part_are_put_back_in_a_study_and_in_a_further_trial() -> None:
    sound = sound_study()
    pair = ("R.Thigh.Front", "R.Thigh.Rear")
    spoilt = with_trial(sound, "walk", swapped(*pair, slice(50, 80)))
    prepared = preprocess_study(spoilt)
    assert prepared.model_or_none is not None
    walk = next(t for t in prepared.trials if t.name == "walk")
    alone = preprocess_trial(
        spoilt.trials[1], prepared.model_or_none, spoilt.marker_set, spoilt.settings
    )
    for trial in (walk, alone):
        (back,) = trial.restored_swaps
        assert {back.label, back.other} == set(pair)
        assert np.flatnonzero(back.frames).tolist() == list(range(50, 80))
        np.testing.assert_array_equal(trial.recording.markers, sound.trials[1].recording.markers)
        assert trial.swapped_labels == () and trial.with_labels_restored is trial
    codes = {f.code for f in check_further(alone)}
    assert Code.EXCHANGED_BACK in codes and Code.EXCHANGED_LABELS not in codes
    np.testing.assert_array_equal(
        next(t for t in prepared.study.trials if t.name == "walk").recording.markers,
        spoilt.trials[1].recording.markers,
    )


KNOCKED = {
    "subject01": ("R.Thigh.Upper", "R.Thigh.Front", "R.Thigh.Rear"),
    "uf3": ("R_Thigh_Superior", "R_Thigh_Inferior", "R_Thigh_Lateral"),
}
PLACED_M = 0.012
"""By the rest of the leg, whose joints moving people have this far from where they stand."""


@pytest.mark.parametrize("name", KNOCKED)
def test_a_cluster_knocked_since_the_static_trial_is_placed_by_the_others(
    name: str, real_study: Callable[[str], Study]
) -> None:
    """By 23 degrees and 50 mm, for which the leg was refused."""
    study = real_study(name)
    static = study.static.recording
    columns = [static.labels.index(label) for label in KNOCKED[name]]
    middle = static.markers[:, columns].mean(axis=(0, 1))
    rotation = Rotation.from_euler("y", 23.0, degrees=True).as_matrix()
    markers = static.markers.copy()
    markers[:, columns] = (markers[:, columns] - middle) @ rotation.T + middle + [0.03, -0.04, 0.0]
    spoilt = with_trial(study, study.static.name, lambda r: replace(r, markers=markers))
    (found,) = findings(spoilt, code=Code.CLUSTER_SLID)
    check_finding(found, Code.CLUSTER_SLID, Severity.INFO, *KNOCKED[name])
    assert serious(spoilt) == []
    prepared = preprocess_study(spoilt)
    placed, (one,) = prepared.study, prepared.placed
    away = (placed.static.recording.markers - static.markers)[:, columns]
    assert np.linalg.norm(away, axis=2).max() < PLACED_M < one.shift_spread
    assert {name for name in placed.loosened if "hip_r" in name} == {
        f"hip_r.thigh.{d}" for d in ("ant", "sup", "lat")
    }
    prior = ANATOMY.widen(placed.loosened)
    k = prior.names.index("hip_r.thigh.sup")
    more = prior.covariance[k, k] - ANATOMY.covariance[k, k]
    assert more == pytest.approx(one.shift_spread**2) and preprocess_study(study).study is study
