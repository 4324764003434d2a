"""The study file: what is read, and that every mistake ends in one line naming field, find and
cure.
"""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gaitcal.errors import Code, InputError
from gaitcal.io.toml import MAX_BYTES
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_file import Markers, StudyFile, SubjectTable, TrialTable, load_study_file
from tests.messages import refuses

STUDY = """\
[subject]
name = "subject01"
mass_kg = 72.6
height_m = 1.803
sex = "male"
[markers]
set = "gait2354"
rename = { "RASI" = "R.ASIS" }
[[trial]]
name = "static"
role = "static"
file = "static.trc"
[[trial]]
name = "hip"
role = "joint"
joint = "hip_r"
file = "hip.csv"
[[trial]]
name = "walk"
role = "gait"
file = "data/walk.C3D"
forces = "walk_grf.mot"
plates = { 1 = "r", 2 = "none" }
time = [0.4, 1.6]
filter_hz = 12
[calibration]
nodes = 20
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study_file", numbered=False)
    (folder / "data").mkdir()
    for name in ("static.trc", "hip.csv", "data/walk.C3D", "walk_grf.mot", "own_set.toml"):
        (folder / name).touch()
    return folder


def load(folder: Path, text: str | bytes) -> StudyFile:
    path = folder / "study.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_study_file(path)


def test_reads_everything_and_resolves_paths_from_its_own_folder(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    study = load(folder, STUDY)
    assert study.subject == SubjectTable(name="subject01", mass_kg=72.6, height_m=1.803, sex="male")
    assert study.markers.rename == {"RASI": "R.ASIS"} and study.static is study.trials[0]
    walk = study.trials[2]
    assert (walk.file, walk.forces) == (folder / "data/walk.C3D", folder / "walk_grf.mot")
    assert (walk.plates, walk.time, walk.filter_hz) == ({"1": "r", "2": "none"}, (0.4, 1.6), 12.0)
    assert study.calibration == CalibrationSettings(nodes=20, force_filter_hz=50.0)


def test_byte_order_mark_windows_line_ends_and_no_calibration(folder: Path) -> None:
    text = STUDY.split("[calibration]")[0].replace("\n", "\r\n")
    assert load(folder, b"\xef\xbb\xbf" + text.encode()).calibration == CalibrationSettings()


def test_own_marker_set_is_a_path(folder: Path) -> None:
    assert load(folder, STUDY).markers.set_path is None
    own = load(folder, STUDY.replace('"gait2354"', '"./own_set.toml"'))
    assert own.markers.set_path == folder / "own_set.toml"
    with refuses(Code.NO_FILE, "'own_set.toml'", field="markers.set", source="study.toml"):
        load(folder, STUDY.replace('"gait2354"', '"own_sets.toml"'))


@pytest.mark.parametrize("relative", [True, False])
def test_written_study_is_read_back_the_same(folder: Path, relative: bool) -> None:
    study = load(
        folder, STUDY.replace("nodes = 20", 'nodes = 20\nforce_filter_hz = 6.5\nrobust = "huber"')
    )
    text = study.to_toml(folder if relative else None)
    assert load(folder, text) == study
    assert (str(folder) in text) is not relative


def test_a_study_made_in_python_is_written_and_read_back(folder: Path) -> None:
    study = StudyFile(
        subject=SubjectTable(
            name='odd "name" \\ <script> µ', mass_kg=60, height_m=1.7, sex="female"
        ),
        markers=Markers(set="gait2354", weights={"Top.Head": 0.0}),
        trial=(TrialTable(name="static", role="static", file=Path("static.trc"), time=(0, 1)),),
    )
    read = load(folder, study.to_toml())
    assert (read.subject, read.markers, read.trials[0].time) == (
        study.subject,
        study.markers,
        (0.0, 1.0),
    )


def test_every_calibration_field_is_described_and_has_a_default() -> None:
    for name, field in CalibrationSettings.model_fields.items():
        assert field.description, name
        assert not field.is_required(), name


# One row a mistake: what is replaced in STUDY, by what, and what the line must hold.
FAULTS = {
    "mass 0": ("72.6", "0", Code.BAD_VALUE, "subject.mass_kg"),
    "mass nan": ("72.6", "nan", Code.BAD_VALUE, "subject.mass_kg"),
    "mass as text": ("72.6", '"72.6"', Code.BAD_VALUE, "subject.mass_kg", "72.6"),
    "mass missing": ("mass_kg = 72.6\n", "", Code.MISSING_FIELD, "subject.mass_kg"),
    "mass misspelt": ("mass_kg", "mas_kg", Code.UNKNOWN_FIELD, "subject", "mas_kg", "mass_kg"),
    "height negative": ("1.803", "-1.8", Code.BAD_VALUE, "subject.height_m"),
    "height in mm": ("1.803", "1803", Code.BAD_VALUE, "subject.height_m", "1.803"),
    "height in cm": ("1.803", "180.3", Code.BAD_VALUE, "subject.height_m", "1.803"),
    "sex": ('"male"', '"mail"', Code.BAD_VALUE, "subject.sex", "mail", "male", "female"),
    "name empty": ('"subject01"', '" "', Code.BAD_VALUE, "subject.name"),
    "table unknown": (
        "[calibration]",
        "[calibraton]",
        Code.UNKNOWN_FIELD,
        "",
        "calibraton",
        "calibration",
    ),
    "table missing": ("[markers]\n", "", Code.UNKNOWN_FIELD, "subject"),
    "nodes no whole number": ("nodes = 20", "nodes = 20.5", Code.BAD_VALUE, "calibration.nodes"),
    "mode": (
        "nodes = 20",
        'mode = "simultanous"',
        Code.BAD_VALUE,
        "calibration.mode",
        "simultaneous",
    ),
    "filter word": (
        "nodes = 20",
        'force_filter_hz = "match"',
        Code.BAD_VALUE,
        "calibration.force_filter_hz",
        "matched",
        "none",
    ),
    "joint step without ip": (
        "nodes = 20",
        'ip = "none"\njoint_step = true',
        Code.BAD_VALUE,
        "calibration.joint_step",
    ),
    "two trials, one name": ('"walk"', '"static"', Code.BAD_VALUE, "trial", "static"),
    "two names, one file": ('"walk"', '"Static"', Code.BAD_VALUE, "trial"),
    "no static": ('role = "static"', 'role = "gait"', Code.BAD_VALUE, "trial", "static"),
    "trial name with a path": ('"walk"', '"../walk"', Code.BAD_VALUE, "trial[3].name", "../walk"),
    "trial name reserved": ('"walk"', '"con"', Code.BAD_VALUE, "trial[3].name"),
    "role": (
        'role = "gait"',
        'role = "walk"',
        Code.BAD_VALUE,
        "trial[3].role",
        "static",
        "joint",
        "gait",
        "motion",
    ),
    "joint missing": ('joint = "hip_r"\n', "", Code.BAD_VALUE, "trial[2].joint", "knee_r"),
    "joint unknown": (
        'joint = "hip_r"',
        'joint = "hip"',
        Code.BAD_VALUE,
        "trial[2].joint",
        "hip",
        "ankle_l",
    ),
    "joint for gait": (
        'role = "gait"',
        'role = "gait"\njoint = "hip_r"',
        Code.BAD_VALUE,
        "trial[3].joint",
        "gait",
    ),
    "file missing": (
        '"static.trc"',
        '"statics.trc"',
        Code.NO_FILE,
        "trial[1].file",
        "statics.trc",
        "static.trc",
    ),
    "file far from any": ('"static.trc"', '"zzz.c3d"', Code.NO_FILE, "trial[1].file", "hip.csv"),
    "folder missing": ('"static.trc"', '"raw/static.trc"', Code.NO_FILE, "trial[1].file", "raw"),
    "file name endless": ('"static.trc"', f'''"{"s" * 5000}.trc"''', Code.NO_FILE, "trial[1].file"),
    "file of another kind": (
        '"static.trc"',
        '"static.xlsx"',
        Code.BAD_VALUE,
        "trial[1].file",
        "static.xlsx",
    ),
    "forces of another kind": ("walk_grf.mot", "walk_grf.trc", Code.BAD_VALUE, "trial[3].forces"),
    "plate side": (
        '2 = "none"',
        '2 = "left"',
        Code.BAD_VALUE,
        "trial[3].plates.2",
        "left",
        "r",
        "l",
        "none",
    ),
    "time decreasing": ("[0.4, 1.6]", "[1.6, 0.4]", Code.BAD_VALUE, "trial[3].time"),
    "trial filter": (
        "filter_hz = 12",
        "filter_hz = -12",
        Code.BAD_VALUE,
        "trial[3].filter_hz",
        "none",
    ),
    "renamed twice": (
        '"RASI" =',
        '"A" = "R.ASIS", "RASI" =',
        Code.BAD_VALUE,
        "markers.rename",
        "A",
        "RASI",
    ),
    "marker set empty": ('"gait2354"', '""', Code.BAD_VALUE, "markers.set"),
    "no TOML": ("[markers]", "[markers", Code.TOML, ""),
    "windows path": ('"static.trc"', '"C:\\data\\static.trc"', Code.TOML, ""),
    "number of 5000 digits": ("nodes = 20", "nodes = 1" + "0" * 5000, Code.TOML, ""),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault(folder: Path, fault: str) -> None:
    old, new, code, field, *parts = FAULTS[fault]
    assert old in STUDY
    with refuses(code, *parts, field=field, source="study.toml") as caught:
        load(folder, STUDY.replace(old, new, 1))
    assert len(str(caught.value)) < 900


def test_single_bracket_trial(folder: Path) -> None:
    text = (
        STUDY.split("[[trial]]")[0]
        + '[trial]\nname = "static"\nrole = "static"\nfile = "static.trc"\n'
    )
    with refuses(Code.BAD_VALUE, field="trial", source="study.toml"):
        load(folder, text)
    with refuses(Code.TOML, source="study.toml"):
        load(folder, STUDY.replace('[[trial]]\nname = "walk"', '[trial]\nname = "walk"'))


@pytest.mark.parametrize(
    "content, code",
    [
        (b"", Code.MISSING_FIELD),
        (b"[subject]\nname = \"M\xfcller\"\n", Code.NOT_TEXT),
        (b"# " + b"x" * MAX_BYTES, Code.TOML),
        (STUDY.encode("utf-16"), Code.NOT_TEXT),
        (b".".join([b"a"] * 40_000) + b" = 1", Code.TOML),
        (b"[subject]\n[" + b" . ".join([b'"a"'] * 2000) + b"]", Code.TOML),
        (b"a = " + b"[" * 40_000, Code.TOML),
    ],
)  # fmt: skip
def test_content_that_is_no_study(folder: Path, content: bytes, code: Code) -> None:
    with refuses(code, source="study.toml"):
        load(folder, content)


def test_no_study_file(folder: Path) -> None:
    load(folder, STUDY)
    for path, names in ((folder / "studi.toml", ["'study.toml'"]), (folder, []), ("/dev/null", [])):
        with refuses(Code.NO_FILE, *names):
            load_study_file(path)


WORDS = '[[trial]] [subject] nan -1e400 0x true 1979-05-27T07:32:00Z \\u0000 """ role [] {} ..'
FRAGMENTS = [
    *"[]{}='\"\\\n,./\x1b☃",
    *WORDS.split(),
    'joint = "hip_r"',
    "9" * 400,
    *STUDY.splitlines(keepends=True),
]
PIECE = st.sampled_from(FRAGMENTS) | st.text(max_size=4)


@settings(max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    edits=st.lists(
        st.tuples(st.integers(0, len(STUDY)), st.integers(0, 12), PIECE), min_size=1, max_size=5
    )
)
def test_mutated_files_end_in_a_study_or_one_line(
    folder: Path, edits: list[tuple[int, int, str]]
) -> None:
    text = STUDY
    for at, length, new in edits:
        text = text[:at] + new + text[at + length :]
    try:
        load(folder, text.encode("utf-8", "surrogatepass"))
    except InputError as error:
        assert len(str(error).splitlines()) == 1
