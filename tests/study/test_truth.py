"""The truth that a study names: written and read back, refused where a name, a unit or a rule is
another.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.errors import Code
from gaitcal.model.landmarks import measure_static_posture
from gaitcal.model.linkage import COORDINATES, REACTIONS
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.parameters import JP_NAMES
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.study.declared_truth import (
    Truth,
    describe_landmark_mismatch,
    format_landmarks,
    format_moments,
    format_motion,
    list_truth_files,
    read_truth,
)
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_file import TruthTable, load_study_file
from gaitcal.synthetic.synthetic_motion import simulate_static_trial
from tests.messages import check_text, refuses
from tests.refusal import refusal
from tests.synthetic_studies import made_recording

SETTINGS = CalibrationSettings(hip_centre="bell", ankle_zero="markers")
TIME = np.linspace(0.0, 1.0, 11)
LANDMARKS = {"asis_r": np.array([0.1, 0.9, 0.13]), "heel_l": np.array([-0.05, 0.03, -0.1])}
DIGITS = 1e-8  # relative: nine are written


def written(folder: Path, **changes: str) -> TruthTable:
    """A truth of one trial and three parameters; `changes`: file -> its whole text instead."""
    rng = np.random.default_rng(1)
    curves = folder / "truth"
    curves.mkdir()
    q, forces = rng.normal(0, 0.3, (11, len(COORDINATES))), rng.normal(0, 50.0, (11, len(FORCES)))
    texts = {
        "parameters": "name,unit,value\nhip_r.pelvis.ant,mm,-40.5\n"
        "knee_l.thigh.front,deg,3\nthigh_r.mass,kg,8.1\n",
        "motion": format_motion(TIME, q, q, q),
        "moments": format_moments(TIME, forces, 1200.0),
        "landmarks": format_landmarks(LANDMARKS),
    } | changes
    names = {
        "parameters": "../truth.csv",
        "motion": "walk_motion.csv",
        "moments": "walk_moments.csv",
    }
    for part, text in texts.items():
        (curves / names.get(part, "landmarks.csv")).write_text(text, encoding="utf-8")
    files = {
        "parameters": folder / "truth.csv",
        "folder": curves,
        "landmarks": curves / "landmarks.csv",
    }
    return TruthTable(**files, markers="published", hip_centre="bell", ankle_zero="markers")


def read(
    table: TruthTable, settings: CalibrationSettings = SETTINGS, markers: str = "published"
) -> Truth:
    truth = read_truth(table, settings, markers, ["still", "walk"], Path("study.toml"))
    assert truth is not None
    return truth


def test_round_trip(tmp_path: Path) -> None:
    table = written(tmp_path)
    truth, rng = read(table), np.random.default_rng(1)
    assert truth.parameters["hip_r.pelvis.ant"] == pytest.approx(-0.0405)
    assert truth.parameters["knee_l.thigh.front"] == pytest.approx(np.deg2rad(3.0))
    assert truth.parameters["thigh_r.mass"] == 8.1
    for curves, names, scale in (
        (truth.motions, COORDINATES, 0.3),
        (truth.moments, (*COORDINATES, *REACTIONS), 50.0),
    ):
        assert list(curves) == ["walk"]
        expected = rng.normal(0, scale, (11, len(names)))
        for k, name in enumerate(names):
            np.testing.assert_allclose(curves["walk"].values[name], expected[:, k], rtol=DIGITS)
    for name, place in LANDMARKS.items():
        np.testing.assert_allclose(truth.landmarks[name], place, rtol=DIGITS)
    files = list_truth_files(table, ["still", "walk"])
    assert [f.name for f in files] == [
        "truth.csv",
        "landmarks.csv",
        "walk_motion.csv",
        "walk_moments.csv",
    ]


def test_between_and_beyond_its_instants(tmp_path: Path) -> None:
    curve = read(written(tmp_path)).motions["walk"]
    name = "hip_flexion_r"
    middle = curve.interpolate(np.array([-0.5, 0.0, 0.05, 1.0, 1.5]))[name]
    values = curve.values[name]
    np.testing.assert_allclose(
        middle, [np.nan, values[0], 0.5 * (values[0] + values[1]), values[-1], np.nan]
    )


def lines(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


Q = np.zeros((11, len(COORDINATES)))


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("parameters", "name,unit,value\nhip_r.pelvis.anterior,mm,1\n"),
        ("parameters", "name,unit,value\nhip_r.pelvis.ant,m,0.04\n"),
        ("parameters", "name,unit,value\nhip_r.pelvis.ant,mm,\n"),
        ("parameters", "name,unit,value\nhip_r.pelvis.ant,mm,1\nhip_r.pelvis.ant,mm,2\n"),
        ("motion", lines(format_motion(TIME, Q), "in degrees", "in radians")),
        ("motion", lines(format_motion(TIME, Q), "knee_angle_r", "knee_flexion_r")),
        ("motion", lines(format_motion(TIME, Q), "\n0.3,0,", "\n0.3,x,")),
        ("motion", lines(format_motion(TIME, Q), "\n0.3,", "\n0.1,")),
        ("motion", lines(format_motion(TIME, Q), "\n0.3,", "\n0.3,1,")),
        ("motion", lines(format_motion(TIME, Q), "pelvis_list", "pelvis_tilt")),
        ("parameters", "name,unit,value\nhip_r.pelvis.ant,mm,x\n"),
        ("landmarks", "name,x,y,z\n"),
        ("landmarks", "name,x,y,z\nasis_r,0.1,high,0.2\n"),
    ],
)
def test_refused_in_one_line(tmp_path: Path, file: str, text: str) -> None:
    with refuses(Code.TRUTH, ".csv"):
        read(written(tmp_path, **{file: text}))


@pytest.mark.parametrize(
    ("settings", "markers", "field"),
    [
        (CalibrationSettings(ankle_zero="markers"), "published", "truth.hip_centre"),
        (CalibrationSettings(hip_centre="bell"), "published", "truth.ankle_zero"),
        (SETTINGS, "gait2354", "truth.markers"),
    ],
)
def test_told_in_other_frames_than_the_calibration_uses(
    tmp_path: Path, settings: CalibrationSettings, markers: str, field: str
) -> None:
    assert field in refusal(read, written(tmp_path), settings, markers)


def test_a_folder_without_any_trial_of_the_study(tmp_path: Path) -> None:
    with refuses(Code.TRUTH, field="truth.folder", source="study.toml"):
        read_truth(written(tmp_path), SETTINGS, "published", ["run"], Path("study.toml"))


def test_every_parameter_of_a_result_has_a_unit(tmp_path: Path) -> None:
    rows = "".join(
        f"{name},deg,0\n" for name in JP_NAMES if name.endswith(("front", "trans", "sag"))
    )
    assert len(
        read(written(tmp_path, parameters="name,unit,value\n" + rows)).parameters
    ) == rows.count("\n")


def test_the_study_file_names_it(tmp_path: Path) -> None:
    written(tmp_path)
    (tmp_path / "still.csv").write_text("", encoding="utf-8")
    text = (
        '[subject]\nname = "n"\nmass_kg = 70.0\nheight_m = 1.7\nsex = "male"\n[markers]\nset = '
        '"published"\n'
    )
    text += '[[trial]]\nname = "still"\nrole = "static"\nfile = "still.csv"\n'
    text += (
        '[truth]\nparameters = "truth.csv"\nfolder = "truth"\nlandmarks = "truth/landmarks.csv"\n'
    )
    text += 'markers = "published"\nhip_centre = "bell"\n'
    path = tmp_path / "study.toml"
    path.write_text(text + 'ankle_zero = "markers"\n', encoding="utf-8")
    file = load_study_file(path)
    assert file.truth.folder == tmp_path.absolute() / "truth"
    again = tmp_path / "again.toml"
    again.write_text(file.to_toml(tmp_path), encoding="utf-8")
    assert load_study_file(again) == file
    for wrong, told in (
        (text + 'ankle_zer = "markers"\n', (Code.UNKNOWN_FIELD, "'ankle_zero'")),
        (text, (Code.MISSING_FIELD, "truth.ankle_zero")),
        (
            text.replace("truth.csv", "truths.csv") + 'ankle_zero = "markers"\n',
            (Code.NO_FILE, "truth.parameters", "'truth.csv'"),
        ),
    ):
        path.write_text(wrong, encoding="utf-8")
        with refuses(*told):
            load_study_file(path)


def test_landmarks_tell_the_static_trial_and_the_marker_set() -> None:
    """The same posture elsewhere in the room is the same; another posture, a moved landmark, or
    another set is not.
    """
    marker_set, static = (
        load_marker_set("published"),
        made_recording(simulate_static_trial(), static=True),
    )
    told = measure_static_posture(static, marker_set, slice(0, 10)).landmarks
    assert describe_landmark_mismatch(told, static, marker_set) is None
    quarter = static.markers[:, :, [2, 1, 0]] * [1.0, 1.0, -1.0] + [0.3, 0.02, -2.0]
    assert describe_landmark_mismatch(told, replace(static, markers=quarter), marker_set) is None
    tilted = static.markers @ make_axis_rotation(0, np.deg2rad(3.0)).T
    moved = static.markers.copy()
    moved[:, static.labels.index(marker_set.landmarks["heel_r"][0])] += [0.0, 0.0, 0.001]
    for markers in (tilted, moved):
        assert describe_landmark_mismatch(told, replace(static, markers=markers), marker_set)
    check_text(
        str(describe_landmark_mismatch(told, replace(static, markers=moved), marker_set)), "heel_r"
    )
    same_name = replace(
        marker_set, landmarks=marker_set.landmarks | {"toe_r": marker_set.landmarks["heel_r"]}
    )
    check_text(str(describe_landmark_mismatch(told, static, same_name)), "toe_r")
    fewer = {name: place for name, place in told.items() if name != "toe_l"}
    check_text(str(describe_landmark_mismatch(fewer, static, marker_set)), "toe_l")
