"""Files of all kinds, and none of them ends the reading."""

from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gaitcal.errors import Code
from gaitcal.intake.recordings_folder import FileKind, find_marker_sets_above, read_folder
from gaitcal.io.toml import find_models_folder
from tests.intake.folders import recordings, write
from tests.messages import refuses

LOADS = (
    "<OpenSimDocument><ExternalLoads><datafile>grf.mot</datafile></ExternalLoads></OpenSimDocument>"
)


def test_kinds(tmp_path: Path) -> None:
    folder = write(tmp_path, {"walk": recordings()["walk"]}, forces="grf")
    (folder / "own.toml").write_bytes((find_models_folder() / "markersets/rcnl.toml").read_bytes())
    for name, content in {
        "study.toml": '[subject]\nname = "x"\n',
        "other.toml": "a = 1\n",
        "loads.xml": LOADS,
        "bomb.xml": "<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>",
        "grf_plates.csv": "plate,corner,x,y,z\n",
        "truth.csv": "name,value\na,1\n",
        "broken.c3d": "\0" * 700,
        ".hidden.c3d": "\0" * 700,
        "noending": "",
    }.items():
        (folder / name).write_text(content, encoding="utf-8")
    found = {file.name: file for file in read_folder(folder).files}
    kinds = {name: file.kind for name, file in found.items()}
    assert kinds == {
        "walk.csv": FileKind.RECORDING,
        "grf.csv": FileKind.FORCES,
        "own.toml": FileKind.MARKER_SET,
        "study.toml": FileKind.STUDY,
        "other.toml": FileKind.OTHER,
        "loads.xml": FileKind.EXTERNAL_LOADS,
        "bomb.xml": FileKind.UNREADABLE,
        "grf_plates.csv": FileKind.CORNERS,
        "truth.csv": FileKind.UNREADABLE,
        "broken.c3d": FileKind.UNREADABLE,
        "noending": FileKind.OTHER,
    }
    assert found["loads.xml"].table_name == "grf.mot"
    assert all(
        file.reason for file in found.values() if file.kind in (FileKind.UNREADABLE, FileKind.OTHER)
    )
    (folder / "person").mkdir()
    assert [f.name for f in find_marker_sets_above(folder / "person")] == ["own.toml"]


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(["c3d", "trc", "csv", "mot", "sto", "xml", "toml"]), st.binary(max_size=600))
def test_no_content_ends_the_reading(tmp_path: Path, ending: str, content: bytes) -> None:
    file = tmp_path / f"x.{ending}"
    file.write_bytes(content)
    (found,) = read_folder(tmp_path).files
    assert found.reason or found.kind not in (FileKind.UNREADABLE, FileKind.OTHER)
    file.unlink()


def test_no_folder(tmp_path: Path) -> None:
    with refuses(Code.FOLDER, source="nothing"):
        read_folder(tmp_path / "nothing")
