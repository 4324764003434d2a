"""One real person, relabelled as other laboratories would: all built-in sets make the same legs of these markers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.nominal import nominal_model
from tests.model.people import PEOPLE

SAME = 1e-9
"""m; the same landmarks make the same joints, to rounding."""

WINDOW = slice(0, 50)
"""Frames of standing: the stillest depend on which markers there are."""

OURS = "ASIS PSIS LFE MFE LM SPH CAL TT2 MFH1 MFH5 THI1 THI2 THI3 LEG1 LEG2 LEG3"
"""What these laboratories share with the 73 markers that the person wore, without the side."""
THEIRS = {
    "ior": "{S}IAS {S}IPS {S}FLE {S}FME {S}FAL {S}TAM {S}FCC {S}FM2 {S}FM1 {S}FM5 "
    "{S}TH1 {S}TH2 {S}TH3 {S}SK1 {S}SK2 {S}SK3",
    "cast": "{S}_IAS {S}_IPS {S}_FLE {S}_FME {S}_FAL {S}_TAM {S}_FCC {S}_FM2 {S}_FM1 {S}_FM5 {S}_TH1 "
    "{S}_TH2 {S}_TH3 {S}_SK1 {S}_SK2 {S}_SK3",
    "visual3d": "{S}ASIS {S}PSIS {S}LK {S}MK {S}LA {S}MA {S}HEEL {S}TOE {S}MT1 {S}MT5 "
    "{S}TH1 {S}TH2 {S}TH3 {S}SK1 {S}SK2 {S}SK3",
    "opencap": "{s}.ASIS_study {s}.PSIS_study {s}_knee_study {s}_mknee_study {s}_ankle_study {s}_mankle_study "
    "{s}_calc_study {s}_toe_study - {s}_5meta_study {s}_thigh1_study {s}_thigh2_study {s}_thigh3_study "
    "{s}_sh1_study {s}_sh2_study "
    "{s}_sh3_study",
    "rajagopal": "{S}ASI {S}PSI {S}LFC {S}MFC {S}LMAL {S}MMAL {S}CAL {S}TOE - {S}MT5 {S}TH1 {S}TH2 {S}TH3 {S}TB1 "
    "{S}TB2 {S}TB3",
    "ufabc": "{S}.ASIS {S}.PSIS {S}.Knee {S}.Knee.Medial {S}.Ankle {S}.Ankle.Medial {S}.Heel {S}.MT2 {S}.MT1 {S}.MT5 "
    "{S}.GTR - - {S}.HF {S}.TT -",
    "plug-in-gait": "{S}ASI {S}PSI {S}KNE {S}KNM {S}ANK {S}MED {S}HEE {S}TOE {S}MT1 {S}MT5 {S}THI {S}THAP {S}THAD "
    "{S}TIB {S}TIAP {S}TIAD",
}


@pytest.mark.parametrize("name", THEIRS)
def test_the_same_person_under_their_labels(name: str, data_dir: Path) -> None:
    person = PEOPLE["functional"]
    recording = person.markers.renamed(person.static(data_dir))
    new: dict[str, str] = {}
    for side in "RL":
        small = "r" if side == "R" else "L"  # OpenCap's spelling
        for ours, theirs in zip(OURS.split(), THEIRS[name].split(), strict=True):
            new[side + ours] = theirs.replace("{S}", side).replace("{s}", small)
    kept = [i for i, label in enumerate(recording.labels) if new.get(label, "-") != "-"]
    legs = replace(recording, labels=tuple(new[recording.labels[i]] for i in kept), markers=recording.markers[:, kept])
    marker_set = load_marker_set(name)
    found = marker_set.coverage(legs.labels)
    assert found.complete and not found.unknown
    model = nominal_model(legs, marker_set, person.subject, window=WINDOW)
    known = nominal_model(recording, person.markers, person.subject, window=WINDOW)
    for landmark in ("hjc", "kjc", "ajc", "heel", "toe"):
        for side in "rl":
            segment, at = model.landmarks[f"{landmark}_{side}"]
            same_segment, same_at = known.landmarks[f"{landmark}_{side}"]
            assert segment == same_segment
            np.testing.assert_allclose(at, same_at, atol=SAME)
    followed = set(model.markers.labels)
    assert {label for label in legs.labels if label in marker_set.tracked} <= followed
