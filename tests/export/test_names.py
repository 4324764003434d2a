"""Names are data: whatever stands in them, the files stay well-formed, the names distinct, and
nothing is a path.
"""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.export.opensim.osim_reader import read_osim
from gaitcal.export.opensim.osim_writer import (
    decode_name,
    encode_name,
    strip_control_characters,
    write_osim,
)
from gaitcal.export.other_formats import write_mjcf, write_urdf
from gaitcal.model.linkage import SEGMENTS
from gaitcal.model.subject_model import SubjectModel

NASTY = (
    "<script>alert(1)</script>", "../../etc/passwd", "..", "C:\\windows", "a b", "a\tb\nc",
    "x\x00y", "]]>", "--><b>",
    "&amp;", 'quote"d', "it's", "100%", "%41", "%", "", "*12", "Subj:LASI", "Hüfte", "腰",
    "\u202eright to left",
    "\ud800 alone", "\N{FOOT}", "pelvis", "knee_angle_r", "e\u0301", "\ufffe",
)  # fmt: skip


@given(st.text(st.characters(codec=None)))
def test_reversible(name: str) -> None:
    safe = encode_name(name)
    assert decode_name(safe) == name
    assert safe
    assert not set(safe) & set("\\/*+ \t\n<>&\"'")
    assert safe.isprintable()


@given(st.text())
def test_foreign_names_are_never_an_error(name: str) -> None:
    assert isinstance(decode_name(name), str)
    assert isinstance(decode_name("%FF" + name), str)


@given(st.text(st.characters(codec=None)))
def test_any_text_makes_well_formed_xml(text: str) -> None:
    element = ET.Element("credits")
    element.text = strip_control_characters(text)
    ET.fromstring(ET.tostring(element, encoding="utf-8"))


@pytest.fixture
def nasty(published: SubjectModel) -> SubjectModel:
    massive = [s for s in SEGMENTS if not s.startswith("talus")] * 3
    markers = replace(
        published.markers,
        labels=NASTY,
        segments=tuple(massive[: len(NASTY)]),
        local=np.random.default_rng(4).normal(size=(len(NASTY), 3)),
        weight=np.ones(len(NASTY)),
    )
    subject = replace(published.subject, name="../<script>\x00 ünder")
    return replace(published, markers=markers, subject=subject, notes=("<b>\x00\ud800", "--> ]]>"))


def test_files_are_well_formed_and_hold_no_markup(nasty: SubjectModel, tmp_path: Path) -> None:
    for write, name in ((write_osim, "m.osim"), (write_urdf, "m.urdf"), (write_mjcf, "m.xml")):
        write(nasty, tmp_path / name)
        tree = ET.parse(tmp_path / name)
        assert not [e for e in tree.iter() if e.tag in ("script", "b")]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.osim", "m.urdf", "m.xml"]
    peer = read_osim(tmp_path / "m.osim")
    assert tuple(peer.markers) == NASTY


def test_urdf_reader_finds_every_marker(nasty: SubjectModel, tmp_path: Path) -> None:
    write_urdf(nasty, tmp_path / "m.urdf")
    peer = pin.buildModelFromUrdf(str(tmp_path / "m.urdf"))
    assert all(peer.existFrame(f"marker_{encode_name(name)}", pin.FrameType.BODY) for name in NASTY)


def test_opensim_finds_every_marker(osim: Any, nasty: SubjectModel, tmp_path: Path) -> None:
    write_osim(nasty, tmp_path / "m.osim")
    model = osim.Model(str(tmp_path / "m.osim"))
    model.initSystem()
    found = [model.getMarkerSet().get(i).getName() for i in range(model.getNumMarkers())]
    assert tuple(decode_name(name) for name in found) == NASTY


def test_mujoco_finds_every_marker(mujoco: Any, nasty: SubjectModel, tmp_path: Path) -> None:
    write_mjcf(nasty, tmp_path / "m.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    assert {decode_name(model.site(i).name) for i in range(model.nsite)} == set(NASTY)
