"""Strides out of a result: `export --format cycles` in other conventions, and `report` on paper."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.errors import Code
from gaitcal.gait.cycles import EventSource, GaitCycle, GaitEvent, normalise
from gaitcal.gait.ensemble import ensemble
from gaitcal.gait.events import GaitEvents
from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.gait.peaks import PHASE_PEAKS, PeakMean, make_peak_columns
from gaitcal.gait.profile_score import ANGLES
from gaitcal.io.labels import FootMoment
from gaitcal.report.figures.curve_panel import CurvePanel
from gaitcal.report.figures.document import LEAST_SHEET, ReportContent, _build_report, write_pdf
from gaitcal.report.figures.report_sheets import Picture
from gaitcal.report.gait_report import (
    KINEMATICS,
    KINETICS,
    _build_joint_rows,
    _explain_missing_curves,
    read_comments,
    read_report_content,
)
from gaitcal.results.cycle_tables import read_cycles
from gaitcal.results.result_tables import read_result_tables
from gaitcal.results.saved_result import load_result_model
from gaitcal.results.stride_uses import STRIDES
from gaitcal.results.table_files import read_csv, write_csv
from tests.commands import edited
from tests.commands import tried as run
from tests.fake_result import HOSTILE
from tests.kept import kept_folder
from tests.messages import check_text, refuses
from tests.synthetic_studies import write_synthetic_study

ROUNDED = 2e-6
TIMES = 2e-5
"""Relative: times of `strides.csv` are rounded to a microsecond."""
MASS = 69.4


def strides(*_: object) -> GaitEvents:
    """One stride of either foot, wherever its feet may be: what counts here is that they are cut
    out alike.
    """
    times = [(0.21234, "r"), (0.4, "l"), (0.95, "r"), (1.1, "l")]
    return GaitEvents(
        tuple(GaitEvent(FootMoment.STRIKE, side, t, EventSource.MOTION) for t, side in times)
    )


def kept_strides(kept: Path) -> Path:
    """A result with one stride of either foot."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("gaitcal.analysis.trial_result.find_trial_events", strides)
            done = run(
                "calibrate",
                write_synthetic_study(folder / "study"),
                "--out",
                folder / "result",
                "-q",
            )
        assert done.exit_code == 0, done.output

    return kept_folder(kept / "strides", make) / "result"


@pytest.fixture(scope="module")
def made(kept: Path) -> Path:
    return kept_strides(kept)


@pytest.fixture
def result(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made.parent / "study", tmp_path / "study")
    return Path(shutil.copytree(made, tmp_path / "result"))


def table(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, comment="#")


def exported(result: Path, *options: str) -> pd.DataFrame:
    done = run("export", result, "--format", "cycles", *options)
    assert done.exit_code == 0, done.output
    return table(result / "export" / "cycles.csv")


def test_strides_as_they_are_say_their_units_and_signs(result: Path) -> None:
    before, after = table(result / "cycles.csv"), exported(result)
    pd.testing.assert_frame_equal(after[list(before.columns)], before)
    assert set(after["unit"]) >= {"deg", "N m", "W"} and after["positive"].notna().all()
    said = after.groupby("variable")["positive"].first()
    assert said["hip_power"] == "generated"
    check_text(said["ankle_angle_moment"])


def test_a_clinical_convention_changes_signs_and_units_alone(result: Path) -> None:
    before = table(result / "cycles.csv")
    after = exported(result, "--convention", "clinical", "--units", "Nm/kg", "--external")
    of_leg = before["variable"].str.endswith("_moment") & ~before["variable"].str.startswith(
        "lumbar"
    )
    trunk = before["variable"].str.endswith("_moment") & ~of_leg
    powers = before["variable"].str.endswith("_power")
    assert of_leg.any() and trunk.any() and powers.any()
    extension = before["variable"].eq("lumbar_extension_moment") | before["side"].eq("l")
    of_trunk = np.where(extension[trunk], 1.0, -1.0) / MASS
    for rows, factor in ((of_leg, -1.0 / MASS), (trunk, of_trunk), (powers, 1.0 / MASS)):
        np.testing.assert_allclose(
            after["value"][rows], factor * before["value"][rows], atol=ROUNDED
        )
        np.testing.assert_allclose(after["se"][rows], before["se"][rows] / MASS, atol=ROUNDED)
    assert (after["se"].dropna() >= 0).all()
    pelvis = before["variable"].eq("pelvis_list")
    sign = np.where(before["side"][pelvis] == "r", -1.0, 1.0)
    np.testing.assert_allclose(after["value"][pelvis], sign * before["value"][pelvis], atol=ROUNDED)
    pd.testing.assert_series_equal(after["valid"], before["valid"])
    text = (result / "export/cycles.csv").read_text(encoding="utf-8").splitlines()
    head = "\n".join(line for line in text if line.startswith("#"))
    assert "external" in head and "clinical" in head
    check_text(head)
    assert set(after["unit"][of_leg]) == {"N m/kg"} and set(after["positive"][of_leg]) >= {
        "external, flexion"
    }
    manifest = json.loads((result / "export/manifest.json").read_text(encoding="utf-8"))
    assert manifest["written"]["cycles.csv"]["convention"] == {
        "signs": "clinical",
        "moments": "external",
        "frame": "coordinates",
        "moment_unit": "Nm/kg",
        "power_unit": "W/kg",
    }


@pytest.mark.parametrize("frame", ["proximal", "distal", "jcs"])
def test_moments_in_other_frames_are_those_of_the_vectors_over_the_same_strides(
    result: Path, frame: str
) -> None:
    before, after = table(result / "cycles.csv"), exported(result, "--moments", frame)
    others = ~before["variable"].str.endswith("_moment")
    kept = after[~after["variable"].str.endswith("_moment")].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept[list(before.columns)], before[others].reset_index(drop=True))
    vectors = table(result / "moment_vectors/walk.csv")
    events = json.loads((result / "summary.json").read_text(encoding="utf-8"))["trials"]["walk"][
        "events"
    ]
    strikes = [
        e["time"] for e in events if e["side"] == "l" and e["event"] == FootMoment.STRIKE.value
    ]
    cycle = GaitCycle(strikes[0], strikes[1], None)
    found = after[(after["side"] == "l") & (after["stride"] == 1)]
    assert {"hip_rotation_moment", "knee_rotation_moment", "ankle_inversion_moment"} <= set(
        found["variable"]
    )
    for name in ("knee_rotation", "ankle_angle", "hip_adduction"):
        rows = found[found["variable"] == f"{name}_moment"]
        known = rows[rows["se"].notna()]
        assert len(known) and known["se_stride"].between(1e-9, known["se"] + ROUNDED).all()
        for column, suffix in (("value", ""), ("se", "_se"), ("se_stride", "_se_stride")):
            expected = normalise(
                vectors["time"].to_numpy(), vectors[f"{name}_l_{frame}{suffix}"].to_numpy(), cycle
            )
            np.testing.assert_allclose(rows[column], expected, atol=ROUNDED)
    own = before[(before["side"] == "l") & (before["stride"] == 1)]
    means = ensemble(read_cycles(result / "export"))
    of_knee = means[(means["variable"] == "knee_rotation_moment") & (means["n"] > 0)]
    assert (
        len(of_knee)
        and of_knee[["se", "sd_error"]].notna().all(axis=None)
        and set(of_knee["unit"]) == {"N m"}
    )
    hip = found[found["variable"] == "hip_flexion_moment"]
    as_it_was = own[own["variable"] == "hip_flexion_moment"]
    assert hip["valid"].tolist() == as_it_was["valid"].tolist()
    if frame != "distal":  # the hip's flexion axis is the pelvis' z
        size = as_it_was["value"].abs().max()
        np.testing.assert_allclose(
            hip["value"].to_numpy(), as_it_was["value"].to_numpy(), atol=TIMES * size
        )


def test_powers_of_a_result_are_torques_times_velocities(made: Path) -> None:
    """Of the files alone: moments/, motion/ and powers/."""
    motion, moments, powers = (
        table(made / folder / "walk.csv") for folder in ("motion", "moments", "powers")
    )
    names = ("hip_flexion_r", "hip_adduction_r", "hip_rotation_r")
    expected = sum(moments[name] * np.radians(motion[f"{name}_velocity"]) for name in names)
    np.testing.assert_allclose(powers["hip_power_r"], expected, atol=1e-5)
    np.testing.assert_allclose(powers["hip_power_r_per_kg"], expected / MASS, atol=1e-5)
    np.testing.assert_array_equal(powers["valid_l"], moments["valid_l"])
    assert (powers["hip_power_r_se"] > 0).all()


def test_further_trials_have_a_table_of_their_own(result: Path) -> None:
    """Told where the model has changed since."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gaitcal.analysis.trial_result.find_trial_events", strides)
        study = result.parent / "study"
        trial = (result, study / "walk.csv", "--forces", study / "walk_forces.csv", "-q")
        elsewhere = result.parent / "further" / "trials"
        for out in ((), ("--out", elsewhere)):
            done = run("dynamics", *trial, *out)
            assert done.exit_code == 0, done.output
    # Further trials find the model of their result wherever they are; they have no report.
    found = read_result_tables(elsewhere)
    assert found.model.subject.mass == load_result_model(result)[0].subject.mass
    with refuses(Code.NO_FILE, "model.toml"):
        read_report_content(result / "dynamics", None, {})
    done = run("export", result, "--format", "cycles", "--external", "--moments", "distal")
    assert done.exit_code == 0 and "another model" not in done.output, done.output
    found = table(result / "export/dynamics_cycles.csv")
    vectors = table(result / "dynamics/moment_vectors/walk.csv")
    of_knee = found[(found["variable"] == "knee_angle_moment") & (found["side"] == "r")]
    assert (
        len(of_knee) == 101
        and -of_knee["value"].max() >= vectors["knee_angle_r_distal"].min() - ROUNDED
    )
    with (result / "model.toml").open("a", encoding="utf-8") as model:
        model.write("# edited\n")
    done = run("export", result, "--format", "cycles")
    assert "another model" in done.output.replace("\n", " ")


def test_wrong_words_are_told(result: Path) -> None:
    for options, said in (
        (("--convention", "clinicl"), "found 'clinicl'; allowed: opensim, clinical"),
        (("--moments", "tibia"), "allowed: coordinates, proximal, distal, jcs"),
        (("--units", "Nmm"), "allowed: Nm, Nm/kg, %BW*H"),
    ):
        done = run("export", result, "--format", "cycles", *options)
        assert done.exit_code and said in str(done.exception)
    done = run("export", result, "--format", "osim", "--external")
    assert done.exit_code and "--format cycles" in str(done.exception)


def test_a_result_without_vectors_gives_no_moments_in_their_frames(result: Path) -> None:
    shutil.rmtree(result / "moment_vectors")
    done = run("export", result, "--format", "cycles", "--moments", "distal")
    assert done.exit_code and not (result / "export").exists()


NORMS = "schwartz2008"


@pytest.fixture(scope="module")
def content(made: Path) -> ReportContent:
    return read_report_content(made, (read_normal_bands(NORMS), NORMS), {"kinematics": HOSTILE})


@pytest.fixture
def changed(made: Path, tmp_path: Path) -> Path:
    """A copy of the result, for changes of what a report reads."""
    return Path(shutil.copytree(made, tmp_path / "changed"))


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
    table, size = read_cycles(made), 1.0 if variable in KINEMATICS else MASS
    for side in "rl":
        rows = table[(table["variable"] == variable) & (table["side"] == side)]
        expected = np.where(rows["valid"] == 1, clinical * rows["value"] / size, np.nan).reshape(
            -1, 101
        )
        shown = panel(content, variable)
        np.testing.assert_allclose(np.array(shown.strides[side]), expected, atol=ROUNDED)
        if len(expected) == 1:
            np.testing.assert_allclose(shown.mean[side], expected[0], atol=ROUNDED)


def test_a_norm_stands_beside_what_it_is_of(content: ReportContent) -> None:
    """The peak plantarflexor moment of healthy people is positive, 1.2 N·m/kg, and the panel says
    so.
    """
    shown = panel(content, "ankle_angle_moment")
    ((mean, sd),) = shown.norms.values()
    assert 1.0 < np.nanmax(mean) < 1.5 and (sd[1:-1] > 0).all()
    assert shown.senses == ("plantarflexion", "dorsiflexion") and shown.unit == "N·m/kg"
    check_text(content.norm, 4, 17, 83, 2008)
    check_text(content.norm_remark, 4, 17)


def test_scores_stand_on_paper_as_in_a_second_computation(
    made: Path, content: ReportContent
) -> None:
    """GPS of the right side: nine root mean squares over 0, 2, ... 100 % of its strides, away from
    the norm.
    """
    table, bands = read_cycles(made), read_normal_bands(NORMS)
    model = load_result_model(made)[0]
    squares = []
    for name in ANGLES:
        rows = table[
            (table["variable"] == name) & (table["side"] == "r") & (table["turn"].abs() < 15)
        ]
        away = (
            rows["value"].to_numpy().reshape(-1, 101)[:, ::2]
            - bands[name].scale_to_person(model.subject)[0][::2]
        )
        squares.append(np.mean(np.sqrt(np.mean(away**2, axis=1))) ** 2)
    shown = {(s.side, s.variable): s for s in content.profile}
    assert shown["r", "gps"].score == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-6)
    assert np.isfinite(shown["r", "gps"].error)


def test_no_adult_is_held_against_children_unasked(made: Path) -> None:
    content = read_report_content(made, None, {})
    assert content.norm == "" and not content.profile
    check_text(content.norm_remark)


def test_axes_hold_strides_and_norm_and_stay_wide_where_little_happens(
    content: ReportContent,
) -> None:
    shown = panel(content, "ankle_angle_moment")
    mean, sd = shown.norms["r"]
    low, high = shown.limits
    assert low < np.nanmin(mean - sd) and np.nanmax(mean + sd) < high
    still = replace(shown, norms={}, mean={}, strides={"r": (np.full(101, 0.1),)})
    assert still.limits == pytest.approx((0.1 - still.least / 2, 0.1 + still.least / 2))


def test_the_same_content_gives_the_same_pages(content: ReportContent, tmp_path: Path) -> None:
    hostile = replace(
        content,
        person=(("Name or code", HOSTILE), *content.person[1:]),
        reasons=((HOSTILE, HOSTILE),),
    )
    pages = [write_pdf(hostile, tmp_path / name) for name in ("one.pdf", "two.pdf")]
    one, two = ((tmp_path / name).read_bytes() for name in ("one.pdf", "two.pdf"))
    assert one == two and 2 <= pages[0] == pages[1] <= 4 and len(one) < 1_000_000
    assert len(re.findall(rb"/Type /Page\b", one)) == pages[0]


def test_command_takes_the_comments_beside_the_result(made: Path, tmp_path: Path) -> None:
    comments = tmp_path / "comments.toml"
    comments.write_text('summary = "walks without aids"\n')
    done = run("report", made, "--pdf", tmp_path / "report.pdf", "--comments", comments)
    assert done.exit_code == 0 and f"4 pages, comments of {comments}" in done.output.replace(
        "\n", " "
    )
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("text", "told"), [('kinematic = "x"\n', "kinematic"), ("joints = 3\n", "joints")]
)
def test_other_comments_are_refused(text: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "comments.toml").write_text(text)
    with refuses(Code.COMMENTS, source="comments.toml", field=told):
        read_comments(tmp_path / "comments.toml")


def test_strides_count_on_paper_as_on_the_page(changed: Path) -> None:
    rows, comments = read_csv(changed / STRIDES)
    rows = rows.assign(side=["r", "l"], plate=["7", ""], turns=["0", "1"])
    rows["reason"] = ["", "foot beside the plate"]
    write_csv(rows, changed / STRIDES, comments)
    rows = read_report_content(changed, None, {}).walks[1:]
    assert [row[1] for row in rows] == ["right", "left"]
    assert [row[3:] for row in rows] == [
        ("7", "1 of 1", ""),
        ("", "0 of 1", "foot beside the plate; 1 stride turning: not in means"),
    ]


@pytest.mark.parametrize("beyond", ["", "force_N", "torque_Nm"])
def test_unexplained_force_and_moment_are_both_judged(beyond: str, changed: Path) -> None:
    with edited(changed, "summary.json") as summary:
        trial = next(trial for trial in summary["trials"].values() if trial["role"] == "gait")
        trial["pelvis_residual"] = {"jp": {"force_N": 20.0, "torque_Nm": 5.0}}
        trial["pelvis_residual_limit"] = {"force_N": 30.0, "torque_Nm": 9.0} | (
            {beyond: 2.0} if beyond else {}
        )
        trial |= {} if beyond else {"trunk_measured": False}
    (told,) = read_report_content(changed, None, {}).fit
    assert ("too high" in told) == bool(beyond)
    check_text(told, 20, 5.0)
    assert ("limits are wide, as trunk and arms have no markers" in told) == (not beyond)


def test_relative_angles_have_no_profile(changed: Path) -> None:
    with edited(changed, "manifest.json") as manifest:
        manifest["settings"]["angles"] = "relative"
    content = read_report_content(changed, (read_normal_bands(NORMS), NORMS), {})
    assert not content.profile
    check_text(content.norm_remark)


def test_an_activity_has_sheets_and_peaks_of_its_own(changed: Path) -> None:
    cycles = changed / "cycles.csv"
    cycles.write_text(
        re.sub(",gait,(stance|swing|)$", ",squat,rising", cycles.read_text(), flags=re.MULTILINE)
    )
    strides, comments = read_csv(changed / STRIDES)
    write_csv(strides.assign(activity="squat", repetition="1"), changed / STRIDES, comments)
    peak = PeakMean(
        activity="squat",
        peak=PHASE_PEAKS["in_rising_knee_extension_moment"],
        side="r",
        n=1,
        strides=1,
        mean=-40.0,
        sd=np.nan,
        se=2.0,
        percent=70.0,
    )
    write_csv(make_peak_columns([peak, replace(peak, side="l")]), changed / "peaks.csv")
    with edited(changed, "summary.json") as summary:
        for trial in summary["trials"].values():
            trial |= {"role": "motion", "activity": "squat", "repetitions": [{}]}
        summary["trials"]["hop"] = {**trial, "activity": "hop"}
    content = read_report_content(changed, None, {})
    assert not content.walked
    check_text(content.title)
    assert [sheet.title for sheet in content.sheets] == [
        "Kinematics, squat",
        "Kinetics, squat",
        "Legs, hop",
    ]
    assert all(sheet.has_curves and "repetitions" in sheet.thin for sheet in content.sheets[:2])
    (title, (head, *rows)) = content.peaks[0]
    moment = 40.0 / MASS
    assert "repetitions" in title and head[3:] == ("rising",)
    assert [row[:3] for row in rows] == [
        ("Knee extension moment", "N·m/kg", side) for side in ("right", "left")
    ]
    assert all(row[3].startswith(f"{moment:.2f} ± ") for row in rows)


def test_without_a_stride_a_sentence_stands_in_place_of_sheets(
    changed: Path, tmp_path: Path
) -> None:
    lines = (changed / "cycles.csv").read_text().splitlines(keepends=True)
    head = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    (changed / "cycles.csv").write_text("".join(lines[: head + 1]))
    strides, comments = read_csv(changed / STRIDES)
    write_csv(strides.iloc[:0], changed / STRIDES, comments)
    content = read_report_content(changed, None, {"kinetics": "kept"})
    assert {sheet.without for sheet in content.sheets} == {
        "No curves: there is no complete stride or repetition."
    }
    assert "result.html" in _explain_missing_curves((), ())  # isolated trials alone
    printed = [part.text for part in _build_report(content, 500.0, 700.0) if hasattr(part, "text")]
    assert printed.count(content.sheets[0].without) == 2 and "kept" in printed
    assert write_pdf(content, tmp_path / "two.pdf") == 2


def test_a_long_comment_leaves_the_curves_their_height(
    content: ReportContent, tmp_path: Path
) -> None:
    long = replace(
        content, comments={"kinematics": "Knees stay bent in stance. " * 200, "kinetics": "short"}
    )
    sheets = [
        part
        for part in _build_report(long, 500.0, 700.0)
        if isinstance(part, Picture) and part.height > 300
    ]
    assert len(sheets) == 2 and min(part.height for part in sheets) >= LEAST_SHEET
    assert write_pdf(long, tmp_path / "long.pdf") == write_pdf(content, tmp_path / "short.pdf") + 1


def test_a_report_is_no_folder(content: ReportContent, tmp_path: Path) -> None:
    with refuses(Code.FOLDER_TAKEN):
        write_pdf(content, tmp_path)


def test_a_joint_moves_as_far_as_in_the_segment_where_it_moves_most() -> None:
    """3 and 4 mm in the pelvis, 4 mm in the thigh: 5 mm, not the 6.4 of both together."""
    rows = pd.DataFrame(
        {
            "kind": "joint position",
            "status": "fitted",
            "joint": "hip_r",
            "segment": ["pelvis", "pelvis", "thigh_r"],
            "nominal": 0.0,
            "fitted": [3.0, 4.0, 4.0],
            "standard_error": [1.0, 2.0, 3.0],
        }
    )
    _, row = _build_joint_rows(rows)
    assert row[1:3] == ("5.0", "3.0")
