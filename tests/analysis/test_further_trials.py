"""`gaitcal dynamics` reads a recording as the study did, checks it first, and tells what its
torques are worth.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace as replaced
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.errors import Code, ConvergenceError
from gaitcal.gait.events import GaitEvents
from gaitcal.model.marker_set import load_marker_set
from gaitcal.preprocess.static_disagreement import PossibleMove
from gaitcal.study.study_trial import Role
from tests import commands
from tests.messages import check_text, refuses
from tests.refusal import refusal
from tests.synthetic_studies import write_synthetic_study

RENAMED = {"R.Shank.Front": "RTIB", "L.Heel": "LHEE"}
WEIGHTED = "R.Thigh.Front"
SOME = ("Shank.Upper", "Shank.Rear", "Toe.Tip", "Toe.Lat", "Toe.Med")
SAME = 1e-9
"""N·m, N: the calibration's own trial, tracked once more with the same model and spline nodes."""
Change = Callable[[pd.DataFrame], pd.DataFrame]


def run(*words: object) -> str:
    ended = commands.run(*words)
    assert ended.exit_code == 0, ended.output
    return ended.output


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study whose files have other labels than its marker set, and its result."""
    folder = tmp_path_factory.mktemp("made")
    study = write_synthetic_study(folder / "study")
    columns = {f"{old}_{axis}": f"{new}_{axis}" for old, new in RENAMED.items() for axis in "xyz"}
    for name in ("static.csv", "walk.csv"):
        table = pd.read_csv(folder / "study" / name)
        assert set(columns) <= set(table)
        table.rename(columns=columns).to_csv(folder / "study" / name, index=False)
    rename = ", ".join(f'"{new}" = "{old}"' for old, new in RENAMED.items())
    lines = f'set = "published"\nrename = {{ {rename} }}\nweights = {{ "{WEIGHTED}" = 0 }}'
    study.write_text(
        study.read_text(encoding="utf-8").replace('set = "published"', lines), encoding="utf-8"
    )
    run("calibrate", study, "--out", folder / "result", "-q")
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "made"))


def spoil(folder: Path, change: Change) -> tuple[Path, str, Path]:
    path = folder / "study/walk.csv"
    change(pd.read_csv(path)).to_csv(folder / "walk2.csv", index=False)
    return folder / "walk2.csv", "--forces", folder / "study/walk_forces.csv"


def read_summary(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "result/dynamics/summary.json").read_text(encoding="utf-8")))


def analysed(folder: Path, change: Change = lambda t: t, *options: object) -> str:
    """What `dynamics` prints of the walk, changed so."""
    return run("dynamics", folder / "result", *spoil(folder, change), *options)


def columns_of(folder: Path, segment: str) -> list[str]:
    """Columns of a segment's markers in the study's files."""
    labels = load_marker_set(folder / "result/marker_set.toml").tracking[segment]
    return [f"{RENAMED.get(label, label)}_{axis}" for label in labels for axis in "xyz"]


def moments(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, comment="#")


def test_the_calibrations_own_trial_gives_its_own_torques(folder: Path) -> None:
    """All but standard errors: a further trial's markers are independent of those that the
    calibration used.
    """
    analysed(folder)
    own, again = (
        moments(folder / "result" / name)
        for name in ("moments/walk.csv", "dynamics/moments/walk2.csv")
    )
    assert own["valid"].any()
    kept = [name for name in own if not name.endswith("_se")]
    np.testing.assert_allclose(again[kept].to_numpy(), own[kept].to_numpy(), atol=SAME)
    trial = json.loads((folder / "result/summary.json").read_text(encoding="utf-8"))["trials"][
        "walk"
    ]
    further = read_summary(folder)["trials"]["walk2"]
    assert further["weighted_markers"] == trial["weighted_markers"]
    assert {"plates", "inertia", "joint_nominal"} <= set(
        further["torque_error_sources"]["hip_flexion_r"]
    )
    for name, parts in trial["torque_error_sources"].items():
        assert further["torque_error_sources"][name] == pytest.approx(parts, abs=1e-3), name
    assert read_summary(folder)["warnings"] == []


def _scaled(factor: float) -> Change:
    return lambda t: t.assign(**{c: factor * t[c] for c in t if c != "time"})


def _exchanged(*pairs: tuple[str, str]) -> Change:
    """The columns of markers under each other's label."""
    names = {
        f"{a}_{axis}": f"{b}_{axis}"
        for pair in pairs
        for a, b in (pair, pair[::-1])
        for axis in "xyz"
    }
    return lambda t: t.rename(columns=names)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (_scaled(1000.0), Code.UNIT_OF_LENGTH),
        (_scaled(1.4), Code.UNIT_OF_LENGTH),
        (_exchanged(("L.Shank.Front", "L.Thigh.Front")), Code.EXCHANGED_LABELS),
        (_exchanged(*((f"R.{m}", f"L.{m}") for m in SOME)), Code.SIDES_EXCHANGED),
    ],
    ids=["mm read as m", "another body", "labels exchanged", "sides exchanged"],
)
def test_errors_stop_before_anything_is_solved(
    change: Change, code: Code, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = spoil(folder, change)
    monkeypatch.setattr("gaitcal.analysis.trial_result.analyse", None)
    with refuses(code, field="trial 'walk2'", source="walk2.csv") as caught:
        run("dynamics", folder / "result", *trial)
    assert caught.value.exit_code == 1
    assert not (folder / "result/dynamics").exists()


def test_warnings_are_printed_and_written(folder: Path) -> None:
    """A body a little larger may be the same one, measured with cameras that were
    calibrated anew.
    """
    out, warnings = analysed(folder, _scaled(1.02)), read_summary(folder)["warnings"]
    check_text(warnings)
    assert all(f"warning: {w}" in out for w in warnings)


def test_what_its_markers_may_have_done_goes_into_its_bars(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thigh whose markers turned by 12 deg, which is too weak to be told."""
    columns = columns_of(folder, "thigh_l")

    def turned(t: pd.DataFrame) -> pd.DataFrame:
        x = t[columns].to_numpy().reshape(len(t), -1, 3)
        middle = x.mean(axis=1, keepdims=True)
        by = Rotation.from_euler("y", 12.0, degrees=True)
        moved = (middle + (x - middle) @ by.as_matrix().T).reshape(len(t), -1)
        return t.assign(**dict(zip(columns, moved.T, strict=True)))

    given: list[dict[str, PossibleMove]] = []

    def record(*arguments: object) -> None:
        given.append(arguments[4])  # type: ignore[arg-type]
        raise ConvergenceError("enough")

    monkeypatch.setattr("gaitcal.analysis.trial_result.analyse", record)
    for change in (lambda t: t, turned):
        with pytest.raises(ConvergenceError):
            commands.run("dynamics", folder / "result", *spoil(folder, change))
    before, after = (np.rad2deg(moves["thigh_l"].rotation[1]) for moves in given)
    assert before < 1.0 and 3.0 < after < 14.0


def test_a_segment_without_markers_is_told_and_has_no_valid_torque(folder: Path) -> None:
    gone = columns_of(folder, "shank_l")
    assert set(gone) & set(pd.read_csv(folder / "study/walk.csv"))
    analysed(folder, lambda t: t.drop(columns=gone, errors="ignore"))
    assert not moments(folder / "result/dynamics/moments/walk2.csv")["valid"].any()
    check_text(read_summary(folder)["warnings"], "shank_l")


@pytest.mark.slow
def test_tracking_that_did_not_converge_ends_in_3_after_writing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gaitcal.analysis import trial_result

    def late(*arguments: object) -> object:
        done = analyse(*arguments)  # type: ignore[arg-type]
        return replaced(done, calibrated=replaced(done.calibrated, converged=False))

    analyse = trial_result.analyse
    monkeypatch.setattr(trial_result, "analyse", late)
    with refuses(Code.NOT_CONVERGED, "walk2") as caught:
        analysed(folder)
    assert caught.value.exit_code == 3
    (warning,) = read_summary(folder)["warnings"]
    check_text(warning, "walk2")
    assert read_summary(folder)["trials"]["walk2"]["verdict"] == "refused"


def test_options_as_in_a_study_file(folder: Path) -> None:
    analysed(folder, lambda t: t, "--time", "0.2,0.8", "--filter-hz", "none", "--plates", "1=none")
    table, notes = (
        moments(folder / "result/dynamics/moments/walk2.csv"),
        read_summary(folder)["notes"],
    )
    assert 0.2 <= table["time"].min() < 0.21 and 0.79 < table["time"].max() <= 0.8
    check_text(notes, "walk2", 2)
    assert not any("plate 1" in note and "right foot" in note for note in notes)


@pytest.mark.parametrize(("depth", "said"), [(0.3, 1), (0.0, 0)])
def test_a_squat_that_was_taken_as_a_walk_is_told(depth: float, said: int) -> None:
    from gaitcal.cli.calibrate_command import _find_non_walks

    time = np.arange(0.0, 4.0, 0.01)
    height = 1.0 - depth * np.sin(0.5 * np.pi * np.clip(time - 1.0, 0.0, 2.0)) ** 2
    body = SimpleNamespace(time=time, coordinates=("pelvis_ty",), q=height[:, None])
    trial = SimpleNamespace(name="squat", role=Role.GAIT, body=body, events=GaitEvents())
    assert len(_find_non_walks([trial])) == said  # type: ignore[list-item]
    assert not _find_non_walks([SimpleNamespace(**vars(trial) | {"role": Role.MOTION})])  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("option", "value"),
    [
        *(("--plates", v) for v in ("", "1", "1=x", "=r", "1=r,1=l", "1=r,", "7=r")),
        *(("--time", v) for v in ("", "0.4", "1,0.4", "a,b", "nan,1", "0,1,2", "50,60")),
        ("--role", "jump"),
        *(("--filter-hz", v) for v in ("", "0", "-1", "x", "nan", "inf")),
    ],
)
def test_options_that_are_wrong(option: str, value: str, folder: Path) -> None:
    said = refusal(analysed, folder, lambda t: t, option, value)
    check_text(said, option.split("-")[2])
    assert not (folder / "result/dynamics").exists()


def test_options_of_one_recording_and_two_trials(folder: Path) -> None:
    trial = spoil(folder, lambda t: t)[0]
    for option, value in (("--forces", "f.mot"), ("--plates", "1=r"), ("--time", "0,1")):
        said = refusal(
            run, "dynamics", folder / "result", trial, folder / "study/walk.csv", option, value
        )
        check_text(said, f"{option}", 2)


def test_frames_without_a_leg_segment_are_not_valid(folder: Path) -> None:
    """A left foot that nobody sees for a while: no torque of these frames counts, and the others
    stay as they were.
    """
    gap = (0.3, 0.5)
    foot = columns_of(folder, "foot_l")

    def hide(t: pd.DataFrame) -> pd.DataFrame:
        t = t.copy()
        t.loc[t["time"].between(*gap), [c for c in foot if c in t]] = np.nan
        return t

    before = moments(folder / "result/moments/walk.csv")
    analysed(folder, hide)
    now = moments(folder / "result/dynamics/moments/walk2.csv")
    inside = before["time"].between(*gap)
    assert before["valid"][inside].any(), "valid while the foot was seen"
    assert not now["valid"][inside].any() and not now["valid_l"][inside].any()
    assert (now["valid"] == before["valid"])[~inside].all() and (
        now["valid_r"] == before["valid_r"]
    ).all()
    (note,) = [note for note in read_summary(folder)["notes"] if "foot_l" in note]
    check_text(note, f"{int(inside.sum())}")
