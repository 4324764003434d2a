"""`gaitcal report`: numbers of the tables on paper, in the clinical convention; comments; the same bytes each time."""

import json
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from gaitcal.cli.application import app
from gaitcal.errors import InputError
from gaitcal.figures.document import LEAST_SHEET, ReportContent, _story, write_pdf
from gaitcal.figures.report_sheets import CurvePanel, SheetOfCurves, limits_of
from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.gait.profile_score import ANGLES
from gaitcal.io.result_folder import SELF, self_hash, sha256_of
from gaitcal.results.cycles import read_cycles
from gaitcal.results.gait_report import KINEMATICS, KINETICS, read_comments, report_content
from gaitcal.results.saved import load_result_model
from tests.fake_result import HOSTILE
from tests.results.test_cycles_export import kept_strides

ROUNDED = 2e-6
NORMS = "schwartz2008"


@pytest.fixture(scope="module")
def made(kept: Path) -> Path:
    return kept_strides(kept)


@pytest.fixture(scope="module")
def content(made: Path) -> ReportContent:
    return report_content(made, (read_normal_bands(NORMS), NORMS), {"kinematics": HOSTILE})


@contextmanager
def edited(made: Path, folder: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """A copy whose JSON files become what is left of them at the end; its manifest knows what was changed."""
    shutil.copytree(made, folder)
    names = ("summary.json", "page.json", "manifest.json")
    data = {name: json.loads((folder / name).read_text()) for name in names}
    yield folder, data
    for name in names[:2]:
        (folder / name).write_text(json.dumps(data[name]))
    manifest = data["manifest.json"]
    manifest["sha256"] |= {name: sha256_of(folder / name) for name in ("cycles.csv", *names[:2])}
    (folder / "manifest.json").write_text(json.dumps({**manifest, SELF: self_hash(manifest)}))


def panel(content: ReportContent, variable: str) -> CurvePanel:
    sheet, titles = (1, KINETICS) if variable in KINETICS else (0, KINEMATICS)
    found = content.sheets[sheet].panels[list(titles).index(variable)]
    assert isinstance(found, CurvePanel)
    return found


@pytest.mark.parametrize(
    ("variable", "clinical"),
    [("hip_flexion", 1.0), ("pelvis_tilt", -1.0), ("ankle_angle_moment", -1.0), ("hip_power", 1.0)],
)
def test_curves_are_those_of_the_table_with_clinical_signs(
    made: Path, content: ReportContent, variable: str, clinical: float
) -> None:
    table = read_cycles(made)
    mass = load_result_model(made)[0].subject.mass
    size = 1.0 if variable in KINEMATICS else mass
    for side in "rl":
        rows = table[(table["variable"] == variable) & (table["side"] == side)]
        expected = np.where(rows["valid"] == 1, clinical * rows["value"] / size, np.nan).reshape(-1, 101)
        shown = panel(content, variable)
        np.testing.assert_allclose(np.array(shown.strides[side]), expected, atol=ROUNDED)
        if len(expected) == 1:
            np.testing.assert_allclose(shown.mean[side], expected[0], atol=ROUNDED)


def test_a_norm_stands_beside_what_it_is_of(content: ReportContent) -> None:
    """The peak plantarflexor moment of healthy people is positive, 1.2 N·m/kg, and the panel says so."""
    shown = panel(content, "ankle_angle_moment")
    assert shown.norm is not None and 1.0 < np.nanmax(shown.norm[0]) < 1.5 and (shown.norm[1][1:-1] > 0).all()
    assert shown.senses == ("plantarflexion", "dorsiflexion") and shown.unit == "N·m/kg"
    assert content.norm == "children 4 to 17 years, free speed, n = 83 (Schwartz, Rozumalski, Trost 2008)"
    assert "Bands of children of 4 to 17 years, as asked for" in content.norm_remark


def test_scores_stand_on_paper_as_in_a_second_computation(made: Path, content: ReportContent) -> None:
    """GPS of the right side: nine root mean squares over 0, 2, ... 100 % of its strides, away from the norm."""
    table, bands = read_cycles(made), read_normal_bands(NORMS)
    model = load_result_model(made)[0]
    squares = []
    for name in ANGLES:
        rows = table[(table["variable"] == name) & (table["side"] == "r") & (table["turn"].abs() < 15)]
        away = rows["value"].to_numpy().reshape(-1, 101)[:, ::2] - bands[name].for_person(model.subject)[0][::2]
        squares.append(np.mean(np.sqrt(np.mean(away**2, axis=1))) ** 2)
    shown = {(s.side, s.variable): s for s in content.profile}
    assert shown["r", "gps"].score == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-6)
    assert np.isfinite(shown["r", "gps"].error)


def test_no_adult_is_held_against_children_unasked(made: Path) -> None:
    content = report_content(made, None, {})
    assert content.norm == "" and not content.profile and content.norm_remark.startswith("No norm")


def test_axes_hold_strides_and_norm_and_stay_wide_where_little_happens(content: ReportContent) -> None:
    shown = panel(content, "ankle_angle_moment")
    assert shown.norm is not None
    mean, sd = shown.norm
    low, high, step = limits_of(shown)
    assert low < np.nanmin(mean - sd) and np.nanmax(mean + sd) < high and 3 <= (high - low) / step <= 6
    still = replace(shown, norm=None, mean={}, strides={"r": (np.full(101, 0.1),)})
    assert limits_of(still)[:2] == pytest.approx((0.1 - still.least / 2, 0.1 + still.least / 2))


def test_the_same_content_gives_the_same_pages(content: ReportContent, tmp_path: Path) -> None:
    hostile = replace(content, person=(("Name or code", HOSTILE), *content.person[1:]), reasons=((HOSTILE, HOSTILE),))
    pages = [write_pdf(hostile, tmp_path / name) for name in ("one.pdf", "two.pdf")]
    one, two = ((tmp_path / name).read_bytes() for name in ("one.pdf", "two.pdf"))
    assert one == two and 2 <= pages[0] == pages[1] <= 4 and len(one) < 1_000_000
    assert len(re.findall(rb"/Type /Page\b", one)) == pages[0]


def test_command_takes_the_comments_beside_the_result(made: Path, tmp_path: Path) -> None:
    comments = tmp_path / "comments.toml"
    comments.write_text('summary = "walks without aids"\n')
    words = ["report", str(made), "--pdf", str(tmp_path / "report.pdf"), "--comments", str(comments)]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0 and f"4 pages, comments of {comments}" in done.output.replace("\n", " ")
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('kinematic = "x"\n', "kinematic: unknown section; allowed: summary, .*; did you mean 'kinematics'?"),
        ("joints = 3\n", "joints: found int; allowed: text in quotation marks"),
    ],
)
def test_other_comments_are_refused(text: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "comments.toml").write_text(text)
    with pytest.raises(InputError, match=told):
        read_comments(tmp_path / "comments.toml")


def test_a_result_of_before_foot_progression_and_errors_of_symmetry_is_printed(made: Path, tmp_path: Path) -> None:
    with edited(made, tmp_path / "old") as (old, data):
        kept = [line for line in (old / "cycles.csv").read_text().splitlines() if ",foot_progression," not in line]
        (old / "cycles.csv").write_text("\n".join(kept) + "\n")
        for measure in data["summary.json"]["spatiotemporal"].values():
            measure.pop("symmetry_se_percent", None)
        data["summary.json"].pop("norm", None)
    content = report_content(old, (read_normal_bands(NORMS), NORMS), {})
    told = [shown for shown in content.sheets[0].panels if isinstance(shown, str)]
    assert any("calibrate again" in words for words in told) and not content.profile


def test_strides_count_on_paper_as_on_the_page(made: Path, tmp_path: Path) -> None:
    with edited(made, tmp_path / "told") as (folder, data):
        strides = next(trial["strides"] for trial in data["page.json"]["trials"] if trial["strides"])
        right, left = strides
        right |= {"side": "r", "plate": "7", "reason": "", "turns": False}
        left |= {"side": "l", "plate": "", "reason": "foot beside the plate", "turns": True}
    rows = report_content(folder, None, {}).walks[1:]
    assert [row[1] for row in rows] == ["right", "left"]
    assert [row[3:] for row in rows] == [
        ("7", "1 of 1", ""),
        ("", "0 of 1", "foot beside the plate; 1 stride turning: not in means"),
    ]


@pytest.mark.parametrize("beyond", ["", "force_N", "torque_Nm"])
def test_unexplained_force_and_moment_are_both_judged(beyond: str, made: Path, tmp_path: Path) -> None:
    with edited(made, tmp_path / "judged") as (folder, data):
        trial = next(trial for trial in data["summary.json"]["trials"].values() if trial["role"] == "gait")
        trial["pelvis_residual"] = {"jp": {"force_N": 20.0, "torque_Nm": 5.0}}
        trial["pelvis_residual_limit"] = {"force_N": 30.0, "torque_Nm": 9.0} | ({beyond: 2.0} if beyond else {})
    (told,) = report_content(folder, None, {}).fit
    assert ("too high" in told) == bool(beyond) and "force at the pelvis 20 N" in told and "moment 5.0 N·m" in told


def test_relative_angles_have_no_profile(made: Path, tmp_path: Path) -> None:
    with edited(made, tmp_path / "relative") as (folder, data):
        data["manifest.json"]["settings"]["angles"] = "relative"
    content = report_content(folder, (read_normal_bands(NORMS), NORMS), {})
    assert not content.profile and "counted from the static posture" in content.norm_remark


def test_without_a_stride_a_sentence_stands_in_place_of_sheets(made: Path, tmp_path: Path) -> None:
    with edited(made, tmp_path / "none") as (folder, data):
        lines = (folder / "cycles.csv").read_text().splitlines(keepends=True)
        head = next(k for k, line in enumerate(lines) if not line.startswith("#"))
        (folder / "cycles.csv").write_text("".join(lines[: head + 1]))
        for trial in data["page.json"]["trials"]:
            trial["strides"] = []
    content = report_content(folder, None, {"kinetics": "kept"})
    assert {sheet.without for sheet in content.sheets} == {"No curves: no walk has a complete stride."}
    printed = [part.text for part in _story(content, 500.0, 700.0) if hasattr(part, "text")]
    assert printed.count(content.sheets[0].without) == 2 and "kept" in printed
    assert write_pdf(content, tmp_path / "two.pdf") == 2


def test_a_long_comment_leaves_the_curves_their_height(content: ReportContent, tmp_path: Path) -> None:
    long = replace(content, comments={"kinematics": "Knees stay bent in stance. " * 200, "kinetics": "short"})
    sheets = [part for part in _story(long, 500.0, 700.0) if isinstance(part, SheetOfCurves)]
    assert len(sheets) == 2 and min(part.height for part in sheets) >= LEAST_SHEET
    assert write_pdf(long, tmp_path / "long.pdf") == write_pdf(content, tmp_path / "short.pdf") + 1


def test_a_report_is_no_folder(content: ReportContent, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder; the name of a file is needed"):
        write_pdf(content, tmp_path)
