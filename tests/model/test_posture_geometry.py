"""Static postures whose answer is known beforehand: everybody enlarged, and a bent arm with one elbow marker."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.io.still import still_window
from gaitcal.model.chain import axis_rotation
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.nominal import nominal_model
from gaitcal.model.parameters import JOINT_PARAMETERS, Kind
from gaitcal.model.segment_frames import Frame, HipCentre, half_width
from gaitcal.model.trunk import measured_arm
from tests.model.people import PEOPLE

SAME = 1e-9
"""m, rad: what rounding leaves of coordinates of several metres."""
LARGER = 1.07


@pytest.mark.parametrize("name", PEOPLE)
def test_a_larger_person_has_everything_larger(name: str, data_dir: Path) -> None:
    """Positions grow with the recording and the height, directions stay; the subtalar axis alone has a fixed place.

    Hips by Bell: the constants of Harrington's equations do not grow.
    """
    person = PEOPLE[name]
    static = person.markers.renamed(person.static(data_dir))
    window = still_window(static, person.markers.labels).frames
    grown = replace(static, markers=LARGER * static.markers)
    subject = replace(person.subject, height=LARGER * person.subject.height)
    one = nominal_model(static, person.markers, person.subject, window=window, hip_centre=HipCentre.BELL)
    other = nominal_model(grown, person.markers, subject, window=window, hip_centre=HipCentre.BELL)
    for parameter, small, large in zip(JOINT_PARAMETERS, one.parameters.joint, other.parameters.joint, strict=True):
        if not parameter.joint.startswith("subtalar"):
            factor = LARGER if parameter.kind is Kind.POSITION else 1.0
            assert large == pytest.approx(factor * small, abs=SAME), parameter.name
    np.testing.assert_allclose(other.parameters.zero_angles, one.parameters.zero_angles, atol=SAME)
    np.testing.assert_allclose(other.markers.local, LARGER * one.markers.local, atol=SAME)


@pytest.mark.parametrize("side", ["r", "l"])
@pytest.mark.parametrize("bent_deg", [40.0, 90.0, 120.0])
@pytest.mark.parametrize("raised_deg", [0.0, 20.0])
def test_the_plane_of_a_bent_arm_gives_its_elbow(side: str, bent_deg: float, raised_deg: float) -> None:
    """The forearm is turned forward about the elbow's axis; the marker lies half a width outwards on that axis."""
    height, outwards = 1.75, 1.0 if side == "r" else -1.0
    body = axis_rotation(1, 0.8)
    shoulder = np.array([1.0, 1.4, -2.0])
    lift = body @ axis_rotation(0, -outwards * np.deg2rad(raised_deg))
    elbow = shoulder - 0.30 * lift[:, 1]
    wrist = elbow - 0.26 * (lift @ axis_rotation(2, np.deg2rad(bent_deg)))[:, 1]
    marker = elbow + outwards * half_width("elbow", height) * lift[:, 2]
    landmarks = {f"elbow_lat_{side}": marker, f"wrist_{side}": wrist}
    found = measured_arm(StaticPosture("made up", {}, landmarks, {}), side, Frame(body, np.zeros(3)), shoulder, height)
    np.testing.assert_allclose(found.elbow, elbow, atol=SAME)
    np.testing.assert_allclose(found.axis, lift[:, 2], atol=SAME)
    np.testing.assert_allclose(found.upper.rotation, lift, atol=SAME)
    assert found.turn == pytest.approx(0.0, abs=SAME)
