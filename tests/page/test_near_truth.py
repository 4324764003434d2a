"""How near the truth, in blocks: numbers of each row, what led away, and nothing where no truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.page.page_data import result_sections
from gaitcal.page.plain_data import Block, number
from gaitcal.session.result import Calibration
from gaitcal.session.truth_errors import CurveTruth, CurveTruths, FeatureTruth, ParameterTruth, TruthErrors
from tests.fake_result import FRAMES, fake_calibration
from tests.page.walked_blocks import headings, rows_of, tables, walked, words

TRUE, FITTED, NOMINAL = 60.0, 58.0, 59.0
"""mm, of the right hip's place forward."""


def with_truth(calibration: Calibration) -> Calibration:
    wave = np.sin(np.linspace(0.0, 6.0, FRAMES))
    curve = CurveTruth(
        name="hip_flexion_r",
        truth=wave,
        fitted=wave + 2.0,
        nominal=wave - 1.0,
        error_bar=np.full(FRAMES, 2.0),
        counts=np.ones(FRAMES, dtype=bool),
    )
    return replace(
        calibration,
        truth=TruthErrors(
            parameters=(
                ParameterTruth(
                    name="hip_r.pelvis.ant",
                    kind="joint position",
                    unit="mm",
                    truth=TRUE,
                    nominal=NOMINAL,
                    fitted=FITTED,
                    error_bar=2.0,
                    status="fitted",
                ),
            ),
            features=(
                FeatureTruth(
                    joint="hip_r",
                    part="centre",
                    words="Hip centre in the pelvis",
                    unit="mm",
                    nominal=5.0,
                    fitted=2.0,
                    within=(True, True, False),
                ),
            ),
            trials={"walk": CurveTruths(np.arange(FRAMES) / 100.0, {curve.name: curve}, {curve.name: curve})},
        ),
    )


@pytest.fixture(scope="module")
def blocks() -> list[Block]:
    return result_sections(with_truth(fake_calibration()))["joints"]


def test_sums_joints_angles_and_moments_are_told(blocks: list[Block]) -> None:
    assert "How near the truth" in headings(blocks)
    sums = rows_of(tables(blocks, "RMS error")[0])
    assert sums["joint positions, legs mm"] == ["1", "1.00", "farther: 2.00", "100 %"]
    assert sums["walk: leg angles deg"] == ["1", "1.00", "farther: 2.00", "100 %"]
    joints = rows_of(tables(blocks, "Centre or axis")[0])
    assert joints["Hip centre in the pelvis, mm"] == ["5.0", "2.0", "2 of 3", "–", "–", "–"]
    for head in ("Angle, deg", "Moment, N·m"):
        assert rows_of(tables(blocks, head)[0])["Hip flexion"][:3] == ["1.0", "farther: 2.0", "100 %"]
    assert f"RMS error over all {FRAMES} frames" in words(blocks)


def test_the_truth_stands_beside_each_parameter(blocks: list[Block]) -> None:
    known = [row for b in walked(blocks) if b["kind"] == "intervals" for row in b["rows"] if row["truth"] is not None]
    assert [(row["label"], row["side"], row["truth"]) for row in known] == [("hip centre, pelvis, forward", "r", TRUE)]
    (table,) = (b for b in tables(blocks, "Right") if "Truth" in b["head"])
    assert rows_of(table)["hip centre in the pelvis, forward mm"][-1] == number(TRUE)


def test_without_truth_nothing_of_it_is_there() -> None:
    assert "truth" not in words([b for s in result_sections(fake_calibration()).values() for b in s]).lower()
