"""MOT and STO tables, ground reactions in all their spellings, and OpenSim's external loads."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import Code
from gaitcal.io.axes import UP_TO_Y, AxisPermutation, rotate_recording
from gaitcal.io.csv_recordings import write_forces_csv, write_markers_csv, write_plates_csv
from gaitcal.io.force_tables import Forces
from gaitcal.io.formats import convert, read_forces, read_recording
from gaitcal.io.opensim_files import find_loads_tables, read_table, write_forces_mot, write_trc
from gaitcal.io.recording import Recording
from gaitcal.study.study import Study
from tests.commands import refused
from tests.io.recordings import loaded_body
from tests.messages import check_text, refuses
from tests.synthetic_studies import write_synthetic_study

ONE = [f"1_{quantity}{axis}" for quantity in "fpt" for axis in "xyz"]
"""Columns of a plate: force, point, moment."""
STEP = [0.0, 700, 0, 0.3, 0, 0.1, 0, 4, 0]


def names_of(*quantities: str) -> list[str]:
    return [f"{quantity}{axis}" for quantity in quantities for axis in "xyz"]


def in_turn(pattern: str, quantities: tuple[str, str, str], plates: tuple[str, str]) -> list[str]:
    """All columns of one plate, then those of the other."""
    return [pattern.format(q=q, a=axis, k=k) for k in plates for q in quantities for axis in "xyz"]


F, P, M, T = "ground_force_v", "ground_force_p", "ground_moment_m", "ground_torque_"
CALCN = ("force", "force", "moment")
LEGS = ("force_v", "force_p", "torque_")
SCHEMES = {
    "opensim": names_of(F, P, f"1_{F}", f"1_{P}", T, f"1_{T}"),
    "sides": names_of(
        *(f"ground_force_{k}_{q}" for k in "rl" for q in "vp"),
        "ground_torque_r_",
        "ground_torque_l_",
    ),
    "numbers": names_of(
        *(f"{F[:-1]}{k}_{q}" for k in "12" for q in "vp"), *(f"ground_moment_{k}_m" for k in "12")
    ),
    "ours": names_of("R_f", "R_p", "L_f", "L_p", "R_t", "L_t"),
    "repeated": names_of(F, P, F, P, T, T),
}
"""Forces and points of both plates, then their moments."""
IN_TURN = {
    "Fx1": in_turn("{q}{a}{k}", ("F", "COP", "M"), ("1", "2")),
    "Fx_1": in_turn("{q}{a}_{k}", ("F", "CoP", "T"), ("1", "2")),
    "F1x": in_turn("{q}{k}{a}", ("F", "P", "M"), ("1", "2")),
    "ground_force_vx_r": in_turn("ground_{q}{a}_{k}", LEGS, ("r", "l")),
    "calcn": names_of(
        *(f"ground_{q}_calcn_{k}_{c}" for k in "rl" for q, c in zip(CALCN, "vpm", strict=True))
    ),
    "R_ground": in_turn("{k}_ground_{q}{a}", LEGS, ("R", "L")),
}


def table(
    names: list[str], rows: np.ndarray, header: str = "made up\nversion=1\nnRows=7\nnColumns=99\n"
) -> str:
    lines = [header + "endheader", "\t".join(["time", *names])]
    lines += [
        "\t".join([f"{0.01 * i:.2f}", *(repr(float(v)) for v in row)]) for i, row in enumerate(rows)
    ]
    return "\n".join(lines) + "\n"


def forces_of(folder: Path, names: list[str], rows: np.ndarray) -> Forces:
    (folder / "f.mot").write_text(table(names, rows), encoding="utf-8")
    return read_forces(folder / "f.mot")


@pytest.mark.parametrize("scheme", [*SCHEMES, *IN_TURN])
def test_every_naming_scheme_gives_the_same_two_plates(tmp_path: Path, scheme: str) -> None:
    starts = ((1, 4, 13), (7, 10, 16)) if scheme in SCHEMES else ((1, 4, 7), (10, 13, 16))
    names = (SCHEMES | IN_TURN)[scheme]
    plates = forces_of(tmp_path, names, np.arange(1.0, 19.0) + np.zeros((4, 1))).plates
    assert [plate.name for plate in plates] == ["1", "2"]
    for plate, places in zip(plates, starts, strict=True):
        for vectors, start in zip((plate.force, plate.point, plate.moment), places, strict=True):
            np.testing.assert_array_equal(vectors[0], np.arange(start, start + 3))


def test_a_fixed_point_with_full_moment_is_the_same_wrench(tmp_path: Path) -> None:
    force, centre, free = (
        np.array([30.0, 700.0, -20.0]),
        np.array([0.4, 0.0, 0.1]),
        np.array([0.0, 3.0, 0.0]),
    )
    full = free + np.cross(centre, force)
    rows = np.tile(np.concatenate([force, centre, free, force, 0 * force, full]), (3, 1))
    first, second = forces_of(
        tmp_path, [*ONE, *(name.replace("1", "2") for name in ONE)], rows
    ).plates
    np.testing.assert_allclose(first.wrench(), second.wrench(), atol=1e-12)


def test_forces_on_the_plate_are_turned_round(tmp_path: Path) -> None:
    forces = forces_of(tmp_path, ONE, np.tile([10.0, -700, 5, 0.3, 0, 0.1, 0, 4, 0], (3, 1)))
    np.testing.assert_array_equal(forces.plates[0].force[0], [-10, 700, -5])
    np.testing.assert_array_equal(forces.plates[0].moment[0], [0, -4, 0])
    check_text(forces.notes)


def test_points_unknown_without_force_do_not_spoil_the_wrench_and_others_are_not_put_at_the_origin(
    tmp_path: Path,
) -> None:
    for force, told in (([0.0, 0, 0], True), (STEP[:3], False)):
        rows = np.array(
            [STEP, [*force, *[np.nan] * 3, *(STEP[6:] if any(force) else [np.nan, 0, 0])], STEP]
        )
        forces = forces_of(tmp_path, ONE, rows)
        assert any("1 samples without force" in note for note in forces.notes) == told
        (plate,) = forces.plates
        assert (plate.wrench()[1] == 0).all() if told else np.isnan(plate.point[1]).all()


@pytest.mark.parametrize(
    "names",
    [
        ["hip_flexion_r", "pelvis_tx", "pelvis_ty"],
        ["ground_force_vx", "ground_force_vy", "ground_force_px"],
        ["ground_force_vx", "ground_force_vy", "ground_force_vz"],
    ],
)
def test_incomplete_forces_are_named(tmp_path: Path, names: list[str]) -> None:
    with refuses(Code.FILE_FORMAT, source="f.mot"):
        forces_of(tmp_path, names, np.ones((3, len(names))))


def test_a_free_moment_alone(tmp_path: Path) -> None:
    names = ["Fx1", "Fy1", "Fz1", "COPx1", "COPy1", "COPz1", "Tz1"]
    values = np.tile([10.0, 20, 700, 0.3, 0.4, 0, 6], (3, 1))
    (plate,) = forces_of(tmp_path, names, values).plates
    np.testing.assert_array_equal(plate.force[0], [10, 700, -20])
    np.testing.assert_array_equal(plate.moment[0], [0, 6, 0])
    with refuses(Code.FILE_FORMAT, field="plate 1", source="f.mot"):
        forces_of(tmp_path, [n.replace("Tz", "Tx") for n in names], values)


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        (table(["a", "b"], np.array([[1, 2], [3, 4]]), "inDegrees=yes\n"), True),
        (table(["a", "b"], np.array([[1, 2], [3, 4]]), "inDegrees = no\n"), False),
        (table(["a", "b"], np.array([[1, 2], [3, 4]]), "name x\ndatacolumns 3\n"), None),
        ("x\nendheader\n\n  time   a  b\n 0.0  1 2\n 0.1  3 4\n", None),
    ],
    ids=["degrees", "radians", "not told", "parted by blanks"],
)
def test_tables(tmp_path: Path, text: str, degrees: bool | None) -> None:
    path = tmp_path / "t.mot"
    path.write_text(text, encoding="utf-8")
    found = read_table(str(path))  # a path as text serves too
    assert found.in_degrees is degrees and found.names == ("a", "b")
    np.testing.assert_array_equal(found.values, [[1, 2], [3, 4]])
    np.testing.assert_array_equal(found.get_column("b"), [2, 4])


@pytest.mark.parametrize(
    "text, message",
    [
        ("time\ta\n0\t1\n", "no line 'endheader'"),
        ("endheader\n", "ends after its header"),
        ("endheader\nframe\ta\n0\t1\n", "found 'frame'; the first column must be 'time'"),
        ("endheader\ntime\ta\n", "no row of numbers"),
        ("endheader\ntime\ta\n0\t1\n1\t2\t3\n", "line 4: found 3 cells; 2 are allowed"),
        ("endheader\ntime\ta\n0\t1\n1\n", "line 4: found 1 cells (file cut short?); 2 are needed"),
    ],
)
def test_faults_of_tables(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "t.mot"
    path.write_text(text)
    with refused(message):
        read_table(path)


@pytest.mark.parametrize(
    "turn", [t for t in UP_TO_Y.values() if t in (UP_TO_Y[0, 1], UP_TO_Y[2, 1])]
)
@pytest.mark.parametrize("kind", ["mot", "csv"])
def test_markers_and_forces_of_a_room_with_another_axis_up(
    tmp_path: Path, turn: AxisPermutation, kind: str
) -> None:
    """Both are turned alike, so that the feet stay on their plates; corners too."""
    recording = standing_body()
    back = AxisPermutation(
        tuple(turn.source.index(k) for k in range(3)),
        tuple(turn.sign[turn.source.index(k)] for k in range(3)),
    )
    np.testing.assert_array_equal(turn.apply(back.apply(np.array([1.0, 2, 3]))), [1, 2, 3])
    away = rotate_recording(recording, back)
    if kind == "mot":
        markers, forces = tmp_path / "w.trc", tmp_path / "w.mot"
        write_trc(markers, away)
        write_forces_mot(forces, away.plates)
    else:
        markers, forces = tmp_path / "w.csv", tmp_path / "w_forces.csv"
        write_markers_csv(markers, away)
        write_forces_csv(forces, away.plates)
        write_plates_csv(tmp_path / "w_plates.csv", away.plates)
    found = read_recording(markers, forces=forces)
    np.testing.assert_array_equal(found.markers, recording.markers)
    for plate, original in zip(found.plates, recording.plates, strict=True):
        np.testing.assert_array_equal(plate.wrench(), original.wrench())
        if kind == "csv":
            np.testing.assert_array_equal(plate.corners, original.corners)
    check_text(found.notes)


def standing_body() -> Recording:
    """A body of twelve markers over two plates, y up."""
    recording = loaded_body()
    more = recording.markers[:, :4] + [0.02, 0.1, 0.03]
    return replace(
        recording,
        labels=(*recording.labels, *(f"M{k}" for k in range(4))),
        markers=np.concatenate([recording.markers, more], axis=1),
    )


LOADS = """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
  <ExternalLoads name="loads"><objects>{forces}</objects>{common}</ExternalLoads>
</OpenSimDocument>
"""
FORCE = """<ExternalForce name="{name}"><applied_to_body>{body}</applied_to_body>
  <force_expressed_in_body>{force_in}</force_expressed_in_body><point_expressed_in_body>{point_in}</point_expressed_in_body>
  <force_identifier>{force}</force_identifier><point_identifier>{point}</point_identifier>
  <torque_identifier>{torque}</torque_identifier><data_source_name>{source}</data_source_name>{more}</ExternalForce>"""
COLUMNS = [
    f"{side}_{kind}{axis}"
    for side in "ab"
    for kind in ("force_v", "force_p", "torque_")
    for axis in "xyz"
]


def force(name: str = "one", body: str = "calcn_r", side: str = "a", **change: str) -> str:
    words = {
        "name": name, "body": body, "force_in": "ground", "point_in": "/ground",
        "force": f"{side}_force_v",
        "point": f"{side}_force_p", "torque": f"{side}_torque_", "source": "Unassigned", "more": "",
    }  # fmt: skip
    return FORCE.format(**{**words, **change})


def write(folder: Path, *forces: str, table: str = "grf.mot") -> Path:
    values = np.tile(
        [10.0, 700, 5, 0.1, 0, 0.2, 0, 3, 0, -10, 650, 4, 0.9, 0, -0.1, 0, -2, 0], (4, 1)
    )
    rows = ["\t".join(map(str, [0.01 * k, *row])) for k, row in enumerate(values.tolist())]
    header = ["f", "version=1", "endheader", "\t".join(["time", *COLUMNS])]
    (folder / "grf.mot").write_text("\n".join([*header, *rows]) + "\n", encoding="utf-8")
    common = f"<datafile>{table}</datafile>" if table else ""
    path = folder / "grf.xml"
    path.write_text(LOADS.format(forces="\n".join(forces), common=common), encoding="utf-8")
    return path


def test_the_real_file(data_dir: Path) -> None:
    folder = data_dir / "subject01"
    loads, table = (
        read_forces(folder / "subject01_walk1_grf.xml"),
        read_forces(folder / "subject01_walk1_grf.mot"),
    )
    assert loads.feet == {"right": "r", "left": "l"}
    for plate, other in zip(loads.plates, table.plates, strict=True):
        for part in ("time", "force", "point", "moment"):
            np.testing.assert_array_equal(getattr(plate, part), getattr(other, part))
    walk = read_recording(folder / "subject01_walk1.trc", forces=folder / "subject01_walk1_grf.xml")
    assert walk.feet == {"right": "r", "left": "l"}


def test_order_bodies_and_switches(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        force("second", "/bodyset/calcn_l", "b"),
        force("first", "r_foot", "a"),
        force("off", "torso", "a", more="<isDisabled>true</isDisabled>"),
        force("none", "pelvis", "a", force="Unassigned"),
    )
    found = read_forces(path)
    assert found.feet == {"second": "l", "first": "r"}
    np.testing.assert_array_equal(found.plates[0].force[0], [-10, 650, 4])
    np.testing.assert_array_equal(found.plates[1].moment[0], [0, 3, 0])
    check_text(found.notes, "off")
    check_text(found.notes, "none")


@pytest.mark.parametrize(
    "table", ["grf.mot", "./grf.mot", r"C:\lab\session\grf.mot", "../elsewhere/grf.mot"]
)
def test_the_table_is_found_beside_it(tmp_path: Path, table: str) -> None:
    path = write(tmp_path, force(), table=table)
    assert find_loads_tables(path) == (tmp_path / "grf.mot",)
    assert read_forces(path).plates[0].force[0, 1] == 700


def test_a_table_of_each_force(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        force(source="grf.mot"),
        force("two", "calcn_l", "b", source="other.mot"),
        table="",
    )
    shutil.copy(tmp_path / "grf.mot", tmp_path / "other.mot")
    assert len(find_loads_tables(path)) == 2 and read_forces(path).feet == {"one": "r", "two": "l"}


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            force(body="torso"),
            "ExternalForce one: found a force on 'torso'; allowed are forces on the right and left",
        ),
        (force(body="calcn"), "found a force on 'calcn'"),
        (
            force(point_in="calcn_r"),
            "ExternalForce one: found its point expressed in 'calcn_r'; allowed is ground",
        ),
        (force(force_in="tibia_r"), "found its force expressed in 'tibia_r'"),
        (
            force(force="c_force_v"),
            "ExternalForce one, force: found 0 columns; c_force_vx, c_force_vy",
        ),
        (force(point=""), "plate one: no point of application"),
        (
            force(more="<isDisabled> true </isDisabled>"),
            "found no ExternalForce that is switched on",
        ),
    ],
)
def test_what_cannot_be_taken_is_named(tmp_path: Path, entry: str, message: str) -> None:
    with refused(message):
        read_forces(write(tmp_path, entry))


def test_files_that_are_none(tmp_path: Path) -> None:
    with refused("datafile: found 'gone.mot', which does not exist beside it"):
        read_forces(write(tmp_path, force(), table="gone.mot"))
    with refused("names no table of forces"):
        read_forces(write(tmp_path, force(), table=""))
    for text, message in (
        ("<a/>", "found <a>; a file with <ExternalLoads>"),
        ("no xml", "is not well-formed"),
    ):
        (tmp_path / "x.xml").write_text(text)
        with refused(message):
            read_forces(tmp_path / "x.xml")


def test_a_study_takes_feet_and_table_from_it(tmp_path: Path) -> None:
    path = write_synthetic_study(tmp_path)
    convert(tmp_path / "walk_forces.csv", tmp_path / "grf.mot")
    columns = [f"ground_{q}" for q in ("force_{}_v", "force_{}_p", "moment_{}_m")]
    entries = [
        force(
            name,
            body,
            **dict(zip(("force", "point", "torque"), (c.format(k) for c in columns), strict=True)),
        )
        for k, name, body in ((1, "right", "calcn_r"), (2, "left", "calcn_l"))
    ]
    text = LOADS.format(forces="".join(entries), common="<datafile>grf.mot</datafile>")
    (tmp_path / "grf.xml").write_text(text, encoding="utf-8")
    path.write_text(
        path.read_text(encoding="utf-8").replace("walk_forces.csv", "grf.xml"), encoding="utf-8"
    )
    study = Study.load(path)
    assert study.trials[1].plates == {"right": "r", "left": "l"}
    assert {"grf.xml", "grf.mot"} <= set(study.inputs)
    of_walk = 'forces = "grf.xml"\n'
    text = path.read_text(encoding="utf-8")
    assert of_walk in text
    path.write_text(
        text.replace(of_walk, of_walk + 'plates = { right = "none" }\n'), encoding="utf-8"
    )
    assert Study.load(path).trials[1].plates == {"right": "none", "left": "l"}
    assert study.input_names(study.trials[1]) == {
        "file": "walk.csv",
        "forces": "grf.xml",
        "table0": "grf.mot",
    }
