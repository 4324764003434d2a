"""`gaitcal compare A B` on result folders: read whole, written whole, hostile names, damaged and
foreign folders.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.result import Calibration
from gaitcal.cli.console import Console
from gaitcal.cli.view_command import compare_sessions_or_models as run
from gaitcal.cli.view_command import print_report
from gaitcal.errors import Code, InputError, UsageError
from gaitcal.io.result_folder import MANIFEST, ResultKind, write_result_folder
from gaitcal.model.linkage import NEEDED_JOINTS
from gaitcal.model.model_file import save_model
from gaitcal.model.parameters import JP_NAMES
from gaitcal.pipeline.write_results import write_results
from gaitcal.report.figures.document import write_pdf
from gaitcal.report.session_report import (
    CURVES,
    DIFFERENCES,
    PAGE,
    PRINTED,
    WORDS,
    build_comparison_content,
    compare_results,
    write_comparison,
)
from gaitcal.results.saved_result import MODEL, UNCERTAINTY, save_uncertainty
from gaitcal.results.stride_files import write_stride_files
from gaitcal.results.stride_sets import Common
from gaitcal.results.stride_tables import build_stride_tables
from gaitcal.results.summary import SUMMARY, summarise_calibration
from gaitcal.results.table_files import format_json, read_csv
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from tests.fake_result import HOSTILE, Names, fake_calibration
from tests.messages import refuses


def write_result(calibration: Calibration, folder: Path) -> None:
    """What a comparison reads of a result folder, signed as one."""
    with write_result_folder(folder, ResultKind.CALIBRATION) as out:
        settings = json.loads(CalibrationSettings().model_dump_json())
        content = {"gaitcal": "0", "settings": settings, "trials": {}, "inputs_sha256": {}}
        (out / MANIFEST).write_text(json.dumps(content), encoding="utf-8")
        (out / SUMMARY).write_text(
            format_json(summarise_calibration(calibration)), encoding="utf-8"
        )
        save_model(calibration.model, out / MODEL)
        save_uncertainty(calibration.uncertainty, out / UNCERTAINTY)
        write_stride_files(out, build_stride_tables(calibration.model, calibration.trials))


@pytest.fixture
def results(tmp_path: Path) -> tuple[Path, Path]:
    """Before and after, of a person and a trial with hostile names; the second has another knee."""
    names = Names(subject=HOSTILE, trial=HOSTILE)
    before = fake_calibration(names)
    joint = before.model.parameters.joint.copy()
    joint[:3] += 1e-4
    model = replace(before.model, parameters=replace(before.model.parameters, joint=joint))
    folders = tmp_path / "before #1 [bold]x", tmp_path / "after"
    for calibration, folder in zip((before, replace(before, model=model)), folders, strict=True):
        write_result(calibration, folder)
    return folders


def test_a_result_against_itself_and_against_another(
    results: tuple[Path, Path], tmp_path: Path
) -> None:
    before, after = results
    same = compare_results(before, before)
    assert same.common is Common.MODEL and not same.differences["exceeds"].any()
    assert (same.differences["difference"].abs() == 0.0).all()
    found = compare_results(before, after)
    assert found.common is not Common.MODEL
    assert len(found.curves) and set(found.curves["side"]) == {"r", "l"}
    out = write_comparison(found, tmp_path / "comparison", results)
    for name, table in ((DIFFERENCES, found.differences), (CURVES, found.curves)):
        read, comments = read_csv(out / name)
        assert len(read) == len(table) and list(read.columns) == list(table.columns) and comments
        assert len(pd.read_csv(out / name, comment="#")) == len(table)
    lines = (out / WORDS).read_text(encoding="utf-8").splitlines()
    assert len(lines) == len(found.lines) and all(line.isprintable() for line in lines)
    write_comparison(same, out, results)  # an earlier one is replaced


def test_scores_against_other_norms_have_no_difference(
    results: tuple[Path, Path], tmp_path: Path
) -> None:
    found = compare_results(*results)
    for of_both in (("free speed", "free speed"), ("free speed", "slow speed"), ("", "")):
        for folder, words, score in zip(results, of_both, (9.1, 6.2), strict=True):
            told = json.loads((folder / SUMMARY).read_text())
            told |= {
                "norm": {"words": words},
                "gait_profile": {"r": {"gps": {"score": score, "se": 0.4}}},
            }
            (folder / SUMMARY).write_text(json.dumps(told))
        out = write_comparison(found, tmp_path / "comparison", results)
        page = (out / PAGE).read_text(encoding="utf-8")
        assert page.count("6.2 ± 0.4") == 1 and ("-2.9 (missed below" in page) == (
            of_both == ("free speed",) * 2
        )
        assert f">after, against {of_both[1] or 'a norm not recorded'}</th>" in page


def test_the_report_of_two_sessions_holds_both_means(
    results: tuple[Path, Path], tmp_path: Path
) -> None:
    found = compare_results(*results)
    content = build_comparison_content(found, results, {"kinematics": "Softer knee."})
    told = [json.loads((folder / SUMMARY).read_text())["verdict"] for folder in results]
    assert content.people[-1] == ("Verdict", *told), "of both, not of doubtful ones only"
    panel = next(
        p for p in content.sheets[0].panels if not isinstance(p, str) and p.title == "Pelvic tilt"
    )
    rows = found.curves[(found.curves["variable"] == "pelvis_tilt") & (found.curves["side"] == "r")]
    for drawn, column, sign in (
        (panel.strides["r"][0], "a", -1),
        (panel.mean["r"], "b", -1),
        (panel.error["r"], "mdc95", 1),
    ):
        np.testing.assert_allclose(
            drawn, sign * rows[column].to_numpy(), err_msg="clinical: anterior tilt is positive"
        )
    assert len(content.others) <= PRINTED + 1 and content.people[0] == ("", *found.names)
    pages = write_pdf(content, tmp_path / "two.pdf")
    assert 3 <= pages <= 5 and 2_000 < (tmp_path / "two.pdf").stat().st_size < 1_000_000
    with refuses(UsageError, field="--pdf"):
        print_report(Console(quiet=True, verbose=False), *results)


def test_names_stay_as_they_are_on_the_screen(
    results: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    run(Console(quiet=False, verbose=False), *results)
    assert "after against before #1 [bold]x" in capsys.readouterr().out


def test_a_folder_that_is_taken_is_told_first(tmp_path: Path) -> None:
    out = tmp_path / "full"
    out.mkdir()
    (out / "thesis.txt").write_text("")
    with refuses(Code.FOLDER_TAKEN, "thesis.txt"):
        run(Console(quiet=True, verbose=False), tmp_path / "not", tmp_path / "read", out=out)


@pytest.mark.parametrize(
    "file", ["cycles.csv", "spatiotemporal.csv", "summary.json", "uncertainty.npz"]
)
def test_damaged_files_are_named(results: tuple[Path, Path], file: str) -> None:
    before, after = results
    content = (after / file).read_bytes()
    (after / file).write_bytes(content[: len(content) // 2])
    with refuses(Code.DAMAGED_RESULT, file):
        compare_results(before, after)
    (after / file).unlink()
    with refuses(InputError, file):
        compare_results(before, after)


def test_an_edited_model_is_said(results: tuple[Path, Path]) -> None:
    before, after = results
    with (after / "model.toml").open("a", encoding="utf-8") as stream:
        stream.write("\n# looked at\n")
    assert any(
        text.startswith("after: model.toml is not as")
        for text in compare_results(before, after).warnings
    )


def test_no_result_and_no_room_are_told(results: tuple[Path, Path], tmp_path: Path) -> None:
    before, after = results
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "nowhere"):
        with refuses(Code.NO_RESULT, folder.name):
            compare_results(before, folder)
    with refuses(InputError, after.name):
        write_comparison(compare_results(before, after), after, results)
    assert json.loads((after / "manifest.json").read_text())["kind"] == "calibration"


def test_options_that_cannot_be(results: tuple[Path, Path], tmp_path: Path) -> None:
    before, after = results
    console = Console(quiet=True, verbose=False)
    for other, options in ((None, {}), (after, {"osim": tmp_path / "model.osim"})):
        with pytest.raises(UsageError):
            run(console, before, other, **options)


WALKS = ("walk03", "walk04")
EXPECTED = 0.95
"""Part of the differences of joint parameters inside bars of 95 %; measured over ten pairs of
walks: all of them.
"""


@pytest.mark.slow
def test_walk_against_walk(data_dir: Path, tmp_path: Path) -> None:
    studies, results = [], []
    for name in WALKS:
        trials = [
            f'[[trial]]\nname = "{trial}"\nrole = "{role}"\n'
            f'file = "{(data_dir / "labs_c3d/multi" / trial).as_posix()}.c3d"\n'
            for trial, role in (("static", "static"), (name, "gait"))
        ]
        person = '[subject]\nname = "S4"\nmass_kg = 53.5\nheight_m = 1.634\nsex = "female"\n'
        studies.append(tmp_path / f"{name}.toml")
        studies[-1].write_text(
            person + '[markers]\nset = "plug-in-gait"\n' + "".join(trials), encoding="utf-8"
        )
        results.append(write_results(calibrate(Study.load(studies[-1])), tmp_path / name))
    found = compare_results(*results)
    assert found.common is Common.STATIC and found.names == WALKS
    joints = [d for d in found.found if d.kind.startswith("joint") and not d.beyond_legs]
    assert len(joints) == sum(name.startswith(NEEDED_JOINTS) for name in JP_NAMES)
    assert np.mean([not d.exceeds for d in joints]) >= EXPECTED
    assert any(d.difference != 0.0 for d in joints)
