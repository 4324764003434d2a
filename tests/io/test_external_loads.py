"""OpenSim's ExternalLoads: the plates of the table, with the feet and names that the file gives them."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.export.other_formats import write_external_loads
from gaitcal.io.formats import convert, read_forces, read_recording
from gaitcal.io.opensim_files import loads_tables
from gaitcal.study.study import Study
from tests.synthetic_studies import write_synthetic_study

LOADS = """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
  <ExternalLoads name="loads"><objects>{forces}</objects>{common}</ExternalLoads>
</OpenSimDocument>
"""
FORCE = """<ExternalForce name="{name}"><applied_to_body>{body}</applied_to_body>
  <force_expressed_in_body>{force_in}</force_expressed_in_body><point_expressed_in_body>{point_in}</point_expressed_in_body>
  <force_identifier>{force}</force_identifier><point_identifier>{point}</point_identifier>
  <torque_identifier>{torque}</torque_identifier><data_source_name>{source}</data_source_name>{more}</ExternalForce>"""
COLUMNS = [f"{side}_{kind}{axis}" for side in "ab" for kind in ("force_v", "force_p", "torque_") for axis in "xyz"]


def force(name: str = "one", body: str = "calcn_r", side: str = "a", **change: str) -> str:
    words = {
        "name": name,
        "body": body,
        "force_in": "ground",
        "point_in": "/ground",
        "force": f"{side}_force_v",
        "point": f"{side}_force_p",
        "torque": f"{side}_torque_",
        "source": "Unassigned",
        "more": "",
    }
    return FORCE.format(**{**words, **change})


def write(folder: Path, *forces: str, table: str = "grf.mot") -> Path:
    values = np.tile([10.0, 700, 5, 0.1, 0, 0.2, 0, 3, 0, -10, 650, 4, 0.9, 0, -0.1, 0, -2, 0], (4, 1))
    rows = ["\t".join(map(str, [0.01 * k, *row])) for k, row in enumerate(values.tolist())]
    header = ["f", "version=1", "endheader", "\t".join(["time", *COLUMNS])]
    (folder / "grf.mot").write_text("\n".join([*header, *rows]) + "\n", encoding="utf-8")
    common = f"<datafile>{table}</datafile>" if table else ""
    path = folder / "grf.xml"
    path.write_text(LOADS.format(forces="\n".join(forces), common=common), encoding="utf-8")
    return path


def test_the_real_file(data_dir: Path) -> None:
    folder = data_dir / "subject01"
    loads, table = read_forces(folder / "subject01_walk1_grf.xml"), read_forces(folder / "subject01_walk1_grf.mot")
    assert loads.feet == {"right": "r", "left": "l"}
    for plate, other in zip(loads.plates, table.plates, strict=True):
        for part in ("time", "force", "point", "moment"):
            np.testing.assert_array_equal(getattr(plate, part), getattr(other, part))
    walk = read_recording(folder / "subject01_walk1.trc", forces=folder / "subject01_walk1_grf.xml")
    assert walk.feet == {"right": "r", "left": "l"}


def test_our_own_files_come_back(tmp_path: Path) -> None:
    wrench = np.random.default_rng(3).normal(size=(5, 2, 6)) * 100
    wrench[:, :, 1] = 700.0
    _, xml = write_external_loads(tmp_path, np.arange(5) / 100, wrench, stem="walk")
    found = read_forces(xml)
    assert list(found.feet.values()) == ["r", "l"]
    for k, plate in enumerate(found.plates):
        np.testing.assert_allclose(plate.wrench(), wrench[:, k], atol=1e-9)


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
    assert any("'off' is switched off" in note for note in found.notes)
    assert any("'none' has no columns" in note for note in found.notes)


@pytest.mark.parametrize("table", ["grf.mot", "./grf.mot", r"C:\lab\session\grf.mot", "../elsewhere/grf.mot"])
def test_the_table_is_found_beside_it(tmp_path: Path, table: str) -> None:
    path = write(tmp_path, force(), table=table)
    assert loads_tables(path) == (tmp_path / "grf.mot",)
    assert read_forces(path).plates[0].force[0, 1] == 700


def test_a_table_of_each_force(tmp_path: Path) -> None:
    path = write(tmp_path, force(source="grf.mot"), force("two", "calcn_l", "b", source="other.mot"), table="")
    shutil.copy(tmp_path / "grf.mot", tmp_path / "other.mot")
    assert len(loads_tables(path)) == 2 and read_forces(path).feet == {"one": "r", "two": "l"}


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (force(body="torso"), "ExternalForce one: found a force on 'torso'; allowed are forces on the right and left"),
        (force(body="calcn"), "found a force on 'calcn'"),
        (force(point_in="calcn_r"), "ExternalForce one: found its point expressed in 'calcn_r'; allowed is ground"),
        (force(force_in="tibia_r"), "found its force expressed in 'tibia_r'"),
        (force(force="c_force_v"), "ExternalForce one, force: found 0 columns; c_force_vx, c_force_vy"),
        (force(point=""), "plate one: no point of application"),
        (force(more="<isDisabled> true </isDisabled>"), "found no ExternalForce that is switched on"),
    ],
)
def test_what_cannot_be_taken_is_named(tmp_path: Path, entry: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_forces(write(tmp_path, entry))
    assert message in str(caught.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="datafile: found 'gone.mot', which does not exist beside it"):
        read_forces(write(tmp_path, force(), table="gone.mot"))
    with pytest.raises(InputError, match="names no table of forces"):
        read_forces(write(tmp_path, force(), table=""))
    for text, message in (("<a/>", "found <a>; a file with <ExternalLoads>"), ("no xml", "is not well-formed")):
        (tmp_path / "x.xml").write_text(text)
        with pytest.raises(InputError, match=message):
            read_forces(tmp_path / "x.xml")


def test_a_study_takes_feet_and_table_from_it(tmp_path: Path) -> None:
    path = write_synthetic_study(tmp_path)
    convert(tmp_path / "walk_forces.csv", tmp_path / "grf.mot")
    columns = [f"ground_{q}" for q in ("force_{}_v", "force_{}_p", "moment_{}_m")]
    entries = [
        force(name, body, **dict(zip(("force", "point", "torque"), (c.format(k) for c in columns), strict=True)))
        for k, name, body in ((1, "right", "calcn_r"), (2, "left", "calcn_l"))
    ]
    text = LOADS.format(forces="".join(entries), common="<datafile>grf.mot</datafile>")
    (tmp_path / "grf.xml").write_text(text, encoding="utf-8")
    path.write_text(path.read_text(encoding="utf-8").replace("walk_forces.csv", "grf.xml"), encoding="utf-8")
    study = Study.load(path)
    assert study.trials[1].plates == {"right": "r", "left": "l"}
    assert {"grf.xml", "grf.mot"} <= set(study.inputs)
    of_walk = 'forces = "grf.xml"\n'
    text = path.read_text(encoding="utf-8")
    assert of_walk in text
    path.write_text(text.replace(of_walk, of_walk + 'plates = { right = "none" }\n'), encoding="utf-8")
    assert Study.load(path).trials[1].plates == {"right": "none", "left": "l"}
    assert study.input_names(study.trials[1]) == {"file": "walk.csv", "forces": "grf.xml", "table0": "grf.mot"}
