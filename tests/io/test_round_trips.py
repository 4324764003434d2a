"""What is written or converted reads back: to the bit in text, to 32-bit floats in C3D."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gaitcal.errors import Code
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.csv_recordings import write_forces_csv, write_markers_csv, write_plates_csv
from gaitcal.io.formats import convert, read_forces, read_recording
from gaitcal.io.labels import clean_label, find_common_prefix, is_unlabelled
from gaitcal.io.opensim_files import parse_trc, write_forces_mot, write_trc
from gaitcal.io.recording import ForcePlate, Recording
from tests.commands import refused
from tests.io.recordings import body, loaded_body
from tests.messages import refuses

QUICK = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
FINITE = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text(
    st.characters(exclude_categories=["Cs", "Cc", "Zl", "Zp"]), min_size=1, max_size=12
).filter(lambda name: clean_label(name) == name and not is_unlabelled(name))


@st.composite
def times(draw: st.DrawFn, largest: int = 6) -> np.ndarray:
    found = draw(st.lists(FINITE, min_size=1, max_size=largest, unique=True))
    return np.array(sorted(found))


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    time = draw(times())
    labels = draw(
        st.lists(NAMES, min_size=1, max_size=4, unique=True).filter(
            lambda names: not find_common_prefix(names)[0]
        )
    )
    markers = draw(arrays(np.float64, (len(time), len(labels), 3), elements=FINITE))
    gaps = draw(arrays(np.bool_, (len(time), len(labels)))) | (markers == 0).all(axis=2)
    return Recording(
        source="drawn",
        time=time,
        labels=tuple(labels),
        markers=np.where(gaps[:, :, None], np.nan, markers),
    )


@st.composite
def plates(draw: st.DrawFn) -> tuple[ForcePlate, ...]:
    time = draw(times())
    names = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))

    def values() -> np.ndarray:
        return draw(arrays(np.float64, (len(time), 3), elements=st.floats(-1e6, 1e6)))

    found = []
    for name in names:
        force = values()
        force[:, 1] = np.abs(force).sum(axis=1)  # along another axis, or down, it would be turned
        found.append(ForcePlate(name=name, time=time, force=force, point=values(), moment=values()))
    return tuple(found)


def require_same_bits(a: np.ndarray, b: np.ndarray) -> None:
    """Equal in every bit: NaN equals NaN, and 0 is not -0."""
    np.testing.assert_array_equal(a, b, strict=True)
    known = ~np.isnan(a)
    np.testing.assert_array_equal(np.signbit(a[known]), np.signbit(b[known]))


def require_same_plates(found: tuple[ForcePlate, ...], expected: tuple[ForcePlate, ...]) -> None:
    for a, b in zip(found, expected, strict=True):
        for field in ("time", "force", "point", "moment"):
            require_same_bits(getattr(a, field), getattr(b, field))


def require_same(found: Recording, expected: Recording) -> None:
    """Markers, times and plates in every bit."""
    assert found.labels == expected.labels
    require_same_bits(found.time, expected.time)
    require_same_bits(found.markers, expected.markers)
    assert [plate.name for plate in found.plates] == [plate.name for plate in expected.plates]
    require_same_plates(found.plates, expected.plates)
    for a, b in zip(found.plates, expected.plates, strict=True):
        np.testing.assert_array_equal(a.corners, b.corners)


@given(recordings())
@QUICK
def test_markers_csv(tmp_path: Path, recording: Recording) -> None:
    write_markers_csv(tmp_path / "m.csv", recording)
    require_same(read_recording(tmp_path / "m.csv"), recording)


@given(recordings())
@QUICK
def test_trc(tmp_path: Path, recording: Recording) -> None:
    recording = replace(recording, time=np.arange(len(recording.time)) / 97.0)
    write_trc(tmp_path / "m.trc", recording)
    found = parse_trc(tmp_path / "m.trc")  # without the search for the vertical
    assert found.notes == ()
    require_same(found, recording)


@given(plates())
@QUICK
def test_forces_csv(tmp_path: Path, given_: tuple[ForcePlate, ...]) -> None:
    write_forces_csv(tmp_path / "f.csv", given_)
    found = read_forces(tmp_path / "f.csv").plates
    assert [plate.name for plate in found] == [plate.name for plate in given_]
    require_same_plates(found, given_)


@given(plates())
@QUICK
def test_forces_mot(tmp_path: Path, given_: tuple[ForcePlate, ...]) -> None:
    time = np.arange(len(given_[0].time)) / 997.0
    given_ = tuple(replace(plate, time=time) for plate in given_)
    write_forces_mot(tmp_path / "f.mot", given_)
    require_same_plates(read_forces(tmp_path / "f.mot").plates, given_)


def test_plates_of_different_length_share_a_table(tmp_path: Path) -> None:
    first, second = loaded_body().plates
    short = replace(
        second,
        time=second.time[7:-3],
        force=second.force[7:-3],
        point=second.point[7:-3],
        moment=second.moment[7:-3],
    )
    for name, write in (("f.csv", write_forces_csv), ("f.mot", write_forces_mot)):
        write(tmp_path / name, (first, short))
        require_same_plates(read_forces(tmp_path / name).plates, (first, short))
    with refuses(Code.NOT_WRITABLE, source="x.csv"):
        write_forces_csv(tmp_path / "x.csv", (first, replace(second, time=second.time + 1e-4)))
    with refuses(Code.NOT_WRITABLE, source="x.csv"):
        write_forces_csv(tmp_path / "x.csv", ())
    assert not (tmp_path / "x.csv").exists()


@pytest.mark.parametrize("suffix", [".c3d", ".C3D"])
def test_c3d(tmp_path: Path, suffix: str) -> None:
    recording = loaded_body()
    recording = replace(recording, time=recording.time + 3.41)
    recording = replace(
        recording, plates=tuple(replace(p, time=p.time + 3.41) for p in recording.plates)
    )
    recording.markers[10:15, 2] = np.nan
    path = tmp_path / f"x{suffix}"
    write_c3d(path, recording)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    found = read_recording(path)
    assert found.labels == recording.labels
    np.testing.assert_allclose(found.time, recording.time, rtol=1e-14)
    np.testing.assert_array_equal(np.isnan(found.markers), np.isnan(recording.markers))
    np.testing.assert_allclose(found.markers, recording.markers, rtol=1e-6)
    assert len(found.plates) == 2
    for a, b in zip(found.plates, recording.plates, strict=True):
        np.testing.assert_allclose(a.time, b.time, rtol=1e-14)
        scale = np.abs(b.wrench()).max(axis=0)
        assert np.all(np.abs(a.wrench() - b.wrench()) < 1e-6 * scale)
        np.testing.assert_allclose(a.corners, b.corners, rtol=1e-6)
        loaded = b.force[:, 1] > 50
        np.testing.assert_allclose(a.point[loaded], b.point[loaded], atol=1e-6)


def test_c3d_refuses_what_it_cannot_hold(tmp_path: Path) -> None:
    recording = loaded_body()
    uneven, unknown = recording.time.copy(), loaded_body()
    uneven[5] += 0.003
    odd = replace(recording.plates[0], time=recording.plates[0].time + 0.0005)
    unknown.plates[0].force[3] = np.nan
    for wrong, told in (
        (replace(recording, time=uneven), "constant frame rate"),
        (replace(recording, plates=(odd,)), "plate 1: 1000 samples"),
        (replace(body(), time=body().time + 700), "1 to 65535 are allowed"),
        (unknown, "NaN"),
    ):
        with refused(told):
            write_c3d(tmp_path / "x.c3d", wrong)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("label", ["a\tb", "a\nb", " a", "", "a\x00"])
def test_names_that_no_table_can_hold_are_refused(tmp_path: Path, label: str) -> None:
    recording = replace(body(3), labels=(label, *body().labels[1:]))
    for name, write in (("x.csv", write_markers_csv), ("x.trc", write_trc), ("x.c3d", write_c3d)):
        with refuses(Code.NOT_WRITABLE):
            write(tmp_path / name, recording)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "file", ["pig_c3d/gait.c3d", "labs_c3d/kad/static.c3d", "children/HC002D/straight.c3d"]
)
def test_a_table_says_what_its_c3d_file_said(file: str, data_dir: Path, tmp_path: Path) -> None:
    """Facts but the person's name, events, and computed points but those of segments' axes."""
    original = read_recording(data_dir / file)
    convert(data_dir / file, tmp_path / "x.csv")
    found = read_recording(tmp_path / "x.csv")
    assert found.facts == replace(original.facts, name=None) and found.facts.knee_width
    assert found.events == original.events
    kept = [original.computed.labels.index(label) for label in found.computed.labels]
    np.testing.assert_array_equal(found.computed.points, original.computed.points[:, kept])
    assert "PELO" in original.computed.labels and "PELO" not in found.computed.labels
    for table in ("x.csv", "x_facts.csv"):
        assert original.facts.name not in (tmp_path / table).read_text(encoding="utf-8")
    plain = pd.read_csv(tmp_path / "x.csv")
    assert list(plain.columns[:2]) == ["time", f"{original.labels[0]}_x"] and len(plain) == len(
        original.time
    )
    assert pd.read_csv(tmp_path / "x_facts.csv").columns.tolist() == ["fact", "value"]


@pytest.mark.parametrize(
    "row",
    [
        'mass,"""x"""',
        "mass,NaN",
        'event,"[1, ""x"", ""foot strike""]"',
        "nobody,1",
        "knee_width,{",
        "mass",
    ],
)
def test_a_damaged_row_of_what_was_said_is_named(row: str, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("# plain words\ntime,A_x,A_y,A_z\n0,1,2,3\n", encoding="utf-8")
    (tmp_path / "x_facts.csv").write_text(f"fact,value\n{row}\n", encoding="utf-8")
    with refuses(Code.FILE_FORMAT, field="row 1", source="x_facts.csv"):
        read_recording(tmp_path / "x.csv")


@pytest.mark.parametrize(
    "file",
    [
        "pig_c3d/gait.c3d",
        "pig_c3d/static.c3d",
        "functional_c3d/static.c3d",
        "c3d_formats/Eb015vi.c3d",
        "c3d_formats/TYPE-1.C3D",
    ],
)
def test_a_real_c3d_and_its_csv_are_the_same_bits(
    data_dir: Path, tmp_path: Path, file: str
) -> None:
    written = convert(data_dir / file, tmp_path / "out.csv")
    facts = (
        ("_facts",) if file.startswith("pig") else ()
    )  # the others say nothing of person and events
    assert written == tuple(
        tmp_path / f"out{kind}.csv" for kind in ("", "_forces", "_plates", *facts)
    )
    require_same(read_recording(written[0], forces=written[1]), read_recording(data_dir / file))


def test_corners_go_with_the_forces_and_not_with_others(tmp_path: Path) -> None:
    plate = loaded_body().plates[0]
    write_forces_csv(tmp_path / "a_forces.csv", (plate,))
    assert read_forces(tmp_path / "a_forces.csv").plates[0].corners is None
    write_plates_csv(tmp_path / "a_plates.csv", (plate,))
    read = read_forces(tmp_path / "a_forces.csv")
    np.testing.assert_array_equal(read.plates[0].corners, plate.corners)
    assert any("a_plates.csv" in note for note in read.notes)
    written = convert(tmp_path / "a_forces.csv", tmp_path / "b_forces.mot")
    assert written == (tmp_path / "b_forces.mot", tmp_path / "b_plates.csv")
    np.testing.assert_array_equal(read_forces(written[0]).plates[0].corners, plate.corners)
    (tmp_path / "a_plates.csv").unlink()
    assert convert(tmp_path / "a_forces.csv", tmp_path / "b_forces.mot") == written
    assert read_forces(written[0]).plates[0].corners is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("corner,x\n", "a header 'plate,corner,x,y,z' is needed"),
        ("plate,corner,x,y,z\n1,1,0,0,0\n", "corner 2, 3, 4 of plate '1' is missing"),
        ("plate,corner,x,y,z\n1,5,0,0,0\n", "a corner of 1 to 4"),
        ("plate,corner,x,y,z\n1,1,0,nan,0\n", "three numbers"),
        ("plate,corner,x,y,z\n1,1,0,0,0\n1,1,0,0,0\n", "corner 1 of plate '1' twice"),
        ("plate,corner,x,y,z\n9,1,0,0,0\n9,2,0,0,0\n9,3,0,0,0\n9,4,0,0,0\n", "found the plate '9'"),
    ],
)
def test_damaged_corners_are_told(tmp_path: Path, text: str, told: str) -> None:
    write_forces_csv(tmp_path / "a_forces.csv", loaded_body().plates)
    (tmp_path / "a_plates.csv").write_text(text, encoding="utf-8")
    with refuses(Code.FILE_FORMAT, told, source="a_plates.csv"):
        read_forces(tmp_path / "a_forces.csv")


def test_faults_leave_the_target_as_it_was(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", body(5))
    write_forces_csv(tmp_path / "f.csv", loaded_body().plates)
    target = tmp_path / "out.mot"
    target.write_text("old")
    (tmp_path / "bad.mot").write_text("no table")
    for source, out, told in (
        ("a.trc", "out.mot", "a.trc can become .csv, .trc, .c3d"),
        ("f.csv", "out.trc", "f.csv can become .csv, .mot, .sto"),
        ("absent.c3d", "out.mot", "no such file"),
        ("a.trc", "./a.trc", "the same file"),
        ("a.trc", "", "found a folder"),
        ("bad.mot", "bad.csv", "endheader"),
    ):
        with refused(told):
            convert(tmp_path / source, tmp_path / out)
    assert target.read_text() == "old"
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "a.trc",
        "bad.mot",
        "f.csv",
        "out.mot",
    ]
