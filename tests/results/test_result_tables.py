"""What a writer computes is what a reader of the folder gets: page, PDF and figures show
one set.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.analysis.result import Calibration
from gaitcal.errors import Code
from gaitcal.gait.normal_bands import Norm, read_normal_bands
from gaitcal.gait.peaks import PEAKS
from gaitcal.io.result_folder import compute_sha256
from gaitcal.model.model_file import save_model
from gaitcal.quality.verdict import Judgement
from gaitcal.report.gait_report import build_report_content, read_report_content
from gaitcal.results.result_tables import (
    ResultTables,
    build_result_tables,
    read_result_tables,
    write_result_tables,
)
from gaitcal.results.saved_result import MODEL
from gaitcal.results.stride_files import STRIDE_FILES, read_earlier_strides, write_stride_files
from gaitcal.results.stride_tables import build_stride_tables
from gaitcal.results.stride_uses import STRIDES, StrideUse, average_toe_offs, read_uses
from gaitcal.results.summary import parse_verdict
from tests.messages import refuses

TIME = 1e-6
"""s: digits of `strides.csv`."""


@pytest.fixture(scope="module")
def tables(whole: Calibration) -> ResultTables:
    bands = read_normal_bands("schwartz2008")
    norm = Norm(bands=bands, steps={"speed": (1.1, 0.2)}, label="children", remark="as asked for")
    return build_result_tables(whole, norm, {"gaitcal": "0", "settings": {"normal": "own.csv"}})


@pytest.fixture(scope="module")
def folder(tables: ResultTables, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("result")
    write_result_tables(tables, out)
    save_model(tables.model, out / MODEL)
    return out


def without_cycle(use: StrideUse) -> StrideUse:
    return replace(use, cycle=None)


def test_tables_are_read_as_they_were_built(tables: ResultTables, folder: Path) -> None:
    found = read_result_tables(folder)
    assert len(found.strides.uses) == len(tables.strides.uses) > 2
    for read, built in zip(found.strides.uses, tables.strides.uses, strict=True):
        assert without_cycle(read) == without_cycle(built)
        for name in ("start", "stop", "toe_off"):
            times = getattr(read.cycle, name), getattr(built.cycle, name)
            assert times == (None, None) or times[0] == pytest.approx(times[1], abs=TIME)
    assert average_toe_offs(found.strides.uses) == pytest.approx(
        average_toe_offs(tables.strides.uses), abs=1e-3
    )
    for peak, expected in zip(found.strides.peaks, tables.strides.peaks, strict=True):
        assert (peak.peak, peak.side, peak.n) == (expected.peak, expected.side, expected.n)
        np.testing.assert_allclose(
            (peak.mean, peak.sd, peak.se), (expected.mean, expected.sd, expected.se), atol=1e-6
        )
    for name, column in tables.strides.cycles.items():
        np.testing.assert_array_equal(found.strides.cycles[name], column, err_msg=name)
    assert found.summary == tables.summary
    assert found.norm.steps == tables.norm.steps
    assert list(found.norm.curves) == list(tables.norm.curves)
    for name, curve in tables.norm.curves.items():
        assert found.norm.curves[name].source == curve.source
        for side in "rl":
            np.testing.assert_array_equal(found.norm.curves[name].sides[side], curve.sides[side])
    assert len(found.scores) == len(tables.scores)
    for score, computed in zip(found.scores, tables.scores, strict=True):
        assert (score.side, score.variable) == (computed.side, computed.variable)
        assert (score.score, score.norm) == pytest.approx((computed.score, computed.norm), abs=1e-4)


def test_the_report_of_a_folder_is_that_of_its_calibration(
    tables: ResultTables, folder: Path
) -> None:
    read = read_report_content(folder, None, {})
    built = build_report_content(tables, None, {}, folder.name)
    for name in ("person", "verdict", "reasons", "fit", "walks", "steps", "joints", "footer"):
        assert getattr(read, name) == getattr(built, name), name
    for one, other in zip(read.sheets, built.sheets, strict=True):
        assert (one.title, one.note, one.without) == (other.title, other.note, other.without)
        for panel, expected in zip(one.panels, other.panels, strict=True):
            if isinstance(expected, str):
                assert panel == expected
                continue
            assert not isinstance(panel, str) and panel.unit == expected.unit
            assert panel.toe_off == pytest.approx(expected.toe_off, abs=1e-3)
            for side in "rl":
                np.testing.assert_array_equal(panel.strides[side], expected.strides[side])
                np.testing.assert_array_equal(panel.mean[side], expected.mean[side])


def test_further_trials_join_the_strides_and_peaks_of_earlier_ones(
    whole: Calibration, tmp_path: Path
) -> None:
    walk = whole.trial("walk")
    folders = [tmp_path / name for name in ("first", "joined", "together")]
    for place in folders:
        place.mkdir()
    first, joined, together = folders
    later = replace(walk, name="later")
    write_stride_files(first, build_stride_tables(whole.model, [walk]))
    hashes = {name: str(compute_sha256(first / name)) for name in STRIDE_FILES}
    write_stride_files(
        joined,
        build_stride_tables(whole.model, [later]),
        read_earlier_strides(first, hashes, ["walk"]),
    )
    write_stride_files(together, build_stride_tables(whole.model, [walk, later]))
    for file in ("cycles.csv", "ensemble.csv", "peaks.csv", STRIDES):
        assert (joined / file).read_text() == (together / file).read_text(), file
    assert {use.trial for use in read_uses(joined)} == {"walk", "later"}


def test_a_stride_that_turns_is_in_no_mean_peak_but_has_its_own(whole: Calibration) -> None:
    walk = whole.trial("walk")
    strides = tuple(replace(s, turn=70.0 if s.number == 1 else 0.0) for s in walk.strides)
    tables = build_stride_tables(whole.model, [replace(walk, strides=strides)])
    counts = dict.fromkeys("rl", 0)
    for use in tables.uses:
        counts[use.side] += not use.turns
        assert PEAKS.keys() & tables.peaks_of_strides[use.trial, use.side, use.number].keys()
    assert {mean.strides for mean in tables.peaks if mean.side == "r"} == {counts["r"]}


def test_a_damaged_table_is_refused(folder: Path, tmp_path: Path) -> None:
    for name in (STRIDES, "peaks.csv", "normal_curves.csv"):
        for file in folder.iterdir():
            (tmp_path / file.name).write_bytes(file.read_bytes())
        (tmp_path / name).write_text("trial,side\nwalk,r\n")
        with refuses(Code.DAMAGED_RESULT, source=name):
            read_result_tables(tmp_path)


@pytest.mark.parametrize(
    ("walks", "expected"),
    [
        (("refused", "refused"), Judgement.REFUSED),
        (("refused", "trustworthy"), Judgement.DOUBTFUL),
        ((), Judgement.TRUSTWORTHY),
    ],
)
def test_further_trials_are_judged_together(walks: tuple[str, ...], expected: Judgement) -> None:
    trials = {str(k): {"verdict": word, "verdict_r": word} for k, word in enumerate(walks)}
    assert parse_verdict({"trials": trials}).judgement is expected
    assert parse_verdict({"trials": trials, "verdict": "doubtful"}).judgement is Judgement.DOUBTFUL
