"""`cohort.html` as data, and the command `gaitcal cohort`: who stands in it, and that it is the
same every time.
"""

import base64
import csv
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gaitcal.cli.cohort_command import _make_progress_printer, format_duration
from gaitcal.cli.console import Console
from gaitcal.cohort.cohort_page import MEASURES, NO_STRIDE
from gaitcal.cohort.cohort_people import find_people
from gaitcal.cohort.one_person import (
    EVERY,
    NAMES,
    SHAPE,
    STEPS,
    VARIABLES,
    CommonSettings,
    pack_mean_curves,
    pack_no_curves,
)
from gaitcal.errors import Code
from gaitcal.gait.conventions import Signs
from gaitcal.gait.cycles import CurveKind
from gaitcal.gait.normal_bands import find_bands_file, read_normal_bands
from gaitcal.io.result_folder import read_listed_hashes
from gaitcal.report.page.plain_data import GAP
from gaitcal.results.table_files import write_csv
from tests.cohort.made_people import FORCES, KNEE, Kept, some_people, write_cohort
from tests.commands import run
from tests.intake.folders import recordings, write
from tests.messages import check_text, refuses
from tests.report.page.walked_blocks import held, scripts

MASS = 50.0
HOSTILE = "</script><script>window.hacked=1</script><img src=x onerror=window.hacked=1>@@PAGE@@"


def content(page: Path) -> dict[str, Any]:
    return held(page.read_text(encoding="utf-8"), "content")


def integers(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<i2")


def ensemble(path: Path) -> None:
    percent = np.arange(101)
    curves = {
        ("knee_angle", "r"): 20.0 + percent / 3.0,
        ("knee_angle_moment", "l"): np.where(percent > 50, np.nan, 0.3 * percent),
        ("hip_power", "r"): np.full(101, 1e9),
        ("lumbar_bending", "r"): percent * 1.0,
    }
    parts = [
        pd.DataFrame({"variable": name, "side": side, "percent": percent, "mean": mean, "se": 0.0})
        for (name, side), mean in curves.items()
    ]
    write_csv(pd.concat(parts), path)


def test_mean_curves_are_packed_by_body_mass(tmp_path: Path) -> None:
    ensemble(tmp_path / "ensemble.csv")
    found = integers(pack_mean_curves(tmp_path / "ensemble.csv", MASS)).reshape(SHAPE)
    percent = np.arange(0, 101, EVERY)
    angle, moment = STEPS[CurveKind.ANGLE], STEPS[CurveKind.MOMENT]
    knee = found[VARIABLES.index("knee_angle"), 0]
    np.testing.assert_allclose(angle * knee, 20 + percent / 3, atol=angle / 2 + 1e-9)
    other = found[VARIABLES.index("knee_angle_moment"), 1]
    np.testing.assert_allclose(
        moment * other[percent <= 50], 0.3 * percent[percent <= 50] / MASS, atol=moment / 2 + 1e-9
    )
    assert (other[percent > 50] == GAP).all()
    assert (
        found[VARIABLES.index("hip_power"), 0] == -GAP - 1
    ).all()  # what is too large does not become a gap
    assert (found[VARIABLES.index("knee_angle"), 1] == GAP).all()


def test_people_without_curves_have_room(tmp_path: Path) -> None:
    assert pack_mean_curves(tmp_path / "none.csv", MASS) == ""
    assert (integers(pack_no_curves()) == GAP).all()
    assert integers(pack_no_curves()).size == np.prod(SHAPE) == len(VARIABLES) * 2 * 51
    assert not pack_no_curves().endswith("=")  # people's texts can stand one behind the other


def test_measures_are_of_columns_that_are_there() -> None:
    for measure in MEASURES:
        for text in filter(None, (measure.column, measure.error)):
            assert {text.format("r"), text.format("l")} <= set(NAMES), text
        assert measure.joined or f"{measure.name}_r" not in NAMES, (
            "the page would show that column, with its sign"
        )


def test_everyone_stands_in_the_page(tmp_path: Path) -> None:
    page = write_cohort(tmp_path / "out", some_people())
    found = content(page)
    assert found["about"] | {"version": ""} == {
        "people": 6, "sessions": 7, "results": 6, "version": "", "settings": {}
    }  # fmt: skip
    columns = {column["name"]: column for column in found["columns"]}
    names = [columns["person"]["words"][k] for k in columns["person"]["of"]]
    assert names == ["Ann", "Bob", "Cid", "Dan", "Dan", "Eve"]
    speed = np.frombuffer(base64.b64decode(columns["speed_r"]["numbers"]), dtype="<f4")
    np.testing.assert_allclose(speed, [1.0, 1.4, 0.7, 1.3, 0.9, np.nan], rtol=1e-6)
    assert columns["speed_r"]["unit"] == "m/s"
    assert "cadence_r" not in columns  # nobody has it
    assert [tuple(cause.values()) for cause in found["reasons"]["causes"]] == [KNEE, FORCES]
    assert found["reasons"]["of"] == [[], [0], [1, 0], [], [], []]
    assert found["reasons"]["strideless"] is None
    assert [line["cause"] for line in found["failures"]] == ["the static trial is restless"]
    packed = next(
        text for attributes, text in scripts(page.read_text()) if 'id="curves-packed"' in attributes
    )
    curves = integers(packed).reshape(6, *SHAPE)
    assert curves[:, 0, :, 0].tolist() == [
        [100, 200],
        [300, 300],
        [9000, 9000],
        [10, GAP],
        [30, GAP],
        [100, 100],
    ]


def test_only_its_own_scripts_run(tmp_path: Path) -> None:
    hostile = [
        Kept(
            name=HOSTILE,
            group=HOSTILE,
            verdict="doubtful",
            reasons=(("warning", HOSTILE, HOSTILE),),
        ),
        Kept(name="b" + HOSTILE, cause=HOSTILE),
    ]
    html = write_cohort(tmp_path / "out", hostile).read_text(encoding="utf-8")
    assert "<img" not in html
    allowed = re.search(r"script-src ([^;]*);", html)
    assert allowed
    code = [text for attributes, text in scripts(html) if "type=" not in attributes]
    hashes = {
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        for text in code
    }
    assert set(allowed.group(1).split()) == hashes
    assert len(code) == 2


def test_the_same_people_give_the_same_bytes(tmp_path: Path) -> None:
    people = some_people()
    one = write_cohort(tmp_path / "one", people)
    other = write_cohort(tmp_path / "other", people[::-1])
    assert one.read_bytes() == other.read_bytes()
    assert (
        json.loads((one.parent / "manifest.json").read_text())["sha256"]["cohort.html"]
        == hashlib.sha256(one.read_bytes()).hexdigest()
    )


def test_normal_bands_are_per_body_mass(tmp_path: Path) -> None:
    page = write_cohort(
        tmp_path / "out", some_people(), CommonSettings(normal=find_bands_file("schwartz2008"))
    )
    bands = {curve["name"]: curve.get("normal") for curve in content(page)["curves"]}
    own = read_normal_bands("schwartz2008")["knee_angle_moment"]
    assert own.signs.signs is Signs.CLINICAL, "extensor, as the page has it"
    extensor = np.interp(range(0, 101, 2), own.percent, own.mean)
    np.testing.assert_allclose(bands["knee_angle_moment"]["mean"], extensor, atol=1e-4)
    assert "n = 83" in bands["hip_adduction_moment"]["source"]


def test_a_session_is_no_person_and_a_cohort_may_be_of_nobody(tmp_path: Path) -> None:
    people = [Kept(name="Dan", session=session) for session in ("post", "pre")]
    about = content(write_cohort(tmp_path / "out", people))["about"]
    assert (about["people"], about["sessions"]) == (1, 2)
    found = content(write_cohort(tmp_path / "none", [Kept(name="Zed", cause="restless")]))
    assert (found["about"]["results"], found["columns"], len(found["failures"])) == (0, [], 1)


def test_who_has_no_stride_that_counts_is_told(tmp_path: Path) -> None:
    """Trustworthy as they are, walks without a stride give no number of gait: nobody is to look for
    it in vain.
    """
    counts = [(1, 0, 0), (2, 1, 0), (0, 0, 0)]
    people = [
        Kept(name=name, row={"walks": walks, "strides_r": right, "strides_l": left})
        for name, (walks, right, left) in zip("abc", counts, strict=True)
    ]
    reasons = content(write_cohort(tmp_path / "out", people))["reasons"]
    assert reasons["of"] == [[0], [], []] and reasons["strideless"] == 0
    assert tuple(reasons["causes"][0].values()) == NO_STRIDE


def test_usage(tmp_path: Path) -> None:
    assert run("cohort", tmp_path).exit_code == 2
    with refuses(Code.OPTION, 0, field="--jobs"):
        run("cohort", tmp_path, "--out", tmp_path / "out", "--jobs", 0)
    with refuses(Code.COHORT):
        run("cohort", tmp_path, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_durations() -> None:
    assert [format_duration(s) for s in (12, 200, 7500)] == ["12 s", "3 min", "2 h 05 min"]


def test_tables_of_markers_are_recordings_and_tables_of_forces_are_not(tmp_path: Path) -> None:
    write(tmp_path / "Ann", recordings(), forces="grf")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "list.csv").write_text("a;b\n1;2\n")
    cohort = find_people(tmp_path, tmp_path / "out")
    assert ([p.name for p in cohort.people], cohort.ignored) == (["Ann"], ("notes",))


def test_lines_name_people_without_a_session(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tell = _make_progress_printer(Console(quiet=False, verbose=True), lambda text: None, 2)
    for session in ("", "pre"):
        one = replace(Kept(name="P1", session=session).outcome, computed=False)
        tell(one, 1, None)
    assert (
        capsys.readouterr().out
        == "P1: trustworthy, unchanged (1 of 2)\nP1 pre: trustworthy, unchanged (1 of 2)\n"
    )


@pytest.mark.parametrize(
    "words",
    [
        ("view", "COHORT", "--html", "page.html"),
        ("compare", "COHORT", "COHORT"),
        ("compare", "COHORT", "--osim", "model.osim"),
        ("dynamics", "COHORT", "walk.c3d"),
        ("export", "COHORT"),
        ("export", "COHORT", "--format", "cycles"),
        ("figures", "COHORT"),
        ("montecarlo", "COHORT"),
    ],
)
def test_a_cohort_is_no_result_of_one_person(tmp_path: Path, words: tuple[str, ...]) -> None:
    write_cohort(tmp_path, [Kept(name="Ann")])
    one = tmp_path / "people" / "Ann"
    one.mkdir(parents=True)
    (one / "manifest.json").write_text("{}")
    with refuses(Code.NO_RESULT, str(one)) as caught:
        run(*(tmp_path if word == "COHORT" else word for word in words))
    assert caught.value.code is Code.NO_RESULT


def test_the_manifest_of_a_cohort_is_signed(tmp_path: Path) -> None:
    write_cohort(tmp_path, [Kept(name="Ann")])
    assert {"people.csv", "cohort.html"} < set(read_listed_hashes(tmp_path))
    manifest = tmp_path / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"people": 1', '"people": 2'))
    with refuses(Code.DAMAGED_RESULT, source="manifest.json"):
        read_listed_hashes(tmp_path)


@pytest.mark.slow
def test_from_bare_folders_to_tables(tmp_path: Path) -> None:
    """One is calibrated, one has nobody who tells the mass, one has a file that is none; a second
    run does nothing.
    """
    lab, out = tmp_path / "lab", tmp_path / "out"
    write(lab / "Ann" / "day 1", recordings(), forces="grf")
    write(lab / "Bob", recordings(), forces="grf")
    (lab / "Cid").mkdir()
    (lab / "Cid" / "walk.c3d").write_bytes(b"no recording")
    (lab / "people.csv").write_text("person,group,sex,mass_kg,height_m\nAnn,controls,m,69.4,1.70\n")
    command = ("cohort", lab, "--out", out, "--jobs", 1)
    first = run(*command)
    assert first.exit_code == 1, first.output
    assert "1 of 3" in first.stdout
    assert f"page: {out / 'cohort.html'}" in first.stdout
    assert (out / "cohort.html").is_file()
    with (out / "people.csv").open(newline="") as stream:
        (ann,) = csv.DictReader(stream)
    assert (ann["person"], ann["session"], ann["group"]) == ("Ann", "day 1", "controls")
    result = out / ann["folder"]
    assert json.loads((result / "manifest.json").read_text())["subject"]["name"] == "Ann"
    assert 'session = "day 1"' in (result / "study.toml").read_text()
    with (out / "failures.csv").open(newline="") as stream:
        bob, cid = csv.DictReader(stream)
    check_text(bob["cause"], "subject.mass_kg")
    check_text(bob["what_to_do"], "mass_kg", "people.csv", "cohort.toml")
    assert (cid["person"], bob["code"], cid["code"]) == ("Cid", "GC-211", "GC-223")
    written = (result / "manifest.json").stat().st_mtime_ns
    again = run(*command)
    assert again.exit_code == 1
    assert "failed: Bob: subject.mass_kg" in again.stdout
    assert " of 3" not in again.stdout
    assert (result / "manifest.json").stat().st_mtime_ns == written
