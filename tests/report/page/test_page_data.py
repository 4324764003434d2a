"""The sections of a sheet: numbers are those of the files, what is missing is left out or said,
names are data.
"""

import base64
import itertools
import json
from dataclasses import replace
from typing import Any

import pytest

from gaitcal import cycles
from gaitcal.analysis.parameter_table import parameter_table
from gaitcal.analysis.result import Calibration
from gaitcal.gait.moments import describe_parameter
from gaitcal.quality.verdict import judge
from gaitcal.report.page.key_figures import compute_gait_numbers
from gaitcal.report.page.page_data import (
    build_calibration_page_data,
    build_peak_rows,
    build_result_sections,
)
from gaitcal.report.page.plain_data import LONGEST_NAME, format_number
from gaitcal.report.page.trial_data import build_trial_sections
from gaitcal.report.page.trust_sections import find_peak_error
from gaitcal.results.parameter_labels import SHORTER_UNITS
from gaitcal.results.summary import summarise_calibration
from tests.fake_result import HOSTILE, Names, fake_calibration, with_phase
from tests.report.page.walked_blocks import (
    KINDS,
    every,
    headings,
    rows_of,
    shown,
    tables,
    walked,
    words,
)

PRESETS = {"clinician", "fit", "joints", "trust", "provenance"}


@pytest.fixture(scope="module")
def sheet(whole: Calibration) -> dict[str, Any]:
    return build_calibration_page_data(whole)


def test_every_block_is_of_a_known_kind_with_plain_data(sheet: dict[str, Any]) -> None:
    assert set(sheet["sections"]) == PRESETS
    assert set(sheet["trials"][0]["sections"]) == {"clinician", "fit", "trust"}
    for block in every(sheet):
        assert set(block) - {"kind"} <= KINDS[block["kind"]], block
        if block["kind"] == "table":
            assert {len(row) for row in block["rows"]} <= {len(block["head"])}, block["head"]
    json.dumps(sheet, allow_nan=False)


def test_marker_errors_are_those_of_the_summary(whole: Calibration, sheet: dict[str, Any]) -> None:
    told = summarise_calibration(whole)["trials"]
    (table,) = tables(sheet["sections"]["fit"], "Trial")
    keys = (
        "nominal",
        "calibrated",
        "rigid_floor",
        "calibrated_to_floor",
        "joint_floor",
        "calibrated_to_joint_floor",
    )
    for name, row in rows_of(table).items():
        rms = told[name.split()[0]]["rms_mm"]
        assert row[:6] == [format_number(rms.get(key), 2 if "to" in key else 1) for key in keys]
        assert row[6] == format_number(told[name.split()[0]]["max_mm"]["calibrated"])
    (segments,) = tables(sheet["trials"][0]["sections"]["fit"], "Segment, RMS in mm")
    legs = told["walk"]["pelvis_and_legs_mm"]
    assert rows_of(segments)["pelvis and legs"][1] == format_number(legs["calibrated"])


def test_parameters_are_those_of_the_table(whole: Calibration, sheet: dict[str, Any]) -> None:
    table = parameter_table(whole).set_index("name")
    drawn = {
        (row["label"].replace(", ", " in the ", 1), row["side"]): row
        for b in every(sheet)
        if b["kind"] == "intervals" and b["unit"] in ("mm", "deg")
        for row in b["rows"]
    }
    fitted = table[(table["status"] == "fitted") & table["kind"].str.startswith("joint")]
    assert len(fitted) == len(drawn) > 0
    for name, row in fitted.iterrows():
        interval = drawn[describe_parameter(name), name.split(".")[0][-1]]
        told = [interval[key] for key in ("fitted", "nominal", "se")]
        assert told == pytest.approx(
            row[["fitted", "nominal", "standard_error"]].tolist(), abs=1e-4
        )
        assert interval["bounds"][1] - interval["bounds"][0] in (100.0, 60.0)
    text = words(sheet["sections"]["joints"])
    assert "kept, not determined" in text and ", at its bound" in text
    row = table.loc["head_trunk.moi.ant"]
    before, after, change = (
        SHORTER_UNITS["kg*mm^2"][1] * row[k] for k in ("nominal", "fitted", "standard_error")
    )
    segments = [rows_of(b) for b in tables(sheet["sections"]["joints"], "Parameter")]
    told = [rows["moment of inertia about the forward axis kg·cm²"] for rows in segments]
    assert [
        format_number(before, 0),
        format_number(after, 0),
        f"{format_number(after - before, 0, True)} ± {format_number(change, 0)}",
    ] in told


def test_residuals_and_changes_are_those_of_the_summary(
    whole: Calibration, sheet: dict[str, Any]
) -> None:
    told, blocks = (
        summarise_calibration(whole)["trials"]["walk"],
        sheet["trials"][0]["sections"]["trust"],
    )
    (table,) = tables(blocks, "Model")
    rows = rows_of(table)
    *before, last = list(rows.values())[:-3]
    *earlier, final = told["pelvis_residual"].values()
    for row, residual in zip(before, earlier, strict=True):
        assert [row[0], row[2]] == [
            format_number(residual["force_N"]),
            format_number(residual["torque_Nm"]),
        ]
    judged = [
        f"within: {format_number(final['force_N'])}",
        f"within: {format_number(final['torque_Nm'])}",
    ]
    assert [last[0], last[2]] == judged, "the last model is held against its errors"
    limit = told["pelvis_residual_limit"]
    assert [rows["limit"][0], rows["limit"][2]] == [
        format_number(limit["force_N"]),
        format_number(limit["torque_Nm"]),
    ]
    (changes,) = tables(blocks, "RMS change")
    rows = rows_of(changes)
    assert rows["Right hip flexion"][0] == format_number(
        told["torque_change_bwh"]["hip_flexion_r"], 2
    )
    (curves,) = [b for b in walked(blocks) if b["kind"] == "curves"]
    assert compute_gait_numbers(whole.model, whole.trials[0]).limits is not None
    assert curves["kinds"] == ["residual_force", "residual_moment"], (
        "no limit is drawn by which nothing is judged"
    )


def test_the_error_of_a_peak_is_that_of_its_frame_and_its_sources_sum_to_it(
    whole: Calibration,
) -> None:
    walk, mass = compute_gait_numbers(whole.model, whole.trials[0]), whole.model.subject.mass
    loads = walk.trial.loads
    peak = find_peak_error(walk, "knee_adduction_l", mass)
    valid = loads.reactions.valid_legs[:, 1]
    moment = loads.final.knee_adduction[:, 1]
    assert peak.value * mass == pytest.approx(moment[valid].min()), (
        "the abductor's peak: external adduction"
    )
    frame = round(peak.time * 100.0)
    assert moment[frame] == pytest.approx(peak.value * mass)
    assert peak.error * mass == pytest.approx(loads.errors.knee_adduction[frame, 1])
    assert sum(peak.compute_part(share) ** 2 for share in peak.shares.values()) == pytest.approx(
        peak.error**2
    )
    shares = list(peak.shares.values())
    assert shares == sorted(shares, reverse=True)


@pytest.mark.parametrize(
    ("without", "there", "missing"),
    [
        ({"plates": False}, "No joint moments and powers", "error alone"),
        ({"valid": False}, "wholly on force plates", "error alone"),
        ({"errors": False}, "No standard errors of the moments", "error alone"),
        ({"gait": False}, "that needs a walking trial with force plates", "Of 241 frames"),
        ({"joint": False}, "Joint parameters were not calibrated", "kept, not determined"),
        ({"cycles": False}, "No complete stride of the", "Usable for moments"),
    ],
)
def test_what_is_not_there_is_said_or_left_out(
    without: dict[str, bool], there: str, missing: str
) -> None:
    made = build_calibration_page_data(fake_calibration(**without))
    text = words(every(made))
    assert there in text
    assert missing not in text
    json.dumps(made, allow_nan=False)


def test_a_further_trial_has_the_sections_of_its_kind(
    whole: Calibration, sheet: dict[str, Any]
) -> None:
    for trial, told in zip(whole.trials, sheet["trials"], strict=True):
        assert build_trial_sections(whole.model, trial) == told["sections"]
    refused = build_trial_sections(whole.model, whole.trials[0].exclude_legs(["l"]))
    assert "Refused: left" in words(refused["clinician"])
    none = build_calibration_page_data(fake_calibration(gait=False, isolated=False))["sections"]
    assert "nothing was fitted" in words(none["fit"]) and "clinician" not in none


def test_hostile_and_long_names_are_data_and_folders_stay_private() -> None:
    made = build_calibration_page_data(fake_calibration(Names(*[HOSTILE] * 6)))
    text = json.dumps(
        [made["sections"], made["lines"], [t["sections"] for t in made["trials"]]],
        ensure_ascii=False,
    )
    assert "\u202e" not in text, "nothing turns the writing direction"
    assert '<script>alert(\\"x\\")</script>' in text, "a name is shown as it is"
    assert "/home/somebody" not in text
    long = build_calibration_page_data(fake_calibration(Names("x" * 5000, "y" * 5000, "z" * 5000)))
    assert all(len(text) < 60 + 4 * LONGEST_NAME for text in headings(every(long)))
    (table,) = tables(long["sections"]["fit"], "Trial")
    assert all(len(shown(row[0])) <= LONGEST_NAME for row in table["rows"])


def test_what_was_recorded_assumed_and_computed(whole: Calibration) -> None:
    noted = replace(whole, notes=("short", "long " * 80, "walk: its own"))
    manifest = {
        "gaitcal": "9.9",
        "settings": {"a": {"b": None}, "c": [1, 2]},
        "inputs_sha256": {"walk.trc": "ab" * 32},
    }
    blocks = build_result_sections(noted, manifest=manifest)["provenance"]
    rows = rows_of(tables(blocks, "Name")[0])
    assert rows == {"gaitcal": ["9.9"], "settings.a.b": ["–"], "settings.c": ["1, 2"]}
    assert rows_of(tables(blocks, "File")[0]) == {"walk.trc": ["ab" * 32]}
    assert [b["items"] for b in blocks if b["kind"] == "list"] == [["short"]]
    long, walk = (b for b in blocks if b["kind"] == "fold")
    assert long["title"].endswith("…") and walk["title"] == "Trial walk: 1 note"
    assert walk["blocks"][0]["items"] == ["its own"]
    assert "long " * 79 in words(blocks)
    phases = rows_of(tables(blocks, "Phase")[0])
    assert phases["legs, from walking"] == ["walk", "34", "converged"]
    recorded = rows_of(tables(blocks, "Trial")[0])
    assert recorded["walk"][1:4] == ["walk.trc", "2.40 s", "241"]


def test_how_long_it_took_is_not_told_and_what_did_not_converge_is_told_first(
    whole: Calibration,
) -> None:
    slower = replace(whole, phases=tuple(replace(p, seconds=7.0) for p in whole.phases))
    assert build_result_sections(whole) == build_result_sections(slower)
    made = build_calibration_page_data(with_phase(whole, False))
    assert made["lines"][0]["tone"] == "poor" and made["lines"][0]["text"].startswith(
        "Not converged"
    )
    assert made["sections"]["trust"][0]["tone"] == "bad"


def test_three_lines(whole: Calibration, sheet: dict[str, Any]) -> None:
    believed, agrees, counts = sheet["lines"]
    assert believed["tone"] == "look" and believed["text"].startswith(
        "Doubtful: knee_r.thigh.front (right knee axis"
    )
    walk = summarise_calibration(whole)["trials"]["walk"]
    rms, limit = walk["pelvis_and_legs_mm"]["calibrated"], walk["pelvis_residual_limit"]
    assert agrees["text"].startswith(f"Marker fit {format_number(rms)} mm (best possible ")
    assert (
        f"N RMS (limit {format_number(limit['force_N'])}), moment " in agrees["text"]
        and "too high" not in agrees["text"]
    )
    assert "Usable for moments: 1 of 2 right, 0 of 1 left strides; others: " in counts["text"]
    sound = replace(whole, verdict=judge((), ["walk"]))
    assert [line["tone"] for line in build_calibration_page_data(sound)["lines"]] == [
        "good",
        "good",
        "plain",
    ]
    without = build_calibration_page_data(fake_calibration(plates=False))["lines"][2]
    assert without == {
        "tone": "plain",
        "text": "Angles only, no moments: there are no force plates.",
    }


def test_the_line_on_top_has_the_first_peak_of_the_adduction_moment(
    whole: Calibration, sheet: dict[str, Any]
) -> None:
    """The number of the table of peaks, external and by body mass."""
    mass, text = whole.model.subject.mass, sheet["lines"][2]["text"]
    told = next(
        row
        for row in build_peak_rows(sheet)
        if row["title"] == "Knee abduction moment, loading response"
    )
    legs = [leg for leg in "rl" if leg in told]
    assert legs and told["external"] == "Knee adduction moment, loading response"
    for leg in legs:
        word, of = {"r": "right", "l": "left"}[leg], told[leg]
        assert (
            f"{word} {-of['mean'] / mass:.2f} ± {of['se'] / mass:.2f} ({of['n']} of "
            f"{of['strides']} stride" in text
        )


def test_percents_of_strides_are_valid_as_in_the_table(
    whole: Calibration, sheet: dict[str, Any]
) -> None:
    """Whether a percent beside a gap counts is told to the page, not found by it again from rounded
    times.
    """
    table = cycles(whole)
    strides = table.groupby(["trial", "side", "stride", "variable"])
    checked, gaps = 0, 0
    for trial in sheet["trials"]:
        for stride, curve in itertools.product(trial["strides"], trial["curves"]):
            variable = f"{curve['base']}{'_moment' * (curve['kind'] == 'moment')}"
            key = (trial["name"], stride["side"], stride["number"], variable)
            if (
                key not in strides.groups
                or curve["side"] not in ("", stride["side"])
                or stride["turns"]
            ):
                continue
            valid = strides.get_group(key).sort_values("percent")["valid"].tolist()
            assert list(base64.b64decode(stride["valid"][curve["valid"]])) == valid, key
            checked, gaps = checked + 1, gaps + (0 in valid)
    assert checked and gaps
